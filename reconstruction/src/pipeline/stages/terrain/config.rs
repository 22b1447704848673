//! Constants of the stage `terrain`.

use estimator_config::config;
use terrain::{EdgeConfig, FusionConfig, MeshConfig, PlaneConfig, SimplifyConfig};

config! {
    /// Constants of the stage; those of the estimators are theirs.
    pub(super) struct TerrainConfig {
        /// One standard deviation of the position of a keyframe relative to those that see the same
        /// surface, m: refined poses of simulated walks differ by 2 to 3 mm from the ground truth
        /// over some metres.
        pub pose_sigma_m: f64 = 0.003,
        /// Fusion.
        pub fusion: FusionConfig = FusionConfig::default(),
        /// Mesh of the volume.
        pub mesh: MeshConfig = MeshConfig::default(),
        /// Planes.
        pub planes: PlaneConfig = PlaneConfig::default(),
        /// Step edges.
        pub edges: EdgeConfig = EdgeConfig::default(),
        /// Simplified mesh.
        pub simplify: SimplifyConfig = SimplifyConfig::default(),
    }
}
