//! Optical kernels of a scene: what the eye and the cones' filters do to a display's primaries, as Fourier transforms.
//!
//! For primary k, kind T (isomerized in L, M, S; arriving) and a place on the retina (field point f, eccentricity e):
//! `K(ν) = Σ_m w_{kTe,m} OTF_f(λ_m, J⁻ᵀν) exp(-2πi J⁻ᵀν·δ_f(λ_m))`, ν in cycles per unit tangent of the screen, J the
//! magnification (µm per unit tangent) at f, δ the landing point of the chief ray at λ_m from that at 543 nm (transverse chromatic
//! shift). Between places K is interpolated by Lagrange polynomials over Padua points of the field ([`super::padua`]) and Chebyshev nodes of eccentricity; a low-rank basis then spans all places and
//! types of cones ([`super::lowrank`]), so that a cone's mean is a short sum of basis images.
//!
//! Absolute: K(0) is the share of photons through the entrance pupil that is counted; nothing is renormalized.

use glam::DVec2;
use rayon::prelude::*;
use rustfft::num_complex::Complex64;
use serde::{Deserialize, Serialize};

use super::density::densities;
use super::field::Field;
use super::lowrank::{add, compress, compress_together, reduce};
use super::padua::FieldNodes;
use super::polar::PolarShape;
use super::spectral::{ARRIVING, Absorbers, KINDS, Paths, Share, paths_at};
use super::transfer::{FieldPoint, Transfer, extent, transfer_table};
use super::{codec, nodes};
use crate::cone::pigment::Pigments;
use crate::display::photon_shares;
use crate::media::Media;
use crate::optics::{EyeState, Prescription, Projection, SchematicEye};
use crate::psf::{FieldTable, FieldTableSpec, Wavefront};
use crate::spectrum::Spectrum;

const MAGIC: [u8; 8] = *b"PEkernl4";
/// Diameter of the smallest cones, µm: frequencies that such an aperture averages away weigh less in the basis.
const APERTURE_UM: f64 = 2.0;
/// µm of retina per unit tangent near the fovea, for that weight only.
const UM_PER_TANGENT: f64 = 16_440.0;
/// Tolerance of the basis for arriving photons over that for counts.
const ARRIVING_TOLERANCE: f64 = 10.0;
/// Interpolation error of the tables over that of the basis: the means feel it less.
pub const TABLE_TOLERANCE: f64 = 4.0;
/// How much errors of L, M and S count in their basis, as there are cones; few S cones a little more.
const SHARES: [f64; ARRIVING] = [0.55, 0.3, 0.15];
/// Weight of the mean light against all other frequencies in the basis.
const MEAN_WEIGHT: f64 = 2.0;

/// Inputs of the kernels.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct KernelSpec {
    /// The eye.
    pub prescription: Prescription,
    /// Its pupil, focus and dispersion.
    pub state: EyeState,
    /// Distance of the screen from the corneal apex, mm.
    pub distance_mm: f64,
    /// Rectangle of the retina, µm: minimum and maximum.
    pub field_um: [DVec2; 2],
    /// Points of the field along each side, see `exposure/padua.rs`.
    pub field_nodes: u32,
    /// Range of visual eccentricity, degrees.
    pub ecc_deg: [f64; 2],
    /// Chebyshev nodes of the eccentricity.
    pub ecc_nodes: u32,
    /// Wavelength nodes, nm, increasing.
    pub nodes_nm: Vec<f64>,
    /// Spectra of the primaries (radiant power).
    pub primaries: Vec<Spectrum>,
    /// Factor on the density of the lens.
    pub lens_density_scale: f64,
    /// Factor on the density of the cornea.
    pub cornea_density_scale: f64,
    /// Peak density of the macula.
    pub macular_peak_density: f64,
    /// Whether reflections at the surfaces are computed instead of the cornea's flat density.
    pub reflection_losses: bool,
    /// Stiles-Crawford coefficient, base 10, 1/mm²; 0 is off.
    pub stiles_crawford_rho10_per_mm2: f64,
    /// Part of the cones' pigment that is not bleached.
    pub unbleached: f64,
    /// Relative error of the low-rank basis.
    pub tolerance: f64,
    /// Highest frequency kept, cycles per unit tangent.
    pub band: f64,
    /// The table that the wavefronts are taken from, an artifact of its own; without it each is traced.
    pub wavefronts: Option<Box<FieldTableSpec>>,
}

/// The kernels of one kind from its basis.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
struct KindBasis {
    /// `[place][r]`, place = field node * eccentricity nodes + eccentricity node.
    from_basis: Vec<Vec<f64>>,
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
struct Head {
    spec: KernelSpec,
    shape: PolarShape,
    /// By kind.
    kinds: Vec<KindBasis>,
    /// Kernels of the basis that the types of cones share, and of that for arriving photons.
    ranks: [usize; 2],
    basis_error: f64,
    /// Mean over the field nodes of the apodized share of the pupil's light.
    throughput: f64,
    /// `[wavelength]`, mean over the field nodes.
    paths: Vec<Paths>,
}

/// Which basis a kind's kernels are in.
fn basis_of(kind: usize) -> usize {
    usize::from(kind == ARRIVING)
}

/// Kernels of one kind, `[place][primary·sample]`.
type PlaceKernels = Vec<Vec<Complex64>>;

/// Transfer tables that are made before they are added up.
pub const BLOCK: usize = 32;

/// A kernel that is being added up: of one kind, field point and eccentricity.
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

/// Kernels, ready for use.
#[derive(Clone, Debug)]
pub struct Kernels {
    head: Head,
    field: FieldNodes,
    /// Nodes of the eccentricity, degrees.
    ecc_deg: Vec<f64>,
    /// By primary, of which the tables are.
    shares: Vec<Vec<Share>>,
    /// `[basis][r][primary][sample]`.
    tables: [Vec<Vec<Vec<Complex64>>>; 2],
}

/// Primaries that shine together: their numbers, each with its share of their photons.
pub type Group = Vec<(usize, f64)>;

impl KernelSpec {
    /// Shares of each primary's photons by wavelength.
    pub fn shares(&self) -> Vec<Vec<Share>> {
        photon_shares(&self.primaries)
    }

    /// The absorbers.
    ///
    /// # Errors
    /// When the embedded tables cannot be read.
    pub fn absorbers(&self) -> Result<Absorbers, String> {
        let mut media = Media::new(self.lens_density_scale, self.macular_peak_density)?
            .with_cornea_scale(self.cornea_density_scale);
        if self.reflection_losses {
            let eye = SchematicEye::new(&self.prescription, &self.state).map_err(|e| e.to_string())?;
            media = media.with_reflections(|nm| eye.indices(nm));
        }
        Ok(Absorbers { media, pigments: Pigments::new()?.with_unbleached(self.unbleached) })
    }

    /// The screen in front of the eye.
    ///
    /// # Errors
    /// When the eye is refused.
    pub fn projection(&self) -> Result<Projection, String> {
        let eye = SchematicEye::new(&self.prescription, &self.state).map_err(|e| e.to_string())?;
        Projection::new(&eye, self.distance_mm).map_err(|e| e.to_string())
    }

    fn ecc_values(&self) -> Vec<f64> {
        nodes::chebyshev(self.ecc_deg[0], self.ecc_deg[1], self.ecc_nodes as usize)
    }

    fn field(&self) -> FieldNodes {
        FieldNodes::new(self.field_um, self.field_nodes)
    }

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
        let jobs: Vec<(&FieldPoint, &Wavefront)> =
            points.iter().zip(&wavefronts).flat_map(|(p, waves)| waves.iter().map(move |w| (p, w))).collect();
        let shape = self.shape_for(&jobs)?;
        let factors: Vec<f64> = points
            .par_iter()
            .map(|point| densities(&field, point, &self.nodes_nm, rho))
            .collect::<Result<Vec<_>, String>>()?
            .concat();
        let media = self.absorbers()?.media;
        let paths: Vec<Paths> = jobs.iter().map(|(_, w)| Paths::new(w, &media)).collect();
        let (kernels, throughput) = self.kernels_by_place(&jobs, &factors, &paths, shape)?;
        let weights = basis_weights(shape, self.primaries.len());
        let (counted, arriving) = kernels.split_at(ARRIVING);
        let shared = compress_together(counted, &SHARES, &weights, self.tolerance);
        // Arriving photons enter the budget only, where places average out: a coarser basis will do.
        let arriving = compress(&arriving[0], &weights, ARRIVING_TOLERANCE * self.tolerance);
        let samples = shape.len();
        let split = |kernel: &Vec<Complex64>| kernel.chunks(samples).map(<[Complex64]>::to_vec).collect();
        let tables = [&shared.kernels, &arriving.kernels].map(|kernels| kernels.iter().map(split).collect());
        let ranks = [shared.kernels.len(), arriving.kernels.len()];
        let kinds = shared.coefficients.into_iter().chain([arriving.coefficients]);
        let kinds = kinds.map(|from_basis| KindBasis { from_basis }).collect();
        Ok(Kernels {
            head: Head {
                spec: self.clone(),
                shape,
                kinds,
                ranks,
                basis_error: shared.error,
                throughput,
                paths: self.mean_paths(&paths),
            },
            field: self.field(),
            ecc_deg: self.ecc_values(),
            shares: self.shares(),
            tables,
        })
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
            let [blur, shift] = extent(point, wavefront).map(|e| e * self.band * caught.powf(1.0 / 6.0));
            cycles = [cycles[0].max(blur), cycles[1].max(shift)];
        }
        Ok(PolarShape::for_cycles(self.band, cycles, TABLE_TOLERANCE * self.tolerance))
    }

    /// By kind, and the mean throughput. Transfer tables of `jobs` (`[field][wavelength]`) are made a few at a time
    /// and added up: all of them would be the most of the memory.
    fn kernels_by_place(
        &self,
        jobs: &[(&FieldPoint, &Wavefront)],
        factors: &[f64],
        paths: &[Paths],
        shape: PolarShape,
    ) -> Result<(Vec<PlaceKernels>, f64), String> {
        let absorbers = self.absorbers()?;
        let kinks_nm = self.prescription.kinks_nm(self.state.dispersion);
        let nodes = (self.nodes_nm.as_slice(), kinks_nm.as_slice());
        let shares = self.shares();
        let eccentricities = self.ecc_values();
        let waves = self.nodes_nm.len().max(1);
        let fields = jobs.len() / waves;
        let mut places: Vec<Place> = (0..KINDS.len())
            .flat_map(|kind| (0..fields).map(move |field| (kind, field)))
            .flat_map(|(kind, field)| eccentricities.iter().map(move |&ecc_deg| (kind, field, ecc_deg)))
            .collect::<Vec<_>>()
            .into_par_iter()
            .map(|(kind, field, ecc_deg)| {
                let along = &paths[field * waves..(field + 1) * waves];
                let weights = |primary: &Vec<Share>| {
                    absorbers.smooth_weights(primary, nodes, KINDS[kind], ecc_deg, along)
                };
                let kernel = vec![Complex64::ZERO; shares.len() * shape.len()];
                Place { field, weights: shares.iter().map(weights).collect(), kernel }
            })
            .collect();
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
        let per_kind = (fields * eccentricities.len()).max(1);
        let kernels: Vec<Vec<Complex64>> = places.into_iter().map(|place| place.kernel).collect();
        let mut kernels = kernels.into_iter();
        let by_kind = (0..KINDS.len()).map(|_| kernels.by_ref().take(per_kind).collect()).collect();
        Ok((by_kind, throughput / jobs.len().max(1) as f64))
    }
}

/// Weights of the samples in the basis: `dν/ν` times the aperture's transform squared, and the mean.
///
/// An error of the kernel at frequencies about ν spreads over an area of 1/ν². Its share of the light over the whole image (L1) is the
/// root of area times energy, `|e(ν)|·ν·(1/ν)`: every octave weighs the same; so it does in the mean picture, whose power falls with
/// 1/ν². With the area ν dν alone (L2) 11 images left an L1 of 2.3e-3 on one lit pixel; so weighted 12 leave 3.9e-4.
fn basis_weights(shape: PolarShape, primaries: usize) -> Vec<f64> {
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

impl Kernels {
    /// The inputs.
    pub fn spec(&self) -> &KernelSpec {
        &self.head.spec
    }

    /// Shares of each primary's photons by wavelength.
    pub fn shares(&self) -> &[Vec<Share>] {
        &self.shares
    }

    /// The kernels of primaries that shine together, one a group: those of a mixture of their light, whose photons have these `shares` by
    /// wavelength. What L, M and S see of it differs less than what they see of each: a smaller basis does, which leaves a relative error of
    /// `tolerance` more.
    #[must_use]
    pub fn together(&self, groups: &[Group], shares: Vec<Vec<Share>>, tolerance: f64) -> Self {
        let samples = self.head.shape.len();
        let weights = basis_weights(self.head.shape, groups.len());
        let mut made = Self { shares, ..self.clone() };
        for (basis, tables) in self.tables.iter().enumerate() {
            let mixed = |by_primary: &Vec<Vec<Complex64>>| -> Vec<Complex64> {
                let mut kernel = vec![Complex64::ZERO; groups.len() * samples];
                for (group, kernel) in groups.iter().zip(kernel.chunks_exact_mut(samples)) {
                    for &(primary, part) in group {
                        add(kernel, &by_primary[primary], part);
                    }
                }
                kernel
            };
            let old: Vec<Vec<Complex64>> = tables.par_iter().map(mixed).collect();
            let own = (0..KINDS.len()).filter(|kind| basis_of(*kind) == basis);
            let sets: Vec<&[Vec<f64>]> =
                own.clone().map(|kind| self.head.kinds[kind].from_basis.as_slice()).collect();
            let shares = if basis == 0 { &SHARES[..] } else { &[1.0] };
            let reduced = reduce(&old, &sets, shares, &weights, tolerance);
            for kind in own {
                let own = |c: &Vec<f64>| {
                    reduced.from_old.iter().map(|row| row.iter().zip(c).map(|(f, c)| f * c).sum()).collect()
                };
                made.head.kinds[kind].from_basis = self.head.kinds[kind].from_basis.iter().map(own).collect();
            }
            if basis == 0 {
                made.head.basis_error = self.head.basis_error.hypot(reduced.error);
            }
            made.head.ranks[basis] = reduced.kernels.len();
            let split = |kernel: &Vec<Complex64>| kernel.chunks(samples).map(<[Complex64]>::to_vec).collect();
            made.tables[basis] = reduced.kernels.iter().map(split).collect();
        }
        made
    }

    /// Shape of the tables.
    pub fn shape(&self) -> PolarShape {
        self.head.shape
    }

    /// Relative error of the low-rank basis.
    pub fn basis_error(&self) -> f64 {
        self.head.basis_error
    }

    /// Share of the pupil's light that cones aimed at its centre accept.
    pub fn throughput(&self) -> f64 {
        self.head.throughput
    }

    /// Path lengths in the media, mean over field and wavelengths.
    pub fn paths(&self) -> Paths {
        let count = self.head.paths.len().max(1) as f64;
        let mean = |of: fn(&Paths) -> f64| self.head.paths.iter().map(of).sum::<f64>() / count;
        Paths { cornea: mean(|p| p.cornea), lens: mean(|p| p.lens) }
    }

    /// Path lengths in the media at a wavelength (nm), mean over the field.
    pub fn paths_at(&self, nm: f64) -> Paths {
        paths_at(&self.head.spec.nodes_nm, &self.head.paths, nm)
    }

    /// Basis images of a kind; all types of cones share theirs.
    pub fn rank(&self, kind: usize) -> usize {
        self.tables[basis_of(kind)].len()
    }

    /// The table of a kind's basis kernel for a primary.
    pub fn table(&self, kind: usize, r: usize, primary: usize) -> &[Complex64] {
        &self.tables[basis_of(kind)][r][primary]
    }

    /// Coefficients `[r]` of a kind's basis at a place of the retina (µm) with a visual eccentricity (degrees).
    pub fn coefficients(&self, kind: usize, um: DVec2, ecc_deg: f64) -> Vec<f64> {
        self.coefficients_at(kind, &self.weights(um, ecc_deg))
    }

    /// Weights of the kernels' places at a place of the retina (µm) with a visual eccentricity (degrees), the same for every kind.
    pub fn weights(&self, um: DVec2, ecc_deg: f64) -> Vec<f64> {
        let at_e = nodes::lagrange(&self.ecc_deg, ecc_deg);
        self.field.weights(um).iter().flat_map(|wf| at_e.iter().map(move |we| wf * we)).collect()
    }

    /// Coefficients `[r]` of a kind's basis for [`Kernels::weights`].
    pub fn coefficients_at(&self, kind: usize, weights: &[f64]) -> Vec<f64> {
        let mut sum = vec![0.0; self.rank(kind)];
        for (weight, row) in weights.iter().zip(&self.head.kinds[kind].from_basis) {
            sum.iter_mut().zip(row).for_each(|(s, u)| *s += weight * u);
        }
        sum
    }

    /// As bytes.
    ///
    /// # Errors
    /// When the head cannot be written.
    pub fn to_bytes(&self) -> Result<Vec<u8>, String> {
        let samples = self.tables.iter().flatten().flatten().flatten();
        codec::encode(MAGIC, &self.head, samples.flat_map(|z| [z.re, z.im]))
    }

    /// From bytes.
    ///
    /// # Errors
    /// When the bytes are damaged.
    pub fn from_bytes(bytes: &[u8]) -> Result<Self, String> {
        let (head, numbers): (Head, Vec<f64>) = codec::decode(MAGIC, bytes)?;
        let primaries = head.spec.primaries.len();
        let samples = head.shape.len();
        let expected = head.ranks.iter().sum::<usize>().checked_mul(2 * primaries * samples);
        let fits = |(kind, own): (usize, &KindBasis)| {
            own.from_basis.iter().all(|row| row.len() == head.ranks[basis_of(kind)])
        };
        if head.paths.len() != head.spec.nodes_nm.len() {
            return Err("its paths do not fit its wavelengths".into());
        }
        let fits = head.kinds.len() == KINDS.len() && head.kinds.iter().enumerate().all(fits);
        if !fits || expected != Some(numbers.len()) || samples == 0 {
            return Err("its size does not fit its head".into());
        }
        let values: Vec<Complex64> = numbers.chunks_exact(2).map(|z| Complex64::new(z[0], z[1])).collect();
        let mut parts = values.chunks_exact(samples);
        let mut next = || parts.next().map(<[Complex64]>::to_vec).unwrap_or_default();
        let tables =
            head.ranks.map(|rank| (0..rank).map(|_| (0..primaries).map(|_| next()).collect()).collect());
        let (field, ecc_deg, shares) = (head.spec.field(), head.spec.ecc_values(), head.spec.shares());
        Ok(Self { head, field, ecc_deg, shares, tables })
    }
}
