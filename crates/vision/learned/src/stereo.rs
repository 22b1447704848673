//! Stereo network: from a rectified pair to disparities.

use std::path::Path;

use depth::DisparityMap;
use ort::value::TensorElementType;

use crate::error::LearnedError;
use crate::image::ImageView;
use crate::network::Network;
use crate::output::Values;
use crate::pair::ImagePair;
use crate::runtime::Runtime;
use crate::settings::{StereoFile, StereoSettings, Text};
use crate::sigma;

const EXPECTED: &str = "f32 of [1, 1, rows, columns] or [1, rows, columns], as large as the inputs";

/// A stereo network with validated inputs and output.
#[derive(Debug)]
pub struct StereoNetwork {
    network: Network,
    pair: ImagePair,
    settings: StereoSettings,
}

impl StereoNetwork {
    /// Opens the network of a file, with the settings of the file beside it that has the extension
    /// `.toml` instead of `.onnx`.
    ///
    /// # Errors
    /// [`LearnedError::Read`], [`LearnedError::Model`], [`LearnedError::Toml`],
    /// [`LearnedError::Settings`], [`LearnedError::Tensor`].
    pub fn open(runtime: &Runtime, file: &Path) -> Result<Self, LearnedError> {
        let text = Text::beside(file)?;
        let StereoFile {
            input: images,
            stereo: settings,
        } = text.parse()?;
        images.validate(&text)?;
        settings.validate(&text)?;
        let network = Network::open(runtime, file, &text, settings.output.as_deref())?;
        let names = [settings.left.as_deref(), settings.right.as_deref()];
        let pair = ImagePair::new(&network, file, ["left", "right"], names, (images, &text))?;
        let (kind, shape) = network.output(EXPECTED)?;
        let fits = matches!(shape[..], [] | [-1 | 1, _, _] | [-1 | 1, -1 | 1, _, _]);
        if kind != TensorElementType::Float32 || !fits {
            return Err(network.unfit(EXPECTED));
        }
        Ok(Self {
            network,
            pair,
            settings,
        })
    }

    /// BLAKE3 of the file of the network and its settings, hexadecimal. A different hash may mean
    /// different disparities.
    pub fn hash(&self) -> &str {
        self.network.hash()
    }

    /// Settings from the file beside the network.
    pub fn settings(&self) -> &StereoSettings {
        &self.settings
    }

    /// Disparities of the left image of a rectified pair, with sigmas as described in
    /// `docs/reference/learned.md`.
    ///
    /// # Errors
    /// [`LearnedError::Image`], [`LearnedError::Run`], and [`LearnedError::Tensor`] if the output
    /// has another size.
    pub fn run(
        &mut self,
        left: &ImageView<'_>,
        right: &ImageView<'_>,
    ) -> Result<DisparityMap, LearnedError> {
        let width = left.width();
        let found = self.one_way(left, right)?;
        if !self.settings.both_ways {
            return Ok(sigma::constant_sigma(width, found, &self.settings));
        }
        // Mirrored, the right image is the left image of a pair.
        let mut right_to_left = self.one_way(&right.mirrored(), &left.mirrored())?;
        right_to_left
            .chunks_exact_mut(width)
            .for_each(<[f32]>::reverse);
        Ok(sigma::left_right_check(
            width,
            found,
            &right_to_left,
            &self.settings,
        ))
    }

    /// Disparities of one direction without a check, px.
    fn one_way(
        &mut self,
        left: &ImageView<'_>,
        right: &ImageView<'_>,
    ) -> Result<Vec<f32>, LearnedError> {
        let (size, tensors) = self.pair.tensors([left, right])?;
        let output = self.network.run(tensors)?;
        let [columns, rows] = size;
        let fits =
            matches!(output.shape[..], [1, r, c] | [1, 1, r, c] if [r, c] == [rows, columns]);
        let Values::Float(values) = &output.values else {
            return Err(self.network.unfit(EXPECTED));
        };
        if !fits {
            let found = format!(
                "{:?} for inputs of {rows} rows and {columns} columns",
                output.shape
            );
            return Err(self.network.wrong_output(found, EXPECTED));
        }
        let rows = values.chunks_exact(columns).take(left.height());
        Ok(rows
            .flat_map(|row| &row[..left.width()])
            .map(|number| number * self.settings.factor)
            .collect())
    }
}
