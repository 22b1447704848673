//! Replay of bags: rosbag2 recordings in MCAP, and MCAP files with ROS 2 messages.
//!
//! Contract: images of `sensor_msgs/Image` or `CompressedImage` and samples of `sensor_msgs/Imu`,
//! each at the time in its header, which is its device time; the recording time is used only for
//! the order. Two topics, one for each eye, are paired by time alone (`pairing`): the frame has the
//! left image's time, and the delay of the right one is recorded with it. Values of samples are
//! those of the message.
//!
//! *Early*: [`Bag::open`] reads the whole bag once, so that unusable data is rejected before
//! anything is recorded: another kind of storage, absent topics, images without times, cameras that
//! do not expose simultaneously, an unsupported encoding. *At a gap*: a left image without a
//! partner, without an increasing time, damaged, or of another size keeps its number and is dropped
//! with the reason; a sample without a usable time keeps its number and is skipped. Right images
//! without a partner are counted in a notice. *At the end* there is no more of either. *On failure*
//! of the disk the source is unusable.

use session_archive::record::paws::gap::Cause;
use session_archive::time::{HostTime, TickLength};

use super::{
    CameraInfo, DevicePart, DroppedFrame, Extent, FrameArrival, ImuInfo, ImuValues, Notice,
    RawFrame, RawImu, Sample, Source, SourceError, SourceInfo,
};
use crate::config::BagConfig;
use crate::digest::Digest;
use crate::error_chain::with_causes;

mod cdr;
mod container;
mod error;
mod image;
mod messages;
mod plan;
mod scan;
mod topics;

pub use cdr::CdrError;
pub use error::BagError;

use container::{Container, RecordLocation};
use image::BagImage;
use messages::Kind;
use plan::{Outcome, Plan, PlannedFrame};

/// rosbag2's other storage, and how to convert it.
const SQLITE: (&str, &str) = (
    "rosbag2's SQLite storage (.db3)",
    "convert it with `ros2 bag convert -i BAG -o convert.yaml`, where convert.yaml has `output_bags: [{uri: OUT, \
     storage_id: mcap, all: true}]`",
);

/// A bag as a source. See the module for the contract.
pub struct Bag {
    name: String,
    info: SourceInfo,
    files: Vec<Container>,
    /// Of the left topic and of the right one.
    kinds: [Kind; 2],
    /// Columns and rows of the first frame in the messages; the same for all frames.
    size: (u32, u32),
    plan: Plan,
    notes: Vec<String>,
    /// Notices for the session.
    notices: Vec<String>,
    start: HostTime,
    notices_out: usize,
    frames_out: usize,
    imu_out: usize,
    /// Whether images are read and decoded, or only counted.
    pixels_needed: bool,
    /// The files continue behind the part that was read.
    is_head: bool,
}

impl Bag {
    /// Opens a bag as camera `name`, the first frame to arrive at `start`.
    ///
    /// # Errors
    /// [`BagError`], naming the file.
    pub fn open(name: &str, config: &BagConfig, start: HostTime) -> Result<Self, BagError> {
        let scanned = scan::scan(&config.path, Extent::Whole)?;
        Self::of_scan(name, config, start, scanned)
    }

    /// Opens the beginning of each file as if it were all of the bag: for a check.
    ///
    /// # Errors
    /// [`BagError`], naming the file; [`BagError::Head`] if more of it might suffice.
    pub fn open_head(name: &str, config: &BagConfig) -> Result<Self, BagError> {
        let scanned = scan::scan(&config.path, Extent::Head)?;
        let is_head = scanned.is_head;
        Self::of_scan(name, config, HostTime(0), scanned).map_err(|error| {
            match is_head && error.needs_more_data() {
                true => BagError::Head {
                    source: Box::new(error),
                },
                false => error,
            }
        })
    }

    fn of_scan(
        name: &str,
        config: &BagConfig,
        start: HostTime,
        scanned: scan::Bag,
    ) -> Result<Self, BagError> {
        let path = config.path.as_path();
        let scan::Bag {
            mut files,
            streams,
            mut notes,
            is_head,
        } = scanned;
        let chosen = topics::choose(config, path, &streams)?;
        let plan = plan::plan(path, &streams, &chosen, config.pair_within_ns)?;
        let left = &streams[chosen.left];
        let kinds = [left.kind, streams[chosen.right.unwrap_or(chosen.left)].kind];
        let fail = |what: String| BagError::Image {
            path: path.to_owned(),
            topic: left.topic.clone(),
            what,
        };
        let first = plan.frames.iter().find_map(|planned| match &planned.what {
            Outcome::Frame { left, right } => Some((*left, right.map(|(location, _)| location))),
            Outcome::Dropped(_) => None,
        });
        let (first_left, first_right) = first.ok_or_else(|| fail("there is none".to_owned()))?;
        let image = load(&mut files, kinds, first_left, first_right)?.map_err(fail)?;
        if !image.image.width.is_multiple_of(2) {
            return Err(fail(format!(
                "it is {} wide, expected an even width for both eyes side by side",
                image.image.width
            )));
        }
        let topics = match chosen.right {
            Some(right) => format!("{} and {}", left.topic, streams[right].topic),
            None => left.topic.clone(),
        };
        let folder = path.file_name().unwrap_or_default().display();
        notes.extend(plan.notices.iter().cloned());
        let ns = TickLength::NANOSECOND;
        let info = SourceInfo {
            description: format!("bag {folder}: {topics}"),
            camera: CameraInfo {
                width: image.image.width,
                height: image.image.height,
                rate_hz: plan.rate_hz,
                tick: ns,
                tick_bits: None,
                number_bits: None,
                colour: image.colour,
                still: false,
                stamped: None,
            },
            imu: plan.imu_rate_hz.map(|rate_hz| ImuInfo {
                rate_hz,
                tick: ns,
                tick_bits: None,
                number_bits: None,
                scale: None,
                temperature_scale_c: None,
            }),
            calibration_files: Vec::new(),
        };
        Ok(Self {
            name: name.to_owned(),
            info,
            files,
            kinds,
            size: image.size(),
            notices: plan.apart.iter().chain(&notes).cloned().collect(),
            plan,
            notes,
            start,
            notices_out: 0,
            frames_out: 0,
            imu_out: 0,
            pixels_needed: true,
            is_head,
        })
    }

    /// Tolerable problems of the bag, to be shown.
    pub fn notes(&self) -> &[String] {
        &self.notes
    }

    /// Whether the bag continues behind the part that was read.
    pub fn is_head(&self) -> bool {
        self.is_head
    }

    fn frame(&mut self, position: usize) -> Result<Sample, SourceError> {
        let PlannedFrame {
            number,
            offset_ns,
            ref what,
        } = self.plan.frames[position];
        let host_time = self.start + offset_ns;
        let lost = |detail| {
            Ok(Sample::Dropped(DroppedFrame {
                number,
                host_time,
                cause: Cause::Device,
                detail,
            }))
        };
        let (left, right) = match what {
            Outcome::Frame { left, right } => (*left, *right),
            Outcome::Dropped(why) => return lost(why.clone()),
        };
        let device_ticks = self.plan.first_ns + offset_ns;
        if !self.pixels_needed {
            return Ok(Sample::Arrival(FrameArrival {
                number,
                device_ticks,
                host_time,
            }));
        }
        let locations = (left, right.map(|(location, _)| location));
        let loaded = load(&mut self.files, self.kinds, locations.0, locations.1);
        let loaded = loaded.map_err(|error| SourceError::Unusable {
            source_name: self.name.clone(),
            what: with_causes(&error),
        })?;
        let image = match loaded {
            Ok(image) => image,
            Err(why) => return lost(why),
        };
        let found = image.size();
        if found != self.size {
            return lost(format!(
                "it is {}x{}, expected {}x{} like the first one",
                found.0, found.1, self.size.0, self.size.1
            ));
        }
        Ok(Sample::Frame(RawFrame {
            number,
            device_ticks,
            kernel_time: None,
            host_time,
            exposure_ns: None,
            eyes_apart_ns: right.map(|(_, apart_ns)| apart_ns),
            image: image.image,
        }))
    }
}

/// The stereo frame of these images, or the reason why there is none.
fn load(
    files: &mut [Container],
    [left_kind, right_kind]: [Kind; 2],
    left: (usize, RecordLocation),
    right: Option<(usize, RecordLocation)>,
) -> Result<Result<BagImage, String>, BagError> {
    let mut one = |kind, (file, location): (usize, RecordLocation)| -> Result<_, BagError> {
        Ok(image::decode(kind, &files[file].load(location)?))
    };
    let left = one(left_kind, left)?;
    let Some(right) = right else {
        return Ok(left);
    };
    let right = one(right_kind, right)?.map_err(|why| format!("right image: {why}"));
    Ok(left.and_then(|left| image::join(&left, &right?)))
}

impl Source for Bag {
    fn info(&self) -> &SourceInfo {
        &self.info
    }

    fn digest(&self) -> Vec<u8> {
        let mut digest = Digest::new("bag");
        // Result of the settings.
        digest.value(&(self.kinds, self.plan.first_ns));
        for frame in &self.plan.frames {
            digest.value(frame);
        }
        digest.value(&self.plan.imu);
        for file in &self.files {
            digest.file(file.path());
        }
        digest.finish().to_vec()
    }

    fn next_sample(&mut self) -> Result<Option<Sample>, SourceError> {
        if let Some(text) = self.notices.get(self.notices_out) {
            self.notices_out += 1;
            return Ok(Some(Sample::Notice(Notice {
                host_time: self.start,
                part: DevicePart::Camera,
                text: text.clone(),
            })));
        }
        let frame_ns = self.plan.frames.get(self.frames_out).map(|f| f.offset_ns);
        if let Some(sample) = self.plan.imu.get(self.imu_out).copied() {
            let offset_ns = sample.stamp_ns - self.plan.first_ns;
            if frame_ns.is_none_or(|frame_ns| offset_ns <= frame_ns) {
                self.imu_out += 1;
                return Ok(Some(Sample::Imu(RawImu {
                    number: sample.number,
                    device_ticks: sample.stamp_ns,
                    host_time: self.start + offset_ns,
                    values: ImuValues::Si {
                        gyro: sample.values.gyro_rad_s,
                        accel: sample.values.accel_m_s2,
                    },
                    temperature: None,
                    frame_sync: false,
                })));
            }
        }
        if frame_ns.is_none() {
            return Ok(None);
        }
        self.frames_out += 1;
        self.frame(self.frames_out - 1).map(Some)
    }

    fn set_pixels_needed(&mut self, needed: bool) {
        self.pixels_needed = needed;
    }

    fn begin_at(&mut self, start: HostTime) {
        self.start = start;
    }
}

#[cfg(test)]
mod tests;
