//! Cameras of the rig that recorded, on agents.

use cad_transforms::RigidTransform;

use super::CameraConfig;
use crate::agent::{AgentConfig, Playback};
use crate::error::SimulationError;
use crate::ground::Ground;
use crate::scene::{RecordingCamera, Sector};

impl CameraConfig {
    /// A camera of the rig that recorded a sector, by its name, with images of another size: see
    /// [`Self::of_recording`]. A missing edge keeps the shape of the image, both its size. The
    /// mount is that in the rig: see [`Self::recorded_mount`].
    ///
    /// # Errors
    /// [`SimulationError::Setting`] for a camera that did not record and an empty image.
    pub fn recorded(
        sector: &Sector,
        name: &str,
        size: [Option<u32>; 2],
    ) -> Result<Self, SimulationError> {
        let camera = camera(sector, name)?;
        let recorded = [camera.model.width, camera.model.height];
        let scaled = |edge: u32, other: u32, to: u32| {
            let length = f64::from(edge) * f64::from(to) / f64::from(other);
            (length.round() as u32).max(1)
        };
        let size = match size {
            [Some(width), Some(height)] => [width, height],
            [Some(width), None] => [width, scaled(recorded[1], recorded[0], width)],
            [None, Some(height)] => [scaled(recorded[0], recorded[1], height), height],
            [None, None] => recorded,
        };
        Self::of_recording(camera, size)
    }

    /// The mount `body_from_camera` of a recorded camera on an agent that stands level below the
    /// rig, where the wearer had it: height and tilt of the rig are medians over the walk.
    ///
    /// # Errors
    /// [`SimulationError::Setting`] for a camera that did not record, [`SimulationError::Scene`]
    /// without a trajectory above known ground.
    pub fn recorded_mount(sector: &Sector, name: &str) -> Result<RigidTransform, SimulationError> {
        let camera = camera(sector, name)?;
        let agent = AgentConfig::default();
        let ground = match &sector.levels {
            Some(levels) => Some(Ground::new(levels.to_vec(), &agent)?),
            None => None,
        };
        let body_from_rig = Playback::of(&sector.recording)
            .zip(ground)
            .and_then(|(wearer, ground)| wearer.body_from_rig(&ground, &agent));
        match body_from_rig {
            Some(body_from_rig) => Ok(body_from_rig * camera.rig_from_camera),
            None => Err(SimulationError::Scene {
                place: format!("sector {}", sector.name),
                found: "no height of the rig above ground".to_owned(),
                expected: "outputs trajectory and maps, from which mounts are measured".to_owned(),
            }),
        }
    }
}

fn camera<'a>(sector: &'a Sector, name: &str) -> Result<&'a RecordingCamera, SimulationError> {
    let cameras = &sector.recording.cameras;
    let found = cameras.iter().find(|camera| camera.name == name);
    found.ok_or_else(|| {
        let names: Vec<&str> = cameras.iter().map(|camera| camera.name.as_str()).collect();
        SimulationError::Setting {
            name: "camera.recorded".to_owned(),
            found: format!("{name:?}"),
            expected: match names.is_empty() {
                true => "no camera: the scene has no output rig".to_owned(),
                false => format!("one of {}", names.join(", ")),
            },
        }
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::SyntheticScene;

    #[test]
    fn a_missing_edge_keeps_the_shape() {
        let room = SyntheticScene::room().unwrap().scene;
        let sector = &room.sectors[0];
        let size = |size| {
            let config = CameraConfig::recorded(sector, "front/left", size).unwrap();
            [config.model.width, config.model.height]
        };
        assert_eq!(size([None, None]), [320, 180]);
        assert_eq!(size([Some(80), None]), [80, 45]);
        assert_eq!(size([None, Some(90)]), [160, 90]);
        assert_eq!(size([Some(64), Some(64)]), [64, 64]);
        let error = CameraConfig::recorded(sector, "feet/left", [None; 2]).unwrap_err();
        assert!(error.to_string().contains("one of front/left"), "{error}");
    }

    #[test]
    fn on_an_agent_below_the_rig_the_camera_is_where_it_recorded() {
        let room = SyntheticScene::room().unwrap().scene;
        let sector = &room.sectors[0];
        let mount = CameraConfig::recorded_mount(sector, "front/left").unwrap();
        let pose = &sector.recording.trajectory.as_ref().unwrap().poses()[7];
        let [x, y, _] = pose.world_from_rig.translation_m();
        let below = crate::AgentState {
            position_m: [x, y, 0.0],
            ..crate::AgentState::default()
        };
        let difference = sector.references[7].inverse() * below.world_from_body() * mount;
        assert!(difference.distance_m() < 1e-6 && difference.angle_rad() < 1e-9);
        let mut blind = sector.clone();
        blind.levels = None;
        let error = CameraConfig::recorded_mount(&blind, "front/left").unwrap_err();
        assert!(error.to_string().contains("maps"), "{error}");
    }
}
