//! Noise of a sensor: photon noise and readout noise, by pixel and channel.
//!
//! The variance is linear in the light (Foi, Trimeche, Katkovnik and Egiazarian, Practical
//! Poissonian-Gaussian Noise Modeling and Fitting for Single-Image Raw-Data, 2008); both parts are
//! taken as one near-normal draw, which is the usual approximation above some ten electrons.

use estimator_config::config;

use crate::error::{SimulationError, check_range};
use crate::randomness::RandomStream;

config! {
    /// Noise of the sensor, in linear light before the gamma.
    pub struct NoiseConfig {
        /// Electrons of a pixel of full brightness at a gain of 1; 0 for no noise at all. A small
        /// pixel of 2 to 3 µm has some 10 000 at its lowest gain. Fewer is noisier.
        pub full_well_e: f64 = 0.0,
        /// Standard deviation of readout, electrons. Some 2 to 5 are usual; what matters in the
        /// dark.
        pub readout_e: f64 = 3.0,
    }
}

impl NoiseConfig {
    pub(super) fn check(&self) -> Result<(), SimulationError> {
        let electrons = self.full_well_e;
        check_range(
            "camera.noise.full_well_e",
            electrons,
            [0.0, 1e7],
            "0 to 1e7",
        )?;
        check_range(
            "camera.noise.readout_e",
            self.readout_e,
            [0.0, 1e5],
            "0 to 1e5",
        )
    }

    pub(super) fn is_none(&self) -> bool {
        self.full_well_e == 0.0
    }

    /// Of a channel with a gain of linear light.
    pub(super) fn of_channel(&self, gain: f64) -> ChannelNoise {
        let readout = gain * self.readout_e / self.full_well_e;
        ChannelNoise {
            photon: (gain / self.full_well_e) as f32,
            readout: (readout * readout) as f32,
        }
    }
}

/// Variance of a channel's light: `photon · light + readout`.
#[derive(Clone, Copy, Debug)]
pub(super) struct ChannelNoise {
    photon: f32,
    readout: f32,
}

impl ChannelNoise {
    /// Light with a draw of noise.
    pub(super) fn add(self, light: f32, stream: &RandomStream, index: u64) -> f32 {
        let deviation = (self.photon * light + self.readout).sqrt();
        light + deviation * stream.bell(index) as f32
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::randomness::Stream;

    /// Another range of noise scales the same draws.
    #[test]
    fn draws_do_not_depend_on_the_noise() {
        let stream = RandomStream::new(3, 0, Stream::Noise);
        let draws = |full_well_e: f64, readout_e: f64| {
            let config = NoiseConfig {
                full_well_e,
                readout_e,
            };
            let noise = config.of_channel(1.0);
            let deviation = (0.5 / full_well_e + (readout_e / full_well_e).powi(2)).sqrt();
            let draw = |index| f64::from(noise.add(0.5, &stream, index) - 0.5) / deviation;
            (0..1000).map(draw).collect::<Vec<_>>()
        };
        let (weak, strong) = (draws(10_000.0, 3.0), draws(200.0, 12.0));
        assert!(weak.iter().zip(&strong).all(|(a, b)| (a - b).abs() < 1e-3));
    }

    #[test]
    fn variance_rises_with_light_and_gain() {
        let config = NoiseConfig {
            full_well_e: 1000.0,
            readout_e: 5.0,
        };
        let stream = RandomStream::new(3, 0, Stream::Noise);
        let count = 40_000;
        for (gain, light) in [(1.0, 0.0_f32), (1.0, 0.5), (4.0, 0.5)] {
            let noise = config.of_channel(gain);
            let errors: Vec<f64> = (0..count)
                .map(|index| f64::from(noise.add(light, &stream, index) - light))
                .collect();
            let mean = errors.iter().sum::<f64>() / count as f64;
            let variance = errors.iter().map(|e| e * e).sum::<f64>() / count as f64;
            // Electrons before the gain: shot noise of their mean, and readout.
            let electrons = f64::from(light) / gain * 1000.0;
            let expected = (gain / 1000.0).powi(2) * (electrons + 25.0);
            assert!(
                (variance / expected - 1.0).abs() < 0.03,
                "{variance} {expected}"
            );
            assert!(
                mean.abs() < 4.0 * (expected / count as f64).sqrt(),
                "{mean}"
            );
        }
    }
}
