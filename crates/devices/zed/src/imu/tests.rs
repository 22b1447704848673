use super::fake::{FakePort, Fault, World, world};
use super::*;
use std::rc::Rc;

const S: i64 = 1_000_000_000;
const MS: i64 = 1_000_000;

/// What was seen until `until`, ns after the start: events other than samples with the time in ms,
/// and the numbers.
struct DriverRun {
    events: Vec<(i64, Event)>,
    numbers: Vec<u64>,
    counters: Counters,
    rate_hz: f64,
}

/// Runs the driver in a world; a device that is disconnected is looked for every 100 ms.
fn run(world: &Rc<World>, until: i64) -> DriverRun {
    let start = world.now.get();
    let clock = || world.now.get();
    let mut imu = Imu::open(FakePort(world.clone()), start).expect("it is there");
    let (mut events, mut numbers) = (Vec::new(), Vec::new());
    while clock() - start < until {
        match imu.next(&clock, start + until) {
            Event::Sample(arrival) => {
                assert_eq!(arrival.host_ns, clock());
                numbers.push(arrival.numbered.number);
            }
            Event::Gone { .. } if matches!(events.last(), Some((_, Event::Gone { .. }))) => {}
            event => events.push(((clock() - start) / MS, event)),
        }
        if !imu.is_open() {
            world.now.set(clock() + 100 * MS);
            if imu.try_reopen(clock()).is_ok() {
                events.push(((clock() - start) / MS, Event::Reopened));
            }
        }
    }
    DriverRun {
        events,
        numbers,
        counters: imu.counters(),
        rate_hz: imu.rate_hz().unwrap_or(0.0),
    }
}

/// The times of events without what they say.
fn names(seen: &DriverRun) -> Vec<(i64, &'static str)> {
    let name = |(at, event): &(i64, Event)| {
        let name = match event {
            Event::Silent { .. } => "silent",
            Event::Restarted { .. } => "restarted",
            Event::Reopened => "reopened",
            Event::Gone { .. } => "gone",
            Event::Malformed(_) => "malformed",
            Event::Nothing => return None,
            Event::Sample(_) => "sample",
        };
        Some((*at, name))
    };
    seen.events.iter().filter_map(name).collect()
}

#[test]
fn a_minute_of_samples_is_a_minute_of_samples() {
    for rate in [400, 800, 1000] {
        let world = world(rate, &[]);
        let seen = run(&world, 60 * S);
        assert_eq!(names(&seen), []);
        let sent = world.state.borrow().sent;
        assert!(sent >= 60 * rate as u64 - 1);
        assert_eq!(seen.numbers, (0..sent).collect::<Vec<_>>());
        assert_eq!((seen.counters.samples, seen.counters.lost), (sent, 0));
        assert!(
            (seen.rate_hz / rate as f64 - 1.0).abs() < 1e-3,
            "{}",
            seen.rate_hz
        );
    }
}

#[test]
fn the_stream_is_pinged_each_second_and_stopped_at_the_end() {
    let world = world(800, &[]);
    run(&world, 10 * S + 100 * MS);
    let state = world.state.borrow();
    let commands: Vec<_> = state
        .commands
        .iter()
        .map(|(at, c)| ((at - 100 * S) / MS, &c[..]))
        .collect();
    let mut expected: Vec<(i64, &[u8])> = vec![(0, &[0x32, 1]), (0, &[0x21, 0xf2])];
    expected.extend((1..=10).map(|s| (s * 1000, &[0x21, 0xf2][..])));
    expected.push((10_100, &[0x32, 0]));
    assert_eq!(commands, expected);
}

#[test]
fn a_silent_device_is_reported_and_started_again() {
    let world = world(800, &[Fault::Stopped(105 * S)]);
    let seen = run(&world, 10 * S);
    assert_eq!(names(&seen), [(5498, "silent"), (5498, "restarted")]);
    assert_eq!(
        seen.events[1].1,
        Event::Restarted {
            streaming: Some(true)
        }
    );
    // The device's clock went on: what is missing is known to the sample.
    assert!(
        (398..=401).contains(&seen.counters.lost),
        "{}",
        seen.counters.lost
    );
}

#[test]
fn a_device_that_is_deaf_to_starts_is_started_until_it_hears() {
    let world = world(400, &[Fault::Stopped(102 * S), Fault::Deaf(102 * S, 3)]);
    let seen = run(&world, 10 * S);
    let expected = [
        (2497, "silent"),
        (2497, "restarted"),
        (3497, "reopened"),
        (3997, "restarted"),
        (4997, "reopened"),
    ];
    assert_eq!(names(&seen), expected);
    assert_eq!(
        seen.events[1].1,
        Event::Restarted {
            streaming: Some(false)
        }
    );
    let counters = seen.counters;
    assert_eq!((counters.restarts, counters.reopens), (2, 2));
    assert!(counters.samples > 2700, "{counters:?}");
}

#[test]
fn a_stuck_device_is_opened_again() {
    let world = world(800, &[Fault::Stuck(103 * S)]);
    let seen = run(&world, 6 * S);
    assert_eq!(
        names(&seen),
        [(3498, "silent"), (3498, "restarted"), (4498, "reopened")]
    );
    assert!(
        (1195..=1205).contains(&seen.counters.lost),
        "{:?}",
        seen.counters
    );
}

#[test]
fn a_device_that_goes_and_returns_goes_on() {
    let world = world(800, &[Fault::Gone(103 * S, 105 * S)]);
    let seen = run(&world, 10 * S);
    let names = names(&seen);
    assert_eq!(names.len(), 2, "{names:?}");
    assert_eq!(names[0].1, "gone");
    assert!(
        (3000..3010).contains(&names[0].0) && (5000..5120).contains(&names[1].0),
        "{names:?}"
    );
    let Event::Gone { detail } = &seen.events[0].1 else {
        panic!("{:?}", seen.events);
    };
    assert_eq!(detail, "talking to a fake: no such device");
    // Its clock restarted, so the loss is by the host's time: two seconds and until it was found.
    assert!(
        (1599..1700).contains(&seen.counters.lost),
        "{:?}",
        seen.counters
    );
    assert!(seen.numbers.is_sorted_by(|a, b| a < b));
}

#[test]
fn refused_pings_end_the_stream_and_the_watchdog_brings_it_back() {
    let world = world(800, &[Fault::Refusing(102 * S, 110 * S)]);
    let seen = run(&world, 20 * S);
    // The last ping was at 1 s; six seconds later the device gives up. A start of the stream counts
    // as one.
    assert_eq!(names(&seen), [(7498, "silent"), (7498, "restarted")]);
    assert!(seen.counters.pings_refused >= 8, "{:?}", seen.counters);
    assert!(
        (395..=405).contains(&seen.counters.lost),
        "{:?}",
        seen.counters
    );
}

#[test]
fn a_read_that_is_no_report_is_counted_and_skipped() {
    let world = world(800, &[Fault::Garbage(101 * S)]);
    let seen = run(&world, 2 * S);
    assert_eq!(names(&seen), [(1000, "malformed")]);
    assert_eq!(seen.counters.malformed, 1);
    assert_eq!(seen.counters.lost, 0);
}

#[test]
fn a_short_silence_is_nobodys_business() {
    let world = world(800, &[Fault::Silent(101 * S, 101 * S + 400 * MS)]);
    let seen = run(&world, 3 * S);
    assert_eq!(names(&seen), []);
    assert!(
        (319..=321).contains(&seen.counters.lost),
        "{:?}",
        seen.counters
    );
}

#[test]
fn what_waits_at_the_end_is_not_lost() {
    let world = world(800, &[]);
    let clock = || world.now.get();
    let mut imu = Imu::open(FakePort(world.clone()), clock()).expect("it is there");
    let Event::Sample(first) = imu.next(&clock, clock() + S) else {
        panic!("a sample")
    };
    assert_eq!(first.numbered.number, 0);
    // The reader was away for a twentieth of a second.
    world.now.set(clock() + 50 * MS);
    let (left, counters) = imu.finish(&clock);
    assert_eq!((left.len(), counters.samples, counters.lost), (40, 41, 0));
    assert_eq!(world.state.borrow().sent, 41);
}

#[test]
fn what_is_not_there_is_not_opened() {
    let world = world(800, &[Fault::Gone(0, 200 * S)]);
    let error = Imu::open(FakePort(world), 0).expect_err("it is not there");
    assert_eq!(error.to_string(), "looking for a fake: found none");
}
