use std::time::Duration;

use super::*;
use crate::NS_PER_MS;
use crate::light::fake::RecordingLight;
use crate::pattern::Colour;
use crate::signal::Warning;

const MS: i64 = NS_PER_MS;

fn status(phase: Phase) -> Status {
    Status {
        phase,
        ..Status::default()
    }
}

/// What shows from `from` to `to`, at each change: milliseconds, colour, whether it beeps.
fn film(indicator: &mut Indicator, from: i64, to: i64) -> Vec<(i64, Colour, bool)> {
    let mut film = Vec::new();
    let mut now = from * MS;
    loop {
        let showing = indicator.at(now);
        film.push((now / MS, showing.state.colour, showing.tone_hz.is_some()));
        match showing.next_ns.filter(|next| *next < to * MS) {
            Some(next) => {
                assert!(next > now, "it would never sleep");
                now = next;
            }
            None => return film,
        }
    }
}

#[test]
fn a_recording_begins_with_a_blink_and_a_beep_and_is_then_steady() {
    use Colour::{Off, White};
    let mut indicator = Indicator::new(0);
    indicator.set(&status(Phase::Ready), 0);
    indicator.set(&status(Phase::Recording), 5000 * MS);
    assert_eq!(
        film(&mut indicator, 5000, 60_000),
        [
            (5000, White, true),
            (5200, Off, true),
            (5300, Off, false),
            (5400, White, false),
            (6000, White, false),
        ]
    );
    assert_eq!(indicator.at(6000 * MS).next_ns, None);
}

#[test]
fn what_stays_the_same_keeps_its_rhythm() {
    let mut indicator = Indicator::new(0);
    let mut now = status(Phase::Ready);
    now.warnings.insert(Warning::Storage);
    indicator.set(&now, 0);
    let before = indicator.at(50 * MS);
    // A less urgent warning changes nothing.
    now.warnings.insert(Warning::Heat);
    indicator.set(&now, 50 * MS);
    assert_eq!(indicator.at(50 * MS), before);
    now.warnings.insert(Warning::Stream);
    indicator.set(&now, 50 * MS);
    assert_ne!(indicator.at(50 * MS).next_ns, before.next_ns);
}

#[test]
fn an_answer_comes_first_for_a_second_and_the_newest_counts() {
    let mut indicator = Indicator::new(0);
    indicator.set(&status(Phase::Recording), 0);
    indicator.at(2000 * MS);
    indicator.play(Once::Marked, 3000 * MS);
    indicator.play(Once::Refused, 3100 * MS);
    assert_eq!(indicator.at(3100 * MS).state.colour, Colour::Red);
    assert_eq!(indicator.at(4099 * MS).state.colour, Colour::Off);
    assert_eq!(indicator.at(4100 * MS).state.colour, Colour::White);
}

#[test]
fn warnings_keep_white_while_recording_and_come_back_with_their_beep() {
    let mut indicator = Indicator::new(0);
    let mut now = status(Phase::Recording);
    indicator.set(&now, 0);
    now.warnings.insert(Warning::Heat);
    indicator.set(&now, 10_000 * MS);
    let film = film(&mut indicator, 10_000, 41_000);
    assert!(film.iter().all(|(_, colour, _)| *colour != Colour::Off));
    let beeps: Vec<i64> = film.iter().filter(|f| f.2).map(|f| f.0 / 1000).collect();
    assert!(beeps.contains(&10) && beeps.contains(&40));
    assert!(!beeps.iter().any(|s| (12..40).contains(s)));
}

fn next(looks: &std::sync::mpsc::Receiver<LightState>) -> Colour {
    looks.recv_timeout(Duration::from_secs(60)).unwrap().colour
}

#[test]
fn a_panel_shows_its_state_and_ends_dark() {
    let (light, looks) = RecordingLight::new(0);
    let time = crate::button::fake::Time::default();
    let panel = Panel::start(time.clock(), vec![Box::new(light)], Vec::new()).unwrap();
    assert_eq!(next(&looks), Colour::Blue);
    panel.set(status(Phase::Recording));
    assert_eq!(next(&looks), Colour::White);
    time.advance_to(5_000 * MS);
    panel.play(Once::Refused);
    assert_eq!(next(&looks), Colour::Red);
    // It wakes by itself when the answer is over.
    time.advance_to(10_000 * MS);
    assert_eq!(next(&looks), Colour::White);
    drop(panel);
    assert_eq!(next(&looks), Colour::Off);
}

#[test]
fn a_failing_light_is_tried_again_and_does_not_disturb_the_other() {
    let (bad, bad_looks) = RecordingLight::new(2);
    let (good, good_looks) = RecordingLight::new(0);
    let clock: Clock = Arc::new(|| 0);
    let panel = Panel::start(clock, vec![Box::new(bad), Box::new(good)], Vec::new()).unwrap();
    assert_eq!(next(&good_looks), Colour::Blue);
    panel.set(status(Phase::Ready));
    assert_eq!(next(&good_looks), Colour::Green);
    let fault = Status {
        fault: true,
        ..Status::default()
    };
    panel.set(fault);
    assert_eq!(next(&good_looks), Colour::Red);
    drop(panel);
    assert_eq!(next(&good_looks), Colour::Off);
    let mut tried: Vec<Colour> = bad_looks.iter().map(|state| state.colour).collect();
    tried.dedup();
    assert_eq!(
        tried,
        [Colour::Blue, Colour::Green, Colour::Red, Colour::Off]
    );
}

/// The clock runs so fast that the next step of a pattern is always due.
#[test]
fn a_panel_without_devices_sleeps() {
    let (looked, looks) = std::sync::mpsc::sync_channel(8);
    let now = std::sync::atomic::AtomicI64::new(0);
    let clock: Clock = Arc::new(move || {
        let _ = looked.try_send(());
        now.fetch_add(3_600_000_000_000, std::sync::atomic::Ordering::SeqCst)
    });
    let panel = Panel::start(clock, Vec::new(), Vec::new()).unwrap();
    panel.set(status(Phase::Starting));
    let pause = Duration::from_millis(200);
    let count = std::iter::from_fn(|| looks.recv_timeout(pause).ok())
        .take(8)
        .count();
    assert!(count < 4, "it looked at the clock {count} times");
}
