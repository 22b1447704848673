//! The two images of one size that a network compares.

use std::path::Path;

use ort::value::DynValue;

use crate::error::LearnedError;
use crate::image::ImageView;
use crate::input::Input;
use crate::network::{Network, mismatch};
use crate::settings::{InputSettings, Text};

/// Inputs of a network for two images.
#[derive(Debug)]
pub(crate) struct ImagePair {
    /// What the images are, which is also what settings call their inputs.
    roles: [&'static str; 2],
    inputs: [Input; 2],
    settings: InputSettings,
}

/// Tensors of a pair by the names of their inputs.
type Tensors<'a> = Vec<(&'a str, ort::Result<DynValue>)>;

impl ImagePair {
    /// Inputs by their names, where settings have them: the first one is for the first image
    /// otherwise.
    ///
    /// # Errors
    /// [`LearnedError::Settings`], [`LearnedError::Tensor`].
    pub(crate) fn new(
        network: &Network,
        file: &Path,
        roles: [&'static str; 2],
        names: [Option<&str>; 2],
        (settings, text): (InputSettings, &Text),
    ) -> Result<Self, LearnedError> {
        let inputs = network.inputs(2)?;
        let number = |name: Option<&str>| name.map(|name| network.input(name)).transpose();
        let (first, second) = match (number(names[0])?, number(names[1])?) {
            (None, None) => (0, 1),
            (Some(first), None) => (first, 1 - first),
            (None, Some(second)) => (1 - second, second),
            (Some(first), Some(second)) => (first, second),
        };
        let [a, b] = roles;
        if first == second {
            let found = format!("one name for both `{a}` and `{b}`");
            return Err(text.invalid(found, "two names"));
        }
        let inputs = [first, second].map(|number| inputs[number].clone());
        if !inputs[0].same_size(&inputs[1]) {
            let [a, b] = inputs.each_ref().map(|input| &input.name);
            return Err(mismatch(
                file,
                "the size of the inputs".to_owned(),
                format!("two sizes, of `{a}` and `{b}`"),
                "one".to_owned(),
            ));
        }
        for input in &inputs {
            input.validate_settings(&settings, text)?;
        }
        Ok(Self {
            roles,
            inputs,
            settings,
        })
    }

    /// The tensors of two images, with their columns and rows.
    ///
    /// # Errors
    /// [`LearnedError::Image`] if the images have two sizes or are larger than the inputs.
    pub(crate) fn tensors(
        &self,
        images: [&ImageView<'_>; 2],
    ) -> Result<([usize; 2], Tensors<'_>), LearnedError> {
        let sizes = images.map(|image| [image.width(), image.height()]);
        if sizes[0] != sizes[1] {
            let [first, second] = sizes.map(|[w, h]| format!("{w} x {h} pixels"));
            let [a, b] = self.roles;
            return Err(LearnedError::Image {
                found: format!("a {b} image of {second}"),
                expected: format!("{first} as for the {a} image"),
            });
        }
        let size = self.inputs[0].padded(images[0], self.settings.multiple)?;
        let tensors = self.inputs.iter().zip(images).map(|(input, image)| {
            let tensor = input.tensor(image, size, &self.settings);
            (input.name.as_str(), tensor)
        });
        Ok((size, tensors.collect()))
    }
}
