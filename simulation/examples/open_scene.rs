//! Opens a scene and says what is in it, what is missing, and what that took:
//! `cargo run -p simulation --example open_scene -- walk.scene`.

use std::path::Path;
use std::sync::Arc;
use std::time::Instant;

use simulation::{GaussianStore, ResidencyConfig, SceneData};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let path = std::env::args()
        .nth(1)
        .ok_or("expected the path of a scene")?;
    let start = Instant::now();
    let scene = Arc::new(SceneData::open(Path::new(&path))?);
    println!(
        "{}: opened in {:.3} s",
        scene.name,
        start.elapsed().as_secs_f64()
    );
    for sector in &scene.sectors {
        let recording = &sector.recording;
        println!(
            "sector {}: {} levels, {} reference poses, {} contacts, {recording:?}, {:?}, {} edges",
            sector.name,
            sector.levels.as_ref().map_or(0, |levels| levels.len()),
            sector.references.len(),
            recording.contacts.len(),
            sector.gaussians,
            sector.edges.len(),
        );
    }
    for missing in scene.missing() {
        println!(
            "{} has no {}: no {}",
            missing.place, missing.output, missing.features
        );
    }
    let store = GaussianStore::new(scene.clone(), ResidencyConfig::default());
    for (number, sector) in scene.sectors.iter().enumerate() {
        if let Some(gaussians) = &sector.gaussians {
            let start = Instant::now();
            store.content(number)?;
            println!(
                "sector {}: Gaussians with their levels in {:.3} s, at most {:.1} MB",
                sector.name,
                start.elapsed().as_secs_f64(),
                gaussians.resident_bytes() as f64 / 1e6,
            );
        }
    }
    Ok(())
}
