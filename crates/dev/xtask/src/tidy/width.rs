//! Comment lines that are too wide. rustfmt wraps comments on nightly only, so they are counted
//! here.

use super::facts::shown_line;
use super::files::File;
use super::place::Place;
use super::source::{Comment, Style};

/// A comment line has at most this many characters, with its indent.
pub(crate) const MAX_COMMENT_COLUMNS: usize = 100;

/// Lines of a file that hold only a line comment, `//` of any kind, and are too wide. Rows of
/// tables and lines with an address cannot be wrapped and do not count; a comment behind code does
/// not either.
pub(crate) fn wide_comments(file: &File, comments: &[Comment<'_>]) -> Vec<Place> {
    let lines: Vec<&str> = file.text.lines().collect();
    let line_comments = comments.iter().filter(|c| c.style != Style::Block);
    let wide = line_comments.filter_map(|comment| {
        let line = lines.get(comment.line.checked_sub(1)?)?;
        let columns = line.chars().count();
        let is_alone = line.trim_start().starts_with("//");
        let cannot_wrap =
            comment.text.contains("://") || comment.text.trim_start().starts_with('|');
        (is_alone && columns > MAX_COMMENT_COLUMNS && !cannot_wrap).then(|| {
            let text = format!("comment of {columns} columns: {}", shown_line(line));
            Place::new(&file.path, comment.line, text)
        })
    });
    wide.collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::tidy::source::lex;

    fn columns(text: &str) -> Vec<(usize, String)> {
        let file = File {
            path: "calib/src/a.rs".into(),
            text: text.into(),
        };
        let places = wide_comments(&file, &lex(&file.text).comments).into_iter();
        places
            .map(|place| {
                let (before, _) = place.text.split_once(':').expect("a colon");
                (place.line, before.to_owned())
            })
            .collect()
    }

    #[test]
    fn more_than_a_hundred_characters_with_the_indent_are_wide() {
        for marker in ["//", "///", "//!"] {
            let line = |width: usize| {
                let begin = format!("    {marker} ");
                let rest = "é".repeat(width - begin.len());
                format!("x\n{begin}{rest}\n")
            };
            assert_eq!(columns(&line(100)), [], "{marker}");
            let expected = (2, "comment of 101 columns".to_owned());
            assert_eq!(columns(&line(101)), [expected], "{marker}");
        }
    }

    #[test]
    fn tables_addresses_code_strings_and_blocks_are_not_counted() {
        let wide = "wide ".repeat(20);
        for text in [
            format!("/// | {wide} |"),
            format!("// https://example.org/ {wide}"),
            format!("let a = 1; // {wide}"),
            format!("let a = \"\n// {wide}\";"),
            format!("/* {wide} */"),
        ] {
            assert_eq!(columns(&text), [], "{text}");
        }
    }
}
