//! What a network cannot say of itself: a small TOML file beside it, of the same name.
//!
//! Contract: what is not stated has the default that is told here; a key that is not known is an error, so that none is misspelt
//! silently. A stereo network needs no file; a segmentation network needs one, since only a person knows its classes.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use serde::Deserialize;
use serde::de::DeserializeOwned;

use crate::error::LearnedError;

/// Table `[input]`: how pictures go in. What goes in is `(value / 255 * white - mean) / std`, with values of 0 to 255.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct InputSettings {
    /// What goes in for white; 255 by default, and 1 for networks that take 0 to 1.
    pub white: f32,
    /// Taken off, one for each channel; none by default.
    pub mean: Vec<f32>,
    /// Divided by, one for each channel; none by default.
    pub std: Vec<f32>,
    /// Columns and rows are padded to a multiple of this; 32 by default.
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

/// Table `[stereo]`. The defaults suit exports of RAFT-Stereo.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct StereoSettings {
    /// Name of the input for the left picture; the first one by default.
    pub left: Option<String>,
    /// Name of the input for the right picture; the other one by default.
    pub right: Option<String>,
    /// Name of the output; needed where there are several.
    pub output: Option<String>,
    /// What the output is multiplied by to be a disparity in px; -1 by default, for networks that give the flow along x.
    pub factor: f32,
    /// Whether the network also runs from right to left, which takes twice the time; true by default.
    pub both_ways: bool,
    /// What is absent where both ways differ by more, px; 1 by default.
    pub apart_px: f32,
    /// Sigma where both ways agree, and of everything where there is only one, px; 0.5 by default, which is a guess.
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

/// How an answer becomes as large as the picture.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Enlarge {
    /// Scores between the nearest four; class numbers are always those of the nearest.
    #[default]
    Bilinear,
    /// The nearest.
    Nearest,
}

/// Table `[segmentation]`.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SegmentationSettings {
    /// Name of the output; needed where there are several.
    pub output: Option<String>,
    /// How scores become as large as the picture; bilinear by default.
    #[serde(default)]
    pub enlarge: Enlarge,
    /// Numbers of the classes of things that can move, from 0, by names for people.
    pub masked: BTreeMap<String, u32>,
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

/// The text of a settings file; empty where there is none.
pub(crate) struct Text {
    pub(crate) file: PathBuf,
    pub(crate) text: String,
}

impl Text {
    /// Settings of a network.
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
            return Err(text.invalid(format!("factor = {}", self.factor), "a finite number but 0"));
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
    fn nothing_said_means_raft_stereo() {
        let file: StereoFile = text("").parse().unwrap();
        assert_eq!(file.input, InputSettings::default());
        assert_eq!(file.stereo, StereoSettings::default());
        file.input.validate(&text("")).unwrap();
        file.stereo.validate(&text("")).unwrap();
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
    fn what_cannot_be_followed_is_refused() {
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
