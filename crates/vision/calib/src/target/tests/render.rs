//! Images of boards with known corners, by supersampling the board.

use boards::Target;

use crate::target::ImageView;

/// Samples per pixel along each axis.
const DENSE: usize = 5;

/// Pose of the board and model of the camera.
#[derive(Clone, Copy, Debug)]
pub(crate) struct View {
    pub(crate) size: [usize; 2],
    /// Focal length, pixels; the principal point is the image centre.
    pub(crate) focal: f64,
    pub(crate) lens: Lens,
    /// Middle of the board in the camera, metres.
    pub(crate) at: [f64; 3],
    /// Rotations about the camera's x, y, z in this order, radians.
    pub(crate) turn: [f64; 3],
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Lens {
    Pinhole,
    /// r = f θ
    Fisheye,
}

/// Degradation of the image.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Degradation {
    /// Gaussian blur, pixels.
    pub(crate) blur: f64,
    /// Uniform motion, pixels along x and y.
    pub(crate) motion: [f64; 2],
    /// Noise, grey values.
    pub(crate) noise: f64,
    /// Grey values of black and white.
    pub(crate) levels: [f64; 2],
    /// Whether levels are linear light, to be converted to sRGB.
    pub(crate) srgb: bool,
    /// Brightness change from the left to the right edge, as a fraction.
    pub(crate) shade: f64,
    pub(crate) background: f64,
    pub(crate) seed: u64,
}

impl Default for Degradation {
    fn default() -> Self {
        Self {
            blur: 0.7,
            motion: [0.0; 2],
            noise: 2.0,
            levels: [30.0, 210.0],
            srgb: false,
            shade: 0.0,
            background: 90.0,
            seed: 1,
        }
    }
}

impl View {
    pub(crate) fn new(size: [usize; 2], focal: f64, at: [f64; 3], turn: [f64; 3]) -> Self {
        Self {
            size,
            focal,
            lens: Lens::Pinhole,
            at,
            turn,
        }
    }

    fn rotation(&self) -> [[f64; 3]; 3] {
        let [(sx, cx), (sy, cy), (sz, cz)] = self.turn.map(f64::sin_cos);
        let x = [[1.0, 0.0, 0.0], [0.0, cx, -sx], [0.0, sx, cx]];
        let y = [[cy, 0.0, sy], [0.0, 1.0, 0.0], [-sy, 0.0, cy]];
        let z = [[cz, -sz, 0.0], [sz, cz, 0.0], [0.0, 0.0, 1.0]];
        let times = |a: [[f64; 3]; 3], b: [[f64; 3]; 3]| {
            [0, 1, 2].map(|i| [0, 1, 2].map(|j| (0..3).map(|k| a[i][k] * b[k][j]).sum()))
        };
        times(z, times(y, x))
    }

    fn middle(&self) -> [f64; 2] {
        self.size.map(|n| 0.5 * (n as f64 - 1.0))
    }

    /// Projection of a point given relative to the board's middle.
    fn project(&self, [x, y]: [f64; 2]) -> [f64; 2] {
        let r = self.rotation();
        let p = [0, 1, 2].map(|i| r[i][0] * x + r[i][1] * y + self.at[i]);
        let m = self.middle();
        match self.lens {
            Lens::Pinhole => [0, 1].map(|k| m[k] + self.focal * p[k] / p[2]),
            Lens::Fisheye => {
                let off = p[0].hypot(p[1]);
                let scale = if off > 1e-12 {
                    self.focal * off.atan2(p[2]) / off
                } else {
                    self.focal / p[2]
                };
                [0, 1].map(|k| m[k] + scale * p[k])
            }
        }
    }

    /// The point of a pixel, relative to the board's middle.
    fn read_expected(&self, pixel: [f64; 2], r: &[[f64; 3]; 3]) -> Option<[f64; 2]> {
        let m = self.middle();
        let [u, v] = [0, 1].map(|k| (pixel[k] - m[k]) / self.focal);
        let ray = match self.lens {
            Lens::Pinhole => [u, v, 1.0],
            Lens::Fisheye => {
                let angle = u.hypot(v);
                let s = if angle > 1e-12 {
                    angle.sin() / angle
                } else {
                    1.0
                };
                [u * s, v * s, angle.cos()]
            }
        };
        let along = |i: usize, p: [f64; 3]| r[0][i] * p[0] + r[1][i] * p[1] + r[2][i] * p[2];
        let depth = along(2, self.at) / along(2, ray);
        (depth > 0.0).then(|| [0, 1].map(|i| depth * along(i, ray) - along(i, self.at)))
    }

    fn board_middle(target: &Target) -> [f64; 2] {
        let sheet = target.sheet_m();
        [0, 1].map(|k| 0.5 * (sheet.min_m[k] + sheet.max_m[k]))
    }

    /// Positions of all corners of the board in the image, also those outside.
    pub(crate) fn truth(&self, target: &Target) -> Vec<(u32, [f64; 2])> {
        let middle = Self::board_middle(target);
        let project = |at: [f64; 2]| self.project([0, 1].map(|k| at[k] - middle[k]));
        target
            .corners()
            .iter()
            .map(|c| (c.id, project(c.at_m)))
            .collect()
    }

    /// An image of boards, each with its own view; the first one is on top.
    pub(crate) fn render(boards: &[(&Target, View)], look: &Degradation) -> RenderedImage {
        let size = boards[0].1.size;
        let [width, height] = size.map(|n| n + 2 * PAD);
        let [fine_width, fine_height] = [width * DENSE, height * DENSE];
        let mut fine = vec![look.background as f32; fine_width * fine_height];
        for (target, view) in boards.iter().rev() {
            let ink = Ink::of(target);
            let middle = Self::board_middle(target);
            let r = view.rotation();
            let row_at = |j: usize| -> Vec<Option<[f64; 2]>> {
                let pixel = |n: usize| (n as f64 + 0.5) / DENSE as f64 - 0.5 - PAD as f64;
                (0..=fine_width)
                    .map(|i| view.read_expected([pixel(i), pixel(j)], &r))
                    .collect()
            };
            let mut next = row_at(0);
            for (j, row) in fine.chunks_exact_mut(fine_width).enumerate() {
                let here = std::mem::replace(&mut next, row_at(j + 1));
                for (i, value) in row.iter_mut().enumerate() {
                    let (Some(at), Some(right), Some(below)) = (here[i], here[i + 1], next[i])
                    else {
                        continue;
                    };
                    let half = [0, 1]
                        .map(|k| 0.5 * (right[k] - at[k]).abs().max((below[k] - at[k]).abs()));
                    if let Some(white) = ink.at([0, 1].map(|k| at[k] + middle[k]), half) {
                        let [dark, bright] = look.levels.map(|v| v as f32);
                        *value = dark + white * (bright - dark);
                    }
                }
            }
        }
        let dense = DENSE as f64;
        let length = look.motion[0].hypot(look.motion[1]);
        if length > 0.0 {
            fine = moved(&fine, fine_width, look.motion.map(|v| v * dense));
        }
        if look.blur > 0.0 {
            fine = blurred(&fine, fine_width, look.blur * dense);
            fine = transposed(
                &blurred(
                    &transposed(&fine, fine_width),
                    fine_height,
                    look.blur * dense,
                ),
                fine_height,
            );
        }
        let mut random = Random(look.seed.wrapping_mul(0x9e37_79b9_7f4a_7c15) | 1);
        let mut pixels = Vec::with_capacity(size[0] * size[1]);
        for y in 0..size[1] {
            for x in 0..size[0] {
                let mut sum = 0.0f64;
                for dy in 0..DENSE {
                    let row = ((y + PAD) * DENSE + dy) * fine_width + (x + PAD) * DENSE;
                    sum += fine[row..row + DENSE]
                        .iter()
                        .map(|v| f64::from(*v))
                        .sum::<f64>();
                }
                let mut value = sum / (dense * dense);
                value *= 1.0 + look.shade * (x as f64 / size[0] as f64 - 0.5);
                if look.srgb {
                    let linear = (value / 255.0).clamp(0.0, 1.0);
                    value = 255.0
                        * if linear < 0.0031308 {
                            12.92 * linear
                        } else {
                            1.055 * linear.powf(1.0 / 2.4) - 0.055
                        };
                }
                value += look.noise * random.normal();
                pixels.push(value.round().clamp(0.0, 255.0) as u8);
            }
        }
        RenderedImage { size, pixels }
    }
}

/// Pixels rendered beyond the edge, for the blur.
const PAD: usize = 8;

pub(crate) struct RenderedImage {
    pub(crate) size: [usize; 2],
    pub(crate) pixels: Vec<u8>,
}

impl RenderedImage {
    pub(crate) fn view(&self) -> ImageView<'_> {
        ImageView::new(self.size[0], self.size[1], self.size[0], &self.pixels).unwrap()
    }

    pub(crate) fn mirrored(&self) -> Self {
        let pixels = self
            .pixels
            .chunks_exact(self.size[0])
            .flat_map(|row| row.iter().rev().copied())
            .collect();
        Self {
            size: self.size,
            pixels,
        }
    }

    pub(crate) fn inverted(&self) -> Self {
        Self {
            size: self.size,
            pixels: self.pixels.iter().map(|v| 255 - v).collect(),
        }
    }
}

/// The print, by the edges of the black rectangles.
struct Ink {
    edges: [Vec<f64>; 2],
    black: Vec<bool>,
    sheet: boards::Rectangle,
}

impl Ink {
    fn of(target: &Target) -> Self {
        let rectangles = target.black();
        let edges = [0, 1].map(|k| {
            let mut edges: Vec<f64> = rectangles
                .iter()
                .flat_map(|r| [r.min_m[k], r.max_m[k]])
                .collect();
            edges.sort_by(f64::total_cmp);
            edges.dedup_by(|a, b| (*a - *b).abs() < 1e-9);
            edges
        });
        let columns = edges[0].len();
        let mut black = vec![false; columns * edges[1].len()];
        for r in &rectangles {
            let range = |k: usize| {
                let index = |v: f64| edges[k].partition_point(|e| *e < v - 1e-9);
                index(r.min_m[k])..index(r.max_m[k])
            };
            for y in range(1) {
                for x in range(0) {
                    black[y * columns + x] = true;
                }
            }
        }
        Self {
            edges,
            black,
            sheet: target.sheet_m(),
        }
    }

    /// Fraction of white around a point, over a box of this half size; `None` off the sheet.
    fn at(&self, at: [f64; 2], half: [f64; 2]) -> Option<f32> {
        if !(0..2).all(|k| self.sheet.min_m[k] <= at[k] && at[k] < self.sheet.max_m[k]) {
            return None;
        }
        // Along each axis: the cell before the nearest edge, the cell behind it, and the latter's
        // fraction.
        let parts = [0, 1].map(|k| {
            let edges = &self.edges[k];
            let low = edges.partition_point(|e| *e <= at[k] - half[k]);
            let high = edges.partition_point(|e| *e <= at[k] + half[k]);
            let share = match low == high {
                true => 0.0,
                false => (at[k] + half[k] - edges[low]) / (2.0 * half[k]),
            };
            (low.checked_sub(1), high.checked_sub(1), share as f32)
        });
        let white = |x: Option<usize>, y: Option<usize>| match (x, y) {
            (Some(x), Some(y)) => f32::from(u8::from(!self.black[y * self.edges[0].len() + x])),
            _ => 1.0,
        };
        let [(x0, x1, u), (y0, y1, v)] = parts;
        let along = |y| (1.0 - u) * white(x0, y) + u * white(x1, y);
        Some((1.0 - v) * along(y0) + v * along(y1))
    }
}

fn blurred(values: &[f32], width: usize, sigma: f64) -> Vec<f32> {
    let reach = (4.0 * sigma).ceil() as isize;
    let kernel: Vec<f32> = (-reach..=reach)
        .map(|i| (-0.5 * (i as f64 / sigma).powi(2)).exp() as f32)
        .collect();
    let total: f32 = kernel.iter().sum();
    let mut out = vec![0.0; values.len()];
    let mut padded = vec![0.0; width + 2 * reach as usize];
    for (row, out) in values.chunks_exact(width).zip(out.chunks_exact_mut(width)) {
        padded[..reach as usize].fill(row[0]);
        padded[reach as usize..][..width].copy_from_slice(row);
        padded[reach as usize + width..].fill(row[width - 1]);
        for (k, weight) in kernel.iter().enumerate() {
            for (out, value) in out.iter_mut().zip(&padded[k..]) {
                *out += weight / total * value;
            }
        }
    }
    out
}

fn transposed(values: &[f32], width: usize) -> Vec<f32> {
    let height = values.len() / width;
    let mut out = vec![0.0; values.len()];
    for y in 0..height {
        for x in 0..width {
            out[x * height + y] = values[y * width + x];
        }
    }
    out
}

fn moved(values: &[f32], width: usize, by: [f64; 2]) -> Vec<f32> {
    let height = (values.len() / width) as isize;
    let count = (by[0].hypot(by[1]).ceil() as isize).max(1);
    let mut out = vec![0.0; values.len()];
    for step in 0..count {
        let part = (step as f64 + 0.5) / count as f64 - 0.5;
        let [dx, dy] = by.map(|v| (v * part).round() as isize);
        for y in 0..height {
            let from = (y + dy).clamp(0, height - 1) * width as isize;
            for x in 0..width as isize {
                let source = from + (x + dx).clamp(0, width as isize - 1);
                out[(y * width as isize + x) as usize] += values[source as usize] / count as f32;
            }
        }
    }
    out
}

/// xorshift64*
pub(crate) struct Random(pub(crate) u64);

impl Random {
    pub(crate) fn uniform(&mut self) -> f64 {
        self.0 ^= self.0 >> 12;
        self.0 ^= self.0 << 25;
        self.0 ^= self.0 >> 27;
        (self.0.wrapping_mul(0x2545_f491_4f6c_dd1d) >> 11) as f64 / (1u64 << 53) as f64
    }

    /// Box-Muller.
    pub(crate) fn normal(&mut self) -> f64 {
        let (a, b) = (self.uniform().max(1e-300), self.uniform());
        (-2.0 * a.ln()).sqrt() * (std::f64::consts::TAU * b).cos()
    }
}
