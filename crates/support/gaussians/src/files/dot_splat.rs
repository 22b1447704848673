//! The `.splat` file of web viewers: 32 bytes per Gaussian, no header, one color from all sides.
//!
//! Three f32 position, three f32 scale (not its logarithm), red, green, blue and opacity in 8 bits,
//! rotation `w x y z` in 8 bits, `value / 255 * 2 - 1`. Written are the largest times most opaque
//! Gaussians first, so that viewers can show a file while it loads.
//!
//! ```
//! use gaussians::files::dot_splat;
//! use gaussians::{Splat, Splats};
//!
//! let mut splats = Splats::empty(0)?;
//! splats.push(&Splat::sphere(0.1, [1.0, 0.5, 0.2]))?;
//! let bytes = dot_splat::write(&splats);
//! assert_eq!(bytes.len(), 32);
//! let back = dot_splat::read(&bytes, 1000)?.splats.get(0);
//! assert!((back.log_scale[0] - 0.1_f32.ln()).abs() < 1e-6);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

use super::{FileError, SplatFile, byte, logit, opacity_byte, unit};
use crate::harmonics::{from_color, to_color};
use crate::splats::{Splat, Splats};

const ROW: usize = 32;

/// Smallest scale that is read, m: files hold zeros.
const MIN_SCALE_M: f32 = 1e-9;

/// Writes Gaussians; harmonics above degree 0 are lost.
pub fn write(splats: &Splats) -> Vec<u8> {
    let weight = |i: usize| {
        let splat = splats.get(i);
        let volume = libm::expf(splat.log_scale.iter().sum());
        volume / (1.0 + libm::expf(-splat.opacity_logit))
    };
    let mut order: Vec<(f32, usize)> = (0..splats.len()).map(|i| (weight(i), i)).collect();
    order.sort_by(|a, b| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1)));
    let mut bytes = Vec::with_capacity(splats.len() * ROW);
    for (_, i) in order {
        let splat = splats.get(i);
        let floats = splat
            .position_m
            .into_iter()
            // Readers, ours among them, refuse an infinite scale.
            .chain(splat.log_scale.map(|v| libm::expf(v).min(f32::MAX)));
        bytes.extend(floats.flat_map(f32::to_le_bytes));
        bytes.extend(splat.harmonics[0].map(|f| byte(255.0 * to_color(f))));
        bytes.push(opacity_byte(splat.opacity_logit));
        bytes.extend(unit(splat.rotation_wxyz).map(|v| byte((v + 1.0) * 127.5)));
    }
    bytes
}

/// Reads at most `max` Gaussians.
///
/// # Errors
/// [`FileError::Length`] if the file does not consist of rows of 32 bytes, [`FileError::TooMany`],
/// [`FileError::Splats`] if a value is not finite or a scale negative.
pub fn read(bytes: &[u8], max: usize) -> Result<SplatFile, FileError> {
    let (rows, rest) = bytes.as_chunks::<ROW>();
    if !rest.is_empty() {
        return Err(FileError::Length {
            what: "rows of 32 bytes",
            found: bytes.len() as u64,
            expected: (rows.len() as u64 + 1) * ROW as u64,
        });
    }
    if rows.len() > max {
        let found = rows.len() as u64;
        return Err(FileError::TooMany { found, max });
    }
    let mut splats = Splats::empty(0)?;
    for row in rows {
        let (floats, _) = row.as_chunks::<4>();
        let float = |k: usize| f32::from_le_bytes(floats[k]);
        let scale = |k: usize| match float(3 + k) {
            // A negative scale has no logarithm and is refused as not finite.
            scale if scale >= 0.0 => libm::logf(scale.max(MIN_SCALE_M)),
            _ => f32::NAN,
        };
        let mut splat = Splat::sphere(1.0, [0.5; 3]);
        splat.position_m = std::array::from_fn(float);
        splat.log_scale = std::array::from_fn(scale);
        splat.harmonics[0] = std::array::from_fn(|c| from_color(f32::from(row[24 + c]) / 255.0));
        splat.opacity_logit = logit(row[27]);
        splat.rotation_wxyz = std::array::from_fn(|k| f32::from(row[28 + k]) / 127.5 - 1.0);
        splats.push(&splat)?;
    }
    Ok(SplatFile {
        splats,
        compensated: false,
    })
}
