use super::*;
use crate::tidy::files;

fn code(text: &str) -> Vec<(Kind, &str)> {
    let source = lex(text);
    source.code.iter().map(|t| (t.kind, t.text)).collect()
}

fn words(text: &str) -> Vec<&str> {
    lex(text).code.iter().map(|token| token.text).collect()
}

fn comments(text: &str) -> Vec<(Style, &str, usize)> {
    let source = lex(text);
    let comments = source.comments.iter();
    comments.map(|c| (c.style, c.text, c.line)).collect()
}

const TEXT: Kind = Kind::Text { raw: false };
const RAW: Kind = Kind::Text { raw: true };

#[test]
fn comments_of_every_style_are_split_from_code() {
    let text = "\
//! module
/// item
//// not documentation
fn f() {} // at the end
/* block */ /** doc */
/**/ x
";
    assert_eq!(
        comments(text),
        [
            (Style::Inner, " module", 1),
            (Style::Outer, " item", 2),
            (Style::Plain, "// not documentation", 3),
            (Style::Plain, " at the end", 4),
            (Style::Block, " block ", 5),
            (Style::Block, "* doc ", 5),
            (Style::Block, "", 6),
        ]
    );
    assert_eq!(words(text), ["fn", "f", "(", ")", "{", "}", "x"]);
}

#[test]
fn block_comments_nest_and_lines_go_on_behind_them() {
    let text = "a /* one /* two\n */ still\n one */ b";
    assert_eq!(
        comments(text),
        [(Style::Block, " one /* two\n */ still\n one ", 1)]
    );
    let lines: Vec<_> = lex(text).code.iter().map(|t| (t.text, t.line)).collect();
    assert_eq!(lines, [("a", 1), ("b", 3)]);
}

#[test]
fn markers_inside_strings_are_no_comments() {
    for text in [
        r#"f("http://x /* y")"#,
        r#"f("a \" // b")"#,
        r###"f(r#"a " // b"#)"###,
        r###"f(br##"a "# // b"##)"###,
        r#"f(b"// b")"#,
        r#"f(c"// b")"#,
        r#"f(cr"// b")"#,
    ] {
        assert_eq!(comments(text), [], "{text}");
        assert_eq!(words(text).last(), Some(&")"), "{text}");
        assert_eq!(code(text).len(), 4, "{text}");
    }
}

#[test]
fn strings_inside_comments_are_no_strings() {
    assert_eq!(words("a // it's \"open\n b"), ["a", "b"]);
    assert_eq!(words("a /* \"open */ b"), ["a", "b"]);
}

#[test]
fn a_string_is_what_is_between_its_quotes() {
    assert_eq!(code(r#""a\"b""#), [(TEXT, r#"a\"b"#)]);
    assert_eq!(code(r#""ends in \\" x"#)[0], (TEXT, r"ends in \\"));
    assert_eq!(code("r\"a\\\" x")[0], (RAW, "a\\"));
    assert_eq!(code("r##\"a\"#b\"## x")[0], (RAW, "a\"#b"));
}

#[test]
fn lines_are_counted_inside_strings() {
    let source = lex("f(\"one\ntwo \\\n three\", b)\nc");
    let lines: Vec<_> = source.code.iter().map(|t| t.line).collect();
    assert_eq!(lines, [1, 1, 1, 3, 3, 3, 4]);
}

#[test]
fn characters_and_lifetimes_are_distinguished() {
    use Kind::{Character, Lifetime};
    let text = r"'a' 'a b'\'' '\\' '\u{1F600}' '(' 'é' b'x' b'\'' 'static '_ ' '";
    let kinds: Vec<_> = code(text)
        .into_iter()
        .filter(|(kind, _)| matches!(kind, Character | Lifetime))
        .collect();
    assert_eq!(
        kinds,
        [
            (Character, "a"),
            (Lifetime, "a"),
            (Character, r"\'"),
            (Character, r"\\"),
            (Character, r"\u{1F600}"),
            (Character, "("),
            (Character, "é"),
            (Character, "x"),
            (Character, r"\'"),
            (Lifetime, "static"),
            (Lifetime, "_"),
            (Character, " "),
        ]
    );
}

#[test]
fn a_quote_as_a_character_opens_no_string() {
    assert_eq!(
        words("x('\"', '/', '/') // c"),
        ["x", "(", "\"", ",", "/", ",", "/", ")"]
    );
}

#[test]
fn raw_names_are_no_keywords() {
    let source = lex("r#fn fn");
    assert!(!source.code[0].is_word("fn") && source.code[0].is_name());
    assert!(source.code[1].is_word("fn"));
}

#[test]
fn numbers_stop_at_ranges_calls_and_signs() {
    for (text, expected) in [
        ("1..2", vec!["1", ".", ".", "2"]),
        ("1.5e-3+x", vec!["1.5e-3", "+", "x"]),
        ("2e+3", vec!["2e+3"]),
        ("0xfe-1", vec!["0xfe", "-", "1"]),
        ("1.max(2)", vec!["1", ".", "max", "(", "2", ")"]),
        ("x.0.1", vec!["x", ".", "0.1"]),
        ("1_000.0_f64", vec!["1_000.0_f64"]),
    ] {
        assert_eq!(words(text), expected, "{text}");
    }
}

#[test]
fn paths_are_joined_by_one_mark() {
    assert_eq!(words("a::b: C"), ["a", "::", "b", ":", "C"]);
}

#[test]
fn a_script_line_is_left_out_and_an_inner_attribute_is_not() {
    assert_eq!(words("#!/usr/bin/env it's\nx"), ["x"]);
    assert_eq!(words("#![x]"), ["#", "!", "[", "x", "]"]);
}

#[test]
fn unfinished_text_ends_with_the_file() {
    for text in [
        "\"open",
        "r#\"open\"",
        "/* open /* */",
        "'",
        "b'",
        "\"\\",
        "\"\\é",
        "'\\",
        "/*",
        "r#",
        "é",
    ] {
        lex(text);
    }
    assert_eq!(words("r#\"open\" x"), ["open\" x"]);
}

#[test]
fn brackets_of_every_file_of_the_repository_match() {
    let root = crate::process::root().expect("a workspace");
    let Ok(paths) = files::listed(&root) else {
        eprintln!("skipped: not in a git checkout");
        return;
    };
    let mut number = 0;
    for path in paths.iter().filter(|path| path.ends_with(".rs")) {
        let text = std::fs::read_to_string(root.join(path)).expect(path);
        let mut open = Vec::new();
        for token in lex(&text).code {
            if token.kind != Kind::Mark {
                continue;
            }
            match token.text {
                "(" | "[" | "{" => open.push(token.text),
                ")" => assert_eq!(open.pop(), Some("("), "{path}:{}", token.line),
                "]" => assert_eq!(open.pop(), Some("["), "{path}:{}", token.line),
                "}" => assert_eq!(open.pop(), Some("{"), "{path}:{}", token.line),
                _ => {}
            }
        }
        assert!(open.is_empty(), "{path}: {open:?}");
        number += 1;
    }
    assert!(number > 500, "{number} files");
}
