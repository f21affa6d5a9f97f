//! The model of display, eye, retina and counting: pure, no I/O, no clock, no async, no global state.

pub mod catalog;
pub mod digest;
pub mod optics;
pub mod psf;
pub mod retina;
pub mod rng;
