//! Stage `terrain`: the surface that the walk went over, with its planes and step edges.
//!
//! Contract: depth maps of keyframes are fused twice over. The first pass makes a truncated signed
//! distance field and its mesh; the second refits planes of the mesh to the depths themselves.
//! Pixels that masks exclude, and those of the wearer's shoes and legs, are not used. Where no
//! depth map shows a surface the mesh has a hole. Vertices have the colors of the cloud. Memory
//! grows with the area of the surface, not with the number of keyframes; the result does not depend
//! on the number of threads.

use ::terrain::edges::{find_edges, snap};
use ::terrain::fusion::Volume;
use ::terrain::mesh::Mesh;
use ::terrain::planes::PlaneRefiner;
use ::terrain::simplify::simplify;
use scene_bundle::outputs::{
    self, CLOUD, DEPTH, KEYFRAMES, MASKS, RIG_REFINED, TAG_DETECTIONS, TERRAIN, TRAJECTORY,
};
use serde_json::{Value, json};

use self::colors::CloudColors;
use self::config::TerrainConfig;
use self::shoes::Shoes;
use self::views::ViewReader;
use super::depth_frames::{DepthFrame, instants};
use crate::input::Input;
use crate::pipeline::{Stage, StageError, Work};

mod colors;
mod config;
mod shoes;
pub(super) mod surface;
mod views;

/// See the module.
pub(super) struct TerrainStage;

impl Stage<Input> for TerrainStage {
    fn name(&self) -> &'static str {
        "terrain"
    }

    fn version(&self) -> u32 {
        4
    }

    fn inputs(&self) -> &'static [&'static str] {
        &[
            RIG_REFINED,
            TRAJECTORY,
            KEYFRAMES,
            DEPTH,
            CLOUD,
            MASKS,
            TAG_DETECTIONS,
        ]
    }

    fn outputs(&self) -> &'static [&'static str] {
        &[TERRAIN]
    }

    fn settings(&self) -> Value {
        json!({ "config": TerrainConfig::default() })
    }

    fn run(&self, work: &Work<'_, Input>) -> Result<(), StageError> {
        let config = TerrainConfig::default();
        let rig = outputs::rig::read(&work.read(RIG_REFINED)?)?;
        let (depth, masks) = (work.read(DEPTH)?, work.read(MASKS)?);
        let index = outputs::depth::read_index(&depth)?;
        let trajectory = outputs::trajectory::read(&work.read(TRAJECTORY)?)?;
        let instants = instants(&rig, &index, &work.read(KEYFRAMES)?, &trajectory)?;
        let frames: Vec<DepthFrame> = instants.into_iter().flatten().collect();
        let detections = outputs::tag_detections::read(&work.read(TAG_DETECTIONS)?)?;
        let shoes = Shoes::new(&rig, &detections, config);
        let reader = ViewReader::new((&depth, &index), &masks, shoes, &rig, config.pose_sigma_m)?;
        let (mut done, all) = (0, 2 * frames.len() as u64);
        let mut advance = || {
            done += 1;
            work.progress(done, all);
        };

        let mut volume = Volume::new(config.fusion)?;
        reader.for_each(&frames, |view| {
            volume.add(view)?;
            advance();
            Ok(())
        })?;
        let mut mesh = Mesh::of(&volume, &config.mesh);
        let stats = volume.stats();
        drop(volume);
        let mut refiner = PlaneRefiner::new(&mesh, &config.planes);
        reader.for_each(&frames, |view| {
            refiner.add(view)?;
            advance();
            Ok(())
        })?;
        if refiner.dropped_candidates() > 0 {
            work.record_loss(format!(
                "{} small planes are left out: their number is limited to 65535",
                refiner.dropped_candidates()
            ));
        }
        let planes = refiner.finish();
        let edges = find_edges(&planes, &config.edges);
        snap(&mut mesh, &planes, &edges, config.fusion.voxel_m);
        CloudColors::new(&outputs::cloud::read(&work.read(CLOUD)?)?).paint(&mut mesh);
        let (simplified, report) = simplify(&mesh, &config.simplify);
        work.note(format!(
            "{} keyframes in {} blocks of 8 x 8 x 8 voxels ({:.0} MB); {} triangles, {} after \
             simplification; {} planes, {} step edges",
            stats.views,
            stats.blocks,
            stats.bytes as f64 * 1e-6,
            report.triangles_before,
            report.triangles_after,
            planes.planes.len(),
            edges.iter().filter(|edge| edge.step.is_some()).count()
        ));
        if mesh.triangles.is_empty() {
            work.note("no depth map shows a surface: the mesh is empty");
        }
        outputs::terrain::write(
            work.draft(TERRAIN),
            &surface::terrain(&planes, &edges, config.fusion.voxel_m),
            &surface::mesh(mesh, planes.of_vertex),
            &surface::mesh_without_planes(simplified),
        )?;
        Ok(())
    }
}
