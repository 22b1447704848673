//! Access to a TOML table key by key.
//!
//! Contract: reading a key of a [`Section`] returns its value, or `None` if it is absent or
//! invalid; the latter is reported with its line. Parsing never stops at a problem.
//! [`Section::finish`] reports every key that was never read. So the code that reads a key is the
//! single list of known keys.

use std::cell::RefCell;
use std::fmt::Display;
use std::ops::RangeInclusive;
use std::path::{Path, PathBuf};
use std::str::FromStr;

use session_archive::text::is_plain;
use toml::Spanned;
use toml::de::{DeTable, DeValue};

use super::Problem;

/// Collects problems with their lines.
pub(super) struct Log<'t> {
    text: &'t str,
    problems: RefCell<Vec<Problem>>,
}

impl<'t> Log<'t> {
    pub(super) fn new(text: &'t str) -> Self {
        Self {
            text,
            problems: RefCell::default(),
        }
    }

    /// `at` counts bytes from the start of the text.
    pub(super) fn add(&self, at: usize, message: String) {
        let line = 1 + self.text.bytes().take(at).filter(|b| *b == b'\n').count();
        self.problems.borrow_mut().push(Problem { line, message });
    }

    /// All of them in the order of the file.
    pub(super) fn into_problems(self) -> Vec<Problem> {
        let mut problems = self.problems.into_inner();
        problems.sort_by_key(|problem| problem.line);
        problems
    }
}

/// A table that is being read.
pub(super) struct Section<'d> {
    log: &'d Log<'d>,
    /// `None` if the file has no such table or something else instead of it: then every key is
    /// absent.
    table: Option<&'d DeTable<'d>>,
    /// Its position in the text.
    at: usize,
    /// Its name in the file: `[session]`.
    name: String,
    /// The keys read so far.
    known: Vec<&'static str>,
    /// Every key is accepted.
    is_open: bool,
}

impl<'d> Section<'d> {
    pub(super) fn root(table: &'d DeTable<'d>, log: &'d Log<'d>) -> Self {
        let name = "the configuration".to_owned();
        Self {
            log,
            table: Some(table),
            at: 0,
            name,
            known: Vec::new(),
            is_open: false,
        }
    }

    /// The table under `key`, which may be absent.
    pub(super) fn section(&mut self, key: &'static str, name: &str) -> Section<'d> {
        let log = self.log;
        let place = self.at;
        let found = self.read(key, "a table", |at, value| Some((at, value.as_table()?)));
        Section {
            log,
            at: found.map_or(place, |(at, _)| at),
            table: found.map(|(_, table)| table),
            name: name.to_owned(),
            known: Vec::new(),
            is_open: false,
        }
    }

    /// The tables in the list under `key`, which may be absent, but not empty.
    pub(super) fn sections(&mut self, key: &'static str, name: &str) -> Vec<Section<'d>> {
        let log = self.log;
        let expected = format!("tables, each beginning with {name}");
        let tables = self.read(key, expected, |_, value| {
            let tables = value.as_array().filter(|list| !list.is_empty())?.iter();
            tables
                .map(|table| Some((table.span().start, table.get_ref().as_table()?)))
                .collect::<Option<Vec<_>>>()
        });
        let section = |(at, table)| Section {
            log,
            at,
            table: Some(table),
            name: name.to_owned(),
            known: Vec::new(),
            is_open: false,
        };
        tables
            .unwrap_or_default()
            .into_iter()
            .map(section)
            .collect()
    }

    pub(super) fn integer(&mut self, key: &'static str, range: RangeInclusive<i64>) -> Option<i64> {
        let expected = format!("an integer from {} to {}", range.start(), range.end());
        self.read(key, expected, |_, value| {
            integer(value).filter(|v| range.contains(v))
        })
    }

    pub(super) fn number(&mut self, key: &'static str, range: RangeInclusive<f64>) -> Option<f64> {
        let expected = format!("a number from {} to {}", range.start(), range.end());
        self.read(key, expected, |_, value| {
            number(value).filter(|v| range.contains(v))
        })
    }

    pub(super) fn flag(&mut self, key: &'static str) -> Option<bool> {
        self.read(key, "true or false", |_, value| value.as_bool())
    }

    /// All keys of this table with their integers: for tables with foreign keys.
    pub(super) fn integers(mut self) -> Vec<(String, i64)> {
        self.is_open = true;
        let mut found = Vec::new();
        for (key, value) in self.table.into_iter().flatten() {
            let name = key.get_ref().as_ref();
            match integer(value.get_ref()) {
                Some(value) => found.push((name.to_owned(), value)),
                None => self.refuse(
                    name,
                    format_args!("is {}, expected an integer", self::found(value.get_ref())),
                ),
            }
        }
        self.finish();
        found
    }

    /// Whether the file has this key.
    pub(super) fn has(&self, key: &str) -> bool {
        self.value(key).is_some()
    }

    /// A text of which `is_valid` holds.
    pub(super) fn text(
        &mut self,
        key: &'static str,
        expected: &str,
        is_valid: impl Fn(&str) -> bool,
    ) -> Option<String> {
        self.read(key, expected, |_, value| {
            value
                .as_str()
                .filter(|text| is_valid(text))
                .map(str::to_owned)
        })
    }

    /// A list of texts, each of which can be read as a `T`; empty where the key is absent.
    pub(super) fn parsed<T>(&mut self, key: &'static str, expected: &str) -> Vec<T>
    where
        T: FromStr<Err: Display>,
    {
        let expected = format!("a list of {expected}");
        let texts = self.read(key, expected, |_, value| {
            let texts = value.as_array()?.iter();
            let text = |text: &'d Spanned<DeValue<'d>>| {
                Some((text.span().start, text.get_ref().as_str()?))
            };
            texts.map(text).collect::<Option<Vec<_>>>()
        });
        let mut all = Vec::new();
        for (at, text) in texts.unwrap_or_default() {
            match text.parse() {
                Ok(parsed) => all.push(parsed),
                Err(error) => self.log.add(at, format!("{key} in {}: {error}", self.name)),
            }
        }
        all
    }

    /// A path; a relative one is relative to `folder`.
    pub(super) fn path(&mut self, key: &'static str, folder: &Path) -> Option<PathBuf> {
        let expected = "a path without control characters, relative to this file or from the root (~ is not \
                        expanded)";
        let is_path = |path: &str| !path.is_empty() && !path.starts_with('~') && is_plain(path);
        self.text(key, expected, is_path)
            .map(|path| folder.join(path))
    }

    /// Reports a problem if `key` is absent.
    pub(super) fn must_have(&self, key: &str, expected: &str) {
        if self.table.is_some_and(|table| !table.contains_key(key)) {
            self.log.add(
                self.at,
                format!("{key} is missing in {}, expected {expected}", self.name),
            );
        }
    }

    /// Reports a problem with the value of `key`.
    pub(super) fn refuse(&self, key: &str, reason: impl Display) {
        let at = self.value(key).map_or(self.at, |value| value.span().start);
        self.log.add(at, format!("{key} in {} {reason}", self.name));
    }

    /// Reports every key that was never read.
    pub(super) fn finish(self) {
        for key in self.table.into_iter().flat_map(DeTable::keys) {
            let name = key.get_ref().as_ref();
            if !self.is_open && !self.known.contains(&name) {
                let hint = nearest(name, &self.known);
                self.log.add(
                    key.span().start,
                    format!("unknown key {name} in {}; {hint}", self.name),
                );
            }
        }
    }

    fn value(&self, key: &str) -> Option<&'d Spanned<DeValue<'d>>> {
        self.table?.get(key)
    }

    /// `read` takes the position of the value and the value.
    fn read<T>(
        &mut self,
        key: &'static str,
        expected: impl Display,
        read: impl FnOnce(usize, &'d DeValue<'d>) -> Option<T>,
    ) -> Option<T> {
        self.known.push(key);
        let value = self.value(key)?;
        let read = read(value.span().start, value.get_ref());
        if read.is_none() {
            self.refuse(
                key,
                format_args!("is {}, expected {expected}", found(value.get_ref())),
            );
        }
        read
    }
}

/// The known name nearest to `name`, as a suggestion.
pub(super) fn nearest(name: &str, known: &[&str]) -> String {
    let nearest = known
        .iter()
        .map(|k| (strsim::osa_distance(&name.to_ascii_lowercase(), k), *k))
        .min()
        .filter(|(distance, k)| *distance <= k.len().div_ceil(3));
    match nearest {
        Some((_, nearest)) => format!("did you mean {nearest}?"),
        None => format!("known are {}", known.join(", ")),
    }
}

fn found(value: &DeValue<'_>) -> String {
    match value {
        DeValue::String(text) => format!("{text:?}"),
        DeValue::Integer(integer) => integer.to_string(),
        DeValue::Float(float) => float.to_string(),
        DeValue::Boolean(flag) => flag.to_string(),
        DeValue::Datetime(_) => "a date".to_owned(),
        DeValue::Array(list) if list.is_empty() => "an empty list".to_owned(),
        DeValue::Array(_) => "a list".to_owned(),
        DeValue::Table(_) => "a table".to_owned(),
    }
}

fn integer(value: &DeValue<'_>) -> Option<i64> {
    let integer = value.as_integer()?;
    i64::from_str_radix(integer.as_str(), integer.radix()).ok()
}

fn number(value: &DeValue<'_>) -> Option<f64> {
    match value.as_float() {
        Some(float) => float.as_str().parse().ok(),
        None => integer(value).map(|v| v as f64),
    }
}
