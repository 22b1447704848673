//! Commands of a person by presses: edges and time in, commands out. Pure.
//!
//! | | while not recording | while recording |
//! |---|---|---|
//! | short press | [`Command::Start`], at the release | [`Command::Stop`], once no second press has come for 350 ms |
//! | two presses within 350 ms | as one press | [`Command::Mark`], at the second press |
//! | held for 1.5 s | [`Command::Ask`] about the last recording | [`Command::Ask`] about this one |
//! | short press within 5 s of that | [`Command::Discard`] | [`Command::Discard`] |
//!
//! Contract: whether it records is looked at when a press begins, so a press that was meant to
//! start never stops. A start needs no waiting for a second press, because the recorder keeps the
//! second before. A gesture gives one command; presses that follow its end within 350 ms still
//! belong to it and mean nothing. A question that nobody confirms is [`Command::Cancelled`], as is
//! one that is answered with another long press or whose recording began or ended meanwhile:
//! nothing is discarded on an answer to another question. A level that lasts less than the debounce
//! time is ignored. A button held for 10 s is [`Command::Stuck`] and means nothing until it is
//! released ([`Command::Freed`]).
//!
//! Late: [`Gesture::look`] may come at any time after [`Gesture::deadline`]; its commands carry the
//! right times, and edges that are handed in late are sorted out by their own times. They must come
//! in order.

use crate::NS_PER_MS;
use crate::button::Edge;

mod debounce;

use debounce::Debounce;

/// Which recording a question is about.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Target {
    /// The one that is being made.
    This,
    /// The last one that was made.
    Last,
}

/// A command of the operator, or a state of the button.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Command {
    /// Start recording.
    Start,
    /// Stop recording.
    Stop,
    /// Mark this moment.
    Mark,
    /// Show the question whether a recording shall be discarded. Nothing else yet.
    Ask(Target),
    /// Discard it: the question was confirmed.
    Discard(Target),
    /// Take the question away; discard nothing.
    Cancelled,
    /// The button has been held too long to mean anything. A question about discarding is void.
    Stuck,
    /// The stuck button was released.
    Freed,
}

/// A command and its time.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct TimedCommand {
    /// When the press that it came from began, the first of two. For [`Command::Cancelled`]
    /// and [`Command::Freed`]: when that happened.
    pub at_ns: i64,
    /// The command.
    pub command: Command,
}

/// Time limits of the gestures, ns.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Settings {
    /// A level that lasts less is bouncing. 0 when the button is debounced already.
    pub debounce_ns: i64,
    /// A second press within this time after a release belongs to the first.
    pub double_ns: i64,
    /// A press of at least this is long.
    pub long_ns: i64,
    /// A question can be confirmed for this long after the long press's release.
    pub confirm_ns: i64,
    /// A press of at least this is a stuck button.
    pub stuck_ns: i64,
}

impl Default for Settings {
    fn default() -> Self {
        Self {
            debounce_ns: 20 * NS_PER_MS,
            double_ns: 350 * NS_PER_MS,
            long_ns: 1_500 * NS_PER_MS,
            confirm_ns: 5_000 * NS_PER_MS,
            stuck_ns: 10_000 * NS_PER_MS,
        }
    }
}

/// The state of one button.
#[derive(Debug)]
pub struct Gesture {
    settings: Settings,
    debounce: Debounce,
    state: State,
}

/// Where in a gesture we are.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum State {
    /// Nothing is going on.
    Idle,
    /// A first press, not yet long.
    Down { at: i64, recording: bool },
    /// One short press while recording; a second may follow until `until`.
    Between { first: i64, until: i64 },
    /// The question is shown and the button still held.
    Asking { at: i64, target: Target },
    /// The question stands until `until`. What begins before `from` is still the long press's
    /// bouncing finger.
    Asked {
        target: Target,
        from: i64,
        until: i64,
    },
    /// Pressed again while the question stood.
    Answering { at: i64, target: Target },
    /// The gesture is complete; the button is still held.
    Spent { at: i64 },
    /// Released; what begins before `until` still belongs to the gesture.
    After { until: i64 },
    /// Held too long.
    Stuck,
}

impl Gesture {
    /// A button that is up.
    pub fn new(settings: Settings) -> Self {
        Self {
            settings,
            debounce: Debounce::new(settings.debounce_ns),
            state: State::Idle,
        }
    }

    /// A button that was just opened, which is taken to be up, and how long its levels must last to
    /// count.
    pub(crate) fn opened(&mut self, debounce_ns: i64) {
        self.settings.debounce_ns = debounce_ns;
        self.debounce = Debounce::new(debounce_ns);
    }

    /// The button went down or up. `recording`: whether it records now.
    pub fn edge(&mut self, edge: Edge, recording: bool) -> Vec<TimedCommand> {
        let mut commands = self.look(edge.at_ns, recording);
        self.debounce.note(edge);
        commands.append(&mut self.look(edge.at_ns, recording));
        commands
    }

    /// Time has come to `now_ns`, and there was no edge before it that has not been handed in.
    pub fn look(&mut self, now_ns: i64, recording: bool) -> Vec<TimedCommand> {
        let mut commands = Vec::new();
        if let Some(edge) = self.debounce.settled(now_ns) {
            self.pass(edge.at_ns, recording, &mut commands);
            commands.extend(self.apply(edge, recording));
        }
        // While a level is on trial, nothing after its beginning is decided.
        let sure = self.debounce.trial().map_or(now_ns, |at| at.min(now_ns));
        self.pass(sure, recording, &mut commands);
        commands
    }

    /// When to poll again, if no edge comes before.
    pub fn deadline(&self) -> Option<i64> {
        self.debounce.deadline().or_else(|| self.timeout())
    }

    /// The button was unplugged. A press that was going on is forgotten, a question is taken away;
    /// a stop that waits for a second press is kept.
    pub fn gone(&mut self, now_ns: i64) -> Vec<TimedCommand> {
        self.debounce = Debounce::new(self.settings.debounce_ns);
        let command = match self.state {
            State::Between { .. } => return Vec::new(),
            State::Asking { .. } | State::Asked { .. } | State::Answering { .. } => {
                Some(Command::Cancelled)
            }
            State::Stuck => Some(Command::Freed),
            State::Idle | State::Down { .. } | State::Spent { .. } | State::After { .. } => None,
        };
        self.state = State::Idle;
        let at_ns = now_ns;
        command
            .map(|command| TimedCommand { at_ns, command })
            .into_iter()
            .collect()
    }

    /// When the present state ends by itself.
    fn timeout(&self) -> Option<i64> {
        let s = &self.settings;
        match self.state {
            State::Idle | State::Stuck | State::After { .. } => None,
            State::Down { at, .. } | State::Answering { at, .. } => {
                Some(at.saturating_add(s.long_ns))
            }
            State::Between { until, .. } | State::Asked { until, .. } => Some(until),
            State::Asking { at, .. } | State::Spent { at } => Some(at.saturating_add(s.stuck_ns)),
        }
    }

    /// What happens by itself up to `to`.
    fn pass(&mut self, to: i64, recording: bool, commands: &mut Vec<TimedCommand>) {
        while let Some(due) = self.timeout().filter(|due| *due <= to) {
            let (state, timed) = self.expired(due, recording);
            self.state = state;
            commands.extend(timed);
        }
    }

    /// The present state ended by itself at `due`.
    fn expired(&self, due: i64, recording: bool) -> (State, Option<TimedCommand>) {
        let said = |at_ns, command| Some(TimedCommand { at_ns, command });
        match self.state {
            State::Down {
                at,
                recording: began,
            } => {
                if began != recording {
                    // It is not clear any more which recording is meant.
                    return (State::Spent { at }, None);
                }
                let target = if began { Target::This } else { Target::Last };
                (State::Asking { at, target }, said(at, Command::Ask(target)))
            }
            State::Between { first, .. } => (State::Idle, said(first, Command::Stop)),
            State::Asked { .. } => (State::Idle, said(due, Command::Cancelled)),
            State::Answering { at, .. } => (State::Spent { at }, said(due, Command::Cancelled)),
            State::Asking { at, .. } | State::Spent { at } => {
                (State::Stuck, said(at, Command::Stuck))
            }
            State::Idle | State::After { .. } | State::Stuck => (self.state, None),
        }
    }

    /// An edge that is no bouncing.
    fn apply(&mut self, edge: Edge, recording: bool) -> Option<TimedCommand> {
        let at = edge.at_ns;
        let (state, timed) = if edge.pressed {
            self.pressed(at, recording)
        } else {
            self.released(at, recording)
        };
        self.state = state;
        timed
    }

    fn pressed(&self, at: i64, recording: bool) -> (State, Option<TimedCommand>) {
        match self.state {
            State::Between { first, .. } => {
                let mark = TimedCommand {
                    at_ns: first,
                    command: Command::Mark,
                };
                (State::Spent { at }, Some(mark))
            }
            State::After { until } if at < until => (State::Spent { at }, None),
            State::Idle | State::After { .. } => (State::Down { at, recording }, None),
            State::Asked { target, from, .. } if at >= from => {
                (State::Answering { at, target }, None)
            }
            // Down already, or too early to be an answer.
            state => (state, None),
        }
    }

    fn released(&self, at: i64, recording: bool) -> (State, Option<TimedCommand>) {
        let double = at.saturating_add(self.settings.double_ns);
        let after = State::After { until: double };
        match self.state {
            State::Down {
                at: first,
                recording: true,
            } => (
                State::Between {
                    first,
                    until: double,
                },
                None,
            ),
            State::Down {
                at: at_ns,
                recording: false,
            } => {
                let command = Command::Start;
                (after, Some(TimedCommand { at_ns, command }))
            }
            State::Asking { target, .. } => {
                let until = at.saturating_add(self.settings.confirm_ns);
                let from = double;
                (
                    State::Asked {
                        target,
                        from,
                        until,
                    },
                    None,
                )
            }
            State::Answering { at: began, target } => {
                let timed = if recording == (target == Target::This) {
                    TimedCommand {
                        at_ns: began,
                        command: Command::Discard(target),
                    }
                } else {
                    TimedCommand {
                        at_ns: at,
                        command: Command::Cancelled,
                    }
                };
                (after, Some(timed))
            }
            State::Spent { .. } => (after, None),
            State::Stuck => {
                let command = Command::Freed;
                (after, Some(TimedCommand { at_ns: at, command }))
            }
            // A release whose press nobody saw.
            state => (state, None),
        }
    }
}

#[cfg(test)]
mod tests;
