//! Tags anywhere in an image, without a prediction: to start, and to check.
//!
//! Black regions of a locally thresholded image whose boundary is a convex quadrilateral, decoded.
//! Lenses are unknown here; over a tag, lines are straight enough.

use boards::Dictionary;
use estimator_config::config;
use imaging::ImageView;

use crate::decode::{Book, Layout, ReadConfig, read};
use crate::quadrilateral::{self, QuadrilateralConfig};
use crate::regions::{self, RegionConfig};
use crate::square::Square;

config! {
    /// Configuration of [`search`].
    pub struct SearchConfig {
        /// Black regions.
        pub regions: RegionConfig = RegionConfig::default(),
        /// Their boundaries.
        pub quadrilaterals: QuadrilateralConfig = QuadrilateralConfig::default(),
        /// Cells.
        pub reading: ReadConfig = ReadConfig::default(),
        /// Maximum number of wrong bits of a tag that may be any of the dictionary.
        pub max_wrong_bits: u32 = 2,
        /// Maximum number of white cells in the border, of 28.
        pub max_border_errors: u32 = 3,
    }
}

/// A tag in an image.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Detection {
    /// Number in the dictionary.
    pub id: u32,
    /// Corners of the black square, px, pixel centers at integers: bottom left, bottom right, top
    /// right, top left of the upright tag.
    pub corners: [[f64; 2]; 4],
    /// Number of wrong bits.
    pub wrong_bits: u32,
}

/// A dictionary, prepared for searches.
#[derive(Clone, Debug)]
pub struct Searcher {
    book: Book,
    layout: Layout,
    config: SearchConfig,
}

impl Searcher {
    /// Searches for all tags of a dictionary.
    pub fn new(dictionary: Dictionary, config: &SearchConfig) -> Self {
        let bits = dictionary.bits();
        Self {
            book: Book::of(dictionary),
            layout: Layout {
                from: 0.0,
                to: 1.0,
                bits,
                border: 1,
                white: 1.0 / f64::from(bits + 2),
            },
            config: *config,
        }
    }

    /// All tags of the dictionary in an image, by their first rows.
    pub fn search(&self, image: &ImageView<'_>) -> Vec<Detection> {
        let mut found: Vec<Detection> = regions::dark(image, &self.config.regions)
            .iter()
            .filter_map(|region| quadrilateral::around(region, &self.config.quadrilaterals))
            .filter_map(|corners| self.decode(image, corners))
            .collect();
        found.sort_by(|a, b| {
            a.id.cmp(&b.id)
                .then(a.corners[0][1].total_cmp(&b.corners[0][1]))
        });
        found
    }

    /// The tag in a quadrilateral with corners clockwise in the image.
    fn decode(&self, image: &ImageView<'_>, corners: [[f64; 2]; 4]) -> Option<Detection> {
        let square = Square::new(corners)?;
        let reading = read(image, &square, &self.layout, &self.config.reading)?;
        if reading.border_errors > self.config.max_border_errors {
            return None;
        }
        let found = self.book.find(reading.code, self.config.max_wrong_bits)?;
        // Of the upright tag: top left, top right, bottom right, bottom left.
        let upright: [[f64; 2]; 4] = std::array::from_fn(|k| corners[(k + found.turns) % 4]);
        let [top_left, top_right, bottom_right, bottom_left] = upright;
        Some(Detection {
            id: found.id,
            corners: [bottom_left, bottom_right, top_right, top_left],
            wrong_bits: found.errors,
        })
    }
}
