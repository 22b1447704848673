use proptest::prelude::*;

use super::*;
use crate::NS_PER_S;
use crate::disk::{DiskWatch, Space};

fn ladder() -> Ladder {
    Ladder::new(Limits::default()).unwrap()
}

fn hot(margin_c: f64) -> Pressure {
    Pressure {
        heat: Some(Heat {
            hottest_c: Some(99.0 - margin_c),
            zone: "cpu-thermal".into(),
            margin_c: Some(margin_c),
            margin_zone: "cpu-thermal".into(),
            critical_margin_c: Some(margin_c + 5.5),
            throttled: Some(margin_c < 0.0),
            detail: String::new(),
        }),
        ..Pressure::default()
    }
}

fn disk(usable_mb: f64, mb_per_s: f64) -> Pressure {
    Pressure {
        disk: Some(DiskState {
            usable_bytes: Some((usable_mb * 1e6) as u64),
            bytes_per_s: Some(mb_per_s * 1e6),
            seconds_left: (mb_per_s > 0.0).then(|| usable_mb / mb_per_s),
            ..DiskState::default()
        }),
        ..Pressure::default()
    }
}

fn battery(percent: f64, minutes: f64, on_battery: bool) -> Pressure {
    Pressure {
        power: Some(Power {
            percent: Some(percent),
            minutes_left: on_battery.then_some(minutes),
            on_battery: Some(on_battery),
            supply_volts: None,
            rail: String::new(),
        }),
        ..Pressure::default()
    }
}

fn encoder(fill: f64) -> Pressure {
    Pressure {
        encoder_fill: Some(fill),
        ..Pressure::default()
    }
}

/// Looks once a second for `seconds`, from `from`; what changed.
fn hold(ladder: &mut Ladder, from: i64, seconds: i64, pressure: &Pressure) -> Vec<Change> {
    (from..from + seconds)
        .flat_map(|s| ladder.reading(s * NS_PER_S, pressure))
        .collect()
}

#[test]
fn a_machine_that_tells_nothing_is_normal() {
    let mut ladder = ladder();
    assert_eq!(hold(&mut ladder, 0, 100, &Pressure::default()), []);
    assert_eq!(ladder.step(), Step::Normal);
    assert_eq!(ladder.mitigations(), Mitigations::default());
    assert!(ladder.reasons().is_empty());
}

#[test]
fn each_cause_goes_as_far_as_helps_against_it() {
    let mitigations = |pressure: Pressure| {
        let mut ladder = ladder();
        hold(&mut ladder, 0, 60, &pressure);
        let m = ladder.mitigations();
        let text: String = [
            (m.warn, 'w'),
            (m.lower_preview, 'p'),
            (m.lower_bitrate, 'b'),
            (m.lower_frame_rate, 'f'),
            (m.stop, 's'),
        ]
        .iter()
        .map(|(is_taken, name)| if *is_taken { *name } else { '-' })
        .collect();
        text
    };
    assert_eq!(mitigations(hot(12.0)), "-----");
    assert_eq!(mitigations(hot(8.0)), "w----");
    assert_eq!(mitigations(hot(4.0)), "wp---");
    assert_eq!(mitigations(hot(0.5)), "wp-f-");
    assert_eq!(mitigations(hot(-4.0)), "wp-fs");
    assert_eq!(mitigations(disk(3700.0, 6.0)), "-----");
    assert_eq!(mitigations(disk(3500.0, 6.0)), "w----");
    assert_eq!(mitigations(disk(1000.0, 6.0)), "w-b--");
    assert_eq!(mitigations(disk(30.0, 6.0)), "w-b-s");
    assert_eq!(
        mitigations(disk(0.0, 0.0)),
        "w---s",
        "full, and nothing is written"
    );
    assert_eq!(mitigations(battery(19.0, 60.0, true)), "w----");
    assert_eq!(mitigations(battery(10.0, 60.0, true)), "wp---");
    assert_eq!(mitigations(battery(4.0, 60.0, true)), "wp--s");
    assert_eq!(
        mitigations(battery(50.0, 2.0, true)),
        "w----",
        "a gauge that lies: what is recorded outlives a battery that ends"
    );
    assert_eq!(mitigations(battery(15.0, 2.0, true)), "w---s");
    let mut only_minutes = battery(50.0, 2.0, true);
    only_minutes.power.as_mut().unwrap().percent = None;
    assert_eq!(mitigations(only_minutes), "w---s");
    assert_eq!(
        mitigations(battery(1.0, 0.0, false)),
        "-----",
        "it is plugged in"
    );
    assert_eq!(mitigations(encoder(0.4)), "-----");
    assert_eq!(mitigations(encoder(0.6)), "wp---");
    assert_eq!(mitigations(encoder(0.8)), "wpb--");
    assert_eq!(mitigations(encoder(1.0)), "wpbf-", "never stops for it");
    let mut slowed = hot(20.0);
    slowed.heat.as_mut().unwrap().throttled = Some(true);
    assert_eq!(mitigations(slowed), "wp---");
    let mut lost = disk(5000.0, 6.0);
    lost.disk.as_mut().unwrap().fault = Some(crate::disk::DiskFault::ReadOnly);
    assert_eq!(mitigations(lost), "w---s");
    let mut inodes = disk(5000.0, 6.0);
    inodes.disk.as_mut().unwrap().low_inodes = true;
    assert_eq!(mitigations(inodes), "w----");
}

#[test]
fn the_voltage_counts_where_limits_are_given() {
    let volts = |volts| Pressure {
        power: Some(Power {
            supply_volts: Some(volts),
            rail: "VDD_IN".into(),
            ..Power::default()
        }),
        ..Pressure::default()
    };
    let mut without = ladder();
    assert_eq!(hold(&mut without, 0, 60, &volts(3.0)), []);
    let limits = Limits {
        supply_warn_volts: Some(11.0),
        supply_stop_volts: Some(10.0),
        ..Limits::default()
    };
    let mut with = Ladder::new(limits).unwrap();
    assert_eq!(hold(&mut with, 0, 60, &volts(11.5)), []);
    hold(&mut with, 60, 60, &volts(10.9));
    assert_eq!(with.step(), Step::Warn);
    let changes = hold(&mut with, 120, 60, &volts(9.9));
    assert_eq!(changes.len(), 1);
    assert_eq!(
        changes[0].text,
        "supply: VDD_IN at 9.90 V; recording must end"
    );
}

#[test]
fn a_measure_is_given_back_late_and_at_an_easier_threshold() {
    let mut ladder = ladder();
    hold(&mut ladder, 0, 60, &hot(5.0));
    assert_eq!(ladder.step(), Step::LowerPreview);
    // Better, but not by enough, for however long.
    assert_eq!(hold(&mut ladder, 60, 600, &hot(9.0)), []);
    // Enough, but not for long enough.
    assert_eq!(hold(&mut ladder, 660, 59, &hot(20.0)), []);
    assert_eq!(hold(&mut ladder, 719, 3, &hot(9.0)), []);
    let changes = hold(&mut ladder, 722, 90, &hot(20.0));
    assert_eq!(changes.len(), 1);
    assert_eq!(
        (changes[0].from, changes[0].to),
        (Step::LowerPreview, Step::Normal)
    );
    // A minute from the second good reading on.
    assert_eq!(changes[0].at_ns, 783 * NS_PER_S);
    assert!(
        changes[0].text.ends_with("all clear"),
        "{}",
        changes[0].text
    );
}

#[test]
fn what_relieves_its_own_cause_is_kept_until_the_next_recording() {
    let mut ladder = ladder();
    hold(&mut ladder, 0, 60, &disk(1000.0, 6.0));
    assert!(ladder.mitigations().lower_bitrate);
    // At half the bitrate twice the time is left.
    hold(&mut ladder, 60, 600, &disk(1000.0, 1.0));
    assert!(ladder.mitigations().lower_bitrate);
    let changes = ladder.begin_recording(660 * NS_PER_S);
    assert_eq!(changes.len(), 1);
    assert!(!ladder.mitigations().lower_bitrate);

    hold(&mut ladder, 700, 10, &encoder(1.0));
    assert!(ladder.mitigations().lower_frame_rate);
    hold(&mut ladder, 710, 600, &encoder(0.0));
    assert!(ladder.mitigations().lower_frame_rate);
}

#[test]
fn a_sensor_that_falls_silent_is_no_news_and_then_gone() {
    let mut ladder = ladder();
    hold(&mut ladder, 0, 60, &hot(5.0));
    hold(&mut ladder, 60, 9, &Pressure::default());
    assert_eq!(ladder.step(), Step::LowerPreview);
    let changes = hold(&mut ladder, 69, 120, &Pressure::default());
    assert_eq!(changes.len(), 1);
    assert_eq!(changes[0].text, "heat: no longer tells; all clear");

    // One that answers every third time still counts, and one reading repeated does not.
    let mut ladder = self::ladder();
    for s in 0..60 {
        let pressure = if s % 3 == 0 {
            hot(5.0)
        } else {
            Pressure::default()
        };
        ladder.reading(s * NS_PER_S, &pressure);
    }
    assert_eq!(ladder.step(), Step::LowerPreview);
    let mut not_a_number = hot(0.0);
    not_a_number.heat.as_mut().unwrap().margin_c = Some(f64::NAN);
    hold(&mut ladder, 60, 9, &not_a_number);
    assert_eq!(ladder.step(), Step::LowerPreview);
}

#[test]
fn limits_that_contradict_each_other_are_refused() {
    let refused = |change: fn(&mut Limits)| {
        let mut limits = Limits::default();
        change(&mut limits);
        Ladder::new(limits).unwrap_err().to_string()
    };
    assert_eq!(
        refused(|l| l.disk_bitrate_s = 700.0),
        "the limit disk_warn_s (600) must come before disk_bitrate_s (700)"
    );
    assert_eq!(
        refused(|l| l.encoder_bitrate_fill = 0.2),
        "the limit encoder_preview_fill (0.5) must come before encoder_bitrate_fill (0.2)"
    );
    assert_eq!(
        refused(|l| l.battery_warn_percent = f64::NAN),
        "the limit battery_warn_percent is NaN, expected 0 to 100"
    );
    assert_eq!(
        refused(|l| l.disk_stop_s = 1.0),
        "the limit disk_stop_s is 1, expected 5 or more, to end cleanly"
    );
    let supply = refused(|l| {
        l.supply_warn_volts = Some(10.0);
        l.supply_stop_volts = Some(11.0);
    });
    assert!(supply.contains("supply_warn_volts (10)"), "{supply}");
}

/// A module in a box on a warm day: heats towards ambient + power · resistance with a time
/// constant. What it draws depends on what the ladder has lowered, and beyond 99 °C its clocks.
struct Box {
    celsius: f64,
}

impl Box {
    fn second(&mut self, ambient_c: f64, base_w: f64, mitigations: Mitigations) {
        const KELVIN_PER_W: f64 = 2.0;
        const TIME_CONSTANT_S: f64 = 240.0;
        let mut watts = base_w;
        if mitigations.lower_preview {
            watts -= 1.5;
        }
        if mitigations.lower_frame_rate {
            watts -= 6.0;
        }
        if mitigations.stop {
            watts -= 12.0;
        }
        let target = ambient_c + KELVIN_PER_W * watts.max(5.0);
        self.celsius += (target - self.celsius) / TIME_CONSTANT_S;
    }

    fn pressure(&self) -> Pressure {
        hot(99.0 - self.celsius)
    }
}

/// Two hours at `ambient` °C (a function of the second): the highest temperature and the changes.
fn walk(ambient: impl Fn(i64) -> f64, base_w: f64, heeds: bool) -> (f64, Vec<Change>) {
    let mut ladder = ladder();
    let mut machine = Box { celsius: 30.0 };
    let (mut highest, mut changes) = (0.0_f64, Vec::new());
    for s in 0..7200 {
        let mitigations = if heeds {
            ladder.mitigations()
        } else {
            Mitigations::default()
        };
        machine.second(ambient(s), base_w, mitigations);
        highest = machine.celsius.max(highest);
        let mut pressure = machine.pressure();
        // A sensor that reads nonsense once in a while.
        if s % 97 == 0 {
            pressure = hot(-40.0);
        }
        changes.extend(ladder.reading(s * NS_PER_S, &pressure));
    }
    (highest, changes)
}

#[test]
fn a_hot_afternoon_is_survived_without_flapping() {
    // 22 °C, an hour of sun at 46 °C, and the shade again.
    let afternoon = |s: i64| match s {
        600..4200 => 46.0,
        _ => 22.0,
    };
    let (unheeded, _) = walk(afternoon, 30.0, false);
    assert!(
        unheeded > 104.5,
        "the kernel would have switched off: {unheeded:.1} °C"
    );
    let (highest, changes) = walk(afternoon, 30.0, true);
    assert!(highest < 102.5, "{highest:.1} °C");
    let heat: Vec<Step> = changes
        .iter()
        .filter(|c| c.cause == Cause::Heat)
        .map(|c| c.to)
        .collect();
    assert!(
        heat.starts_with(&[Step::Warn, Step::LowerPreview, Step::LowerFrameRate]),
        "{heat:?}"
    );
    assert!(!heat.contains(&Step::StopCleanly), "{heat:?}");
    assert_eq!(
        heat.last(),
        Some(&Step::Normal),
        "in the shade all is given back"
    );
    // Two hours, and the measure itself cools the machine.
    // A look at the whole course: `cargo test -p machine afternoon -- --nocapture`.
    for c in &changes {
        println!("{:5} s  {}", c.at_ns / NS_PER_S, c.text);
    }
    assert!(heat.len() <= 16, "{} changes: {heat:?}", heat.len());
    for (one, next) in changes.iter().zip(&changes[1..]) {
        let seconds = (next.at_ns - one.at_ns) / NS_PER_S;
        // Raised, and given back.
        let is_back = next.cause == one.cause && one.to > one.from && next.to < next.from;
        assert!(
            !is_back || seconds >= 60,
            "back after {seconds} s: {}",
            next.text
        );
    }
}

#[test]
fn a_machine_that_cannot_cope_stops_before_the_kernel_does() {
    let (highest, changes) = walk(|_| 50.0, 45.0, true);
    assert!(changes.iter().any(|c| c.to == Step::StopCleanly));
    assert!(highest < 104.5, "{highest:.1} °C");
}

/// A disk with `free_mb` free and a reserve, written at a steady rate, looked at every `look_ms`,
/// until the ladder stops: what is left above the reserve, and in all, MB.
fn fill(free_mb: f64, reserve_mb: f64, mb_per_s: f64, look_ms: i64) -> (f64, f64) {
    let mut ladder = ladder();
    let mut watch = DiskWatch::new((reserve_mb * 1e6) as u64);
    let mut free = free_mb * 1e6;
    for reading in 0.. {
        let at_ns = reading * look_ms * 1_000_000;
        let space = Space {
            free_bytes: free.max(0.0) as u64,
            size_bytes: 1 << 40,
            free_inodes: None,
            read_only: false,
            device: 1,
        };
        let pressure = Pressure {
            disk: Some(watch.judge(at_ns, &Ok(space))),
            ..Pressure::default()
        };
        ladder.reading(at_ns, &pressure);
        if ladder.mitigations().stop || free < 0.0 {
            break;
        }
        free -= mb_per_s * 1e6 * look_ms as f64 / 1e3;
    }
    (free / 1e6 - reserve_mb, free / 1e6)
}

/// Random pressure of every kind: enough to cross every threshold.
fn pressures() -> impl Strategy<Value = Vec<(f64, f64)>> {
    // Badness now, and how much worse the other trace has it. Held for some seconds.
    let piece = (0.0..1.2_f64, 0.0..0.6_f64, 1..40_usize);
    prop::collection::vec(piece, 1..40).prop_map(|pieces| {
        let held = pieces
            .into_iter()
            .flat_map(|(base, more, seconds)| std::iter::repeat_n((base, base + more), seconds));
        held.collect()
    })
}

/// Everything as bad as `badness`: 0 is easy, 1 is past every threshold.
fn all(badness: f64) -> Pressure {
    Pressure {
        heat: hot(20.0 - 25.0 * badness).heat,
        power: battery(40.0 * (1.0 - badness), 30.0 * (1.0 - badness), true).power,
        disk: disk(6000.0 * (1.0 - badness).max(0.0), 6.0).disk,
        encoder_fill: Some(badness.clamp(0.0, 1.0)),
    }
}

proptest! {
    #[test]
    fn more_pressure_never_leads_to_a_lower_step(trace in pressures()) {
        let (mut milder, mut harder) = (ladder(), ladder());
        for (s, (base, more)) in trace.into_iter().enumerate() {
            let at_ns = s as i64 * NS_PER_S;
            milder.reading(at_ns, &all(base));
            harder.reading(at_ns, &all(more));
            prop_assert!(milder.step() <= harder.step());
            for ((cause, mild), (_, hard)) in milder.causes().into_iter().zip(harder.causes()) {
                prop_assert!(mild <= hard, "{cause:?} at {s} s: {mild:?} and {hard:?}");
            }
        }
    }

    #[test]
    fn one_glitch_does_nothing(
        at in 0..100_usize,
        badness in prop_oneof![Just(f64::NAN), Just(f64::INFINITY), Just(1e9), -10.0..10.0_f64],
        silent_after in any::<bool>(),
    ) {
        let mut ladder = ladder();
        for s in 0..100 {
            let pressure = match s {
                _ if s == at => all(badness),
                _ if silent_after && s > at => Pressure::default(),
                _ => all(0.0),
            };
            let changes = ladder.reading(s as i64 * NS_PER_S, &pressure);
            prop_assert!(changes.is_empty(), "{changes:?}");
        }
    }

    #[test]
    fn a_steady_recording_ends_before_the_reserve_is_touched(
        mb_per_s in 0.1..400.0_f64,
        seconds in 30.0..2000.0_f64,
        reserve_mb in 0.0..2000.0_f64,
        look_ms in 200..1500_i64,
    ) {
        let (usable_mb, _) = fill(reserve_mb + seconds * mb_per_s, reserve_mb, mb_per_s, look_ms);
        prop_assert!(usable_mb > 0.0, "{usable_mb:.1} MB above the reserve");
        // And not long before: the walk is what it is for.
        prop_assert!(usable_mb < 11.0 * mb_per_s, "{usable_mb:.1} MB above the reserve");
    }

    #[test]
    fn one_that_begins_too_late_ends_before_the_disk_is_full(
        mb_per_s in 1.0..400.0_f64,
        seconds in 0.0..30.0_f64,
        look_ms in 200..1500_i64,
    ) {
        let reserve_mb = 10.0 * mb_per_s;
        let (_, free_mb) = fill(reserve_mb + seconds * mb_per_s, reserve_mb, mb_per_s, look_ms);
        prop_assert!(free_mb > 0.0, "{free_mb:.1} MB free");
    }
}
