//! Contract 1: what was recorded and when.
//!
//! A session is a folder: a manifest, the rig's files, and segments in MCAP, each readable alone.
//! `FORMAT.md` beside this crate is the contract; the crate is its writer, reader, verifier and
//! recovery. It knows nothing of devices, video codecs or catalogues.
//!
//! Recording two marks into a folder, and reading them back:
//!
//! ```
//! # use std::sync::Arc;
//!
//! # use session_archive::manifest::Stop;
//! # use session_archive::reader::{Entry, SessionReader};
//! # use session_archive::record::{Event, Record};
//! # use session_archive::storage::DiskStorage;
//! # use session_archive::time::HostTime;
//! # use session_archive::writer::SessionWriter;
//!
//! # use session_archive::time::CivilTime;
//! # let spec = session_archive::writer::SessionSpec {
//! #     session_id: "0192aa00-0000-7000-8000-00000000000a".to_owned(),
//! #     name: "stairs".to_owned(),
//! #     software: "example".to_owned(),
//! #     started: HostTime(1_000_000_000),
//! #     started_civil: CivilTime(1_790_000_000_000_000_000),
//! #     chunk_ns: 500_000_000,
//! #     cameras: Vec::new(),
//! #     imus: Vec::new(),
//! #     rig: Vec::new(),
//! # };
//! # let folder = tempfile::tempdir()?;
//! let storage = Arc::new(DiskStorage::new(folder.path()));
//! let mut writer = SessionWriter::create(storage.clone(), spec)?;
//! for (ns, text) in [(1_200_000_000, "first step"), (1_900_000_000, "last step")] {
//!     let mark = Event { text: text.to_owned(), ..Event::default() };
//!     writer.append("", HostTime(ns), HostTime(ns), &mark)?;
//! }
//! writer.close(Stop { at: HostTime(2_000_000_000), reason: "button".to_owned() })?;
//!
//! let reader = SessionReader::open(storage)?;
//! let mut marks = Vec::new();
//! for entry in reader.entries() {
//!     if let Entry::Message(message) = entry?
//!         && reader.stream(message.stream).is_some_and(|s| s.schema == Event::SCHEMA.name)
//!     {
//!         marks.push((message.time, message.decode::<Event>()?.text));
//!     }
//! }
//! assert_eq!(marks.len(), 2);
//! assert_eq!(marks[1], (HostTime(1_900_000_000), "last step".to_owned()));
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! Going through a recorded session: one chunk is in memory at a time, and damage is an entry, not
//! an error.
//!
//! ```
//! use std::sync::Arc;
//!
//! use session_archive::reader::{Entry, SessionReader};
//! use session_archive::record::{Frame, Record};
//! use session_archive::storage::DiskStorage;
//!
//! # let folder = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/fixtures/v1");
//! let reader = SessionReader::open(Arc::new(DiskStorage::new(folder)))?;
//! let frames_of = reader.manifest().stream::<Frame>("left_shoulder").ok_or("no such camera")?.id;
//! let (mut frames, mut damaged) = (Vec::new(), 0);
//! for entry in reader.entries() {
//!     match entry? {
//!         Entry::Message(message) if message.stream == frames_of => frames.push(message.decode::<Frame>()?),
//!         Entry::Message(_) | Entry::SegmentEnd { .. } => {}
//!         Entry::Damage { .. } | Entry::SegmentMissing { .. } => damaged += 1,
//!     }
//! }
//! assert_eq!((frames.len(), damaged), (31, 0));
//! assert!(frames.is_sorted_by_key(|frame| frame.number));
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! A folder with segments alone opens too: they carry enough to rebuild the manifest.
//!
//! ```
//! use std::sync::Arc;
//!
//! use session_archive::reader::SessionReader;
//! use session_archive::storage::{DiskStorage, FaultStorage, read_all};
//!
//! # let folder = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/fixtures/v1");
//! let disk = FaultStorage::new(); // in memory
//! let segment = read_all(&DiskStorage::new(folder), "segments/000000.mcap")?;
//! disk.set_content("segments/000000.mcap", segment);
//! let reader = SessionReader::open(Arc::new(disk))?;
//! assert_eq!(reader.manifest_note(), Some("session.json is missing"));
//! assert_eq!(reader.manifest().cameras.len(), 2);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

pub mod foreign;
pub mod handoff;
mod impossible;
pub mod index;
pub mod layout;
pub mod manifest;
pub mod mcap;
pub mod reader;
pub mod record;
pub mod recover;
mod roles;
mod salvage;
pub mod scan;
pub mod storage;
pub mod text;
pub mod time;
pub mod verify;
pub mod writer;
