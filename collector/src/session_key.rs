//! Keys of sessions in a library: the names of their folders.

/// Maximum length of a key, bytes.
const MAX_KEY: usize = 100;
/// Suffix of a recovered copy's folder, after the session's identifier.
pub(crate) const RECOVERED: &str = ".recovered";
/// Key suffix of a replaced copy; followed by `-2` and so on if that exists.
pub(crate) const DAMAGED: &str = ".damaged";

/// Whether a session identifier is a safe folder name inside the library.
pub(crate) fn is_key(text: &str) -> bool {
    let plain = |b: u8| b.is_ascii_alphanumeric() || b"-_.".contains(&b);
    (1..=MAX_KEY).contains(&text.len()) && !text.starts_with('.') && text.bytes().all(plain)
}

/// A key with a suffix; a long key is truncated so that it remains valid.
pub(crate) fn aside_key(key: &str, suffix: &str) -> String {
    let room = MAX_KEY.saturating_sub(suffix.len());
    let begins = key.get(..room).unwrap_or(key);
    format!("{begins}{suffix}")
}

/// Whether the session `aside` is a replaced copy of `key`.
pub(crate) fn is_set_aside_copy(aside: &str, key: &str) -> bool {
    let is_of = |at: usize| aside_key(key, &aside[at..]) == aside;
    aside != key && aside.rfind(DAMAGED).is_some_and(is_of)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn identifiers_cannot_escape_the_library() {
        for good in ["0192aa00-0000-7000-8000-000000000001", "a", "x_1.recovered"] {
            assert!(is_key(good), "{good}");
        }
        for bad in [
            "",
            ".",
            "..",
            ".hidden",
            "a/b",
            "a\\b",
            "a b",
            "\u{e4}",
            &"x".repeat(101),
        ] {
            assert!(!is_key(bad), "{bad}");
        }
    }
}
