use boards::Dictionary;
use imaging::ImageView;
use simd_dispatch::Kernel;

use super::*;
use crate::batch::BATCH;
use crate::patch::{Selection, Window};
use crate::test_images::{CLEAN, Draw, Imaging, SIZE, lens, render};
use crate::view::{RowPoses, View, by_motion};
const MOVING: Motion = Motion {
    linear: [0.9, 0.6, -0.2],
    angular: [0.0, 0.5, 1.0],
};

/// Calls `each` with the problem of a tag of 20 px with a rolling shutter, and a state near it.
fn with_problem(seed: u64, each: impl FnOnce(&Problem<'_>, &State)) {
    let tag = Tag::new(Dictionary::AprilTag36h11, 1, 0.06).unwrap();
    let config = Config::default();
    let mut draw = Draw(seed);
    let imaging = Imaging {
        line_s: 2e-5,
        exposure_s: 0.004,
        ..CLEAN
    };
    let pose = RigidTransform::from_rotation_vector([0.2, 0.3, 0.5], [0.03, 0.02, 1.1]).unwrap();
    let (lens, eye) = (lens(), RigidTransform::identity());
    let image = render(&lens, &tag, &eye, &pose, &MOVING, &imaging, &mut draw);
    let view = View {
        image: ImageView::packed(SIZE[0], SIZE[1], &image).unwrap(),
        lens: &lens,
        eye_from_reference: eye,
        line_s: imaging.line_s,
        exposure_s: imaging.exposure_s,
    };
    let window = Window::new((0, &view), &tag, &pose).unwrap();
    let all = Selection::all(&tag, &config);
    let patch = Patch::new(&window, &tag, &pose, &MOVING, &all, &config).unwrap();
    let problem = Problem::new(vec![patch], &tag, &MOVING, &config, (&pose, 0.0)).unwrap();
    let small = RigidTransform::from_rotation_vector([0.02, 0.01, 0.01], [1e-3, -1e-3, 4e-3]);
    let near = pose * small.unwrap();
    let patterns = problem.patterns(&near, 0.05).unwrap();
    let state = problem.start(&near, 0.05, &patterns).unwrap();
    each(&problem, &state);
}

/// Residuals and derivatives of a pixel, in double precision and one pixel at a time.
fn exact(problem: &Problem<'_>, state: &State, batch: &PixelBatch, n: usize) -> (f64, [f64; OWN]) {
    let own = &problem.patches[0];
    let rows = own.patch.pixels.rows().unwrap();
    let poses = RowPoses::new(&own.patch.view, &state.pose, problem.motion, rows);
    let ray = nalgebra::Vector3::new(f64::from(batch.x[n]), f64::from(batch.y[n]), 1.0);
    let point = poses.at(batch.row[n] as usize).meet(&ray).unwrap();
    let cell = problem.tag.cell_m();
    let pattern = own.template.at(point.at.map(|v| v / cell));
    let growth = state.log_blur - own.log_blur;
    let value = (pattern.value + growth * pattern.by_log_blur) as f32;
    let levels = &state.levels[0];
    let [curve, wider] = [0.0, 0.01].map(|more| levels.tone(state.tone + more));
    let (share, slope) = curve.at(value);
    let (share, slope) = (f64::from(share), f64::from(slope));
    let factor = levels.contrast() * slope;
    let [a, b] = by_motion(&point);
    let mut by = [0.0; OWN];
    for k in 0..BLUR {
        by[k] = factor / cell * (pattern.gradient[0] * a[k] + pattern.gradient[1] * b[k]);
    }
    by[BLUR] = factor * pattern.by_log_blur;
    by[TONE] = levels.contrast() / 0.01 * (f64::from(wider.at(value).0) - share);
    by[SHARED] = 1.0 - share;
    by[SHARED + 1] = share;
    let residual = levels.black + levels.contrast() * share - f64::from(batch.level[n]);
    (residual, by)
}

/// To 0.02 gray levels; derivatives to 1 % of their root mean square, since they jump between
/// entries of the tone curve. Fewer than 1 % of the pixels are next to such a jump.
#[test]
fn batches_agree_with_single_pixels() {
    for seed in 0..4 {
        with_problem(seed, |problem, state| {
            let found = problem.evaluate(state).unwrap();
            let pixels = &problem.patches[0].patch.pixels;
            assert!(pixels.count > 200, "{}", pixels.count);
            let exact: Vec<_> = (0..pixels.count)
                .map(|n| exact(problem, state, &pixels.batches[n / BATCH], n % BATCH))
                .collect();
            let sizes: [f64; OWN] = std::array::from_fn(|k| {
                let squares = exact.iter().map(|(_, by)| by[k] * by[k]);
                (squares.sum::<f64>() / exact.len() as f64).sqrt()
            });
            let mut apart = 0;
            for (n, (residual, by)) in exact.iter().enumerate() {
                let batch = &found.patches[0].batches[n / BATCH];
                let error = f64::from(batch.residuals[n % BATCH]) - residual;
                assert!(error.abs() < 0.02, "{seed} {n}: {error}");
                let is_near =
                    |k: usize| (f64::from(batch.by[k][n % BATCH]) - by[k]).abs() < 0.01 * sizes[k];
                apart += usize::from(!(0..OWN).all(is_near));
            }
            assert!(
                100 * apart < pixels.count,
                "{seed}: {apart} of {}",
                pixels.count
            );
        });
    }
}

#[test]
fn vectors_give_the_same_bits() {
    with_problem(5, |problem, state| {
        let own = &problem.patches[0];
        let plane = own.patch.plane(problem.tag, &state.pose, problem.motion);
        let plane = plane.unwrap();
        let model = LevelModel::new(&state.levels[0], state.tone);
        let evaluate = || Evaluate {
            pixels: &own.patch.pixels,
            plane: &plane,
            template: &own.template,
            growth: 0.03,
            model: &model,
            cell_m: problem.tag.cell_m() as f32,
        };
        let plain = evaluate().run().unwrap();
        let vectors = simd_dispatch::run(evaluate()).unwrap();
        for (a, b) in plain.batches.iter().zip(&vectors.batches) {
            let bits = |lane: &[f32; BATCH]| lane.map(f32::to_bits);
            assert_eq!(bits(&a.residuals), bits(&b.residuals));
            for (a, b) in a.by.iter().zip(&b.by) {
                assert_eq!(bits(a), bits(b));
            }
        }
        let accumulate = || Accumulate {
            residuals: &plain,
            noise: 2.5,
            limit: 2.5,
        };
        let (a, b) = (accumulate().run(), simd_dispatch::run(accumulate()));
        assert_eq!(a.gradient.map(f64::to_bits), b.gradient.map(f64::to_bits));
        let bits = |row: [f64; OWN]| row.map(f64::to_bits);
        assert_eq!(a.hessian.map(bits), b.hessian.map(bits));
        let cost = || Cost {
            residuals: &plain,
            by_limit: 0.15,
        };
        let (a, b) = (cost().run(), simd_dispatch::run(cost()));
        assert_eq!(a.to_bits(), b.to_bits());
    });
}
