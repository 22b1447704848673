//! Board corners in the images of a stereo camera.

use std::collections::BTreeMap;
use std::sync::{Mutex, PoisonError};

use anyhow::{Context, Result};
use boards::Target as Board;
use calib::camera_imu::{Corner, TargetObservation};
use calib::target::{DetectedCorner, ImageView, detect_all};
use camera_models::Eye;
use console_output::Progress;
use session_access::decode::visit_images;
use session_archive::index::{Access, CameraIndex, FrameEntry};
use session_archive::manifest::Camera;
use video::RawImage as DecodedImage;
use video::raw_image::{i420_to_grey, split};

use crate::target_detections::detection_config;

/// Corners of one board, the one with most detections.
pub(super) struct BoardObservations {
    /// In order of time.
    pub(crate) images: Vec<TargetObservation>,
    /// Position of the board; `None` if none was detected.
    pub(crate) board: Option<usize>,
    /// Images that could not be decoded.
    pub(crate) missing: u64,
}

/// Detected corners by board and eye.
type BoardCorners = Vec<[Vec<DetectedCorner>; 2]>;

/// Detects boards in every `every`-th image.
pub(super) fn find(
    camera: &Camera,
    index: &CameraIndex,
    access: &Access,
    boards: &[Board],
    every: u64,
    threads: usize,
    progress: &Progress,
) -> Result<BoardObservations> {
    // By time: two images of one time would conflict.
    let all: Mutex<BTreeMap<i64, BoardCorners>> = Mutex::new(BTreeMap::new());
    let config = detection_config();
    let detect = |frame: &FrameEntry, image: &DecodedImage| -> Result<()> {
        if !frame.number.is_multiple_of(every) || frame.time_unreliable {
            return Ok(());
        }
        let (left, right) = split(image).context("splitting a stereo frame")?;
        let mut found: BoardCorners = vec![Default::default(); boards.len()];
        for (eye, image) in [left, right].iter().enumerate() {
            let gray = i420_to_grey(image).context("converting an image to gray")?;
            let (width, height) = (gray.width as usize, gray.height as usize);
            let view = ImageView::new(width, height, width, &gray.data)
                .context("an image's size does not match its bytes")?;
            let detected = detect_all(&view, boards, &config);
            for (board, detection) in detected.into_iter().enumerate() {
                found[board][eye] = detection.corners;
            }
        }
        let mut all = all.lock().unwrap_or_else(PoisonError::into_inner);
        all.insert(frame.time_ns, found);
        Ok(())
    };
    let decoded = visit_images(camera, index, access, threads, progress, &detect)?;
    let all = all.into_inner().unwrap_or_else(PoisonError::into_inner);
    let counts = |board: usize| -> usize {
        let of = |found: &BoardCorners| found[board].iter().map(Vec::len).sum::<usize>();
        all.values().map(of).sum()
    };
    let board = (0..boards.len())
        .rev()
        .max_by_key(|&board| counts(board))
        .filter(|&board| counts(board) > 0);
    let corner_positions: BTreeMap<u32, [f64; 2]> = board
        .map(|board| boards[board].corners())
        .unwrap_or_default()
        .into_iter()
        .map(|corner| (corner.id, corner.at_m))
        .collect();
    let images = all
        .into_iter()
        .map(|(time_ns, found)| {
            let eyes = board.map(|board| found[board].clone()).unwrap_or_default();
            let mut corners = Vec::new();
            for (eye, detected) in [Eye::Left, Eye::Right].into_iter().zip(eyes) {
                corners.extend(detected.iter().filter_map(|detected| {
                    let [x, y] = *corner_positions.get(&detected.id)?;
                    Some(Corner {
                        x_in_target: [x, y, 0.0],
                        pixel: detected.pixel,
                        sigma_px: detected.sigma_px.max(MIN_SIGMA_PX),
                        eye,
                    })
                }));
            }
            TargetObservation { time_ns, corners }
        })
        .collect();
    Ok(BoardObservations {
        images,
        board,
        missing: decoded.missing,
    })
}

/// Floor of the corner sigma, px: errors of lens, print and compression, independent of sharpness.
const MIN_SIGMA_PX: f64 = 0.05;
