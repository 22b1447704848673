//! Pixels of depth maps that show the wearer's shoes and legs, by the tags on the shoes.
//!
//! A shoe at rest is no dynamic area: several keyframes agree on it, and without this its surface
//! would remain as a bump where it stood.

use cad_transforms::RigidTransform;
use scene_bundle::outputs::depth::DepthView;
use scene_bundle::outputs::rig::{RigModel, RigShoe};
use scene_bundle::outputs::tag_detections::TagDetection;
use terrain::PixelClass;

use super::config::TerrainConfig;
use crate::pipeline::stages::depth_frames::DepthFrame;

/// Maximum time between a depth map and a detection of the same set, ns: a foot moves by less than
/// the margin relative to the rig.
const SAME_SET_NS: i64 = 10_000_000;
/// Half of the size of a sole without outline, m.
const USUAL_HALF_M: [f64; 2] = [0.15, 0.05];

/// Shoes by the time at which a frame shows their tag.
pub(super) struct Shoes<'a> {
    rig: &'a RigModel,
    /// Sorted by time.
    detections: &'a [TagDetection],
    config: TerrainConfig,
}

/// A box in the frame of a foot.
struct ShoeBox {
    foot_from_view: RigidTransform,
    low: [f64; 3],
    high: [f64; 3],
}

impl<'a> Shoes<'a> {
    pub(super) fn new(
        rig: &'a RigModel,
        detections: &'a [TagDetection],
        config: TerrainConfig,
    ) -> Self {
        Self {
            rig,
            detections,
            config,
        }
    }

    /// Excludes the pixels of a depth map (m, row-major) that show a shoe or a leg.
    pub(super) fn exclude(
        &self,
        view: &DepthView,
        frame: &DepthFrame,
        depth_m: &[f32],
        classes: &mut [PixelClass],
    ) {
        let boxes: Vec<ShoeBox> = self.boxes(view, frame);
        if boxes.is_empty() {
            return;
        }
        let model = &view.model;
        let columns = model.width as usize;
        for (number, (class, depth)) in classes.iter_mut().zip(depth_m).enumerate() {
            let depth = f64::from(*depth);
            if depth <= 0.0 {
                continue;
            }
            let [x, y] = [number % columns, number / columns].map(|v| v as f64);
            let point = [
                (x - model.cx) / model.fx * depth,
                (y - model.cy) / model.fy * depth,
                depth,
            ];
            if boxes.iter().any(|shoe| shoe.contains(point)) {
                *class = PixelClass::Excluded;
            }
        }
    }

    fn boxes(&self, view: &DepthView, frame: &DepthFrame) -> Vec<ShoeBox> {
        let Some((_, camera)) = self.rig.camera(&view.camera) else {
            return Vec::new();
        };
        let view_from_rig = view.view_from_left * camera.rig_from_left.inverse();
        let time_ns = frame.key.time_ns;
        let times = time_ns - SAME_SET_NS..=time_ns + SAME_SET_NS;
        let first = self
            .detections
            .partition_point(|own| own.time_ns < *times.start());
        let near = self.detections[first..].iter();
        let near = near.take_while(|own| own.time_ns <= *times.end());
        let up_in_view = frame.world_from_view.inverse().rotate([0.0, 0.0, 1.0]);
        near.filter_map(|own| {
            let shoe = self.rig.shoes.iter().find(|shoe| shoe.foot == own.foot)?;
            let tag = shoe.tags.iter().find(|tag| u64::from(tag.id) == own.tag)?;
            let view_from_foot = |rig_from_tag: &RigidTransform| {
                view_from_rig * *rig_from_tag * tag.foot_from_tag.inverse()
            };
            // Of the two poses that the image hardly tells apart, that with the more level sole.
            let level = |view_from_foot: &RigidTransform| {
                let normal = view_from_foot.rotate([0.0, 0.0, 1.0]);
                (0..3).map(|k| normal[k] * up_in_view[k]).sum::<f64>()
            };
            let second = own.second.map(|second| second.rig_from_tag);
            let poses = [Some(own.rig_from_tag), second].into_iter().flatten();
            let poses = poses.map(|pose| view_from_foot(&pose));
            let pose = poses.max_by(|a, b| level(a).total_cmp(&level(b)))?;
            Some(shoe_box(shoe, pose.inverse(), &self.config))
        })
        .collect()
    }
}

fn shoe_box(shoe: &RigShoe, foot_from_view: RigidTransform, config: &TerrainConfig) -> ShoeBox {
    let end = |k: usize, start: f64, pick: fn(f64, f64) -> f64| {
        let ends = shoe.outline_m.iter().map(|corner| corner[k]);
        ends.fold(start, pick)
    };
    let is_known = !shoe.outline_m.is_empty();
    let range = [0, 1].map(|k| match is_known {
        true => [
            end(k, f64::INFINITY, f64::min),
            end(k, f64::NEG_INFINITY, f64::max),
        ],
        false => [-USUAL_HALF_M[k], USUAL_HALF_M[k]],
    });
    ShoeBox {
        foot_from_view,
        low: [
            range[0][0] - config.shoe_margin_m,
            range[1][0] - config.shoe_margin_m,
            config.shoe_low_m,
        ],
        high: [
            range[0][1] + config.shoe_margin_m,
            range[1][1] + config.shoe_margin_m,
            config.shoe_high_m,
        ],
    }
}

impl ShoeBox {
    fn contains(&self, point: [f64; 3]) -> bool {
        let own = self.foot_from_view.apply(point);
        (0..3).all(|k| (self.low[k]..=self.high[k]).contains(&own[k]))
    }
}

#[cfg(test)]
mod tests;
