//! Gradients through a lens: of a point's pixel and of the Jacobian there.

use crate::lanes::{LANES, Lanes};
use crate::render::geometry::{Linear, Placement};
use crate::render::view::View;

/// Step of the differences of a distorted lens's Jacobian, as a share of the depth.
const LENS_STEP: f64 = 1e-6;

/// Adds to the point's gradient those through its pixel and through the lens's Jacobian.
#[inline(always)]
pub(super) fn add_lens<V: Lanes>(
    place: &Placement<V>,
    linear: &Linear<V>,
    view: &View,
    mean: &[V; 2],
    by_jacobian: &[[V; 3]; 2],
    out: &mut [V; 3],
) {
    let [x, y, z] = place.p;
    if let Some(lens) = &view.lens {
        for k in 0..3 {
            out[k] = out[k] + mean[0] * linear.jacobian[0][k] + mean[1] * linear.jacobian[1][k];
        }
        add_distorted(&place.p, lens, by_jacobian, out);
        return;
    }
    let inverse = V::splat(1.0) / z;
    let two = V::splat(2.0);
    for (k, at) in [x, y].into_iter().enumerate() {
        let focal = linear.jacobian[k][k];
        let slope = at * inverse;
        let (low, high) = (V::splat(view.slope_min[k]), V::splat(view.slope_max[k]));
        let bounded = slope.less(low).or(high.less(slope));
        let by_slope = by_jacobian[k][2];
        // The pixel; then the Jacobian's entries f/z and -f slope/z, the slope bounded or not.
        let through_slope = mean[k] - by_slope.and_not(bounded) * inverse;
        out[k] = focal.mul_add(through_slope, out[k]);
        let slope_in_use = slope.max(low).min(high);
        let through_depth = bounded.select(by_slope, two * by_slope) * slope_in_use * inverse
            - mean[k] * slope
            - by_jacobian[k][k] * inverse;
        out[2] = focal.mul_add(through_depth, out[2]);
    }
}

/// The same through the Jacobian of a distorted lens, in f64, one lane after the other.
#[inline(always)]
fn add_distorted<V: Lanes>(
    p: &[V; 3],
    lens: &camera_models::Lens,
    by_jacobian: &[[V; 3]; 2],
    out: &mut [V; 3],
) {
    let mut points = [[0.0; LANES]; 3];
    let mut gradient = [[[0.0; LANES]; 3]; 2];
    for k in 0..3 {
        p[k].store(&mut points[k]);
        by_jacobian[0][k].store(&mut gradient[0][k]);
        by_jacobian[1][k].store(&mut gradient[1][k]);
    }
    let mut added = [[0.0; LANES]; 3];
    for lane in 0..LANES {
        let point = points.map(|values| f64::from(values[lane]));
        let step = LENS_STEP * point[2];
        let beside = |k: usize| {
            let mut beside = point;
            beside[k] += step;
            Some(lens.project_with_jacobians(beside)?.by_point)
        };
        let here = lens.project_with_jacobians(point).map(|at| at.by_point);
        // At the edge of the lens's domain the Jacobian is taken as constant.
        let (Some(here), Some(x), Some(y)) = (here, beside(0), beside(1)) else {
            continue;
        };
        let dot = |of: nalgebra::Matrix2x3<f64>| {
            let mut sum = 0.0;
            for row in 0..2 {
                for column in 0..3 {
                    sum += of[(row, column)] * f64::from(gradient[row][column][lane]);
                }
            }
            sum
        };
        let (x, y) = (dot((x - here) / step), dot((y - here) / step));
        // A pixel depends on the direction alone, so that the Jacobian falls with the distance:
        // along the point itself its derivative is its negative.
        let z = (-dot(here) - point[0] * x - point[1] * y) / point[2];
        for (added, value) in added.iter_mut().zip([x, y, z]) {
            added[lane] = value as f32;
        }
    }
    for k in 0..3 {
        out[k] = out[k] + V::load(&added[k]);
    }
}
