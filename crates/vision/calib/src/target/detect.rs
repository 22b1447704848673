//! Detection of boards in an image.
//!
//! Contract: every returned corner is correct; uncertain ones are absent. A corner is a crossing of
//! black and white whose borders lead to its neighbours on the board, with an id confirmed by
//! markers or by the whole chessboard. A board with an ambiguous placement gives no corners, with
//! the reason in [`Detection::remark`]. The same image gives the same numbers on every machine.
//!
//! - A **chessboard** must be completely inside the image, with nothing similar around it. If it is
//!   symmetric under half a turn, corner 0 is the one nearer to the top left of the image along the
//!   board's diagonal, and [`Detection::half_turn`] is set. Mirrored or inverted images of a
//!   chessboard cannot be distinguished from a chessboard.
//! - Of an **AprilGrid** or a **ChArUco** board any part may be visible. Mirrored or inverted
//!   images give nothing.
//! - Several boards in one image: [`detect_all`], each with ids of its own. Of two boards with the
//!   same ids, the conflicting ids are dropped.
//!
//! Images are 8 bits of one channel, with any monotonic tone curve. Lines may be curved over the
//! board, but must be straight over about one square.

use boards::Target;

use super::blur::{self, Blur};
use super::config::Config;
use imaging::ImageView;

use super::refine::{self, Window};
use super::scene::{BoardCandidate, CornerCandidate, Scene};
use super::smooth::Smooth;
use super::{chessboard, grid};
use fiducials::square::distance;

/// A detected corner.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DetectedCorner {
    /// Id as in [`Target::corners`].
    pub id: u32,
    /// Position, pixels; integers are pixel centres.
    pub pixel: [f64; 2],
    /// Standard deviation of the position along its worst direction, pixels, from noise and
    /// sharpness of this corner. Errors of the lens, the paper and motion are not included.
    pub sigma_px: f64,
}

/// Detection of one board.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Detection {
    /// Corners, ascending by id, each once.
    pub corners: Vec<DetectedCorner>,
    /// Blur of the board's borders; `None` with too few long borders.
    pub blur: Option<Blur>,
    /// Image noise, grey values, one standard deviation.
    pub noise_grey: f64,
    /// Whether the board is symmetric under half a turn, so that its orientation is a guess.
    pub half_turn: bool,
    /// Reason for missing corners.
    pub remark: Option<&'static str>,
}

/// Detects one board. Without a board the detection is empty.
///
/// ```
/// use boards::Target;
/// use calib::target::{Config, ImageView, detect};
///
/// // A chessboard of 8 x 6 squares of 24 pixels each, drawn on white; its edges fall between pixels.
/// let board = Target::Chessboard { columns: 7, rows: 5, square_m: 0.03 };
/// let (width, height, side, margin) = (264, 216, 24, 36);
/// let gray = |x: usize, y: usize| {
///     let square = |v: usize, count: usize| v.checked_sub(margin).map(|v| v / side).filter(|v| *v < count);
///     match (square(x, 8), square(y, 6)) {
///         (Some(column), Some(row)) if (column + row) % 2 == 0 => 30,
///         _ => 210,
///     }
/// };
/// let pixels: Vec<u8> = (0..width * height).map(|i| gray(i % width, i / width)).collect();
/// let image = ImageView::new(width, height, width, &pixels).ok_or("too few pixels")?;
/// let detection = detect(&image, &board, &Config::default());
/// assert_eq!(detection.corners.len(), 35, "{:?}", detection.remark);
/// let first = detection.corners[0].pixel;
/// assert!(first.iter().all(|v| (v - 59.5).abs() < 0.1), "{first:?}");
/// # Ok::<(), &str>(())
/// ```
pub fn detect(image: &ImageView<'_>, target: &Target, config: &Config) -> Detection {
    let mut all = detect_all(image, std::slice::from_ref(target), config);
    all.pop().unwrap_or_default()
}

/// Detects several boards in one image; the crossings are computed once.
pub fn detect_all(image: &ImageView<'_>, targets: &[Target], config: &Config) -> Vec<Detection> {
    let scene = Scene::of(Smooth::of(image), config);
    let noise = blur::noise(image);
    let mut found: Vec<BoardCandidate> = targets
        .iter()
        .map(|t| find_board(image, &scene, t, config))
        .collect();
    let complete =
        |found: &BoardCandidate, target: &Target| found.corners.len() >= target.corners().len();
    let incomplete = targets.iter().zip(&found).any(|(t, f)| !complete(f, t));
    if config.half_size
        && incomplete
        && image.width().min(image.height()) >= config.min_halved_side_px
    {
        let pixels = image.halved();
        let (width, height) = (image.width() / 2, image.height() / 2);
        let half = ImageView::new(width, height, width, &pixels).expect("halved() fills it");
        let half_scene = Scene::of(Smooth::of(&half), config);
        for (target, found) in targets.iter().zip(&mut found) {
            if complete(found, target) {
                continue;
            }
            let mut other = find_board(&half, &half_scene, target, config);
            if other.corners.len() > found.corners.len() {
                other.enlarge();
                *found = other;
            }
        }
    }
    found
        .into_iter()
        .map(|found| finish(image, &scene.smooth, found, noise, config))
        .collect()
}

fn find_board(
    image: &ImageView<'_>,
    scene: &Scene,
    target: &Target,
    config: &Config,
) -> BoardCandidate {
    if target.invalid_reason().is_some() {
        return BoardCandidate {
            remark: Some("the board itself is impossible"),
            ..BoardCandidate::default()
        };
    }
    match target {
        Target::Chessboard { columns, rows, .. } => {
            chessboard::find(scene, target, *columns as i32, *rows as i32)
        }
        Target::Charuco { .. } => chessboard::find_with_markers(image, scene, target, config),
        Target::AprilGrid { .. } => grid::find(image, scene, target, config),
    }
}

/// Refines corners, drops those that do not converge, measures blur.
fn finish(
    image: &ImageView<'_>,
    smooth: &Smooth,
    found: BoardCandidate,
    noise: f64,
    config: &Config,
) -> Detection {
    let refinement = &config.refinement;
    let mut corners: Vec<DetectedCorner> = found
        .corners
        .iter()
        .filter_map(|corner| {
            // Near the image edge a narrower window may still fit.
            let (pixel, window) = refinement.window_ratio.into_iter().find_map(|share| {
                let sides = corner.sides.map(|side| side.map(|v| share * v));
                let window = Window::along(
                    sides,
                    refinement.max_window_px * share / refinement.window_ratio[0],
                    refinement,
                );
                Some((
                    refine::refine_corner(smooth, corner.at, &window, refinement.max_shift_px)?,
                    window,
                ))
            })?;
            let sigma_px = refine::sigma(smooth, pixel, &window, noise)?;
            let crowded =
                refinement.crowding_sigma_px * libm::exp(-corner.gap / refinement.crowding_px);
            let floor = refinement.sigma_floor_px;
            let inside = |v: f64, size: usize| v > 0.0 && v < size as f64 - 1.0;
            let [x, y] = pixel;
            (inside(x, image.width()) && inside(y, image.height())).then_some(DetectedCorner {
                id: corner.id,
                pixel,
                sigma_px: (sigma_px * sigma_px + floor * floor + crowded * crowded).sqrt(),
            })
        })
        .collect();
    corners.sort_by_key(|c| c.id);
    let crossings: Vec<([f64; 2], f64)> = found.corners.iter().map(|c| (c.at, clear(c))).collect();
    Detection {
        corners,
        blur: blur::measure(image, smooth, &found.borders, &crossings, config),
        noise_grey: noise,
        half_turn: found.half_turn,
        remark: found.remark,
    }
}

/// Distance around a corner without other print, pixels.
fn clear(corner: &CornerCandidate) -> f64 {
    let [a, b] = corner.sides.map(|side| distance(side, [0.0; 2]));
    a.min(b)
}
