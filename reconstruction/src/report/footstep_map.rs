//! Footsteps on the height map, from above, as SVG.
//!
//! Contract: heights are those of the level with the most footsteps, then of others with footsteps
//! where that one has none; colors run over nearly all heights within [`NEAR_M`] of a footstep.
//! Soles are outlines in the world of the bundle. The scale is the same along both axes.

use std::fmt::Write as _;

use cad_transforms::RigidTransform;
use cad_transforms::rig::Foot;
use scene_bundle::outputs::maps::MapLevel;

use super::colors::{hex, ramp};
use super::png_file::png;
use super::views;

/// Half of the drawn surroundings of the footsteps, m.
const NEAR_M: f64 = 1.0;
const MARGIN_PX: f64 = 8.0;
const MAX_HEIGHT_PX: f64 = 700.0;
/// Height of the color scale below the map.
const FOOTER_PX: f64 = 44.0;
/// Colors of soles: left, right, and the ground truth below them.
const FEET: [&str; 2] = ["#ffffff", "#1a1a1a"];
const GROUND_TRUTH: &str = "#c03a86";

/// A sole at rest.
#[derive(Clone, Debug)]
pub(super) struct Footstep {
    /// The foot.
    pub(super) foot: Foot,
    /// Outline in the world of the bundle, m.
    pub(super) outline: Vec<[f64; 2]>,
}

impl Footstep {
    /// An outline in the frame of a foot at this pose.
    pub(super) fn at(foot: Foot, world_from_foot: &RigidTransform, outline_m: &[[f64; 2]]) -> Self {
        let corner = |[x, y]: &[f64; 2]| {
            let [x, y, _] = world_from_foot.apply([*x, *y, 0.0]);
            [x, y]
        };
        Self {
            foot,
            outline: outline_m.iter().map(corner).collect(),
        }
    }

    fn middle(&self) -> [f64; 2] {
        let count = self.outline.len().max(1) as f64;
        [0, 1].map(|k| self.outline.iter().map(|x| x[k]).sum::<f64>() / count)
    }
}

/// Content of a map.
#[derive(Clone, Copy)]
pub(super) struct FootstepMap<'a> {
    /// Levels of the maps.
    pub(super) levels: &'a [MapLevel],
    /// Estimated soles.
    pub(super) footsteps: &'a [Footstep],
    /// True soles.
    pub(super) truth: &'a [Footstep],
}

/// Drawn part of the world.
struct Sheet {
    /// Corner of least x and y, m, and size, m.
    low: [f64; 2],
    size: [f64; 2],
    px_per_m: f64,
}

impl Sheet {
    fn of(footsteps: &[Footstep], width: f64) -> Option<Self> {
        let range = |k: usize| {
            let values = footsteps.iter().map(|step| step.middle()[k]);
            let (low, high) = values.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), v| {
                (low.min(v), high.max(v))
            });
            (low.is_finite() && high.is_finite()).then_some((low - NEAR_M, high + NEAR_M))
        };
        let [x, y] = [range(0)?, range(1)?];
        let size = [x.1 - x.0, y.1 - y.0];
        let room = width - 2.0 * MARGIN_PX;
        Some(Self {
            low: [x.0, y.0],
            size,
            px_per_m: (room / size[0]).min(MAX_HEIGHT_PX / size[1]),
        })
    }

    fn px(&self, at: [f64; 2]) -> [f64; 2] {
        [
            MARGIN_PX + (at[0] - self.low[0]) * self.px_per_m,
            MARGIN_PX + (self.low[1] + self.size[1] - at[1]) * self.px_per_m,
        ]
    }
}

/// The SVG, `width` pixels wide; `None` without footsteps.
pub(super) fn svg(map: &FootstepMap<'_>, width: u32) -> Option<String> {
    let width = f64::from(width);
    let sheet = Sheet::of(map.footsteps, width)?;
    let height = sheet.size[1] * sheet.px_per_m + 2.0 * MARGIN_PX + FOOTER_PX;
    let mut out = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"{width}\" height=\"{height:.0}\" \
         viewBox=\"0 0 {width} {height:.0}\" role=\"img\" aria-label=\"Footsteps from above\" \
         font-family=\"DejaVu Sans, sans-serif\" font-size=\"12\" fill=\"#222\">\n\
         <rect width=\"{width}\" height=\"{height:.0}\" fill=\"#fff\"/>\n"
    );
    let heights = Heights::new(map, &sheet);
    if let Some(image) = heights.png() {
        let [x, y] = sheet.px([sheet.low[0], sheet.low[1] + sheet.size[1]]);
        let [wide, high] = sheet.size.map(|size| size * sheet.px_per_m);
        let _ = writeln!(
            out,
            "<image x=\"{x:.1}\" y=\"{y:.1}\" width=\"{wide:.1}\" height=\"{high:.1}\" \
             preserveAspectRatio=\"none\" style=\"image-rendering:pixelated\" \
             href=\"data:image/png;base64,{}\"/>",
            charts::base64(&image)
        );
    }
    for step in map.truth {
        outline(&mut out, &sheet, step, GROUND_TRUTH, 3.5);
    }
    for step in map.footsteps {
        outline(&mut out, &sheet, step, FEET[step.foot as usize], 1.6);
    }
    footer(&mut out, &sheet, heights.range, height);
    out.push_str("</svg>");
    Some(out)
}

fn outline(out: &mut String, sheet: &Sheet, step: &Footstep, color: &str, width: f64) {
    let mut corners = String::new();
    for corner in &step.outline {
        let [x, y] = sheet.px(*corner);
        let _ = write!(corners, "{x:.1},{y:.1} ");
    }
    let _ = writeln!(
        out,
        "<polygon points=\"{}\" fill=\"none\" stroke=\"{color}\" stroke-width=\"{width}\"/>",
        corners.trim_end()
    );
}

fn footer(out: &mut String, sheet: &Sheet, range: Option<(f32, f32)>, height: f64) {
    let y = height - FOOTER_PX + 8.0;
    let metre = sheet.px_per_m;
    let _ = writeln!(
        out,
        "<path d=\"M{MARGIN_PX} {y:.1}v5h{metre:.1}v-5\" fill=\"none\" stroke=\"#222\" stroke-width=\"1.5\"/>\
         <text x=\"{MARGIN_PX}\" y=\"{:.1}\">1 m</text>",
        y + 20.0
    );
    let Some((low, high)) = range else { return };
    let (left, steps, wide) = (MARGIN_PX + metre.max(40.0) + 24.0, 24, 6.0);
    for k in 0..steps {
        let color = hex(ramp((f64::from(k) + 0.5) / f64::from(steps)));
        let x = left + f64::from(k) * wide;
        let _ = write!(
            out,
            "<rect x=\"{x:.1}\" y=\"{:.1}\" width=\"{:.1}\" height=\"9\" fill=\"{color}\"/>",
            y - 3.0,
            wide + 0.3
        );
    }
    let _ = writeln!(
        out,
        "<text x=\"{left:.1}\" y=\"{:.1}\">height {low:.2} to {high:.2} m</text>",
        y + 20.0
    );
}

/// Heights of the drawn part, a value per cell, the row of greatest y first.
struct Heights {
    columns: usize,
    values: Vec<f32>,
    /// Least and greatest one.
    range: Option<(f32, f32)>,
}

impl Heights {
    fn new(map: &FootstepMap<'_>, sheet: &Sheet) -> Self {
        let cell_m = (map.levels.first()).map_or(0.04, |level| level.grid.cell_m);
        let [columns, rows] = sheet.size.map(|size| (size / cell_m).ceil() as usize);
        let on = |level: &&MapLevel| {
            let steps = map.footsteps.iter().map(Footstep::middle);
            let cells = steps.filter_map(|middle| level.grid.cell(middle));
            cells.filter(|cell| level.has_height(*cell)).count()
        };
        let mut levels: Vec<&MapLevel> = map.levels.iter().collect();
        levels.retain(|level| on(level) > 0);
        levels.sort_by_key(|level| std::cmp::Reverse(on(level)));
        let places = (0..rows).flat_map(|row| (0..columns).map(move |column| (row, column)));
        let values = places.map(|(row, column)| {
            let x = sheet.low[0] + (column as f64 + 0.5) * cell_m;
            let y = sheet.low[1] + sheet.size[1] - (row as f64 + 0.5) * cell_m;
            let cells = levels.iter().filter_map(|level| {
                let cell = level.grid.cell([x, y])?;
                level.has_height(cell).then(|| level.elevation[cell])
            });
            cells.into_iter().next().unwrap_or(f32::NAN)
        });
        let values: Vec<f32> = values.collect();
        let known = values.iter().filter(|value| !value.is_nan());
        let range = views::range(known.map(|value| f64::from(*value)));
        let range = range.map(|(low, high)| (low as f32, high as f32));
        Self {
            columns,
            values,
            range,
        }
    }

    /// Unknown cells are transparent.
    fn png(&self) -> Option<Vec<u8>> {
        let (low, high) = self.range?;
        let span = f64::from((high - low).max(1e-3));
        let pixels = self.values.iter().flat_map(|value| match value.is_nan() {
            true => [0; 4],
            false => {
                let [r, g, b] = ramp(f64::from(value - low) / span);
                [r, g, b, 255]
            }
        });
        let rows = self.values.len() / self.columns;
        png([self.columns, rows], &pixels.collect::<Vec<u8>>()).ok()
    }
}

#[cfg(test)]
mod tests {
    use scene_bundle::outputs::grid::Grid;
    use scene_bundle::outputs::maps::KNOWN;

    use super::*;

    const OUTLINE: [[f64; 2]; 4] = [[-0.1, -0.05], [0.2, -0.05], [0.2, 0.05], [-0.1, 0.05]];

    fn step(x: f64, foot: Foot) -> Footstep {
        let place = RigidTransform::from_rotation_vector([0.0; 3], [x, 0.0, 0.3]);
        Footstep::at(foot, &place.expect("finite"), &OUTLINE)
    }

    fn level(height: f32, known: std::ops::Range<usize>) -> MapLevel {
        let mut level = MapLevel::unknown(Grid {
            cell_m: 0.1,
            origin_m: [-1.0, -1.0],
            columns: 40,
            rows: 20,
        });
        for row in 0..20 {
            for column in known.clone() {
                level.elevation[row * 40 + column] = height;
                level.flags[row * 40 + column] = KNOWN;
            }
        }
        level
    }

    #[test]
    fn the_level_with_the_footsteps_is_in_front() {
        // The first level is nowhere below a footstep, the others are.
        let steps = [
            step(0.0, Foot::Left),
            step(0.5, Foot::Left),
            step(1.2, Foot::Right),
        ];
        let mut high = level(3.0, 22..40);
        high.grid.origin_m[1] = 5.0;
        let levels = [high, level(2.0, 20..40), level(0.3, 0..20)];
        let map = FootstepMap {
            levels: &levels,
            footsteps: &steps,
            truth: &[],
        };
        let sheet = Sheet::of(&steps, 400.0).expect("footsteps");
        let heights = Heights::new(&map, &sheet);
        assert_eq!(heights.range, Some((0.3, 2.0)));
        let of_x = |x: f64| {
            let column = ((x - sheet.low[0]) / 0.1) as usize;
            heights.values[10 * heights.columns + column]
        };
        assert_eq!((of_x(0.5), of_x(1.2), of_x(1.7)), (0.3, 2.0, 2.0));
    }

    #[test]
    fn every_sole_is_drawn_once_with_its_outline_to_scale() {
        let steps = [step(0.0, Foot::Left), step(1.0, Foot::Right)];
        let map = FootstepMap {
            levels: &[],
            footsteps: &steps,
            truth: &steps[..1],
        };
        for width in [336, 760] {
            let text = svg(&map, width).expect("footsteps");
            assert_eq!(text.matches("<polygon").count(), 3);
            for color in [GROUND_TRUTH, FEET[0], FEET[1]] {
                assert!(text.contains(&format!("stroke=\"{color}\"")), "{text}");
            }
        }
        let sheet = Sheet::of(&steps, 400.0).expect("footsteps");
        let [a, b] = [[0.0, 0.0], [1.0, 0.0]].map(|at| sheet.px(at));
        assert!((b[0] - a[0] - sheet.px_per_m).abs() < 1e-9);
        assert!(sheet.px([0.0, 1.0])[1] < a[1], "north is up");
    }

    #[test]
    fn without_footsteps_there_is_no_map() {
        let map = FootstepMap {
            levels: &[],
            footsteps: &[],
            truth: &[],
        };
        assert_eq!(svg(&map, 400), None);
    }
}
