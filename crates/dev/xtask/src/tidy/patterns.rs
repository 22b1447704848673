//! The words and phrases that are to be dropped, `docs/dropped-words.txt`, and where a text has
//! them.
//!
//! One pattern a line, `#` begins a comment. A pattern is one or more words. In parentheses
//! directly behind a word stand endings that may follow it: `image(s)` is `image` and `images`.
//! Case does not matter, only whole words count, and a phrase may cross the end of a line but
//! nothing else than blanks.

use std::collections::HashMap;

use anyhow::{Result, bail, ensure};

use super::prose::{self, Word};

/// The patterns, found by their first word.
#[derive(Debug, Default)]
pub(crate) struct Patterns {
    by_first: HashMap<String, Vec<Pattern>>,
    number: usize,
    longest: usize,
}

#[derive(Clone, Debug)]
struct Pattern {
    /// As the file has it.
    text: String,
    /// The words behind the first, each in every form.
    behind: Vec<Vec<String>>,
}

/// What a text has.
#[derive(Debug, Default, PartialEq)]
pub(crate) struct Count {
    /// Number of words, without numbers.
    pub(crate) words: usize,
    pub(crate) hits: Vec<Hit>,
}

/// A place where a pattern matches.
#[derive(Debug, PartialEq)]
pub(crate) struct Hit {
    /// Counted from the first line of the text, which is 0.
    pub(crate) line: usize,
    /// The pattern, as the file has it.
    pub(crate) pattern: String,
}

impl Patterns {
    /// Reads the file.
    pub(crate) fn parse(text: &str) -> Result<Self> {
        let mut patterns = Self::default();
        let mut known = Vec::new();
        for (line, content) in text.lines().enumerate() {
            let pattern = content.split('#').next().unwrap_or_default().trim();
            if pattern.is_empty() {
                continue;
            }
            let lower = pattern.to_lowercase();
            if known.contains(&lower) {
                bail!("line {}: the pattern {pattern:?} is there twice", line + 1);
            }
            let mut forms = Vec::new();
            for word in lower.split_whitespace() {
                let Some(word) = forms_of(word) else {
                    bail!(
                        "line {}: found {word:?} in the pattern {pattern:?}, expected letters, \
                         then possibly endings as in track(ed|s)",
                        line + 1
                    );
                };
                forms.push(word);
            }
            patterns.add(pattern, &forms);
            known.push(lower);
        }
        ensure!(patterns.number > 0, "found no pattern");
        Ok(patterns)
    }

    /// How many patterns there are.
    pub(crate) fn number(&self) -> usize {
        self.number
    }

    /// Counts the words of a text, and where patterns match. Matches do not overlap; of several
    /// that begin at one word the longest counts.
    pub(crate) fn count(&self, text: &str) -> Count {
        let words = prose::words(text);
        let mut count = Count {
            words: words.iter().filter(|word| word.has_letter()).count(),
            hits: Vec::new(),
        };
        let mut at = 0;
        while at < words.len() {
            match self.matching(&words[at..]) {
                Some(pattern) => {
                    count.hits.push(Hit {
                        line: words[at].line,
                        pattern: pattern.text.clone(),
                    });
                    at += 1 + pattern.behind.len();
                }
                None => at += 1,
            }
        }
        count
    }

    fn add(&mut self, text: &str, forms: &[Vec<String>]) {
        let Some((first, behind)) = forms.split_first() else {
            return;
        };
        self.number += 1;
        for form in first {
            self.longest = self.longest.max(form.len());
            let same_first = self.by_first.entry(form.clone()).or_default();
            same_first.push(Pattern {
                text: text.to_owned(),
                behind: behind.to_vec(),
            });
            same_first.sort_by_key(|pattern| std::cmp::Reverse(pattern.behind.len()));
        }
    }

    /// The pattern that matches at the first of the words.
    fn matching(&self, words: &[Word<'_>]) -> Option<&Pattern> {
        let (first, behind) = words.split_first()?;
        if first.text.len() > self.longest {
            return None;
        }
        let candidates = self.by_first.get(&first.text.to_lowercase())?;
        candidates.iter().find(|pattern| {
            pattern.behind.len() <= behind.len()
                && pattern.behind.iter().zip(behind).all(|(forms, word)| {
                    word.follows && forms.iter().any(|form| *form == word.text.to_lowercase())
                })
        })
    }
}

/// Every form of a word with endings in parentheses; `None` where that is not what it is.
fn forms_of(word: &str) -> Option<Vec<String>> {
    let is_word = |text: &str| !text.is_empty() && text.chars().all(char::is_alphabetic);
    let (stem, endings) = match word.split_once('(') {
        None => (word, None),
        Some((stem, rest)) => (stem, Some(rest.strip_suffix(')')?)),
    };
    let mut forms = vec![stem.to_owned()];
    for ending in endings.into_iter().flat_map(|endings| endings.split('|')) {
        if !is_word(ending) {
            return None;
        }
        forms.push(format!("{stem}{ending}"));
    }
    is_word(stem).then_some(forms)
}

#[cfg(test)]
mod tests {
    use super::*;

    const FILE: &str = "\
# what to drop
told
doubt(ed|ful|s)   # and its kin
the way
sight(s) off by
off by
";

    fn hits(text: &str) -> Vec<(usize, String)> {
        let patterns = Patterns::parse(FILE).expect("patterns");
        let hits = patterns.count(text).hits.into_iter();
        hits.map(|hit| (hit.line, hit.pattern)).collect()
    }

    #[test]
    fn endings_make_forms_of_a_word() {
        for word in ["doubt", "doubted", "Doubtful", "DOUBTS"] {
            assert_eq!(hits(word), [(0, "doubt(ed|ful|s)".into())], "{word}");
        }
        for word in ["doubting", "doubtfully", "redoubt", "is_told", "told_"] {
            assert_eq!(hits(word), [], "{word}");
        }
    }

    #[test]
    fn phrases_cross_the_end_of_a_line_and_nothing_else() {
        assert_eq!(hits("x\nalong the\nway"), [(1, "the way".into())]);
        for text in [
            "the, way",
            "the `x` way",
            "the-way",
            "the 3 way",
            "the\n\nway",
            "the ways",
        ] {
            assert_eq!(hits(text), [], "{text:?}");
        }
    }

    #[test]
    fn the_longest_of_the_patterns_counts_and_none_overlaps() {
        assert_eq!(hits("Sights off by 3"), [(0, "sight(s) off by".into())]);
        assert_eq!(hits("off by off by").len(), 2);
        assert_eq!(hits("sights off"), []);
    }

    #[test]
    fn words_are_counted_without_code_and_numbers() {
        let patterns = Patterns::parse(FILE).expect("patterns");
        let count = patterns.count("Told `told` 3 times, the rig's [way](told.md).");
        assert_eq!((count.words, count.hits.len()), (5, 1));
    }

    #[test]
    fn a_pattern_that_cannot_match_is_refused() {
        for (text, expected) in [
            ("told\ndoubt(ed", "line 2"),
            ("doubt(ed|)", "line 1"),
            ("a-b", "line 1"),
            ("(s)", "line 1"),
            ("told\nTold", "twice"),
            ("# nothing", "no pattern"),
        ] {
            let error = Patterns::parse(text).expect_err(text).to_string();
            assert!(error.contains(expected), "{text:?}: {error}");
        }
        assert_eq!(Patterns::parse(FILE).expect("patterns").number(), 5);
    }

    #[test]
    fn the_file_of_this_repository_can_be_read() {
        let text = include_str!("../../../../../docs/dropped-words.txt");
        let patterns = Patterns::parse(text).expect("patterns");
        assert_eq!(patterns.count("A sight of many pictures").hits.len(), 2);
    }
}
