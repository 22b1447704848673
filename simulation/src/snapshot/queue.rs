//! Frames of a camera with a timing as bytes.
//!
//! Numbers and times of the frames follow from the number of steps and are not stored.

use cad_transforms::RigidTransform;

use super::bytes::{Reader, Writer, damaged};
use super::fields;
use crate::SimulationError;
use crate::camera::{CameraView, Capture, FrameQueue};
use crate::world::episode::Episode;
use crate::world::frames;
use crate::world::shared::Shared;

pub(super) fn write(writer: &mut Writer, queue: &FrameQueue) {
    write_view(writer, &queue.camera);
    writer.u64(queue.current.number);
    for frame in std::iter::once(&queue.current).chain(&queue.in_transit) {
        write_view(
            writer,
            &CameraView {
                sector: frame.sector,
                world_from_camera: frame.world_from_camera,
            },
        );
        for value in frame.velocity_m_s.into_iter().chain(frame.rate_rad_s) {
            writer.f64(value);
        }
    }
}

/// The frames of an episode that began; `None` where each step has the frame of its end.
pub(super) fn read(
    reader: &mut Reader<'_>,
    shared: &Shared,
    episode: &Episode,
) -> Result<Option<FrameQueue>, SimulationError> {
    let Some(schedule) = frames::schedule(shared, episode.seed, episode.number) else {
        return Ok(None);
    };
    let sectors = shared.terrains.len();
    let camera = read_view(reader, sectors)?;
    let current = reader.u64()?;
    let queue =
        FrameQueue::after_steps(schedule, &camera, [episode.steps, current], shared.step_ns);
    let mut queue = queue.ok_or_else(|| damaged(&format!("frame {current}")))?;
    let read = |frame: &mut Capture| {
        let view = read_view(reader, sectors)?;
        *frame = Capture {
            sector: view.sector,
            world_from_camera: view.world_from_camera,
            velocity_m_s: fields::three(reader)?,
            rate_rad_s: fields::three(reader)?,
            ..*frame
        };
        Ok::<(), SimulationError>(())
    };
    std::iter::once(&mut queue.current)
        .chain(&mut queue.in_transit)
        .try_for_each(read)?;
    Ok(Some(queue))
}

fn write_view(writer: &mut Writer, view: &CameraView) {
    writer.u32(view.sector as u32);
    for value in view.world_from_camera.rotation_wxyz() {
        writer.f64(value);
    }
    for value in view.world_from_camera.translation_m() {
        writer.f64(value);
    }
}

fn read_view(reader: &mut Reader<'_>, sectors: usize) -> Result<CameraView, SimulationError> {
    let sector = reader.u32()? as usize;
    if sector >= sectors {
        return Err(damaged(&format!("sector {sector} of a frame")));
    }
    let rotation = [reader.f64()?, reader.f64()?, reader.f64()?, reader.f64()?];
    let pose = RigidTransform::from_wxyz(rotation, fields::three(reader)?);
    let world_from_camera = pose.map_err(|error| damaged(&format!("a pose: {error}")))?;
    Ok(CameraView {
        sector,
        world_from_camera,
    })
}
