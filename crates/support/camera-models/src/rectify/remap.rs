//! Bilinear remapping of 8-bit images.
//!
//! Contract: a position up to 0.02 px outside the source image counts as on its edge, since a map
//! has that accuracy; farther out, and without a source, the pixel gets the fill value. Weights are
//! whole 256ths, so that a pixel is within 2 grey levels of the reference implementation in `f64`
//! and within 1 where neighbours differ by less than 128.

use super::map::Map;

/// Tolerance outside the edge of the source image, pixels.
const EDGE_PX: f32 = 0.02;
const ONE: u32 = 256;
const NOWHERE: u32 = u32::MAX;

/// A map prepared for images of one size.
///
/// A map that moves an image by one column to the left:
///
/// ```
/// use camera_models::rectify::{Map, Remap};
///
/// let map = Map { width: 3, height: 2, x: [1.0, 2.0, 3.0].repeat(2), y: vec![0.0, 0.0, 0.0, 1.0, 1.0, 1.0] };
/// let remap = Remap::new(&map, 3, 2);
/// // The last column has no source and gets the fill value.
/// assert_eq!(remap.apply(&[10, 20, 30, 40, 50, 60], 7), [20, 30, 7, 50, 60, 7]);
/// ```
#[derive(Clone, Debug)]
pub struct Remap {
    old: [usize; 2],
    new: [u32; 2],
    places: Vec<Place>,
}

/// The top left of four source pixels and the weights of the right and the lower ones, in 256ths.
#[derive(Clone, Copy, Debug)]
struct Place {
    index: u32,
    right: u16,
    below: u16,
}

impl Remap {
    /// Prepares a map for source images of `width` x `height` pixels, at least 2 x 2.
    ///
    /// # Panics
    /// With smaller images, or more than 2^31 pixels.
    pub fn new(map: &Map, width: u32, height: u32) -> Self {
        assert!(width >= 2 && height >= 2, "an image of at least 2 x 2");
        assert!(u64::from(width) * u64::from(height) < 1 << 31, "an image");
        let places = map
            .x
            .iter()
            .zip(&map.y)
            .map(|(&x, &y)| {
                let split = |c: f32, size: u32| {
                    let last = (size - 1) as f32;
                    // NaN is in no range.
                    if !(-EDGE_PX..=last + EDGE_PX).contains(&c) {
                        return None;
                    }
                    // Not below 0, so that truncation rounds.
                    let fixed = (c.clamp(0.0, last) * ONE as f32 + 0.5) as u32;
                    let whole = (fixed / ONE).min(size - 2);
                    Some((whole, (fixed - whole * ONE) as u16))
                };
                match (split(x, width), split(y, height)) {
                    (Some((column, right)), Some((row, below))) => Place {
                        index: row * width + column,
                        right,
                        below,
                    },
                    _ => Place {
                        index: NOWHERE,
                        right: 0,
                        below: 0,
                    },
                }
            })
            .collect();
        Self {
            old: [width as usize, height as usize],
            new: [map.width, map.height],
            places,
        }
    }

    /// Width and height of the rectified image.
    pub fn size(&self) -> [u32; 2] {
        self.new
    }

    /// The rectified image, row-major.
    ///
    /// # Panics
    /// If `old` has another size than the source.
    pub fn apply(&self, old: &[u8], fill: u8) -> Vec<u8> {
        let mut new = vec![0; self.places.len()];
        self.apply_to(old, fill, &mut new);
        new
    }

    /// The same into a buffer.
    ///
    /// # Panics
    /// If a buffer has another size.
    pub fn apply_to(&self, old: &[u8], fill: u8, new: &mut [u8]) {
        let [width, height] = self.old;
        assert_eq!(old.len(), width * height, "the source image");
        assert_eq!(new.len(), self.places.len(), "the rectified image");
        for (new, place) in new.iter_mut().zip(&self.places) {
            let i = place.index as usize;
            // Also `None` for a pixel without a source.
            *new = match (old.get(i..i + 2), old.get(i + width..i + width + 2)) {
                (Some(&[a, b]), Some(&[c, d])) => {
                    let [right, below] = [u32::from(place.right), u32::from(place.below)];
                    let mix = |a: u8, b: u8| u32::from(a) * (ONE - right) + u32::from(b) * right;
                    let sum = mix(a, b) * (ONE - below) + mix(c, d) * below;
                    ((sum + ONE * ONE / 2) / (ONE * ONE)) as u8
                }
                _ => fill,
            };
        }
    }
}

/// Reference implementation of [`Remap::apply`] in `f64`.
pub fn remap_exact(map: &Map, old: &[u8], [width, height]: [u32; 2], fill: u8) -> Vec<u8> {
    let inside = |c: f32, size: u32| {
        let last = f64::from(size - 1);
        let c = f64::from(c);
        let edge = f64::from(EDGE_PX);
        (c >= -edge && c <= last + edge).then(|| c.clamp(0.0, last))
    };
    map.x
        .iter()
        .zip(&map.y)
        .map(|(&x, &y)| {
            let (Some(x), Some(y)) = (inside(x, width), inside(y, height)) else {
                return fill;
            };
            let grey = |column: f64, row: f64| {
                let at = row as usize * width as usize + column as usize;
                f64::from(old[at])
            };
            let (left, top) = (x.floor(), y.floor());
            let (right, bottom) = (x.ceil(), y.ceil());
            let (u, v) = (x - left, y - top);
            let upper = grey(left, top) * (1.0 - u) + grey(right, top) * u;
            let lower = grey(left, bottom) * (1.0 - u) + grey(right, bottom) * u;
            (upper * (1.0 - v) + lower * v).round() as u8
        })
        .collect()
}
