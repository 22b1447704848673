//! Tests on real kernel drivers: virtual machines with cameras, an IMU, a button and faulty disks.

pub mod account;
pub mod case;
pub mod cases;
pub mod device_mapper;
pub mod exam;
pub mod guest;
pub mod image;
pub mod kernel;
pub mod leftovers;
pub mod machine;
pub mod marks;
pub mod random;
pub mod stock;
pub mod write_log;

use std::path::PathBuf;

use anyhow::{Context as _, Result};

/// The user's cache folder.
fn cache_home() -> Result<PathBuf> {
    let named =
        |name| std::env::var_os(name).filter(|value: &std::ffi::OsString| !value.is_empty());
    named("XDG_CACHE_HOME")
        .map(PathBuf::from)
        .or_else(|| Some(PathBuf::from(named("HOME")?).join(".cache")))
        .context("looking for the user's cache folder: neither XDG_CACHE_HOME nor HOME is set")
}
