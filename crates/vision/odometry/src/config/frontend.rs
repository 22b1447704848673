//! Constants of the visual front end.

use estimator_config::config;
use imaging::{KltConfig, PyramidConfig};

config! {
    /// Features of one camera: number, spacing, matching.
    pub struct FrontendConfig {
        /// Maximum number of features tracked per camera. Compare OpenVINS `num_pts`. The chart
        /// over settings in docs/reference/odometry.md is flat from 60 on; eight times this
        /// number takes about twice the time.
        pub max_features: usize = 110,
        /// Number of grid cells per requested feature, since some cells have no texture. At 1 there
        /// are too few features on weak texture; high values put features side by side.
        pub cells_per_feature: f64 = 1.3,
        /// Minimum side of a grid cell, px. Limits the number of features of small images.
        pub min_cell_px: usize = 8,
        /// Distance below which two tracks have converged to one corner, px: the newer one is
        /// dropped. Too small counts one corner twice.
        pub min_track_distance_px: f64 = 4.0,
        /// Minimum distance between a tracked feature and one that another camera hands over, px.
        pub min_handover_distance_px: f64 = 6.0,
        /// Coarsest pyramid level of tracking over time. Lower loses fast rotations without an IMU.
        pub temporal_max_level: usize = 3,
        /// Image pyramid.
        pub pyramid: PyramidConfig = PyramidConfig::default(),
        /// Patch alignment.
        pub klt: KltConfig = KltConfig::default(),
        /// Corner detection.
        pub detector: DetectorConfig = DetectorConfig::default(),
        /// Matching between the eyes of a camera.
        pub stereo: StereoConfig = StereoConfig::default(),
        /// Matching between cameras.
        pub cross_camera: CrossCameraConfig = CrossCameraConfig::default(),
        /// Keypoints for loop closure.
        pub keypoints: KeypointConfig = KeypointConfig::default(),
        /// Frozen and torn images.
        pub stale_image: StaleImageConfig = StaleImageConfig::default(),
    }

    /// Corner detection (Shi and Tomasi).
    pub struct DetectorConfig {
        /// Minimum eigenvalue, squared gray levels per pixel of the window: a blank wall with noise
        /// is below it. Lower tracks noise in the dark, higher leaves weak texture unused.
        pub min_eigenvalue: f64 = 20.0,
    }

    /// Matching between the two eyes of a camera.
    pub struct StereoConfig {
        /// Coarsest pyramid level from a predicted range.
        pub max_level: usize = 1,
        /// Pyramid level of the search along the epipolar line without a predicted range.
        pub search_level: usize = 1,
        /// Minimum distance of a match, m. Lower searches longer, and finds more mismatches.
        pub min_distance_m: f64 = 0.3,
        /// Minimum inverse range of a match, 1/m: noise and calibration make that of a distant
        /// point slightly negative.
        pub min_inverse_range_per_m: f64 = -0.05,
        /// Maximum epipolar error with an exact calibration, px. Higher lets mismatches on repeated
        /// texture through.
        pub max_epipolar_error_px: f64 = 1.5,
        /// The same, additional, in standard deviations of the epipolar error due to the estimated
        /// stereo calibration. Lower keeps only the matches that fit a wrong calibration.
        pub epipolar_sigmas: f64 = 3.0,
        /// Minimum NCC of the best candidate of the search.
        pub min_ncc: f64 = 0.75,
        /// Minimum margin of its NCC over all candidates that are not adjacent. Lower takes the
        /// wrong one of a repeated pattern.
        pub min_ncc_margin: f64 = 0.05,
    }

    /// Matching of a feature of one camera in the images of another one.
    pub struct CrossCameraConfig {
        /// Step of the numerical derivatives of the warp between the views, px.
        pub derivative_step_px: f64 = 4.0,
        /// Maximum area scale of the warp, either way: pixels of one image per pixel of the other.
        /// Beyond it the interpolated patch has no detail.
        pub max_scale_ratio: f64 = 3.0,
        /// Maximum distance of a match from its prediction, px. It has to exceed the error of the
        /// extrinsics between cameras: 5 px are 0.8 degrees at a focal length of 350 px.
        pub max_position_error_px: f64 = 5.0,
        /// Maximum deviation of the inverse range of a match from the known one, as a fraction.
        pub max_inverse_range_error_ratio: f64 = 0.1,
        /// The same, additional and absolute, 1/m.
        pub max_inverse_range_error_per_m: f64 = 0.01,
        /// Factor on the sigma of observations of landmarks of another camera: warped patches are
        /// matched less accurately, and their errors are correlated. With 1 the distance between
        /// the cameras determines a wrong scale of the path; source:
        /// docs/decisions/0010-odometry.md.
        pub sigma_ratio: f64 = 3.0,
    }

    /// Keypoints for loop closure.
    pub struct KeypointConfig {
        /// Maximum number per keyframe and camera. Memory is proportional to it, and the time of
        /// the search to its square.
        pub max_keypoints: usize = 160,
        /// Side of the grid cells with one keypoint each, px.
        pub cell_px: usize = 20,
    }

    /// Detection of images that a camera repeats, or tears. Source: `cargo xtask bench
    /// odometry_faults`, faults `frozen` and `torn`.
    pub struct StaleImageConfig {
        /// Maximum mean difference of equal rows, gray levels: encoders change pixels slightly.
        pub max_mean_difference: f64 = 0.05,
        /// Number of rows of pyramid level 1 at a tear that the filter mixed or a patch covers.
        pub margin_rows: usize = 8,
        /// Minimum number of equal rows of pyramid level 1: fewer may be black or accidental.
        pub min_same_rows: usize = 8,
        /// Minimum expected image motion, px. Lower discards images of a slow motion in the dark;
        /// higher accepts frozen ones for longer.
        pub min_motion_px: f64 = 1.5,
        /// Distance at which translation is converted to image motion, m: for a walking person few
        /// images show only more distant points.
        pub assumed_distance_m: f64 = 5.0,
    }
}
