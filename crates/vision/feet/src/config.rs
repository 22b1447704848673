//! Configuration of the tracking of shoe tags.

use estimator_config::config;

config! {
    /// Configuration of [`TagTracker`](crate::tag_tracker::TagTracker).
    pub struct Config {
        /// Motion of feet between frames.
        pub prediction: PredictionConfig = PredictionConfig::default(),
        /// Search for tags that are not where they are predicted.
        pub search: SearchConfig = SearchConfig::default(),
        /// Fit of a tag.
        pub fit: fiducials::Config = fiducials::Config::default(),
        /// Maximum speed of a foot, m/s. Faster ones are mismatches.
        pub max_speed: f64 = 8.0,
        /// Maximum distance of a foot from the rig, m.
        pub max_distance_m: f64 = 2.2,
    }

    /// Motion of feet between frames.
    pub struct PredictionConfig {
        /// Time for which a foot is taken to go on with its last velocity, s.
        pub max_extrapolation_s: f64 = 0.1,
        /// Speed below which a foot is taken to stand, m/s.
        pub standing_speed: f64 = 0.25,
        /// Maximum time between sightings of which a velocity is formed, s.
        pub max_velocity_interval_s: f64 = 0.15,
    }

    /// Search for tags without a prediction of their pose.
    pub struct SearchConfig {
        /// Detection of tags of any identity.
        pub detection: fiducials::SearchConfig = fiducials::SearchConfig::default(),
        /// Time without a sighting of a foot after which whole images are searched, s: after a
        /// swing it is somewhere else.
        pub lost_s: f64 = 0.15,
        /// Distance around a predicted tag in which it is searched if it is not there, m.
        pub near_m: f64 = 0.3,
    }
}
