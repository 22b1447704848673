//! Constants of the decisions of the estimator.

use estimator_config::config;

config! {
    /// Status of poses, and rejection of images or of the IMU.
    pub struct EstimatorConfig {
        /// Minimum number of inliers of a tracked pose, which are also the landmarks of a new
        /// window. Lower accepts accidental agreement, higher is lost on weak texture.
        pub min_inliers: usize = 9,
        /// Minimum fraction of all observations that are inliers.
        pub min_inlier_ratio: f64 = 0.3,
        /// Mean number of inliers per camera below which the sigma of images grows, by the square
        /// of the ratio of this number to theirs: few may all be on one object that moves. Lower
        /// trusts the wearer's legs in front of a plain floor, higher makes sigmas on weak texture
        /// too large.
        pub independent_inliers: usize = 22,
        /// Squared Mahalanobis distance between the positions of two cameras above which they
        /// contradict each other, without an IMU: 3 sigmas in three dimensions. On clean simulated
        /// walks (seeds 41 and 42) the maximum is 5.4; the wearer's shoes reach 2000.
        pub max_camera_disagreement: f64 = 14.16,
        /// Inlier ratio below which the IMU is suspected: an unknown bias, a shock, or saturation.
        pub imu_suspect_inlier_ratio: f64 = 0.35,
        /// Minimum inlier ratio without the IMU for it to be rejected.
        pub vision_only_inlier_ratio: f64 = 0.6,
        /// Position sigma along the worst direction above which a pose is lost, m.
        pub lost_sigma_m: f64 = 0.5,
        /// The same, additional, per metre of distance from the start.
        pub lost_sigma_per_metre: f64 = 0.02,
        /// Initialization.
        pub initialization: InitializationConfig = InitializationConfig::default(),
        /// Selection of keyframes.
        pub keyframes: KeyframeConfig = KeyframeConfig::default(),
        /// A new window after a tracking loss.
        pub reinitialization: ReinitializationConfig = ReinitializationConfig::default(),
        /// A camera that moves on its plate.
        pub camera_shift: CameraShiftConfig = CameraShiftConfig::default(),
    }

    /// Static initialization from the IMU samples before the first images. Pairs are of gyroscope,
    /// rad/s, and accelerometer, m/s².
    pub struct InitializationConfig {
        /// Time before the first images whose samples are used, ns.
        pub window_ns: i64 = 600_000_000,
        /// Minimum duration of rest, s. Shorter takes a turning point of the motion for rest.
        pub min_static_s: f64 = 0.2,
        /// Maximum standard deviations of a body at rest.
        pub static_std: [f64; 2] = [0.03, 0.25],
        /// Maximum gyroscope bias, rad/s: a faster constant rotation is no rest.
        pub max_gyro_bias: f64 = 0.06,
        /// Tilt sigma from gravity at rest, rad.
        pub static_tilt_sigma_rad: f64 = 0.02,
        /// Velocity sigma at rest, m/s.
        pub static_velocity_sigma: f64 = 0.02,
        /// Gyroscope bias sigma at rest, rad/s.
        pub static_gyro_bias_sigma: f64 = 0.004,
        /// Tilt sigma from the mean specific force in motion, rad.
        pub moving_tilt_sigma_rad: f64 = 0.15,
        /// Velocity sigma in motion, m/s: a walking person.
        pub moving_velocity_sigma: f64 = 1.5,
        /// Velocity sigma without an IMU, m/s.
        pub velocity_sigma_without_imu: f64 = 20.0,
        /// Tilt sigma without any measurement, rad.
        pub unknown_tilt_sigma_rad: f64 = 1.0,
        /// Bias sigmas before any measurement.
        pub bias_sigma: [f64; 2] = [0.05, 0.15],
    }

    /// Selection of keyframes.
    pub struct KeyframeConfig {
        /// Median parallax of features since the last keyframe, rotation removed, as a fraction of
        /// the image width. Lower costs time, higher loses accuracy.
        pub min_parallax: f64 = 12.0 / 672.0,
        /// Maximum time between keyframes, s: IMU samples are preintegrated again from the last
        /// one.
        pub max_interval_s: f64 = 0.6,
        /// Minimum fraction of the features of the last keyframe that are still tracked.
        pub min_tracked_ratio: f64 = 0.65,
        /// The same within a short time after it: very noisy images lose a third of the features
        /// from frame to frame, and every frame would become a keyframe.
        pub min_tracked_ratio_early: f64 = 0.35,
        /// That short time, s: five frames at 30 Hz.
        pub early_s: f64 = 0.17,
        /// Translation, m, and rotation, rad, between the two newest keyframes below which the rig
        /// is at rest: the earlier of the two leaves the window instead of the oldest keyframe.
        pub rest_motion: [f64; 2] = [0.01, 0.01],
        /// Interval of keyframes at rest that are kept for bundle adjustment, ns: they observe the
        /// same as earlier ones.
        pub interval_at_rest_ns: i64 = 10_000_000_000,
    }

    /// A new window after a tracking loss. Source: `cargo xtask bench odometry_faults`, faults
    /// `covered_lens`, `darkness` and `disconnect`.
    pub struct ReinitializationConfig {
        /// Maximum rotation sigma for which linearization holds, rad.
        pub max_rotation_sigma_rad: f64 = 0.3,
        /// Minimum duration of IMU samples without a gap, ns: they measure the vertical.
        pub min_continuous_imu_ns: i64 = 300_000_000,
        /// Time without samples after which the IMU is not waited for, ns.
        pub imu_timeout_ns: i64 = 1_000_000_000,
        /// Bias sigmas, rad/s and m/s²: biases were estimated before and change slowly.
        pub bias_sigma: [f64; 2] = [0.01, 0.15],
    }

    /// Detection of a camera that moves on its plate. Source: `cargo xtask bench odometry_faults`,
    /// fault `shifted_camera`: 0.2 degrees are not detected, 0.5 degrees are.
    pub struct CameraShiftConfig {
        /// Minimum number of observations of the tested camera, and of all others together.
        pub min_observations: usize = 12,
        /// Maximum residual of an inlier, px.
        pub inlier_px: f64 = 1.5,
        /// Maximum inlier ratio of a shifted camera without a rotation.
        pub max_static_inlier_ratio: f64 = 0.3,
        /// Its minimum inlier ratio with one.
        pub min_rotated_inlier_ratio: f64 = 0.6,
        /// Minimum inlier ratio of all other cameras.
        pub min_other_inlier_ratio: f64 = 0.6,
        /// Number of iterations of the estimation of the rotation.
        pub iterations: usize = 5,
        /// Sigma of the rotation that is added to poses after a shift, as a fraction of the
        /// rotation of the camera: the camera is one of several, and reported sigmas are larger
        /// than this.
        pub sigma_ratio: f64 = 0.1,
    }
}
