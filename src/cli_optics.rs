//! What can be typed after `retina`, `psf` and `trace`, the commands that ask the model alone.

use std::path::PathBuf;

use clap::{Args, ValueEnum};
use photoneye_eye::optics::{Dispersion, Side};

/// `retina`.
#[derive(Debug, Args)]
pub struct RetinaArgs {
    /// Outer edge, visual degrees from the gaze centre
    #[arg(long, value_name = "DEGREES")]
    pub to_deg: f64,
    /// Inner edge, visual degrees
    #[arg(long, value_name = "DEGREES", default_value_t = 0.0)]
    pub from_deg: f64,
    /// Seed of places, types and pointing
    #[arg(long, default_value_t = 1)]
    pub seed: u64,
    /// How the mosaic grows
    #[arg(long, value_enum, default_value_t = GeneratorName::Domain)]
    pub generator: GeneratorName,
    /// Change a field: retina.aperture=INNER_SEGMENT, retina.peak_density_per_mm2=150000, eye.side=LEFT
    #[arg(long = "set", value_name = "PATH=VALUE")]
    pub set: Vec<String>,
    /// Threads [default: as many as there are cores]
    #[arg(long, env = "PHOTONEYE_THREADS", value_name = "N")]
    pub threads: Option<usize>,
    /// Cone table, an Arrow file
    #[arg(long, value_name = "FILE.arrow")]
    pub out: PathBuf,
    /// A measured mosaic instead of a grown one: CSV with x_um, y_um (µm of arc from the foveal centre) and type (L, M, S)
    #[arg(long, value_name = "FILE.csv")]
    pub import: Option<PathBuf>,
    /// Statistics as JSON
    #[arg(long, value_name = "FILE.json")]
    pub statistics: Option<PathBuf>,
    /// Pictures into this folder: statistics.png, patches.png, fovea.png, strip.png
    #[arg(long, value_name = "DIR")]
    pub png: Option<PathBuf>,
    /// Neighbour graph: CSV with a row for every pair of cones that share a wall (row numbers of the cone table)
    #[arg(long, value_name = "FILE.csv")]
    pub neighbours: Option<PathBuf>,
    /// Receptive fields of all cones: CSV with field, cone, generation, role (row numbers of the cone table)
    #[arg(long, value_name = "FILE.csv")]
    pub fields: Option<PathBuf>,
    /// Generations of neighbours in the centre of a receptive field; 0 is the cone alone
    #[arg(long, default_value_t = 0, value_parser = clap::value_parser!(u8).range(0..=8))]
    pub centre_generations: u8,
    /// Generations of neighbours in its surround
    #[arg(long, default_value_t = 1, value_parser = clap::value_parser!(u8).range(1..=8))]
    pub surround_generations: u8,
}

/// How a mosaic grows.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum GeneratorName {
    /// Patches of hexagonal lattice, relaxed.
    Domain,
    /// The paper's growth in rings.
    Ring,
}

/// Law of the refractive indices.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum DispersionName {
    /// Straight lines between the published wavelengths (the paper's choice).
    Polyline,
    /// Herzberger's interpolation.
    Herzberger,
    /// One parabola for all media.
    Quadratic,
}

impl From<DispersionName> for Dispersion {
    fn from(name: DispersionName) -> Self {
        match name {
            DispersionName::Polyline => Self::Polyline,
            DispersionName::Herzberger => Self::Herzberger,
            DispersionName::Quadratic => Self::Quadratic,
        }
    }
}

/// Which of the two eyes.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum SideName {
    /// The right eye.
    Right,
    /// The left eye.
    Left,
}

impl From<SideName> for Side {
    fn from(name: SideName) -> Self {
        match name {
            SideName::Right => Self::Right,
            SideName::Left => Self::Left,
        }
    }
}

/// Which eye.
#[derive(Debug, Args)]
pub struct EyeArgs {
    /// An eye that `photoneye eyes` lists, or a file of the same form (FILE.json)
    #[arg(long, value_name = "NAME", default_value = "escudero-sanz-navarro")]
    pub eye: String,
    /// Right or left
    #[arg(long, value_enum, ignore_case = true, default_value_t = SideName::Right)]
    pub side: SideName,
    /// Decentre of the stop, mm [default: the eye's, 0.4]
    #[arg(long, allow_hyphen_values = true)]
    pub decentre_mm: Option<f64>,
    /// Law of the refractive indices [default: herzberger where the eye has it]
    #[arg(long, value_enum)]
    pub dispersion: Option<DispersionName>,
}

/// `psf`.
#[derive(Debug, Args)]
pub struct PsfArgs {
    /// The eye
    #[command(flatten)]
    pub eye: EyeArgs,
    /// Angle of the light to the optical axis in the fovea's meridian [default: that of the fovea, 5]
    #[arg(long, allow_hyphen_values = true)]
    pub field_deg: Option<f64>,
    /// Vacuum wavelength
    #[arg(long, default_value_t = 543.0)]
    pub wavelength_nm: f64,
    /// Entrance pupil diameter; the physical stop is this over 1.1334061 (in the default eye) at every wavelength
    #[arg(long, default_value_t = 3.0)]
    pub pupil_mm: f64,
    /// Vergence of the object, dioptres, positive in front of the eye: 2 is 500 mm away
    #[arg(long, default_value_t = 0.0, allow_hyphen_values = true)]
    pub object_vergence_d: f64,
    /// Accommodation parameter A; 0 is the unaccommodated eye
    #[arg(long, default_value_t = 0.0, allow_hyphen_values = true)]
    pub accommodation_a: f64,
    /// What the amplitude over the pupil follows: the flux of the rays, or evenly over the stop
    #[arg(long, value_enum, default_value_t = AmplitudeName::Flux)]
    pub amplitude: AmplitudeName,
    /// Samples along a side
    #[arg(long, default_value_t = 128, value_parser = clap::value_parser!(u32).range(1..=4096))]
    pub samples: u32,
    /// Half of the side; samples lie at (i + 0.5 - N/2)·2·half-width/N about the chief ray of the same wavelength
    #[arg(long, default_value_t = 10.0)]
    pub half_width_um: f64,
    /// How it is computed
    #[arg(long, value_enum, default_value_t = MethodName::Fit)]
    pub method: MethodName,
    /// Rays of the sampled methods (fft: samples of the pupil); the paper has 1024
    #[arg(long, default_value_t = 1024, value_parser = clap::value_parser!(u32).range(4..=1_000_000))]
    pub rays: u32,
    /// Seed of random rays
    #[arg(long, default_value_t = 1)]
    pub seed: u64,
    /// Take the nearest wavelength on this grid from 390 nm, as the paper does with 10
    #[arg(long, value_name = "NM")]
    pub wavelength_step_nm: Option<f64>,
    /// Take the point spread of the nearest place on this grid from the fovea, as the paper does with 300 (287 µm a degree)
    #[arg(long, value_name = "UM")]
    pub node_um: Option<f64>,
    /// Scale so that the window holds all the light, as the paper does
    #[arg(long)]
    pub whole_window: bool,
    /// Compute so many times and print seconds per point spread
    #[arg(long, default_value_t = 1, value_parser = clap::value_parser!(u32).range(1..=1_000_000))]
    pub repeat: u32,
    /// Square array of f64, first index along the retina's tangent away from the optical axis
    #[arg(long, value_name = "FILE.npy")]
    pub out: PathBuf,
}

/// Amplitude over the pupil.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum AmplitudeName {
    /// Root of the ray map's Jacobian.
    Flux,
    /// The area of the stop weighs evenly.
    Uniform,
}

/// How a point spread is computed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum MethodName {
    /// Huygens' sum with exact distances over as many Gauss rays as it takes, slow.
    Huygens,
    /// Polynomial wavefront, matrix product.
    Fit,
    /// Rays at independent random places of the pupil.
    Random,
    /// One ray anywhere in each of so many cells of the pupil.
    Stratified,
    /// Rays on a square lattice of the pupil.
    Grid,
    /// Rays at Gauss nodes of the pupil.
    Gauss,
    /// Fourier transform of the pupil function of the polynomial wavefront.
    Fft,
}

/// `trace`. The dispersion law asked for holds where the file does not say.
#[derive(Debug, Args)]
pub struct TraceArgs {
    /// The eye
    #[command(flatten)]
    pub eye: EyeArgs,
    /// Rays: columns px, py, pz (mm), sx, sy, sz, wavelength_nm and, if wanted, dispersion
    #[arg(long, value_name = "FILE.csv")]
    pub rays: PathBuf,
    /// Entrance pupil diameter that decides the fate
    #[arg(long, default_value_t = 3.0)]
    pub pupil_mm: f64,
    /// Hits, optical path and fate, a row a ray in the order of the rays
    #[arg(long, value_name = "FILE.csv")]
    pub out: PathBuf,
}
