//! Replay of recorded data sets.
//!
//! Contract: sample `k` arrives at `start` plus its distance from the data set's first image, to
//! the nanosecond, and its device ticks are the data set's own timestamps, so that ticks and
//! arrival have one constant offset. Values are those of the data set, never converted; each stream
//! counts from 0, and a number that the data set skips remains skipped, as a lost frame.
//!
//! *Early*: [`Replay::open`] reads every list and the header of every image, so that an unusable
//! data set is rejected before anything is recorded; images are decoded when they are due. *Order*:
//! by arrival; of an IMU sample and an image of the same instant the IMU sample comes first. *At
//! the end* of the images there are no more images, or, with `repeat`, they start again with
//! continuing numbers and ticks; the first comes one nominal period after the last. *IMU* samples
//! run once, from the first image's instant to their own end, and are not repeated: joined at the
//! seam they would be a motion that never happened. So images may continue without an IMU, and an
//! IMU without images. *On failure* the source is unusable, with the file in the message.

use std::path::{Path, PathBuf};

use calibration_files::CalibError;
use camera_models::StereoCalibration;
use session_archive::time::{HostTime, TickLength};
use video::{RawImage, RawImageError};

use crate::digest::Digest;
use crate::error_chain::with_causes;

use super::datasets::{self, DatasetError, DatasetKind, ImuSample, Samples, StereoDataset};
use super::{
    CameraInfo, FrameArrival, ImuInfo, ImuValues, RawFrame, RawImu, Sample, Source, SourceError,
    SourceInfo,
};

pub(super) mod stereo_image;

use stereo_image::EyeSize;

/// Maximum size of all decoded images together for which repeated images stay decoded, bytes.
const MAX_CACHE_BYTES: usize = 256 << 20;

/// Error of replaying a data set. A retry will not help.
#[derive(Debug, thiserror::Error)]
pub enum ReplayError {
    /// The data set itself cannot be read.
    #[error(transparent)]
    Dataset(#[from] DatasetError),
    /// A camera has one image size: replay the others as data sets of their own.
    #[error(
        "replaying images: found {}x{}, expected {}x{} like the first one: {}",
        found.0, found.1, expected.0, expected.1, path.display()
    )]
    Size {
        /// The image.
        path: PathBuf,
        /// Its width and height.
        found: (u32, u32),
        /// Width and height of the first left image.
        expected: (u32, u32),
    },
    /// The image cannot be converted to an encoder's input.
    #[error("converting an image: {}", path.display())]
    Convert {
        /// The image.
        path: PathBuf,
        /// The conversion error.
        source: RawImageError,
    },
    /// The timestamps cannot be times on one clock: correct them.
    #[error("replaying a data set: its stamps run from {first_ns} ns to {last_ns} ns, expected less than a century: {}", path.display())]
    Span {
        /// The data set.
        path: PathBuf,
        /// First timestamp.
        first_ns: i64,
        /// Last timestamp.
        last_ns: i64,
    },
    /// A listed calibration file cannot be read: check its permissions.
    #[error("reading a calibration file: {}", path.display())]
    CalibrationFile {
        /// The file.
        path: PathBuf,
        /// The system's error.
        source: std::io::Error,
    },
}

/// A data set as a source. See the module for the contract.
pub struct Replay {
    name: String,
    info: SourceInfo,
    dataset: StereoDataset,
    /// An error if it is for images of another size.
    calibration: Result<Option<StereoCalibration>, CalibError>,
    start: HostTime,
    repeat: bool,
    eye: EyeSize,
    /// Number of frames delivered, over all rounds.
    frames_out: u64,
    /// Number of IMU samples delivered.
    imu_out: usize,
    /// Whether frames are decoded, or only counted.
    pixels_needed: bool,
    /// Decoded images by position in the data set; empty if they are not kept.
    cache: Vec<Option<RawImage>>,
}

impl Replay {
    /// Opens the data set in `path` as camera `name`, the first image to arrive at `start`.
    ///
    /// `rate_hz` gives the times of a data set without times. With `repeat` the images start again
    /// after the last one, for ever. `imu` is whether the data set's IMU is replayed too, if it has
    /// one.
    ///
    /// # Errors
    /// [`ReplayError`], naming the file.
    pub fn open(
        name: &str,
        path: &Path,
        rate_hz: Option<f64>,
        repeat: bool,
        imu: bool,
        start: HostTime,
    ) -> Result<Self, ReplayError> {
        Self::of_dataset(name, datasets::open(path, rate_hz)?, repeat, imu, start)
    }

    /// Opens the beginning of each list as if there were no more of it: for a check.
    ///
    /// # Errors
    /// As [`Self::open`], and [`DatasetError::Head`].
    pub fn open_head(
        name: &str,
        path: &Path,
        rate_hz: Option<f64>,
        repeat: bool,
        imu: bool,
    ) -> Result<Self, ReplayError> {
        let dataset = datasets::open_head(path, rate_hz)?;
        Self::of_dataset(name, dataset, repeat, imu, HostTime(0))
    }

    fn of_dataset(
        name: &str,
        mut dataset: StereoDataset,
        repeat: bool,
        imu: bool,
        start: HostTime,
    ) -> Result<Self, ReplayError> {
        let first_ns = dataset.frames[0].device_time_ns;
        let imu_recorded = !dataset.imu.is_empty();
        match imu {
            true => dataset
                .imu
                .retain(|sample| sample.device_time_ns >= first_ns),
            false => dataset.imu.clear(),
        }
        check_span(&dataset)?;
        let (eye, samples) = stereo_image::probe(&dataset.frames)?;

        let (calibration, note) = read_calibration(&dataset, eye);
        dataset.notes.extend(note);
        let imu_info = imu_info(&dataset.imu);
        if imu && imu_info.is_none() {
            dataset.imu.clear();
        }
        if imu && imu_recorded && imu_info.is_none() {
            dataset.notes.push(
                "no IMU is replayed: fewer than two samples from the first image on".to_owned(),
            );
        }
        let info = SourceInfo {
            description: describe(&dataset),
            camera: CameraInfo {
                width: 2 * eye.width,
                height: eye.height,
                rate_hz: dataset.rate_hz,
                tick: TickLength::NANOSECOND,
                tick_bits: None,
                number_bits: None,
                colour: samples == Samples::Rgb8,
                still: dataset.frames.len() == 1,
                stamped: None,
            },
            imu: imu_info,
            calibration_files: calibration_files(name, &dataset)?,
        };
        let kept =
            repeat && dataset.frames.len().saturating_mul(eye.stereo_bytes()) <= MAX_CACHE_BYTES;
        Ok(Self {
            name: name.to_owned(),
            info,
            cache: vec![None; if kept { dataset.frames.len() } else { 0 }],
            dataset,
            calibration,
            start,
            repeat,
            eye,
            frames_out: 0,
            imu_out: 0,
            pixels_needed: true,
        })
    }

    /// Absent and ignored parts of the data set, to be shown.
    pub fn notes(&self) -> &[String] {
        &self.dataset.notes
    }

    /// Whether there is more of it than was read.
    pub fn is_head(&self) -> bool {
        self.dataset.is_head
    }

    /// Position in the data set, round, and distance from the first image in ns, of the next frame.
    fn next_frame(&self) -> Option<(usize, u64, i64)> {
        let frames = &self.dataset.frames;
        let round = self.frames_out / frames.len() as u64;
        let position = (self.frames_out % frames.len() as u64) as usize;
        if round > 0 && !self.repeat {
            return None;
        }
        let (first, last) = (
            frames[0].device_time_ns,
            frames[frames.len() - 1].device_time_ns,
        );
        let period = datasets::time_at(1, self.dataset.rate_hz);
        let round_ns = (last - first).saturating_add(period);
        let before = i64::try_from(round)
            .unwrap_or(i64::MAX)
            .saturating_mul(round_ns);
        let offset = before.saturating_add(frames[position].device_time_ns - first);
        Some((position, round, offset))
    }

    fn frame(
        &mut self,
        position: usize,
        round: u64,
        offset_ns: i64,
    ) -> Result<Sample, SourceError> {
        let frames = &self.dataset.frames;
        let first = &frames[0];
        let numbers = frames[frames.len() - 1].number - first.number + 1;
        let number = round * numbers + frames[position].number - first.number;
        let device_ticks = first.device_time_ns.saturating_add(offset_ns);
        let host_time = self.start + offset_ns;
        if !self.pixels_needed {
            self.frames_out += 1;
            return Ok(Sample::Arrival(FrameArrival {
                number,
                device_ticks,
                host_time,
            }));
        }
        let image = self
            .image(position)
            .map_err(|error| SourceError::Unusable {
                source_name: self.name.clone(),
                what: with_causes(&error),
            })?;
        self.frames_out += 1;
        Ok(Sample::Frame(RawFrame {
            number,
            device_ticks,
            kernel_time: None,
            host_time,
            exposure_ns: None,
            eyes_apart_ns: None,
            image,
        }))
    }

    fn image(&mut self, position: usize) -> Result<RawImage, ReplayError> {
        if let Some(Some(image)) = self.cache.get(position) {
            return Ok(image.clone());
        }
        let image = stereo_image::load(&self.dataset.frames[position], self.eye)?;
        if let Some(kept) = self.cache.get_mut(position) {
            *kept = Some(image.clone());
        }
        Ok(image)
    }
}

impl Source for Replay {
    fn info(&self) -> &SourceInfo {
        &self.info
    }

    fn digest(&self) -> Vec<u8> {
        let mut digest = Digest::new("replay");
        digest.value(&(self.repeat, self.dataset.rate_hz));
        digest.value(&self.dataset.imu);
        for frame in &self.dataset.frames {
            digest.value(&(frame.number, frame.device_time_ns));
            digest.file(&frame.left);
            digest.file(&frame.right);
        }
        digest.finish().to_vec()
    }

    fn next_sample(&mut self) -> Result<Option<Sample>, SourceError> {
        let frame = self.next_frame();
        let first_ns = self.dataset.frames[0].device_time_ns;
        if let Some(imu) = self.dataset.imu.get(self.imu_out).copied() {
            let offset_ns = imu.device_time_ns - first_ns;
            if frame.is_none_or(|(_, _, frame_ns)| offset_ns <= frame_ns) {
                self.imu_out += 1;
                return Ok(Some(Sample::Imu(RawImu {
                    number: self.imu_out as u64 - 1,
                    device_ticks: imu.device_time_ns,
                    host_time: self.start + offset_ns,
                    values: ImuValues::Si {
                        gyro: imu.gyro_rad_s,
                        accel: imu.accel_m_s2,
                    },
                    temperature: None,
                    frame_sync: false,
                })));
            }
        }
        frame
            .map(|(position, round, offset_ns)| self.frame(position, round, offset_ns))
            .transpose()
    }

    fn set_pixels_needed(&mut self, needed: bool) {
        self.pixels_needed = needed;
    }

    fn begin_at(&mut self, start: HostTime) {
        self.start = start;
    }

    fn calibration(&self) -> Result<Option<&StereoCalibration>, &CalibError> {
        self.calibration.as_ref().map(Option::as_ref)
    }
}

/// Differences of timestamps are used all over the replay; this check makes them safe.
fn check_span(dataset: &StereoDataset) -> Result<(), ReplayError> {
    const CENTURY_NS: i64 = 100 * 365 * 86_400 * 1_000_000_000;
    let first_ns = dataset.frames[0].device_time_ns;
    let last_frame = dataset.frames[dataset.frames.len() - 1].device_time_ns;
    let last_ns = dataset
        .imu
        .last()
        .map_or(last_frame, |imu| imu.device_time_ns.max(last_frame));
    match last_ns.checked_sub(first_ns) {
        Some(span) if span < CENTURY_NS => Ok(()),
        _ => Err(ReplayError::Span {
            path: dataset.root.clone(),
            first_ns,
            last_ns,
        }),
    }
}

/// Rate from the median interval; `None` without an interval.
fn imu_info(samples: &[ImuSample]) -> Option<ImuInfo> {
    let mut intervals_ns: Vec<i64> = samples
        .windows(2)
        .map(|pair| pair[1].device_time_ns - pair[0].device_time_ns)
        .collect();
    intervals_ns.sort_unstable();
    let median_ns = intervals_ns.get(intervals_ns.len() / 2)?;
    Some(ImuInfo {
        rate_hz: 1e9 / *median_ns as f64,
        tick: TickLength::NANOSECOND,
        tick_bits: None,
        number_bits: None,
        scale: None,
        temperature_scale_c: None,
    })
}

/// The calibration, or a note on why there is none. The files are recorded unchanged either way, so
/// a calibration that cannot be parsed now is not lost.
///
/// # Errors
/// It is for images of another size: recorded with these images it would be wrong.
fn read_calibration(
    dataset: &StereoDataset,
    eye: EyeSize,
) -> (Result<Option<StereoCalibration>, CalibError>, Vec<String>) {
    if dataset.calibration_files.is_empty() {
        return (
            Ok(None),
            vec!["the data set contains no calibration".to_owned()],
        );
    }
    match calibration_files::read_stereo(&dataset.root, eye.width, eye.height) {
        Ok((calibration, notes)) => (
            Ok(Some(calibration)),
            notes.into_iter().map(|note| note.0).collect(),
        ),
        Err(error @ CalibError::Resolution { .. }) => (Err(error), Vec::new()),
        Err(error) => (
            Ok(None),
            vec![format!(
                "the calibration is not used: {}",
                with_causes(&error)
            )],
        ),
    }
}

/// The files' names in the session and their bytes.
fn calibration_files(
    name: &str,
    dataset: &StereoDataset,
) -> Result<Vec<(String, Vec<u8>)>, ReplayError> {
    let read = |path: &PathBuf| {
        let content = plain_file::read(path, plain_file::TEXT_LIMIT).map_err(|source| {
            ReplayError::CalibrationFile {
                path: path.clone(),
                source,
            }
        })?;
        Ok((super::rig_file_name(name, &dataset.root, path), content))
    };
    dataset.calibration_files.iter().map(read).collect()
}

fn describe(dataset: &StereoDataset) -> String {
    let kind = match dataset.kind {
        DatasetKind::Asl => "ASL folder",
        DatasetKind::Kitti => "KITTI pairs",
        DatasetKind::Folders => "left and right folders",
        DatasetKind::Pair => "one pair",
    };
    let folder = dataset.root.file_name().unwrap_or_default();
    format!("replay of {kind}: {}", folder.display())
}

#[cfg(test)]
mod tests;
