//! Draws data/experiments/face.png, the picture of the first experiment: a face of 30 x 30 pixels, lit from the upper left,
//! with a parting and a beauty spot, so that a mirrored result shows.
//!
//! `cargo run --example draw_face [FILE [SIDE_PX]]`
//!
//! Every shape is a signed distance (negative inside) in units of the picture's side, x to the right, y down. Each pixel is the
//! mean of 16 x 16 samples in linear light, as a camera would see it.

use std::{env, error::Error, fs::File, io::BufWriter};

type Rgb = [f64; 3];

/// Samples across one pixel.
const SAMPLES: u32 = 16;

fn main() -> Result<(), Box<dyn Error>> {
    let mut args = env::args().skip(1);
    let path = args.next().unwrap_or_else(|| "data/experiments/face.png".into());
    let side: u32 = args.next().map_or(Ok(30), |text| text.parse())?;
    let mut encoder = png::Encoder::new(BufWriter::new(File::create(path)?), side, side);
    encoder.set_color(png::ColorType::Rgb);
    encoder.set_source_srgb(png::SrgbRenderingIntent::Perceptual);
    let pixels: Vec<u8> = (0..side * side).flat_map(|i| pixel(i % side, i / side, side)).collect();
    let mut writer = encoder.write_header()?;
    writer.write_image_data(&pixels)?;
    Ok(writer.finish()?)
}

fn pixel(column: u32, row: u32, side: u32) -> [u8; 3] {
    let mut sum = [0.0; 3];
    for i in 0..SAMPLES * SAMPLES {
        let at = |pixel: u32, sample: u32| {
            (f64::from(pixel) + (f64::from(sample) + 0.5) / f64::from(SAMPLES)) / f64::from(side)
        };
        let light = light(at(column, i % SAMPLES), at(row, i / SAMPLES));
        for (total, value) in sum.iter_mut().zip(light) {
            *total += value;
        }
    }
    sum.map(|total| {
        let linear = (total / f64::from(SAMPLES * SAMPLES)).clamp(0.0, 1.0);
        let encoded =
            if linear <= 0.003_130_8 { 12.92 * linear } else { 1.055 * linear.powf(1.0 / 2.4) - 0.055 };
        (encoded * 255.0).round() as u8
    })
}

/// The light at a point of the picture, painted from back to front.
fn light(x: f64, y: f64) -> Rgb {
    let mut colour = background(x, y);
    hair_behind(&mut colour, x, y);
    shoulders(&mut colour, x, y);
    neck(&mut colour, x, y);
    head(&mut colour, x, y);
    for side in [-1.0, 1.0] {
        eye(&mut colour, x, y, side);
    }
    nose(&mut colour, x, y);
    mouth(&mut colour, x, y);
    fringe(&mut colour, x, y);
    // A beauty spot on the cheek at the right of the picture.
    paint(&mut colour, srgb(86, 48, 36), ellipse(x, y, (0.625, 0.645), (0.016, 0.016)), 0.006);
    colour
}

fn background(x: f64, y: f64) -> Rgb {
    let glow = (-((x - 0.22).powi(2) + (y - 0.25).powi(2)) / 0.30).exp();
    mix(srgb(52, 74, 104), srgb(150, 178, 200), glow)
}

fn hair_behind(colour: &mut Rgb, x: f64, y: f64) {
    let cap = ellipse(x, y, (0.5, 0.40), (0.315, 0.345));
    let falls = ellipse(x, y, (0.5, 0.60), (0.315, 0.27));
    let strands = 0.5 + 0.5 * (70.0 * (x + 0.18 * y)).sin();
    let lit = (-((x - 0.33).powi(2) + (y - 0.17).powi(2)) / 0.022).exp();
    let hair = mix(srgb(52, 28, 18), srgb(78, 43, 26), 0.6 * strands);
    paint(colour, mix(hair, srgb(176, 112, 66), 0.85 * lit), cap.min(falls), 0.012);
}

fn shoulders(colour: &mut Rgb, x: f64, y: f64) {
    let cloth = ellipse(x, y, (0.5, 1.10), (0.46, 0.225));
    paint(colour, mix(srgb(176, 52, 48), srgb(92, 22, 30), x), cloth, 0.01);
}

fn neck(colour: &mut Rgb, x: f64, y: f64) {
    let throat = rounded_box(x, y, (0.5, 0.85), (0.092, 0.10), 0.06);
    // The chin throws a shadow.
    let shade = smooth(0.95, 0.80, y) * 0.75 + 0.25 * smooth(0.45, 0.62, x);
    paint(colour, mix(srgb(232, 178, 148), srgb(132, 78, 60), shade), throat, 0.01);
}

/// The skull is an ellipsoid; its shading is that of a matt surface lit from the upper left, with a weak light from the right.
fn head(colour: &mut Rgb, x: f64, y: f64) {
    let ear = ellipse(x, y, (0.265, 0.53), (0.035, 0.065)).min(ellipse(x, y, (0.735, 0.53), (0.035, 0.065)));
    paint(colour, if x < 0.5 { srgb(226, 160, 130) } else { srgb(140, 84, 66) }, ear, 0.01);
    let jaw = if y > 0.5 { 1.0 - 0.9 * (y - 0.5).powi(2) / 0.35 } else { 1.0 };
    let (u, v) = ((x - 0.5) / (0.232 * jaw), (y - 0.495) / 0.317);
    let inside = u * u + v * v;
    let normal_z = (1.0 - inside.min(1.0)).sqrt();
    let key = (-0.58 * u - 0.20 * v + 0.79 * normal_z).max(0.0);
    let fill = (0.8 * u + 0.5 * normal_z).max(0.0);
    let skin = srgb(250, 200, 168);
    let warm = srgb(204, 120, 92);
    let lit: Rgb = std::array::from_fn(|i| skin[i] * (0.12 + 0.88 * key) + 0.13 * warm[i] * fill);
    paint(colour, lit, (inside.sqrt() - 1.0) * 0.23, 0.012);
    for cheek in [0.395, 0.605] {
        let blush = (-((x - cheek).powi(2) + (y - 0.60).powi(2)) / 0.004).exp();
        let red = mix(*colour, srgb(214, 104, 92), 0.28 * blush);
        paint(colour, red, (inside.sqrt() - 0.97) * 0.23, 0.012);
    }
}

/// `side` -1: at the left of the picture.
fn eye(colour: &mut Rgb, x: f64, y: f64, side: f64) {
    let (cx, cy) = (0.5 + 0.100 * side, 0.490);
    let socket = (-((x - cx).powi(2) / 0.0060 + (y - cy + 0.012).powi(2) / 0.0022)).exp();
    *colour = mix(*colour, srgb(150, 88, 70), 0.30 * socket);
    let white = if side < 0.0 { srgb(246, 242, 236) } else { srgb(206, 196, 192) };
    let opening = ellipse(x, y, (cx, cy + 0.006), (0.064, 0.040));
    paint(colour, white, opening, 0.006);
    let iris = ellipse(x, y, (cx + 0.006, cy + 0.004), (0.032, 0.038)).max(opening);
    paint(colour, srgb(58, 88, 96), iris, 0.006);
    paint(colour, srgb(10, 10, 14), ellipse(x, y, (cx + 0.006, cy + 0.004), (0.019, 0.022)), 0.005);
    // Brows are arches, a little lower at the temples.
    let outward = (x - cx) * side;
    let rise = -0.10 * outward - 2.5 * outward.powi(2);
    let brow = rounded_box(x, y + rise, (cx + 0.004 * side, 0.412), (0.070, 0.020), 0.014);
    paint(colour, srgb(58, 32, 22), brow, 0.010);
}

fn nose(colour: &mut Rgb, x: f64, y: f64) {
    // The ridge catches the light, its right flank is in shade.
    let along = smooth(0.46, 0.50, y) * smooth(0.66, 0.62, y);
    let ridge = (-(x - 0.490).powi(2) / 0.00035).exp() * along;
    *colour = mix(*colour, srgb(255, 226, 200), 0.50 * ridge);
    let flank = (-(x - 0.532).powi(2) / 0.00050).exp() * along * smooth(0.46, 0.62, y);
    *colour = mix(*colour, srgb(128, 70, 54), 0.55 * flank);
    for (cx, strength) in [(0.472, 0.65), (0.530, 0.85)] {
        let nostril = (-((x - cx).powi(2) / 0.00035 + (y - 0.640).powi(2) / 0.00016)).exp();
        *colour = mix(*colour, srgb(84, 38, 30), strength * nostril);
    }
}

fn mouth(colour: &mut Rgb, x: f64, y: f64) {
    let (u, smile) = (x - 0.5, 0.9 * (x - 0.5).powi(2));
    let upper = ellipse(x, y + smile, (0.5, 0.712), (0.088, 0.021));
    let lower = ellipse(x, y + smile, (0.5, 0.738), (0.072, 0.024));
    paint(colour, mix(srgb(128, 26, 34), srgb(84, 12, 22), smooth(-0.06, 0.08, u)), upper, 0.006);
    paint(colour, mix(srgb(158, 40, 46), srgb(104, 22, 30), smooth(-0.06, 0.08, u)), lower, 0.006);
    let line = ellipse(x, y + smile, (0.5, 0.723), (0.088, 0.006));
    paint(colour, srgb(40, 6, 10), line, 0.006);
    let chin = (-((x - 0.5).powi(2) / 0.004 + (y - 0.780).powi(2) / 0.0003)).exp();
    *colour = mix(*colour, srgb(120, 66, 52), 0.15 * chin);
}

/// Hair over the forehead: the parting is at the left of the picture.
fn fringe(colour: &mut Rgb, x: f64, y: f64) {
    let forehead = ellipse(x, y, (0.5, 0.50), (0.235, 0.32));
    let right = ellipse(x, y, (0.63, 0.215), (0.235, 0.125));
    let left = ellipse(x, y, (0.315, 0.275), (0.085, 0.145));
    let strands = 0.5 + 0.5 * (75.0 * (x + 0.9 * y)).sin();
    let lit = (-((x - 0.44).powi(2) / 0.012 + (y - 0.185).powi(2) / 0.004)).exp();
    let hair = mix(mix(srgb(48, 26, 16), srgb(84, 46, 28), 0.6 * strands), srgb(184, 118, 70), 0.8 * lit);
    paint(colour, hair, right.min(left).max(forehead - 0.05), 0.012);
}

/// Lays `paint` over `colour` where `distance` is negative, with an edge of the given softness.
fn paint(colour: &mut Rgb, paint: Rgb, distance: f64, softness: f64) {
    *colour = mix(*colour, paint, smooth(softness, -softness, distance));
}

/// Near the edge, the distance to an ellipse; exact in sign.
fn ellipse(x: f64, y: f64, centre: (f64, f64), radii: (f64, f64)) -> f64 {
    let (u, v) = ((x - centre.0) / radii.0, (y - centre.1) / radii.1);
    (u.hypot(v) - 1.0) * radii.0.min(radii.1)
}

fn rounded_box(x: f64, y: f64, centre: (f64, f64), half: (f64, f64), radius: f64) -> f64 {
    let (u, v) = ((x - centre.0).abs() - half.0 + radius, (y - centre.1).abs() - half.1 + radius);
    u.max(0.0).hypot(v.max(0.0)) + u.max(v).min(0.0) - radius
}

/// 0 at `from`, 1 at `to`, smooth between; the two may be in either order.
fn smooth(from: f64, to: f64, x: f64) -> f64 {
    let t = ((x - from) / (to - from)).clamp(0.0, 1.0);
    t * t * (3.0 - 2.0 * t)
}

fn mix(a: Rgb, b: Rgb, part: f64) -> Rgb {
    std::array::from_fn(|i| a[i] + (b[i] - a[i]) * part.clamp(0.0, 1.0))
}

/// Linear light of an sRGB colour.
fn srgb(r: u8, g: u8, b: u8) -> Rgb {
    [r, g, b].map(|value| {
        let v = f64::from(value) / 255.0;
        if v <= 0.040_45 { v / 12.92 } else { ((v + 0.055) / 1.055).powf(2.4) }
    })
}
