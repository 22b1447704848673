//! Constants of sectors.

use estimator_config::config;

config! {
    /// How a long walk is divided into sectors.
    pub struct SectorConfig {
        /// Most views at positions in one sector. Source: Beogym, which has 1250 images in each of
        /// its sectors.
        pub views: usize = 1250,
        /// Most views from outside of a sector that train it too, as a share of those inside at
        /// most.
        pub overlap: f64 = 0.5,
        /// Smallest share of the measured points of a view in a sector with which it trains it.
        pub min_seen: f64 = 0.02,
        /// Extent along x or y above which positions are divided, m: views of somebody who stands
        /// still see the same.
        pub min_extent_m: f64 = 2.0,
        /// Sectors up to here are rendered with a sector when its held-out images are compared, m:
        /// as far as the simulation shows Gaussians of its neighbors.
        pub view_reach_m: f64 = 40.0,
    }
}
