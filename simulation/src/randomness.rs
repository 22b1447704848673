//! Random numbers of the simulators: streams without a shared state.
//!
//! A number is a function of the seed of its environment, the episode, the stream and an index.
//! So a snapshot holds counters instead of the state of a generator, environments can be advanced
//! in any order, and a range that is changed leaves all other draws as they are.
//!
//! Environment `i` of a world with seed `s` has the seed `s + i`, as environments in Gymnasium's
//! vector environments have, so that it equals a single environment with that seed.

/// What a random number is for. The numbers of a variant never change.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u64)]
pub enum Stream {
    /// Where an episode starts.
    Start = 1,
    /// Goal or command of an episode.
    Goal = 2,
    /// Phase and interval of the camera.
    Camera = 3,
    /// Scales of speed and yaw rate.
    Dynamics = 4,
    /// Noise of images.
    Noise = 5,
    /// Errors of the camera's mount.
    Mount = 6,
    /// Latency of images.
    Latency = 7,
    /// Brightness of images.
    Exposure = 8,
    /// Lenses of images.
    Intrinsics = 9,
}

/// Random numbers of one stream in one episode of one environment.
///
/// ```
/// use simulation::{RandomStream, Stream};
///
/// let start = RandomStream::new(7, 0, Stream::Start);
/// assert_eq!(start.uniform(3), RandomStream::new(7, 0, Stream::Start).uniform(3));
/// assert_ne!(start.uniform(3), RandomStream::new(7, 1, Stream::Start).uniform(3));
/// assert!((2.0..3.0).contains(&start.range(0, [2.0, 3.0])));
/// ```
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct RandomStream {
    key: u64,
    stream: u64,
}

impl RandomStream {
    /// The stream of the `episode`-th episode of an environment with this seed.
    pub fn new(environment_seed: u64, episode: u64, stream: Stream) -> Self {
        Self {
            key: counter_random::bits(environment_seed, 0, episode),
            stream: stream as u64,
        }
    }

    /// 64 random bits.
    pub fn bits(&self, index: u64) -> u64 {
        counter_random::bits(self.key, self.stream, index)
    }

    /// Uniform above 0 and below 1.
    pub fn uniform(&self, index: u64) -> f64 {
        counter_random::uniform(self.key, self.stream, index)
    }

    /// Uniform within a range; a range of equal ends gives its end exactly.
    pub fn range(&self, index: u64, [low, high]: [f64; 2]) -> f64 {
        low + (high - low) * self.uniform(index)
    }

    /// Mean 0, standard deviation 1, never beyond 3.47.
    pub fn bell(&self, index: u64) -> f64 {
        counter_random::bell(self.key, self.stream, index)
    }

    /// Uniform among `0..count`; 0 for a count of 0. The bias is below `count / 2^64`.
    pub fn below(&self, index: u64, count: usize) -> usize {
        ((u128::from(self.bits(index)) * count as u128) >> 64) as usize
    }
}

#[cfg(test)]
mod tests;
