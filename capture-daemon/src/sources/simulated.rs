//! A simulated walk with the rig: the crate [`rig_sim`] as a source.
//!
//! Contract: frames and IMU samples are those of [`rig_sim::device::Device`], with pixels converted
//! to I420 from the device's layout; the same settings give the same samples. The walk begins at
//! `start`. *If rendering is too slow*, in real time, frames are skipped and reported as dropped by
//! overload. *At the end* of the walk there is nothing more. *Ground truth* is stored with the
//! session: see [`Device::truth`].

use std::path::Path;
use std::sync::Arc;

use cad_transforms::rig::Rig;
use calibration_files::CalibError;
use camera_models::StereoCalibration;
use rig_sim::device::{Delivery, Device, DeviceFrame, DeviceImu};
use rig_sim::faults::{FaultError, Faults};
use rig_sim::rig::PixelFormat;
use rig_sim::simulation::{Settings, Simulation, SimulationError};
use session_archive::record::paws::gap::Cause;
use session_archive::time::HostTime;
use video::raw_image::{nv12_to_i420, yuyv_to_i420};
use video::{RawImage, RawImageError};

use crate::digest::Digest;

use super::walks::Walks;
use super::{
    CameraInfo, DevicePart, Disconnect, DroppedFrame, ImuInfo, ImuValues, RawFrame, RawImu, Sample,
    Source, SourceError, SourceInfo,
};

/// Error of creating the source. A retry will not help.
#[derive(Debug, thiserror::Error)]
pub enum SimulatedError {
    /// The simulation needs a rig: configure its file.
    #[error("simulating {camera}: there is no rig file, expected one with this camera in [rig]")]
    NoRig {
        /// The camera.
        camera: String,
    },
    /// The camera is not in the rig file.
    #[error("simulating {camera}: the rig has no such camera, expected one of {known}")]
    NotOnRig {
        /// The camera.
        camera: String,
        /// The cameras of the rig.
        known: String,
    },
    /// The walk cannot be simulated.
    #[error(transparent)]
    Simulation(#[from] SimulationError),
    /// The faults are invalid.
    #[error("in {path}")]
    Faults {
        /// The file.
        path: String,
        /// The error in it.
        source: FaultError,
    },
    /// The file with faults cannot be read.
    #[error("reading the faults {path}")]
    Read {
        /// The file.
        path: String,
        /// The system's error.
        source: std::io::Error,
    },
}

/// A camera of a simulated rig. See the module.
pub struct SimulatedCamera {
    info: SourceInfo,
    calibration: StereoCalibration,
    device: Device,
    start: HostTime,
    /// Digest of the walk's settings and of the faults.
    digest: Vec<u8>,
}

impl SimulatedCamera {
    /// The camera of this name on a simulated rig in a walk that begins at `start`.
    ///
    /// # Errors
    /// [`SimulatedError`].
    pub fn open(
        name: &str,
        settings: &Settings,
        faults: Option<&Path>,
        rig: Option<&Rig>,
        walks: &mut Walks,
        start: HostTime,
    ) -> Result<Self, SimulatedError> {
        let camera = name.to_owned();
        let rig = rig.ok_or(SimulatedError::NoRig { camera })?;
        let known = rig.cameras();
        if !known.contains(&name) {
            return Err(SimulatedError::NotOnRig {
                camera: name.to_owned(),
                known: known.join(", "),
            });
        }
        let mut digest = Digest::new("simulated");
        digest.value(settings);
        let faults = match faults {
            None => Faults::default(),
            Some(path) => {
                let shown = || path.display().to_string();
                let text =
                    plain_file::read_to_string(path, plain_file::TEXT_LIMIT).map_err(|source| {
                        SimulatedError::Read {
                            path: shown(),
                            source,
                        }
                    })?;
                digest.bytes(text.as_bytes());
                let parsed = Faults::parse(&text, &known, settings.seed);
                parsed.map_err(|source| SimulatedError::Faults {
                    path: shown(),
                    source,
                })?
            }
        };
        let walk = walks.with(settings, rig, &faults.of_wearer())?;
        let position = walk.cameras().iter().position(|c| c.name == name);
        let position = position.expect("a simulation has the cameras of its rig");
        let device = Device::rendered(&walk, position, faults.of(name));
        Ok(Self {
            digest: digest.finish().to_vec(),
            ..Self::of_device(&walk, position, device, start)
        })
    }

    /// A device of a walk, by the position of its camera.
    pub fn of_device(
        walk: &Arc<Simulation>,
        position: usize,
        device: Device,
        start: HostTime,
    ) -> Self {
        let settings = walk.settings();
        let imu = walk.imus()[position].imu.model();
        let [camera_clock, imu_clock] = device.clocks();
        let info = SourceInfo {
            description: format!(
                "simulated {}, {}, {}, seed {}",
                walk.cameras()[position].name,
                settings.kind.name(),
                settings.lighting.name(),
                settings.seed
            ),
            camera: CameraInfo {
                width: 2 * settings.width,
                height: settings.height,
                rate_hz: settings.rate_hz,
                tick: camera_clock.tick(),
                tick_bits: camera_clock.tick_bits(),
                number_bits: None,
                colour: true,
                still: false,
                stamped: None,
            },
            imu: Some(ImuInfo {
                rate_hz: imu.rate_hz,
                tick: imu_clock.tick(),
                tick_bits: imu_clock.tick_bits(),
                number_bits: None,
                scale: Some((imu.count[0], imu.count[1])),
                temperature_scale_c: Some(0.01),
            }),
            calibration_files: Vec::new(),
        };
        Self {
            info,
            calibration: walk.calibration(position),
            device,
            start,
            digest: Vec::new(),
        }
    }

    fn frame(&self, frame: &DeviceFrame) -> Result<RawFrame, RawImageError> {
        Ok(RawFrame {
            number: frame.number,
            device_ticks: frame.ticks,
            kernel_time: None,
            host_time: self.start + frame.arrival_ns,
            exposure_ns: Some((frame.image.exposure.seconds * 1e9) as u32),
            eyes_apart_ns: None,
            image: i420(frame)?,
        })
    }

    fn imu(&self, sample: &DeviceImu) -> RawImu {
        RawImu {
            number: sample.number,
            device_ticks: sample.ticks,
            host_time: self.start + sample.arrival_ns,
            values: ImuValues::Counts {
                gyro: sample.gyro.map(i32::from),
                accel: sample.accel.map(i32::from),
            },
            temperature: Some(sample.temperature.into()),
            frame_sync: sample.frame_sync,
        }
    }
}

/// The image as encoders take it, from the device's bytes.
fn i420(frame: &DeviceFrame) -> Result<RawImage, RawImageError> {
    let pixels = frame.image.pixels(frame.format);
    let (width, height) = (frame.image.width as u32, frame.image.height as u32);
    match frame.format {
        PixelFormat::Yuyv => yuyv_to_i420(width, height, &pixels),
        PixelFormat::Nv12 => nv12_to_i420(width, height, &pixels),
    }
}

impl Source for SimulatedCamera {
    fn info(&self) -> &SourceInfo {
        &self.info
    }

    fn digest(&self) -> Vec<u8> {
        self.digest.clone()
    }

    fn next_sample(&mut self) -> Result<Option<Sample>, SourceError> {
        let Some(delivery) = self.device.deliver() else {
            return Ok(None);
        };
        let sample = match delivery {
            Delivery::Imu(sample) => Sample::Imu(self.imu(&sample)),
            Delivery::Disconnected(at_ns) => Sample::Disconnected(Disconnect {
                host_time: self.start + at_ns,
                part: DevicePart::Both,
                detail: "the simulated device was unplugged".to_owned(),
            }),
            Delivery::Frame(frame) => {
                let frame = self.frame(&frame).map_err(|error| SourceError::Unusable {
                    source_name: self.info.description.clone(),
                    what: error.to_string(),
                })?;
                Sample::Frame(frame)
            }
        };
        Ok(Some(sample))
    }

    fn begin_at(&mut self, start: HostTime) {
        self.start = start;
    }

    fn skip_overdue(&mut self, now: HostTime) -> Vec<DroppedFrame> {
        let skipped = self.device.skip_frames_to(now - self.start);
        let lost = skipped.into_iter().map(|number| DroppedFrame {
            number,
            host_time: now,
            cause: Cause::MachineOverload,
            detail: "the machine is too slow to render them in time".to_owned(),
        });
        lost.collect()
    }

    fn truth(&self) -> Vec<(String, Vec<u8>)> {
        let files = self.device.truth(self.start.ns()).into_iter();
        files
            .map(|(name, text)| (name, text.into_bytes()))
            .collect()
    }

    fn calibration(&self) -> Result<Option<&StereoCalibration>, &CalibError> {
        Ok(Some(&self.calibration))
    }
}

#[cfg(test)]
mod tests {
    use rig_sim::camera::Quality;
    use rig_sim::scene::{Kind, Lighting};
    use session_archive::time::NS_PER_S;

    use super::*;

    const START: HostTime = HostTime(5 * NS_PER_S);
    const RIG: &str = include_str!("../../../cad-transforms/rigs/example.toml");

    /// The number of the next frame.
    fn next_frame(source: &mut SimulatedCamera) -> Option<u64> {
        while let Some(sample) = source.next_sample().expect("a sample") {
            if let Sample::Frame(frame) = sample {
                return Some(frame.number);
            }
        }
        None
    }

    /// Frames that cannot be rendered in time are dropped by the machine, not by the device, and
    /// each number is reported exactly once.
    #[test]
    fn frames_rendered_too_late_are_dropped_as_overload_in_order() {
        let settings = Settings {
            kind: Kind::Corridor,
            lighting: Lighting::Day,
            seed: 1,
            seconds: 1.5,
            rate_hz: 10.0,
            width: 32,
            height: 32,
            quality: Quality::FAST,
        };
        let rig = Rig::parse(RIG).expect("a rig");
        let mut walks = Walks::default();
        let source = SimulatedCamera::open("feet", &settings, None, Some(&rig), &mut walks, START);
        let mut source = source.expect("a source");
        assert_eq!(next_frame(&mut source), Some(0));

        // Frames are captured in the middle of each tenth of a second.
        let now = START + NS_PER_S;
        let lost = source.skip_overdue(now);
        let numbers: Vec<u64> = lost.iter().map(|lost| lost.number).collect();
        assert_eq!(numbers, (1..=9).collect::<Vec<u64>>());
        for one in &lost {
            assert_eq!((one.cause, one.host_time), (Cause::MachineOverload, now));
            assert!(one.detail.contains("the machine is too slow"), "{one:?}");
        }
        assert_eq!(source.skip_overdue(now), [], "they are lost once");
        for number in 10..15 {
            assert_eq!(next_frame(&mut source), Some(number));
        }
        assert_eq!(next_frame(&mut source), None);
    }
}
