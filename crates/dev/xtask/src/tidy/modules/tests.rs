use super::*;
use crate::tidy::outline;
use crate::tidy::source::lex;
use crate::tidy::test_code;

/// The uses among files of a package `p`, as `from -> to:line`.
fn uses(files: &[(&str, &str)]) -> Vec<String> {
    let outlines: Vec<Outline> = files
        .iter()
        .map(|(_, text)| {
            let source = lex(text);
            outline::read(&test_code::find(&source.code).without(&source.code))
        })
        .collect();
    let paths: Vec<String> = files
        .iter()
        .map(|(path, _)| format!("p/src/{path}"))
        .collect();
    let files: Vec<ModuleFile<'_>> = paths
        .iter()
        .zip(&outlines)
        .map(|(path, outline)| ModuleFile { path, outline })
        .collect();
    edges("p/src", &files)
        .into_iter()
        .map(|((from, to), line)| {
            let name = |at: usize| short(files[at].path, "p/src");
            format!("{} -> {}:{line}", name(from), name(to))
        })
        .collect()
}

const NONE: [&str; 0] = [];

#[test]
fn declarations_and_other_crates_are_no_uses() {
    assert_eq!(
        uses(&[
            ("lib.rs", "mod a; mod b;"),
            ("a.rs", "use std::b::C; fn f() { std::mem::take(x); b.c() }"),
            ("b.rs", "pub struct C;"),
        ]),
        NONE
    );
}

#[test]
fn paths_from_the_root_from_above_and_from_here_are_followed() {
    assert_eq!(
        uses(&[
            ("lib.rs", "mod a; mod b;"),
            ("a.rs", "mod c;\nuse crate::b::B;"),
            (
                "a/c.rs",
                "\n\nfn f() { super::g(); super::super::b::B::new() }"
            ),
            ("b.rs", "mod d; pub struct B; use self::d::D; use d::E;"),
            ("b/d.rs", "pub struct D; pub struct E;"),
        ]),
        [
            "a.rs -> b.rs:2",
            "a/c.rs -> a.rs:3",
            "a/c.rs -> b.rs:3",
            "b.rs -> b/d.rs:1"
        ]
    );
}

#[test]
fn re_exports_are_followed_to_the_file_that_defines() {
    let files = |import| {
        [
            (
                "lib.rs",
                "mod a; mod b; pub use a::A; pub use a::deep as shallow;",
            ),
            (
                "a.rs",
                "pub mod deep; pub use deep::inner::{A, B as C}; pub use deep::*;",
            ),
            ("a/deep.rs", "pub mod inner; pub fn function() {}"),
            ("a/deep/inner.rs", "pub struct A; pub struct B;"),
            ("b.rs", import),
        ]
    };
    let of_b = |import| {
        let uses = uses(&files(import)).into_iter();
        uses.filter(|line| line.starts_with("b.rs"))
            .collect::<Vec<_>>()
    };
    for (import, expected) in [
        ("use crate::A;", "a/deep/inner.rs"),
        ("use crate::a::A as X;", "a/deep/inner.rs"),
        ("use crate::a::C;", "a/deep/inner.rs"),
        ("use crate::a::function;", "a/deep.rs"),
        ("fn f() { crate::shallow::inner::B }", "a/deep/inner.rs"),
        ("use super::a; fn f() { a::A::new() }", "a/deep/inner.rs"),
        (
            "use crate::a::*; fn f() { A; function() }",
            "a/deep/inner.rs",
        ),
        ("use super::*; fn f() { A }", "a/deep/inner.rs"),
    ] {
        let found = of_b(import);
        assert!(
            found.contains(&format!("b.rs -> {expected}:1")),
            "{import}: {found:?}"
        );
        assert!(
            !found.contains(&"b.rs -> a.rs:1".to_owned()),
            "{import}: {found:?}"
        );
    }
    // The module itself, where nothing of it is named, and names that cannot be followed.
    assert_eq!(of_b("use crate::a;"), ["b.rs -> a.rs:1"]);
    assert_eq!(of_b("use crate::a::MadeByMacro;"), ["b.rs -> a.rs:1"]);
    assert_eq!(of_b("use crate::a::*; fn f() { nothing }"), NONE);
}

#[test]
fn names_of_types_end_a_path() {
    assert_eq!(
        uses(&[
            ("lib.rs", "mod a; mod b;"),
            ("a.rs", "pub enum E { V }"),
            ("b.rs", "use crate::a::E::V;\nuse crate::a::E::*;"),
        ]),
        ["b.rs -> a.rs:1"]
    );
}

#[test]
fn a_parent_and_its_child_can_use_each_other() {
    assert_eq!(
        uses(&[
            ("lib.rs", "mod a;"),
            ("a.rs", "mod b;\nuse b::B;\npub struct A;"),
            ("a/b.rs", "use super::A;\npub struct B;"),
        ]),
        ["a.rs -> a/b.rs:2", "a/b.rs -> a.rs:1"]
    );
}

#[test]
fn a_module_and_an_item_of_one_name_are_two_things() {
    assert_eq!(
        uses(&[
            ("lib.rs", "mod a; mod b; pub use a::a;"),
            ("a.rs", "pub mod c; pub fn a() {}"),
            ("a/c.rs", "pub struct C;"),
            ("b.rs", "use crate::a; fn f() { crate::a::c::C }"),
        ]),
        ["lib.rs -> a.rs:1", "b.rs -> a.rs:1", "b.rs -> a/c.rs:1"]
    );
}

#[test]
fn modules_with_a_body_have_their_own_names() {
    assert_eq!(
        uses(&[
            (
                "lib.rs",
                "mod a { pub mod b; pub(crate) fn f() { super::g(); self::b::h() } } mod c;"
            ),
            ("a/b.rs", "use super::f;"),
            ("c.rs", "use crate::a::b::h;"),
        ]),
        [
            "lib.rs -> a/b.rs:1",
            "a/b.rs -> lib.rs:1",
            "c.rs -> a/b.rs:1"
        ]
    );
}

#[test]
fn tests_are_no_uses() {
    assert_eq!(
        uses(&[
            ("lib.rs", "mod a; mod b;"),
            (
                "a.rs",
                "#[cfg(test)] use crate::b::B; #[cfg(test)] mod tests { use crate::b::*; fn f(b: B) {} }"
            ),
            ("b.rs", "pub struct B;"),
        ]),
        NONE
    );
}

#[test]
fn programs_are_crates_of_their_own() {
    assert_eq!(
        uses(&[
            ("lib.rs", "pub mod a; pub struct L;"),
            ("a.rs", "use crate::L;"),
            ("main.rs", "mod m; use p::L; struct M; use crate::m::N;"),
            ("m.rs", "use crate::M;"),
            ("bin/one.rs", "mod two; fn f() { two::g() }"),
            ("bin/two.rs", "fn g() { crate::f() }"),
            ("bin/three/main.rs", "mod four; fn f() { four::g() }"),
            ("bin/three/four.rs", "pub fn g() {}"),
        ]),
        [
            "a.rs -> lib.rs:1",
            "main.rs -> m.rs:1",
            "m.rs -> main.rs:1",
            "bin/one.rs -> bin/two.rs:1",
            "bin/two.rs -> bin/one.rs:1",
            "bin/three/main.rs -> bin/three/four.rs:1",
        ]
    );
}

#[test]
fn exported_macros_lie_in_the_file_that_has_them() {
    assert_eq!(
        uses(&[
            ("lib.rs", "mod a; mod b;"),
            ("a.rs", "#[macro_export] macro_rules! complain { () => {} }"),
            ("b.rs", "fn f() { crate::complain!() }"),
        ]),
        ["b.rs -> a.rs:1"]
    );
}

#[test]
fn imports_that_go_round_end() {
    let uses = uses(&[
        ("lib.rs", "mod a; mod b;\nuse a::X;"),
        ("a.rs", "pub use crate::b::X; pub use crate::b::*;"),
        (
            "b.rs",
            "pub use crate::a::X; pub use crate::a::*; fn f() { Y }",
        ),
    ]);
    assert!(
        uses.iter().any(|line| line.starts_with("lib.rs -> ")),
        "{uses:?}"
    );
}
