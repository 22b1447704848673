//! JSON with the line of every value.

use std::collections::BTreeSet;
use std::fmt;

use serde::de::{Deserialize, Deserializer, MapAccess, Visitor};
use serde_json::value::RawValue;

use super::{MAX_DEPTH, Node, Value};
use crate::error::CalibError;
use crate::text::Source;

/// Reads a whole file.
pub(crate) fn parse(source: &Source) -> Result<Node, CalibError> {
    let text = source.text.trim_start_matches('\u{feff}');
    let raw: &RawValue = serde_json::from_str(text).map_err(|e| syntax(source, text, &e))?;
    let breaks = text.match_indices('\n').map(|(at, _)| at).collect();
    let whole = Whole {
        source,
        text,
        breaks,
    };
    node(&whole, raw.get(), 0)
}

/// The whole file.
struct Whole<'a> {
    source: &'a Source,
    text: &'a str,
    /// Line ends of the file.
    breaks: Vec<usize>,
}

fn node(whole: &Whole<'_>, raw: &str, depth: usize) -> Result<Node, CalibError> {
    let Whole {
        source,
        text,
        breaks,
    } = whole;
    // `raw` is a part of `text`, so that its offset is the difference of the two addresses.
    let before = raw.as_ptr() as usize - text.as_ptr() as usize;
    let line = 1 + breaks.partition_point(|at| *at < before);
    if depth > MAX_DEPTH {
        let found = format!("more than {MAX_DEPTH} values inside each other");
        return Err(source.unexpected(line, &found, "a calibration"));
    }
    let inner = |e: serde_json::Error| source.unexpected(line, &e.to_string(), "valid JSON");
    let value = match raw.as_bytes().first() {
        Some(b'{') => {
            let Entries(entries) = serde_json::from_str(raw).map_err(inner)?;
            let mut map: Vec<(String, Node)> = Vec::with_capacity(entries.len());
            let mut known = BTreeSet::new();
            for (key, raw) in entries {
                let child = node(whole, raw.get(), depth + 1)?;
                if !known.insert(key.clone()) {
                    return Err(source.malformed(child.line, &key, "each key once"));
                }
                map.push((key, child));
            }
            Value::Map(map)
        }
        Some(b'[') => {
            let items: Vec<&RawValue> = serde_json::from_str(raw).map_err(inner)?;
            let items = items
                .into_iter()
                .map(|raw| node(whole, raw.get(), depth + 1));
            Value::List(items.collect::<Result<_, _>>()?)
        }
        Some(b'"') => Value::Quoted(serde_json::from_str(raw).map_err(inner)?),
        _ => Value::Plain(raw.to_owned()),
    };
    Ok(Node { line, value })
}

/// A syntax error with the text of its line.
fn syntax(source: &Source, text: &str, error: &serde_json::Error) -> CalibError {
    let line = error.line().max(1);
    let content = text.lines().nth(line - 1).unwrap_or_default().trim();
    let digits_around_comma = content
        .as_bytes()
        .windows(3)
        .any(|w| w[0].is_ascii_digit() && w[1] == b',' && w[2].is_ascii_digit());
    let expected = match (error.is_eof(), digits_around_comma) {
        (true, _) => "the rest of the file: it is cut off".to_owned(),
        (_, true) => format!("valid JSON ({error}; is there a decimal comma?)"),
        _ => format!("valid JSON ({error})"),
    };
    let shown: String = content.chars().take(60).collect();
    source.malformed(line, &shown, &expected)
}

/// An object in the order of the file, with duplicate keys.
struct Entries<'a>(Vec<(String, &'a RawValue)>);

impl<'de> Deserialize<'de> for Entries<'de> {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct Objects;
        impl<'de> Visitor<'de> for Objects {
            type Value = Entries<'de>;

            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str("an object")
            }

            fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<Entries<'de>, A::Error> {
                let mut entries = Vec::new();
                while let Some(entry) = map.next_entry()? {
                    entries.push(entry);
                }
                Ok(Entries(entries))
            }
        }
        deserializer.deserialize_map(Objects)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::tree::At;

    fn source(text: &str) -> Source {
        Source {
            path: "calib.json".into(),
            text: text.to_owned(),
        }
    }

    #[test]
    fn values_know_their_lines_and_keys() {
        let source =
            source("\u{feff}{\n \"a\": {\"b\": [1.5,\n  -2e-05, \"x\\n\"]},\n \"n\": null}\n");
        let tree = parse(&source).unwrap();
        let root = At::root(&source, &tree);
        let items = root.get("a.b").unwrap().items().unwrap();
        assert_eq!((items[0].line(), items[1].line()), (2, 3));
        assert_eq!(items[1].number().unwrap(), -2e-05);
        assert_eq!(items[2].text().unwrap(), "x\n");
        assert!(root.find("n").is_none() && root.find("a.c").is_none());
        let error = items[2].number().unwrap_err().to_string();
        assert!(
            error.contains("line 3: found \"x\\n\", expected a finite number as a.b[2]"),
            "{error}"
        );
        let error = root.get("a.c").err().unwrap().to_string();
        assert!(
            error.contains("a.c is missing, found b (line 2)"),
            "{error}"
        );
    }

    #[test]
    fn damage_is_named_with_its_line() {
        for (text, expected) in [
            (
                "{\n\"a\": 1,5\n}",
                "line 2: found \"\\\"a\\\": 1,5\", expected valid JSON",
            ),
            ("{\n\"a\": 1,5\n}", "is there a decimal comma?"),
            ("{\"a\": [1, 2", "cut off"),
            ("", "cut off"),
            ("{\"a\": NaN}", "line 1: found"),
            (
                "{\"a\": 1,\n \"a\": 2}",
                "line 2: found \"a\", expected each key once",
            ),
        ] {
            let error = parse(&source(text)).unwrap_err().to_string();
            assert!(
                error.contains(expected),
                "found {error:?}, expected {expected:?}"
            );
        }
        let deep = "[".repeat(60) + &"]".repeat(60);
        assert!(
            parse(&source(&deep))
                .unwrap_err()
                .to_string()
                .contains("more than 32")
        );
        let deeper = "[".repeat(100_000) + &"]".repeat(100_000);
        assert!(parse(&source(&deeper)).is_err());
    }
}
