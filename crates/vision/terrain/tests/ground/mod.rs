//! Exact ground with planes, edges and a level of its own, and the collision surface over it.

use terrain::convex::{Collision, collision_parts};
use terrain::edges::{Edge, EdgeKind};
use terrain::maps::{EDGE, FREE, KNOWN, Level, UNKNOWN};
use terrain::planes::{Plane, PlaneOutline, Planes};
use terrain::{ConvexConfig, PlaneConfig};

/// Edge of a cell of the maps, m.
pub(crate) const CELL_M: f64 = 0.04;
/// Surfaces farther from a height are not of its level, m.
const LEVEL_M: f64 = 0.4;

/// Where the scene is in the world: its cells are along the axes of the world, the scene is not.
#[derive(Clone, Copy)]
pub(crate) struct Place {
    pub(crate) yaw_rad: f64,
    pub(crate) offset: [f64; 2],
}

impl Place {
    pub(crate) fn world(&self, [x, y]: [f64; 2]) -> [f64; 2] {
        let (sin, cos) = self.yaw_rad.sin_cos();
        let [dx, dy] = self.offset;
        [cos * x - sin * y + dx, sin * x + cos * y + dy]
    }

    fn scene(&self, [x, y]: [f64; 2]) -> [f64; 2] {
        let (sin, cos) = self.yaw_rad.sin_cos();
        let [x, y] = [x - self.offset[0], y - self.offset[1]];
        [cos * x + sin * y, cos * y - sin * x]
    }

    fn rotated(&self, [x, y, z]: [f64; 3]) -> [f64; 3] {
        let still = Self {
            offset: [0.0; 2],
            ..*self
        };
        let [x, y] = still.world([x, y]);
        [x, y, z]
    }
}

/// An edge of a scene.
pub(crate) struct Border {
    pub(crate) kind: EdgeKind,
    pub(crate) ends: [[f64; 3]; 2],
    pub(crate) planes: (u32, Option<u32>),
}

/// A scene. Coordinates are its own.
pub(crate) struct Ground {
    pub(crate) place: Place,
    /// True height.
    pub(crate) height: fn(f64, f64) -> f64,
    /// Where the level has heights.
    pub(crate) is_known: fn(f64, f64) -> bool,
    pub(crate) planes: Vec<PlaneOutline>,
    pub(crate) edges: Vec<Border>,
    /// From and to a corner of the level.
    pub(crate) extent: [[f64; 2]; 2],
}

impl Ground {
    pub(crate) fn collision(&self, config: &ConvexConfig) -> Surface {
        let planes = self.planes.iter().map(|outline| {
            let [x, y] = self.place.world([outline.center[0], outline.center[1]]);
            let outline = PlaneOutline {
                center: [x, y, outline.center[2]],
                normal: self.place.rotated(outline.normal),
                axes: outline.axes.map(|axis| self.place.rotated(axis)),
                ..outline.clone()
            };
            Plane::of_outline(&outline, &PlaneConfig::default())
        });
        let planes = Planes {
            planes: planes.collect(),
            ..Planes::default()
        };
        let edges = self.edges.iter().map(|own| {
            let [from, to] = own.ends.map(|[x, y, z]| {
                let [x, y] = self.place.world([x, y]);
                [x, y, z]
            });
            Edge {
                kind: own.kind,
                from,
                to,
                sigma_m: 0.001,
                planes: own.planes,
                step: None,
            }
        });
        let edges: Vec<Edge> = edges.collect();
        let levels = [self.level()];
        Surface {
            place: self.place,
            collision: collision_parts(&planes, &edges, &levels, config),
        }
    }

    fn level(&self) -> Level {
        let [from, to] = self.extent;
        let corners = [from, [to[0], from[1]], to, [from[0], to[1]]].map(|x| self.place.world(x));
        let [low, high] = [f64::min as fn(f64, f64) -> f64, f64::max].map(|pick| {
            [0, 1].map(|k| corners.iter().map(|x| x[k]).reduce(pick).unwrap_or(0.0) / CELL_M)
        });
        let origin = low.map(|v| (v.floor() + 0.5) * CELL_M);
        let size = [0, 1].map(|k| (high[k].ceil() - low[k].floor()) as usize);
        let count = size[0] * size[1];
        let mut level = Level {
            cell_m: CELL_M,
            origin,
            size,
            elevation: vec![f32::NAN; count],
            lower: vec![f32::NAN; count],
            upper: vec![f32::NAN; count],
            occupancy: vec![UNKNOWN; count],
            flags: vec![0; count],
            ..Level::default()
        };
        for index in 0..count {
            let center = level.center(index);
            let [x, y] = self.place.scene(center);
            let inside = (from[0]..=to[0]).contains(&x) && (from[1]..=to[1]).contains(&y);
            if !inside || !(self.is_known)(x, y) {
                continue;
            }
            let around = (0..9).map(|k| {
                let step = [k % 3, k / 3].map(|v| (f64::from(v) - 1.0) * CELL_M / 3.0);
                let [x, y] = self.place.scene([0, 1].map(|k| center[k] + step[k]));
                (self.height)(x, y) as f32
            });
            level.elevation[index] = (self.height)(x, y) as f32;
            level.lower[index] = around.clone().fold(f32::INFINITY, f32::min);
            level.upper[index] = around.fold(f32::NEG_INFINITY, f32::max);
            level.occupancy[index] = FREE;
            level.flags[index] = KNOWN;
            if f64::from(level.upper[index] - level.lower[index]) > 2.0 * CELL_M {
                level.flags[index] |= EDGE;
            }
        }
        level
    }
}

/// Parts and layer as physics has them: triangles of the parts, and of the layer.
pub(crate) struct Surface {
    place: Place,
    pub(crate) collision: Collision,
}

impl Surface {
    /// The highest surface of the level of a height.
    pub(crate) fn height(&self, at: [f64; 2], near: f64) -> Option<f64> {
        let at = self.place.world(at);
        let of_layer = self.collision.layers[0].height_at(at[0], at[1]);
        let parts = self.collision.parts.iter();
        let of_parts = parts.flat_map(|part| part.triangles.iter().map(move |own| (part, own)));
        let of_parts = of_parts.filter_map(|(part, own)| {
            let [a, b, c] = own.map(|i| part.vertices[i as usize]);
            let area = (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]);
            let of_b = ((at[0] - a[0]) * (c[1] - a[1]) - (at[1] - a[1]) * (c[0] - a[0])) / area;
            let of_c = ((b[0] - a[0]) * (at[1] - a[1]) - (b[1] - a[1]) * (at[0] - a[0])) / area;
            let of_a = 1.0 - of_b - of_c;
            let inside = area > 1e-12 && of_a.min(of_b).min(of_c) >= -1e-9;
            inside.then_some(of_a * a[2] + of_b * b[2] + of_c * c[2])
        });
        of_parts
            .chain(of_layer)
            .filter(|height| (height - near).abs() < LEVEL_M)
            .reduce(f64::max)
    }

    /// Height of the lowest point of a ball that rests on the surface.
    pub(crate) fn foot_height(&self, at: [f64; 2], radius_m: f64, near: f64) -> Option<f64> {
        resting(at, radius_m, |at| self.height(at, near))
    }
}

/// The same on any surface.
pub(crate) fn resting(
    at: [f64; 2],
    radius_m: f64,
    height: impl Fn([f64; 2]) -> Option<f64>,
) -> Option<f64> {
    const STEPS: i32 = 4;
    let all = (-STEPS..=STEPS).flat_map(|i| (-STEPS..=STEPS).map(move |k| [i, k]));
    let heights = all.filter_map(|step| {
        let away = step.map(|k| f64::from(k) / f64::from(STEPS) * radius_m);
        let rest = radius_m * radius_m - away[0] * away[0] - away[1] * away[1];
        let below = (rest >= 0.0).then(|| radius_m - rest.sqrt())?;
        Some(height([at[0] + away[0], at[1] + away[1]])? - below)
    });
    heights.reduce(f64::max)
}
