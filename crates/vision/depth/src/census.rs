//! Census transform and gray levels: the image data that the matching cost compares.
//!
//! A census code holds, for several pairs of pixels around a center, which one is brighter. It is
//! invariant to exposure and gain of either camera, which is why it is compared rather than gray
//! levels alone (Zabih and Woodfill, "Non-parametric local transforms for computing visual
//! correspondence", ECCV 1994). [`Census::Opposite9x7`] compares opposite pixels of a window and
//! needs half the number of bits for the same window (Spangenberg, Langner and Rojas, "Weighted
//! semi-global matching and center-symmetric census transform for robust driver assistance", CAIP
//! 2013). Outside the image the border pixels are repeated.
//!
//! Codes are stored as byte planes per row, so that a vector holds one byte of the codes of many
//! columns. The last plane is the gray level divided by 2: differences below two levels are noise.

use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use crate::lanes::{Kernel, Lanes, Level};
use imaging::ImageView;

/// Census window.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Census {
    /// The center with the 24 other pixels of a 5x5 window: 24 bits.
    Full5x5,
    /// The center with the 48 other pixels of a 7x7 window: 48 bits.
    Full7x7,
    /// Opposite pixels of a window of 9 columns x 7 rows: 31 bits. For noisy images.
    Opposite9x7,
}

/// Offsets of two compared pixels from the center: columns and rows.
pub(crate) type Pair = [(i32, i32); 2];

impl Census {
    /// Compared pairs; a bit is set if the first pixel of a pair is brighter. Eight pairs form a
    /// byte, the first one in its highest bit.
    pub(crate) fn pairs(self) -> Vec<Pair> {
        let window = |columns: i32, rows: i32| {
            let columns = move |y| (-columns..=columns).map(move |x| (x, y));
            (-rows..=rows).flat_map(columns)
        };
        let full = |reach: i32| -> Vec<Pair> {
            let others = window(reach, reach).filter(|p| *p != (0, 0));
            others.map(|p| [p, (0, 0)]).collect()
        };
        match self {
            Self::Full5x5 => full(2),
            Self::Full7x7 => full(3),
            Self::Opposite9x7 => {
                let half = window(4, 3).filter(|(x, y)| (*y, *x) < (0, 0));
                half.map(|(x, y)| [(x, y), (-x, -y)]).collect()
            }
        }
    }

    /// Maximum offset of a pixel from the center.
    pub(crate) fn reach(self) -> usize {
        match self {
            Self::Full5x5 => 2,
            Self::Full7x7 => 3,
            Self::Opposite9x7 => 4,
        }
    }

    /// Number of bits of a code.
    pub fn bits(self) -> u8 {
        match self {
            Self::Full5x5 => 24,
            Self::Full7x7 => 48,
            Self::Opposite9x7 => 31,
        }
    }

    /// Number of bytes of a code.
    pub(crate) fn planes(self) -> usize {
        usize::from(self.bits()).div_ceil(8)
    }
}

/// Memory layout of codes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct Layout {
    /// Padding before the columns of each row, bytes.
    pub(crate) before: usize,
    /// Padding after the columns of each row, bytes.
    pub(crate) behind: usize,
    /// Whether columns are stored in reverse order.
    pub(crate) mirrored: bool,
}

/// Codes of an image. Padding bytes are 0.
#[derive(Debug, Default)]
pub(crate) struct Codes {
    bytes: Vec<u8>,
    planes: usize,
    stride: usize,
}

impl Codes {
    /// One plane of a row, with padding.
    pub(crate) fn plane(&self, y: usize, plane: usize) -> &[u8] {
        let at = (y * (self.planes + 1) + plane) * self.stride;
        &self.bytes[at..at + self.stride]
    }

    /// Gray levels of a row, divided by 2.
    pub(crate) fn gray(&self, y: usize) -> &[u8] {
        self.plane(y, self.planes)
    }

    /// Computes the codes of an image, and replaces the previous ones.
    pub(crate) fn compute(
        &mut self,
        level: Level,
        census: Census,
        image: &ImageView<'_>,
        layout: Layout,
    ) {
        let (width, height) = (image.width(), image.height());
        let reach = census.reach();
        let pairs = census.pairs();
        let columns = width.next_multiple_of(level.lanes());
        let padded = PaddedImage::new(image, reach, columns - width);
        self.planes = census.planes();
        self.stride = layout.before + width + layout.behind;
        self.bytes.clear();
        self.bytes
            .resize(height * (self.planes + 1) * self.stride, 0);
        let of_row = (self.planes + 1) * self.stride;
        let rows = self.bytes.par_chunks_mut(of_row).enumerate();
        rows.for_each_init(
            || vec![0; columns],
            |row, (y, codes)| {
                let planes = codes.chunks_mut(self.stride);
                // The last plane has no pairs: it holds the gray level.
                let bits = pairs.chunks(8).chain([&[][..]]);
                for (pairs, plane) in bits.zip(planes) {
                    let plane = &mut plane[layout.before..layout.before + width];
                    if pairs.is_empty() {
                        let halved = image.row(y).iter().map(|v| v / 2);
                        plane.iter_mut().zip(halved).for_each(|(to, v)| *to = v);
                    } else {
                        level.run(Bits {
                            padded: &padded,
                            y,
                            pairs,
                            row,
                        });
                        plane.copy_from_slice(&row[..width]);
                    }
                    if layout.mirrored {
                        plane.reverse();
                    }
                }
            },
        );
    }
}

/// Image whose border is repeated `reach` times on each side, and `more` times on the right.
pub(crate) struct PaddedImage {
    pixels: Vec<u8>,
    stride: usize,
    reach: usize,
}

impl PaddedImage {
    pub(crate) fn new(image: &ImageView<'_>, reach: usize, more: usize) -> Self {
        let (width, height) = (image.width(), image.height());
        let stride = width + 2 * reach + more;
        let mut pixels = Vec::with_capacity(stride * (height + 2 * reach));
        for y in 0..height + 2 * reach {
            let row = image.row(y.saturating_sub(reach).min(height - 1));
            pixels.extend(std::iter::repeat_n(row[0], reach));
            pixels.extend_from_slice(row);
            pixels.extend(std::iter::repeat_n(row[width - 1], reach + more));
        }
        Self {
            pixels,
            stride,
            reach,
        }
    }

    /// Row `y + dy`, starting at column `dx`.
    #[inline(always)]
    pub(crate) fn row(&self, y: usize, (dx, dy): (i32, i32)) -> &[u8] {
        let y = (y + self.reach).wrapping_add_signed(dy as isize);
        let x = self.reach.wrapping_add_signed(dx as isize);
        &self.pixels[y * self.stride + x..(y + 1) * self.stride]
    }
}

/// Computes one byte of the codes of a row, whose length is a multiple of the vector length.
struct Bits<'a> {
    padded: &'a PaddedImage,
    y: usize,
    pairs: &'a [Pair],
    row: &'a mut [u8],
}

impl Kernel for Bits<'_> {
    type Output = ();

    #[inline(always)]
    fn run<V: Lanes>(self) {
        let none: (&[u8], &[u8]) = (&[], &[]);
        let mut rows = [none; 8];
        let count = self.pairs.len();
        for (rows, pair) in rows.iter_mut().zip(self.pairs) {
            *rows = (
                self.padded.row(self.y, pair[0]),
                self.padded.row(self.y, pair[1]),
            );
            assert!(rows.0.len() >= self.row.len() && rows.1.len() >= self.row.len());
        }
        assert!(self.row.len().is_multiple_of(V::COUNT));
        let one = V::splat(1);
        for at in (0..self.row.len()).step_by(V::COUNT) {
            let mut code = V::splat(0);
            for (a, b) in &rows[..count] {
                // SAFETY: all input rows are at least as long as the output row, whose length is a
                // multiple of the vector length.
                let brighter =
                    unsafe { V::load(a.as_ptr().add(at)).sub(V::load(b.as_ptr().add(at))) };
                code = code.add(code).add(brighter.min(one));
            }
            // A last byte with fewer pairs uses its low bits, in both images. SAFETY: as above.
            unsafe { code.store(self.row.as_mut_ptr().add(at)) };
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::reference::{self, Random};

    #[test]
    fn codes_equal_those_of_the_reference() {
        let mut random = Random(3);
        for (width, height) in [(1, 1), (5, 3), (70, 9), (131, 7)] {
            let pixels = random.image(width, height);
            let image = ImageView::packed(width, height, &pixels).unwrap();
            for census in [Census::Full5x5, Census::Full7x7, Census::Opposite9x7] {
                assert_eq!(census.pairs().len(), usize::from(census.bits()));
                for (level, mirrored) in reference::with_levels([false, true]) {
                    let mut codes = Codes::default();
                    let layout = Layout {
                        before: 3,
                        behind: 2,
                        mirrored,
                    };
                    codes.compute(level, census, &image, layout);
                    for y in 0..height {
                        for x in 0..width {
                            let at = if mirrored { width - 1 - x } else { x };
                            let expected = reference::code(&image, census, x, y);
                            // The last byte may hold fewer bits.
                            let found = (0..census.planes()).fold(0u64, |code, p| {
                                let bits = census.pairs()[8 * p..].len().min(8);
                                code << bits | u64::from(codes.plane(y, p)[3 + at])
                            });
                            assert_eq!(found, expected, "{census:?} {level:?} {x} {y}");
                            assert_eq!(codes.gray(y)[3 + at], pixels[y * width + x] / 2);
                        }
                    }
                }
            }
        }
    }
}
