//! Selection of a bag's topics for the eyes and the IMU.

use std::path::Path;

use super::error::BagError;
use super::messages::Kind;
use super::scan::Stream;
use crate::config::{BagConfig, BagImages};

/// Positions of the chosen topics among the streams of a bag.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct TopicSelection {
    /// Images of the left eye, or of both side by side.
    pub(super) left: usize,
    /// Images of the right eye, if they have a topic of their own.
    pub(super) right: Option<usize>,
    pub(super) imu: Option<usize>,
}

/// Name parts that distinguish the left topic from the right one.
const SIDES: [(&str, &str); 4] = [
    ("left", "right"),
    ("cam0", "cam1"),
    ("image_0", "image_1"),
    ("infra1", "infra2"),
];

/// Selects the configured topics, or else the unambiguous ones.
pub(super) fn choose(
    config: &BagConfig,
    path: &Path,
    streams: &[Stream],
) -> Result<TopicSelection, BagError> {
    let fail = |what: String| BagError::Topics {
        path: path.to_owned(),
        what,
        topics: streams.iter().map(Stream::describe).collect(),
    };
    let named = |name: &str, image: bool| {
        let found = streams.iter().position(|stream| stream.topic == *name);
        let word = if image { "images" } else { "IMU samples" };
        let found = found.ok_or_else(|| fail(format!("found no {name} with {word}")))?;
        match streams[found].kind.is_image() == image {
            true => Ok(found),
            false => Err(fail(format!("{name} is not a topic with {word}"))),
        }
    };
    let (left, right) = match &config.images {
        BagImages::SideBySide(topic) => (named(topic, true)?, None),
        BagImages::Pair { left, right } => {
            let (left, right) = (named(left, true)?, named(right, true)?);
            if left == right {
                return Err(fail("left_topic and right_topic are the same".to_owned()));
            }
            (left, Some(right))
        }
        BagImages::Found => found(streams).ok_or_else(|| {
            fail(
                "found no single pair of image topics whose names differ by left and right; name them with left_topic and \
                 right_topic, or with topic where one has both eyes side by side"
                    .to_owned(),
            )
        })?,
    };
    let imus: Vec<usize> = (0..streams.len())
        .filter(|i| streams[*i].kind == Kind::Imu)
        .collect();
    let imu = match (&config.imu_topic, config.imu, imus.as_slice()) {
        (_, false, _) => None,
        (Some(topic), true, _) => Some(named(topic, false)?),
        (None, true, []) => None,
        (None, true, [only]) => Some(*only),
        (None, true, _) => {
            return Err(fail(
                "found several topics with IMU samples; name one with imu_topic, or leave them out with imu = false"
                    .to_owned(),
            ));
        }
    };
    Ok(TopicSelection { left, right, imu })
}

/// The only image topic, or the only pair of them.
fn found(streams: &[Stream]) -> Option<(usize, Option<usize>)> {
    let images: Vec<usize> = (0..streams.len())
        .filter(|i| streams[*i].kind.is_image())
        .collect();
    if let [only] = images[..] {
        return Some((only, None));
    }
    let mut pairs = Vec::new();
    for left in &images {
        for right in &images {
            let (a, b) = (&streams[*left].topic, &streams[*right].topic);
            if SIDES.iter().any(|(l, r)| a != b && a.replace(l, r) == *b) {
                pairs.push((*left, Some(*right)));
            }
        }
    }
    match pairs[..] {
        [only] => Some(only),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn streams(topics: &[(&str, Kind)]) -> Vec<Stream> {
        let stream = |(topic, kind): &(&str, Kind)| Stream::new(topic, *kind);
        topics.iter().map(stream).collect()
    }

    fn config(images: BagImages, imu_topic: Option<&str>) -> BagConfig {
        BagConfig {
            path: "walk".into(),
            images,
            imu: true,
            imu_topic: imu_topic.map(str::to_owned),
            pair_within_ns: None,
        }
    }

    #[test]
    fn unambiguous_topics_are_found() {
        let of = |topics: &[(&str, Kind)]| {
            choose(
                &config(BagImages::Found, None),
                Path::new("walk"),
                &streams(topics),
            )
        };
        let (left, right) = (("/left/image", Kind::Image), ("/right/image", Kind::Image));
        let imu = ("/imu", Kind::Imu);
        let chosen = of(&[right, imu, left]).expect("a pair");
        assert_eq!(
            (chosen.left, chosen.right, chosen.imu),
            (2, Some(0), Some(1))
        );
        let chosen = of(&[("/stereo", Kind::CompressedImage)]).expect("one topic");
        assert_eq!((chosen.left, chosen.right, chosen.imu), (0, None, None));
        let depth = ("/depth", Kind::Image);
        assert_eq!(of(&[depth, left, right]).expect("a pair").left, 1);

        let both = [
            left,
            right,
            ("/left/c", Kind::CompressedImage),
            ("/right/c", Kind::CompressedImage),
        ];
        let error = of(&both).expect_err("two pairs").to_string();
        assert!(
            error.contains("name them with left_topic and right_topic"),
            "{error}"
        );
        assert!(
            error.contains("/left/c (sensor_msgs/CompressedImage, 0 messages)"),
            "{error}"
        );
        let error = of(&[left, right, imu, ("/imu2", Kind::Imu)]).expect_err("two IMUs");
        assert!(
            error.to_string().contains("name one with imu_topic"),
            "{error}"
        );
    }

    #[test]
    fn named_topic_must_exist_and_have_the_right_type() {
        let streams = streams(&[
            ("/a", Kind::Image),
            ("/b", Kind::Image),
            ("/imu", Kind::Imu),
        ]);
        let pair = |left: &str, right: &str| BagImages::Pair {
            left: left.to_owned(),
            right: right.to_owned(),
        };
        let of = |config: BagConfig| choose(&config, Path::new("walk"), &streams);
        let chosen = of(config(pair("/b", "/a"), Some("/imu"))).expect("chosen");
        assert_eq!(
            (chosen.left, chosen.right, chosen.imu),
            (1, Some(0), Some(2))
        );
        for (config, expected) in [
            (config(pair("/a", "/c"), None), "found no /c with images"),
            (
                config(pair("/a", "/imu"), None),
                "/imu is not a topic with images",
            ),
            (config(pair("/a", "/a"), None), "are the same"),
            (
                config(pair("/a", "/b"), Some("/a")),
                "/a is not a topic with IMU samples",
            ),
        ] {
            let error = of(config).expect_err(expected).to_string();
            assert!(error.contains(expected), "{error}");
        }
    }
}
