//! From a configuration to sources, hub and recorder set-ups.

use std::collections::BTreeMap;
use std::path::Path;

use anyhow::{Context as _, anyhow, bail};
use cad_transforms::frame::{Frame, FramePart};
use cad_transforms::rig::Rig;
use cad_transforms::transform::RigidTransform;
use calib::foxglove::CameraInfo;
use calib::stereo::{Eye, StereoCalibration};
use session_archive::manifest;
use session_archive::record::{CameraCalibration, FrameTransform, FrameTransforms, timestamp};
use session_archive::time::HostTime;
use video::{EncoderSettings, discover};

use crate::announce;
use crate::config::{self, Config, SourceConfig};
use crate::hub::{CameraSetup, ImuSetup};
use crate::recorder::Setup;
use crate::sources::device::Device;
use crate::sources::gstreamer::Gstreamer;
use crate::sources::replay::Replay;
use crate::sources::simulated::{Simulated, Walks};
use crate::sources::synthetic::Synthetic;
use crate::sources::{AnySource, Source, SourceInfo, rig_file_name};
use crate::sync::clock::ClockConfig;

/// Everything that a run needs.
pub struct Built {
    /// One source per camera, in the order of the configuration.
    pub sources: Vec<AnySource>,
    /// For the hub.
    pub cameras: Vec<CameraSetup>,
    /// For the recorder.
    pub setup: Setup,
}

impl Built {
    /// Lets scheduled sources begin at `start`; from then on the session's files hold what they know to be true.
    ///
    /// # Errors
    /// Two sources have different truths of one name.
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

/// Opens the sources, finds an encoder for each that can keep up, reads rig and calibrations.
/// Scheduled sources begin at `start`.
///
/// # Errors
/// What cannot be opened, found or read, with the camera's name.
pub fn build(config: &Config, start: HostTime) -> anyhow::Result<Built> {
    build_for(config, start, false)
}

/// As [`build`]; for virtual time the speed of an encoder does not matter, nor may it decide which
/// bytes come out.
pub(super) fn build_for(
    config: &Config,
    start: HostTime,
    virtual_time: bool,
) -> anyhow::Result<Built> {
    video::init()?;
    let rig = read_rig(config.rig.as_deref())?;
    let mut sources = Vec::new();
    let mut elements = BTreeMap::new();
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
    for (camera, source) in config.cameras.iter().zip(&sources) {
        let name = &camera.name;
        let info = source.info().clone();
        let size = (info.camera.width, info.camera.height);
        let element = match elements.get(&(size, info.camera.rate_hz.to_bits())) {
            Some(element) => String::clone(element),
            None => {
                let needed = match virtual_time {
                    true => 0.0,
                    false => needed_speed(config, info.camera.rate_hz),
                };
                announce::step(format_args!("finding an encoder for {}x{}", size.0, size.1));
                let element = choose(config, size, needed).with_context(|| {
                    format!("finding an encoder for {name} ({}x{})", size.0, size.1)
                })?;
                elements.insert((size, info.camera.rate_hz.to_bits()), element.clone());
                element
            }
        };
        let stereo = stereo_calibration(camera, &info, source.calibration())?;
        if let Some(stereo) = &stereo {
            transforms.add_stereo(name, stereo)?;
            setup
                .calibrations
                .extend(calibration_records(name, stereo, start));
        }
        add_rig_files(&mut setup.rig_files, camera, &info, stereo.as_ref())?;
        let (listed, of_hub) = describe(config, camera, &info, &element)?;
        setup.cameras.push(listed);
        if let (Some(imu), Some(of_hub)) = (&info.imu, &of_hub.imu) {
            setup.imus.push(manifest::Imu {
                name: of_hub.name.clone(),
                rate_hz: imu.rate_hz,
                tick: imu.tick,
                source: info.description.clone(),
            });
        }
        cameras.push(of_hub);
    }
    setup.transforms = transforms.into_record();
    Ok(Built {
        sources,
        cameras,
        setup,
    })
}

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
        SourceConfig::Simulated(s) => Box::new(Simulated::open(
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

/// The encoder that was asked for, if it works; or the best that does.
fn choose(config: &Config, (width, height): (u32, u32), needed: f64) -> anyhow::Result<String> {
    let threads = config.encoder.threads;
    let trial = match &config.encoder.element {
        Some(element) => discover::trial_with(element, width, height, threads)
            .with_context(|| format!("{element} was asked for"))?,
        None => discover::best_encoder_at(width, height, threads, needed)?.trial,
    };
    if trial.pictures_per_s < needed {
        log::warn!(
            "{} did {:.0} pictures/s of {width}x{height} in a trial, expected at least {needed:.0}: \
             frames may be dropped",
            trial.element,
            trial.pictures_per_s
        );
    }
    Ok(trial.element)
}

/// Pictures per second that an encoder, tried alone, must reach to serve a camera of this rate beside the
/// others: its share of the processors, and half as much again for everything else.
pub(crate) fn needed_speed(config: &Config, rate_hz: f64) -> f64 {
    let processors = std::thread::available_parallelism().map_or(1, usize::from);
    let of_one = processors.min(config.encoder.threads as usize);
    1.5 * rate_hz * ((config.cameras.len() * of_one) as f64 / processors as f64).max(1.0)
}

/// A camera for the manifest, and for the hub.
fn describe(
    config: &Config,
    camera: &config::Camera,
    info: &SourceInfo,
    element: &str,
) -> anyhow::Result<(manifest::Camera, CameraSetup)> {
    let codec = video::encoder::element_codec(element)
        .ok_or_else(|| anyhow!("{element} is not an encoder that this program can drive"))?;
    let chunk_s = config.session.chunk_ns as f64 * 1e-9;
    let encoder = EncoderSettings {
        element: element.to_owned(),
        width: info.camera.width,
        height: info.camera.height,
        rate_hz: info.camera.rate_hz,
        quality_db: config.encoder.quality_db,
        threads: config.encoder.threads,
        // Key frames are forced at the chunks' boundaries; this only catches what forcing misses.
        max_key_interval_frames: (2.0 * chunk_s * info.camera.rate_hz).ceil().max(1.0) as u32,
    };
    let listed = manifest::Camera {
        name: camera.name.clone(),
        width: info.camera.width,
        height: info.camera.height,
        codec: codec.foxglove_format().to_owned(),
        colour: if info.camera.colour { "yuv420" } else { "grey" }.to_owned(),
        rate_hz: info.camera.rate_hz,
        tick: info.camera.tick,
        trigger: camera.trigger.clone(),
        source: info.description.clone(),
        encoder: format!("{element}, {} dB", config.encoder.quality_db),
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
    Ok((listed, of_hub))
}

/// The calibration file that was named, or what came with the source.
fn stereo_calibration(
    camera: &config::Camera,
    info: &SourceInfo,
    own: Option<&StereoCalibration>,
) -> anyhow::Result<Option<StereoCalibration>> {
    let Some(path) = &camera.calibration else {
        return Ok(own.cloned());
    };
    let (stereo, notes) = calib::read_stereo(path, info.camera.width / 2, info.camera.height)
        .with_context(|| format!("reading the calibration of {}", camera.name))?;
    for note in notes {
        log::warn!("{}: {}", path.display(), note.0);
    }
    Ok(Some(stereo))
}

fn calibration_records(
    camera: &str,
    stereo: &StereoCalibration,
    at: HostTime,
) -> Vec<(String, CameraCalibration)> {
    [("left", Eye::Left), ("right", Eye::Right)]
        .into_iter()
        .map(|(eye, which)| {
            let info = CameraInfo::of(stereo, which);
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
            // The data set's own file named as the calibration too, or the truth about one walk.
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
    std::fs::read(path).with_context(|| format!("reading {}", path.display()))
}

/// The transforms of the session: what the rig file says, and for frames that it does not have,
/// what the calibrations say.
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
