//! What can be measured of one image alone.

use crate::RawImage;

/// At and beyond these an 8-bit sample says only that it is dark, or bright.
const CLIPPED: [u8; 2] = [2, 253];

/// Numbers that say whether an image shows something.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Look {
    /// Mean difference between a pixel and its neighbours to the right and below, grey levels
    /// of 255. Focus, motion, fog, a cover, darkness and overexposure all lower it; noise raises
    /// it.
    pub sharpness: f64,
    /// Mean, grey levels of 255.
    pub brightness: f64,
    /// Share of pixels of at most 2 or at least 253 grey levels.
    pub clipped: f64,
}

impl Look {
    /// Measures luma. A malformed image gives zeros.
    pub fn of(image: &RawImage) -> Self {
        let (Ok(luma), width) = (image.luma(), image.width as usize) else {
            return Self::default();
        };
        let (mut sum, mut clipped, mut steps, mut pairs) = (0_u64, 0_u64, 0_u64, 0_u64);
        let rows: Vec<&[u8]> = luma.chunks_exact(width.max(1)).collect();
        for (y, row) in rows.iter().enumerate() {
            sum += row.iter().map(|v| u64::from(*v)).sum::<u64>();
            let is_clipped = |v: &&u8| **v <= CLIPPED[0] || **v >= CLIPPED[1];
            clipped += row.iter().filter(is_clipped).count() as u64;
            let beside = row.iter().zip(row.get(1..).unwrap_or_default());
            let below = rows.get(y + 1).copied().unwrap_or_default();
            let differences = beside.chain(row.iter().zip(below));
            for (a, b) in differences {
                steps += u64::from(a.abs_diff(*b));
                pairs += 1;
            }
        }
        let share = |part: u64, whole: u64| part as f64 / whole.max(1) as f64;
        let pixels = luma.len() as u64;
        Self {
            sharpness: share(steps, pairs),
            brightness: share(sum, pixels),
            clipped: share(clipped, pixels),
        }
    }
}
