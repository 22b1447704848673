//! Monitor of the machine, read once a second: heat, power, disk, clock.

use std::path::PathBuf;

use machine::Roots;
use machine::battery::{self, Power, Status};
use machine::clock::{self, ClockEvent, ClockWatch};
use machine::disk::{self, DiskWatch};
use machine::ladder::Pressure;
use machine::thermal::{self, Thermometer};
use session_archive::time::{HostTime, NS_PER_S};

use crate::recorder::MachineReading;
use crate::status::{BatteryStatus, ClockStatus, MachineStatus};

/// Monitor with the previous readings, for values that follow from two readings.
pub(super) struct MachineMonitor {
    roots: Roots,
    folder: PathBuf,
    thermometer: Thermometer,
    disk: DiskWatch,
    clock: ClockWatch,
    /// Discipline of the civil clock, and the time of that reading.
    source: (String, Option<HostTime>),
}

/// Interval between readings of the clock's discipline, ns: each goes through all processes.
const DISCIPLINE_INTERVAL_NS: i64 = 30 * NS_PER_S;

impl MachineMonitor {
    /// Sessions are written to `folder`, and at least `reserve_bytes` are left free.
    pub(super) fn new(folder: PathBuf, reserve_bytes: u64) -> Self {
        Self {
            roots: Roots::default(),
            folder,
            thermometer: Thermometer::new(),
            disk: DiskWatch::new(reserve_bytes),
            clock: ClockWatch::new(),
            source: (String::new(), None),
        }
    }

    fn clock_source(&mut self, now: HostTime) -> String {
        if self
            .source
            .1
            .is_none_or(|at| now.since(at) >= DISCIPLINE_INTERVAL_NS)
        {
            let programs = clock::discipline(&self.roots).programs;
            self.source = (programs.join(" "), Some(now));
        }
        self.source.0.clone()
    }

    pub(super) fn read(&mut self, now: HostTime, recording: bool) -> MachineReading {
        let heat = self
            .thermometer
            .judge(&thermal::Readings::read(&self.roots));
        let readings = battery::Readings::read(&self.roots);
        let power = battery::judge(&readings, None);
        if !recording {
            // The present write rate of other programs is no estimate for a future recording.
            self.disk.begin_recording();
        }
        let disk = self.disk.judge(now.0, &disk::reading(&self.folder));
        let clock_reading = clock::read();
        let (state, clock_events) = self.clock.judge(&clock_reading);
        let step_ns = clock_events.iter().find_map(|event| match event {
            ClockEvent::Step { by_ns } => Some(*by_ns),
            _ => None,
        });
        let source = self.clock_source(now);
        let kernel = state.kernel.as_ref();
        let error = |of: fn(&clock::Kernel) -> i64| kernel.map_or(0, of).unsigned_abs();
        let status = MachineStatus {
            temperature_c: heat.hottest_c,
            throttled: heat.throttled,
            battery: battery_status(&power, &readings),
            clock: Some(ClockStatus {
                civil: clock_reading.realtime_ns,
                synchronised: state.synchronised == Some(true),
                source,
                offset_ns: kernel.map_or(0, |k| k.offset_ns),
                error_ns: error(|k| k.estimated_error_ns),
                max_error_ns: error(|k| k.max_error_ns),
                step_ns: step_ns.unwrap_or(0),
            }),
        };
        let pressure = Pressure {
            heat: Some(heat),
            power: Some(power),
            disk: Some(disk),
            encoder_fill: None,
        };
        let events = clock_events.iter().map(ToString::to_string).collect();
        MachineReading {
            status,
            pressure,
            events,
        }
    }
}

fn battery_status(power: &Power, readings: &battery::Readings) -> Option<BatteryStatus> {
    Some(BatteryStatus {
        percent: power.percent?,
        charging: readings
            .batteries
            .iter()
            .any(|b| b.status == Status::Charging),
        minutes_left: power.minutes_left,
    })
}
