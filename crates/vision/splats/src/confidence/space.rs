//! Space through which the views of a training looked, as voxels.
//!
//! Contract: voxels are cubes of the world, blocks of 4x4x4 of them one number of 64 bits. The
//! order of the blocks is that of their indices, whatever the order of the rays.

use std::collections::BTreeMap;

/// Voxels along an edge of a block.
const BLOCK: i32 = 4;

/// Largest index of a block along an axis.
const MAX_INDEX: f32 = 8_000_000.0;

/// A block of voxels: its index along the axes, and a bit `x + 4 y + 16 z` for each voxel.
pub type SpaceBlock = ([i32; 3], u64);

/// Voxels that rays passed.
///
/// ```
/// use splats::ObservedSpace;
///
/// let mut space = ObservedSpace::new(0.25, 20.0);
/// space.insert_ray([0.0; 3], [1.0, 0.0, 0.0], 5.0);
/// assert_eq!(space.unseen_share([0.1, 0.0, 0.0], [1.0, 0.0, 0.0], 4.0), 0.0);
/// assert!(space.unseen_share([0.1, 2.0, 0.0], [1.0, 0.0, 0.0], 4.0) == 1.0);
/// assert!((space.unseen_share([0.1, 0.0, 0.0], [1.0, 0.0, 0.0], 10.0) - 0.5).abs() < 0.05);
/// ```
#[derive(Clone, Debug, PartialEq)]
pub struct ObservedSpace {
    voxel_m: f32,
    range_m: f32,
    blocks: BTreeMap<[i32; 3], u64>,
}

impl ObservedSpace {
    /// Nothing was seen, in voxels with an edge of `voxel_m`. Rays end at a distance of `range_m`.
    pub fn new(voxel_m: f32, range_m: f32) -> Self {
        Self {
            voxel_m,
            range_m,
            blocks: BTreeMap::new(),
        }
    }

    /// From blocks.
    pub fn from_blocks(
        [voxel_m, range_m]: [f32; 2],
        blocks: impl IntoIterator<Item = SpaceBlock>,
    ) -> Self {
        Self {
            voxel_m,
            range_m,
            blocks: blocks.into_iter().collect(),
        }
    }

    /// Edge of a voxel, m.
    pub fn voxel_m(&self) -> f32 {
        self.voxel_m
    }

    /// Distance at which rays end, m.
    pub fn range_m(&self) -> f32 {
        self.range_m
    }

    /// Blocks with a seen voxel, by index.
    pub fn blocks(&self) -> impl Iterator<Item = SpaceBlock> + '_ {
        self.blocks.iter().map(|(index, bits)| (*index, *bits))
    }

    /// Number of seen voxels.
    pub fn voxels(&self) -> u64 {
        self.blocks
            .values()
            .map(|bits| u64::from(bits.count_ones()))
            .sum()
    }

    /// Adds the voxels of another space of the same voxels.
    pub fn insert_all(&mut self, other: &Self) {
        for (index, bits) in &other.blocks {
            *self.blocks.entry(*index).or_default() |= bits;
        }
    }

    /// Adds the voxels that a ray passes from `origin` on, m along a direction of unit length.
    pub fn insert_ray(&mut self, origin: [f32; 3], direction: [f32; 3], length_m: f32) {
        // Consecutive samples share a block mostly.
        let mut last: Option<SpaceBlock> = None;
        for along in self.samples(length_m) {
            let Some((index, bit)) = self.voxel(origin, direction, along) else {
                break;
            };
            match &mut last {
                Some((of, bits)) if *of == index => *bits |= bit,
                _ => {
                    if let Some((of, bits)) = last {
                        *self.blocks.entry(of).or_default() |= bits;
                    }
                    last = Some((index, bit));
                }
            }
        }
        if let Some((of, bits)) = last {
            *self.blocks.entry(of).or_default() |= bits;
        }
    }

    /// Share of a ray of this length that is in voxels which no ray passed; 0 for a ray shorter
    /// than half a voxel.
    pub fn unseen_share(&self, origin: [f32; 3], direction: [f32; 3], length_m: f32) -> f32 {
        let (mut unseen, mut all) = (0_u32, 0_u32);
        let mut last: Option<SpaceBlock> = None;
        for along in self.samples(length_m) {
            let Some((index, bit)) = self.voxel(origin, direction, along) else {
                break;
            };
            let bits = match last {
                Some((of, bits)) if of == index => bits,
                _ => {
                    let bits = self.blocks.get(&index).copied().unwrap_or(0);
                    last = Some((index, bits));
                    bits
                }
            };
            all += 1;
            unseen += u32::from(bits & bit == 0);
        }
        match all {
            0 => 0.0,
            _ => unseen as f32 / all as f32,
        }
    }

    /// Distances along a ray, half a voxel apart.
    fn samples(&self, length_m: f32) -> impl Iterator<Item = f32> + use<> {
        let step = 0.5 * self.voxel_m;
        let count = (length_m.min(self.range_m) / step) as u32;
        (0..count).map(move |k| (k as f32 + 0.5) * step)
    }

    /// Block and bit of a point of a ray.
    fn voxel(&self, origin: [f32; 3], direction: [f32; 3], along: f32) -> Option<SpaceBlock> {
        let mut index = [0; 3];
        let mut bit = 0;
        for k in 0..3 {
            let at = ((origin[k] + along * direction[k]) / self.voxel_m).floor();
            if at.is_nan() || at.abs() >= MAX_INDEX {
                return None;
            }
            let at = at as i32;
            index[k] = at.div_euclid(BLOCK);
            bit += at.rem_euclid(BLOCK) << (2 * k);
        }
        Some((index, 1 << bit))
    }
}
