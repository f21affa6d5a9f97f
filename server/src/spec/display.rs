//! The display: a preset of data/displays, then the fields of the spec over it; a list of primaries replaces the preset's whole.

use photoneye_eye::catalog;
use photoneye_eye::display::{
    Channel, Display, EmissionLaw, Levels, Panel, Placement, Primary, Scan, Transfer, Waveform, White,
};
use photoneye_eye::spectrum::Spectrum;
use photoneye_proto::v1::{self, spectrum, waveform};
use photoneye_proto::{FieldError, from_json};

use super::read::{choice, empty_choice, field_error, in_range, needed, number, numbers};

/// The validated-to-be display of a spec.
///
/// # Errors
/// The first field that is missing or does not fit.
pub fn display(spec: Option<&v1::Display>) -> Result<Display, FieldError> {
    let spec = needed("display", spec)?;
    let spec = match &spec.preset {
        None => spec.clone(),
        Some(name) => over(preset(name)?, spec),
    };
    let white = match (spec.white_luminance_cd_m2, spec.lumens) {
        (Some(_), Some(_)) => {
            return Err(FieldError::new("display.lumens", "excludes `white_luminance_cd_m2`"));
        }
        (None, Some(lumens)) => White::Lumens(lumens + 0.0),
        (luminance, None) => White::LuminanceCdM2(needed("display.white_luminance_cd_m2", luminance)? + 0.0),
    };
    let primaries =
        (0..).zip(&spec.primaries).map(|(i, one)| primary(&format!("display.primaries[{i}]"), one));
    let mut primaries: Vec<Primary> = primaries.collect::<Result<_, _>>()?;
    let white_channel = white_channel(&spec, &primaries)?;
    for primary in primaries.iter_mut().filter(|primary| primary.channel == Channel::White) {
        primary.channel = white_channel;
    }
    primaries.extend(spec.ambient.as_ref().map(ambient).transpose()?);
    let contrast = spec.contrast.map(|c| in_range("display.contrast", c, 1.0, 1e9)).transpose()?;
    let width_px = needed("display.width_px", spec.width_px)?;
    let height_px = needed("display.height_px", spec.height_px)?;
    let display = Display {
        width_px,
        height_px,
        pixel_pitch_cm: needed("display.pixel_pitch_cm", spec.pixel_pitch_cm)?,
        distance_cm: needed("display.distance_cm", spec.distance_cm)?,
        placement: placement(&spec, [width_px, height_px])?,
        white,
        frame_rate_hz: needed("display.frame_rate_hz", spec.frame_rate_hz)?,
        transfer: transfer(&spec)?,
        emission_law: emission_law(&spec)?,
        black: contrast.map_or(0.0, |contrast| 1.0 / contrast),
        panel: Panel { lag_ms: number(spec.lag_ms, 0.0), levels: levels(spec.levels.as_ref())? },
        primaries,
    };
    // Now, because other fields take their defaults from these.
    display.validate().map_err(field_error)?;
    Ok(display)
}

/// A display of data/displays.
///
/// # Errors
/// When there is none of that name (the message lists them), or its file does not fit the schema.
pub fn preset(name: &str) -> Result<v1::Display, FieldError> {
    let text = catalog::text("displays", name).ok_or_else(|| {
        let names = catalog::names("displays").join("`, `");
        FieldError::new("display.preset", format!("unknown display `{name}`, expected one of `{names}`"))
    })?;
    from_json(text)
        .map_err(|error| FieldError::new("display.preset", format!("data/displays/{name}.json: {error}")))
}

fn over(preset: v1::Display, spec: &v1::Display) -> v1::Display {
    // The two ways to say how bright white is exclude each other: one in the spec takes both from the preset.
    let bright = spec.white_luminance_cd_m2.is_some() || spec.lumens.is_some();
    let white = if bright { spec } else { &preset };
    let (white_luminance_cd_m2, lumens) = (white.white_luminance_cd_m2, white.lumens);
    let primaries = if spec.primaries.is_empty() { preset.primaries } else { spec.primaries.clone() };
    v1::Display {
        preset: spec.preset.clone(),
        width_px: spec.width_px.or(preset.width_px),
        height_px: spec.height_px.or(preset.height_px),
        pixel_pitch_cm: spec.pixel_pitch_cm.or(preset.pixel_pitch_cm),
        distance_cm: spec.distance_cm.or(preset.distance_cm),
        white_luminance_cd_m2,
        lumens,
        frame_rate_hz: spec.frame_rate_hz.or(preset.frame_rate_hz),
        primaries,
        transfer: spec.transfer.or(preset.transfer),
        emission_law: spec.emission_law.or(preset.emission_law),
        description: spec.description.clone().or(preset.description),
        contrast: spec.contrast.or(preset.contrast),
        ambient: spec.ambient.clone().or(preset.ambient),
        lag_ms: spec.lag_ms.or(preset.lag_ms),
        levels: spec.levels.or(preset.levels),
        source: spec.source.clone().or(preset.source),
        licence: spec.licence.clone().or(preset.licence),
        placement: spec.placement.or(preset.placement),
        eye_at_px: if spec.eye_at_px.is_empty() { preset.eye_at_px } else { spec.eye_at_px.clone() },
        tilt_deg: spec.tilt_deg.or(preset.tilt_deg),
        turn_deg: spec.turn_deg.or(preset.turn_deg),
        curvature_radius_cm: spec.curvature_radius_cm.or(preset.curvature_radius_cm),
        white_driven_by: spec.white_driven_by.or(preset.white_driven_by),
        // A transfer of the spec takes the place of the preset's with its numbers.
        gamma: spec.gamma.or(preset.gamma.filter(|_| spec.transfer.is_none())),
        hlg_system_gamma: spec
            .hlg_system_gamma
            .or(preset.hlg_system_gamma.filter(|_| spec.transfer.is_none())),
    }
}

/// What drives the primaries `white`.
fn white_channel(spec: &v1::Display, primaries: &[Primary]) -> Result<Channel, FieldError> {
    use v1::display::WhiteDrivenBy as W;
    let field = "display.white_driven_by";
    let is_white = |primary: &Primary| primary.channel == Channel::White;
    let is_mixed = primaries.iter().any(is_white) && !primaries.iter().all(is_white);
    if is_mixed && spec.white_driven_by.is_none() {
        let message = "is missing: a white primary beside coloured ones is driven by the `MEAN` of red, green and \
                       blue or by the `LEAST` of them";
        return Err(FieldError::new(field, message));
    }
    Ok(match choice(field, spec.white_driven_by, W::Mean, W::as_str_name)? {
        W::Mean => Channel::White,
        W::Least => Channel::Least,
    })
}

/// How the screen stands before the head.
fn placement(spec: &v1::Display, size_px: [u32; 2]) -> Result<Placement, FieldError> {
    use v1::display::Placement as P;
    let placed = choice("display.placement", spec.placement, P::Fixed, P::as_str_name)?;
    if placed == P::Frontal {
        let given = [
            ("eye_at_px", !spec.eye_at_px.is_empty()),
            ("tilt_deg", spec.tilt_deg.is_some()),
            ("turn_deg", spec.turn_deg.is_some()),
            ("curvature_radius_cm", spec.curvature_radius_cm.is_some()),
        ];
        return match given.into_iter().find(|(_, is_given)| *is_given) {
            Some((name, _)) => {
                Err(FieldError::new(format!("display.{name}"), "excludes `placement` `FRONTAL`"))
            }
            None => Ok(Placement::Frontal),
        };
    }
    let eye_at_px = if spec.eye_at_px.is_empty() {
        size_px.map(|size| 0.5 * f64::from(size))
    } else {
        numbers("display.eye_at_px", &spec.eye_at_px)?
    };
    Ok(Placement::Fixed {
        eye_at_px,
        tilt_deg: number(spec.tilt_deg, 0.0),
        turn_deg: number(spec.turn_deg, 0.0),
        curvature_radius_cm: spec.curvature_radius_cm.map(|radius_cm| radius_cm + 0.0),
    })
}

fn transfer(spec: &v1::Display) -> Result<Transfer, FieldError> {
    use v1::display::Transfer as T;
    let transfer = choice("display.transfer", spec.transfer, T::Srgb, T::as_str_name)?;
    // Numbers that the transfer does not have.
    let has = [
        ("gamma", spec.gamma.is_some() && transfer != T::Gamma, "GAMMA"),
        ("hlg_system_gamma", spec.hlg_system_gamma.is_some() && transfer != T::Hlg, "HLG"),
    ];
    if let Some((name, _, owner)) = has.into_iter().find(|(_, is_odd, _)| *is_odd) {
        return Err(FieldError::new(format!("display.{name}"), format!("needs `transfer` `{owner}`")));
    }
    Ok(match transfer {
        T::Gamma => Transfer::Gamma(needed("display.gamma", spec.gamma)? + 0.0),
        T::Hlg => Transfer::Hlg(spec.hlg_system_gamma.map(|gamma| gamma + 0.0)),
        T::Srgb => Transfer::Srgb,
        T::Bt1886 => Transfer::Bt1886,
        T::Linear => Transfer::Linear,
        T::Pq => Transfer::Pq,
    })
}

fn emission_law(spec: &v1::Display) -> Result<EmissionLaw, FieldError> {
    use v1::display::EmissionLaw as E;
    let law = choice("display.emission_law", spec.emission_law, E::Lambertian, E::as_str_name)?;
    Ok(match law {
        E::Lambertian => EmissionLaw::Lambertian,
        E::Uniform => EmissionLaw::Uniform,
    })
}

fn primary(path: &str, spec: &v1::Primary) -> Result<Primary, FieldError> {
    let name_path = format!("{path}.name");
    let channel = match needed(&name_path, spec.name.as_deref())? {
        "red" => Channel::Red,
        "green" => Channel::Green,
        "blue" => Channel::Blue,
        "white" => Channel::White,
        other => {
            let message =
                format!("unknown primary `{other}`, expected one of `red`, `green`, `blue`, `white`");
            return Err(FieldError::new(name_path, message));
        }
    };
    let rect = |(i, rect): (usize, &v1::Rect)| -> Result<[f64; 4], FieldError> {
        let corner =
            |name: &str, value| needed(&format!("{path}.rects[{i}].{name}"), value).map(|v: f64| v + 0.0);
        Ok([corner("x0", rect.x0)?, corner("y0", rect.y0)?, corner("x1", rect.x1)?, corner("y1", rect.y1)?])
    };
    let mut rects = spec.rects.iter().enumerate().map(rect).collect::<Result<Vec<_>, _>>()?;
    if rects.is_empty() {
        rects.push([0.0, 0.0, 1.0, 1.0]);
    }
    let offset = spec.offset_px.unwrap_or_default();
    Ok(Primary {
        channel,
        spectrum: spectrum(&format!("{path}.spectrum"), spec.spectrum.as_ref())?,
        power: number(spec.power, 1.0),
        rects,
        offset_px: [number(offset.x, 0.0), number(offset.y, 0.0)],
        spot_sd_px: number(spec.spot_sd_px, 0.0),
        waveform: waveform(&format!("{path}.waveform"), spec.waveform.as_ref())?,
    })
}

/// Room light: a primary that nothing drives; a matt surface of reflectance ρ under E lx has the luminance Eρ/π.
fn ambient(spec: &v1::Ambient) -> Result<Primary, FieldError> {
    let lux = needed("display.ambient.illuminance_lux", spec.illuminance_lux)?;
    let lux = in_range("display.ambient.illuminance_lux", lux, 0.0, 2e5)? + 0.0;
    let part = in_range("display.ambient.reflectance", number(spec.reflectance, 0.005), 0.0, 1.0)?;
    let spectrum = match &spec.spectrum {
        None => Spectrum::named("room-light/d65")
            .map_err(|message| FieldError::new("display.ambient.spectrum", message))?,
        given => spectrum("display.ambient.spectrum", given.as_ref())?,
    };
    Ok(Primary {
        channel: Channel::Room,
        spectrum,
        power: lux * part / std::f64::consts::PI,
        rects: vec![[0.0, 0.0, 1.0, 1.0]],
        offset_px: [0.0; 2],
        spot_sd_px: 0.0,
        waveform: Waveform::Steady,
    })
}

fn levels(spec: Option<&v1::Levels>) -> Result<Levels, FieldError> {
    use v1::levels::Kind as K;
    let Some(spec) = spec else {
        return Ok(Levels::Continuous);
    };
    let (bits, dither) = (spec.bits.unwrap_or(8), spec.dither.unwrap_or(false));
    Ok(match choice("display.levels.kind", spec.kind, K::Values, K::as_str_name)? {
        K::Values => Levels::Values { bits, dither },
        K::BitPlanes => Levels::Planes { bits, dither },
    })
}

fn waveform(path: &str, spec: Option<&v1::Waveform>) -> Result<Waveform, FieldError> {
    let of_pixel = pixel_waveform(path, spec)?;
    Ok(match spec.and_then(|spec| spec.scan) {
        None => of_pixel,
        Some(scan) => {
            let scan = Scan { share: number(scan.share, 0.95), line: number(scan.line, 0.8) };
            Waveform::Scanned { pixel: Box::new(of_pixel), scan }
        }
    })
}

fn pixel_waveform(path: &str, spec: Option<&v1::Waveform>) -> Result<Waveform, FieldError> {
    let pulse = |pulse: &waveform::Pulse| [number(pulse.start, 0.0), number(pulse.end, 1.0)];
    Ok(match spec.map(|spec| spec.kind.as_ref()) {
        None | Some(Some(waveform::Kind::Steady(_))) => Waveform::Steady,
        Some(Some(waveform::Kind::Pulse(one))) => Waveform::Pulses(vec![pulse(one)]),
        Some(Some(waveform::Kind::Pulses(all))) => Waveform::Pulses(all.parts.iter().map(pulse).collect()),
        Some(Some(waveform::Kind::Pwm(pwm))) => Waveform::Pwm {
            hz: needed(&format!("{path}.pwm.hz"), pwm.hz)?,
            duty: needed(&format!("{path}.pwm.duty"), pwm.duty)?,
        },
        Some(Some(waveform::Kind::Phosphor(phosphor))) => Waveform::Phosphor {
            decay_us: needed(&format!("{path}.phosphor.decay_us"), phosphor.decay_us)?,
            start: number(phosphor.start, 0.0),
        },
        // A scan alone: pixels hold their light until their next turn.
        Some(None) if spec.is_some_and(|spec| spec.scan.is_some()) => Waveform::Steady,
        Some(None) => return Err(empty_choice(path, &["steady", "pulse", "pulses", "pwm", "phosphor"])),
    })
}

fn spectrum(path: &str, spec: Option<&v1::Spectrum>) -> Result<Spectrum, FieldError> {
    match &needed(path, spec)?.kind {
        Some(spectrum::Kind::Line(line)) => Ok(Spectrum::Line {
            nm: needed(&format!("{path}.line.nm"), line.nm)?,
            fwhm_nm: number(line.fwhm_nm, 0.0),
        }),
        Some(spectrum::Kind::Named(name)) => {
            Spectrum::named(name).map_err(|message| FieldError::new(format!("{path}.named"), message))
        }
        Some(spectrum::Kind::Table(table)) => Ok(Spectrum::Table {
            nm: table.nm.iter().map(|nm| nm + 0.0).collect(),
            value: table.value.iter().map(|value| value + 0.0).collect(),
        }),
        Some(spectrum::Kind::EqualEnergy(_)) => Ok(Spectrum::EqualEnergy),
        None => Err(empty_choice(path, &["line", "named", "table", "equal_energy"])),
    }
}
