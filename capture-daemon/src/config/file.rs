//! The keys of the configuration file, their ranges and their defaults.

use std::collections::BTreeMap;
use std::ops::RangeInclusive;
use std::path::Path;

use cad_transforms::frame::{MAX_CAMERA_NAME, is_camera_name};
use session_archive::text::{MAX_NOTE, check_note};
use toml::de::DeTable;
use video::encoder::known_elements;

use super::section::{Log, Section, nearest};
use super::{
    Camera, Config, Control, DEFAULT_SOCKET, Disk, Encoder, Problems, ReplayConfig, Session,
    SourceConfig, SyntheticConfig,
};
use super::{device, operator, recorded};

/// Maximum length of a Unix socket path, bytes: `sun_path` of unix(7) less the terminating zero.
const MAX_SOCKET_PATH: usize = 107;
/// Maximum plausible latency, ms.
const MAX_LATENCY_MS: f64 = 1000.0;
/// Maximum camera rate, frames per second.
pub(super) const MAX_RATE_HZ: f64 = 1000.0;
/// Maximum IMU rate, samples per second.
pub(super) const MAX_IMU_RATE_HZ: f64 = 10_000.0;

pub(super) fn parse(text: &str, folder: &Path) -> Result<Config, Problems> {
    let log = Log::new(text);
    let (document, errors) = DeTable::parse_recoverable(text);
    for error in &errors {
        log.add(
            error.span().map_or(0, |span| span.start),
            format!("not TOML: {}", error.message()),
        );
    }
    // Values read from a broken document may not be the intended ones.
    let config = if errors.is_empty() {
        config(Section::root(document.get_ref(), &log), folder)
    } else {
        None
    };
    let problems = log.into_problems();
    config
        .filter(|_| problems.is_empty())
        .ok_or(Problems(problems))
}

/// Returns `None` only with a reported problem.
fn config(mut root: Section<'_>, folder: &Path) -> Option<Config> {
    let session = session(root.section("session", "[session]"), folder);
    let disk = disk(root.section("disk", "[disk]"));
    let encoder = encoder(root.section("encoder", "[encoder]"));
    let control = control(root.section("control", "[control]"), folder);
    let operator = operator::operator(root.section("operator", "[operator]"));
    let page = operator::page(root.section("page", "[page]"), folder);
    let mut rig_section = root.section("rig", "[rig]");
    let rig = rig_section.path("file", folder);
    rig_section.finish();
    root.must_have("camera", "a table [[camera]] for each camera");
    let cameras = cameras(root.sections("camera", "[[camera]]"), folder);
    root.finish();
    Some(Config {
        session,
        disk,
        encoder,
        control,
        operator,
        page,
        rig,
        cameras: cameras?,
    })
}

fn session(mut section: Section<'_>, folder: &Path) -> Session {
    let expected = format!("one line without control characters, at most {MAX_NOTE} bytes");
    let is_name = |name: &str| check_note(name).is_ok();
    let session = Session {
        out: section.path("out", folder),
        name: section.text("name", &expected, is_name).unwrap_or_default(),
        chunk_ns: section.integer("chunk_ms", 100..=1000).unwrap_or(500) * 1_000_000,
        pre_roll_ns: ns(1e9, section.number("pre_roll_s", 0.0..=60.0).unwrap_or(0.0)),
    };
    section.finish();
    session
}

fn disk(mut section: Section<'_>) -> Disk {
    let reserve_gb = section.number("reserve_gb", 0.0..=100_000.0).unwrap_or(1.0);
    section.finish();
    Disk {
        reserve_bytes: (reserve_gb * 1e9).round() as u64,
    }
}

fn encoder(mut section: Section<'_>) -> Encoder {
    let elements: Vec<&str> = known_elements().collect();
    let expected = format!("\"auto\" or one of {}", elements.join(", "));
    let is_known = |element: &str| element == "auto" || elements.contains(&element);
    let encoder = Encoder {
        element: section
            .text("element", &expected, is_known)
            .filter(|element| element != "auto"),
        quality_db: section.number("quality_db", 30.0..=55.0).unwrap_or(42.0),
        threads: section.integer("threads", 1..=16).unwrap_or(1) as u32,
    };
    section.finish();
    encoder
}

fn control(mut section: Section<'_>, folder: &Path) -> Control {
    let socket = section
        .path("socket", folder)
        .unwrap_or_else(|| DEFAULT_SOCKET.into());
    let length = socket.as_os_str().len();
    if length > MAX_SOCKET_PATH {
        section.refuse(
            "socket",
            format_args!("is a path of {length} bytes, expected at most {MAX_SOCKET_PATH}"),
        );
    }
    section.finish();
    Control { socket }
}

fn cameras(sections: Vec<Section<'_>>, folder: &Path) -> Option<Vec<Camera>> {
    let mut cameras = Vec::new();
    let mut first_with: BTreeMap<String, usize> = BTreeMap::new();
    let mut complete = true;
    for (i, mut section) in sections.into_iter().enumerate() {
        let camera = camera(&mut section, folder, i);
        if let Some(name) = camera.as_ref().map(|camera| camera.name.clone())
            && let Some(first) = first_with.insert(name.clone(), i)
        {
            let reason = format!(
                "is {name:?} like that of camera {}, expected a name of its own",
                first + 1
            );
            section.refuse("name", reason);
        }
        section.finish();
        complete &= camera.is_some();
        cameras.extend(camera);
    }
    complete.then_some(cameras)
}

fn camera(section: &mut Section<'_>, folder: &Path, position: usize) -> Option<Camera> {
    let a_name = format!(
        "a name of a-z, 0-9 and _, first a letter, at most {MAX_CAMERA_NAME} long, not rig or world"
    );
    section.must_have("name", &a_name);
    section.must_have("source", "a table [camera.source] with a kind");
    let name = section.text("name", &a_name, is_camera_name);
    let trigger = section.text("trigger", &a_name, is_camera_name);
    let calibration = section.path("calibration", folder);
    let mut ms = |key, default| {
        ns(
            1e6,
            section.number(key, 0.0..=MAX_LATENCY_MS).unwrap_or(default),
        )
    };
    let (latency_ns, latency_sigma_ns) = (ms("latency_ms", 0.0), ms("latency_sigma_ms", 1.0));
    let (imu_latency_ns, imu_latency_sigma_ns) =
        (ms("imu_latency_ms", 0.0), ms("imu_latency_sigma_ms", 1.0));
    let source = source(
        section.section("source", "[camera.source]"),
        folder,
        position,
    );
    if calibration.is_some()
        && source
            .as_ref()
            .is_some_and(SourceConfig::has_nominal_lenses)
    {
        section.refuse(
            "calibration",
            "is given, but a simulated camera has nominal lenses and brings their calibration along",
        );
    }
    Some(Camera {
        name: name?,
        trigger,
        calibration,
        latency_ns,
        latency_sigma_ns: latency_sigma_ns.unsigned_abs(),
        imu_latency_ns,
        imu_latency_sigma_ns: imu_latency_sigma_ns.unsigned_abs(),
        source: source?,
    })
}

fn source(mut section: Section<'_>, folder: &Path, position: usize) -> Option<SourceConfig> {
    let expected = format!(
        "\"zed\" (a ZED Mini over USB), \"v4l2\" (a V4L2 camera), \"gstreamer\" (elements), \
         {}\"replay\" (a recorded data set), \"bag\" (of ROS 2), \"video\" (a file or two) or \
         \"synthetic\" (a generated image sequence)",
        if cfg!(feature = "simulator") {
            "\"sim\" (a simulated walk), "
        } else {
            ""
        }
    );
    section.must_have("kind", &expected);
    let kind = section.text("kind", &expected, |_| true)?;
    let source = match kind.as_str() {
        "replay" => {
            section.must_have("path", "the folder of a data set");
            let path = section.path("path", folder);
            let rate_hz = section.number("rate_hz", 0.01..=MAX_RATE_HZ);
            let repeat = section.flag("repeat").unwrap_or(false);
            let imu = section.flag("imu").unwrap_or(true);
            path.map(|path| {
                SourceConfig::Replay(ReplayConfig {
                    path,
                    rate_hz,
                    repeat,
                    imu,
                })
            })
        }
        "bag" => recorded::bag(&mut section, folder).map(SourceConfig::Bag),
        "video" => recorded::video(&mut section, folder).map(SourceConfig::Video),
        "synthetic" => Some(SourceConfig::Synthetic(synthetic(&mut section, position))),
        #[cfg(feature = "simulator")]
        "sim" => Some(SourceConfig::Simulated(super::simulated::simulated(
            &mut section,
            folder,
        ))),
        // Its other keys are those of the simulator, so they are not checked.
        #[cfg(not(feature = "simulator"))]
        "sim" => {
            section.refuse(
                "kind",
                "is \"sim\", but this program was built without the simulator (the feature \"simulator\" of capture-daemon)",
            );
            return None;
        }
        "v4l2" => device::v4l2(&mut section, folder).map(SourceConfig::V4l2),
        "zed" => device::zed(&mut section).map(SourceConfig::V4l2),
        "gstreamer" => device::gstreamer(&mut section).map(SourceConfig::Gstreamer),
        // Its other keys belong to another kind, so they are not checked.
        unknown => {
            let hint = nearest(
                unknown,
                &[
                    "zed",
                    "v4l2",
                    "gstreamer",
                    #[cfg(feature = "simulator")]
                    "sim",
                    "replay",
                    "bag",
                    "video",
                    "synthetic",
                ],
            );
            section.refuse(
                "kind",
                format_args!("is {unknown:?}, expected {expected}; {hint}"),
            );
            return None;
        }
    };
    section.finish();
    source
}

/// A whole number of pixels that is a multiple of `step`.
pub(super) fn pixels(
    section: &mut Section<'_>,
    key: &'static str,
    range: RangeInclusive<i64>,
    default: i64,
    step: i64,
) -> u32 {
    let pixels = section.integer(key, range).unwrap_or(default);
    if pixels % step != 0 {
        section.refuse(
            key,
            format_args!("is {pixels}, expected a multiple of {step}"),
        );
    }
    pixels as u32
}

/// One of these values, by its name; the first where the key is absent.
pub(super) fn one_of<T: Copy>(
    section: &mut Section<'_>,
    key: &'static str,
    values: &[(&str, T)],
) -> T {
    choice(section, key, values).unwrap_or(values[0].1)
}

/// One of these values, by its name.
pub(super) fn choice<T: Copy>(
    section: &mut Section<'_>,
    key: &'static str,
    values: &[(&str, T)],
) -> Option<T> {
    let names: Vec<String> = values.iter().map(|(name, _)| format!("{name:?}")).collect();
    let expected = format!("one of {}", names.join(", "));
    let is_one = |text: &str| values.iter().any(|(name, _)| *name == text);
    let named = section.text(key, &expected, is_one)?;
    let found = values.iter().find(|(name, _)| *name == named);
    found.map(|(_, value)| *value)
}

/// Default: size and rates of a ZED Mini in its smallest mode.
fn synthetic(section: &mut Section<'_>, position: usize) -> SyntheticConfig {
    let width = pixels(section, "width", 128..=16_384, 1344, 4);
    let height = pixels(section, "height", 32..=8192, 376, 2);
    SyntheticConfig {
        width,
        height,
        rate_hz: section
            .number("rate_hz", 0.01..=MAX_RATE_HZ)
            .unwrap_or(30.0),
        imu_rate_hz: section
            .number("imu_rate_hz", 0.0..=MAX_IMU_RATE_HZ)
            .unwrap_or(400.0),
        // Cameras with identical images are hard to distinguish in a recording.
        seed: section
            .integer("seed", 0..=i64::MAX)
            .map_or(position as u64, i64::unsigned_abs),
    }
}

/// A time given in another unit, of which `unit_ns` is the length. Ranges keep it exact.
pub(super) fn ns(unit_ns: f64, value: f64) -> i64 {
    (value * unit_ns).round() as i64
}
