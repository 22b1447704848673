//! Order of Gaussians in memory.

use gaussians::Splats;

/// Indices along a Morton curve over the box of all positions, so that neighbors in space are
/// neighbors in memory.
pub(crate) fn morton_order(splats: &Splats) -> Vec<u32> {
    let spread = |v: u32| {
        // Bits of a number of 10 bits, two zeros between each.
        let v = (v | v << 16) & 0x0300_00ff;
        let v = (v | v << 8) & 0x0300_f00f;
        let v = (v | v << 4) & 0x030c_30c3;
        (v | v << 2) & 0x0924_9249
    };
    let mut codes = vec![0; splats.len()];
    for (k, plane) in splats.planes()[..3].iter().enumerate() {
        let low = plane.iter().copied().fold(f32::INFINITY, f32::min);
        let high = plane.iter().copied().fold(f32::NEG_INFINITY, f32::max);
        let scale = 1023.0 / (high - low).max(f32::MIN_POSITIVE);
        for (code, value) in codes.iter_mut().zip(plane) {
            *code |= spread(((value - low) * scale) as u32) << k;
        }
    }
    let mut order: Vec<u32> = (0..splats.len() as u32).collect();
    order.sort_by_key(|i| codes[*i as usize]);
    order
}
