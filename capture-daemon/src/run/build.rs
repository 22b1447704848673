//! Construction of sources, hub setup and recorder setup from a configuration.

use std::fmt;
use std::path::Path;

use anyhow::{Context as _, anyhow, bail};
use cad_transforms::frame::{Frame, FramePart};
use cad_transforms::rig::Rig;
use cad_transforms::transform::RigidTransform;
use calibration_files::CalibError;
use camera_models::{Eye, ImuCalibration, StereoCalibration, camera_info};
use session_archive::manifest;
use session_archive::record::{CameraCalibration, FrameTransform, FrameTransforms, timestamp};
use session_archive::time::HostTime;
use video::discover::{self, Load};
use video::encoder::Preset;
use video::{Codec, EncoderSettings};

use crate::announce;
use crate::config::{self, Config, SourceConfig};
use crate::error_chain::with_causes;
use crate::hub::{CameraSetup, ImuSetup};
use crate::recorder::Setup;
use crate::sources::bag::Bag;
use crate::sources::device::Device;
use crate::sources::gstreamer::Gstreamer;
use crate::sources::replay::Replay;
#[cfg(feature = "simulator")]
use crate::sources::simulated::SimulatedCamera;
use crate::sources::synthetic::Synthetic;
use crate::sources::video_file::VideoReplay;
use crate::sources::walks::Walks;
use crate::sources::{AnySource, CameraInfo, Source, SourceInfo, rig_file_name};
use crate::sync::clock::ClockConfig;

/// All parts of a run.
pub struct RunParts {
    /// One source per camera, in the order of the configuration.
    pub sources: Vec<AnySource>,
    /// Setup of the hub.
    pub cameras: Vec<CameraSetup>,
    /// Setup of the recorder.
    pub setup: Setup,
}

impl RunParts {
    /// Lets scheduled sources begin at `start`; from then on the session's files contain their
    /// ground truth.
    ///
    /// # Errors
    /// Two sources have different ground truth under one name.
    pub(super) fn begin_at(&mut self, start: HostTime) -> anyhow::Result<()> {
        for source in &mut self.sources {
            if let AnySource::Scheduled(source) = source {
                source.begin_at(start);
                add_files(&mut self.setup.rig_files, source.truth())?;
            }
        }
        Ok(())
    }
}

/// Opens the sources, selects an encoder for them, reads rig and calibrations. Scheduled sources
/// begin at `start`.
///
/// # Errors
/// A part that cannot be opened, found or read, with the camera's name.
pub fn build(config: &Config, start: HostTime) -> anyhow::Result<RunParts> {
    video::init()?;
    let rig = read_rig(config.rig.as_deref())?;
    let mut sources = Vec::new();
    let mut cameras = Vec::new();
    let mut setup = Setup {
        cameras: Vec::new(),
        imus: Vec::new(),
        calibrations: Vec::new(),
        transforms: FrameTransforms::default(),
        rig_files: rig.files,
        chunk_ns: config.session.chunk_ns,
        pre_roll_ns: config.session.pre_roll_ns,
        reserve_bytes: config.disk.reserve_bytes,
        name: config.session.name.clone(),
        software: concat!("pawsd ", env!("CARGO_PKG_VERSION")).to_owned(),
    };
    let mut transforms = Transforms::of(rig.rig.as_ref(), start);
    let mut walks = Walks::default();
    for camera in &config.cameras {
        let name = &camera.name;
        announce::step(format_args!("opening {name}"));
        let source = open(camera, rig.rig.as_ref(), &mut walks, start)
            .with_context(|| format!("opening the source of {name}"))?;
        sources.push(source);
    }
    announce::step("finding an encoder");
    let encoder = choose_encoder(config, sources.iter().map(|s| &s.info().camera))
        .context("finding an encoder for the cameras")?;
    for (camera, source) in config.cameras.iter().zip(&sources) {
        let name = &camera.name;
        let info = source.info().clone();
        let stereo = stereo_calibration(camera, &info, source.calibration())?;
        if let Some(stereo) = &stereo {
            transforms.add_stereo(name, stereo)?;
            setup
                .calibrations
                .extend(calibration_records(name, stereo, start));
        }
        add_rig_files(&mut setup.rig_files, camera, &info, stereo.as_ref())?;
        let (listed, of_hub) = describe(config, camera, &info, &encoder);
        setup.cameras.push(listed);
        if let (Some(imu), Some(of_hub)) = (&info.imu, &of_hub.imu) {
            setup.imus.push(manifest::Imu {
                name: of_hub.name.clone(),
                rate_hz: imu.rate_hz,
                tick: imu.tick,
                source: info.description.clone(),
                noise: stereo
                    .as_ref()
                    .and_then(|stereo| imu_noise(stereo.imu.as_ref()?)),
            });
        }
        cameras.push(of_hub);
    }
    setup.transforms = transforms.into_record();
    Ok(RunParts {
        sources,
        cameras,
        setup,
    })
}

#[cfg_attr(
    not(feature = "simulator"),
    expect(
        unused_variables,
        reason = "only simulated cameras share walks and need the rig"
    )
)]
fn open(
    camera: &config::Camera,
    rig: Option<&Rig>,
    walks: &mut Walks,
    start: HostTime,
) -> anyhow::Result<AnySource> {
    let scheduled: Box<dyn Source> = match &camera.source {
        SourceConfig::Replay(r) => {
            let replay = Replay::open(&camera.name, &r.path, r.rate_hz, r.repeat, r.imu, start)?;
            for note in replay.notes() {
                log::info!("{}: {note}", camera.name);
            }
            Box::new(replay)
        }
        SourceConfig::Bag(b) => {
            let bag = Bag::open(&camera.name, b, start)?;
            for note in bag.notes() {
                log::info!("{}: {note}", camera.name);
            }
            Box::new(bag)
        }
        SourceConfig::Video(v) => Box::new(VideoReplay::open(&camera.name, v, start)?),
        #[cfg(feature = "simulator")]
        SourceConfig::Simulated(s) => Box::new(SimulatedCamera::open(
            &camera.name,
            &s.walk,
            s.faults.as_deref(),
            rig,
            walks,
            start,
        )?),
        SourceConfig::Synthetic(s) => Box::new(Synthetic::new(
            &camera.name,
            s.width,
            s.height,
            s.rate_hz,
            s.imu_rate_hz,
            s.seed,
            start,
        )?),
        SourceConfig::V4l2(config) => return Ok(AnySource::Live(Box::new(Device::new(config)))),
        SourceConfig::Gstreamer(config) => {
            return Ok(AnySource::Live(Box::new(Gstreamer::new(config))));
        }
    };
    Ok(AnySource::Scheduled(scheduled))
}

/// Encoder of all cameras of a run.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct ChosenEncoder {
    /// Luma pixels per second of all cameras together.
    pub(crate) pixels_per_s: f64,
    element: String,
    codec: Codec,
    preset: Preset,
}

impl fmt::Display for ChosenEncoder {
    /// Formats as `x264enc, ultrafast`.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.element)?;
        if self.element == "x264enc" {
            write!(f, ", {}", self.preset.name())?;
        }
        Ok(())
    }
}

/// The configured encoder, if it works, or else the best one that works at every camera's size.
pub(crate) fn choose_encoder<'a>(
    config: &Config,
    cameras: impl Iterator<Item = &'a CameraInfo>,
) -> anyhow::Result<ChosenEncoder> {
    let load = Load {
        cameras: cameras.map(|c| (c.width, c.height, c.rate_hz)).collect(),
        threads: config.encoder.threads,
    };
    if let Some(element) = &config.encoder.element {
        let codec = discover::works(element, &load)
            .with_context(|| format!("trying {element}, which [encoder] names"))?;
        return Ok(ChosenEncoder {
            pixels_per_s: load.pixels_per_s(),
            element: element.clone(),
            codec,
            preset: load.preset(),
        });
    }
    let choice = discover::choose(&load)?;
    Ok(ChosenEncoder {
        pixels_per_s: load.pixels_per_s(),
        element: choice.element,
        codec: choice.codec,
        preset: choice.preset,
    })
}

/// Descriptions of a camera for the manifest and for the hub.
fn describe(
    config: &Config,
    camera: &config::Camera,
    info: &SourceInfo,
    chosen: &ChosenEncoder,
) -> (manifest::Camera, CameraSetup) {
    let chunk_s = config.session.chunk_ns as f64 * 1e-9;
    let encoder = EncoderSettings {
        element: chosen.element.clone(),
        width: info.camera.width,
        height: info.camera.height,
        rate_hz: info.camera.rate_hz,
        quality_db: config.encoder.quality_db,
        threads: config.encoder.threads,
        // Key frames are forced at the chunk boundaries; this only covers missed ones.
        max_key_interval_frames: (2.0 * chunk_s * info.camera.rate_hz).ceil().max(1.0) as u32,
        preset: chosen.preset,
    };
    let listed = manifest::Camera {
        name: camera.name.clone(),
        width: info.camera.width,
        height: info.camera.height,
        codec: chosen.codec.foxglove_format().to_owned(),
        colour: if info.camera.colour { "yuv420" } else { "grey" }.to_owned(),
        rate_hz: info.camera.rate_hz,
        tick: info.camera.tick,
        trigger: camera.trigger.clone(),
        source: info.description.clone(),
        encoder: format!("{chosen}, {} dB", config.encoder.quality_db),
    };
    let clock = |tick, tick_bits, latency_ns, latency_sigma_ns| ClockConfig {
        tick_bits,
        latency_ns,
        latency_sigma_ns,
        ..ClockConfig::new(tick)
    };
    let of_hub = CameraSetup {
        name: camera.name.clone(),
        trigger: camera.trigger.clone(),
        rate_hz: info.camera.rate_hz,
        clock: clock(
            info.camera.tick,
            info.camera.tick_bits,
            camera.latency_ns,
            camera.latency_sigma_ns,
        ),
        number_bits: info.camera.number_bits,
        still: info.camera.still,
        stamped: info.camera.stamped,
        encoder,
        imu: info.imu.clone().map(|imu| ImuSetup {
            name: format!("{}/imu", camera.name),
            clock: clock(
                imu.tick,
                imu.tick_bits,
                camera.imu_latency_ns,
                camera.imu_latency_sigma_ns,
            ),
            number_bits: imu.number_bits,
            info: imu,
        }),
    };
    (listed, of_hub)
}

/// Stereo calibration from the configured file, or else from the source.
///
/// # Errors
/// The file cannot be read, or the calibration is for images of another size than the source's:
/// the session could not be reconstructed.
fn stereo_calibration(
    camera: &config::Camera,
    info: &SourceInfo,
    own: Result<Option<&StereoCalibration>, &CalibError>,
) -> anyhow::Result<Option<StereoCalibration>> {
    let eye = (info.camera.width / 2, info.camera.height);
    let context = || {
        format!(
            "reading the calibration of {} ({}, which delivers images of {}x{} for each eye); to fix \
             it, give `calibration` of [[camera]] a file for images of this size, or let the camera \
             deliver the size of the file",
            camera.name, info.description, eye.0, eye.1
        )
    };
    let Some(path) = &camera.calibration else {
        let own = own.map_err(|error| anyhow!(with_causes(error)));
        return Ok(own.with_context(context)?.cloned());
    };
    let (stereo, notes) =
        calibration_files::read_stereo(path, eye.0, eye.1).with_context(context)?;
    for note in notes {
        log::warn!("{}: {}", path.display(), note.0);
    }
    Ok(Some(stereo))
}

/// The noise of an IMU that its calibration states.
fn imu_noise(imu: &ImuCalibration) -> Option<manifest::ImuNoise> {
    let noise = imu.noise?;
    Some(manifest::ImuNoise {
        gyro_noise_density: noise.gyro_noise_density,
        gyro_random_walk: noise.gyro_random_walk,
        accel_noise_density: noise.accel_noise_density,
        accel_random_walk: noise.accel_random_walk,
    })
}

fn calibration_records(
    camera: &str,
    stereo: &StereoCalibration,
    at: HostTime,
) -> Vec<(String, CameraCalibration)> {
    [("left", Eye::Left), ("right", Eye::Right)]
        .into_iter()
        .map(|(eye, which)| {
            let info = camera_info::CameraInfo::of(stereo, which);
            let frame = format!("{camera}/{eye}");
            let record = CameraCalibration {
                timestamp: Some(timestamp(at)),
                frame_id: frame.clone(),
                width: info.width,
                height: info.height,
                distortion_model: info.distortion_model.to_owned(),
                d: info.d,
                k: info.k.to_vec(),
                r: info.r.to_vec(),
                p: info.p.to_vec(),
            };
            (frame, record)
        })
        .collect()
}

fn add_rig_files(
    files: &mut Vec<(String, Vec<u8>)>,
    camera: &config::Camera,
    info: &SourceInfo,
    stereo: Option<&StereoCalibration>,
) -> anyhow::Result<()> {
    let mut found = info.calibration_files.clone();
    if let (Some(path), Some(stereo)) = (&camera.calibration, stereo) {
        for file in &stereo.provenance.files {
            found.push((rig_file_name(&camera.name, path, file), read(file)?));
        }
    }
    add_files(files, found)
}

fn add_files(
    files: &mut Vec<(String, Vec<u8>)>,
    found: Vec<(String, Vec<u8>)>,
) -> anyhow::Result<()> {
    for (name, content) in found {
        match files.iter().find(|(n, _)| *n == name) {
            // The data set's own file configured as the calibration too, or the ground truth of one
            // walk.
            Some((_, kept)) if *kept == content => {}
            Some(_) => bail!("two different files would be kept as rig/{name}"),
            None => files.push((name, content)),
        }
    }
    Ok(())
}

#[derive(Default)]
struct RigFiles {
    rig: Option<Rig>,
    files: Vec<(String, Vec<u8>)>,
}

fn read_rig(path: Option<&Path>) -> anyhow::Result<RigFiles> {
    let Some(path) = path else {
        return Ok(RigFiles::default());
    };
    let rig = Rig::read(path).context("reading the rig file")?;
    Ok(RigFiles {
        rig: Some(rig),
        files: vec![("rig.toml".to_owned(), read(path)?)],
    })
}

fn read(path: &Path) -> anyhow::Result<Vec<u8>> {
    plain_file::read(path, plain_file::TEXT_LIMIT)
        .with_context(|| format!("reading {}", path.display()))
}

/// Transforms of the session: those of the rig file, and those of the calibrations for frames that
/// it does not contain.
struct Transforms {
    at: HostTime,
    known: Vec<Frame>,
    record: Vec<FrameTransform>,
}

impl Transforms {
    fn of(rig: Option<&Rig>, at: HostTime) -> Self {
        let mut transforms = Self {
            at,
            known: Vec::new(),
            record: Vec::new(),
        };
        for edge in rig.map(Rig::edges).unwrap_or_default() {
            transforms.add(&edge.parent, &edge.child, &edge.parent_from_child);
        }
        transforms
    }

    fn add_stereo(&mut self, camera: &str, stereo: &StereoCalibration) -> anyhow::Result<()> {
        let left = Frame::of_camera(camera, FramePart::Left)?;
        let right = Frame::of_camera(camera, FramePart::Right)?;
        let imu = Frame::of_camera(camera, FramePart::Imu)?;
        if !self.known.contains(&right) {
            self.add(&left, &right, &stereo.right_from_left.inverse());
        }
        if let Some(calibration) = &stereo.imu
            && !self.known.contains(&imu)
        {
            self.add(&left, &imu, &calibration.imu_from_left.inverse());
        }
        Ok(())
    }

    fn add(&mut self, parent: &Frame, child: &Frame, parent_from_child: &RigidTransform) {
        self.known.push(child.clone());
        self.record.push(FrameTransform::placing(
            child.as_str(),
            parent.as_str(),
            parent_from_child.translation_m(),
            parent_from_child.rotation_wxyz(),
            self.at,
        ));
    }

    fn into_record(self) -> FrameTransforms {
        FrameTransforms {
            transforms: self.record,
        }
    }
}
