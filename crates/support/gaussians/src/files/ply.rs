//! The `.ply` file of 3DGS (Kerbl et al. 2023): one element `vertex` of floats.
//!
//! Order of properties, as published and as written here: `x y z nx ny nz f_dc_0..2 f_rest_0..
//! opacity scale_0..2 rot_0..3`. Opacities are logits, scales natural logarithms, rotations `w x y
//! z`; `f_rest` holds all coefficients of red, then those of green, then of blue. Read are
//! properties by name, in any order and among others, little-endian. A comment `SplatRenderMode:
//! mip` states compensated dilation, as Brush and SuperSplat write it.
//!
//! ```
//! use gaussians::files::ply;
//! use gaussians::{Splat, Splats};
//!
//! let mut splats = Splats::empty(1)?;
//! splats.push(&Splat::sphere(0.1, [1.0, 0.5, 0.2]))?;
//! let bytes = ply::write(&splats, false);
//! let back = ply::read(&bytes, 1000)?;
//! assert_eq!(back.splats, splats);
//!
//! let error = ply::read(&bytes[..bytes.len() - 1], 1000).unwrap_err();
//! assert_eq!(error.to_string(), "vertices: 103 bytes, expected 104");
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

use super::{FileError, SplatFile, header};
use crate::splats::{MAX_DEGREE, Plane, Splats, coefficients};

/// Longest header that is read, bytes.
const MAX_HEADER: usize = 1 << 16;

const END: &[u8] = b"end_header\n";
const MIP: &str = "SplatRenderMode: mip";

/// Writes Gaussians.
pub fn write(splats: &Splats, compensated: bool) -> Vec<u8> {
    let count = splats.len();
    let mut text = String::from("ply\nformat binary_little_endian 1.0\n");
    if compensated {
        text += &format!("comment {MIP}\n");
    }
    text += &format!("element vertex {count}\n");
    let properties = properties(splats.degree());
    for (name, _) in &properties {
        text += &format!("property float {name}\n");
    }
    let mut bytes = text.into_bytes();
    bytes.extend(END);
    bytes.reserve(count * properties.len() * 4);
    for i in 0..count {
        for (_, plane) in &properties {
            let value = plane.map_or(0.0, |plane| splats.planes()[plane][i]);
            bytes.extend(value.to_le_bytes());
        }
    }
    bytes
}

/// Reads at most `max` Gaussians.
///
/// # Errors
/// [`FileError::Header`], [`FileError::Length`] if the vertices are incomplete,
/// [`FileError::TooMany`], [`FileError::Splats`] if a value is not finite.
pub fn read(bytes: &[u8], max: usize) -> Result<SplatFile, FileError> {
    let head = &bytes[..bytes.len().min(MAX_HEADER)];
    let Some(end) = head.windows(END.len()).position(|window| window == END) else {
        let reason = format!("no line \"end_header\" in the first {} bytes", head.len());
        return Err(header(reason));
    };
    let text = std::str::from_utf8(&head[..end]).map_err(|_| header("not a text in UTF-8"))?;
    let layout = Layout::parse(text)?;
    if layout.count > max as u64 {
        let found = layout.count;
        return Err(FileError::TooMany { found, max });
    }
    let count = layout.count as usize;
    let data = &bytes[end + END.len()..];
    let expected = layout.count * layout.stride as u64;
    if (data.len() as u64) < expected {
        let found = data.len() as u64;
        return Err(FileError::Length {
            what: "vertices",
            found,
            expected,
        });
    }
    let degree = layout.degree()?;
    let mut planes = vec![Vec::new(); Plane::count(degree)];
    for (name, plane) in properties(degree) {
        let Some(plane) = plane else {
            continue;
        };
        let offset = layout.offset(&name)?;
        let vertices = data.chunks_exact(layout.stride).take(count);
        let value = |vertex: &[u8]| match vertex[offset..].first_chunk() {
            Some(four) => f32::from_le_bytes(*four),
            None => 0.0,
        };
        planes[plane] = vertices.map(value).collect();
    }
    Ok(SplatFile {
        splats: Splats::from_planes(degree, planes)?,
        compensated: layout.compensated,
    })
}

/// All properties in the published order, with their planes. Normals have none.
fn properties(degree: usize) -> Vec<(String, Option<usize>)> {
    let rest = coefficients(degree) - 1;
    let named = |names: [&str; 3], first: usize| {
        let all = names.into_iter().enumerate();
        all.map(move |(k, name)| (name.to_owned(), Some(first + k)))
            .collect::<Vec<_>>()
    };
    let mut all = named(["x", "y", "z"], Plane::POSITION);
    all.extend(["nx", "ny", "nz"].map(|name| (name.to_owned(), None)));
    all.extend(named(["f_dc_0", "f_dc_1", "f_dc_2"], Plane::HARMONICS));
    for c in 0..3 {
        for k in 0..rest {
            let plane = Plane::HARMONICS + 3 * (k + 1) + c;
            all.push((format!("f_rest_{}", c * rest + k), Some(plane)));
        }
    }
    all.push(("opacity".to_owned(), Some(Plane::OPACITY)));
    all.extend(named(["scale_0", "scale_1", "scale_2"], Plane::SCALE));
    all.extend((0..4).map(|k| (format!("rot_{k}"), Some(Plane::ROTATION + k))));
    all
}

/// The element `vertex` of a header.
struct Layout<'a> {
    count: u64,
    /// Names, whether they are 32-bit floats, and offsets in a vertex, bytes.
    properties: Vec<(&'a str, bool, usize)>,
    /// Bytes of a vertex.
    stride: usize,
    compensated: bool,
}

impl<'a> Layout<'a> {
    fn parse(text: &'a str) -> Result<Self, FileError> {
        let mut lines = text.lines();
        if lines.next() != Some("ply") {
            return Err(header("the first line is not \"ply\""));
        }
        let mut layout = Self {
            count: 0,
            properties: Vec::new(),
            stride: 0,
            compensated: false,
        };
        let mut elements = 0;
        let mut has_format = false;
        for line in lines {
            let words: Vec<&str> = line.split_ascii_whitespace().collect();
            match words[..] {
                ["format", "binary_little_endian", "1.0"] => has_format = true,
                ["format", ..] => {
                    let reason = format!("{line:?}, expected \"format binary_little_endian 1.0\"");
                    return Err(header(reason));
                }
                ["comment", ..] => layout.compensated |= line.contains(MIP),
                ["element", name, count] => {
                    elements += 1;
                    // Elements behind the vertices are not read.
                    if elements == 1 {
                        layout.count = vertices(name, count)?;
                    }
                }
                ["property", kind, name] if elements == 1 => {
                    let size = size(kind).ok_or_else(|| header(format!("type {kind:?}")))?;
                    let is_float = matches!(kind, "float" | "float32");
                    layout.properties.push((name, is_float, layout.stride));
                    layout.stride += size;
                }
                ["property", "list", ..] if elements == 1 => {
                    return Err(header("a list in the element \"vertex\""));
                }
                _ => {}
            }
        }
        match (has_format, elements) {
            (false, _) => Err(header("no line \"format\"")),
            (_, 0) => Err(header("no element \"vertex\"")),
            _ => Ok(layout),
        }
    }

    /// Degree of the harmonics, from the number of properties `f_rest_*`.
    fn degree(&self) -> Result<usize, FileError> {
        let rest = self
            .properties
            .iter()
            .filter(|(name, ..)| name.starts_with("f_rest_"));
        let found = rest.count();
        let of = |degree: usize| 3 * (coefficients(degree) - 1);
        (0..=MAX_DEGREE)
            .find(|degree| of(*degree) == found)
            .ok_or_else(|| {
                header(format!(
                    "{found} properties f_rest_*, expected 0, 9, 24 or 45"
                ))
            })
    }

    fn offset(&self, name: &str) -> Result<usize, FileError> {
        let property = self.properties.iter().find(|(of, ..)| *of == name);
        match property {
            Some((_, true, offset)) => Ok(*offset),
            Some((_, false, _)) => Err(header(format!("property {name:?} is not a float"))),
            None => Err(header(format!("no property {name:?}"))),
        }
    }
}

fn vertices(name: &str, count: &str) -> Result<u64, FileError> {
    if name != "vertex" {
        return Err(header(format!(
            "first element {name:?}, expected \"vertex\""
        )));
    }
    let count: u32 = count
        .parse()
        .map_err(|_| header(format!("{count:?} vertices")))?;
    Ok(u64::from(count))
}

fn size(kind: &str) -> Option<usize> {
    match kind {
        "char" | "uchar" | "int8" | "uint8" => Some(1),
        "short" | "ushort" | "int16" | "uint16" => Some(2),
        "int" | "uint" | "float" | "int32" | "uint32" | "float32" => Some(4),
        "double" | "float64" => Some(8),
        _ => None,
    }
}
