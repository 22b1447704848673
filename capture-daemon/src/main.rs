//! capture-daemon
fn main() {}
