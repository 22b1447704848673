//! Constants of the stage `cloud`.
//!
//! Where a field names no source, its value was chosen on the simulated walks of the tests and of
//! the demo (images 672 px wide); how the cloud depends on it was not charted.

use estimator_config::config;

config! {
    /// Which depths become points.
    pub(super) struct CloudConfig {
        /// Number of instants before and after that of a keyframe whose depth maps vote on its
        /// surfaces: as far as people see ahead on a walk, and as much as fits in memory.
        pub neighbor_instants: usize = 4,
        /// Maximum sigma of a depth that becomes a point, m. Half a metre would fill streets with
        /// fog.
        pub max_point_sigma_m: f64 = 0.15,
        /// Maximum sigma of a depth that is classified as static or dynamic, m.
        pub max_motion_sigma_m: f64 = 0.5,
        /// Edge of a voxel, m: less than feet and wheels are sensitive to, and about the resolution
        /// of stereo at a few steps.
        pub voxel_m: f64 = 0.05,
        /// Votes of other views on a surface.
        pub votes: VoteConfig = VoteConfig::default(),
        /// Masks of dynamic objects and of the wearer.
        pub masks: MaskConfig = MaskConfig::default(),
    }

    /// Votes of other views on a surface.
    pub(super) struct VoteConfig {
        /// Maximum difference of two depths that support each other, in combined sigmas.
        pub support_sigma: f64 = 2.0,
        /// A view sees through a surface (free-space violation) if all its depths there are farther
        /// by more than this many combined sigmas.
        pub free_space_sigma: f64 = 3.0,
        /// Minimum number of views of other instants that support a static surface. With one, feet
        /// that rest for a moment and people who walk along the viewing direction would remain.
        pub min_support_views: u32 = 2,
        /// Number of supporting views required for each free-space violation: matchers err, and two
        /// in four rarely err alike.
        pub support_per_violation: u32 = 3,
        /// Minimum number of views of other instants that see through a dynamic surface.
        pub min_violation_views: u32 = 2,
    }

    /// Masks of dynamic objects and of the wearer; pixels are those of the depth maps.
    pub(super) struct MaskConfig {
        /// Maximum distance of the wearer's own body, from the chest to the tips of shoes that step
        /// forward, m.
        pub max_wearer_distance_m: f64 = 1.8,
        /// Ratio of views in which a cell shows the wearer above which it belongs to the wearer
        /// mask. Lower masks people who cross, higher leaves shoes in.
        pub min_wearer_ratio: f64 = 0.04,
        /// Minimum number of views for that decision.
        pub min_wearer_views: u32 = 20,
        /// Side of a cell, px.
        pub cell_px: usize = 8,
        /// Ratio of near dynamic pixels of a cell that shows the wearer in a view.
        pub min_cell_ratio: f64 = 0.3,
        /// Radius of the square around a pixel of which most must be dynamic, px: matchers make
        /// edges slightly too wide, and those are seen through as well.
        pub smoothing_radius_px: usize = 2,
        /// Dilation of dynamic areas, px.
        pub dilation_px: usize = 2,
        /// Dilation into pixels without depth, px.
        pub dilation_unknown_px: usize = 10,
        /// Width around the view in which the image takes the value of its border, px.
        pub border_extension_px: f64 = 16.0,
    }
}
