//! `paws-reconstruct evaluate-depth`.

use std::path::PathBuf;
use std::process::ExitCode;

use anyhow::Result;
use clap::Args;
use command_line::output::print;
use reconstruction::evaluate::depth::{CameraDepth, evaluate};
use scene_bundle::Scene;

use super::progress_bar;

#[derive(Args)]
pub(crate) struct Arguments {
    /// The scene bundle.
    scene: PathBuf,
    /// The folder that `paws-rig-sim render --truth` wrote with the session.
    #[arg(long, value_name = "FOLDER")]
    truth: PathBuf,
    /// Print JSON.
    #[arg(long)]
    json: bool,
}

pub(crate) fn run(arguments: &Arguments) -> Result<ExitCode> {
    let scene = Scene::open(&arguments.scene)?;
    let bar = progress_bar(0, "comparing {wide_bar} {pos}/{len} keyframes, {eta} left")?;
    let rows = evaluate(&scene, &arguments.truth, |done, total| {
        bar.set_length(total);
        bar.set_position(done);
    })?;
    bar.finish_and_clear();
    if arguments.json {
        print(serde_json::to_string_pretty(&rows)?)?;
        return Ok(ExitCode::SUCCESS);
    }
    print(format_args!(
        "{:16} {:>8} {:>8} {:>7} {:>7} {:>7} {:>7} {:>8} {:>9}",
        "camera", "images", "density", "bad-1", "bad-2", "bad-3", "EPE px", "2 sigma", "invented"
    ))?;
    for row in &rows {
        print(line(row))?;
    }
    if let Some(all) = rows.last() {
        print(format_args!(
            "bad-2 {:.2} % at density {:.2}, {:.1} % within 2 sigma",
            100.0 * all.bad[1],
            all.density,
            100.0 * all.within_2_sigma
        ))?;
    }
    Ok(ExitCode::SUCCESS)
}

fn line(row: &CameraDepth) -> String {
    let [one, two, three] = row.bad.map(|share| format!("{:.2} %", 100.0 * share));
    format!(
        "{:16} {:>8} {:>8.3} {one:>7} {two:>7} {three:>7} {:>7.3} {:>8} {:>9}",
        row.camera,
        row.images,
        row.density,
        row.mean_error_px,
        format!("{:.1} %", 100.0 * row.within_2_sigma),
        format!("{:.2} %", 100.0 * row.invented),
    )
}
