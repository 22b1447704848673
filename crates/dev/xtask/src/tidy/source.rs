//! A small lexer for Rust: code, comments and literals, each with its line.
//!
//! It knows as much of the language as the checks need: where comments and literals begin and end,
//! and which names and marks the code between them consists of. It never fails. Text that is no
//! valid Rust yields tokens all the same; a literal or comment without an end reaches to the end of
//! the file. Comments of `.proto` files have the same form, so the same lexer reads them.

/// The tokens of one file, in the order of the text.
#[derive(Debug, Default)]
pub(crate) struct Source<'a> {
    /// Names, numbers, marks and literals.
    pub(crate) code: Vec<Token<'a>>,
    pub(crate) comments: Vec<Comment<'a>>,
}

/// One token of code.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Token<'a> {
    pub(crate) kind: Kind,
    /// The token; for literals what is between the quotes, as it is written, with its escapes. For
    /// raw names without `r#`.
    pub(crate) text: &'a str,
    /// Line of its first character, counted from 1.
    pub(crate) line: usize,
}

/// What a token is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Kind {
    /// A name or a keyword.
    Name,
    /// A raw name, `r#type`: never a keyword.
    RawName,
    Lifetime,
    Number,
    /// `::`, or one character of any other punctuation.
    Mark,
    /// A character or byte, `'a'`, `b'a'`.
    Character,
    /// A string of any kind.
    Text {
        /// Whether a backslash stands for itself.
        raw: bool,
    },
}

/// One comment.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Comment<'a> {
    pub(crate) style: Style,
    /// What is behind the marker, up to the end of the line or the closing marker.
    pub(crate) text: &'a str,
    /// Line of its first character, counted from 1.
    pub(crate) line: usize,
}

/// How a comment is marked.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Style {
    /// `//`
    Plain,
    /// `///`
    Outer,
    /// `//!`
    Inner,
    /// `/* */`, documentation or not.
    Block,
}

impl Token<'_> {
    /// Whether it is this keyword, or this name that is not raw.
    pub(crate) fn is_word(&self, word: &str) -> bool {
        self.kind == Kind::Name && self.text == word
    }

    /// Whether it is this punctuation.
    pub(crate) fn is_mark(&self, mark: &str) -> bool {
        self.kind == Kind::Mark && self.text == mark
    }

    /// Whether it is a name, raw or not, or a keyword.
    pub(crate) fn is_name(&self) -> bool {
        matches!(self.kind, Kind::Name | Kind::RawName)
    }
}

/// Splits a file.
pub(crate) fn lex(text: &str) -> Source<'_> {
    let mut lexer = Lexer {
        text,
        at: 0,
        line: 1,
        source: Source::default(),
    };
    if text.starts_with("#!") && !text.starts_with("#![") {
        lexer.at = text.find('\n').unwrap_or(text.len());
    }
    while lexer.step() {}
    lexer.source
}

struct Lexer<'a> {
    text: &'a str,
    /// Offset of the next character.
    at: usize,
    line: usize,
    source: Source<'a>,
}

impl<'a> Lexer<'a> {
    /// Takes one token, comment or blank; `false` at the end.
    fn step(&mut self) -> bool {
        let rest = &self.text[self.at..];
        let Some(first) = rest.chars().next() else {
            return false;
        };
        if first.is_whitespace() {
            self.advance(first.len_utf8());
        } else if rest.starts_with("//") {
            self.line_comment(rest);
        } else if rest.starts_with("/*") {
            self.block_comment(rest);
        } else if let Some((prefix, raw)) = string_prefix(rest) {
            self.string(rest, prefix, raw);
        } else if rest.starts_with("b'") {
            self.character(rest, 2);
        } else if first == '\'' {
            self.quote(rest);
        } else if rest.starts_with("r#") && rest[2..].starts_with(begins_name) {
            let end = 2 + name_length(&rest[2..]);
            self.token(Kind::RawName, &rest[2..end], end);
        } else if begins_name(first) {
            let end = name_length(rest);
            self.token(Kind::Name, &rest[..end], end);
        } else if first.is_ascii_digit() {
            let end = number_length(rest);
            self.token(Kind::Number, &rest[..end], end);
        } else {
            let end = if rest.starts_with("::") {
                2
            } else {
                first.len_utf8()
            };
            self.token(Kind::Mark, &rest[..end], end);
        }
        true
    }

    fn line_comment(&mut self, rest: &'a str) {
        let end = rest.find('\n').unwrap_or(rest.len());
        let (style, marker) = if rest.starts_with("///") && !rest.starts_with("////") {
            (Style::Outer, 3)
        } else if rest.starts_with("//!") {
            (Style::Inner, 3)
        } else {
            (Style::Plain, 2)
        };
        self.comment(style, rest[marker..end].trim_end_matches('\r'), end);
    }

    fn block_comment(&mut self, rest: &'a str) {
        let mut depth = 0;
        let mut at = 0;
        let bytes = rest.as_bytes();
        let (end, inner) = loop {
            match bytes.get(at..at + 2) {
                Some(b"/*") => {
                    depth += 1;
                    at += 2;
                }
                Some(b"*/") => {
                    depth -= 1;
                    at += 2;
                    if depth == 0 {
                        break (at, at - 2);
                    }
                }
                Some(_) => at += 1,
                None => break (rest.len(), rest.len()),
            }
        };
        let inner = rest.get(2..inner).unwrap_or_default();
        self.comment(Style::Block, inner, end);
    }

    /// A string whose opening quote is behind `prefix` bytes; raw strings have `#` on both sides.
    fn string(&mut self, rest: &'a str, prefix: usize, raw: bool) {
        let hashes = rest[prefix..].bytes().take_while(|b| *b == b'#').count();
        let begin = prefix + hashes + 1;
        let bytes = rest.as_bytes();
        let mut at = begin;
        let (inner, end) = loop {
            match bytes.get(at) {
                None => break (rest.len(), rest.len()),
                Some(b'\\') if !raw => at = (at + 2).min(rest.len()),
                Some(b'"')
                    if rest[at + 1..]
                        .bytes()
                        .take(hashes)
                        .eq((0..hashes).map(|_| b'#')) =>
                {
                    break (at, at + 1 + hashes);
                }
                Some(_) => at += 1,
            }
        };
        // An escaped character of several bytes at the very end of an unfinished string.
        let content = rest.get(begin..inner).unwrap_or_default();
        self.token(Kind::Text { raw }, content, end);
    }

    /// A character literal or a lifetime.
    fn quote(&mut self, rest: &'a str) {
        let mut after = rest[1..].chars();
        let (first, second) = (after.next(), after.next());
        let lifetime = first.is_some_and(begins_name) && second != Some('\'');
        if lifetime {
            let end = 1 + name_length(&rest[1..]);
            self.token(Kind::Lifetime, &rest[1..end], end);
        } else {
            self.character(rest, 1);
        }
    }

    /// A character literal whose content begins after `begin` bytes. It does not reach over its
    /// line.
    fn character(&mut self, rest: &'a str, begin: usize) {
        let mut escaped = false;
        let mut end = None;
        for (at, c) in rest[begin..].char_indices() {
            match c {
                _ if escaped => escaped = false,
                '\\' => escaped = true,
                '\'' if at > 0 => {
                    end = Some(begin + at);
                    break;
                }
                '\n' => break,
                _ => {}
            }
        }
        match end {
            Some(end) => self.token(Kind::Character, &rest[begin..end], end + 1),
            None => self.token(Kind::Mark, &rest[..begin], begin),
        }
    }

    fn token(&mut self, kind: Kind, text: &'a str, length: usize) {
        let line = self.line;
        self.source.code.push(Token { kind, text, line });
        self.advance(length);
    }

    fn comment(&mut self, style: Style, text: &'a str, length: usize) {
        let line = self.line;
        self.source.comments.push(Comment { style, text, line });
        self.advance(length);
    }

    fn advance(&mut self, length: usize) {
        let taken = &self.text.as_bytes()[self.at..self.at + length];
        self.line += taken.iter().filter(|byte| **byte == b'\n').count();
        self.at += length;
    }
}

/// Bytes before the `#` or quote of a string that begins here, and whether it is raw.
fn string_prefix(rest: &str) -> Option<(usize, bool)> {
    for (prefix, raw) in [
        ("", false),
        ("b", false),
        ("c", false),
        ("r", true),
        ("br", true),
        ("cr", true),
    ] {
        if let Some(behind) = rest.strip_prefix(prefix) {
            let quote = if raw {
                behind.trim_start_matches('#')
            } else {
                behind
            };
            if quote.starts_with('"') {
                return Some((prefix.len(), raw));
            }
        }
    }
    None
}

fn begins_name(c: char) -> bool {
    c == '_' || c.is_alphabetic()
}

fn name_length(rest: &str) -> usize {
    rest.find(|c: char| c != '_' && !c.is_alphanumeric())
        .unwrap_or(rest.len())
}

/// `1`, `0xff_u8`, `1.5e-3`; the range `1..2` is two numbers and the call `1.max(2)` one and a
/// name.
fn number_length(rest: &str) -> usize {
    let mut end = name_length(rest);
    let digit = |at: usize| rest.as_bytes().get(at).is_some_and(u8::is_ascii_digit);
    if rest[end..].starts_with('.') && digit(end + 1) {
        end += 1 + name_length(&rest[end + 1..]);
    }
    let exponent = rest[..end].ends_with(['e', 'E']) && !rest.starts_with("0x");
    if exponent && rest[end..].starts_with(['+', '-']) && digit(end + 1) {
        end += 1 + name_length(&rest[end + 1..]);
    }
    end
}

#[cfg(test)]
mod tests;
