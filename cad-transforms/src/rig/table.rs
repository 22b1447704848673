//! Tables and values of the rig file, with the place of every complaint.

use std::ops::Range;

use toml::Spanned;
use toml::de::{DeTable, DeValue};

use super::Problem;

/// How much of a value a message shows, characters.
const MOST_FOUND: usize = 60;

/// Collects problems with their lines.
pub(crate) struct Log<'t> {
    pub(crate) text: &'t str,
    pub(crate) problems: Vec<Problem>,
}

impl Log<'_> {
    pub(crate) fn add(&mut self, at: Range<usize>, message: String) {
        let line = self.line(&at);
        self.problems.push(Problem { line, message });
    }

    /// What the file has there, on one line and not too long.
    pub(crate) fn found(&self, at: &Range<usize>) -> String {
        let text = self.text.get(at.clone()).unwrap_or_default();
        let words: Vec<&str> = text.split_whitespace().collect();
        let text = words.join(" ");
        match text.char_indices().nth(MOST_FOUND) {
            Some((end, _)) => format!("{}…", &text[..end]),
            None => text,
        }
    }

    pub(crate) fn line(&self, at: &Range<usize>) -> usize {
        line_of(self.text, at.start)
    }
}

pub(crate) fn line_of(text: &str, offset: usize) -> usize {
    1 + text.bytes().take(offset).filter(|b| *b == b'\n').count()
}

/// Why a text is not TOML, with the line as it stands there.
pub(crate) fn not_toml(text: &str, error: &toml::de::Error) -> Problem {
    let line = line_of(text, error.span().map_or(0, |span| span.start));
    let found = text.lines().nth(line - 1).unwrap_or_default().trim();
    // As in 0,063: a list with such numbers may read as more of them, or as none.
    let bytes = found.as_bytes();
    let comma = bytes
        .windows(3)
        .any(|w| w[0].is_ascii_digit() && w[1] == b',' && w[2].is_ascii_digit());
    let hint = if comma {
        "; decimals are written with a point, not a comma"
    } else {
        ""
    };
    Problem {
        line,
        message: format!("not TOML: {} in `{found}`{hint}", error.message()),
    }
}

/// A TOML table with what is needed to complain about it.
pub(crate) struct Table<'a, 'i> {
    pub(crate) table: &'a DeTable<'i>,
    pub(crate) at: Range<usize>,
    pub(crate) name: &'static str,
}

impl<'a, 'i> Table<'a, 'i> {
    pub(crate) fn refuse_unknown(&self, known: &[&str], log: &mut Log<'_>) {
        for key in self.table.keys() {
            let name = key.get_ref().as_ref();
            if known.contains(&name) {
                continue;
            }
            let nearest = known
                .iter()
                .map(|k| (strsim::osa_distance(name, k), *k))
                .min()
                .filter(|(distance, k)| *distance <= k.len().div_ceil(3));
            let hint = match nearest {
                Some((_, nearest)) => format!("did you mean {nearest}?"),
                None => format!("known are {}", known.join(", ")),
            };
            log.add(
                key.span(),
                format!("unknown key {name} in {}; {hint}", self.name),
            );
        }
    }

    /// The value under `key`, or a problem when it is missing or is not what `read` takes.
    pub(crate) fn get<T>(
        &self,
        key: &str,
        log: &mut Log<'_>,
        read: impl Fn(&'a DeValue<'i>) -> Option<T>,
        expected: &str,
    ) -> Option<(Range<usize>, T)> {
        self.get_list(key, log, read, expected, None)
    }

    /// As [`Self::entries`], where the key may be absent.
    pub(crate) fn optional_entries(
        &self,
        key: &str,
        name: &'static str,
        expected: &str,
        log: &mut Log<'_>,
    ) -> Vec<Table<'a, 'i>> {
        match self.table.contains_key(key) {
            true => self.entries(key, name, expected, log),
            false => Vec::new(),
        }
    }

    /// The tables of the list under `key`, or problems; `name` is theirs in messages.
    pub(crate) fn entries(
        &self,
        key: &str,
        name: &'static str,
        expected: &str,
        log: &mut Log<'_>,
    ) -> Vec<Table<'a, 'i>> {
        let list = self.get(key, log, list_of, expected);
        let mut tables = Vec::new();
        for entry in list.map(|(_, list)| list).unwrap_or_default() {
            let at = entry.span();
            match entry.get_ref().as_table() {
                Some(table) => tables.push(Table { table, at, name }),
                None => log.add(at, format!("{key} holds something that is not a table")),
            }
        }
        tables
    }

    /// As [`Self::get`], for a list of `count` numbers, or of such lists.
    pub(crate) fn get_list<T>(
        &self,
        key: &str,
        log: &mut Log<'_>,
        read: impl Fn(&'a DeValue<'i>) -> Option<T>,
        expected: &str,
        count: impl Into<Option<usize>>,
    ) -> Option<(Range<usize>, T)> {
        let Some(value) = self.table.get(key) else {
            log.add(
                self.at.clone(),
                format!("{key} is missing in {}, expected {expected}", self.name),
            );
            return None;
        };
        match read(value.get_ref()) {
            Some(read) => Some((value.span(), read)),
            None => {
                let found = log.found(&value.span());
                let counts = count.into().map(|count| miscounted(value.get_ref(), count));
                let hint = match counts.flatten() {
                    Some(n) => format!(", a list of {n}; decimals are written with a point"),
                    None => String::new(),
                };
                let message = format!(
                    "{key} in {} is not {expected} (found {found}{hint})",
                    self.name
                );
                log.add(value.span(), message);
                None
            }
        }
    }
}

/// Length of the first list of values that has not `count` of them.
fn miscounted(value: &DeValue<'_>, count: usize) -> Option<usize> {
    let list = value.as_array()?;
    if list.iter().any(|value| value.get_ref().is_array()) {
        return list
            .iter()
            .find_map(|value| miscounted(value.get_ref(), count));
    }
    (list.len() != count).then_some(list.len())
}

pub(crate) fn integer(value: &DeValue<'_>) -> Option<i64> {
    let integer = value.as_integer()?;
    i64::from_str_radix(integer.as_str(), integer.radix()).ok()
}

pub(crate) fn number(value: &DeValue<'_>) -> Option<f64> {
    let number = match value.as_float() {
        Some(float) => float.as_str().parse().ok(),
        None => integer(value).map(|v| v as f64),
    };
    number.filter(|v: &f64| v.is_finite())
}

pub(crate) fn positive(value: &DeValue<'_>) -> Option<f64> {
    number(value).filter(|v| *v > 0.0)
}

pub(crate) fn text_of(value: &DeValue<'_>) -> Option<String> {
    value
        .as_str()
        .filter(|text| !text.trim().is_empty())
        .map(str::to_owned)
}

pub(crate) fn table_of<'a, 'i>(value: &'a DeValue<'i>) -> Option<&'a DeTable<'i>> {
    value.as_table()
}

fn list_of<'a, 'i>(value: &'a DeValue<'i>) -> Option<Vec<&'a Spanned<DeValue<'i>>>> {
    value
        .as_array()
        .filter(|list| !list.is_empty())
        .map(|list| list.iter().collect())
}

pub(crate) fn numbers<const N: usize>(value: &DeValue<'_>) -> Option<[f64; N]> {
    let list: Option<Vec<f64>> = value
        .as_array()?
        .iter()
        .map(|v| number(v.get_ref()))
        .collect();
    list?.try_into().ok()
}

pub(crate) fn rows(value: &DeValue<'_>) -> Option<[f64; 9]> {
    let rows: Option<Vec<[f64; 3]>> = value
        .as_array()?
        .iter()
        .map(|v| numbers::<3>(v.get_ref()))
        .collect();
    rows?.concat().try_into().ok()
}
