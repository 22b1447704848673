//! The sky: a color per direction in the world.
//!
//! A square octahedral map (Engelhardt and Dachsbacher, Octahedron Environment Maps, VMV 2008): the
//! sphere is projected onto the octahedron |x| + |y| + |z| = 1, whose lower half is folded outward
//! around the upper one. Nearly equal areas, no poles, one lookup with bilinear interpolation.

use crate::error::SplatError;

/// A map of colors over all directions.
///
/// ```
/// use splats::Sky;
///
/// let mut sky = Sky::uniform(16, [0.5, 0.7, 1.0])?;
/// assert_eq!(sky.color([0.0, 0.0, 1.0]), [0.5, 0.7, 1.0]);
/// # Ok::<(), splats::SplatError>(())
/// ```
#[derive(Clone, Debug, PartialEq)]
pub struct Sky {
    size: usize,
    texels: Vec<[f32; 3]>,
}

impl Sky {
    /// A map of `size` x `size` texels of one color.
    ///
    /// # Errors
    /// [`SplatError::Sky`] if the size is not in 2 to 4096 or a color is not finite.
    pub fn uniform(size: usize, color: [f32; 3]) -> Result<Self, SplatError> {
        if !(2..=4096).contains(&size) {
            return Err(SplatError::Sky { size, texels: 0 });
        }
        Self::from_texels(size, vec![color; size * size])
    }

    /// From `size` x `size` texels, row by row.
    ///
    /// # Errors
    /// [`SplatError::Sky`] if the number of texels is wrong or one is not finite.
    pub fn from_texels(size: usize, texels: Vec<[f32; 3]>) -> Result<Self, SplatError> {
        let finite = texels.as_flattened().iter().all(|value| value.is_finite());
        if !(2..=4096).contains(&size) || texels.len() != size * size || !finite {
            let texels = texels.len();
            return Err(SplatError::Sky { size, texels });
        }
        Ok(Self { size, texels })
    }

    /// Texels along an edge.
    pub fn size(&self) -> usize {
        self.size
    }

    /// The texels, row by row.
    pub fn texels(&self) -> &[[f32; 3]] {
        &self.texels
    }

    /// The color in a direction in the world; the length does not matter.
    pub fn color(&self, direction_in_world: [f32; 3]) -> [f32; 3] {
        let taps = self.taps(direction_in_world);
        let mut color = [0.0; 3];
        for (index, weight) in taps {
            for (sum, value) in color.iter_mut().zip(self.texels[index]) {
                *sum += weight * value;
            }
        }
        color
    }

    /// The four texels of a direction and their weights, which sum to 1.
    pub(crate) fn taps(&self, direction: [f32; 3]) -> [(usize, f32); 4] {
        taps(self.size, direction)
    }

    /// The texels, for optimizers of this crate.
    pub(crate) fn texels_mut(&mut self) -> &mut [[f32; 3]] {
        &mut self.texels
    }
}

/// The four texels of a direction in a map of `size` x `size` and their weights, which sum to 1.
pub(crate) fn taps(size: usize, [x, y, z]: [f32; 3]) -> [(usize, f32); 4] {
    let norm = (x.abs() + y.abs() + z.abs()).max(f32::MIN_POSITIVE);
    let (mut u, mut v) = (x / norm, y / norm);
    if z < 0.0 {
        let sign = |of: f32| if of < 0.0 { -1.0 } else { 1.0 };
        (u, v) = ((1.0 - v.abs()) * sign(u), (1.0 - u.abs()) * sign(v));
    }
    let last = size - 1;
    let along = |of: f32| {
        let at = ((of * 0.5 + 0.5) * last as f32).clamp(0.0, last as f32);
        let low = (at as usize).min(last - 1);
        (low, at - low as f32)
    };
    let ((column, a), (row, b)) = (along(u), along(v));
    let at = row * size + column;
    [
        (at, (1.0 - a) * (1.0 - b)),
        (at + 1, a * (1.0 - b)),
        (at + size, (1.0 - a) * b),
        (at + size + 1, a * b),
    ]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn neighboring_directions_have_neighboring_colors_everywhere() {
        // A color that is continuous over the sphere, stored by direction of the texel.
        let size = 65;
        let of = |d: [f32; 3]| {
            let n = d.iter().map(|v| v * v).sum::<f32>().sqrt();
            d.map(|v| v / n)
        };
        let direction = |i: usize| {
            let at = |k: usize| k as f32 / 64.0 * 2.0 - 1.0;
            let (u, v) = (at(i % size), at(i / size));
            let z = 1.0 - u.abs() - v.abs();
            let (x, y) = match z < 0.0 {
                true => ((1.0 - v.abs()) * u.signum(), (1.0 - u.abs()) * v.signum()),
                false => (u, v),
            };
            of([x, y, z])
        };
        let sky = Sky::from_texels(size, (0..size * size).map(direction).collect()).unwrap();
        for i in 0..2000_u64 {
            let d = of(std::array::from_fn(|k| {
                counter_random::bell(3, k as u64, i) as f32
            }));
            let found = sky.color(d);
            for k in 0..3 {
                assert!((found[k] - d[k]).abs() < 0.01, "{d:?} {found:?}");
            }
        }
    }

    #[test]
    fn invalid_maps_are_refused() {
        assert!(Sky::uniform(1, [0.0; 3]).is_err());
        assert!(Sky::uniform(4, [f32::NAN; 3]).is_err());
        assert!(Sky::from_texels(4, vec![[0.0; 3]; 15]).is_err());
    }
}
