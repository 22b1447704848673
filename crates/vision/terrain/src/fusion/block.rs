//! A block of 8 x 8 x 8 voxels.
//!
//! A voxel takes 4 bytes: its distance as a share of the volume's range, and its weight in units of
//! 1/4096. Voxels at a surface have color, normal and counts in a layer of their own, which only
//! blocks at surfaces have.

/// Voxels along an edge of a block.
pub(crate) const EDGE: usize = 8;
/// Voxels of a block; x runs fastest, z slowest.
pub(crate) const COUNT: usize = EDGE * EDGE * EDGE;
/// Steps of a weight of 1.
pub(crate) const WEIGHT_STEPS: f32 = 4096.0;
/// Steps of the range of distances.
pub(crate) const DISTANCE_STEPS: f32 = 32767.0;

/// Steps of the length of a normal.
pub(crate) const NORMAL_STEPS: f32 = 32767.0;

/// What is known of the surface at a voxel.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct SurfaceVoxel {
    /// RGB of the nearest view.
    pub(crate) color: [u8; 3],
    /// Rank of the view that gave the color: the nearer, the higher; 0 without color.
    pub(crate) color_rank: u8,
    /// Mean outward normal in the world, in steps; 0 where none was seen.
    pub(crate) normal: [i16; 3],
    /// Views that saw the surface here, at most 255.
    pub(crate) views: u8,
}

/// What is known of the surface at the voxels of a block; see [`SurfaceVoxel`].
#[derive(Clone, Debug)]
pub(crate) struct SurfaceLayer {
    pub(crate) normal: [[i16; COUNT]; 3],
    pub(crate) views: [u8; COUNT],
    /// Views that saw through a voxel, less those that saw a surface there.
    pub(crate) contradictions: [u8; COUNT],
    pub(crate) color: [[u8; 3]; COUNT],
    pub(crate) color_rank: [u8; COUNT],
}

impl SurfaceLayer {
    pub(crate) fn new() -> Box<Self> {
        Box::new(Self {
            normal: [[0; COUNT]; 3],
            views: [0; COUNT],
            contradictions: [0; COUNT],
            color: [[0; 3]; COUNT],
            color_rank: [0; COUNT],
        })
    }

    pub(crate) fn at(&self, voxel: usize) -> SurfaceVoxel {
        SurfaceVoxel {
            color: self.color[voxel],
            color_rank: self.color_rank[voxel],
            normal: [0, 1, 2].map(|k| self.normal[k][voxel]),
            views: self.views[voxel],
        }
    }

    /// Forgets a voxel.
    pub(crate) fn clear(&mut self, voxel: usize) {
        for of in &mut self.normal {
            of[voxel] = 0;
        }
        (self.views[voxel], self.contradictions[voxel]) = (0, 0);
        (self.color[voxel], self.color_rank[voxel]) = ([0; 3], 0);
    }
}

/// Voxels of a block, and what all of them share.
#[derive(Clone, Debug)]
pub(crate) struct Block {
    pub(crate) distance: [i16; COUNT],
    pub(crate) weight: [u16; COUNT],
    pub(crate) surface: Option<Box<SurfaceLayer>>,
    /// Least sigma along the normal of an observation at a surface, m.
    pub(crate) best_sigma_m: f32,
    /// Times that a voxel was seen through and lost weight.
    pub(crate) carved: u32,
}

impl Block {
    pub(crate) fn new() -> Box<Self> {
        Box::new(Self {
            distance: [0; COUNT],
            weight: [0; COUNT],
            surface: None,
            best_sigma_m: f32::INFINITY,
            carved: 0,
        })
    }

    pub(crate) fn bytes(&self) -> usize {
        let layer = size_of::<SurfaceLayer>();
        size_of::<Self>() + self.surface.as_ref().map_or(0, |_| layer)
    }
}
