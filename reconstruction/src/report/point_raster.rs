//! Rasterizer of point clouds and meshes: each point is a square of its projected size, each
//! triangle is shaded by its slope, the nearest is in front.
//!
//! Contract: the same input gives the same image. It is rendered at twice its size and downsampled,
//! and darkened beside nearer points, so that edges and steps are visible (after Boucheny's
//! eye-dome lighting, 2009). Empty pixels are transparent, so that images suit light and dark
//! pages.

use scene_bundle::outputs::cloud::CloudPoint;

/// Supersampling factor along each side.
const SUPERSAMPLING: usize = 2;
/// Maximum side of a square, rendered px: points just before the camera would hide the rest.
const MAX_SQUARE_PX: i64 = 40;
/// Radius of the neighbourhood for shading, rendered px.
const SHADE_RADIUS_PX: usize = 3;
/// Empty pixel.
pub(super) const TRANSPARENT: [u8; 4] = [255, 255, 255, 0];
/// Radius of the dots of the path, rendered px.
const DOT_RADIUS_PX: i64 = 4;
/// Direction to the light of meshes, and the share of light from everywhere.
const LIGHT: [f64; 3] = [0.48, 0.36, 0.8];
const AMBIENT: f64 = 0.35;

/// Viewpoint of an image.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Viewpoint {
    /// Columns and rows of the image.
    pub(super) size: [usize; 2],
    /// Camera position, m.
    pub(super) eye: [f64; 3],
    /// Camera axes right, down, forward in the world; of length 1.
    pub(super) axes: [[f64; 3]; 3],
    /// Projection scale.
    pub(super) scale: Scale,
}

/// Projection scale.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Scale {
    /// Perspective with this focal length in px.
    Perspective(f64),
    /// Orthographic, px per m.
    Map(f64),
}

/// Projection of a point: rendered column and row, depth, rendered px per m.
struct Projection {
    at: [f64; 2],
    depth: f64,
    px_per_m: f64,
}

impl Viewpoint {
    fn project(&self, x_in_world: [f64; 3]) -> Option<Projection> {
        let away = [0, 1, 2].map(|k| x_in_world[k] - self.eye[k]);
        let [right, down, depth] = self.axes.map(|axis| dot(axis, away));
        let px_per_m = SUPERSAMPLING as f64
            * match self.scale {
                Scale::Perspective(focal_px) => focal_px / depth,
                Scale::Map(px_per_m) => px_per_m,
            };
        let middle = self.size.map(|n| 0.5 * (n * SUPERSAMPLING) as f64);
        (depth > 0.1).then(|| Projection {
            at: [middle[0] + right * px_per_m, middle[1] + down * px_per_m],
            depth,
            px_per_m,
        })
    }
}

pub(super) fn dot(a: [f64; 3], b: [f64; 3]) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

/// Image that is being rendered.
struct Canvas {
    width: usize,
    height: usize,
    colors: Vec<[u8; 3]>,
    depths: Vec<f32>,
}

/// Renders rows of RGBA. `edge_m` is the size of a point; dots of `rig_path` are on top.
pub(super) fn draw(
    points: &[CloudPoint],
    edge_m: f64,
    rig_path: &[([f64; 3], [u8; 3])],
    viewpoint: &Viewpoint,
) -> Vec<u8> {
    let mut canvas = Canvas::new(viewpoint);
    for point in points {
        if let Some(project) = viewpoint.project(point.x_in_world.map(f64::from)) {
            canvas.square(&project, edge_m, point.color);
        }
    }
    canvas.finish(rig_path, viewpoint)
}

/// Renders rows of RGBA of triangles, each with its color; dots of `rig_path` are on top.
pub(super) fn draw_mesh(
    triangles: impl Iterator<Item = ([[f64; 3]; 3], [u8; 3])>,
    rig_path: &[([f64; 3], [u8; 3])],
    viewpoint: &Viewpoint,
) -> Vec<u8> {
    let mut canvas = Canvas::new(viewpoint);
    for (corners, color) in triangles {
        if let [Some(a), Some(b), Some(c)] = corners.map(|corner| viewpoint.project(corner)) {
            canvas.triangle([a, b, c], lit(&corners, color));
        }
    }
    canvas.finish(rig_path, viewpoint)
}

/// The color of a triangle, lit from either side.
fn lit(corners: &[[f64; 3]; 3], color: [u8; 3]) -> [u8; 3] {
    let [a, b, c] = corners.map(nalgebra::Vector3::from);
    let normal = (b - a).cross(&(c - a));
    let light = nalgebra::Vector3::from(LIGHT);
    let cosine = normal.dot(&light).abs() / normal.norm().max(f64::MIN_POSITIVE);
    let light = AMBIENT + (1.0 - AMBIENT) * cosine.min(1.0);
    color.map(|part| (f64::from(part) * light).round() as u8)
}

impl Canvas {
    fn new(viewpoint: &Viewpoint) -> Self {
        let [width, height] = viewpoint.size.map(|n| n * SUPERSAMPLING);
        Self {
            width,
            height,
            colors: vec![[0; 3]; width * height],
            depths: vec![f32::INFINITY; width * height],
        }
    }

    /// Shades, draws the path on top, and downsamples.
    fn finish(mut self, rig_path: &[([f64; 3], [u8; 3])], viewpoint: &Viewpoint) -> Vec<u8> {
        self.shade(matches!(viewpoint.scale, Scale::Map(_)));
        for (x_in_world, color) in rig_path {
            if let Some(project) = viewpoint.project(*x_in_world) {
                self.dot(&project, *color);
            }
        }
        self.downsample()
    }

    /// All pixels with their centers in a triangle, by barycentric coordinates.
    fn triangle(&mut self, corners: [Projection; 3], color: [u8; 3]) {
        let [a, b, c] = [0, 1, 2].map(|k| corners[k].at);
        let area = |p: [f64; 2], q: [f64; 2], r: [f64; 2]| {
            (q[0] - p[0]) * (r[1] - p[1]) - (q[1] - p[1]) * (r[0] - p[0])
        };
        let whole = area(a, b, c);
        if whole == 0.0 {
            return;
        }
        let range = |k: usize, size: usize| {
            let of = [a[k], b[k], c[k]];
            let low = of
                .into_iter()
                .fold(f64::INFINITY, f64::min)
                .floor()
                .max(0.0);
            let high = of.into_iter().fold(f64::NEG_INFINITY, f64::max).ceil();
            low as usize..(high.max(0.0) as usize).min(size)
        };
        for y in range(1, self.height) {
            for x in range(0, self.width) {
                let at = [x as f64 + 0.5, y as f64 + 0.5];
                let shares = [area(at, b, c), area(a, at, c), area(a, b, at)].map(|s| s / whole);
                if shares.iter().any(|share| *share < 0.0) {
                    continue;
                }
                let depth: f64 = (0..3).map(|k| shares[k] * corners[k].depth).sum();
                let i = y * self.width + x;
                if (depth as f32) < self.depths[i] {
                    (self.depths[i], self.colors[i]) = (depth as f32, color);
                }
            }
        }
    }

    fn square(&mut self, project: &Projection, edge_m: f64, color: [u8; 3]) {
        let side = ((edge_m * project.px_per_m).ceil() as i64).clamp(1, MAX_SQUARE_PX);
        let from = project.at.map(|c| (c - 0.5 * side as f64).round() as i64);
        let columns = from[0].max(0)..(from[0] + side).min(self.width as i64);
        let depth = project.depth as f32;
        for y in from[1].max(0)..(from[1] + side).min(self.height as i64) {
            for x in columns.clone() {
                let i = y as usize * self.width + x as usize;
                if depth < self.depths[i] {
                    (self.depths[i], self.colors[i]) = (depth, color);
                }
            }
        }
    }

    fn dot(&mut self, project: &Projection, color: [u8; 3]) {
        let [x, y] = project.at.map(|c| c.round() as i64);
        for (dx, dy) in (-DOT_RADIUS_PX..=DOT_RADIUS_PX)
            .flat_map(|dx| (-DOT_RADIUS_PX..=DOT_RADIUS_PX).map(move |dy| (dx, dy)))
        {
            let (x, y) = (x + dx, y + dy);
            let inside =
                (0..self.width as i64).contains(&x) && (0..self.height as i64).contains(&y);
            if inside && dx * dx + dy * dy <= DOT_RADIUS_PX * DOT_RADIUS_PX {
                let i = y as usize * self.width + x as usize;
                (self.depths[i], self.colors[i]) = (project.depth as f32, color);
            }
        }
    }

    /// Darkens pixels beside nearer ones. On a map nearer means higher, by metres; else by a ratio
    /// of the depth.
    fn shade(&mut self, is_map: bool) {
        let near = |a: f32, b: f32| match is_map {
            true => (a - b).clamp(0.0, 0.6),
            false => (8.0 * (a / b).ln()).clamp(0.0, 0.6),
        };
        for y in SHADE_RADIUS_PX..self.height.saturating_sub(SHADE_RADIUS_PX) {
            for x in SHADE_RADIUS_PX..self.width.saturating_sub(SHADE_RADIUS_PX) {
                let i = y * self.width + x;
                let depth = self.depths[i];
                if !depth.is_finite() {
                    continue;
                }
                let around = [
                    i - SHADE_RADIUS_PX,
                    i + SHADE_RADIUS_PX,
                    i - SHADE_RADIUS_PX * self.width,
                    i + SHADE_RADIUS_PX * self.width,
                ];
                let dark: f32 = around.iter().map(|k| near(depth, self.depths[*k])).sum();
                let light = (-0.5 * dark).exp();
                self.colors[i] = self.colors[i].map(|c| (f32::from(c) * light) as u8);
            }
        }
    }

    /// Mean of each block of rendered pixels, as RGBA.
    fn downsample(&self) -> Vec<u8> {
        let (columns, rows) = (self.width / SUPERSAMPLING, self.height / SUPERSAMPLING);
        let mut out = Vec::with_capacity(4 * columns * rows);
        for (row, column) in (0..rows).flat_map(|row| (0..columns).map(move |c| (row, c))) {
            let mut sum = [0_usize; 3];
            let mut drawn = 0;
            for k in 0..SUPERSAMPLING * SUPERSAMPLING {
                let (y, x) = (
                    row * SUPERSAMPLING + k / SUPERSAMPLING,
                    column * SUPERSAMPLING + k % SUPERSAMPLING,
                );
                let i = y * self.width + x;
                if !self.depths[i].is_finite() {
                    continue;
                }
                drawn += 1;
                for (sum, part) in sum.iter_mut().zip(self.colors[i]) {
                    *sum += usize::from(part);
                }
            }
            match drawn {
                0 => out.extend(TRANSPARENT),
                _ => out.extend(sum.map(|sum| (sum / drawn) as u8)),
            }
            if drawn > 0 {
                out.push((255 * drawn / (SUPERSAMPLING * SUPERSAMPLING)) as u8);
            }
        }
        out
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn point(x: [f32; 3], color: [u8; 3]) -> CloudPoint {
        CloudPoint {
            x_in_world: x,
            color,
            sigma_m: 0.01,
        }
    }

    /// View along x, with z up.
    fn ahead() -> Viewpoint {
        Viewpoint {
            size: [40, 30],
            eye: [0.0; 3],
            axes: [[0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]],
            scale: Scale::Perspective(40.0),
        }
    }

    fn pixel(image: &[u8], x: usize, y: usize) -> [u8; 4] {
        let i = 4 * (y * 40 + x);
        [0, 1, 2, 3].map(|k| image[i + k])
    }

    #[test]
    fn the_nearest_point_is_in_front_whatever_the_order() {
        let near = point([2.0, 0.0, 0.0], [200, 0, 0]);
        let far = point([4.0, 0.0, 0.0], [0, 200, 0]);
        for points in [[near, far], [far, near]] {
            let image = draw(&points, 0.3, &[], &ahead());
            assert_eq!(pixel(&image, 20, 15), [200, 0, 0, 255]);
            assert_eq!(pixel(&image, 2, 2), TRANSPARENT);
        }
    }

    #[test]
    fn triangles_cover_what_is_behind_them() {
        let wall = |x: f64, color: [u8; 3]| {
            let corner = |y: f64, z: f64| [x, y, z];
            (
                [corner(1.0, -1.0), corner(-1.0, -1.0), corner(0.0, 1.0)],
                color,
            )
        };
        for order in [[0, 1], [1, 0]] {
            let walls = [wall(2.0, [200, 0, 0]), wall(3.0, [0, 200, 0])];
            let image = draw_mesh(order.map(|k| walls[k]).into_iter(), &[], &ahead());
            let [red, green, blue, alpha] = pixel(&image, 20, 15);
            // Its cosine to the light is 0.48.
            assert_eq!((green, blue, alpha), (0, 0, 255));
            assert_eq!(red, (200.0 * (0.35 + 0.65 * 0.48_f64)).round() as u8);
            assert_eq!(pixel(&image, 2, 2), TRANSPARENT);
        }
    }

    #[test]
    fn points_are_projected_to_the_right_pixels() {
        // Left and up.
        let image = draw(&[point([4.0, 1.0, 0.5], [0, 0, 200])], 0.3, &[], &ahead());
        assert_eq!(pixel(&image, 10, 10), [0, 0, 200, 255]);
        // Behind the camera.
        let image = draw(&[point([-4.0, 0.0, 0.0], [0; 3])], 0.3, &[], &ahead());
        assert!(image.chunks(4).all(|c| c == TRANSPARENT));
        let map = Viewpoint {
            scale: Scale::Map(10.0),
            ..ahead()
        };
        let image = draw(&[], 0.3, &[([7.0, -1.0, 0.0], [9; 3])], &map);
        assert_eq!(pixel(&image, 30, 15)[..3], [9; 3]);
    }
}
