//! The images of a session, decoded: every image, or a run of them.
//!
//! GOPs are independent, so each thread takes the next one and decodes it with its own decoder. An
//! image counts if it is decoded and has the camera's size; its content is not examined. Memory use
//! is one decoded GOP per thread.

use std::ops::Range;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Mutex, PoisonError};
use std::thread;

use anyhow::{Context, Result};
use console_output::Progress;
use session_archive::index::{Access, CameraIndex, FrameEntry, Index};
use session_archive::manifest::Camera;
use session_archive::reader::SessionReader;
use video::{AccessUnit, Codec, DecodeError, Decoder, Picture};

/// Result of decoding one camera.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct DecodeCheck {
    /// The camera.
    pub camera: String,
    /// Images decoded with the expected size.
    pub images: u64,
    /// Access units that gave no image, or one of another size.
    pub missing: u64,
    /// Description of the first such error.
    pub first_problem: Option<String>,
}

/// Decodes all images of a session with up to `threads` threads.
///
/// # Errors
/// An I/O error occurs, or this machine has no decoder for a camera's codec.
pub fn decode_all(
    reader: &SessionReader,
    index: &Index,
    threads: usize,
    progress: &Progress,
) -> Result<Vec<DecodeCheck>> {
    let access = Access::open(&**reader.storage(), index).context("opening the segments")?;
    let cameras = &reader.manifest().cameras;
    let mut all = Vec::new();
    for (camera, frames) in cameras.iter().zip(&index.cameras) {
        let ignore = |_: &FrameEntry, _: &Picture| Ok(());
        let decoded = visit_images(camera, frames, &access, threads, progress, &ignore)?;
        all.push(decoded);
    }
    Ok(all)
}

/// Callback for each correctly decoded image; called from several threads, in no order.
pub type Visit<'a> = &'a (dyn Fn(&FrameEntry, &Picture) -> Result<()> + Sync);

/// Decodes all images of a camera and calls `visit` for each.
///
/// # Errors
/// There is no decoder, or `visit` failed.
pub fn visit_images(
    camera: &Camera,
    index: &CameraIndex,
    access: &Access,
    threads: usize,
    progress: &Progress,
    visit: Visit<'_>,
) -> Result<DecodeCheck> {
    let codec = Codec::from_foxglove_format(&camera.codec).with_context(|| {
        format!(
            "decoding {}: found the codec {:?}, expected h264 or h265",
            camera.name, camera.codec
        )
    })?;
    let groups = groups(index);
    let next = AtomicUsize::new(0);
    let total = Mutex::new((0_u64, 0_u64, None::<(usize, String)>));
    let work = || -> Result<()> {
        let mut decoder = Decoder::new(codec);
        loop {
            let at = next.fetch_add(1, Ordering::Relaxed);
            let Some(group) = groups.get(at) else {
                return Ok(());
            };
            let mut decoding = Group {
                camera,
                index,
                group: group.clone(),
                access,
                visit,
            };
            let (good, problem) = decoding.decode(&mut decoder)?;
            let bytes = index.frames[group.clone()].iter();
            progress.add(bytes.map(|f| u64::from(f.bytes)).sum());
            let mut total = total.lock().unwrap_or_else(PoisonError::into_inner);
            total.0 += good;
            total.1 += group.len() as u64 - good;
            // The first by position, independent of thread timing.
            if let Some(problem) = problem
                && total.2.as_ref().is_none_or(|(first, _)| at < *first)
            {
                total.2 = Some((at, problem));
            }
        }
    };
    let results = thread::scope(|scope| {
        let running: Vec<_> = (0..threads.clamp(1, groups.len().max(1)))
            .map(|_| scope.spawn(work))
            .collect();
        let joined = running.into_iter().map(|thread| match thread.join() {
            Ok(result) => result,
            Err(panic) => std::panic::resume_unwind(panic),
        });
        joined.collect::<Result<Vec<()>>>()
    });
    results.with_context(|| format!("decoding {}", camera.name))?;
    let (images, missing, problem) = total.into_inner().unwrap_or_else(PoisonError::into_inner);
    let mut first_problem = problem.map(|(_, text)| text);
    if index.undecodable > 0 {
        first_problem.get_or_insert_with(|| "the key frame before it is missing".to_owned());
    }
    Ok(DecodeCheck {
        camera: camera.name.clone(),
        images,
        missing: missing + index.undecodable,
        first_problem,
    })
}

/// The GOPs of a camera, as ranges of frame positions.
fn groups(index: &CameraIndex) -> Vec<Range<usize>> {
    let mut groups = Vec::new();
    let mut at = 0;
    while at < index.frames.len() {
        let group = index.gop(at);
        at = group.end.max(at + 1);
        groups.push(group);
    }
    groups
}

/// One GOP.
struct Group<'a> {
    camera: &'a Camera,
    index: &'a CameraIndex,
    group: Range<usize>,
    access: &'a Access,
    visit: Visit<'a>,
}

impl Group<'_> {
    /// Number of correctly decoded images, and the first error. Only what affects all GOPs is
    /// returned as `Err`.
    fn decode(&mut self, decoder: &mut Decoder) -> Result<(u64, Option<String>)> {
        let units = match read_units(self.index, self.group.clone(), self.access) {
            Ok(units) => units,
            Err(problem) => return Ok((0, Some(problem))),
        };
        let (images, mut problem) = match decoder.decode(&units) {
            Ok(images) => (images, None),
            Err(e @ (DecodeError::NoDecoder { .. } | DecodeError::Init(_))) => return Err(e.into()),
            Err(DecodeError::Incomplete {
                pictures: images,
                missing,
            }) => {
                let name = self.name(missing.first().copied().unwrap_or(0));
                (images, Some(format!("{name} gave no image")))
            }
            Err(e) => {
                let name = self.name(0);
                (Vec::new(), Some(format!("the group of {name}: {e}")))
            }
        };
        let camera = self.camera;
        let mut good = 0;
        for (at, image) in &images {
            if (image.width, image.height) == (camera.width, camera.height) {
                if let Some(frame) = self.frame(*at) {
                    (self.visit)(frame, image)?;
                    good += 1;
                }
                continue;
            }
            problem.get_or_insert_with(|| {
                format!(
                    "{} is {}x{} pixels, expected {}x{}",
                    self.name(*at),
                    image.width,
                    image.height,
                    camera.width,
                    camera.height
                )
            });
        }
        Ok((good, problem))
    }

    /// The frame with this decoder timestamp.
    fn frame(&self, at_ns: i64) -> Option<&FrameEntry> {
        let position = usize::try_from(at_ns / FRAME_NS).ok()?;
        self.index.frames[self.group.clone()].get(position)
    }

    fn name(&self, at_ns: i64) -> String {
        let frame = self.frame(at_ns);
        frame.map_or("a frame".to_owned(), |f| format!("frame {}", f.number))
    }
}

/// Decodes the images of a run of frames, with the frames that they depend on, and calls `visit`
/// for each in order. Images that cannot be decoded are left out.
///
/// # Errors
/// There is no decoder.
pub fn visit_run(
    camera: &Camera,
    index: &CameraIndex,
    access: &Access,
    run: Range<usize>,
    visit: &mut dyn FnMut(&FrameEntry, &Picture),
) -> Result<()> {
    let codec = Codec::from_foxglove_format(&camera.codec)
        .with_context(|| format!("decoding {}: the codec {:?}", camera.name, camera.codec))?;
    let mut decoder = Decoder::new(codec);
    let mut at = run.start;
    while at < run.end.min(index.frames.len()) {
        let group = index.gop(at);
        let end = group.end.min(run.end).max(at + 1);
        let images = match read_units(index, group.start..end, access) {
            Err(_) => Vec::new(),
            Ok(units) => match decoder.decode(&units) {
                Ok(images)
                | Err(DecodeError::Incomplete {
                    pictures: images, ..
                }) => images,
                Err(e @ (DecodeError::NoDecoder { .. } | DecodeError::Init(_))) => {
                    return Err(e.into());
                }
                Err(_) => Vec::new(),
            },
        };
        for (time, image) in &images {
            let position = usize::try_from(time / FRAME_NS)
                .ok()
                .map(|p| group.start + p);
            let frame = position.filter(|p| *p >= at && *p < end);
            let fits = (image.width, image.height) == (camera.width, camera.height);
            if let Some(frame) = frame.and_then(|p| index.frames.get(p))
                && fits
            {
                visit(frame, image);
            }
        }
        at = end;
    }
    Ok(())
}

/// Decoder timestamps are frame positions times this, ns, so that unreliable times cannot disturb
/// decoding.
const FRAME_NS: i64 = 1_000_000;

/// The verified access units of a run of frames, each with its position in the run (times 1 ms) as
/// timestamp.
fn read_units(
    index: &CameraIndex,
    run: Range<usize>,
    access: &Access,
) -> Result<Vec<AccessUnit>, String> {
    let frames = index.frames[run].iter().zip(0..);
    let units = frames.map(|(frame, i)| {
        let data = access
            .unit(frame)
            .map_err(|e| format!("frame {}: {e}", frame.number))?;
        Ok(AccessUnit {
            pts_ns: i * FRAME_NS,
            data,
            key: i == 0,
        })
    });
    units.collect()
}
