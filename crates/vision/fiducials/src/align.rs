//! Coarse alignment of a tag by correlation: from within some cells to where the fit converges.

use cad_transforms::RigidTransform;
use nalgebra::Vector3;

use crate::blur::Blur;
use crate::moments::Moments;
use crate::patch::Patch;
use crate::tag::Tag;
use crate::template::Template;
use crate::view::Motion;

/// Displacements that are tried along each axis, in steps, and a step, cells.
const STEPS: i32 = 4;
const STEP_CELLS: f64 = 0.4;
/// Maximum number of pixels of an eye here.
const MAX_PIXELS: usize = 200;
/// Blur of the pattern here, cells.
const BLUR_CELLS: f64 = 0.5;

pub(crate) struct Aligner<'a> {
    pub(crate) patches: &'a [&'a Patch<'a>],
    pub(crate) tag: &'a Tag,
    pub(crate) motion: &'a Motion,
}

/// Where pixels of an eye meet the plane of a tag, cells, and their gray levels.
type Points = Vec<([f64; 2], f64)>;

impl Aligner<'_> {
    /// The start, moved in the plane of the tag to where it correlates best with the first eye, and
    /// then along the ray to where it does with all.
    pub(crate) fn align(&self, start: &RigidTransform) -> RigidTransform {
        let blur = Blur {
            sigma: [BLUR_CELLS; 2],
            lens_share: 1.0,
            motion: [0.0; 2],
        };
        let template = Template::new(self.tag, &blur);
        let shifts = (-STEPS..=STEPS).flat_map(|i| (-STEPS..=STEPS).map(move |j| [i, j]));
        let points = self.points(0, start);
        let found = best(shifts, |shift| {
            let shift = shift.map(|n| STEP_CELLS * f64::from(n));
            correlation(&template, &points, shift)
        });
        let step = STEP_CELLS * self.tag.cell_m();
        let [x, y] = found.map(|n| step * f64::from(n));
        let Ok(shift) = RigidTransform::from_translation_m([x, y, 0.0]) else {
            return *start;
        };
        let in_plane = *start * shift;
        let Some(second) = self.patches.get(1) else {
            return in_plane;
        };
        let [first, second] = [&self.patches[0].view, &second.view]
            .map(|view| Vector3::from(view.eye_from_reference.inverse().translation_m()));
        let ray = in_plane.translation() - first;
        let along = step * ray.norm() / (second - first).norm().max(1e-6);
        let moved = |n: i32| {
            let shift = ray.normalize() * (along * f64::from(n));
            let shift = RigidTransform::from_translation_m(shift.into());
            shift.map_or(in_plane, |shift| shift * in_plane)
        };
        let eyes = 0..self.patches.len();
        let found = best(-STEPS..=STEPS, |n| {
            let pose = moved(n);
            let of_eye = |eye| correlation(&template, &self.points(eye, &pose), [0.0; 2]);
            eyes.clone().map(of_eye).sum()
        });
        moved(found)
    }

    /// Of a part of the pixels, which suffices here.
    fn points(&self, eye: usize, pose: &RigidTransform) -> Points {
        let patch = self.patches[eye];
        let per_m = 1.0 / self.tag.cell_m();
        let stride = patch.pixels.len().div_ceil(MAX_PIXELS).max(1);
        let mut points = Vec::with_capacity(MAX_PIXELS);
        let mut index = 0;
        patch.for_each(pose, self.motion, |pixel, row_pose| {
            if index % stride == 0
                && let Some(point) = row_pose.meet(&pixel.ray)
            {
                points.push((point.at.map(|v| v * per_m), pixel.level));
            }
            index += 1;
        });
        points
    }
}

/// The first of the candidates with the highest score.
fn best<T: Copy + Default>(candidates: impl Iterator<Item = T>, score: impl Fn(T) -> f64) -> T {
    let mut best = (f64::NEG_INFINITY, T::default());
    for candidate in candidates {
        let score = score(candidate);
        if score > best.0 {
            best = (score, candidate);
        }
    }
    best.1
}

/// Correlation of gray levels with the pattern, with the tag moved by a shift, cells.
fn correlation(template: &Template, points: &Points, shift: [f64; 2]) -> f64 {
    let mut moments = Moments::default();
    for (at, level) in points {
        let place = [0, 1].map(|k| at[k] - shift[k]);
        moments.add(template.at(place).value, *level);
    }
    moments.correlation()
}
