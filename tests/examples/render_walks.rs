//! Renders walks once, so that later runs can reuse them: `cargo run --release -p tests --example
//! render_walks -- FOLDER [NAME...]`.
//!
//! Names are those of `harness::sequences::named`; default: all walks for tuning.
#![expect(
    clippy::disallowed_methods,
    reason = "a program for people at a desk says how long it took"
)]

use std::path::PathBuf;
use std::time::Instant;

use anyhow::{Context as _, Result};
use harness::sequences::{named, walk};

fn main() -> Result<()> {
    let mut arguments = std::env::args().skip(1);
    let folder = arguments
        .next()
        .context("where to? render_walks FOLDER [NAME...]")?;
    let folder = PathBuf::from(folder);
    let mut names: Vec<String> = arguments.collect();
    if names.is_empty() {
        names = named::TUNING.map(str::to_owned).to_vec();
    }
    for name in names {
        let began = Instant::now();
        let sequence = walk(&named::settings(&name)?)?.cached(&folder)?;
        let seconds = began.elapsed().as_secs_f64();
        println!("{name}: {} sets in {seconds:.1} s", sequence.len());
    }
    Ok(())
}
