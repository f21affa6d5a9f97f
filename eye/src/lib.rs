//! The model of eye, display, retina and counting; pure: no I/O, no clock, no async, no global state.
