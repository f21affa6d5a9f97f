//! Spectra: tables with their interpolation, display spectra, and the samples over which every spectral integral is summed (§5).
//!
//! Wavelengths in nm, 390 to 830. A spectral integral is a sum over [`Sample`]s: 0.5 nm trapezoids for smooth spectra, Gauss
//! points for a narrow line, one point for a single wavelength; so lines stay exact and nothing snaps to channels.

use serde::{Deserialize, Serialize};

use crate::catalog;
use crate::experiment::{RangeError, check_range};

/// Shortest wavelength, nm.
pub const MIN_NM: f64 = 390.0;
/// Longest wavelength, nm.
pub const MAX_NM: f64 = 830.0;
/// Spacing of the samples of a smooth spectrum, nm.
const STEP_NM: f64 = 0.5;

/// Radiant power against wavelength, relative.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub enum Spectrum {
    /// A Gaussian line; a width of 0 is a single wavelength.
    Line {
        /// Centre, nm.
        nm: f64,
        /// Full width at half maximum, nm.
        fwhm_nm: f64,
    },
    /// Power per nm at increasing wavelengths, linear between, 0 outside.
    Table {
        /// Wavelengths, nm.
        nm: Vec<f64>,
        /// Power per nm.
        value: Vec<f64>,
    },
    /// The same power per nm everywhere.
    EqualEnergy,
}

/// One term of a spectral sum: radiant power at a wavelength.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sample {
    /// Wavelength, nm.
    pub nm: f64,
    /// Radiant power, relative.
    pub power: f64,
}

impl Spectrum {
    /// A spectrum of data/spectra, `table/column`.
    ///
    /// # Errors
    /// When there is no such table or column; the message lists those that exist.
    pub fn named(name: &str) -> Result<Self, String> {
        let (file, column) = name.split_once('/').unwrap_or((name, ""));
        let table = Table::load(file)?;
        let value = table.column(column)?.to_vec();
        Ok(Self::Table { nm: table.nm, value })
    }

    /// Checks ranges. `path` is the field's path in the schema.
    ///
    /// # Errors
    /// The first field that is out of range.
    pub fn validate(&self, path: &str) -> Result<(), RangeError> {
        match self {
            Self::Line { nm, fwhm_nm } => {
                check_range(&format!("{path}.line.nm"), *nm, MIN_NM, MAX_NM)?;
                check_range(&format!("{path}.line.fwhm_nm"), *fwhm_nm, 0.0, 50.0)
            }
            Self::Table { nm, value } => validate_table(path, nm, value),
            Self::EqualEnergy => Ok(()),
        }
    }

    /// The samples over which integrals are summed; powers are not negative, zero ones are left out.
    pub fn samples(&self) -> Vec<Sample> {
        match self {
            Self::Line { nm, fwhm_nm } if *fwhm_nm < 1e-3 => vec![Sample { nm: *nm, power: 1.0 }],
            Self::Line { nm, fwhm_nm } => line_samples(*nm, *fwhm_nm),
            Self::Table { nm, value } => smooth_samples(|x| linear(nm, value, x)),
            Self::EqualEnergy => smooth_samples(|_| 1.0),
        }
    }
}

fn validate_table(path: &str, nm: &[f64], value: &[f64]) -> Result<(), RangeError> {
    if nm.len() < 2 || nm.len() != value.len() || nm.len() > 4401 {
        let found = format!("{} wavelengths and {} values", nm.len(), value.len());
        return Err(RangeError::new(
            &format!("{path}.table"),
            found,
            "2 to 4401 of each, as many of one as of the other",
        ));
    }
    let mut least = 0.0;
    for (i, (&x, &y)) in nm.iter().zip(value).enumerate() {
        check_range(&format!("{path}.table.nm[{i}]"), x, least, 2000.0)?;
        check_range(&format!("{path}.table.value[{i}]"), y, 0.0, 1e12)?;
        least = x + 1e-6;
    }
    Ok(())
}

/// 0.5 nm trapezoids of a function of wavelength.
fn smooth_samples(f: impl Fn(f64) -> f64) -> Vec<Sample> {
    let last = ((MAX_NM - MIN_NM) / STEP_NM) as usize;
    (0..=last)
        .map(|i| {
            let nm = MIN_NM + STEP_NM * i as f64;
            let width = if i == 0 || i == last { 0.5 * STEP_NM } else { STEP_NM };
            Sample { nm, power: width * f(nm) }
        })
        .filter(|s| s.power > 0.0)
        .collect()
}

/// A Gaussian line of unit power as 33 equal steps over ±4 standard deviations, cut at the ends of the range.
fn line_samples(nm: f64, fwhm_nm: f64) -> Vec<Sample> {
    let sd = fwhm_nm / (8.0 * std::f64::consts::LN_2).sqrt();
    let weight = |i: i32| (-0.5 * (f64::from(i) / 4.0).powi(2)).exp();
    let total: f64 = (-16..=16).map(weight).sum();
    (-16..=16)
        .map(|i| Sample { nm: nm + sd * f64::from(i) / 4.0, power: weight(i) / total })
        .filter(|s| (MIN_NM..=MAX_NM).contains(&s.nm))
        .collect()
}

/// Linear interpolation in a table of increasing `x`; 0 outside.
fn linear(x: &[f64], y: &[f64], at: f64) -> f64 {
    let above = x.partition_point(|&v| v < at);
    match above {
        0 if x[0] > at => 0.0,
        0 => y[0],
        n if n == x.len() => 0.0,
        n => {
            let t = (at - x[n - 1]) / (x[n] - x[n - 1]);
            y[n - 1] + t * (y[n] - y[n - 1])
        }
    }
}

/// A table of data/spectra: wavelengths and named columns.
#[derive(Clone, Debug)]
pub struct Table {
    name: String,
    /// Wavelengths, nm (or another first column), increasing.
    pub nm: Vec<f64>,
    columns: Vec<(String, Vec<f64>)>,
}

impl Table {
    /// Reads an embedded table: `#` comments, a header line, rows of numbers.
    ///
    /// # Errors
    /// When there is no such table (the message lists them) or a row is not numbers.
    pub fn load(name: &str) -> Result<Self, String> {
        let text = catalog::text("spectra", name).ok_or_else(|| {
            format!("no spectrum table `{name}`, there are {}", catalog::names("spectra").join(", "))
        })?;
        let mut lines = text.lines().filter(|l| !l.starts_with('#') && !l.trim().is_empty());
        let header: Vec<&str> = lines.next().unwrap_or_default().split(',').collect();
        let mut columns: Vec<(String, Vec<f64>)> =
            header.iter().map(|h| ((*h).to_owned(), Vec::new())).collect();
        for line in lines {
            let cells: Vec<&str> = line.split(',').collect();
            if cells.len() != columns.len() {
                return Err(format!(
                    "table `{name}`: row `{line}` has {} cells, not {}",
                    cells.len(),
                    columns.len()
                ));
            }
            for (cell, (_, column)) in cells.iter().zip(&mut columns) {
                column.push(
                    cell.trim().parse().map_err(|_| format!("table `{name}`: `{cell}` is not a number"))?,
                );
            }
        }
        let nm = if columns.is_empty() { Vec::new() } else { columns.remove(0).1 };
        Ok(Self { name: name.to_owned(), nm, columns })
    }

    /// One column by name.
    ///
    /// # Errors
    /// When there is no such column; the message lists them.
    pub fn column(&self, name: &str) -> Result<&[f64], String> {
        self.columns.iter().find(|(n, _)| n == name).map(|(_, v)| v.as_slice()).ok_or_else(|| {
            let known: Vec<String> = self.columns.iter().map(|(n, _)| format!("{}/{n}", self.name)).collect();
            format!("no spectrum `{}/{name}`, there are {}", self.name, known.join(", "))
        })
    }

    /// One column as a natural cubic spline.
    ///
    /// # Errors
    /// As [`Table::column`].
    pub fn spline(&self, name: &str) -> Result<Spline, String> {
        Ok(Spline::natural(&self.nm, self.column(name)?))
    }
}

/// A natural cubic spline; constant outside its knots.
#[derive(Clone, Debug)]
pub struct Spline {
    x: Vec<f64>,
    y: Vec<f64>,
    /// Second derivatives at the knots.
    bend: Vec<f64>,
}

impl Spline {
    /// The natural cubic spline through the points; `x` increasing, two points or more.
    pub fn natural(x: &[f64], y: &[f64]) -> Self {
        let n = x.len();
        let mut bend = vec![0.0; n];
        let mut upper = vec![0.0; n];
        // Thomas algorithm on the tridiagonal system of second derivatives.
        for i in 1..n.saturating_sub(1) {
            let (h0, h1) = (x[i] - x[i - 1], x[i + 1] - x[i]);
            let slope_change = 6.0 * ((y[i + 1] - y[i]) / h1 - (y[i] - y[i - 1]) / h0);
            let pivot = 2.0 * (h0 + h1) - h0 * upper[i - 1];
            upper[i] = h1 / pivot;
            bend[i] = (slope_change - h0 * bend[i - 1]) / pivot;
        }
        for i in (1..n.saturating_sub(1)).rev() {
            bend[i] -= upper[i] * bend[i + 1];
        }
        Self { x: x.to_vec(), y: y.to_vec(), bend }
    }

    /// The value at `at`.
    pub fn at(&self, at: f64) -> f64 {
        let last = self.x.len() - 1;
        if at <= self.x[0] {
            return self.y[0];
        }
        if at >= self.x[last] {
            return self.y[last];
        }
        let i = self.x.partition_point(|&v| v <= at) - 1;
        let h = self.x[i + 1] - self.x[i];
        let (a, b) = ((self.x[i + 1] - at) / h, (at - self.x[i]) / h);
        let bent = (a * a * a - a) * self.bend[i] + (b * b * b - b) * self.bend[i + 1];
        a * self.y[i] + b * self.y[i + 1] + bent * h * h / 6.0
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_line_keeps_its_power_and_its_centre() {
        let samples = Spectrum::Line { nm: 543.0, fwhm_nm: 2.0 }.samples();
        let power: f64 = samples.iter().map(|s| s.power).sum();
        let mean: f64 = samples.iter().map(|s| s.power * s.nm).sum::<f64>() / power;
        let variance: f64 = samples.iter().map(|s| s.power * (s.nm - mean).powi(2)).sum::<f64>() / power;
        assert!((power - 1.0).abs() < 1e-12 && (mean - 543.0).abs() < 1e-9);
        assert!(((variance * 8.0 * std::f64::consts::LN_2).sqrt() - 2.0).abs() < 0.002);
    }

    #[test]
    fn equal_energy_integrates_to_the_range() {
        let power: f64 = Spectrum::EqualEnergy.samples().iter().map(|s| s.power).sum();
        assert!((power - 440.0).abs() < 1e-9);
    }

    #[test]
    fn splines_reproduce_cubics_away_from_the_ends() {
        let x: Vec<f64> = (0..41).map(f64::from).collect();
        let y: Vec<f64> = x.iter().map(|v| v.powi(3) - 20.0 * v * v).collect();
        let spline = Spline::natural(&x, &y);
        let exact = 20.3_f64.powi(3) - 20.0 * 20.3 * 20.3;
        assert!((spline.at(20.3) - exact).abs() < 1e-6 * exact.abs());
    }

    #[test]
    fn unknown_names_list_the_known_ones() {
        assert!(Spectrum::named("nothing/red").is_err_and(|e| e.contains("projector-uhp")));
        assert!(Spectrum::named("projector-uhp/pink").is_err_and(|e| e.contains("projector-uhp/green")));
    }
}
