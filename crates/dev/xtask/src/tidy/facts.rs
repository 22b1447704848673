//! What one file contributes to the counts, found from its text alone.

use super::comments;
use super::files::{File, file_name};
use super::outline::{self, Outline};
use super::patterns::Patterns;
use super::place::Place;
use super::size;
use super::source::{Kind, Source, Token, lex};
use super::strings;
use super::test_code::{self, TestCode};
use super::type_names;
use super::width;

/// Words and hits of the patterns.
#[derive(Debug, Default)]
pub(crate) struct Texts {
    pub(crate) words: usize,
    pub(crate) hits: Vec<Place>,
}

/// What is in a file of Rust or in a schema.
#[derive(Debug, Default)]
pub(crate) struct Facts {
    pub(crate) comments: Texts,
    /// Of files of Rust only.
    pub(crate) wide_comments: Vec<Place>,
    /// Types whose name is a participle, in files of Rust.
    pub(crate) participles: Vec<Place>,
    /// Paths without extension of the modules that it declares for tests only.
    pub(crate) test_modules: Vec<String>,
    /// What does not count where the file is for tests; `None` where its path says so, and for a
    /// schema.
    pub(crate) code: Option<CodeFacts>,
}

/// What is in the code of a file, without the parts for tests.
#[derive(Debug)]
pub(crate) struct CodeFacts {
    pub(crate) strings: Vec<Place>,
    pub(crate) outline: Outline,
    pub(crate) long_file: Option<Place>,
    pub(crate) long_functions: Vec<Place>,
    pub(crate) public_items: Vec<Place>,
    /// Of `lib.rs` only.
    pub(crate) public_modules: Vec<Place>,
}

impl Texts {
    /// Adds a text that begins on a line of a file. `kind` says what it is.
    pub(crate) fn add(
        &mut self,
        file: &File,
        line: usize,
        text: &str,
        kind: &str,
        patterns: &Patterns,
    ) {
        let count = patterns.count(text);
        self.words += count.words;
        for hit in count.hits {
            let line = line + hit.line;
            let lines = &mut file.text.lines();
            let shown = shown_line(lines.nth(line.saturating_sub(1)).unwrap_or_default());
            let text = format!("{kind}, {}: {shown}", hit.pattern);
            self.hits.push(Place::new(&file.path, line, text));
        }
    }
}

/// Reads a `.rs` or `.proto` file. `package` is the folder of its package.
pub(crate) fn of(file: &File, package: &str, patterns: &Patterns) -> Facts {
    let source = lex(&file.text);
    let mut facts = Facts::default();
    for block in comments::blocks(&source.comments) {
        facts
            .comments
            .add(file, block.line, &block.text, "comment", patterns);
    }
    if file.extension() != "rs" {
        return facts;
    }
    facts.wide_comments = width::wide_comments(file, &source.comments);
    facts.participles = type_names::participles(&file.path, &source.code);
    let tests = test_code::find(&source.code);
    let modules = tests.modules.iter();
    facts.test_modules = modules
        .map(|module| test_code::module_stem(&file.path, module))
        .collect();
    if !test_code::is_test_path(&file.path, package) {
        facts.code = Some(code_facts(file, &source, &tests, patterns));
    }
    facts
}

fn code_facts(
    file: &File,
    source: &Source<'_>,
    tests: &TestCode,
    patterns: &Patterns,
) -> CodeFacts {
    let path = file.path.as_str();
    let code: Vec<Token<'_>> = tests.without(&source.code);
    let mut texts = Texts::default();
    for token in &code {
        if let Kind::Text { raw } = token.kind
            && token.text.contains(' ')
        {
            let text = strings::text(token.text, raw);
            texts.add(file, token.line, &text, "string", patterns);
        }
    }
    let public_modules = if file_name(path) == "lib.rs" {
        size::public_modules(path, &code)
    } else {
        Vec::new()
    };
    CodeFacts {
        strings: texts.hits,
        outline: outline::read(&code),
        long_file: size::long_file(path, size::lines(&file.text, &source.code, tests)),
        long_functions: size::long_functions(path, &code),
        public_items: size::public_items(path, &code),
        public_modules,
    }
}

/// A line as lists show it: without its indent, and cut where it is long.
pub(crate) fn shown_line(line: &str) -> String {
    const MAX_CHARACTERS: usize = 120;
    let line = line.trim();
    match line.char_indices().nth(MAX_CHARACTERS) {
        Some((end, _)) => format!("{}…", &line[..end]),
        None => line.to_owned(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn facts(path: &str, text: &str) -> Facts {
        let patterns = Patterns::parse("told\nthe way").expect("patterns");
        let file = File {
            path: path.to_owned(),
            text: text.to_owned(),
        };
        of(&file, "calib", &patterns)
    }

    fn shown(places: &[Place]) -> Vec<String> {
        places.iter().map(Place::to_string).collect()
    }

    const TEXT: &str = r#"
/// What is told on the
/// way, and `told`.
fn f() {
    print("told", "it is told", "{told} told\n");
}
#[cfg(test)]
mod made;
#[cfg(test)]
mod tests {
    // Told in a test.
    const A: &str = "told in a test";
}
"#;

    #[test]
    fn comments_count_everywhere_and_strings_outside_tests() {
        let facts = facts("calib/src/a.rs", TEXT);
        assert_eq!(
            shown(&facts.comments.hits),
            [
                "calib/src/a.rs:2: comment, told: /// What is told on the",
                "calib/src/a.rs:2: comment, the way: /// What is told on the",
                "calib/src/a.rs:11: comment, told: // Told in a test.",
            ]
        );
        assert_eq!(facts.comments.words, 11);
        assert_eq!(facts.test_modules, ["calib/src/a/made"]);
        let code = facts.code.expect("code");
        assert_eq!(
            shown(&code.strings),
            [
                "calib/src/a.rs:5: string, told: print(\"told\", \"it is told\", \"{told} told\\n\");",
                "calib/src/a.rs:5: string, told: print(\"told\", \"it is told\", \"{told} told\\n\");",
            ]
        );
    }

    #[test]
    fn a_file_for_tests_has_comments_only() {
        for path in ["calib/tests/it.rs", "calib/src/a/tests.rs"] {
            let facts = facts(path, TEXT);
            assert_eq!(facts.comments.hits.len(), 3, "{path}");
            assert!(facts.code.is_none(), "{path}");
        }
    }

    #[test]
    fn a_schema_has_comments_only() {
        let facts = facts("calib/a.proto", "// told\nimport \"is told.proto\";");
        assert_eq!(facts.comments.hits.len(), 1);
        assert!(facts.code.is_none());
    }

    #[test]
    fn long_lines_are_cut_between_characters() {
        let line = "é".repeat(200);
        assert_eq!(shown_line(&line).chars().count(), 121);
        assert_eq!(shown_line("  b"), "b");
    }
}
