//! A chart: series over two axes, reference lines and bands, and the words around them.

mod draw;

use crate::axis::{Axis, Extent, Scale};
use crate::geometry::Rect;
use crate::labels::Placer;
use crate::series::{Series, Shape, Style, style};
use crate::sheet::{Sheet, Swatch, TICK, foot_height, ticks_below};
use crate::svg::{Anchor, MUTED, Svg, num, shorten, text_width};

/// A chart in the making; every method returns it, [`Chart::to_svg`] draws it.
#[derive(Clone, Debug)]
pub struct Chart {
    sheet: Sheet,
    x: Axis,
    y: Axis,
    series: Vec<Series>,
    references: Vec<Reference>,
}

/// A reference line (`from == to`) or band over the whole plot.
#[derive(Clone, Debug)]
struct Reference {
    of_x: bool,
    from: f64,
    to: f64,
    label: String,
}

impl Chart {
    /// A chart with linear axes without captions.
    pub fn new(title: &str) -> Self {
        Self {
            sheet: Sheet {
                title: title.into(),
                ..Sheet::default()
            },
            x: Axis::linear("", ""),
            y: Axis::linear("", ""),
            series: Vec::new(),
            references: Vec::new(),
        }
    }

    /// A line below the title.
    pub fn subtitle(mut self, text: &str) -> Self {
        self.sheet.subtitle = text.into();
        self
    }

    /// A small line at the bottom: machine, commit, command, method.
    pub fn footnote(mut self, text: &str) -> Self {
        self.sheet.footnotes.push(text.into());
        self
    }

    /// The horizontal axis.
    pub fn x_axis(mut self, axis: Axis) -> Self {
        self.x = axis;
        self
    }

    /// The vertical axis.
    pub fn y_axis(mut self, axis: Axis) -> Self {
        self.y = axis;
        self
    }

    /// Adds a series. One without a name is not in the legend.
    pub fn series(mut self, series: Series) -> Self {
        self.series.push(series);
        self
    }

    /// A labelled line at one y. An automatic range is widened to hold it.
    pub fn hline(self, y: f64, label: &str) -> Self {
        self.reference(false, y, y, label)
    }

    /// A labelled line at one x. An automatic range is widened to hold it.
    pub fn vline(self, x: f64, label: &str) -> Self {
        self.reference(true, x, x, label)
    }

    /// Shades what lies between two y: a tolerance.
    pub fn hband(self, from: f64, to: f64, label: &str) -> Self {
        self.reference(false, from, to, label)
    }

    /// Shades what lies between two x: a gap, an episode. Thousands of them stay small; label only a few.
    pub fn vband(self, from: f64, to: f64, label: &str) -> Self {
        self.reference(true, from, to, label)
    }

    fn reference(mut self, of_x: bool, from: f64, to: f64, label: &str) -> Self {
        self.references.push(Reference {
            of_x,
            from,
            to,
            label: label.into(),
        });
        self
    }

    /// The picture, `width` pixels wide (at least 280) and `height` high, or as much more as leaves the plot 90 pixels.
    pub fn to_svg(&self, width: u32, height: u32) -> String {
        let width = f64::from(width.max(280));
        let mut svg = Svg::default();
        let styles: Vec<Style> = self
            .series
            .iter()
            .enumerate()
            .map(|(i, s)| style(s.slot.unwrap_or(i)))
            .collect();
        let legend: Vec<_> = self
            .series
            .iter()
            .zip(&styles)
            .map(|(s, st)| (s.legend_name(), swatch(s, *st)))
            .collect();
        let head = self.sheet.head(&mut svg, width, &legend);

        // Vertically: words, y caption, plot, ticks and caption of x, footnotes.
        let (x_data, y_data) = self.extents();
        let empty = !self
            .series
            .iter()
            .any(|s| s.points().any(|p| self.usable(p)));
        let slot = (width - 90.0) / self.x.category_names().map_or(1, <[_]>::len).max(1) as f64;
        let slanted = self.slanted(slot);
        let slant_height = slanted
            .iter()
            .map(|name| text_width(name, TICK) * 0.5)
            .fold(0.0, f64::max);
        let notes = self.sheet.foot_lines(width, &self.notes());
        let top = (head
            + if self.y.caption((0.0, 1.0)).is_empty() {
                8.0
            } else {
                22.0
            })
        .round();
        let below = if slanted.is_empty() {
            22.0
        } else {
            slant_height + 16.0
        };
        let below = below
            + if self.x.caption((0.0, 1.0)).is_empty() {
                0.0
            } else {
                16.0
            };
        let bottom = (f64::from(height) - foot_height(&notes) - below)
            .max(top + 90.0)
            .round();

        // Horizontally: the y ticks decide where the plot starts.
        let most = ((bottom - top) / 30.0).clamp(2.0, 8.0) as usize;
        let solid = self.series.iter().any(Series::is_solid);
        let y_range = self
            .y
            .resolve(y_data, if solid { 0.07 } else { 0.03 }, true, most);
        let shown = |axis: &Axis, ticks: Vec<(f64, String)>| {
            if empty && axis.is_automatic() && axis.category_names().is_none() {
                Vec::new()
            } else {
                ticks
            }
        };
        let y_ticks = shown(&self.y, self.y.ticks(y_range, most));
        let widest = y_ticks
            .iter()
            .map(|t| text_width(&t.1, TICK))
            .fold(0.0, f64::max)
            .min(width * 0.3);
        let lean = slanted
            .first()
            .map_or(0.0, |name| text_width(name, TICK) * 0.87 - slot / 2.0);
        let left = (widest + 16.0).max(lean + 8.0).round();
        let plot = Rect {
            x0: left,
            y0: top,
            x1: (width - 14.0).round(),
            y1: bottom,
        };
        let most = ((plot.x1 - plot.x0) / 80.0).clamp(2.0, 10.0) as usize;
        let pad = self.series.iter().map(Series::padding).fold(0.0, f64::max);
        let x_range = self.x.resolve(x_data, pad, false, most);
        let x_ticks = shown(&self.x, self.x.ticks(x_range, most));
        let x = Scale {
            range: x_range,
            log: self.x.is_log(),
            pixels: (plot.x0, plot.x1),
        };
        let y = Scale {
            range: y_range,
            log: self.y.is_log(),
            pixels: (plot.y1, plot.y0),
        };

        let mut canvas = draw::Canvas {
            chart: self,
            svg,
            plot,
            x,
            y,
            labels: Placer::new(plot),
            beside: Vec::new(),
            values: Vec::new(),
        };
        canvas.bands();
        canvas.grid(&x_ticks, &y_ticks);
        canvas.series(&styles);
        canvas.reference_lines();
        canvas.write_labels();
        let mut svg = canvas.svg;

        let frame = "fill=\"none\" stroke=\"#8a8a8a\"";
        svg.rect(
            plot.x0,
            plot.y0,
            plot.x1 - plot.x0,
            plot.y1 - plot.y0,
            frame,
        );
        if empty {
            let centre = ((plot.x0 + plot.x1) / 2.0, (plot.y0 + plot.y1) / 2.0 + 5.0);
            svg.text(
                centre.0,
                centre.1,
                14.0,
                Anchor::Middle,
                "fill=\"#767676\"",
                "no data",
            );
        }
        let grey = format!("fill=\"{MUTED}\"");
        let caption = shorten(&self.y.caption(y_range), TICK, width - 20.0);
        svg.text(10.0, plot.y0 - 8.0, TICK, Anchor::Start, &grey, &caption);
        let mut free = f64::INFINITY;
        for (value, text) in &y_ticks {
            let at = y.at(*value);
            if at + 5.0 <= free {
                svg.text(
                    plot.x0 - 6.0,
                    at + 4.0,
                    TICK,
                    Anchor::End,
                    "",
                    &shorten(text, TICK, widest + 1.0),
                );
                free = at - 7.0;
            }
        }
        let at = x_ticks.into_iter().map(|(value, text)| (x.at(value), text));
        if slanted.is_empty() {
            ticks_below(&mut svg, plot.y1, width, at);
        } else {
            let every = (14.0 / slot).ceil().max(1.0) as usize;
            for ((x, _), name) in at.zip(&slanted).step_by(every) {
                let (x, y) = (x + 4.0, plot.y1 + 13.0);
                let turn = format!("transform=\"rotate(-30 {} {})\"", num(x), num(y));
                svg.text(x, y, TICK, Anchor::End, &turn, name);
            }
        }
        let caption = shorten(&self.x.caption(x_range), TICK, plot.x1 - plot.x0);
        svg.text(
            (plot.x0 + plot.x1) / 2.0,
            plot.y1 + below - 5.0,
            TICK,
            Anchor::Middle,
            &grey,
            &caption,
        );
        let end = Sheet::foot(&mut svg, plot.y1 + below, &notes);
        svg.finish(width, end.max(f64::from(height)), &self.sheet.title)
    }

    /// Category names when they are too long to stand side by side.
    fn slanted(&self, slot: f64) -> Vec<String> {
        let names = self.x.category_names().unwrap_or_default();
        match names.iter().any(|name| text_width(name, TICK) > slot - 6.0) {
            true => names
                .iter()
                .map(|name| shorten(name, TICK, 150.0))
                .collect(),
            false => Vec::new(),
        }
    }

    fn usable(&self, (x, low, high): (f64, f64, f64)) -> bool {
        self.x.usable(x) && self.y.usable(low) && self.y.usable(high)
    }

    /// What an automatic range has to hold.
    fn extents(&self) -> (Extent, Extent) {
        let (mut x, mut y) = (Extent::default(), Extent::default());
        for series in &self.series {
            for (at, low, high) in series.points().filter(|p| self.usable(*p)) {
                x.add(at);
                y.add(low);
                y.add(high);
            }
            if let Shape::Bars(values) = &series.shape
                && !self.x.is_log()
            {
                x.add(-0.5);
                x.add(values.len() as f64 - 0.5);
            }
            // What is solid stands on zero or, on a log axis, somewhat below the least.
            if let (true, Some((low, _))) = (series.is_solid(), y.0) {
                y.add(if self.y.is_log() { low / 2.0 } else { 0.0 });
            }
        }
        for reference in &self.references {
            let (axis, extent) = if reference.of_x {
                (&self.x, &mut x)
            } else {
                (&self.y, &mut y)
            };
            [reference.from, reference.to]
                .into_iter()
                .filter(|v| axis.usable(*v))
                .for_each(|v| extent.add(v));
        }
        (x, y)
    }

    /// What was left out, per series.
    fn notes(&self) -> Vec<String> {
        let mut notes = Vec::new();
        for series in &self.series {
            let (mut not_finite, mut not_positive, mut outside) = (0, 0, 0);
            if let Shape::Histogram(h) = &series.shape {
                let bins = h.edges.windows(2).zip(&h.counts);
                let hidden = bins
                    .filter(|(edge, _)| !self.x.shows((edge[0] + edge[1]) / 2.0))
                    .map(|(_, n)| *n as usize);
                (not_finite, outside) = (h.not_finite, h.outside + hidden.sum::<usize>());
            } else {
                for p in series.points() {
                    if ![p.0, p.1, p.2].iter().all(|v| v.abs() < 1e100) {
                        not_finite += 1;
                    } else if !self.usable(p) {
                        not_positive += 1;
                    } else if !(self.x.shows(p.0) && self.y.shows(p.1) && self.y.shows(p.2)) {
                        outside += 1;
                    }
                }
            }
            let counted = [
                (not_finite, "not finite"),
                (not_positive, "not above zero, which a log axis cannot show"),
                (outside, "outside the range shown"),
            ];
            for (n, what) in counted.into_iter().filter(|(n, _)| *n > 0) {
                let who = if series.name.is_empty() {
                    String::new()
                } else {
                    format!("{}: ", series.name)
                };
                notes.push(format!(
                    "{who}{n} {} {what}",
                    if n == 1 { "point" } else { "points" }
                ));
            }
        }
        notes
    }
}

fn swatch(series: &Series, style: Style) -> Swatch {
    let marker = series.has_markers().then_some(style);
    match &series.shape {
        Shape::Line(_) | Shape::Steps(_) => Swatch::Line(Some(series.stroke(style)), marker),
        Shape::Scatter(_) => Swatch::Line(None, marker),
        Shape::Band(_) => Swatch::Box(style.colour, 0.2),
        Shape::Bars(_) => Swatch::Box(style.colour, 1.0),
        Shape::Histogram(_) => Swatch::Box(style.colour, 0.3),
    }
}
