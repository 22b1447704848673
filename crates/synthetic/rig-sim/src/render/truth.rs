//! Ground truth of a camera's images, as files: pixel layers, and the tags on the shoes.
//!
//! Each layer is a PNG per image under the name of the image, row by row:
//!
//! - `depth`: 16 bits, mm along the optical axis; 0 for the sky and for more than 65.535 m;
//! - `class`: 8 bits, numbers of [`Class`];
//! - `instance`: 16 bits, a number per instance; 0 for the sky;
//! - `flow`: to the next image, as in KITTI (Menze and Geiger 2015): 16 bits red, green, blue; red
//!   is 64 times the displacement to the right in px plus 2^15, green the same downwards, to 1/64
//!   px. Blue is 0 where flow is undefined, 1 where the point is visible in the next image and 2
//!   where it is occluded or outside. The last image has no flow.

use std::fmt::Write as _;
use std::fs;
use std::path::{Path, PathBuf};

use super::{RenderError, at, write, yaml};
use crate::camera::truth::{Flow, Truth};
use crate::faults::CameraFaults;
use crate::png_file;
use crate::scene::surface::Class;
use crate::simulation::{GroundTruth, Simulation};

/// Layers of each eye; the number of the eye follows the name.
const LAYERS: [&str; 4] = ["depth", "class", "instance", "flow"];
const TAGS: &str = "#frame,timestamp [ns],eye,id,visible,u0 [px],v0 [px],u1 [px],v1 [px],\
                    u2 [px],v2 [px],u3 [px],v3 [px],visible share []\n";

/// Writes ground truth of a camera's frames in order.
pub(super) struct TruthFiles<'a> {
    simulation: &'a Simulation,
    ground_truth: GroundTruth<'a>,
    root: PathBuf,
    size: [usize; 2],
    /// Ground truth of the next frame.
    ahead: Option<[Truth; 2]>,
    tags: String,
}

impl<'a> TruthFiles<'a> {
    /// Creates the folders below `root`, a camera's `mav0`.
    pub(super) fn begin(
        simulation: &'a Simulation,
        number: usize,
        faults: &CameraFaults,
        root: &Path,
    ) -> Result<Self, RenderError> {
        let camera = &simulation.cameras()[number];
        for eye in 0..2 {
            for layer in LAYERS {
                let folder = root.join(format!("{layer}{eye}"));
                let data = folder.join("data");
                fs::create_dir_all(&data).map_err(at(&data))?;
                let text = yaml::truth(&camera.name, eye, layer, &meaning(layer));
                write(&folder.join("sensor.yaml"), &text)?;
            }
        }
        Ok(Self {
            simulation,
            ground_truth: simulation.ground_truth(number).with_faults(faults.clone()),
            root: root.to_owned(),
            size: [camera.models[0].width, camera.models[0].height].map(|v| v as usize),
            ahead: None,
            tags: TAGS.to_owned(),
        })
    }

    /// Writes all layers of frame `number`, whose images are named `name`.
    pub(super) fn frame(&mut self, number: u64, name: &str) -> Result<(), RenderError> {
        let settings = self.simulation.settings();
        let (now_ns, next_ns) = (settings.frame_ns(number), settings.frame_ns(number + 1));
        let now = match self.ahead.take() {
            Some(now) => now,
            None => [0, 1].map(|eye| self.ground_truth.render(eye, now_ns)),
        };
        let next = [0, 1].map(|eye| self.ground_truth.render(eye, next_ns));
        for eye in 0..2 {
            let flow = self.ground_truth.flow(eye, &now[eye], &next[eye]);
            self.layers(eye, &now[eye], &flow, name)?;
            for tag in self.ground_truth.tags(eye, &now[eye]) {
                let corners = tag.corners.map(|[u, v]| format!("{u:.4},{v:.4}")).join(",");
                // Writing to a string does not fail.
                let _ = writeln!(
                    self.tags,
                    "{number},{now_ns},{eye},{},{},{corners},{:.3}",
                    tag.id,
                    u8::from(tag.is_visible()),
                    tag.visible_share
                );
            }
        }
        self.ahead = Some(next);
        Ok(())
    }

    fn layers(
        &self,
        eye: usize,
        truth: &Truth,
        flow: &Flow,
        name: &str,
    ) -> Result<(), RenderError> {
        let path = |layer: &str| self.root.join(format!("{layer}{eye}/data")).join(name);
        let file = path("depth");
        let depth = truth.depth.iter().copied().map(millimetres);
        png_file::gray16(&file, self.size, depth).map_err(at(&file))?;
        let file = path("class");
        let class: Vec<u8> = truth.class.iter().map(|&class| class as u8).collect();
        png_file::gray8(&file, self.size, &class).map_err(at(&file))?;
        let file = path("instance");
        let instance = truth.instance.iter().copied();
        png_file::gray16(&file, self.size, instance).map_err(at(&file))?;
        let file = path("flow");
        let flow = flow.flow_px.iter().zip(&flow.shown);
        let flow = flow.map(|(flow_px, shown)| kitti(*flow_px, *shown));
        png_file::rgb16(&file, self.size, flow).map_err(at(&file))
    }

    /// Writes the files that are complete only after the last frame: the `list` of images, and the
    /// tags, beside `mav0`.
    pub(super) fn end(self, list: &str) -> Result<(), RenderError> {
        for eye in 0..2 {
            for layer in LAYERS {
                write(&self.root.join(format!("{layer}{eye}/data.csv")), list)?;
            }
        }
        write(&self.root.with_file_name("tags.csv"), &self.tags)
    }
}

fn meaning(layer: &str) -> String {
    match layer {
        "depth" => "mm along the optical axis, 0 for none or more than 65535".to_owned(),
        "class" => {
            let names = Class::ALL.map(|class| format!("{} {}", class as u8, class.name()));
            names.join(", ")
        }
        "instance" => "a number per thing, 0 sky".to_owned(),
        _ => "64 times the movement to the next image in px plus 32768, right and down; \
              third channel 0 unknown, 1 shown there, 2 hidden there or outside"
            .to_owned(),
    }
}

/// 0 for no surface, or for a depth outside the range of the format.
fn millimetres(depth_m: f32) -> u16 {
    let mm = (f64::from(depth_m) * 1000.0).round();
    match (1.0..=65_535.0).contains(&mm) {
        true => mm as u16,
        false => 0,
    }
}

/// Flow as KITTI writes it; undefined where the format cannot represent it.
fn kitti(flow_px: [f32; 2], shown: bool) -> [u16; 3] {
    let [u, v] = flow_px.map(|px| (f64::from(px) * 64.0).round() + 32_768.0);
    let range = 0.0..=65_535.0;
    match range.contains(&u) && range.contains(&v) {
        true => [u as u16, v as u16, if shown { 1 } else { 2 }],
        false => [0; 3],
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn depth_outside_the_range_is_written_as_0() {
        let cases = [
            (1.2345, 1235),
            (0.0004, 0),
            (65.535, 65_535),
            (65.536, 0),
            (f32::INFINITY, 0),
            (f32::NAN, 0),
            (-1.0, 0),
        ];
        for (depth_m, expected) in cases {
            assert_eq!(millimetres(depth_m), expected, "{depth_m}");
        }
    }

    #[test]
    fn flow_outside_the_range_is_undefined() {
        let cases = [
            ([0.0, 0.0], true, [32_768, 32_768, 1]),
            ([1.5, -0.25], false, [32_864, 32_752, 2]),
            ([-512.0, 511.98], true, [0, 65_535, 1]),
            ([512.1, 0.0], true, [0; 3]),
            ([f32::NAN, f32::NAN], false, [0; 3]),
        ];
        for (flow_px, shown, expected) in cases {
            assert_eq!(kitti(flow_px, shown), expected, "{flow_px:?}");
        }
    }
}
