//! Rectification maps: the source position of every rectified pixel.
//!
//! Distortion is smooth, so that exact positions are computed only at the nodes of a grid of 16
//! pixels, and interpolated between four of them by a cubic, along columns first, then along rows
//! (Lagrange's form). In the middle of a tile, where such a cubic is worst, the exact position is
//! computed too: a tile with an error of more than a fifth of the bound there, or with a node
//! without a source, is computed exactly.

/// Source positions of the pixels of a rectified image, row-major.
#[derive(Clone, Debug, PartialEq)]
pub struct Map {
    /// Width of the rectified image, pixels.
    pub width: u32,
    /// Height of the rectified image, pixels.
    pub height: u32,
    /// x in the source image, pixels; NaN without a source.
    pub x: Vec<f32>,
    /// y in the source image, pixels; NaN without a source.
    pub y: Vec<f32>,
}

/// Pixels between two nodes.
const STEP: usize = 16;
/// Maximum error in the middle of an interpolated tile, pixels.
const MIDDLE_PX: f64 = 0.002;

/// A row of interpolated nodes: columns of x and of y.
struct NodeRow {
    x: Vec<f32>,
    y: Vec<f32>,
}

impl Map {
    /// Error bound of a map against the exact one, pixels.
    pub const BOUND_PX: f32 = 0.01;

    /// Every position computed exactly.
    pub(super) fn exact(
        width: u32,
        height: u32,
        place: impl Fn([f64; 2]) -> Option<[f64; 2]>,
    ) -> Self {
        let (columns, rows) = (width as usize, height as usize);
        let mut map = Self::empty(width, height);
        for i in 0..columns * rows {
            map.set(i, place([(i % columns) as f64, (i / columns) as f64]));
        }
        map
    }

    pub(super) fn interpolated(
        width: u32,
        height: u32,
        place: impl Fn([f64; 2]) -> Option<[f64; 2]>,
    ) -> Self {
        let (columns, rows) = (width as usize, height as usize);
        let mut map = Self::empty(width, height);
        let (tiles_x, tiles_y) = (columns.div_ceil(STEP), rows.div_ceil(STEP));
        // One node before the first pixel and two after the start of the last tile.
        let nodes_x = tiles_x + 3;
        let at = |i: usize| (i as f64 - 1.0) * STEP as f64;
        let nodes: Vec<Option<[f64; 2]>> = (0..nodes_x * (tiles_y + 3))
            .map(|i| place([at(i % nodes_x), at(i / nodes_x)]))
            .collect();
        let weights = weights();
        let by_node: [[f32; STEP]; 4] =
            std::array::from_fn(|k| std::array::from_fn(|j| weights[j][k] as f32));
        let mut row = NodeRow {
            x: vec![0.0; nodes_x],
            y: vec![0.0; nodes_x],
        };
        for tile_y in 0..tiles_y {
            let band: [&[Option<[f64; 2]>]; 4] =
                std::array::from_fn(|k| &nodes[(tile_y + k) * nodes_x..][..nodes_x]);
            let smooth: Vec<bool> = (0..tiles_x)
                .map(|tile_x| is_smooth(&band, tile_x, tile_y, &place))
                .collect();
            for v in tile_y * STEP..((tile_y + 1) * STEP).min(rows) {
                for i in 0..nodes_x {
                    let [x, y] = along(&band.map(|nodes| nodes[i]), &weights[v % STEP]);
                    (row.x[i], row.y[i]) = (x as f32, y as f32);
                }
                for (tile_x, smooth) in smooth.iter().enumerate() {
                    let begin = tile_x * STEP;
                    let end = (begin + STEP).min(columns);
                    let span = v * columns + begin..v * columns + end;
                    if *smooth {
                        fill(
                            &mut map.x[span.clone()],
                            &row.x[tile_x..tile_x + 4],
                            &by_node,
                        );
                        fill(&mut map.y[span], &row.y[tile_x..tile_x + 4], &by_node);
                    } else {
                        for (u, i) in (begin..end).zip(span) {
                            map.set(i, place([u as f64, v as f64]));
                        }
                    }
                }
            }
        }
        map
    }

    /// A map of the right size without values.
    fn empty(width: u32, height: u32) -> Self {
        let count = width as usize * height as usize;
        Self {
            width,
            height,
            x: vec![0.0; count],
            y: vec![0.0; count],
        }
    }

    fn set(&mut self, i: usize, place: Option<[f64; 2]>) {
        let [x, y] = place.unwrap_or([f64::NAN; 2]);
        (self.x[i], self.y[i]) = (x as f32, y as f32);
    }
}

/// The weights of four nodes at -1, 0, 1 and 2 for each pixel between 0 and 1.
fn weights() -> [[f64; 4]; STEP] {
    std::array::from_fn(|j| {
        let t = j as f64 / STEP as f64;
        [
            -t * (t - 1.0) * (t - 2.0) / 6.0,
            (t + 1.0) * (t - 1.0) * (t - 2.0) / 2.0,
            -(t + 1.0) * t * (t - 2.0) / 2.0,
            (t + 1.0) * t * (t - 1.0) / 6.0,
        ]
    })
}

/// Interpolation between four nodes; NaN if one has no source.
fn along(nodes: &[Option<[f64; 2]>; 4], weights: &[f64; 4]) -> [f64; 2] {
    let mut sum = [0.0; 2];
    for (node, weight) in nodes.iter().zip(weights) {
        let [x, y] = node.unwrap_or([f64::NAN; 2]);
        sum[0] += weight * x;
        sum[1] += weight * y;
    }
    sum
}

/// Whether interpolation is accurate in a tile.
fn is_smooth(
    band: &[&[Option<[f64; 2]>]; 4],
    tile_x: usize,
    tile_y: usize,
    place: &impl Fn([f64; 2]) -> Option<[f64; 2]>,
) -> bool {
    let half = weights()[STEP / 2];
    let columns: [Option<[f64; 2]>; 4] =
        std::array::from_fn(|i| Some(along(&band.map(|nodes| nodes[tile_x + i]), &half)));
    let [x, y] = along(&columns, &half);
    let middle = |tile: usize| (tile * STEP + STEP / 2) as f64;
    place([middle(tile_x), middle(tile_y)])
        .is_some_and(|[ex, ey]| (x - ex).hypot(y - ey) <= MIDDLE_PX)
}

fn fill(out: &mut [f32], nodes: &[f32], by_node: &[[f32; STEP]; 4]) {
    let [a, b, c, d] = [nodes[0], nodes[1], nodes[2], nodes[3]];
    let at =
        |j: usize| a * by_node[0][j] + b * by_node[1][j] + c * by_node[2][j] + d * by_node[3][j];
    // A whole tile has a length known to the compiler.
    if let Ok(out) = <&mut [f32; STEP]>::try_from(&mut *out) {
        for (j, out) in out.iter_mut().enumerate() {
            *out = at(j);
        }
    } else {
        for (j, out) in out.iter_mut().enumerate() {
            *out = at(j);
        }
    }
}
