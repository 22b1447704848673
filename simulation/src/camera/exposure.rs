//! From colors of a scene to those of an image: gain, white balance and gamma.
//!
//! Colors of a scene are those of its recorded images, taken as proportional to the light to the
//! power of 1 / 2.2, as the training does. Gains, noise and motion blur are of linear light.

use estimator_config::config;

use crate::error::{SimulationError, check_range};

/// Gamma of the recorded images.
pub(super) const SCENE_GAMMA: f64 = 2.2;
/// Cells of the table of linear light. Between them it is linear, to 1e-6.
const CELLS: usize = 1024;

config! {
    /// Brightness of images.
    pub struct ExposureConfig {
        /// Gain of linear light against the scene's, 1 for none.
        pub gain: f64 = 1.0,
        /// Further gains of red, green and blue.
        pub white_balance: [f64; 3] = [1.0, 1.0, 1.0],
        /// Values of an image are linear light to the power of 1 / gamma. Source: 2.2, that of the
        /// recorded images; 1 gives linear images.
        pub gamma: f64 = 2.2,
    }
}

impl ExposureConfig {
    pub(super) fn check(&self) -> Result<(), SimulationError> {
        let range = [1e-3, 1e3];
        check_range("camera.exposure.gain", self.gain, range, "0.001 to 1000")?;
        for gain in self.white_balance {
            check_range(
                "camera.exposure.white_balance",
                gain,
                range,
                "0.001 to 1000",
            )?;
        }
        check_range("camera.exposure.gamma", self.gamma, [0.2, 5.0], "0.2 to 5")
    }

    /// Gains of linear light per channel, with that of a frame.
    pub(super) fn gains(&self, of_frame: f64) -> [f64; 3] {
        self.white_balance
            .map(|balance| self.gain * balance * of_frame)
    }
}

/// Gains of linear light as a map of the scene's colors.
pub(super) fn scene_exposure(gains: [f64; 3]) -> splats::Exposure {
    match gains == [1.0; 3] {
        true => splats::Exposure::NONE,
        false => {
            let log = gains.map(|gain| (libm::log(gain) / SCENE_GAMMA) as f32);
            splats::Exposure::from_log_gain(log)
        }
    }
}

/// A value in 8 bits; 0 for NaN.
pub(super) fn quantized(value: f32) -> u8 {
    (value.clamp(0.0, 1.0) * 255.0 + 0.5) as u8
}

/// Between values of images and linear light.
#[derive(Clone, Debug)]
pub(super) struct ToneCurve {
    /// Linear light of the scene's values from 0 to 1.
    light: Vec<f32>,
    /// Light between value `k` and `k + 1` of the image.
    thresholds: Vec<f32>,
}

impl ToneCurve {
    pub(super) fn new(gamma: f64) -> Self {
        let light = |cell: usize| libm::pow(cell as f64 / CELLS as f64, SCENE_GAMMA) as f32;
        let threshold = |value: u32| libm::pow((f64::from(value) + 0.5) / 255.0, gamma) as f32;
        Self {
            light: (0..=CELLS).map(light).collect(),
            thresholds: (0..255).map(threshold).collect(),
        }
    }

    /// Linear light of a color of the scene.
    pub(super) fn light(&self, value: f32) -> f32 {
        if value >= 1.0 {
            return libm::powf(value, SCENE_GAMMA as f32);
        }
        // 0 for NaN.
        let value = value.max(0.0);
        let at = value * CELLS as f32;
        let cell = at as usize;
        let rest = at - cell as f32;
        self.light[cell] + rest * (self.light[cell + 1] - self.light[cell])
    }

    /// The nearest 8-bit value of linear light.
    pub(super) fn value(&self, light: f32) -> u8 {
        self.thresholds
            .partition_point(|threshold| *threshold <= light) as u8
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn light_is_the_power_of_values_and_back() {
        let curve = ToneCurve::new(SCENE_GAMMA);
        for value in 0..=255_u8 {
            let color = f32::from(value) / 255.0;
            let exact = libm::powf(color, 2.2);
            assert!((curve.light(color) - exact).abs() < 1e-6, "{value}");
            assert_eq!(curve.value(curve.light(color)), value);
        }
        assert_eq!((curve.light(f32::NAN), curve.light(-1.0)), (0.0, 0.0));
        assert!((curve.light(1.5) - libm::powf(1.5, 2.2)).abs() < 1e-6);
        assert_eq!([curve.value(-1.0), curve.value(2.0)], [0, 255]);
    }

    #[test]
    fn a_gain_of_light_is_one_of_values_to_the_power_of_the_gamma() {
        let config = ExposureConfig {
            gain: 2.0,
            white_balance: [1.0, 0.5, 1.0],
            ..ExposureConfig::default()
        };
        let [r, g, _] = scene_exposure(config.gains(1.0)).apply([0.25; 3]);
        assert!((r - 0.25 * libm::powf(2.0, 1.0 / 2.2)).abs() < 1e-6);
        assert!((g - 0.25).abs() < 1e-6);
        let curve = ToneCurve::new(SCENE_GAMMA);
        assert_eq!(curve.value(2.0 * curve.light(0.25)), quantized(r));
    }
}
