//! Name and version of this program.

/// As written into output files.
pub(crate) const SOFTWARE: &str = concat!("paws-calib ", env!("CARGO_PKG_VERSION"));
