//! Image format of a camera.

use std::sync::Arc;

use session_archive::manifest;
use video::Codec;

use crate::error::SessionError;
use crate::image::Color;

/// What a camera's frames decode to.
#[derive(Debug)]
pub(crate) struct CameraFormat {
    pub(crate) name: Arc<str>,
    pub(crate) codec: Codec,
    pub(crate) color: Color,
    /// Columns of a stereo frame, both eyes.
    pub(crate) width: u32,
    pub(crate) height: u32,
}

impl CameraFormat {
    pub(crate) fn new(camera: &manifest::Camera) -> Result<Self, SessionError> {
        let unknown = |what, found: &str, expected| SessionError::Format {
            camera: camera.name.clone(),
            what,
            found: found.to_owned(),
            expected,
        };
        let color = match camera.colour.as_str() {
            "grey" => Color::Grey,
            "yuv420" => Color::Rgb,
            other => return Err(unknown("colour", other, "grey or yuv420")),
        };
        let codec = Codec::from_foxglove_format(&camera.codec)
            .ok_or_else(|| unknown("codec", &camera.codec, "h264 or h265"))?;
        Ok(Self {
            name: camera.name.as_str().into(),
            codec,
            color,
            width: camera.width,
            height: camera.height,
        })
    }
}
