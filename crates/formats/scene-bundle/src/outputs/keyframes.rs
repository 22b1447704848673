//! Output `keyframes`: `keyframes.npy`, a row per keyframe of a camera.
//!
//! Contract: rows are sorted by camera and time; no two rows have the same camera and frame.

use cad_transforms::RigidTransform;

use super::refused;
use crate::draft::Draft;
use crate::error::BundleError;
use crate::npy::{Column, Kind, TableWriter, rows};
use crate::scene::OutputReader;

const TABLE: &str = "keyframes.npy";

const COLUMNS: [Column; 6] = [
    Column("set", Kind::U64, 1),
    Column("frame", Kind::U64, 1),
    Column("time_ns", Kind::I64, 1),
    Column("camera", Kind::U8, 1),
    Column("position_m", Kind::F64, 3),
    Column("rotation_wxyz", Kind::F64, 4),
];

/// A keyframe: one stereo frame of one camera, with its pose.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Keyframe {
    /// Number of the frame set that it belongs to.
    pub set: u64,
    /// Number of the frame among those of its camera; image files are named by it.
    pub frame: u64,
    /// Time of the frame, ns: the middle of the exposure.
    pub time_ns: i64,
    /// The camera: its index in the output `rig`, from 0.
    pub camera: u8,
    /// Takes points in the left optical frame at the frame's own time to the world, metres.
    pub world_from_left: RigidTransform,
}

/// Writes keyframes, in any order.
///
/// # Errors
/// [`BundleError::Refused`] for a duplicate frame, [`BundleError::Io`].
pub fn write(draft: &Draft, keyframes: &[Keyframe]) -> Result<(), BundleError> {
    let mut sorted: Vec<&Keyframe> = keyframes.iter().collect();
    sorted.sort_by_key(|k| (k.camera, k.time_ns, k.frame));
    let mut frames: Vec<(u8, u64)> = keyframes.iter().map(|k| (k.camera, k.frame)).collect();
    frames.sort_unstable();
    if let Some(pair) = frames.windows(2).find(|pair| pair[0] == pair[1]) {
        let found = format!("frame {} of camera {} twice", pair[0].1, pair[0].0);
        return Err(refused(draft, TABLE, found, "each frame once"));
    }
    let mut table = TableWriter::create(draft, TABLE, &COLUMNS)?;
    for keyframe in sorted {
        table.row(|row| {
            row.u64(keyframe.set);
            row.u64(keyframe.frame);
            row.i64(keyframe.time_ns);
            row.u8(keyframe.camera);
            row.f64(&keyframe.world_from_left.translation_m());
            row.f64(&keyframe.world_from_left.rotation_wxyz());
        })?;
    }
    table.finish()
}

/// Reads keyframes, sorted by camera and time.
///
/// # Errors
/// As [`OutputReader::read`]; [`BundleError::Malformed`].
///
/// Rows are sorted by camera and time, in whatever order they were written:
///
/// ```
/// use scene_bundle::outputs::keyframes;
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
///
/// let draft = bundle.begin(outputs::KEYFRAMES)?;
/// keyframes::write(&draft, &[keyframe(7)?, keyframe(5)?])?;
/// draft.commit(record)?;
/// let rows = keyframes::read(&bundle.scene().output(outputs::KEYFRAMES)?)?;
/// assert_eq!(rows.iter().map(|row| row.frame).collect::<Vec<_>>(), [5, 7]);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub fn read(reader: &OutputReader) -> Result<Vec<Keyframe>, BundleError> {
    let bytes = reader.read(TABLE)?;
    let place = reader.file_path(TABLE);
    let rows = rows(&bytes, &COLUMNS, &place)?.enumerate();
    rows.map(|(row, mut fields)| {
        let (set, frame, time_ns, camera) = (fields.u64(), fields.u64(), fields.i64(), fields.u8());
        let position: [f64; 3] = fields.f64();
        let rotation: [f64; 4] = fields.f64();
        let pose = RigidTransform::from_wxyz(rotation, position);
        let world_from_left = pose.map_err(|error| BundleError::Malformed {
            path: place.clone(),
            place: format!("row {row}"),
            found: error.to_string(),
            expected: "a pose".to_owned(),
        })?;
        Ok(Keyframe {
            set,
            frame,
            time_ns,
            camera,
            world_from_left,
        })
    })
    .collect()
}
