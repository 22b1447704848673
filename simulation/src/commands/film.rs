//! `paws-sim film`: an agent walks to goals in a scene.

use std::fs;
use std::path::PathBuf;
use std::process::ExitCode;

use anyhow::{Context, Result};
use charts::{Film, FilmFrame, FilmMap, Page, base64};
use clap::Args;
use command_line::output::print;
use scene_bundle::film::{self, SceneFilm};
use scene_bundle::layout;

use super::progress_bar;
use super::walk::{SIZE, Walk};

/// Steps of the simulation between two images.
pub(super) const STEPS_PER_IMAGE: u32 = 2;

/// What the map shows.
const LEGEND: &str = "Map: free ground is gray by its height, obstacles are brown, unknown ground is \
    white; the dark line is the recorded path, the blue one that of the agent.";

#[derive(Args)]
pub(crate) struct Arguments {
    /// The scene: a bundle, or a scene file of several recordings.
    scene: PathBuf,
    /// Duration, s.
    #[arg(long, default_value_t = 30, value_parser = clap::value_parser!(u32).range(1..=3600))]
    seconds: u32,
    /// Seed of start and goals.
    #[arg(long, value_name = "N", default_value_t = 0)]
    seed: u64,
    /// Predicted PSNR of what the agent sees, dB: starts are where it is higher, and the agent
    /// restarts where it is lower; 0 is no limit.
    #[arg(long, value_name = "DB", default_value_t = 0.0)]
    min_support: f64,
    /// Also write a page with the film; replaced if it exists.
    #[arg(long, value_name = "FILE")]
    page: Option<PathBuf>,
}

pub(crate) fn run(arguments: &Arguments) -> Result<ExitCode> {
    let mut walk = Walk::open(&arguments.scene, arguments.seed, arguments.min_support)?;
    let steps = (f64::from(arguments.seconds) / walk.step_s()).round() as u32;
    let mut frames = Vec::new();
    let bar = progress_bar(u64::from(steps), "walking")?;
    for step in 0..=steps {
        bar.set_position(u64::from(step));
        if step % STEPS_PER_IMAGE == 0 {
            frames.push(frame(&mut walk)?);
        }
        if step < steps {
            let action = walk.guide();
            walk.step(action)?;
        }
    }
    bar.finish_and_clear();
    let summary = summary(&walk, f64::from(arguments.seconds));
    let film = scene_film(&summary, &walk, frames)?;
    let folder = folder(&arguments.scene);
    film::write(&folder, &film)
        .with_context(|| format!("writing {}", folder.join(layout::FILM).display()))?;
    if let Some(path) = &arguments.page {
        fs::write(path, page(&film)).with_context(|| format!("writing {}", path.display()))?;
    }
    print(format_args!(
        "{} {}",
        summary,
        folder.join(layout::FILM).display()
    ))?;
    Ok(ExitCode::SUCCESS)
}

/// What the agent sees now.
pub(super) fn frame(walk: &mut Walk) -> Result<FilmFrame> {
    Ok(FilmFrame {
        jpeg_base64: base64(&walk.image()?),
        map_px: walk.map_px(),
        heading_rad: walk.heading_rad(),
        caption: walk.caption()?,
    })
}

/// What an agent did in a time.
pub(super) fn summary(walk: &Walk, seconds: f64) -> String {
    format!(
        "An agent walked {:.1} m in {seconds:.0} s, reached {} goals, was stopped in {} steps and restarted {} times.",
        walk.path_m(),
        walk.goals_reached(),
        walk.collisions(),
        walk.ends(),
    )
}

/// A film with the map of a walk.
pub(super) fn scene_film(summary: &str, walk: &Walk, frames: Vec<FilmFrame>) -> Result<SceneFilm> {
    let map = FilmMap {
        png_base64: base64(&walk.map.png()?),
        size: walk.map.size(),
    };
    Ok(SceneFilm {
        summary: format!("{summary} {LEGEND}"),
        film: Film {
            step_s: f64::from(STEPS_PER_IMAGE) * walk.step_s(),
            size: SIZE,
            frames,
            map: Some(map),
        },
    })
}

/// A page with a film.
pub(super) fn page(film: &SceneFilm) -> String {
    Page::new("An agent in a reconstructed scene")
        .text(&film.summary)
        .embed(&film.film.to_html("what the agent sees"))
        .to_html()
}

/// The folder of a bundle that is named by its folder or its manifest.
fn folder(scene: &std::path::Path) -> PathBuf {
    match scene.is_dir() {
        true => scene.to_owned(),
        false => scene.parent().unwrap_or(scene).to_owned(),
    }
}
