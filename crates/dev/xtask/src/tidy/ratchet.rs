//! `docs/tidy.txt`: the counts that may only fall, and what became of them.
//!
//! A plain table, one key and its number a line, sorted, so that two branches that lower different
//! counts merge without a conflict. Writing it never makes a check weaker: a count is lowered or
//! left, and only a key that the file does not have is taken as it is found.

use std::cmp::Ordering;
use std::collections::BTreeMap;

use anyhow::{Context, Result, bail};

use super::place::Place;

/// A count as it is found.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Measure {
    /// What is counted, and of which package: `comment-words calib`.
    pub(crate) key: String,
    pub(crate) value: usize,
    /// How it may change.
    pub(crate) direction: Direction,
    /// Where what is counted is.
    pub(crate) places: Vec<Place>,
    /// What `--list` is to be called with for all places; `None` where the whole list has them.
    pub(crate) of: Option<String>,
}

/// How a count may change.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Direction {
    MayFall,
    MayRise,
}

/// The counts that the file permits.
#[derive(Debug, Default, PartialEq)]
pub(crate) struct Ratchet {
    counts: BTreeMap<String, usize>,
}

/// How the counts that were found compare with those permitted.
#[derive(Debug, Default)]
pub(crate) struct Comparison<'a> {
    /// Worse than permitted, with the number that is.
    pub(crate) worse: Vec<(&'a Measure, usize)>,
    /// Better than permitted, with the number that is.
    pub(crate) better: Vec<(&'a Measure, usize)>,
    /// Not in the file.
    pub(crate) new: Vec<&'a Measure>,
    /// In the file and not counted any more.
    pub(crate) unused: Vec<String>,
}

const HEADER: &str = "\
# Counts that may only fall (`patterns` may only rise); CONTRIBUTING.md says how to read them.
# `cargo xtask tidy` compares, `cargo xtask tidy --write` lowers what fell and adds what is new.
# A count that has to rise is raised here by hand, with the reason in the message of the commit.
";

impl Ratchet {
    /// Reads the file.
    pub(crate) fn parse(text: &str) -> Result<Self> {
        let mut counts = BTreeMap::new();
        for (at, line) in text.lines().enumerate() {
            let line = line.trim();
            if line.is_empty() || line.starts_with('#') {
                continue;
            }
            let number = at + 1;
            let expected = || format!("line {number}: found {line:?}, expected a key and a number");
            let (key, value) = line.rsplit_once(' ').with_context(expected)?;
            let value = value.parse().with_context(expected)?;
            if counts.insert(key.trim().to_owned(), value).is_some() {
                bail!("line {number}: the key {key:?} is there twice");
            }
        }
        Ok(Self { counts })
    }

    /// The text of the file.
    pub(crate) fn to_text(&self) -> String {
        let lines = self
            .counts
            .iter()
            .map(|(key, value)| format!("{key} {value}\n"));
        format!("{HEADER}{}", lines.collect::<String>())
    }

    /// Compares what was found with what is permitted.
    pub(crate) fn compare<'a>(&self, measures: &'a [Measure]) -> Comparison<'a> {
        let mut comparison = Comparison::default();
        for measure in measures {
            let Some(permitted) = self.counts.get(&measure.key).copied() else {
                comparison.new.push(measure);
                continue;
            };
            match measure.direction.order(measure.value, permitted) {
                Ordering::Greater => comparison.worse.push((measure, permitted)),
                Ordering::Less => comparison.better.push((measure, permitted)),
                Ordering::Equal => {}
            }
        }
        let is_used = |key: &str| measures.iter().any(|measure| measure.key == key);
        let unused = self.counts.keys().filter(|key| !is_used(key));
        comparison.unused = unused.cloned().collect();
        comparison
    }

    /// What is permitted from now on: the better of both numbers, and what is new.
    pub(crate) fn tightened(&self, measures: &[Measure]) -> Self {
        let counts = measures.iter().map(|measure| {
            let permitted = self.counts.get(&measure.key).copied();
            let value = match permitted {
                Some(permitted)
                    if measure.direction.order(measure.value, permitted) == Ordering::Greater =>
                {
                    permitted
                }
                _ => measure.value,
            };
            (measure.key.clone(), value)
        });
        Self {
            counts: counts.collect(),
        }
    }
}

impl Direction {
    /// `Greater` where a number is worse than the one that is permitted.
    fn order(self, value: usize, permitted: usize) -> Ordering {
        match self {
            Self::MayFall => value.cmp(&permitted),
            Self::MayRise => permitted.cmp(&value),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn measure(key: &str, value: usize, direction: Direction) -> Measure {
        Measure {
            key: key.to_owned(),
            value,
            direction,
            places: Vec::new(),
            of: None,
        }
    }

    fn found() -> Vec<Measure> {
        vec![
            measure("comment-words calib", 7, Direction::MayFall),
            measure("comment-words depth", 3, Direction::MayFall),
            measure("comment-words zed", 5, Direction::MayFall),
            measure("patterns", 21, Direction::MayRise),
            measure("public-items calib", 9, Direction::MayFall),
        ]
    }

    const FILE: &str = "\
# a comment

patterns 22
comment-words calib 6
comment-words depth 4
comment-words zed 5
comment-words gone-crate 2
";

    fn keys(measures: &[(&Measure, usize)]) -> Vec<(String, usize)> {
        measures.iter().map(|(m, n)| (m.key.clone(), *n)).collect()
    }

    #[test]
    fn counts_are_compared_in_their_direction() {
        let found = found();
        let comparison = Ratchet::parse(FILE).expect("a file").compare(&found);
        assert_eq!(
            keys(&comparison.worse),
            [("comment-words calib".into(), 6), ("patterns".into(), 22)]
        );
        assert_eq!(
            keys(&comparison.better),
            [("comment-words depth".into(), 4)]
        );
        assert_eq!(comparison.new.len(), 1);
        assert_eq!(comparison.new[0].key, "public-items calib");
        assert_eq!(comparison.unused, ["comment-words gone-crate"]);
    }

    #[test]
    fn writing_lowers_adds_and_removes_and_never_raises() {
        let before = Ratchet::parse(FILE).expect("a file");
        let text = before.tightened(&found()).to_text();
        let lines: Vec<&str> = text.lines().filter(|line| !line.starts_with('#')).collect();
        assert_eq!(
            lines,
            [
                "comment-words calib 6",
                "comment-words depth 3",
                "comment-words zed 5",
                "patterns 22",
                "public-items calib 9",
            ]
        );
        let again = Ratchet::parse(&text).expect("its own text");
        assert_eq!(again, before.tightened(&found()));
        assert_eq!(again.to_text(), text);
    }

    #[test]
    fn the_number_of_patterns_may_rise() {
        let before = Ratchet::parse("patterns 22").expect("a file");
        let more = [measure("patterns", 23, Direction::MayRise)];
        assert!(before.compare(&more).worse.is_empty());
        assert!(before.tightened(&more).to_text().ends_with("patterns 23\n"));
    }

    #[test]
    fn a_line_that_is_no_count_is_refused() {
        for (text, expected) in [
            ("a 1\nb", "line 2"),
            ("a b", "line 1"),
            ("a -1", "line 1"),
            ("<<<<<<< ours\na 1", "line 1"),
            ("a 1\na 2", "twice"),
        ] {
            let error = format!("{:#}", Ratchet::parse(text).expect_err(text));
            assert!(error.contains(expected), "{text:?}: {error}");
        }
    }
}
