//! What a driver says of a frame: bytes of the kernel's to numbers. Pure.

use crate::sys;

/// A frame without its image data.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct FrameInfo {
    /// The driver's count of frames since the stream began; wraps at 2^32. Frames that it dropped
    /// count, too.
    pub sequence: u32,
    /// Time stamp, ns on [`clock`](Self::clock). The kernel hands it over in whole microseconds.
    pub time_ns: i64,
    /// Whose clock that is.
    pub clock: Clock,
    /// What it is the time of.
    pub stamped: TimestampSource,
    /// Length of the frame, bytes.
    pub bytes_used: usize,
    /// The driver says that the frame may be damaged.
    pub corrupt: bool,
    /// Shorter than a whole frame, or empty.
    pub short: bool,
}

/// The clock of a time stamp.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Clock {
    /// `CLOCK_MONOTONIC`.
    Monotonic,
    /// Copied from elsewhere, as loopback devices do.
    Copied,
    /// The driver does not say.
    Unknown,
}

/// What a time stamp is the time of.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum TimestampSource {
    /// The last byte of the frame has arrived; also what drivers say that know nothing better.
    EndOfFrame,
    /// The exposure began. By a USB camera's driver this is when the frame's first packet arrived.
    StartOfExposure,
    /// Something newer than this program.
    Other,
}

/// `V4L2_BUF_FLAG_ERROR`.
const ERROR: u32 = 0x40;
/// `V4L2_BUF_FLAG_TIMESTAMP_MASK`.
const CLOCK: u32 = 0xe000;
/// `V4L2_BUF_FLAG_TSTAMP_SRC_MASK`.
const SOURCE: u32 = 0x7_0000;

impl FrameInfo {
    /// `capacity` is the length of the buffer, `expected` that of a whole frame where there is one.
    pub(super) fn of(buffer: &sys::Buffer, capacity: usize, expected: Option<usize>) -> Self {
        // No driver writes more than fits; a larger number is clamped.
        let bytes_used = (buffer.bytes_used as usize).min(capacity);
        Self {
            sequence: buffer.sequence,
            time_ns: buffer
                .seconds
                .saturating_mul(1_000_000_000)
                .saturating_add(buffer.microseconds.saturating_mul(1000)),
            clock: match buffer.flags & CLOCK {
                0x2000 => Clock::Monotonic,
                0x4000 => Clock::Copied,
                _ => Clock::Unknown,
            },
            stamped: match buffer.flags & SOURCE {
                0 => TimestampSource::EndOfFrame,
                0x1_0000 => TimestampSource::StartOfExposure,
                _ => TimestampSource::Other,
            },
            bytes_used,
            corrupt: buffer.flags & ERROR != 0 || buffer.bytes_used as usize > capacity,
            short: bytes_used < expected.unwrap_or(1),
        }
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn buffer(flags: u32, bytes_used: u32) -> sys::Buffer {
        sys::Buffer {
            flags,
            bytes_used,
            sequence: 7,
            seconds: 86_400 * 365,
            microseconds: 999_999,
            ..Default::default()
        }
    }

    #[test]
    fn flags_of_the_kernel() {
        // What vivid and uvcvideo give: mapped, monotonic, start of exposure.
        let info = FrameInfo::of(&buffer(0x1_2001, 100), 100, Some(100));
        assert_eq!(
            info,
            FrameInfo {
                sequence: 7,
                time_ns: 31_536_000_999_999_000,
                clock: Clock::Monotonic,
                stamped: TimestampSource::StartOfExposure,
                bytes_used: 100,
                corrupt: false,
                short: false,
            }
        );
        let info = FrameInfo::of(&buffer(0x4041, 100), 100, Some(100));
        assert_eq!(
            (info.clock, info.stamped, info.corrupt),
            (Clock::Copied, TimestampSource::EndOfFrame, true)
        );
        let info = FrameInfo::of(&buffer(0x2_6000, 100), 100, Some(100));
        assert_eq!(
            (info.clock, info.stamped),
            (Clock::Unknown, TimestampSource::Other)
        );
    }

    #[test]
    fn short_and_too_long() {
        let of = |used, expected| FrameInfo::of(&buffer(0, used), 100, expected);
        assert!(of(99, Some(100)).short);
        assert!(!of(100, Some(100)).short);
        assert!(!of(1, None).short);
        assert!(of(0, None).short);
        let long = of(101, Some(100));
        assert!(long.corrupt && !long.short && long.bytes_used == 100);
    }

    proptest! {
        #[test]
        fn times_are_exact(seconds in 0_i64..9_000_000_000, microseconds in 0_i64..1_000_000) {
            let info = FrameInfo::of(&sys::Buffer { seconds, microseconds, ..Default::default() }, 0, None);
            prop_assert_eq!(info.time_ns.div_euclid(1_000_000_000), seconds);
            prop_assert_eq!(info.time_ns.rem_euclid(1_000_000_000), microseconds * 1000);
        }

        #[test]
        fn no_number_of_a_driver_harms(
            flags: u32, bytes_used: u32, seconds: i64, microseconds: i64, capacity in 0_usize..1000,
        ) {
            let buffer =
                sys::Buffer { flags, bytes_used, seconds, microseconds, ..Default::default() };
            prop_assert!(FrameInfo::of(&buffer, capacity, None).bytes_used <= capacity);
        }
    }
}
