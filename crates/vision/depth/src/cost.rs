//! Matching cost of two pixels.
//!
//! The Hamming distance of their census codes plus the difference of their halved gray levels,
//! truncated at a limit ([`crate::Matching::max_gray_cost`]). Disparities outside the right image
//! or outside the band have cost [`INVALID`]. No path reduces it, so that they never win.

use crate::census::Codes;
use crate::lanes::{Kernel, Lanes};

/// Cost of a disparity outside the image or the band.
pub(crate) const INVALID: u8 = u8::MAX;

/// Computes the costs of a row. Column `x` starts at `x * stride`; the lanes `start..start + lanes`
/// are computed.
pub(crate) struct CostRow<'a> {
    pub(crate) left: &'a Codes,
    /// Mirrored, with at least `stride` bytes of padding beyond the left border of the image.
    pub(crate) right: &'a Codes,
    pub(crate) planes: usize,
    /// Limit of the gray-level cost.
    pub(crate) max_gray_cost: u8,
    pub(crate) y: usize,
    /// Index in the right rows of the first disparity of column 0; that of column `x` is `origin -
    /// x`.
    pub(crate) origin: usize,
    /// First disparity, px.
    pub(crate) first: i32,
    pub(crate) width: usize,
    pub(crate) stride: usize,
    pub(crate) start: usize,
    pub(crate) lanes: usize,
    /// Initial cost per lane: [`INVALID`] outside the band, else 0.
    pub(crate) out: &'a [u8],
    pub(crate) costs: &'a mut [u8],
}

impl Kernel for CostRow<'_> {
    type Output = ();

    #[inline(always)]
    fn run<V: Lanes>(self) {
        match (self.planes, self.max_gray_cost > 0) {
            (3, false) => self.planes::<V, 3, false>(),
            (3, true) => self.planes::<V, 3, true>(),
            (4, false) => self.planes::<V, 4, false>(),
            (4, true) => self.planes::<V, 4, true>(),
            (6, false) => self.planes::<V, 6, false>(),
            (6, true) => self.planes::<V, 6, true>(),
            (planes, _) => unreachable!("no census has codes of {planes} bytes"),
        }
    }
}

impl CostRow<'_> {
    #[inline(always)]
    fn planes<V: Lanes, const P: usize, const GRAY: bool>(self) {
        let (width, stride) = (self.width, self.stride);
        let none: &[u8] = &[];
        let (mut left, mut right) = ([none; P], [none; P]);
        for p in 0..P {
            left[p] = self.left.plane(self.y, p);
            right[p] = self.right.plane(self.y, p);
        }
        let (left_gray, right_gray) = (self.left.gray(self.y), self.right.gray(self.y));
        assert!(left_gray.len() >= width && self.origin + 1 >= width);
        assert!(right_gray.len() >= self.origin + stride);
        assert!(left.iter().all(|row| row.len() == left_gray.len()));
        assert!(right.iter().all(|row| row.len() == right_gray.len()));
        assert!(self.costs.len() >= width * stride && self.out.len() >= stride);
        assert!(self.start + self.lanes <= stride && self.lanes.is_multiple_of(V::COUNT));
        let most = V::splat(self.max_gray_cost);
        for x in 0..width {
            let mut code = [V::splat(0); P];
            for p in 0..P {
                code[p] = V::splat(left[p][x]);
            }
            let gray = V::splat(left_gray[x]);
            let mut lane = self.start;
            while lane < self.start + self.lanes {
                let at = self.origin - x + lane;
                // SAFETY: rows of the right image extend a stride beyond the origin, and `x` is at
                // most the origin; the lanes are within a stride, and the number of costs is
                // columns times the stride.
                unsafe {
                    let mut cost = V::load(self.out.as_ptr().add(lane));
                    for p in 0..P {
                        let other = V::load(right[p].as_ptr().add(at));
                        cost = cost.add(code[p].xor(other).count_ones());
                    }
                    if GRAY {
                        let other = V::load(right_gray.as_ptr().add(at));
                        let apart = gray.sub(other).or(other.sub(gray));
                        cost = cost.add(apart.min(most));
                    }
                    cost.store(self.costs.as_mut_ptr().add(x * stride + lane));
                }
                lane += V::COUNT;
            }
        }
        // Lane d of column x maps to column x - first - d of the right image.
        let (start, end) = (self.start, self.start + self.lanes);
        for x in 0..width {
            let zero = x as i64 - i64::from(self.first);
            let last = (zero + 1).clamp(start as i64, end as i64) as usize;
            let begin = (zero - width as i64 + 1).clamp(start as i64, end as i64) as usize;
            if last < end {
                self.costs[x * stride..][last..end].fill(INVALID);
            }
            if begin > start {
                self.costs[x * stride..][start..begin].fill(INVALID);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::census::{Census, Layout};
    use crate::reference::{self, Random};
    use imaging::ImageView;

    #[test]
    fn costs_equal_those_of_the_reference() {
        let mut random = Random(5);
        let (width, height) = (53, 4);
        let (a, b) = (random.image(width, height), random.image(width, height));
        let left = ImageView::packed(width, height, &a).unwrap();
        let right = ImageView::packed(width, height, &b).unwrap();
        for (level, first) in reference::with_levels([-3, 0, 7]) {
            for (census, max_gray_cost) in [
                (Census::Full5x5, 0),
                (Census::Full7x7, 8),
                (Census::Opposite9x7, 20),
            ] {
                let stride = 128;
                let before = 3;
                let layout = Layout {
                    before,
                    behind: 7 + stride,
                    mirrored: true,
                };
                let mut codes = [Codes::default(), Codes::default()];
                codes[0].compute(level, census, &left, Layout::default());
                codes[1].compute(level, census, &right, layout);
                let mut out = vec![0; stride];
                out[..5].fill(INVALID);
                out[90..].fill(INVALID);
                for y in 0..height {
                    let mut costs = vec![77; width * stride];
                    level.run(CostRow {
                        left: &codes[0],
                        right: &codes[1],
                        planes: census.planes(),
                        max_gray_cost,
                        y,
                        origin: (before as i32 + width as i32 - 1 + first) as usize,
                        first,
                        width,
                        stride,
                        start: 64,
                        lanes: 64,
                        out: &out,
                        costs: &mut costs,
                    });
                    for (i, found) in costs.into_iter().enumerate() {
                        let (x, lane) = (i % (width * stride) / stride, i % stride);
                        let expected = match (lane >= 64, out[lane]) {
                            (false, _) => 77,
                            (true, INVALID) => INVALID,
                            _ => {
                                let disparity = first + lane as i32;
                                reference::cost(
                                    &left,
                                    &right,
                                    census,
                                    max_gray_cost,
                                    x,
                                    y,
                                    disparity,
                                )
                            }
                        };
                        assert_eq!(found, expected, "{level:?} {census:?} {x} {lane}");
                    }
                }
            }
        }
    }
}
