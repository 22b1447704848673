use super::*;
use crate::tree::At;

fn source(text: &str) -> Source {
    Source {
        path: "sensor.yaml".into(),
        text: text.to_owned(),
    }
}

#[test]
fn reads_blocks_lists_and_comments() {
    let text = "%YAML:1.0\n# General\nT_BS: !!opencv-matrix\n  rows: 2\n  data: [1.5, -2e-05, # first\n\n         \
                3,\n         4]\nrate_hz: 20 # Hz\ncomment: VI-Sensor #3 (a: b)\nname: 'cam 0'\nempty:\n";
    let source = source(text);
    let tree = parse(&source).unwrap();
    let root = At::root(&source, &tree);
    let data = root.get("T_BS.data").unwrap();
    assert_eq!(
        (data.line(), data.numbers::<4>().unwrap()),
        (5, [1.5, -2e-05, 3.0, 4.0])
    );
    assert_eq!(root.get("T_BS.rows").unwrap().number().unwrap(), 2.0);
    assert_eq!(root.get("rate_hz").unwrap().number().unwrap(), 20.0);
    let comment = root.get("comment").unwrap();
    assert_eq!((comment.line(), comment.text().unwrap()), (10, "VI-Sensor"));
    assert_eq!(root.get("name").unwrap().text().unwrap(), "cam 0");
    assert!(root.find("empty").is_none() && root.find("absent").is_none());
}

#[test]
fn reads_what_other_programs_write() {
    // PyYAML's default: sequences at the indentation of their key, flow inside, wrapped lines.
    let text = "---\ncam0:\n  T_cam_imu:\n  - [1.0, 0.0,\n    0.5]\n  - - 2.0\n    - 3.0\n  cam_overlaps: [1]\n  \
                nested: {a: 1, 'b c': [2, 3], d: {e: \"x, y\"}}\ncam1: {intrinsics: [1, 2], }\nlist:\n- name: a\n  \
                value: 1\n-\n  name: b # c\n  \"value\": 2\ntopic: /cam0/image_raw\nurl: a:b\n...\nnot read\n";
    let source = source(text);
    let tree = parse(&source).unwrap();
    let root = At::root(&source, &tree);
    let all = |key: &str| root.get(key).unwrap().number_list().unwrap();
    assert_eq!(all("cam0.T_cam_imu"), [1.0, 0.0, 0.5, 2.0, 3.0]);
    assert_eq!(all("cam0.cam_overlaps"), [1.0]);
    assert_eq!(all("cam0.nested.b c"), [2.0, 3.0]);
    assert_eq!(all("cam1.intrinsics"), [1.0, 2.0]);
    let text = |key: &str| root.get(key).unwrap().text().unwrap().to_owned();
    assert_eq!(text("cam0.nested.d.e"), "x, y");
    assert_eq!(
        (text("topic"), text("url")),
        ("/cam0/image_raw".to_owned(), "a:b".to_owned())
    );
    let items = root.get("list").unwrap().items().unwrap();
    let pairs: Vec<(String, f64)> = items
        .iter()
        .map(|item| {
            let name = item.get("name").unwrap().text().unwrap().to_owned();
            (name, item.get("value").unwrap().number().unwrap())
        })
        .collect();
    assert_eq!(pairs, [("a".to_owned(), 1.0), ("b".to_owned(), 2.0)]);
    assert_eq!(items[1].get("value").unwrap().path(), "list[1].value");
}

#[test]
fn unsupported_yaml_is_rejected() {
    for (text, expected) in [
        (
            "- item\nkey: 1\n",
            "line 2: found \"key: 1\", expected the indentation",
        ),
        (
            "a: 1\n\tb: 2\n",
            "line 2: found \"\\tb: 2\", expected indentation by spaces",
        ),
        (
            "a: 1\n  b: 2\n",
            "line 2: found \"  b: 2\", expected the indentation of one of the keys above",
        ),
        (
            "a:\n    b: 1\n  c: 2\n",
            "line 3: found \"  c: 2\", expected the indentation",
        ),
        (
            "a: 1\na: 2\n",
            "line 2: found \"a\", expected each key once",
        ),
        (
            "a: {b: 1, b: 2}\n",
            "line 1: found \"b\", expected each key once",
        ),
        (
            "a: [1, 2\n3]\n",
            "line 1: found \"a: [1, 2\", expected a comma or a closing bracket",
        ),
        (
            "a: [1, 2,\n",
            "a closing bracket before the end of the file",
        ),
        ("a: [1,, 2]\n", "expected a number between commas"),
        ("a: [1] 2\n", "expected nothing behind the bracket"),
        ("a:1\n", "expected key: value"),
        ("a: *b\n", "anchors and text blocks are not read"),
        ("a: |\n  b\n", "anchors and text blocks are not read"),
        (
            "a: 1\n---\nb: 1\n",
            "line 2: found \"---\", expected one document",
        ),
        ("a: {b 1}\n", "expected key: value"),
        ("a: ['b]\n", "expected a closing quote"),
    ] {
        let source = source(text);
        let error = parse(&source)
            .err()
            .unwrap_or_else(|| panic!("{text:?} was taken"))
            .to_string();
        assert!(
            error.contains(expected),
            "found {error:?}, expected {expected:?}"
        );
    }
    for deep in [
        format!("a: {}{}", "[".repeat(90_000), "]".repeat(90_000)),
        format!("{}1", "- ".repeat(90_000)),
    ] {
        assert!(parse(&source(&deep)).is_err());
    }
}

#[test]
fn wrong_values_are_named() {
    let source = source("a: [1, 2]\nb: x\nc: [1, 2,5e, 3]\nd: [458,654, 1, 2,5]\n");
    let tree = parse(&source).unwrap();
    let root = At::root(&source, &tree);
    let error = |key: &str| {
        root.get(key)
            .and_then(|at| at.numbers::<3>())
            .unwrap_err()
            .to_string()
    };
    assert!(error("a").contains("line 1: found 2 numbers, expected a with 3 numbers"));
    assert!(error("b").contains("line 2: found \"x\", expected a list in brackets as b"));
    assert!(error("c").contains("line 3: found \"5e\", expected a finite number as c[2]"));
    assert!(error("d").contains("found 5 numbers (were decimal commas written?)"));
    assert!(error("e").contains("e is missing, found a, b, c"));
}

#[test]
fn quotes_must_be_closed() {
    for text in [
        "a: 1\nb: \"\n",
        "a: 1\nb: '\n",
        "a: 1\nb: \"x\n",
        "a: 1\nb: 'it''s\n",
        "a: 1\nb: \"x\" y\n",
        "- a\n- '\n",
    ] {
        let error = parse(&source(text)).unwrap_err().to_string();
        assert!(
            error.contains("line 2: found") && error.contains("closing quote"),
            "{text:?}: {error}"
        );
    }
    let text = "a: ''\nb: \"\"\nc: 'it''s'\n";
    let source = source(text);
    let tree = parse(&source).unwrap();
    let root = At::root(&source, &tree);
    assert_eq!(root.get("a").unwrap().text().unwrap(), "");
    assert_eq!(root.get("b").unwrap().text().unwrap(), "");
    assert_eq!(root.get("c").unwrap().text().unwrap(), "it's");
}
