//! Every path and file name of a bundle, and which names are allowed.

/// The manifest.
pub const MANIFEST: &str = "scene.json";
/// Maximum size of a manifest, bytes.
pub(crate) const MANIFEST_LIMIT: u64 = plain_file::DOCUMENT_LIMIT;
/// Lock file, held by the process that writes to the bundle.
pub const LOCK: &str = "lock";
/// Time and memory of the stages; not part of the bundle.
pub const STAGE_TIMINGS: &str = "stage_timings.jsonl";
/// Small images of each camera; not part of the bundle.
pub const CAMERA_IMAGES: &str = "seen.jsonl";
/// Film of an agent in the scene; not part of the bundle.
pub const FILM: &str = "film.jsonl";
/// Report page of the bundle; not part of it.
pub const PAGE: &str = "report.html";
/// In an output's folder: hashes of files that are too many for the manifest.
pub(crate) const LISTING: &str = "files.b3";

/// Prefix of the folders of drafts.
const DRAFT_PREFIX: &str = ".draft-";
/// Number of digits of the hash in a folder's name.
const HASH_DIGITS: usize = 16;

/// Folder of an output of this content: `NAME.` and the first 16 digits of its hash.
///
/// ```
/// use scene_bundle::layout::{folder, is_ours};
///
/// let name = folder("trajectory", &"0123456789abcdef".repeat(4));
/// assert_eq!(name, "trajectory.0123456789abcdef");
/// // Only such names may be removed by a writer that cleans up.
/// assert!(is_ours(&name));
/// assert!(!is_ours("notes.txt"));
/// ```
pub fn folder(name: &str, hash: &str) -> String {
    format!("{name}.{}", hash.get(..HASH_DIGITS).unwrap_or(hash))
}

/// Folder in which an output is made.
pub fn draft(name: &str) -> String {
    format!("{DRAFT_PREFIX}{name}")
}

/// Whether a name in the bundle's folder is one that only a writer makes: a draft, a version of an
/// output, or a manifest that was being written.
pub fn is_ours(name: &str) -> bool {
    let is_hash = |text: &str| text.len() == HASH_DIGITS && is_hex(text);
    name == temporary(MANIFEST)
        || name.strip_prefix(DRAFT_PREFIX).is_some_and(is_output_name)
        || name
            .split_once('.')
            .is_some_and(|(output, hash)| is_output_name(output) && is_hash(hash))
}

/// State of a training of the stage `splats` that was not completed, or of one of its sectors; not
/// part of the bundle.
///
/// ```
/// use scene_bundle::layout::{is_splats_checkpoint, splats_checkpoint};
///
/// assert_eq!(splats_checkpoint(None), "splats.checkpoint");
/// assert_eq!(splats_checkpoint(Some(7)), "splats-007.checkpoint");
/// assert!(is_splats_checkpoint(&splats_checkpoint(Some(1234))));
/// assert!(is_splats_checkpoint("splats-007.checkpoint.tmp"));
/// assert!(!is_splats_checkpoint("splats-a.checkpoint"));
/// assert!(!is_splats_checkpoint("splats.checkpoint.tmp.tmp"));
/// ```
pub fn splats_checkpoint(sector: Option<usize>) -> String {
    sector.map_or_else(
        || "splats.checkpoint".to_owned(),
        |sector| format!("splats-{sector:03}.checkpoint"),
    )
}

/// Whether a name is one of [`splats_checkpoint`], also with `.tmp` after it, as while it is
/// written.
pub fn is_splats_checkpoint(name: &str) -> bool {
    let name = name.strip_suffix(".tmp").unwrap_or(name);
    let sector = name.strip_prefix("splats-");
    let sector = sector.and_then(|rest| rest.strip_suffix(".checkpoint"));
    let number = sector.and_then(|number| number.parse().ok());
    name == splats_checkpoint(None) || number.is_some_and(|n| name == splats_checkpoint(Some(n)))
}

/// Name of a file while it is written beside the old one.
pub fn temporary(path: &str) -> String {
    format!("{path}.tmp")
}

/// Whether an output may have this name: lower-case letters, digits and `-`, beginning with a
/// letter.
pub fn is_output_name(name: &str) -> bool {
    let plain = |b: u8| b.is_ascii_lowercase() || b.is_ascii_digit() || b == b'-';
    name.as_bytes().first().is_some_and(u8::is_ascii_lowercase) && name.bytes().all(plain)
}

/// Whether a file of an output may have this path: parts of ASCII letters, digits, `_`, `-` and
/// `.`, none beginning with a dot, with `/` between them.
///
/// ```
/// use scene_bundle::layout::is_file_path;
///
/// assert!(is_file_path("left_shoulder/left/000001.png"));
/// // No path leads out of the folder of its output, and none is hidden in it.
/// for path in ["../scene.json", "/etc/hosts", "a//b", ".a", "a b"] {
///     assert!(!is_file_path(path), "{path}");
/// }
/// ```
pub fn is_file_path(path: &str) -> bool {
    let plain = |b: u8| b.is_ascii_alphanumeric() || b"_-.".contains(&b);
    let part = |part: &str| !part.is_empty() && !part.starts_with('.') && part.bytes().all(plain);
    path.split('/').all(part)
}

/// Whether this is a BLAKE3 hash in lower-case hex.
pub fn is_hash(text: &str) -> bool {
    text.len() == 64 && is_hex(text)
}

fn is_hex(text: &str) -> bool {
    text.bytes().all(|b| matches!(b, b'0'..=b'9' | b'a'..=b'f'))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_do_not_lead_out_of_the_bundle() {
        for name in ["rig", "trajectory-causal", "depth2"] {
            assert!(is_output_name(name), "{name}");
        }
        for name in ["", "-rig", "2d", "Rig", "a.b", "a/b", "..", "a b", "\u{e9}"] {
            assert!(!is_output_name(name), "{name}");
        }
        for path in ["a.npy", "left_shoulder/left/000001.png", "A-b_c.2"] {
            assert!(is_file_path(path), "{path}");
        }
        for path in [
            "", "/a", "a/", "a//b", "../a", "a/../b", ".a", "a b", "a\\b", "a\n",
        ] {
            assert!(!is_file_path(path), "{path}");
        }
    }

    #[test]
    fn only_names_that_a_writer_creates_may_be_removed() {
        let hash = "0123456789abcdef".repeat(4);
        for name in [
            folder("trajectory-causal", &hash),
            draft("rig"),
            temporary(MANIFEST),
        ] {
            assert!(is_ours(&name), "{name}");
        }
        for name in [
            MANIFEST,
            LOCK,
            "notes.txt",
            "rig",
            "rig.0123456789abcde",
            "rig.0123456789abcdeg",
            ".draft-",
            "Rig.0123456789abcdef",
        ] {
            assert!(!is_ours(name), "{name}");
        }
    }
}
