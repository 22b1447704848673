//! Outline of a file: its modules, and what it defines, imports and names by a path.
//!
//! Names only, no types: methods and fields are not followed, nor what macros make. In the body of
//! a macro only paths from the root of the crate have a meaning of their own, so the others are
//! left out.

use std::collections::HashSet;

use super::source::{Kind, Token};
use super::test_code::depth_change;
use super::uses;

/// The modules of one file, without those for tests. The first is that of the file itself, the
/// others are written with a body inside it.
#[derive(Debug)]
pub(crate) struct Outline {
    pub(crate) scopes: Vec<Scope>,
    /// Names of macros that are exported, and thereby lie in the root of the crate.
    pub(crate) exported_macros: Vec<String>,
    /// Every name in the code that does not stand behind a dot; only where something is imported
    /// with `*`.
    pub(crate) names: HashSet<String>,
}

/// A module with its body in a file.
#[derive(Debug, Default)]
pub(crate) struct Scope {
    pub(crate) name: String,
    /// The scope that it lies in; `None` for that of the file.
    pub(crate) parent: Option<usize>,
    /// Modules whose body is in another file.
    pub(crate) declared: Vec<String>,
    /// What is defined here: functions, types, constants, macros.
    pub(crate) items: HashSet<String>,
    pub(crate) imports: Vec<Import>,
    /// Paths of two or more parts in the code.
    pub(crate) paths: Vec<Path>,
}

/// One name out of a `use`.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Import {
    pub(crate) path: Vec<String>,
    /// Its name here; `None` for all that is in the module, `*`.
    pub(crate) name: Option<String>,
    pub(crate) line: usize,
    /// Whether it stands in a function and is not seen from elsewhere.
    pub(crate) is_local: bool,
}

/// A path in the code.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Path {
    pub(crate) parts: Vec<String>,
    pub(crate) line: usize,
}

/// Reads the tokens of a file without its tests.
pub(crate) fn read(code: &[Token<'_>]) -> Outline {
    let mut reader = Reader {
        code,
        outline: Outline {
            scopes: vec![Scope::default()],
            exported_macros: Vec::new(),
            names: HashSet::new(),
        },
        open: vec![(0, 0)],
        depth: 0,
        macro_depth: None,
    };
    let mut at = 0;
    while at < code.len() {
        at += reader.take(at);
    }
    let mut outline = reader.outline;
    let mut imports = outline.scopes.iter().flat_map(|scope| &scope.imports);
    if imports.any(|import| import.name.is_none()) {
        outline.names = names(code);
    }
    outline
}

struct Reader<'a> {
    code: &'a [Token<'a>],
    outline: Outline,
    /// The scopes that are open, each with the depth of brackets directly inside it.
    open: Vec<(usize, i32)>,
    depth: i32,
    /// The depth around the macro whose body is being read.
    macro_depth: Option<i32>,
}

impl Reader<'_> {
    /// Takes what begins at a token; the number of tokens that it consists of.
    fn take(&mut self, at: usize) -> usize {
        let token = &self.code[at];
        let change = depth_change(token);
        if change != 0 {
            self.depth += change;
            if change < 0 && self.open.len() > 1 && self.depth < self.innermost().1 {
                self.open.pop();
            }
            if change < 0 && self.macro_depth == Some(self.depth) {
                self.macro_depth = None;
            }
            return 1;
        }
        if self.macro_depth.is_some() {
            return match token.is_word("crate") && self.is_mark(at + 1, "::") {
                true => self.path(at),
                false => 1,
            };
        }
        if token.is_word("use") && !self.is_mark(at + 1, "<") {
            return self.import(at);
        }
        if token.is_word("mod") {
            return self.module(at);
        }
        if self.depth == self.innermost().1 {
            self.item(at);
        }
        if token.is_name() && self.is_mark(at + 1, "::") {
            return self.path(at);
        }
        1
    }

    fn innermost(&self) -> (usize, i32) {
        self.open.last().copied().unwrap_or_default()
    }

    fn scope(&mut self) -> &mut Scope {
        let scope = self.innermost().0;
        &mut self.outline.scopes[scope]
    }

    fn is_mark(&self, at: usize, mark: &str) -> bool {
        self.code.get(at).is_some_and(|token| token.is_mark(mark))
    }

    fn import(&mut self, at: usize) -> usize {
        let is_local = self.depth > self.innermost().1;
        let (leaves, length) = uses::parse(&self.code[at + 1..]);
        for leaf in leaves {
            self.scope().imports.push(Import {
                path: leaf.path,
                name: leaf.name,
                line: leaf.line,
                is_local,
            });
        }
        1 + length
    }

    fn module(&mut self, at: usize) -> usize {
        let Some(name) = self.code.get(at + 1).filter(|token| token.is_name()) else {
            return 1;
        };
        let name = name.text.to_owned();
        if self.is_mark(at + 2, ";") {
            self.scope().declared.push(name);
            return 3;
        }
        if !self.is_mark(at + 2, "{") {
            return 1;
        }
        let parent = self.innermost().0;
        self.outline.scopes.push(Scope {
            name,
            parent: Some(parent),
            ..Scope::default()
        });
        self.depth += 1;
        self.open.push((self.outline.scopes.len() - 1, self.depth));
        3
    }

    /// Notes the item whose keyword is at a token.
    fn item(&mut self, at: usize) {
        const KEYWORDS: [&str; 8] = [
            "fn", "struct", "enum", "union", "trait", "type", "const", "static",
        ];
        let token = &self.code[at];
        let mut name = at + 1;
        if token.is_word("macro_rules") && self.is_mark(at + 1, "!") {
            name = at + 2;
            self.macro_depth = Some(self.depth);
            let is_exported = self.code[..at]
                .iter()
                .rev()
                .take_while(|token| !token.is_mark(";") && !token.is_mark("}"))
                .any(|token| token.is_word("macro_export"));
            if let Some(token) = self.code.get(name).filter(|_| is_exported) {
                self.outline.exported_macros.push(token.text.to_owned());
            }
        } else if token.kind != Kind::Name || !KEYWORDS.contains(&token.text) {
            return;
        } else if token.is_word("static") && self.code.get(name).is_some_and(|t| t.is_word("mut")) {
            name += 1;
        }
        // `const fn`: the name is behind `fn`.
        let is_keyword = |token: &&Token<'_>| {
            let keywords = ["fn", "unsafe", "async", "extern"];
            keywords.iter().any(|keyword| token.is_word(keyword))
        };
        let named = self.code.get(name).filter(|token| token.is_name());
        if let Some(token) = named.filter(|token| !is_keyword(token)) {
            let text = token.text.to_owned();
            self.scope().items.insert(text);
        }
    }

    fn path(&mut self, at: usize) -> usize {
        let line = self.code[at].line;
        let mut parts = vec![self.code[at].text.to_owned()];
        let mut end = at + 1;
        while self.is_mark(end, "::")
            && let Some(part) = self.code.get(end + 1).filter(|token| token.is_name())
        {
            parts.push(part.text.to_owned());
            end += 2;
        }
        let behind = |back: usize| at.checked_sub(back).map(|before| &self.code[before]);
        // `<T as A>::B::c`, `::std::a`: not a path from here. `pub(in crate::a)`: no use of it.
        let is_tail = behind(1).is_some_and(|token| token.is_mark("::"));
        let is_visibility = behind(1).is_some_and(|token| token.is_word("in"))
            && behind(2).is_some_and(|token| token.is_mark("("))
            && behind(3).is_some_and(|token| token.is_word("pub"));
        if parts.len() > 1 && !is_tail && !is_visibility {
            self.scope().paths.push(Path { parts, line });
        }
        end - at
    }
}

fn names(code: &[Token<'_>]) -> HashSet<String> {
    let mut names = HashSet::new();
    let mut before: Option<&Token<'_>> = None;
    for token in code {
        let is_member = before.is_some_and(|before| before.is_mark("."));
        if token.is_name() && !is_member {
            names.insert(token.text.to_owned());
        }
        before = Some(token);
    }
    names
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::tidy::source::lex;

    fn of(text: &str) -> Outline {
        read(&lex(text).code)
    }

    fn items(scope: &Scope) -> Vec<&str> {
        let mut items: Vec<&str> = scope.items.iter().map(String::as_str).collect();
        items.sort_unstable();
        items
    }

    #[test]
    fn items_are_those_of_the_module_itself() {
        let outline = of("
            pub fn a() { fn inner() {} struct Inner; }
            pub(crate) const unsafe fn b() {}
            struct C { d: fn() } enum D { E } trait F { fn g(); type H; const I: u8; }
            impl C { fn method() {} const J: u8 = 1; }
            const K: u8 = 1; static mut L: u8 = 1; type M = u8; const _: () = ();
            macro_rules! n { () => { fn o() {} } }
        ");
        assert_eq!(
            items(&outline.scopes[0]),
            ["C", "D", "F", "K", "L", "M", "_", "a", "b", "n"]
        );
    }

    #[test]
    fn modules_with_a_body_are_scopes_and_others_are_declared() {
        let outline = of("mod a; mod b { mod c; fn d() {} mod e { use f::g; } } fn h() {}");
        let scopes = &outline.scopes;
        assert_eq!(scopes[0].declared, ["a"]);
        assert_eq!(items(&scopes[0]), ["h"]);
        assert_eq!((scopes[1].name.as_str(), scopes[1].parent), ("b", Some(0)));
        assert_eq!(scopes[1].declared, ["c"]);
        assert_eq!(items(&scopes[1]), ["d"]);
        assert_eq!((scopes[2].name.as_str(), scopes[2].parent), ("e", Some(1)));
        assert_eq!(scopes[2].imports.len(), 1);
    }

    #[test]
    fn imports_in_functions_are_local() {
        let outline = of("use a::b; fn f() { use c::d; } impl E { fn g() { use h::*; } }");
        let local: Vec<bool> = outline.scopes[0]
            .imports
            .iter()
            .map(|i| i.is_local)
            .collect();
        assert_eq!(local, [false, true, true]);
    }

    #[test]
    fn paths_in_code_have_all_their_parts() {
        let outline = of("
            fn f(a: crate::b::C<super::d::E>) { g::h::<I>(x); self.j(); <K as l::M>::n::o() }
            pub(in crate::p) fn q() {}
            fn r() { for s in crate::t() {} }
            fn u() { Some::<v::W>(1) + ::std::x() }
        ");
        let paths: Vec<_> = outline.scopes[0]
            .paths
            .iter()
            .map(|path| (path.parts.join("::"), path.line))
            .collect();
        let expected = [
            ("crate::b::C", 2),
            ("super::d::E", 2),
            ("g::h", 2),
            ("l::M", 2),
            ("crate::t", 4),
            ("v::W", 5),
        ];
        assert_eq!(paths, expected.map(|(path, line)| (path.to_owned(), line)));
    }

    #[test]
    fn exported_macros_are_noted() {
        let outline = of("
            macro_rules! a { () => {} }
            #[macro_export] macro_rules! b { () => {} }
        ");
        assert_eq!(outline.exported_macros, ["b"]);
    }

    #[test]
    fn of_a_macro_only_paths_from_the_root_are_read() {
        let outline = of("
            macro_rules! a { () => { use super::b; mod c { } super::d(); $crate::e(); f::g() }; }
            fn h() { super::i() }
        ");
        let paths = outline.scopes[0].paths.iter();
        let paths: Vec<String> = paths.map(|path| path.parts.join("::")).collect();
        assert_eq!(paths, ["crate::e", "super::i"]);
        assert_eq!(outline.scopes.len(), 1);
        assert_eq!(outline.scopes[0].imports, []);
        assert_eq!(items(&outline.scopes[0]), ["a", "h"]);
    }

    #[test]
    fn names_are_noted_only_for_an_import_of_all() {
        assert!(of("use a::b; fn f() {}").names.is_empty());
        let names = of("use a::*; fn f() { c.d(); E }").names;
        assert!(names.contains("E") && names.contains("c") && !names.contains("d"));
    }
}
