//! Names of types that are past participles: what was done to a thing does not say what it is.
//!
//! The names of variants do not count: they are states, and a state is a participle.

use super::place::Place;
use super::source::Token;

/// Participles that do not end in `-ed`.
const IRREGULAR: [&str; 26] = [
    "Built",
    "Chosen",
    "Done",
    "Drawn",
    "Found",
    "Given",
    "Gone",
    "Heard",
    "Held",
    "Hidden",
    "Kept",
    "Known",
    "Left",
    "Lost",
    "Made",
    "Said",
    "Seen",
    "Sent",
    "Shown",
    "Taken",
    "Thrown",
    "Told",
    "Understood",
    "Unseen",
    "Worn",
    "Written",
];

/// What ends in `-ed` and is a noun, or is what Tokio calls such a thing: the state behind an
/// `Arc`, and a time limit that is over.
const NOUNS: [&str; 8] = [
    "Bed", "Elapsed", "Embed", "Feed", "Led", "Seed", "Shared", "Speed",
];

/// The types, traits and aliases of a file, tests included, whose name ends in a participle.
pub(crate) fn participles(path: &str, code: &[Token<'_>]) -> Vec<Place> {
    let pairs = code.iter().zip(code.iter().skip(1));
    let named = pairs.filter(|(keyword, name)| {
        let keywords = ["struct", "enum", "union", "trait", "type"];
        keywords.iter().any(|word| keyword.is_word(word))
            && name.is_name()
            && is_participle(last_word(name.text))
    });
    named
        .map(|(keyword, name)| {
            Place::new(path, name.line, format!("{} {}", keyword.text, name.text))
        })
        .collect()
}

/// `Case` of `CamelCase`.
fn last_word(name: &str) -> &str {
    let start = name.rfind(|c: char| c.is_uppercase()).unwrap_or(0);
    &name[start..]
}

fn is_participle(word: &str) -> bool {
    // `Need`: a word in `-eed` has no stem.
    let is_regular = word.ends_with("ed") && !word.ends_with("eed");
    (is_regular && !NOUNS.contains(&word)) || IRREGULAR.contains(&word)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::tidy::source::lex;

    fn of(text: &str) -> Vec<String> {
        let places = participles("calib/src/a.rs", &lex(text).code).into_iter();
        places.map(|place| place.to_string()).collect()
    }

    #[test]
    fn types_traits_and_aliases_count_in_tests_too() {
        assert_eq!(
            of(
                "pub struct Seen;\nenum SampleDropped { A }\ntrait Scaled {}\n\
                #[cfg(test)] mod tests { type Found = u8; }"
            ),
            [
                "calib/src/a.rs:1: struct Seen",
                "calib/src/a.rs:2: enum SampleDropped",
                "calib/src/a.rs:3: trait Scaled",
                "calib/src/a.rs:4: type Found",
            ]
        );
    }

    #[test]
    fn nouns_variants_and_functions_do_not_count() {
        for text in [
            "struct Speed; struct PixelSeed; enum Need {} struct Shared; struct Elapsed;",
            "struct SeenPoints; struct TrainedScene;",
            "enum Status { Lost, Held }",
            "fn found() {} const FOUND: u8 = 1; // struct Seen",
        ] {
            assert!(of(text).is_empty(), "{text}");
        }
    }
}
