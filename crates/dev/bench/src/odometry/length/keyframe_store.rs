//! Keyframes on disk, as output by the odometry: in the process their memory would be attributed to
//! the odometry. Not as `tracks` of a scene bundle: those are read as a whole, which would count as
//! memory of adjusting the first minutes.

use std::fs::File;
use std::io::{BufReader, BufWriter, Read, Seek as _, Write};

use ::odometry::Keyframe;
use ::odometry::keyframe::{BodyState, Keypoint, StereoObservation};
use anyhow::{Context, Result};
use nalgebra::{Quaternion, UnitQuaternion, Vector3};

/// All keyframes so far.
pub(super) struct KeyframeStore {
    file: BufWriter<File>,
    count: usize,
}

impl KeyframeStore {
    /// Empty, in an unnamed temporary file.
    ///
    /// # Errors
    /// Any I/O error.
    pub(super) fn new() -> Result<Self> {
        let file = tempfile::tempfile().context("making a file for keyframes")?;
        Ok(Self {
            file: BufWriter::new(file),
            count: 0,
        })
    }

    pub(super) fn len(&self) -> usize {
        self.count
    }

    /// # Errors
    /// Any I/O error.
    pub(super) fn push(&mut self, keyframe: &Keyframe) -> Result<()> {
        self.count += 1;
        write(&mut self.file, keyframe).context("writing a keyframe")
    }

    /// Iterates from the first keyframe; nothing can be added afterwards.
    ///
    /// # Errors
    /// Any I/O error.
    pub(super) fn iter(&mut self) -> Result<impl Iterator<Item = Result<Keyframe>>> {
        self.file.flush()?;
        let mut file = self.file.get_ref().try_clone()?;
        file.rewind()?;
        let mut file = BufReader::new(file);
        let read = move |_| read(&mut file).context("reading a keyframe");
        Ok((0..self.count).map(read))
    }
}

fn write(to: &mut impl Write, keyframe: &Keyframe) -> std::io::Result<()> {
    let state = &keyframe.state;
    to.write_all(&keyframe.number.to_le_bytes())?;
    to.write_all(&state.time_ns.to_le_bytes())?;
    let q = state.rotation.coords;
    let numbers = (state.position.iter())
        .chain(q.iter())
        .chain(&state.velocity)
        .chain(&state.gyro_bias)
        .chain(&state.accel_bias)
        .chain(&state.gyro_rate);
    for number in numbers {
        to.write_all(&number.to_le_bytes())?;
    }
    to.write_all(&[u8::from(keyframe.imu_valid)])?;
    for count in [
        keyframe.exposure_offset_s.len(),
        keyframe.observations.len(),
        keyframe.keypoints.len(),
    ] {
        to.write_all(&(count as u32).to_le_bytes())?;
    }
    let stereo = keyframe.stereo_errors.as_flattened();
    let extrinsics = keyframe.extrinsics_errors.as_flattened();
    for number in (keyframe.exposure_offset_s.iter())
        .chain(stereo)
        .chain(extrinsics)
    {
        to.write_all(&number.to_le_bytes())?;
    }
    for observation in &keyframe.observations {
        to.write_all(&observation.id.to_le_bytes())?;
        to.write_all(&[observation.camera, u8::from(observation.right.is_some())])?;
        for number in observation
            .left
            .into_iter()
            .chain(observation.right.unwrap_or_default())
        {
            to.write_all(&number.to_le_bytes())?;
        }
    }
    for keypoint in &keyframe.keypoints {
        to.write_all(&[keypoint.camera])?;
        for number in [keypoint.left[0], keypoint.left[1], keypoint.rho] {
            to.write_all(&number.to_le_bytes())?;
        }
        for word in keypoint.descriptor {
            to.write_all(&word.to_le_bytes())?;
        }
    }
    Ok(())
}

fn read(from: &mut impl Read) -> std::io::Result<Keyframe> {
    let number = u64::from_le_bytes(bytes(from)?);
    let time_ns = i64::from_le_bytes(bytes(from)?);
    let mut numbers = [0.0; 19];
    for number in &mut numbers {
        *number = f64::from_le_bytes(bytes(from)?);
    }
    let vector = |at: usize| Vector3::new(numbers[at], numbers[at + 1], numbers[at + 2]);
    let [x, y, z, w] = [3, 4, 5, 6].map(|k| numbers[k]);
    let state = BodyState {
        time_ns,
        position: vector(0),
        rotation: UnitQuaternion::new_unchecked(Quaternion::new(w, x, y, z)),
        velocity: vector(7),
        gyro_bias: vector(10),
        accel_bias: vector(13),
        gyro_rate: vector(16),
    };
    let [imu_valid] = bytes(from)?;
    let mut counts = [0; 3];
    for count in &mut counts {
        *count = u32::from_le_bytes(bytes(from)?);
    }
    let pixel =
        |from: &mut dyn Read| -> std::io::Result<f32> { Ok(f32::from_le_bytes(bytes(from)?)) };
    let exposure_offset_s = (0..counts[0])
        .map(|_| Ok(f64::from_le_bytes(bytes(from)?)))
        .collect::<std::io::Result<_>>()?;
    let stereo_errors = errors(from, counts[0])?;
    let extrinsics_errors = errors(from, counts[0])?;
    let observations = (0..counts[1])
        .map(|_| {
            let id = u64::from_le_bytes(bytes(from)?);
            let [camera, has_right] = bytes(from)?;
            let left = [pixel(from)?, pixel(from)?];
            let right = [pixel(from)?, pixel(from)?];
            Ok(StereoObservation {
                id,
                camera,
                left,
                right: (has_right == 1).then_some(right),
            })
        })
        .collect::<std::io::Result<_>>()?;
    let keypoints = (0..counts[2])
        .map(|_| {
            let [camera] = bytes(from)?;
            let left = [pixel(from)?, pixel(from)?];
            let rho = pixel(from)?;
            let mut descriptor = [0; 4];
            for word in &mut descriptor {
                *word = u64::from_le_bytes(bytes(from)?);
            }
            Ok(Keypoint {
                camera,
                left,
                rho,
                descriptor,
            })
        })
        .collect::<std::io::Result<_>>()?;
    Ok(Keyframe {
        number,
        state,
        imu_valid: imu_valid == 1,
        exposure_offset_s,
        stereo_errors,
        extrinsics_errors,
        observations,
        keypoints,
    })
}

/// Errors of calibrations with `N` components, one per camera.
fn errors<const N: usize>(from: &mut impl Read, cameras: u32) -> std::io::Result<Vec<[f64; N]>> {
    let error = |_| {
        let mut error = [0.0; N];
        for number in &mut error {
            *number = f64::from_le_bytes(bytes(from)?);
        }
        Ok(error)
    };
    (0..cameras).map(error).collect()
}

fn bytes<const N: usize>(from: &mut (impl Read + ?Sized)) -> std::io::Result<[u8; N]> {
    let mut bytes = [0; N];
    from.read_exact(&mut bytes)?;
    Ok(bytes)
}
