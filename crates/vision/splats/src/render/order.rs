//! Order of Gaussians by depth.

use super::project::Footprint;

/// Bits of a pass of the sort.
const BITS: u32 = 11;
const BUCKETS: usize = 1 << BITS;

/// Indices of the footprints, nearest first; equal depths in the order of their indices.
///
/// A radix sort from the lowest digit (Knuth, The Art of Computer Programming 3, 5.2.5): depths are
/// positive, so their bits are ordered as they are. The highest bit is the sign: 31 bits in three
/// passes.
pub(super) fn by_depth(footprints: &[Footprint]) -> Vec<u32> {
    let mut keys: Vec<(u32, u32)> = (0..)
        .zip(footprints)
        .map(|(i, f)| (f.z.to_bits(), i))
        .collect();
    let mut other = vec![(0, 0); keys.len()];
    let mut counts = [[0_u32; BUCKETS]; 3];
    let digit = |key: u32, pass: usize| (key >> (pass as u32 * BITS)) as usize & (BUCKETS - 1);
    for (key, _) in &keys {
        for (pass, counts) in counts.iter_mut().enumerate() {
            counts[digit(*key, pass)] += 1;
        }
    }
    for (pass, counts) in counts.iter_mut().enumerate() {
        // Depths of a scene often share their highest bits.
        if counts.iter().any(|count| *count as usize == keys.len()) {
            continue;
        }
        let mut sum = 0;
        for count in counts.iter_mut() {
            sum += std::mem::replace(count, sum);
        }
        for entry in &keys {
            let at = &mut counts[digit(entry.0, pass)];
            other[*at as usize] = *entry;
            *at += 1;
        }
        std::mem::swap(&mut keys, &mut other);
    }
    keys.into_iter().map(|(_, index)| index).collect()
}
