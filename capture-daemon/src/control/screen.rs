//! Status and progress as text, for a person at a terminal.
//!
//! Contract: the status of a rig fits on one screen, and problems stand out at its end. Unknown
//! numbers are omitted, never shown as zero.

use std::fmt::Write as _;

use session_archive::text::shown;
use session_archive::time::{HostTime, NS_PER_S};

use crate::status::{Progress, State, Status, StreamStatus};

/// Log time between two lines about a recording without problems, ns.
const REPORT_INTERVAL_NS: i64 = 5 * NS_PER_S;

/// The whole status, several lines.
pub fn status(status: &Status) -> String {
    let mut text = format!("pawsd is {}", status.state);
    if matches!(status.state, State::Recording | State::Stopping) {
        let _ = write!(text, ", {} so far", duration(status.seconds));
    }
    text.push('\n');
    if let Some(session) = &status.session {
        let session = session.to_string_lossy();
        let _ = writeln!(text, "session   {}", shown(&session));
    }
    if let Some(free) = status.free_bytes {
        let left = status
            .seconds_left
            .map(|s| format!(", enough for {}", duration(s)));
        let _ = writeln!(
            text,
            "disk      {:.1} GB free{}",
            free as f64 / 1e9,
            left.unwrap_or_default()
        );
    }
    for (i, encoder) in status.encoders.iter().enumerate() {
        let _ = writeln!(
            text,
            "{:<10}{}",
            if i == 0 { "encoders" } else { "" },
            shown(encoder)
        );
    }
    if !status.streams.is_empty() {
        let width = status
            .streams
            .iter()
            .map(|s| s.name.chars().count())
            .max()
            .unwrap_or(0)
            .max(6);
        let _ = writeln!(
            text,
            "\n{:<width$}  {:>8}  {:>10}  {:>10}  {:>8}",
            "stream", "per s", "received", "stored", "missing"
        );
        for stream in &status.streams {
            let line = format!(
                "{:<width$}  {:>8.1}  {:>10}  {:>10}  {:>8}  {}",
                stream.name,
                stream.rate_hz,
                stream.received,
                stream.stored,
                stream.missing,
                remark(stream)
            );
            let _ = writeln!(text, "{}", line.trim_end());
        }
    }
    if !status.alarms.is_empty() {
        text.push('\n');
    }
    for alarm in &status.alarms {
        let _ = writeln!(text, "! {}", shown(alarm));
    }
    for note in &status.notes {
        let _ = writeln!(text, "\nnote: {}", shown(note));
    }
    text
}

fn remark(stream: &StreamStatus) -> String {
    let state = match (stream.silent, stream.frozen) {
        (true, _) => "SILENT ",
        (false, true) => "FROZEN ",
        (false, false) => "",
    };
    let all = stream.stored + stream.missing;
    let percent = 100.0 * stream.missing as f64 / all.max(1) as f64;
    match percent >= 0.05 {
        true => format!("{state}{percent:.1} % missing"),
        false => state.trim_end().to_owned(),
    }
}

/// A duration in readable form.
fn duration(seconds: f64) -> String {
    let whole = seconds.max(0.0) as u64;
    match (whole / 3600, whole / 60 % 60) {
        (0, 0) => format!("{seconds:.1} s"),
        (0, minutes) => format!("{minutes} min {:02} s", whole % 60),
        (hours @ 0..=99, minutes) => format!("{hours} h {minutes:02} min"),
        (hours, _) => format!("{} days", hours / 24),
    }
}

/// Converts the progress of a recording to lines. Durability events arrive twice a second and are
/// reported only now and then; all other events immediately.
#[derive(Debug, Default)]
pub struct ProgressText {
    started: Option<HostTime>,
    last_reported: Option<HostTime>,
}

impl ProgressText {
    /// Line for this event, if it deserves one.
    pub fn line(&mut self, progress: &Progress) -> Option<String> {
        Some(match progress {
            Progress::Started { session, at, notes } => {
                (self.started, self.last_reported) = (Some(*at), Some(*at));
                let notes = notes.iter().map(|note| format!("\nnote: {}", shown(note)));
                format!(
                    "recording: {}{}",
                    session.display(),
                    notes.collect::<String>()
                )
            }
            Progress::Durable { until, messages } => {
                if self
                    .last_reported
                    .is_some_and(|last_reported| until.0 - last_reported.0 < REPORT_INTERVAL_NS)
                {
                    return None;
                }
                self.last_reported = Some(*until);
                let seconds = self
                    .started
                    .map_or(0.0, |at| (until.0 - at.0) as f64 / NS_PER_S as f64);
                format!("{} on disk, {messages} messages", duration(seconds))
            }
            Progress::Alarm { text, active: true } => format!("ALARM: {}", shown(text)),
            Progress::Alarm {
                text,
                active: false,
            } => format!("no longer: {}", shown(text)),
            Progress::Finished {
                reason,
                seconds,
                stored,
                missing,
                absent,
                streams,
                error,
                ..
            } => {
                let losses = streams.iter().filter(|s| s.missing > 0);
                let losses: String = losses.map(|s| format!("\n  {s}")).collect();
                let failure = error.as_ref().map(|error| format!("\nFAILED: {error}"));
                let nothing = match absent.as_slice() {
                    [] => String::new(),
                    names => format!(", nothing at all of {}", names.join(", ")),
                };
                format!(
                    "finished after {} ({reason}): {stored} samples stored, {missing} missing{nothing}{losses}{}",
                    duration(*seconds),
                    failure.unwrap_or_default()
                )
            }
        })
    }
}

#[cfg(test)]
mod tests {
    use std::path::PathBuf;

    use super::*;
    use crate::status::{CauseCount, StreamAccount};

    fn stream(name: &str, silent: bool, frozen: bool) -> StreamStatus {
        StreamStatus {
            name: name.into(),
            rate_hz: 29.97,
            received: 1234,
            stored: 1200,
            missing: 3,
            silent,
            frozen,
        }
    }

    #[test]
    fn status_of_a_rig_fits_on_one_screen() {
        let full = Status {
            state: State::Recording,
            session: Some("/data/a".into()),
            seconds: 83.4,
            durable_until: Some(HostTime(5)),
            streams: vec![
                stream("left_shoulder", false, false),
                stream("left_shoulder/imu", true, true),
                stream("feet", false, true),
            ],
            free_bytes: Some(118_400_000_000),
            seconds_left: Some(8040.0),
            alarms: vec![
                "left_shoulder/imu is silent".into(),
                "feet is frozen".into(),
            ],
            notes: vec!["the lenses of feet are not known".into()],
            concerns: Default::default(),
            encoders: vec!["left_shoulder: x264enc".into(), "feet: x264enc".into()],
            machine: crate::status::MachineStatus::default(),
            degradation: String::new(),
        };
        let expected = "\
pawsd is recording, 1 min 23 s so far
session   /data/a
disk      118.4 GB free, enough for 2 h 14 min
encoders  left_shoulder: x264enc
          feet: x264enc

stream                per s    received      stored   missing
left_shoulder          30.0        1234        1200         3  0.2 % missing
left_shoulder/imu      30.0        1234        1200         3  SILENT 0.2 % missing
feet                   30.0        1234        1200         3  FROZEN 0.2 % missing

! left_shoulder/imu is silent
! feet is frozen

note: the lenses of feet are not known
";
        assert_eq!(status(&full), expected);
        let empty = Status {
            state: State::Idle,
            session: None,
            streams: Vec::new(),
            free_bytes: None,
            seconds_left: None,
            alarms: Vec::new(),
            notes: Vec::new(),
            concerns: Default::default(),
            encoders: Vec::new(),
            machine: crate::status::MachineStatus::default(),
            degradation: String::new(),
            ..full
        };
        assert_eq!(status(&empty), "pawsd is idle\n");
    }

    #[test]
    fn foreign_names_cannot_add_lines() {
        let hostile = "x\n! all is well\u{1b}[2J".to_owned();
        let status = Status {
            state: State::Armed,
            session: Some(format!("/data/{hostile}").into()),
            seconds: 0.0,
            durable_until: None,
            streams: Vec::new(),
            free_bytes: None,
            seconds_left: None,
            alarms: vec![hostile.clone()],
            concerns: Default::default(),
            encoders: vec![hostile.clone()],
            machine: crate::status::MachineStatus::default(),
            notes: vec![hostile.clone()],
            degradation: String::new(),
        };
        let text = super::status(&status);
        assert_eq!(text.lines().count(), 7, "{text}");
        assert!(!text.contains('\u{1b}'), "{text}");
        let mut narrator = ProgressText::default();
        for active in [true, false] {
            let text = hostile.clone();
            let line = narrator.line(&Progress::Alarm { text, active }).unwrap();
            assert!(!line.contains(['\n', '\u{1b}']), "{line}");
        }
    }

    #[test]
    fn durations_are_readable() {
        let check = |seconds: f64, expected: &str| assert_eq!(duration(seconds), expected);
        check(0.04, "0.0 s");
        check(59.94, "59.9 s");
        check(60.0, "1 min 00 s");
        check(3599.9, "59 min 59 s");
        check(3600.0, "1 h 00 min");
        check(1e6, "11 days");
        check(f64::INFINITY, "213503982334601 days");
    }

    #[test]
    fn recording_without_problems_prints_few_lines() {
        let mut narrator = ProgressText::default();
        let session = PathBuf::from("/data/a");
        let at = HostTime(7 * NS_PER_S);
        let started = Progress::Started {
            session: session.clone(),
            at,
            notes: Vec::new(),
        };
        assert_eq!(narrator.line(&started).unwrap(), "recording: /data/a");
        let lacking = Progress::Started {
            session: session.clone(),
            at,
            notes: vec!["no lenses".into()],
        };
        assert_eq!(
            narrator.line(&lacking).unwrap(),
            "recording: /data/a\nnote: no lenses"
        );
        let lines: Vec<String> = (1..=24)
            .map(|half| Progress::Durable {
                until: HostTime(at.0 + half * NS_PER_S / 2),
                messages: 10 * half as u64,
            })
            .filter_map(|progress| narrator.line(&progress))
            .collect();
        assert_eq!(
            lines,
            [
                "5.0 s on disk, 100 messages",
                "10.0 s on disk, 200 messages"
            ]
        );
        let alarm = Progress::Alarm {
            text: "feet is silent".into(),
            active: true,
        };
        assert_eq!(narrator.line(&alarm).unwrap(), "ALARM: feet is silent");
        let finished = Progress::Finished {
            session,
            reason: "disk".into(),
            seconds: 12.0,
            stored: 240,
            missing: 1,
            absent: vec!["feet".into()],
            streams: vec![StreamAccount {
                name: "left_shoulder".into(),
                is_camera: true,
                stored: 3,
                missing: 1,
                causes: vec![CauseCount {
                    cause: "the disk is too slow".into(),
                    count: 1,
                }],
            }],
            error: Some("no space left".into()),
        };
        let expected = "finished after 12.0 s (disk): 240 samples stored, 1 missing, nothing at all of feet\n\
                        \x20 left_shoulder: 25.0 % of the frames are missing (1 of 4): the disk is too slow (1)\n\
                        FAILED: no space left";
        assert_eq!(narrator.line(&finished).unwrap(), expected);
    }
}
