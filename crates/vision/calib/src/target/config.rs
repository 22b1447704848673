//! Configuration of the target detection: all of its tuned constants.
//!
//! One struct per concern, in the order of the data flow. Where a field names no source, its value
//! was chosen on rendered images of the tests and on real ones of `test-data`; how the result
//! depends on it was not charted. Pixels are those of the image as given, or of its half.

use estimator_config::config;
use fiducials::decode::ReadConfig;

config! {
    /// Configuration of the target detection.
    pub struct Config {
        /// Maximum number of wrong bits of a tag or marker; limited by the distance of its
        /// dictionary. Lower loses small tags, higher accepts texture as tags.
        pub max_bit_errors: u32 = 2,
        /// Also detect at half the size if the full image does not show the whole board: for
        /// blurred images.
        pub half_size: bool = true,
        /// Minimum side of an image whose half is searched, px.
        pub min_halved_side_px: usize = 64,
        /// Crossings of black and white.
        pub saddles: SaddleConfig = SaddleConfig::default(),
        /// Borders between them.
        pub links: LinkConfig = LinkConfig::default(),
        /// Lattices of a chessboard.
        pub lattice: LatticeConfig = LatticeConfig::default(),
        /// Tags and markers.
        pub markers: MarkerConfig = MarkerConfig::default(),
        /// Subpixel refinement.
        pub refinement: RefinementConfig = RefinementConfig::default(),
        /// Measurement of blur.
        pub blur: BlurConfig = BlurConfig::default(),
    }

    /// Crossings of black and white.
    pub struct SaddleConfig {
        /// Minimum square root of the negated determinant of the Hessian, gray levels per square
        /// pixel: an ideal crossing of contrast A blurred by s has `A / (π s²)`, so that 20 gray
        /// levels pass up to a blur of 2.5 px. Lower costs time on noise.
        pub min_curvature: f32 = 1.0,
        /// Minimum contrast between the bright and the dark sectors, gray levels. Lower accepts
        /// noise, higher loses boards in the shade.
        pub min_contrast: f32 = 8.0,
        /// Fraction of it that a quick test with whole pixels requires.
        pub quick_contrast_ratio: f32 = 0.7,
        /// Maximum number of candidates, strongest first: an image of gravel must not take minutes.
        pub max_candidates: usize = 6000,
        /// Maximum distance of a crossing from its candidate, px.
        pub max_shift_px: f64 = 2.0,
        /// Radii of the circle around a crossing, px; the second one is used where the first one
        /// touches other print.
        pub radius_px: [f32; 2] = [3.0, 2.2],
        /// Distance below which of two crossings the one of higher contrast is kept, px.
        pub min_distance_px: f64 = 1.5,
        /// Maximum angle between a border and its continuation, rad: 35 degrees, since a ring of
        /// few pixels next to other corners is a rough estimate.
        pub max_bend_rad: f64 = 0.6,
        /// Minimum angle between two borders, rad.
        pub min_sector_rad: f64 = 0.2,
        /// Minimum contrast of each side against the middle, as a fraction of the whole. Lower
        /// accepts ends of lines.
        pub min_side_ratio: f32 = 0.12,
    }

    /// Borders that are followed between crossings.
    pub struct LinkConfig {
        /// Distance from a crossing at which its border begins, px.
        pub start_px: f32 = 2.0,
        /// Length of a border up to which it is followed in short steps, px.
        pub slow_length_px: f32 = 12.0,
        /// Length of a step up to there and beyond, px.
        pub step_px: [f32; 2] = [1.0, 1.75],
        /// Minimum length over which the direction of a border is measured, px.
        pub min_direction_length_px: f32 = 3.0,
        /// Minimum distance between linked crossings, px: nearer ones may be the same.
        pub min_length_px: f64 = 2.0,
        /// Maximum distance without contrast over which a border is followed, px, because of blur
        /// or another corner. Higher leads from one board to another.
        pub max_unsupported_px: f32 = 6.5,
        /// Maximum distance of a crossing from the border that reaches it, px.
        pub max_miss_px: f32 = 2.0,
        /// Minimum contrast of a border relative to its crossing. Lower follows noise, higher ends
        /// at the edge of a shadow.
        pub min_contrast_ratio: f32 = 0.3,
        /// Minimum cosine of the angle by which a border may turn.
        pub min_cosine: f32 = 0.8,
        /// Minimum cosine of the angle between a border and the ray at which it arrives.
        pub min_arrival_cosine: f64 = 0.8,
    }

    /// Lattices of a chessboard.
    pub struct LatticeConfig {
        /// Maximum ratio of neighbouring steps. Those of an AprilGrid are above it; lower loses
        /// boards in oblique views.
        pub max_step_ratio: f64 = 1.8,
        /// Maximum deviation of a crossing from the middle between its neighbours, twice, as a
        /// fraction of their distance.
        pub max_bend_ratio: f64 = 0.3,
        /// Minimum fraction of the corners of a plain chessboard that are found before missing ones
        /// are searched.
        pub min_found_ratio: f64 = 0.75,
        /// Maximum number of crossings in a row or column at the edge that is removed: a shadow or
        /// an object beside the board.
        pub max_fringe_corners: usize = 2,
        /// Maximum number of rows and columns that are removed.
        pub max_fringe_lines: usize = 8,
        /// Maximum number of searches for missing corners: later ones start from corners found by
        /// earlier ones.
        pub max_searches: usize = 3,
        /// Maximum distance of a missing corner from its prediction, as a fraction of the step.
        pub search_shift_ratio: f64 = 0.2,
        /// Bounds of it, px.
        pub search_shift_px: [f64; 2] = [1.0, 4.0],
        /// Radius of the window that finds it, as a fraction of the step.
        pub search_window_ratio: f64 = 0.4,
        /// Bounds of it, px.
        pub search_window_px: [f64; 2] = [2.6, 4.0],
        /// Radius of the circle that confirms it, as a fraction of the step.
        pub search_radius_ratio: f32 = 0.4,
        /// Maximum of it, px.
        pub max_search_radius_px: f32 = 3.0,
    }

    /// Tags and markers.
    pub struct MarkerConfig {
        /// Minimum contrast between the border and white, gray levels.
        pub min_contrast: f64 = 8.0,
        /// Minimum side of a cell that is averaged over nine samples, px. Smaller ones are blurred
        /// already.
        pub averaged_cell_px: f64 = 3.5,
        /// Distance of these samples from each other along both axes, as a fraction of the side.
        pub sample_spacing_ratio: f64 = 0.25,
        /// Side of a cell below which a part of its neighbours is subtracted, px.
        pub sharpened_cell_px: f64 = 5.0,
        /// That part.
        pub sharpening: f64 = 0.25,
        /// Maximum number of white cells in the border of a tag, of 64.
        pub max_border_errors: u32 = 4,
        /// The same for a marker, of its one cell wide border.
        pub max_marker_border_errors: u32 = 2,
        /// Maximum number of wrong bits of a tag whose id is known from its neighbours.
        pub max_expected_errors: u32 = 4,
        /// Minimum side of such a tag, px.
        pub min_expected_side_px: f64 = 8.0,
        /// Maximum distance of its corners from their prediction, as a fraction of the side.
        pub expected_shift_ratio: f64 = 0.09,
        /// Bounds of it, px.
        pub expected_shift_px: [f64; 2] = [1.2, 6.0],
        /// Radius of the window that finds such a corner, as a fraction of the side.
        pub expected_window_ratio: f64 = 0.2,
        /// Bounds of it, px.
        pub expected_window_px: [f64; 2] = [2.6, 5.0],
        /// Radius of the circle that confirms it, as a fraction of the side.
        pub expected_radius_ratio: f32 = 0.15,
        /// Bounds of it, px.
        pub expected_radius_px: [f32; 2] = [2.0, 3.0],
        /// Maximum number of wrong bits of a tag that no neighbour confirms. Higher accepts texture
        /// as tags.
        pub max_lone_errors: u32 = 1,
        /// Minimum number of markers that agree on the position of a ChArUco board.
        pub min_votes: u32 = 2,
        /// Minimum ratio of their number to that of the contradicting ones.
        pub min_vote_ratio: u32 = 3,
        /// Maximum number of wrong bits per agreeing marker, in the mean.
        pub max_mean_errors: u32 = 1,
        /// Divisor of the number of bits: a square contradicts the board if more than that part of
        /// its marker's bits are wrong.
        pub max_wrong_bits_divisor: u32 = 4,
        /// Divisor of the number of agreeing markers: that part of it is the maximum number of
        /// squares that contradict.
        pub max_wrong_squares_divisor: u32 = 3,
        /// Distance without other print around a corner of a ChArUco board, as a multiple of the
        /// distance between a marker and the border of its square. Higher lets markers bias the
        /// corner.
        pub clear_margin_ratio: f64 = 1.3,
    }

    /// Subpixel refinement.
    pub struct RefinementConfig {
        /// Maximum radius of the window, px. A wider one reduces noise; a narrower one reduces the
        /// error from a lens that curves borders. It is narrowed for small squares anyway.
        pub max_window_px: f64 = 7.0,
        /// Minimum radius of a round window, px: enough pixels around a crossing.
        pub min_window_px: f64 = 2.6,
        /// Minimum reach of a window along a side, px.
        pub min_along_px: f64 = 1.9,
        /// Reaches of the window that are tried, as fractions of the clear distance: near the image
        /// edge a narrower one may still fit. Above 1 other print biases the position.
        pub window_ratio: [f64; 2] = [0.75, 0.45],
        /// Minimum sine of the angle between the sides of an elliptical window; below it a round
        /// one is used.
        pub min_side_sine: f64 = 0.15,
        /// Minimum determinant of the gradients' matrix over its squared trace. Lower accepts a
        /// border of a single direction.
        pub min_determinant_ratio: f64 = 0.003,
        /// Minimum trace of that matrix, squared gray levels.
        pub min_trace: f64 = 1.0,
        /// Maximum number of steps.
        pub max_iterations: usize = 20,
        /// Number of initial steps in full length.
        pub full_steps: usize = 6,
        /// Factor on later ones: a step that oscillates is too long.
        pub late_step_ratio: f64 = 0.5,
        /// Length of a step at convergence, px. It bounds the bias of a corner.
        pub convergence_px: f64 = 5e-4,
        /// Maximum number of steps of a candidate crossing.
        pub max_coarse_iterations: usize = 6,
        /// Length of a step at its convergence, px.
        pub coarse_convergence_px: f64 = 0.04,
        /// Maximum distance of a refined corner from its crossing, px.
        pub max_shift_px: f64 = 1.0,
        /// Factor on the noise of a smoothed pixel: the binomial filter spreads it over neighbours,
        /// whose gradients are nearly the same. Source: measured, see the test
        /// `stated_sigma_agrees_with_errors`.
        pub smoothed_noise_ratio: f64 = 0.8,
        /// Sigma floor from quantization and the finite window, px.
        pub sigma_floor_px: f64 = 0.005,
        /// Sigma due to another corner `gap` pixels away, px: this times `exp(-gap /
        /// crowding_px)`. Source: rendered AprilGrids at 60 degrees and of small tags, 0.15 px at a
        /// gap of 3.3 px, 0.01 px at 5 px.
        pub crowding_sigma_px: f64 = 60.0,
        /// See `crowding_sigma_px`, px.
        pub crowding_px: f64 = 0.55,
    }

    /// Measurement of blur.
    pub struct BlurConfig {
        /// Minimum reach of a border for measuring its width, px.
        pub min_reach_px: f64 = 2.5,
        /// Maximum reach, px. Blur that is wider is underestimated.
        pub max_reach_px: f64 = 12.0,
        /// Maximum reach as a fraction of the border's length.
        pub max_reach_ratio: f64 = 0.35,
        /// Positions along a border at which its width is measured, as fractions of its length.
        pub positions: [f64; 3] = [0.4, 0.5, 0.6],
        /// Divisor of the number of samples across a border: that part at each end gives the level
        /// of its side.
        pub level_divisor: usize = 5,
        /// Minimum number of measured widths.
        pub min_widths: u32 = 12,
        /// Minimum contrast of a border or crossing, gray levels.
        pub min_contrast: f64 = 10.0,
        /// Radius of the circle that gives the borders of a crossing, px.
        pub crossing_radius_px: f32 = 3.0,
        /// Maximum distance from a crossing at which the levels of its sectors are measured, px.
        pub max_sector_px: f64 = 10.0,
        /// Weight of round blur and no tone curve, relative to the number of widths: for boards
        /// with too few crossings.
        pub regularization: f64 = 1e-3,
    }
}

impl MarkerConfig {
    /// How cells are read.
    pub(super) fn reading(&self) -> ReadConfig {
        let mut config = ReadConfig::default();
        config.min_contrast = self.min_contrast;
        config.averaged_cell_px = self.averaged_cell_px;
        config.sample_spacing_ratio = self.sample_spacing_ratio;
        config.sharpened_cell_px = self.sharpened_cell_px;
        config.sharpening = self.sharpening;
        config
    }
}
