//! Arrays of numbers, row-major.
//!
//! Contract: the reader takes an array of the expected type and shape, as written here or saved
//! again by NumPy, and nothing else.

use std::path::Path;

use super::{Kind, blankless, parts, start, wrong};
use crate::error::BundleError;

/// A number of an array.
pub(crate) trait Element: Copy {
    const KIND: Kind;

    fn put(self, bytes: &mut Vec<u8>);

    /// Of exactly the bytes of one number.
    fn get(bytes: &[u8]) -> Self;
}

impl Element for f32 {
    const KIND: Kind = Kind::F32;

    fn put(self, bytes: &mut Vec<u8>) {
        bytes.extend(self.to_le_bytes());
    }

    fn get(bytes: &[u8]) -> Self {
        Self::from_le_bytes([bytes[0], bytes[1], bytes[2], bytes[3]])
    }
}

impl Element for u8 {
    const KIND: Kind = Kind::U8;

    fn put(self, bytes: &mut Vec<u8>) {
        bytes.push(self);
    }

    fn get(bytes: &[u8]) -> Self {
        bytes[0]
    }
}

impl Element for i8 {
    const KIND: Kind = Kind::I8;

    fn put(self, bytes: &mut Vec<u8>) {
        bytes.push(self.to_le_bytes()[0]);
    }

    fn get(bytes: &[u8]) -> Self {
        Self::from_le_bytes([bytes[0]])
    }
}

fn description<T: Element>(shape: &[usize]) -> String {
    let sizes: Vec<String> = shape.iter().map(usize::to_string).collect();
    // A tuple of one has a comma at its end.
    let comma = if shape.len() == 1 { "," } else { "" };
    format!(
        "{{'descr': '{}', 'fortran_order': False, 'shape': ({}{comma}), }}",
        T::KIND.code(),
        sizes.join(", ")
    )
}

/// The file of an array. The product of the shape is the number of values.
pub(crate) fn encode<T: Element>(shape: &[usize], values: &[T]) -> Vec<u8> {
    debug_assert_eq!(shape.iter().product::<usize>(), values.len());
    let text = description::<T>(shape);
    let mut bytes = start(&text, text.len());
    bytes.reserve(values.len() * T::KIND.bytes());
    values.iter().for_each(|value| value.put(&mut bytes));
    bytes
}

/// The values of an array of a shape. `path` is for messages.
pub(crate) fn decode<T: Element>(
    bytes: &[u8],
    shape: &[usize],
    path: &Path,
) -> Result<Vec<T>, BundleError> {
    let (text, data) = parts(bytes, path)?;
    let (text, expected) = (blankless(&text), blankless(&description::<T>(shape)));
    if text != expected {
        return Err(wrong(path, "header", text, expected));
    }
    let size = T::KIND.bytes();
    let count = shape.iter().try_fold(size, |all, n| all.checked_mul(*n));
    if count != Some(data.len()) {
        let found = format!("{} bytes of numbers", data.len());
        return Err(wrong(
            path,
            "numbers",
            found,
            format!("{shape:?} of {size} bytes"),
        ));
    }
    Ok(data.chunks_exact(size).map(T::get).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn arrays_of_another_type_or_shape_are_refused() {
        let path = Path::new("a.npy");
        let bytes = encode(&[2, 3], &[0.5_f32, -1.0, f32::INFINITY, 3.0, 4.0, 5.0]);
        let header = String::from_utf8_lossy(&bytes[10..128]).into_owned();
        assert_eq!(
            header.trim_end(),
            "{'descr': '<f4', 'fortran_order': False, 'shape': (2, 3), }"
        );
        assert_eq!(bytes.len(), 128 + 24);
        let back = decode::<f32>(&bytes, &[2, 3], path).unwrap();
        assert_eq!(back, [0.5, -1.0, f32::INFINITY, 3.0, 4.0, 5.0]);
        let message = |result: Result<(), BundleError>| result.unwrap_err().to_string();
        let turned = message(decode::<f32>(&bytes, &[3, 2], path).map(drop));
        assert!(turned.contains("'shape':(2,3)"), "{turned}");
        let other = message(decode::<u8>(&bytes, &[2, 3], path).map(drop));
        assert!(other.contains("expected {'descr':'|u1'"), "{other}");
        let short = message(decode::<f32>(&bytes[..bytes.len() - 1], &[2, 3], path).map(drop));
        assert!(short.contains("found 23 bytes of numbers"), "{short}");
        let one = encode(&[3], &[-1_i8, 0, 100]);
        assert!(String::from_utf8_lossy(&one[..128]).contains("'shape': (3,)"));
        assert_eq!(decode::<i8>(&one, &[3], path).unwrap(), [-1, 0, 100]);
    }
}
