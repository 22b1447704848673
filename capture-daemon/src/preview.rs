//! Newest image of each camera, for previews.
//!
//! Contract: storing an image costs one reference to it, a few times a second; nothing is copied or
//! compressed for it here, and a reader that holds an image blocks nobody. Pixels in a camera's own
//! buffer are scaled down by GStreamer beside the recording, one at a time and only while somebody
//! watches.

use std::sync::{Mutex, PoisonError};

use bytes::Bytes;
use session_archive::time::{HostTime, NS_PER_S};
use video::preview::{Preview, PreviewSettings};
use video::{NativeFormat, RawImage};

use crate::sources::PreviewPixels;

/// Interval between stored images, ns, in normal operation.
const PERIOD_NS: i64 = NS_PER_S / 4;
/// Interval between stored images, ns, while the machine is overloaded.
const DEGRADED_PERIOD_NS: i64 = 2 * NS_PER_S;
/// Time after the last request after which nobody watches, ns.
const VIEWER_TIMEOUT_NS: i64 = 5 * NS_PER_S;
/// Delay before a failed preview encoder is restarted, if somebody still watches, ns.
const RETRY_NS: i64 = 10 * NS_PER_S;
/// Height of the previews from GStreamer, pixels.
const PREVIEW_HEIGHT_PX: u32 = 180;

/// The newest images.
#[derive(Debug)]
pub struct Previews {
    cameras: Vec<Mutex<CameraPreview>>,
}

/// Newest image of a camera.
#[derive(Clone, Debug)]
pub enum Newest {
    /// As it was recorded.
    Image(RawImage),
    /// A preview as a JPEG file.
    Jpeg(Bytes),
}

#[derive(Debug, Default)]
struct CameraPreview {
    newest: Option<Newest>,
    /// Number of stored images.
    number: u64,
    next: Option<HostTime>,
    /// Time of the last request.
    last_request: Option<HostTime>,
    /// Format of a camera whose pixels are in its own buffers.
    native: Option<NativeFormat>,
    small: Option<Preview>,
    /// Earliest time of the next start.
    retry_at: Option<HostTime>,
}

impl Previews {
    /// Creates it for this number of cameras, without images.
    pub fn new(cameras: usize) -> Self {
        let cameras = (0..cameras).map(|_| Mutex::default()).collect();
        Self { cameras }
    }

    /// Stores an image, if one is due.
    pub fn offer(
        &self,
        camera: usize,
        preview_pixels: PreviewPixels<'_>,
        now: HostTime,
        degraded: bool,
    ) {
        // Readers of the old image may have it a little longer.
        let Some(Ok(mut entry)) = self.cameras.get(camera).map(Mutex::try_lock) else {
            return;
        };
        if entry.next.is_some_and(|next| now < next) {
            return;
        }
        let period = if degraded {
            DEGRADED_PERIOD_NS
        } else {
            PERIOD_NS
        };
        entry.next = Some(now + period);
        match preview_pixels {
            PreviewPixels::Image(image) => {
                entry.number += 1;
                entry.newest = Some(Newest::Image(image.clone()));
            }
            PreviewPixels::Native(frame) => {
                if entry.native.as_ref() != Some(frame.format()) {
                    entry.native = Some(frame.format().clone());
                    end_in_background(entry.small.take());
                }
                if entry
                    .last_request
                    .is_none_or(|at| now.since(at) > VIEWER_TIMEOUT_NS)
                {
                    end_in_background(entry.small.take());
                } else if let Some(small) = &entry.small {
                    small.offer(now.0, frame);
                }
            }
        }
    }

    /// Newest image of a camera and its number, which increases.
    pub fn newest(&self, camera: usize, now: HostTime) -> Option<(u64, Newest)> {
        let entry = self.cameras.get(camera)?;
        let mut entry = entry.lock().unwrap_or_else(PoisonError::into_inner);
        entry.last_request = Some(now);
        entry.update_small(now);
        if let Some(jpeg) = entry.small.as_ref().and_then(Preview::take) {
            entry.number += 1;
            entry.newest = Some(Newest::Jpeg(jpeg.data));
        }
        Some((entry.number, entry.newest.clone()?))
    }
}

impl CameraPreview {
    /// Starts the preview encoder, if it is needed and has not failed recently.
    fn update_small(&mut self, now: HostTime) {
        let Some(format) = &self.native else { return };
        let failure = match &self.small {
            Some(small) => small.failure(),
            None if self.retry_at.is_some_and(|at| now < at) => return,
            None => match Preview::start(&small(format), format) {
                Ok(small) => {
                    self.small = Some(small);
                    return;
                }
                Err(error) => Some(error.to_string()),
            },
        };
        if let Some(failure) = failure {
            log::warn!("encoding previews: {failure}");
            end_in_background(self.small.take());
            self.retry_at = Some(now + RETRY_NS);
        }
    }
}

/// Ends the preview encoder on a thread of its own: a stuck one takes seconds, and frames are
/// waiting.
fn end_in_background(small: Option<Preview>) {
    if let Some(small) = small {
        let ending = std::thread::Builder::new().name("preview-end".to_owned());
        // Without a thread it ends here.
        let _ = ending.spawn(move || drop(small));
    }
}

/// Both eyes, with the aspect ratio of the frame.
fn small(format: &NativeFormat) -> PreviewSettings {
    let width = u64::from(format.width()) * u64::from(PREVIEW_HEIGHT_PX)
        / u64::from(format.height().max(1));
    PreviewSettings {
        width: (width as u32).next_multiple_of(4).clamp(4, 1280),
        height: PREVIEW_HEIGHT_PX,
        rate_hz: NS_PER_S as f64 / PERIOD_NS as f64,
        quality: 60,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn image(level: u8) -> RawImage {
        let format = video::PixelFormat::I420;
        let data = vec![level; format.bytes(4, 2).expect("size")].into();
        RawImage {
            width: 4,
            height: 2,
            format,
            data,
        }
    }

    #[test]
    fn keeps_a_few_images_per_second() {
        let previews = Previews::new(1);
        assert!(previews.newest(0, HostTime(0)).is_none());
        let entry = |at: i64, degraded| {
            let before = previews
                .newest(0, HostTime(0))
                .map_or(0, |(number, _)| number);
            previews.offer(
                0,
                PreviewPixels::Image(&image(at as u8)),
                HostTime(at * 10_000_000),
                degraded,
            );
            previews.newest(0, HostTime(0)).expect("an image").0 > before
        };
        let times: Vec<i64> = (0..100).filter(|at| entry(*at, false)).collect();
        assert_eq!(times, [0, 25, 50, 75]);
        let times: Vec<i64> = (100..500).filter(|at| entry(*at, true)).collect();
        assert_eq!(times, [100, 300]);
        let Some((number, Newest::Image(newest))) = previews.newest(0, HostTime(0)) else {
            panic!("an image");
        };
        assert_eq!((number, newest.data[0]), (6, 300_i64 as u8));
        previews.offer(7, PreviewPixels::Image(&image(0)), HostTime(0), false);
        assert!(previews.newest(7, HostTime(0)).is_none());
    }
}
