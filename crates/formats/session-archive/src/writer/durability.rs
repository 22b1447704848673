//! What the writer reports as durable: on disk after a power cut.
//!
//! Messages become durable chunk by chunk: a chunk is written, then synced, and only then counted.
//! What is still in the chunk in the making can be lost, half a second by default.

use crate::time::HostTime;

/// Up to where everything is on disk: the messages, or the gap records in their place
/// (`Incident::lost`).
///
/// ```
/// use session_archive::record::Event;
/// use session_archive::time::HostTime;
/// # use session_archive::time::CivilTime;
/// # let spec = session_archive::writer::SessionSpec {
/// #     session_id: "0192aa00-0000-7000-8000-00000000000d".to_owned(),
/// #     name: String::new(),
/// #     software: "example".to_owned(),
/// #     started: HostTime(0),
/// #     started_civil: CivilTime(0),
/// #     chunk_ns: 500_000_000,
/// #     cameras: Vec::new(),
/// #     imus: Vec::new(),
/// #     rig: Vec::new(),
/// # };
/// # let storage = std::sync::Arc::new(session_archive::storage::FaultStorage::new());
/// # let mut writer = session_archive::writer::SessionWriter::create(storage, spec)?;
/// let mark = Event { text: "stairs".to_owned(), ..Event::default() };
/// writer.append("", HostTime(100), HostTime(100), &mark)?;
/// // The chunk in the making is what a power cut may take.
/// assert_eq!(writer.durability().messages, 0);
/// assert!(writer.durability().until < HostTime(100));
///
/// writer.poll(HostTime(2_000_000_000))?;
/// let durable = writer.durability();
/// assert_eq!((durable.messages, durable.chunks), (1, 1));
/// assert_eq!(durable.until, HostTime(2_000_000_000));
/// # Ok::<(), session_archive::writer::WriteError>(())
/// ```
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Durability {
    /// Every message appended so far with a log time up to here is on disk.
    pub until: HostTime,
    /// Messages on disk.
    pub messages: u64,
    /// Chunks on disk, the heads of segments not counted.
    pub chunks: u64,
    /// Bytes on disk.
    pub bytes: u64,
}
