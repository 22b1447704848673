//! Small charts as SVG text, and self-contained HTML pages to put them in.
//!
//! Contract: drawing never fails and never panics. Values that cannot be drawn (not finite, beyond
//! 1e100 in size, not above zero on a log axis) are left out and *counted in the footnote*; a line
//! is broken where one of its points is missing. A chart without data says "no data". However many
//! points come in, the text that goes out is bounded by the pixels: lines whose points come in the
//! order of x keep the least and the greatest value of each pixel column, so extremes survive;
//! dense scatter and timelines merge what shares a pixel. The same input gives the same bytes. Text
//! is escaped everywhere.
//!
//! The SVG is plain 1.1 with presentation attributes: no scripts, no styles, no ids, no references,
//! so that several can be put into one page and any converter can draw them. Sizes are CSS pixels.
//! On its own it is drawn on white; in a [`Page`] it follows the reader's choice of a light or dark
//! screen.
//!
//! ```
//! use charts::{Axis, Chart, Page, Series, Verdict};
//!
//! let speed = Series::scatter("x264", [(12.0, 41.3), (30.0, 43.9)]).labels(["fast", "slow"]);
//! let svg = Chart::new("Quality against time")
//!     .x_axis(Axis::log("time per frame", "ms"))
//!     .y_axis(Axis::linear("PSNR", "dB"))
//!     .series(speed)
//!     .hline(40.0, "target")
//!     .to_svg(700, 360);
//! let page = Page::new("Encoders").verdict(Verdict::Pass).figure(&svg, "one core").to_html();
//! assert!(page.contains("target"));
//! ```

mod axis;
mod chart;
mod film;
mod geometry;
mod html;
mod inspect;
mod labels;
mod series;
mod sheet;
mod svg;
mod theme;
mod timeline;

#[cfg(test)]
mod tests;

pub use axis::{Axis, si, significant};
pub use chart::Chart;
pub use film::{Film, FilmFrame, FilmMap};
pub use html::{Cell, Image, Page, Table, Verdict, base64};
pub use inspect::inspect;
pub use series::{BREAK, Bins, Series};
pub use timeline::{Span, Timeline};

/// Width of a chart in a report page, CSS pixels.
pub const REPORT_WIDTH: u32 = 820;
/// Height of a chart in a report page, CSS pixels.
pub const REPORT_HEIGHT: u32 = 230;
