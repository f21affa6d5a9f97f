//! What is known of a video before anything is computed: which primaries it lights at all, and how much of the screen. Of drawn patterns; an
//! uploaded clip may light all primaries and is taken as evenly lit.

use super::Rule;
use crate::display::{Channel, Place, emitters};
use crate::experiment::{Experiment, Video};
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
                Channel::White | Channel::Room => rgb.iter().any(|v| *v > 0.0),
            })
            || display.driven(channel, &[0.0; 3], place) > 0.0
    };
    let lit: Vec<bool> = display.primaries.iter().map(|p| lights(p.channel)).collect();
    if lit.contains(&true) { lit } else { all }
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
    let light = picture.rgb.iter().map(|v| display.curve().light(f64::from(*v).clamp(0.0, 1.0)));
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
