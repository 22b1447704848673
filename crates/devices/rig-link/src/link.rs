//! Types of the protocol *rig link v1*, specified in `docs/reference/rig-link.md`.
//!
//! Everything is JSON, unknown fields are ignored, and a field that may be missing is an `Option`.
//! A session's *list* is the set of its files with length and hash; its [`list_hash`] identifies
//! the whole content of the session in one line of text.

use serde::{Deserialize, Serialize};

/// Version of the contract. It is incremented only if an old end would misunderstand a new one.
pub const VERSION: u32 = 1;
/// Value of [`Sessions::format`].
pub const FORMAT: &str = "rig-link";
/// Value of [`Receipt::format`].
pub const RECEIPT_FORMAT: &str = "rig-link-receipt";
/// Header that a client without a browser's `Origin` sends with every POST; the value is
/// [`VERSION`].
pub const HEADER: &str = "x-rig-link";
/// Maximum length of a file's path below a session's folder, bytes.
const MAX_PATH: usize = 512;
/// Maximum depth of nested folders; a session has one level.
pub const MAX_DEPTH: usize = 8;
/// Maximum length of a manifest's line, bytes.
pub(crate) const MAX_LINE: usize = 4096;

/// Files at the top of a session's folder that a host derives and can derive again; never listed.
pub const DERIVED: [&str; 5] = [
    "import.json",
    "index.bin",
    "validation.json",
    "handoff.json",
    "report.html",
];

/// State of a session.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum SessionState {
    /// Being recorded now: listed, but cannot be pulled.
    Recording,
    /// Stopped and closed by the recorder.
    Closed,
    /// Recovered after it was cut off.
    Recovered,
    /// Cut off while it was recorded, and not recovered.
    Interrupted,
    /// Its `session.json` cannot be read.
    Damaged,
}

/// One session of the list.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct SessionSummary {
    /// Name of its folder, used in addresses.
    pub name: String,
    /// Its identifier, unique among all sessions of all rigs; `None` if its manifest cannot be
    /// read.
    pub session_id: Option<String>,
    /// Title given by the operator, on one line (a control character is `\u001b`); may be empty.
    pub title: String,
    /// State.
    pub state: SessionState,
    /// Start time by the recorder's civil clock, ns since 1970, UTC.
    pub started_ns: Option<i64>,
    /// Bytes of its files.
    pub bytes: u64,
    /// Number of its files.
    pub files: u64,
    /// The stored receipt. Whether it still matches is checked when the session is freed.
    pub receipt: Option<Receipt>,
}

/// Response to `GET /api/sessions`.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Sessions {
    /// [`FORMAT`].
    pub format: String,
    /// [`VERSION`].
    pub version: u32,
    /// By name.
    pub sessions: Vec<SessionSummary>,
}

/// One file of a session.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct FileEntry {
    /// Path below the session's folder, `/` between names.
    pub path: String,
    /// Length.
    pub bytes: u64,
    /// Modification time, ns since 1970 by the rig's clock.
    pub modified_ns: i64,
    /// BLAKE3 of the content, 64 hex digits.
    pub blake3: String,
}

/// Last line of a manifest; without it the manifest is incomplete.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Total {
    /// [`list_hash`] of the files.
    pub list: String,
    /// Their number.
    pub files: u64,
    /// Sum of their lengths.
    pub bytes: u64,
}

/// One line of `GET /api/sessions/NAME/manifest`.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Line {
    /// A file, sent as soon as it is hashed.
    File(FileEntry),
    /// The end.
    Total(Total),
    /// The rig cannot continue; nothing follows.
    Error(Problem),
}

/// A complete manifest.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Manifest {
    /// The files, by path.
    pub files: Vec<FileEntry>,
    /// Their totals.
    pub total: Total,
}

/// A host's confirmation that it holds a session, verified and synced. The rig may then free the
/// session.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Receipt {
    /// [`RECEIPT_FORMAT`].
    pub format: String,
    /// [`VERSION`].
    pub version: u32,
    /// The session's identifier.
    pub session_id: String,
    /// [`list_hash`] of the files that the host holds.
    pub list: String,
    /// Number of files it holds.
    pub files: u64,
    /// Their bytes.
    pub bytes: u64,
    /// Name of the host, for display.
    pub host: String,
    /// Time of the verification, ns since 1970 by the host's clock.
    pub verified_ns: i64,
}

/// An error, for programs and for display.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Problem {
    /// Kind of the error, which determines the client's action.
    pub code: Code,
    /// What was found and expected.
    pub message: String,
}

/// Body of every error response.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub(crate) struct ErrorBody {
    /// The problem.
    pub error: Problem,
}

/// Error codes.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Code {
    /// The request does not follow this protocol.
    BadRequest,
    /// The token is missing or wrong.
    Unauthorised,
    /// The request comes from another site's page, or names another host.
    Forbidden,
    /// The resource does not exist.
    NotFound,
    /// The resource exists, but not for this method.
    WrongMethod,
    /// The session is being recorded.
    Recording,
    /// There is no receipt for the session.
    NoReceipt,
    /// The list hash does not match the files on disk.
    ListDiffers,
    /// Hashes are not known (any more): fetch the manifest, then repeat the request.
    ManifestFirst,
    /// The session's folder contains entries that are not listed, so it is not removed.
    NotListed,
    /// The recorder rejects the action.
    Refused,
    /// Too many requests; wait for `Retry-After`.
    TooMany,
    /// The range is not in the file.
    Range,
    /// An I/O error occurs.
    Io,
    /// A code unknown to this version.
    #[serde(other)]
    Unknown,
}

/// Identifies the content of a session: BLAKE3, in hex, over `PATH NUL LENGTH NUL HASH LF` for each
/// file in ascending order of the bytes of `PATH`, with `LENGTH` in decimal and `HASH` in
/// lower-case hex.
pub fn list_hash<'a>(files: impl IntoIterator<Item = (&'a str, u64, &'a str)>) -> String {
    let mut files: Vec<_> = files.into_iter().collect();
    files.sort_unstable();
    let mut hasher = blake3::Hasher::new();
    for (path, bytes, hash) in files {
        hasher.update(format!("{path}\0{bytes}\0{hash}\n").as_bytes());
    }
    hasher.finalize().to_hex().to_string()
}

/// The total of these files.
pub fn total(files: &[FileEntry]) -> Total {
    Total {
        list: list_hash(
            files
                .iter()
                .map(|f| (f.path.as_str(), f.bytes, f.blake3.as_str())),
        ),
        files: files.len() as u64,
        bytes: files.iter().map(|f| f.bytes).sum(),
    }
}

/// Whether a text is a valid path of a file below a session's folder, without leaving it: names
/// without control characters and backslashes, none of them `.` or `..`, `/` between them.
pub fn is_file_path(path: &str) -> bool {
    let name = |name: &str| {
        !["", ".", ".."].contains(&name) && !name.contains(|c: char| c.is_control() || c == '\\')
    };
    path.len() <= MAX_PATH
        && path.split('/').count() <= MAX_DEPTH + 1
        && path.split('/').all(name)
        && !DERIVED.contains(&path)
}

/// Whether a folder with this name may be a session: letters, digits, `-`, `_` and `.`, not
/// beginning with a dot, at most 100.
pub(crate) fn is_session_name(name: &str) -> bool {
    let plain = |b: u8| b.is_ascii_alphanumeric() || b"-_.".contains(&b);
    (1..=100).contains(&name.len()) && !name.starts_with('.') && name.bytes().all(plain)
}

/// Whether a text is a BLAKE3 hash as this contract writes it.
pub fn is_hash(text: &str) -> bool {
    let digit = |b: u8| b.is_ascii_digit() || (b'a'..=b'f').contains(&b);
    text.len() == 64 && text.bytes().all(digit)
}

/// A file's path as in an address: everything but letters, digits, `-_.~` and `/` as `%XX`.
pub(crate) fn to_address(path: &str) -> String {
    let mut out = String::with_capacity(path.len());
    for byte in path.bytes() {
        if byte.is_ascii_alphanumeric() || b"-_.~/".contains(&byte) {
            out.push(byte.into());
        } else {
            out.push_str(&format!("%{byte:02X}"));
        }
    }
    out
}

/// Decodes the path in an address, once; `None` if it is not UTF-8 or a `%` is not followed by two
/// hex digits.
pub(crate) fn from_address(text: &str) -> Option<String> {
    let mut out = Vec::with_capacity(text.len());
    let mut bytes = text.bytes();
    while let Some(byte) = bytes.next() {
        if byte == b'%' {
            let mut digit = || char::from(bytes.next()?).to_digit(16);
            let (high, low) = (digit()?, digit()?);
            out.push((high * 16 + low) as u8);
        } else {
            out.push(byte);
        }
    }
    String::from_utf8(out).ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn list_hash_matches_the_specification() {
        let a = "a".repeat(64);
        let b = "b".repeat(64);
        let text = format!("rig/x\0{}\0{b}\nsession.json\0{}\0{a}\n", 7, 12);
        let expected = blake3::hash(text.as_bytes()).to_hex().to_string();
        for order in [[0, 1], [1, 0]] {
            let files = [("session.json", 12, a.as_str()), ("rig/x", 7, b.as_str())];
            assert_eq!(list_hash(order.map(|i| files[i])), expected);
        }
        assert_ne!(list_hash([("rig/x", 7, b.as_str())]), expected);
    }

    #[test]
    fn file_paths_are_confined_to_the_folder() {
        for good in ["session.json", "segments/000000.mcap", "rig/a b\u{e4}.yaml"] {
            assert!(is_file_path(good), "{good}");
        }
        for bad in [
            "",
            "/",
            "/etc/passwd",
            "..",
            "../x",
            "rig/../x",
            "rig//x",
            "rig/",
            "./x",
            "a\\b",
            "a\0b",
            "a\nb",
            "index.bin",
            "import.json",
            "1/2/3/4/5/6/7/8/9/10",
        ] {
            assert!(!is_file_path(bad), "{bad:?}");
        }
        assert!(!is_file_path(&"x".repeat(MAX_PATH + 1)));
    }

    #[test]
    fn paths_are_decoded_once_and_only_if_valid() {
        for text in ["rig/a b%2f\u{e4}.yaml", "", "100%"] {
            assert_eq!(from_address(&to_address(text)).as_deref(), Some(text));
        }
        assert_eq!(from_address("%252e").as_deref(), Some("%2e"));
        for bad in ["%", "%2", "%zz", "%ff", "%c0%ae", "%+1"] {
            assert_eq!(from_address(bad), None, "{bad}");
        }
    }

    #[test]
    fn codes_of_a_later_version_are_unknown() {
        let body: ErrorBody =
            serde_json::from_str(r#"{"error":{"code":"new_kind","message":"m"}}"#).unwrap();
        assert_eq!(body.error.code, Code::Unknown);
    }
}
