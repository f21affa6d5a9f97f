//! The command line of photoneye.
fn main() {}
