//! The scene of Gaussians: a flight through it, held-out images as recorded beside those that it
//! renders, and quality over the number of Gaussians.

use ::splats::{Background, Sky, SplatError, Splats};
use charts::{Cell, Image, Page, Table};
use scene_bundle::outputs::SPLATS;
use scene_bundle::outputs::splats::{self, SplatBackground, SplatScene, SplatView};
use scene_bundle::{OutputReader, Scene};

use super::error::ReportError;
use super::fly_path::{self, FlyPath};
use super::gaussian_viewer::{self, GaussianViewer};
use super::{gaussian_stills, gaussian_stills::Still};

/// The section before it is put into the page.
pub(super) enum Gaussians {
    /// The bundle has no such output.
    Missing,
    /// Nothing could be trained.
    Empty,
    /// A scene.
    Trained(Box<TrainedScene>),
}

/// A scene with what the page shows of it.
pub(super) struct TrainedScene {
    record: SplatScene,
    comparisons: Vec<(usize, Vec<u8>)>,
    paths: Vec<FlyPath>,
    viewer: Option<GaussianViewer>,
    stills: Vec<Still>,
}

impl Gaussians {
    /// Reads the scene and renders its views.
    pub(super) fn read(scene: &Scene) -> Result<Self, ReportError> {
        if !scene.has(SPLATS) {
            return Ok(Self::Missing);
        }
        let reader = scene.output(SPLATS)?;
        let record = splats::read(&reader)?;
        if record.count() == 0 {
            return Ok(Self::Empty);
        }
        let mut comparisons = Vec::new();
        for number in 0..record.views.len() {
            if let Some(png) = splats::read_comparison(&reader, number)? {
                comparisons.push((number, png));
            }
        }
        let paths = fly_path::of_views(&record.views);
        let (mut viewer, mut stills) = (None, Vec::new());
        if let Some(first) = paths.first() {
            let content = content(&reader, &record)?;
            viewer = Some(gaussian_viewer::viewer(
                &content,
                record.compensated,
                &paths,
            ));
            stills = gaussian_stills::along(&content, record.compensated, first)?;
        }
        Ok(Self::Trained(Box::new(TrainedScene {
            record,
            comparisons,
            paths,
            viewer,
            stills,
        })))
    }

    /// Text of the Gaussians in the page, bytes.
    pub(super) fn bytes(&self) -> usize {
        match self {
            Self::Trained(trained) => trained.viewer.as_ref().map_or(0, |viewer| viewer.bytes),
            Self::Missing | Self::Empty => 0,
        }
    }

    /// Adds the section.
    pub(super) fn add(&self, page: Page) -> Page {
        let page = page.section("Gaussians");
        match self {
            Self::Missing => page.text("There is no scene of Gaussians in this bundle."),
            Self::Empty => {
                page.text("No scene of Gaussians could be trained: see the losses below.")
            }
            Self::Trained(trained) => trained.add(page),
        }
    }
}

impl TrainedScene {
    fn add(&self, mut page: Page) -> Page {
        page = page.text(&in_short(&self.record));
        if let Some(viewer) = &self.viewer {
            page = page
                .text(&about_view(viewer, &self.record))
                .embed(&viewer.html);
        }
        if let Some(path) = self.paths.first() {
            let name = &path.name;
            let images = self.stills.iter().map(|still| {
                let caption = format!("{name}, {:.1} s", still.time_s);
                Image::png(&still.png, &format!("{caption}, rendered"), &caption)
            });
            page = page
                .text(&format!("Along the path of the camera {name}, rendered."))
                .images(&images.collect::<Vec<_>>());
        }
        let images = self.comparisons.iter().map(|(number, png)| {
            let (name, caption) = names(&self.record.views[*number]);
            Image::png(png, &name, &caption)
        });
        page = page
            .text(
                "Held-out left images with the median PSNR of their camera: as recorded, and to \
                 the right of it as rendered. The wearer and what moves are masked and not in the \
                 scene.",
            )
            .images(&images.collect::<Vec<_>>());
        if !self.record.training.checks.is_empty() {
            page = page.table(&checks(&self.record));
        }
        page
    }
}

/// All sectors, before their background.
fn content(reader: &OutputReader, record: &SplatScene) -> Result<::splats::Scene, ReportError> {
    let mut all = Splats::empty(record.degree).map_err(SplatError::from)?;
    for number in 0..record.sectors.len() {
        let sector = splats::read_sector(reader, record, number)?;
        for index in 0..sector.len() {
            all.push(&sector.get(index)).map_err(SplatError::from)?;
        }
    }
    let background = match record.background {
        SplatBackground::Constant(color) => Background::Constant(color),
        SplatBackground::Sky { size } => {
            Background::Sky(Sky::from_texels(size, splats::read_sky(reader, record)?)?)
        }
    };
    Ok(::splats::Scene {
        splats: all,
        background,
    })
}

fn about_view(viewer: &GaussianViewer, record: &SplatScene) -> String {
    let all = record.count();
    let count = match viewer.count == all {
        true => format!("All {all} Gaussians are in this view"),
        false => format!(
            "{} of {all} Gaussians are in this view, those with the largest product of opacity and cross-section",
            viewer.count
        ),
    };
    let degree = match viewer.degree < record.degree {
        true => format!(", with harmonics up to degree {}", viewer.degree),
        false => String::new(),
    };
    format!(
        "{count}{degree}. The flight follows the smoothed path of a camera, as a pinhole camera without exposure. \
         Drag to look around, with two fingers, shift or the right button to move; pinch or turn the wheel after a \
         click to move forward and back; or use the arrow keys, with shift to move, + and -."
    )
}

fn in_short(record: &SplatScene) -> String {
    let training = &record.training;
    let quality = record.held_out().map_or_else(
        || "no image was held out".to_owned(),
        |mean| {
            let count = record.views.iter().filter(|view| view.held_out.is_some());
            let lpips = mean.lpips;
            format!(
                "PSNR {:.2} dB{} SSIM {:.3}{} (means) in {} held-out images",
                mean.psnr_db,
                if lpips.is_some() { "," } else { " and" },
                mean.ssim,
                lpips.map_or(String::new(), |lpips| format!(" and LPIPS {lpips:.3}")),
                count.count()
            )
        },
    );
    let divided = match record.sectors.len() {
        0 | 1 => String::new(),
        count => format!(" in each of {count} sectors"),
    };
    format!(
        "{} Gaussians ({} at the start) with harmonics of degree {}, trained in {} steps{divided} \
         from {} images, preset {}; {quality}.",
        record.count(),
        training.start_count,
        record.degree,
        training.steps,
        record
            .views
            .iter()
            .filter(|view| view.held_out.is_none())
            .count(),
        training.preset
    )
}

/// Name and caption of a comparison.
fn names(view: &SplatView) -> (String, String) {
    let quality = view.held_out.map_or(String::new(), |held_out| {
        let lpips = held_out.lpips;
        let lpips = lpips.map_or(String::new(), |lpips| format!(", LPIPS {lpips:.3}"));
        format!(
            ": PSNR {:.2} dB, SSIM {:.3}{lpips}",
            held_out.psnr_db, held_out.ssim
        )
    });
    let name = format!(
        "{}, frame {}, recorded and rendered",
        view.camera, view.frame
    );
    (
        name,
        format!("{}, frame {}{quality}", view.camera, view.frame),
    )
}

fn checks(record: &SplatScene) -> Table {
    let heads = [
        "step",
        "Gaussians",
        "PSNR, dB",
        "more Gaussians",
        "PSNR, dB",
        "gain of a tenth more, dB",
        "upper bound, dB",
        "growth",
    ];
    record
        .training
        .checks
        .iter()
        .fold(Table::new(heads), |table, check| {
            table.row([
                Cell::number(check.step),
                Cell::number(check.counts[0]),
                Cell::number(format!("{:.2}", check.psnr_db[0])),
                Cell::number(check.counts[1]),
                Cell::number(format!("{:.2}", check.psnr_db[1])),
                Cell::number(format!("{:.3}", check.gain_db)),
                Cell::number(format!("{:.3}", check.upper_gain_db)),
                if check.continues {
                    "continues"
                } else {
                    "pauses"
                }
                .into(),
            ])
        })
}
