//! The recorded path: a polyline on the ground, with positions along it.

/// A polyline with its length up to each point.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct Path {
    points_m: Vec<[f64; 3]>,
    lengths_m: Vec<f64>,
}

/// Where a position is relative to a path.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct PathPosition {
    /// Length of the path up to the nearest point, m.
    pub(crate) along_m: f64,
    /// Horizontal distance to that point, m.
    pub(crate) cross_track_m: f64,
}

/// Points of a path are at least this far apart, m: shorter pieces carry the sway of a walk.
const MIN_SPACING_M: f64 = 0.1;
/// How far behind and ahead of the position before it the nearest point is searched, m. Paths that
/// cross or return to themselves are followed in their order.
const WINDOW_M: [f64; 2] = [0.5, 1.5];
/// How far the window reaches beyond the longest step, m.
const BEYOND_STEP_M: f64 = 0.5;

impl Path {
    /// A path through points of which near ones are left out; the first and last remain.
    pub(crate) fn new(points_m: impl IntoIterator<Item = [f64; 3]>) -> Self {
        let mut path = Self::default();
        let mut skipped = None;
        for point in points_m {
            let is_near = |last: &[f64; 3]| horizontal_m(*last, point) < MIN_SPACING_M;
            if path.points_m.last().is_some_and(is_near) {
                skipped = Some(point);
                continue;
            }
            skipped = None;
            path.push(point);
        }
        if let Some(last) = skipped {
            path.push(last);
        }
        path
    }

    fn push(&mut self, point: [f64; 3]) {
        let length = match (self.points_m.last(), self.lengths_m.last()) {
            (Some(before), Some(length)) => length + horizontal_m(*before, point),
            _ => 0.0,
        };
        self.points_m.push(point);
        self.lengths_m.push(length);
    }

    /// Whether there is a piece to follow.
    pub(crate) fn is_empty(&self) -> bool {
        self.points_m.len() < 2
    }

    pub(crate) fn length_m(&self) -> f64 {
        self.lengths_m.last().copied().unwrap_or(0.0)
    }

    /// The point at a length, on the polyline.
    pub(crate) fn at(&self, along_m: f64) -> Option<[f64; 3]> {
        let piece = self.piece(along_m);
        let (a, b) = (self.points_m.get(piece)?, self.points_m.get(piece + 1)?);
        let length = self.lengths_m[piece + 1] - self.lengths_m[piece];
        let share = match length > 0.0 {
            true => ((along_m - self.lengths_m[piece]) / length).clamp(0.0, 1.0),
            false => 0.0,
        };
        Some(std::array::from_fn(|k| a[k] + share * (b[k] - a[k])))
    }

    /// The nearest position on the whole path.
    pub(crate) fn nearest(&self, at_m: [f64; 3]) -> Option<PathPosition> {
        self.nearest_within(at_m, [0.0, self.length_m()])
    }

    /// The nearest position around a known one, after a step of at most a length, m.
    pub(crate) fn follow(
        &self,
        at_m: [f64; 3],
        along_m: f64,
        max_step_m: f64,
    ) -> Option<PathPosition> {
        let [behind_m, ahead_m] = WINDOW_M.map(|window_m| window_m.max(max_step_m + BEYOND_STEP_M));
        self.nearest_within(at_m, [along_m - behind_m, along_m + ahead_m])
    }

    /// The nearest position between two lengths.
    fn nearest_within(&self, at_m: [f64; 3], [from_m, to_m]: [f64; 2]) -> Option<PathPosition> {
        if self.is_empty() {
            return None;
        }
        let mut best: Option<(f64, f64)> = None;
        for piece in self.piece(from_m)..=self.piece(to_m) {
            let (a, b) = (self.points_m[piece], self.points_m[piece + 1]);
            let along = [b[0] - a[0], b[1] - a[1]];
            let to = [at_m[0] - a[0], at_m[1] - a[1]];
            let squared = along[0] * along[0] + along[1] * along[1];
            let share = match squared > 0.0 {
                true => {
                    let share = (to[0] * along[0] + to[1] * along[1]) / squared;
                    let length = self.lengths_m[piece + 1] - self.lengths_m[piece];
                    let [low, high] =
                        [from_m, to_m].map(|end| (end - self.lengths_m[piece]) / length);
                    share
                        .clamp(0.0, 1.0)
                        .max(low)
                        .min(high.max(low))
                        .clamp(0.0, 1.0)
                }
                false => 0.0,
            };
            let offset = [to[0] - share * along[0], to[1] - share * along[1]];
            // Levels above each other count as far apart.
            let height = at_m[2] - (a[2] + share * (b[2] - a[2]));
            let distance = offset[0] * offset[0] + offset[1] * offset[1] + height * height;
            if best.is_none_or(|(least, _)| distance < least) {
                let length = self.lengths_m[piece + 1] - self.lengths_m[piece];
                best = Some((distance, self.lengths_m[piece] + share * length));
            }
        }
        let (_, along_m) = best?;
        let cross_track_m = horizontal_m(self.at(along_m)?, at_m);
        Some(PathPosition {
            along_m,
            cross_track_m,
        })
    }

    /// The piece that contains a length.
    fn piece(&self, along_m: f64) -> usize {
        let after = self.lengths_m.partition_point(|length| *length <= along_m);
        after
            .saturating_sub(1)
            .min(self.points_m.len().saturating_sub(2))
    }
}

/// Horizontal distance, m.
pub(crate) fn horizontal_m(a: [f64; 3], b: [f64; 3]) -> f64 {
    let [x, y] = [a[0] - b[0], a[1] - b[1]];
    (x * x + y * y).sqrt()
}

#[cfg(test)]
mod tests;
