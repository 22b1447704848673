//! What charts and timelines share: title, subtitle and legend above, footnotes below, ticks.

use crate::series::Style;
use crate::svg::{Anchor, INK, MUTED, Svg, num, shorten, text_width, wrap};

pub(crate) const GRID: &str = "stroke=\"#e2e2e2\"";
pub(crate) const TICK: f64 = 11.0;
const MARGIN: f64 = 10.0;

/// The words around a chart.
#[derive(Clone, Debug, Default)]
pub(crate) struct Sheet {
    pub(crate) title: String,
    pub(crate) subtitle: String,
    pub(crate) footnotes: Vec<String>,
}

/// What stands before a name in the legend.
#[derive(Clone, Debug)]
pub(crate) enum Swatch {
    /// A line with these attributes if any, a marker of this style if any.
    Line(Option<String>, Option<Style>),
    /// A box of this colour and opacity.
    Box(&'static str, f64),
}

impl Sheet {
    /// Draws the words above the chart; returns the y below them.
    pub(crate) fn head(&self, svg: &mut Svg, width: f64, legend: &[(&str, Swatch)]) -> f64 {
        let room = width - 2.0 * MARGIN;
        let mut y = 6.0;
        for line in wrap(&self.title, 15.0 * 1.08, room) {
            y += 19.0;
            svg.text(
                MARGIN,
                y - 4.0,
                15.0,
                Anchor::Start,
                "font-weight=\"bold\"",
                &line,
            );
        }
        for line in wrap(&self.subtitle, 12.0, room) {
            y += 16.0;
            svg.text(
                MARGIN,
                y - 4.0,
                12.0,
                Anchor::Start,
                &format!("fill=\"{MUTED}\""),
                &line,
            );
        }
        let mut x = MARGIN;
        let mut row = 0.0;
        for (name, swatch) in legend.iter().filter(|(name, _)| !name.is_empty()) {
            let name = shorten(name, 12.0, room - 36.0);
            let wide = 36.0 + text_width(&name, 12.0);
            if row == 0.0 || x + wide > width - MARGIN {
                (x, row) = (MARGIN, row + 1.0);
                y += 18.0;
            }
            swatch.draw(svg, x, y - 8.0);
            svg.text(x + 32.0, y - 4.0, 12.0, Anchor::Start, "", &name);
            x += wide + 16.0;
        }
        y + 2.0
    }

    /// The footnotes as lines, `more` after the caller's own.
    pub(crate) fn foot_lines(&self, width: f64, more: &[String]) -> Vec<String> {
        let all = self.footnotes.iter().chain(more);
        all.flat_map(|note| wrap(note, 10.0, width - 2.0 * MARGIN))
            .collect()
    }

    /// Draws footnote lines from `y` down; returns the y below them.
    pub(crate) fn foot(svg: &mut Svg, y: f64, lines: &[String]) -> f64 {
        for (i, line) in lines.iter().enumerate() {
            svg.text(
                MARGIN,
                y + 13.0 * (i as f64 + 1.0),
                10.0,
                Anchor::Start,
                &format!("fill=\"{MUTED}\""),
                line,
            );
        }
        y + foot_height(lines)
    }
}

pub(crate) fn foot_height(lines: &[String]) -> f64 {
    lines.len() as f64 * 13.0 + 8.0
}

impl Swatch {
    fn draw(&self, svg: &mut Svg, x: f64, y: f64) {
        match self {
            Self::Box(colour, opacity) => {
                let fill =
                    format!("fill=\"{colour}\" fill-opacity=\"{opacity}\" stroke=\"{colour}\"");
                svg.rect(x + 0.5, y - 5.0, 26.0, 10.0, &fill);
            }
            Self::Line(line, marker) => {
                if let Some(attributes) = line {
                    svg.line((x, y), (x + 27.0, y), attributes);
                }
                if let Some(style) = marker {
                    markers(svg, &[(x + 13.5, y)], *style);
                }
            }
        }
    }
}

/// Markers of a series, as one path.
pub(crate) fn markers(svg: &mut Svg, points: &[(f64, f64)], style: Style) {
    let d: String = points
        .iter()
        .map(|p| format!("M{} {}{}", num(p.0), num(p.1), style.marker.outline))
        .collect();
    let (fill, rim, wide) = if style.marker.filled {
        (style.colour, "#fff", "0.8")
    } else {
        ("#fff", style.colour, "1.8")
    };
    svg.element(
        "path",
        &format!("d=\"{d}\" fill=\"{fill}\" stroke=\"{rim}\" stroke-width=\"{wide}\""),
    );
}

/// Tick texts below a horizontal axis at `y`. A text that would touch the one before is left out.
pub(crate) fn ticks_below(
    svg: &mut Svg,
    y: f64,
    width: f64,
    ticks: impl Iterator<Item = (f64, String)>,
) {
    let mut free = 0.0;
    for (x, text) in ticks {
        let half = text_width(&text, TICK) / 2.0;
        let x = x.clamp(half + 2.0, (width - half - 2.0).max(half + 2.0));
        if x - half >= free {
            svg.text(
                x,
                y + 15.0,
                TICK,
                Anchor::Middle,
                &format!("fill=\"{INK}\""),
                &text,
            );
            free = x + half + 6.0;
        }
    }
}
