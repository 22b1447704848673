//! Numbers as numpy prints and stores them.

use std::path::Path;

use nalgebra::{Matrix3, Rotation3, UnitQuaternion, Vector3};

use super::wrong;
use crate::error::SimulationError;
use crate::scene::similarity::Similarity;

/// Largest deviation of `RᵀR` from a multiple of the identity: numpy prints eight digits.
const ORTHONORMAL_TOLERANCE: f64 = 1e-4;

/// A matrix of rotation and scale.
pub(super) fn rotation_and_scale(
    matrix: &Matrix3<f64>,
) -> Result<(UnitQuaternion<f64>, f64), (String, &'static str)> {
    let determinant = matrix.determinant();
    if determinant.is_nan() || determinant <= 0.0 {
        let found = format!("a matrix of determinant {determinant}");
        return Err((found, "a rotation: a positive determinant, not mirrored"));
    }
    let scale = determinant.cbrt();
    let unit = matrix / scale;
    let deviation = (unit.transpose() * unit - Matrix3::identity()).amax();
    if deviation > ORTHONORMAL_TOLERANCE {
        let found = format!("axes that are not orthonormal by {deviation:.2e}");
        return Err((found, "a rotation, scaled or not"));
    }
    let rotation = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(unit));
    let rotation = UnitQuaternion::new_normalize(rotation.into_inner());
    // Eight digits of a rotation do not make a scale.
    let is_rigid = (scale - 1.0).abs() < ORTHONORMAL_TOLERANCE;
    Ok((rotation, if is_rigid { 1.0 } else { scale }))
}

/// `transformation.txt`: a printed array of four rows of three, R above t, with `x_in_lidar = R
/// x_in_sector + t`.
pub(super) fn transform(text: &str, path: &Path) -> Result<Similarity, SimulationError> {
    if text.contains("...") {
        let found = "an array that numpy abbreviated".to_owned();
        return Err(wrong(path, found, "all twelve numbers"));
    }
    let is_separator = |c: char| c.is_whitespace() || "[],;".contains(c);
    let words = text.split(is_separator).filter(|word| !word.is_empty());
    let mut values = Vec::new();
    for (index, word) in words.enumerate() {
        match word.parse::<f64>() {
            Ok(value) if value.is_finite() => values.push(value),
            _ => {
                let found = format!("{word:?} as number {index}");
                return Err(wrong(path, found, "finite numbers"));
            }
        }
    }
    let Ok(values) = <[f64; 12]>::try_from(values.as_slice()) else {
        let found = format!("{} numbers", values.len());
        return Err(wrong(
            path,
            found,
            "12: three rows of a rotation, one of a translation",
        ));
    };
    let matrix = Matrix3::from_row_slice(&values[..9]);
    let (rotation, scale) =
        rotation_and_scale(&matrix).map_err(|(found, expected)| wrong(path, found, expected))?;
    let translation = Vector3::from_column_slice(&values[9..]);
    Ok(Similarity::from_parts(scale, rotation, translation))
}

/// An array of numbers of two dimensions in a `.npy` file of version 1 or 2, as f64.
pub(super) struct Array {
    pub(super) rows: usize,
    pub(super) columns: usize,
    pub(super) values: Vec<f64>,
}

/// Reads an array. Arrays of objects are pickles and refused.
pub(super) fn array(bytes: &[u8], path: &Path) -> Result<Array, SimulationError> {
    let damaged = || wrong(path, "no header of an array".to_owned(), "a .npy file");
    let (start, length) = match bytes {
        [0x93, b'N', b'U', b'M', b'P', b'Y', 1, _, a, b, ..] => {
            (10, usize::from(u16::from_le_bytes([*a, *b])))
        }
        [0x93, b'N', b'U', b'M', b'P', b'Y', 2 | 3, _, a, b, c, d, ..] => {
            (12, u32::from_le_bytes([*a, *b, *c, *d]) as usize)
        }
        _ => return Err(damaged()),
    };
    let header = bytes.get(start..start + length).ok_or_else(damaged)?;
    let header = std::str::from_utf8(header).map_err(|_| damaged())?;
    let between = |begin: &str, end: &str| {
        let rest = &header[header.find(begin)? + begin.len()..];
        Some(&rest[..rest.find(end)?])
    };
    let kind = between("'descr': '", "'").ok_or_else(damaged)?;
    if header.contains("'fortran_order': True") {
        let found = "an array in the order of Fortran".to_owned();
        return Err(wrong(path, found, "rows first: numpy.ascontiguousarray"));
    }
    let shape = between("'shape': (", ")").ok_or_else(damaged)?;
    let shape: Vec<usize> = shape
        .split(',')
        .filter_map(|n| n.trim().parse().ok())
        .collect();
    let [rows, columns] = shape[..] else {
        return Err(wrong(path, format!("{} dimensions", shape.len()), "2"));
    };
    let data = &bytes[start + length..];
    let values: Vec<f64> = match kind {
        "<f4" => numbers(data, |b: [u8; 4]| f64::from(f32::from_le_bytes(b))),
        "<f8" => numbers(data, f64::from_le_bytes),
        "<i4" => numbers(data, |b: [u8; 4]| f64::from(i32::from_le_bytes(b))),
        "<i8" => numbers(data, |b: [u8; 8]| i64::from_le_bytes(b) as f64),
        "|u1" | "|b1" => numbers(data, |[b]: [u8; 1]| f64::from(b)),
        "|O" => {
            let found = "an array of objects, which is a pickle".to_owned();
            return Err(wrong(path, found, "an array of numbers"));
        }
        other => {
            return Err(wrong(
                path,
                format!("numbers of type {other}"),
                "<f4, <f8, <i4, <i8, |u1 or |b1",
            ));
        }
    };
    if rows.checked_mul(columns) != Some(values.len()) {
        let found = format!("{} values of {rows} x {columns}", values.len());
        return Err(wrong(path, found, "all of them"));
    }
    Ok(Array {
        rows,
        columns,
        values,
    })
}

fn numbers<const N: usize>(data: &[u8], read: impl Fn([u8; N]) -> f64) -> Vec<f64> {
    data.as_chunks::<N>()
        .0
        .iter()
        .map(|bytes| read(*bytes))
        .collect()
}
