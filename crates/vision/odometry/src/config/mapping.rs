//! Constants of mapping: loop closure and bundle adjustment.

use estimator_config::config;

config! {
    /// Bundle adjustment of all keyframes.
    pub struct MappingConfig {
        /// Minimum number of keyframes that observe a landmark; with fewer it adds no information.
        pub min_observations: usize = 2,
        /// Residual above which an observation is an outlier, in standard deviations.
        pub outlier_sigma: f64 = 5.0,
        /// Maximum numbers of iterations: with loop closures trusted, with their robust loss, and
        /// after outliers were removed. They suffice for an hour
        /// (`cargo xtask bench odometry_length`).
        pub max_iterations: [usize; 3] = [12, 12, 30],
        /// Maximum damping at which a step is nearly undamped, and may end the optimization.
        pub max_free_damping: f64 = 1e-5,
        /// Minimum relative cost reduction of such a step.
        pub convergence_ratio: f64 = 1e-5,
        /// Number of keyframes with a computed covariance; those between are interpolated.
        pub max_covariances: usize = 120,
        /// Loop closure.
        pub loop_closure: LoopClosureConfig = LoopClosureConfig::default(),
    }

    /// Loop closure: which keyframes are compared, and which results are believed.
    pub struct LoopClosureConfig {
        /// Minimum time between the two keyframes, s: below it the window has connected them.
        pub min_interval_s: f64 = 12.0,
        /// Maximum distance of the two keyframes, m.
        pub max_distance_m: f64 = 1.5,
        /// Its increase, and that of the maximum correction, per metre of path length between them:
        /// the drift that is still possible.
        pub drift_rate: f64 = 0.01,
        /// Maximum angle between the optical axes of two cameras, rad.
        pub max_view_angle_rad: f64 = 0.6,
        /// Minimum distance between queried keyframes, m.
        pub query_spacing_m: f64 = 0.6,
        /// Minimum rotation between queried keyframes that are nearer, rad.
        pub query_spacing_rad: f64 = 0.3,
        /// Maximum number of candidates per query, the nearest first.
        pub max_candidates: usize = 3,
        /// Maximum Hamming distance of a match, of 256 bits.
        pub max_hamming: u32 = 72,
        /// Maximum ratio of its distance to that of the second-best match.
        pub second_best_ratio: f64 = 0.85,
        /// Maximum angle between the predicted and the measured bearing of a match, rad: the effect
        /// of pose errors on near points.
        pub max_search_angle_rad: f64 = 0.6,
        /// Minimum number of inliers.
        pub min_inliers: f64 = 12.0,
        /// Minimum fraction of all matches that are inliers.
        pub min_inlier_ratio: f64 = 0.3,
        /// Scales of the Tukey loss, in standard deviations, one per iteration. The first has to
        /// exceed the effect of the drift on near points.
        pub tukey_sigma: [f64; 10] = [43.0, 32.0, 23.0, 17.0, 11.5, 8.5, 6.5, 5.0, 4.3, 4.3],
        /// Number of minimal samples. With 30 % of inliers 100 contain one without an outlier with
        /// a probability of 93 %.
        pub samples: u64 = 100,
        /// Standard deviation of a keypoint, px: corners are at whole pixels, and views differ.
        pub sigma_px: f64 = 1.4,
        /// Standard deviation of its disparity, px.
        pub disparity_sigma_px: f64 = 0.5,
        /// Maximum correction by a loop closure, m, in addition to the drift. A larger one is
        /// perceptual aliasing.
        pub max_correction_m: f64 = 0.3,
        /// Maximum correction by a loop closure, rad.
        pub max_correction_rad: f64 = 0.12,
        /// Scale of the Cauchy loss of loop closures, in standard deviations, after the first
        /// convergence.
        pub cauchy_sigma: f64 = 3.0,
        /// The same before it: a long path has a large closure error, and loop closures are
        /// trusted.
        pub cauchy_sigma_first: f64 = 100.0,
    }
}
