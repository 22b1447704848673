use std::time::Duration;

use super::*;
use crate::NS_PER_S;
use crate::sysfs::fake::tree;

const CIVIL: i64 = 1_790_000_000 * NS_PER_S;

fn at(monotonic_ns: i64, civil_offset_ns: i64, suspended_ns: i64) -> ClockReading {
    ClockReading {
        monotonic_ns,
        realtime_ns: monotonic_ns + civil_offset_ns,
        boottime_ns: monotonic_ns + suspended_ns,
        apart_ns: 400,
        kernel: None,
    }
}

fn events(readings: &[ClockReading]) -> Vec<ClockEvent> {
    let mut watch = ClockWatch::new();
    let events = readings.iter().flat_map(|reading| watch.judge(reading).1);
    events.collect()
}

#[test]
fn a_clock_that_goes_on_is_no_event() {
    let readings: Vec<ClockReading> = (0..100)
        .map(|s| at(s * NS_PER_S, CIVIL + s % 3 * 300, 0))
        .collect();
    assert_eq!(events(&readings), []);
    let state = ClockWatch::new().judge(&readings[0]).0;
    assert_eq!(state.civil_offset_ns, CIVIL);
    assert_eq!(state.synchronised, None);
}

#[test]
fn steps_are_reported_once_with_their_size() {
    let hour = 3600 * NS_PER_S;
    let check = |by_ns: i64| {
        let readings = [
            at(0, CIVIL, 0),
            at(NS_PER_S, CIVIL + by_ns, 0),
            at(2 * NS_PER_S, CIVIL + by_ns, 0),
        ];
        assert_eq!(events(&readings), [ClockEvent::Step { by_ns }]);
    };
    check(hour);
    check(-hour);
    check(50_000);
    check(-50_000);
    // Before 1970, and the far future.
    check(-CIVIL - hour);
    check(i64::MAX / 4);
    let text = ClockEvent::Step { by_ns: -hour }.to_string();
    assert_eq!(
        text,
        "civil time was set by -3600.000000 s; recorded time is untouched"
    );
}

#[test]
fn a_suspension_is_no_step() {
    let sleep = 90 * NS_PER_S;
    let readings = [
        at(0, CIVIL, 0),
        at(NS_PER_S, CIVIL + sleep, sleep),
        at(2 * NS_PER_S, CIVIL + sleep, sleep),
    ];
    assert_eq!(events(&readings), [ClockEvent::Suspended { for_ns: sleep }]);
    let set_on_waking = [
        readings[0].clone(),
        at(NS_PER_S, CIVIL + sleep + NS_PER_S, sleep),
    ];
    assert_eq!(
        events(&set_on_waking),
        [
            ClockEvent::Suspended { for_ns: sleep },
            ClockEvent::Step { by_ns: NS_PER_S }
        ]
    );
}

#[test]
fn an_interrupted_reading_is_no_step() {
    let mut late = at(NS_PER_S, CIVIL + 3_000_000, 1_000_000);
    late.apart_ns = 5_000_000;
    assert_eq!(
        events(&[at(0, CIVIL, 0), late, at(2 * NS_PER_S, CIVIL, 0)]),
        []
    );
}

#[test]
fn synchronisation_comes_and_goes() {
    let kernel = |synchronised| {
        Some(Kernel {
            synchronised,
            offset_ns: 0,
            estimated_error_ns: 0,
            max_error_ns: 0,
            frequency_ppb: 0,
            tai_offset_s: 37,
            leap: Leap::None,
        })
    };
    let readings: Vec<ClockReading> = [
        Some(false),
        None,
        Some(false),
        Some(true),
        Some(true),
        Some(false),
    ]
    .iter()
    .enumerate()
    .map(|(s, synchronised)| {
        let mut reading = at(s as i64 * NS_PER_S, CIVIL, 0);
        reading.kernel = synchronised.and_then(kernel);
        reading
    })
    .collect();
    assert_eq!(
        events(&readings),
        [
            ClockEvent::Synchronised { now: true },
            ClockEvent::Synchronised { now: false }
        ]
    );
}

#[test]
fn the_kernels_words_are_understood() {
    // SAFETY: a plain struct of integers.
    let mut timex: libc::timex = unsafe { std::mem::zeroed() };
    timex.status = libc::STA_NANO | libc::STA_PLL;
    timex.offset = -1234;
    timex.esterror = 25;
    timex.maxerror = 500;
    timex.freq = 25 << 16 | 1 << 15;
    timex.tai = 37;
    assert_eq!(
        read::meaning(libc::TIME_INS, &timex),
        Kernel {
            synchronised: true,
            offset_ns: -1234,
            estimated_error_ns: 25_000,
            max_error_ns: 500_000,
            frequency_ppb: 25_500,
            tai_offset_s: 37,
            leap: Leap::Insert,
        }
    );
    timex.status = libc::STA_UNSYNC;
    let kernel = read::meaning(libc::TIME_ERROR, &timex);
    assert!(!kernel.synchronised);
    assert_eq!(
        kernel.offset_ns, -1_234_000,
        "microseconds without STA_NANO"
    );
}

#[test]
fn who_keeps_the_clock_is_seen_from_outside() {
    let check = |files: &str, expected: &str| {
        let (_root, roots) = tree(files);
        assert_eq!(discipline(&roots).to_string(), expected);
    };
    check("proc/version = x", "nobody");
    check("proc/1/comm = systemd\nproc/812/comm = chronyd", "chrony");
    check(
        "proc/7/comm = phc2sys\nproc/8/comm = ptp4l\nproc/9/comm = ptp4l",
        "ptp4l, phc2sys",
    );
    let (_root, roots) = tree(
        "proc/300/comm = systemd-timesyn
        run/systemd/timesync/synchronized =
        sys/class/ptp/ptp0/clock_name = stmmac ptp",
    );
    let found = discipline(&roots);
    assert_eq!(found.programs, ["systemd-timesyncd"]);
    assert!(found.timesyncd_has_synchronised);
    assert_eq!(found.ptp_clocks, ["stmmac ptp"]);
}

#[test]
fn the_machines_clocks_agree_with_themselves() {
    let mut watch = ClockWatch::new();
    let first = read();
    assert!(first.realtime_ns > first.monotonic_ns);
    watch.judge(&first);
    let alarm = StepAlarm::new().unwrap();
    assert!(
        !alarm.wait(Duration::from_millis(20)).unwrap(),
        "nobody sets the clock"
    );
    assert!(!alarm.take().unwrap());
    let second = read();
    assert!(second.monotonic_ns - first.monotonic_ns >= 20_000_000);
    let (state, events) = watch.judge(&second);
    assert_eq!(events, []);
    assert_eq!(state.apart_ns, second.apart_ns);
}
