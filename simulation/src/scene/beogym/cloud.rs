//! Point clouds in PCD files (PCL), ASCII or binary.

use std::path::Path;

use super::wrong;
use crate::error::SimulationError;

/// The fields that are read.
const AXES: [&str; 3] = ["x", "y", "z"];
/// Numbers of a field at most; real files have up to some hundred.
const MAX_COUNT: usize = 1 << 16;

/// Positions in a PCD file. Points that are not finite are left out: PCL marks unmeasured ones so.
pub(super) fn read(bytes: &[u8], path: &Path) -> Result<Vec<[f64; 3]>, SimulationError> {
    let mut lines = Vec::new();
    let mut at = 0;
    let data = loop {
        let Some(length) = bytes[at..].iter().position(|byte| *byte == b'\n') else {
            let found = "no line DATA in the header".to_owned();
            return Err(wrong(path, found, "a PCD file"));
        };
        let line = String::from_utf8_lossy(&bytes[at..at + length])
            .trim()
            .to_owned();
        at += length + 1;
        if let Some(kind) = line.strip_prefix("DATA ") {
            break kind.to_owned();
        }
        lines.push(line);
    };
    let words = |key: &str| -> Vec<&str> {
        let line = lines.iter().find_map(|line| line.strip_prefix(key));
        line.map(|line| line.split_whitespace().collect())
            .unwrap_or_default()
    };
    let (fields, sizes, kinds) = (words("FIELDS "), words("SIZE "), words("TYPE "));
    let counts: Vec<usize> = match words("COUNT ") {
        counts if counts.is_empty() => vec![1; fields.len()],
        counts => counts
            .iter()
            .filter_map(|count| count.parse().ok())
            .filter(|count| *count <= MAX_COUNT)
            .collect(),
    };
    let sizes = sizes.iter().filter_map(|size| size.parse().ok());
    let sizes: Vec<usize> = sizes.filter(|size| [1, 2, 4, 8].contains(size)).collect();
    let points: usize = words("POINTS ")
        .first()
        .and_then(|n| n.parse().ok())
        .unwrap_or(0);
    if [sizes.len(), kinds.len(), counts.len()] != [fields.len(); 3] {
        let found = format!("{} fields, other numbers of sizes and types", fields.len());
        return Err(wrong(path, found, "the same count of each"));
    }
    let mut columns = [0; 3];
    for (axis, column) in AXES.iter().zip(&mut columns) {
        let index = fields.iter().position(|field| field == axis);
        let index =
            index.filter(|i| kinds[*i] == "F" && [4, 8].contains(&sizes[*i]) && counts[*i] == 1);
        *column = index.ok_or_else(|| {
            wrong(
                path,
                format!("no number {axis}"),
                "floating point numbers x, y and z",
            )
        })?;
    }
    let all = match data.as_str() {
        "ascii" => ascii(
            &bytes[at..],
            &columns.map(|c| counts[..c].iter().sum::<usize>()),
            path,
        )?,
        "binary" => {
            let offset = |c: usize| -> usize { (0..c).map(|i| sizes[i] * counts[i]).sum() };
            let fields = columns.map(|c| (offset(c), sizes[c]));
            binary(&bytes[at..], &fields, offset(sizes.len()))
        }
        other => {
            let found = format!("data {other}");
            let expected = "ascii or binary: pcl_convert_pcd_ascii_binary IN OUT 1 converts";
            return Err(wrong(path, found, expected));
        }
    };
    if all.len() != points {
        let found = format!("{} points", all.len());
        return Err(wrong(path, found, &format!("{points} as in the header")));
    }
    Ok(all
        .into_iter()
        .filter(|x| x.iter().all(|v| v.is_finite()))
        .collect())
}

fn ascii(
    bytes: &[u8],
    columns: &[usize; 3],
    path: &Path,
) -> Result<Vec<[f64; 3]>, SimulationError> {
    let text = String::from_utf8_lossy(bytes);
    let lines = text.lines().filter(|line| !line.trim().is_empty());
    let point = |(index, line): (usize, &str)| {
        let words: Vec<&str> = line.split_whitespace().collect();
        let value = |column: usize| words.get(column).and_then(|word| word.parse::<f64>().ok());
        let values = columns.map(value);
        match values {
            [Some(x), Some(y), Some(z)] => Ok([x, y, z]),
            _ => Err(wrong(
                path,
                format!("{line:?} as point {index}"),
                "numbers x, y and z",
            )),
        }
    };
    lines.enumerate().map(point).collect()
}

fn binary(bytes: &[u8], fields: &[(usize, usize); 3], stride: usize) -> Vec<[f64; 3]> {
    let value = |point: &[u8], (offset, size): (usize, usize)| match size {
        4 => point[offset..]
            .first_chunk()
            .map(|b| f64::from(f32::from_le_bytes(*b))),
        _ => point[offset..]
            .first_chunk()
            .map(|b| f64::from_le_bytes(*b)),
    };
    let points = bytes.chunks_exact(stride.max(1));
    points
        .map(|point| fields.map(|field| value(point, field).unwrap_or(f64::NAN)))
        .collect()
}
