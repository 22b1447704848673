//! Encodes images to video, synchronously.

use std::path::PathBuf;
use std::sync::mpsc::{Receiver, RecvTimeoutError, sync_channel};
use std::time::Duration;

use video::encoder::MAX_IN_FLIGHT;
use video::{AccessUnit, Codec, EncodeError, Encoder, EncoderEvent, EncoderSettings, RawImage};
use video::{RawImageError, mp4};

/// A software encoder of GStreamer's common plugins, so that bytes are the same on all machines.
pub(crate) const ELEMENT: &str = "x264enc";
/// Luma PSNR of encoded images, dB.
pub(crate) const QUALITY_DB: f64 = 42.0;
/// Maximum time to encode one image.
const ENCODE_TIMEOUT: Duration = Duration::from_secs(60);

/// Error of encoding video.
#[derive(Debug, thiserror::Error)]
pub enum FilmError {
    /// The encoder did not start or failed: check the installation of GStreamer and its plugins.
    #[error("encoding images")]
    Encode(#[from] EncodeError),
    /// The encoder failed or timed out.
    #[error("encoding images: {0}")]
    Encoder(String),
    /// Unsupported image size.
    #[error("encoding images")]
    RawImage(#[from] RawImageError),
    /// The file could not be written.
    #[error("writing a film to {}", path.display())]
    Write {
        /// Path of the file.
        path: PathBuf,
        /// Cause.
        source: mp4::Mp4Error,
    },
}

/// Encoder that returns each access unit before the next image.
pub(crate) struct Film {
    encoder: Encoder,
    events: Receiver<EncoderEvent>,
}

impl Film {
    /// For images of this size, with at least one key frame in `keys` images.
    pub(crate) fn new(size: [u32; 2], rate_hz: f64, keys: u32) -> Result<Self, FilmError> {
        let settings = EncoderSettings {
            element: ELEMENT.to_owned(),
            width: size[0],
            height: size[1],
            rate_hz,
            quality_db: QUALITY_DB,
            threads: 1,
            max_key_interval_frames: keys.max(1),
            preset: video::encoder::Preset::default(),
        };
        let (sender, events) = sync_channel(MAX_IN_FLIGHT);
        // The receiver no longer exists once the film is dropped.
        let on_output = move |event| drop(sender.send(event));
        let encoder = Encoder::start(&settings, Box::new(on_output))?;
        Ok(Self { encoder, events })
    }

    pub(crate) fn codec(&self) -> Codec {
        self.encoder.codec()
    }

    /// Access unit of an image; timestamps must increase.
    pub(crate) fn encode(
        &mut self,
        time_ns: i64,
        image: &RawImage,
        key: bool,
    ) -> Result<AccessUnit, FilmError> {
        self.encoder.push(time_ns, image, key)?;
        match self.events.recv_timeout(ENCODE_TIMEOUT) {
            Ok(EncoderEvent::AccessUnit(unit)) => Ok(unit),
            Ok(EncoderEvent::Failed(reason)) => Err(FilmError::Encoder(reason)),
            Err(RecvTimeoutError::Timeout | RecvTimeoutError::Disconnected) => {
                Err(FilmError::Encoder(format!("{ELEMENT} returned nothing")))
            }
        }
    }
}
