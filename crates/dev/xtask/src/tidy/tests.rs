use std::fs;
use std::path::PathBuf;

use super::ratchet::Direction;
use super::*;

fn measure(key: &str, value: usize) -> Measure {
    Measure {
        key: key.into(),
        value,
        direction: Direction::MayFall,
        places: Vec::new(),
        of: None,
    }
}

/// A repository root with a file of counts, removed at the end.
struct Root(PathBuf);

impl Root {
    fn new(name: &str, counts: Option<&str>) -> Self {
        let name = format!("xtask-tidy-{name}-{}", std::process::id());
        let root = std::env::temp_dir().join(name);
        fs::create_dir_all(root.join("docs")).expect("a folder");
        if let Some(counts) = counts {
            fs::write(root.join(COUNTS), counts).expect("a file");
        }
        Self(root)
    }

    fn counts(&self) -> Vec<String> {
        let text = fs::read_to_string(self.0.join(COUNTS)).expect("a file of counts");
        let lines = text.lines().filter(|line| !line.starts_with('#'));
        lines.map(str::to_owned).collect()
    }
}

impl Drop for Root {
    fn drop(&mut self) {
        let _ = fs::remove_dir_all(&self.0);
    }
}

fn conclusion(root: &Root, found: &[Measure], write: bool) -> Result<String> {
    compare(&root.0, found, write)
        .expect("a comparison")
        .conclusion
}

#[test]
fn a_count_that_rose_fails_and_is_never_written() {
    let root = Root::new("rose", Some("a 1\nb 5\n"));
    let found = [measure("a", 2), measure("b", 4)];
    for write in [false, true] {
        let error = conclusion(&root, &found, write).expect_err("a count that rose");
        let text = error.to_string();
        assert!(
            text.contains("1 count is worse") && text.contains(": a."),
            "{text}"
        );
    }
    assert_eq!(root.counts(), ["a 1", "b 4"]);
}

#[test]
fn a_count_that_fell_is_no_failure_and_is_lowered_when_written() {
    let root = Root::new("fell", Some("a 3\nunused 7\n"));
    let found = [measure("a", 2)];
    let summary = conclusion(&root, &found, false).expect("no count rose");
    assert!(
        summary.contains("2 fell") && summary.contains("--write"),
        "{summary}"
    );
    assert_eq!(root.counts(), ["a 3", "unused 7"]);
    conclusion(&root, &found, true).expect("no count rose");
    assert_eq!(root.counts(), ["a 2"]);
    assert_eq!(
        conclusion(&root, &found, false).expect("the same"),
        "No count rose."
    );
}

#[test]
fn a_new_count_fails_until_it_is_written() {
    let root = Root::new("new", None);
    let found = [measure("a", 2), measure("b", 0)];
    let error = conclusion(&root, &found, false).expect_err("no counts");
    assert!(error.to_string().contains("2 counts are not in"), "{error}");
    conclusion(&root, &found, true).expect("new counts");
    assert_eq!(root.counts(), ["a 2", "b 0"]);
    conclusion(&root, &found, false).expect("known counts");
}

#[test]
fn a_list_of_an_unknown_crate_is_refused() {
    let known = Measure {
        of: Some("calib".into()),
        ..measure("comment-words calib", 0)
    };
    let error = list(&[known], Some("clib")).expect_err("an unknown crate");
    assert!(error.to_string().contains("known: calib"), "{error}");
}
