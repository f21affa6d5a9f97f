//! Content-addressed blobs and the stored (Arrow) form of cones and counts.
