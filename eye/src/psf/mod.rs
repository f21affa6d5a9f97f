//! Point spread and optical transfer of the eye (§21).
//!
//! [`Wavefront`] = path difference and amplitude over the pupil, as polynomials; [`matrix::psf`] the point spread as a
//! matrix product; [`Otf`] the transfer function as an autocorrelation; [`huygens::psf`] the slow sum over traced rays
//! that both are held against. [`sampled`] and [`sampled_fft`] are other ways to the same numbers, for comparison.
//!
//! With q the direction cosines from the landing point towards the pupil, λ' the wavelength in the vitreous and
//! k' = 2π/λ': field(ξ) = ∫ A(q) exp(i k' (W(q) − q·ξ)) dq, PSF = |field|², OTF(ν) = ∫ PSF(ξ) exp(−2πi ν·ξ) dξ.
//! ξ is counted from the landing point of the chief ray of the same wavelength, µm along the retina's tangents.

pub mod chords;
pub mod field_table;
pub mod gridding;
pub mod huygens;
pub mod least_squares;
pub mod matrix;
pub mod otf;
pub mod outline;
pub mod polynomial;
pub mod quadrature;
pub mod sampled;
pub mod sampled_fft;
pub mod sincos;
pub mod table;
pub mod transfer_map;
pub mod wavefront;

pub use field_table::{FieldTable, FieldTableSpec};
pub use huygens::HuygensOptions;
pub use matrix::{GridAxes, PsfGrid, psf};
pub use otf::Otf;
pub use sampled::PupilSampling;
pub use table::{WavefrontTable, WavelengthNodes};
pub use transfer_map::TransferMap;
pub use wavefront::{Amplitude, StilesCrawfordApodization, Wavefront, WavefrontOptions};
