//! What differs in a camera's images from episode to episode: domain randomization of brightness
//! and lens.
//!
//! Each range is drawn once per seed, episode and camera from a stream of its own, those of the
//! key that noise is drawn with, so that an image remains a function of its request.

use estimator_config::config;

use crate::error::SimulationError;
use crate::randomness::{RandomStream, Stream};

config! {
    /// Ranges of domain randomization of images. 1 to 1 is none.
    pub struct VariationConfig {
        /// Gain of linear light, beside that of the exposure.
        pub gain: [f64; 2] = [1.0, 1.0],
        /// Scale of the focal lengths: an error of the calibration.
        pub focal_scale: [f64; 2] = [1.0, 1.0],
    }
}

impl VariationConfig {
    pub(super) fn check(&self) -> Result<(), SimulationError> {
        for (name, [low, high], [least, greatest]) in [
            ("gain", self.gain, [1e-3, 1e3]),
            ("focal_scale", self.focal_scale, [0.5, 2.0]),
        ] {
            if !(least <= low && low <= high && high <= greatest) {
                return Err(SimulationError::Setting {
                    name: format!("camera.variation.{name}"),
                    found: format!("{low} to {high}"),
                    expected: format!("an ascending range within {least} to {greatest}"),
                });
            }
        }
        Ok(())
    }

    /// The gain of a frame.
    pub(super) fn gain_of(&self, seed: u64, episode: u64, camera: u8) -> f64 {
        let stream = RandomStream::new(seed, episode, Stream::Exposure);
        stream.range(u64::from(camera), self.gain)
    }

    /// The scale of the focal lengths of a frame.
    pub(super) fn focal_scale_of(&self, seed: u64, episode: u64, camera: u8) -> f64 {
        let stream = RandomStream::new(seed, episode, Stream::Intrinsics);
        stream.range(u64::from(camera), self.focal_scale)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn drawn(config: &VariationConfig) -> Vec<[u64; 2]> {
        let of = |number: u64| {
            let (seed, episode) = (number % 20, number / 20);
            [
                config.gain_of(seed, episode, 0),
                config.focal_scale_of(seed, episode, 0),
            ]
        };
        (0..400)
            .map(|number| of(number).map(f64::to_bits))
            .collect()
    }

    #[test]
    fn ranges_are_independent_filled_and_hold_for_an_episode() {
        let base = VariationConfig {
            gain: [0.5, 2.0],
            focal_scale: [0.98, 1.02],
        };
        let expected = drawn(&base);
        let other = drawn(&VariationConfig {
            gain: [0.8, 1.0],
            ..base
        });
        assert!(
            expected
                .iter()
                .zip(&other)
                .all(|(a, b)| a[0] != b[0] && a[1] == b[1])
        );
        let other = drawn(&VariationConfig {
            focal_scale: [1.0, 1.1],
            ..base
        });
        assert!(
            expected
                .iter()
                .zip(&other)
                .all(|(a, b)| a[0] == b[0] && a[1] != b[1])
        );
        for (k, [low, high]) in [base.gain, base.focal_scale].into_iter().enumerate() {
            let values = expected.iter().map(|row| f64::from_bits(row[k]));
            let least = values.clone().fold(f64::INFINITY, f64::min);
            let greatest = values.fold(f64::NEG_INFINITY, f64::max);
            assert!(low <= least && greatest <= high);
            assert!(greatest - least > 0.97 * (high - low), "{least} {greatest}");
        }
        assert_ne!(base.gain_of(4, 1, 0), base.gain_of(4, 2, 0));
        assert_ne!(base.gain_of(4, 1, 0), base.gain_of(4, 1, 1));
        let none = VariationConfig::default();
        let found = [none.gain_of(4, 1, 0), none.focal_scale_of(4, 1, 0)];
        assert_eq!(found, [1.0; 2]);
    }

    #[test]
    fn impossible_ranges_are_refused_by_name() {
        for (config, name) in [
            (
                VariationConfig {
                    gain: [1.0, 0.5],
                    ..VariationConfig::default()
                },
                "camera.variation.gain",
            ),
            (
                VariationConfig {
                    focal_scale: [f64::NAN, 1.0],
                    ..VariationConfig::default()
                },
                "camera.variation.focal_scale",
            ),
        ] {
            let error = config.check().unwrap_err().to_string();
            assert!(error.contains(name), "{error}");
        }
    }
}
