//! `feet`: shoe tags, contacts and swings on simulated walks.
//!
//! - [`tags`]: sightings of shoe tags against the truth.
//! - [`gait`]: contacts, their times, and hidden swings, from these sightings and true poses of the
//!   rig.

use anyhow::Result;
use serde_json::json;

use crate::arguments::Arguments;
use crate::odometry::results;
use crate::stamp;

mod gait;
mod tags;

/// Runs the benchmark: `[--quick] [--out DIR]`.
///
/// # Errors
/// Bad arguments, or an I/O error.
pub(crate) fn run(args: &[String]) -> Result<()> {
    let Arguments { quick, out } = Arguments::parse(args)?;
    let tags = tags::run(quick)?;
    let report = json!({
        "benchmark": "feet",
        "stamp": stamp::stamp("feet", args)?,
        "tags": tags,
    });
    results::write(
        &out,
        vec![("feet.json".to_owned(), format!("{report:#}\n"))],
    )
}
