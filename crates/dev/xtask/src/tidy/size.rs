//! How long files and functions are, and how much a library makes public.

use super::place::Place;
use super::source::Token;
use super::test_code::{TestCode, depth_change};

/// More lines than this are too many for a file.
pub(crate) const MAX_FILE_LINES: usize = 600;

/// More lines than this are too many for a function, its signature included.
pub(crate) const MAX_FUNCTION_LINES: usize = 100;

/// Lines of a file without the items for tests at its end.
pub(crate) fn lines(text: &str, code: &[Token<'_>], tests: &TestCode) -> usize {
    match code.get(tests.trailing(code)) {
        Some(first) => first.line - 1,
        None => text.lines().count(),
    }
}

/// The file, if it is too long.
pub(crate) fn long_file(path: &str, lines: usize) -> Option<Place> {
    (lines > MAX_FILE_LINES).then(|| Place::new(path, 1, format!("file of {lines} lines")))
}

/// The functions that are too long. `code` is the file without its tests.
pub(crate) fn long_functions(path: &str, code: &[Token<'_>]) -> Vec<Place> {
    let mut found = Vec::new();
    for (at, token) in code.iter().enumerate() {
        let Some(name) = code.get(at + 1).filter(|name| name.is_name()) else {
            continue;
        };
        if !token.is_word("fn") {
            continue;
        }
        let lines = last_line(&code[at..]).map_or(0, |last| last + 1 - token.line);
        if lines > MAX_FUNCTION_LINES {
            let text = format!("fn {} of {lines} lines", name.text);
            found.push(Place::new(path, token.line, text));
        }
    }
    found
}

/// Line of the closing brace of a function; `None` for one without a body.
fn last_line(function: &[Token<'_>]) -> Option<usize> {
    let mut depth = 0;
    for token in function {
        depth += depth_change(token);
        match (depth, token.text) {
            (0, "}") => return Some(token.line),
            (0, ";") => return None,
            _ => {}
        }
    }
    None
}

/// The public items of a file: not fields, not what is public in a part of the crate only.
pub(crate) fn public_items(path: &str, code: &[Token<'_>]) -> Vec<Place> {
    const ITEMS: [&str; 13] = [
        "fn", "struct", "enum", "trait", "const", "static", "type", "mod", "use", "unsafe",
        "async", "extern", "macro",
    ];
    let mut found = Vec::new();
    for (at, token) in code.iter().enumerate() {
        let behind = |skip: usize| code.get(at + skip);
        let is_item = behind(1).is_some_and(|next| {
            let is_union = next.is_word("union") && behind(2).is_some_and(Token::is_name);
            is_union || ITEMS.iter().any(|item| next.is_word(item))
        });
        if token.is_word("pub") && is_item {
            let words = code[at..]
                .iter()
                .skip(1)
                .take_while(|token| token.is_name());
            let words: Vec<&str> = words.map(|token| token.text).collect();
            let text = format!("pub {}", words.join(" "));
            found.push(Place::new(path, token.line, text));
        }
        if token.is_word("macro_export") {
            found.push(Place::new(path, token.line, "macro_rules".to_owned()));
        }
    }
    found
}

/// The public modules of a file that are not inside another module.
pub(crate) fn public_modules(path: &str, code: &[Token<'_>]) -> Vec<Place> {
    let mut found = Vec::new();
    let mut depth = 0;
    for (at, token) in code.iter().enumerate() {
        depth += depth_change(token);
        if let [public, module, name, ..] = &code[at..]
            && depth == 0
            && public.is_word("pub")
            && module.is_word("mod")
        {
            let text = format!("pub mod {}", name.text);
            found.push(Place::new(path, token.line, text));
        }
    }
    found
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::tidy::source::lex;
    use crate::tidy::test_code;

    fn texts(places: Vec<Place>) -> Vec<String> {
        places.into_iter().map(|place| place.text).collect()
    }

    #[test]
    fn tests_at_the_end_are_no_lines_of_a_file() {
        for (text, expected) in [
            ("a\nb\n\n#[cfg(test)]\nmod tests {\n}\n", 3),
            ("a\n#[cfg(test)]\nmod tests {\n}\nfn b() {}\n", 5),
            ("a\n// b\n", 2),
            ("", 0),
        ] {
            let source = lex(text);
            let tests = test_code::find(&source.code);
            assert_eq!(lines(text, &source.code, &tests), expected, "{text:?}");
        }
        assert_eq!(long_file("a.rs", MAX_FILE_LINES), None);
        assert!(long_file("a.rs", MAX_FILE_LINES + 1).is_some());
    }

    #[test]
    fn functions_are_measured_from_signature_to_brace() {
        let function = |body: usize| {
            format!(
                "\nfn f<const N: usize>(a: [u8; 2])\n{{{}}}\n",
                "\n".repeat(body)
            )
        };
        let long = |text: &str| texts(long_functions("a.rs", &lex(text).code));
        assert_eq!(long(&function(98)), Vec::<String>::new());
        assert_eq!(long(&function(99)), ["fn f of 101 lines"]);
        let nested = format!("fn outer() {{ {} }}", function(99));
        assert_eq!(
            long(&nested),
            ["fn outer of 103 lines", "fn f of 101 lines"]
        );
        let without_body = format!("trait T {{ fn f(); {} fn g(); }}", "\n".repeat(200));
        assert_eq!(long(&without_body), Vec::<String>::new());
        let pointer = format!("type F = fn(u8); {} const A: fn(u8) = b;", "\n".repeat(200));
        assert_eq!(long(&pointer), Vec::<String>::new());
    }

    #[test]
    fn public_items_are_counted_and_fields_are_not() {
        let text = "
            pub mod a; pub use b::c; pub const fn d() {} pub unsafe trait E {} pub async fn f() {}
            pub struct G { pub field: u8, pub union: u8 } pub struct H(pub u8); pub union I { j: u8 }
            pub(crate) fn k() {} pub(super) use l; pub(in crate::m) const N: u8 = 1; fn o() {}
            impl G { pub fn p() {} pub const Q: u8 = 1; } pub extern \"C\" fn r() {}
        ";
        assert_eq!(
            texts(public_items("a.rs", &lex(text).code)),
            [
                "pub mod a",
                "pub use b",
                "pub const fn d",
                "pub unsafe trait E",
                "pub async fn f",
                "pub struct G",
                "pub struct H",
                "pub union I",
                "pub fn p",
                "pub const Q",
                "pub extern"
            ]
        );
    }

    #[test]
    fn public_modules_are_those_of_the_file_itself() {
        let text = "pub mod a; mod b { pub mod c {} } pub mod d { } pub(crate) mod e;";
        assert_eq!(
            texts(public_modules("lib.rs", &lex(text).code)),
            ["pub mod a", "pub mod d"]
        );
    }
}
