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

/// What is known of the surface at a voxel.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct SurfaceVoxel {
    /// RGB of the nearest view.
    pub(crate) color: [u8; 3],
    /// Rank of the view that gave the color: the nearer, the higher; 0 without color.
    pub(crate) color_rank: u8,
    /// Mean outward normal in the world, octahedral (Cigolle et al. 2014).
    pub(crate) normal: [i16; 2],
    /// Views that saw the surface here, at most 255.
    pub(crate) views: u8,
    /// Views that saw through it, less those that saw it.
    pub(crate) contradictions: u8,
}

/// Voxels of a block, and what all of them share.
#[derive(Clone, Debug)]
pub(crate) struct Block {
    pub(crate) distance: [i16; COUNT],
    pub(crate) weight: [u16; COUNT],
    pub(crate) surface: Option<Box<[SurfaceVoxel; COUNT]>>,
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
        let layer = size_of::<[SurfaceVoxel; COUNT]>();
        size_of::<Self>() + self.surface.as_ref().map_or(0, |_| layer)
    }
}

/// Octahedral code of a unit vector.
pub(crate) fn encode_normal(n: [f32; 3]) -> [i16; 2] {
    let sum = n[0].abs() + n[1].abs() + n[2].abs();
    let (mut x, mut y) = (n[0] / sum, n[1] / sum);
    if n[2] < 0.0 {
        let sign = |v: f32| if v < 0.0 { -1.0 } else { 1.0 };
        (x, y) = ((1.0 - y.abs()) * sign(x), (1.0 - x.abs()) * sign(y));
    }
    [x, y].map(|v| (v * 32767.0) as i16)
}

/// Unit vector of an octahedral code.
pub(crate) fn decode_normal(code: [i16; 2]) -> [f32; 3] {
    let [x, y] = code.map(|v| f32::from(v) / 32767.0);
    let z = 1.0 - x.abs() - y.abs();
    let fold = (-z).max(0.0);
    let shift = |v: f32| if v < 0.0 { v + fold } else { v - fold };
    let v = [shift(x), shift(y), z];
    let norm = (v[0] * v[0] + v[1] * v[1] + v[2] * v[2]).sqrt();
    v.map(|c| c / norm)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn normals_survive_their_code() {
        for i in 0..200 {
            let v = [0, 1, 2].map(|k| counter_random::uniform(5, k, i) as f32 - 0.5);
            let norm = (v[0] * v[0] + v[1] * v[1] + v[2] * v[2]).sqrt();
            let n = v.map(|c| c / norm);
            let back = decode_normal(encode_normal(n));
            let error = (0..3).map(|k| (n[k] - back[k]).abs()).fold(0.0, f32::max);
            assert!(error < 2e-4, "{n:?} {back:?}");
        }
    }
}
