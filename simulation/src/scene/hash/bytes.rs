//! Bytes of text and numbers in a hash.

pub(in crate::scene) fn text(hasher: &mut blake3::Hasher, text: &str) {
    hasher.update(&(text.len() as u64).to_le_bytes());
    hasher.update(text.as_bytes());
}

pub(in crate::scene) fn numbers(hasher: &mut blake3::Hasher, values: &[f64]) {
    for value in values {
        hasher.update(&value.to_le_bytes());
    }
}

/// Hashes f32 numbers, in blocks rather than one by one.
pub(in crate::scene) fn floats(hasher: &mut blake3::Hasher, values: &[f32]) {
    for block in values.chunks(4096) {
        let bytes: Vec<u8> = block.iter().flat_map(|value| value.to_le_bytes()).collect();
        hasher.update(&bytes);
    }
}
