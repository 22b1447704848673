//! Constants of the stage `maps`.

use estimator_config::config;
use terrain::{ConvexConfig, MapConfig, ObstacleConfig};

config! {
    /// Constants of the stage; those of the estimators are theirs.
    pub(super) struct MapsConfig {
        /// One standard deviation of the height of a contact besides that of the foot in the rig,
        /// m: of the pose of the rig relative to the keyframes, and of soles that bend.
        pub contact_sigma_m: f64 = 0.004,
        /// Maps.
        pub maps: MapConfig = MapConfig::default(),
        /// Convex parts of planes, and height layers.
        pub convex: ConvexConfig = ConvexConfig::default(),
        /// Convex parts of obstacles.
        pub obstacles: ObstacleConfig = ObstacleConfig::default(),
    }
}
