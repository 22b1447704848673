//! What `cargo xtask tidy` prints.

use std::fmt::Write as _;

use super::measures::{LARGEST_CIRCLE, MAX_HITS_PER_1000, hits_per_1000};
use super::place::Place;
use super::ratchet::{Comparison, Measure};
use super::size::{MAX_FILE_LINES, MAX_FUNCTION_LINES};
use super::survey::{Circle, Crate, Survey};
use super::width::MAX_COMMENT_COLUMNS;

/// How many places are listed of one count.
const MAX_PLACES: usize = 40;

/// How many files of a circle are named.
const MAX_MEMBERS: usize = 8;

/// The table of the crates, circles, pages and charts, and breaches.
pub(crate) fn overview(survey: &Survey) -> String {
    let mut text = table(survey);
    let circles = survey.crates.iter().filter(|c| !c.circles.is_empty());
    let circles: Vec<&Crate> = circles.collect();
    if !circles.is_empty() {
        text.push_str("\nCircles of files that use each other:\n");
    }
    for counts in circles {
        for circle in &counts.circles {
            let _ = writeln!(text, "  {}: {}", counts.name, members(circle));
        }
    }
    let (markdown, charts) = (&survey.markdown, &survey.charts);
    let _ = writeln!(
        text,
        "\nMarkdown: {} words, {} dropped ones. Charts: {} words, {} dropped ones.",
        markdown.words,
        markdown.hits.len(),
        charts.words,
        charts.hits.len()
    );
    let breaches = survey.breaches.iter();
    let breaches: Vec<&Place> = breaches.flat_map(|rule| &rule.places).collect();
    section(&mut text, "Breaches of the layers", &breaches);
    let without: Vec<&Place> = survey.without_layer.iter().collect();
    section(&mut text, "Packages without a layer", &without);
    let unnamed: Vec<&Place> = survey.unnamed.iter().collect();
    section(
        &mut text,
        "Packages and folders that ARCHITECTURE.md does not name",
        &unnamed,
    );
    text
}

/// The counts that are worse, with their places, those that are new and those that fell.
pub(crate) fn comparison(comparison: &Comparison<'_>) -> String {
    let mut text = String::new();
    for (measure, permitted) in &comparison.worse {
        let found = measure.value;
        let _ = writeln!(
            text,
            "\n{}: found {found}, permitted {permitted}",
            measure.key
        );
        places(&mut text, measure);
    }
    for measure in &comparison.new {
        let _ = writeln!(
            text,
            "not in docs/tidy.txt: {} {}",
            measure.key, measure.value
        );
    }
    for (measure, permitted) in &comparison.better {
        let _ = writeln!(
            text,
            "better: {} {}, permitted {permitted}",
            measure.key, measure.value
        );
    }
    for key in &comparison.unused {
        let _ = writeln!(text, "no longer counted: {key}");
    }
    text
}

/// Every place of the counts, or of those of one crate, in the order of the paths.
pub(crate) fn list<'a>(measures: &'a [Measure], of: Option<&str>) -> Vec<&'a Place> {
    // Both counts of circles have the same places.
    let chosen = measures
        .iter()
        .filter(|measure| !measure.key.starts_with(LARGEST_CIRCLE))
        .filter(|measure| of.is_none() || measure.of.as_deref() == of);
    let mut places: Vec<&Place> = chosen.flat_map(|measure| &measure.places).collect();
    places.sort();
    places
}

fn table(survey: &Survey) -> String {
    let width = survey.crates.iter().map(|counts| counts.name.len());
    let width = width.max().unwrap_or(0).max("crate".len());
    let mut text = String::new();
    let heading = [
        "words",
        "hits",
        "/1000",
        "strings",
        &format!("wide>{MAX_COMMENT_COLUMNS}"),
        &format!("files>{MAX_FILE_LINES}"),
        &format!("fns>{MAX_FUNCTION_LINES}"),
        "circle",
        "public",
        "modules",
    ]
    .map(str::to_owned);
    row(&mut text, width, "crate", &heading);
    let mut total = Crate::default();
    for counts in &survey.crates {
        let largest = counts
            .circles
            .first()
            .map_or(0, |circle| circle.files.len());
        let public = |places: &[Place]| match counts.is_library {
            true => places.len().to_string(),
            false => String::new(),
        };
        let columns = [
            counts.comments.words.to_string(),
            counts.comments.hits.len().to_string(),
            format!("{:.1}", hits_per_1000(counts)),
            counts.strings.len().to_string(),
            counts.wide_comments.len().to_string(),
            counts.long_files.len().to_string(),
            counts.long_functions.len().to_string(),
            largest.to_string(),
            public(&counts.public_items),
            public(&counts.public_modules),
        ];
        row(&mut text, width, &counts.name, &columns);
        total.comments.words += counts.comments.words;
        total.comments.hits.extend_from_slice(&counts.comments.hits);
    }
    let sum = |of: fn(&Crate) -> usize| survey.crates.iter().map(of).sum::<usize>().to_string();
    let columns = [
        total.comments.words.to_string(),
        total.comments.hits.len().to_string(),
        format!("{:.1}", hits_per_1000(&total)),
        sum(|counts| counts.strings.len()),
        sum(|counts| counts.wide_comments.len()),
        sum(|counts| counts.long_files.len()),
        sum(|counts| counts.long_functions.len()),
        String::new(),
        sum(|counts| counts.public_items.len()),
        sum(|counts| counts.public_modules.len()),
    ];
    row(&mut text, width, "all", &columns);
    let over = survey
        .crates
        .iter()
        .filter(|counts| hits_per_1000(counts) > MAX_HITS_PER_1000 as f64);
    let _ = writeln!(
        text,
        "\n{} of {} crates have more than {MAX_HITS_PER_1000} dropped words in 1000 of their comments.",
        over.count(),
        survey.crates.len()
    );
    text
}

fn row(text: &mut String, width: usize, name: &str, columns: &[String; 10]) {
    const WIDTHS: [usize; 10] = [8, 6, 7, 9, 10, 11, 9, 8, 8, 9];
    let _ = write!(text, "{name:width$}");
    for (column, width) in columns.iter().zip(WIDTHS) {
        let _ = write!(text, "{column:>width$}");
    }
    text.truncate(text.trim_end().len());
    text.push('\n');
}

fn members(circle: &Circle) -> String {
    let named: Vec<&str> = circle.files.iter().map(String::as_str).collect();
    let (shown, more) = named.split_at(named.len().min(MAX_MEMBERS));
    let more = match more.len() {
        0 => String::new(),
        number => format!(" and {number} more"),
    };
    format!("{} files: {}{more}", named.len(), shown.join(", "))
}

fn section(text: &mut String, heading: &str, places: &[&Place]) {
    let _ = writeln!(text, "{heading}: {}", places.len());
    for place in places {
        let _ = writeln!(text, "  {place}");
    }
}

fn places(text: &mut String, measure: &Measure) {
    for place in measure.places.iter().take(MAX_PLACES) {
        let _ = writeln!(text, "  {place}");
    }
    if measure.places.len() > MAX_PLACES {
        let of = measure.of.as_deref().unwrap_or_default();
        let list = format!("cargo xtask tidy --list {of}");
        let more = measure.places.len() - MAX_PLACES;
        let _ = writeln!(text, "  and {more} more: {}", list.trim_end());
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::tidy::facts::Texts;
    use crate::tidy::ratchet::Direction;

    fn hits(number: usize) -> Vec<Place> {
        let places = (0..number).map(|line| Place::new("calib/src/a.rs", line + 1, "a hit"));
        places.collect()
    }

    fn survey() -> Survey {
        let calib = Crate {
            name: "calib".into(),
            is_library: true,
            comments: Texts {
                words: 3000,
                hits: hits(45),
            },
            circles: vec![Circle {
                files: (0..10).map(|at| format!("{at}.rs")).collect(),
                uses: hits(2),
            }],
            public_items: hits(7),
            ..Crate::default()
        };
        let collector = Crate {
            name: "collector".into(),
            comments: Texts {
                words: 1000,
                hits: hits(10),
            },
            strings: hits(4),
            wide_comments: hits(3),
            ..Crate::default()
        };
        Survey {
            crates: vec![calib, collector],
            markdown: Texts::default(),
            charts: Texts::default(),
            breaches: Vec::new(),
            without_layer: vec![Place::new(
                "lens/Cargo.toml",
                1,
                "lens is in no known layer",
            )],
            unnamed: Vec::new(),
            patterns: 1,
        }
    }

    #[test]
    fn the_overview_has_every_crate_and_its_counts() {
        let text = overview(&survey());
        let columns = |name: &str| {
            let line = text.lines().find(|line| line.starts_with(name));
            let line = line.unwrap_or_else(|| panic!("{name} in:\n{text}"));
            line.split_whitespace()
                .skip(1)
                .collect::<Vec<_>>()
                .join(" ")
        };
        assert_eq!(columns("calib"), "3000 45 15.0 0 0 0 0 10 7 0");
        assert_eq!(columns("collector"), "1000 10 10.0 4 3 0 0 0");
        assert_eq!(columns("all"), "4000 55 13.8 4 3 0 0 7 0");
        for part in [
            "\n1 of 2 crates have more than 10",
            "  calib: 10 files: 0.rs, 1.rs, 2.rs, 3.rs, 4.rs, 5.rs, 6.rs, 7.rs and 2 more\n",
            "\nBreaches of the layers: 0\n",
            "\nPackages without a layer: 1\n  lens/Cargo.toml:1: lens is in no known layer\n",
        ] {
            assert!(text.contains(part), "{part:?} in:\n{text}");
        }
    }

    fn measure(key: &str, of: &str, places: Vec<Place>) -> Measure {
        Measure {
            key: key.into(),
            value: places.len(),
            direction: Direction::MayFall,
            places,
            of: Some(of.into()),
        }
    }

    #[test]
    fn a_worse_count_lists_its_places_up_to_a_number() {
        let measure = measure("comment-words calib", "calib", hits(45));
        let text = comparison(&Comparison {
            worse: vec![(&measure, 44)],
            ..Comparison::default()
        });
        assert!(
            text.starts_with("\ncomment-words calib: found 45, permitted 44\n"),
            "{text}"
        );
        assert_eq!(text.matches("calib/src/a.rs:").count(), 40);
        assert!(
            text.ends_with("and 5 more: cargo xtask tidy --list calib\n"),
            "{text}"
        );
    }

    #[test]
    fn the_list_of_a_crate_has_its_places_once() {
        let measures = [
            measure("largest-circle calib", "calib", hits(2)),
            measure("files-in-circles calib", "calib", hits(2)),
            measure("comment-words zed", "zed", hits(1)),
        ];
        assert_eq!(list(&measures, Some("calib")).len(), 2);
        assert_eq!(list(&measures, Some("other")).len(), 0);
        assert_eq!(list(&measures, None).len(), 3);
    }
}
