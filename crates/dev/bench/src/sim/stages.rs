//! Time of a stereo frame by stage.

use rig_sim::camera::optics::Conditions;
use rig_sim::camera::sensor::{Exposure, SensorModel};
use rig_sim::camera::{MonoCamera, Quality, Shot, Stage, placed};
use rig_sim::simulation::Simulation;
use serde_json::{Map, Value, json};

use crate::meter::cpu_s;

/// Processor time per stereo frame, ms; a mean over cameras and times.
#[derive(Debug, Default)]
pub(super) struct Stages {
    poses: f64,
    visibility: f64,
    shading: f64,
    developing: f64,
}

impl Stages {
    /// By name.
    pub(super) fn parts(&self) -> [(&'static str, f64); 4] {
        [
            ("poses", self.poses),
            ("visibility", self.visibility),
            ("shading", self.shading),
            ("developing", self.developing),
        ]
    }

    pub(super) fn json(&self) -> Value {
        let parts = self.parts().map(|(name, ms)| (name.to_owned(), json!(ms)));
        Value::Object(Map::from_iter(parts))
    }
}

impl std::fmt::Display for Stages {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let parts = self.parts().map(|(name, ms)| format!("{name} {ms:.2} ms"));
        write!(f, "{}", parts.join(", "))
    }
}

/// Renders images along the walk, at the real-time quality, one after the other, without the
/// wearer.
pub(super) fn measure(simulation: &Simulation, instants: u64) -> Stages {
    let settings = simulation.settings();
    let exposure = Exposure {
        seconds: 4e-4,
        gain: 1.0,
    };
    let (width, height) = (settings.width as usize, settings.height as usize);
    let mut luma = vec![0; width * height];
    let (mut cb, mut cr) = (vec![0; width * height / 4], vec![0; width * height / 4]);
    let placed = placed::placed(simulation.scene());
    let mut sum = Stages::default();
    for camera in simulation.cameras() {
        for k in 0..2 {
            let quality = Quality::FAST;
            let model = &camera.models[k];
            let mut eye = MonoCamera::new(model, camera.shutter, SensorModel::SMALL, quality);
            let pose = |t: f64| camera.world_from_eye(k, &simulation.walker().rig(t), None);
            for instant in 0..instants {
                let part = (instant as f64 + 0.5) / instants as f64;
                let shot = Shot {
                    time_s: part * settings.seconds,
                    exposure,
                    quality,
                    noise: instant,
                };
                let mut last = cpu_s();
                let mut passed = || {
                    let now = cpu_s();
                    1e3 * (now - std::mem::replace(&mut last, now))
                };
                eye.expose_in_stages(simulation.scene(), &placed, &pose, &shot, &mut |stage| {
                    let ms = passed();
                    match stage {
                        Stage::Poses => sum.poses += ms,
                        Stage::Visibility => sum.visibility += ms,
                        Stage::Shading => sum.shading += ms,
                    }
                });
                sum.shading += passed();
                let chroma = [&mut cb[..], &mut cr[..]];
                eye.degrade(
                    simulation.scene(),
                    &pose(shot.time_s),
                    &Conditions::NOMINAL,
                    k as u64,
                );
                eye.develop(&exposure, instant, &mut luma, chroma, width);
                sum.developing += passed();
            }
        }
    }
    let frames = (instants as usize * simulation.cameras().len()) as f64;
    Stages {
        poses: sum.poses / frames,
        visibility: sum.visibility / frames,
        shading: sum.shading / frames,
        developing: sum.developing / frames,
    }
}
