//! The scene of Gaussians: held-out images as recorded beside those that it renders, and quality
//! over the number of Gaussians.

use charts::{Cell, Image, Page, Table};
use scene_bundle::outputs::SPLATS;
use scene_bundle::outputs::splats::{self, SplatScene, SplatView};
use scene_bundle::{BundleError, Scene};

/// Adds the section.
pub(super) fn add(page: Page, scene: &Scene) -> Result<Page, BundleError> {
    let mut page = page.section("Gaussians");
    if !scene.has(SPLATS) {
        return Ok(page.text("There is no scene of Gaussians in this bundle."));
    }
    let reader = scene.output(SPLATS)?;
    let record = splats::read(&reader)?;
    if record.sectors.is_empty() {
        return Ok(page.text("No scene of Gaussians could be trained: see the losses below."));
    }
    page = page.text(&in_short(&record));
    let mut images = Vec::new();
    for (number, view) in record.views.iter().enumerate() {
        if let Some(png) = splats::read_comparison(&reader, number)? {
            let (name, caption) = names(view);
            images.push(Image::png(&png, &name, &caption));
        }
    }
    page = page
        .text(
            "Held-out left images with the median PSNR of their camera: as recorded, and to the \
             right of it as rendered. The wearer and what moves are masked and not in the scene.",
        )
        .images(&images);
    if !record.training.checks.is_empty() {
        page = page.table(&checks(&record));
    }
    Ok(page)
}

fn in_short(record: &SplatScene) -> String {
    let training = &record.training;
    let quality = record.held_out().map_or_else(
        || "no image was held out".to_owned(),
        |mean| {
            let count = record.views.iter().filter(|view| view.held_out.is_some());
            format!(
                "PSNR {:.2} dB and SSIM {:.3} (means) in {} held-out images",
                mean.psnr_db,
                mean.ssim,
                count.count()
            )
        },
    );
    format!(
        "{} Gaussians ({} at the start) with harmonics of degree {}, trained in {} steps from {} \
         images, preset {}; {quality}.",
        record.count(),
        training.start_count,
        record.degree,
        training.steps,
        record
            .sectors
            .iter()
            .map(|sector| sector.views.len())
            .sum::<usize>(),
        training.preset
    )
}

/// Name and caption of a comparison.
fn names(view: &SplatView) -> (String, String) {
    let quality = view.held_out.map_or(String::new(), |held_out| {
        format!(
            ": PSNR {:.2} dB, SSIM {:.3}",
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
