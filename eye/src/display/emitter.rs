//! Lowering: a display becomes a list of emitters, flat data without a device.
//!
//! Luminance L (cd/m²) of full white is the mean over the pixel pitch, so a pixel of area A emits the flux πLA (Lambertian) or
//! 2πLA (uniform over the half space); a flux of Φ lumens of the whole screen is shared evenly. On axis a source of flux Φ has
//! the intensity Φ/π or Φ/2π; the pupil of area P at distance d takes P/d² of it (§6).

use super::{Channel, Display, EmissionLaw, Waveform, White};
use crate::photometry::{luminous_flux_per_power, photons_per_joule};
use crate::spectrum::Spectrum;

/// Photons of one wavelength from one fully driven pixel in one frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PhotonSample {
    /// Wavelength, nm.
    pub nm: f64,
    /// Photons into the half space.
    pub emitted: f64,
}

/// One primary, lowered.
#[derive(Clone, Debug, PartialEq)]
pub struct Emitter {
    /// What drives it.
    pub channel: Channel,
    /// Photons of a fully driven pixel in a frame, by wavelength.
    pub photons: Vec<PhotonSample>,
    /// Rectangles in pixel units with the misregistration in them, each with its share of the light (by area).
    pub rects: Vec<([f64; 4], f64)>,
    /// Standard deviation of the Gaussian that blurs the rectangles, pixels.
    pub spot_sd_px: f64,
    /// When it gives its light.
    pub waveform: Waveform,
}

impl Emitter {
    /// The rectangle `[x0, y0, x1, y1]` that a photon comes from, by share, for a uniform number.
    pub fn rect(&self, uniform: f64) -> [f64; 4] {
        let mut left = uniform;
        for (rect, share) in &self.rects {
            if left < *share {
                return *rect;
            }
            left -= share;
        }
        self.rects[self.rects.len() - 1].0
    }

    /// Whether another one shines at the same places at the same times where a picture is gray: they differ in their spectra alone.
    pub fn shines_with(&self, other: &Self) -> bool {
        let driven = |e: &Self| e.channel != Channel::Room;
        let place = |e: &Self| (e.rects.clone(), e.spot_sd_px);
        driven(self) && driven(other) && self.waveform == other.waveform && place(self) == place(other)
    }

    /// One emitter for several that shine together.
    #[must_use]
    pub fn together(&self, others: &[&Self]) -> Self {
        let mut photons: Vec<PhotonSample> = std::iter::once(self)
            .chain(others.iter().copied())
            .flat_map(|e| e.photons.iter().copied())
            .collect();
        photons.sort_by(|a, b| a.nm.total_cmp(&b.nm));
        photons.dedup_by(|next, sum| {
            let same = next.nm.total_cmp(&sum.nm).is_eq();
            if same {
                sum.emitted += next.emitted;
            }
            same
        });
        Self { photons, ..self.clone() }
    }

    /// Photons of a fully driven pixel in a frame, all wavelengths.
    pub fn emitted(&self) -> f64 {
        self.photons.iter().map(|p| p.emitted).sum()
    }
}

/// Shares of the photons of each spectrum by wavelength (nm, share); the shares of one spectrum sum to 1.
pub fn photon_shares(spectra: &[Spectrum]) -> Vec<Vec<(f64, f64)>> {
    let shares = |spectrum: &Spectrum| {
        let photons: Vec<_> =
            spectrum.samples().iter().map(|s| (s.nm, s.power * photons_per_joule(s.nm))).collect();
        let total: f64 = photons.iter().map(|p| p.1).sum();
        photons.into_iter().map(|(nm, n)| (nm, n / total)).collect()
    };
    spectra.iter().map(shares).collect()
}

/// Share of a pixel's photons that a pupil of the nominal area takes at the corneal apex on the line of sight. The beam that
/// enters the eye is less, because the entrance pupil lies behind the apex ([`crate::optics::BeamField`]).
pub fn pupil_share(display: &Display, pupil_mm: f64) -> f64 {
    let area_cm2 = std::f64::consts::FRAC_PI_4 * (pupil_mm / 10.0).powi(2);
    pupil_share_at(display.emission_law, area_cm2, display.distance_cm)
}

/// Share of the photons of a source that meets an area (cm²) at a distance (cm) on axis.
pub fn pupil_share_at(law: EmissionLaw, pupil_cm2: f64, distance_cm: f64) -> f64 {
    let solid_angle = match law {
        EmissionLaw::Lambertian => std::f64::consts::PI,
        EmissionLaw::Uniform => std::f64::consts::TAU,
    };
    pupil_cm2 / (distance_cm * distance_cm * solid_angle)
}

/// The emitters of a display.
///
/// # Errors
/// When the primaries give no light that is seen (a luminance cannot be made from them).
pub fn emitters(display: &Display) -> Result<Vec<Emitter>, String> {
    let spectra: Vec<_> = display.primaries.iter().map(|p| p.spectrum.samples()).collect();
    let mut lumens_of_white = 0.0;
    let mut lumens_per_watt = Vec::with_capacity(spectra.len());
    for (primary, samples) in display.primaries.iter().zip(&spectra) {
        let lumens = luminous_flux_per_power(samples)?;
        if primary.channel != Channel::Room {
            lumens_of_white += primary.power * lumens;
        }
        lumens_per_watt.push(lumens);
    }
    let pixel_lumens = display.pixel_lumens();
    let room_unseen =
        |(p, lumens): (&super::Primary, &f64)| p.channel == Channel::Room && p.power > 0.0 && *lumens <= 0.0;
    if display.primaries.iter().zip(&lumens_per_watt).any(room_unseen) {
        return Err("display.ambient.spectrum: it holds nothing that the luminous efficiency weighs".into());
    }
    if lumens_of_white <= 0.0 && pixel_lumens > 0.0 {
        return Err("display.primaries: they emit nothing that the luminous efficiency weighs, so no luminance can be reached".into());
    }
    let scale = if pixel_lumens > 0.0 { pixel_lumens / lumens_of_white } else { 0.0 };
    let seconds = 1.0 / display.frame_rate_hz;
    let lower = |((primary, samples), lumens): ((&super::Primary, &Vec<crate::spectrum::Sample>), &f64)| {
        let watts = match primary.channel {
            Channel::Room if primary.power > 0.0 => display.lumens_of(primary.power) / lumens,
            Channel::Room => 0.0,
            _ => scale * primary.power,
        };
        let photons = samples
            .iter()
            .map(|s| PhotonSample { nm: s.nm, emitted: watts * s.power * seconds * photons_per_joule(s.nm) })
            .collect();
        let area: f64 = primary.rects.iter().map(|r| (r[2] - r[0]) * (r[3] - r[1])).sum();
        let [dx, dy] = primary.offset_px;
        let rects = primary
            .rects
            .iter()
            .map(|[x0, y0, x1, y1]| ([x0 + dx, y0 + dy, x1 + dx, y1 + dy], (x1 - x0) * (y1 - y0) / area))
            .collect();
        let (spot_sd_px, waveform) = (primary.spot_sd_px, primary.waveform.clone());
        Emitter { channel: primary.channel, photons, rects, spot_sd_px, waveform }
    };
    Ok(display.primaries.iter().zip(&spectra).zip(&lumens_per_watt).map(lower).collect())
}

impl Display {
    /// Retinal illuminance by a white screen and the room light on it, through a pupil (diameter, mm), trolands.
    pub fn white_trolands(&self, pupil_mm: f64) -> f64 {
        let white = self.white_cd_m2();
        let room: f64 = self.primaries.iter().filter(|p| p.channel == Channel::Room).map(|p| p.power).sum();
        (white + room) * std::f64::consts::FRAC_PI_4 * pupil_mm * pupil_mm
    }

    /// Luminance of full white, without the room's light, cd/m².
    pub fn white_cd_m2(&self) -> f64 {
        match self.white {
            White::LuminanceCdM2(luminance) => luminance,
            White::Lumens(_) => self.pixel_lumens() / self.lumens_of(1.0),
        }
    }

    /// Luminous flux of one fully white pixel, lm.
    fn pixel_lumens(&self) -> f64 {
        match self.white {
            White::LuminanceCdM2(luminance) => self.lumens_of(luminance),
            White::Lumens(flux) => flux / (f64::from(self.width_px) * f64::from(self.height_px)),
        }
    }

    /// Luminous flux of one pixel of a luminance (cd/m²), lm.
    fn lumens_of(&self, luminance: f64) -> f64 {
        let area_m2 = (self.pixel_pitch_cm / 100.0).powi(2);
        match self.emission_law {
            EmissionLaw::Lambertian => std::f64::consts::PI * luminance * area_m2,
            EmissionLaw::Uniform => std::f64::consts::TAU * luminance * area_m2,
        }
    }
}
