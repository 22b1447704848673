//! Places texts where they cover the least: each takes the best of a few candidate positions, given
//! everything placed before it. First come, first served; good enough for some dozens of labels.

use crate::geometry::{Point, Rect};
use crate::svg::text_width;

pub(crate) const SIZE: f64 = 11.0;

#[derive(Debug)]
pub(crate) struct Placer {
    bounds: Rect,
    taken: Vec<Rect>,
    dots: Vec<Point>,
}

impl Placer {
    pub(crate) fn new(bounds: Rect) -> Self {
        Self {
            bounds,
            taken: Vec::new(),
            dots: Vec::new(),
        }
    }

    /// A polyline that labels should not cover.
    pub(crate) fn avoid_line(&mut self, points: &[Point]) {
        self.dots.extend(points);
        for pair in points.windows(2) {
            let (dx, dy) = (pair[1].0 - pair[0].0, pair[1].1 - pair[0].1);
            let n = (dx.hypot(dy) / 5.0).ceil().min(400.0);
            self.dots.extend(
                (1..n as usize)
                    .map(|i| (pair[0].0 + dx * i as f64 / n, pair[0].1 + dy * i as f64 / n)),
            );
        }
    }

    /// A rectangle that labels should not cover.
    pub(crate) fn avoid(&mut self, rect: Rect) {
        self.taken.push(rect);
    }

    /// A label beside a point.
    pub(crate) fn beside(&mut self, (x, y): Point, text: &str) -> Point {
        let w = text_width(text, SIZE);
        let (right, left, middle) = (x + 8.0, x - 8.0 - w, x - w / 2.0);
        let (above, below, level) = (y - 8.0, y + 8.0 + SIZE, y + 4.0);
        self.place(
            text,
            &[
                (right, level),
                (middle, above),
                (left, level),
                (middle, below),
                (x + 5.0, y - 5.0),
                (x - 5.0 - w, y - 5.0),
                (x + 5.0, y + 4.0 + SIZE),
                (x - 5.0 - w, y + 4.0 + SIZE),
                (right, above - 8.0),
                (left, above - 8.0),
                (right, below + 8.0),
                (left, below + 8.0),
            ],
        )
    }

    /// Takes the best of the baseline starts and returns it.
    pub(crate) fn place(&mut self, text: &str, starts: &[Point]) -> Point {
        let width = text_width(text, SIZE);
        let rect = |(x, y): Point| Rect {
            x0: x - 1.0,
            y0: y - SIZE + 1.0,
            x1: x + width + 1.0,
            y1: y + 3.0,
        };
        let cost = |start: Point| {
            let r = rect(start);
            let outside = r.area() - r.overlap(&self.bounds);
            let texts: f64 = self.taken.iter().map(|t| t.overlap(&r)).sum();
            let dots = self.dots.iter().filter(|dot| r.contains(**dot)).count();
            outside * 20.0 + texts * 10.0 + dots as f64 * 8.0
        };
        let mut best = (f64::INFINITY, self.bounds_start());
        for (preference, &start) in starts.iter().enumerate() {
            let cost = cost(start) + preference as f64;
            if cost < best.0 {
                best = (cost, start);
            }
        }
        // The last resort for a label at the rim: inside, whatever it covers.
        let (x, y) = best.1;
        let x = x.clamp(
            self.bounds.x0 + 1.0,
            (self.bounds.x1 - width - 1.0).max(self.bounds.x0 + 1.0),
        );
        let y = y.clamp(
            self.bounds.y0 + SIZE,
            (self.bounds.y1 - 3.0).max(self.bounds.y0 + SIZE),
        );
        self.taken.push(rect((x, y)));
        (x, y)
    }

    fn bounds_start(&self) -> Point {
        (self.bounds.x0, self.bounds.y0 + SIZE)
    }
}
