//! Formats, sizes and intervals: what there are, and setting one.

use rustix::io::Errno;

use super::{Camera, CameraError};
use crate::mode::{Format, Fourcc, Interval, Intervals, Mode, Modes, SizeModes, Sizes};
use crate::sys;

/// Maximum number of entries of a list: a driver that lists more would never end.
const MOST: u32 = 4096;

impl Camera {
    /// Everything that the camera offers.
    ///
    /// # Errors
    /// [`Gone`](CameraError::Gone) or [`Io`](CameraError::Io).
    pub fn modes(&self) -> Result<Vec<Modes>, CameraError> {
        let mut all = Vec::new();
        for index in 0..MOST {
            let mut raw = sys::FormatDescription {
                index,
                kind: sys::CAPTURE,
                ..Default::default()
            };
            if !self.listed("listing the formats", sys::next_format(self.fd(), &mut raw))? {
                break;
            }
            let fourcc = Fourcc::from_code(raw.pixel_format);
            all.push(Modes {
                fourcc,
                description: sys::text(&raw.description),
                compressed: raw.flags & sys::FORMAT_COMPRESSED != 0,
                emulated: raw.flags & sys::FORMAT_EMULATED != 0,
                sizes: self.sizes(fourcc)?,
            });
        }
        Ok(all)
    }

    fn sizes(&self, fourcc: Fourcc) -> Result<Vec<SizeModes>, CameraError> {
        let mut all = Vec::new();
        for index in 0..MOST {
            let mut raw = sys::FrameSize {
                index,
                pixel_format: fourcc.code(),
                ..Default::default()
            };
            if !self.listed("listing the sizes", sys::next_size(self.fd(), &mut raw))? {
                break;
            }
            let [a, b, c, d, e, f] = raw.size;
            let discrete = raw.kind == sys::DISCRETE;
            let (sizes, width, height) = if discrete {
                let (width, height) = (a, b);
                (Sizes::Discrete { width, height }, width, height)
            } else {
                // Continuous sizes are reported with steps of 1.
                let (width, height) = ([a, b, c.max(1)], [d, e, f.max(1)]);
                (Sizes::Stepwise { width, height }, b, e)
            };
            all.push(SizeModes {
                sizes,
                intervals: self.intervals(fourcc, width, height)?,
            });
            if !discrete {
                break;
            }
        }
        Ok(all)
    }

    /// The intervals that the camera offers at one size; empty where it does not tell.
    ///
    /// # Errors
    /// [`Gone`](CameraError::Gone) or [`Io`](CameraError::Io).
    pub fn intervals(
        &self,
        fourcc: Fourcc,
        width: u32,
        height: u32,
    ) -> Result<Vec<Intervals>, CameraError> {
        let mut all = Vec::new();
        for index in 0..MOST {
            let mut raw = sys::FrameInterval {
                index,
                pixel_format: fourcc.code(),
                width,
                height,
                ..Default::default()
            };
            let result = sys::next_interval(self.fd(), &mut raw);
            if !self.listed("listing the rates", result)? {
                break;
            }
            let [least, greatest, step] = raw.interval.map(interval);
            if raw.kind == sys::DISCRETE {
                all.push(Intervals::Discrete(least));
            } else {
                all.push(Intervals::Range {
                    least,
                    greatest,
                    // Continuous: the step is 1/1 by the kernel's page, which is no step of a rate.
                    step: (raw.kind == STEPWISE).then_some(step),
                });
                break;
            }
        }
        Ok(all)
    }

    /// What it is set to.
    ///
    /// # Errors
    /// [`Gone`](CameraError::Gone) or [`Io`](CameraError::Io).
    pub fn format(&self) -> Result<Format, CameraError> {
        let mut format = sys::Format {
            kind: sys::CAPTURE,
            ..Default::default()
        };
        sys::get_format(self.fd(), &mut format).map_err(self.failed("reading the format"))?;
        let pix = format.pix;
        Ok(Format {
            fourcc: Fourcc::from_code(pix.pixel_format),
            width: pix.width,
            height: pix.height,
            bytes_per_line: pix.bytes_per_line,
            size_image: pix.size_image,
            interval: self.interval()?,
        })
    }

    /// Sets format, size and rate, and reads all back.
    ///
    /// # Errors
    /// [`Refused`](CameraError::Refused) when the camera gives something else, to which it then is
    /// set; [`Busy`](CameraError::Busy) while anyone streams from it, this program included;
    /// [`Gone`](CameraError::Gone) or [`Io`](CameraError::Io).
    pub fn set_mode(&self, mode: &Mode) -> Result<Format, CameraError> {
        let mut format = sys::Format {
            kind: sys::CAPTURE,
            ..Default::default()
        };
        format.pix.width = mode.width;
        format.pix.height = mode.height;
        format.pix.pixel_format = mode.fourcc.code();
        format.pix.field = sys::PROGRESSIVE;
        match sys::set_format(self.fd(), &mut format) {
            // Drivers should offer another format instead, but some refuse.
            Err(Errno::INVAL) => {
                return Err(CameraError::Refused {
                    asked: mode.to_string(),
                    given: "no such format".into(),
                    path: self.path().to_owned(),
                });
            }
            result => result.map_err(self.failed("setting the format"))?,
        }
        let mut parameters = sys::StreamParameters {
            kind: sys::CAPTURE,
            time_per_frame: [mode.interval.numerator, mode.interval.denominator],
            ..Default::default()
        };
        match sys::set_parameters(self.fd(), &mut parameters) {
            // No rate can be set; the present one is read below.
            Err(Errno::NOTTY) => {}
            result => result.map_err(self.failed("setting the rate"))?,
        }
        let format = self.format()?;
        // A driver that does not tell the rate cannot be held to it.
        let rate = format.interval.is_none_or(|i| i.is_about(mode.interval));
        if (format.fourcc, format.width, format.height) == (mode.fourcc, mode.width, mode.height)
            && rate
        {
            return Ok(format);
        }
        Err(CameraError::Refused {
            asked: mode.to_string(),
            given: format.to_string(),
            path: self.path().to_owned(),
        })
    }

    fn interval(&self) -> Result<Option<Interval>, CameraError> {
        let mut parameters = sys::StreamParameters {
            kind: sys::CAPTURE,
            ..Default::default()
        };
        match sys::get_parameters(self.fd(), &mut parameters) {
            Err(Errno::NOTTY | Errno::INVAL) => return Ok(None),
            result => result.map_err(self.failed("reading the rate"))?,
        }
        let [numerator, denominator] = parameters.time_per_frame;
        let has_rate = parameters.capability & sys::PARM_TIME_PER_FRAME != 0
            && numerator != 0
            && denominator != 0;
        Ok(has_rate.then_some(Interval {
            numerator,
            denominator,
        }))
    }

    /// Whether there was one more; false at the end, and where the driver does not list such
    /// things.
    pub(super) fn listed(
        &self,
        doing: &'static str,
        result: Result<(), Errno>,
    ) -> Result<bool, CameraError> {
        match result {
            Ok(()) => Ok(true),
            Err(Errno::INVAL | Errno::NOTTY | Errno::NODATA) => Ok(false),
            Err(errno) => Err(self.failed(doing)(errno)),
        }
    }
}

/// `V4L2_FRMIVAL_TYPE_STEPWISE`.
const STEPWISE: u32 = 3;

fn interval([numerator, denominator]: [u32; 2]) -> Interval {
    Interval {
        numerator,
        denominator,
    }
}
