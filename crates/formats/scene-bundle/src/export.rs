//! Export of a bundle to other formats.
//!
//! Contract: nothing that exists is overwritten. A file appears whole or not at all; a folder is
//! written under its name with `.partial` appended and renamed when it is complete. What the format
//! cannot hold is reported ([`Summary::notes`]); content that should have been written and could
//! not be is counted ([`Summary::lost`]). The same bundle gives the same bytes.

use std::fs;
use std::io;
use std::path::{Path, PathBuf};

use cad_transforms::output::{Existing, WriteError, write};

use crate::error::BundleError;
use crate::formats::{euroc, kitti, tum};
use crate::outputs::{self, cloud};
use crate::scene::Scene;
use crate::trajectory::{Status, Trajectory};

mod colmap;
mod depth_warp;
mod folder;
mod las;
mod lenses;
mod nerfstudio;
mod posed_images;

use folder::NewFolder;

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
}

impl Format {
    /// All of them.
    pub const ALL: [Self; 9] = [
        Self::Tum,
        Self::Kitti,
        Self::Euroc,
        Self::Nerfstudio,
        Self::ColmapText,
        Self::ColmapBinary,
        Self::Ply,
        Self::Las,
        Self::Laz,
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

/// How to write it.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Options {
    /// Whether the causal trajectory is exported instead of the offline one. No effect on
    /// keyframes, which have their own poses.
    pub causal: bool,
    /// Folder of the images, as `paws-reconstruct frames` writes them: `CAMERA/left/NNNNNN.png`,
    /// named by the number of the frame. With it, keyframes without an image are left out.
    pub images: Option<PathBuf>,
    /// Whether right images are included.
    pub right: bool,
    /// Only these cameras; all where it is empty.
    pub cameras: Vec<String>,
}

/// Summary of an export.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Summary {
    /// Description of what was written.
    pub description: String,
    /// Content that the format cannot represent, and what was changed to fit it.
    pub notes: Vec<String>,
    /// What should have been written and was not.
    pub lost: Vec<String>,
}

/// Why nothing was written.
#[derive(Debug, thiserror::Error)]
pub enum ExportError {
    /// The bundle cannot be read.
    #[error(transparent)]
    Bundle(#[from] BundleError),
    /// The path exists already, or writing fails.
    #[error(transparent)]
    File(#[from] WriteError),
    /// The path exists already: give another.
    #[error("writing an export: it exists already and is not overwritten: {}", .0.display())]
    Exists(PathBuf),
    /// Delete it: it is what an earlier run had written before it was stopped.
    #[error("writing an export: an earlier run was stopped and left a folder behind; delete it: {}", .0.display())]
    LeftOver(PathBuf),
    /// Any I/O error of the underlying file system.
    #[error("writing an export: {}", path.display())]
    Write {
        /// Path that was being written.
        path: PathBuf,
        /// What failed.
        #[source]
        error: io::Error,
    },
    /// The format cannot hold what there is.
    #[error("writing {format}: found {found}, expected {expected}")]
    Refused {
        /// The format.
        format: &'static str,
        /// What there is.
        found: String,
        /// What the format needs.
        expected: String,
    },
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

fn writing(path: &Path) -> impl FnOnce(io::Error) -> ExportError + use<> {
    let path = path.to_owned();
    move |error| ExportError::Write { path, error }
}

/// Path of the image folder for a program that reads a file in `out`: relative where possible.
fn relative_path(out: &Path, images: &Path) -> Result<PathBuf, ExportError> {
    let parent = match out.parent() {
        Some(parent) if !parent.as_os_str().is_empty() => parent,
        _ => Path::new("."),
    };
    fs::create_dir_all(parent).map_err(writing(parent))?;
    let whole = |path: &Path| fs::canonicalize(path).map_err(writing(path));
    let (parent, images) = (whole(parent)?, whole(images)?);
    let out = parent.join(out.file_name().unwrap_or_default());
    let common = out
        .components()
        .zip(images.components())
        .take_while(|(a, b)| a == b)
        .count();
    let up = out.components().skip(common).map(|_| "..");
    let mut path: PathBuf = up.collect();
    path.extend(images.components().skip(common));
    Ok(path)
}
