//! Map: the scene from above, cut above eye height, with the path and every footprint.

use nalgebra::Vector3;
use raster::{Canvas, Color};

use crate::scene::surface::Class;
use crate::simulation::{Simulation, seconds};
use crate::walker::gait::{HALF_WIDTH, HEEL_X, TOE_X};
use crate::walker::{Side, Walker};

/// Position of the widest part of a sole, m in front of its middle.
const SOLE_WIDEST_X_M: f64 = 0.07;
/// Margin around the path, m.
const PATH_MARGIN_M: f64 = 2.0;
/// Maximum height of the map relative to its width.
const MAX_HEIGHT_RATIO: f64 = 0.5;
/// Height of the cut above the chest, m: above cars and furniture, below ceilings.
const CUT_HEIGHT_M: f64 = 0.4;
/// Minimum height difference that is outlined, m.
const MIN_STEP_M: f64 = 0.03;
/// Maximum number of path points that determine the height of the cut.
const MAX_PATH_SAMPLES: usize = 200;

const LEFT: Color = [30, 80, 210];
const RIGHT: Color = [210, 40, 30];
const PATH_COLOR: Color = [60, 60, 60];
const INK_COLOR: Color = [0, 0, 0];

/// Projection from the world to the map.
pub(super) struct Projection {
    /// World coordinates of the top left pixel, m.
    corner: [f64; 2],
    /// Size of a pixel, m.
    pixel: f64,
    /// Whether the map is rotated: the world's x runs up instead of to the right.
    rotated: bool,
}

impl Projection {
    pub(super) fn px(&self, p: &Vector3<f64>) -> [f64; 2] {
        let (x, y) = (
            (p.x - self.corner[0]) / self.pixel,
            (self.corner[1] - p.y) / self.pixel,
        );
        match self.rotated {
            // A rotation by the other 180° would be upside down: the far end is up.
            true => [y, -x],
            false => [x, y],
        }
    }

    fn world(&self, [u, v]: [f64; 2]) -> [f64; 2] {
        let (x, y) = match self.rotated {
            true => (-v, u),
            false => (u, v),
        };
        [
            self.corner[0] + x * self.pixel,
            self.corner[1] - y * self.pixel,
        ]
    }
}

/// Draws the map, `width` pixels wide, and returns its projection. `marks` are instants to be
/// marked on the path, ns.
pub(super) fn draw(simulation: &Simulation, width: usize, marks: &[i64]) -> (Canvas, Projection) {
    let end_s = simulation.settings().seconds;
    let path: Vec<Vector3<f64>> = (0..=(20.0 * end_s) as usize)
        .map(|k| simulation.walker().rig(0.05 * k as f64).position)
        .collect();
    let (projection, height) = projection(&path, width);
    let mut canvas = Canvas::new(width, height, WHITE);
    paint_place(&mut canvas, simulation, &path, &projection);
    for pair in path.windows(2) {
        let ends = [projection.px(&pair[0]), projection.px(&pair[1])];
        canvas.line(&ends, 1.5, PATH_COLOR);
    }
    for (side, color) in [(Side::Left, LEFT), (Side::Right, RIGHT)] {
        let falls = simulation.walker().contacts(side).iter();
        for fall in falls.filter(|fall| fall.strike_s <= end_s) {
            // The outline of a shoe, from the heel round to the heel.
            let outline = [
                (HEEL_X, 0.5),
                (HEEL_X + 0.04, 0.75),
                (SOLE_WIDEST_X_M, 1.0),
                (TOE_X - 0.02, 0.7),
                (TOE_X, 0.2),
            ];
            let there = outline.iter().map(|&(x, y)| (x, y));
            let back = outline.iter().rev().map(|&(x, y)| (x, -y));
            let corners: Vec<[f64; 2]> = there
                .chain(back)
                .map(|(x, y)| {
                    let p = fall.rotation * Vector3::new(x, y * HALF_WIDTH, 0.0);
                    projection.px(&(fall.position + p))
                })
                .collect();
            canvas.convex(&corners, color);
        }
    }
    mark(&mut canvas, simulation.walker(), &projection, marks);
    let bar_m = if 1.0 / projection.pixel > 60.0 {
        1.0
    } else {
        5.0
    };
    let y = height as f64 - 12.0;
    canvas.line(
        &[[12.0, y], [12.0 + bar_m / projection.pixel, y]],
        3.0,
        INK_COLOR,
    );
    canvas.text([12, height - 30], 2, &format!("{bar_m} m"), INK_COLOR);
    (canvas, projection)
}

const WHITE: Color = [250, 250, 250];

/// A projection that shows the whole path, and the height of the map.
fn projection(path: &[Vector3<f64>], width: usize) -> (Projection, usize) {
    let start = (
        Vector3::repeat(f64::INFINITY),
        Vector3::repeat(f64::NEG_INFINITY),
    );
    let (low, high) = path
        .iter()
        .fold(start, |(low, high), p| (low.inf(p), high.sup(p)));
    let (middle, size) = (
        (low + high) * 0.5,
        (high - low).add_scalar(2.0 * PATH_MARGIN_M),
    );
    let rotated = size.y > size.x;
    let (across, up) = if rotated {
        (size.y, size.x)
    } else {
        (size.x, size.y)
    };
    let pixel = (across / width as f64).max(up / (MAX_HEIGHT_RATIO * width as f64));
    let height = (up / pixel).ceil() as usize;
    // The middle of the path is in the middle of the map.
    let (half_across, half_up) = (0.5 * width as f64 * pixel, 0.5 * height as f64 * pixel);
    let corner = match rotated {
        true => [middle.x + half_up, middle.y + half_across],
        false => [middle.x - half_across, middle.y + half_up],
    };
    let projection = Projection {
        corner,
        pixel,
        rotated,
    };
    (projection, height)
}

/// Draws the scene from above, each class in one color.
fn paint_place(
    canvas: &mut Canvas,
    simulation: &Simulation,
    path: &[Vector3<f64>],
    projection: &Projection,
) {
    let scene = simulation.scene();
    let points: Vec<&Vector3<f64>> = path
        .iter()
        .step_by(path.len().div_ceil(MAX_PATH_SAMPLES))
        .collect();
    let (width, height) = (canvas.width, canvas.height);
    let seen = |k: usize| {
        let [x, y] = projection.world([(k % width) as f64, (k / width) as f64]);
        let far = |p: &Vector3<f64>| (p.x - x) * (p.x - x) + (p.y - y) * (p.y - y);
        let near = points.iter().min_by(|a, b| far(a).total_cmp(&far(b)))?;
        let from = Vector3::new(x, y, near.z + CUT_HEIGHT_M);
        let hit = scene.first_hit(&from, &-Vector3::z())?;
        let material = scene.fixed.triangles[hit.triangle as usize].material;
        let class = scene.materials[material as usize].class;
        Some((color(class), from.z - hit.distance))
    };
    let seen: Vec<Option<(Color, f64)>> = (0..width * height).map(seen).collect();
    for (k, found) in seen.iter().enumerate() {
        let Some((color, z)) = *found else { continue };
        let step = |beside: usize| {
            let there = seen.get(beside).copied().flatten();
            there.is_some_and(|(_, other)| (other - z).abs() > MIN_STEP_M)
        };
        let is_edge = (k % width + 1 < width && step(k + 1)) || step(k + width);
        canvas.pixels[k] = match is_edge {
            true => color.map(|c| c / 2),
            false => color,
        };
    }
}

/// Marks instants by dots with an arrow in the chest's direction, and the time.
fn mark(canvas: &mut Canvas, walker: &Walker, projection: &Projection, marks: &[i64]) {
    for &time_ns in marks {
        let state = walker.rig(seconds(time_ns));
        let at = projection.px(&state.position);
        let ahead = state.position + state.rotation * (Vector3::x() * 0.6);
        canvas.line(&[at, projection.px(&ahead)], 3.0, INK_COLOR);
        canvas.disc(at, 5.0, INK_COLOR);
        let corner = at.map(|v| (v + 8.0).max(0.0) as usize);
        canvas.text(corner, 2, &format!("{:.1} s", seconds(time_ns)), INK_COLOR);
    }
}

fn color(class: Class) -> Color {
    match class {
        Class::Sky => WHITE,
        Class::Pavement => [214, 210, 202],
        Class::Road => [168, 168, 174],
        Class::Crosswalk => [240, 240, 240],
        Class::Grass => [196, 212, 168],
        Class::Stair => [228, 206, 172],
        Class::Wall => [120, 104, 98],
        Class::Obstacle => [186, 152, 116],
        Class::Person => [232, 170, 190],
        Class::Glass => [160, 206, 228],
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn whole_path_is_on_the_map_in_either_orientation() {
        for end in [[9.0, 2.0], [2.0, 9.0], [0.1, 0.1], [5.0, 5.0]] {
            let path = [
                Vector3::new(1.0, -3.0, 0.0),
                Vector3::new(1.0 + end[0], end[1] - 3.0, 0.0),
            ];
            let (projection, height) = projection(&path, 300);
            assert!((50..=150).contains(&height), "{end:?}: {height}");
            for p in &path {
                let px = projection.px(p);
                let margin = PATH_MARGIN_M / projection.pixel - 1.0;
                let sizes = [300.0, height as f64];
                for axis in 0..2 {
                    assert!(
                        px[axis] > margin && px[axis] < sizes[axis] - margin,
                        "{end:?}: {px:?}"
                    );
                }
                let back = projection.world(px);
                assert!((back[0] - p.x).abs() + (back[1] - p.y).abs() < 1e-9);
            }
            // Left remains left of forward: the map is not mirrored.
            let [o, x, y] =
                [Vector3::zeros(), Vector3::x(), Vector3::y()].map(|p| projection.px(&p));
            let turn = (x[0] - o[0]) * (y[1] - o[1]) - (x[1] - o[1]) * (y[0] - o[0]);
            assert!(turn < 0.0, "{end:?}");
        }
    }
}
