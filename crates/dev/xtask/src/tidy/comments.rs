//! Comments as texts: lines that belong together are one text, so that phrases and code may cross
//! lines.

use super::source::{Comment, Style};

/// A text out of one or more comments.
#[derive(Debug, PartialEq)]
pub(crate) struct Block {
    /// Line of the file on which the text begins, counted from 1.
    pub(crate) line: usize,
    pub(crate) text: String,
}

/// Joins comments of the same style on lines that follow each other, and takes the frame off
/// blocks.
pub(crate) fn blocks(comments: &[Comment<'_>]) -> Vec<Block> {
    let mut blocks: Vec<Block> = Vec::new();
    let mut before: Option<&Comment<'_>> = None;
    for comment in comments {
        let continues = before.is_some_and(|before| {
            before.style == comment.style
                && comment.style != Style::Block
                && before.line + 1 == comment.line
        });
        let text = match comment.style {
            Style::Block => without_frame(comment.text),
            Style::Plain | Style::Outer | Style::Inner => comment.text.to_owned(),
        };
        match blocks.last_mut().filter(|_| continues) {
            Some(block) => {
                block.text.push('\n');
                block.text.push_str(&text);
            }
            None => blocks.push(Block {
                line: comment.line,
                text,
            }),
        }
        before = Some(comment);
    }
    blocks
}

/// The text of a block comment without the `*` at the beginning of its lines.
fn without_frame(text: &str) -> String {
    let lines = text.split('\n').map(|line| {
        let trimmed = line.trim_start();
        trimmed.strip_prefix('*').unwrap_or(trimmed)
    });
    lines.collect::<Vec<_>>().join("\n")
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::tidy::source::lex;

    fn of(text: &str) -> Vec<(usize, String)> {
        let blocks = blocks(&lex(text).comments).into_iter();
        blocks.map(|block| (block.line, block.text)).collect()
    }

    #[test]
    fn lines_of_one_style_are_one_text() {
        assert_eq!(
            of("x\n/// a\n/// b\nfn f() {}\n// c\n\n// d\n//! e\n"),
            [
                (2, " a\n b".into()),
                (5, " c".into()),
                (7, " d".into()),
                (8, " e".into())
            ]
        );
    }

    #[test]
    fn a_block_loses_its_frame_and_keeps_its_lines() {
        assert_eq!(of("/** a\n * b\n   c\n */"), [(1, " a\n b\nc\n".into())]);
        assert_eq!(of("/* a */\n/* b */").len(), 2);
    }
}
