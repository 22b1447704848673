//! The part of YAML that `sensor.yaml` files use: `key: value`, one block inside another by indentation,
//! and lists in brackets over any number of lines. Anything else is refused with its line, so that a
//! file is never half understood.

use std::collections::BTreeMap;

use crate::error::CalibError;
use crate::text::Source;

/// Values by their full key, for example `T_BS.data`.
pub(crate) struct Yaml<'s> {
    source: &'s Source,
    values: BTreeMap<String, Value<'s>>,
}

struct Value<'s> {
    line: usize,
    text: &'s str,
    /// Elements with their lines, where the value is a list.
    list: Option<Vec<(usize, &'s str)>>,
}

impl<'s> Yaml<'s> {
    pub(crate) fn parse(source: &'s Source) -> Result<Self, CalibError> {
        let mut values = BTreeMap::new();
        // Blocks that are open: the indentation of their keys, once known, and their full key with a dot.
        let mut blocks: Vec<(Option<usize>, String)> = vec![(Some(0), String::new())];
        let mut lines = source
            .text
            .trim_start_matches('\u{feff}')
            .lines()
            .enumerate()
            .map(|(i, line)| (i + 1, line));
        while let Some((line, raw)) = lines.next() {
            let text = without_comment(raw).trim_end();
            let content = text.trim_start();
            if content.is_empty() || text.starts_with('%') || text == "---" || text == "..." {
                continue;
            }
            let (spaces, _) = text.split_at(text.len() - content.len());
            if spaces.contains('\t') {
                return Err(source.malformed(line, raw, "indentation by spaces"));
            }
            let indent = spaces.len();
            if let Some((unknown @ None, _)) = blocks.last_mut()
                && indent > 0
            {
                *unknown = Some(indent);
            }
            while blocks.len() > 1
                && blocks
                    .last()
                    .is_some_and(|(at, _)| at.is_none_or(|at| at > indent))
            {
                blocks.pop();
            }
            let (at, prefix) = blocks.last().expect("the outermost block stays");
            if *at != Some(indent) {
                return Err(source.malformed(
                    line,
                    raw,
                    "the indentation of one of the keys above",
                ));
            }
            let Some((key, value)) = content
                .split_once(':')
                .filter(|(key, value)| is_key(key) && starts_value(value))
            else {
                return Err(source.malformed(line, content, "key: value"));
            };
            let (key, value) = (format!("{prefix}{}", key.trim_end()), value.trim());
            if value.is_empty() || value.starts_with('!') {
                blocks.push((None, format!("{key}.")));
                continue;
            }
            let list = match value.strip_prefix('[') {
                Some(first) => Some(list(source, (line, first), &mut lines)?),
                None => None,
            };
            if values
                .insert(
                    key.clone(),
                    Value {
                        line,
                        text: value,
                        list,
                    },
                )
                .is_some()
            {
                return Err(source.malformed(line, &key, "each key once"));
            }
        }
        Ok(Self { source, values })
    }

    /// Text of a value, without quotes.
    pub(crate) fn text(&self, key: &str) -> Result<(usize, &'s str), CalibError> {
        let value = self.get(key)?;
        let text = value.text;
        let quoted = ['"', '\'']
            .iter()
            .find_map(|q| text.strip_prefix(*q)?.strip_suffix(*q));
        Ok((value.line, quoted.unwrap_or(text)))
    }

    pub(crate) fn number(&self, key: &str) -> Result<f64, CalibError> {
        let (line, text) = self.text(key)?;
        self.source.number(line, text)
    }

    /// Exactly `N` numbers, and the line where the list begins.
    pub(crate) fn numbers<const N: usize>(
        &self,
        key: &str,
    ) -> Result<(usize, [f64; N]), CalibError> {
        let value = self.get(key)?;
        let expected = || format!("{key} with {N} numbers in brackets");
        let Some(list) = &value.list else {
            return Err(self.source.malformed(value.line, value.text, &expected()));
        };
        let numbers: Vec<f64> = list
            .iter()
            .map(|(line, text)| self.source.number(*line, text))
            .collect::<Result<_, _>>()?;
        let count = numbers.len();
        let numbers = numbers.try_into().map_err(|_| {
            self.source
                .malformed(value.line, &format!("{count} numbers"), &expected())
        })?;
        Ok((value.line, numbers))
    }

    pub(crate) fn contains(&self, key: &str) -> bool {
        self.values.contains_key(key)
    }

    fn get(&self, key: &str) -> Result<&Value<'s>, CalibError> {
        self.values.get(key).ok_or_else(|| {
            let known: Vec<&str> = self.values.keys().map(String::as_str).collect();
            self.source.missing(key, &known.join(", "))
        })
    }
}

/// The elements of a list that begins behind the bracket in `first` and may go on over more lines.
fn list<'s>(
    source: &Source,
    first: (usize, &'s str),
    lines: &mut impl Iterator<Item = (usize, &'s str)>,
) -> Result<Vec<(usize, &'s str)>, CalibError> {
    let mut elements = Vec::new();
    let (mut line, mut text) = first;
    loop {
        let (inside, closed) = match text.split_once(']') {
            Some((inside, rest)) if rest.trim().is_empty() => (inside, true),
            Some((_, rest)) => {
                return Err(source.malformed(line, rest, "nothing behind the bracket"));
            }
            None => (text, false),
        };
        let words: Vec<&str> = inside.split(',').map(str::trim).collect();
        for (i, word) in words.iter().enumerate() {
            // A comma may end a line; elsewhere two commas have lost a number between them.
            match word.is_empty() {
                false => elements.push((line, *word)),
                true if i + 1 == words.len() => {}
                true => return Err(source.malformed(line, inside, "a number between commas")),
            }
        }
        if closed {
            return Ok(elements);
        }
        if words.last().is_some_and(|word| !word.is_empty()) {
            return Err(source.malformed(
                line,
                text.trim(),
                "a comma or a closing bracket at the end of the line",
            ));
        }
        match lines.next() {
            Some((next, raw)) => (line, text) = (next, without_comment(raw)),
            None => {
                return Err(source.malformed(
                    line,
                    text,
                    "a closing bracket before the end of the file",
                ));
            }
        }
    }
}

/// A comment starts with `#` at the beginning or behind a blank.
fn without_comment(line: &str) -> &str {
    let start = line
        .char_indices()
        .find(|(i, c)| *c == '#' && (*i == 0 || line[..*i].ends_with([' ', '\t'])))
        .map_or(line.len(), |(i, _)| i);
    &line[..start]
}

fn is_key(text: &str) -> bool {
    let key = text.trim_end();
    !key.is_empty() && key.bytes().all(|b| b.is_ascii_alphanumeric() || b == b'_')
}

fn starts_value(text: &str) -> bool {
    text.is_empty() || text.starts_with(' ')
}

#[cfg(test)]
mod tests {
    use super::*;

    fn source(text: &str) -> Source {
        Source {
            path: "sensor.yaml".into(),
            text: text.to_owned(),
        }
    }

    #[test]
    fn reads_blocks_lists_and_comments() {
        let text = "%YAML:1.0\n# General\nT_BS: !!opencv-matrix\n  rows: 2\n  data: [1.5, -2e-05, # first\n\n         \
                    3,\n         4]\nrate_hz: 20 # Hz\ncomment: VI-Sensor #3 (a: b)\nname: 'cam 0'\n";
        let source = source(text);
        let yaml = Yaml::parse(&source).unwrap();
        assert_eq!(
            yaml.numbers::<4>("T_BS.data").unwrap(),
            (5, [1.5, -2e-05, 3.0, 4.0])
        );
        assert_eq!(yaml.number("T_BS.rows").unwrap(), 2.0);
        assert_eq!(yaml.number("rate_hz").unwrap(), 20.0);
        assert_eq!(yaml.text("comment").unwrap(), (10, "VI-Sensor"));
        assert_eq!(yaml.text("name").unwrap().1, "cam 0");
        assert!(yaml.contains("rate_hz") && !yaml.contains("T_BS"));
    }

    #[test]
    fn refuses_what_it_does_not_know() {
        for (text, expected) in [
            ("- item\n", "line 1: found \"- item\", expected key: value"),
            (
                "a: 1\n\tb: 2\n",
                "line 2: found \"\\tb: 2\", expected indentation by spaces",
            ),
            (
                "a: 1\n  b: 2\n",
                "line 2: found \"  b: 2\", expected the indentation of one of the keys above",
            ),
            (
                "a:\n    b: 1\n  c: 2\n",
                "line 3: found \"  c: 2\", expected the indentation",
            ),
            (
                "a: 1\na: 2\n",
                "line 2: found \"a\", expected each key once",
            ),
            (
                "a: [1, 2\n3]\n",
                "line 1: found \"1, 2\", expected a comma or a closing bracket",
            ),
            (
                "a: [1, 2,\n",
                "a closing bracket before the end of the file",
            ),
            ("a: [1,, 2]\n", "expected a number between commas"),
            ("a: [1] 2\n", "expected nothing behind the bracket"),
            ("a:1\n", "expected key: value"),
        ] {
            let source = source(text);
            let error = Yaml::parse(&source)
                .err()
                .unwrap_or_else(|| panic!("{text:?} was taken"))
                .to_string();
            assert!(
                error.contains(expected),
                "found {error:?}, expected {expected:?}"
            );
        }
    }

    #[test]
    fn wrong_values_are_named() {
        let source = source("a: [1, 2]\nb: x\nc: [1, 2,5e, 3]\n");
        let yaml = Yaml::parse(&source).unwrap();
        let error = |result: Result<(usize, [f64; 3]), CalibError>| result.unwrap_err().to_string();
        assert!(
            error(yaml.numbers("a"))
                .contains("line 1: found \"2 numbers\", expected a with 3 numbers")
        );
        assert!(error(yaml.numbers("b")).contains("line 2: found \"x\""));
        assert!(
            error(yaml.numbers("c")).contains("line 3: found \"5e\", expected a finite number")
        );
        assert!(error(yaml.numbers("d")).contains("d is missing, found a, b, c"));
    }
}
