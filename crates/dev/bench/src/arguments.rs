//! The arguments that most benchmarks take: `[--quick] [--out DIR]`.

use std::path::PathBuf;

use anyhow::{Context, Result, bail, ensure};

/// Amount of work, and output folder.
#[derive(Debug, PartialEq)]
pub(crate) struct Arguments {
    /// A short slice of it.
    pub(crate) quick: bool,
    /// The folder of charts and tables.
    pub(crate) out: PathBuf,
}

impl Arguments {
    /// # Errors
    /// Any other argument, or `--out` without a folder.
    pub(crate) fn parse(args: &[String]) -> Result<Self> {
        let mut parsed = Self {
            quick: false,
            out: PathBuf::from("docs/benchmarks"),
        };
        let mut rest = args.iter();
        while let Some(argument) = rest.next() {
            match argument.as_str() {
                "--quick" => parsed.quick = true,
                "--out" => parsed.out = rest.next().context("--out needs a folder")?.into(),
                other => bail!("unknown argument {other:?}, expected --quick or --out DIR"),
            }
        }
        Ok(parsed)
    }
}

/// The parts of a benchmark that `--only` names, of those it has.
///
/// # Errors
/// There is no list, or a part of another name in it.
pub(crate) fn parts(list: Option<&String>, known: &[&str]) -> Result<Vec<String>> {
    let list = list.context("--only needs parts")?;
    let parts: Vec<String> = list.split(',').map(str::to_owned).collect();
    ensure!(
        parts.iter().all(|part| known.contains(&part.as_str())),
        "found the parts {list:?}, expected some of {}",
        known.join(", ")
    );
    Ok(parts)
}
