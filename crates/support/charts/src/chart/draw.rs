//! Draws a plot: grid, series, reference lines, labels on top of all, then the texts around it.

use super::{Chart, Layout};
use crate::axis::{Scale, significant};
use crate::geometry::{Point, Rect, cells, clip_line, clip_polygon, thin};
use crate::labels::{Placer, SIZE};
use crate::series::{Histogram, Series, Shape, Style};
use crate::sheet::{GRID, TICK, markers, ticks_below};
use crate::svg::{Anchor, MUTED, Svg, num, shorten, text_width};

/// Above this many points markers shrink to dots without labels, and above the second to squares of
/// a grid.
const DOTS_ABOVE: usize = 300;
const CELLS_ABOVE: usize = 3000;

pub(super) struct Canvas<'a> {
    chart: &'a Chart,
    pub(super) svg: Svg,
    layout: &'a Layout,
    plot: Rect,
    x: Scale,
    y: Scale,
    placer: Placer,
    /// Written last: labels beside these points, and the values centred above bars.
    labels: Vec<(Point, String)>,
    values: Vec<(Point, String)>,
}

impl<'a> Canvas<'a> {
    pub(super) fn new(chart: &'a Chart, svg: Svg, layout: &'a Layout) -> Self {
        let Layout { plot, x, y, .. } = *layout;
        let (labels, values) = (Vec::new(), Vec::new());
        Self {
            chart,
            svg,
            layout,
            plot,
            x,
            y,
            placer: Placer::new(plot),
            labels,
            values,
        }
    }

    fn pixel(&self, (x, y): Point) -> Point {
        (self.x.at(x), self.y.at(y))
    }

    /// Where bars stand.
    fn ground(&self) -> f64 {
        let (lo, hi) = self.y.range;
        self.y.at(if self.y.log {
            lo
        } else {
            0.0_f64.clamp(lo, hi)
        })
    }

    pub(super) fn grid(&mut self) {
        let Rect { x0, y0, x1, y1 } = self.plot;
        let x_ticks = if self.chart.x.category_names().is_some() {
            &[][..]
        } else {
            &self.layout.x_ticks
        };
        for (v, _) in x_ticks {
            let at = self.x.at(*v).clamp(x0, x1);
            self.svg.line((at, y0), (at, y1), GRID);
        }
        for (v, _) in &self.layout.y_ticks {
            let at = self.y.at(*v).clamp(y0, y1);
            let zero = *v == 0.0 && !self.y.log;
            self.svg.line(
                (x0, at),
                (x1, at),
                if zero { "stroke=\"#8a8a8a\"" } else { GRID },
            );
        }
    }

    /// Areas first, then lines, then points.
    pub(super) fn series(&mut self, styles: &[Style]) {
        let chart = self.chart;
        let all = || chart.series.iter().zip(styles.iter().copied());
        let bars = all().filter_map(|(s, style)| s.bar_values().map(|values| (values, style)));
        self.draw_bars(&bars.collect::<Vec<_>>());
        for (series, style) in all() {
            if let Shape::Histogram(h) = &series.shape {
                self.draw_histogram(h, style, &series.stroke(style));
            }
        }
        for (series, style) in all() {
            match &series.shape {
                Shape::Line(points) => self.draw_line(series, points, style),
                Shape::Steps(points) => self.draw_line(series, &corners_of_steps(points), style),
                _ => {}
            }
        }
        for (series, style) in all() {
            if let Some(points) = series.single_points() {
                self.draw_points(series, points, style);
            }
        }
    }

    fn draw_line(&mut self, series: &Series, points: &[Point], style: Style) {
        let chart = self.chart;
        let mut pieces: Vec<Vec<Point>> = Vec::new();
        for run in points
            .split(|p| !chart.usable(*p))
            .filter(|run| !run.is_empty())
        {
            let pixels: Vec<Point> = run.iter().map(|p| self.pixel(*p)).collect();
            for piece in clip_line(&pixels, self.plot) {
                // Thousands of breaks inside pixel columns are too fine to show, and to store.
                let column = |p: Option<&Point>| p.map(|p| p.0.floor());
                let joins = |last: &&mut Vec<Point>| {
                    series.is_dense() && column(last.last()) == column(piece.first())
                };
                match pieces.last_mut().filter(joins) {
                    Some(last) => last.extend(piece),
                    None => pieces.push(piece),
                }
            }
        }
        for piece in pieces {
            let piece = thin(&piece);
            match piece.as_slice() {
                [only] => self.dots(&[*only], style.colour, 2.6),
                piece => self.svg.poly("polyline", piece, &series.stroke(style)),
            }
            self.placer.avoid_line(&piece);
        }
    }

    fn draw_points(&mut self, series: &Series, points: &[Point], style: Style) {
        let (chart, x, y) = (self.chart, self.x, self.y);
        let visible = |p: &Point| chart.usable(*p) && x.holds(p.0) && y.holds(p.1);
        let pixels: Vec<Point> = points
            .iter()
            .filter(|p| visible(p))
            .map(|p| self.pixel(*p))
            .collect();
        if series.has_markers() {
            match pixels.len() {
                n if n > CELLS_ABOVE => self.draw_cells(&pixels, style.colour),
                n if n > DOTS_ABOVE => self.dots(&pixels, style.colour, 3.0),
                _ => markers(&mut self.svg, &pixels, style),
            }
        }
        if points.len() <= DOTS_ABOVE {
            let rect = |&(x, y): &Point| Rect {
                x0: x - 4.0,
                y0: y - 4.0,
                x1: x + 4.0,
                y1: y + 4.0,
            };
            pixels.iter().for_each(|p| self.placer.avoid(rect(p)));
            let labelled = points
                .iter()
                .zip(&series.labels)
                .filter(|(p, text)| visible(p) && !text.is_empty());
            self.labels
                .extend(labelled.map(|(p, text)| ((x.at(p.0), y.at(p.1)), text.clone())));
        }
    }

    fn dots(&mut self, points: &[Point], colour: &str, wide: f64) {
        let mut d = String::new();
        points
            .iter()
            .for_each(|p| d.push_str(&format!("M{} {}h.01", num(p.0), num(p.1))));
        let stroke =
            format!("stroke=\"{colour}\" stroke-width=\"{wide}\" stroke-linecap=\"round\"");
        self.svg.element("path", &format!("d=\"{d}\" {stroke}"));
    }

    /// More points than can be distinguished: the squares that hold one, larger where they are
    /// many.
    fn draw_cells(&mut self, points: &[Point], colour: &str) {
        let fine = cells(points, 2.0);
        let (size, strokes) = if fine.len() <= 4000 {
            (2.0, fine)
        } else {
            (4.0, cells(points, 4.0))
        };
        let mut d = String::new();
        for ((x, y), long) in strokes {
            let (x, y) = (x.min(self.plot.x1), (y - size / 2.0).max(self.plot.y0));
            let end = (y + long + size).min(self.plot.y1);
            d.push_str(&format!("M{} {}V{}", num(x), num(y), num(end)));
            self.placer.avoid_line(&[(x, y), (x, end)]);
        }
        self.svg.element(
            "path",
            &format!("d=\"{d}\" stroke=\"{colour}\" stroke-width=\"{size}\""),
        );
    }

    fn draw_histogram(&mut self, histogram: &Histogram, style: Style, stroke: &str) {
        let ground = self.ground();
        let top = |n: f64| if n > 0.0 { self.y.at(n) } else { ground };
        let tops: Vec<Point> = histogram
            .corners()
            .map(|(edge, n)| (self.x.at(edge), top(n)))
            .collect();
        let (Some(first), Some(last)) = (tops.first(), tops.last()) else {
            return;
        };
        let ends = [(first.0, ground), (last.0, ground)];
        let outline = thin(&[&ends[..1], &tops, &ends[1..]].concat());
        let look = format!("fill=\"{}\" fill-opacity=\"0.3\"", style.colour);
        self.svg
            .poly("polygon", &clip_polygon(outline.clone(), self.plot), &look);
        for piece in clip_line(&outline, self.plot) {
            self.svg.poly("polyline", &piece, stroke);
            self.placer.avoid_line(&piece);
        }
    }

    /// Bars side by side. Their values stand above them where there is room for all of them.
    fn draw_bars(&mut self, series: &[(&[f64], Style)]) {
        let axis = &self.chart.y;
        let slot = if self.x.log {
            0.0
        } else {
            self.x.at(1.0) - self.x.at(0.0)
        };
        let wide = (slot * 0.8 / series.len() as f64).clamp(1.0, 70.0);
        let ground = self.ground();
        let text = |v: &f64| {
            if axis.usable(*v) {
                significant(*v)
            } else {
                "n/a".into()
            }
        };
        let fits = |v: &f64| text_width(&text(v), 10.0) <= wide + 8.0;
        let with_values = series.iter().all(|(values, _)| values.iter().all(fits));
        for (index, (values, style)) in series.iter().enumerate() {
            for (i, value) in values
                .iter()
                .enumerate()
                .filter(|(i, _)| self.x.holds(*i as f64))
            {
                let left = self.x.at(i as f64) + (index as f64 - series.len() as f64 / 2.0) * wide;
                let x0 = left.max(self.plot.x0);
                let x1 = (left + wide - 1.0).min(self.plot.x1).max(x0 + 0.5);
                let mut top = ground;
                if axis.usable(*value) {
                    top = self.y.at(*value).clamp(self.plot.y0, self.plot.y1);
                    let (y0, y1) = (top.min(ground), top.max(ground));
                    self.svg.rect(
                        x0,
                        y0,
                        x1 - x0,
                        y1 - y0,
                        &format!("fill=\"{}\"", style.colour),
                    );
                    self.placer.avoid(Rect {
                        x0,
                        y0: y0 - 12.0,
                        x1,
                        y1,
                    });
                }
                if with_values {
                    let above = (top - 3.0).max(self.plot.y0 + 9.0);
                    let y = if *value < 0.0 { top + 11.0 } else { above };
                    self.values.push((((x0 + x1) / 2.0, y), text(value)));
                }
            }
        }
    }

    /// The lines and their labels, which take their places before the labels of points.
    pub(super) fn reference_lines(&mut self) {
        let Rect { x0, y0, x1, y1 } = self.plot;
        for r in &self.chart.references {
            let (axis, scale) = if r.of_x {
                (&self.chart.x, self.x)
            } else {
                (&self.chart.y, self.y)
            };
            if !axis.usable(r.at) || !scale.holds(r.at) {
                continue;
            }
            let at = scale.at(r.at);
            let (a, b) = if r.of_x {
                ((at, y0), (at, y1))
            } else {
                ((x0, at), (x1, at))
            };
            let look = "stroke=\"#444\" stroke-width=\"1.2\" stroke-dasharray=\"6 3\"";
            self.svg.line(a, b, look);
            self.placer.avoid_line(&[a, b]);
            if r.label.is_empty() {
                continue;
            }
            let wide = text_width(&r.label, SIZE);
            let starts: Vec<Point> = if r.of_x {
                let rows = (0..5).map(|row| y0 + SIZE + 2.0 + 14.0 * f64::from(row));
                rows.flat_map(|y| [(at + 4.0, y), (at - 4.0 - wide, y)])
                    .collect()
            } else {
                let across = [x1 - wide - 5.0, x0 + 5.0, (x0 + x1 - wide) / 2.0];
                let levels = [at - 5.0, at + SIZE + 3.0];
                across
                    .into_iter()
                    .flat_map(|x| levels.map(|y| (x, y)))
                    .collect()
            };
            let (x, y) = self.placer.place(&r.label, &starts);
            self.svg.text_with_rim(x, y, SIZE, Anchor::Start, &r.label);
        }
    }

    pub(super) fn write_labels(&mut self) {
        for ((x, y), text) in std::mem::take(&mut self.values) {
            self.svg.text_with_rim(x, y, 10.0, Anchor::Middle, &text);
        }
        for (at, text) in std::mem::take(&mut self.labels) {
            let (x, y) = self.placer.beside(at, &text);
            self.svg.text_with_rim(x, y, SIZE, Anchor::Start, &text);
        }
    }

    pub(super) fn frame(&mut self) {
        let Rect { x0, y0, x1, y1 } = self.plot;
        self.svg
            .rect(x0, y0, x1 - x0, y1 - y0, "fill=\"none\" stroke=\"#8a8a8a\"");
        if self.layout.empty {
            let (x, y) = ((x0 + x1) / 2.0, (y0 + y1) / 2.0 + 5.0);
            self.svg
                .text(x, y, 14.0, Anchor::Middle, "fill=\"#767676\"", "no data");
        }
    }

    /// Tick texts and captions; a text that would touch the one before is left out.
    pub(super) fn axis_texts(&mut self, width: f64) {
        let Rect { x0, y0, x1, y1 } = self.plot;
        let svg = &mut self.svg;
        let mut free = f64::INFINITY;
        for (value, text) in &self.layout.y_ticks {
            let y = self.y.at(*value);
            if y + 5.0 <= free {
                svg.text(
                    x0 - 6.0,
                    y + 4.0,
                    TICK,
                    Anchor::End,
                    "",
                    &shorten(text, TICK, x0 - 14.0),
                );
                free = y - 7.0;
            }
        }
        let slanted = &self.layout.slanted;
        let x_ticks = self
            .layout
            .x_ticks
            .iter()
            .map(|(v, text)| (self.x.at(*v), text.clone()));
        if slanted.is_empty() {
            ticks_below(svg, y1, width, x_ticks);
        } else {
            let every = (14.0 * slanted.len() as f64 / (x1 - x0)).ceil().max(1.0) as usize;
            for ((x, _), name) in x_ticks.zip(slanted).step_by(every) {
                let (x, y) = (x + 4.0, y1 + 13.0);
                let turn = format!("transform=\"rotate(-30 {} {})\"", num(x), num(y));
                svg.text(x, y, TICK, Anchor::End, &turn, name);
            }
        }
        let grey = format!("fill=\"{MUTED}\"");
        let caption = shorten(&self.chart.x.caption(self.x.range), TICK, width - 20.0);
        let below = y1 + self.layout.below - 5.0;
        svg.text(
            (x0 + x1) / 2.0,
            below,
            TICK,
            Anchor::Middle,
            &grey,
            &caption,
        );
        let caption = shorten(&self.chart.y.caption(self.y.range), TICK, width - 20.0);
        svg.text(10.0, y0 - 8.0, TICK, Anchor::Start, &grey, &caption);
    }
}

/// The corners of a step line. What cannot be drawn remains in, as the break it is.
fn corners_of_steps(points: &[Point]) -> Vec<Point> {
    let mut corners = Vec::with_capacity(points.len() * 2);
    for (i, p) in points.iter().enumerate() {
        if i > 0 {
            corners.push((p.0, points[i - 1].1));
        }
        corners.push(*p);
    }
    corners
}
