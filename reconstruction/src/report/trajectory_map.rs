//! A path from above, colored by a value, as SVG with a color scale and a scale bar.
//!
//! Contract: the scale is the same along both axes. Steps shorter than about a pixel are merged, so
//! that the size of the text is bounded. The line is broken where the rig was lost.

use std::fmt::Write as _;

use super::colors::{UNKNOWN, dark_ramp, hex, ramp};

/// Position of the rig at one time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Step {
    /// s since the beginning.
    pub(super) time_s: f64,
    /// Position in the drawn world, m: that of the ground truth if there is one.
    pub(super) x_in_world: [f64; 3],
    /// Value that it is colored by, m; `None` if not known.
    pub(super) value_m: Option<f64>,
    /// Whether the line continues from the previous step.
    pub(super) follows: bool,
}

const MAX_HEIGHT_PX: f64 = 700.0;
const MIN_HEIGHT_PX: f64 = 150.0;
const MARGIN_PX: f64 = 24.0;
/// Height of the footer below the map: scale bar and color scale.
const FOOTER_PX: f64 = 58.0;
/// Width below which the color scale takes the whole width, px.
const NARROW_WIDTH_PX: f64 = 500.0;
/// Color of the ground truth.
const GROUND_TRUTH_COLOR: &str = "#c8c8c8";
/// Number of distinct colors.
const LEVELS: usize = 24;
/// Minimum length of a drawn step, px.
const MIN_STEP_PX: f64 = 1.5;

/// From metres to pixels of the map.
struct MapFrame {
    low: [f64; 2],
    px_per_m: f64,
    width: f64,
    height: f64,
}

impl MapFrame {
    fn of(positions: impl Iterator<Item = [f64; 3]> + Clone, width: f64) -> Self {
        let end = |k: usize, start: f64, pick: fn(f64, f64) -> f64| {
            let end = positions.clone().map(|x| x[k]).fold(start, pick);
            if end.is_finite() { end } else { 0.0 }
        };
        let low = [0, 1].map(|k| end(k, f64::INFINITY, f64::min));
        let high = [0, 1].map(|k| end(k, f64::NEG_INFINITY, f64::max));
        // A rig at rest is shown within a metre.
        let size = [0, 1].map(|k| (high[k] - low[k]).max(1.0));
        let room = [width - 2.0 * MARGIN_PX, MAX_HEIGHT_PX - 2.0 * MARGIN_PX];
        let px_per_m = (room[0] / size[0]).min(room[1] / size[1]);
        let height = (size[1] * px_per_m + 2.0 * MARGIN_PX).max(MIN_HEIGHT_PX);
        // In the middle of the sheet.
        let spare = [width, height].map(|length| length / px_per_m);
        Self {
            low: [0, 1].map(|k| 0.5 * (low[k] + high[k] - spare[k])),
            px_per_m,
            width,
            height,
        }
    }

    /// Whether the color scale is below the scale bar, if there is not enough width beside it.
    fn is_narrow(&self) -> bool {
        self.width < NARROW_WIDTH_PX
    }

    fn footer_px(&self) -> f64 {
        match self.is_narrow() {
            true => 2.0 * FOOTER_PX - 6.0,
            false => FOOTER_PX,
        }
    }

    fn px(&self, x: [f64; 3]) -> [f64; 2] {
        [
            (x[0] - self.low[0]) * self.px_per_m,
            self.height - (x[1] - self.low[1]) * self.px_per_m,
        ]
    }
}

/// Content of a map.
#[derive(Clone, Copy)]
pub(super) struct Map<'a> {
    /// Positions of the rig.
    pub(super) steps: &'a [Step],
    /// The ground truth, drawn below it in gray.
    pub(super) truth: &'a [[f64; 3]],
    /// Value of the last color, m.
    pub(super) largest_m: f64,
    /// Names the values.
    pub(super) caption: &'a str,
}

/// Colors of a map on white, each with its counterpart on a dark screen.
pub(super) fn dark() -> Vec<(String, String)> {
    let middle = |level: usize| (level as f64 + 0.5) / LEVELS as f64;
    let levels = (0..LEVELS).map(|l| (hex(ramp(middle(l))), hex(dark_ramp(middle(l)))));
    levels
        .chain([(GROUND_TRUTH_COLOR.to_owned(), "#4a5159".to_owned())])
        .collect()
}

/// The SVG, `width` pixels wide.
pub(super) fn svg(map: &Map<'_>, width: u32) -> String {
    let Map {
        steps,
        truth,
        largest_m,
        caption,
    } = *map;
    let width = f64::from(width);
    let drawn = steps.iter().map(|s| s.x_in_world);
    let map_frame = MapFrame::of(drawn.chain(truth.iter().copied()), width);
    let height = map_frame.height + map_frame.footer_px();
    let mut out = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"{width}\" height=\"{height:.0}\" \
         viewBox=\"0 0 {width} {height:.0}\" role=\"img\" aria-label=\"The path from above\" font-family=\"DejaVu Sans, sans-serif\" font-size=\"12\" fill=\"#222\">\n\
         <rect width=\"{width}\" height=\"{height:.0}\" fill=\"#fff\"/>\n"
    );
    line(
        &mut out,
        &map_frame,
        truth.iter().map(|x| (*x, true)),
        GROUND_TRUTH_COLOR,
        7.0,
    );
    draw_colored_segments(&mut out, &map_frame, steps, largest_m);
    for (step, text) in [(steps.first(), "start"), (steps.last(), "end")] {
        let Some(step) = step else { continue };
        let [x, y] = map_frame.px(step.x_in_world);
        let fill = if text == "start" { "#fff" } else { "#222" };
        let (anchor, beside) = match x > 0.85 * width {
            true => ("end", x - 9.0),
            false => ("start", x + 9.0),
        };
        let _ = writeln!(
            out,
            "<circle cx=\"{x:.1}\" cy=\"{y:.1}\" r=\"4.5\" fill=\"{fill}\" stroke=\"#222\" stroke-width=\"1.5\"/>\
             <text x=\"{beside:.1}\" y=\"{:.1}\" text-anchor=\"{anchor}\">{text}</text>",
            y + if text == "start" { 16.0 } else { -8.0 }
        );
    }
    metres(&mut out, &map_frame);
    scale(&mut out, &map_frame, largest_m, caption);
    out.push_str("</svg>");
    out
}

/// One line; each position has a flag whether the line continues to it.
fn line(
    out: &mut String,
    map_frame: &MapFrame,
    positions: impl Iterator<Item = ([f64; 3], bool)>,
    color: &str,
    width: f64,
) {
    let mut path = String::new();
    let mut last: Option<[f64; 2]> = None;
    for (place, follows) in positions {
        let [x, y] = map_frame.px(place);
        let is_short = last.is_some_and(|[a, b]| (x - a).hypot(y - b) < MIN_STEP_PX);
        if follows && is_short {
            continue;
        }
        let go = if follows && last.is_some() { 'L' } else { 'M' };
        let _ = write!(path, "{go}{x:.1} {y:.1}");
        last = Some([x, y]);
    }
    let _ = writeln!(
        out,
        "<path d=\"{path}\" fill=\"none\" stroke=\"{color}\" stroke-width=\"{width}\" \
         stroke-linecap=\"round\" stroke-linejoin=\"round\"/>"
    );
}

/// Segments of one color, each as one line.
fn draw_colored_segments(out: &mut String, map_frame: &MapFrame, steps: &[Step], largest_m: f64) {
    let level = |step: &Step| {
        let share = step.value_m? / largest_m.max(f64::MIN_POSITIVE);
        Some(((share * LEVELS as f64) as usize).min(LEVELS - 1))
    };
    let mut from = 0;
    while from < steps.len() {
        let of = level(&steps[from]);
        let same = steps[from..].iter().take_while(|s| level(s) == of).count();
        // This segment begins at the end of the last one.
        let begin = if steps[from].follows {
            from.saturating_sub(1)
        } else {
            from
        };
        let stretch = steps[begin..from + same].iter().enumerate();
        let positions = stretch.map(|(k, step)| (step.x_in_world, k > 0 && step.follows));
        let color = of.map_or(UNKNOWN, |of| ramp((of as f64 + 0.5) / LEVELS as f64));
        line(out, map_frame, positions, &hex(color), 3.0);
        from += same;
    }
}

/// 1, 2 or 5 times a power of ten, about a fifth of the sheet.
fn round_length(room_m: f64) -> f64 {
    let power = 10_f64.powf(room_m.log10().floor());
    let fits = [5.0, 2.0, 1.0].into_iter().find(|k| k * power <= room_m);
    fits.unwrap_or(1.0) * power
}

fn metres(out: &mut String, map_frame: &MapFrame) {
    let length = round_length(0.25 * map_frame.width / map_frame.px_per_m);
    let (left, y) = (MARGIN_PX, map_frame.height + 22.0);
    let right = left + length * map_frame.px_per_m;
    let _ = writeln!(
        out,
        "<path d=\"M{left} {:.1}V{y:.1}H{right:.1}V{:.1}\" fill=\"none\" stroke=\"#222\" stroke-width=\"1.5\"/>\
         <text x=\"{left}\" y=\"{:.1}\">{length} m</text>",
        y - 5.0,
        y - 5.0,
        y + 17.0
    );
}

fn scale(out: &mut String, map_frame: &MapFrame, largest_m: f64, caption: &str) {
    let (left, y) = match map_frame.is_narrow() {
        true => (MARGIN_PX, map_frame.height + FOOTER_PX),
        false => (0.5 * map_frame.width, map_frame.height + 10.0),
    };
    let width = map_frame.width - MARGIN_PX - left;
    let step = width / LEVELS as f64;
    for level in 0..LEVELS {
        let color = hex(ramp((level as f64 + 0.5) / LEVELS as f64));
        let x = left + level as f64 * step;
        // A little wider, so that no line shows between two.
        let wide = step + 0.5;
        let _ = write!(
            out,
            "<rect x=\"{x:.1}\" y=\"{y:.1}\" width=\"{wide:.1}\" height=\"12\" fill=\"{color}\"/>"
        );
    }
    let (right, below) = (left + width, y + 29.0);
    let _ = writeln!(
        out,
        "\n<text x=\"{left}\" y=\"{below:.1}\">0</text>\
         <text x=\"{:.1}\" y=\"{below:.1}\" text-anchor=\"middle\">{caption}</text>\
         <text x=\"{right:.1}\" y=\"{below:.1}\" text-anchor=\"end\">{}</text>",
        left + 0.5 * width,
        charts::si(largest_m, "m")
    );
}

#[cfg(test)]
mod tests {
    use super::*;

    fn step(x: f64, y: f64, value_m: f64) -> Step {
        Step {
            time_s: 0.0,
            x_in_world: [x, y, 0.0],
            value_m: Some(value_m),
            follows: true,
        }
    }

    fn drawn(steps: &[Step], largest_m: f64) -> String {
        let map = Map {
            steps,
            truth: &[],
            largest_m,
            caption: "error",
        };
        svg(&map, 760)
    }

    #[test]
    fn every_color_has_a_dark_counterpart() {
        let steps: Vec<Step> = (0..100)
            .map(|k| step(f64::from(k), 0.0, 1e-3 * f64::from(k)))
            .collect();
        let map = Map {
            steps: &steps,
            truth: &[[0.0; 3], [9.0; 3]],
            largest_m: 0.1,
            caption: "error",
        };
        let text = svg(&map, 336);
        let dark = dark();
        for part in text.split("=\"#").skip(1) {
            let color = format!("#{}", part.split('"').next().expect("a colour"));
            let is_known = ["#fff", "#222"].contains(&&*color)
                || dark.iter().any(|(light, _)| *light == color);
            assert!(is_known, "{color}");
        }
    }

    #[test]
    fn the_bar_is_a_round_length_and_true_to_scale() {
        for (room, length) in [(1.0, 1.0), (4.9, 2.0), (23.0, 20.0), (0.07, 0.05)] {
            assert!((round_length(room) - length).abs() < 1e-9, "{room}");
        }
        let map_frame = MapFrame::of([[0.0, 0.0, 0.0], [30.0, 4.0, 0.0]].into_iter(), 760.0);
        let [a, b] = [[0.0; 3], [10.0, 0.0, 0.0]].map(|x| map_frame.px(x));
        assert!((b[0] - a[0] - 10.0 * map_frame.px_per_m).abs() < 1e-9);
        // North is up.
        assert!(map_frame.px([0.0, 1.0, 0.0])[1] < map_frame.px([0.0; 3])[1]);
    }

    #[test]
    fn the_text_of_a_long_walk_is_bounded() {
        let long: Vec<Step> = (0..50_000)
            .map(|k| {
                let s = f64::from(k) * 1e-3;
                step(20.0 * s.cos(), 20.0 * s.sin(), 0.01)
            })
            .collect();
        let text = drawn(&long, 0.02);
        assert!(text.len() < 120_000, "{}", text.len());
        // One value is one line.
        assert_eq!(text.matches("stroke-width=\"3\"").count(), 1);
    }

    #[test]
    fn lines_are_broken_where_the_rig_was_lost() {
        let mut steps: Vec<Step> = (0..10).map(|k| step(f64::from(k), 0.0, 0.01)).collect();
        steps[5].follows = false;
        let text = drawn(&steps, 0.02);
        let path = text
            .lines()
            .find(|l| l.contains("stroke-width=\"3\""))
            .expect("a line");
        assert_eq!(path.matches('M').count(), 2, "{path}");
        // Empty input does not panic.
        assert!(drawn(&[], 0.0).ends_with("</svg>"));
    }
}
