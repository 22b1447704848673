//! LPIPS network: from two images to one distance (Zhang et al., The Unreasonable Effectiveness of
//! Deep Features as a Perceptual Metric, 2018).

use std::path::Path;

use ort::value::TensorElementType;

use crate::error::LearnedError;
use crate::image::ImageView;
use crate::network::Network;
use crate::output::Values;
use crate::pair::ImagePair;
use crate::runtime::Runtime;
use crate::settings::{LpipsFile, Text};

const EXPECTED: &str = "one f32, such as [1, 1, 1, 1]";

/// A network that compares two images, with validated inputs and output.
#[derive(Debug)]
pub struct LpipsNetwork {
    network: Network,
    pair: ImagePair,
}

impl LpipsNetwork {
    /// Opens the network of a file, with the settings of the file beside it that has the extension
    /// `.toml` instead of `.onnx`.
    ///
    /// # Errors
    /// [`LearnedError::Read`], [`LearnedError::Model`], [`LearnedError::Toml`],
    /// [`LearnedError::Settings`], [`LearnedError::Tensor`].
    pub fn open(runtime: &Runtime, file: &Path) -> Result<Self, LearnedError> {
        let text = Text::beside(file)?;
        let LpipsFile {
            input: images,
            lpips: settings,
        } = text.parse()?;
        images.validate(&text)?;
        let network = Network::open(runtime, file, &text, settings.output.as_deref())?;
        let names = [settings.recorded.as_deref(), None];
        let roles = ["recorded", "rendered"];
        let pair = ImagePair::new(&network, file, roles, names, (images, &text))?;
        let (kind, shape) = network.output(EXPECTED)?;
        let is_one = shape.iter().all(|length| matches!(length, -1 | 1));
        if kind != TensorElementType::Float32 || !is_one {
            return Err(network.unfit(EXPECTED));
        }
        Ok(Self { network, pair })
    }

    /// BLAKE3 of the file of the network and its settings, hexadecimal. A different hash may mean
    /// different distances.
    pub fn hash(&self) -> &str {
        self.network.hash()
    }

    /// Distance of a rendered image from a recorded one of the same size; 0 for equal images.
    ///
    /// # Errors
    /// [`LearnedError::Image`], [`LearnedError::Run`], and [`LearnedError::Tensor`] if the output
    /// is not one finite number.
    pub fn run(
        &mut self,
        recorded: &ImageView<'_>,
        rendered: &ImageView<'_>,
    ) -> Result<f64, LearnedError> {
        let (_, tensors) = self.pair.tensors([recorded, rendered])?;
        let output = self.network.run(tensors)?;
        match &output.values {
            Values::Float(values) if values.len() == 1 && values[0].is_finite() => {
                Ok(f64::from(values[0]))
            }
            Values::Float(values) if values.len() == 1 => {
                Err(self.network.wrong_output(values[0].to_string(), EXPECTED))
            }
            _ => {
                let found = format!("{:?}", output.shape);
                Err(self.network.wrong_output(found, EXPECTED))
            }
        }
    }
}
