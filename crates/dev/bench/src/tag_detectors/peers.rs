//! Peers in processes of their own: `pupil-apriltags` (the reference implementation, AprilTag 3, in
//! C) in Python, and `kornia-apriltag` in a program that `cargo xtask bench` builds.

use std::fs;
use std::io::Write;
use std::process::{Command, Stdio};

use anyhow::{Context, Result, ensure};
use serde::Deserialize;
use serde_json::{Value, json};

use super::methods::Answers;
use crate::python;

/// Names the program of kornia-apriltag.
const KORNIA: &str = "PAWS_KORNIA_APRILTAG";
/// Images are reduced by these factors before quadrilaterals are looked for.
const DECIMATIONS: [u32; 2] = [1, 2];

/// What a peer reports.
#[derive(Debug, Deserialize)]
struct Report {
    version: String,
    methods: Vec<Answers>,
}

/// Versions and answers of all peers.
#[derive(Debug, Default)]
pub(super) struct Peers {
    pub(super) versions: Vec<String>,
    pub(super) answers: Vec<Answers>,
}

/// Answers of the peers on images of one size.
///
/// # Errors
/// A peer fails, or there is no interpreter with `pupil-apriltags`.
pub(super) fn answers(images: &[&[u8]], size: [usize; 2]) -> Result<Peers> {
    let folder = tempfile::tempdir().context("making a folder for images")?;
    let mut paths = Vec::new();
    for (number, pixels) in images.iter().enumerate() {
        let path = folder.path().join(format!("{number}.raw"));
        fs::write(&path, pixels).context("writing an image")?;
        paths.push(path);
    }
    let question = json!({ "images": paths, "size": size, "decimations": DECIMATIONS });
    let mut peers = Peers::default();
    let mut add = |answer: Value| -> Result<()> {
        let report: Report = serde_json::from_value(answer).context("reading a peer's report")?;
        for method in &report.methods {
            ensure!(
                method.images.len() == images.len(),
                "{}: an answer for each image",
                method.name
            );
        }
        peers.versions.push(report.version);
        peers.answers.extend(report.methods);
        Ok(())
    };
    add(python::ask("tag_detectors/april_tag.py", &question)?)?;
    if has_kornia() {
        add(ask_kornia(&question)?)?;
    }
    Ok(peers)
}

/// Whether there is a program of kornia-apriltag.
pub(super) fn has_kornia() -> bool {
    std::env::var_os(KORNIA).is_some()
}

fn ask_kornia(question: &Value) -> Result<Value> {
    let program = std::env::var_os(KORNIA).with_context(|| format!("{KORNIA} names no program"))?;
    let mut child = Command::new(program)
        .env("RAYON_NUM_THREADS", "1")
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .spawn()
        .context("starting the program of kornia-apriltag")?;
    let mut stdin = child.stdin.take().context("its standard input")?;
    stdin
        .write_all(question.to_string().as_bytes())
        .context("writing to it")?;
    drop(stdin);
    let output = child.wait_with_output().context("waiting for it")?;
    ensure!(output.status.success(), "it ended with {}", output.status);
    serde_json::from_slice(&output.stdout).context("reading what it reports")
}
