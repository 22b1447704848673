//! Configuration of the estimator of frame sync.

use estimator_config::config;

config! {
    /// Configuration of [`FrameSync`](super::FrameSync). Where a field names no source, its value
    /// was chosen on the simulated streams of `cargo xtask bench frame_sync`; how the error depends
    /// on it was not charted.
    pub struct FrameSyncConfig {
        /// Maximum number of events of each stream that are held: a minute at 30 frames per second,
        /// in which oscillators that warm up remain within some 10 us of a line. More follow a
        /// changing rate late, fewer have more noise.
        pub window: usize = 2048,
        /// Minimum number of frames seen by both streams. Lower gives estimates with a large sigma.
        pub min_pairs: usize = 32,
        /// Number of consecutive outlier events after which the counter is taken to have slipped.
        /// Lower restarts at a burst of late events, higher is wrong for longer.
        pub max_outliers: u32 = 8,
        /// Maximum step of a counter; one that leaps by more has restarted.
        pub max_count_step: u32 = 1 << 17,
        /// Number of blocks of arrivals of which the fastest is kept.
        pub blocks: usize = 120,
        /// Length of a block, ns. Together they are the time in which one arrival has to be fast.
        pub block_ns: i64 = 500_000_000,
        /// Minimum number of frames between two fits.
        pub min_refit_frames: usize = 8,
        /// The same as a divisor of the number of frames held. Higher costs time.
        pub refit_divisor: usize = 32,
        /// Maximum relative difference of the rates of the two clocks. Crystals: 100 parts in 1e6
        /// each. Lower bends the line, higher lets late stamps bend it.
        pub max_rate_deviation: f64 = 500e-6,
        /// Relative difference of the frame rates above which the streams are of two cameras: a
        /// slope from late stamps is not exact.
        pub max_frame_rate_deviation: f64 = 0.01,
        /// Number of parts of the window whose lowest points make the lower edge. More have fewer
        /// fast stamps each, fewer do not resolve the rate.
        pub parts: usize = 8,
        /// Divisor of the number of points: that part may be left out of a band.
        pub max_left_out_divisor: usize = 5,
        /// Distance below the median from which a stamp is wrong and not early, in distances of the
        /// lowest tenth from the median.
        pub max_early_ratio: f64 = 4.0,
        /// The same, additional and absolute, ns.
        pub max_early_ns: f64 = 100_000.0,
    }
}
