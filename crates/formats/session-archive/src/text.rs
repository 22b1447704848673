//! Text that people and devices give, and that is shown on a screen.
//!
//! Names of sessions, marks, sources, reasons of a stop: all of it is recorded as it was given and
//! read back years later by programs on other machines. Two rules keep it from doing more than
//! being read:
//!
//! * *Where it comes in* a name or a mark passes [`check_note`]: one line of at most [`MAX_NOTE`]
//!   bytes, the same on the page, on the control socket, on the command line and in the
//!   configuration.
//! * *Where it is printed* [`shown`] writes every [hidden](is_hidden) character as `\u001b`, which
//!   is also how JSON writes it. Sessions recorded by others, or before this rule, open as they are
//!   and are harmless to look at.

use std::borrow::Cow;
use std::fmt::Write as _;
use std::io;

/// Longest name of a session and longest mark, bytes of UTF-8.
pub const MAX_NOTE: usize = 200;

/// Why a text is no name and no mark.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum NoteError {
    /// Shorten the text.
    #[error("a name or a mark of {found} bytes, expected at most {MAX_NOTE}")]
    TooLong {
        /// Bytes found.
        found: usize,
    },
    /// Leave the character out.
    #[error(
        "a name or a mark with the character U+{:04X} at position {position}, expected one line \
         without control characters",
        u32::from(*.found)
    )]
    Hidden {
        /// The first such character.
        found: char,
        /// Its position, counted in characters from 1.
        position: usize,
    },
}

/// Whether a character acts on a terminal, or on the order of the text around it, instead of being
/// seen: the control characters C0, DEL and C1, the separators of lines and paragraphs, the marks
/// that change the direction of writing (Unicode Standard Annex 9, section 2), and the byte order
/// mark.
pub fn is_hidden(c: char) -> bool {
    c.is_control()
        || matches!(c, '\u{61c}' | '\u{200e}' | '\u{200f}' | '\u{feff}')
        || matches!(c, '\u{2028}'..='\u{202e}' | '\u{2066}'..='\u{2069}')
}

/// Whether none of a text is [hidden](is_hidden): it is one line that shows what it is.
pub fn is_plain(text: &str) -> bool {
    !text.contains(is_hidden)
}

/// Checks the name of a session or a mark, which may be empty.
///
/// # Errors
/// See [`NoteError`].
///
/// ```
/// use session_archive::text::{NoteError, check_note};
///
/// assert_eq!(check_note("stairs, second floor"), Ok(()));
/// assert_eq!(check_note("clear\u{1b}[2J"), Err(NoteError::Hidden { found: '\u{1b}', position: 6 }));
/// assert_eq!(
///     check_note(&"x".repeat(300)).unwrap_err().to_string(),
///     "a name or a mark of 300 bytes, expected at most 200"
/// );
/// ```
pub fn check_note(text: &str) -> Result<(), NoteError> {
    if text.len() > MAX_NOTE {
        return Err(NoteError::TooLong { found: text.len() });
    }
    match text.chars().enumerate().find(|(_, c)| is_hidden(*c)) {
        None => Ok(()),
        Some((i, found)) => Err(NoteError::Hidden {
            found,
            position: i + 1,
        }),
    }
}

/// A text as one line for a screen: what is [hidden](is_hidden), line breaks included, as `\u000a`.
///
/// ```
/// use session_archive::text::{shown, shown_lines};
///
/// assert_eq!(shown("one\ntwo\u{1b}[2J"), "one\\u000atwo\\u001b[2J");
/// assert_eq!(shown_lines("one\ntwo\u{1b}[2J"), "one\ntwo\\u001b[2J");
/// ```
pub fn shown(text: &str) -> Cow<'_, str> {
    escaped(text, is_hidden)
}

/// The same for a text of several lines: line breaks and tabs are kept.
pub fn shown_lines(text: &str) -> Cow<'_, str> {
    escaped(text, |c| is_hidden(c) && c != '\n' && c != '\t')
}

fn escaped(text: &str, hide: impl Fn(char) -> bool) -> Cow<'_, str> {
    if !text.contains(&hide) {
        return Cow::Borrowed(text);
    }
    let mut out = String::with_capacity(text.len() + 16);
    for c in text.chars() {
        if hide(c) {
            // None of them is beyond U+FFFF.
            let _ = write!(out, "\\u{:04x}", u32::from(c));
        } else {
            out.push(c);
        }
    }
    Cow::Owned(out)
}

/// The name of a value of a protobuf enumeration as words: `CAUSE_ENCODER_OVERLOAD` with the prefix
/// `CAUSE_` as `encoder overload`.
pub fn enum_words(name: &str, prefix: &str) -> String {
    let name = name.strip_prefix(prefix).unwrap_or(name);
    name.to_lowercase().replace('_', " ")
}

/// Writes to a screen what it is given, as [`shown_lines`] does it. A piece is expected to end with
/// a whole character, as those of `write!` do; bytes that are no UTF-8 are written as `\u0080` to
/// `\u00ff`.
///
/// ```
/// use std::io::Write as _;
///
/// use session_archive::text::Screen;
///
/// let mut screen = Screen(Vec::new());
/// writeln!(screen, "name: {}", "stairs\u{202e}gnp.exe")?;
/// assert_eq!(screen.0, b"name: stairs\\u202egnp.exe\n");
/// # Ok::<(), std::io::Error>(())
/// ```
#[derive(Debug)]
pub struct Screen<W>(pub W);

impl<W: io::Write> io::Write for Screen<W> {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        for chunk in bytes.utf8_chunks() {
            self.0.write_all(shown_lines(chunk.valid()).as_bytes())?;
            for byte in chunk.invalid() {
                write!(self.0, "\\u{byte:04x}")?;
            }
        }
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        self.0.flush()
    }
}

#[cfg(test)]
mod tests {
    use std::io::Write as _;

    use super::*;

    /// Clear the screen; the same in one C1 character; a title; backwards; a line of its own.
    const HOSTILE: [&str; 8] = [
        "a\u{1b}[2Jb",
        "a\u{9b}2Jb",
        "a\u{1b}]0;pwned\u{7}b",
        "a\u{202e}gnp.exe",
        "a\u{2028}b",
        "a\u{7f}b",
        "a\nFAILED: no",
        "a\u{2066}b",
    ];

    #[test]
    fn hidden_characters_are_refused_and_seen_when_printed() {
        for text in HOSTILE {
            let Err(NoteError::Hidden { position: 2, .. }) = check_note(text) else {
                panic!("{text:?} was taken");
            };
            let seen = shown(text);
            assert!(is_plain(&seen), "{seen:?}");
            assert!(seen.starts_with("a\\u"), "{seen}");
        }
        assert_eq!(shown("a\u{1b}[2Jb"), "a\\u001b[2Jb");
        assert_eq!(shown("two\nlines"), "two\\u000alines");
        assert_eq!(shown_lines("two\n\tlines\r"), "two\n\tlines\\u000d");
        let text = "stairs \u{e4} \u{2191} \u{65e5}\u{672c} \u{1f6b6}\u{200d}\u{2642}\u{fe0f}";
        assert!(matches!(shown(text), Cow::Borrowed(_)));
        assert_eq!(check_note(text), Ok(()));
        let error = check_note("x\u{1b}").unwrap_err().to_string();
        assert!(error.contains("U+001B at position 2"), "{error}");
    }

    #[test]
    fn the_longest_note_is_counted_in_bytes() {
        assert_eq!(check_note(""), Ok(()));
        assert_eq!(check_note(&"x".repeat(MAX_NOTE)), Ok(()));
        assert_eq!(check_note(&"\u{e4}".repeat(MAX_NOTE / 2)), Ok(()));
        let long = "\u{e4}".repeat(MAX_NOTE / 2 + 1);
        let error = check_note(&long).unwrap_err();
        assert_eq!(error, NoteError::TooLong { found: 202 });
    }

    #[test]
    fn nothing_gets_through_a_screen_that_acts_on_it() {
        let mut screen = Screen(Vec::new());
        for text in HOSTILE {
            writeln!(screen, "name: {text}").unwrap();
        }
        screen.write_all(b"\x9b2J \xff\n").unwrap();
        let text = String::from_utf8(screen.0).unwrap();
        assert!(text.lines().all(is_plain), "{text:?}");
        assert!(text.ends_with("\\u009b2J \\u00ff\n"), "{text}");
        // Valid JSON is unchanged.
        let json = serde_json::to_string(&HOSTILE).unwrap();
        let mut screen = Screen(Vec::new());
        screen.write_all(json.as_bytes()).unwrap();
        let back: Vec<String> = serde_json::from_slice(&screen.0).unwrap();
        assert_eq!(back, HOSTILE);
    }
}
