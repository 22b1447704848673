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
/// Blur of the pattern here, cells.
const BLUR_CELLS: f64 = 0.5;

pub(crate) struct Aligner<'a> {
    pub(crate) patches: &'a [&'a Patch<'a>],
    pub(crate) tag: &'a Tag,
    pub(crate) motion: &'a Motion,
}

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
        let eyes = 0..self.patches.len();
        let step = STEP_CELLS * self.tag.cell_m();
        let mut best = (self.correlation(&template, 0, start), *start);
        for (i, j) in (-STEPS..=STEPS).flat_map(|i| (-STEPS..=STEPS).map(move |j| (i, j))) {
            let shift = [step * f64::from(i), step * f64::from(j), 0.0];
            let Ok(shift) = RigidTransform::from_translation_m(shift) else {
                continue;
            };
            let moved = *start * shift;
            let correlation = self.correlation(&template, 0, &moved);
            if correlation > best.0 {
                best = (correlation, moved);
            }
        }
        let Some(second) = self.patches.get(1) else {
            return best.1;
        };
        let [first, second] = [&self.patches[0].view, &second.view]
            .map(|view| Vector3::from(view.eye_from_reference.inverse().translation_m()));
        let in_plane = best.1;
        let ray = in_plane.translation() - first;
        let baseline = (second - first).norm().max(1e-6);
        let along = step * ray.norm() / baseline;
        let mut best = (f64::NEG_INFINITY, in_plane);
        for k in -STEPS..=STEPS {
            let shift = ray.normalize() * (along * f64::from(k));
            let Ok(shift) = RigidTransform::from_translation_m(shift.into()) else {
                continue;
            };
            let moved = shift * in_plane;
            let correlation = eyes
                .clone()
                .map(|eye| self.correlation(&template, eye, &moved))
                .sum();
            if correlation > best.0 {
                best = (correlation, moved);
            }
        }
        best.1
    }

    /// Correlation of the gray levels of an eye with the pattern.
    fn correlation(&self, template: &Template, eye: usize, pose: &RigidTransform) -> f64 {
        let patch = self.patches[eye];
        let cell = self.tag.cell_m();
        let mut moments = Moments::default();
        patch.for_each(pose, self.motion, |pixel, row_pose| {
            let Some(point) = row_pose.meet(&pixel.ray) else {
                return;
            };
            let expected = template.at(point.at.map(|v| v / cell)).value;
            moments.add(expected, pixel.level);
        });
        moments.correlation()
    }
}
