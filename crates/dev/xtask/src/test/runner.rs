//! Reading the standard test runner's output: what to show, what was skipped, what failed.
//!
//! With `--show-output` the runner prints what passing tests wrote, between a line `successes:`
//! and its closing line. Only the lines that begin with `skipped:` are of interest there; they are
//! collected, and the rest of that block is hidden. Every other line is shown as it came, the
//! closing lines (`test result: ...`) above all.

/// What was gathered from the output so far.
#[derive(Debug, Default)]
pub(crate) struct Report {
    /// Test name and the reason it printed.
    pub(crate) skipped: Vec<(String, String)>,
    /// Names of the tests that failed.
    pub(crate) failed: Vec<String>,
    passed: usize,
    /// The test whose captured output is being read, inside the block of passing tests.
    inside: Option<String>,
}

impl Report {
    /// Takes one line without its line end; says whether to show it.
    pub(crate) fn take(&mut self, line: &str) -> bool {
        if let Some(test) = &mut self.inside {
            if line == "failures:" || line.starts_with("test result: ") {
                self.inside = None;
            } else {
                let heading = line.strip_prefix("---- ");
                if let Some(name) = heading.and_then(|rest| rest.strip_suffix(" stdout ----")) {
                    *test = name.to_owned();
                } else if let Some(reason) = line.strip_prefix("skipped:") {
                    self.skipped.push((test.clone(), reason.trim().to_owned()));
                }
                return false;
            }
        } else if line == "successes:" {
            self.inside = Some(String::new());
            return false;
        }
        if let Some(result) = line.strip_prefix("test ") {
            if let Some(name) = result.strip_suffix(" ... FAILED") {
                self.failed.push(name.to_owned());
            } else if result.ends_with(" ... ok") {
                self.passed += 1;
            }
        }
        true
    }

    /// `128 passed, 2 of them skipped`, for the table.
    pub(crate) fn counts(&self) -> String {
        let mut names: Vec<&str> = self.skipped.iter().map(|(name, _)| name.as_str()).collect();
        names.dedup();
        match names.len() {
            0 => format!("{} passed", self.passed),
            skipped => format!("{} passed, {skipped} of them skipped", self.passed),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const OUTPUT: &str = "
running 3 tests
test real_data ... ok
test quiet ... ok
test wrong ... FAILED

successes:

---- real_data stdout ----
skipped: no recordings; set PAWS_DATA
chatter that nobody requested
skipped: no Python

---- noisy stdout ----
chatter

successes:
    quiet
    real_data

failures:

---- wrong stdout ----
thread 'wrong' panicked at src/lib.rs:1:1:
skipped: inside a failure this is evidence, not a skip

failures:
    wrong

test result: FAILED. 2 passed; 1 failed; 0 ignored; 0 measured; 0 filtered out; finished in 0.00s
";

    #[test]
    fn skips_are_collected_and_the_rest_of_passing_output_is_hidden() {
        let mut report = Report::default();
        let shown: Vec<&str> = OUTPUT.lines().filter(|line| report.take(line)).collect();
        let shown = shown.join("\n");
        assert_eq!(
            report.skipped,
            [
                ("real_data".into(), "no recordings; set PAWS_DATA".into()),
                ("real_data".into(), "no Python".into()),
            ]
        );
        assert_eq!(report.failed, ["wrong"]);
        assert_eq!(report.counts(), "2 passed, 1 of them skipped");
        assert!(!shown.contains("chatter"), "{shown}");
        for kept in [
            "test real_data ... ok",
            "panicked at",
            "evidence",
            "test result: FAILED.",
        ] {
            assert!(shown.contains(kept), "{kept:?} is hidden in:\n{shown}");
        }
    }

    #[test]
    fn a_second_run_in_the_same_output_starts_shown() {
        let mut report = Report::default();
        for line in OUTPUT.lines() {
            report.take(line);
        }
        assert!(report.take("running 1 test"));
        assert!(report.take("test other ... ok"));
        assert_eq!(report.counts(), "3 passed, 1 of them skipped");
    }
}
