//! Import of Beogym's folders.
//!
//! Generation 1 is a folder of `NAME/point_cloud.ply`, `NAME/transformation.txt` and
//! `NAME/cameras.json` per sector, and `surfaceMap.pcd`, a LiDAR map. Generation 2 is a folder with
//! `sequence.json`, which this page of the reference defines, and arrays; RocksDB and pickles are
//! refused with a hint how to convert them.
//!
//! Beogym's frames have y up. All sectors are carried into one world with z up, so that edges
//! between them are identities; they lead between sectors whose areas meet. The edges of Beogym's
//! own graph say the same in a form that lost its direction.

mod cloud;
mod maps;
mod numbers;
mod plausibility;
mod sequence;
mod splats;

use std::collections::BTreeMap;
use std::fs;
use std::path::Path;
use std::sync::Arc;

use cad_transforms::RigidTransform;
use estimator_config::config;
use nalgebra::{UnitQuaternion, Vector3};

use super::data::{Missing, SceneData};
use super::gaussians::GaussianSource;
use super::sector::{Area, Recording, Sector, SectorEdge};
use super::similarity::Similarity;
use super::similarity::rigid;
use crate::error::SimulationError;

config! {
    /// How folders of Beogym are read.
    pub struct BeogymConfig {
        /// Edge of a cell of the maps, m. Beogym's own are 0.1 or 0.2 m.
        pub cell_m: f64 = 0.1,
        /// Fewest points of a surface in a cell.
        pub min_points: usize = 2,
        /// Height of the robot's head room, m: what is lower above the ground is an obstacle.
        pub head_room_m: f64 = 1.9,
        /// Greatest step, m: points above it are an obstacle.
        pub max_step_m: f64 = 0.2,
        /// Smallest area of a level above another one, m2: less are canopies and noise.
        pub min_level_m2: f64 = 2.0,
        /// How far a sector owns what is beside its camera poses, m. Images of Beogym's sectors do
        /// not overlap; neighbors meet in the middle between their poses.
        pub margin_m: f64 = 3.0,
        /// Largest number of Gaussians of a sector.
        pub max_gaussians: usize = 20_000_000,
    }
}

/// Reads a folder of either generation.
pub(super) fn open(folder: &Path, config: &BeogymConfig) -> Result<SceneData, SimulationError> {
    refuse_databases(folder)?;
    if folder.join(sequence::FILE).is_file() {
        return sequence::open(folder, config);
    }
    let folder = match folder.join("gaussian_splat_data") {
        inner if inner.is_dir() => inner,
        _ => folder.to_owned(),
    };
    let folder = folder.as_path();
    let mut missing = Vec::new();
    let mut parts = Vec::new();
    let mut transforms = Vec::new();
    // The same file as two sectors shows one place as two.
    let mut hashes: BTreeMap<[u8; 32], String> = BTreeMap::new();
    for name in sector_names(folder)? {
        let path = folder.join(&name);
        let ply = read(&path.join("point_cloud.ply"))?;
        let hash = *blake3::hash(&ply).as_bytes();
        if let Some(other) = hashes.insert(hash, name.clone()) {
            let found = format!("the same file as in {other}");
            return Err(wrong(
                &path.join("point_cloud.ply"),
                found,
                "Gaussians of its own",
            ));
        }
        let transform = path.join("transformation.txt");
        let lidar_from_sector = numbers::transform(&text(&transform)?, &transform)?;
        let world_from_sector = world_from_lidar().compose(&lidar_from_sector);
        let gaussians = splats::read(
            &ply,
            &path.join("point_cloud.ply"),
            &world_from_sector,
            config,
        )?;
        let cameras = path.join("cameras.json");
        let references = match cameras.is_file() {
            true => splats::cameras(&text(&cameras)?, &cameras, &world_from_sector)?,
            false => {
                missing.push(Missing {
                    place: name.clone(),
                    output: "cameras.json".to_owned(),
                    features: "starts near recorded poses, deviation from them".to_owned(),
                });
                Vec::new()
            }
        };
        transforms.push(lidar_from_sector);
        parts.push((name, gaussians, references));
    }
    let map = [folder, folder.parent().unwrap_or(folder)].map(|of| of.join("surfaceMap.pcd"));
    let levels = match map.iter().find(|path| path.is_file()) {
        Some(path) => {
            let points = cloud::read(&read(path)?, path)?;
            let to_world = world_from_lidar();
            let points: Vec<[f64; 3]> = points.into_iter().map(|x| to_world.apply(x)).collect();
            let levels = maps::levels(&points, config)
                .map_err(|found| wrong(path, found, "points of a map that fits in memory"))?;
            Some(Arc::new(levels))
        }
        None => {
            missing.push(Missing {
                place: folder.display().to_string(),
                output: "surfaceMap.pcd".to_owned(),
                features: "agents on the ground, collisions, starts in free space".to_owned(),
            });
            None
        }
    };
    let mut sectors = Vec::new();
    for (name, gaussians, references) in parts {
        let area = area_of(&gaussians, &references, config);
        sectors.push(Sector {
            name,
            levels: levels.clone(),
            area,
            references: Arc::new(references),
            gaussians: Some(GaussianSource::new(gaussians, false)?),
            recording: Arc::new(Recording::default()),
            edges: Vec::new(),
        });
    }
    missing.extend(plausibility::implausible(&sectors, &transforms));
    connect(&mut sectors);
    let name = folder.file_name().map_or_else(
        || "beogym".to_owned(),
        |name| name.to_string_lossy().into_owned(),
    );
    let hash = super::hash::of_sectors(&sectors);
    SceneData::with_hash(&name, sectors, hash, missing)
}

/// From y up to z up: a quarter turn about x.
fn world_from_lidar() -> Similarity {
    let half = std::f64::consts::FRAC_1_SQRT_2;
    let rotation = nalgebra::Quaternion::new(half, half, 0.0, 0.0);
    Similarity::from_parts(
        1.0,
        UnitQuaternion::new_normalize(rotation),
        Vector3::zeros(),
    )
}

/// Sectors in the order of their numbers: sec10 after sec9.
fn sector_names(folder: &Path) -> Result<Vec<String>, SimulationError> {
    let entries = fs::read_dir(folder);
    let entries = entries.map_err(|e| wrong(folder, e.to_string(), "a folder of Beogym"))?;
    let mut names: Vec<String> = entries
        .flatten()
        .filter(|entry| entry.path().join("point_cloud.ply").is_file())
        .map(|entry| entry.file_name().to_string_lossy().into_owned())
        .collect();
    let number = |name: &str| -> u64 {
        let digits = name.trim_start_matches(|c: char| !c.is_ascii_digit());
        digits.parse().unwrap_or(u64::MAX)
    };
    names.sort_by(|a, b| number(a).cmp(&number(b)).then(a.cmp(b)));
    match names.is_empty() {
        false => Ok(names),
        true => {
            let found = "no sector: no folder with point_cloud.ply".to_owned();
            Err(wrong(
                folder,
                found,
                "sec1/point_cloud.ply and others, or sequence.json",
            ))
        }
    }
}

/// RocksDB and pickled graphs are not read.
fn refuse_databases(folder: &Path) -> Result<(), SimulationError> {
    let entries = fs::read_dir(folder).into_iter().flatten().flatten();
    for entry in entries {
        let name = entry.file_name().to_string_lossy().into_owned();
        let found =
            if name.ends_with(".pickle") || name.ends_with(".gpickle") || name.ends_with(".pkl") {
                "a pickle, which can run any program when it is read"
            } else if name == "CURRENT" || name.ends_with(".sst") {
                "a RocksDB database"
            } else {
                continue;
            };
        let expected = "sequence.json and arrays: ten lines of Python on the reference page, \
                        \"Conversion of Beogym's databases\", write them";
        return Err(wrong(&entry.path(), found.to_owned(), expected));
    }
    Ok(())
}

/// Around the camera poses, or else around most of the Gaussians.
fn area_of(
    gaussians: &::splats::Scene,
    references: &[RigidTransform],
    config: &BeogymConfig,
) -> Area {
    let (mut axes, mut margin_m) = ([Vec::new(), Vec::new()], config.margin_m);
    for pose in references {
        for (k, axis) in axes.iter_mut().enumerate() {
            axis.push(pose.translation_m()[k]);
        }
    }
    if references.is_empty() {
        margin_m = 0.0;
        for (k, axis) in axes.iter_mut().enumerate() {
            let plane = &gaussians.splats.planes()[gaussians::Plane::POSITION + k];
            axis.extend(plane.iter().map(|value| f64::from(*value)));
            axis.sort_by(f64::total_cmp);
            // Without stray ones.
            let cut = axis.len() / 50;
            *axis = axis[cut..axis.len() - cut].to_vec();
        }
    }
    let extreme = |of: fn(f64, f64) -> f64, margin_m: f64| {
        axes.each_ref()
            .map(|axis| axis.iter().copied().reduce(of).unwrap_or(0.0) + margin_m)
    };
    Area::new(extreme(f64::min, -margin_m), extreme(f64::max, margin_m))
}

/// Edges both ways between sectors of one world whose areas meet.
fn connect(sectors: &mut [Sector]) {
    let areas: Vec<Area> = sectors.iter().map(|sector| sector.area).collect();
    for (from, sector) in sectors.iter_mut().enumerate() {
        let here = areas[from];
        for (to, there) in areas.iter().enumerate() {
            let overlap = Area::new(
                [0, 1].map(|k| here.min_m[k].max(there.min_m[k])),
                [0, 1].map(|k| here.max_m[k].min(there.max_m[k])),
            );
            let meets = (0..2).all(|k| overlap.min_m[k] <= overlap.max_m[k]);
            if to != from && meets {
                sector.edges.push(SectorEdge {
                    to,
                    to_from_here: Similarity::identity(),
                    overlap,
                    residual_m: None,
                    is_imported: true,
                });
            }
        }
    }
}

fn read(path: &Path) -> Result<Vec<u8>, SimulationError> {
    fs::read(path).map_err(|error| wrong(path, error.to_string(), "a readable file"))
}

fn text(path: &Path) -> Result<String, SimulationError> {
    String::from_utf8(read(path)?)
        .map_err(|error| wrong(path, error.to_string(), "a text in UTF-8"))
}

fn wrong(path: &Path, found: String, expected: &str) -> SimulationError {
    SimulationError::Scene {
        place: path.display().to_string(),
        found,
        expected: expected.to_owned(),
    }
}

/// A pose in the world of one in a sector.
fn carried(
    world_from_sector: &Similarity,
    pose: (UnitQuaternion<f64>, Vector3<f64>),
) -> RigidTransform {
    world_from_sector.carry(&rigid(pose.0, pose.1))
}

#[cfg(test)]
mod tests;
