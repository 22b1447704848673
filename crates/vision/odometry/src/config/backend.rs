//! Constants of the sliding window and its solver.

use estimator_config::config;

config! {
    /// Sliding window.
    pub struct BackendConfig {
        /// Number of keyframes in the window. Compare OpenVINS `max_clones`, Basalt
        /// `vio_max_kfs`. Charted over settings in docs/reference/odometry.md.
        pub window_size: usize = 8,
        /// Maximum number of solver iterations for a keyframe.
        pub max_iterations: usize = 4,
        /// Number of initial frame sets for which the whole window is optimized, keyframes or not.
        /// Later that makes poses worse: docs/decisions/0010-odometry.md.
        pub initial_frames: u64 = 12,
        /// Tilt sigma of the solver above which it always is, rad. Until a walk changes its
        /// heading, gravity does not separate tilt and accelerometer bias, and states with a wrong
        /// tilt would leave the window.
        pub settled_tilt_sigma_rad: f64 = 2e-3,
        /// Relative cost reduction per iteration at which the solver stops.
        pub convergence_ratio: f64 = 1e-3,
        /// Standard deviation of an observation, px. Compare Basalt `vio_obs_std_dev`. It weights
        /// images against the IMU.
        pub observation_sigma_px: f64 = 0.5,
        /// Threshold of the Huber loss, in standard deviations. Compare Basalt
        /// `vio_obs_huber_thresh`.
        pub huber_sigma: f64 = 1.5,
        /// Residual above which an observation is an outlier, in standard deviations. Compare
        /// Basalt `vio_outlier_threshold`. Lower discards features of a wrong calibration, higher
        /// keeps moving objects.
        pub outlier_sigma: f64 = 5.0,
        /// Estimation of the newest pose alone.
        pub newest_pose: NewestPoseConfig = NewestPoseConfig::default(),
        /// From the covariance of the solver to the reported one.
        pub covariance: CovarianceConfig = CovarianceConfig::default(),
        /// Priors of camera extrinsics.
        pub extrinsics: ExtrinsicsConfig = ExtrinsicsConfig::default(),
        /// Priors of stereo calibrations.
        pub stereo: StereoCalibrationConfig = StereoCalibrationConfig::default(),
    }

    /// Estimation of the newest pose with the landmarks fixed: Tukey's loss with a scale that
    /// decreases with the iterations.
    pub struct NewestPoseConfig {
        /// Scales of the loss in standard deviations, one per iteration, from a pose that the IMU
        /// predicts.
        pub tukey_sigma: [f64; 4] = [12.0, 8.0, 6.0, 5.0],
        /// The same from a pose of constant velocity, which can have a large error.
        pub tukey_sigma_without_imu: [f64; 10] =
            [240.0, 160.0, 100.0, 60.0, 36.0, 24.0, 16.0, 10.0, 7.0, 5.0],
        /// Final scale, in standard deviations. Lower discards accurate observations (for normal
        /// noise, Tukey's loss has an efficiency of 95 % at 4.7), higher lets outliers pull the
        /// pose.
        pub tukey_sigma_final: f64 = 4.0,
        /// Maximum number of iterations at the final scale.
        pub max_iterations: usize = 4,
    }

    /// How reported standard deviations relate to those of the solver, which takes observations of
    /// one feature as independent. Tuned on six simulated walks of a minute with one, two and three
    /// cameras (seeds 41 and 42); examined on others by `cargo xtask bench odometry`, see
    /// docs/decisions/0010-odometry.md. Lower is silently wrong; higher flags good poses.
    pub struct CovarianceConfig {
        /// Factor on the standard deviations of the solver. Compare OpenVINS
        /// `init_dyn_inflation_*`. With 2 one pose in fifteen is silently wrong.
        pub sigma_inflation: f64 = 3.0,
        /// Additional position sigma, m.
        pub position_sigma_floor_m: f64 = 0.003,
        /// Additional rotation sigma, rad. With 1e-3 the heading of single cameras with IMU is
        /// overconfident.
        pub rotation_sigma_floor_rad: f64 = 2e-3,
        /// Initial tilt sigma of a rig without an IMU, whose world is not levelled, rad.
        pub initial_tilt_sigma_rad: f64 = 0.35,
        /// Sigma of a heading rate that matches have in common over many frames, rad/s: 0.001 px
        /// per frame at 15 Hz. Without it heading is overconfident after a minute.
        pub heading_rate_sigma: f64 = 6e-5,
        /// Time over which that rate remains correlated, s.
        pub heading_rate_correlation_s: f64 = 60.0,
        /// Sigma of a scale of rotations: of the heading by the net turn. Found on five walks: 0.01
        /// to 0.2 %.
        pub turn_scale_sigma: f64 = 5e-4,
    }

    /// Priors of camera extrinsics, translation in m and rotation in rad. Source:
    /// docs/decisions/0010-odometry.md; `cargo xtask bench odometry --only mounts` charts the error
    /// over the error of a camera's nominal rotation.
    pub struct ExtrinsicsConfig {
        /// Sigmas where the calibration gives none. The translation is considered known: a walk
        /// determines it less accurately than a ruler (errors of 5 to 20 mm with a prior of 5 mm),
        /// and it matters less than the rotation.
        pub default_sigma: [f64; 2] = [1e-3, 3.5e-3],
        /// Sigmas added to those of the calibration: plates bend and warm up, the extrinsics of the
        /// IMU have errors too, and estimates from a walk with correct extrinsics deviate by up to
        /// a tenth of a degree.
        pub sigma_floor: [f64; 2] = [3e-4, 1.2e-3],
    }

    /// Prior of the stereo calibration of a camera: sigmas of the error of the right eye against
    /// the left one, where the calibration gives none. Source: `cargo xtask bench
    /// odometry_calibration`.
    pub struct StereoCalibrationConfig {
        /// Rotation about each axis, rad. Published calibrations of rectified sets deviate by 0.1
        /// degrees.
        pub rotation_sigma_rad: f64 = 2e-3,
        /// Baseline, relative. Only an IMU determines it, and in a minute less well than a factory.
        pub baseline_sigma: f64 = 0.02,
        /// Focal length, relative.
        pub focal_sigma: f64 = 3e-3,
        /// Principal point along the baseline, in focal lengths.
        pub principal_point_sigma: f64 = 2e-3,
        /// Decentering of the right lens minus that of the left one (`p2`), across epipolar lines
        /// only, also where the calibration states its covariance. Lower takes the lenses for a
        /// rotation about y. Source: rows of the rectified pairs of `KITTI_sequence_1` differ by
        /// 5e-3.
        pub decentering_sigma: f64 = 5e-3,
        /// Correlation between cameras of one rig, which were made and calibrated alike: 0 or more,
        /// and below 1. With 0 three right eyes that are rotated by the same angle are taken for
        /// unlikely.
        pub correlation: f64 = 0.5,
        /// Additional rotation sigma where the calibration states its covariance, rad: eyes rotate
        /// as they warm up.
        pub stated_rotation_floor_rad: f64 = 2e-4,
        /// The same for the baseline, and the sigma of focal length and principal point there.
        pub stated_lens_floor: f64 = 5e-4,
    }
}
