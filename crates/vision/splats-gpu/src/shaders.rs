//! Sources that several kernels share.

pub(crate) const COMMON: &str = include_str!("shaders/common.wgsl");
pub(crate) const LENS: &str = include_str!("shaders/lens.wgsl");
pub(crate) const GEOMETRY: &str = include_str!("shaders/geometry.wgsl");
pub(crate) const SLOPE: &str = include_str!("shaders/slope.wgsl");
pub(crate) const HARMONICS: &str = include_str!("shaders/harmonics.wgsl");
pub(crate) const SKY: &str = include_str!("shaders/sky.wgsl");

/// Threads of a group, where it is a row.
pub(crate) const THREADS: usize = 64;
