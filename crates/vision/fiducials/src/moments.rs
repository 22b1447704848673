//! Moments of pairs of numbers: their correlation, and the line through them.

/// Moments of pairs.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Moments {
    count: f64,
    x: f64,
    y: f64,
    xx: f64,
    xy: f64,
    yy: f64,
}

impl Moments {
    pub(crate) fn add(&mut self, x: f64, y: f64) {
        self.count += 1.0;
        self.x += x;
        self.y += y;
        self.xx += x * x;
        self.xy += x * y;
        self.yy += y * y;
    }

    /// Covariances, times the square of the number of pairs: of x, of both, of y.
    fn covariances(&self) -> [f64; 3] {
        [
            self.count * self.xx - self.x * self.x,
            self.count * self.xy - self.x * self.y,
            self.count * self.yy - self.y * self.y,
        ]
    }

    /// Correlation; 0 if x or y are all equal.
    pub(crate) fn correlation(&self) -> f64 {
        let [xx, xy, yy] = self.covariances();
        let product = xx * yy;
        if product > 0.0 {
            xy / product.sqrt()
        } else {
            0.0
        }
    }

    /// Offset and slope of the line through the pairs; `None` if all x are equal.
    pub(crate) fn line(&self) -> Option<(f64, f64)> {
        let [xx, xy, _] = self.covariances();
        (xx > 0.0).then(|| {
            let slope = xy / xx;
            ((self.y - slope * self.x) / self.count, slope)
        })
    }
}
