//! What is known of a video before anything is computed: which primaries it lights at all, and how much of the screen. Of drawn patterns; an
//! uploaded clip may light all primaries and is taken as evenly lit.

use glam::DVec2;

use super::Rule;
use crate::display::{Channel, Place, emitters};
use crate::experiment::{Experiment, Pattern, Video};
use crate::exposure::joins;
use crate::exposure::primaries::groups;
use crate::spectrum::Spectrum;
use crate::video::{ScreenView, draw};

/// A larger picture is not looked at: planning takes milliseconds.
const MOST_PIXELS: u64 = 200_000;

/// By primary: whether any pixel of the video lights it.
pub fn primaries(experiment: &Experiment) -> Vec<bool> {
    let display = &experiment.display;
    let all = vec![true; display.primaries.len()];
    let pixels = u64::from(display.width_px) * u64::from(display.height_px);
    let Video::Pattern(pattern) = &experiment.video else { return all };
    if !Rule::UnlitPrimaries.applies(experiment)
        || display.black > 0.0
        || pixels > MOST_PIXELS
        || all.len() < 2
    {
        return all;
    }
    let Ok(view) = ScreenView::of(experiment) else { return all };
    let picture = draw(pattern, &view);
    let place = Place { column: 0, row: 0, frame: 0 };
    // Dither may light a dark value in some frame: only a value of 0 is dark in all.
    let lights = |channel: Channel| {
        channel == Channel::Room
            || picture.rgb.chunks_exact(3).any(|rgb| match channel {
                Channel::Red => rgb[0] > 0.0,
                Channel::Green => rgb[1] > 0.0,
                Channel::Blue => rgb[2] > 0.0,
                Channel::Least => rgb.iter().all(|v| *v > 0.0),
                Channel::White | Channel::Room => rgb.iter().any(|v| *v > 0.0),
            })
            || display.driven(channel, &[0.0; 3], place) > 0.0
    };
    let lit: Vec<bool> = display.primaries.iter().map(|p| lights(p.channel)).collect();
    if lit.contains(&true) { lit } else { all }
}

/// Least and most of the lit pixels' edges, pixels of the display; `None` when nothing is lit. The whole
/// display where the picture is not looked at.
pub fn bounds_px(experiment: &Experiment) -> Option<[DVec2; 2]> {
    let display = &experiment.display;
    let size = DVec2::new(f64::from(display.width_px), f64::from(display.height_px));
    let whole = Some([DVec2::ZERO, size]);
    let is_dark = |channel| display.driven(channel, &[0.0; 3], Place { column: 0, row: 0, frame: 0 }) <= 0.0;
    let black = display.black <= 0.0 && display.primaries.iter().all(|p| is_dark(p.channel));
    let Video::Pattern(pattern) = &experiment.video else { return whole };
    let room = display.primaries.iter().any(|p| p.channel == Channel::Room && p.power > 0.0);
    if !black || room {
        return whole;
    }
    let is_lit = |rgb: &[f64; 3]| rgb.iter().any(|v| *v > 0.0);
    match pattern {
        Pattern::Uniform { rgb } => return whole.filter(|_| is_lit(rgb)),
        Pattern::Point { at_px: [x, y], rgb } => {
            let at = DVec2::new(f64::from(*x), f64::from(*y));
            return is_lit(rgb).then_some([at, at + 1.0]);
        }
        _ if size.x * size.y > MOST_PIXELS as f64 => return whole,
        _ => {}
    }
    let Ok(view) = ScreenView::of(experiment) else { return whole };
    let picture = draw(pattern, &view);
    let lit = picture.rgb.chunks_exact(3).enumerate().filter(|(_, rgb)| rgb.iter().any(|v| *v > 0.0));
    lit.map(|(pixel, _)| {
        let at = [pixel as u32 % display.width_px, pixel as u32 / display.width_px];
        DVec2::from(at.map(f64::from))
    })
    .fold(None, |found, at| {
        let [min, max] = found.unwrap_or([at, at + 1.0]);
        Some([min.min(at), max.max(at + 1.0)])
    })
}

/// Primaries that `expected` computes: fewer than there are where a drawn pattern is gray. What an uploaded clip shows is not known yet.
pub fn computed_primaries(experiment: &Experiment) -> usize {
    let all = experiment.display.primaries.len();
    let gray = matches!(&experiment.video, Video::Pattern(pattern) if pattern.is_gray());
    match emitters(&experiment.display) {
        Ok(emitters) if gray && joins(experiment, &emitters) => groups(&emitters).len(),
        _ => all,
    }
}

/// Root mean square over mean of the picture's light: 1 of an even picture, the root of the number of pixels of a single lit one.
pub fn sparsity(experiment: &Experiment) -> f64 {
    let display = &experiment.display;
    let Video::Pattern(pattern) = &experiment.video else { return 1.0 };
    if u64::from(display.width_px) * u64::from(display.height_px) > MOST_PIXELS {
        return 1.0;
    }
    let Ok(view) = ScreenView::of(experiment) else { return 1.0 };
    let picture = draw(pattern, &view);
    let curve = display.curve();
    let light = picture
        .rgb
        .chunks_exact(3)
        .flat_map(|rgb| curve.lights(std::array::from_fn(|i| f64::from(rgb[i]).clamp(0.0, 1.0))));
    let (sum, squares) = light.fold((0.0, 0.0), |(sum, squares), l| (sum + l, squares + l * l));
    if sum > 0.0 { (squares * picture.rgb.len() as f64).sqrt() / sum } else { 1.0 }
}

/// The spectra for which kernels are made: an unlit primary, whose kernel is multiplied by nothing, has that of the first lit one.
pub fn spectra(experiment: &Experiment) -> Vec<Spectrum> {
    let lit = primaries(experiment);
    let all = &experiment.display.primaries;
    let stand_in = lit.iter().position(|lit| *lit).unwrap_or(0);
    all.iter()
        .zip(&lit)
        .map(|(p, lit)| if *lit { &p.spectrum } else { &all[stand_in].spectrum }.clone())
        .collect()
}
