//! `cargo run --release -p bench -- compare BEFORE AFTER`: whether a change of names left every
//! result as it was.
//!
//! BEFORE and AFTER are folders. Of their `*.json` files (results of benchmarks), every number and
//! text is compared, times, memory and stamps left out ([`MEASURES_OF_THE_MACHINE`]). Of their
//! `*.rs` files (checkouts), the pinned hashes: literals of 16 to 64 hexadecimal digits. Names of
//! BEFORE are replaced by those of a rename map first: `--renames FILE`, default
//! `docs/renames.txt`, with a line `old new` for every name and `old text => new text` for every
//! whole text.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail, ensure};
use serde_json::{Map, Value};

/// Keys whose values depend on the machine and its load.
const MEASURES_OF_THE_MACHINE: &[&str] = &[
    "stamp",
    "origin",
    "ms",
    "hz",
    "beaten_by",
    "not_beaten",
    "median_us",
    "p99_us",
    "max_us",
    "wall_ms",
    "wall_s",
    "cpu_ms",
    "cpu_s",
    "cpu_seconds",
    "cpu_percent",
    "cpu_ms_per_frame",
    "daemon_cpu_ms_per_frame",
    "bare_cpu_ms_per_frame",
    "bare_reading_cpu_ms_per_frame",
    "frames_per_s",
    "frames_per_second",
    "cpu_ms_per_picture",
    "cpu_ms_per_stereo_frame",
    "stages_cpu_ms_per_stereo_frame",
    "calibrating_cpu_s",
    "cpu_s_per_gb",
    "armed_cpu_s_per_s",
    "recording_cpu_s_per_s",
    "memory",
    "memory_mb",
    "peak_mb",
    "peak_bytes",
    "resident_bytes",
    "growth",
    "growth_after_first_minute_bytes",
    "load",
    "load_average",
    "host_load",
    "throughput",
    "times_real_time",
    "pairs_per_s",
    "pictures_per_s",
    "pictures_per_second",
    "images_per_s",
    "images_per_second",
    "sets_per_s",
    "bytes_per_s",
    "bytes_per_second",
    "syncs_per_s",
    "wakes_per_s",
    "preempted_per_s",
    "last_third_over_first",
    "ns_per_sample",
    "map_ms",
    "remap_ms",
    "full_ms",
    "band_ms",
    "ours_ms",
    "seconds",
    "minute",
    "minutes",
    "longest_set_ms",
    "system_call_us",
    "write",
    "read",
    "validate",
    "overhead",
    "stop_s",
    "first_wrong_s",
];

pub(crate) fn run(args: &[String]) -> Result<()> {
    let mut folders = Vec::new();
    let mut renames = PathBuf::from("docs/renames.txt");
    let mut rest = args.iter();
    while let Some(argument) = rest.next() {
        match argument.as_str() {
            "--renames" => renames = rest.next().context("--renames needs a file")?.into(),
            option if option.starts_with('-') => bail!("unknown option {option:?}"),
            folder => folders.push(PathBuf::from(folder)),
        }
    }
    let [before, after] = folders.as_slice() else {
        bail!(
            "expected two folders, BEFORE and AFTER; found {}",
            folders.len()
        );
    };
    let renames = Renames::read(&renames)?;
    let mut differences = Vec::new();
    let results = compare_results(before, after, &renames, &mut differences)?;
    let pins = compare_pins(before, after, &mut differences)?;
    println!(
        "{results} files of results, {pins} pinned hashes, {} differences",
        differences.len()
    );
    for difference in differences.iter().take(40) {
        println!("  {difference}");
    }
    ensure!(
        results + pins > 0,
        "nothing to compare: no results and no pinned hashes in {}",
        before.display()
    );
    ensure!(differences.is_empty(), "results differ");
    Ok(())
}

/// Old names to new ones.
struct Renames(BTreeMap<String, String>);

impl Renames {
    fn read(path: &Path) -> Result<Self> {
        let text = fs::read_to_string(path)
            .with_context(|| format!("reading the rename map {}", path.display()))?;
        Self::parse(&text)
    }

    fn parse(text: &str) -> Result<Self> {
        let mut map = BTreeMap::new();
        for (index, line) in text.lines().enumerate() {
            let line = line.trim();
            if line.is_empty() || line.starts_with('#') {
                continue;
            }
            let mut words = line.split_whitespace();
            let pair = line
                .split_once(" => ")
                .map(|(old, new)| (old.trim(), new.trim()));
            let pair = pair.or_else(|| match (words.next(), words.next(), words.next()) {
                (Some(old), Some(new), None) => Some((old, new)),
                _ => None,
            });
            let Some((old, new)) = pair else {
                bail!(
                    "rename map, line {}: found {line:?}, expected an old name and a new one",
                    index + 1
                );
            };
            if let Some(other) = map.insert(old.to_owned(), new.to_owned())
                && other != new
            {
                bail!(
                    "rename map, line {}: {old:?} becomes {new:?}, and {other:?} in an earlier line",
                    index + 1
                );
            }
        }
        Ok(Self(map))
    }

    /// The text with every name in it replaced. A name is a run of letters, digits, `_`, `-` and
    /// `.`.
    fn apply(&self, text: &str) -> String {
        if let Some(new) = self.0.get(text) {
            return new.clone();
        }
        let is_part = |c: char| c.is_alphanumeric() || "_-.".contains(c);
        let mut out = String::new();
        let mut rest = text;
        while let Some(start) = rest.find(is_part) {
            let (between, tail) = rest.split_at(start);
            let (name, next) = tail.split_at(tail.find(|c| !is_part(c)).unwrap_or(tail.len()));
            out += between;
            out += self.0.get(name).map_or(name, String::as_str);
            rest = next;
        }
        out + rest
    }
}

/// Compares the files of results of both folders and returns their number.
fn compare_results(
    before: &Path,
    after: &Path,
    renames: &Renames,
    differences: &mut Vec<String>,
) -> Result<usize> {
    let mut count = 0;
    for path in files(before, "json", false)? {
        let name = path
            .file_name()
            .unwrap_or_default()
            .to_string_lossy()
            .into_owned();
        let other = after.join(renames.apply(&name));
        if !other.exists() {
            differences.push(format!("{name}: no such file after"));
            continue;
        }
        count += 1;
        compare_values(
            &name,
            &renamed(&parse(&path)?, renames),
            &renamed(&parse(&other)?, renames),
            differences,
        );
    }
    Ok(count)
}

fn parse(path: &Path) -> Result<Value> {
    let text =
        fs::read_to_string(path).with_context(|| format!("reading results {}", path.display()))?;
    serde_json::from_str(&text).with_context(|| format!("parsing results {}", path.display()))
}

/// The value with names replaced and measures of the machine left out.
fn renamed(value: &Value, renames: &Renames) -> Value {
    match value {
        Value::Object(fields) => {
            let is_measure = |key: &str| MEASURES_OF_THE_MACHINE.contains(&key);
            let kept = fields
                .iter()
                .filter(|(key, _)| !is_measure(key) && !is_measure(&renames.apply(key)));
            Value::Object(
                kept.map(|(key, value)| (renames.apply(key), renamed(value, renames)))
                    .collect::<Map<_, _>>(),
            )
        }
        Value::Array(items) => {
            Value::Array(items.iter().map(|item| renamed(item, renames)).collect())
        }
        Value::String(text) => Value::String(renames.apply(text)),
        other => other.clone(),
    }
}

fn compare_values(path: &str, before: &Value, after: &Value, differences: &mut Vec<String>) {
    match (before, after) {
        (Value::Object(a), Value::Object(b)) => {
            let keys: BTreeSet<&String> = a.keys().chain(b.keys()).collect();
            for key in keys {
                let (a, b) = (
                    a.get(key).unwrap_or(&Value::Null),
                    b.get(key).unwrap_or(&Value::Null),
                );
                compare_values(&format!("{path}/{key}"), a, b, differences);
            }
        }
        (Value::Array(a), Value::Array(b)) if a.len() == b.len() => {
            for (index, (a, b)) in a.iter().zip(b).enumerate() {
                compare_values(&format!("{path}/{index}"), a, b, differences);
            }
        }
        (a, b) if a == b => {}
        (a, b) => differences.push(format!("{path}: {a} before, {b} after")),
    }
}

/// Compares the pinned hashes of both folders and returns their number. Each stands as often after
/// as before.
fn compare_pins(before: &Path, after: &Path, differences: &mut Vec<String>) -> Result<usize> {
    let (before, after) = (pins(before)?, pins(after)?);
    let all: BTreeSet<&String> = before.keys().chain(after.keys()).collect();
    for pin in all {
        let (a, b) = (before.get(pin).unwrap_or(&0), after.get(pin).unwrap_or(&0));
        if a != b {
            differences.push(format!("pinned hash {pin}: {a} times before, {b} after"));
        }
    }
    Ok(before.values().sum())
}

/// The hexadecimal literals of 16 to 64 digits in the `*.rs` files below a folder, and how often
/// each occurs.
fn pins(folder: &Path) -> Result<BTreeMap<String, usize>> {
    let mut found = BTreeMap::new();
    for path in files(folder, "rs", true)? {
        let text = fs::read_to_string(&path)
            .with_context(|| format!("reading a source file {}", path.display()))?;
        for word in text.split(|c: char| !(c.is_ascii_alphanumeric() || c == '_')) {
            let digits = word.strip_prefix("0x").unwrap_or(word).replace('_', "");
            let is_pin =
                (16..=64).contains(&digits.len()) && digits.bytes().all(|b| b.is_ascii_hexdigit());
            if is_pin && digits.bytes().any(|b| b.is_ascii_digit()) {
                *found.entry(digits.to_lowercase()).or_insert(0) += 1;
            }
        }
    }
    Ok(found)
}

/// The files with an extension in a folder, sorted; also those in folders below it, without
/// `target` and hidden ones.
fn files(folder: &Path, extension: &str, below: bool) -> Result<Vec<PathBuf>> {
    let reading = || format!("reading the folder {}", folder.display());
    let mut found = Vec::new();
    for entry in fs::read_dir(folder).with_context(reading)? {
        let path = entry.with_context(reading)?.path();
        let name = path
            .file_name()
            .unwrap_or_default()
            .to_string_lossy()
            .into_owned();
        if path.is_dir() {
            if below && name != "target" && !name.starts_with('.') {
                found.extend(files(&path, extension, below)?);
            }
        } else if path.extension().is_some_and(|e| e == extension) {
            found.push(path);
        }
    }
    found.sort();
    Ok(found)
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    fn compared(before: &Value, after: &Value, renames: &str) -> Vec<String> {
        let renames = Renames::parse(renames).unwrap();
        let mut differences = Vec::new();
        compare_values(
            "r",
            &renamed(before, &renames),
            &renamed(after, &renames),
            &mut differences,
        );
        differences
    }

    #[test]
    fn renamed_keys_and_texts_are_equal_and_changed_numbers_are_reported() {
        let before = json!({"sights": [1, 2.5], "what": "the sights of a", "wall_s": 3.0});
        let map = "# names\nsights inliers\nwhat parameter\n";
        let after = json!({"inliers": [1, 2.5], "parameter": "the inliers of a", "wall_s": 4.0});
        assert_eq!(compared(&before, &after, map), [""; 0]);
        let wrong = json!({"inliers": [1, 2.5000001], "parameter": "the inliers of a"});
        assert_eq!(
            compared(&before, &wrong, map),
            ["r/inliers/1: 2.5 before, 2.5000001 after"]
        );
        let missing = json!({"inliers": [1], "parameter": "the inliers of a"});
        assert_eq!(compared(&before, &missing, map).len(), 1);
        assert_eq!(compared(&before, &after, "").len(), 4);
    }

    #[test]
    fn a_changed_pin_is_reported() {
        let (a, b) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
        fs::write(
            a.path().join("x.rs"),
            "const A: u64 = 0x0123_4567_89ab_cdef;",
        )
        .unwrap();
        fs::write(
            b.path().join("y.rs"),
            "const B: u64 = 0x0123_4567_89ab_cdee;",
        )
        .unwrap();
        let mut differences = Vec::new();
        assert_eq!(
            compare_pins(a.path(), b.path(), &mut differences).unwrap(),
            1
        );
        assert_eq!(differences.len(), 2, "{differences:?}");
        differences.clear();
        compare_pins(a.path(), a.path(), &mut differences).unwrap();
        assert_eq!(differences, [""; 0]);
    }

    #[test]
    fn a_line_of_the_rename_map_without_two_names_or_with_another_new_name_is_an_error() {
        let error = Renames::parse("a b\nc\n").err().unwrap().to_string();
        assert!(
            error.contains("line 2") && error.contains("\"c\""),
            "{error}"
        );
        let error = Renames::parse("a b\na b\na c\n").err().unwrap().to_string();
        assert!(error.contains("line 3"), "{error}");
    }
}
