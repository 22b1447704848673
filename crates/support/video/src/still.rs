//! A few small images of what a stereo camera saw: at the start, in the middle, at the end, and the
//! worst.
//!
//! Contract: *worst* is the least sharp one ([`Look::sharpness`]) among the frames that are looked
//! at, which are the three others and key frames spread evenly over the recording, at
//! most [`Settings::most`]: what a long recording costs is bounded. A covered, blurred, black or
//! overexposed image is less sharp than its neighbours; so is one of a plain wall. What cannot be
//! decoded is counted and passed over; the next one that can takes its place. The same frames give
//! the same images on the same decoder.

use std::collections::BTreeSet;
use std::ops::Range;

use bytes::Bytes;
use thiserror::Error;

use crate::{AccessUnit, Codec, DecodeError, Decoder, RawImage};

mod look;
mod small;

pub use look::Look;

/// A frame of a recording, in the order of times.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Candidate {
    /// Its number in the camera's stream.
    pub number: u64,
    /// Its time, ns.
    pub time_ns: i64,
    /// Position of the key frame that decoding has to start from.
    pub key: usize,
}

/// How much is looked at, and how images are kept.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Settings {
    /// Key frames looked at, at most.
    pub most: usize,
    /// Columns of an image, at most.
    pub width: u32,
    /// JPEG quality, 1 to 100.
    pub quality: u8,
}

impl Default for Settings {
    /// 32 key frames; images of some 15 kB.
    fn default() -> Self {
        Self {
            most: 32,
            width: 400,
            quality: 70,
        }
    }
}

/// What an image stands for.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Role {
    /// The first frame.
    Start,
    /// The key frame in the middle.
    Middle,
    /// The last frame.
    End,
    /// The least sharp of those looked at.
    LeastSharp,
}

impl Role {
    /// For people.
    pub fn name(self) -> &'static str {
        match self {
            Self::Start => "start",
            Self::Middle => "middle",
            Self::End => "end",
            Self::LeastSharp => "least sharp",
        }
    }
}

/// A small image of one eye.
#[derive(Clone, Debug, PartialEq)]
pub struct Still {
    /// What it stands for; more than one if a frame is both.
    pub roles: Vec<Role>,
    /// Number of its frame.
    pub number: u64,
    /// Time of its frame, ns.
    pub time_ns: i64,
    /// `left` or `right`: the eye that is less sharp in [`Role::LeastSharp`], else the left one;
    /// `both` if the frame cannot be cut in two.
    pub eye: &'static str,
    /// What was measured in that eye, before it was made small.
    pub look: Look,
    /// The file.
    pub jpeg: Vec<u8>,
}

/// What one camera saw.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Stills {
    /// In the order of times.
    pub stills: Vec<Still>,
    /// Frames that were decoded and looked at.
    pub looked_at: usize,
    /// Frames that were to be looked at and could not be decoded.
    pub undecodable: usize,
}

/// Why there is no image.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
pub enum StillError {
    /// This machine decodes nothing of this codec.
    #[error(transparent)]
    Decode(#[from] DecodeError),
    /// A frame is malformed, or no JPEG can be made of it.
    #[error("making a small image: {0}")]
    Image(String),
}

/// Looks at some frames of a camera. `read` gives the access unit of the frame at a position, or
/// nothing if it is damaged.
///
/// # Errors
/// [`StillError`]; what concerns single frames is counted instead.
pub fn stills(
    codec: Codec,
    frames: &[Candidate],
    settings: &Settings,
    read: &mut dyn FnMut(usize) -> Option<Bytes>,
) -> Result<Stills, StillError> {
    let (chosen, middle) = choose(frames, settings.most);
    let mut decoder = Decoder::new(codec);
    let mut found = Stills::default();
    let mut seen: Vec<StillCandidate> = Vec::new();
    for position in chosen {
        let key = frames[position].key.min(position);
        match decode(&mut decoder, key..position + 1, read)? {
            Some(image) => {
                found.looked_at += 1;
                keep(&mut seen, StillCandidate::of(position, &image), middle);
            }
            None => found.undecodable += 1,
        }
    }
    let least = least_sharp(&seen);
    for (k, one) in seen.iter().enumerate() {
        let roles = [
            (k == 0).then_some(Role::Start),
            (Some(k) == nearest(&seen, middle)).then_some(Role::Middle),
            (k + 1 == seen.len() && k > 0).then_some(Role::End),
            (Some(k) == least).then_some(Role::LeastSharp),
        ];
        let roles: Vec<Role> = roles.into_iter().flatten().collect();
        let Some(last) = roles.last() else { continue };
        let (eye, look, image) = one.eye(*last == Role::LeastSharp);
        let frame = frames[one.position];
        found.stills.push(Still {
            number: frame.number,
            time_ns: frame.time_ns,
            eye,
            look,
            jpeg: small::jpeg(image, settings.width, settings.quality)?,
            roles,
        });
    }
    Ok(found)
}

/// Positions to look at, in order, and the one in the middle.
fn choose(frames: &[Candidate], most: usize) -> (BTreeSet<usize>, usize) {
    let mut keys: Vec<usize> = (0..frames.len()).filter(|k| frames[*k].key == *k).collect();
    let Some(last) = frames.len().checked_sub(1) else {
        return (BTreeSet::new(), 0);
    };
    let middle = frames[last / 2].key.min(last);
    if keys.len() > most {
        let all = keys.len();
        keys = (0..most).map(|k| keys[k * all / most]).collect();
    }
    keys.extend([0, middle, last]);
    (keys.into_iter().collect(), middle)
}

/// Decoders are given positions for times.
const FRAME_NS: i64 = 1_000_000;

/// The last frame of a run that begins with a key frame.
fn decode(
    decoder: &mut Decoder,
    run: Range<usize>,
    read: &mut dyn FnMut(usize) -> Option<Bytes>,
) -> Result<Option<RawImage>, StillError> {
    let units = run.enumerate().map(|(k, position)| {
        Some(AccessUnit {
            pts_ns: k as i64 * FRAME_NS,
            data: read(position)?,
            key: k == 0,
        })
    });
    let Some(units) = units.collect::<Option<Vec<AccessUnit>>>() else {
        return Ok(None);
    };
    let last_ns = (units.len() as i64 - 1) * FRAME_NS;
    let images = match decoder.decode(&units) {
        Ok(images) | Err(DecodeError::Incomplete { images, .. }) => images,
        Err(error @ (DecodeError::NoDecoder { .. } | DecodeError::Init(_))) => {
            return Err(error.into());
        }
        Err(_) => Vec::new(),
    };
    let last = images.into_iter().last();
    Ok(last.filter(|(at, _)| *at == last_ns).map(|(_, p)| p))
}

/// A decoded frame and what its eyes look like.
struct StillCandidate {
    position: usize,
    eyes: Vec<(&'static str, Look, RawImage)>,
}

impl StillCandidate {
    fn of(position: usize, both: &RawImage) -> Self {
        let eyes = match crate::raw_image::split(both) {
            Ok((left, right)) => vec![("left", left), ("right", right)],
            Err(_) => vec![("both", both.clone())],
        };
        let eyes = eyes.into_iter();
        Self {
            position,
            eyes: eyes
                .map(|(name, eye)| (name, Look::of(&eye), eye))
                .collect(),
        }
    }

    /// The left eye, or the less sharp one.
    fn eye(&self, is_worst: bool) -> (&'static str, Look, &RawImage) {
        let sharpness = |eye: &&(&'static str, Look, RawImage)| eye.1.sharpness;
        let worst = self.eyes.iter();
        let worst = worst.min_by(|a, b| sharpness(a).total_cmp(&sharpness(b)));
        let (name, look, image) = match is_worst {
            true => worst.unwrap_or(&self.eyes[0]),
            false => &self.eyes[0],
        };
        (name, *look, image)
    }

    fn sharpness(&self) -> f64 {
        self.eye(true).1.sharpness
    }
}

/// Adds a frame and lets go of those that no image will be made of, so that four or five are in
/// memory.
fn keep(seen: &mut Vec<StillCandidate>, new: StillCandidate, middle: usize) {
    seen.push(new);
    let kept = [
        Some(0),
        nearest(seen, middle),
        seen.len().checked_sub(1),
        least_sharp(seen),
    ];
    let mut k = 0;
    seen.retain(|_| {
        k += 1;
        kept.contains(&Some(k - 1))
    });
}

fn nearest(seen: &[StillCandidate], position: usize) -> Option<usize> {
    (0..seen.len()).min_by_key(|k| seen[*k].position.abs_diff(position))
}

fn least_sharp(seen: &[StillCandidate]) -> Option<usize> {
    (0..seen.len()).min_by(|a, b| seen[*a].sharpness().total_cmp(&seen[*b].sharpness()))
}

#[cfg(test)]
mod tests;
