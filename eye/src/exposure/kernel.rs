//! Optical kernels of a scene: what the eye and the cones' filters do to a display's primaries, as Fourier transforms.
//!
//! For primary k, kind T (isomerized in L, M, S; arriving) and a place on the retina (field point f, eccentricity e):
//! `K(ν) = Σ_m w_{kTe,m} OTF_f(λ_m, J⁻ᵀν) exp(-2πi J⁻ᵀν·δ_f(λ_m))`, ν in cycles per unit tangent of the screen, J the
//! magnification (µm per unit tangent) at f, δ the landing point of the chief ray at λ_m from that at 543 nm (transverse chromatic
//! shift); w holds the light that enters the pupil from there. From the kernels of sources follows what a cone at each place collects
//! ([`super::around`]). Between places that is interpolated by Lagrange polynomials over Padua points of the field ([`super::padua`]) and Chebyshev nodes of eccentricity; a low-rank basis then spans all places and
//! types of cones ([`super::lowrank`]), so that a cone's mean is a short sum of basis images.
//!
//! Absolute: K(0) is the share of photons through the entrance pupil that is counted; nothing is renormalized.

use glam::{DMat2, DVec2};
use rayon::prelude::*;
use rustfft::num_complex::Complex64;
use serde::{Deserialize, Serialize};

use super::codec;
use super::kernel_build::{basis_weights, displacement};
use super::lowrank::{Span, add};
use super::nodes::PiecewiseNodes;
use super::padua::FieldNodes;
use super::polar::PolarShape;
use super::spectral::{ARRIVING, Absorbers, KINDS, Paths, Share, paths_at};
use crate::cone::pigment::{DENSITY_EDGES_DEG, Pigments};
use crate::display::{EmissionLaw, photon_shares};
use crate::media::{MACULA_EDGE_DEG, Media};
use crate::optics::{EyeState, Prescription, Projection, SchematicEye, Screen};
use crate::psf::FieldTableSpec;
use crate::spectrum::Spectrum;

/// Least half of the side of the rectangle of the field's points, µm.
const LEAST_HALF_UM: f64 = 60.0;

const MAGIC: [u8; 8] = *b"PEkernl5";
/// Diameter of the smallest cones, µm: frequencies that such an aperture averages away weigh less in the basis.
pub(super) const APERTURE_UM: f64 = 2.0;
/// µm of retina per unit tangent near the fovea, for that weight only.
pub(super) const UM_PER_TANGENT: f64 = 16_440.0;
/// Tolerance of the basis for arriving photons over that for counts.
pub(super) const ARRIVING_TOLERANCE: f64 = 10.0;
/// Interpolation error of the tables over that of the basis: the means feel it less.
pub const TABLE_TOLERANCE: f64 = 4.0;
/// How much errors of L, M and S count in their basis, as there are cones; few S cones a little more.
pub(super) const SHARES: [f64; ARRIVING] = [0.55, 0.3, 0.15];
/// Weight of the mean light against all other frequencies in the basis.
pub(super) const MEAN_WEIGHT: f64 = 2.0;

/// Inputs of the kernels.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct KernelSpec {
    /// The eye.
    pub prescription: Prescription,
    /// Its pupil, focus and dispersion.
    pub state: EyeState,
    /// The screen before the eye.
    pub screen: Screen,
    /// How the screen's light falls with the angle.
    pub emission_law: EmissionLaw,
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
pub(super) struct KindBasis {
    /// `[place][r]`, place = field node * eccentricity nodes + eccentricity node.
    pub(super) from_basis: Vec<Vec<f64>>,
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(super) struct Head {
    pub(super) spec: KernelSpec,
    pub(super) shape: PolarShape,
    /// By kind.
    pub(super) kinds: Vec<KindBasis>,
    /// Kernels of the basis that the types of cones share, and of that for arriving photons.
    pub(super) ranks: [usize; 2],
    pub(super) basis_error: f64,
    /// Mean over the field nodes of the apodized share of the pupil's light.
    pub(super) throughput: f64,
    /// `[field node]`: where images stand, from the chief ray at the reference wavelength, µm.
    pub(super) anchors: Vec<DVec2>,
    /// `[wavelength]`, mean over the field nodes.
    pub(super) paths: Vec<Paths>,
}

/// Which basis a kind's kernels are in.
fn basis_of(kind: usize) -> usize {
    usize::from(kind == ARRIVING)
}

/// Tables of a basis, `[r][primary][sample]`.
pub(super) type Tables = Vec<Vec<Vec<Complex64>>>;

/// Kernels of one spectral mode, `[field point][primary·sample]`.
pub(super) type PlaceKernels = Vec<Vec<Complex64>>;

/// Kernels, ready for use.
#[derive(Clone, Debug)]
pub struct Kernels {
    pub(super) head: Head,
    pub(super) field: FieldNodes,
    /// Nodes of the eccentricity, degrees.
    pub(super) ecc: PiecewiseNodes,
    /// By primary, of which the tables are.
    pub(super) shares: Vec<Vec<Share>>,
    /// `[basis][r][primary][sample]`.
    pub(super) tables: [Tables; 2],
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
        Projection::of(&eye, self.screen).map_err(|e| e.to_string())
    }

    /// The eccentricities at which kernels are known: pigments change their law at some.
    pub(super) fn ecc(&self) -> PiecewiseNodes {
        let kinks: Vec<f64> = DENSITY_EDGES_DEG.into_iter().chain([MACULA_EDGE_DEG]).collect();
        PiecewiseNodes::new(self.ecc_deg[0], self.ecc_deg[1], &kinks, self.ecc_nodes as usize)
    }

    pub(super) fn ecc_values(&self) -> Vec<f64> {
        self.ecc().values()
    }

    /// The points of the field: over the cones, and at least so far about their middle that changes can be told.
    pub(super) fn field(&self) -> FieldNodes {
        let [min, max] = self.field_um;
        let (middle, half) = (0.5 * (min + max), (0.5 * (max - min)).max(DVec2::splat(LEAST_HALF_UM)));
        FieldNodes::new([middle - half, middle + half], self.field_nodes)
    }
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
            let reduced = Span::new(&old, &weights).reduce(&sets, shares, tolerance);
            for kind in own {
                let own = |c: &Vec<f64>| reduced.coefficients(c);
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

    /// The place (µm) whose image, where its light is, lies at a place of the retina; and how it changes with that.
    pub fn source_um(&self, um: DVec2) -> (DVec2, DMat2) {
        let mut source = um;
        let mut slope = DMat2::ZERO;
        // The displacement changes by some per cent of the distance: three steps are exact to 1e-5 of it.
        for _ in 0..3 {
            let (displaced, changes) = displacement(&self.field, &self.head.anchors, source);
            (source, slope) = (um - displaced, changes);
        }
        (source, (DMat2::IDENTITY + slope).inverse())
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
        let at_e = self.ecc.weights(ecc_deg);
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
        if head.anchors.len() != head.spec.field().points().len() {
            return Err("its displacements do not fit its field".into());
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
        let (field, ecc, shares) = (head.spec.field(), head.spec.ecc(), head.spec.shares());
        Ok(Self { head, field, ecc, shares, tables })
    }
}
