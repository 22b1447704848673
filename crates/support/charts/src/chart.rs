//! A chart: series over two axes, reference lines, and the words around them.

mod draw;

use crate::axis::{Axis, Extent, Scale, significant};
use crate::geometry::Rect;
use crate::series::{Series, Shape, Style, style};
use crate::sheet::{Sheet, Swatch, TICK, foot_height};
use crate::svg::{Svg, shorten, text_width};
use draw::Canvas;

/// A chart under construction; every method returns it, [`Chart::to_svg`] draws it.
#[derive(Clone, Debug)]
pub struct Chart {
    sheet: Sheet,
    x: Axis,
    y: Axis,
    series: Vec<Series>,
    references: Vec<Reference>,
}

/// A reference line across the whole plot.
#[derive(Clone, Debug)]
struct Reference {
    of_x: bool,
    at: f64,
    label: String,
}

/// Where everything in a chart stands.
struct Layout {
    plot: Rect,
    x: Scale,
    y: Scale,
    x_ticks: Vec<(f64, String)>,
    y_ticks: Vec<(f64, String)>,
    /// Category names, where they need to be slanted.
    slanted: Vec<String>,
    /// Height of the ticks and the caption below the plot.
    below: f64,
    empty: bool,
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

    /// A labelled line at one y. The range is widened to hold it.
    pub fn hline(self, y: f64, label: &str) -> Self {
        self.reference(false, y, label)
    }

    /// A labelled line at one x. The range is widened to hold it.
    pub fn vline(self, x: f64, label: &str) -> Self {
        self.reference(true, x, label)
    }

    fn reference(mut self, of_x: bool, at: f64, label: &str) -> Self {
        self.references.push(Reference {
            of_x,
            at,
            label: label.into(),
        });
        self
    }

    /// The chart, `width` pixels wide (at least 280) and `height` high, or as much more as leaves
    /// the plot 90 pixels.
    pub fn to_svg(&self, width: u32, height: u32) -> String {
        let (width, height) = (f64::from(width.max(280)), f64::from(height));
        let mut svg = Svg::default();
        let slots = self.series.iter().enumerate();
        let styles: Vec<Style> = slots.map(|(i, s)| style(s.slot.unwrap_or(i))).collect();
        let named = self.series.iter().zip(&styles);
        let legend: Vec<_> = named
            .map(|(s, style)| (s.legend_name(), swatch(s, *style)))
            .collect();
        let head = self.sheet.head(&mut svg, width, &legend);
        let notes = self.sheet.foot_lines(width, &self.notes());
        let layout = self.layout(width, head, height - foot_height(&notes));
        let foot = layout.plot.y1 + layout.below;

        let mut canvas = Canvas::new(self, svg, &layout);
        canvas.grid();
        canvas.series(&styles);
        canvas.reference_lines();
        canvas.write_labels();
        canvas.frame();
        canvas.axis_texts(width);
        let mut svg = canvas.svg;
        let end = Sheet::foot(&mut svg, foot, &notes);
        svg.finish(width, end.max(height), &self.sheet.title)
    }

    /// Shares out the space from `head` to `foot`, and fixes ranges and ticks.
    fn layout(&self, width: f64, head: f64, foot: f64) -> Layout {
        let (x_data, y_data) = self.extents();
        let empty = !self
            .series
            .iter()
            .any(|s| s.points().any(|p| self.usable(p)));
        let shown = |axis: &Axis, range: (f64, f64), most: usize| {
            // Without data there is no scale to show.
            if empty && axis.category_names().is_none() {
                Vec::new()
            } else {
                axis.ticks(range, most)
            }
        };
        let widest = |texts: &mut dyn Iterator<Item = &String>| {
            texts.map(|text| text_width(text, TICK)).fold(0.0, f64::max)
        };

        // Vertically: words, y caption, plot, ticks and caption of x, footnotes.
        let slot = (width - 90.0) / self.x.category_names().map_or(1, <[_]>::len).max(1) as f64;
        let slanted = self.slanted(slot);
        let ticks = if slanted.is_empty() {
            22.0
        } else {
            widest(&mut slanted.iter()) * 0.5 + 16.0
        };
        let below = ticks + if self.x.has_caption() { 16.0 } else { 0.0 };
        let top = (head + if self.y.has_caption() { 22.0 } else { 8.0 }).round();
        let bottom = (foot - below).max(top + 90.0).round();

        // Horizontally: the y ticks decide where the plot starts.
        let most = ((bottom - top) / 30.0).clamp(2.0, 8.0) as usize;
        let pad = if self.series.iter().any(Series::is_solid) {
            0.07
        } else {
            0.03
        };
        let y_range = self.y.resolve(y_data, pad, true, most);
        let y_ticks = shown(&self.y, y_range, most);
        let tick_room = widest(&mut y_ticks.iter().map(|t| &t.1)).min(width * 0.3);
        let lean = slanted
            .first()
            .map_or(0.0, |name| text_width(name, TICK) * 0.87 - slot / 2.0);
        let left = (tick_room + 16.0).max(lean + 8.0).round();
        let plot = Rect {
            x0: left,
            y0: top,
            x1: (width - 14.0).round(),
            y1: bottom,
        };

        let most = ((plot.x1 - plot.x0) / 80.0).clamp(2.0, 10.0) as usize;
        let pad = self.series.iter().map(Series::padding).fold(0.0, f64::max);
        let x_range = self.x.resolve(x_data, pad, false, most);
        let x_ticks = shown(&self.x, x_range, most);
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
        Layout {
            plot,
            x,
            y,
            x_ticks,
            y_ticks,
            slanted,
            below,
            empty,
        }
    }

    /// Category names when they are too long to stand side by side.
    fn slanted(&self, slot: f64) -> Vec<String> {
        let names = self.x.category_names().unwrap_or_default();
        if names
            .iter()
            .all(|name| text_width(name, TICK) <= slot - 6.0)
        {
            return Vec::new();
        }
        names
            .iter()
            .map(|name| shorten(name, TICK, 150.0))
            .collect()
    }

    fn usable(&self, (x, y): (f64, f64)) -> bool {
        self.x.usable(x) && self.y.usable(y)
    }

    /// What the ranges have to hold.
    fn extents(&self) -> (Extent, Extent) {
        let (mut x, mut y) = (Extent::default(), Extent::default());
        for series in &self.series {
            for p in series.points().filter(|p| self.usable(*p)) {
                x.add(p.0);
                y.add(p.1);
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
            if axis.usable(reference.at) {
                extent.add(reference.at);
            }
        }
        (x, y)
    }

    /// What was left out, per series.
    fn notes(&self) -> Vec<String> {
        let mut notes = Vec::new();
        for series in &self.series {
            let (mut not_finite, mut not_positive) = (0, 0);
            if let Shape::Histogram(h) = &series.shape {
                not_finite = h.not_finite;
            } else {
                for p in series.points() {
                    if p.0.is_nan() && p.1.is_nan() {
                        // A break on purpose.
                    } else if ![p.0, p.1].iter().all(|v| v.abs() < 1e100) {
                        not_finite += 1;
                    } else if !self.usable(p) {
                        not_positive += 1;
                    }
                }
            }
            let counted = [
                (not_finite, "not finite"),
                (not_positive, "not above zero, which a log axis cannot show"),
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
        for r in &self.references {
            let axis = if r.of_x { &self.x } else { &self.y };
            if !axis.usable(r.at) {
                notes.push(format!(
                    "the line at {} ({}) cannot be shown",
                    significant(r.at),
                    r.label
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
        Shape::Bars(_) => Swatch::Box(style.colour, 1.0),
        Shape::Histogram(_) => Swatch::Box(style.colour, 0.3),
    }
}
