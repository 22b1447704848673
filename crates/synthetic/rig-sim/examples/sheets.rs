//! Draws the images of the documentation: for each scene the camera images by day with the map of
//! the path, and one sheet of the other lightings, one row each.
//!
//! `cargo run --release -p rig-sim --example sheets -- docs/images`

use std::path::PathBuf;
use std::sync::Arc;

use anyhow::{Context, Result};
use cad_transforms::rig::Rig;
use raster::Canvas;
use rig_sim::camera::Quality;
use rig_sim::preview::{self, instants, sheet};
use rig_sim::scene::{Kind, Lighting};
use rig_sim::simulation::{Settings, Simulation};

const RIG: &str = include_str!("../../../../cad-transforms/rigs/example.toml");
const OTHER_LIGHTS: [Lighting; 3] = [Lighting::Night, Lighting::LowSun, Lighting::Flicker];
/// One eye by day and in other lights, pixels.
const DAY: [u32; 2] = [256, 144];
const OTHER: [u32; 2] = [216, 122];

fn main() -> Result<()> {
    let folder = std::env::args_os().nth(1).context("no folder was named")?;
    let folder = PathBuf::from(folder);
    std::fs::create_dir_all(&folder).with_context(|| format!("making {}", folder.display()))?;
    let rig = Rig::parse(RIG)?;
    for kind in Kind::ALL {
        let drawn =
            |lighting: Lighting, [width, height]: [u32; 2], count: usize| -> Result<Canvas> {
                let settings = Settings {
                    kind,
                    lighting,
                    seed: 1,
                    seconds: 12.0,
                    rate_hz: 30.0,
                    width,
                    height,
                    quality: Quality::ACCURATE,
                };
                let simulation = Arc::new(Simulation::new(&settings, &rig)?);
                let instants = instants(&simulation, count);
                Ok(sheet(&simulation, &instants, &|| {}))
            };
        let save = |canvas: &Canvas, name: &str| {
            let path = folder.join(format!("sim-{}{name}.png", kind.name()));
            preview::save(canvas, &path).with_context(|| format!("writing {}", path.display()))
        };
        save(&drawn(Lighting::Day, DAY, 2)?, "")?;

        let mut rows = Vec::new();
        for lighting in OTHER_LIGHTS {
            rows.push(drawn(lighting, OTHER, 1)?);
        }
        let (width, height) = (rows[0].width, OTHER[1] as usize + 4);
        let mut lights = Canvas::new(width, rows.len() * height - 4, [255; 3]);
        for (i, row) in rows.iter().enumerate() {
            // Without the map.
            let pixels = &row.pixels[..width * OTHER[1] as usize];
            lights.paste([0, i * height], width, pixels);
        }
        save(&lights, "-lights")?;
    }
    Ok(())
}
