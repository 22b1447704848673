//! What a session says about the rig rather than about an instant: calibrations, transforms and
//! clock maps.
//!
//! The format repeats the newest of each at the head of every segment, so the heads and the last
//! segment are all that is read. What comes out: of calibrations and transforms the newest; of
//! clock maps those in force at the heads and all of the last segment, which includes the newest.

use std::collections::BTreeMap;
use std::io;

use session_archive::manifest::is_state;
use session_archive::reader::{ReadError as SessionError, SessionReader};
use session_archive::record::{
    CameraCalibration, ClockMap, FrameTransform, FrameTransforms, Protobuf, Record,
};
use session_archive::scan::Item;

/// The state of a session, by the name of what it belongs to.
#[derive(Debug, Default)]
pub(super) struct State {
    /// By eye, as in `feet/left`.
    pub(super) calibrations: BTreeMap<String, CameraCalibration>,
    pub(super) transforms: Vec<FrameTransform>,
    /// By clock, then by version.
    pub(super) clock_maps: BTreeMap<String, Vec<ClockMap>>,
}

impl State {
    pub(super) fn read(reader: &SessionReader) -> Result<Self, SessionError> {
        let mut state = Self::default();
        let numbers: Vec<u32> = reader.segment_numbers().collect();
        let last = numbers.last().copied();
        for number in numbers {
            let path = || session_archive::layout::segment(number);
            let failed = |error| SessionError::Io {
                path: path(),
                error,
            };
            let mut scan = match reader.segment(number) {
                Ok(segment) => segment.scan()?,
                // Known to be missing when the session was validated.
                Err(SessionError::Io { error, .. }) if error.kind() == io::ErrorKind::NotFound => {
                    continue;
                }
                Err(e) => return Err(e),
            };
            while let Some(item) = scan.next_item().map_err(failed)? {
                let Item::Chunk(chunk) = item else { continue };
                for message in chunk.messages().map_while(Result::ok) {
                    state.take(reader, message.channel_id, message.data);
                }
                if Some(number) != last {
                    break;
                }
            }
        }
        Ok(state)
    }

    fn take(&mut self, reader: &SessionReader, channel: u16, data: &[u8]) {
        let Some(stream) = reader.stream(channel).filter(|s| is_state(s)) else {
            return;
        };
        // What does not decode was shown by the validation; there is nothing to read in it.
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
