//! A tag on a shoe over ground, drawn at random: poses, motions, and what is predicted of them.

use anyhow::{Context, Result};
use boards::Dictionary;
use cad_transforms::RigidTransform;
use camera_models::{CameraModel, Distortion, Lens};
use counter_random::{bell, bits, uniform};
use fiducials::{Motion, Tag};
use nalgebra::{UnitQuaternion, Vector3};

use super::conditions::{Condition, Resolution};

/// Side of the black square, m.
pub(super) const TAG_M: f64 = 0.06;
/// Between the eyes, m.
pub(super) const BASELINE_M: f64 = 0.063;
/// Exposure, s.
pub(super) const EXPOSURE_S: f64 = 0.008;
/// Number of tags of the dictionary.
pub(super) const TAGS: u64 = 587;

/// How far predictions are wrong: along the plane of the tag at most, cells; rotation, and distance
/// as a share of it, as standard deviations; velocity, as a share of it and m/s.
const START_CELLS: f64 = 1.0;
const START_RAD: f64 = 0.06;
const START_DISTANCE: f64 = 0.02;
const VELOCITY_SHARE: f64 = 0.1;
const VELOCITY: f64 = 0.02;

/// Both eyes have the same lens, and are parallel.
pub(super) struct Camera {
    pub(super) size: [usize; 2],
    pub(super) lens: Lens,
    pub(super) focal_px: f64,
}

impl Camera {
    pub(super) fn new(resolution: Resolution) -> Self {
        let (size, focal_px) = match resolution {
            Resolution::Vga => ([672, 376], 367.0),
            Resolution::Hd => ([1280, 720], 700.0),
        };
        let [width, height] = size.map(|v| v as f64);
        let middle = [0.5 * width + 4.3, 0.5 * height - 3.1];
        let distortion = Distortion::RadTan4 {
            k1: -0.17,
            k2: 0.025,
            p1: 2e-4,
            p2: -1e-4,
        };
        let model = CameraModel::new(
            (size[0] as u32, size[1] as u32),
            [focal_px, focal_px, middle[0], middle[1]],
            distortion,
        );
        Self {
            size,
            lens: Lens::new(&model),
            focal_px,
        }
    }
}

/// What the eyes see, and what a tracker would know of it.
pub(super) struct Scene {
    pub(super) seed: u64,
    /// Takes points of the tag to the left eye in mid-exposure.
    pub(super) left_from_tag: RigidTransform,
    /// Of the shoe, in the left eye.
    pub(super) motion: Motion,
    pub(super) id: u32,
    pub(super) has_tag: bool,
    /// Predictions of pose and motion.
    pub(super) start: RigidTransform,
    pub(super) predicted: Motion,
}

/// Numbers of a scene, by what they decide.
struct Draw {
    seed: u64,
    index: u64,
}

impl Draw {
    fn uniform(&mut self, from: f64, to: f64) -> f64 {
        self.index += 1;
        from + (to - from) * uniform(self.seed, STREAM, self.index)
    }

    fn bell(&mut self, sigma: f64) -> f64 {
        self.index += 1;
        sigma * bell(self.seed, STREAM, self.index)
    }
}

/// Of scenes; noise and textures have their own.
const STREAM: u64 = 1;

impl Scene {
    /// A scene; `has_tag` or a shoe without one.
    pub(super) fn new(
        camera: &Camera,
        condition: &Condition,
        seed: u64,
        has_tag: bool,
    ) -> Result<Self> {
        use std::f64::consts::{PI, TAU};
        let mut draw = Draw { seed, index: 0 };
        let id = (bits(seed, STREAM, 0) % TAGS) as u32;
        let tag = tag(id)?;
        let distance = camera.focal_px * TAG_M / condition.size_px;
        let [width, height] = camera.size.map(|v| v as f64);
        let pixel = [
            draw.uniform(0.3 * width, 0.8 * width),
            draw.uniform(0.25 * height, 0.75 * height),
        ];
        let ray = camera
            .lens
            .unproject(pixel)
            .context("a pixel of the lens")?;
        let middle = Vector3::from(ray) * (distance / ray[2]);
        let to_tag =
            UnitQuaternion::rotation_between(&Vector3::z(), &middle).context("a ray to the tag")?;
        let about = draw.uniform(-PI, PI);
        let (sin, cos) = (libm::sin(about), libm::cos(about));
        let tilt = condition.tilt_deg.to_radians();
        let tilted = UnitQuaternion::from_scaled_axis(Vector3::new(cos, sin, 0.0) * tilt);
        let turned = UnitQuaternion::from_scaled_axis(Vector3::z() * draw.uniform(-PI, PI));
        let rotation = to_tag * tilted * turned;
        let left_from_tag = transform(&rotation, &middle)?;

        let towards = draw.uniform(0.0, TAU);
        let speed = condition.motion_cells * tag.cell_m() / EXPOSURE_S;
        let along = Vector3::new(libm::cos(towards), libm::sin(towards), 0.0);
        let velocity = rotation * along * speed;
        let mut error = || Vector3::from_fn(|_, _| draw.bell(VELOCITY_SHARE * speed + VELOCITY));
        let predicted = velocity + error();

        let radius = START_CELLS * tag.cell_m() * libm::sqrt(draw.uniform(0.0, 1.0));
        let direction = draw.uniform(0.0, TAU);
        let aside = Vector3::new(libm::cos(direction), libm::sin(direction), 0.0) * radius;
        let farther = middle * draw.bell(START_DISTANCE);
        let small = Vector3::from_fn(|_, _| draw.bell(START_RAD));
        let start = transform(
            &(rotation * UnitQuaternion::from_scaled_axis(small)),
            &(middle + rotation * aside + farther),
        )?;
        Ok(Self {
            seed,
            left_from_tag,
            motion: motion(&velocity),
            id,
            has_tag,
            start,
            predicted: motion(&predicted),
        })
    }

    /// Corners of the black square in the left image, in the order of [`Tag::corners`].
    pub(super) fn corners(&self, camera: &Camera) -> Result<[[f64; 2]; 4]> {
        corners_at(camera, self.id, &self.left_from_tag).context("a tag in the image")
    }
}

/// Corners of a tag in the left image.
pub(super) fn corners_at(
    camera: &Camera,
    id: u32,
    left_from_tag: &RigidTransform,
) -> Option<[[f64; 2]; 4]> {
    let mut corners = [[0.0; 2]; 4];
    for (corner, point) in corners.iter_mut().zip(tag(id).ok()?.corners()) {
        *corner = camera.lens.project(left_from_tag.apply(point))?;
    }
    Some(corners)
}

/// A tag of the dictionary.
pub(super) fn tag(id: u32) -> Result<Tag> {
    Tag::new(Dictionary::AprilTag36h11, id, TAG_M).context("a tag of the dictionary")
}

/// The left eye in the axes of the right one.
pub(super) fn right_from_left() -> Result<RigidTransform> {
    Ok(RigidTransform::from_translation_m([-BASELINE_M, 0.0, 0.0])?)
}

fn motion(velocity: &Vector3<f64>) -> Motion {
    Motion {
        linear: (*velocity).into(),
        angular: [0.0; 3],
    }
}

fn transform(rotation: &UnitQuaternion<f64>, at: &Vector3<f64>) -> Result<RigidTransform> {
    let transform =
        RigidTransform::from_rotation_vector(rotation.scaled_axis().into(), (*at).into());
    Ok(transform?)
}
