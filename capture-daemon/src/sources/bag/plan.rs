//! Replay plan of a bag: increasing times, pairs, and dropped frames. Pure.

use std::path::Path;

use video::capture::Eye;

use super::container::RecordLocation;
use super::error::BagError;
use super::messages::Imu;
use super::scan::{IndexedMessage, Stream};
use super::topics::TopicSelection;
use crate::sources::pairing::{ImagePairer, PairingOutput, TimedImage, alone, limit_ns};

/// A century, ns: bound that makes differences of times safe.
const CENTURY_NS: i64 = 100 * 365 * 86_400 * 1_000_000_000;

/// The replay plan.
#[derive(Debug)]
pub(super) struct Plan {
    /// Every left image from the first frame on, in order.
    pub(super) frames: Vec<PlannedFrame>,
    /// Every usable sample from the first frame on.
    pub(super) imu: Vec<PlannedImu>,
    pub(super) rate_hz: f64,
    /// Rate of the samples, if there are two or more.
    pub(super) imu_rate_hz: Option<f64>,
    /// Time of the first frame, ns.
    pub(super) first_ns: i64,
    /// Time differences of left and right images, for people.
    pub(super) apart: Option<String>,
    /// Skipped messages, for people.
    pub(super) notices: Vec<String>,
}

/// A left image and its outcome.
#[derive(Debug)]
pub(super) struct PlannedFrame {
    /// From 0.
    pub(super) number: u64,
    /// From the first frame, ns; the newest earlier one for an image without a time.
    pub(super) offset_ns: i64,
    pub(super) what: Outcome,
}

#[derive(Debug)]
pub(super) enum Outcome {
    /// Left image and, if it has a topic of its own, right one with its delay.
    Frame {
        left: (usize, RecordLocation),
        right: Option<((usize, RecordLocation), i64)>,
    },
    /// Reason why there is no frame.
    Dropped(String),
}

/// A sample.
#[derive(Clone, Copy, Debug)]
pub(super) struct PlannedImu {
    /// From 0.
    pub(super) number: u64,
    pub(super) stamp_ns: i64,
    pub(super) values: Imu,
}

/// Times of messages, or why they are unusable, with the number of each kind.
struct Times {
    of: Vec<Result<i64, &'static str>>,
    missing: usize,
    falling: usize,
    damaged: usize,
}

impl Times {
    /// # Errors
    /// Fewer than half of the messages are usable, or fewer than two.
    fn of(stream: &Stream, path: &Path) -> Result<Self, BagError> {
        let mut times = Self {
            of: Vec::with_capacity(stream.messages.len()),
            missing: 0,
            falling: 0,
            damaged: 0,
        };
        let mut newest = None;
        for message in &stream.messages {
            let time = times.classify(message, newest);
            if let Ok(time) = time {
                newest = Some(time);
            }
            times.of.push(time);
        }
        let (total, good) = (times.of.len(), times.good().count());
        if good < 2 || 2 * good < total {
            return Err(BagError::Times {
                path: path.to_owned(),
                topic: stream.topic.clone(),
                total,
                missing: times.missing,
                falling: times.falling,
                damaged: times.damaged,
            });
        }
        Ok(times)
    }

    fn classify(
        &mut self,
        message: &IndexedMessage,
        newest: Option<i64>,
    ) -> Result<i64, &'static str> {
        match (message.stamp_ns, &message.imu) {
            (Err(_), _) | (_, Some(Err(_))) => {
                self.damaged += 1;
                Err("its message is damaged")
            }
            (Ok(None), _) => {
                self.missing += 1;
                Err("its header has no time")
            }
            (Ok(Some(time)), _) if newest.is_some_and(|newest| time <= newest) => {
                self.falling += 1;
                Err("its time is not after that of the one before")
            }
            (Ok(Some(time)), _) => Ok(time),
        }
    }

    /// Positions and times of usable messages.
    fn good(&self) -> impl Iterator<Item = (usize, i64)> {
        let usable = self.of.iter().enumerate();
        usable.filter_map(|(i, time)| time.ok().map(|time| (i, time)))
    }

    /// Description of the unusable messages, for people.
    fn rejection_text(&self) -> Option<String> {
        let parts = [
            (self.missing, "without a time"),
            (self.falling, "with a time that does not rise"),
            (self.damaged, "damaged or without values"),
        ];
        let parts = parts.into_iter().filter(|(count, _)| *count > 0);
        let parts: Vec<String> = parts
            .map(|(count, what)| format!("{count} {what}"))
            .collect();
        (!parts.is_empty()).then(|| parts.join(", "))
    }
}

/// The right image of a left one, and its delay.
type Partner = Option<(usize, i64)>;

pub(super) fn plan(
    path: &Path,
    streams: &[Stream],
    chosen: &TopicSelection,
    pair_within_ns: Option<i64>,
) -> Result<Plan, BagError> {
    let left = &streams[chosen.left];
    let times = Times::of(left, path)?;
    let rate_hz = rate_of(times.good().map(|(_, time)| time));
    let mut notices = Vec::new();
    let limit = |configured_ns| {
        limit_ns(rate_hz, configured_ns).map_err(|what| BagError::Setting {
            path: path.to_owned(),
            what,
        })
    };
    let (within_ns, max_ns) = (limit(pair_within_ns)?, limit(None)?);
    let mut apart = None;
    let partners = match chosen.right {
        Some(right) => {
            let right = &streams[right];
            let right_times = Times::of(right, path)?;
            if let Some(what) = right_times.rejection_text() {
                notices.push(format!("{}: left out: {what}", right.topic));
            }
            let found = pairs(
                path,
                [left, right],
                [&times, &right_times],
                [within_ns, max_ns],
                &mut notices,
            )?;
            apart = Some(found.1);
            Some(found.0)
        }
        None => None,
    };
    let mut frames = Vec::new();
    let mut first = None;
    let mut newest_ns = 0;
    for (i, message) in left.messages.iter().enumerate() {
        let partner: Option<Partner> = partners.as_ref().map(|partners| partners[i]);
        let what = match (times.of[i], partner) {
            (Err(why), _) => Outcome::Dropped(why.to_owned()),
            (Ok(_), Some(None)) => Outcome::Dropped(alone(Eye::Left, within_ns)),
            (Ok(_), None) => Outcome::Frame {
                left: message.location,
                right: None,
            },
            (Ok(_), Some(Some((right, apart_ns)))) => Outcome::Frame {
                left: message.location,
                right: chosen
                    .right
                    .map(|of| (streams[of].messages[right].location, apart_ns)),
            },
        };
        if let (None, Outcome::Frame { .. }, Ok(time)) = (first, &what, times.of[i]) {
            first = Some((i, time));
        }
        let Some((first_position, first_ns)) = first else {
            continue;
        };
        newest_ns = times.of[i].map_or(newest_ns, |time| time.saturating_sub(first_ns));
        frames.push(PlannedFrame {
            number: (i - first_position) as u64,
            offset_ns: newest_ns,
            what,
        });
    }
    let Some((_, first_ns)) = first else {
        // Half of the images have a partner.
        return Err(BagError::Setting {
            path: path.to_owned(),
            what: "found no frame".to_owned(),
        });
    };
    let (imu, imu_rate_hz) = match chosen.imu {
        Some(of) => samples(path, &streams[of], first_ns, &mut notices)?,
        None => (Vec::new(), None),
    };
    let last_ns = imu
        .last()
        .map_or(0, |s: &PlannedImu| s.stamp_ns.saturating_sub(first_ns));
    if newest_ns.max(last_ns) > CENTURY_NS {
        return Err(BagError::Setting {
            path: path.to_owned(),
            what: "its times span more than a century".to_owned(),
        });
    }
    Ok(Plan {
        frames,
        imu,
        rate_hz,
        imu_rate_hz,
        first_ns,
        apart,
        notices,
    })
}

/// The partner of each left image, and a text with their time differences, beside the limit and the
/// largest possible limit.
fn pairs(
    path: &Path,
    [left, right]: [&Stream; 2],
    [left_times, right_times]: [&Times; 2],
    [within_ns, max_ns]: [i64; 2],
    notices: &mut Vec<String>,
) -> Result<(Vec<Partner>, String), BagError> {
    let of = |eye, times: &Times| -> Vec<(i64, Eye, usize)> {
        times.good().map(|(i, time)| (time, eye, i)).collect()
    };
    let rights: Vec<i64> = right_times.good().map(|(_, time)| time).collect();
    let mut images = of(Eye::Left, left_times);
    let total = images.len();
    let mut nearest: Vec<i64> = images
        .iter()
        .map(|(time, ..)| distance(&rights, *time))
        .collect();
    images.extend(of(Eye::Right, right_times));
    images.sort_by_key(|(time, ..)| *time);

    let mut partners: Vec<Partner> = vec![None; left.messages.len()];
    let (mut later, mut without_left) = (Vec::new(), 0);
    let mut out = |paired: PairingOutput<usize>| match paired {
        PairingOutput::Both(a, b) => {
            let apart = b.time_ns - a.time_ns;
            later.push(apart);
            partners[a.of] = Some((b.of, apart));
        }
        PairingOutput::Unpaired(Eye::Right, _) => without_left += 1,
        PairingOutput::Unpaired(Eye::Left, _) => {}
    };
    let mut pairs = ImagePairer::new(within_ns);
    for (time_ns, eye, of) in images {
        pairs.push(eye, TimedImage { time_ns, of }, &mut out);
    }
    pairs.finish(&mut out);

    let ms = |ns: i64| ns as f64 * 1e-6;
    if 2 * later.len() < total {
        return Err(BagError::Unsynchronised {
            path: path.to_owned(),
            topics: format!(
                "{} at {:.2} Hz and {} at {:.2} Hz",
                left.topic,
                rate_of(left_times.good().map(|(_, time)| time)),
                right.topic,
                rate_of(rights.iter().copied())
            ),
            total,
            paired: later.len(),
            within_ms: ms(within_ns),
            max_ms: ms(max_ns),
            apart_ms: ms(median(&mut nearest)),
        });
    }
    let max_abs = later.iter().map(|apart| apart.abs()).max().unwrap_or(0);
    let apart = format!(
        "left and right images are paired by their times: right ones are {:.3} ms later in the median, at most {:.3} ms apart",
        ms(median(&mut later)),
        ms(max_abs)
    );
    if without_left > 0 {
        notices.push(format!(
            "{}: {without_left} images have no left one within {:.1} ms",
            right.topic,
            ms(within_ns)
        ));
    }
    Ok((partners, apart))
}

/// From `time` to the nearest of the sorted `times`, ns.
fn distance(times: &[i64], time: i64) -> i64 {
    let after = times.partition_point(|t| *t < time);
    let near = [after.checked_sub(1), Some(after)];
    let near = near.into_iter().flatten().filter_map(|i| times.get(i));
    near.map(|t| t.saturating_sub(time).saturating_abs())
        .min()
        .unwrap_or(i64::MAX)
}

/// Usable samples from `first_ns` on, and their rate.
fn samples(
    path: &Path,
    stream: &Stream,
    first_ns: i64,
    notices: &mut Vec<String>,
) -> Result<(Vec<PlannedImu>, Option<f64>), BagError> {
    let times = Times::of(stream, path)?;
    if let Some(what) = times.rejection_text() {
        notices.push(format!("{}: left out: {what}", stream.topic));
    }
    let usable = times.good().filter(|(_, time)| *time >= first_ns);
    let mut first = None;
    let mut samples = Vec::new();
    for (i, stamp_ns) in usable {
        if let Some(Ok(values)) = stream.messages[i].imu {
            samples.push(PlannedImu {
                number: (i - *first.get_or_insert(i)) as u64,
                stamp_ns,
                values,
            });
        }
    }
    if samples.len() < 2 {
        notices.push(format!(
            "{}: not replayed: fewer than two samples from the first image on",
            stream.topic
        ));
        return Ok((Vec::new(), None));
    }
    let rate_hz = rate_of(samples.iter().map(|sample| sample.stamp_ns));
    Ok((samples, Some(rate_hz)))
}

/// Rate by the median interval of two or more rising times, Hz.
fn rate_of(times: impl Iterator<Item = i64>) -> f64 {
    let times: Vec<i64> = times.collect();
    let intervals = times.windows(2).map(|pair| pair[1].saturating_sub(pair[0]));
    1e9 / median(&mut intervals.collect::<Vec<i64>>()).max(1) as f64
}

fn median(values: &mut [i64]) -> i64 {
    values.sort_unstable();
    values.get(values.len() / 2).copied().unwrap_or_default()
}
