//! Synthetic scenes as scene bundles: for tests, and to try commands without a recorded walk.

use std::path::Path;

use ::splats::Coverage;
use cad_transforms::RigidTransform;
use scene_bundle::outputs::contacts::{ContactPatch, FootContact};
use scene_bundle::outputs::rig::{RigCamera, RigModel};
use scene_bundle::outputs::splats::{
    SplatBackground, SplatContent, SplatCoverage, SplatCoverageContent, SplatObservation,
    SplatScene, SplatSector, SplatSpaceBlock, SplatTraining,
};
use scene_bundle::outputs::{self, contacts, maps, rig, splats, trajectory};
use scene_bundle::{Bundle, BundleError, Draft, Provenance, Record, RigRevision};

use super::{SKY, SyntheticScene};
use crate::error::SimulationError;
use crate::scene::{GaussianSource, Sector};

/// Distance of the right camera of the rig from the left one, m.
const BASELINE_M: f64 = 0.12;

impl SyntheticScene {
    /// Writes a scene of one sector as a bundle: maps, Gaussians, rig, trajectory and contacts. Its
    /// rig is a stereo camera, whose left one has the lens and mount of the synthetic walk.
    ///
    /// # Errors
    /// [`SimulationError::Scene`] for a scene of several sectors, which are recordings of their
    /// own, and for a path where something is; [`SimulationError::Bundle`] for one that cannot be
    /// written.
    pub fn write_bundle(&self, path: &Path) -> Result<(), SimulationError> {
        self.write_bundle_with(path, false)
    }

    /// The same with what the cameras of the walk saw, as of a scene that was trained with their
    /// images: what predictions of the PSNR come from. That takes seconds.
    ///
    /// # Errors
    /// As [`Self::write_bundle`].
    pub fn write_observed_bundle(&self, path: &Path) -> Result<(), SimulationError> {
        self.write_bundle_with(path, true)
    }

    fn write_bundle_with(&self, path: &Path, is_observed: bool) -> Result<(), SimulationError> {
        let [sector] = self.scene.sectors.as_slice() else {
            return Err(SimulationError::Scene {
                place: format!("scene {}", self.scene.name),
                found: format!("{} recordings", self.scene.sectors.len()),
                expected: "one, of which a bundle is".to_owned(),
            });
        };
        if path.exists() {
            return Err(SimulationError::Scene {
                place: path.display().to_string(),
                found: "something that is there".to_owned(),
                expected: "a new folder".to_owned(),
            });
        }
        let source = sector.gaussians.as_ref();
        let source = source.ok_or_else(|| SimulationError::Scene {
            place: format!("scene {}", self.scene.name),
            found: "no Gaussians".to_owned(),
            expected: "those of a synthetic scene".to_owned(),
        })?;
        let observed = match is_observed {
            true => source.observed()?,
            false => None,
        };
        if is_observed && observed.is_none() {
            return Err(SimulationError::Scene {
                place: format!("scene {}", self.scene.name),
                found: "Gaussians that no camera recorded".to_owned(),
                expected: "those of a synthetic scene with its own spacing".to_owned(),
            });
        }
        let coverage = observed.as_ref().map(|observed| observed.coverage());
        let record = record_of(source, coverage);
        let content = coverage.map(content_of);
        let scene = source.load()?;
        write(path, sector, &scene, &record, content.as_ref()).map_err(|source| {
            SimulationError::Bundle {
                path: path.to_owned(),
                source,
            }
        })
    }
}

/// The record of Gaussians, with one sector of all of them.
fn record_of(source: &GaussianSource, coverage: Option<&Coverage>) -> SplatScene {
    SplatScene {
        degree: source.degree(),
        compensated: source.is_compensated(),
        background: SplatBackground::Constant(SKY),
        sectors: vec![SplatSector {
            min_m: [-100.0; 3],
            max_m: [100.0; 3],
            count: 0,
            file: String::new(),
            blake3: String::new(),
            views: Vec::new(),
            neighbors: Vec::new(),
        }],
        views: Vec::new(),
        training: SplatTraining::default(),
        coverage: coverage.map(|coverage| SplatCoverage {
            voxel_m: coverage.space().voxel_m(),
            range_m: coverage.space().range_m(),
            sky_texels: coverage.sky().size(),
        }),
    }
}

fn content_of(coverage: &Coverage) -> SplatCoverageContent {
    let gaussians = coverage.gaussians().iter().map(|seen| SplatObservation {
        instants: seen.instants,
        directions: seen.directions.0,
        finest_m: seen.finest_m,
        color_error: seen.color_error,
        depth_error: seen.depth_error,
    });
    let blocks = coverage.space().blocks();
    SplatCoverageContent {
        gaussians: vec![gaussians.collect()],
        space: blocks
            .map(|(index, voxels)| SplatSpaceBlock { index, voxels })
            .collect(),
        sky: coverage.sky().texels().to_vec(),
    }
}

fn write(
    path: &Path,
    sector: &Sector,
    scene: &::splats::Scene,
    record_of_splats: &SplatScene,
    coverage: Option<&SplatCoverageContent>,
) -> Result<(), BundleError> {
    let bundle = Bundle::create_or_open(path, provenance())?;
    let output = |name: &str, write: &dyn Fn(&Draft) -> Result<(), BundleError>| {
        let draft = bundle.begin(name)?;
        write(&draft)?;
        draft.commit(record())
    };
    if let Some(levels) = &sector.levels {
        output(outputs::MAPS, &|draft| maps::write(draft, levels).map(drop))?;
    }
    output(outputs::SPLATS, &|draft| {
        let content = SplatContent {
            sectors: std::slice::from_ref(&scene.splats),
            coverage,
            ..SplatContent::default()
        };
        splats::write(draft, record_of_splats, &content).map(drop)
    })?;
    if let Some(rig) = rig_model(sector) {
        output(outputs::RIG, &|draft| rig::write(draft, &rig))?;
    }
    if let Some(walk) = &sector.recording.trajectory {
        output(outputs::TRAJECTORY, &|draft| trajectory::write(draft, walk))?;
    }
    output(outputs::CONTACTS, &|draft| {
        let own = &sector.recording.contacts;
        let patches: Vec<ContactPatch> = own.iter().map(whole_sole).collect();
        contacts::write(draft, own, &patches, &[])
    })?;
    bundle.finish(2)
}

/// A rectangle of 28x10 cm, all of which bears.
pub(crate) fn whole_sole(contact: &FootContact) -> ContactPatch {
    let corners = [[-0.14, -0.05], [0.14, -0.05], [0.14, 0.05], [-0.14, 0.05]];
    let corner = |[x, y]: [f64; 2]| contact.world_from_foot.apply([x, y, 0.0]);
    ContactPatch {
        outline_m: corners.map(corner).to_vec(),
        area_share: 1.0,
        ground_share: 1.0,
        gap_m: Some(0.0),
    }
}

fn rig_model(sector: &Sector) -> Option<RigModel> {
    let camera = sector.recording.cameras.first()?;
    let left_from_right = RigidTransform::from_translation_m([BASELINE_M, 0.0, 0.0]).ok()?;
    let name = camera.name.split('/').next().unwrap_or_default();
    Some(RigModel {
        name: "synthetic".to_owned(),
        revision: "1".to_owned(),
        cameras: vec![RigCamera {
            name: name.to_owned(),
            left: camera.model,
            right: camera.model,
            rig_from_left: camera.rig_from_camera,
            rig_from_left_covariance: None,
            right_from_left: left_from_right.inverse(),
            right_from_left_covariance: None,
            line_s: camera.line_s,
        }],
        imus: Vec::new(),
        shoes: Vec::new(),
    })
}

fn provenance() -> Provenance {
    Provenance {
        session_id: "01890a5d-ac96-774b-bcce-b302099a8057".to_owned(),
        handoff_blake3: "ab".repeat(32),
        judgement: None,
        rig: RigRevision {
            name: "synthetic".to_owned(),
            revision: "1".to_owned(),
        },
        program: "simulation".to_owned(),
        program_version: env!("CARGO_PKG_VERSION").to_owned(),
        started_civil_ns: 0,
        ended_civil_ns: None,
    }
}

fn record() -> Record {
    Record {
        stage: "synthetic".to_owned(),
        stage_version: 1,
        settings: serde_json::json!({}),
        inputs: Default::default(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::SceneData;

    #[test]
    fn a_bundle_opens_with_the_ground_walk_and_rig_of_the_scene() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("stairs.scene");
        let stairs = SyntheticScene::stairs().unwrap();
        stairs.write_bundle(&path).unwrap();
        let opened = SceneData::open(&path).unwrap();
        let [found, expected] = [&opened.sectors[0], &stairs.scene.sectors[0]];
        assert_eq!(found.recording.contacts, expected.recording.contacts);
        let cameras = &found.recording.cameras;
        assert_eq!(cameras[0], expected.recording.cameras[0]);
        assert_eq!(cameras[1].name, "front/right");
        assert_eq!(found.references, expected.references);
        let counts = [found, expected].map(|of| of.gaussians.as_ref().unwrap().count());
        assert_eq!(counts[0], counts[1]);
        // Never over another one.
        assert!(SyntheticScene::room().unwrap().write_bundle(&path).is_err());
        let several = SyntheticScene::corridor_loop().unwrap();
        let error = several.write_bundle(&folder.path().join("loop.scene"));
        assert!(error.unwrap_err().to_string().contains("4 recordings"));
    }
}
