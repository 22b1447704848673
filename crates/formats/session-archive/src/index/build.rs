//! Building an index from the messages of a session, in their order.

use std::collections::BTreeMap;
use std::io;

use super::entries::{BatchEntry, CameraIndex, FrameEntry, ImuIndex, Index, SetEntry};
use crate::layout;
use crate::mcap::CHUNK_PREFIX;
use crate::reader::{Message, ReadError, SessionReader};
use crate::record::paws::gap::Cause;
use crate::record::{CompressedVideo, Frame, FrameSet, Gap, ImuBatch, Record};
use crate::verify::union;

/// What a channel carries, with the position of its camera or IMU.
#[derive(Clone, Copy)]
enum Kind {
    Video(usize),
    Frame(usize),
    Imu(usize),
    Sets,
    Gaps,
}

/// A frame set before its frames' positions are known.
struct PendingSet {
    number: u64,
    time_ns: i64,
    members: Vec<(usize, u64)>,
}

pub(super) struct Build {
    kinds: BTreeMap<u16, Kind>,
    pub(super) index: Index,
    /// The frame record whose access unit has not come yet, per camera.
    awaiting: Vec<Option<Frame>>,
    /// Position of the key frame of the current run, per camera; none after a break.
    pub(super) key: Vec<Option<u32>>,
    /// Number of the newest frame, per camera.
    newest: Vec<Option<u64>>,
    /// First and last numbers of frames that the encoder had made and that are lost, per camera.
    lost: Vec<Vec<(u64, u64)>>,
    sets: Vec<PendingSet>,
}

impl Build {
    pub(super) fn new(reader: &SessionReader) -> Result<Self, ReadError> {
        let manifest = reader.manifest();
        let camera = |of: &str| manifest.cameras.iter().position(|c| c.name == of);
        let mut kinds = BTreeMap::new();
        for stream in &manifest.streams {
            let kind = match stream.schema.as_str() {
                name if name == CompressedVideo::SCHEMA.name => camera(&stream.of).map(Kind::Video),
                name if name == Frame::SCHEMA.name => camera(&stream.of).map(Kind::Frame),
                name if name == ImuBatch::SCHEMA.name => manifest
                    .imus
                    .iter()
                    .position(|i| i.name == stream.of)
                    .map(Kind::Imu),
                name if name == FrameSet::SCHEMA.name => Some(Kind::Sets),
                name if name == Gap::SCHEMA.name => Some(Kind::Gaps),
                _ => None,
            };
            if let Some(kind) = kind {
                kinds.insert(stream.id, kind);
            }
        }
        let cameras = manifest.cameras.iter().map(|c| CameraIndex {
            name: c.name.clone(),
            frames: Vec::new(),
            undecodable: 0,
        });
        let imus = manifest.imus.iter();
        let imus = imus.map(|i| ImuIndex {
            name: i.name.clone(),
            batches: Vec::new(),
        });
        let count = manifest.cameras.len();
        Ok(Self {
            kinds,
            index: Index {
                session_id: manifest.session_id.clone(),
                segments: segment_lengths(reader).map_err(|error| ReadError::Io {
                    path: layout::SEGMENTS.to_owned(),
                    error,
                })?,
                cameras: cameras.collect(),
                imus: imus.collect(),
                sets: Vec::new(),
                damaged: 0,
            },
            awaiting: vec![None; count],
            key: vec![None; count],
            newest: vec![None; count],
            lost: vec![Vec::new(); count],
            sets: Vec::new(),
        })
    }

    pub(super) fn message(&mut self, m: &Message) {
        let payload_at = m.chunk_offset + CHUNK_PREFIX as u64 + u64::from(m.payload_offset);
        match self.kinds.get(&m.stream) {
            Some(Kind::Frame(camera)) => self.awaiting[*camera] = m.decode().ok(),
            Some(Kind::Video(camera)) => self.video(*camera, m, payload_at),
            Some(Kind::Imu(imu)) => {
                let Ok(batch) = m.decode::<ImuBatch>() else {
                    return;
                };
                let (Some(&start_ns), Some(&end_ns)) = (batch.times.first(), batch.times.last())
                else {
                    return;
                };
                self.index.imus[*imu].batches.push(BatchEntry {
                    first_number: batch.first_number,
                    samples: batch.device_ticks.len() as u32,
                    start_ns,
                    end_ns,
                    segment: m.segment,
                    offset: payload_at,
                    bytes: m.data.len() as u32,
                    crc32: crc32fast::hash(&m.data),
                });
            }
            Some(Kind::Sets) => {
                let Ok(set) = m.decode::<FrameSet>() else {
                    return;
                };
                let position = |name: &str| self.index.cameras.iter().position(|c| c.name == name);
                let members = set.members.iter();
                let members = members
                    .filter_map(|m| position(&m.camera).map(|c| (c, m.number)))
                    .collect();
                self.sets.push(PendingSet {
                    number: set.number,
                    time_ns: set.time,
                    members,
                });
            }
            Some(Kind::Gaps) => {
                let Ok(gap) = m.decode::<Gap>() else {
                    return;
                };
                let camera = (self.index.cameras.iter()).position(|c| c.name == gap.stream);
                if let (Some(camera), true) = (camera, is_behind_the_encoder(gap.cause())) {
                    self.lost[camera].push((gap.first, gap.last));
                }
            }
            None => {}
        }
    }

    fn video(&mut self, camera: usize, m: &Message, payload_at: u64) {
        let frame = self.awaiting[camera].take();
        let (Some(frame), Ok(video)) = (frame, m.decode::<CompressedVideo>()) else {
            return;
        };
        let matches = frame.number as u32 == m.sequence
            && crc32fast::hash(&video.data) == frame.payload_crc32
            && self.newest[camera].is_none_or(|newest| frame.number > newest);
        if !matches {
            self.key[camera] = None;
            return;
        }
        // An empty access unit has no position in the file.
        let unit_at = match video.data.is_empty() {
            true => 0,
            false => video.data.as_ptr() as usize - m.data.as_ptr() as usize,
        };
        let list = &mut self.index.cameras[camera];
        let position = list.frames.len() as u32;
        if frame.key_frame {
            self.key[camera] = Some(position);
        }
        self.newest[camera] = Some(frame.number);
        let Some(key) = self.key[camera] else {
            list.undecodable += 1;
            return;
        };
        list.frames.push(FrameEntry {
            number: frame.number,
            time_ns: frame.time,
            sigma_ns: frame.sigma_ns,
            time_unreliable: frame.time_unreliable,
            host_time_ns: frame.host_time,
            device_ticks: frame.device_ticks,
            exposure_ns: frame.exposure_ns,
            key,
            segment: m.segment,
            offset: payload_at + unit_at as u64,
            bytes: video.data.len() as u32,
            crc32: frame.payload_crc32,
        });
    }

    pub(super) fn finish(mut self) -> Index {
        for (camera, lost) in self.index.cameras.iter_mut().zip(self.lost) {
            camera.leave_out_behind(lost);
        }
        self.sets.sort_by_key(|s| (s.time_ns, s.number));
        let cameras = &self.index.cameras;
        let sets = self.sets.into_iter().map(|set| {
            let mut frames = vec![None; cameras.len()];
            for (camera, number) in set.members {
                frames[camera] = cameras[camera].position(number).map(|p| p as u32);
            }
            SetEntry {
                number: set.number,
                time_ns: set.time_ns,
                frames,
            }
        });
        self.index.sets = sets.collect();
        self.index
    }
}

impl CameraIndex {
    /// Leaves out the frames that refer to one of these numbers: those between it and the next key
    /// frame. Gap records may come long after the frames, those of recovery last of all.
    fn leave_out_behind(&mut self, lost: Vec<(u64, u64)>) {
        let lost = union(lost);
        let frames = std::mem::take(&mut self.frames);
        let mut key = 0;
        for (position, frame) in frames.iter().enumerate() {
            let is_key = frame.key as usize == position;
            if is_key {
                key = self.frames.len() as u32;
            }
            let from = frames[frame.key as usize].number;
            let next = lost.partition_point(|range| range.1 <= from);
            let is_behind = lost.get(next).is_some_and(|range| range.0 < frame.number);
            if is_behind && !is_key {
                self.undecodable += 1;
            } else {
                self.frames.push(FrameEntry { key, ..*frame });
            }
        }
    }
}

/// Whether frames that are missing for this cause were encoded, so that later ones may refer to
/// them. Frames dropped before the encoder leave no trace in its output.
fn is_behind_the_encoder(cause: Cause) -> bool {
    match cause {
        Cause::EncoderRestart | Cause::WriterOverload | Cause::Storage | Cause::Damaged => true,
        Cause::Unknown
        | Cause::Device
        | Cause::Disconnected
        | Cause::EncoderOverload
        | Cause::Late
        | Cause::LoadShed
        | Cause::MachineOverload => false,
    }
}

/// Number and length of each segment.
pub(super) fn segment_lengths(reader: &SessionReader) -> io::Result<Vec<(u32, u64)>> {
    let mut lengths = Vec::new();
    for number in reader.segment_numbers() {
        match reader.storage().open(&layout::segment(number)) {
            Ok(file) => lengths.push((number, file.len()?)),
            Err(e) if e.kind() == io::ErrorKind::NotFound => {}
            Err(e) => return Err(e),
        }
    }
    Ok(lengths)
}
