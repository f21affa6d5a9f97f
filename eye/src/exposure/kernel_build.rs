//! Building the kernels of a scene: wavefronts at the points of the field, their transfer functions, the light that each lets
//! in, spectral weights, what a cone collects of them ([`super::around`]), and the low-rank basis.

use glam::{DMat2, DVec2};
use rayon::prelude::*;
use rustfft::num_complex::Complex64;

use super::around::{Around, Moments};
use super::field::Field;
use super::kernel::{
    APERTURE_UM, ARRIVING_TOLERANCE, Head, KernelSpec, Kernels, KindBasis, MEAN_WEIGHT, PlaceKernels, SHARES,
    TABLE_TOLERANCE, Tables, UM_PER_TANGENT,
};
use super::lowrank::{Modes, Span, add, modes};
use super::padua::FieldNodes;
use super::polar::PolarShape;
use super::spectral::{ARRIVING, KINDS, Paths, Share};
use super::transfer::{FieldPoint, Transfer, extent, extent_about_centroid, transfer_table};
use crate::optics::Projection;
use crate::optics::beam::nominal_mm2;
use crate::psf::{FieldTable, Wavefront};

/// Error of the spectral modes over that of the basis.
const MODES: f64 = 0.15;
/// Transfer tables that are made before they are added up.
pub const BLOCK: usize = 32;

/// A kernel that is being added up: of one spectral mode and field point.
struct Place {
    field: usize,
    /// `[primary][wavelength]`.
    weights: Vec<Vec<f64>>,
    /// `[primary·sample]`.
    kernel: Vec<Complex64>,
}

/// Samples of kernels that are added up together.
const SAMPLES: usize = 1024;

impl Place {
    /// Adds those of some consecutive transfers (`[field][wavelength]`, the first is number `first`) that are of its field point.
    fn add(&mut self, first: usize, transfers: &[Transfer], waves: usize) {
        let own = self.field * waves..(self.field + 1) * waves;
        let (from, to) = (own.start.max(first), own.end.min(first + transfers.len()));
        if from >= to {
            return;
        }
        let transfers = &transfers[from - first..to - first];
        let samples = self.kernel.len() / self.weights.len().max(1);
        // Some samples at a time: they stay at hand for all transfers and primaries.
        for at in (0..samples).step_by(SAMPLES) {
            let some = at..samples.min(at + SAMPLES);
            for (wave, transfer) in (from - own.start..).zip(transfers) {
                for (primary, weights) in self.weights.iter().enumerate() {
                    let kernel = &mut self.kernel[primary * samples..][some.clone()];
                    if weights[wave] != 0.0 {
                        add(kernel, &transfer.table[some.clone()], weights[wave]);
                    }
                }
            }
        }
    }
}

impl KernelSpec {
    /// Computes the kernels, with the table that [`KernelSpec::wavefronts`] names.
    ///
    /// # Errors
    /// When a field point is not seen or an eye cannot be traced.
    pub fn build(&self, table: Option<&FieldTable>) -> Result<Kernels, String> {
        let projection = self.projection()?;
        let points: Vec<FieldPoint> = self
            .field()
            .points()
            .iter()
            .map(|um| FieldPoint::new(&projection, *um))
            .collect::<Result<_, _>>()?;
        // Everything in the order of points and wavelengths, whatever thread computes it.
        let rho = self.stiles_crawford_rho10_per_mm2;
        let field = Field::new(&projection, table);
        let wavefronts: Vec<Vec<Wavefront>> = points
            .par_iter()
            .map(|point| field.wavefronts(point, &self.nodes_nm, rho))
            .collect::<Result<_, String>>()?;
        // Images stand where their light is, so that kernels change little over the field.
        let anchors = self.anchors(&points, &wavefronts)?;
        let nodes = self.field();
        let points: Vec<FieldPoint> = points
            .into_iter()
            .zip(&anchors)
            .map(|(point, anchor)| {
                let (_, slope) = displacement(&nodes, &anchors, point.landing_um);
                point.anchored(*anchor, slope)
            })
            .collect();
        let jobs: Vec<(&FieldPoint, &Wavefront)> =
            points.iter().zip(&wavefronts).flat_map(|(p, waves)| waves.iter().map(move |w| (p, w))).collect();
        let shape = self.shape_for(&jobs)?;
        // Light that enters the pupil from each point at each wavelength, over that of the nominal pupil on the line of sight.
        let nominal = nominal_mm2(self.state.pupil_mm);
        let entering = |(p, w): &(&FieldPoint, &Wavefront)| {
            self.emission_law.irradiance(&self.screen, p.tangent) * w.pupil_area_mm2 / nominal
        };
        let factors: Vec<f64> = jobs.iter().map(entering).collect();
        let media = self.absorbers()?.media;
        let paths: Vec<Paths> = jobs.iter().map(|(_, w)| Paths::new(w, &media)).collect();
        // What cones do with the wavelengths is a mixture of few modes; each has a kernel for sources at every point.
        let Modes { mixtures, modes } = self.modes(points.len(), &paths)?;
        let (kernels, throughput) = self.kernels_by_mode(&jobs, &factors, &modes, shape);
        let blur = |(p, w): &(&FieldPoint, &Wavefront)| extent(p, w)[0];
        let spot = jobs.iter().map(blur).fold(0.0, f64::max);
        let kernels = self.collected((&projection, &points), (kernels, shape), spot)?;
        let (kinds, tables, basis_error) = self.basis(kernels, &mixtures, points.len(), shape);
        let ranks = [tables[0].len(), tables[1].len()];
        Ok(Kernels {
            head: Head {
                spec: self.clone(),
                shape,
                kinds,
                ranks,
                basis_error,
                throughput,
                anchors,
                paths: self.mean_paths(&paths),
            },
            field: self.field(),
            ecc: self.ecc(),
            shares: self.shares(),
            tables,
        })
    }

    /// What cones at the points of the field collect, `[mode][field point]`, from the kernels of sources at these points.
    fn collected(
        &self,
        (projection, points): (&Projection, &[FieldPoint]),
        (kernels, shape): (Vec<PlaceKernels>, PolarShape),
        spot: f64,
    ) -> Result<Vec<PlaceKernels>, String> {
        let (moments, nodes) = (Moments::new(shape), self.field());
        let size = (spot, self.tolerance);
        let around = |point: &FieldPoint| Around::new(projection, &nodes, point, size);
        let arounds: Vec<Around> = points.par_iter().map(around).collect::<Result<_, _>>()?;
        // The kernels of sources are given back mode by mode: they are the most of the memory.
        let of_mode = |kernels: PlaceKernels| {
            let of_sources: Vec<&[Complex64]> = kernels.iter().map(Vec::as_slice).collect();
            let place = |own: usize| arounds[own].collected(&moments, &of_sources, own);
            (0..points.len()).into_par_iter().map(place).collect()
        };
        Ok(kernels.into_iter().map(of_mode).collect())
    }

    /// Means over the field nodes, `[wavelength]`, of paths `[field node][wavelength]`.
    fn mean_paths(&self, paths: &[Paths]) -> Vec<Paths> {
        let waves = self.nodes_nm.len();
        let fields = (paths.len() / waves.max(1)).max(1) as f64;
        let mean = |wave: usize, of: fn(&Paths) -> f64| {
            paths.iter().skip(wave).step_by(waves).map(of).sum::<f64>() / fields
        };
        (0..waves).map(|i| Paths { cornea: mean(i, |p| p.cornea), lens: mean(i, |p| p.lens) }).collect()
    }

    /// The shape of the tables: a wavelength that is caught little need not be resolved as well.
    fn shape_for(&self, jobs: &[(&FieldPoint, &Wavefront)]) -> Result<PolarShape, String> {
        let absorbers = self.absorbers()?;
        let paths = Paths { cornea: 1.0, lens: 1.0 };
        let mut caught = vec![0.0_f64; self.nodes_nm.len()];
        for shares in &self.shares() {
            for kind in KINDS {
                let weights = absorbers.weights(shares, &self.nodes_nm, kind, self.ecc_deg[1], paths);
                let total: f64 = weights.iter().sum();
                caught
                    .iter_mut()
                    .zip(&weights)
                    .for_each(|(c, w)| *c = c.max(w / total.max(f64::MIN_POSITIVE)));
            }
        }
        let mut cycles = [0.0_f64; 2];
        for ((point, wavefront), caught) in jobs.iter().zip(caught.iter().cycle()) {
            // The error is proportional to the catch and to the sixth power of the cycles.
            let [blur, shift] =
                extent_about_centroid(point, wavefront).map(|e| e * self.band * caught.powf(1.0 / 6.0));
            cycles = [cycles[0].max(blur), cycles[1].max(shift)];
        }
        Ok(PolarShape::for_cycles(self.band, cycles, TABLE_TOLERANCE * self.tolerance))
    }

    /// `[field point]`: displacement of the light's centroid from the chief ray at the reference wavelength, µm, over what L, M and S
    /// cones catch of all primaries.
    fn anchors(&self, points: &[FieldPoint], wavefronts: &[Vec<Wavefront>]) -> Result<Vec<DVec2>, String> {
        let absorbers = self.absorbers()?;
        let paths = Paths { cornea: 1.0, lens: 1.0 };
        let mut caught = vec![0.0; self.nodes_nm.len()];
        for (primary, kind) in self.shares().iter().flat_map(|p| (0..ARRIVING).map(move |kind| (p, kind))) {
            let weights = absorbers.weights(primary, &self.nodes_nm, KINDS[kind], self.ecc_deg[1], paths);
            caught.iter_mut().zip(weights).for_each(|(c, w)| *c += SHARES[kind] * w);
        }
        let total: f64 = caught.iter().sum::<f64>().max(f64::MIN_POSITIVE);
        let of_point = |(point, waves): (&FieldPoint, &Vec<Wavefront>)| {
            let to_chart = point.chart_from_tangents();
            let of_wave = |w: &Wavefront| w.landing_um - point.landing_um + to_chart * w.centroid_um();
            waves.iter().zip(&caught).map(|(w, c)| *c / total * of_wave(w)).sum()
        };
        Ok(points.par_iter().zip(wavefronts).map(of_point).collect())
    }

    /// Spectral modes: how each kind of cone at each eccentricity weighs wavelengths is `Σ_s mixture[kind, ecc][s] mode_s`, a mode
    /// being weights `[field point][primary][wavelength]`, one after the other.
    fn modes(&self, points: usize, paths: &[Paths]) -> Result<Modes, String> {
        let absorbers = self.absorbers()?;
        let kinks_nm = self.prescription.kinks_nm(self.state.dispersion);
        let nodes = (self.nodes_nm.as_slice(), kinks_nm.as_slice());
        let shares = self.shares();
        let waves = self.nodes_nm.len();
        let rows: Vec<(usize, f64)> = (0..KINDS.len())
            .flat_map(|kind| self.ecc_values().into_iter().map(move |ecc_deg| (kind, ecc_deg)))
            .collect();
        let of_row = |&(kind, ecc_deg): &(usize, f64)| -> Vec<f64> {
            let of_point = |point: usize| {
                let along = &paths[point * waves..(point + 1) * waves];
                let of_primary =
                    |s: &Vec<Share>| absorbers.smooth_weights(s, nodes, KINDS[kind], ecc_deg, along);
                shares.iter().flat_map(of_primary).collect::<Vec<f64>>()
            };
            (0..points).flat_map(of_point).collect()
        };
        let rows: Vec<Vec<f64>> = rows.par_iter().map(of_row).collect();
        Ok(modes(&rows, MODES * self.tolerance))
    }

    /// `[mode][field point]`, and the mean throughput. Transfer tables of `jobs` (`[field point][wavelength]`) are made a few at a
    /// time and added up: all of them would be the most of the memory.
    fn kernels_by_mode(
        &self,
        jobs: &[(&FieldPoint, &Wavefront)],
        factors: &[f64],
        modes: &[Vec<f64>],
        shape: PolarShape,
    ) -> (Vec<PlaceKernels>, f64) {
        let (waves, primaries) = (self.nodes_nm.len().max(1), self.primaries.len());
        let points = jobs.len() / waves;
        let place = |(mode, field): (&Vec<f64>, usize)| {
            let own = &mode[field * primaries * waves..(field + 1) * primaries * waves];
            let weights = own.chunks_exact(waves).map(<[f64]>::to_vec).collect();
            Place { field, weights, kernel: vec![Complex64::ZERO; primaries * shape.len()] }
        };
        let mut places: Vec<Place> =
            modes.iter().flat_map(|mode| (0..points).map(move |field| (mode, field))).map(place).collect();
        let mut throughput = 0.0;
        for (block, (jobs, factors)) in jobs.chunks(BLOCK).zip(factors.chunks(BLOCK)).enumerate() {
            let transfers: Vec<Transfer> = jobs
                .par_iter()
                .zip(factors)
                .map(|((p, w), factor)| transfer_table(p, w, shape).times(*factor))
                .collect();
            throughput += transfers.iter().map(|t| t.throughput).sum::<f64>();
            places.par_iter_mut().for_each(|place| place.add(block * BLOCK, &transfers, waves));
        }
        let mut kernels = places.into_iter().map(|place| place.kernel);
        let by_mode = (0..modes.len()).map(|_| kernels.by_ref().take(points).collect()).collect();
        (by_mode, throughput / jobs.len().max(1) as f64)
    }

    /// The low-rank basis of `kernels[mode][field point]`: by kind the coefficients of each place, the tables of counts and of
    /// arriving photons, and the error of the former.
    fn basis(
        &self,
        kernels: Vec<PlaceKernels>,
        mixtures: &[Vec<f64>],
        points: usize,
        shape: PolarShape,
    ) -> (Vec<KindBasis>, [Tables; 2], f64) {
        let weights = basis_weights(shape, self.primaries.len());
        let steps = self.ecc_values().len();
        let modes = kernels.len();
        let kernels: Vec<Vec<Complex64>> = kernels.into_iter().flatten().collect();
        // A place (field point, eccentricity) has its mixture of the modes' kernels at its own point.
        let of_kind = |kind: usize| -> Vec<Vec<f64>> {
            let place = |place: usize| {
                let (field, mixture) = (place / steps, &mixtures[kind * steps + place % steps]);
                let mut own = vec![0.0; modes * points];
                mixture.iter().enumerate().for_each(|(mode, part)| own[mode * points + field] = *part);
                own
            };
            (0..points * steps).map(place).collect()
        };
        let by_kind: Vec<Vec<Vec<f64>>> = (0..KINDS.len()).map(of_kind).collect();
        let sets: Vec<&[Vec<f64>]> = by_kind.iter().map(Vec::as_slice).collect();
        let span = Span::new(&kernels, &weights);
        let counted = span.reduce(&sets[..ARRIVING], &SHARES, self.tolerance);
        // Arriving photons enter the budget only, where places average out: a coarser basis will do.
        let tolerance = ARRIVING_TOLERANCE * self.tolerance;
        let arriving = span.reduce(&sets[ARRIVING..], &[1.0], tolerance);
        let basis_of = |kind: usize| if kind == ARRIVING { &arriving } else { &counted };
        let kinds = by_kind.iter().enumerate().map(|(kind, places)| {
            let from_basis = places.iter().map(|own| basis_of(kind).coefficients(own)).collect();
            KindBasis { from_basis }
        });
        let kinds = kinds.collect();
        let error = counted.error;
        let split = |kernel: &Vec<Complex64>| kernel.chunks(shape.len()).map(<[Complex64]>::to_vec).collect();
        let tables = [&counted, &arriving].map(|basis| basis.kernels.iter().map(split).collect());
        (kinds, tables, error)
    }
}

/// The displacement of images at a place of the retina (µm), and how it changes there, from those at the points of the field.
pub(super) fn displacement(nodes: &FieldNodes, anchors: &[DVec2], um: DVec2) -> (DVec2, DMat2) {
    let at = nodes.weights(um).iter().zip(anchors).map(|(w, a)| *w * *a).sum();
    let by = |axis: usize| nodes.slopes(um).iter().zip(anchors).map(|(s, a)| s.first[axis] * *a).sum();
    (at, DMat2::from_cols(by(0), by(1)))
}

/// Weights of the samples in the basis: `dν/ν` times the aperture's transform squared, and the mean.
///
/// An error of the kernel at frequencies about ν spreads over an area of 1/ν². Its share of the light over the whole image (L1) is the
/// root of area times energy, `|e(ν)|·ν·(1/ν)`: every octave weighs the same; so it does in the mean picture, whose power falls with
/// 1/ν². With the area ν dν alone (L2) 11 images left an L1 of 2.3e-3 on one lit pixel; so weighted 12 leave 3.9e-4.
pub(super) fn basis_weights(shape: PolarShape, primaries: usize) -> Vec<f64> {
    let at = |i: usize| i % shape.radial;
    let of_octave = |i: usize| {
        let nu = shape.radius * at(i) as f64 / (shape.radial - 1) as f64;
        let blur = (-0.5 * (std::f64::consts::TAU * nu / UM_PER_TANGENT * APERTURE_UM / 4.0).powi(2)).exp();
        if at(i) == 0 { 0.0 } else { blur * blur / at(i) as f64 }
    };
    let one: Vec<f64> = (0..shape.len()).map(of_octave).collect();
    let mean = MEAN_WEIGHT * one.iter().sum::<f64>() / shape.azimuthal as f64;
    let one: Vec<f64> = (0..).zip(one).map(|(i, w)| if at(i) == 0 { mean } else { w }).collect();
    one.repeat(primaries)
}
