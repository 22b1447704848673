//! Stage `cloud`: colored points of the static scene, and masks of the dynamic parts.
//!
//! Contract: a point is a depth of a keyframe with a small sigma that keyframes of other instants
//! support and hardly any violates as free space ([`free_space`]): dynamic objects, errors of
//! a single view and objects that the user's network classifies as movable are excluded. All points
//! in a voxel become one ([`voxels`]). Surfaces that others see through are dynamic; they are
//! masked ([`dynamic_mask`]). The color is that of the left image; gray images give gray. An image
//! that cannot be read is a loss. Memory is that of the depth of some keyframes and of one entry
//! per voxel of the scene, however long the recording. The result does not depend on the number of
//! threads.

use std::collections::VecDeque;

use camera_models::{Eye, Lens};
use rayon::prelude::*;
use scene_bundle::outputs::depth::DepthIndex;
use scene_bundle::outputs::{self, CLOUD, DEPTH, KEYFRAMES, MASKS, RIG_REFINED, TRAJECTORY};
use serde_json::{Value, json};
use session_input::{Frames, Image, ReadError};

use self::config::CloudConfig;
use self::dynamic_mask::{DynamicMasker, PixelMotion};
use self::free_space::PointMotion;
use self::posed_depth_map::PosedDepthMap;
use self::voxels::{Point, Voxels};
use super::depth_frames::instants;
use super::networks::Networks;
use crate::input::{HANDOFF, Input};
use crate::pipeline::{Stage, StageError, Work};

mod config;
mod dynamic_mask;
mod free_space;
mod posed_depth_map;
mod voxels;

/// See the module.
pub(super) struct CloudStage {
    pub(super) networks: Networks,
}

impl Stage<Input> for CloudStage {
    fn name(&self) -> &'static str {
        "cloud"
    }

    fn version(&self) -> u32 {
        4
    }

    fn inputs(&self) -> &'static [&'static str] {
        &[HANDOFF, RIG_REFINED, TRAJECTORY, KEYFRAMES, DEPTH]
    }

    fn outputs(&self) -> &'static [&'static str] {
        &[CLOUD, MASKS]
    }

    fn settings(&self) -> Value {
        json!({
            "network": self.networks.segmentation_hash(),
            "config": CloudConfig::default(),
        })
    }

    fn run(&self, work: &Work<'_, Input>) -> Result<(), StageError> {
        let config = CloudConfig::default();
        let rig = outputs::rig::read(&work.read(RIG_REFINED)?)?;
        let depth = work.read(DEPTH)?;
        let index = outputs::depth::read_index(&depth)?;
        let trajectory = outputs::trajectory::read(&work.read(TRAJECTORY)?)?;
        let instants = instants(&rig, &index, &work.read(KEYFRAMES)?, &trajectory)?;
        let mut images = Vec::new();
        let mut lenses = Vec::new();
        let mut dynamic = Vec::new();
        for view in &index.views {
            let camera = rig.camera(&view.camera);
            let (_, camera) = camera.ok_or_else(|| ReadError::NoSuch(view.camera.clone()))?;
            lenses.push(Lens::new(&camera.left));
            dynamic.push(DynamicMasker::new(config.masks, view, &camera.left));
            images.push(frames(work.source(), &index, &view.camera)?);
        }
        let all: usize = instants.iter().map(Vec::len).sum();
        let (mut done, mut voxels) = (0, Voxels::new(config.voxel_m));
        // The instants in memory, and the number of instants before them.
        let (mut near, mut first_near): (VecDeque<Vec<PosedDepthMap>>, usize) =
            (VecDeque::new(), 0);
        for (now, frame_set) in instants.iter().enumerate() {
            while first_near + near.len() < instants.len().min(now + config.neighbor_instants + 1) {
                let frame_set = &instants[first_near + near.len()];
                let views = frame_set
                    .par_iter()
                    .map(|depth_frame| PosedDepthMap::read(&depth, &index, depth_frame));
                near.push_back(views.collect::<Result<_, _>>()?);
            }
            while first_near + config.neighbor_instants < now {
                near.pop_front();
                first_near += 1;
            }
            for (place, depth_frame) in frame_set.iter().enumerate() {
                let image = images[depth_frame.key.view].next();
                match image {
                    Some(Ok(view)) => {
                        if view.number != depth_frame.key.frame {
                            let (found, camera) = (view.number, &view.camera);
                            return Err(format!(
                                "found frame {found} of {camera} where {} was expected: its frames are not in the order of \
                                 their frame sets",
                                depth_frame.key.frame
                            )
                            .into());
                        }
                        let movable = self.networks.movable(&view.left)?;
                        let left_image = LeftImage {
                            lens: &lenses[depth_frame.key.view],
                            image: &view.left,
                            movable: movable.as_deref(),
                        };
                        let (points, pixels) =
                            points(&config, &near, (now - first_near, place), &left_image);
                        voxels.add(&points);
                        let dynamic = &mut dynamic[depth_frame.key.view];
                        if let Some(mask) = dynamic.add(&pixels, movable.as_deref()) {
                            let camera = &index.views[depth_frame.key.view].camera;
                            let frame = depth_frame.key.frame;
                            outputs::masks::write_dynamic(work.draft(MASKS), camera, frame, &mask)?;
                        }
                    }
                    Some(Err(loss)) => work.record_loss_from(&loss),
                    None => work.record_loss(format!(
                        "there is no image of frame {}",
                        depth_frame.key.frame
                    )),
                }
                done += 1;
                work.progress(done, all as u64);
            }
        }
        let points = voxels.into_points();
        work.note(format!("{} points", points.len()));
        outputs::cloud::write(work.draft(CLOUD), &points)?;
        for (view, dynamic) in index.views.iter().zip(&dynamic) {
            if let Some(mask) = dynamic.wearer_mask() {
                outputs::masks::write(work.draft(MASKS), &view.camera, Eye::Left, &mask)?;
            }
        }
        Ok(())
    }
}

/// Images of all keyframes of a camera that have depth, in order.
fn frames(input: &Input, index: &DepthIndex, camera: &str) -> Result<Frames, ReadError> {
    let entries = input.index().camera(camera);
    let entries = entries.ok_or_else(|| ReadError::NoSuch(camera.to_owned()))?;
    let keys = index.images.iter();
    let of_camera = keys.filter(|key| index.views[key.view].camera == camera);
    let positions: Vec<usize> = of_camera
        .filter_map(|key| entries.position(key.frame))
        .collect();
    input
        .session()
        .frames_where(camera, |p| positions.binary_search(&p).is_ok())
}

/// Points and motion of each pixel of one view: `near` are the instants around it, `at` is the
/// index of its instant and of the view in it.
fn points(
    config: &CloudConfig,
    near: &VecDeque<Vec<PosedDepthMap>>,
    at: (usize, usize),
    left_image: &LeftImage<'_>,
) -> (Vec<Point>, Vec<PixelMotion>) {
    let view = &near[at.0][at.1];
    let others: Vec<(bool, &PosedDepthMap)> = near
        .iter()
        .enumerate()
        .flat_map(|(k, views)| views.iter().map(move |view| (k != at.0, view)))
        .filter(|(_, other)| !std::ptr::eq(*other, view))
        .filter(|(_, other)| view.may_share(other))
        .collect();
    let pixel = |column: u32, row: u32| {
        let Some(surface) = view.surface(column, row, config.max_motion_sigma_m) else {
            return (None, PixelMotion::Unknown);
        };
        let motion = surface.classify(&config.votes, &others);
        let pixel = PixelMotion::of(
            &config.masks,
            motion == PointMotion::Dynamic,
            surface.depth_m,
        );
        if motion != PointMotion::Static || surface.sigma_m > config.max_point_sigma_m {
            return (None, pixel);
        }
        let color = left_image.color(view.ray_in_left(column, row));
        let point = color.map(|color| Point {
            x_in_world: surface.x_in_world,
            sigma_m: surface.sigma_m,
            color,
        });
        (point, pixel)
    };
    let rows = (0..view.height()).into_par_iter();
    let all = rows.flat_map_iter(|row| (0..view.width()).map(move |column| (column, row)));
    let (points, pixels): (Vec<Option<Point>>, Vec<PixelMotion>) =
        all.map(|(column, row)| pixel(column, row)).unzip();
    (points.into_iter().flatten().collect(), pixels)
}

/// A left image as recorded.
struct LeftImage<'a> {
    lens: &'a Lens,
    image: &'a Image,
    /// Movable pixels according to the network, if there is one.
    movable: Option<&'a [bool]>,
}

impl LeftImage<'_> {
    /// Color of the pixel nearest to the projection of a ray, unless the network classifies it as
    /// movable.
    fn color(&self, ray: [f64; 3]) -> Option<[u8; 3]> {
        let [x, y] = self.lens.project(ray)?;
        let image = self.image;
        let inside = |c: f64, size: u32| (c > -0.5 && c < f64::from(size) - 0.5).then(|| c.round());
        let (x, y) = (inside(x, image.width)?, inside(y, image.height)?);
        let pixel = y as usize * image.width as usize + x as usize;
        if self.movable.is_some_and(|movable| movable[pixel]) {
            return None;
        }
        let channels = image.color.channels();
        match image.data.get(channels * pixel..channels * (pixel + 1))? {
            [gray] => Some([*gray; 3]),
            [red, green, blue] => Some([*red, *green, *blue]),
            _ => None,
        }
    }
}

#[cfg(test)]
mod tests;
