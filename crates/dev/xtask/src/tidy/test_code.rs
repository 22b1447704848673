//! Which code is compiled for tests only.
//!
//! Items under `#[cfg(test)]` and `#[test]`, the files of modules declared so, files `tests.rs`,
//! folders `tests`, and the package of that name.

use std::collections::BTreeSet;
use std::ops::Range;

use super::files::{file_name, folder};
use super::source::{Kind, Token};

/// What a file has of tests.
#[derive(Debug, Default, PartialEq)]
pub(crate) struct TestCode {
    /// The tokens of items that are compiled for tests only, attributes included.
    pub(crate) ranges: Vec<Range<usize>>,
    /// Names of modules without a body that are declared for tests only.
    pub(crate) modules: Vec<String>,
}

/// Finds the items for tests in the tokens of a file.
pub(crate) fn find(code: &[Token<'_>]) -> TestCode {
    let mut found = TestCode::default();
    let mut at = 0;
    while at < code.len() {
        if !code[at].is_mark("#") {
            at += 1;
            continue;
        }
        let is_inner = code.get(at + 1).is_some_and(|token| token.is_mark("!"));
        let open = at + 1 + usize::from(is_inner);
        let Some(attribute) = bracketed(code, open) else {
            at += 1;
            continue;
        };
        if !is_for_tests(&code[attribute.clone()]) {
            at = attribute.end + 1;
            continue;
        }
        if is_inner {
            // It is about the file, or about the block that it is in; the former alone is in use.
            found.ranges = std::iter::once(0..code.len()).collect();
            return found;
        }
        let item = after_attributes(code, attribute.end + 1);
        let end = item_end(code, item);
        if let [module, name, mark] = code.get(end.saturating_sub(3)..end).unwrap_or_default()
            && module.is_word("mod")
            && mark.is_mark(";")
        {
            found.modules.push(name.text.to_owned());
        }
        found.ranges.push(at..end);
        at = end.max(at + 1);
    }
    found
}

impl TestCode {
    /// The tokens that are not compiled for tests only.
    pub(crate) fn without<'a>(&self, code: &[Token<'a>]) -> Vec<Token<'a>> {
        let mut left = Vec::with_capacity(code.len());
        let mut at = 0;
        for range in &self.ranges {
            left.extend_from_slice(&code[at..range.start]);
            at = range.end;
        }
        left.extend_from_slice(&code[at..]);
        left
    }

    /// The token with which the items for tests at the end of the file begin.
    pub(crate) fn trailing(&self, code: &[Token<'_>]) -> usize {
        let mut end = code.len();
        for range in self.ranges.iter().rev() {
            if range.end != end {
                break;
            }
            end = range.start;
        }
        end
    }
}

/// Whether a path alone says that the file is for tests. `package` is the folder of its package.
pub(crate) fn is_test_path(path: &str, package: &str) -> bool {
    let inside = path.strip_prefix(package).unwrap_or(path);
    package == "tests"
        || file_name(path) == "tests.rs"
        || folder(inside).split('/').any(|part| part == "tests")
}

/// Files and folders, without an extension, of the modules that a file declares: `src/a.rs` with a
/// module `b` yields `src/a/b`.
pub(crate) fn module_stem(path: &str, module: &str) -> String {
    let folder = module_folder(path);
    format!("{folder}/{module}")
}

/// The folder in which the modules lie that a file declares. Roots of crates are `lib.rs`,
/// `main.rs` and what lies in a folder `bin`.
pub(crate) fn module_folder(path: &str) -> String {
    let name = file_name(path);
    let is_root = matches!(name, "lib.rs" | "main.rs" | "mod.rs" | "build.rs");
    if is_root || folder(path).ends_with("/src/bin") {
        folder(path).to_owned()
    } else {
        path.strip_suffix(".rs").unwrap_or(path).to_owned()
    }
}

/// Whether a file is that of one of the modules, or of a module below one of them.
pub(crate) fn is_below(path: &str, stems: &BTreeSet<String>) -> bool {
    let mut stem = path.strip_suffix(".rs").unwrap_or(path);
    loop {
        if stems.contains(stem) {
            return true;
        }
        match stem.rsplit_once('/') {
            Some((above, _)) => stem = above,
            None => return false,
        }
    }
}

/// What is between the bracket at `open` and its counterpart.
fn bracketed(code: &[Token<'_>], open: usize) -> Option<Range<usize>> {
    if !code.get(open)?.is_mark("[") {
        return None;
    }
    let mut depth = 0;
    for (at, token) in code.iter().enumerate().skip(open) {
        match depth_change(token) {
            1 => depth += 1,
            -1 => depth -= 1,
            _ => {}
        }
        if depth == 0 {
            return Some(open + 1..at);
        }
    }
    None
}

/// Whether an attribute lets its item be compiled in tests only.
fn is_for_tests(attribute: &[Token<'_>]) -> bool {
    match attribute {
        [test] => test.is_word("test"),
        [cfg, open, condition @ .., close] => {
            cfg.is_word("cfg")
                && open.is_mark("(")
                && close.is_mark(")")
                && needs_test(condition).is_some_and(|(needs, _)| needs)
        }
        _ => false,
    }
}

/// Whether the condition that begins here holds in tests only, and where it ends.
fn needs_test(condition: &[Token<'_>]) -> Option<(bool, usize)> {
    let name = condition.first()?;
    if condition.get(1).is_none_or(|token| !token.is_mark("(")) {
        // `test`, or `name`, or `name = "value"`.
        let end = condition
            .iter()
            .position(|t| t.is_mark(",") || t.is_mark(")"));
        return Some((name.is_word("test"), end.unwrap_or(condition.len())));
    }
    let mut parts = Vec::new();
    let mut at = 2;
    while !condition.get(at)?.is_mark(")") {
        if condition[at].is_mark(",") {
            at += 1;
            continue;
        }
        let (needs, length) = needs_test(&condition[at..])?;
        parts.push(needs);
        at += length.max(1);
    }
    let needs = match name.text {
        "all" => parts.contains(&true),
        "any" => !parts.is_empty() && !parts.contains(&false),
        _ => false,
    };
    Some((needs, at + 1))
}

/// The first token behind the attributes that begin here.
fn after_attributes(code: &[Token<'_>], mut at: usize) -> usize {
    while code.get(at).is_some_and(|token| token.is_mark("#")) {
        match bracketed(code, at + 1) {
            Some(attribute) => at = attribute.end + 1,
            None => break,
        }
    }
    at
}

/// Items that end with the first block; the others end with `;`.
const WITH_BLOCK: [&str; 10] = [
    "mod",
    "fn",
    "struct",
    "enum",
    "union",
    "trait",
    "impl",
    "macro_rules",
    "unsafe",
    "extern",
];

/// Items that end with `;` whatever blocks they have.
const WITHOUT_BLOCK: [&str; 5] = ["use", "const", "static", "type", "let"];

/// Where the item ends that begins here: behind its `;` or its block. Anything else, such as a
/// field or an arm of `match`, ends before the next comma.
fn item_end(code: &[Token<'_>], start: usize) -> usize {
    let mut is_item = false;
    let mut ends_with_block = true;
    for token in &code[start.min(code.len())..] {
        if token.kind == Kind::Name && WITH_BLOCK.contains(&token.text) {
            (is_item, ends_with_block) = (true, true);
            break;
        }
        if token.kind == Kind::Name && WITHOUT_BLOCK.contains(&token.text) {
            // `const fn` is a function.
            (is_item, ends_with_block) = (true, false);
            if token.text == "const" {
                continue;
            }
            break;
        }
        let goes_on = ["pub", "crate", "super", "self", "in", "async"].contains(&token.text);
        if !goes_on && !token.is_mark("(") && !token.is_mark(")") && !token.is_mark("::") {
            break;
        }
    }
    let mut depth = 0;
    for (at, token) in code.iter().enumerate().skip(start) {
        let change = depth_change(token);
        if depth == 0 && (change < 0 || (!is_item && token.is_mark(","))) {
            return at;
        }
        depth += change;
        let closes_block = depth == 0 && token.is_mark("}");
        if depth == 0 && (token.is_mark(";") || (closes_block && ends_with_block)) {
            return at + 1;
        }
    }
    code.len()
}

/// 1 at an opening bracket of any kind, -1 at a closing one.
pub(crate) fn depth_change(token: &Token<'_>) -> i32 {
    match (token.kind, token.text) {
        (Kind::Mark, "(" | "[" | "{") => 1,
        (Kind::Mark, ")" | "]" | "}") => -1,
        _ => 0,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::tidy::source::lex;

    /// The names in the code that is left without tests.
    fn left(text: &str) -> String {
        let source = lex(text);
        let left = find(&source.code).without(&source.code);
        let names = left.iter().filter(|token| token.is_name());
        names.map(|token| token.text).collect::<Vec<_>>().join(" ")
    }

    #[test]
    fn items_for_tests_are_left_out_to_their_end() {
        for item in [
            "mod tests { fn a() { b(); } }",
            "fn a<T>(b: [u8; 2]) -> c where d: e {}",
            "use a::{b, c};",
            "pub(crate) use a::{b, c};",
            "const A: B = B { c: 1 };",
            "const fn a() { b }",
            "pub const unsafe fn a() {}",
            "static A: [u8; 1] = [b; 1];",
            "impl A for B { fn c() {} }",
            "struct A { b: c }",
            "struct A(b);",
            "#[derive(A)] struct B;",
            "macro_rules! a { () => {} }",
            "type A = B;",
            "mod a;",
            "async fn a() {}",
            "pub(in crate::a) fn b() {}",
        ] {
            let text = format!("fn before() {{}} #[cfg(test)] {item} fn after() {{}}");
            assert_eq!(left(&text), "fn before fn after", "{item}");
        }
        assert_eq!(left("#[test] fn a() { b } x"), "x");
    }

    #[test]
    fn fields_and_arms_for_tests_end_with_their_comma() {
        assert_eq!(left("struct A { #[cfg(test)] b: c, d: e }"), "struct A d e");
        assert_eq!(
            left("struct A { d: e, #[cfg(test)] b: c } x"),
            "struct A d e x"
        );
        assert_eq!(
            left("match a { #[cfg(test)] b => { c } d => e }"),
            "match a d e"
        );
    }

    #[test]
    fn only_conditions_that_need_a_test_count() {
        for (condition, is_test) in [
            ("test", true),
            ("all(test, feature = \"a\")", true),
            ("all(feature = \"a\", all(test))", true),
            ("any(test, feature = \"a\")", false),
            ("any(test, all(test, unix))", true),
            ("not(test)", false),
            ("all(not(test), unix)", false),
            ("feature = \"test\"", false),
            ("testing", false),
        ] {
            let text = format!("#[cfg({condition})] fn a() {{}}");
            assert_eq!(left(&text).is_empty(), is_test, "{condition}");
        }
    }

    #[test]
    fn a_file_can_be_for_tests_as_a_whole() {
        assert_eq!(left("#![allow(a)] #![cfg(test)] fn b() {}"), "");
        assert_eq!(left("#![cfg(unix)] fn b() {}"), "cfg unix fn b");
    }

    #[test]
    fn modules_for_tests_are_named() {
        let source = lex("#[cfg(test)] pub(crate) mod made; #[cfg(test)] mod tests {} mod a;");
        assert_eq!(find(&source.code).modules, ["made"]);
        let stems = BTreeSet::from([module_stem("a/src/lib.rs", "made")]);
        assert!(is_below("a/src/made.rs", &stems));
        assert!(is_below("a/src/made/mod.rs", &stems));
        assert!(is_below("a/src/made/deep/er.rs", &stems));
        assert!(!is_below("a/src/made_by.rs", &stems));
        assert_eq!(module_stem("a/src/b.rs", "c"), "a/src/b/c");
        assert_eq!(module_stem("a/src/b/mod.rs", "c"), "a/src/b/c");
        assert_eq!(module_stem("a/src/bin/b.rs", "c"), "a/src/bin/c");
    }

    #[test]
    fn trailing_items_for_tests_begin_with_the_first_of_them() {
        let source = lex(
            "fn a() {}\n#[cfg(test)] mod b {}\nfn c() {}\n#[cfg(test)]\nmod d {}\n#[cfg(test)] mod e {}",
        );
        let found = find(&source.code);
        assert_eq!(source.code[found.trailing(&source.code)].line, 4);
        let source = lex("#[cfg(test)] mod b {}\nfn c() {}");
        let found = find(&source.code);
        assert_eq!(found.trailing(&source.code), source.code.len());
    }

    #[test]
    fn paths_for_tests() {
        for (path, package, is_test) in [
            ("calib/src/lens/tests.rs", "calib", true),
            ("calib/tests/it/main.rs", "calib", true),
            ("calib/src/target/tests/boards.rs", "calib", true),
            ("tests/src/lib.rs", "tests", true),
            ("calib/src/lens.rs", "calib", false),
            ("calib/src/contests.rs", "calib", false),
        ] {
            assert_eq!(is_test_path(path, package), is_test, "{path}");
        }
    }
}
