//! Settings of device cameras, and their syntax in the file.

use std::path::{Path, PathBuf};

use session_archive::text::is_plain;

use crate::sources::pairing;

use super::file::{MAX_IMU_RATE_HZ, MAX_RATE_HZ, ns, one_of, pixels};
use super::section::Section;

/// A V4L2 camera with both eyes side by side in its image, or one for each eye.
#[derive(Clone, Debug, PartialEq)]
pub struct V4l2Config {
    /// The device; of two, the one of the left eye.
    pub device: DeviceChoice,
    /// Device of the right eye, if it is a separate one.
    pub right: Option<RightDevice>,
    /// Width of the stereo frame (both eyes), pixels, a multiple of 4.
    pub width: u32,
    /// Height, pixels, even.
    pub height: u32,
    /// Frames per second.
    pub rate_hz: f64,
    /// Layout of the pixels.
    pub format: PixelLayout,
    /// Number of driver buffers.
    pub buffers: u32,
    /// Controls to be written at the start, under the driver's names, and read back.
    pub controls: Vec<(String, i64)>,
    /// The microcontroller with the camera's IMU.
    pub imu: Option<ZedImuConfig>,
}

/// The device of the right eye, in the same mode as that of the left.
#[derive(Clone, Debug, PartialEq)]
pub struct RightDevice {
    /// Which one.
    pub device: DeviceChoice,
    /// Maximum difference of the driver's timestamps of a pair, ns.
    pub within_ns: i64,
}

impl V4l2Config {
    /// The devices, one or two, each with settings of its own.
    pub fn eyes(&self) -> Vec<Self> {
        let Some(right) = &self.right else {
            return vec![self.clone()];
        };
        let eye = |device: &DeviceChoice| Self {
            device: device.clone(),
            right: None,
            width: self.width / 2,
            ..self.clone()
        };
        vec![eye(&self.device), eye(&right.device)]
    }
}

/// Selection of a device.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum DeviceChoice {
    /// By its node.
    Path(PathBuf),
    /// A ZED over USB.
    Zed {
        /// Serial number; `None` selects the only device present.
        serial: Option<String>,
    },
    /// By its USB identifiers.
    Usb {
        /// Vendor.
        vendor: u16,
        /// Product.
        product: u16,
        /// Serial number, if several are connected.
        serial: Option<String>,
    },
}

/// Layout of a video device's pixels.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PixelLayout {
    /// Y U Y V, 4:2:2.
    Yuyv,
    /// Luma, then U and V interleaved, 4:2:0.
    Nv12,
    /// Luma alone.
    Grey,
    /// Motion-JPEG: each image a JPEG file, whose Huffman tables may be left out.
    Mjpeg,
}

impl PixelLayout {
    /// FourCC of the layout.
    pub fn fourcc(self) -> [u8; 4] {
        match self {
            Self::Yuyv => *b"YUYV",
            Self::Nv12 => *b"NV12",
            Self::Grey => *b"GREY",
            Self::Mjpeg => *b"MJPG",
        }
    }
}

/// The microcontroller of a Stereolabs USB camera.
#[derive(Clone, Debug, PartialEq)]
pub struct ZedImuConfig {
    /// Serial number; `None` selects the only device present.
    pub serial: Option<String>,
    /// Nominal samples per second, used until the rate is measured.
    pub rate_hz: f64,
}

/// Cameras behind GStreamer elements.
#[derive(Clone, Debug, PartialEq)]
pub struct GstreamerConfig {
    /// Elements as for gst-launch-1.0, without a sink: of the stereo frame, or of the left eye.
    pub chain: String,
    /// Elements of the right eye, if it is a stream of its own.
    pub right_chain: Option<String>,
    /// Width of the stereo frame (both eyes), pixels, a multiple of 4.
    pub width: u32,
    /// Height, pixels, even.
    pub height: u32,
    /// Frames per second.
    pub rate_hz: f64,
    /// Delay before the start, ns: cameras behind one driver may have to be started one after
    /// another.
    pub start_after_ns: i64,
    /// The microcontroller with the camera's IMU.
    pub imu: Option<ZedImuConfig>,
}

pub(super) fn v4l2(section: &mut Section<'_>, folder: &Path) -> Option<V4l2Config> {
    let left = device(section, folder, ["device", "usb", "usb_serial"], true);
    let right_keys = ["right_device", "right_usb", "right_usb_serial"];
    let right = device(section, folder, right_keys, false);
    let formats = [
        ("YUYV", PixelLayout::Yuyv),
        ("NV12", PixelLayout::Nv12),
        ("GREY", PixelLayout::Grey),
        ("MJPG", PixelLayout::Mjpeg),
    ];
    let rate_hz = rate(section);
    let within_ns = pair_within(section, Some(rate_hz));
    let imu = zed_imu(section, "imu", None);
    match &right {
        None => refuse_without(section, &["pair_within_ms"], "right_device or right_usb"),
        Some(right) if left.as_ref() == Some(right) => section.refuse(
            right_keys[0],
            "is the device of the left eye, too; expected another one",
        ),
        Some(_) if imu.is_some() => section.refuse(
            "imu",
            "is \"zed\", but a pair of two devices has no IMU; expected \"none\"",
        ),
        Some(_) => {}
    }
    let right = right.map(|device| RightDevice {
        device,
        // A rejected limit has been reported.
        within_ns: pairing::limit_ns(rate_hz, within_ns).unwrap_or_default(),
    });
    Some(V4l2Config {
        width: pixels(section, "width", 32..=16_384, 1344, 4),
        height: pixels(section, "height", 16..=8192, 376, 2),
        rate_hz,
        right,
        format: one_of(section, "format", &formats),
        buffers: buffers(section),
        controls: section.section("controls", "controls").integers(),
        imu,
        device: left?,
    })
}

/// Maximum time difference of two images of a pair, ns; checked against the rate if that is known.
pub(super) fn pair_within(section: &mut Section<'_>, rate_hz: Option<f64>) -> Option<i64> {
    let within_ms = section.number("pair_within_ms", 0.001..=1000.0)?;
    let within_ns = ns(1e6, within_ms);
    if let Some(Err(what)) = rate_hz.map(|rate_hz| pairing::limit_ns(rate_hz, Some(within_ns))) {
        section.refuse(
            "pair_within_ms",
            format_args!("does not fit the rate: {what}"),
        );
    }
    Some(within_ns)
}

/// A ZED Mini is a video device and a microcontroller with the IMU.
pub(super) fn zed(section: &mut Section<'_>) -> Option<V4l2Config> {
    let serial = section
        .integer("serial", 1..=99_999_999)
        .map(|serial| serial.to_string());
    let mut modes: Vec<(&str, zed::camera::Mode)> = zed::camera::MODES
        .iter()
        .map(|mode| (mode.name, *mode))
        .collect();
    // The default mode comes first.
    modes.sort_by_key(|(name, _)| *name != "HD720");
    let mode = one_of(section, "mode", &modes);
    let fastest = mode
        .rates_hz
        .iter()
        .max()
        .map_or(0.0, |rate| f64::from(*rate));
    let rate_hz = section
        .number("rate_hz", 1.0..=100.0)
        .unwrap_or(fastest.min(30.0));
    if !mode.rates_hz.iter().any(|rate| f64::from(*rate) == rate_hz) {
        let rates: Vec<String> = mode.rates_hz.iter().map(ToString::to_string).collect();
        section.refuse(
            "rate_hz",
            format_args!(
                "is {rate_hz}, expected one of {} in this mode",
                rates.join(", ")
            ),
        );
    }
    let imu_rate_hz = imu_rate(section);
    let has_imu = section.flag("imu").unwrap_or(true);
    if !has_imu {
        refuse_without(section, &["imu_rate_hz"], "imu = true");
    }
    Some(V4l2Config {
        device: DeviceChoice::Zed {
            serial: serial.clone(),
        },
        right: None,
        width: mode.width,
        height: mode.height,
        rate_hz,
        format: PixelLayout::Yuyv,
        buffers: buffers(section),
        controls: section.section("controls", "controls").integers(),
        imu: has_imu.then_some(ZedImuConfig {
            serial,
            rate_hz: imu_rate_hz,
        }),
    })
}

pub(super) fn gstreamer(section: &mut Section<'_>) -> Option<GstreamerConfig> {
    let a_chain = "elements as for gst-launch-1.0, without a sink and without control characters";
    section.must_have("chain", a_chain);
    // The value may extend over several lines.
    let is_chain = |text: &str| {
        let plain = text.split(['\n', '\r', '\t']).all(is_plain);
        !text.trim().is_empty() && plain
    };
    let chain = section.text("chain", a_chain, is_chain);
    Some(GstreamerConfig {
        right_chain: section.text("right_chain", a_chain, is_chain),
        width: pixels(section, "width", 32..=16_384, 1344, 4),
        height: pixels(section, "height", 16..=8192, 376, 2),
        rate_hz: rate(section),
        start_after_ns: ns(
            1e9,
            section.number("start_after_s", 0.0..=60.0).unwrap_or(0.0),
        ),
        imu: zed_imu(section, "imu", None),
        chain: chain?,
    })
}

fn rate(section: &mut Section<'_>) -> f64 {
    section
        .number("rate_hz", 0.01..=MAX_RATE_HZ)
        .unwrap_or(30.0)
}

fn imu_rate(section: &mut Section<'_>) -> f64 {
    section
        .number("imu_rate_hz", 1.0..=MAX_IMU_RATE_HZ)
        .unwrap_or(400.0)
}

fn buffers(section: &mut Section<'_>) -> u32 {
    section.integer("buffers", 2..=32).unwrap_or(8) as u32
}

/// `imu = "zed"`, with its serial number if several are connected.
fn zed_imu(
    section: &mut Section<'_>,
    key: &'static str,
    default: Option<&str>,
) -> Option<ZedImuConfig> {
    let kind = section.text(key, "\"zed\" or \"none\"", |kind| {
        matches!(kind, "zed" | "none")
    });
    let serial = section.text(
        "imu_serial",
        "the serial number of the microcontroller",
        |s| !s.is_empty() && is_plain(s),
    );
    let rate_hz = imu_rate(section);
    let is_zed = kind.as_deref().or(default) == Some("zed");
    if !is_zed {
        refuse_without(section, &["imu_serial", "imu_rate_hz"], "imu = \"zed\"");
    }
    is_zed.then_some(ZedImuConfig { serial, rate_hz })
}

/// Rejects keys that are meaningless without another one.
fn refuse_without(section: &Section<'_>, keys: &[&str], expected: &str) {
    for key in keys.iter().filter(|key| section.has(key)) {
        section.refuse(key, format_args!("is given, expected {expected} beside it"));
    }
}

/// `device = "/dev/video0"`, or `usb = "2b03:f682"`, and `usb_serial` if several are connected; or
/// the same with other keys.
fn device(
    section: &mut Section<'_>,
    folder: &Path,
    [device_key, usb_key, serial_key]: [&'static str; 3],
    needed: bool,
) -> Option<DeviceChoice> {
    let path = section.path(device_key, folder);
    let usb = section.text(usb_key, A_USB_ID, |text| usb_id(text).is_some());
    let serial = section.text(serial_key, "the serial number on the bus", |s| {
        !s.is_empty() && is_plain(s)
    });
    match (path, usb.as_deref().and_then(usb_id)) {
        (Some(path), None) => {
            let expected = format!("{usb_key}, and not {device_key},");
            refuse_without(section, &[serial_key], &expected);
            Some(DeviceChoice::Path(path))
        }
        (None, Some((vendor, product))) => Some(DeviceChoice::Usb {
            vendor,
            product,
            serial,
        }),
        (Some(_), Some(_)) => {
            section.refuse(
                usb_key,
                format_args!("is given beside {device_key}, expected one of the two"),
            );
            None
        }
        (None, None) => {
            if needed && !section.has(usb_key) {
                section.must_have(
                    device_key,
                    "a node like /dev/video0, or usb = \"VENDOR:PRODUCT\"",
                );
            } else if !needed && !section.has(usb_key) {
                refuse_without(section, &[serial_key], usb_key);
            }
            None
        }
    }
}

const A_USB_ID: &str = "vendor and product as in \"2b03:f682\"";

/// Vendor and product, hexadecimal, four digits each.
fn usb_id(text: &str) -> Option<(u16, u16)> {
    let (vendor, product) = text.split_once(':')?;
    let id = |text: &str| {
        let is_id = text.len() == 4 && text.bytes().all(|b| b.is_ascii_hexdigit());
        is_id.then(|| u16::from_str_radix(text, 16).ok()).flatten()
    };
    Some((id(vendor)?, id(product)?))
}
