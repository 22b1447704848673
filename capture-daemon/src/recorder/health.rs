//! Every second: the health record, and the checks that depend on it.

use session_archive::record::Health;
use session_archive::record::paws::health::{
    Battery, Clock, FrameSync as FrameSyncRecord, Stream as StreamRecord,
};
use session_archive::time::HostTime;

use super::Recorder;
use super::machine_watch::step_name;
use crate::hub::StreamHealth;
use crate::sources::FrameSync;
use crate::status::{BatteryStatus, ClockStatus};

impl Recorder {
    pub(super) fn on_health(&mut self, at: HostTime, streams: Vec<StreamHealth>) {
        // While nobody stores frames, this shows that they arrive.
        for (delivered, stream) in self.delivered.iter_mut().zip(&streams) {
            *delivered |= stream.received > 0;
        }
        self.health = streams;
        self.free_bytes = self.store.free_bytes();
        self.check_machine(at);
        self.check_losses(at);
        let Some(session) = &mut self.session else {
            return self.guard_disk(at, None);
        };
        let (write_max_ns, sync_max_ns) = session.timed.take_max_durations();
        let durability = session.writer.durability();
        let mut written = 0;
        let streams = self
            .health
            .iter()
            .zip(&mut session.streams)
            .map(|(health, tally)| {
                let bytes = tally.bytes - tally.bytes_before;
                tally.bytes_before = tally.bytes;
                written += bytes;
                StreamRecord {
                    name: health.name.clone(),
                    rate_hz: health.rate_hz,
                    received: health.received,
                    stored: tally.stored,
                    missing: tally.missing,
                    queue_bytes: health.queue_bytes,
                    bitrate: 8.0 * bytes as f64,
                    silent: health.silent,
                    frozen: health.frozen,
                    frame_sync: health.frame_sync.map(frame_sync_record),
                }
            });
        let record = Health {
            streams: streams.collect(),
            writer_queue_bytes: (self.queues.bytes)(),
            write_max_ns,
            sync_max_ns,
            free_bytes: self.free_bytes.unwrap_or(0),
            temperature_c: self.machine.temperature_c,
            durable_until: durability.until.0,
            clock: self.machine.clock.as_ref().map(clock_record),
            battery: self.machine.battery.as_ref().map(battery_record),
            throttled: self.machine.throttled,
            degradation: step_name(self.ladder.step()).to_owned(),
        };
        let stored = session.writer.append("", at, at, &record);
        self.check(stored);
        self.guard_disk(at, Some(written));
    }
}

fn clock_record(clock: &ClockStatus) -> Clock {
    Clock {
        civil: clock.civil,
        synchronised: clock.synchronised,
        source: clock.source.clone(),
        offset_ns: clock.offset_ns,
        error_ns: clock.error_ns,
        max_error_ns: clock.max_error_ns,
        step_ns: clock.step_ns,
    }
}

fn battery_record(battery: &BatteryStatus) -> Battery {
    Battery {
        percent: battery.percent,
        charging: battery.charging,
        minutes_left: battery.minutes_left,
    }
}

fn frame_sync_record((sync, offset_ns): (FrameSync, i64)) -> FrameSyncRecord {
    FrameSyncRecord {
        offset_ns,
        sigma_ns: sync.sigma_ns,
        residual_median_ns: sync.residual_median_ns,
        residual_p99_ns: sync.residual_p99_ns,
        pairs: sync.pairs,
        count_minus_number: sync.count_minus_number,
    }
}
