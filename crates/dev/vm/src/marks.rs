//! What a recorder in a guest says, as marks: short words that a log of writes can hold.
//!
//! A mark is put in where it happens: `started` when the recorder said that it began,
//! `durable:UNTIL:MESSAGES` when it said what is on disk, `now:NS` every [`TICK`], the guest's
//! monotonic clock. So a cut between two marks knows what had been promised and what time it was.

use std::time::Duration;

use serde_json::Value;

use crate::exam::Promise;

/// How often the time is marked.
pub const TICK: Duration = Duration::from_millis(20);

/// One mark.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Mark {
    /// The session has begun.
    Started,
    /// Everything up to a log time is on disk.
    Durable {
        /// Log time, ns.
        until: i64,
        /// Messages on disk.
        messages: u64,
    },
    /// The time.
    Now(i64),
    /// The session has ended.
    Finished,
}

impl Mark {
    /// The mark of a line of `pawsd record --json`, if it has one.
    pub fn of_progress(line: &str) -> Option<Self> {
        let progress: Value = serde_json::from_str(line).ok()?;
        match progress["event"].as_str()? {
            "started" => Some(Self::Started),
            "durable" => Some(Self::Durable {
                until: progress["until"].as_i64()?,
                messages: progress["messages"].as_u64()?,
            }),
            "finished" => Some(Self::Finished),
            _ => None,
        }
    }

    /// The mark of a word.
    pub fn parse(word: &str) -> Option<Self> {
        let parts: Vec<&str> = word.trim().split(':').collect();
        match parts[..] {
            ["started"] => Some(Self::Started),
            ["finished"] => Some(Self::Finished),
            ["now", ns] => Some(Self::Now(ns.parse().ok()?)),
            ["durable", until, messages] => Some(Self::Durable {
                until: until.parse().ok()?,
                messages: messages.parse().ok()?,
            }),
            _ => None,
        }
    }
}

impl std::fmt::Display for Mark {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Started => f.write_str("started"),
            Self::Durable { until, messages } => write!(f, "durable:{until}:{messages}"),
            Self::Now(ns) => write!(f, "now:{ns}"),
            Self::Finished => f.write_str("finished"),
        }
    }
}

/// What the marks up to a cut amount to.
pub fn promise(marks: impl IntoIterator<Item = Mark>) -> Promise {
    let mut promise = Promise::default();
    for mark in marks {
        match mark {
            Mark::Started => promise.started = true,
            Mark::Durable { messages, .. } => promise.messages = messages,
            Mark::Now(_) | Mark::Finished => {}
        }
    }
    promise
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn marks_come_back_from_words() {
        let durable = Mark::Durable {
            until: 12,
            messages: 3,
        };
        for mark in [Mark::Started, durable, Mark::Now(5), Mark::Finished] {
            assert_eq!(Mark::parse(&mark.to_string()), Some(mark));
        }
        for word in ["", "now", "now:x", "durable:1", "dm-log-writes-end"] {
            assert_eq!(Mark::parse(word), None, "{word}");
        }
    }

    #[test]
    fn a_recorder_s_lines_become_marks() {
        let line = r#"{"event":"durable","until":77,"messages":9}"#;
        let durable = Mark::Durable {
            until: 77,
            messages: 9,
        };
        assert_eq!(Mark::of_progress(line), Some(durable));
        let alarm = r#"{"event":"alarm","text":"","active":true}"#;
        assert_eq!(Mark::of_progress(alarm), None);
        assert_eq!(Mark::of_progress("no JSON"), None);
        let last = promise([Mark::Started, Mark::Now(1), durable, Mark::Now(2)]);
        assert_eq!(
            last,
            Promise {
                started: true,
                messages: 9
            }
        );
    }
}
