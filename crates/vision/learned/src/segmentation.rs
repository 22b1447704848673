//! Segmentation network: from an image to a class per pixel.

use std::path::Path;

use ort::value::TensorElementType;

use crate::error::LearnedError;
use crate::image::ImageView;
use crate::input::Input;
use crate::network::Network;
use crate::output::{Output, Values};
use crate::runtime::Runtime;
use crate::settings::{Enlarge, InputSettings, SegmentationFile, SegmentationSettings, Text};

const EXPECTED: &str = "f32 scores of [1, at least 2 classes, rows, columns] or u8, i32 or i64 class numbers of [1, rows, columns], \
                        as large as the input or smaller by a whole number";

/// Mask of the objects in an image that can move.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct MovableMask {
    /// Number of columns.
    pub width: usize,
    /// Number of rows.
    pub height: usize,
    /// Row-major; true on a movable object.
    pub movable: Vec<bool>,
}

/// A segmentation network with a validated input and output.
#[derive(Debug)]
pub struct SegmentationNetwork {
    network: Network,
    input: Input,
    images: InputSettings,
    settings: SegmentationSettings,
}

impl SegmentationNetwork {
    /// Opens the network of a file, with the settings of the file beside it that has the extension
    /// `.toml` instead of `.onnx`.
    ///
    /// # Errors
    /// [`LearnedError::Read`], [`LearnedError::Model`], [`LearnedError::Toml`],
    /// [`LearnedError::Settings`], [`LearnedError::Tensor`].
    pub fn open(runtime: &Runtime, file: &Path) -> Result<Self, LearnedError> {
        let text = Text::beside(file)?;
        if text.text.is_empty() {
            let found = "no settings".to_owned();
            return Err(text.invalid(found, "a file that names the classes to mask"));
        }
        let SegmentationFile {
            input: images,
            segmentation: settings,
        } = text.parse()?;
        images.validate(&text)?;
        if settings.masked.is_empty() {
            return Err(text.invalid("no class under `masked`".to_owned(), "at least one"));
        }
        let network = Network::open(runtime, file, &text, settings.output.as_deref())?;
        let inputs = network.inputs(1)?;
        let [input] = <[Input; 1]>::try_from(inputs).map_err(|_| network.unfit(EXPECTED))?;
        input.validate_settings(&images, &text)?;
        let (kind, shape) = network.output(EXPECTED)?;
        let fits = match (kind, &shape[..]) {
            (TensorElementType::Float32, [] | [-1 | 1, -1 | 2.., _, _]) => true,
            (kind, [] | [-1 | 1, _, _]) => Output::is_integer(kind),
            _ => false,
        };
        if !fits {
            return Err(network.unfit(EXPECTED));
        }
        if let (TensorElementType::Float32, &[_, classes, _, _]) = (kind, &shape[..]) {
            let beyond = |class: u32| classes >= 0 && i64::from(class) >= classes;
            if let Some((name, class)) = settings.masked.iter().find(|(_, class)| beyond(**class)) {
                let expected = format!("the number of one of {classes} classes, from 0");
                return Err(text.invalid(format!("{name} = {class}"), &expected));
            }
        }
        Ok(Self {
            network,
            input,
            images,
            settings,
        })
    }

    /// BLAKE3 of the file of the network and its settings, hexadecimal. A different hash may mean
    /// different masks.
    pub fn hash(&self) -> &str {
        self.network.hash()
    }

    /// Settings from the file beside the network.
    pub fn settings(&self) -> &SegmentationSettings {
        &self.settings
    }

    /// Mask of the configured classes.
    ///
    /// # Errors
    /// [`LearnedError::Image`], [`LearnedError::Run`], and [`LearnedError::Tensor`] if the output
    /// has another shape.
    pub fn run(&mut self, image: &ImageView<'_>) -> Result<MovableMask, LearnedError> {
        let size = self.input.padded(image, self.images.multiple)?;
        let tensor = self.input.tensor(image, size, &self.images);
        let output = self.network.run(vec![(&self.input.name, tensor)])?;
        let [columns, rows] = size;
        let unfit = || {
            let found = format!(
                "{:?} for an input of {rows} rows and {columns} columns",
                output.shape
            );
            self.network.wrong_output(found, EXPECTED)
        };
        let class: Box<dyn Fn(usize, usize) -> usize> = match (&output.values, &output.shape[..]) {
            (Values::Float(scores), &[1, classes, r, c]) if classes >= 2 => {
                let scores = Scores {
                    scores,
                    classes,
                    grid: Grid::new(size, [c, r]).ok_or_else(unfit)?,
                };
                match self.settings.enlarge {
                    Enlarge::Nearest => Box::new(move |x, y| scores.nearest(x, y)),
                    Enlarge::Bilinear => Box::new(move |x, y| scores.bilinear(x, y)),
                }
            }
            (Values::Integer(classes), &[1, r, c]) => {
                let grid = Grid::new(size, [c, r]).ok_or_else(unfit)?;
                // A class below 0 is not a class; some networks mark unknown pixels with it.
                Box::new(move |x, y| {
                    usize::try_from(classes[grid.nearest(x, y)]).unwrap_or(usize::MAX)
                })
            }
            _ => return Err(unfit()),
        };
        let masked: Vec<usize> = self.settings.masked.values().map(|c| *c as usize).collect();
        let (width, height) = (image.width(), image.height());
        let pixels = (0..height).flat_map(|y| (0..width).map(move |x| (x, y)));
        Ok(MovableMask {
            width,
            height,
            movable: pixels.map(|(x, y)| masked.contains(&class(x, y))).collect(),
        })
    }
}

/// Grid of output cells, each of which covers a square of pixels.
#[derive(Clone, Copy)]
struct Grid {
    /// Side length of a cell, px.
    side: usize,
    columns: usize,
    rows: usize,
}

impl Grid {
    /// `None` if the cells are not squares of whole pixels. Both sizes are columns and rows.
    fn new(input: [usize; 2], output: [usize; 2]) -> Option<Self> {
        let side = input[0].checked_div(output[0])?;
        (output.map(|length| length * side) == input).then_some(Self {
            side,
            columns: output[0],
            rows: output[1],
        })
    }

    fn nearest(&self, x: usize, y: usize) -> usize {
        y / self.side * self.columns + x / self.side
    }

    /// The cells before and after a pixel along one axis, and its fractional position between them.
    fn around(&self, pixel: usize, cells: usize) -> (usize, usize, f32) {
        // Centers of pixels and of cells are at integer coordinates.
        let at = ((pixel as f32 + 0.5) / self.side as f32 - 0.5).clamp(0.0, (cells - 1) as f32);
        let before = at as usize;
        (before, (before + 1).min(cells - 1), at - before as f32)
    }
}

/// Scores of each class for each cell.
struct Scores<'a> {
    scores: &'a [f32],
    classes: usize,
    grid: Grid,
}

impl Scores<'_> {
    fn nearest(&self, x: usize, y: usize) -> usize {
        let cell = self.grid.nearest(x, y);
        self.best(|scores| scores[cell])
    }

    fn bilinear(&self, x: usize, y: usize) -> usize {
        let Grid { columns, rows, .. } = self.grid;
        let (left, right, across) = self.grid.around(x, columns);
        let (top, bottom, down) = self.grid.around(y, rows);
        self.best(|scores| {
            let row = |y: usize| {
                let [a, b] = [left, right].map(|x| scores[y * columns + x]);
                a + (b - a) * across
            };
            let (a, b) = (row(top), row(bottom));
            a + (b - a) * down
        })
    }

    /// The class with the highest score, the first among equals.
    fn best(&self, score: impl Fn(&[f32]) -> f32) -> usize {
        let cells = self.grid.columns * self.grid.rows;
        let scores = self.scores.chunks_exact(cells).map(score);
        let (mut best, mut highest) = (0, f32::NEG_INFINITY);
        for (class, score) in scores.enumerate().take(self.classes) {
            if score > highest {
                (best, highest) = (class, score);
            }
        }
        best
    }
}
