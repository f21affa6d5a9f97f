//! Filling of convex polygons on a sample grid: a sample belongs to a polygon when its centre is inside (half-open, so that
//! polygons sharing an edge never share a sample).

/// Calls `mark` with the index `row * width + column` of every sample whose centre is in the polygon.
pub fn fill(
    corners: impl Iterator<Item = [f32; 2]>,
    width: usize,
    height: usize,
    mut mark: impl FnMut(usize),
) {
    let corners: Vec<[f32; 2]> = corners.collect();
    let first_row = clamp_row(corners.iter().map(|c| c[1]).fold(f32::MAX, f32::min), height);
    let last_row = clamp_row(corners.iter().map(|c| c[1]).fold(f32::MIN, f32::max), height);
    for row in first_row..last_row {
        let y = row as f32 + 0.5;
        let (mut left, mut right) = (f32::MAX, f32::MIN);
        for (i, a) in corners.iter().enumerate() {
            let b = corners[(i + 1) % corners.len()];
            if (a[1] <= y) != (b[1] <= y) {
                let x = a[0] + (y - a[1]) / (b[1] - a[1]) * (b[0] - a[0]);
                left = left.min(x);
                right = right.max(x);
            }
        }
        for column in clamp_row(left, width)..clamp_row(right, width) {
            mark(row * width + column);
        }
    }
}

/// The first sample whose centre is at or past `at`, within the grid.
fn clamp_row(at: f32, samples: usize) -> usize {
    ((at - 0.5).ceil().max(0.0) as usize).min(samples)
}
