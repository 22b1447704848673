//! Binary glTF 2.0 with the extension `KHR_gaussian_splatting` (Khronos Group, ratified 2026),
//! written.
//!
//! A primitive of points in 32-bit floats: `POSITION`, and with the prefix
//! `KHR_gaussian_splatting:` unit quaternions `x y z w` as `ROTATION`, standard deviations (not
//! their logarithms) as `SCALE`, `OPACITY` from 0 to 1, and a `SH_DEGREE_l_COEF_n` for each
//! coefficient of the harmonics. `COLOR_0` is for programs without the extension: the color of
//! degree 0 as linear values and the opacity. Colors are blended as sRGB values
//! (`srgb_rec709_display`).
//!
//! In glTF y is up: rotate a world with z up by [`rub_from_z_up`](super::spz::rub_from_z_up) before
//! writing, not by a node: readers ought to rotate harmonics by their node, but need not.
//!
//! ```
//! use gaussians::files::{glb, spz};
//! use gaussians::{Splat, Splats};
//!
//! let mut splats = Splats::empty(1)?;
//! splats.push(&Splat::sphere(0.1, [1.0, 0.5, 0.2]))?;
//! let bytes = glb::write(&splats.transformed(&spz::rub_from_z_up()), "example 1.0")?;
//! assert!(bytes.starts_with(b"glTF"));
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

use serde_json::{Map, Value, json};

use super::{FileError, header, unit};
use crate::harmonics::to_color;
use crate::splats::{Plane, Splats};

const NAME: &str = "KHR_gaussian_splatting";
/// Type of numbers (glTF 2.0, 5.1.3).
const FLOAT: u32 = 5126;
/// Use of a view of the buffer (5.11.5).
const ARRAY_BUFFER: u32 = 34962;
/// Mode of a primitive (5.24.4).
const POINTS: u32 = 0;

/// Attribute of all Gaussians: name, shape and numbers.
type Attribute = (String, &'static str, Vec<f32>);

/// Writes Gaussians; `generator` is the program that writes them.
///
/// # Errors
/// [`FileError::Header`] if a standard deviation is too large for 32 bits or the file would have
/// more than 4 GiB.
pub fn write(splats: &Splats, generator: &str) -> Result<Vec<u8>, FileError> {
    let asset = json!({ "version": "2.0", "generator": generator });
    if splats.is_empty() {
        // Accessors of nothing are not allowed.
        let content = json!({ "asset": asset, "scene": 0, "scenes": [{}] });
        return container(&content, &[]);
    }
    let attributes = attributes(splats)?;
    let mut binary = Vec::new();
    let (mut views, mut accessors, mut names) = (Vec::new(), Vec::new(), Map::new());
    for (number, (name, shape, numbers)) in attributes.iter().enumerate() {
        let offset = binary.len();
        binary.extend(numbers.iter().flat_map(|v| v.to_le_bytes()));
        views.push(json!({
            "buffer": 0,
            "byteOffset": offset,
            "byteLength": binary.len() - offset,
            "target": ARRAY_BUFFER,
        }));
        let mut accessor = json!({
            "bufferView": number,
            "componentType": FLOAT,
            "count": splats.len(),
            "type": shape,
        });
        if name == "POSITION" {
            let [low, high] = bounds(splats);
            accessor["min"] = json!(low);
            accessor["max"] = json!(high);
        }
        accessors.push(accessor);
        names.insert(name.clone(), json!(number));
    }
    let primitive = json!({
        "mode": POINTS,
        "attributes": names,
        "extensions": { NAME: { "kernel": "ellipse", "colorSpace": "srgb_rec709_display" } },
    });
    let content = json!({
        "asset": asset,
        "extensionsUsed": [NAME],
        "scene": 0,
        "scenes": [{ "nodes": [0] }],
        "nodes": [{ "mesh": 0, "name": "Gaussians" }],
        "meshes": [{ "primitives": [primitive] }],
        "accessors": accessors,
        "bufferViews": views,
        "buffers": [{ "byteLength": binary.len() }],
    });
    container(&content, &binary)
}

fn attributes(splats: &Splats) -> Result<Vec<Attribute>, FileError> {
    let mut positions = Vec::with_capacity(3 * splats.len());
    let (mut rotations, mut scales) = (Vec::new(), Vec::new());
    let (mut opacities, mut colors) = (Vec::new(), Vec::new());
    for i in 0..splats.len() {
        let splat = splats.get(i);
        let sigmas = splat.log_scale.map(libm::expf);
        if let Some(sigma) = sigmas.iter().find(|sigma| !sigma.is_finite()) {
            let reason = format!("a standard deviation of {sigma} m, expected a finite one");
            return Err(header(reason));
        }
        let [w, x, y, z] = unit(splat.rotation_wxyz);
        let opacity = 1.0 / (1.0 + libm::expf(-splat.opacity_logit));
        positions.extend(splat.position_m);
        rotations.extend([x, y, z, w]);
        scales.extend(sigmas);
        opacities.push(opacity);
        colors.extend(splat.harmonics[0].map(|f| linear(to_color(f).clamp(0.0, 1.0))));
        colors.push(opacity);
    }
    let of_extension = |name: &str| format!("{NAME}:{name}");
    let mut all = vec![
        ("POSITION".to_owned(), "VEC3", positions),
        ("COLOR_0".to_owned(), "VEC4", colors),
        (of_extension("ROTATION"), "VEC4", rotations),
        (of_extension("SCALE"), "VEC3", scales),
        (of_extension("OPACITY"), "SCALAR", opacities),
    ];
    for degree in 0..=splats.degree() {
        for n in 0..2 * degree + 1 {
            let first = Plane::HARMONICS + 3 * (degree * degree + n);
            let planes = &splats.planes()[first..first + 3];
            let values = (0..splats.len()).flat_map(|i| [0, 1, 2].map(|c| planes[c][i]));
            let name = of_extension(&format!("SH_DEGREE_{degree}_COEF_{n}"));
            all.push((name, "VEC3", values.collect()));
        }
    }
    Ok(all)
}

/// Lowest and highest coordinates.
fn bounds(splats: &Splats) -> [[f32; 3]; 2] {
    let of = |first: f32, choose: fn(f32, f32) -> f32| {
        [0, 1, 2].map(|k| {
            let plane = &splats.planes()[Plane::POSITION + k];
            plane.iter().copied().fold(first, choose)
        })
    };
    [of(f32::INFINITY, f32::min), of(f32::NEG_INFINITY, f32::max)]
}

/// Linear value of an sRGB value (IEC 61966-2-1).
fn linear(value: f32) -> f32 {
    match value <= 0.04045 {
        true => value / 12.92,
        false => libm::powf((value + 0.055) / 1.055, 2.4),
    }
}

/// The file of a JSON and, if there is one, a binary chunk.
fn container(content: &Value, binary: &[u8]) -> Result<Vec<u8>, FileError> {
    let mut json = content.to_string().into_bytes();
    json.resize(json.len().next_multiple_of(4), b' ');
    // The binary chunk consists of words of four bytes already.
    let chunks = [(b"JSON", json.as_slice()), (b"BIN\0", binary)];
    let chunks: Vec<_> = (chunks.into_iter())
        .filter(|(_, chunk)| !chunk.is_empty())
        .collect();
    let length = 12
        + chunks
            .iter()
            .map(|(_, chunk)| 8 + chunk.len())
            .sum::<usize>();
    let Ok(length) = u32::try_from(length) else {
        return Err(header(format!(
            "a file of {length} bytes, expected below 4 GiB"
        )));
    };
    let mut bytes = Vec::with_capacity(length as usize);
    bytes.extend(b"glTF");
    bytes.extend(2_u32.to_le_bytes());
    bytes.extend(length.to_le_bytes());
    for (kind, chunk) in chunks {
        bytes.extend((chunk.len() as u32).to_le_bytes());
        bytes.extend(kind);
        bytes.extend(chunk);
    }
    Ok(bytes)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::splats::Splat;
    use crate::tests::random_splats;

    /// JSON and binary chunk.
    fn parse(bytes: &[u8]) -> (Value, &[u8]) {
        let word = |at: usize| u32::from_le_bytes(bytes[at..at + 4].try_into().unwrap()) as usize;
        assert_eq!(
            (&bytes[..4], word(4), word(8)),
            (&b"glTF"[..], 2, bytes.len())
        );
        let end = 20 + word(12);
        assert_eq!(&bytes[16..20], b"JSON");
        let content = serde_json::from_slice(&bytes[20..end]).unwrap();
        if end == bytes.len() {
            return (content, &[]);
        }
        assert_eq!((&bytes[end + 4..end + 8], end % 4), (&b"BIN\0"[..], 0));
        assert_eq!(word(end), bytes.len() - end - 8);
        (content, &bytes[end + 8..])
    }

    /// Numbers of an attribute, as its accessor says.
    fn numbers(content: &Value, binary: &[u8], name: &str) -> Vec<f32> {
        let primitive = &content["meshes"][0]["primitives"][0];
        let number = primitive["attributes"][name].as_u64().expect(name) as usize;
        let accessor = &content["accessors"][number];
        let view = &content["bufferViews"][accessor["bufferView"].as_u64().unwrap() as usize];
        let at = |key: &str| view[key].as_u64().unwrap() as usize;
        let bytes = &binary[at("byteOffset")..][..at("byteLength")];
        let shape = match accessor["type"].as_str().unwrap() {
            "SCALAR" => 1,
            "VEC3" => 3,
            _ => 4,
        };
        assert_eq!(accessor["componentType"], FLOAT);
        assert_eq!(
            bytes.len() as u64,
            4 * shape * accessor["count"].as_u64().unwrap()
        );
        let (floats, _) = bytes.as_chunks::<4>();
        floats.iter().map(|v| f32::from_le_bytes(*v)).collect()
    }

    #[test]
    fn attributes_are_those_of_the_extension() {
        for degree in 0..=3 {
            let splats = random_splats(4, 20, degree);
            let bytes = write(&splats, "test").unwrap();
            let (content, binary) = parse(&bytes);
            assert_eq!(content["extensionsUsed"], json!([NAME]));
            let primitive = &content["meshes"][0]["primitives"][0];
            assert_eq!(primitive["mode"], 0);
            assert_eq!(primitive["extensions"][NAME]["kernel"], "ellipse");
            let count = primitive["attributes"].as_object().unwrap().len();
            assert_eq!(count, 5 + (degree + 1) * (degree + 1));
            let of = |name: &str| numbers(&content, binary, &format!("{NAME}:{name}"));
            let positions = numbers(&content, binary, "POSITION");
            for i in 0..20 {
                let splat = splats.get(i);
                assert_eq!(positions[3 * i..3 * i + 3], splat.position_m);
                let [w, x, y, z] = unit(splat.rotation_wxyz);
                assert_eq!(of("ROTATION")[4 * i..4 * i + 4], [x, y, z, w]);
                let sigma = of("SCALE")[3 * i + 1];
                assert!((sigma / splat.log_scale[1].exp() - 1.0).abs() < 1e-6);
                let opacity = of("OPACITY")[i];
                assert!(((opacity / (1.0 - opacity)).ln() - splat.opacity_logit).abs() < 1e-3);
                for (k, rgb) in splat.harmonics.iter().enumerate().take((degree + 1).pow(2)) {
                    let l = k.isqrt();
                    let name = format!("SH_DEGREE_{l}_COEF_{}", k - l * l);
                    assert_eq!(of(&name)[3 * i..3 * i + 3], *rgb);
                }
            }
            let low = positions
                .chunks(3)
                .map(|x| x[1])
                .fold(f32::INFINITY, f32::min);
            assert_eq!(content["accessors"][0]["min"][1], json!(low));
        }
    }

    #[test]
    fn attributes_are_those_that_another_program_writes() {
        let theirs = include_bytes!(concat!(
            env!("CARGO_MANIFEST_DIR"),
            "/tests/data/splat-transform.glb"
        ));
        let ours = write(&random_splats(6, 20, 2), "test").unwrap();
        let ((theirs, their_binary), (ours, our_binary)) = (parse(theirs), parse(&ours));
        let names = |content: &Value| {
            let primitive = &content["meshes"][0]["primitives"][0];
            let attributes = primitive["attributes"].as_object().unwrap();
            attributes.keys().cloned().collect::<Vec<_>>()
        };
        assert_eq!(names(&ours), names(&theirs));
        for name in names(&ours) {
            // Theirs are sRGB values in 8 bits.
            if name == "COLOR_0" {
                continue;
            }
            let expected = numbers(&theirs, their_binary, &name);
            let found = numbers(&ours, our_binary, &name);
            assert_eq!(found.len(), expected.len(), "{name}");
            let mut both: Vec<(f32, f32)> = found.into_iter().zip(expected).collect();
            if name.ends_with(":ROTATION") {
                // Theirs are of any length and sign.
                for four in both.chunks_mut(4) {
                    let length = four.iter().map(|(_, q)| q * q).sum::<f32>().sqrt();
                    let cosine: f32 = four.iter().map(|(a, b)| a * b).sum();
                    (four.iter_mut()).for_each(|(_, q)| *q /= length.copysign(cosine));
                }
            }
            for (found, expected) in both {
                assert!(
                    (found - expected).abs() < 2e-6,
                    "{name}: {found} {expected}"
                );
            }
        }
    }

    #[test]
    fn colors_for_other_programs_are_linear() {
        let mut splats = Splats::empty(0).unwrap();
        splats.push(&Splat::sphere(0.1, [0.5, 2.0, -1.0])).unwrap();
        let bytes = write(&splats, "test").unwrap();
        let (content, binary) = parse(&bytes);
        let [r, g, b, a] = numbers(&content, binary, "COLOR_0")[..] else {
            panic!("{content}")
        };
        assert!(
            (r - 0.21404).abs() < 1e-4 && (a - 0.5).abs() < 1e-6,
            "{r} {a}"
        );
        assert_eq!((g, b), (1.0, 0.0));
    }

    #[test]
    fn nothing_and_infinite_sizes() {
        let bytes = write(&Splats::empty(2).unwrap(), "test").unwrap();
        let (content, binary) = parse(&bytes);
        assert_eq!((content.get("meshes"), binary.len()), (None, 0));
        let mut splats = Splats::empty(0).unwrap();
        let huge = Splat {
            log_scale: [100.0, 0.0, 0.0],
            ..Splat::sphere(1.0, [0.5; 3])
        };
        splats.push(&huge).unwrap();
        let error = write(&splats, "test").unwrap_err().to_string();
        assert!(error.contains("standard deviation"), "{error}");
    }
}
