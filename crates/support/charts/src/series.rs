//! What is drawn in a chart, and how series are distinguished: colours of the Okabe–Ito palette,
//! and a dash or marker of their own for readers and printers who see no colour.

use crate::axis::Extent;

/// Between two points of a line: breaks it, and unlike a value that cannot be drawn is not
/// reported.
pub const BREAK: (f64, f64) = (f64::NAN, f64::NAN);

/// A named set of values.
#[derive(Clone, Debug)]
pub struct Series {
    pub(crate) name: String,
    pub(crate) shape: Shape,
    pub(crate) labels: Vec<String>,
    pub(crate) slot: Option<usize>,
}

#[derive(Clone, Debug)]
pub(crate) enum Shape {
    Line(Vec<(f64, f64)>),
    Steps(Vec<(f64, f64)>),
    Scatter(Vec<(f64, f64)>),
    Bars(Vec<f64>),
    Histogram(Histogram),
}

/// How a histogram divides its values.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Bins {
    /// Number of bins of equal width from the least to the greatest value.
    Count(usize),
    /// Bins of this width, starting at a multiple of it.
    Width(f64),
}

impl Series {
    fn new(name: &str, shape: Shape) -> Self {
        Self {
            name: name.into(),
            shape,
            labels: Vec::new(),
            slot: None,
        }
    }

    /// Points joined in their order; few points get markers. A point that cannot be drawn breaks
    /// the line.
    pub fn line(name: &str, points: impl IntoIterator<Item = (f64, f64)>) -> Self {
        Self::new(name, Shape::Line(points.into_iter().collect()))
    }

    /// A value that holds from its x until the next point.
    pub fn steps(name: &str, points: impl IntoIterator<Item = (f64, f64)>) -> Self {
        Self::new(name, Shape::Steps(points.into_iter().collect()))
    }

    /// Points by themselves.
    pub fn scatter(name: &str, points: impl IntoIterator<Item = (f64, f64)>) -> Self {
        Self::new(name, Shape::Scatter(points.into_iter().collect()))
    }

    /// One bar per category, in the order of [`crate::Axis::categories`]. Several such series stand
    /// side by side.
    pub fn bars(name: &str, values: impl IntoIterator<Item = f64>) -> Self {
        Self::new(name, Shape::Bars(values.into_iter().collect()))
    }

    /// Counts of values per bin. Values that are not finite are counted in the footnote.
    pub fn histogram(name: &str, values: impl IntoIterator<Item = f64>, bins: Bins) -> Self {
        Self::new(
            name,
            Shape::Histogram(Histogram::new(values.into_iter().collect(), bins)),
        )
    }

    /// A text beside each point, in order; an empty one is left out. For lines, steps and scatter
    /// of at most 300 points.
    pub fn labels<T: Into<String>>(mut self, labels: impl IntoIterator<Item = T>) -> Self {
        self.labels = labels.into_iter().map(Into::into).collect();
        self
    }

    /// Draws with the colour, dash and marker of slot `n` rather than those of its position, so
    /// that the same thing looks the same in several charts.
    pub fn slot(mut self, n: usize) -> Self {
        self.slot = Some(n);
        self
    }

    /// What decides the range; values that cannot be drawn included.
    pub(crate) fn points(&self) -> Box<dyn Iterator<Item = (f64, f64)> + '_> {
        match &self.shape {
            Shape::Line(points) | Shape::Steps(points) | Shape::Scatter(points) => {
                Box::new(points.iter().copied())
            }
            Shape::Bars(values) => Box::new(values.iter().enumerate().map(|(i, &v)| (i as f64, v))),
            Shape::Histogram(h) => Box::new(h.corners()),
        }
    }

    /// Its name in the legend; empty where its own labels say it already.
    pub(crate) fn legend_name(&self) -> &str {
        if self.labels == [self.name.as_str()] {
            ""
        } else {
            &self.name
        }
    }

    pub(crate) fn has_markers(&self) -> bool {
        match &self.shape {
            Shape::Line(points) => points.len() <= 40,
            Shape::Scatter(_) => true,
            _ => false,
        }
    }

    /// The share of the width it needs free at each side.
    pub(crate) fn padding(&self) -> f64 {
        match self.shape {
            Shape::Histogram(_) => 0.02,
            Shape::Scatter(ref points) if points.len() > 1000 => 0.0,
            _ if self.has_markers() => 0.04,
            _ => 0.0,
        }
    }

    /// The points that may have a marker and a label.
    pub(crate) fn single_points(&self) -> Option<&[(f64, f64)]> {
        match &self.shape {
            Shape::Line(points) | Shape::Steps(points) | Shape::Scatter(points) => Some(points),
            _ => None,
        }
    }

    /// Whether its points fill the pixels, so that neither a dash nor a short break can be seen.
    pub(crate) fn is_dense(&self) -> bool {
        self.single_points()
            .is_some_and(|points| points.len() > 1500)
    }

    pub(crate) fn bar_values(&self) -> Option<&[f64]> {
        match &self.shape {
            Shape::Bars(values) => Some(values),
            _ => None,
        }
    }

    /// Stroke attributes of its line.
    pub(crate) fn stroke(&self, style: Style) -> String {
        let (wide, dash) = match &self.shape {
            _ if self.is_dense() => ("1.1", ""),
            Shape::Histogram(_) => ("1.3", style.dash),
            _ => ("1.8", style.dash),
        };
        let colour = style.colour;
        let mut look = format!(
            "fill=\"none\" stroke=\"{colour}\" stroke-width=\"{wide}\" stroke-linejoin=\"round\""
        );
        if !dash.is_empty() {
            look.push_str(&format!(" stroke-dasharray=\"{dash}\""));
        }
        look
    }

    /// Whether it stands on the zero line.
    pub(crate) fn is_solid(&self) -> bool {
        matches!(self.shape, Shape::Bars(_) | Shape::Histogram(_))
    }
}

#[derive(Clone, Debug)]
pub(crate) struct Histogram {
    pub(crate) edges: Vec<f64>,
    pub(crate) counts: Vec<u64>,
    pub(crate) not_finite: usize,
}

/// More bins than this cannot be distinguished.
const MOST_BINS: usize = 2000;

impl Histogram {
    fn new(mut values: Vec<f64>, bins: Bins) -> Self {
        let all = values.len();
        values.retain(|v| v.abs() < 1e100);
        let not_finite = all - values.len();
        let mut extent = Extent::default();
        values.iter().for_each(|v| extent.add(*v));
        let edges = extent
            .0
            .map_or_else(Vec::new, |(lo, hi)| edges(lo, hi, bins));
        let mut counts = vec![0; edges.len().saturating_sub(1)];
        // The outer edges belong to the outer bins, even where rounding puts a value beyond one.
        if let Some(last) = counts.len().checked_sub(1) {
            for v in values {
                let above = edges.partition_point(|edge| *edge <= v);
                counts[above.saturating_sub(1).min(last)] += 1;
            }
        }
        Self {
            edges,
            counts,
            not_finite,
        }
    }

    pub(crate) fn corners(&self) -> impl Iterator<Item = (f64, f64)> + '_ {
        self.edges
            .windows(2)
            .zip(&self.counts)
            .flat_map(|(edge, &n)| [(edge[0], n as f64), (edge[1], n as f64)])
    }
}

fn edges(lo: f64, hi: f64, bins: Bins) -> Vec<f64> {
    let even = |lo: f64, hi: f64, n: usize| -> Vec<f64> {
        let n = n.clamp(1, MOST_BINS);
        (0..=n)
            .map(|i| {
                if i == n {
                    hi
                } else {
                    lo + (hi - lo) * i as f64 / n as f64
                }
            })
            .collect()
    };
    // A single value still needs a bin with some width.
    let wide = |lo: f64, hi: f64| {
        if hi - lo > lo.abs() * 1e-12 {
            (lo, hi)
        } else {
            (lo - lo.abs().max(1.0) * 0.05, hi + lo.abs().max(1.0) * 0.05)
        }
    };
    match bins {
        Bins::Count(n) => {
            let (lo, hi) = wide(lo, hi);
            even(lo, hi, n)
        }
        Bins::Width(width) => {
            let (first, last) = ((lo / width).floor(), (hi / width).floor() + 1.0);
            if (1e-100..1e100).contains(&width) && last - first <= MOST_BINS as f64 {
                (0..=(last - first) as usize)
                    .map(|i| (first + i as f64) * width)
                    .collect()
            } else {
                let (lo, hi) = wide(lo, hi);
                even(lo, hi, MOST_BINS)
            }
        }
    }
}

/// How one series looks.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Style {
    pub(crate) colour: &'static str,
    pub(crate) dash: &'static str,
    pub(crate) marker: Marker,
}

/// The outline of a marker about 8 px across, relative to its centre, and whether it is filled.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Marker {
    pub(crate) outline: &'static str,
    pub(crate) filled: bool,
}

/// Okabe and Ito's colours, strongest on white first; yellow is left out, it does not show on
/// white.
const COLOURS: [&str; 7] = [
    "#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000",
];
const DASHES: [&str; 7] = ["", "8 3", "2 3", "9 3 2 3", "14 4", "5 2", "12 3 2 3 2 3"];
const CIRCLE: &str = "m-4 0a4 4 0 1 0 8 0a4 4 0 1 0-8 0z";
const SQUARE: &str = "m-3.5-3.5h7v7h-7z";
const UP: &str = "m0-4.8l4.5 7.8h-9z";
const DIAMOND: &str = "m0-5l5 5l-5 5l-5-5z";
const DOWN: &str = "m0 4.8l4.5-7.8h-9z";
const MARKERS: [(&str, bool); 7] = [
    (CIRCLE, true),
    (SQUARE, true),
    (UP, true),
    (DIAMOND, true),
    (DOWN, true),
    (CIRCLE, false),
    (SQUARE, false),
];

pub(crate) fn style(slot: usize) -> Style {
    // Past the palette the colours repeat with the next dash and marker.
    let (colour, shape) = (slot % 7, (slot + slot / 7) % 7);
    let (outline, filled) = MARKERS[shape];
    Style {
        colour: COLOURS[colour],
        dash: DASHES[shape],
        marker: Marker { outline, filled },
    }
}
