//! Coarse alignment of a tag by correlation: from within some cells to where the fit converges.

use cad_transforms::RigidTransform;
use nalgebra::Vector3;
use simd_dispatch::Kernel;

use crate::batch::{BATCH, PixelBatch, Pixels, Plane, PlaneBatch};
use crate::blur::Blur;
use crate::moments::Moments;
use crate::patch::{Patch, plane};
use crate::tag::Tag;
use crate::template::{PatternBatch, Template};
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

/// Pixels of an eye and where they meet the plane of a tag.
#[derive(Default)]
struct Points {
    pixels: Pixels,
    places: Vec<PlaneBatch>,
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
        let mut pixels = Pixels::with_capacity(MAX_PIXELS);
        let stride = patch.pixels.count.div_ceil(MAX_PIXELS).max(1);
        for index in (0..patch.pixels.count).step_by(stride) {
            pixels.push(patch.pixels.batches[index / BATCH].pixel(index % BATCH));
        }
        let plane = plane(&patch.view, self.tag, (pose, self.motion), &pixels);
        let Some(plane) = plane.filter(Plane::shows_front) else {
            return Points::default();
        };
        let of_batch = |pixels: &PixelBatch| {
            let mut point = PlaneBatch::ZERO;
            plane.meet(pixels, &mut point);
            point
        };
        Points {
            places: pixels.batches.iter().map(of_batch).collect(),
            pixels,
        }
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
    let shift = shift.map(|v| v as f32);
    let mut pattern = PatternBatch::ZERO;
    let batches = points.pixels.batches.iter().zip(&points.places);
    for (number, (pixels, places)) in batches.enumerate() {
        simd_dispatch::run(ShiftedPattern {
            template,
            places,
            shift,
            pattern: &mut pattern,
        });
        for k in 0..points.pixels.count_of(number) {
            moments.add(f64::from(pattern.value[k]), f64::from(pixels.level[k]));
        }
    }
    moments.correlation()
}

/// The pattern at places of a tag that is moved by a shift, cells.
struct ShiftedPattern<'k> {
    template: &'k Template,
    places: &'k PlaneBatch,
    shift: [f32; 2],
    pattern: &'k mut PatternBatch,
}

impl Kernel for ShiftedPattern<'_> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        let mut moved = *self.places;
        for k in 0..BATCH {
            moved.x[k] -= self.shift[0];
            moved.y[k] -= self.shift[1];
        }
        self.template.sample(&moved, 0.0, self.pattern);
    }
}
