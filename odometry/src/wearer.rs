//! Where a camera sees the person who wears it.
//!
//! Legs and shoes are seen sharply, in the same part of every picture, and never go where the world goes: corners on them are
//! refused again and again. Contract: a part of the picture is the wearer's if most corners that were kept there were refused;
//! where too few were tried nothing is said. People who walk through the view are refused too, but never for long in one part.

/// Side of a part, pixels.
const CELL: usize = 16;
/// Corners that must have been tried in a part, and the share of refused ones from which it is the wearer's.
const TRIED: u32 = 24;
const REFUSED: f64 = 0.55;

/// Counts of one camera.
#[derive(Clone, Debug)]
pub(crate) struct Wearer {
    width: usize,
    height: usize,
    columns: usize,
    /// Of each part: corners that agreed at a keyframe, and corners that were refused.
    counts: Vec<[u32; 2]>,
}

impl Wearer {
    pub(crate) fn new(width: usize, height: usize) -> Self {
        let (columns, rows) = (width.div_ceil(CELL), height.div_ceil(CELL));
        Self {
            width,
            height,
            columns,
            counts: vec![[0; 2]; columns * rows],
        }
    }

    fn count(&mut self, at: [f32; 2], kind: usize) {
        let [x, y] = at.map(|v| v.max(0.0) as usize);
        if x < self.width && y < self.height {
            self.counts[y / CELL * self.columns + x / CELL][kind] += 1;
        }
    }

    /// A corner went where the world went.
    pub(crate) fn agreed(&mut self, at: [f32; 2]) {
        self.count(at, 0);
    }

    /// A corner did not.
    pub(crate) fn refused(&mut self, at: [f32; 2]) {
        self.count(at, 1);
    }

    /// Rows first, a byte per pixel: 0 where the wearer is, else 255; none if that is nowhere.
    pub(crate) fn mask(&self) -> Option<Vec<u8>> {
        let is_wearer = |[agreed, refused]: &[u32; 2]| {
            let tried = agreed + refused;
            tried >= TRIED && f64::from(*refused) >= REFUSED * f64::from(tried)
        };
        let parts: Vec<bool> = self.counts.iter().map(is_wearer).collect();
        if !parts.contains(&true) {
            return None;
        }
        let mut mask = vec![255; self.width * self.height];
        for (y, row) in mask.chunks_exact_mut(self.width).enumerate() {
            for (x, pixel) in row.iter_mut().enumerate() {
                if parts[y / CELL * self.columns + x / CELL] {
                    *pixel = 0;
                }
            }
        }
        Some(mask)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_always_refused_is_the_wearer() {
        let mut wearer = Wearer::new(100, 70);
        assert_eq!(wearer.mask(), None);
        for k in 0..60 {
            // Shoes below on the left; somebody crosses; the world everywhere.
            wearer.refused([10.0, 60.0]);
            wearer.refused([k as f32 * 1.6, 20.0]);
            wearer.agreed([40.0, 40.0]);
            wearer.agreed([k as f32 * 1.6, 20.0]);
        }
        let mask = wearer.mask().expect("a mask");
        assert_eq!(mask.len(), 7000);
        assert_eq!(mask[60 * 100 + 10], 0);
        for (x, y) in [(40, 40), (50, 20), (90, 60), (10, 30)] {
            assert_eq!(mask[y * 100 + x], 255, "{x} {y}");
        }
        // Beyond the picture nothing is counted.
        wearer.refused([1e6, -5.0]);
        wearer.refused([f32::NAN, 2000.0]);
    }
}
