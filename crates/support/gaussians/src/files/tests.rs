use std::io::Write;

use super::*;
use crate::splats::{Plane, Splat};
use crate::tests::random_splats;

const MAX: usize = 1000;

type Reader = fn(&[u8], usize) -> Result<SplatFile, FileError>;

fn files() -> Vec<(&'static str, Reader, Vec<u8>)> {
    let splats = random_splats(1, 20, 2);
    vec![
        ("ply", ply::read, ply::write(&splats, true)),
        ("splat", dot_splat::read, dot_splat::write(&splats)),
        ("spz", spz::read, spz::write(&splats, true).unwrap()),
        ("old spz", spz::read, old_spz(&splats)),
    ]
}

/// Version 2, written byte by byte from the columns that version 4 has.
fn old_spz(splats: &Splats) -> Vec<u8> {
    let mut plain = Vec::new();
    plain.extend(0x5053_474e_u32.to_le_bytes());
    plain.extend(2_u32.to_le_bytes());
    plain.extend((splats.len() as u32).to_le_bytes());
    plain.extend([0, 12, 0, 0]);
    let all: Vec<_> = (0..splats.len()).map(|i| splats.get(i)).collect();
    for splat in &all {
        for x in splat.position_m {
            plain.extend(&((x * 4096.0).round() as i32).to_le_bytes()[..3]);
        }
    }
    plain.extend(
        all.iter()
            .map(|s| (255.0 / (1.0 + (-s.opacity_logit).exp())).round() as u8),
    );
    plain.extend(
        all.iter()
            .flat_map(|s| s.harmonics[0].map(|f| ((0.15 * f + 0.5) * 255.0).round() as u8)),
    );
    plain.extend(
        all.iter()
            .flat_map(|s| s.log_scale.map(|s| ((s + 10.0) * 16.0).round() as u8)),
    );
    for splat in &all {
        let [w, x, y, z] = unit(splat.rotation_wxyz);
        let sign = if w < 0.0 { -1.0 } else { 1.0 };
        plain.extend([x, y, z].map(|v| ((v * sign + 1.0) * 127.5).round() as u8));
    }
    let mut encoder = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::default());
    encoder.write_all(&plain).unwrap();
    encoder.finish().unwrap()
}

/// Largest difference of a Gaussian's values; rotations by angle.
fn deviation(a: &Splats, b: &Splats, i: usize) -> [f32; 5] {
    let (a, b) = (a.get(i), b.get(i));
    let largest = |a: &[f32], b: &[f32]| {
        a.iter()
            .zip(b)
            .map(|(a, b)| (a - b).abs())
            .fold(0.0, f32::max)
    };
    let (qa, qb) = (unit(a.rotation_wxyz), unit(b.rotation_wxyz));
    let cosine: f32 = qa.iter().zip(qb).map(|(a, b)| a * b).sum();
    let opacity = |logit: f32| 1.0 / (1.0 + (-logit).exp());
    [
        largest(&a.position_m, &b.position_m),
        largest(&a.log_scale, &b.log_scale),
        2.0 * cosine.abs().min(1.0).acos(),
        (opacity(a.opacity_logit) - opacity(b.opacity_logit)).abs(),
        largest(&a.harmonics[0], &b.harmonics[0]),
    ]
}

#[test]
fn ply_has_the_published_order_of_properties_and_loses_nothing() {
    for degree in 0..=3 {
        let splats = random_splats(1, 20, degree);
        let bytes = ply::write(&splats, false);
        let back = ply::read(&bytes, MAX).unwrap();
        assert_eq!(
            back,
            SplatFile {
                splats: splats.clone(),
                compensated: false
            }
        );
        let header = String::from_utf8_lossy(&bytes[..bytes.len().min(3000)]).into_owned();
        let header = &header[..header.find("end_header").unwrap()];
        let names = header
            .lines()
            .filter_map(|line| line.strip_prefix("property float "));
        let names: Vec<&str> = names.collect();
        assert_eq!(names.len(), [17, 26, 41, 62][degree]);
        assert_eq!(
            names[..9],
            [
                "x", "y", "z", "nx", "ny", "nz", "f_dc_0", "f_dc_1", "f_dc_2"
            ]
        );
        let tail = [
            "opacity", "scale_0", "scale_1", "scale_2", "rot_0", "rot_1", "rot_2", "rot_3",
        ];
        assert_eq!(names[names.len() - 8..], tail);
    }
    // Channel-major: with degree 1, f_rest_0..2 are red, f_rest_3..5 green.
    let splats = random_splats(2, 1, 1);
    let bytes = ply::write(&splats, false);
    let row = &bytes[bytes.len() - 26 * 4..];
    let float = |k: usize| f32::from_le_bytes(row[4 * k..4 * k + 4].try_into().unwrap());
    assert_eq!(float(9 + 1), splats.planes()[Plane::HARMONICS + 3 * 2][0]);
    assert_eq!(float(9 + 3), splats.planes()[Plane::HARMONICS + 3 + 1][0]);
}

#[test]
fn ply_is_read_by_name_among_other_properties() {
    let splats = random_splats(3, 2, 0);
    let names = [
        "rot_3", "rot_2", "rot_1", "rot_0", "z", "y", "x", "opacity", "scale_2", "scale_1",
        "scale_0", "f_dc_2", "f_dc_1", "f_dc_0",
    ];
    let planes = [9, 8, 7, 6, 2, 1, 0, 10, 5, 4, 3, 13, 12, 11];
    let mut bytes =
        b"ply\nformat binary_little_endian 1.0\nelement vertex 2\nproperty uchar label\n".to_vec();
    for name in names {
        bytes.extend(format!("property float32 {name}\n").into_bytes());
    }
    bytes.extend(b"property double weight\nelement face 0\nproperty list uchar int vertex_index\nend_header\n");
    for i in 0..2 {
        bytes.push(7);
        bytes.extend(
            planes
                .iter()
                .flat_map(|plane| splats.planes()[*plane][i].to_le_bytes()),
        );
        bytes.extend(1.5_f64.to_le_bytes());
    }
    assert_eq!(ply::read(&bytes, MAX).unwrap().splats, splats);
}

#[test]
fn broken_headers_are_refused_by_name() {
    let good = String::from("ply\nformat binary_little_endian 1.0\nelement vertex 0\n");
    let cases = [
        ("plx\nend_header\n".to_owned(), "first line"),
        (
            "ply\nformat ascii 1.0\nend_header\n".to_owned(),
            "binary_little_endian",
        ),
        ("ply\nend_header\n".to_owned(), "format"),
        (
            "ply\nformat binary_little_endian 1.0\nend_header\n".to_owned(),
            "vertex",
        ),
        (
            "ply\nformat binary_little_endian 1.0\nelement vertex -3\nend_header\n".to_owned(),
            "-3",
        ),
        (
            format!("{good}property float x\nend_header\n"),
            "property \"y\"",
        ),
        (format!("{good}property int x\nend_header\n"), "not a float"),
        (
            format!("{good}property list uchar int x\nend_header\n"),
            "list",
        ),
        (
            format!("{good}property float f_rest_0\nend_header\n"),
            "f_rest",
        ),
        ("ply\n".repeat(100_000), "end_header"),
    ];
    for (text, expected) in cases {
        let error = ply::read(text.as_bytes(), MAX).unwrap_err();
        assert!(error.to_string().contains(expected), "{error}: {expected}");
    }
    let splats = random_splats(1, 20, 2);
    let many = ply::write(&splats, false);
    assert_eq!(
        ply::read(&many, 19),
        Err(FileError::TooMany { found: 20, max: 19 })
    );
    // A header that announces more than there is.
    let huge = String::from_utf8_lossy(&many).replacen("vertex 20", "vertex 4000000000", 1);
    let error = ply::read(huge.as_bytes(), usize::MAX).unwrap_err();
    assert!(matches!(error, FileError::Length { .. }), "{error}");
    let mut nan = many.clone();
    let last = nan.len() - 4;
    nan[last..].copy_from_slice(&f32::NAN.to_le_bytes());
    let error = ply::read(&nan, MAX).unwrap_err();
    assert_eq!(
        error.to_string(),
        "the rotation of Gaussian 19 is not a finite number"
    );
}

#[test]
fn compressed_files_lose_no_more_than_their_steps() {
    for (name, read, bytes) in files().into_iter().skip(1) {
        let splats = random_splats(1, 20, 2);
        let back = read(&bytes, MAX).unwrap();
        assert_eq!(back.compensated, name == "spz");
        let back = back.splats;
        assert_eq!(back.len(), 20);
        for i in 0..20 {
            // `.splat` has another order.
            let distance = |j: &usize| -> f32 {
                let along = |k: usize| splats.planes()[k][i] - back.planes()[k][*j];
                (0..3).map(|k| along(k) * along(k)).sum()
            };
            let nearest = (0..20)
                .min_by(|a, b| distance(a).total_cmp(&distance(b)))
                .unwrap();
            let found = deviation(&splats, &back.select(&[nearest as u32; 20]), i);
            let limits = match name {
                "splat" => [0.0, 1e-5, 0.02, 0.003, 1.0],
                "spz" => [1.3e-4, 0.032, 0.005, 0.003, 0.02],
                _ => [1.3e-4, 0.032, 0.1, 0.003, 0.02],
            };
            for (found, limit) in found.into_iter().zip(limits) {
                assert!(
                    found <= limit,
                    "{name}, Gaussian {i}: {found} above {limit}"
                );
            }
        }
    }
    let splats = random_splats(1, 20, 2);
    let back = spz::read(&spz::write(&splats, false).unwrap(), MAX)
        .unwrap()
        .splats;
    for plane in Plane::HARMONICS + 3..Plane::count(2) {
        for i in 0..20 {
            let (a, b) = (
                splats.planes()[plane][i].clamp(-1.0, 1.0),
                back.planes()[plane][i],
            );
            assert!((a - b).abs() <= 0.07, "plane {plane}: {a} {b}");
        }
    }
}

#[test]
fn incomplete_files_are_refused() {
    for (name, read, bytes) in files() {
        for length in 0..bytes.len() {
            // A `.splat` of whole rows is a shorter file.
            let result = read(&bytes[..length], MAX);
            assert!(
                result.is_err() || name == "splat" && length % 32 == 0,
                "{name} of {length} bytes"
            );
        }
    }
    for read in [ply::read as Reader, spz::read] {
        assert!(read(&[], MAX).is_err());
        assert!(read(&[0x1f, 0x8b], MAX).is_err());
    }
}

#[test]
fn a_file_of_another_program_is_read() {
    let bytes = include_bytes!(concat!(
        env!("CARGO_MANIFEST_DIR"),
        "/tests/data/splat-transform.spz"
    ));
    let back = spz::read(bytes, MAX).unwrap().splats;
    assert_eq!((back.len(), back.degree()), (50, 2));
    // Signs of the harmonics of degrees 1 and 2 where y and z are negated.
    let signs = [1.0, -1.0, -1.0, 1.0, -1.0, 1.0, 1.0, -1.0, 1.0];
    for i in 0..50_u64 {
        let bell = |k: u64| counter_random::bell(3, k, i) as f32;
        let position = [bell(0), -bell(1), -bell(2)];
        let distance = |j: &usize| -> f32 {
            let along = |k: usize| (position[k] - back.get(*j).position_m[k]).powi(2);
            (0..3).map(along).sum()
        };
        let nearest = (0..50)
            .min_by(|a, b| distance(a).total_cmp(&distance(b)))
            .unwrap();
        let found = back.get(nearest);
        assert!(distance(&nearest) < 1e-6, "{}", distance(&nearest));
        for k in 0..3 {
            let scale = -2.0 + bell(3 + k as u64);
            assert!((found.log_scale[k] - scale).abs() < 0.032);
        }
        let expected = unit([bell(6), bell(7), -bell(8), -bell(9)]);
        let both = expected.iter().zip(unit(found.rotation_wxyz));
        let cosine: f32 = both.map(|(a, b)| a * b).sum();
        assert!(cosine.abs() > 0.99999, "{cosine}");
        assert!((found.opacity_logit - bell(10)).abs() < 0.03);
        for (k, sign) in signs.into_iter().enumerate() {
            for c in 0..3 {
                let value = sign * 0.3 * bell(11 + 3 * k as u64 + c as u64);
                assert!((found.harmonics[k][c] - value).abs() < 0.07, "{k}");
            }
        }
    }
}

#[test]
fn a_scale_beyond_single_precision_is_written_as_the_largest() {
    let mut splats = Splats::empty(0).unwrap();
    let mut splat = Splat::sphere(1.0, [0.5; 3]);
    splat.log_scale = [100.0, 0.0, 88.0];
    splats.push(&splat).unwrap();
    let read = dot_splat::read(&dot_splat::write(&splats), MAX).unwrap();
    let scales = read.splats.get(0).log_scale;
    assert!((scales[0] - f32::MAX.ln()).abs() < 1e-4, "{scales:?}");
    assert!((scales[2] - 88.0).abs() < 1e-4, "{scales:?}");
}
