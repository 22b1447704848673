//! Everything that is counted, for the whole repository.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::atomic::{AtomicUsize, Ordering};

use anyhow::{Result, anyhow};

use super::charts;
use super::circles;
use super::dependencies::{self, Breaches};
use super::facts::{self, Facts, Texts};
use super::files::{File, file_name, folder};
use super::manifest::{self, Package};
use super::modules::{self, ModuleFile};
use super::patterns::Patterns;
use super::place::Place;
use super::test_code;

/// The counts of the repository.
#[derive(Debug)]
pub(crate) struct Survey {
    /// In the order of their names.
    pub(crate) crates: Vec<Crate>,
    pub(crate) markdown: Texts,
    pub(crate) charts: Texts,
    pub(crate) breaches: Vec<Breaches>,
    pub(crate) without_layer: Vec<Place>,
    pub(crate) unnamed: Vec<Place>,
    /// How many patterns of words there are.
    pub(crate) patterns: usize,
}

/// The counts of one package.
#[derive(Debug, Default)]
pub(crate) struct Crate {
    pub(crate) name: String,
    /// Path of its manifest from the repository root.
    pub(crate) manifest: String,
    pub(crate) is_library: bool,
    pub(crate) comments: Texts,
    pub(crate) strings: Vec<Place>,
    pub(crate) wide_comments: Vec<Place>,
    pub(crate) participles: Vec<Place>,
    pub(crate) long_files: Vec<Place>,
    pub(crate) long_functions: Vec<Place>,
    /// The largest first.
    pub(crate) circles: Vec<Circle>,
    pub(crate) public_items: Vec<Place>,
    pub(crate) public_modules: Vec<Place>,
}

/// Files that use each other.
#[derive(Debug)]
pub(crate) struct Circle {
    /// Paths from the folder of the sources.
    pub(crate) files: Vec<String>,
    /// The uses among them, one line for each pair.
    pub(crate) uses: Vec<Place>,
}

/// Pages whose words do not count: the history as it was, and the page that names the words.
const EXEMPT_PAGES: [&str; 2] = ["CHANGELOG.md", "docs/glossary.md"];

/// Counts everything in the files.
pub(crate) fn survey(files: &[File], patterns: &Patterns) -> Result<Survey> {
    let packages: Vec<Package> = files
        .iter()
        .filter(|file| file_name(&file.path) == "Cargo.toml")
        .filter_map(|file| manifest::parse(&file.text, folder(&file.path)))
        .collect();
    let mut names = BTreeSet::new();
    for package in &packages {
        if !names.insert(&package.name) {
            return Err(anyhow!("two packages have the name {}", package.name));
        }
    }

    let folders: BTreeSet<&str> = packages.iter().map(|p| p.folder.as_str()).collect();
    let code: Vec<(&File, &str)> = files
        .iter()
        .filter(|file| matches!(file.extension(), "rs" | "proto"))
        .filter_map(|file| Some((file, package_folder(&file.path, &folders)?)))
        .collect();
    let all_facts = in_parallel(&code, |(file, package)| facts::of(file, package, patterns));
    let mut by_package: BTreeMap<&str, Vec<(&File, Facts)>> = BTreeMap::new();
    for ((file, package), facts) in code.into_iter().zip(all_facts) {
        by_package.entry(package).or_default().push((file, facts));
    }

    let mut crates: Vec<Crate> = packages
        .iter()
        .map(|package| {
            let files = by_package.remove(package.folder.as_str());
            of_package(package, files.unwrap_or_default())
        })
        .collect();
    crates.sort_by(|one, other| one.name.cmp(&other.name));

    let mut markdown = Texts::default();
    let mut chart_texts = Texts::default();
    for file in files {
        let path = file.path.as_str();
        if file.extension() == "md" && !EXEMPT_PAGES.contains(&path) {
            markdown.add(file, 1, &file.text, "page", patterns);
        }
        if file.extension() == "svg" {
            for label in charts::labels(&file.text) {
                chart_texts.add(file, label.line, &label.text, "chart", patterns);
            }
        }
    }
    let architecture = files.iter().find(|file| file.path == "ARCHITECTURE.md");
    let architecture = architecture.map_or("", |file| file.text.as_str());
    let paths = files.iter().map(|file| file.path.as_str());
    Ok(Survey {
        crates,
        markdown,
        charts: chart_texts,
        breaches: dependencies::breaches(&packages),
        without_layer: dependencies::without_layer(&packages),
        unnamed: dependencies::unnamed(architecture, &packages, paths),
        patterns: patterns.number(),
    })
}

/// The folder of the package that a file belongs to: the nearest one above it.
fn package_folder<'a>(path: &str, folders: &BTreeSet<&'a str>) -> Option<&'a str> {
    let mut above = folder(path);
    while !above.is_empty() {
        if let Some(found) = folders.get(above) {
            return Some(found);
        }
        above = folder(above);
    }
    None
}

fn of_package(package: &Package, files: Vec<(&File, Facts)>) -> Crate {
    let source = modules::source_folder(&package.folder);
    let root = format!("{source}/lib.rs");
    let mut counts = Crate {
        name: package.name.clone(),
        manifest: package.manifest(),
        is_library: files.iter().any(|(file, _)| file.path == root),
        ..Crate::default()
    };
    let test_modules: BTreeSet<String> = files
        .iter()
        .flat_map(|(_, facts)| facts.test_modules.iter().cloned())
        .collect();
    let mut outlines = Vec::new();
    for (file, facts) in files {
        let path = file.path.as_str();
        counts.comments.words += facts.comments.words;
        counts.comments.hits.extend(facts.comments.hits);
        counts.wide_comments.extend(facts.wide_comments);
        counts.participles.extend(facts.participles);
        let Some(code) = facts.code else {
            continue;
        };
        if test_code::is_below(path, &test_modules) {
            continue;
        }
        counts.strings.extend(code.strings);
        counts.long_files.extend(code.long_file);
        counts.long_functions.extend(code.long_functions);
        if !modules::is_source(path, &source) {
            continue;
        }
        let of_program =
            file_name(path) == "main.rs" || path.starts_with(&format!("{source}/bin/"));
        if counts.is_library && !of_program {
            counts.public_items.extend(code.public_items);
        }
        if path == root {
            counts.public_modules = code.public_modules;
        }
        outlines.push((path, code.outline));
    }
    counts.circles = circles_of(&source, &outlines);
    counts
}

fn circles_of(source: &str, outlines: &[(&str, super::outline::Outline)]) -> Vec<Circle> {
    let files: Vec<ModuleFile<'_>> = outlines
        .iter()
        .map(|(path, outline)| ModuleFile { path, outline })
        .collect();
    let edges = modules::edges(source, &files);
    let circles = circles::circles(files.len(), &edges).into_iter();
    circles
        .map(|members| {
            let name = |at: usize| modules::short(files[at].path, source);
            let inside = |at: &usize| members.binary_search(at).is_ok();
            let uses = edges
                .iter()
                .filter(|((from, to), _)| inside(from) && inside(to));
            Circle {
                files: members.iter().map(|at| name(*at).to_owned()).collect(),
                uses: uses
                    .map(|((from, to), line)| {
                        let size = members.len();
                        let text = format!("circle of {size} files, uses {}", name(*to));
                        Place::new(files[*from].path, *line, text)
                    })
                    .collect(),
            }
        })
        .collect()
}

/// Does the same work for every item on all processors; the results are in the order of the items.
fn in_parallel<T: Sync, R: Send>(items: &[T], work: impl Fn(&T) -> R + Sync) -> Vec<R> {
    let next = AtomicUsize::new(0);
    let threads = std::thread::available_parallelism().map_or(1, usize::from);
    let mut results: Vec<(usize, R)> = std::thread::scope(|scope| {
        let worker = || {
            let mut results = Vec::new();
            loop {
                let at = next.fetch_add(1, Ordering::Relaxed);
                match items.get(at) {
                    Some(item) => results.push((at, work(item))),
                    None => return results,
                }
            }
        };
        let workers: Vec<_> = (0..threads).map(|_| scope.spawn(worker)).collect();
        let results = workers.into_iter().flat_map(|worker| {
            worker
                .join()
                .unwrap_or_else(|panic| std::panic::resume_unwind(panic))
        });
        results.collect()
    });
    results.sort_by_key(|(at, _)| *at);
    results.into_iter().map(|(_, result)| result).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn files(texts: &[(&str, &str)]) -> Vec<File> {
        let files = texts.iter().map(|(path, text)| File {
            path: (*path).to_owned(),
            text: (*text).to_owned(),
        });
        files.collect()
    }

    fn of(texts: &[(&str, &str)]) -> Survey {
        let patterns = Patterns::parse("told\npicture(s)").expect("patterns");
        survey(&files(texts), &patterns).expect("a survey")
    }

    const CALIB: (&str, &str) = ("calib/Cargo.toml", "[package]\nname = \"calib\"");

    #[test]
    fn files_count_for_the_nearest_package() {
        let survey = of(&[
            CALIB,
            ("calib/src/lib.rs", "// told"),
            ("calib/src/a.proto", "// told"),
            ("calib/fuzz/Cargo.toml", "[package]\nname = \"fuzz\""),
            ("calib/fuzz/a.rs", "// told"),
            ("other.rs", "// told"),
        ]);
        let hits: Vec<_> = survey
            .crates
            .iter()
            .map(|c| (c.name.as_str(), c.comments.hits.len()))
            .collect();
        assert_eq!(hits, [("calib", 2), ("fuzz", 1)]);
    }

    #[test]
    fn modules_for_tests_in_files_of_their_own_count_as_tests() {
        let survey = of(&[
            CALIB,
            (
                "calib/src/lib.rs",
                "#[cfg(test)] mod made; mod a; pub fn f() {}",
            ),
            (
                "calib/src/made.rs",
                "mod deep; pub fn g() { h(\"is told\") } use crate::a;",
            ),
            ("calib/src/made/deep.rs", "pub fn i() { h(\"is told\") }"),
            (
                "calib/src/a.rs",
                "pub fn j() { h(\"is told\") } use crate::f; // told",
            ),
        ]);
        let calib = &survey.crates[0];
        assert_eq!(calib.strings.len(), 1);
        assert_eq!(calib.public_items.len(), 2);
        assert_eq!(calib.circles.len(), 0);
        assert_eq!(calib.comments.hits.len(), 1);
    }

    #[test]
    fn circles_have_their_files_and_the_lines_that_use() {
        let survey = of(&[
            CALIB,
            ("calib/src/lib.rs", "mod a; mod b; mod c;"),
            ("calib/src/a.rs", "\nuse crate::b::B; use crate::c::C;"),
            ("calib/src/b.rs", "fn f() { crate::a::A }"),
            ("calib/src/c.rs", "pub struct C;"),
        ]);
        let [circle] = survey.crates[0].circles.as_slice() else {
            panic!("{:?}", survey.crates[0].circles);
        };
        assert_eq!(circle.files, ["a.rs", "b.rs"]);
        let uses: Vec<String> = circle.uses.iter().map(Place::to_string).collect();
        assert_eq!(
            uses,
            [
                "calib/src/a.rs:2: circle of 2 files, uses b.rs",
                "calib/src/b.rs:1: circle of 2 files, uses a.rs"
            ]
        );
    }

    #[test]
    fn public_items_are_those_of_a_library() {
        let survey = of(&[
            CALIB,
            ("calib/src/lib.rs", "pub mod a; pub fn f() {}"),
            ("calib/src/main.rs", "pub fn g() {}"),
            ("calib/examples/b.rs", "pub fn h() {}"),
            ("collector/Cargo.toml", "[package]\nname = \"collector\""),
            ("collector/src/main.rs", "pub fn i() {}"),
        ]);
        let of_crate = |at: usize| {
            let counts: &Crate = &survey.crates[at];
            (
                counts.is_library,
                counts.public_items.len(),
                counts.public_modules.len(),
            )
        };
        assert_eq!(of_crate(0), (true, 2, 1));
        assert_eq!(of_crate(1), (false, 0, 0));
    }

    #[test]
    fn pages_and_charts_are_counted_apart() {
        let survey = of(&[
            ("README.md", "It is told.\n\n`told`\n"),
            ("calib/NOTES.md", "Pictures"),
            ("CHANGELOG.md", "told"),
            ("docs/glossary.md", "told"),
            ("docs/a.svg", "<title>told</title><text>a picture</text>"),
        ]);
        assert_eq!((survey.markdown.words, survey.markdown.hits.len()), (4, 2));
        assert_eq!((survey.charts.words, survey.charts.hits.len()), (2, 1));
    }

    #[test]
    fn two_packages_of_one_name_are_refused() {
        let patterns = Patterns::parse("told").expect("patterns");
        let two = files(&[CALIB, ("other/Cargo.toml", CALIB.1)]);
        assert!(survey(&two, &patterns).is_err());
    }
}
