//! Estimated noise of the measurements.

/// Noise estimate of one kind of measurement (variance component).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Noise {
    /// Estimated over nominal standard deviation. The result is computed with the estimate.
    pub ratio_to_nominal: f64,
    /// Redundancy: number of measurements minus the degrees of freedom they determine.
    pub redundancy: f64,
}

/// Noise estimates of all kinds of measurements.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct NoiseEstimates {
    /// Corners about the pose that fits their view best.
    pub corners: Noise,
    /// Those poses about the motion, given the estimated corner noise. Above 1: errors common to
    /// all corners of a view.
    pub poses: Noise,
    /// White noise of the gyroscope.
    pub gyro: Noise,
    /// White noise of the accelerometer.
    pub accel: Noise,
    /// Bias random walk of the gyroscope.
    pub gyro_walk: Noise,
    /// Bias random walk of the accelerometer.
    pub accel_walk: Noise,
}
