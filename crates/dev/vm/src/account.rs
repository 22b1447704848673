//! Contents of a session by stream: samples, gaps with their causes, and events.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::sync::Arc;

use anyhow::{Context as _, Result, ensure};
use serde::Serialize;
use session_archive::manifest::State;
use session_archive::reader::{Entry, SessionReader};
use session_archive::record::paws::event::Kind;
use session_archive::record::paws::gap::Cause;
use session_archive::record::paws::health::FrameSync;
use session_archive::record::{Event, Gap, Health, Record};
use session_archive::storage::DiskStorage;
use session_archive::verify::verify;

/// One session.
#[derive(Clone, Debug)]
pub struct Account {
    /// Its folder.
    pub folder: PathBuf,
    /// Whether it was closed properly.
    pub closed: bool,
    /// Why it ended, if that was recorded.
    pub stopped: Option<String>,
    /// By numbered stream.
    pub streams: BTreeMap<String, Stream>,
    /// Gap records in the order in which they were written.
    pub gaps: Vec<Gap>,
    /// Events: kind, source, text.
    pub events: Vec<(Kind, String, String)>,
    /// Relation of the camera's and the IMU's clock, by IMU, as last recorded.
    pub ties: BTreeMap<String, FrameSync>,
    /// Steps of civil time, ns.
    pub clock_steps: Vec<i64>,
}

/// One stream.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct Stream {
    /// Samples stored.
    pub samples: u64,
    /// Samples that gap records name.
    pub gaps: u64,
    /// Samples missing without a gap record.
    pub lost: u64,
    /// From the first to the last sample, ns.
    pub span_ns: i64,
}

impl Account {
    /// Reads a session.
    ///
    /// # Errors
    /// It does not open, is damaged, or the file system reports an I/O error.
    pub fn read(folder: &Path) -> Result<Self> {
        let reader = SessionReader::open(Arc::new(DiskStorage::new(folder)))
            .with_context(|| format!("opening the session {}", folder.display()))?;
        let report = verify(&reader, |_| {})?;
        let manifest = reader.manifest();
        let mut account = Self {
            folder: folder.to_owned(),
            closed: manifest.state != State::Recording,
            stopped: manifest.stopped.as_ref().map(|stop| stop.reason.clone()),
            streams: BTreeMap::new(),
            gaps: Vec::new(),
            events: Vec::new(),
            ties: BTreeMap::new(),
            clock_steps: Vec::new(),
        };
        for (name, found) in &report.streams {
            let stream = Stream {
                samples: found.samples,
                gaps: found.gaps,
                lost: found.lost,
                span_ns: found.end.since(found.start),
            };
            account.streams.insert(name.clone(), stream);
        }
        ensure!(
            report.damage.is_empty() || !account.closed,
            "a closed session is damaged, {:?}: {}",
            report.damage,
            folder.display()
        );
        for entry in reader.entries() {
            let Entry::Message(message) = entry? else {
                continue;
            };
            let schema = reader.stream(message.stream).map(|s| s.schema.as_str());
            if schema == Some(Gap::SCHEMA.name) {
                account.gaps.push(message.decode()?);
            } else if schema == Some(Event::SCHEMA.name) {
                let event: Event = message.decode()?;
                account
                    .events
                    .push((event.kind(), event.source, event.text));
            } else if schema == Some(Health::SCHEMA.name) {
                account.health(message.decode()?);
            }
        }
        Ok(account)
    }

    fn health(&mut self, health: Health) {
        for stream in health.streams {
            if let Some(tie) = stream.frame_sync {
                self.ties.insert(stream.name, tie);
            }
        }
        let step = health.clock.map_or(0, |clock| clock.step_ns);
        if step != 0 {
            self.clock_steps.push(step);
        }
    }

    /// Reads all sessions in a folder, in the order of their names, which is that of their times.
    ///
    /// # Errors
    /// One cannot be read.
    pub fn read_all(folder: &Path) -> Result<Vec<Self>> {
        let reading = || format!("looking for sessions {}", folder.display());
        let entries = std::fs::read_dir(folder).with_context(reading)?;
        let mut folders = Vec::new();
        for entry in entries {
            let path = entry.with_context(reading)?.path();
            if path.is_dir() && !path.ends_with("lost+found") {
                folders.push(path);
            }
        }
        folders.sort();
        folders.iter().map(|folder| Self::read(folder)).collect()
    }

    /// Samples and gaps of a stream.
    ///
    /// # Errors
    /// There is no such stream.
    pub fn stream(&self, name: &str) -> Result<Stream> {
        let stream = self.streams.get(name).copied();
        stream.with_context(|| {
            let known: Vec<&str> = self.streams.keys().map(String::as_str).collect();
            format!("no stream {name}, there are {known:?}")
        })
    }

    /// Every sample of every stream is there or in a gap record.
    ///
    /// # Errors
    /// One is not.
    pub fn is_accounted_for(&self) -> Result<()> {
        for (name, stream) in &self.streams {
            ensure!(
                stream.lost == 0 && stream.samples > 0,
                "{name}: {stream:?}: {}",
                self.folder.display()
            );
        }
        Ok(())
    }

    /// How many samples of a stream are missing for a cause.
    pub fn missing(&self, stream: &str, cause: Cause) -> u64 {
        let gaps = self.gaps.iter();
        let gaps = gaps.filter(|gap| gap.stream == stream && gap.cause() == cause);
        gaps.map(Gap::count).sum()
    }

    /// Counts of all streams, for programs.
    pub fn figures(&self) -> serde_json::Value {
        let gaps = self.gaps.iter().map(|gap| {
            serde_json::json!({
                "stream": gap.stream, "count": gap.count(),
                "cause": gap.cause().as_str_name(), "detail": gap.detail,
            })
        });
        let ties = self.ties.iter().map(|(imu, tie)| {
            serde_json::json!({
                "imu": imu, "pairs": tie.pairs, "offset_ns": tie.offset_ns, "sigma_ns": tie.sigma_ns,
                "residual_median_ns": tie.residual_median_ns, "residual_p99_ns": tie.residual_p99_ns,
            })
        });
        serde_json::json!({
            "closed": self.closed, "stopped": self.stopped, "streams": self.streams,
            "gaps": gaps.collect::<Vec<_>>(), "ties": ties.collect::<Vec<_>>(),
        })
    }
}

/// Has `paws validate` judge sessions, with other limits for some metrics; an error if it fails
/// one. Samples that are missing and accounted for are fine, as far as the limits go.
///
/// # Errors
/// It cannot be started, or says FAIL; the message has its reasons.
pub fn validate(paws: &Path, sessions: &[Account], limits: &[&str]) -> Result<()> {
    let said = Command::new(paws)
        .arg("validate")
        .args(limits.iter().flat_map(|limit| ["--limit", limit]))
        .args(sessions.iter().map(|session| &session.folder))
        .stdin(Stdio::null())
        .output()
        .with_context(|| format!("starting {}", paws.display()))?;
    // 3: nothing failed, but something is missing.
    ensure!(
        matches!(said.status.code(), Some(0 | 3)),
        "paws validate ended with {}:\n{}{}",
        said.status,
        String::from_utf8_lossy(&said.stdout),
        String::from_utf8_lossy(&said.stderr)
    );
    Ok(())
}
