//! The arguments of the benchmarks of odometry.

use std::path::PathBuf;

use anyhow::{Context, Result, bail, ensure};

/// Parts to run, and folders.
#[derive(Debug, PartialEq)]
pub(crate) struct Options {
    /// A short slice of it.
    pub(crate) quick: bool,
    /// The folder of charts and tables; of a short slice below the target folder, unless it is
    /// named.
    pub(crate) out: PathBuf,
    /// The folder of rendered images.
    pub(crate) walks: PathBuf,
    /// The parts to run, in order.
    pub(crate) parts: Vec<String>,
    /// The walks to run on; none for all.
    pub(crate) names: Vec<String>,
}

impl Options {
    /// # Errors
    /// An unknown argument or part, or an argument without its value.
    pub(crate) fn parse(args: &[String], parts: &[&str]) -> Result<Self> {
        let quick = args.iter().any(|a| a == "--quick");
        let mut parsed = Self {
            quick,
            // Results are added to existing ones: those of a quick run do not belong to the others.
            out: PathBuf::from(if quick {
                "target/trial"
            } else {
                "docs/benchmarks"
            }),
            walks: default_walks(),
            parts: parts.iter().map(|p| (*p).to_owned()).collect(),
            names: Vec::new(),
        };
        let mut rest = args.iter();
        let list = |value: &String| value.split(',').map(str::to_owned).collect::<Vec<_>>();
        while let Some(argument) = rest.next() {
            let mut value = || {
                let value = rest.next();
                value.with_context(|| format!("{argument} needs a value"))
            };
            match argument.as_str() {
                "--quick" => {}
                "--out" => parsed.out = value()?.into(),
                "--walks" => parsed.walks = value()?.into(),
                "--name" => parsed.names = list(value()?),
                "--only" => {
                    parsed.parts = list(value()?);
                    for part in &parsed.parts {
                        let known = parts.join(", ");
                        ensure!(
                            parts.contains(&part.as_str()),
                            "found the part {part:?}, expected some of {known}"
                        );
                    }
                }
                other => bail!(
                    "unknown argument {other:?}, expected --quick, --only PARTS, --name WALKS, --walks DIR or --out DIR"
                ),
            }
        }
        Ok(parsed)
    }

    /// The strengths of a sweep in this run, weakest first: a quick run uses only the strongest.
    pub(crate) fn strengths<'a>(&self, all: &'a [f64]) -> &'a [f64] {
        &all[if self.quick { all.len() - 1 } else { 0 }..]
    }

    /// The walks that were named, or all of these.
    pub(crate) fn walks_or(&self, all: &[&str]) -> Vec<String> {
        if self.names.is_empty() {
            all.iter().map(|walk| (*walk).to_owned()).collect()
        } else {
            self.names.clone()
        }
    }

    /// Whether a walk is to be run on.
    pub(crate) fn takes(&self, name: &str) -> bool {
        self.names.is_empty() || self.names.iter().any(|n| n == name)
    }
}

/// The folder that `PAWS_WALKS` names, or one in the target folder.
fn default_walks() -> PathBuf {
    let named = std::env::var_os("PAWS_WALKS").filter(|value| !value.is_empty());
    let beside = || {
        PathBuf::from(concat!(
            env!("CARGO_MANIFEST_DIR"),
            "/../../../target/walks"
        ))
    };
    named.map_or_else(beside, PathBuf::from)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn parse(args: &[&str]) -> Result<Options> {
        let args: Vec<String> = args.iter().map(|a| (*a).to_owned()).collect();
        Options::parse(&args, &["kitti", "walks"])
    }

    #[test]
    fn parts_and_walks_are_chosen() {
        let all = parse(&[]).expect("no arguments");
        assert_eq!(all.parts, ["kitti", "walks"]);
        assert!(all.takes("anything") && !all.quick);
        let some = parse(&["--only", "walks", "--name", "a,b", "--quick"]).expect("arguments");
        assert_eq!(some.parts, ["walks"]);
        assert!(some.takes("b") && !some.takes("c") && some.quick);
    }

    #[test]
    fn unknown_arguments_are_refused() {
        assert!(parse(&["--only", "boats"]).is_err());
        assert!(parse(&["--out"]).is_err());
        assert!(parse(&["fast"]).is_err());
    }
}
