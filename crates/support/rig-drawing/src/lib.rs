//! Drawings of a rig: front, side and top views, as SVG text or as a PNG.
//!
//! ```
//! use cad_transforms::Rig;
//! use rig_drawing::draw;
//!
//! let rig = Rig::parse(include_str!("../../../../cad-transforms/rigs/example.toml"))?;
//! assert!(draw(&rig, &Default::default()).svg().starts_with("<svg "));
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

mod colors;
mod drawing;
mod sheet;

pub use colors::DARK;
pub use drawing::draw;
pub use sheet::Sheet;
