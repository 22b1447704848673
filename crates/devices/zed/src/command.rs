//! Commands to the microcontroller, as HID feature reports. Pure.
//!
//! The first byte is the report's number, and goes over the link also where the device's descriptor
//! numbers nothing: hidraw hands feature reports through as they are. Numbers and values:
//! zed-open-capture, `sensorcapture_def.hpp` at 9373915. Never sent to a real device.

/// The feature report that starts and stops the stream and reports its state.
pub const STREAM: u8 = 0x32;
/// The feature report of requests.
pub const REQUEST: u8 = 0x21;
/// The feature report of requests to the video chip.
const VIDEO: u8 = 0x22;

/// Interval in which the device expects [`Command::Ping`], ns. About six missed ones end the
/// stream.
pub(crate) const PING_EVERY_NS: i64 = 1_000_000_000;

/// A command to the microcontroller.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Command {
    /// Send samples.
    Start,
    /// Send no more.
    Stop,
    /// Keep the stream alive.
    Ping,
    /// Restart, and leave the bus meanwhile. For the ZED 2 and 2i.
    Reset,
    /// Let the video chip restart. For the ZED 2 and 2i.
    ResetVideo,
}

impl Command {
    /// The feature report.
    pub const fn report(self) -> &'static [u8] {
        match self {
            Self::Start => &[STREAM, 1],
            Self::Stop => &[STREAM, 0],
            Self::Ping => &[REQUEST, 0xf2],
            Self::Reset => &[REQUEST, 0xe1],
            Self::ResetVideo => &[VIDEO, 0x02, 0x00, 0x00],
        }
    }
}

/// An invalid answer to [`STREAM`].
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("asking whether the IMU streams: found {found:02x?}, expected 32 00 or 32 01")]
pub struct AnswerError {
    /// What came.
    pub found: Vec<u8>,
}

/// Whether the device streams, by its answer to a request for the feature report [`STREAM`].
///
/// # Errors
/// The answer is of another kind.
pub fn is_streaming(answer: &[u8]) -> Result<bool, AnswerError> {
    match answer {
        [STREAM, state @ (0 | 1), ..] => Ok(*state == 1),
        other => Err(AnswerError {
            found: other.to_vec(),
        }),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn commands_are_the_published_bytes() {
        assert_eq!(Command::Start.report(), [0x32, 0x01]);
        assert_eq!(Command::Stop.report(), [0x32, 0x00]);
        assert_eq!(Command::Ping.report(), [0x21, 0xf2]);
        assert_eq!(Command::Reset.report(), [0x21, 0xe1]);
        assert_eq!(Command::ResetVideo.report(), [0x22, 0x02, 0x00, 0x00]);
    }

    #[test]
    fn only_a_plain_answer_counts() {
        assert_eq!(is_streaming(&[0x32, 1]), Ok(true));
        assert_eq!(is_streaming(&[0x32, 0, 0, 0]), Ok(false));
        for found in [&[][..], &[0x32], &[0x32, 2], &[0x21, 1]] {
            assert!(is_streaming(found).is_err());
        }
    }
}
