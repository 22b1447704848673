//! Opens a scene, loads its Gaussians, and says what is there and what is missing:
//! `cargo run -p simulation --example open_scene -- walk.scene`.

use std::path::Path;
use std::sync::Arc;

use simulation::{GaussianStore, ResidencyConfig, SceneData};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let path = std::env::args()
        .nth(1)
        .ok_or("expected the path of a scene")?;
    let scene = Arc::new(SceneData::open(Path::new(&path))?);
    let store = GaussianStore::new(scene.clone(), ResidencyConfig::default());
    println!("{}", scene.name);
    for (number, sector) in scene.sectors.iter().enumerate() {
        let recording = &sector.recording;
        println!(
            "sector {}: {} levels, {} reference poses, {} contacts, {recording:?}, {} edges",
            sector.name,
            sector.levels.as_ref().map_or(0, |levels| levels.len()),
            sector.references.len(),
            recording.contacts.len(),
            sector.edges.len(),
        );
        if let Some(gaussians) = &sector.gaussians {
            store.content(number)?;
            let megabytes = gaussians.resident_bytes() as f64 / 1e6;
            println!("  {gaussians:?}, with their levels at most {megabytes:.1} MB");
        }
    }
    for missing in scene.missing() {
        println!(
            "{} has no {}: no {}",
            missing.place, missing.output, missing.features
        );
    }
    Ok(())
}
