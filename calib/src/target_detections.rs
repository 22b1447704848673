//! Detection of calibration targets in the images of a session.
//!
//! Contract: every image of a frame set is decoded and searched once, on all cores; the result does
//! not depend on their number. Images that cannot be decoded are counted.

use std::collections::BTreeMap;
use std::sync::{Mutex, PoisonError};
use std::thread;

use anyhow::{Context, Result, bail};
use boards::Target as Board;
use calib::cameras::TargetDetection;
use calib::target::{self, ImageView};
use calibration_files::board;
use console_output::Console;
use session_access::decode::visit_images;
use session_archive::index::{Access, FrameEntry, Index};
use session_archive::reader::SessionReader;
use session_archive::verify::rig_file;
use video::RawImage;

/// Configuration of the target detection in all verbs; documents have it as `detection_config`.
pub(crate) fn detection_config() -> target::Config {
    target::Config::default()
}

/// Target detections of a session.
pub(crate) struct DetectedTargets {
    /// Time of each frame set, ns.
    pub(crate) times_ns: Vec<i64>,
    /// Detections; eye `2 n` is the left one of camera `n` of the manifest.
    pub(crate) detections: Vec<TargetDetection>,
    /// Images searched, per eye.
    pub(crate) images: u64,
    /// Images that could not be decoded.
    pub(crate) missing: u64,
}

/// The targets that `files` describe, or else those recorded with the session.
///
/// # Errors
/// A file cannot be read, or the session has no target.
pub(crate) fn targets(reader: &SessionReader, files: &[std::path::PathBuf]) -> Result<Vec<Board>> {
    if !files.is_empty() {
        let read = files.iter().map(|file| board::read(file));
        return Ok(read.collect::<Result<_, _>>()?);
    }
    let mut names: Vec<_> = reader.manifest().rig.iter().collect();
    names.retain(|f| f.name.starts_with("target.") && f.name.ends_with(".toml"));
    names.sort_by(|a, b| a.name.cmp(&b.name));
    let mut boards = Vec::new();
    for file in names {
        let bytes = rig_file(&**reader.storage(), file)
            .with_context(|| format!("reading rig/{} of the session", file.name))?;
        let text = String::from_utf8_lossy(&bytes);
        boards.push(board::parse(&text, std::path::Path::new(&file.name))?);
    }
    if boards.is_empty() {
        bail!(
            "no target: the session has no rig/target.*.toml, so --target FILE is needed; \
             `paws calib targets` writes such files with the boards to print"
        );
    }
    Ok(boards)
}

/// Detects targets in every image of a session.
///
/// # Errors
/// An I/O error occurs, or a codec cannot be decoded here.
pub(crate) fn detect(
    reader: &SessionReader,
    index: &Index,
    boards: &[Board],
    console: &Console<'_>,
) -> Result<DetectedTargets> {
    let access = Access::open(&**reader.storage(), index).context("opening the segments")?;
    let mut detected = DetectedTargets {
        times_ns: index.sets.iter().map(|set| set.time_ns).collect(),
        detections: Vec::new(),
        images: 0,
        missing: 0,
    };
    let threads = thread::available_parallelism().map_or(1, usize::from);
    for (number, (camera, frames)) in reader
        .manifest()
        .cameras
        .iter()
        .zip(&index.cameras)
        .enumerate()
    {
        let mut instants: BTreeMap<u64, usize> = BTreeMap::new();
        for (instant, set) in index.sets.iter().enumerate() {
            if let Some(frame) = set.frames.get(number).copied().flatten() {
                instants.insert(frames.frames[frame as usize].number, instant);
            }
        }
        let bytes = frames.frames.iter().map(|f| u64::from(f.bytes)).sum();
        let progress = console.progress(&format!("detecting targets: {}", camera.name), bytes);
        let found: Mutex<Vec<TargetDetection>> = Mutex::new(Vec::new());
        let config = detection_config();
        let visit = |frame: &FrameEntry, frame_image: &RawImage| {
            let Some(&instant) = instants.get(&frame.number) else {
                return Ok(());
            };
            for (side, view) in halves(frame_image).into_iter().enumerate() {
                let detections = target::detect_all(&view, boards, &config);
                let mut own: Vec<TargetDetection> = detections
                    .into_iter()
                    .enumerate()
                    .filter(|(_, d)| !d.corners.is_empty())
                    .map(|(target, d)| TargetDetection {
                        instant,
                        eye: 2 * number + side,
                        target,
                        corners: d.corners,
                    })
                    .collect();
                found
                    .lock()
                    .unwrap_or_else(PoisonError::into_inner)
                    .append(&mut own);
            }
            Ok(())
        };
        let decoded = visit_images(camera, frames, &access, threads, &progress, &visit)?;
        detected.images += decoded.images;
        detected.missing += decoded.missing;
        detected
            .detections
            .extend(found.into_inner().unwrap_or_else(PoisonError::into_inner));
    }
    detected
        .detections
        .sort_by_key(|s| (s.instant, s.eye, s.target));
    Ok(detected)
}

/// The luma of the left and right half of a side-by-side stereo frame.
pub(crate) fn halves(frame_image: &RawImage) -> Vec<ImageView<'_>> {
    let (width, height) = (frame_image.width as usize, frame_image.height as usize);
    let luma = &frame_image.data[..width * height];
    let half = width / 2;
    [luma, &luma[half..]]
        .into_iter()
        .filter_map(|pixels| ImageView::new(half, height, width, pixels))
        .collect()
}
