//! The model of display, eye, retina and counting: pure, no I/O, no clock, no async, no global state.

pub mod artifact;
pub mod catalog;
pub mod cone;
pub mod digest;
pub mod display;
pub mod experiment;
pub mod exposure;
pub mod math;
pub mod media;
pub mod movement;
pub mod optics;
pub mod photometry;
pub mod picture;
pub mod plan;
pub mod psf;
pub mod report;
pub mod retina;
pub mod rng;
mod seeds;
pub mod spectrum;
pub mod video;
