//! Noise for tests.

/// Numbers with mean 0 and standard deviation 1, one after the other.
pub(crate) struct Noise {
    seed: u64,
    index: u64,
}

impl Noise {
    pub(crate) fn new(seed: u64) -> Self {
        Self { seed, index: 0 }
    }

    pub(crate) fn next(&mut self) -> f64 {
        self.index += 1;
        counter_random::bell(self.seed, 0, self.index)
    }
}
