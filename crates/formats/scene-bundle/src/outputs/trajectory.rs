//! Outputs `trajectory`, `trajectory-causal` and `trajectory-odom`: `trajectory.npy`, a row per
//! pose, and `spans.json`, the runs of equal status.

use cad_transforms::{Covariance, CovarianceError, RigidTransform};
use serde::{Deserialize, Serialize};

use super::{read_json, write_json};
use crate::draft::Draft;
use crate::error::BundleError;
use crate::npy::{Column, Fields, Kind, TableWriter, rows};
use crate::scene::OutputReader;
use crate::trajectory::{Pose, Span, Status, Trajectory, append_span, check};

const TABLE: &str = "trajectory.npy";
const SPANS: &str = "spans.json";

const COLUMNS: [Column; 8] = [
    Column("time_ns", Kind::I64, 1),
    Column("position_m", Kind::F64, 3),
    Column("rotation_wxyz", Kind::F64, 4),
    Column("velocity_m_s", Kind::F64, 3),
    Column("covariance", Kind::F64, 21),
    Column("status", Kind::U8, 1),
    Column("has_velocity", Kind::Bool, 1),
    Column("has_covariance", Kind::Bool, 1),
];

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Spans {
    spans: Vec<Span>,
}

/// Writes a trajectory pose by pose, in constant memory but for the spans.
pub struct TrajectoryWriter<'a> {
    draft: &'a Draft,
    table: TableWriter,
    spans: Vec<Span>,
    count: usize,
}

impl<'a> TrajectoryWriter<'a> {
    /// Begins the files.
    ///
    /// # Errors
    /// As [`Draft::create`].
    pub fn new(draft: &'a Draft) -> Result<Self, BundleError> {
        Ok(Self {
            draft,
            table: TableWriter::create(draft, TABLE, &COLUMNS)?,
            spans: Vec::new(),
            count: 0,
        })
    }

    /// Writes the next pose.
    ///
    /// # Errors
    /// [`BundleError::Refused`] if its time is not later than the last one's or its velocity is not
    /// finite, [`BundleError::Io`].
    pub fn push(&mut self, pose: &Pose) -> Result<(), BundleError> {
        let before_ns = self.spans.last().map(|span| span.to_ns);
        check(self.count, pose, before_ns).map_err(|e| BundleError::Refused {
            path: self.draft.file_path(TABLE),
            found: format!("poses where {e}"),
            expected: "a trajectory".to_owned(),
        })?;
        self.table.row(|row| {
            row.i64(pose.time_ns);
            row.f64(&pose.world_from_rig.translation_m());
            row.f64(&pose.world_from_rig.rotation_wxyz());
            row.f64(&pose.velocity_in_world.unwrap_or([f64::NAN; 3]));
            row.f64(&pose.covariance.map_or([f64::NAN; 21], |c| upper(&c)));
            row.u8(pose.status.code());
            row.bool(pose.velocity_in_world.is_some());
            row.bool(pose.covariance.is_some());
        })?;
        append_span(&mut self.spans, self.count, pose);
        self.count += 1;
        Ok(())
    }

    /// Ends the files. The draft is not committed by this.
    ///
    /// # Errors
    /// [`BundleError::Io`].
    pub fn finish(self) -> Result<(), BundleError> {
        self.table.finish()?;
        write_json(self.draft, SPANS, &Spans { spans: self.spans })
    }
}

/// Writes a whole trajectory.
///
/// # Errors
/// As [`TrajectoryWriter`].
///
/// ```
/// use cad_transforms::RigidTransform;
/// use scene_bundle::{Bundle, Pose, Trajectory, outputs};
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
///
/// let walk = (0..5).map(|i| Pose::new(i * 33_333_333, RigidTransform::identity()));
/// let walk = Trajectory::new(walk.collect())?;
/// let draft = bundle.begin(outputs::TRAJECTORY)?;
/// outputs::trajectory::write(&draft, &walk)?;
/// draft.commit(record)?;
///
/// let reader = bundle.scene().output(outputs::TRAJECTORY)?;
/// assert_eq!(outputs::trajectory::read(&reader)?, walk);
/// assert_eq!(outputs::trajectory::read_spans(&reader)?, walk.spans());
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub fn write(draft: &Draft, trajectory: &Trajectory) -> Result<(), BundleError> {
    let mut writer = TrajectoryWriter::new(draft)?;
    for pose in trajectory.poses() {
        writer.push(pose)?;
    }
    writer.finish()
}

/// Reads a trajectory.
///
/// # Errors
/// As [`OutputReader::read`]; [`BundleError::Malformed`].
pub fn read(reader: &OutputReader) -> Result<Trajectory, BundleError> {
    let bytes = reader.read(TABLE)?;
    let place = reader.file_path(TABLE);
    let wrong = |row: usize, error: String| BundleError::Malformed {
        path: place.clone(),
        place: format!("row {row}"),
        found: error,
        expected: "a pose".to_owned(),
    };
    let mut trajectory = Trajectory::default();
    for (row, fields) in rows(&bytes, &COLUMNS, &place)?.enumerate() {
        let pose = pose(fields).map_err(|error| wrong(row, error))?;
        trajectory
            .push(pose)
            .map_err(|error| wrong(row, error.to_string()))?;
    }
    Ok(trajectory)
}

/// Reads the runs of equal status alone.
///
/// # Errors
/// As [`read`].
pub fn read_spans(reader: &OutputReader) -> Result<Vec<Span>, BundleError> {
    read_json::<Spans>(reader, SPANS).map(|s| s.spans)
}

fn pose(mut fields: Fields<'_>) -> Result<Pose, String> {
    let time_ns = fields.i64();
    let position: [f64; 3] = fields.f64();
    let rotation: [f64; 4] = fields.f64();
    let velocity: [f64; 3] = fields.f64();
    let covariance: [f64; 21] = fields.f64();
    let status = fields.u8();
    let (has_velocity, has_covariance) = (fields.bool(), fields.bool());
    let covariance = has_covariance.then(|| from_upper(&covariance));
    Ok(Pose {
        time_ns,
        world_from_rig: RigidTransform::from_wxyz(rotation, position).map_err(|e| e.to_string())?,
        covariance: covariance.transpose().map_err(|e| e.to_string())?,
        velocity_in_world: has_velocity.then_some(velocity),
        status: Status::from_code(status).ok_or_else(|| format!("status {status}"))?,
    })
}

/// The upper triangle, rows first.
pub(super) fn upper(covariance: &Covariance) -> [f64; 21] {
    let rows = covariance.rows();
    let mut places = (0..6).flat_map(|i| (i..6).map(move |j| (i, j)));
    std::array::from_fn(|_| places.next().map_or(f64::NAN, |(i, j)| rows[i][j]))
}

/// Of an upper triangle, rows first.
pub(super) fn from_upper(upper: &[f64; 21]) -> Result<Covariance, CovarianceError> {
    let mut rows = [[0.0; 6]; 6];
    let places = (0..6).flat_map(|i| (i..6).map(move |j| (i, j)));
    for ((i, j), value) in places.zip(upper) {
        (rows[i][j], rows[j][i]) = (*value, *value);
    }
    Covariance::from_rows(rows)
}
