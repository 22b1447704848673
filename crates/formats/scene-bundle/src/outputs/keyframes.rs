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
