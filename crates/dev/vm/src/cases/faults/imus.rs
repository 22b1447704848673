//! Faults of the IMU.

use anyhow::{Result, ensure};
use session_archive::record::paws::event::Kind;
use session_archive::record::paws::gap::Cause;

use super::{Fault, FaultRun, case};
use crate::case::{Bench, Case};
use crate::cases::config::IMU;

/// The IMU with these arguments, in a recording that begins in its first second and ends in its
/// sixteenth.
fn happen(bench: &Bench, given: &'static str) -> Result<FaultRun> {
    let fault = Fault {
        given,
        during: "sleep 9",
        ..Fault::default()
    };
    fault.happen(bench)
}

/// Only the IMU is hit, it is back, and misses this number of samples.
fn misses(left: &FaultRun, cause: Cause, expected: std::ops::Range<u64>) -> Result<u64> {
    left.others_are_whole(&[IMU])?;
    left.is_back(IMU)?;
    let missing = left.missing(IMU, cause)?;
    ensure!(
        expected.contains(&missing),
        "{IMU} misses {missing}, expected {expected:?}: {:?}",
        left.session()?.gaps
    );
    Ok(missing)
}

/// Number of actions that the watchdog has reported.
fn reports(left: &FaultRun, what: &str) -> Result<usize> {
    let events = left.session()?.events.iter();
    let warnings = events.filter(|(kind, source, text)| {
        *kind == Kind::Warning && source == IMU && text.contains(what)
    });
    Ok(warnings.count())
}

pub(super) const SILENT: Case = case(
    "fault-imu-silent",
    "the IMU sends nothing for 3 s and cannot be talked into it",
    |bench| {
        let left = happen(bench, "IMU='--silent 6:3'")?;
        let missing = misses(&left, Cause::Device, 2400..2410)?;
        let tries = reports(&left, "because it was silent")?;
        ensure!(tries > 0, "the watchdog did nothing");
        left.report(
            bench,
            &[],
            format!(
                "{missing} samples are missing, after {tries} attempts of the watchdog it is back"
            ),
        )
    },
);

pub(super) const STOPPED: Case = case(
    "fault-imu-stopped",
    "the IMU ends its stream by itself",
    |bench| {
        let left = happen(bench, "IMU='--stopped 6'")?;
        let missing = misses(&left, Cause::Device, 390..450)?;
        let restarts = reports(&left, "stopped and started")?;
        ensure!(restarts == 1, "{restarts} restarts by the watchdog");
        left.report(
            bench,
            &[],
            format!(
                "{missing} samples are missing: the watchdog waits half a second and starts it"
            ),
        )
    },
);

pub(super) const DEAF: Case = case(
    "fault-imu-deaf",
    "the IMU ends its stream by itself and ignores two commands to start",
    |bench| {
        let left = happen(bench, "IMU='--stopped 6 --ignore-starts 2'")?;
        let missing = misses(&left, Cause::Device, 800..4000)?;
        let tries = reports(&left, "because it was silent")?;
        ensure!(tries > 1, "{tries} attempts of the watchdog");
        left.report(
            bench,
            &[],
            format!("{missing} samples are missing, {tries} attempts of the watchdog"),
        )
    },
);

/// The daemon pings once a second.
pub(super) const LATE_PINGS: Case = case(
    "fault-imu-keep-alive",
    "the IMU wants a ping each 0.7 s, so its keep-alive is lost again and again",
    |bench| {
        let left = happen(bench, "IMU='--keep-alive 0.7'")?;
        let restarts = reports(&left, "stopped and started")?;
        let most = 450 * restarts as u64;
        let missing = misses(&left, Cause::Device, 400..most)?;
        ensure!(restarts > 5, "{restarts} restarts by the watchdog");
        left.report(
            bench,
            &[],
            format!(
                "{restarts} times started again within half a second, {missing} samples are missing"
            ),
        )
    },
);

pub(super) const GONE: Case = case("fault-imu-gone", "the IMU is unplugged for 3 s", |bench| {
    let left = happen(bench, "IMU='--gone 6:3'")?;
    let missing = misses(&left, Cause::Disconnected, 2390..2480)?;
    left.report(
        bench,
        &[],
        format!("{missing} samples are missing, back at once, its numbers go on"),
    )
});
