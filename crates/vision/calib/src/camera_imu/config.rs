//! Configuration of the camera–IMU calibration: all of its tuned constants.
//!
//! One struct per concern, in the order of the data flow. Where a field names no source, its value
//! was chosen on simulated recordings of `cargo xtask bench camera_imu`; how the error depends on
//! it was not charted. What a user knows about the hardware is in [`Priors`](super::Priors).

use estimator_config::config;

config! {
    /// Configuration of the camera–IMU calibration.
    pub struct Config {
        /// IMU samples.
        pub samples: SampleConfig = SampleConfig::default(),
        /// Pose of each view.
        pub views: ViewConfig = ViewConfig::default(),
        /// Initial estimates in closed form.
        pub initialization: InitializationConfig = InitializationConfig::default(),
        /// Directions that are fixed before the fit.
        pub observability: ObservabilityConfig = ObservabilityConfig::default(),
        /// The joint fit.
        pub solver: SolverConfig = SolverConfig::default(),
        /// Estimation of the noise levels.
        pub noise: NoiseConfig = NoiseConfig::default(),
        /// Checks of the result.
        pub gates: GateConfig = GateConfig::default(),
    }

    /// IMU samples, and the intervals between views that they connect.
    pub struct SampleConfig {
        /// Maximum interval between two samples, in sample periods; a longer one is a gap. One lost
        /// sample is interpolated. Higher integrates over motion that was not measured, lower
        /// separates views at every late sample.
        pub max_interval_periods: f64 = 2.5,
        /// Fraction of the measurement range from which a sample is saturated. Lower discards valid
        /// peaks, higher uses clipped ones.
        pub saturation_ratio: f64 = 0.999,
        /// Maximum interval between two views that the IMU connects, s. Higher adds intervals with
        /// little information, lower separates the chain at short occlusions.
        pub max_view_interval_s: f64 = 1.0,
        /// Margin for changes of the time offset during the fit without reaching a gap, s. Too low
        /// ends a fit at a gap, too high leaves out intervals beside gaps.
        pub offset_margin_s: f64 = 0.01,
        /// Minimum number of views with a pose, and of intervals between them with IMU samples.
        /// Lower accepts recordings that are too short for the noise estimates.
        pub min_views: usize = 20,
    }

    /// Pose of the board in one view.
    pub struct ViewConfig {
        /// Minimum number of corners of a view. Lower accepts poses with hardly any redundancy.
        pub min_corners: usize = 8,
        /// Threshold of the Huber loss of a corner, in standard deviations.
        pub huber_sigma: f64 = 3.0,
        /// Residual above which a corner is an outlier, in standard deviations. Lower discards
        /// corners of a lens with a residual error, higher keeps wrong detections.
        pub outlier_sigma: f64 = 10.0,
        /// Maximum fraction of outliers among the inliers. Above it the view has no pose.
        pub max_outlier_ratio: f64 = 0.25,
        /// Median error above which the second pose of a planar target is tried with two eyes too,
        /// in nominal sigmas. Lower costs time, higher keeps the wrong one of two poses.
        pub ambiguity_scale: f64 = 2.0,
        /// Median error of the corners, in nominal sigmas, from which a view has no pose. Higher
        /// keeps views of a wrong or moved target.
        pub max_scale: f64 = 20.0,
        /// Minimum component along the optical axis of the direction to a corner that takes part in
        /// the homography, 0 to 1: beyond it the coordinates on the plane diverge.
        pub min_axial_component: f64 = 0.05,
        /// Maximum number of iterations of a pose.
        pub max_iterations: usize = 12,
        /// Length of a step at which a pose has converged, in standard deviations.
        pub convergence_sigma: f64 = 1e-2,
        /// Maximum interval to a neighbour from which the motion during readout is derived, s. For
        /// a rolling shutter. Higher averages over the motion, lower takes the camera as static.
        pub max_motion_interval_s: f64 = 0.15,
        /// Residual lens error after intrinsic calibration, px; common to all views and thus not
        /// averaged. Added to the sigmas of rotation and translation. Lower is overconfident.
        pub lens_error_px: f64 = 0.03,
    }

    /// Initial estimates in closed form, and their plausibility.
    pub struct InitializationConfig {
        /// Search range of the time offset, in standard deviations of its prior, to both sides.
        pub offset_range_sigma: f64 = 3.0,
        /// Step of that search in sample periods of the IMU.
        pub offset_step_periods: f64 = 2.0,
        /// Limits of the step, s. Larger steps miss the peak of the correlation, smaller cost time.
        pub offset_step_s: [f64; 2] = [1e-3, 5e-3],
        /// Minimum fraction of the views with both angular rates at an offset. Lower lets an offset
        /// at the end of the range be chosen from a few intervals.
        pub min_overlap_ratio: f64 = 1.0 / 3.0,
        /// Maximum interval between two views whose rotation counts as a rate, s. Higher averages
        /// over the motion, lower finds no pair at low frame rates.
        pub max_rotation_interval_s: f64 = 0.3,
        /// Minimum interval between the views of a triple, s; the maximum is twice as long. Shorter
        /// amplifies pose noise, longer integrates more bias.
        pub min_triple_interval_s: f64 = 0.15,
        /// Uncertainty of a view's velocity in a triple, m/s. It weights the triples against the
        /// priors of lever arm and bias.
        pub velocity_sigma: f64 = 0.02,
        /// Spread of angular rates along an axis below which the axis has no information, rad/s.
        /// Lower aligns noise, higher ignores slow rotations.
        pub static_rate_rad_s: f64 = 0.02,
        /// The same as a fraction of the spread along the axis with the largest one.
        pub min_second_axis_ratio: f64 = 0.02,
        /// Range of the angular rates of the gyroscope over those of the camera. Outside it the
        /// units are wrong or the IMU is another camera's.
        pub rate_ratio: [f64; 2] = [0.5, 2.0],
        /// Range of the estimated gravity over its known magnitude. Outside it the units or the
        /// size of the board are wrong.
        pub gravity_ratio: [f64; 2] = [0.7, 1.4],
    }

    /// Observability from the motion of the recording alone.
    pub struct ObservabilityConfig {
        /// Window length, s. Shorter takes noise for excitation, longer averages over real motion.
        pub window_s: f64 = 0.25,
        /// Assumed accuracy of a view's pose, rad and m: optimistic. Lower fixes fewer directions.
        pub view_pose_sigma: [f64; 2] = [1e-4, 1e-4],
        /// Sigmas above which a direction is fixed at its prior: rotation in rad, lever arm in m,
        /// offset in s. Far above those of a usable result; lower fixes what could be estimated,
        /// higher fits noise.
        pub max_sigma: [f64; 3] = [0.02, 0.03, 3e-3],
    }

    /// Damped Gauss–Newton of the joint problem. Costs are in squared standard deviations.
    pub struct SolverConfig {
        /// Threshold of the Huber loss of a view or an interval, in standard deviations: norm of
        /// seven or nine components. Lower down-weights valid views, higher keeps outliers.
        pub huber_sigma: f64 = 5.5,
        /// Sigmas of fixed directions: rad, m, s. Small beside any result, large beside rounding.
        pub fixed_sigma: [f64; 3] = [1e-6, 1e-6, 1e-7],
        /// Velocity prior, m/s: no hand moves a camera faster. Constrains velocities that nothing
        /// measures.
        pub max_speed_m_s: f64 = 10.0,
        /// Initial damping.
        pub initial_damping: f64 = 1e-6,
        /// Minimum damping. Zero would let a flat direction make steps of any length.
        pub min_damping: f64 = 1e-9,
        /// Maximum damping; above it no step decreases the cost.
        pub max_damping: f64 = 1e8,
        /// Number of iterations after which a slow descent may stop.
        pub max_iterations: usize = 30,
        /// Predicted decrease below which the fit has converged.
        pub convergence_gain: f64 = 1e-4,
        /// Predicted decrease below which the fit may stop after the maximum number of iterations:
        /// along directions that are not determined the descent is long, flat and of no use. Higher
        /// ends a fit too early.
        pub max_stalled_gain: f64 = 10.0,
        /// The same as a fraction of the cost; the larger one counts.
        pub max_stalled_gain_ratio: f64 = 1e-3,
        /// Achieved decrease, absolute and as a fraction of the cost, below both of which the fit
        /// has converged: with the robust loss the last steps are small.
        pub min_gain: [f64; 2] = [1e-3, 1e-8],
        /// Predicted decrease after a new linearization of the views below which no further one is
        /// made.
        pub relinearization_gain: f64 = 1e-2,
        /// Maximum number of further linearizations of the views, without and with the robust loss.
        pub max_relinearizations: [usize; 2] = [1, 4],
        /// Minimum number of inlier corners at the pose of the joint fit, as a fraction of those at
        /// the pose of the view alone; below it the view is linearized at the latter.
        pub min_inlier_corner_ratio: f64 = 0.9,
    }

    /// Noise levels estimated from the residuals (variance components).
    pub struct NoiseConfig {
        /// Number of fits, each with the noise levels of the one before.
        pub max_rounds: usize = 4,
        /// Median mean-square residual without the robust loss above which a noise level is raised
        /// before outliers are rejected.
        pub max_initial_median: f64 = 2.0,
        /// Minimum redundancy of an estimated noise level; with less the nominal one is kept.
        pub min_redundancy: f64 = 10.0,
        /// Significance of a deviation of the variance from 1, in standard deviations.
        pub significance_sigma: f64 = 3.0,
        /// Minimum deviation of the variance from 1 that is corrected.
        pub min_variance_change: f64 = 0.04,
        /// Minimum factors on the nominal noise: poses, gyroscope, accelerometer, bias walks of
        /// both. Bias walks only grow: a small change of a bias proves nothing. Lower trusts a
        /// measurement because its residuals are small by chance.
        pub min_factors: [f64; 5] = [0.2, 0.1, 0.1, 1.0, 1.0],
        /// Maximum factor on the nominal noise.
        pub max_factor: f64 = 1e3,
    }

    /// Thresholds of the checks of the result. Pairs are of a warning and a failure. Lower rejects
    /// valid calibrations, higher accepts wrong ones.
    pub struct GateConfig {
        /// Maximum sigma of a determined rotation, rad: 0.1 degrees.
        pub max_rotation_sigma_rad: f64 = 0.1 * std::f64::consts::PI / 180.0,
        /// Maximum sigma of a determined lever arm, m.
        pub max_translation_sigma_m: f64 = 2e-3,
        /// Maximum sigma of a determined time offset, s.
        pub max_offset_sigma_s: f64 = 3e-4,
        /// Deviations from a nominal value up to this number of standard deviations are chance.
        pub significance_sigma: f64 = 3.5,
        /// Difference of the halves, chi-squared of seven degrees of freedom: exceeded by chance
        /// once in a thousand; certain.
        pub halves_chi2: [f64; 2] = [24.3, 40.0],
        /// Minimum number of intervals in a half for the comparison. Lower compares sigmas that are
        /// not normally distributed.
        pub min_intervals_per_half: usize = 60,
        /// Corner noise over the nominal one: warning below the first and above the second value,
        /// failure above the third.
        pub corner_noise: [f64; 3] = [0.3, 3.0, 8.0],
        /// The same for the poses of the views about the motion.
        pub pose_noise: [f64; 3] = [0.0, 1.5, 3.0],
        /// The same for gyroscope and accelerometer.
        pub imu_noise: [f64; 3] = [0.4, 2.0, 10.0],
        /// The same for the bias random walks.
        pub bias_walk: [f64; 3] = [0.0, 5.0, 100.0],
        /// Growth of the time offset over the recording, s.
        pub drift_s: [f64; 2] = [1e-4, 1e-3],
        /// Scale and skew of the sensors, in standard deviations of their prior.
        pub shape_sigma: [f64; 2] = [4.0, 6.0],
        /// Weight in the robust loss below which a view contradicts the motion, 0 to 1.
        pub outlier_weight: f64 = 0.5,
        /// Fraction of views that contradict the motion.
        pub outlier_ratio: [f64; 2] = [0.03, 0.2],
        /// Minimum fraction of the intervals between views with complete IMU samples; a warning.
        pub min_inertial_ratio: f64 = 0.8,
    }
}
