//! Configuration of the calibration of lenses and rig: all of its tuned constants.
//!
//! One struct per concern, in the order of the data flow. Where a field names no source, its value
//! was chosen on the simulated recordings of `cargo xtask bench calib`; how the error depends on it
//! was not charted. Pairs of `[f64; 2]` with units "m and rad" are of translation and rotation.

use estimator_config::config;

use crate::{adjust, pnp};

config! {
    /// Configuration of the calibration of lenses and rig.
    pub struct Config {
        /// Maximum number of instants for the lenses of one camera, and again for the extrinsics.
        /// More cost time and add little, since the most informative ones come first.
        pub max_views: usize = 40,
        /// Whether all lens models are tried; otherwise only the factory's.
        pub choose_lens: bool = true,
        /// Views of a target, and their corners.
        pub views: ViewConfig = ViewConfig::default(),
        /// Motion of the rig during exposure.
        pub motion: MotionConfig = MotionConfig::default(),
        /// Initial lens.
        pub initialization: InitializationConfig = InitializationConfig::default(),
        /// Pose of a target in one view.
        pub poses: pnp::Config = pnp::Config::default(),
        /// Priors of lenses and extrinsics.
        pub priors: PriorConfig = PriorConfig::default(),
        /// Initial poses of cameras and targets.
        pub pose_graph: PoseGraphConfig = PoseGraphConfig::default(),
        /// Selection of the lens model.
        pub model_selection: ModelSelectionConfig = ModelSelectionConfig::default(),
        /// Bundle adjustment.
        pub solver: adjust::Config = adjust::Config::default(),
        /// Shape of the targets.
        pub board_shape: BoardShapeConfig = BoardShapeConfig::default(),
        /// Image coverage.
        pub coverage: CoverageConfig = CoverageConfig::default(),
        /// Checks of the result.
        pub checks: CheckConfig = CheckConfig::default(),
    }

    /// Views of a target, and their corners.
    pub struct ViewConfig {
        /// Minimum number of corners of a view. Lower accepts poses with hardly any redundancy.
        pub min_corners: usize = 8,
        /// Minimum number of views per eye. Lower fits a lens to a few directions.
        pub min_views: usize = 5,
        /// Sigma floor of a corner, px: residual errors of paper, print and lens. Lower trusts
        /// sharp corners more than the target deserves.
        pub min_sigma_px: f64 = 0.02,
        /// Maximum median residual of an initial lens, px. Lower rejects a factory file of an
        /// older calibration, higher accepts the file of another camera.
        pub max_initial_rms_px: f64 = 8.0,
        /// RMS residual over the median of all views from which a view is an outlier.
        pub outlier_ratio: f64 = 6.0,
        /// Minimum of that median, px: exact observations must not make every view an outlier.
        pub min_median_rms_px: f64 = 0.05,
        /// RMS of the mirrored pose over that of the best one, below which either may be right.
        /// Lower uses wrong poses for the extrinsics, higher discards far and small targets.
        pub max_ambiguity_ratio: f64 = 1.5,
        /// Maximum corner displacement within a cluster of near-identical views, px. Lower takes
        /// repeated images as independent and makes sigmas too small.
        pub cluster_px: f64 = 3.0,
        /// Weight of the common corner sigma in the estimate for one view, in corners. Lower
        /// follows the scatter of a view with few corners.
        pub sigma_prior_corners: f64 = 20.0,
    }

    /// Motion of the rig during exposure. Image motion is in px per 0.1 s.
    pub struct MotionConfig {
        /// Maximum image motion of a static view, px. Higher uses blurred views, lower leaves few.
        pub max_static_px: f64 = 0.25,
        /// Image motion above which views are dropped if others of the same eye are below, px.
        pub max_px: f64 = 1.0,
        /// Fraction of the image motion that is added to the sigma of corners: rows of a rolling
        /// shutter, and left and right eye, are not exposed at the same instant.
        pub sigma_ratio: f64 = 0.25,
        /// Maximum interval between two frames for measuring image motion, ns. Higher misses motion
        /// back and forth, lower leaves it unknown at low frame rates.
        pub max_frame_interval_ns: i64 = 250_000_000,
        /// Minimum fraction of views that are used, the ones with least motion, even if none is
        /// static.
        pub min_used_ratio: f64 = 0.2,
    }

    /// Initial lens without a factory file.
    pub struct InitializationConfig {
        /// Focal lengths that are tried, in image widths: 120 to 24 degrees. A true one far from
        /// all of them leaves no pose that fits.
        pub focal_lengths: [f64; 9] = [0.3, 0.4, 0.52, 0.65, 0.8, 1.0, 1.3, 1.7, 2.4],
        /// Maximum number of views used. More cost time for each focal length.
        pub max_views: usize = 12,
    }

    /// Priors of lenses and extrinsics.
    pub struct PriorConfig {
        /// Of any lens, without a file of it.
        pub any_lens: LensPriorConfig = LensPriorConfig::default(),
        /// Of a lens with a factory file.
        pub factory_lens: FactoryPriorConfig = FactoryPriorConfig::default(),
        /// Sigma of tangential coefficients that a model without them gets back. Source: their size
        /// in the factory files at hand. Lower puts decentering into the rotation between the eyes.
        pub tangential_sigma: f64 = 3e-4,
        /// Added uncertainty of a factory `left_from_right`, m and rad. Lower keeps the error of a
        /// camera that was dropped or warmed up.
        pub factory_stereo_sigma: [f64; 2] = [2e-3, 0.01],
        /// Sigma of extrinsics without a nominal value, m and rad: no information at the size of a
        /// rig.
        pub extrinsics_sigma: [f64; 2] = [3.0, 3.0],
        /// Factor on the first of them for the pose of a target: rooms are larger than rigs.
        pub target_ratio: f64 = 10.0,
    }

    /// Sigmas of the parameters of any lens. They only keep parameters that the views do not
    /// determine within the usual range; lower biases unusual lenses.
    pub struct LensPriorConfig {
        /// Focal length, as a fraction of its initial value.
        pub focal_length_ratio: f64 = 0.3,
        /// Principal point about the image centre, as a fraction of the image width.
        pub principal_point_ratio: f64 = 0.1,
        /// Tangential coefficients.
        pub tangential: f64 = 0.01,
        /// Radial coefficients of a pinhole lens.
        pub radial: f64 = 0.7,
        /// Coefficients of a Kannala–Brandt fisheye.
        pub fisheye: f64 = 0.4,
        /// `xi` of a double sphere, about 0.
        pub xi: f64 = 0.5,
        /// `alpha` of a double sphere or EUCM: mean and sigma.
        pub alpha: [f64; 2] = [0.5, 0.5],
        /// `beta` of an EUCM: mean and sigma.
        pub beta: [f64; 2] = [1.0, 0.7],
    }

    /// Sigmas of the parameters of a lens about its factory file. Source: the difference of two
    /// calibrations of one camera. Lower keeps errors of the file.
    pub struct FactoryPriorConfig {
        /// Focal length, as a fraction.
        pub focal_length_ratio: f64 = 0.01,
        /// Principal point, as a fraction of the image width.
        pub principal_point_ratio: f64 = 0.01,
        /// Tangential coefficients.
        pub tangential: f64 = 2e-3,
        /// Coefficients `k1`, `k2` and `k3`.
        pub radial: [f64; 3] = [0.05, 0.03, 0.01],
        /// All other coefficients.
        pub other: f64 = 0.1,
    }

    /// Initial poses of cameras and targets.
    pub struct PoseGraphConfig {
        /// Weight of rotation against translation in the distance of two poses, m per rad: the size
        /// of a rig.
        pub metres_per_radian: f64 = 0.5,
        /// Maximum distance of two poses, m. A wrong candidate counts no more than this.
        pub max_distance_m: f64 = 1.0,
        /// Maximum number of candidates; of more, every n-th is used. Time grows with its square.
        pub max_candidates: usize = 61,
    }

    /// Selection of the lens model.
    pub struct ModelSelectionConfig {
        /// Number of folds of the cross-validation.
        pub folds: usize = 4,
        /// Maximum ratio of a model's RMS residual to the best one's; models above are dropped.
        pub max_rms_ratio: f64 = 1.2,
        /// Relative difference of mean squares below which models are equivalent. Lower prefers
        /// models with more coefficients than the views determine.
        pub equivalent_ratio: f64 = 0.05,
        /// RMS residual over the median of all views above which a view is an outlier. Higher lets
        /// a view with a wrong pose outweigh the differences between models.
        pub outlier_view_ratio: f64 = 2.0,
    }

    /// Shape of the targets.
    pub struct BoardShapeConfig {
        /// Rounds of shape estimation and bundle adjustment.
        pub rounds: usize = 4,
        /// Minimum decrease of the cost. A tenth of it is a chance of 1 in 10^4 for three
        /// parameters. Lower bends flat targets to fit errors of the lens.
        pub min_cost_decrease: f64 = 60.0,
        /// Minimum decrease as a fraction of the cost.
        pub min_cost_decrease_ratio: f64 = 0.01,
        /// Minimum sagitta, m: smaller shapes are ignored.
        pub min_sagitta_m: f64 = 2e-4,
        /// Residual above which a corner does not contribute to the shape, in standard deviations.
        pub outlier_sigma: f64 = 3.0,
    }

    /// Image coverage.
    pub struct CoverageConfig {
        /// Width of the border that must be covered, as a fraction of the image's width or height.
        /// Distortion is extrapolated beyond the outermost corners.
        pub border_ratio: f64 = 0.1,
        /// Minimum number of views with corners in each border, and of tilted views.
        pub min_views: usize = 3,
        /// Minimum tilt of a tilted view, degrees. Tilted views separate focal length from
        /// distance.
        pub min_tilt_deg: f64 = 20.0,
    }

    /// Thresholds of the checks of the result. Pairs are of a warning and a failure. Lower rejects
    /// valid calibrations, higher accepts wrong ones.
    pub struct CheckConfig {
        /// RMS residual of an eye, px.
        pub rms_px: [f64; 2] = [0.5, 1.5],
        /// Deviation from the factory file. Focal lengths relative to themselves, principal points
        /// relative to the image width.
        pub factory_deviation: [f64; 2] = [0.025, 0.05],
        /// Sigma of the pixel of a given direction, anywhere in the image, px.
        pub pixel_sigma_px: [f64; 2] = [1.0, 4.0],
        /// Sigma of the right eye's pose in the left one, m.
        pub stereo_sigma_m: [f64; 2] = [5e-4, 3e-3],
        /// The same, degrees.
        pub stereo_sigma_deg: [f64; 2] = [0.05, 0.3],
        /// Sigma of the pose of one camera in another, m.
        pub rig_sigma_m: [f64; 2] = [1e-3, 10e-3],
        /// The same, degrees.
        pub rig_sigma_deg: [f64; 2] = [0.05, 0.5],
        /// Relative deviation of a baseline from its nominal value above which the target's size is
        /// suspect.
        pub max_length_ratio: f64 = 0.005,
        /// The same in standard deviations; the larger one counts.
        pub max_length_sigma: f64 = 3.0,
        /// Deviation from nominal extrinsics above which they are contradicted, in standard
        /// deviations of their prior.
        pub prior_sigma: f64 = 4.0,
        /// The deviation, as a fraction of it, above which the prior is replaced, so that it does
        /// not bias the other cameras.
        pub prior_replacement_ratio: f64 = 0.5,
        /// Limit for the maximum of a Brownian bridge, per coordinate, in six coordinates twice
        /// over: exceeded by chance about once in 1000 (Kolmogorov distribution).
        pub max_bridge: f64 = 2.25,
        /// Minimum number of instants for that test.
        pub min_bridge_instants: usize = 8,
        /// Smallest motion that is reported, m.
        pub min_motion_m: f64 = 5e-4,
        /// The same, degrees.
        pub min_motion_deg: f64 = 0.05,
        /// Maximum sagitta of a usable board, m.
        pub max_sagitta_m: f64 = 0.01,
    }
}
