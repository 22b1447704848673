//! A scene of a scene bundle.
//!
//! All files of the outputs in [`USES`] but images of comparisons are read once, which checks
//! their hashes; no thread is started. Sectors are those of the output `splats`, in the world of
//! the bundle, or one.

mod recording;

use std::path::Path;
use std::sync::Arc;

use estimator_config::config;
use scene_bundle::outputs::splats::{SplatScene, SplatSector};
use scene_bundle::outputs::{self, maps};
use scene_bundle::{BundleError, OutputReader, Scene};

use self::recording::{cameras, references, view};
use super::data::{Missing, SceneData};
use super::gaussians::{BundleGaussians, GaussianSource, indices_in_box};
use super::sector::{Area, Recording, Sector, SectorEdge};
use super::similarity::Similarity;
use crate::error::SimulationError;

config! {
    /// How sectors of a bundle are shown.
    pub struct BundleConfig {
        /// Gaussians up to here around a sector are shown with it, m. Less saves memory and shows
        /// gaps far away; images of two sectors at their border differ by what is farther.
        pub view_reach_m: f64 = 40.0,
    }
}

/// Outputs that a scene uses, and what cannot be done without each.
const USES: [(&str, &str); 8] = [
    (
        outputs::MAPS,
        "agents on the ground, collisions, starts in free space",
    ),
    (outputs::SPLATS, "images and depth of cameras"),
    (
        outputs::TRAJECTORY,
        "the recorded wearer, the recorded path as a task",
    ),
    (outputs::RIG, "lenses and mounts of the recorded cameras"),
    (outputs::CONTACTS, "contacts of the recorded walk"),
    (outputs::FEET, "poses of the wearer's feet"),
    (outputs::TERRAIN, "the mesh of the ground"),
    (
        outputs::COLLISION,
        "physics engines on the ground and convex parts",
    ),
];

/// A bundle while it is opened.
struct Opening {
    name: String,
    bundle: Scene,
    missing: Vec<Missing>,
    hasher: blake3::Hasher,
}

pub(super) fn open(path: &Path, config: &BundleConfig) -> Result<SceneData, SimulationError> {
    let bundle = Scene::open(path).map_err(|source| SimulationError::Bundle {
        path: path.to_owned(),
        source,
    })?;
    let name = bundle.path().file_stem().map_or_else(
        || "scene".to_owned(),
        |name| name.to_string_lossy().into_owned(),
    );
    let mut hasher = blake3::Hasher::new();
    hasher.update(b"scene bundle");
    hasher.update(&config.view_reach_m.to_le_bytes());
    let mut opening = Opening {
        name,
        bundle,
        missing: Vec::new(),
        hasher,
    };
    let levels = opening.maps()?;
    let recording = opening.recording()?;
    opening.check_files(outputs::TERRAIN)?;
    opening.check_files(outputs::COLLISION)?;
    let (record, recording) = opening.gaussians(recording)?;
    let references = Arc::new(references(&recording));
    let recording = Arc::new(recording);
    let sector = |name: String, area, gaussians| Sector {
        name,
        levels: levels.clone(),
        area,
        references: references.clone(),
        gaussians,
        recording: recording.clone(),
        edges: Vec::new(),
    };
    let sectors = match record {
        Some(record) => opening.sectors(&Arc::new(record), config, &sector)?,
        None => vec![sector(
            opening.name.clone(),
            whole_area(levels.as_deref(), None),
            None,
        )],
    };
    let mut missing = opening.missing;
    missing.sort_by_key(|missing| {
        USES.iter()
            .position(|(output, _)| *output == missing.output)
    });
    SceneData::with_hash(
        &opening.name,
        sectors,
        *opening.hasher.finalize().as_bytes(),
        missing,
    )
}

impl Opening {
    /// An output, or `None` with a note that it is missing.
    fn output(&mut self, name: &str) -> Result<Option<OutputReader>, SimulationError> {
        if !self.bundle.has(name) {
            self.misses(name);
            return Ok(None);
        }
        let reader = self.bundle.output(name).map_err(|e| self.wrong(name, e))?;
        self.hasher.update(name.as_bytes());
        self.hasher.update(reader.output().hash.as_bytes());
        Ok(Some(reader))
    }

    fn misses(&mut self, name: &str) {
        let features = USES.iter().find(|(output, _)| *output == name);
        self.missing.push(Missing {
            place: self.name.clone(),
            output: name.to_owned(),
            features: features.map_or("", |(_, features)| features).to_owned(),
        });
    }

    /// An output of one reading function.
    fn read<T>(
        &mut self,
        name: &str,
        read: impl FnOnce(&OutputReader) -> Result<T, BundleError>,
    ) -> Result<Option<T>, SimulationError> {
        let Some(reader) = self.output(name)? else {
            return Ok(None);
        };
        read(&reader).map(Some).map_err(|e| self.wrong(name, e))
    }

    /// Reads all files of an output that is not kept in memory.
    fn check_files(&mut self, name: &str) -> Result<(), SimulationError> {
        let check = |reader: &OutputReader| {
            let mut paths = reader.paths();
            paths.try_for_each(|path| reader.read(path).map(drop))
        };
        self.read(name, check).map(drop)
    }

    /// An error of a file with its place, or of the bundle as a whole.
    fn wrong(&self, output: &str, error: BundleError) -> SimulationError {
        let of = |file: &Path| format!("scene {}, output {output}, {}", self.name, file.display());
        match error {
            BundleError::Changed {
                path,
                found,
                expected,
            } => SimulationError::Scene {
                place: of(&path),
                found,
                expected,
            },
            BundleError::Malformed {
                path,
                place,
                found,
                expected,
            } => SimulationError::Scene {
                place: format!("{}, {place}", of(&path)),
                found,
                expected,
            },
            source => SimulationError::Bundle {
                path: self.bundle.path(),
                source,
            },
        }
    }

    fn maps(&mut self) -> Result<Option<Arc<Vec<maps::MapLevel>>>, SimulationError> {
        let levels = self.read(outputs::MAPS, |reader| {
            let index = maps::read_index(reader)?;
            let numbers = 0..index.levels.len();
            numbers
                .map(|n| maps::read_level(reader, &index, n))
                .collect::<Result<Vec<_>, _>>()
        })?;
        let levels = levels.filter(|levels| !levels.is_empty());
        if levels.is_none() && self.bundle.has(outputs::MAPS) {
            self.misses(outputs::MAPS);
        }
        Ok(levels.map(Arc::new))
    }

    fn recording(&mut self) -> Result<Recording, SimulationError> {
        let rig = match self.bundle.has(outputs::RIG_REFINED) {
            true => outputs::RIG_REFINED,
            false => outputs::RIG,
        };
        let rig = self.read(rig, outputs::rig::read)?;
        let contacts = self.read(outputs::CONTACTS, outputs::contacts::read)?;
        let feet = self.read(outputs::FEET, outputs::feet::read)?;
        Ok(Recording {
            trajectory: self.read(outputs::TRAJECTORY, outputs::trajectory::read)?,
            cameras: rig.as_ref().map(cameras).unwrap_or_default(),
            contacts: contacts.unwrap_or_default(),
            feet: feet.unwrap_or_default(),
            views: Vec::new(),
            bundle: Some(self.bundle.clone()),
        })
    }

    /// The record of the Gaussians, and the recording with its views.
    fn gaussians(
        &mut self,
        mut recording: Recording,
    ) -> Result<(Option<SplatScene>, Recording), SimulationError> {
        let Some(record) = self.read(outputs::SPLATS, outputs::splats::read)? else {
            return Ok((None, recording));
        };
        recording.views = record.views.iter().map(view).collect();
        if record.sectors.is_empty() {
            self.misses(outputs::SPLATS);
            return Ok((None, recording));
        }
        Ok((Some(record), recording))
    }

    fn sectors(
        &self,
        record: &Arc<SplatScene>,
        config: &BundleConfig,
        sector: &dyn Fn(String, Area, Option<GaussianSource>) -> Sector,
    ) -> Result<Vec<Sector>, SimulationError> {
        let of_output = |e| self.wrong(outputs::SPLATS, e);
        let reader = self.bundle.output(outputs::SPLATS).map_err(of_output)?;
        outputs::splats::read_sky(&reader, record).map_err(of_output)?;
        outputs::splats::read_coverage(&reader, record).map_err(of_output)?;
        let reach: Vec<_> = record
            .sectors
            .iter()
            .map(|s| reach(s, record, config))
            .collect();
        let mut counts = vec![0; record.sectors.len()];
        for (part, of) in record.sectors.iter().enumerate() {
            if of.count == 0 {
                return Err(SimulationError::Scene {
                    place: format!("scene {}, sector {part}, {}", self.name, of.file),
                    found: "0 Gaussians".to_owned(),
                    expected: "at least one".to_owned(),
                });
            }
            let splats = outputs::splats::read_sector(&reader, record, part).map_err(of_output)?;
            for (count, (min_m, max_m, parts)) in counts.iter_mut().zip(&reach) {
                if parts.contains(&part) {
                    *count += indices_in_box(&splats, *min_m, *max_m).len();
                }
            }
        }
        let is_one = record.sectors.len() == 1;
        let mut sectors = Vec::new();
        for (number, (of, (min_m, max_m, parts))) in record.sectors.iter().zip(reach).enumerate() {
            let name = match is_one {
                true => self.name.clone(),
                false => format!("{}/{number:03}", self.name),
            };
            let source = BundleGaussians {
                scene: self.bundle.clone(),
                record: record.clone(),
                name: name.clone(),
                parts,
                min_m,
                max_m,
            };
            let area = box_area(of);
            let source = GaussianSource::of_bundle(counts[number], source);
            let mut sector = sector(name, area, Some(source));
            if is_one {
                let levels = sector.levels.as_deref();
                sector.area = whole_area(levels, Some(area));
            }
            sector.edges = of
                .neighbors
                .iter()
                .map(|neighbor| edge(of, neighbor, record))
                .collect();
            sectors.push(sector);
        }
        Ok(sectors)
    }
}

fn edge(
    of: &SplatSector,
    neighbor: &outputs::splats::SplatNeighbor,
    record: &SplatScene,
) -> SectorEdge {
    let there = box_area(&record.sectors[neighbor.sector]);
    let here = box_area(of);
    SectorEdge {
        to: neighbor.sector,
        to_from_here: Similarity::from(neighbor.neighbor_from_sector),
        overlap: Area::new(
            [0, 1].map(|k| here.min_m[k].max(there.min_m[k])),
            [0, 1].map(|k| here.max_m[k].min(there.max_m[k])),
        ),
        residual_m: Some(0.0),
        is_imported: false,
    }
}

fn box_area(sector: &SplatSector) -> Area {
    let [x0, y0, _] = sector.min_m;
    let [x1, y1, _] = sector.max_m;
    Area::new([x0, y0], [x1, y1])
}

/// The area of a scene of one sector: its maps and Gaussians.
fn whole_area(levels: Option<&Vec<maps::MapLevel>>, gaussians: Option<Area>) -> Area {
    let of_maps = levels.into_iter().flatten().map(|level| {
        let (corner, size) = (level.grid.corner_m(), level.grid.size_m());
        Area::new(corner, [0, 1].map(|k| corner[k] + size[k]))
    });
    let all = of_maps.chain(gaussians).reduce(|a, b| {
        Area::new(
            [0, 1].map(|k| a.min_m[k].min(b.min_m[k])),
            [0, 1].map(|k| a.max_m[k].max(b.max_m[k])),
        )
    });
    all.unwrap_or(Area::new([0.0; 2], [0.0; 2]))
}

/// What is shown with a sector: a box, and the parts that have Gaussians in it.
type Reach = ([f64; 3], [f64; 3], Vec<usize>);

fn reach(sector: &SplatSector, record: &SplatScene, config: &BundleConfig) -> Reach {
    let min_m = sector.min_m.map(|v| v - config.view_reach_m);
    let max_m = sector.max_m.map(|v| v + config.view_reach_m);
    let is_near = |other: &SplatSector| {
        (0..3).all(|k| other.min_m[k] <= max_m[k] && other.max_m[k] >= min_m[k])
    };
    let parts = (0..record.sectors.len()).filter(|part| is_near(&record.sectors[*part]));
    (min_m, max_m, parts.collect())
}

#[cfg(test)]
mod tests;
