//! The ground below feet at rest, and what it says of the tags on the shoes.
//!
//! Contract: the ground is that of depth alone, a plane through the vertices around a sole. Where
//! the ground is not plane, or depth does not show it on both sides, it says nothing.

use std::collections::HashMap;

use ::feet::PlacementConfig;
use ::feet::events::Contact;
use ::feet::tag_placement::{Estimate, PlacementError, RestPlace, RestSample};
use cad_transforms::{Covariance, RigidTransform};
use estimator_config::config;
use nalgebra::{Matrix3, Vector2, Vector3};
use scene_bundle::outputs::rig::RigShoeTag;
use scene_bundle::outputs::terrain::TerrainMesh;

config! {
    /// Constants of the ground below a sole.
    pub(super) struct GroundBelowConfig {
        /// Radius around the middle of a sole in which vertices count, m.
        pub radius_m: f64 = 0.35,
        /// Half of the length along the sole in which vertices count where those do not say
        /// anything, m: that of a tread.
        pub half_length_m: f64 = 0.13,
        /// Maximum height of these above or below the sole, m: edges of kerbs, other storeys.
        pub max_height_m: f64 = 0.12,
        /// Least number of vertices, and of those on either side of the sole.
        pub min_vertices: f64 = 60.0,
        /// See `min_vertices`.
        pub min_on_a_side: f64 = 15.0,
        /// Maximum root mean square distance from the plane, m.
        pub max_rms_m: f64 = 0.008,
        /// Maximum angle between the courses to and from a contact that are one direction, rad.
        pub max_bend_rad: f64 = 0.17,
    }
}

/// Vertices of a mesh by their place seen from above.
pub(super) struct GroundBelow<'a> {
    mesh: &'a TerrainMesh,
    cells: HashMap<[i32; 2], Vec<u32>>,
    config: GroundBelowConfig,
}

impl<'a> GroundBelow<'a> {
    pub(super) fn new(mesh: &'a TerrainMesh) -> Self {
        let config = GroundBelowConfig::default();
        let mut cells: HashMap<[i32; 2], Vec<u32>> = HashMap::new();
        for (number, position) in (0..).zip(&mesh.positions) {
            let [x, y, _] = position.map(f64::from);
            cells.entry(cell([x, y], &config)).or_default().push(number);
        }
        Self {
            mesh,
            cells,
            config,
        }
    }

    /// Samples of the contacts of a foot, by time.
    pub(super) fn samples(&self, contacts: &[Contact]) -> Vec<RestSample> {
        let sample = |(number, contact): (usize, &Contact)| {
            let place = &contact.stance.world_from_foot;
            let ground = self.plane(place);
            let tilt = ground.map(|(_, normal)| {
                let [x, y, _] = place.inverse().rotate(normal.into());
                [y, -x]
            });
            RestSample {
                time_s: contact.heel_strike.time_s,
                height_m: ground.map(|(height, _)| place.translation_m()[2] - height),
                tilt_rad: [0, 1].map(|k| tilt.map(|tilt| tilt[k])),
                heading_rad: self.heading(contacts, number),
            }
        };
        contacts.iter().enumerate().map(sample).collect()
    }

    /// Height of the ground at the middle of a sole, and its normal.
    fn plane(&self, place: &RigidTransform) -> Option<(f64, Vector3<f64>)> {
        let config = &self.config;
        let middle = Vector3::from(place.translation_m());
        let [row, column] = cell([middle.x, middle.y], config);
        let around = (-1..=1).flat_map(|i| (-1..=1).map(move |j| [row + i, column + j]));
        let numbers = around.filter_map(|cell| self.cells.get(&cell)).flatten();
        let away = numbers.map(|number| {
            let position = self.mesh.positions[*number as usize].map(f64::from);
            Vector3::from(position) - middle
        });
        let near = away.filter(|away| {
            away.xy().norm() < config.radius_m && away.z.abs() < config.max_height_m
        });
        let near: Vec<Vector3<f64>> = near.collect();
        let below = |away: &&Vector3<f64>| {
            let [x, _, _] = place.inverse().rotate((**away).into());
            x.abs() < config.half_length_m
        };
        // Stairs have edges before and behind a sole.
        let tread = || {
            let on_it: Vec<Vector3<f64>> = near.iter().filter(below).copied().collect();
            let mut heights: Vec<f64> = on_it.iter().map(|away| away.z).collect();
            heights.sort_by(f64::total_cmp);
            let middle = *heights.get(heights.len() / 2)?;
            let is_level = |away: &Vector3<f64>| (away.z - middle).abs() < 3.0 * config.max_rms_m;
            self.plane_of(place, on_it.into_iter().filter(is_level).collect())
        };
        let (height, normal) = self.plane_of(place, near.clone()).or_else(tread)?;
        Some((middle.z + height, normal))
    }

    /// Height of the plane through points relative to the middle of a sole, and its normal.
    fn plane_of(
        &self,
        place: &RigidTransform,
        mut near: Vec<Vector3<f64>>,
    ) -> Option<(f64, Vector3<f64>)> {
        let config = &self.config;
        let mut fit = plane_fit(&near)?;
        // Once more without what stands on it.
        near.retain(|away| residual(&fit, away).abs() < 3.0 * config.max_rms_m);
        fit = plane_fit(&near)?;
        let squares = near.iter().map(|away| residual(&fit, away).powi(2));
        let rms = (squares.sum::<f64>() / near.len() as f64).sqrt();
        let foot = place.inverse();
        let side = |away: &&Vector3<f64>| foot.rotate((**away).into())[1] > 0.0;
        let left = near.iter().filter(side).count() as f64;
        let right = near.len() as f64 - left;
        let is_known = left + right >= config.min_vertices
            && left.min(right) >= config.min_on_a_side
            && rms <= config.max_rms_m;
        let normal = Vector3::new(-fit.x, -fit.y, 1.0).normalize();
        is_known.then_some((fit.z, normal))
    }

    /// Direction of a foot relative to its course, where that is straight.
    fn heading(&self, contacts: &[Contact], number: usize) -> Option<f64> {
        let place = |k: usize| Some(contacts.get(k)?.stance.world_from_foot);
        let at = |k: usize| Some(Vector3::from(place(k)?.translation_m()).xy());
        let own = at(number)?;
        let (to, from) = (own - at(number.checked_sub(1)?)?, at(number + 1)? - own);
        let bend = to.perp(&from).atan2(to.dot(&from));
        if bend.abs() > self.config.max_bend_rad || (to + from).norm() < 2.0 * self.config.radius_m
        {
            return None;
        }
        let ahead = Vector3::from(place(number)?.rotate([1.0, 0.0, 0.0])).xy();
        let course: Vector2<f64> = to + from;
        Some(course.perp(&ahead).atan2(course.dot(&ahead)))
    }
}

fn cell([x, y]: [f64; 2], config: &GroundBelowConfig) -> [i32; 2] {
    [x, y].map(|v| (v / config.radius_m).floor() as i32)
}

/// Slopes in x and y, and the height at the origin.
fn plane_fit(points: &[Vector3<f64>]) -> Option<Vector3<f64>> {
    let (mut normal, mut right) = (Matrix3::zeros(), Vector3::zeros());
    for point in points {
        let row = Vector3::new(point.x, point.y, 1.0);
        normal += row * row.transpose();
        right += row * point.z;
    }
    Some(normal.cholesky()?.solve(&right))
}

fn residual(fit: &Vector3<f64>, point: &Vector3<f64>) -> f64 {
    point.z - fit.x * point.x - fit.y * point.y - fit.z
}

/// Where a foot was at rest.
pub(super) fn places(contacts: &[Contact]) -> Vec<RestPlace> {
    let place = |contact: &Contact| RestPlace {
        time_s: contact.heel_strike.time_s,
        position: contact.stance.world_from_foot.translation_m(),
    };
    contacts.iter().map(place).collect()
}

/// Standard deviations of the placement of a tag on its shoe.
struct Tolerance {
    /// Along and across the sole, m.
    along_m: f64,
    height_m: f64,
    tilt_rad: f64,
    heading_rad: f64,
}

impl Tolerance {
    /// Those that the rig file states, or usual ones.
    fn of(tag: &RigShoeTag, config: &PlacementConfig) -> Self {
        match tag.foot_from_tag_covariance.map(|own| own.sigmas()) {
            Some([x, y, z, roll, pitch, yaw]) => Self {
                along_m: x.max(y),
                height_m: z,
                tilt_rad: roll.max(pitch),
                heading_rad: yaw,
            },
            None => Self {
                along_m: config.usual_along_sigma_m,
                height_m: config.usual_height_sigma_m,
                tilt_rad: config.usual_tilt_sigma_rad,
                heading_rad: config.usual_heading_sigma_rad,
            },
        }
    }
}

/// The placement of a tag after the ground below its foot is known.
pub(super) struct Correction {
    pub(super) foot_from_tag: RigidTransform,
    /// What is uncertain of the foot's pose, in its own axes, by the placement.
    pub(super) uncertain: Covariance,
    /// Whether the ground contradicts the tolerance: the placement is then that of the rig file.
    pub(super) contradicts: bool,
}

/// A value with the rig file's placement as the prior, 0 with its tolerance.
struct Posterior {
    value: f64,
    sigma: f64,
    contradicts: bool,
}

impl Posterior {
    fn new(estimate: Option<Estimate>, prior: f64) -> Self {
        let Some(Estimate { value, sigma }) = estimate else {
            return Self {
                value: 0.0,
                sigma: prior,
                contradicts: false,
            };
        };
        let both = prior.hypot(sigma).max(f64::MIN_POSITIVE);
        if value.abs() > 3.0 * both {
            // It is not corrected, so that all of it remains.
            return Self {
                value: 0.0,
                sigma: prior.max(value.abs()),
                contradicts: true,
            };
        }
        Self {
            value: value * (prior / both).powi(2),
            sigma: prior * sigma / both,
            contradicts: false,
        }
    }
}

/// The placement of a tag, corrected as far as the tolerance of the rig file allows.
pub(super) fn corrected(
    tag: &RigShoeTag,
    error: &PlacementError,
    config: &PlacementConfig,
) -> Correction {
    let tolerance = Tolerance::of(tag, config);
    let [roll, pitch] = error
        .tilt_rad
        .map(|own| Posterior::new(own, tolerance.tilt_rad));
    let height = Posterior::new(error.height_m, tolerance.height_m);
    // The tag is where it is along and across the sole; tilt and height are those of the sole.
    let turn = RigidTransform::from_rotation_vector([roll.value, pitch.value, 0.0], [0.0; 3]);
    let turn = turn.unwrap_or_else(|_| RigidTransform::identity());
    let place = tag.foot_from_tag;
    let [x, y, z] = place.translation_m();
    let lifted = turn.rotate([x, y, z])[2] + height.value;
    let rotation = (turn * place).rotation_wxyz();
    let corrected = RigidTransform::from_wxyz(rotation, [x, y, lifted]);
    // The foot turns about the tag.
    let at_tag = RigidTransform::from_translation_m(tag.foot_from_tag.translation_m());
    let sigmas = Covariance::from_sigmas(
        [tolerance.along_m, tolerance.along_m, height.sigma],
        [roll.sigma, pitch.sigma, tolerance.heading_rad],
    );
    Correction {
        foot_from_tag: corrected.unwrap_or(place),
        uncertain: match (at_tag, sigmas) {
            (Ok(foot_from_tag_axes), Ok(sigmas)) => sigmas.moved(&foot_from_tag_axes),
            _ => Covariance::zero(),
        },
        contradicts: roll.contradicts || pitch.contradicts || height.contradicts,
    }
}

#[cfg(test)]
mod tests;
