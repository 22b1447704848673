//! Gray images as estimators use them.
//!
//! - [`ImageView`]: a borrowed image, rows with or without padding.
//! - [`Pyramid`]: levels of half size each.
//! - [`klt`]: tracking of a patch from one pyramid to another.
//!
//! Pixel coordinates are integers at pixel centers, x to the right, y down.
//!
//! ```
//! use imaging::{ImageView, KltConfig, Pyramid, PyramidConfig, klt};
//!
//! // A blob, and the same one moved by 2 px to the right and 1 px down.
//! let blob = |x0: f64, y0: f64| -> Vec<u8> {
//!     let value = |x: usize, y: usize| {
//!         let (dx, dy) = (x as f64 - x0, y as f64 - y0);
//!         30.0 + 200.0 * (-(dx * dx + 1.5 * dy * dy) / 60.0).exp()
//!     };
//!     (0..96 * 96).map(|i| value(i % 96, i / 96) as u8).collect()
//! };
//! let (from, to) = (blob(45.0, 50.0), blob(47.0, 51.0));
//! let pyramid = |pixels: &[u8]| {
//!     Some(Pyramid::new(&PyramidConfig::default(), &ImageView::new(96, 96, 96, pixels)?))
//! };
//! let (from, to) = (pyramid(&from).unwrap(), pyramid(&to).unwrap());
//! let at = [45.0, 50.0];
//! let [x, y] = klt::track::<8>(&KltConfig::default(), &from, &to, at, at, 1).unwrap();
//! assert!((x - 47.0).abs() < 0.05 && (y - 51.0).abs() < 0.05);
//! ```

pub mod klt;
mod pyramid;
mod view;

pub use klt::KltConfig;
pub use pyramid::{Level, Patch, Pyramid, PyramidConfig};
pub use view::{ImageSizeError, ImageView};
