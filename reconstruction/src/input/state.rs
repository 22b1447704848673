//! State of the rig in a session: calibrations, transforms and clock maps.
//!
//! The format repeats the newest of each at the head of every segment, so the heads are read, and
//! everything from the last head on: the last segment, and the one before if that was given up or
//! never filled. Result: of calibrations and transforms the newest; of clock maps those in force at
//! the heads and all after the last one, which includes the newest.

use std::collections::BTreeMap;
use std::io;

use session_archive::manifest::is_state;
use session_archive::reader::{ReadError as SessionError, SessionReader};
use session_archive::record::{
    CameraCalibration, ClockMap, FrameTransform, FrameTransforms, Protobuf, Record, Segment,
};
use session_archive::scan::{Item, VerifiedChunk};

/// The state of a session, by the name of what it belongs to.
#[derive(Debug, Default)]
pub(super) struct State {
    /// By camera side, as in `feet/left`.
    pub(super) calibrations: BTreeMap<String, CameraCalibration>,
    pub(super) transforms: Vec<FrameTransform>,
    /// By clock, then by version.
    pub(super) clock_maps: BTreeMap<String, Vec<ClockMap>>,
}

impl State {
    pub(super) fn read(reader: &SessionReader) -> Result<Self, SessionError> {
        let mut state = Self::default();
        // Backwards until a head is found; from there everything.
        let mut numbers: Vec<u32> = reader.segment_numbers().collect();
        let mut whole = Vec::new();
        while let Some(number) = numbers.pop() {
            whole.push(number);
            if first_chunk(reader, number)?.is_some_and(|chunk| is_head(reader, &chunk)) {
                break;
            }
        }
        for number in numbers {
            if let Some(chunk) = first_chunk(reader, number)? {
                state.take_all(reader, &chunk);
            }
        }
        for number in whole.into_iter().rev() {
            each_chunk(reader, number, |chunk| {
                state.take_all(reader, &chunk);
                true
            })?;
        }
        Ok(state)
    }

    fn take_all(&mut self, reader: &SessionReader, chunk: &VerifiedChunk) {
        for message in chunk.messages().map_while(Result::ok) {
            self.take(reader, message.channel_id, message.data);
        }
    }

    fn take(&mut self, reader: &SessionReader, channel: u16, data: &[u8]) {
        let Some(stream) = reader.stream(channel).filter(|s| is_state(s)) else {
            return;
        };
        // Records that do not decode were reported by the validation; they are skipped.
        match stream.schema.as_str() {
            name if name == CameraCalibration::SCHEMA.name => {
                if let Ok(calibration) = CameraCalibration::decode(data) {
                    self.calibrations.insert(stream.of.clone(), calibration);
                }
            }
            name if name == FrameTransforms::SCHEMA.name => {
                if let Ok(transforms) = FrameTransforms::decode(data) {
                    self.transforms = transforms.transforms;
                }
            }
            name if name == ClockMap::SCHEMA.name => {
                if let Ok(map) = ClockMap::decode(data) {
                    let maps = self.clock_maps.entry(stream.of.clone()).or_default();
                    match maps.binary_search_by_key(&map.version, |m| m.version) {
                        Ok(known) => maps[known] = map,
                        Err(place) => maps.insert(place, map),
                    }
                }
            }
            _ => {}
        }
    }
}

/// Calls `take` with the chunks of a segment until it returns true; a missing segment has none.
fn each_chunk(
    reader: &SessionReader,
    number: u32,
    mut take: impl FnMut(VerifiedChunk) -> bool,
) -> Result<(), SessionError> {
    let failed = |error| SessionError::Io {
        path: session_archive::layout::segment(number),
        error,
    };
    let mut scan = match reader.segment(number) {
        Ok(segment) => segment.scan()?,
        // Known to be missing when the session was validated.
        Err(SessionError::Io { error, .. }) if error.kind() == io::ErrorKind::NotFound => {
            return Ok(());
        }
        Err(e) => return Err(e),
    };
    while let Some(item) = scan.next_item().map_err(failed)? {
        if let Item::Chunk(chunk) = item
            && !take(chunk)
        {
            break;
        }
    }
    Ok(())
}

fn first_chunk(reader: &SessionReader, number: u32) -> Result<Option<VerifiedChunk>, SessionError> {
    let mut first = None;
    each_chunk(reader, number, |chunk| {
        first = Some(chunk);
        false
    })?;
    Ok(first)
}

/// Whether a chunk is a segment's head, which identifies the segment.
fn is_head(reader: &SessionReader, chunk: &VerifiedChunk) -> bool {
    let own = reader.manifest().stream::<Segment>("").map(|s| s.id);
    let first = chunk.messages().next();
    first.is_some_and(|m| m.is_ok_and(|m| Some(m.channel_id) == own))
}
