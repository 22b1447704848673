//! Cross-camera matching: features that another camera of the rig also observes.
//!
//! Where views overlap, a feature tracked by one camera is also tracked by the other one under the
//! same id: its landmark survives when it leaves the first view, and connects the two cameras. The
//! cameras have different orientations, so that patches look different. The patch is therefore
//! warped into the view of the other camera, on a plane perpendicular to the viewing ray, before
//! the search; and stereo matching in the other camera must confirm the known range.

use imaging::ImageView;
use nalgebra::{Matrix3, Vector3};
use rayon::prelude::*;

use super::{Odometry, world_from_left};
use crate::backend::observation::{Camera, CameraPose, transfer};
use crate::backend::window::Window;
use crate::config::FrontendConfig;
use crate::frontend::tracker::{PredictedPixel, Track};
use imaging::{Level, Pyramid};

/// Side of the warped patch, px, and its center.
const WARP_SIDE_PX: usize = 48;
const WARP_CENTER_PX: f64 = 24.0;

/// A feature that should be visible in the other camera.
struct Candidate {
    id: u64,
    expected: PredictedPixel,
    rho: f64,
}

impl Odometry {
    /// Searches the images of the newest frame for the features of the other cameras, at the
    /// predicted positions of their landmarks.
    pub(super) fn match_across_cameras(&mut self, window: &mut Window, exposure_offset_s: &[f64]) {
        let state = window.newest().state;
        let left_poses: Vec<_> = (self.cameras.iter().zip(exposure_offset_s))
            .map(|(camera, exposure_offset_s)| {
                world_from_left(camera, &CameraPose::new(&state, *exposure_offset_s))
            })
            .collect();
        let frontend = &self.config.frontend;
        let config = &frontend.cross_camera;
        let ratio = config.sigma_ratio;
        let count = self.cameras.len();
        let pairs = (0..count).flat_map(|to| (0..count).map(move |from| (from, to)));
        for (from, to) in pairs.filter(|(from, to)| from != to) {
            let [Some(level), Some(target)] =
                [from, to].map(|k| self.trackers[k].image().levels.first())
            else {
                continue;
            };
            let inside = [target.width as f64, target.height as f64];
            let candidates: Vec<Candidate> = self.trackers[from]
                .tracks
                .iter()
                .filter(|track| !self.trackers[to].is_tracked(track.id))
                .filter_map(|track| {
                    self.candidate(window, track, to, exposure_offset_s[to], inside)
                })
                .collect();
            let back = left_poses[from].0.transpose();
            let from_there = (
                back * left_poses[to].0,
                back * (left_poses[to].1 - left_poses[from].1),
            );
            let cameras = [&self.cameras[from], &self.cameras[to]];
            let tracker = &self.trackers[to];
            let found: Vec<Option<Track>> = candidates
                .par_iter()
                .with_min_len(4)
                .map(|candidate| {
                    let patch = warp_patch(frontend, level, cameras, &from_there, candidate)?;
                    let middle = [WARP_CENTER_PX as f32; 2];
                    let expected = candidate.expected;
                    let track =
                        tracker.find(cameras[1], (&patch, middle), candidate.id, expected)?;
                    let distance =
                        (track.at[0] - expected.at[0]).hypot(track.at[1] - expected.at[1]);
                    let apart = (track.rho? - candidate.rho).abs();
                    let fits = distance < config.max_position_error_px as f32
                        && apart
                            < config.max_inverse_range_error_ratio * candidate.rho
                                + config.max_inverse_range_error_per_m;
                    fits.then_some(track)
                })
                .collect();
            for track in found.into_iter().flatten() {
                let observation = track.observation(to, &self.cameras[to], exposure_offset_s[to]);
                if let Some(landmark) = window.landmarks.get_mut(&track.id)
                    && self.trackers[to].insert(track)
                {
                    landmark.observe(self.number, observation, ratio);
                }
            }
        }
    }

    /// Adds the observations of landmarks in the newest frame to the window.
    pub(super) fn match_in_new_frames(&self, window: &mut Window, exposure_offset_s: &[f64]) {
        let ratio = self.config.frontend.cross_camera.sigma_ratio;
        for (k, tracker) in self.trackers.iter().enumerate() {
            for track in &tracker.tracks {
                if let Some(landmark) = window.landmarks.get_mut(&track.id) {
                    let observation = track.observation(k, &self.cameras[k], exposure_offset_s[k]);
                    landmark.observe(self.number, observation, ratio);
                }
            }
        }
    }

    /// Prediction of a feature in another camera; `None` outside its view.
    fn candidate(
        &self,
        window: &Window,
        track: &Track,
        to: usize,
        exposure_offset_s: f64,
        inside: [f64; 2],
    ) -> Option<Candidate> {
        let landmark = window.landmarks.get(&track.id)?;
        let (number, host) = &landmark.observations[0];
        let frame = &window.frames[window.position(*number)?];
        let x = transfer(
            &host.left.ray,
            landmark.rho,
            (
                &self.cameras[host.camera],
                &CameraPose::new(&frame.state, host.exposure_offset_s),
            ),
            (
                &self.cameras[to],
                &CameraPose::new(&window.newest().state, exposure_offset_s),
            ),
        )
        .x;
        let size = x.norm();
        let at = self.cameras[to].left.project(x.into())?;
        let is_inside = (0..2).all(|k| (8.0..inside[k] - 8.0).contains(&at[k]));
        (x.z > 0.1 * size && is_inside).then_some(Candidate {
            id: track.id,
            expected: PredictedPixel {
                at: at.map(|v| v as f32),
                rho: Some(landmark.rho / size),
            },
            rho: landmark.rho / size,
        })
    }
}

/// Patch around a candidate, warped from one camera into the view of the other.
fn warp_patch(
    frontend: &FrontendConfig,
    level: &Level,
    [from, to]: [&Camera; 2],
    (rotation, shift): &(Matrix3<f64>, Vector3<f64>),
    candidate: &Candidate,
) -> Option<Pyramid> {
    let config = &frontend.cross_camera;
    let step = config.derivative_step_px;
    let at = candidate.expected.at.map(f64::from);
    let observation = Vector3::from(to.left.unproject(at)?).normalize();
    // Intersection of the ray of a pixel with the plane, in the first camera.
    let back = |x: f64, y: f64| {
        let ray = Vector3::from(to.left.unproject([at[0] + x, at[1] + y])?);
        let point = rotation * (ray / ray.dot(&observation)) + shift * candidate.rho;
        let at = from.left.project(point.into())?;
        (point.z > 0.1 * point.norm()).then_some(at)
    };
    let middle = back(0.0, 0.0)?;
    let by = |a: [f64; 2], b: [f64; 2]| [0, 1].map(|k| (a[k] - b[k]) / (2.0 * step));
    let by_x = by(back(step, 0.0)?, back(-step, 0.0)?);
    let by_y = by(back(0.0, step)?, back(0.0, -step)?);
    let area = (by_x[0] * by_y[1] - by_x[1] * by_y[0]).abs();
    if !(1.0 / config.max_scale_ratio..config.max_scale_ratio).contains(&area) {
        return None;
    }
    let mut data = Vec::with_capacity(WARP_SIDE_PX * WARP_SIDE_PX);
    for y in 0..WARP_SIDE_PX {
        for x in 0..WARP_SIDE_PX {
            let (dx, dy) = (x as f64 - WARP_CENTER_PX, y as f64 - WARP_CENTER_PX);
            let at = [0, 1].map(|k| middle[k] + by_x[k] * dx + by_y[k] * dy);
            data.push(sample(level, at)?);
        }
    }
    let image = ImageView::new(WARP_SIDE_PX, WARP_SIDE_PX, WARP_SIDE_PX, &data)?;
    Some(Pyramid::new(&frontend.pyramid, &image))
}

/// Bilinear interpolation; `None` outside.
fn sample(level: &Level, [x, y]: [f64; 2]) -> Option<u8> {
    let is_inside =
        x >= 0.0 && y >= 0.0 && x + 1.0 < level.width as f64 && y + 1.0 < level.height as f64;
    if !is_inside {
        return None;
    }
    let at = y as usize * level.width + x as usize;
    let (u, v) = (x.fract(), y.fract());
    let of = |k: usize| f64::from(level.data[k]);
    let upper = of(at) + u * (of(at + 1) - of(at));
    let lower = of(at + level.width) + u * (of(at + level.width + 1) - of(at + level.width));
    Some((upper + v * (lower - upper)).round() as u8)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::backend::solver::tests::camera;

    #[test]
    fn warped_patch_equals_the_view_of_the_other_camera() {
        // Two cameras rotated half a radian to either side, in front of a plane that faces the
        // right one.
        let cameras = [camera(-0.5, 0.0), camera(0.4, 0.0)];
        let [(rotation_a, at_a), (rotation_b, at_b)] = cameras.each_ref().map(|c| c.body_from_left);
        let point = Vector3::new(-0.1, 0.2, 2.5);
        let observation = (point - at_b).normalize();
        let across = observation.cross(&Vector3::y()).normalize();
        let along = observation.cross(&across);
        // Gray value that a camera measures at a pixel.
        let gray_value = |camera: &Camera, pixel: [f64; 2]| {
            let (rotation, at) = &camera.body_from_left;
            let ray = rotation * Vector3::from(camera.left.unproject(pixel).unwrap());
            let on = at + ray * ((point - at).dot(&observation) / ray.dot(&observation)) - point;
            128.0 + 50.0 * (40.0 * across.dot(&on)).sin() + 50.0 * (31.0 * along.dot(&on)).cos()
        };
        let (width, height) = (672, 376);
        let pixels = (0..width * height).map(|i| [(i % width) as f64, (i / width) as f64]);
        let level = Level {
            width,
            height,
            data: pixels.map(|p| gray_value(&cameras[0], p) as u8).collect(),
        };
        let x = rotation_b.transpose() * (point - at_b);
        let at = cameras[1].left.project(x.into()).unwrap();
        let candidate = Candidate {
            id: 1,
            expected: PredictedPixel {
                at: at.map(|v| v as f32),
                rho: None,
            },
            rho: 1.0 / x.norm(),
        };
        let back = rotation_a.transpose();
        let from_there = (back * rotation_b, back * (at_b - at_a));
        let [a, b] = &cameras;
        let frontend = FrontendConfig::default();
        let patch =
            warp_patch(&frontend, &level, [a, b], &from_there, &candidate).expect("a warped patch");
        let at = candidate.expected.at.map(f64::from);
        let mut worst: f64 = 0.0;
        // Within the extent of a patch.
        for (x, y) in (16..33).flat_map(|y| (16..33).map(move |x| (x, y))) {
            let target = [
                at[0] + x as f64 - WARP_CENTER_PX,
                at[1] + y as f64 - WARP_CENTER_PX,
            ];
            let gray = f64::from(patch.levels[0].data[y * WARP_SIDE_PX + x]);
            worst = worst.max((gray - gray_value(b, target)).abs());
        }
        assert!(worst < 8.0, "{worst}");
    }
}
