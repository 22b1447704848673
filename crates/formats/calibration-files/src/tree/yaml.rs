//! The subset of YAML that calibration files use: blocks of `key: value` and of `- item` by
//! indentation, lists and maps in brackets over any number of lines, quotes, comments, and tags
//! such as `!!opencv-matrix`, which are ignored. One document. Anchors, text blocks and scalars
//! over several lines are rejected with their line, so that a file is never half understood.
//!
//! OpenCV writes `%YAML:1.0` where YAML has `%YAML 1.0`; lines that begin with `%` are ignored.

use super::{MAX_DEPTH, Node, Value};
use crate::error::CalibError;
use crate::text::Source;

/// Reads a whole file.
pub(crate) fn parse(source: &Source) -> Result<Node, CalibError> {
    let mut parser = Parser {
        source,
        lines: lines(source)?,
        at: 0,
    };
    let Some(first) = parser.lines.first().copied() else {
        return Ok(Node {
            line: 1,
            value: Value::Map(Vec::new()),
        });
    };
    let node = parser.block(first.indent, 0)?;
    match parser.lines.get(parser.at) {
        None => Ok(node),
        Some(line) => Err(parser.wrong(line, "the indentation of one of the keys above")),
    }
}

/// A line without comment and blanks.
#[derive(Clone, Copy)]
struct Line<'s> {
    number: usize,
    indent: usize,
    text: &'s str,
}

fn lines(source: &Source) -> Result<Vec<Line<'_>>, CalibError> {
    let mut lines = Vec::new();
    let text = source.text.trim_start_matches('\u{feff}');
    for (number, raw) in (1..).zip(text.lines()) {
        let text = without_comment(raw).trim_end();
        let content = text.trim_start();
        if content.is_empty() || text.starts_with('%') {
            continue;
        }
        if text == "..." {
            break;
        }
        if text == "---" {
            if lines.is_empty() {
                continue;
            }
            return Err(source.malformed(number, text, "one document in the file"));
        }
        let indent = text.len() - content.len();
        if text[..indent].contains('\t') {
            return Err(source.malformed(number, raw, "indentation by spaces"));
        }
        lines.push(Line {
            number,
            indent,
            text: content,
        });
    }
    Ok(lines)
}

/// A comment starts with `#` at the beginning or after a blank, and not in quotes.
fn without_comment(line: &str) -> &str {
    let mut quote = None;
    let mut before = ' ';
    for (i, c) in line.char_indices() {
        match quote {
            Some(open) if c == open && before != '\\' => quote = None,
            Some(_) => {}
            None if c == '#' && before.is_whitespace() => return &line[..i],
            None if matches!(c, '"' | '\'') && matches!(before, ' ' | '[' | '{' | ',' | ':') => {
                quote = Some(c);
            }
            None => {}
        }
        before = c;
    }
    line
}

struct Parser<'s> {
    source: &'s Source,
    lines: Vec<Line<'s>>,
    at: usize,
}

impl<'s> Parser<'s> {
    fn wrong(&self, line: &Line<'_>, expected: &str) -> CalibError {
        let indented = format!("{}{}", " ".repeat(line.indent), line.text);
        self.source.malformed(line.number, &indented, expected)
    }

    /// The block whose first line is the current one.
    fn block(&mut self, indent: usize, depth: usize) -> Result<Node, CalibError> {
        let first = self.lines[self.at];
        if depth > MAX_DEPTH {
            return Err(self.wrong(
                &first,
                &format!("at most {MAX_DEPTH} blocks inside each other"),
            ));
        }
        let value = if is_item(first.text) {
            Value::List(self.sequence(indent, depth)?)
        } else {
            Value::Map(self.map(indent, depth)?)
        };
        Ok(Node {
            line: first.number,
            value,
        })
    }

    fn map(&mut self, indent: usize, depth: usize) -> Result<Vec<(String, Node)>, CalibError> {
        let mut entries: Vec<(String, Node)> = Vec::new();
        while let Some(&line) = self.lines.get(self.at) {
            if line.indent < indent || (line.indent == indent && is_item(line.text)) {
                break;
            }
            if line.indent > indent {
                return Err(self.wrong(&line, "the indentation of one of the keys above"));
            }
            let Some((key, rest)) = split_key(line.text) else {
                return Err(self.source.malformed(line.number, line.text, "key: value"));
            };
            let value = without_tag(rest);
            let node = if value.is_empty() {
                self.at += 1;
                self.below(line, depth)?
            } else {
                self.inline(line, value, depth)?
            };
            if entries.iter().any(|(other, _)| other == key) {
                return Err(self.source.malformed(line.number, key, "each key once"));
            }
            entries.push((key.to_owned(), node));
        }
        Ok(entries)
    }

    fn sequence(&mut self, indent: usize, depth: usize) -> Result<Vec<Node>, CalibError> {
        let mut items = Vec::new();
        while let Some(&line) = self.lines.get(self.at) {
            if line.indent < indent || (line.indent == indent && !is_item(line.text)) {
                break;
            }
            if line.indent > indent {
                return Err(self.wrong(&line, "the indentation of one of the items above"));
            }
            let rest = line.text[1..].trim_start();
            let value = without_tag(rest);
            items.push(if value.is_empty() {
                self.at += 1;
                self.below(line, depth)?
            } else if is_item(value) || (split_key(value).is_some() && !opens(value)) {
                // A block that begins after the dash: as if on a line of its own.
                let inner = indent + (line.text.len() - value.len());
                self.lines[self.at] = Line {
                    number: line.number,
                    indent: inner,
                    text: value,
                };
                self.block(inner, depth + 1)?
            } else {
                self.inline(line, value, depth)?
            });
        }
        Ok(items)
    }

    /// The value below a key or a dash without an inline value.
    fn below(&mut self, above: Line<'s>, depth: usize) -> Result<Node, CalibError> {
        match self.lines.get(self.at) {
            // A sequence may have the indentation of its key.
            Some(next)
                if next.indent > above.indent
                    || (next.indent == above.indent
                        && is_item(next.text)
                        && !is_item(above.text)) =>
            {
                let indent = next.indent;
                self.block(indent, depth + 1)
            }
            _ => Ok(Node {
                line: above.number,
                value: Value::Plain(String::new()),
            }),
        }
    }

    /// A value after its key or dash, which may continue over more lines if it is in brackets.
    fn inline(&mut self, line: Line<'s>, value: &'s str, depth: usize) -> Result<Node, CalibError> {
        if opens(value) {
            let mut flow = Flow {
                source: self.source,
                lines: &self.lines,
                at: self.at,
                rest: value,
            };
            let node = flow.value(depth + 1)?;
            if !flow.rest.trim().is_empty() {
                return Err(self.source.malformed(
                    flow.line(),
                    flow.rest.trim(),
                    "nothing behind the bracket",
                ));
            }
            self.at = flow.at + 1;
            return Ok(node);
        }
        if value.starts_with(['&', '*', '|', '>']) {
            return Err(self.source.malformed(
                line.number,
                value,
                "a word, a number or brackets (anchors and text blocks are not read)",
            ));
        }
        self.at += 1;
        Ok(Node {
            line: line.number,
            value: self.scalar(&line, value)?,
        })
    }
}

impl Parser<'_> {
    fn scalar(&self, line: &Line<'_>, text: &str) -> Result<Value, CalibError> {
        for quote in ['"', '\''] {
            let Some(inside) = text.strip_prefix(quote) else {
                continue;
            };
            return match closing_quote(inside, quote as u8) {
                Some(end) if end + 1 == inside.len() => {
                    Ok(Value::Quoted(unescaped(&inside[..end], quote as u8)))
                }
                _ => Err(self.source.malformed(
                    line.number,
                    text,
                    "a closing quote at the end of the line",
                )),
            };
        }
        Ok(Value::Plain(text.to_owned()))
    }
}

/// Values in brackets.
struct Flow<'a, 's> {
    source: &'s Source,
    lines: &'a [Line<'s>],
    at: usize,
    rest: &'s str,
}

impl<'s> Flow<'_, 's> {
    fn line(&self) -> usize {
        self.lines[self.at.min(self.lines.len() - 1)].number
    }

    /// The next character that is not blank, on this line or, where that is allowed, on later ones.
    fn peek(&mut self) -> Result<u8, CalibError> {
        loop {
            self.rest = self.rest.trim_start();
            if let Some(byte) = self.rest.bytes().next() {
                return Ok(byte);
            }
            let Some(next) = self.lines.get(self.at + 1) else {
                return Err(self.source.malformed(
                    self.line(),
                    self.lines[self.at].text,
                    "a closing bracket before the end of the file",
                ));
            };
            self.at += 1;
            self.rest = next.text;
        }
    }

    fn value(&mut self, depth: usize) -> Result<Node, CalibError> {
        let open = self.peek()?;
        let line = self.line();
        if depth > MAX_DEPTH {
            let expected = format!("at most {MAX_DEPTH} brackets inside each other");
            return Err(self.source.malformed(line, self.rest, &expected));
        }
        let value = match open {
            b'[' => {
                let mut items = Vec::new();
                self.elements(b']', &mut |flow| {
                    items.push(flow.value(depth + 1)?);
                    Ok(())
                })?;
                Value::List(items)
            }
            b'{' => {
                let mut entries: Vec<(String, Node)> = Vec::new();
                self.elements(b'}', &mut |flow| {
                    let line = flow.line();
                    let key = flow.word()?;
                    if flow.peek()? != b':' {
                        return Err(flow.source.malformed(line, &key, "key: value"));
                    }
                    flow.rest = &flow.rest[1..];
                    let value = flow.value(depth + 1)?;
                    if entries.iter().any(|(other, _)| *other == key) {
                        return Err(flow.source.malformed(line, &key, "each key once"));
                    }
                    entries.push((key, value));
                    Ok(())
                })?;
                Value::Map(entries)
            }
            quote @ (b'"' | b'\'') => Value::Quoted(self.quoted(quote)?),
            _ => Value::Plain(self.word()?),
        };
        Ok(Node { line, value })
    }

    /// Elements separated by commas, up to the closing bracket. A trailing comma is allowed.
    fn elements(
        &mut self,
        close: u8,
        element: &mut dyn FnMut(&mut Self) -> Result<(), CalibError>,
    ) -> Result<(), CalibError> {
        self.rest = &self.rest[1..];
        loop {
            match self.peek()? {
                byte if byte == close => break,
                b',' => {
                    let expected = "a number between commas";
                    return Err(self.source.malformed(self.line(), self.rest, expected));
                }
                _ => element(self)?,
            }
            let (line, before) = (self.at, self.line());
            match self.peek()? {
                b',' => self.rest = &self.rest[1..],
                byte if byte == close => {}
                _ => {
                    let expected = "a comma or a closing bracket at the end of the line";
                    let found = self.lines[line].text;
                    return Err(self.source.malformed(before, found, expected));
                }
            }
        }
        self.rest = &self.rest[1..];
        Ok(())
    }

    /// A plain scalar, up to its end.
    fn word(&mut self) -> Result<String, CalibError> {
        if let quote @ (b'"' | b'\'') = self.peek()? {
            return self.quoted(quote);
        }
        let bytes = self.rest.as_bytes();
        let end = (0..bytes.len())
            .find(|&i| match bytes[i] {
                b',' | b']' | b'}' | b'[' | b'{' => true,
                b':' => bytes.get(i + 1).is_none_or(|next| *next == b' '),
                _ => false,
            })
            .unwrap_or(bytes.len());
        let (word, rest) = self.rest.split_at(end);
        if word.trim().is_empty() {
            let line = self.line();
            return Err(self.source.malformed(line, self.rest, "a value"));
        }
        self.rest = rest;
        Ok(word.trim_end().to_owned())
    }

    fn quoted(&mut self, quote: u8) -> Result<String, CalibError> {
        let inside = &self.rest[1..];
        let Some(end) = closing_quote(inside, quote) else {
            let line = self.line();
            return Err(self
                .source
                .malformed(line, self.rest, "a closing quote on the same line"));
        };
        self.rest = &inside[end + 1..];
        Ok(unescaped(&inside[..end], quote))
    }
}

fn is_item(text: &str) -> bool {
    text == "-" || text.starts_with("- ")
}

fn opens(value: &str) -> bool {
    value.starts_with(['[', '{'])
}

/// `key: value` or `key:`; the key may be in quotes.
fn split_key(text: &str) -> Option<(&str, &str)> {
    for quote in ['"', '\''] {
        if let Some(inside) = text.strip_prefix(quote) {
            let end = closing_quote(inside, quote as u8)?;
            let rest = inside[end + 1..].trim_start().strip_prefix(':')?;
            return (rest.is_empty() || rest.starts_with(' '))
                .then(|| (&inside[..end], rest.trim()));
        }
    }
    let at = text.bytes().enumerate().position(|(i, b)| {
        b == b':' && matches!(text.as_bytes().get(i + 1), None | Some(b' ' | b'\t'))
    })?;
    let key = text[..at].trim_end();
    (!key.is_empty() && !key.starts_with(['[', '{'])).then(|| (key, text[at + 1..].trim()))
}

/// Removes a tag: the reader knows the type already.
fn without_tag(value: &str) -> &str {
    match value.strip_prefix('!') {
        Some(tag) => tag
            .split_once(char::is_whitespace)
            .map_or("", |(_, rest)| rest.trim()),
        None => value,
    }
}

/// End of a quotation.
fn closing_quote(inside: &str, quote: u8) -> Option<usize> {
    let bytes = inside.as_bytes();
    let mut i = 0;
    while i < bytes.len() {
        match bytes[i] {
            b'\\' if quote == b'"' => i += 1,
            b if b == quote => {
                // Two single quotes are one in the text.
                if quote == b'\'' && bytes.get(i + 1) == Some(&quote) {
                    i += 1;
                } else {
                    return Some(i);
                }
            }
            _ => {}
        }
        i += 1;
    }
    None
}

fn unescaped(text: &str, quote: u8) -> String {
    if quote == b'\'' {
        text.replace("''", "'")
    } else {
        text.replace("\\\"", "\"").replace("\\\\", "\\")
    }
}

#[cfg(test)]
mod tests;
