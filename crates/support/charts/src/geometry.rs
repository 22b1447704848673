//! Pixel geometry: clipping to a rectangle, and thinning to what pixels can show. Coordinates are
//! finite pixels, y down; every function keeps the order of its points.

use std::collections::BTreeSet;

pub(crate) type Point = (f64, f64);

/// An axis-aligned rectangle, `x0 <= x1` and `y0 <= y1`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Rect {
    pub(crate) x0: f64,
    pub(crate) y0: f64,
    pub(crate) x1: f64,
    pub(crate) y1: f64,
}

impl Rect {
    pub(crate) fn contains(&self, p: Point) -> bool {
        (self.x0..=self.x1).contains(&p.0) && (self.y0..=self.y1).contains(&p.1)
    }

    /// Area that two rectangles share.
    pub(crate) fn overlap(&self, other: &Rect) -> f64 {
        let w = self.x1.min(other.x1) - self.x0.max(other.x0);
        let h = self.y1.min(other.y1) - self.y0.max(other.y0);
        w.max(0.0) * h.max(0.0)
    }

    pub(crate) fn area(&self) -> f64 {
        (self.x1 - self.x0) * (self.y1 - self.y0)
    }

    fn clamp(&self, p: Point) -> Point {
        (p.0.clamp(self.x0, self.x1), p.1.clamp(self.y0, self.y1))
    }
}

/// The visible pieces of a polyline. A single point remains a piece of one.
pub(crate) fn clip_line(points: &[Point], rect: Rect) -> Vec<Vec<Point>> {
    if let &[only] = points {
        return if rect.contains(only) {
            vec![vec![only]]
        } else {
            Vec::new()
        };
    }
    let mut pieces: Vec<Vec<Point>> = Vec::new();
    for pair in points.windows(2) {
        let Some((a, b)) = clip_segment(pair[0], pair[1], rect) else {
            continue;
        };
        match pieces.last_mut() {
            Some(piece) if piece.last() == Some(&a) => piece.push(b),
            _ => pieces.push(vec![a, b]),
        }
    }
    pieces
}

/// Liang–Barsky: the part of a segment inside the rectangle.
fn clip_segment(a: Point, b: Point, rect: Rect) -> Option<(Point, Point)> {
    let (dx, dy) = (b.0 - a.0, b.1 - a.1);
    let (mut from, mut to) = (0.0_f64, 1.0_f64);
    let sides = [
        (-dx, a.0 - rect.x0),
        (dx, rect.x1 - a.0),
        (-dy, a.1 - rect.y0),
        (dy, rect.y1 - a.1),
    ];
    for (outward, room) in sides {
        if outward < 0.0 {
            from = from.max(room / outward);
        } else if outward > 0.0 {
            to = to.min(room / outward);
        } else if room < 0.0 {
            return None;
        }
    }
    // Ends inside stay exact; the clamp undoes roundings on segments far longer than the rectangle.
    let start = if from > 0.0 {
        (a.0 + from * dx, a.1 + from * dy)
    } else {
        a
    };
    let end = if to < 1.0 {
        (a.0 + to * dx, a.1 + to * dy)
    } else {
        b
    };
    (from <= to).then(|| (rect.clamp(start), rect.clamp(end)))
}

/// Sutherland–Hodgman: the part of a polygon inside the rectangle.
pub(crate) fn clip_polygon(mut points: Vec<Point>, rect: Rect) -> Vec<Point> {
    // How far a point lies inside each side.
    let sides: [fn(Point, Rect) -> f64; 4] = [
        |p, r| p.0 - r.x0,
        |p, r| r.x1 - p.0,
        |p, r| p.1 - r.y0,
        |p, r| r.y1 - p.1,
    ];
    for inside in sides {
        let mut kept = Vec::with_capacity(points.len());
        for (i, &b) in points.iter().enumerate() {
            let a = points[(i + points.len() - 1) % points.len()];
            let (da, db) = (inside(a, rect), inside(b, rect));
            if (da < 0.0) != (db < 0.0) {
                let t = da / (da - db);
                kept.push((a.0 + t * (b.0 - a.0), a.1 + t * (b.1 - a.1)));
            }
            if db >= 0.0 {
                kept.push(b);
            }
        }
        points = kept;
    }
    points.into_iter().map(|p| rect.clamp(p)).collect()
}

/// Of each run of more than two points in one pixel column, the lowest and the highest, in order.
/// The drawn line moves by less than a pixel and keeps every extreme.
pub(crate) fn thin(points: &[Point]) -> Vec<Point> {
    let mut out = Vec::new();
    for run in points.chunk_by(|a, b| a.0.floor() == b.0.floor()) {
        if run.len() <= 2 {
            out.extend(run);
            continue;
        }
        let (mut low, mut high) = (0, 0);
        for (i, p) in run.iter().enumerate() {
            if p.1 < run[low].1 {
                low = i;
            }
            if p.1 > run[high].1 {
                high = i;
            }
        }
        out.push(run[low.min(high)]);
        if low != high {
            out.push(run[low.max(high)]);
        }
    }
    out
}

/// The cells of a square grid of `size` pixels that hold a point, as vertical strokes
/// (top cell centre, length). For more points than can be distinguished.
pub(crate) fn cells(points: &[Point], size: f64) -> Vec<(Point, f64)> {
    let cell = |v: f64| (v / size).floor() as i64;
    let set: BTreeSet<(i64, i64)> = points.iter().map(|p| (cell(p.0), cell(p.1))).collect();
    let cells: Vec<_> = set.into_iter().collect();
    let stroke = |run: &[(i64, i64)]| {
        let (column, row) = run[0];
        (
            ((column as f64 + 0.5) * size, (row as f64 + 0.5) * size),
            (run.len() - 1) as f64 * size,
        )
    };
    cells
        .chunk_by(|a, b| a.0 == b.0 && a.1 + 1 == b.1)
        .map(stroke)
        .collect()
}

/// Runs of equal kind over `columns` pixel columns: (first column, length, kind). A span
/// `(from, to, kind)` in pixels covers at least one column; where spans meet the greatest kind
/// wins, so that what is short and bad is never hidden by what is long and good.
pub(crate) fn columns(
    spans: impl Iterator<Item = (f64, f64, usize)>,
    columns: usize,
) -> Vec<(usize, usize, usize)> {
    let mut painted: Vec<Option<usize>> = vec![None; columns];
    for (from, to, kind) in spans {
        if to < 0.0 || from > columns as f64 || columns == 0 {
            continue;
        }
        let first = (from.max(0.0).floor() as usize).min(columns - 1);
        let end = (to.ceil().max(0.0) as usize).clamp(first + 1, columns);
        for slot in &mut painted[first..end] {
            *slot = (*slot).max(Some(kind));
        }
    }
    let mut start = 0;
    let mut runs = Vec::new();
    for run in painted.chunk_by(|a, b| a == b) {
        if let Some(kind) = run[0] {
            runs.push((start, run.len(), kind));
        }
        start += run.len();
    }
    runs
}
