//! reconstruction
fn main() {}
