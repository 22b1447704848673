//! Tables and values of the rig file, with the place of every complaint.

use std::ops::Range;

use toml::Spanned;
use toml::de::{DeTable, DeValue};

use super::Problem;

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

    pub(crate) fn line(&self, at: &Range<usize>) -> usize {
        line_of(self.text, at.start)
    }
}

pub(crate) fn line_of(text: &str, offset: usize) -> usize {
    1 + text.bytes().take(offset).filter(|b| *b == b'\n').count()
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
                log.add(
                    value.span(),
                    format!("{key} in {} is not {expected}", self.name),
                );
                None
            }
        }
    }
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

pub(crate) fn list_of<'a, 'i>(value: &'a DeValue<'i>) -> Option<Vec<&'a Spanned<DeValue<'i>>>> {
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
