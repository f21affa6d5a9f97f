//! The one schema of everything on the wire.
