//! Directions in which the views of a training saw sky.

use crate::error::SplatError;
use crate::scene::taps;

/// Weight of a texel above which it stands for a direction.
const MIN_WEIGHT: f32 = 0.1;

/// A map of directions, laid out as a [`Sky`](crate::Sky).
///
/// ```
/// use splats::ObservedSky;
///
/// let mut sky = ObservedSky::none(32);
/// sky.insert([0.1, 0.2, 1.0]);
/// assert!(sky.contains([0.1, 0.2, 1.0]));
/// assert!(!sky.contains([1.0, 0.2, 0.1]));
/// ```
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ObservedSky {
    size: usize,
    texels: Vec<bool>,
}

impl ObservedSky {
    /// No direction, in a map of `size` x `size` texels.
    pub fn none(size: usize) -> Self {
        Self {
            size,
            texels: vec![false; size * size],
        }
    }

    /// From `size` x `size` texels, row by row.
    ///
    /// # Errors
    /// [`SplatError::Sky`] if the size is not in 2 to 4096 or the number of texels is wrong.
    pub fn from_texels(size: usize, texels: Vec<bool>) -> Result<Self, SplatError> {
        if !(2..=4096).contains(&size) || texels.len() != size * size {
            let texels = texels.len();
            return Err(SplatError::Sky { size, texels });
        }
        Ok(Self { size, texels })
    }

    /// Texels along an edge.
    pub fn size(&self) -> usize {
        self.size
    }

    /// Whether sky was seen in the direction of each texel, row by row.
    pub fn texels(&self) -> &[bool] {
        &self.texels
    }

    /// Adds a direction in the world; the length does not matter.
    pub fn insert(&mut self, direction: [f32; 3]) {
        for (index, weight) in taps(self.size, direction) {
            self.texels[index] |= weight > MIN_WEIGHT;
        }
    }

    /// Whether a direction in the world was seen: all texels that color it.
    pub fn contains(&self, direction: [f32; 3]) -> bool {
        let taps = taps(self.size, direction);
        let mut texels = taps.into_iter().filter(|(_, weight)| *weight > MIN_WEIGHT);
        texels.all(|(index, _)| self.texels[index])
    }
}
