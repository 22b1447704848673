//! The secret shared by phone, host and rig.
//!
//! It is compared in constant time, over hashes, so that neither length nor content leaks through
//! time. It is never printed and never logged.

use std::fmt;
use std::io;
use std::os::unix::fs::MetadataExt as _;
use std::path::{Path, PathBuf};

use subtle::ConstantTimeEq;

/// Minimum length, characters.
pub const MIN_LENGTH: usize = 16;
/// Maximum length, characters.
pub const MAX_LENGTH: usize = 256;
/// Maximum length of a token file, with surrounding white space, bytes.
const MAX_FILE: u64 = 4096;
/// Minimum number of different characters: `aaaaaaaaaaaaaaaa` is no secret.
const MIN_DIFFERENT: usize = 6;

/// A secret of [`MIN_LENGTH`] to [`MAX_LENGTH`] visible ASCII characters.
#[derive(Clone)]
pub struct Token(String);

/// A text is not a valid token. The error does not contain the text.
#[derive(Debug, thiserror::Error)]
pub enum TokenError {
    /// Create a longer one, as with `openssl rand -hex 16`.
    #[error(
        "the token has {found} characters, expected {MIN_LENGTH} to {MAX_LENGTH} (`openssl rand -hex 16` creates one)"
    )]
    Length {
        /// Characters found.
        found: usize,
    },
    /// It holds a space, a control character or a letter outside ASCII.
    #[error("the token has a character at position {position} that is not visible ASCII")]
    Character {
        /// Position, from 1.
        position: usize,
    },
    /// Create a better one, as with `openssl rand -hex 16`.
    #[error(
        "the token is made of {found} different characters, expected at least {MIN_DIFFERENT} (`openssl rand -hex 16` creates one)"
    )]
    Simple {
        /// Different characters found.
        found: usize,
    },
    /// Others on this machine can read it: remove their permission.
    #[error(
        "the token can be read by others than its owner: mode {found:04o}, expected 0600; fix it with chmod 600 {}",
        .path.display()
    )]
    Open {
        /// Mode found.
        found: u32,
        /// The file.
        path: PathBuf,
    },
    /// The file cannot be read.
    #[error("reading the token: {}", .path.display())]
    Io {
        /// What failed.
        #[source]
        source: io::Error,
        /// The file.
        path: PathBuf,
    },
}

impl Token {
    /// Parses a token; surrounding line breaks and spaces are ignored.
    ///
    /// # Errors
    /// See [`TokenError`].
    pub fn new(text: &str) -> Result<Self, TokenError> {
        let text = text.trim();
        if let Some(at) = text.chars().position(|c| !c.is_ascii_graphic()) {
            return Err(TokenError::Character { position: at + 1 });
        }
        if !(MIN_LENGTH..=MAX_LENGTH).contains(&text.len()) {
            return Err(TokenError::Length { found: text.len() });
        }
        let mut different: Vec<u8> = text.bytes().collect();
        different.sort_unstable();
        different.dedup();
        if different.len() < MIN_DIFFERENT {
            return Err(TokenError::Simple {
                found: different.len(),
            });
        }
        Ok(Self(text.to_owned()))
    }

    /// Reads a token from a regular file that only its owner may read. A FIFO, a device or a socket
    /// in its place is rejected immediately.
    ///
    /// # Errors
    /// See [`TokenError`].
    pub fn read(path: &Path) -> Result<Self, TokenError> {
        let failed = |source| TokenError::Io {
            source,
            path: path.to_owned(),
        };
        let file = plain_file::open(path).map_err(failed)?;
        let mode = file.metadata().map_err(failed)?.mode() & 0o7777;
        if mode & 0o077 != 0 {
            return Err(TokenError::Open {
                found: mode,
                path: path.to_owned(),
            });
        }
        let bytes = plain_file::read_file(&file, MAX_FILE).map_err(failed)?;
        Self::new(&plain_file::text(bytes).map_err(failed)?)
    }

    /// Whether `given` is this token.
    pub fn is(&self, given: &[u8]) -> bool {
        let hash = |bytes: &[u8]| *blake3::hash(bytes).as_bytes();
        hash(self.0.as_bytes()).ct_eq(&hash(given)).into()
    }

    /// The key of the page's cookies: derived from the token, so that they are valid as long as it
    /// is, and the token cannot be recovered from it.
    pub(crate) fn cookie_key(&self) -> [u8; 32] {
        blake3::derive_key("rig link v1, cookies of the page", self.0.as_bytes())
    }

    /// The secret itself, to be sent over an authenticated connection.
    pub(crate) fn secret(&self) -> &str {
        &self.0
    }
}

impl fmt::Debug for Token {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("Token(not shown)")
    }
}

#[cfg(test)]
mod tests {
    use std::fs;
    use std::os::unix::fs::PermissionsExt as _;

    use super::*;

    #[test]
    fn tokens_are_long_visible_and_not_printed() {
        let good = "0123456789abcdef";
        let token = Token::new(&format!(" {good}\n")).unwrap();
        assert!(token.is(good.as_bytes()));
        for wrong in [
            "",
            "0123456789abcde",
            "0123456789abcdeF",
            "0123456789abcdef\n",
        ] {
            assert!(!token.is(wrong.as_bytes()), "{wrong:?}");
        }
        assert!(!format!("{token:?}").contains("0123"));
        for (bad, part) in [
            ("short", "5 characters"),
            ("", "0 characters"),
            ("0123456789 abcdef", "position 11"),
            ("0123456789abcde\u{e9}", "position 16"),
            ("abababababababababab", "2 different"),
            (&"0123456789abcdef".repeat(17), "272 characters"),
        ] {
            let error = Token::new(bad).unwrap_err().to_string();
            assert!(error.contains(part), "{error}");
        }
    }

    #[test]
    fn token_file_readable_by_others_is_rejected() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("token");
        fs::write(&path, "0123456789abcdef\n").unwrap();
        for mode in [0o644, 0o640, 0o604, 0o620, 0o601] {
            fs::set_permissions(&path, fs::Permissions::from_mode(mode)).unwrap();
            let error = Token::read(&path).unwrap_err().to_string();
            let found = format!("mode {mode:04o}, expected 0600");
            assert!(error.contains(&found), "{error}");
            let mend = format!("chmod 600 {}", path.display());
            assert!(error.ends_with(&mend), "{error}");
        }
        for mode in [0o600, 0o400] {
            fs::set_permissions(&path, fs::Permissions::from_mode(mode)).unwrap();
            assert!(Token::read(&path).is_ok(), "{mode:o}");
        }
        fs::write(&path, "0123456789abcdef".repeat(10_000)).unwrap();
        let error = Token::read(&path).unwrap_err();
        assert!(matches!(error, TokenError::Io { .. }), "{error}");
    }
}
