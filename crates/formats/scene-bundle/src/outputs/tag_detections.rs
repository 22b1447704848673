//! Output `tag-detections`: `detections.npy`, a row per tag on a shoe in a stereo frame.
//!
//! Contract: rows are sorted by time, camera and tag; no tag is twice in a frame.

use cad_transforms::rig::Foot;
use cad_transforms::{Covariance, RigidTransform};

use super::trajectory::{from_upper, upper};
use super::{malformed, refused};
use crate::draft::Draft;
use crate::error::BundleError;
use crate::npy::{Column, Fields, Kind, TableWriter, rows};
use crate::scene::OutputReader;

const TABLE: &str = "detections.npy";

const COLUMNS: [Column; 15] = [
    Column("time_ns", Kind::I64, 1),
    Column("frame", Kind::U64, 1),
    Column("camera", Kind::U8, 1),
    Column("foot", Kind::U8, 1),
    Column("tag", Kind::U64, 1),
    Column("position_m", Kind::F64, 3),
    Column("rotation_wxyz", Kind::F64, 4),
    Column("covariance", Kind::F64, 21),
    Column("visible_share", Kind::F32, 2),
    Column("rms_levels", Kind::F32, 1),
    Column("wrong_bits", Kind::U8, 1),
    Column("has_second", Kind::Bool, 1),
    Column("second_position_m", Kind::F64, 3),
    Column("second_rotation_wxyz", Kind::F64, 4),
    Column("second_excess_cost", Kind::F32, 1),
];

/// A tag on a shoe in one stereo frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TagDetection {
    /// Time of the frame, ns: the middle of the exposure.
    pub time_ns: i64,
    /// Number of the frame among those of its camera.
    pub frame: u64,
    /// The camera: its index in the output `rig`, from 0.
    pub camera: u8,
    /// The shoe.
    pub foot: Foot,
    /// Number of the tag in its family.
    pub tag: u64,
    /// Takes points in the tag's frame to the rig's at the time of the frame, metres.
    pub rig_from_tag: RigidTransform,
    /// Covariance of a small motion of the tag in its own axes.
    pub covariance: Covariance,
    /// Share of the tag's cells that is visible in the left and the right image; 0 where the image
    /// was not used.
    pub visible_share: [f32; 2],
    /// Root mean square difference of the images from the printed tag, gray levels.
    pub rms_levels: f32,
    /// Bits that contradict the tag's code.
    pub wrong_bits: u8,
    /// A second pose, tilted the other way, that the images hardly contradict more.
    pub second: Option<SecondPose>,
}

/// A second minimum of the fit of a planar tag.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SecondPose {
    /// As that of [`TagDetection`].
    pub rig_from_tag: RigidTransform,
    /// Its cost above that of the first one, in units of the variance of a pixel's noise.
    pub excess_cost: f32,
}

/// Writes detections row by row, in constant memory.
pub struct TagDetectionsWriter<'a> {
    draft: &'a Draft,
    table: TableWriter,
    last: Option<(i64, u8, u64)>,
}

impl<'a> TagDetectionsWriter<'a> {
    /// Begins the file.
    ///
    /// # Errors
    /// As [`Draft::create`].
    pub fn new(draft: &'a Draft) -> Result<Self, BundleError> {
        Ok(Self {
            draft,
            table: TableWriter::create(draft, TABLE, &COLUMNS)?,
            last: None,
        })
    }

    /// Writes the next detection.
    ///
    /// # Errors
    /// [`BundleError::Refused`] if it is not behind the last one by time, camera and tag,
    /// [`BundleError::Io`].
    pub fn push(&mut self, detection: &TagDetection) -> Result<(), BundleError> {
        let key = key(detection);
        if let Some(last) = self.last.filter(|last| *last >= key) {
            let found = format!("a detection at {key:?} behind one at {last:?}");
            let expected = "detections sorted by time, camera and tag, each once";
            return Err(refused(self.draft, TABLE, found, expected));
        }
        self.last = Some(key);
        let second = detection.second;
        let second_pose = second.map_or(RigidTransform::identity(), |second| second.rig_from_tag);
        self.table.row(|row| {
            row.i64(detection.time_ns);
            row.u64(detection.frame);
            row.u8(detection.camera);
            row.u8(foot_code(detection.foot));
            row.u64(detection.tag);
            row.f64(&detection.rig_from_tag.translation_m());
            row.f64(&detection.rig_from_tag.rotation_wxyz());
            row.f64(&upper(&detection.covariance));
            row.f32(&detection.visible_share);
            row.f32(&[detection.rms_levels]);
            row.u8(detection.wrong_bits);
            row.bool(second.is_some());
            row.f64(&second_pose.translation_m());
            row.f64(&second_pose.rotation_wxyz());
            row.f32(&[second.map_or(f32::NAN, |second| second.excess_cost)]);
        })
    }

    /// Ends the file. The draft is not committed by this.
    ///
    /// # Errors
    /// [`BundleError::Io`].
    pub fn finish(self) -> Result<(), BundleError> {
        self.table.finish()
    }
}

fn key(detection: &TagDetection) -> (i64, u8, u64) {
    (detection.time_ns, detection.camera, detection.tag)
}

/// As in `feet` and `contacts`.
pub(super) fn foot_code(foot: Foot) -> u8 {
    match foot {
        Foot::Left => 0,
        Foot::Right => 1,
    }
}

pub(super) fn foot_of(code: u8) -> Option<Foot> {
    Foot::ALL.into_iter().find(|foot| foot_code(*foot) == code)
}

/// Reads detections, sorted by time, camera and tag.
///
/// # Errors
/// As [`OutputReader::read`]; [`BundleError::Malformed`].
pub fn read(reader: &OutputReader) -> Result<Vec<TagDetection>, BundleError> {
    let bytes = reader.read(TABLE)?;
    let path = reader.file_path(TABLE);
    let mut detections: Vec<TagDetection> = Vec::new();
    for (row, fields) in rows(&bytes, &COLUMNS, &path)?.enumerate() {
        let found = detection(fields).map_err(|(found, expected)| {
            malformed(path.clone(), format!("row {row}"), found, expected)
        })?;
        if detections
            .last()
            .is_some_and(|last| key(last) >= key(&found))
        {
            let found = format!("{:?}", key(&found));
            let expected = "a row behind the one before by time, camera and tag";
            return Err(malformed(
                path.clone(),
                format!("row {row}"),
                found,
                expected,
            ));
        }
        detections.push(found);
    }
    Ok(detections)
}

/// A row, or what was found and expected.
fn detection(mut fields: Fields<'_>) -> Result<TagDetection, (String, &'static str)> {
    let (time_ns, frame, camera) = (fields.i64(), fields.u64(), fields.u8());
    let code = fields.u8();
    let foot = foot_of(code).ok_or((format!("foot {code}"), "0 or 1"))?;
    let tag = fields.u64();
    let pose = |fields: &mut Fields<'_>| {
        let (position, rotation): ([f64; 3], [f64; 4]) = (fields.f64(), fields.f64());
        RigidTransform::from_wxyz(rotation, position).map_err(|e| (e.to_string(), "a pose"))
    };
    let rig_from_tag = pose(&mut fields)?;
    let covariance = from_upper(&fields.f64::<21>());
    let covariance = covariance.map_err(|e| (e.to_string(), "a covariance"))?;
    let visible_share = fields.f32();
    let [rms_levels] = fields.f32();
    let wrong_bits = fields.u8();
    let has_second = fields.bool();
    let second_pose = pose(&mut fields)?;
    let [excess_cost] = fields.f32();
    Ok(TagDetection {
        time_ns,
        frame,
        camera,
        foot,
        tag,
        rig_from_tag,
        covariance,
        visible_share,
        rms_levels,
        wrong_bits,
        second: has_second.then_some(SecondPose {
            rig_from_tag: second_pose,
            excess_cost,
        }),
    })
}
