//! Replay of video files: both eyes side by side in one, or one file for each eye.
//!
//! Contract: frames carry the container's own times as device time, and the first one arrives at
//! the start; a file has no IMU and no date of recording. Images count from 0 in each file: images
//! lost by a camera before the file was written are unknown. Two files are paired by time alone
//! (`pairing`), each time counted from the beginning of its own file; the delay of the right file's
//! beginning is a setting.
//!
//! *Early*: files that cannot be decoded, whose first image has no time, or that differ in size or
//! rate are rejected before anything is recorded. *At a gap*: an image without a time, with a time
//! that does not increase, reported as damaged by its decoder, of another size than the first one
//! or (on the left) without a partner keeps its number and is dropped with the reason; right images
//! without a partner are counted in a notice at the end. *At the end* of one file the other's
//! images are unpaired. *Two files without any pair* when both have ended are unusable: the error
//! contains the times of their images and a remedy. *On failure* in the middle the source is
//! unusable.

use std::path::Path;

use session_archive::time::{HostTime, TickLength};
use video::capture::Eye;
use video::file::FileError;

mod account;
mod error;
mod images;
#[cfg(test)]
mod tests;

pub use self::error::VideoError;

use self::account::Account;
use self::images::{EyeFile, Step};
use super::pairing::limit_ns;
use super::{CameraInfo, Sample, Source, SourceError, SourceInfo};
use crate::config::VideoConfig;
use crate::digest::Digest;
use crate::error_chain::with_causes;

/// Maximum relative difference of the rates of two files. With more they are from different kinds
/// of cameras.
const MAX_RATE_DIFFERENCE: f64 = 0.01;

/// Video files as a source. See the module for the contract.
pub struct VideoReplay {
    name: String,
    info: SourceInfo,
    left: EyeFile,
    right: Option<EyeFile>,
    account: Account,
    ended: bool,
    config: VideoConfig,
}

impl VideoReplay {
    /// Opens the files as camera `name`, the first frame to arrive at `start`.
    ///
    /// # Errors
    /// [`VideoError`], naming the file.
    pub fn open(name: &str, config: &VideoConfig, start: HostTime) -> Result<Self, VideoError> {
        let left = EyeFile::open(&config.path, 0)?;
        let right = config.right_path.as_ref();
        let right = right.map(|path| EyeFile::open(path, config.right_later_ns));
        let right = right.transpose()?;
        let of = left.file.info();
        let rate_hz = of.rate_hz.ok_or_else(|| VideoError::Times {
            path: config.path.clone(),
            found: "neither a rate nor times that rise",
        })?;
        if let (Some(right), Some(path)) = (&right, &config.right_path) {
            check_alike(&left, &right.file.info().clone(), &config.path, path)?;
        }
        let eyes = 1 + u32::from(right.is_some());
        let width = of.width * eyes;
        if !width.is_multiple_of(2) {
            return Err(VideoError::Width {
                path: config.path.clone(),
                width: of.width,
                expected: "an even number, for both eyes side by side (or right_path for the other eye)",
            });
        }
        let limit = |configured_ns| {
            limit_ns(rate_hz, configured_ns).map_err(|what| VideoError::Setting {
                path: config.path.clone(),
                what,
            })
        };
        let within_ns = limit(config.pair_within_ns)?;
        let max_within_ns = limit(None)?;
        let first_ns = left.first_ns(&config.path)?;
        if let (Some(right), Some(path)) = (&right, &config.right_path) {
            right.first_ns(path)?;
        }
        let size = (width, of.height);
        let colour = of.colour || right.as_ref().is_some_and(|r| r.file.info().colour);
        let info = SourceInfo {
            description: describe(config),
            camera: CameraInfo {
                width,
                height: size.1,
                rate_hz,
                tick: TickLength::NANOSECOND,
                tick_bits: None,
                number_bits: None,
                colour,
                still: false,
                stamped: None,
            },
            imu: None,
            calibration_files: Vec::new(),
        };
        Ok(Self {
            name: name.to_owned(),
            info,
            left,
            right,
            account: Account::new(within_ns, max_within_ns, start, first_ns, size),
            ended: false,
            config: config.clone(),
        })
    }

    /// Takes the next image of the file that lags, or of the only one.
    fn step(&mut self) -> Result<(), FileError> {
        let Some(right) = &mut self.right else {
            match self.left.next()? {
                Step::Image(image) => self.account.single(image),
                Step::Bad(number, why) => self.account.bad.push_back((number, why)),
                Step::End => self.ended = true,
            }
            return Ok(());
        };
        let behind = |eye: &EyeFile| (eye.ended, eye.times.newest_ns);
        if behind(&self.left) <= behind(right) {
            match self.left.next()? {
                Step::Image(image) => self.account.push(Eye::Left, image),
                Step::Bad(number, why) => self.account.bad.push_back((number, why)),
                Step::End => {}
            }
        } else {
            match right.next()? {
                Step::Image(image) => self.account.push(Eye::Right, image),
                Step::Bad(..) => self.account.bad_right += 1,
                Step::End => {}
            }
        }
        self.ended = self.left.ended && right.ended;
        Ok(())
    }
}

impl Source for VideoReplay {
    fn info(&self) -> &SourceInfo {
        &self.info
    }

    fn digest(&self) -> Vec<u8> {
        digest_of(&self.config)
    }

    fn next_sample(&mut self) -> Result<Option<Sample>, SourceError> {
        loop {
            if let Some(sample) = self.account.out.pop_front() {
                return Ok(Some(sample));
            }
            if self.ended {
                return match (&self.right, self.account.never_paired()) {
                    (Some(_), Some(what)) => Err(SourceError::Unusable {
                        source_name: self.name.clone(),
                        what,
                    }),
                    _ => Ok(None),
                };
            }
            self.step().map_err(|error| SourceError::Unusable {
                source_name: self.name.clone(),
                what: with_causes(&error),
            })?;
            if self.ended {
                self.account.finish(self.right.is_some());
            }
        }
    }

    fn begin_at(&mut self, start: HostTime) {
        self.account.start = start;
    }
}

/// Rejects two files that cannot be a pair.
fn check_alike(
    left: &EyeFile,
    right: &video::file::FileInfo,
    left_path: &Path,
    right_path: &Path,
) -> Result<(), VideoError> {
    let left = left.file.info();
    let differ = |found: String| {
        Err(VideoError::Differ {
            found,
            left: left_path.to_owned(),
            right: right_path.to_owned(),
        })
    };
    if (left.width, left.height) != (right.width, right.height) {
        return differ(format!(
            "{}x{} and {}x{}",
            left.width, left.height, right.width, right.height
        ));
    }
    if let (Some(a), Some(b)) = (left.rate_hz, right.rate_hz)
        && (a / b - 1.0).abs() > MAX_RATE_DIFFERENCE
    {
        return differ(format!("{a:.2} Hz and {b:.2} Hz"));
    }
    Ok(())
}

fn digest_of(config: &VideoConfig) -> Vec<u8> {
    let mut digest = Digest::new("video");
    digest.value(&(config.right_later_ns, config.pair_within_ns));
    let files = [Some(&config.path), config.right_path.as_ref()];
    for file in files.into_iter().flatten() {
        digest.file(file);
    }
    digest.finish().to_vec()
}

fn describe(config: &VideoConfig) -> String {
    let name = |path: &Path| {
        let name = path.file_name().unwrap_or_default();
        name.display().to_string()
    };
    match &config.right_path {
        Some(right) => format!("video files {} and {}", name(&config.path), name(right)),
        None => format!("video file {}", name(&config.path)),
    }
}
