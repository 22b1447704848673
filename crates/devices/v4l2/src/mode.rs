//! What cameras offer and are set to: formats, sizes, intervals. Pure.

use std::cmp::Ordering;
use std::fmt;
use std::str::FromStr;

/// A pixel format by its four characters, `YUYV` for example.
#[derive(Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct Fourcc(pub [u8; 4]);

impl Fourcc {
    /// As the kernel writes it.
    pub fn code(self) -> u32 {
        u32::from_le_bytes(self.0)
    }

    /// From the kernel's number.
    pub fn from_code(code: u32) -> Self {
        Self(code.to_le_bytes())
    }

    /// Bits per pixel where every frame has the same number of bytes; none for compressed and for
    /// unknown formats.
    pub fn bits_per_pixel(self) -> Option<u32> {
        self.planes().map(|(all, _)| all)
    }

    /// Bits per pixel of all planes, and of the first one, whose line length the driver tells.
    /// From the kernel's pages on packed, semi-planar and planar formats.
    fn planes(self) -> Option<(u32, u32)> {
        Some(match &self.0 {
            b"YUYV" | b"YVYU" | b"UYVY" | b"VYUY" | b"RGBP" | b"RGBR" => (16, 16),
            b"GREY" | b"RGGB" | b"GRBG" | b"GBRG" | b"BA81" => (8, 8),
            b"Y10 " | b"Y12 " | b"Y16 " => (16, 16),
            b"RG10" | b"BA10" | b"GB10" | b"BG10" | b"RG12" | b"BA12" | b"GB12" | b"BG12" => {
                (16, 16)
            }
            b"NV12" | b"NV21" | b"YU12" | b"YV12" => (12, 8),
            b"NV16" | b"NV61" | b"422P" => (16, 8),
            b"RGB3" | b"BGR3" => (24, 24),
            b"XR24" | b"BX24" | b"AR24" | b"BA24" | b"RX24" | b"XB24" => (32, 32),
            _ => return None,
        })
    }
}

impl fmt::Display for Fourcc {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        // The highest bit marks the big-endian variant of a format.
        let [a, b, c, d] = self.0;
        for byte in [a, b, c, d & 0x7f] {
            let shown = if byte.is_ascii_graphic() || byte == b' ' {
                char::from(byte)
            } else {
                '?'
            };
            write!(f, "{shown}")?;
        }
        if d & 0x80 != 0 {
            write!(f, "-BE")?;
        }
        Ok(())
    }
}

impl fmt::Debug for Fourcc {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "Fourcc({self})")
    }
}

/// A text that is no pixel format.
#[derive(Debug, thiserror::Error, PartialEq, Eq)]
#[error("a pixel format has one to four ASCII characters, like YUYV; found {found:?}")]
pub struct NoFourcc {
    found: String,
}

impl FromStr for Fourcc {
    type Err = NoFourcc;

    fn from_str(text: &str) -> Result<Self, NoFourcc> {
        let bytes = text.as_bytes();
        if bytes.is_empty() || bytes.len() > 4 || !bytes.iter().all(|b| (b' '..=b'~').contains(b)) {
            return Err(NoFourcc { found: text.into() });
        }
        let mut code = [b' '; 4];
        code[..bytes.len()].copy_from_slice(bytes);
        Ok(Self(code))
    }
}

/// Time from one frame to the next, as a fraction of seconds. Equal ones are written equally;
/// [`is_about`](Self::is_about) compares the rates.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Interval {
    /// Seconds times the denominator.
    pub numerator: u32,
    /// 0 only in an undefined interval.
    pub denominator: u32,
}

impl Interval {
    /// The interval for this frame rate, frames per second.
    pub fn of_rate(rate_hz: u32) -> Self {
        Self {
            numerator: 1,
            denominator: rate_hz,
        }
    }

    /// Frames per second, for people and for budgets; 0 where the interval is undefined.
    pub fn rate_hz(self) -> f64 {
        if self.numerator == 0 {
            return 0.0;
        }
        f64::from(self.denominator) / f64::from(self.numerator)
    }

    /// Whether the rates are the same to 1/2000. Drivers count in microseconds or in units of 100
    /// ns, so 1/30 comes back as 333333/10000000; 29.97 against 30 is 1/1000 and is another rate.
    pub fn is_about(self, other: Self) -> bool {
        let a = u64::from(self.numerator) * u64::from(other.denominator);
        let b = u64::from(other.numerator) * u64::from(self.denominator);
        a != 0 && b != 0 && u128::from(a.abs_diff(b)) * 2000 <= u128::from(b)
    }

    fn is_between(self, least: Self, greatest: Self) -> bool {
        let cmp = |a: Self, b: Self| {
            (u64::from(a.numerator) * u64::from(b.denominator))
                .cmp(&(u64::from(b.numerator) * u64::from(a.denominator)))
        };
        cmp(self, least) != Ordering::Less && cmp(self, greatest) != Ordering::Greater
    }
}

impl fmt::Display for Interval {
    /// As a rate.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let rate = self.rate_hz();
        if (rate - rate.round()).abs() < 0.0005 {
            write!(f, "{rate:.0} fps")
        } else {
            write!(f, "{rate:.3} fps")
        }
    }
}

/// The mode requested of a camera.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Mode {
    /// Pixel format.
    pub fourcc: Fourcc,
    /// Pixels.
    pub width: u32,
    /// Pixels.
    pub height: u32,
    /// Time per frame.
    pub interval: Interval,
}

impl fmt::Display for Mode {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self {
            fourcc,
            width,
            height,
            interval,
        } = self;
        write!(f, "{width}x{height} {fourcc} at {interval}")
    }
}

/// What a camera is set to, read back from it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Format {
    /// Pixel format.
    pub fourcc: Fourcc,
    /// Pixels.
    pub width: u32,
    /// Pixels.
    pub height: u32,
    /// Distance of two lines of the first plane in bytes; 0 where it is undefined.
    pub bytes_per_line: u32,
    /// Size of a buffer that holds any frame, bytes.
    pub size_image: u32,
    /// Time per frame, where the driver knows it.
    pub interval: Option<Interval>,
}

impl Format {
    /// Bytes of a whole frame; none where frames differ (compressed) or the format is unknown.
    pub fn image_bytes(&self) -> Option<usize> {
        let (all, first) = self.fourcc.planes()?;
        let line = match u128::from(self.bytes_per_line) {
            0 => u128::from(self.width) * u128::from(first) / 8,
            stride => stride,
        };
        let bytes = line * u128::from(self.height) * u128::from(all) / u128::from(first);
        // What does not fit into the driver's own buffer is not what it means.
        let bytes = bytes.min(self.size_image.into());
        usize::try_from(bytes).ok()
    }
}

impl fmt::Display for Format {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}x{} {}", self.width, self.height, self.fourcc)?;
        match self.interval {
            Some(interval) => write!(f, " at {interval}"),
            None => write!(f, " at a rate that the driver does not tell"),
        }
    }
}

/// Sizes of a pixel format.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Sizes {
    /// This one.
    Discrete {
        /// Pixels.
        width: u32,
        /// Pixels.
        height: u32,
    },
    /// All of these. Continuous sizes have steps of 1.
    Stepwise {
        /// Least, greatest, step, pixels.
        width: [u32; 3],
        /// Least, greatest, step, pixels.
        height: [u32; 3],
    },
}

impl Sizes {
    fn has(&self, w: u32, h: u32) -> bool {
        let within = |[least, greatest, step]: [u32; 3], value: u32| {
            (least..=greatest).contains(&value) && (value - least).is_multiple_of(step.max(1))
        };
        match *self {
            Self::Discrete { width, height } => (width, height) == (w, h),
            Self::Stepwise { width, height } => within(width, w) && within(height, h),
        }
    }
}

impl fmt::Display for Sizes {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Discrete { width, height } => write!(f, "{width}x{height}"),
            Self::Stepwise {
                width: [w0, w1, ws],
                height: [h0, h1, hs],
            } => write!(f, "{w0}x{h0} to {w1}x{h1} in steps of {ws}x{hs}"),
        }
    }
}

/// Intervals of a size.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Intervals {
    /// This one.
    Discrete(Interval),
    /// All between these.
    Range {
        /// Fastest.
        least: Interval,
        /// Slowest.
        greatest: Interval,
        /// `None` where they are continuous.
        step: Option<Interval>,
    },
}

impl Intervals {
    /// Steps are not looked at: drivers round to the next one, and what came of it is read back.
    fn has(&self, interval: Interval) -> bool {
        match *self {
            Self::Discrete(one) => interval.is_about(one),
            Self::Range {
                least, greatest, ..
            } => {
                interval.is_between(least, greatest)
                    || interval.is_about(least)
                    || interval.is_about(greatest)
            }
        }
    }
}

impl fmt::Display for Intervals {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Discrete(one) => one.fmt(f),
            Self::Range {
                least, greatest, ..
            } => write!(f, "{greatest} to {least}"),
        }
    }
}

/// Sizes with their intervals.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct SizeModes {
    /// Sizes.
    pub sizes: Sizes,
    /// Intervals; of the largest size where there are several. Empty where the driver does not
    /// tell.
    pub intervals: Vec<Intervals>,
}

/// A pixel format with its sizes.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Modes {
    /// Pixel format.
    pub fourcc: Fourcc,
    /// The driver's name of it.
    pub description: String,
    /// Frames differ in length.
    pub compressed: bool,
    /// Converted by software, not by the device.
    pub emulated: bool,
    /// Empty where the driver does not tell.
    pub sizes: Vec<SizeModes>,
}

impl Modes {
    /// Whether the camera says that it can do this. What the driver does not tell is taken to be
    /// possible: setting the mode decides.
    pub fn offers(&self, mode: &Mode) -> bool {
        let size = |s: &SizeModes| {
            s.sizes.has(mode.width, mode.height)
                && (s.intervals.is_empty()
                    || matches!(s.sizes, Sizes::Stepwise { .. })
                    || s.intervals.iter().any(|i| i.has(mode.interval)))
        };
        self.fourcc == mode.fourcc && (self.sizes.is_empty() || self.sizes.iter().any(size))
    }
}

#[cfg(test)]
mod tests;
