//! Export of a bundle to other formats.
//!
//! Contract: nothing that exists is overwritten. A file appears whole or not at all; a folder is
//! written under its name with `.partial` appended and renamed when it is complete. What the format
//! cannot hold is reported ([`Summary::notes`]); content that should have been written and could
//! not be is counted ([`Summary::lost`]). The same bundle gives the same bytes.

use std::path::Path;

use cad_transforms::output::{Existing, write};

use crate::formats::{euroc, kitti, tum};
use crate::outputs::terrain::{self, MeshDetail};
use crate::outputs::{self, cloud};
use crate::scene::Scene;
use crate::trajectory::{Status, Trajectory};

mod colmap;
mod depth_warp;
mod error;
mod folder;
mod glb;
mod grid_map;
mod height_geotiff;
mod las;
mod lenses;
mod map_server;
mod mjcf;
mod nerfstudio;
mod obj;
mod options;
mod posed_images;
mod splats;
mod summary;
mod terrain_mesh;
mod urdf;
mod usda;

pub use error::ExportError;
pub use options::Options;
pub use summary::Summary;

use folder::NewFolder;
use splats::SplatFormat;

/// What to write.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Format {
    /// One file, a line per pose of the rig.
    Tum,
    /// A folder with `poses.txt` and `times.txt`, of the rig.
    Kitti,
    /// One CSV file, a line per pose of the rig.
    Euroc,
    /// A folder with `transforms.json` of the keyframes, points, masks and depth.
    Nerfstudio,
    /// A folder with `cameras.txt`, `images.txt` and `points3D.txt`.
    ColmapText,
    /// A folder with `cameras.bin`, `images.bin` and `points3D.bin`.
    ColmapBinary,
    /// One file, the points.
    Ply,
    /// One file, the points.
    Las,
    /// One file, the points, compressed.
    Laz,
    /// One file, the simplified mesh of the ground with all its properties.
    TerrainPly,
    /// One file, the simplified mesh of the ground.
    TerrainObj,
    /// One file, the simplified mesh of the ground, y up.
    TerrainGlb,
    /// One file, the simplified mesh of the ground, colliders and cameras.
    Usda,
    /// A folder with an image of the occupancy and its YAML for each level.
    MapServer,
    /// One MCAP file with a message of all layers for each level.
    GridMap,
    /// A folder with an image of the elevations for each level.
    HeightGeotiff,
    /// A folder with `model.xml` and the height fields of the collision geometry.
    Mjcf,
    /// A folder with `scene.urdf` and a mesh for each convex part.
    Urdf,
    /// One file, the Gaussians, as 3DGS writes them.
    SplatPly,
    /// One file, the Gaussians, compressed.
    Spz,
    /// One file, the Gaussians with one color each.
    Splat,
    /// One file, the Gaussians as glTF, y up.
    SplatGlb,
}

impl Format {
    /// All of them.
    pub const ALL: [Self; 22] = [
        Self::Tum,
        Self::Kitti,
        Self::Euroc,
        Self::Nerfstudio,
        Self::ColmapText,
        Self::ColmapBinary,
        Self::Ply,
        Self::Las,
        Self::Laz,
        Self::TerrainPly,
        Self::TerrainObj,
        Self::TerrainGlb,
        Self::Usda,
        Self::MapServer,
        Self::GridMap,
        Self::HeightGeotiff,
        Self::Mjcf,
        Self::Urdf,
        Self::SplatPly,
        Self::Spz,
        Self::Splat,
        Self::SplatGlb,
    ];

    /// Its name on the command line.
    pub fn name(self) -> &'static str {
        match self {
            Self::Tum => "tum",
            Self::Kitti => "kitti",
            Self::Euroc => "euroc",
            Self::Nerfstudio => "nerfstudio",
            Self::ColmapText => "colmap-text",
            Self::ColmapBinary => "colmap-binary",
            Self::Ply => "ply",
            Self::Las => "las",
            Self::Laz => "laz",
            Self::TerrainPly => "terrain-ply",
            Self::TerrainObj => "terrain-obj",
            Self::TerrainGlb => "terrain-glb",
            Self::Usda => "usda",
            Self::MapServer => "map-server",
            Self::GridMap => "grid-map",
            Self::HeightGeotiff => "height-geotiff",
            Self::Mjcf => "mjcf",
            Self::Urdf => "urdf",
            Self::SplatPly => "splat-ply",
            Self::Spz => "spz",
            Self::Splat => "splat",
            Self::SplatGlb => "splat-glb",
        }
    }

    /// Outputs of a bundle that it needs.
    fn outputs(self, is_causal: bool) -> &'static [&'static str] {
        match self {
            Self::Tum | Self::Kitti | Self::Euroc if is_causal => &[outputs::TRAJECTORY_CAUSAL],
            Self::Tum | Self::Kitti | Self::Euroc => &[outputs::TRAJECTORY],
            Self::Nerfstudio | Self::ColmapText | Self::ColmapBinary => &[
                outputs::RIG_REFINED,
                outputs::KEYFRAMES,
                outputs::DEPTH,
                outputs::MASKS,
                outputs::CLOUD,
            ],
            Self::Ply | Self::Las | Self::Laz => &[outputs::CLOUD],
            Self::TerrainPly | Self::TerrainObj | Self::TerrainGlb | Self::Usda => {
                &[outputs::TERRAIN]
            }
            Self::MapServer | Self::GridMap | Self::HeightGeotiff => &[outputs::MAPS],
            Self::Mjcf | Self::Urdf => &[outputs::COLLISION],
            Self::SplatPly | Self::Spz | Self::Splat | Self::SplatGlb => &[outputs::SPLATS],
        }
    }

    /// The format of a name.
    ///
    /// ```
    /// use scene_bundle::export::Format;
    ///
    /// assert_eq!(Format::from_name("colmap-text"), Some(Format::ColmapText));
    /// assert_eq!(Format::from_name("obj"), None);
    /// assert!(Format::ALL.into_iter().all(|format| Format::from_name(format.name()) == Some(format)));
    /// ```
    pub fn from_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|format| format.name() == name)
    }
}

/// Writes a bundle in a format to `out`, a new file or folder.
///
/// # Errors
/// [`ExportError`]; then nothing was written.
///
/// A trajectory as TUM text, and points as LAS and as PLY:
///
/// ```
/// use scene_bundle::export::{Format, Options, export};
/// # use cad_transforms::RigidTransform;
/// # use scene_bundle::{Bundle, Pose, Trajectory, outputs};
/// # let folder = tempfile::tempdir()?;
/// # let provenance = scene_bundle::Provenance {
/// #     session_id: "01890a5d-ac96-774b-bcce-b302099a8057".to_owned(),
/// #     handoff_blake3: "ab".repeat(32),
/// #     judgement: None,
/// #     rig: scene_bundle::RigRevision { name: "chest".to_owned(), revision: "B".to_owned() },
/// #     program: "example".to_owned(),
/// #     program_version: "1.0".to_owned(),
/// #     started_civil_ns: 1_790_000_000_000_000_000,
/// #     ended_civil_ns: None,
/// # };
/// # let record = scene_bundle::Record {
/// #     stage: "example".to_owned(),
/// #     stage_version: 1,
/// #     settings: serde_json::json!({ "step": 2 }),
/// #     inputs: std::collections::BTreeMap::new(),
/// # };
/// # let bundle = Bundle::create_or_open(&folder.path().join("walk.scene"), provenance)?;
/// # let walk = (0..5).map(|i| Pose::new(i * 33_333_333, RigidTransform::identity()));
/// # let draft = bundle.begin(outputs::TRAJECTORY)?;
/// # outputs::trajectory::write(&draft, &Trajectory::new(walk.collect())?)?;
/// # draft.commit(record.clone())?;
/// # let point = outputs::cloud::CloudPoint { x_in_world: [1.5, -2.0, 0.25], color: [200, 180, 160], sigma_m: 0.004 };
/// # let draft = bundle.begin(outputs::CLOUD)?;
/// # outputs::cloud::write(&draft, &[point])?;
/// # draft.commit(record)?;
/// # let scene = bundle.scene();
///
/// let poses = folder.path().join("poses.txt");
/// let summary = export(&scene, Format::Tum, &Options::default(), &poses)?;
/// assert_eq!(summary.description, "5 poses of the rig");
/// assert_eq!(std::fs::read_to_string(&poses)?.lines().count(), 6); // and the title line
///
/// let points = folder.path().join("cloud.las");
/// let summary = export(&scene, Format::Las, &Options::default(), &points)?;
/// assert_eq!(summary.notes, ["sigma cannot be represented in LAS and is left out"]);
/// assert!(std::fs::read(&points)?.starts_with(b"LASF"));
///
/// // Nothing that exists is overwritten.
/// assert!(export(&scene, Format::Ply, &Options::default(), &points).is_err());
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
///
/// Keyframes as a COLMAP model:
///
/// ```
/// use scene_bundle::export::{Format, Options, export};
/// # use cad_transforms::RigidTransform;
/// # use camera_models::{CameraModel, Distortion};
/// # use scene_bundle::Bundle;
/// # use scene_bundle::outputs::{self, keyframes::Keyframe, rig::{RigCamera, RigModel}};
/// # let folder = tempfile::tempdir()?;
/// # let provenance = scene_bundle::Provenance {
/// #     session_id: "01890a5d-ac96-774b-bcce-b302099a8057".to_owned(),
/// #     handoff_blake3: "ab".repeat(32),
/// #     judgement: None,
/// #     rig: scene_bundle::RigRevision { name: "chest".to_owned(), revision: "B".to_owned() },
/// #     program: "example".to_owned(),
/// #     program_version: "1.0".to_owned(),
/// #     started_civil_ns: 1_790_000_000_000_000_000,
/// #     ended_civil_ns: None,
/// # };
/// # let record = scene_bundle::Record {
/// #     stage: "example".to_owned(),
/// #     stage_version: 1,
/// #     settings: serde_json::json!({ "step": 2 }),
/// #     inputs: std::collections::BTreeMap::new(),
/// # };
/// # let model = CameraModel::new((64, 48), [50.0, 50.0, 31.5, 23.5], Distortion::None);
/// # let camera = RigCamera {
/// #     name: "feet".to_owned(),
/// #     left: model,
/// #     right: model,
/// #     rig_from_left: RigidTransform::from_translation_m([0.0, 0.0, 0.4])?,
/// #     rig_from_left_covariance: None,
/// #     right_from_left: RigidTransform::from_translation_m([-0.063, 0.0, 0.0])?,
/// #     right_from_left_covariance: None,
/// #     line_s: 0.0,
/// # };
/// # let rig = RigModel {
/// #     name: "chest".to_owned(),
/// #     revision: "B".to_owned(),
/// #     cameras: vec![camera],
/// #     imus: Vec::new(),
/// #     shoes: Vec::new(),
/// # };
/// # let keyframe = |frame: u64| -> Result<Keyframe, Box<dyn std::error::Error>> {
/// #     Ok(Keyframe {
/// #         set: frame,
/// #         frame,
/// #         time_ns: 1_000_000_000 + frame as i64 * 33_333_333,
/// #         camera: 0,
/// #         world_from_left: RigidTransform::from_translation_m([0.1 * frame as f64, 0.0, 1.4])?,
/// #     })
/// # };
/// # let bundle = Bundle::create_or_open(&folder.path().join("walk.scene"), provenance)?;
/// # let draft = bundle.begin(outputs::RIG)?;
/// # outputs::rig::write(&draft, &rig)?;
/// # draft.commit(record.clone())?;
/// # let draft = bundle.begin(outputs::KEYFRAMES)?;
/// # outputs::keyframes::write(&draft, &[keyframe(10)?, keyframe(20)?])?;
/// # draft.commit(record.clone())?;
/// # let scene = bundle.scene();
///
/// let out = folder.path().join("colmap");
/// export(&scene, Format::ColmapText, &Options { right: true, ..Options::default() }, &out)?;
/// let images = std::fs::read_to_string(out.join("images.txt"))?;
/// assert_eq!(images.matches("feet/left/").count(), 2);
/// assert_eq!(images.matches("feet/right/").count(), 2);
/// // The principal point gains half a pixel: COLMAP counts from the corner of the first pixel.
/// assert!(std::fs::read_to_string(out.join("cameras.txt"))?.contains(" 32.0 24.0"));
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
///
/// Keyframes as `transforms.json` of nerfstudio:
///
/// ```
/// use scene_bundle::export::{Format, Options, export};
/// # use cad_transforms::RigidTransform;
/// # use camera_models::{CameraModel, Distortion};
/// # use scene_bundle::Bundle;
/// # use scene_bundle::outputs::{self, keyframes::Keyframe, rig::{RigCamera, RigModel}};
/// # let folder = tempfile::tempdir()?;
/// # let provenance = scene_bundle::Provenance {
/// #     session_id: "01890a5d-ac96-774b-bcce-b302099a8057".to_owned(),
/// #     handoff_blake3: "ab".repeat(32),
/// #     judgement: None,
/// #     rig: scene_bundle::RigRevision { name: "chest".to_owned(), revision: "B".to_owned() },
/// #     program: "example".to_owned(),
/// #     program_version: "1.0".to_owned(),
/// #     started_civil_ns: 1_790_000_000_000_000_000,
/// #     ended_civil_ns: None,
/// # };
/// # let record = scene_bundle::Record {
/// #     stage: "example".to_owned(),
/// #     stage_version: 1,
/// #     settings: serde_json::json!({ "step": 2 }),
/// #     inputs: std::collections::BTreeMap::new(),
/// # };
/// # let model = CameraModel::new((64, 48), [50.0, 50.0, 31.5, 23.5], Distortion::None);
/// # let camera = RigCamera {
/// #     name: "feet".to_owned(),
/// #     left: model,
/// #     right: model,
/// #     rig_from_left: RigidTransform::from_translation_m([0.0, 0.0, 0.4])?,
/// #     rig_from_left_covariance: None,
/// #     right_from_left: RigidTransform::from_translation_m([-0.063, 0.0, 0.0])?,
/// #     right_from_left_covariance: None,
/// #     line_s: 0.0,
/// # };
/// # let rig = RigModel {
/// #     name: "chest".to_owned(),
/// #     revision: "B".to_owned(),
/// #     cameras: vec![camera],
/// #     imus: Vec::new(),
/// #     shoes: Vec::new(),
/// # };
/// # let keyframe = |frame: u64| -> Result<Keyframe, Box<dyn std::error::Error>> {
/// #     Ok(Keyframe {
/// #         set: frame,
/// #         frame,
/// #         time_ns: 1_000_000_000 + frame as i64 * 33_333_333,
/// #         camera: 0,
/// #         world_from_left: RigidTransform::from_translation_m([0.1 * frame as f64, 0.0, 1.4])?,
/// #     })
/// # };
/// # let bundle = Bundle::create_or_open(&folder.path().join("walk.scene"), provenance)?;
/// # let draft = bundle.begin(outputs::RIG)?;
/// # outputs::rig::write(&draft, &rig)?;
/// # draft.commit(record.clone())?;
/// # let draft = bundle.begin(outputs::KEYFRAMES)?;
/// # outputs::keyframes::write(&draft, &[keyframe(10)?, keyframe(20)?])?;
/// # draft.commit(record.clone())?;
/// # let scene = bundle.scene();
///
/// let out = folder.path().join("nerf");
/// export(&scene, Format::Nerfstudio, &Options::default(), &out)?;
/// let text = std::fs::read(out.join("transforms.json"))?;
/// let transforms: serde_json::Value = serde_json::from_slice(&text)?;
/// let frames = transforms["frames"].as_array().ok_or("no frames")?;
/// assert_eq!(frames.len(), 2);
/// // The camera looks along -z in the axes of OpenGL.
/// assert_eq!(frames[0]["transform_matrix"][2][2].as_f64(), Some(-1.0));
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub fn export(
    scene: &Scene,
    format: Format,
    options: &Options,
    out: &Path,
) -> Result<Summary, ExportError> {
    // Checked before the work.
    if out.symlink_metadata().is_ok() {
        return Err(ExportError::Exists(out.to_owned()));
    }
    let mut summary = match format {
        Format::Tum | Format::Kitti | Format::Euroc => trajectory(scene, format, options, out)?,
        Format::Nerfstudio => nerfstudio::export(scene, options, out)?,
        Format::ColmapText => colmap::export(scene, colmap::Form::Text, options, out)?,
        Format::ColmapBinary => colmap::export(scene, colmap::Form::Binary, options, out)?,
        Format::Ply => {
            let bytes = cloud::read_file(&scene.output(outputs::CLOUD)?)?;
            write(out, &bytes, Existing::Refuse)?;
            Summary {
                description: "the points as they are".to_owned(),
                ..Summary::default()
            }
        }
        Format::Las | Format::Laz => las::export(scene, format == Format::Laz, out)?,
        Format::TerrainPly => {
            let reader = scene.output(outputs::TERRAIN)?;
            let bytes = terrain::read_mesh_file(&reader, MeshDetail::Simplified)?;
            write(out, &bytes, Existing::Refuse)?;
            Summary {
                description: "the simplified mesh as it is".to_owned(),
                ..Summary::default()
            }
        }
        Format::TerrainObj => obj::export(scene, out)?,
        Format::TerrainGlb => glb::export(scene, out)?,
        Format::Usda => usda::export(scene, out)?,
        Format::MapServer => map_server::export(scene, out)?,
        Format::GridMap => grid_map::export(scene, out)?,
        Format::HeightGeotiff => height_geotiff::export(scene, out)?,
        Format::Mjcf => mjcf::export(scene, out)?,
        Format::Urdf => urdf::export(scene, out)?,
        Format::SplatPly => splats::export(scene, SplatFormat::Ply, out)?,
        Format::Spz => splats::export(scene, SplatFormat::Spz, out)?,
        Format::Splat => splats::export(scene, SplatFormat::Splat, out)?,
        Format::SplatGlb => splats::export(scene, SplatFormat::Glb, out)?,
    };
    let outdated = scene.manifest().outdated();
    for name in format.outputs(options.causal) {
        if let Some(input) = outdated.get(name) {
            summary.lost.push(format!(
                "{name} is out of date: {input} was recomputed since, and the rest does not belong to it"
            ));
        }
    }
    Ok(summary)
}

fn trajectory(
    scene: &Scene,
    format: Format,
    options: &Options,
    out: &Path,
) -> Result<Summary, ExportError> {
    let name = if options.causal {
        outputs::TRAJECTORY_CAUSAL
    } else {
        outputs::TRAJECTORY
    };
    let trajectory = outputs::trajectory::read(&scene.output(name)?)?;
    match format {
        Format::Kitti => {
            let (poses, times) = kitti::to_text(&trajectory);
            let folder = NewFolder::begin(out)?;
            folder.write("poses.txt", poses.as_bytes())?;
            folder.write("times.txt", times.as_bytes())?;
            folder.finish()?;
        }
        Format::Euroc => write(
            out,
            euroc::to_text(&trajectory, None).as_bytes(),
            Existing::Refuse,
        )?,
        _ => write(out, tum::to_text(&trajectory).as_bytes(), Existing::Refuse)?,
    }
    Ok(Summary {
        description: format!("{} poses of the rig", trajectory.usable().count()),
        notes: omitted_fields(&trajectory, format),
        lost: Vec::new(),
    })
}

/// Content that the text formats cannot represent.
fn omitted_fields(trajectory: &Trajectory, format: Format) -> Vec<String> {
    let has = |what: &str, there: bool| there.then(|| what.to_owned());
    let poses = trajectory.poses();
    let lost = trajectory.len() - trajectory.usable().count();
    let velocities = poses
        .iter()
        .filter(|p| p.velocity_in_world.is_some())
        .count();
    let velocities_written =
        format == Format::Euroc && trajectory.usable().all(|p| p.velocity_in_world.is_some());
    let left_out = [
        has("covariances", poses.iter().any(|p| p.covariance.is_some())),
        has("velocities", velocities > 0 && !velocities_written),
        has(
            "statuses",
            poses.iter().any(|p| p.status != Status::Tracked),
        ),
    ];
    let left_out: Vec<String> = left_out.into_iter().flatten().collect();
    let mut notes = Vec::new();
    if !left_out.is_empty() {
        notes.push(format!(
            "{} cannot represent {}",
            format.name(),
            left_out.join(", ")
        ));
    }
    if lost > 0 {
        notes.push(format!("{lost} poses where the rig was lost are left out"));
    }
    notes
}
