//! Detection of boards in an image.
//!
//! Contract: every returned corner is correct; uncertain ones are absent. A corner is a crossing of
//! black and white whose borders lead to its neighbours on the board, with an id confirmed by
//! markers or by the whole chessboard. A board with an ambiguous placement gives no corners, with
//! the reason in [`Detection::remark`]. The same image gives the same numbers on every machine.
//!
//! - A **chessboard** must be completely inside the image, with nothing similar around it. If it is
//!   symmetric under half a turn, corner 0 is the one nearer to the top left of the image along the
//!   board's diagonal, and [`Detection::half_turn`] is set. Mirrored or inverted images of a chessboard
//!   cannot be distinguished from a chessboard.
//! - Of an **AprilGrid** or a **ChArUco** board any part may be visible. Mirrored or inverted images give
//!   nothing.
//! - Several boards in one image: [`detect_all`], each with ids of its own. Of two boards with the same
//!   ids, the conflicting ids are dropped.
//!
//! Images are 8 bits of one channel, with any monotonic tone curve. Lines may be curved over the
//! board, but must be straight over about one square.

use super::blur::{self, Border};
use super::board::Target;
use super::image::{ImageView, Smooth};
use super::link::{self, Links};
use super::refine::{self, Window};
use super::saddle::{self, Saddle};
use super::square::distance;
use super::{chessboard, grid};

/// Detector settings.
#[derive(Clone, Copy, Debug)]
pub struct Settings {
    /// Maximum number of wrong bits of a tag or marker; limited by the distance of its dictionary.
    pub max_bit_errors: u32,
    /// Maximum radius of the refinement window, pixels. A wider one reduces noise; a narrower one
    /// reduces the error from a lens that curves borders. It is narrowed for small squares anyway.
    pub max_window_px: f64,
    /// Also detect at half the size if the full image does not show the whole board: for blurred
    /// images.
    pub half_size: bool,
}

impl Default for Settings {
    fn default() -> Self {
        Self {
            max_bit_errors: 2,
            max_window_px: 7.0,
            half_size: true,
        }
    }
}

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

/// Blur of a view, from the width of the borders: half the distance from 16 % to 84 % of the step,
/// which is one standard deviation of a Gaussian blur; includes the pixel's own size.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Blur {
    /// In the most blurred direction, pixels.
    pub major_px: f64,
    /// Across it, pixels.
    pub minor_px: f64,
    /// The most blurred direction, a unit vector in the image.
    pub direction: [f64; 2],
}

impl Blur {
    /// Length of a uniform motion during the exposure that explains the difference between the
    /// directions, pixels: the blur that remains after removing the minor one.
    pub fn motion_px(&self) -> f64 {
        // 68 % of a uniform motion of this length are between 16 % and 84 %.
        let extra = self.major_px * self.major_px - self.minor_px * self.minor_px;
        2.0 / 0.68 * extra.max(0.0).sqrt()
    }
}

/// Detects one board. Without a board the detection is empty.
///
/// ```
/// use calib::target::{ImageView, Settings, Target, detect};
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
/// let detection = detect(&image, &board, &Settings::default());
/// assert_eq!(detection.corners.len(), 35, "{:?}", detection.remark);
/// let first = detection.corners[0].pixel;
/// assert!(first.iter().all(|v| (v - 59.5).abs() < 0.1), "{first:?}");
/// # Ok::<(), &str>(())
/// ```
pub fn detect(image: &ImageView<'_>, target: &Target, settings: &Settings) -> Detection {
    let mut all = detect_all(image, std::slice::from_ref(target), settings);
    all.pop().unwrap_or_default()
}

/// Detects several boards in one image; the crossings are computed once.
pub fn detect_all(
    image: &ImageView<'_>,
    targets: &[Target],
    settings: &Settings,
) -> Vec<Detection> {
    let scene = Scene::of(Smooth::of(image));
    let noise = blur::noise(image);
    let mut found: Vec<Found> = targets
        .iter()
        .map(|t| find_board(image, &scene, t, settings))
        .collect();
    let complete = |found: &Found, target: &Target| found.corners.len() >= target.corners().len();
    let incomplete = targets.iter().zip(&found).any(|(t, f)| !complete(f, t));
    if settings.half_size && incomplete && image.width().min(image.height()) >= 64 {
        let pixels = image.halved();
        let (width, height) = (image.width() / 2, image.height() / 2);
        let half = ImageView::new(width, height, width, &pixels).expect("halved() fills it");
        let half_scene = Scene::of(Smooth::of(&half));
        for (target, found) in targets.iter().zip(&mut found) {
            if complete(found, target) {
                continue;
            }
            let mut other = find_board(&half, &half_scene, target, settings);
            if other.corners.len() > found.corners.len() {
                other.enlarge();
                *found = other;
            }
        }
    }
    found
        .into_iter()
        .map(|found| finish(image, &scene.smooth, found, noise, settings))
        .collect()
}

/// The crossings of an image and their links.
pub(super) struct Scene {
    pub(super) smooth: Smooth,
    pub(super) saddles: Vec<Saddle>,
    pub(super) links: Links,
}

impl Scene {
    fn of(smooth: Smooth) -> Self {
        let saddles = saddle::find(&smooth);
        let links = link::join(&smooth, &saddles);
        Self {
            smooth,
            saddles,
            links,
        }
    }
}

/// A corner before the final refinement.
#[derive(Clone, Copy, Debug)]
pub(super) struct CornerCandidate {
    pub(super) id: u32,
    pub(super) at: [f64; 2],
    /// Along the two borders, the distance without other print, pixels.
    pub(super) sides: [[f64; 2]; 2],
    /// Distance to the nearest other corner along a border, pixels.
    pub(super) gap: f64,
}

/// A board before the final refinement.
#[derive(Clone, Debug, Default)]
pub(super) struct Found {
    pub(super) corners: Vec<CornerCandidate>,
    pub(super) borders: Vec<Border>,
    pub(super) half_turn: bool,
    pub(super) remark: Option<&'static str>,
}

impl Found {
    /// Converts from half the image size to full size.
    fn enlarge(&mut self) {
        let up = |at: [f64; 2]| at.map(|v| 2.0 * v + 0.5);
        for corner in &mut self.corners {
            corner.at = up(corner.at);
            corner.gap *= 2.0;
            corner.sides = corner.sides.map(|side| side.map(|v| 2.0 * v));
        }
        for border in &mut self.borders {
            (border.ends, border.clear) = (border.ends.map(up), 2.0 * border.clear);
        }
    }
}

fn find_board(image: &ImageView<'_>, scene: &Scene, target: &Target, settings: &Settings) -> Found {
    if target.invalid_reason().is_some() {
        return Found {
            remark: Some("the board itself is impossible"),
            ..Found::default()
        };
    }
    match target {
        Target::Chessboard { columns, rows, .. } => {
            chessboard::find(scene, target, *columns as i32, *rows as i32)
        }
        Target::Charuco { .. } => chessboard::find_with_markers(image, scene, target, settings),
        Target::AprilGrid { .. } => grid::find(image, scene, target, settings),
    }
}

/// Refines corners, drops those that do not converge, measures blur.
fn finish(
    image: &ImageView<'_>,
    smooth: &Smooth,
    found: Found,
    noise: f64,
    settings: &Settings,
) -> Detection {
    let mut corners: Vec<DetectedCorner> = found
        .corners
        .iter()
        .filter_map(|corner| {
            // Near the image edge a narrower window may still fit.
            let (pixel, window) = [0.75, 0.45].into_iter().find_map(|share| {
                let sides = corner.sides.map(|side| side.map(|v| share * v));
                let window = Window::along(sides, settings.max_window_px * share / 0.75);
                Some((
                    refine::refine_corner(smooth, corner.at, &window, 1.0)?,
                    window,
                ))
            })?;
            let sigma_px = refine::sigma(smooth, pixel, &window, noise)?;
            let crowded = CROWDED.0 * libm::exp(-corner.gap / CROWDED.1);
            let inside = |v: f64, size: usize| v > 0.0 && v < size as f64 - 1.0;
            let [x, y] = pixel;
            (inside(x, image.width()) && inside(y, image.height())).then_some(DetectedCorner {
                id: corner.id,
                pixel,
                sigma_px: (sigma_px * sigma_px + FLOOR * FLOOR + crowded * crowded).sqrt(),
            })
        })
        .collect();
    corners.sort_by_key(|c| c.id);
    let crossings: Vec<([f64; 2], f64)> = found.corners.iter().map(|c| (c.at, clear(c))).collect();
    Detection {
        corners,
        blur: blur::measure(image, smooth, &found.borders, &crossings),
        noise_grey: noise,
        half_turn: found.half_turn,
        remark: found.remark,
    }
}

/// Sigma floor from quantization and the finite window, pixels.
const FLOOR: f64 = 0.005;
/// Error from another corner `gap` pixels away, pixels: `CROWDED.0 * exp(-gap / CROWDED.1)`. From
/// rendered AprilGrids at 60 degrees and of small tags: 0.15 at a gap of 3.3, 0.01 at 5.
const CROWDED: (f64, f64) = (60.0, 0.55);

/// Distance around a corner without other print, pixels.
fn clear(corner: &CornerCandidate) -> f64 {
    let [a, b] = corner.sides.map(|side| distance(side, [0.0; 2]));
    a.min(b)
}
