//! Names of coordinate frames.
//!
//! Contract: a [`Frame`] that exists is well formed. It is `world`, `rig`, or one of the three
//! frames of a camera: `NAME/left`, `NAME/right` (optical) and `NAME/imu`. Nothing else is a frame,
//! so a typing mistake ends at the place where the text is read and not as an unconnected frame
//! later.

use std::fmt;
use std::str::FromStr;

use serde::{Deserialize, Serialize};

/// Longest accepted camera name, in bytes. File names and channel topics are built from it.
pub const MAX_CAMERA_NAME: usize = 48;

/// A coordinate frame by name, for example `rig` or `left_shoulder/left`.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(try_from = "String", into = "String")]
pub struct Frame(String);

/// Which of a camera's frames is meant.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum FramePart {
    /// Optical frame of the left image; the camera's reference.
    Left,
    /// Optical frame of the right image.
    Right,
    /// Frame in which the IMU reports.
    Imu,
}

/// Why a text is not the name of a frame.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error(
    "{found:?} is not a frame: expected world, rig, or NAME/left, NAME/right, NAME/imu \
     with NAME of a-z, 0-9 and _ starting with a letter, at most {MAX_CAMERA_NAME} long"
)]
pub struct FrameError {
    /// The text as found.
    pub found: String,
}

impl Frame {
    /// The frame of the rig body.
    pub fn rig() -> Self {
        Self("rig".to_owned())
    }

    /// The gravity-aligned world frame.
    pub fn world() -> Self {
        Self("world".to_owned())
    }

    /// A frame of the camera called `camera`, for example `("feet", FramePart::Left)`.
    ///
    /// # Errors
    /// When `camera` is not a valid camera name.
    pub fn of_camera(camera: &str, part: FramePart) -> Result<Self, FrameError> {
        format!("{camera}/{}", part.as_str()).parse()
    }

    /// The name as written in files and channel names.
    pub fn as_str(&self) -> &str {
        &self.0
    }

    /// Camera name and part, or `None` for `rig` and `world`.
    pub fn camera(&self) -> Option<(&str, FramePart)> {
        let (camera, part) = self.0.split_once('/')?;
        Some((camera, FramePart::parse(part)?))
    }
}

impl FramePart {
    /// The last part of the frame's name.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Left => "left",
            Self::Right => "right",
            Self::Imu => "imu",
        }
    }

    fn parse(text: &str) -> Option<Self> {
        [Self::Left, Self::Right, Self::Imu]
            .into_iter()
            .find(|part| part.as_str() == text)
    }
}

impl FromStr for Frame {
    type Err = FrameError;

    fn from_str(text: &str) -> Result<Self, FrameError> {
        let valid = match text.split_once('/') {
            None => text == "rig" || text == "world",
            Some((camera, part)) => is_camera_name(camera) && FramePart::parse(part).is_some(),
        };
        if valid {
            Ok(Self(text.to_owned()))
        } else {
            Err(FrameError {
                found: text.to_owned(),
            })
        }
    }
}

impl TryFrom<String> for Frame {
    type Error = FrameError;

    fn try_from(text: String) -> Result<Self, FrameError> {
        text.parse()
    }
}

impl From<Frame> for String {
    fn from(frame: Frame) -> Self {
        frame.0
    }
}

impl fmt::Display for Frame {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.0)
    }
}

/// Whether `name` can name a camera: `a-z`, `0-9`, `_`, first a letter, not `rig` or `world`.
pub fn is_camera_name(name: &str) -> bool {
    name.len() <= MAX_CAMERA_NAME
        && name != "rig"
        && name != "world"
        && name.starts_with(|c: char| c.is_ascii_lowercase())
        && name
            .bytes()
            .all(|b| b.is_ascii_lowercase() || b.is_ascii_digit() || b == b'_')
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn accepts_exactly_the_frames_of_the_conventions() {
        for good in [
            "rig",
            "world",
            "feet/left",
            "left_shoulder/right",
            "cam0/imu",
        ] {
            assert_eq!(good.parse::<Frame>().unwrap().as_str(), good);
        }
        for bad in [
            "",
            "/",
            "Rig",
            "feet",
            "feet/",
            "feet/Left",
            "/left",
            "feet/left/",
            "feet/left/x",
            "0cam/left",
            "rig/left",
            "world/imu",
            "fé/left",
            "feet /left",
            "feet/depth",
        ] {
            let error = bad.parse::<Frame>().unwrap_err();
            assert!(
                error
                    .to_string()
                    .starts_with(&format!("{bad:?} is not a frame")),
                "{error}"
            );
        }
        assert!(
            format!("{}/left", "a".repeat(MAX_CAMERA_NAME))
                .parse::<Frame>()
                .is_ok()
        );
        assert!(
            format!("{}/left", "a".repeat(MAX_CAMERA_NAME + 1))
                .parse::<Frame>()
                .is_err()
        );
    }

    #[test]
    fn takes_a_camera_frame_apart() {
        let frame = Frame::of_camera("feet", FramePart::Imu).unwrap();
        assert_eq!(frame.as_str(), "feet/imu");
        assert_eq!(frame.camera(), Some(("feet", FramePart::Imu)));
        assert_eq!(Frame::rig().camera(), None);
        assert!(Frame::of_camera("../feet", FramePart::Left).is_err());
    }
}
