//! OpenCV's matchers, in a process of their own that lives as long as the benchmark, so that both
//! sides keep their buffers.

use std::fs;
use std::io::{BufRead, BufReader, Write};
use std::path::Path;
use std::process::{Child, ChildStdin, ChildStdout, Command, Stdio};

use anyhow::{Context, Result, ensure};
use depth::DisparityMap;
use serde::Serialize;
use serde_json::{Value, json};
use tempfile::TempDir;

use super::frames::Frame;
use crate::python;

/// A matcher with its parameters.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub(crate) struct SgbmConfig {
    /// `BM`, or a mode of SGBM: `SGBM`, `HH`, `SGBM_3WAY`, `HH4`.
    pub(crate) mode: &'static str,
    /// Side of the window, px.
    pub(crate) block: u32,
    /// Uniqueness ratio, percent.
    pub(crate) unique: u32,
    /// Greatest step within a speckle, px.
    pub(crate) speckle: u32,
    /// Whether images are smoothed by 3x3 pixels first.
    pub(crate) smooth: bool,
}

/// The modes of SGBM.
pub(crate) const MODES: [&str; 4] = ["SGBM", "HH", "SGBM_3WAY", "HH4"];

impl SgbmConfig {
    /// All of their modes, strict and not, on original and smoothed images, with windows of these
    /// sizes.
    fn with_windows(bm: &[u32], sgbm: &[u32]) -> Vec<Self> {
        let mut all = Vec::new();
        for smooth in [false, true] {
            for unique in [0, 10] {
                let simple = bm.iter().map(|block| ("BM", *block));
                let modes = MODES
                    .iter()
                    .flat_map(|mode| sgbm.iter().map(|block| (*mode, *block)));
                all.extend(simple.chain(modes).map(|(mode, block)| Self {
                    unique,
                    smooth,
                    ..Self::usual(mode, block)
                }));
            }
        }
        all
    }

    /// With windows from small to large.
    pub(crate) fn many() -> Vec<Self> {
        Self::with_windows(&[7, 11, 15, 21], &[3, 5, 9])
    }

    /// With those that do best on a real pair.
    pub(crate) fn few() -> Vec<Self> {
        Self::with_windows(&[11, 15], &[5])
    }

    /// As in OpenCV's samples: ten percent of uniqueness.
    pub(crate) fn usual(mode: &'static str, block: u32) -> Self {
        Self {
            mode,
            block,
            unique: 10,
            speckle: 2,
            smooth: false,
        }
    }

    pub(crate) fn name(&self) -> String {
        let smooth = if self.smooth { " smoothed" } else { "" };
        format!("{} {} u{}{smooth}", self.mode, self.block, self.unique)
    }
}

/// The process.
pub(crate) struct Peers {
    child: Child,
    input: Option<ChildStdin>,
    output: BufReader<ChildStdout>,
    folder: TempDir,
    pub(crate) version: String,
}

impl Peers {
    /// Starts it.
    ///
    /// # Errors
    /// There is no Python with OpenCV.
    pub(crate) fn start() -> Result<Self> {
        let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("src/depth.py");
        let mut child = Command::new(python::interpreter()?)
            .arg(script)
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .spawn()
            .context("starting python")?;
        let input = child.stdin.take().context("python's standard input")?;
        let output = child.stdout.take().context("python's standard output")?;
        let mut peers = Self {
            child,
            input: Some(input),
            output: BufReader::new(output),
            folder: tempfile::tempdir().context("making a folder for images")?,
            version: String::new(),
        };
        let hello = peers.read()?;
        peers.version = hello["version"]
            .as_str()
            .context("OpenCV's version")?
            .to_owned();
        Ok(peers)
    }

    fn read(&mut self) -> Result<Value> {
        let mut line = String::new();
        let count = self
            .output
            .read_line(&mut line)
            .context("reading from python")?;
        ensure!(count > 0, "python ended early");
        serde_json::from_str(&line).context("reading what python says")
    }

    /// Sets the pair to match.
    ///
    /// # Errors
    /// Any I/O error.
    pub(crate) fn show(&self, frame: &Frame) -> Result<()> {
        for (name, pixels) in ["left", "right"].iter().zip(&frame.eyes) {
            fs::write(self.folder.path().join(name), pixels).context("writing an image")?;
        }
        Ok(())
    }

    /// Runs each matcher once on the pair that is shown; gives the times in ms, and on request the
    /// disparities.
    ///
    /// # Errors
    /// Python fails.
    pub(crate) fn run(
        &mut self,
        frame: &Frame,
        configs: &[SgbmConfig],
        threads: usize,
        wants_maps: bool,
    ) -> Result<(Vec<f64>, Vec<DisparityMap>)> {
        let folder = self.folder.path().to_owned();
        let job = json!({
            "left": folder.join("left"),
            "right": folder.join("right"),
            "size": [frame.width, frame.height],
            "range": frame.range,
            "threads": threads,
            "out": wants_maps.then_some(&folder),
            "configs": configs,
        });
        let input = self.input.as_mut().context("python was requested to end")?;
        writeln!(input, "{job}").context("writing to python")?;
        let answer = self.read()?;
        let times: Vec<f64> =
            serde_json::from_value(answer["ms"].clone()).context("reading times")?;
        ensure!(times.len() == configs.len(), "a time for each matcher");
        let mut maps = Vec::new();
        if wants_maps {
            for k in 0..configs.len() {
                let path = folder.join(format!("{k}.raw"));
                let bytes =
                    fs::read(&path).with_context(|| format!("reading {}", path.display()))?;
                maps.push(map(frame, &bytes)?);
            }
        }
        Ok((times, maps))
    }
}

impl Drop for Peers {
    fn drop(&mut self) {
        // Its input ends, and so does it.
        self.input = None;
        drop(self.child.wait());
    }
}

/// Sixteenths of a pixel as a map; there is no sigma, so nothing is within it.
fn map(frame: &Frame, bytes: &[u8]) -> Result<DisparityMap> {
    ensure!(
        bytes.len() == 2 * frame.width * frame.height,
        "a map of another size"
    );
    let sixteenths = bytes
        .chunks_exact(2)
        .map(|b| i16::from_le_bytes([b[0], b[1]]));
    let disparity: Vec<f32> = sixteenths
        .map(|d| if d < 0 { f32::NAN } else { f32::from(d) / 16.0 })
        .collect();
    Ok(DisparityMap {
        width: frame.width,
        height: frame.height,
        sigma: vec![0.0; disparity.len()],
        disparity,
    })
}
