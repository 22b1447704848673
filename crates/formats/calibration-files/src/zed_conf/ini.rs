//! INI text: sections of `key = value`, names in any case.

use std::collections::BTreeMap;

use crate::error::CalibError;
use crate::text::Source;

/// A parsed file. Names are kept in upper case.
pub(super) struct Ini<'s> {
    source: &'s Source,
    sections: BTreeMap<String, Section<'s>>,
}

pub(super) struct Section<'s> {
    source: &'s Source,
    name: String,
    values: BTreeMap<String, (usize, &'s str)>,
}

impl<'s> Ini<'s> {
    /// Values are parsed only when they are used: others may be anything.
    pub(super) fn parse(source: &'s Source) -> Result<Self, CalibError> {
        let mut sections: BTreeMap<String, Section<'s>> = BTreeMap::new();
        let mut current: Option<String> = None;
        for (line, text) in source.lines() {
            if text.is_empty() || text.starts_with(['#', ';']) {
                continue;
            }
            if let Some(name) = text.strip_prefix('[') {
                let Some(name) = name
                    .strip_suffix(']')
                    .map(|name| name.trim().to_ascii_uppercase())
                else {
                    return Err(source.malformed(line, text, "[SECTION]"));
                };
                // A section that occurs twice is continued.
                sections.entry(name.clone()).or_insert_with(|| Section {
                    source,
                    name: name.clone(),
                    values: BTreeMap::new(),
                });
                current = Some(name);
                continue;
            }
            let Some((key, value)) = text.split_once('=') else {
                return Err(source.malformed(line, text, "key=value or [SECTION]"));
            };
            let Some(section) = current.as_ref().and_then(|name| sections.get_mut(name)) else {
                return Err(source.malformed(line, text, "a [SECTION] before the first key"));
            };
            let (key, value) = (key.trim().to_ascii_uppercase(), value.trim());
            if let Some((first, other)) = section.values.insert(key.clone(), (line, value))
                && other != value
            {
                let expected = format!("the value of line {first}, {other:?}: {key} comes twice");
                return Err(source.malformed(line, value, &expected));
            }
        }
        Ok(Self { source, sections })
    }

    pub(super) fn section(&self, name: &str) -> Option<&Section<'s>> {
        self.sections.get(name)
    }

    pub(super) fn require(&self, name: &str) -> Result<&Section<'s>, CalibError> {
        self.section(name).ok_or_else(|| {
            let found = format!("sections {}", self.section_names().join(", "));
            self.source.missing(&format!("section [{name}]"), &found)
        })
    }

    pub(super) fn section_names(&self) -> Vec<&str> {
        self.sections.keys().map(String::as_str).collect()
    }
}

impl<'s> Section<'s> {
    pub(super) fn name(&self) -> &str {
        &self.name
    }

    pub(super) fn has(&self, key: &str) -> bool {
        self.values.contains_key(key)
    }

    pub(super) fn text(&self, key: &str) -> Result<(usize, &'s str), CalibError> {
        self.values.get(key).copied().ok_or_else(|| {
            let keys: Vec<&str> = self.values.keys().map(String::as_str).collect();
            self.source
                .missing(&format!("{key} in [{}]", self.name), &keys.join(", "))
        })
    }

    /// An error about a value that can be read but is invalid.
    pub(super) fn implausible(&self, key: &str, reason: &str) -> CalibError {
        let line = self.values.get(key).map_or(0, |(line, _)| *line);
        CalibError::Implausible {
            path: self.source.path.clone(),
            reason: format!("line {line}: {key} in [{}]: {reason}", self.name),
        }
    }

    pub(super) fn number(&self, key: &str) -> Result<f64, CalibError> {
        let (line, text) = self.text(key)?;
        let what = format!(" as {key} in [{}]", self.name);
        self.source.number_for(line, text, &what)
    }
}
