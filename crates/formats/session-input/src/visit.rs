//! All images of a camera, or those of a part of its frames, through a callback.
//!
//! For programs that need no order and no memory of other images: validation, target detection,
//! export. [`crate::session`] gives the same images in order, as values.

use std::ops::Range;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Mutex, PoisonError};
use std::thread;

use session_archive::index::{Access, CameraIndex, FrameEntry};
use session_archive::manifest::Camera;
use video::raw_image::without_padding;
use video::{Codec, DecodeError, Decoder, RawImage};

use crate::gop::{self, Units};

/// Result of decoding one camera.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct DecodedCamera {
    /// The camera.
    pub camera: String,
    /// Images decoded with the expected size.
    pub images: u64,
    /// Access units that gave no image, or one of another size.
    pub missing: u64,
    /// Description of the first such error.
    pub first_problem: Option<String>,
}

/// Why no image of a camera can be decoded.
#[derive(Debug, thiserror::Error)]
pub enum VisitError {
    /// A codec that this program does not know: update it.
    #[error("found the codec {0:?}, expected h264 or h265")]
    Codec(String),
    /// This machine has no decoder for it.
    #[error(transparent)]
    Decoder(DecodeError),
}

/// Callback for each correctly decoded image: its index entry, and both eyes side by side. Called
/// from several threads, in no order.
pub type Visit<'a, E> = &'a (dyn Fn(&FrameEntry, &RawImage) -> Result<(), E> + Sync);

/// Decodes all images of a camera and calls `visit` for each; `progress` is called with the bytes
/// of each GOP.
///
/// GOPs are independent, so each of up to `threads` threads takes the next one and decodes it with
/// its own decoder. An image counts if it is decoded and has the camera's size; its content is not
/// examined. A GOP with bytes that cannot be read is missing as a whole. Memory is one decoded GOP
/// per thread.
///
/// # Errors
/// [`VisitError`], or `visit` failed.
pub fn visit_images<E: From<VisitError> + Send>(
    camera: &Camera,
    index: &CameraIndex,
    access: &Access,
    threads: usize,
    progress: &(dyn Fn(u64) + Sync),
    visit: Visit<'_, E>,
) -> Result<DecodedCamera, E> {
    let codec = codec(camera)?;
    let gops = gops(index);
    let next = AtomicUsize::new(0);
    let total = Mutex::new((0_u64, 0_u64, None::<(usize, String)>));
    let work = || -> Result<(), E> {
        let mut decoder = Decoder::new(codec);
        loop {
            let at = next.fetch_add(1, Ordering::Relaxed);
            let Some(positions) = gops.get(at) else {
                return Ok(());
            };
            let run = Run {
                camera,
                frames: &index.frames[positions.clone()],
            };
            let (good, problem) = run.visit(&mut decoder, access, visit)?;
            progress(run.frames.iter().map(|f| u64::from(f.bytes)).sum());
            let mut total = total.lock().unwrap_or_else(PoisonError::into_inner);
            total.0 += good;
            total.1 += run.frames.len() as u64 - good;
            // The first by position, independent of thread timing.
            if let Some(problem) = problem
                && total.2.as_ref().is_none_or(|(first, _)| at < *first)
            {
                total.2 = Some((at, problem));
            }
        }
    };
    thread::scope(|scope| {
        let running: Vec<_> = (0..threads.clamp(1, gops.len().max(1)))
            .map(|_| scope.spawn(work))
            .collect();
        let joined = running.into_iter().map(|thread| match thread.join() {
            Ok(result) => result,
            Err(panic) => std::panic::resume_unwind(panic),
        });
        joined.collect::<Result<Vec<()>, E>>()
    })?;
    let (images, missing, problem) = total.into_inner().unwrap_or_else(PoisonError::into_inner);
    let mut first_problem = problem.map(|(_, text)| text);
    if index.undecodable > 0 {
        first_problem.get_or_insert_with(|| "the key frame before it is missing".to_owned());
    }
    Ok(DecodedCamera {
        camera: camera.name.clone(),
        images,
        missing: missing + index.undecodable,
        first_problem,
    })
}

/// Decodes the images of a run of frames, with the frames that they depend on, and calls `visit`
/// for each in order. Images that cannot be decoded are left out.
///
/// # Errors
/// [`VisitError`].
pub fn visit_run(
    camera: &Camera,
    index: &CameraIndex,
    access: &Access,
    run: Range<usize>,
    visit: &mut dyn FnMut(&FrameEntry, &RawImage),
) -> Result<(), VisitError> {
    let mut decoder = Decoder::new(codec(camera)?);
    let mut at = run.start;
    while at < run.end.min(index.frames.len()) {
        let gop = index.gop(at);
        let end = gop.end.min(run.end).max(at + 1);
        let frames = &index.frames[gop.start..end];
        let images = match gop::read_units(access, frames) {
            Units {
                unread: Some(_), ..
            } => Vec::new(),
            Units { units, .. } => match decoder.decode(&units) {
                Ok(images) | Err(DecodeError::Incomplete { images, .. }) => images,
                Err(e @ (DecodeError::NoDecoder { .. } | DecodeError::Init(_))) => {
                    return Err(VisitError::Decoder(e));
                }
                Err(_) => Vec::new(),
            },
        };
        for (pts_ns, image) in &images {
            let position = gop::position(*pts_ns).filter(|p| gop.start + p >= at);
            if let Some(frame) = position.and_then(|p| frames.get(p))
                && let Some(image) = without_padding(image, camera.width, camera.height)
            {
                visit(frame, &image);
            }
        }
        at = end;
    }
    Ok(())
}

fn codec(camera: &Camera) -> Result<Codec, VisitError> {
    Codec::from_foxglove_format(&camera.codec)
        .ok_or_else(|| VisitError::Codec(camera.codec.clone()))
}

/// The GOPs of a camera, as ranges of frame positions.
fn gops(index: &CameraIndex) -> Vec<Range<usize>> {
    let mut gops = Vec::new();
    let mut at = 0;
    while at < index.frames.len() {
        let gop = index.gop(at);
        at = gop.end.max(at + 1);
        gops.push(gop);
    }
    gops
}

/// One GOP.
struct Run<'a> {
    camera: &'a Camera,
    frames: &'a [FrameEntry],
}

impl Run<'_> {
    /// Number of correctly decoded images, and the first error. Only what affects all GOPs is
    /// returned as `Err`.
    fn visit<E: From<VisitError>>(
        &self,
        decoder: &mut Decoder,
        access: &Access,
        visit: Visit<'_, E>,
    ) -> Result<(u64, Option<String>), E> {
        let units = match gop::read_units(access, self.frames) {
            Units {
                units,
                unread: Some(error),
            } => {
                let frame = self.frames[units.len()].number;
                return Ok((0, Some(format!("frame {frame}: {error}"))));
            }
            Units { units, .. } => units,
        };
        let (images, mut problem) = match decoder.decode(&units) {
            Ok(images) => (images, None),
            Err(e @ (DecodeError::NoDecoder { .. } | DecodeError::Init(_))) => {
                return Err(VisitError::Decoder(e).into());
            }
            Err(DecodeError::Incomplete { images, missing }) => {
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
        for (pts_ns, image) in &images {
            if let Some(image) = without_padding(image, camera.width, camera.height) {
                if let Some(frame) = self.frame(*pts_ns) {
                    visit(frame, &image)?;
                    good += 1;
                }
                continue;
            }
            problem.get_or_insert_with(|| {
                format!(
                    "{} is {}x{} pixels, expected {}x{}",
                    self.name(*pts_ns),
                    image.width,
                    image.height,
                    camera.width,
                    camera.height
                )
            });
        }
        Ok((good, problem))
    }

    /// The frame with this decoder time.
    fn frame(&self, pts_ns: i64) -> Option<&FrameEntry> {
        self.frames.get(gop::position(pts_ns)?)
    }

    fn name(&self, pts_ns: i64) -> String {
        let frame = self.frame(pts_ns);
        frame.map_or("a frame".to_owned(), |f| format!("frame {}", f.number))
    }
}
