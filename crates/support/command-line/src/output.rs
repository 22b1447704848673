//! Results, messages and the end of a program.
//!
//! Contract: results go to standard output, everything else to standard error. Nobody has to
//! listen: a reader that closes the pipe ends a program that only prints with 0, as its output is
//! complete; a message that cannot be printed is left out. Any other failure to write a result is
//! an error.

use std::fmt::Display;
use std::io::{self, Write};
use std::process::ExitCode;

/// Prints a message to standard error as `eprintln!` does, and goes on if nobody reads it. What
/// others named does not act on the terminal: see [`harmless`].
#[macro_export]
macro_rules! complain {
    ($($text:tt)*) => {{
        use std::io::Write as _;
        let text = $crate::output::harmless(&std::format!($($text)*));
        let _ = std::writeln!(std::io::stderr(), "{text}");
    }};
}

/// A text in which control characters, separators of lines and paragraphs and marks that change the
/// direction of writing are spelled, as `\u001b`. Line breaks and tabs stay. (Recorded names are
/// shown by the same rule, which `session_archive::text` states; this crate knows nothing of
/// sessions. That both agree is tested by pawsd.)
pub fn harmless(text: &str) -> String {
    let mut shown = String::with_capacity(text.len());
    for c in text.chars() {
        if is_hidden(c) && !matches!(c, '\n' | '\t') {
            shown.push_str(&format!("\\u{:04x}", u32::from(c)));
        } else {
            shown.push(c);
        }
    }
    shown
}

/// Whether a character acts on a terminal, or on the order of the text around it, instead of being
/// visible: control characters, separators of lines and paragraphs, marks of the direction of
/// writing, the byte order mark.
pub fn is_hidden(c: char) -> bool {
    c.is_control()
        || matches!(c, '\u{61c}' | '\u{200e}' | '\u{200f}' | '\u{2028}'..='\u{202e}' | '\u{2066}'..='\u{2069}' | '\u{feff}')
}

/// Prints one line of results immediately.
///
/// # Errors
/// What the system says; of kind `BrokenPipe` if the reader has closed the pipe.
pub fn print(line: impl Display) -> io::Result<()> {
    let mut out = io::stdout().lock();
    writeln!(out, "{line}").and_then(|()| out.flush())
}

/// Whether `-q` was given, or something else lets the logger pass on only what failed: then
/// progress is not shown either.
pub fn is_quiet() -> bool {
    log::max_level() < log::LevelFilter::Warn
}

/// Whether an error only says that the reader of the output has closed the pipe.
pub fn is_broken_pipe(error: &anyhow::Error) -> bool {
    error.chain().any(|cause| {
        let cause = cause.downcast_ref::<io::Error>();
        cause.is_some_and(|e| e.kind() == io::ErrorKind::BrokenPipe)
    })
}

/// The exit code of a program that has come to its end: the one that it found, 0 if its reader
/// closed the pipe, and 1 for an error, which is printed.
pub fn finish(result: anyhow::Result<ExitCode>) -> ExitCode {
    match result {
        Ok(code) => code,
        Err(error) if is_broken_pipe(&error) => ExitCode::SUCCESS,
        Err(error) => {
            complain!("error: {error:#}");
            ExitCode::FAILURE
        }
    }
}

#[cfg(test)]
mod tests {
    use anyhow::Context as _;

    use super::*;

    #[test]
    fn a_message_does_not_act_on_the_terminal() {
        let text = harmless("walk\u{1b}[2J\n\tname \u{202e}txt\u{7f} é\u{61c}");
        assert_eq!(text, "walk\\u001b[2J\n\tname \\u202etxt\\u007f é\\u061c");
    }

    #[test]
    fn only_a_closed_pipe_is_no_failure() {
        let failed = |kind: io::ErrorKind| {
            let result: io::Result<()> = Err(kind.into());
            result.context("writing").expect_err("it failed")
        };
        assert!(is_broken_pipe(&failed(io::ErrorKind::BrokenPipe)));
        assert!(!is_broken_pipe(&failed(io::ErrorKind::StorageFull)));
    }
}
