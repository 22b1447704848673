//! When a camera captures and when its frames are delivered.
//!
//! Every environment has its own clock in ns, 0 at its reset. Frame `k` is captured at
//! `phase + k · interval` and delivered its latency later; at a control step the newest frame
//! counts that was captured and delivered by then.

use estimator_config::config;

use crate::error::{SimulationError, check_range};
use crate::randomness::{RandomStream, Stream};

config! {
    /// When a camera captures, and when its frames are delivered. Each environment draws its own
    /// values, once per episode.
    pub struct TimingConfig {
        /// Range of the time between two frames, s. 0 to 0 captures at the end of every control
        /// step.
        pub interval_s: [f64; 2] = [0.0, 0.0],
        /// Range of the time of the first frame after a reset, in intervals.
        pub phase: [f64; 2] = [0.0, 0.0],
        /// Range of the time from capture to delivery, s.
        pub latency_s: [f64; 2] = [0.0, 0.0],
        /// Time after which the latency is drawn again, s; 0 for each frame.
        pub redraw_s: f64 = 0.0,
    }
}

/// Longest latency in intervals between frames. It bounds the memory of a queue.
const MAX_IN_TRANSIT: f64 = 16.0;

impl TimingConfig {
    /// A fixed rate, 1/s, and a fixed latency, s.
    pub fn regular(rate_hz: f64, latency_s: f64) -> Self {
        Self {
            interval_s: [1.0 / rate_hz; 2],
            latency_s: [latency_s; 2],
            ..Self::default()
        }
    }

    /// The ranges of GaussGym: intervals of 0.05 to 0.15 s, latencies of 0.12 to 0.3 s, drawn again
    /// every 3 s. Source: `config_vision.yaml` of escontra/gauss_gym (f356bc7). There all
    /// environments share one interval; here each has its own, and a phase.
    pub fn gauss_gym() -> Self {
        Self {
            interval_s: [0.05, 0.15],
            phase: [0.0, 1.0],
            latency_s: [0.12, 0.3],
            redraw_s: 3.0,
        }
    }

    /// The ranges of a name.
    ///
    /// ```
    /// use simulation::TimingConfig;
    ///
    /// assert_eq!(TimingConfig::preset("gauss_gym")?, TimingConfig::gauss_gym());
    /// assert!(TimingConfig::preset("gauss").is_err());
    /// # Ok::<(), simulation::SimulationError>(())
    /// ```
    ///
    /// # Errors
    /// [`SimulationError::Setting`] for a name that is not `gauss_gym`.
    pub fn preset(name: &str) -> Result<Self, SimulationError> {
        match name {
            "gauss_gym" => Ok(Self::gauss_gym()),
            _ => Err(SimulationError::Setting {
                name: "camera.timing".to_owned(),
                found: format!("{name:?}"),
                expected: "settings or the preset gauss_gym".to_owned(),
            }),
        }
    }

    /// Whether each control step has a frame of its own end, without latency: no queue is needed.
    pub(crate) fn is_immediate(&self) -> bool {
        self.interval_s[1] == 0.0 && self.latency_s[1] == 0.0
    }

    /// # Errors
    /// [`SimulationError::Setting`] as [`CameraSchedule::new`], and for a latency of more than 16
    /// control steps of `dt_s` where each step has its frame.
    pub(crate) fn check_steps(&self, dt_s: f64) -> Result<(), SimulationError> {
        self.check()?;
        if self.interval_s[1] > 0.0 {
            return Ok(());
        }
        check_in_transit("camera.timing.latency_s / dt_s", self.latency_s[1] / dt_s)
    }

    pub(super) fn check(&self) -> Result<(), SimulationError> {
        let ranges = [
            ("interval_s", self.interval_s, [0.0, 100.0]),
            ("phase", self.phase, [0.0, 1.0]),
            ("latency_s", self.latency_s, [0.0, 100.0]),
            ("redraw_s", [self.redraw_s; 2], [0.0, 1e6]),
        ];
        for (name, [low, high], [least, most]) in ranges {
            if !(least <= low && low <= high && high <= most) {
                return Err(SimulationError::Setting {
                    name: format!("camera.timing.{name}"),
                    found: format!("{low} to {high}"),
                    expected: format!("an ascending range within {least} to {most}"),
                });
            }
        }
        let [shortest, longest] = self.interval_s;
        if longest == 0.0 {
            return Ok(());
        }
        let name = "camera.timing.interval_s";
        check_range(
            name,
            shortest,
            [1e-4, 100.0],
            "0 to 0, or at least 0.0001 s",
        )?;
        check_in_transit(
            "camera.timing.latency_s / interval_s",
            self.latency_s[1] / shortest,
        )
    }
}

fn check_in_transit(name: &str, in_transit: f64) -> Result<(), SimulationError> {
    let expected = "at most 16 frames in transit: a shorter latency or a longer interval";
    check_range(name, in_transit, [0.0, MAX_IN_TRANSIT], expected)
}

/// Times of the frames of one camera in one episode, ns after the reset.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CameraSchedule {
    /// Time of the first frame, ns.
    pub phase_ns: i64,
    /// Time between frames, ns; 0 for a frame per control step.
    pub interval_ns: i64,
    /// Range of the latency, ns.
    pub latency_ns: [i64; 2],
    /// Time after which the latency is drawn again, ns; 0 for each frame.
    pub redraw_ns: i64,
    /// Seed of the environment.
    pub seed: u64,
    /// Its episode.
    pub episode: u64,
}

impl CameraSchedule {
    /// Draws the times of an episode.
    ///
    /// # Errors
    /// [`SimulationError::Setting`] for ranges that are not ascending, and for latencies of more
    /// than 16 intervals.
    pub fn new(config: &TimingConfig, seed: u64, episode: u64) -> Result<Self, SimulationError> {
        config.check()?;
        Ok(Self::draw(config, seed, episode))
    }

    /// The same with ranges that were checked before.
    pub(crate) fn draw(config: &TimingConfig, seed: u64, episode: u64) -> Self {
        let stream = RandomStream::new(seed, episode, Stream::Camera);
        let interval_s = stream.range(0, config.interval_s);
        let phase = stream.range(1, config.phase);
        Self {
            phase_ns: nanoseconds(phase * interval_s),
            interval_ns: nanoseconds(interval_s),
            latency_ns: config.latency_s.map(nanoseconds),
            redraw_ns: nanoseconds(config.redraw_s),
            seed,
            episode,
        }
    }

    /// Time at which frame `index` is captured, ns.
    pub fn capture_ns(&self, index: u64) -> i64 {
        self.interval_ns
            .saturating_mul(index as i64)
            .saturating_add(self.phase_ns)
    }

    /// Time from capture to delivery of frame `index`, captured at a time, ns.
    pub fn latency_ns(&self, index: u64, capture_ns: i64) -> i64 {
        let [least, most] = self.latency_ns;
        let draw = match self.redraw_ns {
            0 => index,
            redraw_ns => (capture_ns / redraw_ns) as u64,
        };
        let uniform = RandomStream::new(self.seed, self.episode, Stream::Latency).uniform(draw);
        least + ((most - least) as f64 * uniform).round() as i64
    }
}

/// Whole nanoseconds.
pub(crate) fn nanoseconds(seconds: f64) -> i64 {
    (seconds * 1e9).round() as i64
}

#[cfg(test)]
mod tests;
