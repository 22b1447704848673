//! Rasterizer: the visible triangle of each pixel.
//!
//! Contract: triangles that share corners leave no crack and claim no pixel twice; the result does
//! not depend on the order of triangles unless two are coplanar. Corners are projected through the
//! full lens model. An edge that distortion bends by more than `MAX_CHORD_ERROR_PX` is split, which
//! bounds the error of outlines; within an outline a pixel is computed from its exact ray
//! ([`super::shade`]), without this approximation.

use crate::lens::Lens;
use crate::scene::body::Body;

/// No triangle: the sky.
pub const NOTHING: u32 = u32::MAX;

/// Near plane, m.
const MIN_DEPTH_M: f32 = 0.03;
/// Shorter edges are not split, px.
const MIN_SPLIT_EDGE_PX: f32 = 24.0;
/// Maximum deviation of an edge from its chord, px.
const MAX_CHORD_ERROR_PX: f32 = 0.1;
/// Margin outside the image within which triangles are drawn, for edges that distortion bends, px.
const MARGIN_PX: f32 = 16.0;

/// Pose of a camera in a body's frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct View {
    /// Rows of the rotation that maps vectors of the body's frame to the optical frame.
    pub rotation: [[f32; 3]; 3],
    /// Optical centre in the body's frame, m.
    pub origin: [f32; 3],
}

impl View {
    /// A point of the body in the optical frame.
    #[inline(always)]
    pub fn apply(&self, p: [f32; 3]) -> [f32; 3] {
        let d = [0, 1, 2].map(|i| p[i] - self.origin[i]);
        self.turn(d)
    }

    /// A vector of the body in the optical frame.
    #[inline(always)]
    pub fn turn(&self, d: [f32; 3]) -> [f32; 3] {
        self.rotation
            .map(|row| row[0] * d[0] + row[1] * d[1] + row[2] * d[2])
    }
}

/// Visible triangle of each pixel, row-major.
#[derive(Clone, Debug)]
pub struct Visibility {
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Number of the triangle, or [`NOTHING`].
    pub triangle: Vec<u32>,
    /// Inverse depth along z, 1/m; 0 for nothing.
    inverse_depth: Vec<f32>,
    frustum: Frustum,
    projected: Vec<Corner>,
}

/// A projected corner.
#[derive(Clone, Copy, Debug, Default)]
struct Corner {
    /// Position in the optical frame, m.
    at: [f32; 3],
    x: f32,
    y: f32,
    /// 1 / z.
    w: f32,
}

/// Projects points of one body.
struct Projector<'a> {
    lens: &'a Lens,
    shift: (f32, f32),
    /// One view for all rows, or one per row.
    views: &'a [View],
}

impl Projector<'_> {
    /// Projects a point of the body.
    fn corner(&self, p: [f32; 3]) -> Corner {
        let mut found = self.flat(self.views[self.views.len() / 2].apply(p));
        if self.views.len() > 1 {
            // With a rolling shutter each row has its own time.
            for _ in 0..2 {
                let last = self.views.len() - 1;
                let row = match found.at[2] > MIN_DEPTH_M {
                    true => found.y.clamp(0.0, last as f32) as usize,
                    false => self.views.len() / 2,
                };
                found = self.flat(self.views[row].apply(p));
            }
        }
        found
    }

    /// Projects a point of the optical frame.
    fn flat(&self, at: [f32; 3]) -> Corner {
        if at[2] < MIN_DEPTH_M {
            return Corner {
                at,
                ..Corner::default()
            };
        }
        let w = 1.0 / at[2];
        let (x, y) = self.lens.project_f32(at[0] * w, at[1] * w);
        Corner {
            at,
            x: x - self.shift.0,
            y: y - self.shift.1,
            w,
        }
    }
}

impl Visibility {
    /// An empty buffer for a lens.
    pub fn new(lens: &Lens) -> Self {
        let model = lens.model();
        let (width, height) = (model.width as usize, model.height as usize);
        Self {
            frustum: Frustum::of(lens),
            width,
            height,
            triangle: vec![NOTHING; width * height],
            inverse_depth: vec![0.0; width * height],
            projected: Vec::new(),
        }
    }

    /// Whether any part of a body may be visible.
    pub(crate) fn may_see(&self, body: &Body, views: &[View]) -> bool {
        let mut chunks = body.chunks.iter();
        chunks.any(|chunk| self.frustum.may_see(views, chunk.center, chunk.radius))
    }

    /// Clears the buffer.
    pub fn clear(&mut self) {
        self.triangle.fill(NOTHING);
        self.inverse_depth.fill(0.0);
    }

    /// Draws a body whose triangles are numbered from `first`. `views` is one view for all rows or
    /// one for each; pixel centers are offset by `shift` px.
    pub fn draw(
        &mut self,
        body: &Body,
        first: u32,
        lens: &Lens,
        shift: (f32, f32),
        views: &[View],
    ) {
        let projector = Projector { lens, shift, views };
        let mut projected = std::mem::take(&mut self.projected);
        for chunk in &body.chunks {
            if !self.frustum.may_see(views, chunk.center, chunk.radius) {
                continue;
            }
            projected.clear();
            projected.extend(chunk.corners.iter().map(|&p| projector.corner(p)));
            for (i, corners) in chunk.triangles.iter().enumerate() {
                let [a, b, c] = corners.map(|k| projected[k as usize]);
                self.triangle(&projector, a, b, c, first + chunk.first + i as u32);
            }
        }
        self.projected = projected;
    }

    /// Whether this has a surface at a pixel that is nearer than that of `other`.
    #[inline]
    pub(crate) fn is_nearer(&self, other: &Self, pixel: usize) -> bool {
        self.inverse_depth[pixel] > other.inverse_depth[pixel]
    }

    fn triangle(
        &mut self,
        projector: &Projector<'_>,
        a: Corner,
        b: Corner,
        c: Corner,
        number: u32,
    ) {
        let behind = [a, b, c].map(|p| p.at[2] < MIN_DEPTH_M);
        match behind {
            [false, false, false] => self.bent(projector, a, b, c, number, 0),
            [true, true, true] => {}
            _ => {
                // Clipping by Sutherland and Hodgman 1974, at the near plane only.
                let mut kept = [Corner::default(); 4];
                let mut count = 0;
                for (p, q) in [(a, b), (b, c), (c, a)] {
                    let (inside, next) = (p.at[2] >= MIN_DEPTH_M, q.at[2] >= MIN_DEPTH_M);
                    if inside {
                        kept[count] = p;
                        count += 1;
                    }
                    if inside != next {
                        let t = (MIN_DEPTH_M - p.at[2]) / (q.at[2] - p.at[2]);
                        let mut at = [0, 1, 2].map(|i| p.at[i] + (q.at[i] - p.at[i]) * t);
                        at[2] = MIN_DEPTH_M;
                        kept[count] = projector.flat(at);
                        count += 1;
                    }
                }
                for i in 2..count {
                    self.bent(projector, kept[0], kept[i - 1], kept[i], number, 0);
                }
            }
        }
    }

    /// Splits edges that distortion bends. Each edge is decided independently, so neighbors agree.
    fn bent(
        &mut self,
        projector: &Projector<'_>,
        a: Corner,
        b: Corner,
        c: Corner,
        number: u32,
        depth: u32,
    ) {
        let (right, below) = (
            self.width as f32 + MARGIN_PX,
            self.height as f32 + MARGIN_PX,
        );
        let all = |out: fn(&Corner, f32) -> bool, limit: f32| {
            out(&a, limit) && out(&b, limit) && out(&c, limit)
        };
        if all(|p, l| p.x < l, -MARGIN_PX)
            || all(|p, l| p.x > l, right)
            || all(|p, l| p.y < l, -MARGIN_PX)
            || all(|p, l| p.y > l, below)
        {
            return;
        }
        let middle = |p: &Corner, q: &Corner| -> Option<Corner> {
            let (dx, dy) = (q.x - p.x, q.y - p.y);
            let square = dx * dx + dy * dy;
            if square < MIN_SPLIT_EDGE_PX * MIN_SPLIT_EDGE_PX || depth >= 8 {
                return None;
            }
            let m = projector.flat([0, 1, 2].map(|i| 0.5 * (p.at[i] + q.at[i])));
            let off = (m.x - p.x) * dy - (m.y - p.y) * dx;
            (off * off > MAX_CHORD_ERROR_PX * MAX_CHORD_ERROR_PX * square).then_some(m)
        };
        let mids = [middle(&a, &b), middle(&b, &c), middle(&c, &a)];
        let mut next = |a, b, c| self.bent(projector, a, b, c, number, depth + 1);
        match mids {
            [None, None, None] => self.fill(a, b, c, number),
            [Some(ab), None, None] => {
                next(a, ab, c);
                next(ab, b, c);
            }
            [None, Some(bc), None] => {
                next(a, b, bc);
                next(a, bc, c);
            }
            [None, None, Some(ca)] => {
                next(a, b, ca);
                next(ca, b, c);
            }
            [Some(ab), Some(bc), None] => {
                next(ab, b, bc);
                next(a, ab, bc);
                next(a, bc, c);
            }
            [None, Some(bc), Some(ca)] => {
                next(ca, bc, c);
                next(a, b, bc);
                next(a, bc, ca);
            }
            [Some(ab), None, Some(ca)] => {
                next(a, ab, ca);
                next(ab, b, c);
                next(ab, c, ca);
            }
            [Some(ab), Some(bc), Some(ca)] => {
                next(a, ab, ca);
                next(ab, b, bc);
                next(ca, bc, c);
                next(ab, bc, ca);
            }
        }
    }

    /// Claims the pixels whose centers are inside and that have no nearer surface.
    fn fill(&mut self, a: Corner, b: Corner, c: Corner, number: u32) {
        // Rows grow downwards: counter-clockwise from outside has this sign.
        let area = (b.x - a.x) * (c.y - a.y) - (c.x - a.x) * (b.y - a.y);
        if area >= 0.0 {
            return;
        }
        let mut sorted = [a, b, c];
        sorted.sort_unstable_by(|p, q| p.y.total_cmp(&q.y).then(p.x.total_cmp(&q.x)));
        let [top, mid, low] = sorted;
        let first = ceil(top.y).max(0);
        let end = ceil(low.y).min(self.height as i32);
        if first >= end {
            return;
        }
        // 1/z is linear in the image.
        let (bw, cw) = (b.w - a.w, c.w - a.w);
        let w_x = (bw * (c.y - a.y) - cw * (b.y - a.y)) / area;
        let w_y = (cw * (b.x - a.x) - bw * (c.x - a.x)) / area;
        let slope = |p: &Corner, q: &Corner| (q.x - p.x) / (q.y - p.y);
        let long = slope(&top, &low);
        let upper = slope(&top, &mid);
        let lower = slope(&mid, &low);
        let mid_row = ceil(mid.y);
        // Side of the middle corner.
        let is_left = (mid.x - top.x) * (low.y - top.y) < (low.x - top.x) * (mid.y - top.y);
        for row in first..end {
            let y = row as f32;
            let straight = top.x + (y - top.y) * long;
            let broken = match row < mid_row {
                true => top.x + (y - top.y) * upper,
                false => mid.x + (y - mid.y) * lower,
            };
            let (left, right) = match is_left {
                true => (broken, straight),
                false => (straight, broken),
            };
            let from = ceil(left).max(0);
            let to = ceil(right).min(self.width as i32);
            if from >= to {
                continue;
            }
            let start = row as usize * self.width;
            let range = start + from as usize..start + to as usize;
            let mut w = a.w + (from as f32 - a.x) * w_x + (y - a.y) * w_y;
            let depths = &mut self.inverse_depth[range.clone()];
            for (depth, seen) in depths.iter_mut().zip(&mut self.triangle[range]) {
                let nearer = w > *depth;
                *depth = if nearer { w } else { *depth };
                *seen = if nearer { number } else { *seen };
                w += w_x;
            }
        }
    }
}

/// `x` rounded up, saturating; without a call into the math library.
#[inline]
fn ceil(x: f32) -> i32 {
    let whole = x as i32;
    whole.saturating_add(i32::from(whole as f32 != x && x > whole as f32))
}

/// Viewing frustum: inward unit normals of its four sides.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Frustum {
    sides: [[f32; 3]; 4],
}

impl Frustum {
    /// Frustum of a lens.
    pub(crate) fn of(lens: &Lens) -> Self {
        let [x0, y0, x1, y1] = lens.bounds();
        let side = |n: [f64; 3]| {
            let length = (n[0] * n[0] + n[1] * n[1] + n[2] * n[2]).sqrt();
            n.map(|v| (v / length) as f32)
        };
        Self {
            sides: [
                side([1.0, 0.0, -x0]),
                side([-1.0, 0.0, x1]),
                side([0.0, 1.0, -y0]),
                side([0.0, -1.0, y1]),
            ],
        }
    }

    /// Whether a sphere may be visible in the first, middle or last view.
    pub(crate) fn may_see(&self, views: &[View], center: [f32; 3], radius: f32) -> bool {
        let last = views.len() - 1;
        let near = |row: usize| self.may_see_in(views[row].apply(center), radius);
        near(last / 2) || last > 0 && (near(0) || near(last))
    }

    /// `center` in the optical frame.
    fn may_see_in(&self, [x, y, z]: [f32; 3], radius: f32) -> bool {
        let ahead = z > MIN_DEPTH_M - radius;
        let inside = |n: &[f32; 3]| n[0] * x + n[1] * y + n[2] * z > -radius;
        ahead && self.sides.iter().all(inside)
    }
}
