//! Configuration of the verification: all of its tuned constants.
//!
//! One struct per concern, in the order of the data flow. Where a field names no source, its value
//! was chosen on the simulated walks of `cargo xtask bench calib_verify`, with images 672 px wide;
//! how the result depends on it was not charted. What is known about the hardware is in
//! [`Tolerances`](super::Tolerances). Tukey's loss has its usual constant of 95 % efficiency.

use estimator_config::config;
use imaging::{KltConfig, PyramidConfig};

config! {
    /// Configuration of the verification.
    pub struct Config {
        /// Selection of bursts.
        pub bursts: BurstConfig = BurstConfig::default(),
        /// Feature tracks.
        pub tracking: TrackingConfig = TrackingConfig::default(),
        /// Rotation of the right eye against the left one.
        pub stereo: StereoConfig = StereoConfig::default(),
        /// Distances by the motion of the left eye.
        pub parallax: ParallaxConfig = ParallaxConfig::default(),
        /// Rotation of a camera in one track segment.
        pub motion: MotionConfig = MotionConfig::default(),
        /// Camera against its own gyroscope.
        pub camera_imu: CameraImuConfig = CameraImuConfig::default(),
        /// Gyroscopes against each other.
        pub gyro_pairs: GyroPairConfig = GyroPairConfig::default(),
        /// Decisions on the parameters.
        pub decision: DecisionConfig = DecisionConfig::default(),
    }

    /// Selection of bursts.
    pub struct BurstConfig {
        /// Step between candidate times, ns.
        pub step_ns: i64 = 100_000_000,
        /// Sample interval of the rates, ns. Longer misses fast changes, shorter costs time.
        pub rate_step_ns: i64 = 10_000_000,
        /// Rate above which motion blur is expected, rad/s. Higher selects blurred images, lower
        /// those with little rotation.
        pub max_rate_rad_s: f64 = 2.0,
    }

    /// Feature tracks of a burst.
    pub struct TrackingConfig {
        /// Maximum number of corners tracked at a time. Time is proportional to it.
        pub max_corners: usize = 260,
        /// Length of a track segment, s: about half a step of a walker, over which the body rotates
        /// most. Longer loses features, shorter measures less rotation.
        pub segment_s: f64 = 0.3,
        /// Interval between detections of new corners, s: segments overlap.
        pub detection_interval_s: f64 = 0.12,
        /// Minimum fraction of the stereo-matched corners still tracked; below it a segment ends,
        /// because in a camera that faces down the longest tracks are those on the wearer.
        pub min_tracked_ratio: f64 = 0.6,
        /// Minimum length of a segment, s.
        pub min_segment_s: f64 = 0.1,
        /// Minimum distance for stereo matching, m. Lower searches longer and finds more
        /// mismatches.
        pub min_distance_m: f64 = 0.35,
        /// Maximum rotation between the eyes for stereo matching, rad: 1.5 degrees. Lower does not
        /// match eyes that are rotated further, higher searches longer.
        pub max_stereo_rotation_rad: f64 = 0.026,
        /// Pyramid level of the stereo search.
        pub search_level: usize = 1,
        /// Coarsest pyramid level of temporal tracking. Lower loses fast rotations without a
        /// gyroscope.
        pub max_level: usize = 3,
        /// Maximum width of the finest level, px: larger images are halved, which costs little
        /// accuracy and saves much time.
        pub max_width_px: usize = 1000,
        /// Image pyramid.
        pub pyramid: PyramidConfig = PyramidConfig::default(),
        /// Corner detection.
        pub corners: CornerConfig = CornerConfig::default(),
        /// Patch alignment.
        pub klt: KltConfig = klt(),
        /// Search along the epipolar line.
        pub search: SearchConfig = SearchConfig::default(),
    }

    /// Corner detection (Shi and Tomasi).
    pub struct CornerConfig {
        /// Side of the grid cells with one corner each, px. Larger cells leave texture unused,
        /// smaller ones put corners side by side.
        pub cell_px: usize = 22,
        /// Margin to the image border, px: a patch and its motion.
        pub margin_px: usize = 10,
        /// Minimum eigenvalue per pixel of the window, squared gray levels per pixel. Lower tracks
        /// noise, higher leaves weak texture unused.
        pub min_response: f32 = 12.0,
        /// The same relative to the strong corners of the image.
        pub min_response_ratio: f32 = 0.01,
    }

    /// Search of the right image for a patch of 9 x 9 px.
    pub struct SearchConfig {
        /// Minimum NCC of a match, -1 to 1.
        pub min_ncc: f32 = 0.75,
        /// Radius of the best peak, px of the level; only candidates outside it compete with it.
        pub peak_radius_px: usize = 3,
        /// Minimum ratio of `1 - NCC` of any of these to that of the best one. Lower takes the
        /// wrong one of a repeated pattern.
        pub min_ncc_ratio: f32 = 1.3,
    }

    /// Rotation of the right eye against the left one.
    pub struct StereoConfig {
        /// Minimum number of matches.
        pub min_matches: usize = 150,
        /// Minimum fraction of all matches that are inliers.
        pub min_inlier_ratio: f64 = 0.3,
        /// Prior sigma of the rotation about each axis, rad.
        pub rotation_sigma_rad: f64 = 0.05,
        /// Prior sigma of the right eye's centre normal to the baseline, over the baseline. Larger
        /// makes near points useless.
        pub center_sigma_ratio: f64 = 5e-3,
        /// Prior sigma of the difference between the lenses: focal length (relative), `k1`, `p1`,
        /// `p2`. Rows alone determine yaw to twice that. Lower takes a lens for a yaw. Source: the
        /// rectified images of `KITTI_sequence_1`, whose rows differ by a `p2` of 5e-3.
        pub lens_sigma: f64 = 3e-3,
        /// Columns and rows of the image regions within which errors may be correlated.
        pub regions: [usize; 2] = [6, 4],
        /// Number of iterations of reweighting.
        pub rounds: usize = 12,
        /// Sigma floor, px, common to all matches: corners have small systematic errors that differ
        /// between the eyes. Lower is overconfident.
        pub sigma_floor_px: f64 = 0.03,
        /// Minimum spread of residuals, px.
        pub min_spread_px: f64 = 0.05,
    }

    /// Distances by the motion of the left eye.
    pub struct ParallaxConfig {
        /// Number of iterations for a start: each segment apart.
        pub start_rounds: usize = 2,
        /// Number of iterations of all together.
        pub rounds: usize = 3,
        /// Minimum median displacement of the features of a segment by translation, px.
        pub min_parallax_px: f64 = 2.0,
        /// Pixel errors that the uncertainty of the initial rotation of a segment may cause: with a
        /// gyroscope or an earlier estimate, and without. The latter is that of a car in a bend.
        pub initial_error_px: [f64; 2] = [6.0, 40.0],
    }

    /// Rotation of a camera in one track segment.
    pub struct MotionConfig {
        /// Minimum number of inliers.
        pub min_inliers: usize = 30,
        /// Minimum fraction of the features that are inliers. Lower accepts the motion of an
        /// object.
        pub min_inlier_ratio: f64 = 0.4,
        /// Residual of an inlier in units of the scale.
        pub inlier_sigma: f64 = 3.0,
        /// Number of RANSAC samples of two features.
        pub ransac_samples: u64 = 80,
        /// Maximum translation of a sample, baselines: 3 m of a walking person with a ZED Mini,
        /// 25 m of a car with half a metre.
        pub max_translation_baselines: f64 = 48.0,
        /// Standard deviation of a tracked feature, px.
        pub corner_sigma_px: f64 = 0.2,
        /// Standard deviation of a disparity, px.
        pub disparity_sigma_px: f64 = 0.2,
        /// Number of iterations of reweighting.
        pub rounds: usize = 10,
        /// Minimum scale of the residuals in these standard deviations.
        pub min_scale: f64 = 0.4,
        /// Prior sigma of the speed change during a segment, m/s: a walker's chest in a third of a
        /// second.
        pub speed_change_sigma_m_s: f64 = 0.6,
        /// Prior information of the translation per axis, 1/m², so that a camera at rest, or one
        /// that observes only far points, has a solution.
        pub translation_information: f64 = 1e-2,
    }

    /// Camera against its own gyroscope.
    pub struct CameraImuConfig {
        /// Minimum number of segments.
        pub min_segments: usize = 12,
        /// Sigma floor of a segment's rotation, rad: features slide with shadows and contours.
        /// Lower is overconfident.
        pub rotation_sigma_floor_rad: f64 = 1.5e-4,
        /// Number of iterations of reweighting.
        pub rounds: usize = 8,
        /// Minimum scale of the residuals in standard deviations.
        pub min_scale: f64 = 0.7,
        /// Pixel errors that the uncertainty of the initial rotation may cause, one per alignment:
        /// from a nominal calibration, then from an estimated one.
        pub initial_error_px: [f64; 4] = [6.0, 6.0, 2.0, 2.0],
        /// Prior sigma of the rotation between camera and IMU, rad.
        pub rotation_sigma_rad: f64 = 0.1,
        /// Prior sigma of the gyroscope bias, rad/s.
        pub bias_sigma_rad_s: f64 = 0.03,
        /// Prior sigma of the time offset, s.
        pub offset_sigma_s: f64 = 0.03,
        /// Prior sigma of the scale of each axis.
        pub scale_sigma: f64 = 0.01,
        /// Maximum fraction of the gyroscope's rate change during segments that is noise, for the
        /// time offset to be observable. Higher takes noise for motion.
        pub max_noise_ratio: f64 = 0.5,
        /// Prior sigma of the inverse-distance offset, before and between segments: yaw of an eye
        /// over the baseline, rad.
        pub yaw_sigma_rad: f64 = 2e-3,
        /// Readout time of a camera without a nominal line time.
        pub readout: ReadoutConfig = ReadoutConfig::default(),
        /// Maximum interval between two gyroscope samples, s; a longer one is a gap.
        pub max_gap_s: f64 = 0.03,
    }

    /// Readout time of a rolling shutter without a nominal line time.
    pub struct ReadoutConfig {
        /// Prior sigma of the readout time, s.
        pub sigma_s: f64 = 0.015,
        /// Its sigma once estimated, s.
        pub estimated_sigma_s: f64 = 5e-4,
        /// Significance above which the estimate is used, in standard deviations.
        pub min_significance_sigma: f64 = 3.0,
        /// Error of the image times, s, per second of unknown readout. Source: the simulated camera
        /// that faces down, where ignoring its 8.5 ms shifts image times by 1.5 to 2.3 ms.
        pub time_error_ratio: f64 = 0.25,
        /// Error of the rotation, rad, per second of unknown readout. Source: the same camera,
        /// which it rotates by 0.2 to 0.4 degrees.
        pub rotation_error_rad_per_s: f64 = 0.6,
    }

    /// Gyroscopes against each other.
    pub struct GyroPairConfig {
        /// Length of a window, ns. Longer averages over the motion, shorter has more noise.
        pub window_ns: i64 = 20_000_000,
        /// Windows per block, whose errors may be correlated.
        pub windows_per_block: i64 = 100,
        /// Maximum number of blocks.
        pub max_blocks: i64 = 120,
        /// Minimum number of windows.
        pub min_windows: usize = 300,
        /// Margin at both ends for the time offset, ns.
        pub margin_ns: i64 = 100_000_000,
        /// Number of iterations of reweighting.
        pub rounds: usize = 6,
        /// Minimum fraction of the rotation measured by one gyroscope that the other one measured
        /// as well, for a direction to be observable. Lower takes noise for motion.
        pub min_common_ratio: f64 = 0.5,
        /// Prior sigma of the rotation, rad.
        pub rotation_sigma_rad: f64 = 0.1,
        /// Prior sigma of the time offset, s.
        pub offset_sigma_s: f64 = 0.05,
        /// Prior sigma of the scales of both sensors together.
        pub scale_sigma: f64 = 7e-3,
        /// Prior sigma of their shear.
        pub shear_sigma: f64 = 1.5e-3,
        /// Prior sigma of the bias, rad/s.
        pub bias_sigma_rad_s: f64 = 0.03,
        /// Prior sigma of its change over the recording, rad/s.
        pub drift_sigma_rad_s: f64 = 0.01,
        /// Initial spread of the residuals, rad/s.
        pub initial_spread_rad_s: f64 = 0.1,
    }

    /// Decisions on the parameters.
    pub struct DecisionConfig {
        /// Detection threshold in measurement sigmas beyond the tolerance: with three axes,
        /// exceeded by chance in 1 of 250 cases for a parameter at the edge of its tolerance, and
        /// practically never well within it. Lower reports correct parameters, higher misses wrong
        /// ones.
        pub detection_sigma: f64 = 3.3,
        /// Tolerance limit, in sigmas of the tolerance.
        pub tolerance_sigma: f64 = 2.0,
        /// Power margin, in sigmas: an estimate falls short of the true value by more in 1 of 40
        /// cases.
        pub power_sigma: f64 = 2.0,
        /// Chi-squared difference below which two blocks explain the data equally well. Lower
        /// blames one of two cameras by chance.
        pub ambiguity_chi2: f64 = 6.0,
        /// Rotation that a recording must be able to detect to confirm a parameter, rad: half a
        /// degree.
        pub required_rotation_rad: f64 = 0.5 * std::f64::consts::PI / 180.0,
        /// The same for a time offset, s.
        pub required_time_s: f64 = 3e-3,
        /// Covariance factor for pairwise comparisons, which are not independent: with three
        /// gyroscopes each counts for two thirds, with `n` for `2 / n`.
        pub pair_covariance_factor: f64 = 0.5,
    }
}

/// Tracking with the thresholds that the tolerances were set with (`cargo xtask bench
/// calib_verify`); patches are of 11 x 11 px.
fn klt() -> KltConfig {
    let mut config = KltConfig::default();
    config.max_iterations = 12;
    config.max_forward_backward_px = 0.4;
    config.min_contrast = 1.0;
    config
}
