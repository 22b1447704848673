//! Image as an input tensor: 1 x channels x rows x columns.

use std::path::Path;

use ort::value::{DynValue, Outlet, Tensor, TensorElementType, ValueType};

use crate::error::LearnedError;
use crate::image::ImageView;
use crate::network::{describe, mismatch};
use crate::settings::{InputSettings, Text};

const EXPECTED: &str = "f32 or u8 of [1, 1 or 3 channels, rows, columns]";

/// Input of a network for one image.
#[derive(Clone, Debug)]
pub(crate) struct Input {
    pub(crate) name: String,
    bytes: bool,
    channels: usize,
    /// Columns and rows, if the network has a fixed size.
    size: [Option<usize>; 2],
}

impl Input {
    /// # Errors
    /// [`LearnedError::Tensor`] if the input is not an image.
    pub(crate) fn new(outlet: &Outlet, file: &Path) -> Result<Self, LearnedError> {
        let wrong = || {
            let tensor = format!("input `{}`", outlet.name());
            mismatch(file, tensor, describe(outlet.dtype()), EXPECTED.to_owned())
        };
        let ValueType::Tensor { ty, shape, .. } = outlet.dtype() else {
            return Err(wrong());
        };
        let bytes = match ty {
            TensorElementType::Float32 => false,
            TensorElementType::Uint8 => true,
            _ => return Err(wrong()),
        };
        let &[-1 | 1, channels @ (1 | 3), rows, columns] = &shape[..] else {
            return Err(wrong());
        };
        Ok(Self {
            name: outlet.name().to_owned(),
            bytes,
            channels: channels as usize,
            size: [columns, rows].map(|length| usize::try_from(length).ok()),
        })
    }

    /// # Errors
    /// [`LearnedError::Settings`] if normalization values do not fit the type or the channels of
    /// the input.
    pub(crate) fn validate_settings(
        &self,
        settings: &InputSettings,
        text: &Text,
    ) -> Result<(), LearnedError> {
        let plain = InputSettings {
            multiple: settings.multiple,
            ..InputSettings::default()
        };
        if self.bytes && *settings != plain {
            let expected = "no `white`, `mean` or `std`: the network takes bytes as they are";
            return Err(text.invalid("numbers for `[input]`".to_owned(), expected));
        }
        for (key, numbers) in [("mean", &settings.mean), ("std", &settings.std)] {
            if !numbers.is_empty() && numbers.len() != self.channels {
                let found = format!("{key} = {numbers:?}");
                return Err(text.invalid(
                    found,
                    &format!("one number for each of {} channels", self.channels),
                ));
            }
        }
        Ok(())
    }

    /// Whether both inputs have the same size.
    pub(crate) fn same_size(&self, other: &Self) -> bool {
        self.size == other.size
    }

    /// Columns and rows of the tensor for an image.
    ///
    /// # Errors
    /// [`LearnedError::Image`] if the image is larger than the input of the network.
    pub(crate) fn padded(
        &self,
        image: &ImageView<'_>,
        multiple: usize,
    ) -> Result<[usize; 2], LearnedError> {
        let [width, height] = [image.width(), image.height()];
        let [columns, rows] = self.size;
        if columns.is_some_and(|c| c < width) || rows.is_some_and(|r| r < height) {
            let most = |length: Option<usize>| length.map_or("any".to_owned(), |l| l.to_string());
            return Err(LearnedError::Image {
                found: format!("{width} x {height} pixels"),
                expected: format!(
                    "at most what the network takes, {} x {}",
                    most(columns),
                    most(rows)
                ),
            });
        }
        Ok([
            columns.unwrap_or(width.next_multiple_of(multiple)),
            rows.unwrap_or(height.next_multiple_of(multiple)),
        ])
    }

    /// Builds the tensor of `size` columns and rows; it is padded to the right and below by
    /// repeating the border of the image.
    pub(crate) fn tensor(
        &self,
        image: &ImageView<'_>,
        size: [usize; 2],
        settings: &InputSettings,
    ) -> ort::Result<DynValue> {
        let [columns, rows] = size;
        let shape = [1, self.channels, rows, columns];
        if self.bytes {
            let values = self.values(image, size, |_, value| value);
            return Ok(Tensor::from_array((shape, values))?.into_dyn());
        }
        let scale = |channel: usize, value: u8| {
            let mean = settings.mean.get(channel).copied().unwrap_or(0.0);
            let std = settings.std.get(channel).copied().unwrap_or(1.0);
            (f32::from(value) / 255.0 * settings.white - mean) / std
        };
        let tables: Vec<[f32; 256]> = (0..self.channels)
            .map(|channel| std::array::from_fn(|value| scale(channel, value as u8)))
            .collect();
        let values = self.values(image, size, |channel, value| {
            tables[channel][usize::from(value)]
        });
        Ok(Tensor::from_array((shape, values))?.into_dyn())
    }

    fn values<T>(
        &self,
        image: &ImageView<'_>,
        [columns, rows]: [usize; 2],
        number: impl Fn(usize, u8) -> T,
    ) -> Vec<T> {
        let mut values = Vec::with_capacity(self.channels * rows * columns);
        for channel in 0..self.channels {
            for y in 0..rows {
                let y = y.min(image.height() - 1);
                values.extend((0..columns).map(|x| {
                    let x = x.min(image.width() - 1);
                    number(channel, image.value(x, y, channel, self.channels))
                }));
            }
        }
        values
    }
}
