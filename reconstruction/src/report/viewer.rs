//! The view of cloud and path in three dimensions: WebGL2, with everything it needs in the page.
//!
//! Contract: the page opens it from a file, without a network; if WebGL2 is missing, a message is
//! shown instead. Embedded data take at most [`Content::max_bytes`]: the path first, then every
//! n-th point of the cloud in order, so that the same cloud gives the same bytes; the number of
//! shown points is stated. Positions are 16-bit steps within the bounding box, a step being a
//! 65535th of its edge: 1.5 mm in a scene of 100 m.
//!
//! A layer is a name, a kind and a blob of numbers, little-endian, in base64; `viewer.js` has a
//! function for each kind that documents its layout.

use scene_bundle::outputs::cloud::CloudPoint;
use serde_json::{Value, json};

use super::colors;
use super::trajectory_map::Step;
use super::viewer_page::{Template, text_bytes};
use super::views;

const TEMPLATE: Template = Template {
    html: include_str!("viewer.html"),
    script: include_str!("viewer.js"),
};
/// Maximum text for layers and the scene of Gaussians: with charts and images a report is well
/// below 25 MB.
pub(super) const MAX_BYTES: usize = 14_000_000;
/// Bytes per point.
const POINT_BYTES: usize = 9;
/// Maximum number of points of a line; an hour's walk at every 7 cm.
const MAX_LINE_POINTS: usize = 60_000;
/// Maximum number of pieces of a line; each has its two ends in addition to those points.
const MAX_LINE_PIECES: usize = 10_000;
/// Minimum distance of consecutive points of a line, m.
const MIN_STEP_M: f64 = 0.02;
/// Color level where the value is not known.
const UNKNOWN_LEVEL: u8 = 255;
/// Maximum coordinate that is shown, m.
const MAX_COORDINATE_M: f32 = 1e6;

/// Content of the view.
pub(super) struct Content<'a> {
    /// The cloud.
    pub(super) points: &'a [CloudPoint],
    /// The path.
    pub(super) steps: &'a [Step],
    /// The true path in the same world; empty where it is not known.
    pub(super) truth: &'a [[f64; 3]],
    /// Value of the last color, m.
    pub(super) largest_m: f64,
    /// Name of the value that the path is colored by.
    pub(super) what: &'a str,
    /// Initial camera position and target, m.
    pub(super) view: [[f64; 3]; 2],
    /// Initial maximum height of shown points, m.
    pub(super) top_m: f64,
    /// Maximum text for layers.
    pub(super) max_bytes: usize,
}

/// The view as HTML, and the number of points in it.
pub(super) struct Viewer {
    pub(super) html: String,
    pub(super) points: usize,
}

/// Renders the view.
pub(super) fn viewer(content: &Content<'_>) -> Viewer {
    let Content { steps, truth, .. } = content;
    let is_near = |p: &&CloudPoint| p.x_in_world.iter().all(|c| c.abs() <= MAX_COORDINATE_M);
    let points: Vec<&CloudPoint> = content.points.iter().filter(is_near).collect();
    let positions = points.iter().map(|p| p.x_in_world.map(f64::from));
    let positions = positions.chain(steps.iter().map(|s| s.x_in_world));
    let [low, high] = around(positions.chain(truth.iter().copied()));

    let largest_m = content.largest_m.max(f64::MIN_POSITIVE);
    let level = |value_m: f64| (254.0 * (value_m / largest_m).clamp(0.0, 1.0)).round() as u8;
    let path = line(
        steps.iter().map(|s| LinePoint {
            x: s.x_in_world,
            level: s.value_m.map_or(UNKNOWN_LEVEL, level),
            follows: s.follows,
        }),
        low,
    );
    let truth = line(
        truth.iter().enumerate().map(|(k, x)| LinePoint {
            x: *x,
            level: UNKNOWN_LEVEL,
            follows: k > 0,
        }),
        low,
    );
    let room = content
        .max_bytes
        .saturating_sub(text_bytes(path.bytes.len() + truth.bytes.len()));
    let shown = thin(&points, room / text_bytes(POINT_BYTES));
    let numbers = cloud(&shown, low, high);

    let mut layers: Vec<(Value, Vec<u8>)> = Vec::new();
    let mut layer = |mut of: Value, bytes: Vec<u8>| {
        of["blob"] = json!(format!("viewer-{}", layers.len()));
        layers.push((of, bytes));
    };
    layer(
        json!({"kind": "points", "name": "points", "count": shown.len(), "size_m": views::POINT_SIZE_M}),
        numbers,
    );
    if truth.count > 0 {
        let of =
            json!({"kind": "line", "name": "ground truth", "count": truth.count, "wide_px": 6});
        layer(of, truth.bytes);
    }
    let of = json!({"kind": "line", "name": "path", "count": path.count, "wide_px": 3});
    layer(of, path.bytes);

    let [eye, target] = content.view;
    let height = high[2] - low[2];
    let header = json!({
        "low": low,
        "high": high,
        "core": core(&shown, low, high),
        "view": {"eye": eye, "target": target},
        "cut": ((content.top_m - low[2]) / height).clamp(0.0, 1.0),
        "ramp": {
            "light": colors::ANCHORS,
            "dark": colors::DARK,
            "what": content.what,
            "most": charts::si(content.largest_m, "m"),
        },
        "layers": layers.iter().map(|(of, _)| of).collect::<Vec<_>>(),
    });
    let blobs: Vec<(String, Vec<u8>)> = layers
        .into_iter()
        .map(|(of, bytes)| (of["blob"].as_str().unwrap_or_default().to_owned(), bytes))
        .collect();
    Viewer {
        html: TEMPLATE.fill("viewer-data", &header, &blobs),
        points: shown.len(),
    }
}

/// Bounding box of all positions, at least a metre along each edge.
fn around(positions: impl Iterator<Item = [f64; 3]>) -> [[f64; 3]; 2] {
    let nowhere = [(f64::INFINITY, f64::NEG_INFINITY); 3];
    let ends = positions
        .filter(|x| x.iter().all(|c| c.is_finite()))
        .fold(nowhere, |ends, x| {
            [0, 1, 2].map(|k| (ends[k].0.min(x[k]), ends[k].1.max(x[k])))
        });
    let ends = ends.map(|(low, high)| match high - low {
        edge if edge >= 1.0 => (low, high),
        edge if edge >= 0.0 => {
            let middle = 0.5 * (low + high);
            (middle - 0.5, middle + 0.5)
        }
        _ => (-0.5, 0.5),
    });
    [ends.map(|end| end.0), ends.map(|end| end.1)]
}

/// Bounding box of nearly all points.
fn core(points: &[&CloudPoint], low: [f64; 3], high: [f64; 3]) -> [[f64; 3]; 2] {
    let all = [0, 1, 2].map(|k| {
        let values = points.iter().map(|p| f64::from(p.x_in_world[k]));
        views::range(values).unwrap_or((low[k], high[k]))
    });
    [all.map(|(low, _)| low), all.map(|(_, high)| high)]
}

/// At most `most` points, evenly sampled.
fn thin<'a>(points: &[&'a CloudPoint], most: usize) -> Vec<&'a CloudPoint> {
    let all = points.len();
    let count = all.min(most);
    (0..count).map(|k| points[k * all / count]).collect()
}

fn cloud(points: &[&CloudPoint], low: [f64; 3], high: [f64; 3]) -> Vec<u8> {
    let mut bytes = Vec::with_capacity(points.len() * POINT_BYTES);
    for point in points {
        let steps = [0, 1, 2].map(|k| {
            let share = (f64::from(point.x_in_world[k]) - low[k]) / (high[k] - low[k]);
            (65535.0 * share).round().clamp(0.0, 65535.0) as u16
        });
        bytes.extend(steps.iter().flat_map(|s| s.to_le_bytes()));
    }
    bytes.extend(points.iter().flat_map(|p| p.color));
    bytes
}

/// A point of a line.
struct LinePoint {
    x: [f64; 3],
    level: u8,
    follows: bool,
}

/// Encoded line.
struct Line {
    count: usize,
    bytes: Vec<u8>,
}

/// Points too near to the previous one are left out, and too many are thinned to every n-th; ends
/// and breaks are kept. Too many pieces between breaks are thinned to every n-th. A point that is
/// not finite breaks the line.
fn line(positions: impl Iterator<Item = LinePoint>, low: [f64; 3]) -> Line {
    let mut kept: Vec<LinePoint> = Vec::new();
    let mut skipped: Option<LinePoint> = None;
    let mut is_broken = false;
    for mut point in positions {
        if !point.x.iter().all(|c| c.is_finite()) {
            is_broken = true;
            continue;
        }
        point.follows &= !is_broken;
        is_broken = false;
        let is_near = kept.last().is_some_and(|last| {
            let off = [0, 1, 2].map(|k| point.x[k] - last.x[k]);
            off.iter().map(|c| c * c).sum::<f64>() < MIN_STEP_M * MIN_STEP_M
        });
        if point.follows && is_near {
            skipped = Some(point);
            continue;
        }
        if !point.follows {
            kept.extend(skipped.take());
        }
        skipped = None;
        kept.push(point);
    }
    kept.extend(skipped);
    let pieces = kept.iter().filter(|p| !p.follows).count();
    let every_piece = pieces.div_ceil(MAX_LINE_PIECES).max(1);
    let mut piece = 0_usize;
    kept.retain(|point| {
        piece += usize::from(!point.follows);
        piece.saturating_sub(1).is_multiple_of(every_piece)
    });
    let every = kept.len().div_ceil(MAX_LINE_POINTS).max(1);
    let last = kept.len().saturating_sub(1);
    let is_break = |k: usize| kept.get(k).is_some_and(|p| !p.follows);
    let of_line: Vec<&LinePoint> = (0..kept.len())
        .filter(|k| k % every == 0 || *k == last || is_break(*k) || is_break(k + 1))
        .map(|k| &kept[k])
        .collect();
    let numbers = of_line
        .iter()
        .flat_map(|p| [0, 1, 2].map(|k| (p.x[k] - low[k]) as f32));
    let mut bytes: Vec<u8> = numbers.flat_map(f32::to_le_bytes).collect();
    bytes.extend(of_line.iter().flat_map(|p| [p.level, u8::from(p.follows)]));
    Line {
        count: of_line.len(),
        bytes,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn point(x: [f32; 3]) -> CloudPoint {
        CloudPoint {
            x_in_world: x,
            color: [1, 2, 3],
            sigma_m: 0.01,
        }
    }

    fn step(x: f64, follows: bool) -> Step {
        Step {
            time_s: x,
            x_in_world: [x, 0.0, 0.0],
            value_m: Some(0.01 * x),
            follows,
        }
    }

    fn content<'a>(
        points: &'a [CloudPoint],
        steps: &'a [Step],
        truth: &'a [[f64; 3]],
    ) -> Content<'a> {
        Content {
            points,
            steps,
            truth,
            largest_m: 0.1,
            what: "error < 1",
            view: [[0.0, -5.0, 3.0], [0.0; 3]],
            top_m: 1.0,
            max_bytes: MAX_BYTES,
        }
    }

    fn page(html: &str) -> String {
        charts::Page::new("p").embed(html).to_html()
    }

    #[test]
    fn the_program_is_short_and_fetches_nothing() {
        assert!(TEMPLATE.lines().count() <= 600);
        let longest = TEMPLATE.lines().map(|l| l.chars().count()).max();
        assert!(longest <= Some(140), "{longest:?}");
        let viewer = viewer(&content(&[point([0.0; 3])], &[step(0.0, false)], &[]));
        assert_eq!(charts::inspect(&page(&viewer.html)), Ok(()));
        for marker in ["<!--", "error < 1"] {
            assert!(!viewer.html.contains(marker), "{marker}");
        }
        // Without WebGL2 or scripts there is a message.
        assert!(
            viewer.html.contains("data-none=\"\"")
                && viewer.html.contains("needs JavaScript and WebGL2")
        );
        assert!(viewer.html.contains("prefers-color-scheme: dark"));
    }

    #[test]
    fn points_are_quantized_to_a_step() {
        let points = [
            point([-10.0, 0.0, 2.0]),
            point([30.0, 5.0, 2.5]),
            point([f32::NAN; 3]),
        ];
        let near: Vec<&CloudPoint> = points[..2].iter().collect();
        let [low, high] = around(near.iter().map(|p| p.x_in_world.map(f64::from)));
        // An edge is at least a metre.
        assert_eq!((low, high), ([-10.0, 0.0, 1.75], [30.0, 5.0, 2.75]));
        let bytes = cloud(&near, low, high);
        assert_eq!(bytes.len(), 18);
        let step = |k: usize| f64::from(u16::from_le_bytes([bytes[2 * k], bytes[2 * k + 1]]));
        for (k, point) in near.iter().enumerate() {
            for axis in [0, 1, 2] {
                let edge = high[axis] - low[axis];
                let back = low[axis] + step(3 * k + axis) * edge / 65535.0;
                let off = back - f64::from(point.x_in_world[axis]);
                assert!(off.abs() <= 0.5 * edge / 65535.0 + 1e-12, "{off}");
            }
        }
        assert_eq!(bytes[12..], [1, 2, 3, 1, 2, 3]);
        assert_eq!(viewer(&content(&points, &[], &[])).points, 2);
    }

    #[test]
    fn many_points_fit_the_size_limit_deterministically() {
        let points: Vec<CloudPoint> = (0..1_500_000_u32)
            .map(|k| point([k as f32 * 1e-3, (k % 977) as f32, (k % 31) as f32]))
            .collect();
        let steps: Vec<Step> = (0..200_000)
            .map(|k| step(f64::from(k) * 0.05, k % 100_000 != 0))
            .collect();
        let truth: Vec<[f64; 3]> = steps.iter().map(|s| s.x_in_world).collect();
        let of = content(&points, &steps, &truth);
        let first = viewer(&of);
        let rest = TEMPLATE.bytes() + 4096;
        assert!(first.html.len() <= MAX_BYTES + rest, "{}", first.html.len());
        assert!(
            first.html.len() > MAX_BYTES * 9 / 10,
            "{}",
            first.html.len()
        );
        assert!(first.points > 500_000 && first.points < points.len());
        assert!(first.html == viewer(&of).html);
        // Evenly: the first and nearly the last are included.
        let all: Vec<&CloudPoint> = points.iter().collect();
        let thinned = thin(&all, 1000);
        assert_eq!(thinned.len(), 1000);
        assert_eq!(thinned[0].x_in_world, points[0].x_in_world);
        assert_eq!(thinned[999].x_in_world, points[1_498_500].x_in_world);
    }

    #[test]
    fn a_line_keeps_its_ends_and_breaks() {
        let steps: Vec<Step> = (0..1000)
            .map(|k| step(f64::from(k) * 1e-3, k != 500))
            .collect();
        let positions = steps.iter().map(|s| LinePoint {
            x: s.x_in_world,
            level: 7,
            follows: s.follows,
        });
        let made = line(positions, [0.0; 3]);
        assert_eq!(made.bytes.len(), 14 * made.count);
        assert!(made.count > 44 && made.count < 60, "{}", made.count);
        let x =
            |k: usize| f32::from_le_bytes(made.bytes[12 * k..12 * k + 4].try_into().expect("four"));
        let follows = |k: usize| made.bytes[12 * made.count + 2 * k + 1] == 1;
        let broken: Vec<usize> = (1..made.count).filter(|k| !follows(*k)).collect();
        let [broken] = broken[..] else {
            panic!("{broken:?}")
        };
        assert_eq!((x(broken - 1), x(broken)), (0.499, 0.5));
        assert_eq!((x(0), x(made.count - 1)), (0.0, 0.999));
        // Empty input does not panic.
        assert_eq!(line(std::iter::empty(), [0.0; 3]).count, 0);
        assert_eq!(viewer(&content(&[], &[], &[])).points, 0);
    }

    #[test]
    fn a_point_that_is_not_finite_breaks_a_line() {
        let positions = [0.0, 1.0, f64::NAN, 2.0, 3.0].map(|x| LinePoint {
            x: [x, 0.0, 0.0],
            level: 7,
            follows: x > 0.0 || x.is_nan(),
        });
        let made = line(positions.into_iter(), [0.0; 3]);
        assert_eq!(made.count, 4);
        assert_eq!(made.bytes[48..], [7, 0, 7, 1, 7, 0, 7, 1]);
    }

    #[test]
    fn breaks_everywhere_do_not_make_a_line_longer() {
        let most = MAX_LINE_POINTS + 2 * MAX_LINE_PIECES + 1;
        for every in [1, 2, 3, 50] {
            let positions = (0..400_000).map(|k| LinePoint {
                x: [f64::from(k), 0.0, 0.0],
                level: 7,
                follows: k % every != 0,
            });
            let made = line(positions, [0.0; 3]);
            assert!(made.count <= most, "{every}: {}", made.count);
            assert!(made.count > 5_000, "{every}: {}", made.count);
        }
    }
}
