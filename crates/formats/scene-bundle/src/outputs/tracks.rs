//! Output `tracks`: keyframes of the odometry with their observations, the input of the bundle
//! adjustment.
//!
//! Three tables: `keyframes.npy`, a row per keyframe in order of time with the state of the body;
//! `observations.npy`, feature tracks; `keypoints.npy`, keypoints with descriptors for loop
//! closure. Rows of the latter two are in the order of the keyframes, whose table has the number of
//! rows of each.
//!
//! Contract: written keyframe by keyframe in constant memory; read as a whole.

use cad_transforms::RigidTransform;

use crate::draft::Draft;
use crate::error::BundleError;
use crate::npy::{Column, Kind, TableWriter, rows};
use crate::scene::OutputReader;

/// Maximum number of cameras of a rig.
pub const MAX_CAMERAS: usize = 8;

const KEYFRAMES: &str = "keyframes.npy";
const OBSERVATIONS: &str = "observations.npy";
const KEYPOINTS: &str = "keypoints.npy";

/// Components of the error of a stereo calibration, and of extrinsics.
const STEREO_DIM: usize = 7;
const EXTRINSICS_DIM: usize = 6;

const KEYFRAME_COLUMNS: [Column; 14] = [
    Column("set", Kind::U64, 1),
    Column("time_ns", Kind::I64, 1),
    Column("position_m", Kind::F64, 3),
    Column("rotation_wxyz", Kind::F64, 4),
    Column("velocity_m_s", Kind::F64, 3),
    Column("gyro_bias", Kind::F64, 3),
    Column("accel_bias", Kind::F64, 3),
    Column("gyro_rate", Kind::F64, 3),
    Column("imu_valid", Kind::U8, 1),
    Column("exposure_offset_s", Kind::F64, MAX_CAMERAS),
    Column("stereo_error", Kind::F64, STEREO_DIM * MAX_CAMERAS),
    Column("extrinsics_error", Kind::F64, EXTRINSICS_DIM * MAX_CAMERAS),
    Column("observations", Kind::U64, 1),
    Column("keypoints", Kind::U64, 1),
];
const OBSERVATION_COLUMNS: [Column; 4] = [
    Column("track", Kind::U64, 1),
    Column("camera", Kind::U8, 1),
    Column("left_px", Kind::F32, 2),
    Column("right_px", Kind::F32, 2),
];
const KEYPOINT_COLUMNS: [Column; 4] = [
    Column("camera", Kind::U8, 1),
    Column("left_px", Kind::F32, 2),
    Column("inverse_range", Kind::F32, 1),
    Column("descriptor", Kind::U64, 4),
];

/// One keyframe. The body is the IMU that odometry used, or the rig where it used none.
#[derive(Clone, Debug, PartialEq)]
pub struct TrackedKeyframe {
    /// Number of the frame set, counted from 1 by odometry.
    pub set: u64,
    /// Time of the set, ns.
    pub time_ns: i64,
    /// Pose of the body.
    pub world_from_body: RigidTransform,
    /// Velocity of the body in the world, m/s.
    pub velocity: [f64; 3],
    /// rad/s.
    pub gyro_bias: [f64; 3],
    /// m/s².
    pub accel_bias: [f64; 3],
    /// Angular rate in the body's axes as measured by the gyroscope (bias included), rad/s.
    pub gyro_rate: [f64; 3],
    /// Whether the preintegrated IMU samples since the previous keyframe were accepted.
    pub imu_valid: bool,
    /// Exposure offset of each camera's middle row against the time of the set, s; at most
    /// [`MAX_CAMERAS`] values.
    pub exposure_offset_s: Vec<f64>,
    /// Estimated error of each camera's stereo calibration: rotation of the right eye about its x,
    /// y and z axes, rad; baseline, relative; focal length, relative; principal point along x, in
    /// focal lengths; decentering. At most [`MAX_CAMERAS`] values.
    pub stereo_errors: Vec<[f64; STEREO_DIM]>,
    /// Estimated error of each camera's extrinsics: small motion of its left optical frame in its
    /// own axes, translation m and rotation rad. At most [`MAX_CAMERAS`] values.
    pub extrinsics_errors: Vec<[f64; EXTRINSICS_DIM]>,
    /// Observations of tracked features.
    pub observations: Vec<StereoObservation>,
    /// Keypoints for loop closure.
    pub keypoints: Vec<Keypoint>,
}

/// Observation of a tracked feature in a stereo frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StereoObservation {
    /// Track id, the same in every keyframe.
    pub track: u64,
    /// Index of the camera in the output `rig`.
    pub camera: u8,
    /// Pixel in the left image.
    pub left_px: [f32; 2],
    /// Pixel in the right image; NaN in the file if there is no match.
    pub right_px: Option<[f32; 2]>,
}

/// A keypoint with its descriptor.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Keypoint {
    /// Index of the camera in the output `rig`.
    pub camera: u8,
    /// Pixel in the left image.
    pub left_px: [f32; 2],
    /// Inverse distance from the left optical center, 1/m; 0 if not known.
    pub inverse_range: f32,
    /// Binary descriptor, 256 bits.
    pub descriptor: [u64; 4],
}

/// Writes keyframes one after another.
pub struct TracksWriter {
    keyframes: TableWriter,
    observations: TableWriter,
    keypoints: TableWriter,
}

impl TracksWriter {
    /// Begins the tables.
    ///
    /// # Errors
    /// [`BundleError::Io`].
    pub fn new(draft: &Draft) -> Result<Self, BundleError> {
        Ok(Self {
            keyframes: TableWriter::create(draft, KEYFRAMES, &KEYFRAME_COLUMNS)?,
            observations: TableWriter::create(draft, OBSERVATIONS, &OBSERVATION_COLUMNS)?,
            keypoints: TableWriter::create(draft, KEYPOINTS, &KEYPOINT_COLUMNS)?,
        })
    }

    /// Writes a keyframe.
    ///
    /// # Errors
    /// [`BundleError::Io`].
    ///
    /// # Panics
    /// With more than [`MAX_CAMERAS`] cameras.
    pub fn push(&mut self, keyframe: &TrackedKeyframe) -> Result<(), BundleError> {
        let mut exposure_offset_s = [0.0; MAX_CAMERAS];
        exposure_offset_s[..keyframe.exposure_offset_s.len()]
            .copy_from_slice(&keyframe.exposure_offset_s);
        let mut stereo_error = [0.0; STEREO_DIM * MAX_CAMERAS];
        let errors = keyframe.stereo_errors.as_flattened();
        stereo_error[..errors.len()].copy_from_slice(errors);
        let mut extrinsics_error = [0.0; EXTRINSICS_DIM * MAX_CAMERAS];
        let errors = keyframe.extrinsics_errors.as_flattened();
        extrinsics_error[..errors.len()].copy_from_slice(errors);
        self.keyframes.row(|row| {
            row.u64(keyframe.set);
            row.i64(keyframe.time_ns);
            row.f64(&keyframe.world_from_body.translation_m());
            row.f64(&keyframe.world_from_body.rotation_wxyz());
            row.f64(&keyframe.velocity);
            row.f64(&keyframe.gyro_bias);
            row.f64(&keyframe.accel_bias);
            row.f64(&keyframe.gyro_rate);
            row.u8(u8::from(keyframe.imu_valid));
            row.f64(&exposure_offset_s);
            row.f64(&stereo_error);
            row.f64(&extrinsics_error);
            row.u64(keyframe.observations.len() as u64);
            row.u64(keyframe.keypoints.len() as u64);
        })?;
        for observation in &keyframe.observations {
            self.observations.row(|row| {
                row.u64(observation.track);
                row.u8(observation.camera);
                row.f32(&observation.left_px);
                row.f32(&observation.right_px.unwrap_or([f32::NAN; 2]));
            })?;
        }
        for keypoint in &keyframe.keypoints {
            self.keypoints.row(|row| {
                row.u8(keypoint.camera);
                row.f32(&keypoint.left_px);
                row.f32(&[keypoint.inverse_range]);
                keypoint.descriptor.iter().for_each(|bits| row.u64(*bits));
            })?;
        }
        Ok(())
    }

    /// Ends the tables.
    ///
    /// # Errors
    /// [`BundleError::Io`].
    pub fn finish(self) -> Result<(), BundleError> {
        self.keyframes.finish()?;
        self.observations.finish()?;
        self.keypoints.finish()
    }
}

/// Reads all keyframes of a rig with `cameras` cameras.
///
/// # Errors
/// As [`OutputReader::read`]; [`BundleError::Malformed`].
pub fn read(reader: &OutputReader, cameras: usize) -> Result<Vec<TrackedKeyframe>, BundleError> {
    let [keyframe_bytes, observation_bytes, keypoint_bytes] = [
        reader.read(KEYFRAMES)?,
        reader.read(OBSERVATIONS)?,
        reader.read(KEYPOINTS)?,
    ];
    let paths = [KEYFRAMES, OBSERVATIONS, KEYPOINTS].map(|path| reader.file_path(path));
    let mut observations =
        rows(&observation_bytes, &OBSERVATION_COLUMNS, &paths[1])?.map(|mut fields| {
            let (track, camera) = (fields.u64(), fields.u8());
            let (left_px, right_px) = (fields.f32(), fields.f32());
            StereoObservation {
                track,
                camera,
                left_px,
                right_px: right_px.iter().all(|v| !v.is_nan()).then_some(right_px),
            }
        });
    let mut keypoints = rows(&keypoint_bytes, &KEYPOINT_COLUMNS, &paths[2])?.map(|mut fields| {
        let camera = fields.u8();
        let left_px = fields.f32();
        let [inverse_range] = fields.f32();
        Keypoint {
            camera,
            left_px,
            inverse_range,
            descriptor: std::array::from_fn(|_| fields.u64()),
        }
    });
    let mut keyframes = Vec::new();
    for (row, mut fields) in rows(&keyframe_bytes, &KEYFRAME_COLUMNS, &paths[0])?.enumerate() {
        let malformed = |found: String, expected: &str| BundleError::Malformed {
            path: paths[0].clone(),
            place: format!("row {row}"),
            found,
            expected: expected.to_owned(),
        };
        let (set, time_ns) = (fields.u64(), fields.i64());
        let position: [f64; 3] = fields.f64();
        let rotation: [f64; 4] = fields.f64();
        let world_from_body = RigidTransform::from_wxyz(rotation, position)
            .map_err(|error| malformed(error.to_string(), "a pose"))?;
        let (velocity, gyro_bias) = (fields.f64(), fields.f64());
        let (accel_bias, gyro_rate) = (fields.f64(), fields.f64());
        let imu_valid = fields.u8() != 0;
        let exposure_offset_s: [f64; MAX_CAMERAS] = fields.f64();
        let stereo_error: [f64; STEREO_DIM * MAX_CAMERAS] = fields.f64();
        let (stereo_errors, _) = stereo_error.as_chunks::<STEREO_DIM>();
        let extrinsics_error: [f64; EXTRINSICS_DIM * MAX_CAMERAS] = fields.f64();
        let (extrinsics_errors, _) = extrinsics_error.as_chunks::<EXTRINSICS_DIM>();
        let (observation_count, keypoint_count) = (fields.u64() as usize, fields.u64() as usize);
        let keyframe = TrackedKeyframe {
            set,
            time_ns,
            world_from_body,
            velocity,
            gyro_bias,
            accel_bias,
            gyro_rate,
            imu_valid,
            exposure_offset_s: exposure_offset_s[..cameras.min(MAX_CAMERAS)].to_vec(),
            stereo_errors: stereo_errors[..cameras.min(MAX_CAMERAS)].to_vec(),
            extrinsics_errors: extrinsics_errors[..cameras.min(MAX_CAMERAS)].to_vec(),
            observations: observations.by_ref().take(observation_count).collect(),
            keypoints: keypoints.by_ref().take(keypoint_count).collect(),
        };
        if keyframe.observations.len() != observation_count
            || keyframe.keypoints.len() != keypoint_count
        {
            let found = format!("{observation_count} observations and {keypoint_count} keypoints");
            return Err(malformed(
                found,
                "no more than the remaining rows of the other tables",
            ));
        }
        let of_observations = keyframe.observations.iter().map(|s| s.camera);
        let mut all = of_observations.chain(keyframe.keypoints.iter().map(|m| m.camera));
        if let Some(camera) = all.find(|camera| usize::from(*camera) >= cameras) {
            let found = format!("an observation of camera {camera}");
            return Err(malformed(found, &format!("one of {cameras}, from 0 on")));
        }
        keyframes.push(keyframe);
    }
    for (rest, place) in [
        (observations.count(), &paths[1]),
        (keypoints.count(), &paths[2]),
    ] {
        if rest > 0 {
            return Err(BundleError::Malformed {
                path: place.clone(),
                place: "end".to_owned(),
                found: format!("{rest} rows that belong to no keyframe"),
                expected: "none".to_owned(),
            });
        }
    }
    Ok(keyframes)
}
