//! `use` trees: groups, `self`, renames and `*` as one path for every name.

use super::source::Token;

/// One name that a `use` brings in.
#[derive(Debug, PartialEq)]
pub(crate) struct Leaf {
    pub(crate) path: Vec<String>,
    /// The name here; `None` for `*`.
    pub(crate) name: Option<String>,
    pub(crate) line: usize,
}

/// Reads the tree behind `use`, up to its `;`; the number of tokens with it. Paths that begin with
/// `::` name other crates and are left out.
pub(crate) fn parse(code: &[Token<'_>]) -> (Vec<Leaf>, usize) {
    let end = code.iter().position(|token| token.is_mark(";"));
    let end = end.unwrap_or(code.len());
    let mut leaves = Vec::new();
    if !code.first().is_some_and(|token| token.is_mark("::")) {
        tree(&code[..end], &[], &mut leaves);
    }
    (leaves, (end + 1).min(code.len()))
}

/// Reads one branch that goes on from `prefix`; the number of tokens it takes.
fn tree(code: &[Token<'_>], prefix: &[String], leaves: &mut Vec<Leaf>) -> usize {
    let mut path = prefix.to_vec();
    let mut at = 0;
    while let Some(token) = code.get(at) {
        let line = token.line;
        if token.is_mark("::") {
            at += 1;
        } else if token.is_mark("*") {
            leaves.push(Leaf {
                path,
                name: None,
                line,
            });
            return at + 1;
        } else if token.is_mark("{") {
            at += 1;
            while code.get(at).is_some_and(|token| !token.is_mark("}")) {
                let is_comma = code[at].is_mark(",");
                at += if is_comma {
                    1
                } else {
                    tree(&code[at..], &path, leaves).max(1)
                };
            }
            return at + 1;
        } else if token.is_name() {
            // `a::{self}` is `a`.
            if !token.is_word("self") || path.is_empty() {
                path.push(token.text.to_owned());
            }
            at += 1;
            if code.get(at).is_some_and(|token| token.is_mark("::")) {
                continue;
            }
            let mut name = path.last().cloned();
            if code.get(at).is_some_and(|token| token.is_word("as")) {
                name = code.get(at + 1).map(|token| token.text.to_owned());
                at += 2;
            }
            leaves.push(Leaf { path, name, line });
            return at;
        } else {
            return at;
        }
    }
    at
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::tidy::source::lex;

    fn of(text: &str) -> Vec<String> {
        let source = lex(text);
        let (leaves, length) = parse(&source.code);
        assert_eq!(length, source.code.len(), "{text}");
        let leaves = leaves.iter().map(|leaf| {
            let path = leaf.path.join("::");
            let name = leaf.name.as_deref().unwrap_or("*");
            format!("{path} as {name}")
        });
        leaves.collect()
    }

    #[test]
    fn every_name_of_a_tree_has_its_path() {
        assert_eq!(of("a;"), ["a as a"]);
        assert_eq!(of("crate::a::B;"), ["crate::a::B as B"]);
        assert_eq!(of("a::b as c;"), ["a::b as c"]);
        assert_eq!(of("super::*;"), ["super as *"]);
        assert_eq!(
            of("a::{self, b::{C, D as E,}, f::*, self as g, T as _};"),
            [
                "a as a",
                "a::b::C as C",
                "a::b::D as E",
                "a::f as *",
                "a as g",
                "a::T as _"
            ]
        );
        assert_eq!(of("{a::b, c};"), ["a::b as b", "c as c"]);
        assert_eq!(of("self::a;"), ["self::a as a"]);
        assert_eq!(of("super::super::a;"), ["super::super::a as a"]);
    }

    #[test]
    fn other_crates_and_odd_trees_yield_nothing() {
        assert_eq!(of("::a::b;"), Vec::<String>::new());
        for text in [
            "", ";", "a::", "{", "a::{", "a::{b", "+;", "a::{+};", "a as",
        ] {
            let source = lex(text);
            parse(&source.code);
        }
    }

    #[test]
    fn names_have_the_line_that_they_stand_on() {
        let source = lex("a::{\n    b,\n    c,\n};");
        let (leaves, _) = parse(&source.code);
        let lines: Vec<_> = leaves.iter().map(|leaf| leaf.line).collect();
        assert_eq!(lines, [2, 3]);
    }
}
