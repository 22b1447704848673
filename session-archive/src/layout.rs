//! Every path and file name of a session folder.

/// The manifest.
pub const MANIFEST: &str = "session.json";
/// Folder of the vendor calibrations and the rig file, byte copies.
pub const RIG: &str = "rig";
/// Folder of the segments.
pub const SEGMENTS: &str = "segments";
/// The derived index; on the host, never on the body. Can be deleted at any time.
pub const INDEX: &str = "index.bin";
/// The sealed hand-off manifest; on the host.
pub const HANDOFF: &str = "handoff.json";
/// The verdict of the last validation; on the host. Can be deleted at any time.
pub const VALIDATION: &str = "validation.json";

/// Path of a segment: `segments/000042.mcap`.
pub fn segment(number: u32) -> String {
    format!("{SEGMENTS}/{number:06}.mcap")
}

/// The number of a segment from its file name (no folder), if it is one.
pub fn segment_number(name: &str) -> Option<u32> {
    let digits = name.strip_suffix(".mcap")?;
    (digits.len() == 6 && digits.bytes().all(|b| b.is_ascii_digit()))
        .then(|| digits.parse().ok())?
}

/// Whether this is one plain name, with no way into another folder.
pub fn is_file_name(name: &str) -> bool {
    !["", ".", ".."].contains(&name) && !name.contains(['/', '\\', '\0'])
}

/// Path of a file that describes the rig: `rig/NAME`.
pub fn rig_file(name: &str) -> String {
    format!("{RIG}/{name}")
}
