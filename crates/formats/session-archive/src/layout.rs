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
///
/// ```
/// use session_archive::layout;
///
/// assert_eq!(layout::segment(42), "segments/000042.mcap");
/// assert_eq!(layout::segment_number("000042.mcap"), Some(42));
/// assert_eq!(layout::segment_number("42.mcap"), None);
/// assert_eq!(layout::segment_number("000042.mcap.closing"), None);
/// ```
pub fn segment_number(name: &str) -> Option<u32> {
    let digits = name.strip_suffix(".mcap")?;
    (digits.len() == 6 && digits.bytes().all(|b| b.is_ascii_digit()))
        .then(|| digits.parse().ok())?
}

/// Whether this is one plain name, that cannot lead into another folder.
pub(crate) fn is_file_name(name: &str) -> bool {
    !["", ".", ".."].contains(&name) && !name.contains(['/', '\\', '\0'])
}

/// Whether a camera or an IMU may have this name: parts of letters, digits, `_`, `-` and `.`, not
/// beginning with a dot, with `/` between them. Names of files are made of it.
pub(crate) fn is_stream_name(name: &str) -> bool {
    let plain = |c: char| c.is_ascii_alphanumeric() || "_-.".contains(c);
    let part = |part: &str| !part.is_empty() && !part.starts_with('.') && part.chars().all(plain);
    name.split('/').all(part)
}

/// Path of a file that describes the rig: `rig/NAME`.
pub fn rig_file(name: &str) -> String {
    format!("{RIG}/{name}")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_of_streams_lead_nowhere_else() {
        for name in ["feet", "left_shoulder", "feet/imu", "zed-2.i"] {
            assert!(is_stream_name(name), "{name}");
        }
        for name in [
            "", "..", "../feet", "/feet", "feet/", "a//b", ".hidden", "a b", "a\\b", "\u{e9}",
        ] {
            assert!(!is_stream_name(name), "{name}");
        }
    }
}
