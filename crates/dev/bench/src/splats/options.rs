//! Arguments of the benchmark.

use std::path::PathBuf;

use anyhow::{Context, Result, bail};

use super::walks::Extent;
use crate::arguments;
use crate::terrain::walks::SMALL;

pub(super) const PARTS: [&str; 6] = ["walks", "settings", "counts", "failures", "plain", "fox"];

/// Views off the path for each offset and angle.
const OFF_PATH_VIEWS: usize = 4;
/// Of a quick run.
const QUICK_STEPS: usize = 300;
const QUICK_S: f64 = 12.0;

pub(super) struct Options {
    pub(super) out: PathBuf,
    pub(super) parts: Vec<String>,
    /// Short names of the walks to run; empty for those of the part.
    pub(super) walks: Vec<String>,
    pub(super) presets: Vec<String>,
    /// Number of steps in place of the presets'.
    pub(super) steps: Option<usize>,
    pub(super) extent: Extent,
    pub(super) off_path_views: usize,
}

impl Options {
    pub(super) fn parse(args: &[String]) -> Result<Self> {
        let mut parsed = Self {
            out: PathBuf::from("docs/benchmarks"),
            parts: PARTS.map(str::to_owned).to_vec(),
            walks: Vec::new(),
            presets: vec!["balanced".to_owned()],
            steps: None,
            extent: Extent::WHOLE,
            off_path_views: OFF_PATH_VIEWS,
        };
        let mut rest = args.iter();
        while let Some(argument) = rest.next() {
            let mut value = || {
                rest.next()
                    .with_context(|| format!("{argument} needs a value"))
            };
            let list = |text: &String| text.split(',').map(str::to_owned).collect();
            match argument.as_str() {
                "--quick" => {
                    parsed.extent.seconds = QUICK_S;
                    parsed.extent.size = SMALL.map(|edge| edge / 2);
                    parsed.steps = Some(QUICK_STEPS);
                    parsed.off_path_views = 1;
                }
                "--half" => parsed.extent.size = SMALL.map(|edge| edge / 2),
                "--out" => parsed.out = value()?.into(),
                "--walks" => parsed.walks = list(value()?),
                "--preset" | "--presets" => parsed.presets = list(value()?),
                "--steps" => parsed.steps = Some(value()?.parse().context("reading --steps")?),
                "--seconds" => {
                    parsed.extent.seconds = value()?.parse().context("reading --seconds")?;
                }
                "--only" => parsed.parts = arguments::parts(rest.next(), &PARTS)?,
                other => bail!(
                    "unknown argument {other:?}, expected --quick, --only, --walks, --presets, \
                     --steps, --seconds, --half or --out"
                ),
            }
        }
        Ok(parsed)
    }

    /// Walks of a part: those that were named, or its own.
    pub(super) fn walks(&self, part: &str) -> Vec<String> {
        if !self.walks.is_empty() {
            return self.walks.clone();
        }
        let own: &[&str] = match part {
            "settings" | "counts" => &["pavement", "room"],
            "failures" => &["plaza"],
            "plain" => &["pavement"],
            _ => &[],
        };
        own.iter().map(|name| (*name).to_owned()).collect()
    }
}
