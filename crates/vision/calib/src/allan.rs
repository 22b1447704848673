//! Allan deviation of the noise of a static sensor over the averaging time, and its noise
//! coefficients.
//!
//! Contract: [`curve`] takes rates at a constant period, in runs without a gap; averaging factors
//! are whole numbers of samples, and no difference is taken across a gap. [`fit()`] estimates the
//! coefficients of IEEE Std 952-1997 (annex C), as few of them as the curve needs, each with its
//! uncertainty; a coefficient that the recording does not determine is an upper limit and never a
//! value.
//!
//! With τ the averaging time, quantisation Q, white noise N, bias instability B and random walk K
//! add up to
//!
//! ```text
//! σ²(τ) = 3 Q² / τ²  +  N² / τ  +  (2 ln 2 / π) B²  +  K² τ / 3
//! ```
//!
//! For a gyroscope in rad/s, N is in rad/s/√Hz, K in rad/s²/√Hz, B in rad/s and Q in rad; for an
//! accelerometer read m/s for rad.
//!
//! [`deviation`] has the estimators used for clocks, on phase: they are checked against published
//! results.

pub mod chi2;
pub mod deviation;
pub mod fit;
pub mod lines;

mod config;
mod covariance;
mod variance;

pub use config::FitConfig;
pub use fit::{Coefficient, Fit, Value, fit};
pub use variance::{Curve, Point, curve};

#[cfg(test)]
pub(crate) mod tests;
