//! Settings of sources that replay foreign recordings, bags and video files, and their syntax in
//! the file.

use std::path::{Path, PathBuf};

use session_archive::text::is_plain;

use super::device::pair_within;
use super::file::ns;
use super::section::Section;

/// A bag: rosbag2 in MCAP, or an MCAP file with ROS 2 messages.
#[derive(Clone, Debug, PartialEq)]
pub struct BagConfig {
    /// Its folder, or a file.
    pub path: PathBuf,
    /// Topics of the images.
    pub images: BagImages,
    /// Whether its IMU is replayed too, if it has one.
    pub imu: bool,
    /// Topic of the IMU; `None` for the only one.
    pub imu_topic: Option<String>,
    /// Maximum time difference of a pair, ns; `None` for the largest possible one.
    pub pair_within_ns: Option<i64>,
}

/// Topics of a bag's images.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum BagImages {
    /// The only one, or the only two that can be left and right.
    Found,
    /// One topic with both eyes side by side.
    SideBySide(String),
    /// One topic for each eye.
    Pair {
        /// The left eye.
        left: String,
        /// The right eye.
        right: String,
    },
}

/// One or two video files.
#[derive(Clone, Debug, PartialEq)]
pub struct VideoConfig {
    /// Both eyes side by side, or the left eye.
    pub path: PathBuf,
    /// The right eye, if it has a file of its own.
    pub right_path: Option<PathBuf>,
    /// Delay of the right file's beginning, ns.
    pub right_later_ns: i64,
    /// Maximum time difference of a pair, ns; `None` for the largest possible one.
    pub pair_within_ns: Option<i64>,
}

pub(super) fn bag(section: &mut Section<'_>, folder: &Path) -> Option<BagConfig> {
    section.must_have(
        "path",
        "the folder of a rosbag2 recording, or an .mcap file",
    );
    let a_topic = "the name of a topic without control characters, as in \"/left/image_raw\"";
    let is_topic = |name: &str| !name.is_empty() && is_plain(name);
    let mut topic = |key| section.text(key, a_topic, is_topic);
    let (both, left, right) = (topic("topic"), topic("left_topic"), topic("right_topic"));
    let imu_topic = topic("imu_topic");
    let imu = section.flag("imu").unwrap_or(true);
    if !imu && imu_topic.is_some() {
        section.refuse(
            "imu_topic",
            "is given beside imu = false, expected one of the two",
        );
    }
    let pair_within_ns = pair_within(section, None);
    let images = match (both, left, right) {
        (None, None, None) => BagImages::Found,
        (Some(topic), None, None) => BagImages::SideBySide(topic),
        (None, Some(left), Some(right)) => BagImages::Pair { left, right },
        (Some(_), ..) => {
            section.refuse(
                "topic",
                "is given beside left_topic or right_topic; it is for both eyes side by side in one image",
            );
            BagImages::Found
        }
        (None, left, _) => {
            let (given, missing) = match left {
                Some(_) => ("left_topic", "right_topic"),
                None => ("right_topic", "left_topic"),
            };
            section.refuse(
                given,
                format_args!("is given, expected {missing} beside it"),
            );
            BagImages::Found
        }
    };
    Some(BagConfig {
        path: section.path("path", folder)?,
        images,
        imu,
        imu_topic,
        pair_within_ns,
    })
}

pub(super) fn video(section: &mut Section<'_>, folder: &Path) -> Option<VideoConfig> {
    section.must_have("path", "a video file");
    let right_path = section.path("right_path", folder);
    let hour_ms = 3_600_000.0;
    let right_later_ms = section.number("right_later_ms", -hour_ms..=hour_ms);
    let pair_within_ns = pair_within(section, None);
    if right_path.is_none() {
        let keys = ["right_later_ms", "pair_within_ms"];
        for key in keys.into_iter().filter(|key| section.has(key)) {
            section.refuse(key, "is given, expected right_path beside it");
        }
    }
    Some(VideoConfig {
        path: section.path("path", folder)?,
        right_path,
        right_later_ns: ns(1e6, right_later_ms.unwrap_or(0.0)),
        pair_within_ns,
    })
}
