//! The words of a text in Markdown, as comments, pages and messages are.
//!
//! Not words: code in spans and in fenced blocks, addresses, targets of links, HTML tags, and the
//! placeholders of format strings. A number is no word either, but stands between two.

/// A word or a number.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Word<'a> {
    /// Letters, digits and `_`; what follows an apostrophe is left out.
    pub(crate) text: &'a str,
    /// Counted from the first line of the text, which is 0.
    pub(crate) line: usize,
    /// Whether nothing but blanks of the same paragraph stands between it and the word before.
    pub(crate) follows: bool,
}

impl Word<'_> {
    /// Whether it is a word and no number.
    pub(crate) fn has_letter(&self) -> bool {
        self.text.contains(char::is_alphabetic)
    }
}

/// The words of a text, in order.
pub(crate) fn words(text: &str) -> Vec<Word<'_>> {
    let mut words = Vec::new();
    let mut fence: Option<&str> = None;
    let mut paragraph = Paragraph::default();
    let mut at = 0;
    for (line, content) in text.split_inclusive('\n').enumerate() {
        let end = at + content.len();
        let trimmed = content.trim_start_matches([' ', '\t', '>']).trim_end();
        let opens = fence_marker(trimmed);
        let closes = |open: &str| opens.is_some_and(|marker| marker.starts_with(open));
        let is_text = match fence {
            Some(open) => {
                // A closing fence has nothing behind its marker.
                if closes(open) && opens == Some(trimmed) {
                    fence = None;
                }
                false
            }
            None if opens.is_some() => {
                fence = opens;
                false
            }
            None => !trimmed.is_empty() && !is_link_definition(trimmed),
        };
        if is_text {
            paragraph.add(line, at..end);
        } else {
            paragraph.finish(text, &mut words);
        }
        at = end;
    }
    paragraph.finish(text, &mut words);
    words
}

/// Lines that follow each other without an empty one.
#[derive(Default)]
struct Paragraph {
    first_line: usize,
    range: std::ops::Range<usize>,
}

impl Paragraph {
    fn add(&mut self, line: usize, range: std::ops::Range<usize>) {
        if self.range.is_empty() {
            self.first_line = line;
            self.range = range;
        } else {
            self.range.end = range.end;
        }
    }

    fn finish<'a>(&mut self, text: &'a str, words: &mut Vec<Word<'a>>) {
        let range = std::mem::take(&mut self.range);
        if range.is_empty() {
            return;
        }
        let text = &text[range];
        let mut line = self.first_line;
        let mut at = 0;
        let mut follows = false;
        while at < text.len() {
            let rest = &text[at..];
            let word = word_length(rest);
            let length = if word > 0 && !rest[word..].starts_with("://") {
                let text = &rest[..word];
                words.push(Word {
                    text,
                    line,
                    follows,
                });
                follows = true;
                word + possessive(&rest[word..])
            } else {
                let skipped = skipped(rest, text[..at].chars().next_back());
                follows &= rest[..skipped].trim().is_empty();
                skipped
            };
            line += rest[..length].matches('\n').count();
            at += length;
        }
    }
}

/// Length of the word that begins here; 0 where none does.
fn word_length(rest: &str) -> usize {
    rest.find(|c: char| c != '_' && !c.is_alphanumeric())
        .unwrap_or(rest.len())
}

/// Length of an apostrophe and the letters behind it.
fn possessive(rest: &str) -> usize {
    let Some(apostrophe) = rest.chars().next().filter(|c| matches!(c, '\'' | '’')) else {
        return 0;
    };
    match word_length(&rest[apostrophe.len_utf8()..]) {
        0 => 0,
        letters => apostrophe.len_utf8() + letters,
    }
}

/// Length of what begins here and is no word: at least one character.
fn skipped(rest: &str, before: Option<char>) -> usize {
    let first = rest.chars().next().map_or(1, char::len_utf8);
    if rest.starts_with('`') {
        return code_span(rest);
    }
    if let Some(behind) = rest.strip_prefix('\\') {
        let escaped = behind.chars().next().filter(char::is_ascii_punctuation);
        return 1 + escaped.map_or(0, char::len_utf8);
    }
    if before == Some(']') && rest.starts_with('(') {
        return balanced(rest, '(', ')').unwrap_or(first);
    }
    if before == Some(']') && rest.starts_with('[') {
        return balanced(rest, '[', ']').unwrap_or(first);
    }
    if rest.starts_with('<') {
        return tag(rest).unwrap_or(first);
    }
    if rest.starts_with('{') {
        return placeholder(rest).unwrap_or(first);
    }
    let scheme = word_length(rest);
    if scheme > 0 {
        // An address: to the next blank or bracket.
        let end = |c: char| c.is_whitespace() || ")>]\"'`".contains(c);
        return rest.find(end).unwrap_or(rest.len());
    }
    first
}

/// Length of the code span that begins here, or of its backticks where none of the same number
/// follows.
fn code_span(rest: &str) -> usize {
    let ticks = |text: &str| text.bytes().take_while(|byte| *byte == b'`').count();
    let open = ticks(rest);
    let mut at = open;
    while let Some(next) = rest[at..].find('`') {
        at += next;
        let close = ticks(&rest[at..]);
        at += close;
        if close == open {
            return at;
        }
    }
    open
}

fn balanced(rest: &str, open: char, close: char) -> Option<usize> {
    let mut depth = 0;
    for (at, c) in rest.char_indices() {
        if c == open {
            depth += 1;
        } else if c == close {
            depth -= 1;
        }
        if depth == 0 {
            return Some(at + c.len_utf8());
        }
    }
    None
}

/// Length of an HTML tag or an address in angle brackets.
fn tag(rest: &str) -> Option<usize> {
    let inside = rest[1..].split('>').next()?;
    let name = inside.trim_start_matches(['/', '!']);
    let is_tag = name.starts_with(|c: char| c.is_ascii_alphabetic())
        && inside.len() + 1 < rest.len()
        && (!inside.contains(char::is_whitespace) || inside.contains("=\""));
    is_tag.then_some(inside.len() + 2)
}

/// Length of `{}`, `{name}`, `{name:.3}`.
fn placeholder(rest: &str) -> Option<usize> {
    let inside = rest[1..].split('}').next()?;
    let is_whole = inside.len() + 1 < rest.len();
    (is_whole && !inside.contains(char::is_whitespace)).then_some(inside.len() + 2)
}

/// The backticks or tildes of a fence, without what follows them.
fn fence_marker(line: &str) -> Option<&str> {
    for mark in ['`', '~'] {
        let length = line.len() - line.trim_start_matches(mark).len();
        // A span of code in three backticks on one line is no fence.
        if length >= 3 && !line[length..].contains('`') {
            return Some(&line[..length]);
        }
    }
    None
}

/// `[name]: target`
fn is_link_definition(line: &str) -> bool {
    let label = line
        .strip_prefix('[')
        .and_then(|rest| rest.split_once("]:"));
    label.is_some_and(|(label, _)| !label.contains(']'))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn plain(text: &str) -> Vec<&str> {
        words(text).into_iter().map(|word| word.text).collect()
    }

    #[test]
    fn words_are_letters_digits_and_underscores() {
        assert_eq!(
            plain("Off-line, a_b: 3 m"),
            ["Off", "line", "a_b", "3", "m"]
        );
        assert_eq!(
            plain("the rig's, doesn’t; it' x"),
            ["the", "rig", "doesn", "it", "x"]
        );
        let words = words("3 m");
        assert!(!words[0].has_letter() && words[1].has_letter());
    }

    #[test]
    fn code_addresses_and_targets_are_no_words() {
        for text in [
            "a `told` b",
            "a ``told ` told`` b",
            "a `told\ntold` b",
            "a https://x.org/told-felt b",
            "a <https://x.org/told> b",
            "[a](told/felt.md) b",
            "[a](told(felt).md) b",
            "[a][told] b",
            "a <img src=\"told.png\" alt=\"x\"> b",
            "a <told> b",
            "a {told:.3} b {} {told}",
            "a b\n\n[x]: https://told",
            "a\n\n```text\ntold\n\n`told\n```\nb",
            "a\n~~~\ntold\n```\ntold\n~~~\nb",
            "a\n````\n```\ntold\n````\nb",
            "> a\n> ```\n> told\n> ```\n> b",
        ] {
            assert_eq!(plain(text), ["a", "b"], "{text:?}");
        }
    }

    #[test]
    fn what_only_looks_like_code_is_text() {
        for text in [
            "a ` told b",
            "a `told\n\nb",
            "a < told b > c",
            "a { told b }",
            "a ]told b",
            "[a] (told) b",
            "a \\`told\\` b",
            "```a``` told b",
        ] {
            assert!(plain(text).contains(&"told"), "{text:?}");
        }
    }

    #[test]
    fn lines_are_counted_through_code() {
        let found = words("a `b\nc` d\n\n```\ne\n```\nf");
        let lines: Vec<_> = found.iter().map(|word| (word.text, word.line)).collect();
        assert_eq!(lines, [("a", 0), ("d", 1), ("f", 6)]);
    }

    #[test]
    fn words_follow_each_other_over_blanks_only() {
        for (text, follows) in [
            ("off by", true),
            ("off \n  by", true),
            ("off, by", false),
            ("off-by", false),
            ("off\n\nby", false),
            ("off `x` by", false),
            ("off's by", true),
        ] {
            assert_eq!(words(text)[1].follows, follows, "{text:?}");
        }
    }

    #[test]
    fn never_panics_on_odd_text() {
        for text in [
            "", "\\", "`", "](", "<", "{", "é’", "a://", "```", "[", "]:[", "\\é",
        ] {
            words(text);
        }
    }
}
