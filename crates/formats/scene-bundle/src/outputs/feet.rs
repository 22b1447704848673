//! Output `feet`: a row per foot and time in `feet.npy`, from all frames, and in `causal.npy`, from
//! those until then.
//!
//! Contract: rows are sorted by foot and time, each once.

use cad_transforms::rig::Foot;
use cad_transforms::{Covariance, RigidTransform};

use super::tag_detections::{foot_code, foot_of};
use super::trajectory::{from_upper, upper};
use super::{malformed, refused};
use crate::draft::Draft;
use crate::error::BundleError;
use crate::npy::{Column, Fields, Kind, TableWriter, rows};
use crate::scene::OutputReader;

const TABLE: &str = "feet.npy";
const CAUSAL_TABLE: &str = "causal.npy";

const COLUMNS: [Column; 9] = [
    Column("foot", Kind::U8, 1),
    Column("time_ns", Kind::I64, 1),
    Column("position_m", Kind::F64, 3),
    Column("rotation_wxyz", Kind::F64, 4),
    Column("covariance", Kind::F64, 21),
    Column("position_in_rig_m", Kind::F64, 3),
    Column("rotation_in_rig_wxyz", Kind::F64, 4),
    Column("status", Kind::U8, 1),
    Column("has_covariance", Kind::Bool, 1),
];

/// How the pose of a foot is known.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum FootStatus {
    /// A frame shows it at that time, or within 50 ms.
    Observed,
    /// At rest, not seen.
    Held,
    /// Between two contacts, not seen.
    Bridged,
    /// Unknown: the pose is the last known one and must not be used.
    Lost,
}

impl FootStatus {
    /// All of them.
    pub const ALL: [Self; 4] = [Self::Observed, Self::Held, Self::Bridged, Self::Lost];

    /// As in messages and JSON.
    pub fn name(self) -> &'static str {
        match self {
            Self::Observed => "observed",
            Self::Held => "held",
            Self::Bridged => "bridged",
            Self::Lost => "lost",
        }
    }

    fn code(self) -> u8 {
        match self {
            Self::Observed => 0,
            Self::Held => 1,
            Self::Bridged => 2,
            Self::Lost => 3,
        }
    }
}

/// Pose of a foot at a time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FootPose {
    /// The foot.
    pub foot: Foot,
    /// The time, ns.
    pub time_ns: i64,
    /// Takes points in the frame of the foot to the world, metres.
    pub world_from_foot: RigidTransform,
    /// Takes points in the frame of the foot to the rig's at that time, metres.
    pub rig_from_foot: RigidTransform,
    /// Covariance of a small motion of the foot in its own axes, in the rig.
    pub covariance: Option<Covariance>,
    /// How the pose is known.
    pub status: FootStatus,
}

/// Writes poses of feet from all frames, and those from the frames until then, each sorted by foot
/// and time.
///
/// # Errors
/// [`BundleError::Refused`] if they are not sorted, [`BundleError::Io`].
pub fn write(
    draft: &Draft,
    poses: impl IntoIterator<Item = FootPose>,
    causal: impl IntoIterator<Item = FootPose>,
) -> Result<(), BundleError> {
    write_table(draft, TABLE, poses)?;
    write_table(draft, CAUSAL_TABLE, causal)
}

fn write_table(
    draft: &Draft,
    name: &str,
    poses: impl IntoIterator<Item = FootPose>,
) -> Result<(), BundleError> {
    let mut table = TableWriter::create(draft, name, &COLUMNS)?;
    let mut last = None;
    for pose in poses {
        if let Some(found) = last.and_then(|last| unsorted(&last, &pose)) {
            return Err(refused(draft, name, found, SORTED));
        }
        last = Some(pose);
        table.row(|row| {
            row.u8(foot_code(pose.foot));
            row.i64(pose.time_ns);
            row.f64(&pose.world_from_foot.translation_m());
            row.f64(&pose.world_from_foot.rotation_wxyz());
            row.f64(&pose.covariance.map_or([f64::NAN; 21], |c| upper(&c)));
            row.f64(&pose.rig_from_foot.translation_m());
            row.f64(&pose.rig_from_foot.rotation_wxyz());
            row.u8(pose.status.code());
            row.bool(pose.covariance.is_some());
        })?;
    }
    table.finish()
}

/// Reads poses of feet from all frames, sorted by foot and time.
///
/// # Errors
/// As [`OutputReader::read`]; [`BundleError::Malformed`].
pub fn read(reader: &OutputReader) -> Result<Vec<FootPose>, BundleError> {
    read_table(reader, TABLE)
}

/// Reads poses of feet from the frames until then, sorted by foot and time.
///
/// # Errors
/// As [`OutputReader::read`]; [`BundleError::Malformed`].
pub fn read_causal(reader: &OutputReader) -> Result<Vec<FootPose>, BundleError> {
    read_table(reader, CAUSAL_TABLE)
}

fn read_table(reader: &OutputReader, name: &str) -> Result<Vec<FootPose>, BundleError> {
    let bytes = reader.read(name)?;
    let path = reader.file_path(name);
    let rows = rows(&bytes, &COLUMNS, &path)?.enumerate();
    let poses = rows.map(|(row, fields)| {
        pose(fields).map_err(|(found, expected)| {
            malformed(path.clone(), format!("row {row}"), found, expected)
        })
    });
    let poses: Vec<FootPose> = poses.collect::<Result<_, _>>()?;
    for (row, pair) in (1..).zip(poses.windows(2)) {
        if let Some(found) = unsorted(&pair[0], &pair[1]) {
            return Err(malformed(path, format!("row {row}"), found, SORTED));
        }
    }
    Ok(poses)
}

const SORTED: &str = "poses sorted by foot and time, each once";

/// What is found where a pose does not follow the one before.
fn unsorted(before: &FootPose, pose: &FootPose) -> Option<String> {
    let [before, own] = [before, pose].map(|pose| (pose.foot, pose.time_ns));
    (before >= own).then(|| format!("{before:?} before {own:?}"))
}

/// A row, or what was found and expected.
fn pose(mut fields: Fields<'_>) -> Result<FootPose, (String, &'static str)> {
    let code = fields.u8();
    let foot = foot_of(code).ok_or((format!("foot {code}"), "0 or 1"))?;
    let time_ns = fields.i64();
    let transform = |fields: &mut Fields<'_>| {
        let (position, rotation): ([f64; 3], [f64; 4]) = (fields.f64(), fields.f64());
        RigidTransform::from_wxyz(rotation, position).map_err(|e| (e.to_string(), "a pose"))
    };
    let world_from_foot = transform(&mut fields)?;
    let covariance = fields.f64::<21>();
    let rig_from_foot = transform(&mut fields)?;
    let (code, has_covariance) = (fields.u8(), fields.bool());
    let covariance = has_covariance.then(|| from_upper(&covariance)).transpose();
    let status = FootStatus::ALL.into_iter().find(|s| s.code() == code);
    Ok(FootPose {
        foot,
        time_ns,
        world_from_foot,
        rig_from_foot,
        covariance: covariance.map_err(|e| (e.to_string(), "a covariance"))?,
        status: status.ok_or((format!("status {code}"), "0 to 3"))?,
    })
}
