//! What a person means by pressing: edges and time in, wishes out. Pure.
//!
//! | | while not recording | while recording |
//! |---|---|---|
//! | short press | [`Wish::Start`], at the release | [`Wish::Stop`], once no second press has come for 350 ms |
//! | two presses within 350 ms | as one press | [`Wish::Mark`], at the second press |
//! | held for 1.5 s | [`Wish::Ask`] about the last recording | [`Wish::Ask`] about this one |
//! | short press within 5 s of that | [`Wish::Discard`] | [`Wish::Discard`] |
//!
//! Contract: whether it records is looked at when a press begins, so a press that was meant to start
//! never stops. A start needs no waiting for a second press, because the recorder keeps the second before. A
//! gesture gives one wish; presses that follow its end within 350 ms still belong to it and mean nothing.
//! A question that nobody confirms is [`Wish::Cancelled`], as is one that is answered with another long press or
//! whose recording began or ended meanwhile: nothing is discarded on an answer to another question. A
//! level that lasts less than the debounce time is nobody's. A button held for 10 s is [`Wish::Stuck`] and
//! means nothing until it is released ([`Wish::Freed`]).
//!
//! Late: [`Gesture::look`] may come at any time after [`Gesture::deadline`]; what it says carries the right times, and
//! edges that are handed in late are sorted out by their own times. They must come in order.

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

/// What the person wishes, or what there is to know about the button.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Wish {
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

/// A wish and its time.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Wished {
    /// When the press that it came from began, the first of two. For [`Wish::Cancelled`] and [`Wish::Freed`]: when
    /// that happened.
    pub at_ns: i64,
    /// The wish.
    pub wish: Wish,
}

/// How long is long. All in nanoseconds.
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
    /// The question stands until `until`. What begins before `from` is still the long press's bouncing finger.
    Asked {
        target: Target,
        from: i64,
        until: i64,
    },
    /// Pressed again while the question stood.
    Answering { at: i64, target: Target },
    /// The gesture has said all; the button is still held.
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

    /// A button that was just opened, which is taken to be up, and how long its levels must last to count.
    pub(crate) fn opened(&mut self, debounce_ns: i64) {
        self.settings.debounce_ns = debounce_ns;
        self.debounce = Debounce::new(debounce_ns);
    }

    /// The button went down or up. `recording`: whether it records now.
    pub fn edge(&mut self, edge: Edge, recording: bool) -> Vec<Wished> {
        let mut wishes = self.look(edge.at_ns, recording);
        self.debounce.note(edge);
        wishes.append(&mut self.look(edge.at_ns, recording));
        wishes
    }

    /// Time has come to `now_ns`, and there was no edge before it that has not been handed in.
    pub fn look(&mut self, now_ns: i64, recording: bool) -> Vec<Wished> {
        let mut wishes = Vec::new();
        if let Some(edge) = self.debounce.settled(now_ns) {
            self.pass(edge.at_ns, recording, &mut wishes);
            wishes.extend(self.apply(edge, recording));
        }
        // While a level is on trial, nothing after its beginning is decided.
        let sure = self.debounce.trial().map_or(now_ns, |at| at.min(now_ns));
        self.pass(sure, recording, &mut wishes);
        wishes
    }

    /// When to look again, if nothing is heard before.
    pub fn deadline(&self) -> Option<i64> {
        self.debounce.deadline().or_else(|| self.timeout())
    }

    /// The button was unplugged. A press that was going on is forgotten, a question is taken away; a stop
    /// that waits for a second press is kept.
    pub fn gone(&mut self, now_ns: i64) -> Vec<Wished> {
        self.debounce = Debounce::new(self.settings.debounce_ns);
        let wish = match self.state {
            State::Between { .. } => return Vec::new(),
            State::Asking { .. } | State::Asked { .. } | State::Answering { .. } => {
                Some(Wish::Cancelled)
            }
            State::Stuck => Some(Wish::Freed),
            State::Idle | State::Down { .. } | State::Spent { .. } | State::After { .. } => None,
        };
        self.state = State::Idle;
        let at_ns = now_ns;
        wish.map(|wish| Wished { at_ns, wish })
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
    fn pass(&mut self, to: i64, recording: bool, wishes: &mut Vec<Wished>) {
        while let Some(due) = self.timeout().filter(|due| *due <= to) {
            let (state, wished) = self.expired(due, recording);
            self.state = state;
            wishes.extend(wished);
        }
    }

    /// The present state ended by itself at `due`.
    fn expired(&self, due: i64, recording: bool) -> (State, Option<Wished>) {
        let said = |at_ns, wish| Some(Wished { at_ns, wish });
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
                (State::Asking { at, target }, said(at, Wish::Ask(target)))
            }
            State::Between { first, .. } => (State::Idle, said(first, Wish::Stop)),
            State::Asked { .. } => (State::Idle, said(due, Wish::Cancelled)),
            State::Answering { at, .. } => (State::Spent { at }, said(due, Wish::Cancelled)),
            State::Asking { at, .. } | State::Spent { at } => (State::Stuck, said(at, Wish::Stuck)),
            State::Idle | State::After { .. } | State::Stuck => (self.state, None),
        }
    }

    /// An edge that is no bouncing.
    fn apply(&mut self, edge: Edge, recording: bool) -> Option<Wished> {
        let at = edge.at_ns;
        let (state, wished) = if edge.pressed {
            self.pressed(at, recording)
        } else {
            self.released(at, recording)
        };
        self.state = state;
        wished
    }

    fn pressed(&self, at: i64, recording: bool) -> (State, Option<Wished>) {
        match self.state {
            State::Between { first, .. } => {
                let mark = Wished {
                    at_ns: first,
                    wish: Wish::Mark,
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

    fn released(&self, at: i64, recording: bool) -> (State, Option<Wished>) {
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
                let wish = Wish::Start;
                (after, Some(Wished { at_ns, wish }))
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
                let wished = if recording == (target == Target::This) {
                    Wished {
                        at_ns: began,
                        wish: Wish::Discard(target),
                    }
                } else {
                    Wished {
                        at_ns: at,
                        wish: Wish::Cancelled,
                    }
                };
                (after, Some(wished))
            }
            State::Spent { .. } => (after, None),
            State::Stuck => {
                let wish = Wish::Freed;
                (after, Some(Wished { at_ns: at, wish }))
            }
            // A release whose press nobody saw.
            state => (state, None),
        }
    }
}

#[cfg(test)]
mod tests;
