//! Configuration of the clock-map estimator: its tuned constants that do not depend on the device.
//! Those that do are in [`ClockConfig`](super::ClockConfig).
//!
//! One struct per concern, in the order of the data flow. Where a field names no source, its value
//! was chosen on the simulated streams of `cargo xtask bench sync`;
//! docs/decisions/0004-clock-maps.md has the errors over jitter, rate and bursts.

use estimator_config::config;

config! {
    /// Configuration of the clock-map estimator.
    pub(super) struct Config {
        /// Samples that do not fit the line.
        pub steps: StepConfig = StepConfig::default(),
        /// Distribution of the samples' heights above the line.
        pub tail: TailConfig = TailConfig::default(),
        /// Blocks of samples.
        pub blocks: BlockConfig = BlockConfig::default(),
        /// Fit of the line.
        pub fit: FitConfig = FitConfig::default(),
        /// Vertices of earlier lines.
        pub vertices: VertexConfig = VertexConfig::default(),
        /// Published maps and their later check.
        pub publication: PublicationConfig = PublicationConfig::default(),
        /// Flags of mapped times.
        pub flags: FlagConfig = FlagConfig::default(),
    }

    /// Samples that do not fit the line, until they are a step of the clock or not.
    pub(super) struct StepConfig {
        /// Number of sigmas below the map from which a sample is no refinement; also the tolerance
        /// above it. Lower suspects refinements of the line, higher learns from wrong ticks.
        pub tolerance_sigmas: f64 = 4.0,
        /// Quantile of lateness up to which a sample is on time: until then there was no step.
        /// Higher marks a shorter span before a step as unreliable.
        pub on_time_quantile: f64 = 0.5,
        /// Number of consecutive samples behind the newest tick that indicate a restarted counter.
        /// Lower takes reordered samples for a restart.
        pub min_restart_samples: usize = 4,
        /// Maximum number of samples held before early ones are judged.
        pub max_early_samples: usize = 16,
        /// Minimum number of early samples among them that agree, for a step; also of samples that
        /// are later than any latency. Lower takes wrong ticks for a step.
        pub min_early_samples: usize = 3,
        /// Maximum distance of early samples that agree, as a multiple of the 99th percentile of
        /// lateness; the tolerance is added.
        pub agreement_ratio: f64 = 3.0,
        /// Distance below the line from which early samples that are no step are wrong ticks and
        /// not a new minimum latency, as a multiple of the median lateness; the tolerance is added.
        pub wrong_tick_ratio: f64 = 10.0,
        /// Minimum number of samples in a burst for a step.
        pub min_late_samples: u64 = 32,
    }

    /// Distribution of the samples' heights above the line, and runs of high samples.
    pub(super) struct TailConfig {
        /// Improbability of a run that raises an alarm (natural logarithm): once in hours at
        /// 400 Hz. Lower raises more of them by chance; higher detects steps later. With this value
        /// a step of 0.1 ms under 1 ms of jitter takes some 160 samples, one of 1 ms some 16.
        pub alarm_nats: f64 = 16.0,
        /// Quantile of the height that is a usual delay: samples closer together are not
        /// independent, since a delayed sample delays those behind it.
        pub delay_quantile: f64 = 0.9,
        /// Number of samples after which the weight of older ones is halved.
        pub halving_samples: u32 = 20_000,
    }

    /// Blocks of samples, of which only the lower hull is stored.
    pub(super) struct BlockConfig {
        /// Minimum number of samples in a closed block.
        pub min_samples: u32 = 8,
        /// Minimum duration of a closed block, ns, so that fast streams are not fitted more often
        /// than slow ones.
        pub min_duration_ns: f64 = 250_000_000.0,
        /// Number of initial samples after each of which the line is fitted.
        pub initial_samples: u64 = 16,
        /// Distance below the line, in sigmas, from which a later sample changes the line before
        /// its block is closed.
        pub refit_sigmas: f64 = 0.5,
    }

    /// Fit of the line.
    pub(super) struct FitConfig {
        /// Lower bound of every sigma, ns: host timestamps are rounded, some to 1 us.
        pub sigma_floor_ns: f64 = 250.0,
        /// Minimum length of a window, in closed blocks; with fewer there is no choice. Not
        /// less than the last of `edge_depths`.
        pub min_blocks: usize = 8,
        /// Depths at which the density above the line is measured: numbers of lowest samples, one
        /// from each block, in falling order. The lowest density is used. A depth of more than half
        /// the blocks is left out, except the last one. With the fourth lowest of eight, windows
        /// disagree by chance, and the 99th percentile of the error doubles.
        pub edge_depths: [usize; 3] = [32, 16, 8],
        /// Minimum of `growth - 1` in the gap that is expected below the lowest sample: how much
        /// more the heights grow from one depth to four times it than from a quarter to it. Lower
        /// allows a wider gap.
        pub min_growth: f64 = 0.05,
        /// The scale at the edge is increased by the ratio of this to the number of blocks: with
        /// few blocks, it is more likely that some of them look like a sharp edge by chance.
        /// Without it and with a smaller gap, up to 3 of the 118 points of `cargo xtask bench sync`
        /// were silently wrong; higher increases errors (docs/decisions/0004-clock-maps.md).
        pub small_sample_blocks: f64 = 16.0,
        /// Minimum log evidence for a rate against none (natural logarithm); with less, noise would
        /// decide.
        pub min_log_evidence: f64 = 1.0,
        /// Covariance inflation: factor from posterior standard deviations to reported sigmas. The
        /// errors of an envelope are exponential, not normal, and their scale is itself estimated
        /// from few samples; with this factor an error of 5 sigma is as rare (below one in 10^5
        /// fits) as a normal distribution would make one expect of a large deviation, at the price
        /// of a sigma that is wider than the usual error.
        pub sigma_inflation: f64 = 2.8,
        /// Maximum distance of a longer window from a shorter one, in sigmas of the latter, for the
        /// two to agree. Lower shortens windows by chance, higher follows a changing rate late.
        pub agreement_sigmas: f64 = 2.0,
        /// Factor on the remaining distance from the lines of shorter windows, which is added to
        /// sigma: a curve or a step that the line does not model.
        pub window_difference_ratio: f64 = 2.0,
    }

    /// Vertices of earlier lines, and their distances as fractions of the length of the present
    /// line's window.
    pub(super) struct VertexConfig {
        /// Ratio of a vertex's sigma to that of the new line above which it is replaced.
        pub max_sigma_ratio: f64 = 2.0,
        /// Distance of a vertex from the new line, in sigmas of both, above which it is replaced.
        pub max_error_sigmas: f64 = 2.0,
        /// Minimum distance of a vertex before the line's reference, near the middle of the window,
        /// where a line is best determined.
        pub min_distance_ratio: f64 = 1.0 / 16.0,
        /// Distance before the reference at which a vertex is added.
        pub new_distance_ratio: f64 = 1.0 / 8.0,
        /// Minimum distance between an added vertex and the last one.
        pub min_spacing_ratio: f64 = 1.0 / 8.0,
        /// Minimum length of the segment before the reference in the published map.
        pub min_segment_ratio: f64 = 1.0 / 32.0,
    }

    /// Published maps and their later check.
    pub(super) struct PublicationConfig {
        /// Time for which no step of more than `max_error_sigmas` may remain undetected, ns: sigma
        /// is increased for that. Lower states larger sigmas.
        pub max_detection_ns: f64 = 10_000_000_000.0,
        /// Number of sigmas above which an error is a wrong time.
        pub max_error_sigmas: f64 = 5.0,
        /// Change of the newest time, in its former sigma, above which a map is published.
        pub min_shift_sigmas: f64 = 0.5,
        /// Ratios of its sigma to the former one, below and from which a map is published.
        pub sigma_ratio: [f64; 2] = [0.7, 1.4],
        /// Maximum device time between published maps, ns.
        pub max_interval_ns: f64 = 10_000_000_000.0,
        /// Maximum error of a claim against later knowledge, in its sigmas. Lower marks correct
        /// times as unreliable, higher leaves wrong ones unmarked.
        pub max_claim_error_sigmas: f64 = 3.0,
        /// Height of a sample above the line of a wrong claim, as a fraction of the error, below
        /// which it confirms that line.
        pub confirmation_ratio: f64 = 0.5,
    }

    /// Flags of mapped times.
    pub(super) struct FlagConfig {
        /// Factor on the 99th percentile of lateness above which a single sample is suspicious.
        pub suspect_lateness_ratio: f64 = 3.0,
        /// Number of sigmas by which a time may be later than its arrival allows.
        pub max_excess_sigmas: u64 = 5,
    }
}
