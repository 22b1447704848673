//! The counts of a survey as keys of `docs/tidy.txt`.

use super::place::Place;
use super::ratchet::{Direction, Measure};
use super::survey::{Crate, Survey};

/// More hits than this in 1000 words of its comments are too many for a crate.
pub(crate) const MAX_HITS_PER_1000: usize = 10;

/// Key of the number of files in the largest circle of a crate.
pub(crate) const LARGEST_CIRCLE: &str = "largest-circle";

/// What `--list` calls the words of pages and those of charts. No crate has one of these names.
const MARKDOWN: &str = "markdown";
const CHARTS: &str = "svg";

/// Every count, with the places behind it.
pub(crate) fn measures(survey: &Survey) -> Vec<Measure> {
    let mut measures: Vec<Measure> = survey.crates.iter().flat_map(of_crate).collect();
    measures.push(fall(
        "markdown-words",
        Some(MARKDOWN),
        &survey.markdown.hits,
    ));
    measures.push(fall("chart-words", Some(CHARTS), &survey.charts.hits));
    let participles = survey.crates.iter().flat_map(|c| &c.participles);
    let participles: Vec<Place> = participles.cloned().collect();
    measures.push(fall("type-name-participles", None, &participles));
    let over: Vec<Place> = survey.crates.iter().filter_map(over_limit).collect();
    measures.push(fall("crates-over-limit", None, &over));
    for breaches in &survey.breaches {
        let key = format!("breaches {}", breaches.key);
        measures.push(fall(&key, None, &breaches.places));
    }
    measures.push(fall("packages-without-layer", None, &survey.without_layer));
    measures.push(fall("packages-and-folders-unnamed", None, &survey.unnamed));
    measures.push(Measure {
        key: "patterns".to_owned(),
        value: survey.patterns,
        direction: Direction::MayRise,
        places: Vec::new(),
        of: None,
    });
    measures
}

/// Hits in 1000 words of the comments of a crate.
pub(crate) fn hits_per_1000(counts: &Crate) -> f64 {
    let words = counts.comments.words.max(1);
    counts.comments.hits.len() as f64 * 1000.0 / words as f64
}

/// The crate, if it has too many hits for its words.
fn over_limit(counts: &Crate) -> Option<Place> {
    let is_over = counts.comments.hits.len() * 1000 > MAX_HITS_PER_1000 * counts.comments.words;
    is_over.then(|| {
        let text = format!(
            "{} has {:.1} dropped words in 1000 of its comments, at most {MAX_HITS_PER_1000} are permitted",
            counts.name,
            hits_per_1000(counts)
        );
        Place::new(&counts.manifest, 1, text)
    })
}

fn of_crate(counts: &Crate) -> Vec<Measure> {
    let name = counts.name.as_str();
    let measure =
        |what: &str, places: &[Place]| fall(&format!("{what} {name}"), Some(name), places);
    let uses = counts.circles.iter().flat_map(|circle| &circle.uses);
    let uses: Vec<Place> = uses.cloned().collect();
    let sizes = counts.circles.iter().map(|circle| circle.files.len());
    let mut measures = vec![
        measure("comment-words", &counts.comments.hits),
        measure("string-words", &counts.strings),
        measure("wide-comments", &counts.wide_comments),
        measure("long-files", &counts.long_files),
        measure("long-functions", &counts.long_functions),
        Measure {
            value: sizes.clone().max().unwrap_or(0),
            ..measure(LARGEST_CIRCLE, &uses)
        },
        Measure {
            value: sizes.sum(),
            ..measure("files-in-circles", &uses)
        },
    ];
    if counts.is_library {
        measures.push(measure("public-items", &counts.public_items));
        measures.push(measure("public-modules", &counts.public_modules));
    }
    measures
}

/// A count of places.
fn fall(key: &str, of: Option<&str>, places: &[Place]) -> Measure {
    Measure {
        key: key.to_owned(),
        value: places.len(),
        direction: Direction::MayFall,
        places: places.to_vec(),
        of: of.map(str::to_owned),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::tidy::files::File;
    use crate::tidy::patterns::Patterns;
    use crate::tidy::survey::survey;

    fn found(texts: &[(&str, &str)]) -> Vec<(String, usize)> {
        let files: Vec<File> = texts
            .iter()
            .map(|(path, text)| File {
                path: (*path).to_owned(),
                text: (*text).to_owned(),
            })
            .collect();
        let patterns = Patterns::parse("told").expect("patterns");
        let survey = survey(&files, &patterns).expect("a survey");
        let measures = measures(&survey).into_iter();
        measures
            .map(|measure| (measure.key, measure.value))
            .collect()
    }

    fn value(found: &[(String, usize)], key: &str) -> Option<usize> {
        let row = found.iter().find(|(known, _)| known == key);
        row.map(|(_, value)| *value)
    }

    #[test]
    fn every_count_has_a_key() {
        let found = found(&[
            ("ARCHITECTURE.md", "`calib` told"),
            ("calib/Cargo.toml", "[package]\nname = \"calib\""),
            (
                "calib/src/lib.rs",
                "mod a; mod b; mod c; mod d; mod e; pub use a::A; // told",
            ),
            (
                "calib/src/a.rs",
                "use crate::b::B; fn f() { g(\"is told\") }",
            ),
            ("calib/src/b.rs", "use crate::a::A;"),
            ("calib/src/c.rs", "use crate::d::D; struct Seen;"),
            ("calib/src/d.rs", "use crate::e::E;"),
            ("calib/src/e.rs", "use crate::c::C;"),
            ("calib/src/wide.rs", &format!("// {}", "wide ".repeat(20))),
            ("lens/Cargo.toml", "[package]\nname = \"lens\""),
            ("lens/src/main.rs", "// It is so."),
        ]);
        for (key, expected) in [
            ("comment-words calib", Some(1)),
            ("string-words calib", Some(1)),
            ("wide-comments calib", Some(1)),
            ("wide-comments lens", Some(0)),
            ("largest-circle calib", Some(3)),
            ("files-in-circles calib", Some(5)),
            ("public-items calib", Some(1)),
            ("public-modules calib", Some(0)),
            ("long-files lens", Some(0)),
            ("long-functions lens", Some(0)),
            ("public-items lens", None),
            ("markdown-words", Some(1)),
            ("chart-words", Some(0)),
            ("type-name-participles", Some(1)),
            ("crates-over-limit", Some(1)),
            ("breaches program-on-program", Some(0)),
            ("packages-without-layer", Some(1)),
            ("packages-and-folders-unnamed", Some(2)),
            ("patterns", Some(1)),
        ] {
            assert_eq!(value(&found, key), expected, "{key}");
        }
    }

    #[test]
    fn the_limit_is_ten_in_a_thousand() {
        let comment = |words: usize| format!("// told {}", "word ".repeat(words - 1));
        let over = |words: usize| {
            let found = found(&[
                ("calib/Cargo.toml", "[package]\nname = \"calib\""),
                ("calib/src/lib.rs", &comment(words)),
            ]);
            value(&found, "crates-over-limit")
        };
        assert_eq!(over(99), Some(1));
        assert_eq!(over(100), Some(0));
    }
}
