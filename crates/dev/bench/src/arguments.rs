//! The arguments that most benchmarks take: `[--quick] [--out DIR]`.

use std::path::PathBuf;

use anyhow::{Context, Result, bail};

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
