//! Settings that a network file does not contain: a small TOML file beside it with the same name.
//!
//! Contract: missing keys have the defaults documented here; an unknown key is an error, so that a
//! misspelled one is never ignored. Stereo and LPIPS networks need no file. A segmentation network
//! needs one, since the meaning of its classes is not in the network.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use serde::Deserialize;
use serde::de::DeserializeOwned;

use crate::error::LearnedError;

/// Table `[input]`: normalization of images. The input is `(value / 255 * white - mean) / std`,
/// with values from 0 to 255.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct InputSettings {
    /// Input value of white; 255 by default, and 1 for networks with inputs from 0 to 1.
    pub white: f32,
    /// Subtracted mean, one per channel; none by default.
    pub mean: Vec<f32>,
    /// Divisor, one per channel; none by default.
    pub std: Vec<f32>,
    /// Columns and rows are padded to a multiple of this number; 32 by default.
    pub multiple: usize,
}

impl Default for InputSettings {
    fn default() -> Self {
        Self {
            white: 255.0,
            mean: Vec::new(),
            std: Vec::new(),
            multiple: 32,
        }
    }
}

/// Table `[stereo]`. The defaults fit exports of RAFT-Stereo.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct StereoSettings {
    /// Name of the input for the left image; the first one by default.
    pub left: Option<String>,
    /// Name of the input for the right image; the other one by default.
    pub right: Option<String>,
    /// Name of the output; required if there are several.
    pub output: Option<String>,
    /// Factor from the output to a disparity in px; -1 by default, for networks that output the
    /// flow along x.
    pub factor: f32,
    /// Whether the network also runs from right to left for a left-right check, which doubles the
    /// time; true by default.
    pub both_ways: bool,
    /// Maximum left-right difference, px; 1 by default. Disparities with a larger one are absent.
    pub apart_px: f32,
    /// Sigma where both directions agree, or of all disparities if only one direction runs, px. The
    /// default of 0.5 is a guess.
    pub sigma_px: f32,
}

impl Default for StereoSettings {
    fn default() -> Self {
        Self {
            left: None,
            right: None,
            output: None,
            factor: -1.0,
            both_ways: true,
            apart_px: 1.0,
            sigma_px: 0.5,
        }
    }
}

/// Upsampling of an output to the size of the image.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Enlarge {
    /// Bilinear interpolation of scores; class numbers are always those of the nearest cell.
    #[default]
    Bilinear,
    /// Nearest cell.
    Nearest,
}

/// Table `[segmentation]`.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SegmentationSettings {
    /// Name of the output; required if there are several.
    pub output: Option<String>,
    /// Upsampling of scores; bilinear by default.
    #[serde(default)]
    pub enlarge: Enlarge,
    /// Class numbers of objects that can move, from 0, by descriptive names.
    pub masked: BTreeMap<String, u32>,
}

/// Table `[lpips]`. The defaults, and those of `[input]` for it, fit exports of the Python package
/// `lpips`: colors from -1 to 1, without padding.
#[derive(Clone, Debug, Default, PartialEq, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub(crate) struct LpipsSettings {
    /// Name of the input for the recorded image; the first one by default.
    pub(crate) recorded: Option<String>,
    /// Name of the output; required if there are several.
    pub(crate) output: Option<String>,
}

#[derive(Default, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub(crate) struct StereoFile {
    pub(crate) input: InputSettings,
    pub(crate) stereo: StereoSettings,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct SegmentationFile {
    #[serde(default)]
    pub(crate) input: InputSettings,
    pub(crate) segmentation: SegmentationSettings,
}

#[derive(Deserialize)]
#[serde(default, deny_unknown_fields)]
pub(crate) struct LpipsFile {
    #[serde(with = "LpipsInput")]
    pub(crate) input: InputSettings,
    pub(crate) lpips: LpipsSettings,
}

impl Default for LpipsFile {
    fn default() -> Self {
        Self {
            input: lpips_input(),
            lpips: LpipsSettings::default(),
        }
    }
}

/// Table `[input]` with the defaults of an LPIPS network.
#[derive(Deserialize)]
#[serde(remote = "InputSettings", default = "lpips_input", deny_unknown_fields)]
struct LpipsInput {
    white: f32,
    mean: Vec<f32>,
    std: Vec<f32>,
    multiple: usize,
}

fn lpips_input() -> InputSettings {
    InputSettings {
        white: 2.0,
        mean: vec![1.0; 3],
        std: Vec::new(),
        multiple: 1,
    }
}

/// Text of a settings file; empty if the file does not exist.
pub(crate) struct Text {
    pub(crate) file: PathBuf,
    pub(crate) text: String,
}

impl Text {
    /// Reads the settings beside a network.
    pub(crate) fn beside(network: &Path) -> Result<Self, LearnedError> {
        let file = network.with_extension("toml");
        let text = match plain_file::read_to_string(&file, plain_file::TEXT_LIMIT) {
            Err(e) if e.kind() == std::io::ErrorKind::NotFound => String::new(),
            Err(source) => {
                return Err(LearnedError::Read {
                    what: "settings of a network",
                    file,
                    source,
                });
            }
            Ok(text) => text,
        };
        Ok(Self { file, text })
    }

    pub(crate) fn parse<T: DeserializeOwned>(&self) -> Result<T, LearnedError> {
        toml::from_str(&self.text).map_err(|source| LearnedError::Toml {
            file: self.file.clone(),
            source,
        })
    }

    pub(crate) fn invalid(&self, found: String, expected: &str) -> LearnedError {
        LearnedError::Settings {
            file: self.file.clone(),
            found,
            expected: expected.to_owned(),
        }
    }
}

impl InputSettings {
    pub(crate) fn validate(&self, text: &Text) -> Result<(), LearnedError> {
        if self.multiple == 0 {
            return Err(text.invalid("multiple = 0".to_owned(), "at least 1"));
        }
        require_positive(text, "white", self.white)?;
        for std in &self.std {
            require_positive(text, "std", *std)?;
        }
        if let Some(mean) = self.mean.iter().find(|m| !m.is_finite()) {
            return Err(text.invalid(format!("mean = {mean}"), "a finite number"));
        }
        Ok(())
    }
}

impl StereoSettings {
    pub(crate) fn validate(&self, text: &Text) -> Result<(), LearnedError> {
        if self.factor == 0.0 || !self.factor.is_finite() {
            return Err(text.invalid(
                format!("factor = {}", self.factor),
                "a finite number other than 0",
            ));
        }
        require_positive(text, "apart_px", self.apart_px)?;
        require_positive(text, "sigma_px", self.sigma_px)
    }
}

fn require_positive(text: &Text, key: &str, value: f32) -> Result<(), LearnedError> {
    if value > 0.0 && value.is_finite() {
        return Ok(());
    }
    Err(text.invalid(format!("{key} = {value}"), "a finite number above 0"))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn text(text: &str) -> Text {
        Text {
            file: "network.toml".into(),
            text: text.to_owned(),
        }
    }

    #[test]
    fn empty_file_gives_the_defaults_of_raft_stereo() {
        let file: StereoFile = text("").parse().unwrap();
        assert_eq!(file.input, InputSettings::default());
        assert_eq!(file.stereo, StereoSettings::default());
        file.input.validate(&text("")).unwrap();
        file.stereo.validate(&text("")).unwrap();
    }

    #[test]
    fn an_lpips_network_takes_colors_from_minus_1_to_1() {
        let file: LpipsFile = text("").parse().unwrap();
        assert_eq!((file.input.white, file.input.multiple), (2.0, 1));
        let file: LpipsFile = text("[input]\nmultiple = 16\n[lpips]\nrecorded = 'b'")
            .parse()
            .unwrap();
        assert_eq!((file.input.mean, file.input.multiple), (vec![1.0; 3], 16));
        assert_eq!(file.lpips.recorded.as_deref(), Some("b"));
        for bad in ["[input]\nwite = 1.0", "[lpips]\nleft = 'a'", "[stereo]"] {
            assert!(text(bad).parse::<LpipsFile>().is_err(), "{bad}");
        }
    }

    #[test]
    fn all_keys_are_read() {
        let stereo = text(
            "[input]\nwhite = 1.0\nmean = [0.5]\nstd = [0.2]\nmultiple = 16\n\
             [stereo]\nleft = 'a'\nright = 'b'\noutput = 'c'\nfactor = 1.0\nboth_ways = false\napart_px = 2.0\nsigma_px = 0.3",
        );
        let file: StereoFile = stereo.parse().unwrap();
        assert_eq!((file.input.white, file.input.multiple), (1.0, 16));
        assert_eq!(file.stereo.right.as_deref(), Some("b"));
        assert!(!file.stereo.both_ways);
        let segmentation =
            text("[segmentation]\nenlarge = 'nearest'\nmasked = { person = 11, dog = 16 }");
        let file: SegmentationFile = segmentation.parse().unwrap();
        assert_eq!(file.segmentation.enlarge, Enlarge::Nearest);
        assert_eq!(file.segmentation.masked["dog"], 16);
    }

    #[test]
    fn invalid_settings_are_rejected() {
        for bad in [
            "[stereo]\nfacter = 1.0",
            "[segmentation]\nmasked = {}",
            "factor",
        ] {
            let error = text(bad).parse::<StereoFile>().err().expect(bad);
            assert!(error.to_string().ends_with("network.toml"), "{error}");
        }
        for bad in [
            "factor = 0.0",
            "factor = nan",
            "apart_px = -1.0",
            "sigma_px = 0.0",
        ] {
            let text = text(&format!("[stereo]\n{bad}"));
            let file: StereoFile = text.parse().unwrap();
            let error = file.stereo.validate(&text).unwrap_err().to_string();
            let key = bad.split(' ').next().unwrap();
            assert!(error.contains(key), "{error}");
        }
        for bad in [
            "multiple = 0",
            "white = 0.0",
            "std = [0.1, 0.0]",
            "mean = [inf]",
        ] {
            let text = text(&format!("[input]\n{bad}"));
            let file: StereoFile = text.parse().unwrap();
            assert!(file.input.validate(&text).is_err(), "{bad}");
        }
    }
}
