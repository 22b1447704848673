use super::*;
use crate::signal::Meaning;

/// Patterns are sampled so often; every step is a multiple of it.
const TICK_MS: u32 = 20;
const SECOND: usize = (1000 / TICK_MS) as usize;

/// One colour, sampled over the pattern's length.
fn lit(signal: Signal) -> Vec<bool> {
    let pattern = light(signal);
    let ticks = pattern.length_ms() / TICK_MS;
    let at = |tick: u32| i64::from(tick * TICK_MS) * NS_PER_MS;
    (0..ticks)
        .map(|tick| pattern.at(at(tick)).0.is_some_and(|state| state.lit))
        .collect()
}

/// What may be seen of a signal within `ticks`, a bit per tick: from every phase, or from the start
/// of a one-time signal.
fn views(signal: Signal, ticks: usize) -> Vec<u128> {
    let samples = lit(signal);
    let phases = if light(signal).repeats {
        samples.len()
    } else {
        assert_eq!(samples.len(), ticks, "{signal:?} is as long as it is seen");
        1
    };
    let view = |phase: usize| {
        (0..ticks).fold(0u128, |bits, i| {
            bits << 1 | u128::from(samples[(phase + i) % samples.len()])
        })
    };
    (0..phases).map(view).collect()
}

/// For how long two signals differ at least, whatever the phases.
fn apart_ms(a: Signal, b: Signal, ticks: usize) -> u32 {
    let (a, b) = (views(a, ticks), views(b, ticks));
    let differ = a
        .iter()
        .flat_map(|x| b.iter().map(move |y| (x ^ y).count_ones()));
    differ.min().unwrap_or(0) * TICK_MS
}

fn check(signals: &[Signal], ticks: usize, different: impl Fn(Signal, Signal) -> bool) -> u32 {
    let mut least = u32::MAX;
    for (i, &a) in signals.iter().enumerate() {
        for &b in &signals[..i] {
            if different(a, b) {
                let apart = apart_ms(a, b, ticks);
                assert!(apart >= APART_MS, "{a:?} and {b:?}: {apart} ms");
                least = least.min(apart);
            }
        }
    }
    least
}

#[test]
fn one_colour_tells_the_meaning_within_a_second() {
    let least = check(&Signal::all(), SECOND, |a, b| a.meaning() != b.meaning());
    assert_eq!(least, 120, "as docs/reference/led-table.md says");
}

#[test]
fn one_colour_tells_every_signal_within_two_seconds() {
    let mut lasting = Signal::all();
    lasting.retain(|s| !matches!(s, Signal::Once(_)));
    let least = check(&lasting, 2 * SECOND, |_, _| true);
    assert_eq!(least, 200, "as docs/reference/led-table.md says");
}

#[test]
fn the_comparison_notices_what_is_alike() {
    let recording = Signal::Phase(Phase::Recording);
    assert_eq!(apart_ms(recording, recording, SECOND), 0);
    let ready = Signal::Phase(Phase::Ready);
    // Two flashes of 80 ms, 900 apart, against a steady light.
    assert_eq!(apart_ms(recording, ready, SECOND), 840);
}

#[test]
fn steps_are_multiples_of_the_tick() {
    for signal in Signal::all() {
        for (_, ms) in light(signal).steps {
            assert_eq!(ms % TICK_MS, 0, "{signal:?}");
        }
    }
}

#[test]
fn many_colours_tell_the_meaning_by_colour_too() {
    use std::collections::BTreeSet;
    let colours = |signal: Signal| -> BTreeSet<String> {
        let steps = light(signal).steps;
        let seen = steps.iter().map(|(state, _)| format!("{:?}", state.colour));
        seen.filter(|c| c != "Off").collect()
    };
    for signal in Signal::all() {
        let expected: &[&str] = match signal.meaning() {
            Meaning::Busy => &["Blue"],
            Meaning::Ready => &["Green"],
            Meaning::Recording | Meaning::Answer(Once::Started) => &["White"],
            Meaning::ReadyWarning => &["Orange"],
            Meaning::RecordingWarning => &["Orange", "White"],
            Meaning::Fault | Meaning::Answer(Once::Refused) => &["Red"],
            Meaning::Question | Meaning::Answer(Once::Discarded) => &["Magenta"],
            Meaning::Answer(Once::Marked) => &["Cyan", "White"],
        };
        let expected: BTreeSet<String> = expected.iter().map(|c| (*c).to_owned()).collect();
        assert_eq!(colours(signal), expected, "{signal:?}");
    }
}

#[test]
fn a_coloured_light_never_goes_dark_while_recording() {
    for signal in Signal::all() {
        let recording = matches!(
            signal.meaning(),
            Meaning::Recording | Meaning::RecordingWarning | Meaning::Answer(Once::Marked)
        );
        let dark = light(signal)
            .steps
            .iter()
            .any(|(l, _)| l.colour == Colour::Off);
        assert!(!recording || !dark, "{signal:?}");
    }
}

#[test]
fn steady_light_never_changes_and_a_blink_changes_at_its_steps() {
    let steady = light(Signal::Phase(Phase::Recording));
    assert_eq!(steady.at(0).1, None);
    assert_eq!(steady.at(i64::MAX).1, None);

    let starting = light(Signal::Phase(Phase::Starting));
    let at = |ms: i64| starting.at(ms * NS_PER_MS);
    assert_eq!(at(0).1, Some(320 * NS_PER_MS));
    assert!(at(319).0.unwrap().lit);
    assert!(!at(320).0.unwrap().lit);
    assert_eq!(at(320).1, Some(640 * NS_PER_MS));
    assert!(at(640).0.unwrap().lit);

    let marked = light(Signal::Once(Once::Marked));
    assert_eq!(marked.at(1000 * NS_PER_MS), (None, None));
}

#[test]
fn an_off_and_on_beeper_tells_sounds_apart_by_rhythm() {
    let mut rhythms = std::collections::HashMap::new();
    for signal in Signal::all() {
        let Some(sound) = sound(signal) else { continue };
        let tones = sound.steps.iter().filter(|(hz, _)| hz.is_some());
        let rhythm: Vec<bool> = tones.map(|(_, ms)| *ms > 150).collect();
        let meaning = match signal {
            Signal::Warning { .. } => None,
            other => Some(other),
        };
        let before = rhythms.insert(rhythm.clone(), meaning);
        assert!(
            before.is_none_or(|b| b == meaning),
            "{signal:?}: {rhythm:?}"
        );
    }
    assert_eq!(rhythms.len(), 9);
}

#[test]
fn a_sound_ends_and_comes_again_only_where_it_must() {
    let started = sound(Signal::Once(Once::Started)).unwrap();
    assert_eq!(started.at(0), (Some(1320), Some(300 * NS_PER_MS)));
    assert_eq!(started.at(300 * NS_PER_MS), (None, Some(400 * NS_PER_MS)));
    assert_eq!(started.at(400 * NS_PER_MS), (None, None));

    let fault = sound(Signal::Fault).unwrap();
    assert_eq!(
        fault.at(5_000 * NS_PER_MS),
        (None, Some(10_000 * NS_PER_MS))
    );
    assert_eq!(fault.at(10_000 * NS_PER_MS).0, Some(440));
}
