use proptest::prelude::*;

use super::*;

const MS: i64 = NS_PER_MS;

/// Presses as (down, up) in milliseconds up to `end`, looked at whenever the machine asks for it
/// and at the end.
fn commands(recording: bool, presses: &[(i64, i64)], end: i64) -> Vec<(i64, Command)> {
    let edges = presses
        .iter()
        .flat_map(|&(down, up)| [(down, true), (up, false)]);
    let edges: Vec<Edge> = edges
        .filter(|(ms, _)| *ms <= end)
        .map(|(ms, pressed)| Edge {
            at_ns: ms * MS,
            pressed,
        })
        .collect();
    let timed = play(&edges, end * MS, |_| recording);
    timed.iter().map(|w| (w.at_ns / MS, w.command)).collect()
}

/// Plays edges and polls at every deadline. `recording` is evaluated at each time.
fn play(edges: &[Edge], end_ns: i64, recording: impl Fn(i64) -> bool) -> Vec<TimedCommand> {
    let mut gesture = Gesture::new(Settings::default());
    let mut timed = Vec::new();
    let idle_until = |gesture: &mut Gesture, timed: &mut Vec<TimedCommand>, to: i64| {
        while let Some(due) = gesture.deadline().filter(|due| *due < to) {
            timed.extend(gesture.look(due, recording(due)));
        }
    };
    for &edge in edges {
        idle_until(&mut gesture, &mut timed, edge.at_ns);
        timed.extend(gesture.edge(edge, recording(edge.at_ns)));
    }
    idle_until(&mut gesture, &mut timed, end_ns);
    timed.extend(gesture.look(end_ns, recording(end_ns)));
    timed
}

#[test]
fn a_short_press_starts_at_its_release() {
    let mut gesture = Gesture::new(Settings {
        debounce_ns: 0,
        ..Settings::default()
    });
    let edge = |ms: i64, pressed| Edge {
        at_ns: ms * MS,
        pressed,
    };
    assert_eq!(gesture.edge(edge(100, true), false), []);
    let start = TimedCommand {
        at_ns: 100 * MS,
        command: Command::Start,
    };
    assert_eq!(gesture.edge(edge(250, false), false), [start]);
    assert_eq!(gesture.deadline(), None);
}

#[test]
fn a_press_while_recording_stops_after_the_window_with_the_time_of_the_press() {
    assert_eq!(commands(true, &[(100, 250)], 599), []);
    assert_eq!(commands(true, &[(100, 250)], 600), [(100, Command::Stop)]);
}

#[test]
fn two_presses_mark_at_the_first_and_a_third_means_nothing() {
    let mark = [(100, Command::Mark)];
    assert_eq!(commands(true, &[(100, 200), (400, 500)], 9000), mark);
    assert_eq!(
        commands(true, &[(100, 200), (400, 500), (700, 800)], 9000),
        mark
    );
    // Later it is a gesture of its own.
    assert_eq!(
        commands(true, &[(100, 200), (400, 500), (900, 1000)], 9000),
        [(100, Command::Mark), (900, Command::Stop)]
    );
    // The second press began too late.
    assert_eq!(
        commands(true, &[(100, 200), (550, 600)], 9000),
        [(100, Command::Stop), (550, Command::Stop)]
    );
}

#[test]
fn a_double_press_by_habit_does_not_stop_what_it_started() {
    let edges: Vec<Edge> = [(100, true), (200, false), (300, true), (400, false)]
        .map(|(ms, pressed)| Edge {
            at_ns: ms * MS,
            pressed,
        })
        .into();
    let timed = play(&edges, 9000 * MS, |at| at >= 220 * MS);
    assert_eq!(
        timed.iter().map(|w| w.command).collect::<Vec<_>>(),
        [Command::Start]
    );
}

#[test]
fn a_long_press_asks_while_held_and_a_short_one_confirms() {
    assert_eq!(commands(false, &[(0, 9000)], 1499), []);
    assert_eq!(
        commands(false, &[(0, 9000)], 1500),
        [(0, Command::Ask(Target::Last))]
    );
    assert_eq!(
        commands(false, &[(0, 1600), (3000, 3200)], 20_000),
        [
            (0, Command::Ask(Target::Last)),
            (3000, Command::Discard(Target::Last))
        ]
    );
    assert_eq!(
        commands(true, &[(0, 1600), (3000, 3200)], 20_000),
        [
            (0, Command::Ask(Target::This)),
            (3000, Command::Discard(Target::This))
        ]
    );
}

#[test]
fn a_question_without_an_answer_is_cancelled() {
    let ask = (0, Command::Ask(Target::Last));
    assert_eq!(
        commands(false, &[(0, 1600)], 20_000),
        [ask, (6600, Command::Cancelled)]
    );
    // A second long press is not an answer.
    assert_eq!(
        commands(false, &[(0, 1600), (3000, 5000)], 20_000),
        [ask, (4500, Command::Cancelled)]
    );
    // A finger that bounces off the long press does not answer.
    assert_eq!(
        commands(false, &[(0, 1600), (1700, 1800)], 20_000),
        [ask, (6600, Command::Cancelled)]
    );
    // Too late: a gesture of its own.
    assert_eq!(
        commands(false, &[(0, 1600), (6600, 6700)], 20_000),
        [ask, (6600, Command::Cancelled), (6600, Command::Start)]
    );
}

#[test]
fn a_question_about_a_recording_is_void_when_that_changed() {
    let edges: Vec<Edge> = [(0, true), (1600, false), (3000, true), (3200, false)]
        .map(|(ms, pressed)| Edge {
            at_ns: ms * MS,
            pressed,
        })
        .into();
    let timed = play(&edges, 20_000 * MS, |at| at < 2000 * MS);
    assert_eq!(
        timed.iter().map(|w| w.command).collect::<Vec<_>>(),
        [Command::Ask(Target::This), Command::Cancelled]
    );
}

#[test]
fn a_long_press_during_which_a_recording_begins_asks_nothing() {
    let press = |pressed, ms: i64| Edge {
        at_ns: ms * MS,
        pressed,
    };
    let edges = [press(true, 0), press(false, 2000)];
    assert_eq!(play(&edges, 9000 * MS, |at| at > 1000 * MS), []);
}

#[test]
fn bouncing_is_no_press_and_a_bounced_press_is_one() {
    assert_eq!(commands(false, &[(100, 110)], 9000), []);
    assert_eq!(
        commands(false, &[(100, 103), (105, 109), (111, 300)], 9000),
        [(111, Command::Start)]
    );
    // A contact that opens for a moment while held.
    assert_eq!(
        commands(true, &[(100, 200), (210, 400)], 9000),
        [(100, Command::Stop)]
    );
}

#[test]
fn a_press_on_trial_at_the_end_of_the_window_still_marks() {
    // The window ends at 550; the press began at 545 and is sure at 565.
    assert_eq!(
        commands(true, &[(100, 200), (545, 700)], 9000),
        [(100, Command::Mark)]
    );
    // The same, but it was only bouncing.
    assert_eq!(
        commands(true, &[(100, 200), (545, 550)], 9000),
        [(100, Command::Stop)]
    );
}

#[test]
fn a_stuck_button_is_reported_once_and_ignored_until_released() {
    assert_eq!(
        commands(true, &[(0, 60_000), (61_000, 61_100)], 70_000),
        [
            (0, Command::Ask(Target::This)),
            (0, Command::Stuck),
            (60_000, Command::Freed),
            (61_000, Command::Stop)
        ]
    );
}

#[test]
fn unplugging_forgets_presses_and_questions_but_not_a_stop() {
    let edge = |ms: i64, pressed| Edge {
        at_ns: ms * MS,
        pressed,
    };
    let mut gesture = Gesture::new(Settings::default());
    assert_eq!(gesture.edge(edge(0, true), false), []);
    assert_eq!(gesture.look(1500 * MS, false).len(), 1);
    let cancelled = TimedCommand {
        at_ns: 1600 * MS,
        command: Command::Cancelled,
    };
    assert_eq!(gesture.gone(1600 * MS), [cancelled]);
    assert_eq!(gesture.deadline(), None);

    gesture.edge(edge(2000, true), true);
    gesture.edge(edge(2100, false), true);
    gesture.look(2130 * MS, true);
    assert_eq!(gesture.gone(2200 * MS), []);
    let stop = TimedCommand {
        at_ns: 2000 * MS,
        command: Command::Stop,
    };
    assert_eq!(gesture.look(2450 * MS, true), [stop]);
}

/// Random presses: gaps from bouncing to long pauses, levels that may repeat, recording that
/// changes by itself.
fn edges() -> impl Strategy<Value = Vec<(Edge, bool)>> {
    let gap = prop_oneof![
        0..30 * MS,
        0..400 * MS,
        1_000 * MS..2_000 * MS,
        0..12_000 * MS
    ];
    prop::collection::vec((gap, any::<bool>(), any::<bool>()), 0..60).prop_map(|steps| {
        let mut at_ns = 0;
        let mut level = false;
        steps
            .into_iter()
            .map(|(gap, repeats, recording)| {
                at_ns += gap;
                // One in four repeats its level, as after lost edges.
                level ^= !(repeats && gap % 2 == 0);
                let pressed = level;
                (Edge { at_ns, pressed }, recording)
            })
            .collect()
    })
}

proptest! {
    #[test]
    fn nothing_is_discarded_without_a_standing_question(steps in edges()) {
        let mut gesture = Gesture::new(Settings::default());
        let mut asked = None;
        let mut presses = 0;
        let mut timed = 0;
        for (edge, recording) in steps {
            presses += usize::from(edge.pressed);
            for w in gesture.edge(edge, recording) {
                match w.command {
                    Command::Ask(target) => {
                        prop_assert_eq!(asked.replace((w.at_ns, target)), None);
                    }
                    Command::Discard(target) => {
                        let (at, of) = asked.take().expect("a question");
                        prop_assert_eq!(of, target);
                        prop_assert!(at < w.at_ns);
                        // The press refers to the present state.
                        prop_assert_eq!(target == Target::This, recording);
                    }
                    Command::Cancelled => prop_assert!(asked.take().is_some()),
                    Command::Start | Command::Stop | Command::Mark => prop_assert_eq!(asked, None),
                    Command::Stuck => asked = None,
                    Command::Freed => {}
                }
                timed += usize::from(!matches!(
                    w.command,
                    Command::Cancelled | Command::Stuck | Command::Freed
                ));
            }
        }
        // At most one command per press, so at most one per gesture.
        prop_assert!(timed <= presses, "{} wishes of {} presses", timed, presses);
    }

    #[test]
    fn looking_more_often_changes_nothing(steps in edges(), recording: bool, period in 1..900i64) {
        let edges: Vec<Edge> = steps.into_iter().map(|(edge, _)| edge).collect();
        let end = edges.last().map_or(0, |e| e.at_ns) + 20_000 * MS;
        let expected = play(&edges, end, |_| recording);

        let mut gesture = Gesture::new(Settings::default());
        let mut timed = Vec::new();
        let mut now = 0;
        for edge in edges {
            while now < edge.at_ns {
                timed.extend(gesture.look(now, recording));
                now += period * MS;
            }
            timed.extend(gesture.edge(edge, recording));
            now = now.max(edge.at_ns);
        }
        timed.extend(gesture.look(end, recording));
        prop_assert_eq!(timed, expected);
    }

    #[test]
    fn every_gesture_ends(steps in edges(), recording: bool) {
        let mut gesture = Gesture::new(Settings::default());
        let mut now = 0;
        for (edge, _) in steps {
            gesture.edge(edge, recording);
            now = edge.at_ns;
        }
        let release = Edge { at_ns: now, pressed: false };
        gesture.edge(release, recording);
        gesture.look(now + 20_000 * MS, recording);
        prop_assert_eq!(gesture.deadline(), None);
    }

    #[test]
    fn never_panics_on_any_times(times in prop::collection::vec((any::<i64>(), any::<bool>(), any::<bool>()), 0..20)) {
        let mut gesture = Gesture::new(Settings::default());
        for (at_ns, pressed, recording) in times {
            gesture.edge(Edge { at_ns, pressed }, recording);
            gesture.look(at_ns, !recording);
        }
    }
}
