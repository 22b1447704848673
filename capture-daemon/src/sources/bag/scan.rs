//! Content of a bag: its topics with images and IMU samples, and the time of each message.

use std::path::{Path, PathBuf};

use super::SQLITE;
use super::cdr::CdrError;
use super::container::{Container, RecordLocation};
use super::error::BagError;
use super::messages::{self, Imu, Kind};
use crate::sources::Extent;

/// One topic.
#[derive(Debug)]
pub(super) struct Stream {
    pub(super) topic: String,
    pub(super) kind: Kind,
    /// Its messages, in the order in which they were recorded.
    pub(super) messages: Vec<IndexedMessage>,
}

/// One message.
#[derive(Debug)]
pub(super) struct IndexedMessage {
    /// Recording time; only for the order.
    log_time: u64,
    /// Index of the file in the bag, and the location in it.
    pub(super) location: (usize, RecordLocation),
    /// Time in its header, ns; `None` if it was never set.
    pub(super) stamp_ns: Result<Option<i64>, CdrError>,
    /// Its values, if it is an IMU sample.
    pub(super) imu: Option<Result<Imu, CdrError>>,
}

impl Stream {
    pub(super) fn new(topic: &str, kind: Kind) -> Self {
        Self {
            topic: topic.to_owned(),
            kind,
            messages: Vec::new(),
        }
    }

    /// Description for people.
    pub(super) fn describe(&self) -> String {
        format!(
            "{} ({}, {} messages)",
            self.topic,
            self.kind.name(),
            self.messages.len()
        )
    }
}

/// A scanned bag.
pub(super) struct Bag {
    pub(super) files: Vec<Container>,
    pub(super) streams: Vec<Stream>,
    /// Tolerable problems, for people.
    pub(super) notes: Vec<String>,
    /// The files continue behind the part that was read.
    pub(super) is_head: bool,
}

/// Scans all files of a bag.
pub(super) fn scan(path: &Path, extent: Extent) -> Result<Bag, BagError> {
    let mut files = Vec::new();
    let mut streams: Vec<Stream> = Vec::new();
    let mut notes = Vec::new();
    let mut foreign = None;
    let mut is_head = false;
    for (number, file) in files_of(path)?.into_iter().enumerate() {
        let mut container = Container::open(&file, extent)?;
        let scanned = container.scan(|topic, message, location| {
            let Some(kind) = Kind::of(&topic.schema) else {
                return;
            };
            if topic.encoding != "cdr" {
                foreign = Some(format!("{} is encoded as {:?}", topic.name, topic.encoding));
                return;
            }
            let known = streams
                .iter()
                .position(|s| s.topic == topic.name && s.kind == kind);
            let known = known.unwrap_or_else(|| {
                streams.push(Stream::new(&topic.name, kind));
                streams.len() - 1
            });
            streams[known].messages.push(IndexedMessage {
                log_time: message.log_time,
                location: (number, location),
                stamp_ns: messages::stamp(message.data),
                imu: (kind == Kind::Imu).then(|| messages::imu(message.data)),
            });
        })?;
        is_head |= scanned.is_head;
        let name = file.file_name().unwrap_or_default().display().to_string();
        if let Some(at) = scanned.cut_at {
            notes.push(format!(
                "{name} is cut off at byte {at}: what is before it is replayed"
            ));
        }
        if scanned.damaged > 0 {
            notes.push(format!(
                "{name}: {} damaged chunks are left out",
                scanned.damaged
            ));
        }
        files.push(container);
    }
    if let (Some(what), true) = (foreign, streams.is_empty()) {
        return Err(BagError::Topics {
            path: path.to_owned(),
            what: format!("{what}, expected \"cdr\" as ROS 2 writes it"),
            topics: Vec::new(),
        });
    }
    for stream in &mut streams {
        stream
            .messages
            .sort_by_key(|message| (message.log_time, message.location));
    }
    Ok(Bag {
        files,
        streams,
        notes,
        is_head,
    })
}

/// The MCAP files of a bag: itself, or those in its folder.
fn files_of(path: &Path) -> Result<Vec<PathBuf>, BagError> {
    let failed = |source| BagError::Read {
        path: path.to_owned(),
        source,
    };
    if !std::fs::metadata(path).map_err(failed)?.is_dir() {
        return Ok(vec![path.to_owned()]);
    }
    let mut files = Vec::new();
    let mut other = None;
    for entry in std::fs::read_dir(path).map_err(failed)? {
        let file = entry.map_err(failed)?.path();
        let name = file
            .file_name()
            .unwrap_or_default()
            .to_string_lossy()
            .to_ascii_lowercase();
        if name.ends_with(".mcap") {
            files.push(file);
        } else if name.ends_with(".db3") || name.ends_with(".db3.zstd") {
            other = Some(SQLITE);
        } else if name.ends_with(".mcap.zstd") {
            other = Some((
                "files that are compressed as a whole",
                "unpack them with `zstd -d FILE`",
            ));
        }
    }
    if files.is_empty() {
        let (found, remedy) = other.unwrap_or((
            "a folder without .mcap files",
            "name the folder that `ros2 bag record --storage mcap` made, or a file",
        ));
        return Err(BagError::Storage {
            path: path.to_owned(),
            found,
            remedy,
        });
    }
    files.sort();
    Ok(files)
}
