//! One session while it is being recorded: its archive and its account.

use std::collections::VecDeque;
use std::path::PathBuf;
use std::sync::Arc;

use session_archive::manifest::Stop;
use session_archive::record::FrameSet as FrameSetRecord;
use session_archive::record::paws::frame_set::Member as MemberRecord;
use session_archive::record::paws::gap::Cause;
use session_archive::time::{HostTime, NS_PER_S};
use session_archive::writer::{Incident, SessionWriter, WriteError};

use super::Setup;
use super::losses::Losses;
use super::timed::TimedStorage;
use crate::hub::Outgoing;
use crate::status::StreamAccount;
use crate::sync::sequence_tracker::SequenceTracker;
use crate::sync::sets::{CameraSpec, FrameSet, FrameSetBuilder};

/// A session that is being recorded.
pub(super) struct Session {
    pub(super) path: PathBuf,
    pub(super) writer: SessionWriter,
    pub(super) timed: Arc<TimedStorage>,
    /// Cameras first, then IMUs.
    pub(super) streams: Vec<Stream>,
    pub(super) cameras: usize,
    pub(super) sets: FrameSetBuilder,
    /// Cameras without a key frame so far: frames before it could not be decoded.
    pub(super) without_key: Vec<bool>,
    /// When recording began, pre-roll included.
    pub(super) started: HostTime,
    pub(super) first: Option<HostTime>,
    pub(super) last: HostTime,
    pub(super) stopping: Option<Stopping>,
    pub(super) chunks_reported: u64,
    /// Incidents that the writer handled and that have not been reported.
    pub(super) incidents: Vec<Incident>,
    /// Log time, stream and number of the samples that are not known to be on disk.
    pub(super) pending: VecDeque<(HostTime, usize, u64)>,
}

/// State of a stream in this session.
pub(super) struct Stream {
    pub(super) name: String,
    pub(super) tracker: SequenceTracker,
    pub(super) stored: u64,
    pub(super) missing: u64,
    pub(super) bytes: u64,
    /// `bytes` at the last health record.
    pub(super) bytes_before: u64,
    pub(super) losses: Losses,
}

/// A stop that was requested.
pub(super) struct Stopping {
    pub(super) at: HostTime,
    pub(super) reason: String,
    /// Streams whose last samples may still be in transit.
    pub(super) waiting: Vec<bool>,
}

impl Session {
    pub(super) fn new(
        path: PathBuf,
        writer: SessionWriter,
        timed: Arc<TimedStorage>,
        setup: &Setup,
        started: HostTime,
    ) -> Self {
        let cameras = setup.cameras.iter().map(|c| &c.name);
        let names = cameras.chain(setup.imus.iter().map(|i| &i.name));
        let streams = names.map(|name| Stream {
            name: name.clone(),
            tracker: SequenceTracker::new(name),
            stored: 0,
            missing: 0,
            bytes: 0,
            bytes_before: 0,
            losses: Losses::default(),
        });
        let specs = setup.cameras.iter().map(|c| CameraSpec {
            trigger: c.trigger.clone(),
            period_ns: (NS_PER_S as f64 / c.rate_hz.max(0.001)) as i64,
        });
        Self {
            path,
            writer,
            timed,
            streams: streams.collect(),
            cameras: setup.cameras.len(),
            sets: FrameSetBuilder::new(specs.collect()),
            without_key: vec![true; setup.cameras.len()],
            started,
            first: None,
            last: started,
            stopping: None,
            chunks_reported: 0,
            incidents: Vec::new(),
            pending: VecDeque::new(),
        }
    }

    /// Account of each stream, cameras first.
    pub(super) fn account(&self) -> Vec<StreamAccount> {
        let account = |(position, stream): (usize, &Stream)| StreamAccount {
            name: stream.name.clone(),
            is_camera: position < self.cameras,
            stored: stream.stored,
            missing: stream.missing,
            causes: stream.losses.by_cause(),
        };
        self.streams.iter().enumerate().map(account).collect()
    }

    /// Length so far, s.
    pub(super) fn seconds(&self) -> f64 {
        self.first.map_or(0.0, |first| {
            self.last.since(first).max(0) as f64 / NS_PER_S as f64
        })
    }

    /// Streams without samples.
    pub(super) fn absent(&self) -> Vec<String> {
        let absent = self.streams.iter().filter(|s| s.stored + s.missing == 0);
        absent.map(|s| s.name.clone()).collect()
    }

    /// Stores an item in the archive, with the resulting gap records and frame sets.
    pub(super) fn store(&mut self, item: Outgoing) -> Result<(), WriteError> {
        match item {
            Outgoing::Frame {
                camera,
                frame,
                unit,
                key,
            } => {
                let time = HostTime(frame.time);
                let host = HostTime(frame.host_time);
                self.without_key[camera] &= !key;
                if self.without_key[camera]
                    || !self.place(camera, frame.number, 1, time, time, host)?
                {
                    return Ok(());
                }
                let number = frame.number;
                let stream = &mut self.streams[camera];
                stream.bytes += unit.len() as u64;
                self.writer.append_frame(&stream.name, frame, &unit, key)?;
                // A frame that was just lost must not get into a set.
                self.record_incidents();
                for set in self.sets.push(camera, number, time) {
                    self.frame_set(&set, host)?;
                }
                Ok(())
            }
            Outgoing::Imu { imu, batch } => {
                let (Some(&start), Some(&end)) = (batch.times.first(), batch.times.last()) else {
                    return Ok(());
                };
                let (start, end) = (HostTime(start), HostTime(end));
                let host = HostTime(batch.host_times.last().copied().unwrap_or(end.0));
                let n = batch.device_ticks.len() as u64;
                let position = self.cameras + imu;
                if self.place(position, batch.first_number, n, start, end, host)? {
                    let stream = &mut self.streams[position];
                    stream.bytes += prost_len(&batch);
                    self.writer.append(&stream.name, start, host, &batch)?;
                }
                Ok(())
            }
            Outgoing::Clock { at, map } => self.writer.append(&map.clock, at, at, &map),
            Outgoing::Dropped {
                stream,
                first,
                last,
                cause,
                detail,
                at: _,
            } => {
                self.dropped(&stream, first, last, cause, &detail);
                Ok(())
            }
            Outgoing::Alarm { .. } | Outgoing::Notice { .. } | Outgoing::Health { .. } => Ok(()),
        }
    }

    /// Ends the active alarms about losses with the session.
    pub(super) fn end_losses(&mut self) -> Vec<(String, bool)> {
        let losses = self.streams.iter_mut().map(|stream| &mut stream.losses);
        losses.filter_map(Losses::end).collect()
    }

    /// Marks samples that are on disk now.
    pub(super) fn record_durable(&mut self) {
        let until = self.writer.durability().until;
        self.pending.retain(|(time, ..)| *time > until);
    }

    fn frame_set(&mut self, set: &FrameSet, host: HostTime) -> Result<(), WriteError> {
        let name = |camera: usize| self.streams[camera].name.clone();
        let members = set.members.iter().map(|m| MemberRecord {
            camera: name(m.camera),
            number: m.number,
            time: m.time.0,
        });
        let record = FrameSetRecord {
            number: set.number,
            time: set.time.0,
            members: members.collect(),
            missing: set.missing.iter().map(|c| name(*c)).collect(),
        };
        self.writer.append("", set.time, host, &record)
    }

    /// At the end of all samples: stores the last frame sets, and gaps for losses reported behind
    /// the last samples. Runs to its end even if the disk fails, for the account.
    pub(super) fn settle(&mut self) -> Result<(), WriteError> {
        let mut result = Ok(());
        for set in self.sets.flush() {
            result = result.and(self.frame_set(&set, self.last));
        }
        result.and(self.last_gaps())
    }

    /// Ends the session; returns whether everything is on disk.
    pub(super) fn close(&mut self, stop: Stop) -> Result<(), WriteError> {
        let closed = self.writer.close(stop);
        self.record_incidents();
        closed.map(|_| ())
    }

    /// After a permanent failure of the disk: counts samples that are not known to be on it as
    /// missing.
    pub(super) fn write_off(&mut self) {
        self.record_durable();
        for (_, stream, count) in std::mem::take(&mut self.pending) {
            let stream = &mut self.streams[stream];
            let lost = count.min(stream.stored);
            stream.stored -= lost;
            stream.missing += lost;
            stream.losses.gap(Cause::Storage, lost);
        }
        self.last = self.last.min(self.writer.durability().until);
    }
}

fn prost_len(message: &impl session_archive::record::Protobuf) -> u64 {
    message.encoded_len() as u64
}
