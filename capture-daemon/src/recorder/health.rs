//! State of machine and clocks in the form of health records.

use session_archive::record::paws::health::{Battery, Clock, FrameSync as FrameSyncRecord};

use crate::sources::FrameSync;
use crate::status::{BatteryStatus, ClockStatus};

pub(super) fn clock_record(clock: &ClockStatus) -> Clock {
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

pub(super) fn battery_record(battery: &BatteryStatus) -> Battery {
    Battery {
        percent: battery.percent,
        charging: battery.charging,
        minutes_left: battery.minutes_left,
    }
}

pub(super) fn frame_sync_record((sync, offset_ns): (FrameSync, i64)) -> FrameSyncRecord {
    FrameSyncRecord {
        offset_ns,
        sigma_ns: sync.sigma_ns,
        residual_median_ns: sync.residual_median_ns,
        residual_p99_ns: sync.residual_p99_ns,
        pairs: sync.pairs,
        count_minus_number: sync.count_minus_number,
    }
}
