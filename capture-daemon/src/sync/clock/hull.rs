//! Lower convex hulls of (device time, lag) points, in blocks.
//!
//! Only points on the lower convex hull can touch a line that is below all points, so a block of
//! samples may discard all the others: for any line fitted later, the lowest sample of the block
//! above it is still known exactly.

/// One sample: device time since the epoch's first sample, and how much later than that it
/// arrived. Both ns. Within a session both are exact in an `f64` (below 2^53 ns = 104 days).
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Point {
    /// Device time since the epoch's origin, ns.
    pub x: f64,
    /// Host time since the epoch's origin, minus `x`, ns.
    pub lag: f64,
}

/// Whether `b` lies strictly below the chord from `a` to `c`, `b.x` being between theirs.
fn below(a: Point, b: Point, c: Point) -> bool {
    let along = (b.x - a.x) / (c.x - a.x);
    b.lag < a.lag + along * (c.lag - a.lag)
}

/// Adds a point to the lower hull of points sorted by `x`, rising or falling; `p` must be beyond
/// the last one. Returns with `p` at the end. Amortised O(1).
pub(super) fn extend(hull: &mut Vec<Point>, p: Point) {
    while let [.., a, b] = hull[..] {
        if below(a, b, p) {
            break;
        }
        hull.pop();
    }
    hull.push(p);
}

/// Maximum number of hull points in a block. Of n samples with random latencies about ln n are on
/// the hull; a block that fills up closes early.
const MAX_BLOCK_HULL: usize = 8;

/// A run of consecutive samples, of which only the lower hull is stored.
#[derive(Clone, Debug, Default)]
pub(super) struct Block {
    hull: [Point; MAX_BLOCK_HULL],
    len: usize,
    /// Number of samples.
    pub count: u32,
    x_sum: f64,
    lag_sum: f64,
    first_x: f64,
    last_x: f64,
}

impl Block {
    /// A block with one sample.
    pub(super) fn starting(p: Point) -> Self {
        let mut block = Self {
            first_x: p.x,
            ..Self::default()
        };
        block.push(p);
        block
    }

    /// Adds a sample to the right of all others. The block must not be full.
    pub(super) fn push(&mut self, p: Point) {
        while self.len >= 2 && !below(self.hull[self.len - 2], self.hull[self.len - 1], p) {
            self.len -= 1;
        }
        self.hull[self.len] = p;
        self.len += 1;
        self.count += 1;
        self.x_sum += p.x;
        self.lag_sum += p.lag;
        self.last_x = p.x;
    }

    /// Whether another sample might not find room.
    pub(super) fn is_full(&self) -> bool {
        self.len == MAX_BLOCK_HULL
    }

    /// The lower hull, from left to right.
    pub(super) fn hull(&self) -> &[Point] {
        &self.hull[..self.len]
    }

    /// Device time of the first sample.
    pub(super) fn first_x(&self) -> f64 {
        self.first_x
    }

    /// Device time of the last sample.
    pub(super) fn last_x(&self) -> f64 {
        self.last_x
    }

    /// Sum of the samples' device times.
    pub(super) fn x_sum(&self) -> f64 {
        self.x_sum
    }

    /// Sum of the samples' lags.
    pub(super) fn lag_sum(&self) -> f64 {
        self.lag_sum
    }

    /// Height of the lowest sample above the line `lag = at_zero + rate * x`.
    pub(super) fn lowest_above(&self, at_zero: f64, rate: f64) -> f64 {
        let above = |p: &Point| p.lag - at_zero - rate * p.x;
        self.hull().iter().map(above).fold(f64::INFINITY, f64::min)
    }
}
