//! `paws-reconstruct report`.

use std::path::PathBuf;
use std::process::ExitCode;

use anyhow::{Context, Result};
use clap::Args;
use command_line::output::print;
use reconstruction::evaluate::files::{self, LoadedTrajectory};
use reconstruction::evaluate::ground_truth::GroundTruth;
use reconstruction::report::report;
use scene_bundle::outputs::{TRAJECTORY, TRAJECTORY_CAUSAL};
use scene_bundle::{Scene, layout};

#[derive(Args)]
pub(crate) struct Arguments {
    /// The scene bundle.
    scene: PathBuf,
    /// Ground-truth trajectory: TUM, KITTI or EuRoC, or the truth of a simulated session
    /// (truth.CAMERA.csv). Ground truth of feet in the same folder (truth.contacts.csv,
    /// truth.foot-poses.csv) is used, too.
    #[arg(long, value_name = "FILE")]
    truth: Option<PathBuf>,
    /// The page to write. Default: report.html in the bundle.
    #[arg(long, value_name = "FILE")]
    out: Option<PathBuf>,
}

pub(crate) fn run(arguments: &Arguments) -> Result<ExitCode> {
    let scene = Scene::open(&arguments.scene)?;
    let truth = match &arguments.truth {
        Some(path) => {
            let truth = files::load(path, None)?;
            // A bundle has timestamps; a ground truth without any cannot be compared with it.
            if scene.has(TRAJECTORY) || scene.has(TRAJECTORY_CAUSAL) {
                let estimate = LoadedTrajectory::timed(scene_bundle::Trajectory::default());
                files::comparable(&estimate, &truth, &arguments.scene)?;
            }
            Some(truth.trajectory)
        }
        None => None,
    };
    let folder = arguments.truth.as_deref().and_then(std::path::Path::parent);
    let feet = folder.map(GroundTruth::of_folder).transpose()?.flatten();
    let page = report(&scene, truth.as_ref(), feet.as_ref())?;
    let out = match &arguments.out {
        Some(out) => out.clone(),
        None => scene.path().join(layout::PAGE),
    };
    std::fs::write(&out, page.html).with_context(|| format!("writing {}", out.display()))?;
    print(format_args!("{}: {}", page.summary, out.display()))?;
    Ok(ExitCode::SUCCESS)
}
