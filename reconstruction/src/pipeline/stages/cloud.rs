//! Stage `cloud`: coloured points of what stood still, and masks of what did not.
//!
//! Contract: a point is where the depth of a keyframe says that something is, if it says so closely enough, keyframes of other
//! instants say the same, and hardly any sees what is behind it ([`look`]): what moved is not there, nor what one view alone makes
//! up, nor what a network of the user's says can move. All that is in a voxel becomes one point ([`voxels`]). What others see through moves; it is masked ([`moving`]). Colour is that of the left picture; grey pictures give grey.
//! A picture that cannot be read is a loss. Memory is that of the depth of some keyframes and of a line per voxel of the scene,
//! however long somebody walked about in it. Any number of threads gives the same.

use std::collections::{BTreeMap, VecDeque};

use calib::{Eye, Lens};
use rayon::prelude::*;
use scene_bundle::outputs::depth::DepthIndex;
use scene_bundle::outputs::rig::RigModel;
use scene_bundle::outputs::{self, CLOUD, DEPTH, KEYFRAMES, MASKS, RIG_ADJUSTED, TRAJECTORY};
use scene_bundle::{OutputReader, Trajectory};
use serde_json::{Value, json};

use self::look::{Look, Shot, Verdict};
use self::moving::{Moving, Pixel};
use self::sway::Sway;
use self::voxels::{Point, Voxels};
use super::HANDOFF;
use super::networks::Networks;
use crate::input::{Frames, Input, ReadError};
use crate::picture::Picture;
use crate::pipeline::{Stage, StageError, Work};

mod look;
mod moving;
mod sway;
mod voxels;

/// See the module.
pub(super) struct CloudStage {
    pub(super) networks: Networks,
}

/// So many instants before and behind that of a keyframe are asked whether they see the same: as far as people see ahead on a
/// walk, and as much as is held in memory.
const REACH: usize = 4;
/// A depth that is more uncertain makes no point, m. Half a metre would fill streets with fog.
const LARGEST_SIGMA_M: f64 = 0.15;
/// Nor is anything known of whether it moves from here on, m.
const MOVING_SIGMA_M: f64 = 0.5;

impl Stage<Input> for CloudStage {
    fn name(&self) -> &'static str {
        "cloud"
    }

    fn version(&self) -> u32 {
        3
    }

    fn inputs(&self) -> &'static [&'static str] {
        &[HANDOFF, RIG_ADJUSTED, TRAJECTORY, KEYFRAMES, DEPTH]
    }

    fn outputs(&self) -> &'static [&'static str] {
        &[CLOUD, MASKS]
    }

    fn settings(&self) -> Value {
        json!({
            "network": self.networks.segmentation_hash(),
            "reach": REACH,
            "largest_sigma_m": LARGEST_SIGMA_M,
            "agree_sigma": look::AGREE_SIGMA,
            "moving_sigma_m": MOVING_SIGMA_M,
            "wearer_share": moving::WEARER_SHARE,
            "wearer_least_looks": moving::LEAST_LOOKS,
            "through_sigma": look::THROUGH_SIGMA,
            "least_confirmed": look::LEAST_CONFIRMED,
            "confirmed_per_through": look::CONFIRMED_PER_THROUGH,
            "voxel_m": voxels::EDGE_M,
        })
    }

    fn run(&self, work: &Work<'_, Input>) -> Result<(), StageError> {
        let rig = outputs::rig::read(&work.read(RIG_ADJUSTED)?)?;
        let depth = work.read(DEPTH)?;
        let index = outputs::depth::read_index(&depth)?;
        let trajectory = outputs::trajectory::read(&work.read(TRAJECTORY)?)?;
        let instants = instants(&rig, &index, &work.read(KEYFRAMES)?, &trajectory)?;
        let mut pictures = Vec::new();
        let mut lenses = Vec::new();
        let mut moving = Vec::new();
        for view in &index.views {
            let camera = rig.camera(&view.camera);
            let (_, camera) = camera.ok_or_else(|| ReadError::NoSuch(view.camera.clone()))?;
            lenses.push(Lens::new(&camera.left));
            moving.push(Moving::new(view, &camera.left));
            pictures.push(frames(work.source(), &index, &view.camera)?);
        }
        let all: usize = instants.iter().map(Vec::len).sum();
        let (mut done, mut voxels) = (0, Voxels::default());
        // The instants that are in memory, and how many were there before them.
        let (mut near, mut gone): (VecDeque<Vec<Look>>, usize) = (VecDeque::new(), 0);
        for (now, shots) in instants.iter().enumerate() {
            while gone + near.len() < instants.len().min(now + REACH + 1) {
                let shots = &instants[gone + near.len()];
                let looks = shots
                    .par_iter()
                    .map(|shot| Look::read(&depth, &index, shot));
                near.push_back(looks.collect::<Result<_, _>>()?);
            }
            while gone + REACH < now {
                near.pop_front();
                gone += 1;
            }
            for (place, shot) in shots.iter().enumerate() {
                let picture = pictures[shot.key.view].next();
                match picture {
                    Some(Ok(view)) => {
                        if view.number != shot.key.frame {
                            let (found, camera) = (view.number, &view.camera);
                            return Err(format!(
                                "found frame {found} of {camera} where {} was expected: its frames are not in the order of \
                                 their frame sets",
                                shot.key.frame
                            )
                            .into());
                        }
                        let movable = self.networks.movable(&view.left)?;
                        let eye = EyePicture {
                            lens: &lenses[shot.key.view],
                            picture: &view.left,
                            movable: movable.as_deref(),
                        };
                        let (points, pixels) = points(&near, (now - gone, place), &eye);
                        voxels.add(&points);
                        let moving = &mut moving[shot.key.view];
                        if let Some(mask) = moving.add(&pixels, movable.as_deref()) {
                            let camera = &index.views[shot.key.view].camera;
                            let frame = shot.key.frame;
                            outputs::masks::write_moving(work.draft(MASKS), camera, frame, &mask)?;
                        }
                    }
                    Some(Err(loss)) => work.lose_for(&loss),
                    None => work.lose(format!("there is no picture of frame {}", shot.key.frame)),
                }
                done += 1;
                work.progress(done, all as u64);
            }
        }
        let points = voxels.into_points();
        work.note(format!("{} points", points.len()));
        outputs::cloud::write(work.draft(CLOUD), &points)?;
        for (view, moving) in index.views.iter().zip(&moving) {
            if let Some(mask) = moving.wearer() {
                outputs::masks::write(work.draft(MASKS), &view.camera, Eye::Left, &mask)?;
            }
        }
        Ok(())
    }
}

/// What was seen at each instant, in order.
fn instants(
    rig: &RigModel,
    index: &DepthIndex,
    keyframes: &OutputReader,
    trajectory: &Trajectory,
) -> Result<Vec<Vec<Shot>>, StageError> {
    let mut poses = BTreeMap::new();
    for keyframe in outputs::keyframes::read(keyframes)? {
        let camera = rig.cameras.get(usize::from(keyframe.camera));
        let name = camera.map_or("", |camera| camera.name.as_str());
        poses.insert((name, keyframe.frame), keyframe.world_from_left);
    }
    let mut instants: BTreeMap<u64, Vec<Shot>> = BTreeMap::new();
    for key in &index.pictures {
        let view = &index.views[key.view];
        let Some(world_from_left) = poses.get(&(view.camera.as_str(), key.frame)) else {
            let (frame, camera) = (key.frame, &view.camera);
            return Err(format!("frame {frame} of {camera} has depth and is no keyframe").into());
        };
        let world_from_view = *world_from_left * view.view_from_left.inverse();
        let camera = rig.camera(&view.camera).map(|(_, camera)| camera);
        let sway = camera.map(|camera| Sway::new(camera, view, trajectory, key.time_ns));
        let shot = Shot {
            key: *key,
            world_from_view,
            sway: sway.unwrap_or_default(),
        };
        instants.entry(key.set).or_default().push(shot);
    }
    Ok(instants.into_values().collect())
}

/// The pictures of all keyframes of a camera that have depth, in their order.
fn frames(input: &Input, index: &DepthIndex, camera: &str) -> Result<Frames, ReadError> {
    let entries = input.index().camera(camera);
    let entries = entries.ok_or_else(|| ReadError::NoSuch(camera.to_owned()))?;
    let keys = index.pictures.iter();
    let of_camera = keys.filter(|key| index.views[key.view].camera == camera);
    let positions: Vec<usize> = of_camera
        .filter_map(|key| entries.position(key.frame))
        .collect();
    input.frames_where(camera, |p| positions.binary_search(&p).is_ok())
}

/// What one look adds, and what moves in it, pixel by pixel: `near` are the instants around it, `at` says which of them and which
/// of its looks.
fn points(
    near: &VecDeque<Vec<Look>>,
    at: (usize, usize),
    eye: &EyePicture<'_>,
) -> (Vec<Point>, Vec<Pixel>) {
    let look = &near[at.0][at.1];
    let others: Vec<(bool, &Look)> = near
        .iter()
        .enumerate()
        .flat_map(|(k, looks)| looks.iter().map(move |look| (k != at.0, look)))
        .filter(|(_, other)| !std::ptr::eq(*other, look))
        .filter(|(_, other)| look.may_share(other))
        .collect();
    let pixel = |column: u32, row: u32| {
        let Some(surface) = look.surface(column, row, MOVING_SIGMA_M) else {
            return (None, Pixel::Unknown);
        };
        let verdict = surface.judged(&others);
        let pixel = Pixel::of(verdict == Verdict::Moves, surface.depth_m);
        if verdict != Verdict::Stands || surface.sigma_m > LARGEST_SIGMA_M {
            return (None, pixel);
        }
        let colour = eye.colour(look.ray_in_left(column, row));
        let point = colour.map(|colour| Point {
            x_in_world: surface.x_in_world,
            sigma_m: surface.sigma_m,
            colour,
        });
        (point, pixel)
    };
    let rows = (0..look.height()).into_par_iter();
    let all = rows.flat_map_iter(|row| (0..look.width()).map(move |column| (column, row)));
    let (points, pixels): (Vec<Option<Point>>, Vec<Pixel>) =
        all.map(|(column, row)| pixel(column, row)).unzip();
    (points.into_iter().flatten().collect(), pixels)
}

/// A left picture as it was recorded.
struct EyePicture<'a> {
    lens: &'a Lens,
    picture: &'a Picture,
    /// Pixels that a network says can move, if there is one.
    movable: Option<&'a [bool]>,
}

impl EyePicture<'_> {
    /// Of the pixel that is nearest to where a ray is seen, if that stands still for all the network knows.
    fn colour(&self, ray: [f64; 3]) -> Option<[u8; 3]> {
        let [x, y] = self.lens.project(ray)?;
        let picture = self.picture;
        let inside = |c: f64, size: u32| (c > -0.5 && c < f64::from(size) - 0.5).then(|| c.round());
        let (x, y) = (inside(x, picture.width)?, inside(y, picture.height)?);
        let pixel = y as usize * picture.width as usize + x as usize;
        if self.movable.is_some_and(|movable| movable[pixel]) {
            return None;
        }
        let channels = picture.colour.channels();
        match picture.data.get(channels * pixel..channels * (pixel + 1))? {
            [grey] => Some([*grey; 3]),
            [red, green, blue] => Some([*red, *green, *blue]),
            _ => None,
        }
    }
}

#[cfg(test)]
mod tests;
