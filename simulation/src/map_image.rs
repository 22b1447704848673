//! The ground from above as an image, with the path of the recording.
//!
//! Contract: x of the world to the right, y up, the same scale along both. Free ground is gray by
//! its height, obstacles are brown, unknown ground is white. Of several levels the first one with
//! free ground or an obstacle is drawn.

use raster::{Canvas, Color};
use scene_bundle::outputs::maps::{FREE, MapLevel, OCCUPIED};

use crate::scene::{SceneData, Similarity};

/// Longest edge of the image, px.
const EDGE_PX: f64 = 640.0;
/// Border around what is known, px.
const MARGIN_PX: f64 = 8.0;
/// Gray of the lowest and of the highest ground.
const GRAYS: [f64; 2] = [120.0, 225.0];
const UNKNOWN_COLOR: Color = [255, 255, 255];
const OBSTACLE_COLOR: Color = [138, 90, 60];
const PATH_COLOR: Color = [40, 40, 40];

/// An image of the ground.
#[derive(Clone, Debug)]
pub struct MapImage {
    canvas: Canvas,
    /// World position of the left upper corner, m.
    corner_m: [f64; 2],
    px_per_m: f64,
}

/// Levels of a sector, and its frame on the map. All frames have z up: they differ by a rotation
/// about it.
struct Part<'a> {
    levels: &'a [MapLevel],
    map_from_sector: Similarity,
    sector_from_map: Similarity,
}

impl<'a> Part<'a> {
    fn new(levels: &'a [MapLevel], map_from_sector: Similarity) -> Self {
        Self {
            levels,
            map_from_sector,
            sector_from_map: map_from_sector.inverse(),
        }
    }

    /// Where a point of the sector is on the map, with its height, m.
    fn on_map(&self, at_m: [f64; 2], height_m: f64) -> [f64; 3] {
        self.map_from_sector.apply([at_m[0], at_m[1], height_m])
    }
}

impl MapImage {
    /// Draws the levels of all sectors that edges connect with the first one, in its frame; `None`
    /// if nothing is known of any.
    pub fn new(scene: &SceneData) -> Option<Self> {
        let mut parts: Vec<Part<'_>> = Vec::new();
        for (sector, (root, map_from_sector)) in
            scene.sectors.iter().zip(scene.roots_from_sectors())
        {
            let Some(levels) = sector.levels.as_ref().filter(|_| root == 0) else {
                continue;
            };
            // Sectors of a recording share them.
            if parts
                .iter()
                .all(|part| !std::ptr::eq(part.levels, levels.as_slice()))
            {
                parts.push(Part::new(levels, map_from_sector));
            }
        }
        Self::of_parts(&parts)
    }

    fn of_parts(parts: &[Part<'_>]) -> Option<Self> {
        let (mut low, mut high) = ([f64::INFINITY; 2], [f64::NEG_INFINITY; 2]);
        let mut heights: Vec<f64> = Vec::new();
        let levels = parts
            .iter()
            .flat_map(|part| part.levels.iter().map(move |level| (part, level)));
        for (part, level) in levels {
            for cell in 0..level.grid.cells() {
                let is_known = level.has_height(cell) || level.occupancy[cell] == OCCUPIED;
                let center_m = level.grid.center_m(cell);
                if is_known {
                    let at = part.on_map(center_m, 0.0);
                    for k in 0..2 {
                        low[k] = low[k].min(at[k] - 0.5 * level.grid.cell_m);
                        high[k] = high[k].max(at[k] + 0.5 * level.grid.cell_m);
                    }
                }
                if level.occupancy[cell] == FREE {
                    let height_m = f64::from(level.elevation[cell]);
                    heights.push(part.on_map(center_m, height_m)[2]);
                }
            }
        }
        let size_m = [0, 1].map(|k| high[k] - low[k]);
        if !size_m.iter().all(|v| v.is_finite() && *v > 0.0) {
            return None;
        }
        heights.sort_by(f64::total_cmp);
        let quantile = |q: f64| {
            let index = (q * heights.len().saturating_sub(1) as f64) as usize;
            heights.get(index).copied().unwrap_or(0.0)
        };
        let range = (quantile(0.02), quantile(0.98));
        let px_per_m = (EDGE_PX - 2.0 * MARGIN_PX) / size_m[0].max(size_m[1]);
        let [width, height] = size_m.map(|v| (v * px_per_m + 2.0 * MARGIN_PX).ceil() as usize);
        let mut image = Self {
            canvas: Canvas::new(width, height, UNKNOWN_COLOR),
            corner_m: [
                low[0] - MARGIN_PX / px_per_m,
                high[1] + MARGIN_PX / px_per_m,
            ],
            px_per_m,
        };
        for y in 0..height {
            for x in 0..width {
                let at = image.world_m([x as f64, y as f64]);
                let color = parts.iter().find_map(|part| color(part, at, range));
                if let Some(color) = color {
                    image.canvas.pixels[y * width + x] = color;
                }
            }
        }
        Some(image)
    }

    /// Draws a path through positions in the world, m.
    pub fn path(&mut self, positions_m: &[[f64; 2]]) {
        let points: Vec<[f64; 2]> = positions_m.iter().map(|at| self.px(*at)).collect();
        self.canvas.line(&points, 1.5, PATH_COLOR);
    }

    /// Pixel of a position in the world.
    pub fn px(&self, at_m: [f64; 2]) -> [f64; 2] {
        [
            (at_m[0] - self.corner_m[0]) * self.px_per_m,
            (self.corner_m[1] - at_m[1]) * self.px_per_m,
        ]
    }

    /// Position in the world of a pixel, m.
    fn world_m(&self, px: [f64; 2]) -> [f64; 2] {
        [
            self.corner_m[0] + px[0] / self.px_per_m,
            self.corner_m[1] - px[1] / self.px_per_m,
        ]
    }

    /// Its size, px.
    pub fn size(&self) -> [u32; 2] {
        [self.canvas.width as u32, self.canvas.height as u32]
    }

    /// A PNG file.
    ///
    /// # Errors
    /// None for images that [`MapImage::new`] gives.
    pub fn png(&self) -> Result<Vec<u8>, png::EncodingError> {
        self.canvas.png(png::Compression::Balanced)
    }
}

/// Color of a part at a place on the map; `None` where nothing is known.
fn color(part: &Part<'_>, at: [f64; 2], (low, high): (f64, f64)) -> Option<Color> {
    let [x, y, _] = part.sector_from_map.apply([at[0], at[1], 0.0]);
    part.levels.iter().find_map(|level| {
        let cell = level.grid.cell([x, y])?;
        match level.occupancy[cell] {
            FREE => {
                let [_, _, height] = part.on_map([x, y], f64::from(level.elevation[cell]));
                let share = ((height - low) / (high - low).max(1e-3)).clamp(0.0, 1.0);
                let gray = libm::round(GRAYS[0] + share * (GRAYS[1] - GRAYS[0])) as u8;
                Some([gray; 3])
            }
            OCCUPIED => Some(OBSTACLE_COLOR),
            _ => None,
        }
    })
}

#[cfg(test)]
mod tests {
    use scene_bundle::outputs::grid::Grid;
    use scene_bundle::outputs::maps::KNOWN;

    use super::*;
    use crate::testing;

    fn level() -> MapLevel {
        let mut level = MapLevel::unknown(Grid {
            cell_m: 0.5,
            origin_m: [10.0, -3.0],
            columns: 8,
            rows: 6,
        });
        for row in 1..5 {
            for column in 1..7 {
                let cell = row * 8 + column;
                level.occupancy[cell] = if column == 6 { OCCUPIED } else { FREE };
                level.flags[cell] = KNOWN;
                level.elevation[cell] = 0.1 * row as f32;
            }
        }
        level
    }

    #[test]
    fn axes_and_colors_are_those_of_the_contract() {
        let levels = [level()];
        let here = Part::new(&levels, Similarity::identity());
        let image = MapImage::of_parts(&[here]).expect("known ground");
        let color = |at: [f64; 2]| {
            let [x, y] = image.px(at).map(|v| libm::round(v) as usize);
            image.canvas.pixels[y * image.canvas.width + x]
        };
        // Height rises with y.
        let (low, high) = (color([11.0, -2.5]), color([11.0, -1.0]));
        assert!(low[0] < high[0], "{low:?} {high:?}");
        assert_eq!(color([13.0, -2.0]), OBSTACLE_COLOR);
        let [x, y] = image.px([10.5, -1.0]);
        assert!(x < image.px([13.0, -1.0])[0] && y < image.px([10.5, -2.5])[1]);
        assert_eq!(image.size()[0].max(image.size()[1]), EDGE_PX as u32);
        let back = image.world_m(image.px([12.3, -1.7]));
        assert!((back[0] - 12.3).abs() < 1e-9 && (back[1] + 1.7).abs() < 1e-9);
        image.png().expect("a PNG");
    }

    #[test]
    fn nothing_known_gives_no_image() {
        assert!(MapImage::of_parts(&[]).is_none());
        let unknown = [MapLevel::unknown(level().grid)];
        let part = Part::new(&unknown, Similarity::identity());
        assert!(MapImage::of_parts(&[part]).is_none());
    }

    #[test]
    fn sectors_of_other_recordings_are_drawn_where_the_edges_put_them() {
        let scene = &testing::corridor().scene;
        let image = MapImage::new(scene).expect("known ground");
        let color = |at: [f64; 2]| {
            let [x, y] = image.px(at).map(|v| libm::round(v) as usize);
            image.canvas.pixels[y * image.canvas.width + x]
        };
        // The middles of all four sides, in the frame of the first.
        for at in [[6.0, 1.0], [11.0, 6.0], [6.0, 11.0], [1.0, 6.0]] {
            let [r, g, b] = color(at);
            assert!(r == g && g == b && r < 255, "{at:?}: {:?}", [r, g, b]);
        }
        // Inside of the block of houses.
        let inside = color([6.0, 6.0]);
        assert!(
            inside == OBSTACLE_COLOR || inside == UNKNOWN_COLOR,
            "{inside:?}"
        );
        let roots = scene.roots_from_sectors();
        let [x, y, _] = roots[2].1.apply([6.0, 1.0, 0.5]);
        assert!((x - 6.0).abs() < 1e-9 && (y - 11.0).abs() < 1e-9, "{x} {y}");
    }
}
