//! Drawn pictures: each pixel holds the value whose light is the pattern's mean there (gratings and squares are sampled at pixel
//! centres).

use super::Picture;
use crate::display::Display;
use crate::experiment::{Gaze, Pattern};

/// Draws a pattern for a display and a gaze.
pub fn draw(pattern: &Pattern, display: &Display, gaze: &Gaze) -> Picture {
    let (width, height) = (display.width_px, display.height_px);
    let mut rgb = Vec::with_capacity(3 * width as usize * height as usize);
    for row in 0..height {
        for column in 0..width {
            rgb.extend(pixel(pattern, display, gaze, column, row).map(|v| v as f32));
        }
    }
    Picture { width, height, rgb }
}

fn pixel(pattern: &Pattern, display: &Display, gaze: &Gaze, column: u32, row: u32) -> [f64; 3] {
    match pattern {
        Pattern::Uniform { rgb } => *rgb,
        Pattern::Grating { cycles_per_degree, contrast, orientation_deg, phase_deg } => {
            // Degrees from the gaze centre, x right, y up.
            let pixel_deg = display.pixel_radians().to_degrees();
            let x = (f64::from(column) + 0.5 - gaze.center_px[0]) * pixel_deg;
            let y = (gaze.center_px[1] - f64::from(row) - 0.5) * pixel_deg;
            let (sin, cos) = orientation_deg.to_radians().sin_cos();
            let cycles = cycles_per_degree * (x * cos + y * sin);
            let light =
                0.5 * (1.0 + contrast * (std::f64::consts::TAU * cycles + phase_deg.to_radians()).cos());
            [display.transfer.value(light.clamp(0.0, 1.0)); 3]
        }
        Pattern::Checkerboard { square_px } => {
            let white = (column / square_px + row / square_px).is_multiple_of(2);
            [if white { 1.0 } else { 0.0 }; 3]
        }
        Pattern::Point { at_px, rgb } => {
            if *at_px == [column, row] {
                *rgb
            } else {
                [0.0; 3]
            }
        }
    }
}
