//! Faults of the button, and of the clock on the wall.

use anyhow::{Result, ensure};

use super::{Fault, FaultRun, case};
use crate::case::{Bench, Case, Report};

fn happen(bench: &Bench, during: &'static str) -> Result<FaultRun> {
    let fault = Fault {
        during,
        ..Fault::default()
    };
    fault.happen(bench)
}

/// Two sessions, both whole; the first one was stopped by a button.
fn two_takes(bench: &Bench, left: &FaultRun, line: &str) -> Result<Report> {
    left.two_whole_sessions("button")?;
    left.report(bench, &[], line.to_owned())
}

/// While it is away the light's line is held by the daemon, so the chip that comes back has another
/// number: the lines are configured by their names.
pub(super) const BUTTON_GONE: Case = case(
    "fault-button-gone",
    "the GPIO chip with button and light goes for 3 s; then the button stops and starts, and the light shows it",
    |bench| {
        let during = "rig=/sys/kernel/config/gpio-sim/rig
            echo 0 >$rig/live; sleep 3; gpio_chip || exit 4; sleep 2
            press; until_state armed || exit 3
            sleep 2; press; until_state recording || exit 2
            sleep 2; light >light.txt";
        let left = happen(bench, during)?;
        let light = left.file("light.txt")?;
        ensure!(light.trim() == "1", "the light is {light:?} in a recording");
        two_takes(
            bench,
            &left,
            "the button works again, the light too, nothing is missing",
        )
    },
);

pub(super) const KEY_GONE: Case = case(
    "fault-key-gone",
    "the input device with the key is plugged in, out and in during a recording; then it stops and starts",
    |bench| {
        let during =
            "vm-button unplug@1 plug@3 press@6 press@9 unplug@14 end@15 >button.txt & key=$!
            until_true state armed || exit 4; until_state recording || exit 3; wait $key";
        let left = happen(bench, during)?;
        two_takes(bench, &left, "the key works again, nothing is missing")
    },
);

pub(super) const CLOCK_STEP: Case = case(
    "fault-clock-step",
    "civil time is set an hour forward and back, and an hour back and forward",
    |bench| {
        let during = "for by in '+1 hour' '-1 hour' '-1 hour' '+1 hour'; do
            date -s \"$by\" >/dev/null; sleep 3; done";
        let left = happen(bench, during)?;
        left.others_are_whole(&[])?;
        let session = left.session()?;
        let steps = session.clock_steps.iter();
        let hours: Vec<i64> = steps
            .map(|ns| (*ns as f64 / 3.6e12).round() as i64)
            .collect();
        ensure!(
            hours == [1, -1, -1, 1],
            "steps of {hours:?} h were recorded"
        );
        let clock_events = session
            .events
            .iter()
            .filter(|(_, source, _)| source == "clock");
        ensure!(clock_events.count() == 4, "{:?}", session.events);
        left.report(
            bench,
            &[],
            "all four steps are events, recorded times are untouched, nothing is missing".into(),
        )
    },
);
