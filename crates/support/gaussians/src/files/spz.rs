//! The compressed `.spz` file (Niantic), versions 2 to 4 read, version 4 written.
//!
//! Columns of fixed-point numbers: position 24 bits with a number of fractional bits, opacity 8
//! bits, color `0.15 f + 0.5`, scale `(logarithm + 10) * 16`, rotation as the three smallest
//! components (9 bits and sign each; in version 2 as x, y and z in 8 bits), harmonics `128 f +
//! 128`. Up to version 3 one gzip stream behind a header of 16 bytes, in version 4 a zstd stream
//! per column. Its axes are x right, y up, z backward: rotate a world with z up by
//! [`rub_from_z_up`] before writing.
//!
//! ```
//! use gaussians::files::spz;
//! use gaussians::{Splat, Splats};
//!
//! let mut splats = Splats::empty(1)?;
//! splats.push(&Splat { position_m: [1.0, 2.0, 3.0], ..Splat::sphere(0.1, [1.0, 0.5, 0.2]) })?;
//! let bytes = spz::write(&splats.transformed(&spz::rub_from_z_up()), false)?;
//! let back = spz::read(&bytes, 1000)?.splats.transformed(&spz::rub_from_z_up().inverse());
//! assert!((back.get(0).position_m[1] - 2.0).abs() < 0.001);
//! assert!((back.get(0).log_scale[0] - 0.1_f32.ln()).abs() < 0.04);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

use std::io::Read;

use cad_transforms::RigidTransform;

use super::{FileError, SplatFile, byte, header, logit, opacity_byte, unit};
use crate::splats::{MAX_DEGREE, Splat, Splats, coefficients};

const MAGIC: u32 = 0x5053_474e;
const HEADER: usize = 32;
const OLD_HEADER: usize = 16;
/// Fractional bits of positions that are written: 0.24 mm, up to 2048 m.
const FRACTION_BITS: u8 = 12;
const COLOR_SCALE: f32 = 0.15;
const COMPENSATED: u8 = 1;
/// Names of the columns, in order.
const COLUMNS: [&str; 6] = [
    "positions",
    "opacities",
    "colors",
    "scales",
    "rotations",
    "harmonics",
];
const LEVEL: i32 = 12;

/// The axes of this format from a world with x forward or right, y left or forward, z up: a
/// rotation by -90° about x.
pub fn rub_from_z_up() -> RigidTransform {
    let rows = [1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, -1.0, 0.0];
    RigidTransform::from_rotation_rows(rows, [0.0; 3]).expect("the rows of a rotation")
}

/// Writes Gaussians. Positions are rounded to 0.24 mm, scales to 6 % and to 0.05 mm to 380 m,
/// harmonics above degree 0 are cut at -1 and 1.
///
/// # Errors
/// [`FileError::Header`] if a position is beyond 2048 m.
pub fn write(splats: &Splats, compensated: bool) -> Result<Vec<u8>, FileError> {
    let mut columns: [Vec<u8>; 6] = Default::default();
    for i in 0..splats.len() {
        let splat = splats.get(i);
        for x in splat.position_m {
            let fixed = libm::roundf(x * f32::from(1_u16 << FRACTION_BITS));
            if fixed.abs() >= (1 << 23) as f32 {
                return Err(header(format!(
                    "a position of {x} m, expected below 2048 m"
                )));
            }
            columns[0].extend(&(fixed as i32).to_le_bytes()[..3]);
        }
        columns[1].push(opacity_byte(splat.opacity_logit));
        columns[2].extend(splat.harmonics[0].map(|f| byte((COLOR_SCALE * f + 0.5) * 255.0)));
        columns[3].extend(splat.log_scale.map(|s| byte((s + 10.0) * 16.0)));
        columns[4].extend(smallest_three(splat.rotation_wxyz).to_le_bytes());
        for k in 1..coefficients(splats.degree()) {
            let bits = if k < 4 { 5 } else { 4 };
            columns[5].extend(splat.harmonics[k].map(|f| harmonic_byte(f, bits)));
        }
    }
    let mut bytes = Vec::new();
    bytes.extend(MAGIC.to_le_bytes());
    bytes.extend(4_u32.to_le_bytes());
    bytes.extend((splats.len() as u32).to_le_bytes());
    let flags = if compensated { COMPENSATED } else { 0 };
    bytes.extend([
        splats.degree() as u8,
        FRACTION_BITS,
        flags,
        COLUMNS.len() as u8,
    ]);
    bytes.extend((HEADER as u32).to_le_bytes());
    bytes.resize(HEADER, 0);
    let mut streams = Vec::new();
    for column in &columns {
        let packed =
            zstd::bulk::compress(column, LEVEL).map_err(|error| FileError::Compression {
                what: "a column",
                reason: error.to_string(),
            })?;
        bytes.extend((packed.len() as u64).to_le_bytes());
        bytes.extend((column.len() as u64).to_le_bytes());
        streams.extend(packed);
    }
    bytes.extend(streams);
    Ok(bytes)
}

/// Reads at most `max` Gaussians.
///
/// # Errors
/// [`FileError::Header`], [`FileError::Length`], [`FileError::TooMany`],
/// [`FileError::Compression`].
pub fn read(bytes: &[u8], max: usize) -> Result<SplatFile, FileError> {
    match bytes {
        [0x1f, 0x8b, ..] => read_old(bytes, max),
        _ => read_columns(bytes, max),
    }
}

/// What a header says.
struct Header {
    version: u32,
    count: usize,
    degree: usize,
    fraction_bits: u8,
    flags: u8,
}

impl Header {
    fn parse(bytes: &[u8], length: usize, max: usize) -> Result<Self, FileError> {
        if bytes.len() < length {
            return Err(FileError::Length {
                what: "header",
                found: bytes.len() as u64,
                expected: length as u64,
            });
        }
        let (words, _) = bytes.as_chunks::<4>();
        let [magic, version, count] = [0, 1, 2].map(|k| u32::from_le_bytes(words[k]));
        let [degree, fraction_bits, flags, _] = words[3];
        if magic != MAGIC {
            return Err(header(format!(
                "starts with {magic:#010x}, expected {MAGIC:#010x}"
            )));
        }
        if usize::from(degree) > MAX_DEGREE {
            return Err(header(format!(
                "harmonics of degree {degree}, expected 0 to {MAX_DEGREE}"
            )));
        }
        if fraction_bits > 23 {
            return Err(header(format!(
                "{fraction_bits} fractional bits, expected 0 to 23"
            )));
        }
        if count as usize > max {
            let found = u64::from(count);
            return Err(FileError::TooMany { found, max });
        }
        Ok(Self {
            version,
            count: count as usize,
            degree: usize::from(degree),
            fraction_bits,
            flags,
        })
    }

    /// Bytes of each column.
    fn lengths(&self) -> [usize; 6] {
        let rotation = if self.version < 3 { 3 } else { 4 };
        let harmonics = 3 * (coefficients(self.degree) - 1);
        [9, 1, 3, 3, rotation, harmonics].map(|of_one| of_one * self.count)
    }
}

fn read_columns(bytes: &[u8], max: usize) -> Result<SplatFile, FileError> {
    let head = Header::parse(bytes, HEADER, max)?;
    if head.version != 4 {
        return Err(header(format!(
            "version {} without gzip, expected 4",
            head.version
        )));
    }
    let start = u32::from_le_bytes([bytes[16], bytes[17], bytes[18], bytes[19]]) as usize;
    let streams = usize::from(bytes[15]);
    if streams != COLUMNS.len() {
        return Err(header(format!(
            "{streams} streams, expected {}",
            COLUMNS.len()
        )));
    }
    let table = bytes.get(start..).unwrap_or_default();
    let short = |what, found: usize, expected: u64| FileError::Length {
        what,
        found: found as u64,
        expected,
    };
    let Some((entries, mut rest)) = table.split_at_checked(16 * COLUMNS.len()) else {
        return Err(short("table of streams", table.len(), 96));
    };
    let (entries, _) = entries.as_chunks::<8>();
    let mut columns: [Vec<u8>; 6] = Default::default();
    for (k, expected) in head.lengths().into_iter().enumerate() {
        let what = COLUMNS[k];
        let packed = u64::from_le_bytes(entries[2 * k]);
        let plain = u64::from_le_bytes(entries[2 * k + 1]);
        if plain != expected as u64 {
            return Err(short(
                what,
                usize::try_from(plain).unwrap_or(usize::MAX),
                expected as u64,
            ));
        }
        let length = usize::try_from(packed).unwrap_or(usize::MAX);
        let Some((stream, later)) = rest.split_at_checked(length) else {
            return Err(short(what, rest.len(), packed));
        };
        rest = later;
        let broken = |error: std::io::Error| FileError::Compression {
            what,
            reason: error.to_string(),
        };
        // An empty column may have no stream at all.
        if expected > 0 {
            let decoder = zstd::stream::read::Decoder::new(stream).map_err(broken)?;
            columns[k] = whole(decoder, expected, what)?;
        }
    }
    decode(&head, &columns)
}

fn read_old(bytes: &[u8], max: usize) -> Result<SplatFile, FileError> {
    let mut decoder = flate2::read::GzDecoder::new(bytes);
    let head = exactly(&mut decoder, OLD_HEADER, "header")?;
    let head = Header::parse(&head, OLD_HEADER, max)?;
    if !(2..=3).contains(&head.version) {
        return Err(header(format!(
            "version {} with gzip, expected 2 or 3",
            head.version
        )));
    }
    let lengths = head.lengths();
    let mut plain: &[u8] = &whole(decoder, lengths.iter().sum(), "columns")?;
    let mut columns: [Vec<u8>; 6] = Default::default();
    for (column, length) in columns.iter_mut().zip(lengths) {
        let (now, later) = plain.split_at(length);
        *column = now.to_vec();
        plain = later;
    }
    decode(&head, &columns)
}

/// Reads this number of bytes, after which the stream has to end with its checksum.
fn whole(mut from: impl Read, length: usize, what: &'static str) -> Result<Vec<u8>, FileError> {
    let bytes = exactly(&mut from, length, what)?;
    let broken = |error: std::io::Error| FileError::Compression {
        what,
        reason: error.to_string(),
    };
    match from.read(&mut [0]).map_err(broken)? {
        0 => Ok(bytes),
        _ => Err(FileError::Length {
            what,
            found: length as u64 + 1,
            expected: length as u64,
        }),
    }
}

/// Reads this number of bytes; memory grows with what is there, not with what is announced.
fn exactly(from: impl Read, length: usize, what: &'static str) -> Result<Vec<u8>, FileError> {
    let mut bytes = Vec::new();
    let read = from.take(length as u64).read_to_end(&mut bytes);
    read.map_err(|error| FileError::Compression {
        what,
        reason: error.to_string(),
    })?;
    if bytes.len() != length {
        return Err(FileError::Length {
            what,
            found: bytes.len() as u64,
            expected: length as u64,
        });
    }
    Ok(bytes)
}

/// Columns of the lengths that the header states, as Gaussians.
fn decode(head: &Header, columns: &[Vec<u8>; 6]) -> Result<SplatFile, FileError> {
    let [positions, opacities, colors, scales, rotations, harmonics] = columns;
    let step = 1.0 / (1_u32 << head.fraction_bits) as f32;
    let rest = 3 * (coefficients(head.degree) - 1);
    let mut splats = Splats::empty(head.degree)?;
    for i in 0..head.count {
        let mut splat = Splat::sphere(1.0, [0.5; 3]);
        for k in 0..3 {
            let at = 9 * i + 3 * k;
            let [a, b, c] = [positions[at], positions[at + 1], positions[at + 2]];
            // The shift extends the sign.
            splat.position_m[k] = (i32::from_le_bytes([0, a, b, c]) >> 8) as f32 * step;
            splat.log_scale[k] = f32::from(scales[3 * i + k]) / 16.0 - 10.0;
            splat.harmonics[0][k] = (f32::from(colors[3 * i + k]) / 255.0 - 0.5) / COLOR_SCALE;
        }
        splat.opacity_logit = logit(opacities[i]);
        splat.rotation_wxyz = match head.version {
            2 => first_three([rotations[3 * i], rotations[3 * i + 1], rotations[3 * i + 2]]),
            _ => from_smallest_three(std::array::from_fn(|k| rotations[4 * i + k])),
        };
        for (k, value) in harmonics[rest * i..rest * (i + 1)].iter().enumerate() {
            splat.harmonics[1 + k / 3][k % 3] = (f32::from(*value) - 128.0) / 128.0;
        }
        splats.push(&splat)?;
    }
    Ok(SplatFile {
        splats,
        compensated: head.flags & COMPENSATED != 0,
    })
}

/// A coefficient in 8 bits, rounded to fewer, so that the stream compresses.
fn harmonic_byte(coefficient: f32, bits: u32) -> u8 {
    let step = (1 << (8 - bits)) as f32;
    let value = libm::roundf(coefficient * 128.0 + 128.0);
    (libm::floorf((value + step / 2.0) / step) * step).clamp(0.0, 255.0) as u8
}

/// Index of the largest component (order x y z w) and, in order, sign and 9 bits of the others.
fn smallest_three(wxyz: [f32; 4]) -> u32 {
    let [w, x, y, z] = unit(wxyz);
    let q = [x, y, z, w];
    let larger = |a: usize, b: usize| if q[b].abs() > q[a].abs() { b } else { a };
    let largest = (0..4).fold(0, larger);
    let mut packed = largest as u32;
    for (k, value) in q.into_iter().enumerate() {
        if k != largest {
            let sign = u32::from((value < 0.0) != (q[largest] < 0.0));
            let size = libm::roundf(511.0 * std::f32::consts::SQRT_2 * value.abs()) as u32;
            packed = packed << 10 | sign << 9 | size.min(511);
        }
    }
    packed
}

fn from_smallest_three(bytes: [u8; 4]) -> [f32; 4] {
    let mut packed = u32::from_le_bytes(bytes);
    let largest = (packed >> 30) as usize;
    let mut q = [0.0; 4];
    let mut squares = 0.0;
    for k in (0..4).rev() {
        if k != largest {
            let size = (packed & 511) as f32 / (511.0 * std::f32::consts::SQRT_2);
            q[k] = if packed & 512 == 0 { size } else { -size };
            squares += size * size;
            packed >>= 10;
        }
    }
    // Broken files: three components of more than length 1.
    q[largest] = (1.0 - squares).max(1e-6).sqrt();
    let [x, y, z, w] = q;
    [w, x, y, z]
}

fn first_three(bytes: [u8; 3]) -> [f32; 4] {
    let [x, y, z] = bytes.map(|v| f32::from(v) / 127.5 - 1.0);
    let w = (1.0 - x * x - y * y - z * z).max(1e-6).sqrt();
    [w, x, y, z]
}
