//! A canvas of RGB pixels: lines, discs, polygons, text, PNG.
//!
//! Two fonts need no font file: [`Canvas::text`] draws digits of square dots, for labels in camera
//! images; [`strokes::text`] gives all ASCII letters as lines, for drawings that are also vector
//! graphics.
//!
//! Not drawn here: point clouds, meshes and camera images, whose pixels depend on depth or light;
//! counters and textures in the planes of a video image; charts and boards, which are vector
//! graphics.
//!
//! ```
//! use raster::Canvas;
//!
//! let mut canvas = Canvas::new(12, 12, [255; 3]);
//! canvas.disc([5.5, 5.5], 3.0, [200, 0, 0]);
//! // Antialiased: drawn at three times the size.
//! let image = canvas.downsampled(3);
//! assert_eq!((image.width, image.pixels[0]), (4, [255; 3]));
//! ```

mod canvas;
mod dot_matrix;
pub mod strokes;

pub use canvas::{Canvas, Color};
pub use png::{Compression, EncodingError};
