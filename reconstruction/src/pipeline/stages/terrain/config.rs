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
        /// Length and width added to the outline of a sole for what is excluded as a shoe, m: shoes
        /// are wider than their soles, and the pose has errors.
        pub shoe_margin_m: f64 = 0.025,
        /// Least height above the sole that is excluded, m: ground beside the sole is lower.
        pub shoe_low_m: f64 = 0.012,
        /// Greatest height that is excluded, m: the shank.
        pub shoe_high_m: f64 = 0.6,
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
