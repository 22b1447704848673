//! Whether a frame's references are there, read from the headers alone.
//!
//! A decoder that misses a frame goes on with the wrong one and says nothing: with libav a single
//! lost access unit gave frames at 16 to 20 dB without any error. This finds such a loss before
//! decoding, at the cost of a few header bytes per access unit.
//!
//! Contract: give a [`Continuity`] the access units of one stream in order. The first one after a
//! loss is [`Step::Broken`], and so is every later one up to the next key frame. Pure, total on
//! any bytes, bounded memory. *What it cannot tell* is [`Step::Unknown`]: headers it cannot read,
//! or features that none of our encoders uses (H.264 gaps in frame_num, H.265 scaling lists in
//! the SPS). *What it does not see*: a loss of exactly a multiple of MaxFrameNum (at least 16)
//! H.264 frames; the loss of frames that nothing refers to, which does no harm; damage inside
//! a frame.
//!
//! Sources: ITU-T H.264 (08/2021) clauses 7.3.2.1, 7.3.3, 7.4.3 (frame_num); ITU-T H.265
//! (08/2021) clauses 7.3.2.2, 7.3.2.3, 7.3.6, 7.3.7, 7.4.8 (reference image sets), 8.3.1
//! (image order count).

use crate::{Codec, annexb};

mod bits;
mod h264;
mod h265;

/// Relation of an access unit to those before it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Step {
    /// A key frame: needs nothing.
    Key,
    /// Everything it refers to was there.
    Follows,
    /// Something it refers to, directly or through others, is missing: it cannot be decoded
    /// rightly.
    Broken,
    /// Its headers do not tell.
    Unknown,
}

/// Follows one stream.
#[derive(Debug, Clone)]
pub struct Continuity {
    reader: Reader,
    /// A key frame was seen, and nothing was missing since.
    intact: bool,
}

#[derive(Debug, Clone)]
enum Reader {
    H264(h264::Reader),
    H265(h265::Reader),
}

impl Continuity {
    /// Nothing seen yet: everything before the first key frame is broken.
    pub fn new(codec: Codec) -> Continuity {
        let reader = match codec {
            Codec::H264 => Reader::H264(h264::Reader::default()),
            Codec::H265 => Reader::H265(h265::Reader::default()),
        };
        Continuity {
            reader,
            intact: false,
        }
    }

    /// Takes the next access unit, Annex B.
    pub fn next(&mut self, access_unit: &[u8]) -> Step {
        let codec = match self.reader {
            Reader::H264(_) => Codec::H264,
            Reader::H265(_) => Codec::H265,
        };
        let key = annexb::is_key(codec, access_unit);
        let complete = match &mut self.reader {
            Reader::H264(reader) => reader.read(access_unit),
            Reader::H265(reader) => reader.read(access_unit),
        };
        self.intact = key || (self.intact && complete != Some(false));
        match (key, self.intact, complete) {
            (true, ..) => Step::Key,
            (false, false, _) => Step::Broken,
            (false, true, Some(_)) => Step::Follows,
            (false, true, None) => Step::Unknown,
        }
    }
}

#[cfg(test)]
mod tests;
