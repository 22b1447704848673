//! Writes the gap records of a session, and keeps its account of stored and missing samples.
//!
//! Contract: samples and gap records together are every number of a stream from its first to its
//! last, exactly once. Which numbers are missing is found by
//! [`SequenceTracker`](crate::sync::sequence_tracker::SequenceTracker).

use session_archive::record::Gap;
use session_archive::record::paws::gap::Cause;
use session_archive::time::HostTime;
use session_archive::writer::WriteError;

use super::session::Session;

impl Session {
    /// Samples will not arrive; their gap record is written before the stream's next sample, or at
    /// the end.
    pub(super) fn dropped(
        &mut self,
        stream: &str,
        first: u64,
        last: u64,
        cause: Cause,
        detail: &str,
    ) {
        if let Some(stream) = self.streams.iter_mut().find(|s| s.name == stream) {
            stream.tracker.dropped(first, last, cause, detail);
            stream.losses.report(cause);
        }
    }

    /// Accounts for samples; false if they are late or repeated and must not be stored.
    pub(super) fn place(
        &mut self,
        stream: usize,
        first: u64,
        count: u64,
        start: HostTime,
        end: HostTime,
        host: HostTime,
    ) -> Result<bool, WriteError> {
        let tally = &mut self.streams[stream];
        let Some(gaps) = tally.tracker.samples(first, count, start, end) else {
            log::warn!("{}: samples from {first} were late or repeated", tally.name);
            return Ok(false);
        };
        tally.stored += count;
        self.pending.push_back((start, stream, count));
        for gap in gaps {
            self.gap(stream, &gap, start, host)?;
        }
        self.first = Some(self.first.map_or(start, |f| f.min(start)));
        self.last = self.last.max(end);
        Ok(true)
    }

    fn gap(
        &mut self,
        stream: usize,
        gap: &Gap,
        at: HostTime,
        host: HostTime,
    ) -> Result<(), WriteError> {
        let tally = &mut self.streams[stream];
        tally.missing += gap.count();
        tally.losses.gap(gap.cause(), gap.count());
        self.writer.append("", at, host, gap)
    }

    /// Counts samples that the writer could not store as missing; it has written the gap records
    /// itself.
    pub(super) fn record_incidents(&mut self) {
        for incident in self.writer.take_incidents() {
            for gap in &incident.lost {
                self.record_loss(gap);
            }
            self.incidents.push(incident);
        }
    }

    fn record_loss(&mut self, gap: &Gap) {
        let Some(position) = self.streams.iter().position(|s| s.name == gap.stream) else {
            return;
        };
        let stream = &mut self.streams[position];
        stream.missing += gap.count();
        stream.losses.gap(gap.cause(), gap.count());
        stream.losses.report(gap.cause());
        stream.stored = stream.stored.saturating_sub(gap.count());
        if position < self.cameras {
            self.sets.forget(position, gap.first, gap.last);
        }
    }

    /// At the end of all samples: the gaps of losses reported behind the last ones. Runs to its end
    /// even if the disk fails, for the account.
    pub(super) fn last_gaps(&mut self) -> Result<(), WriteError> {
        let mut result = Ok(());
        for stream in 0..self.streams.len() {
            for gap in self.streams[stream].tracker.finish() {
                result = result.and(self.gap(stream, &gap, self.last, self.last));
            }
        }
        result
    }
}
