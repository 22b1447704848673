//! Configuration of changes of sector.

use estimator_config::config;

config! {
    /// When an agent changes its sector.
    pub struct CrossingConfig {
        /// How far beyond the border the owner changes, m: two cells of 4 cm. Less than the noise
        /// of a controller lets agents flicker between sectors; more moves the crossing away from
        /// where both sectors are known best.
        pub hysteresis_m: f64 = 0.08,
        /// Half of the width of the band around the border in which images of sectors from
        /// different recordings are cross-faded, m. Not more than the overlap.
        pub fade_m: f64 = 0.5,
    }
}
