//! Layers of a walkable level.

/// A surface was observed in the cell.
pub const KNOWN: u8 = 1;
/// The height is that of the plane around a small hole.
pub const FILLED: u8 = 2;
/// A ground sample, such as a foothold, is in the cell.
pub const SAMPLED: u8 = 4;
/// A ground sample contradicts the depth, and won: water, grass, glass.
pub const CONTRADICTED: u8 = 8;
/// The cell has two heights: an edge passes through it or beside it.
pub const EDGE: u8 = 16;
/// The sigma of the height is too large to step on it without looking.
pub const UNCERTAIN: u8 = 32;

/// Occupancy of a cell that is walkable and clear.
pub const FREE: i8 = 0;
/// Occupancy of a cell with an obstacle.
pub const OCCUPIED: i8 = 100;
/// Occupancy of a cell that was not seen: it is not free.
pub const UNKNOWN: i8 = -1;

/// Grids of a level. Entries are row-major: x along columns, y along rows. Numbers are NaN where
/// they are not known.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Level {
    /// Edge of a cell, m.
    pub cell_m: f64,
    /// Center of the first cell, x and y in the world, m.
    pub origin: [f64; 2],
    /// Columns and rows.
    pub size: [usize; 2],
    /// Height of the surface at the center of the cell, m.
    pub elevation: Vec<f32>,
    /// Least height of ground in the cell, m.
    pub lower: Vec<f32>,
    /// Greatest height of ground in the cell, m.
    pub upper: Vec<f32>,
    /// One standard deviation of the elevation, m.
    pub sigma: Vec<f32>,
    /// Upward normal.
    pub normal: Vec<[f32; 3]>,
    /// Angle of the normal with the vertical, rad.
    pub slope: Vec<f32>,
    /// Greatest height difference beyond the slope of the cell nearby, m.
    pub step: Vec<f32>,
    /// Root mean square distance of the heights nearby from a plane, m.
    pub roughness: Vec<f32>,
    /// Height above the ground to the next surface seen; infinite if none was seen, m.
    pub clearance: Vec<f32>,
    /// 1 for level, smooth ground to 0 for ground that cannot be walked on.
    pub traversability: Vec<f32>,
    /// Horizontal distance to the nearest edge, obstacle or unknown cell, m; negative in those.
    pub distance: Vec<f32>,
    /// [`FREE`], [`OCCUPIED`] or [`UNKNOWN`].
    pub occupancy: Vec<i8>,
    /// Views that saw the ground, at most 255.
    pub views: Vec<u8>,
    /// Bits: [`KNOWN`], [`FILLED`], [`SAMPLED`], [`CONTRADICTED`], [`EDGE`],
    /// [`UNCERTAIN`].
    pub flags: Vec<u8>,
}

impl Level {
    pub(crate) fn new(cell_m: f64, origin: [f64; 2], size: [usize; 2]) -> Self {
        let count = size[0] * size[1];
        let nan = || vec![f32::NAN; count];
        Self {
            cell_m,
            origin,
            size,
            elevation: nan(),
            lower: nan(),
            upper: nan(),
            sigma: nan(),
            normal: vec![[f32::NAN; 3]; count],
            slope: nan(),
            step: nan(),
            roughness: nan(),
            clearance: nan(),
            traversability: nan(),
            distance: nan(),
            occupancy: vec![UNKNOWN; count],
            views: vec![0; count],
            flags: vec![0; count],
        }
    }

    /// Index of the cell that contains a place.
    pub fn index(&self, x: f64, y: f64) -> Option<usize> {
        let cell = [(x, 0), (y, 1)].map(|(v, k)| ((v - self.origin[k]) / self.cell_m).round());
        let inside = (0..2).all(|k| cell[k] >= 0.0 && cell[k] < self.size[k] as f64);
        inside.then(|| cell[1] as usize * self.size[0] + cell[0] as usize)
    }

    /// Center of a cell, x and y in the world, m.
    pub fn center(&self, index: usize) -> [f64; 2] {
        let cell = [index % self.size[0], index / self.size[0]];
        [0, 1].map(|k| self.origin[k] + cell[k] as f64 * self.cell_m)
    }

    /// Whether a cell has a height.
    pub fn has_height(&self, index: usize) -> bool {
        self.flags[index] & (KNOWN | FILLED | SAMPLED) != 0
    }

    /// Cells with heights within a radius, without the cell itself, with their offset in m.
    pub(crate) fn near(
        &self,
        index: usize,
        radius_m: f64,
    ) -> impl Iterator<Item = (usize, [f64; 2])> + '_ {
        let reach = (radius_m / self.cell_m).floor() as i64;
        let at = [(index % self.size[0]) as i64, (index / self.size[0]) as i64];
        (-reach..=reach)
            .flat_map(move |dy| (-reach..=reach).map(move |dx| [dx, dy]))
            .filter_map(move |step| {
                let to = [at[0] + step[0], at[1] + step[1]];
                let inside = (0..2).all(|k| to[k] >= 0 && to[k] < self.size[k] as i64);
                let offset = step.map(|k| k as f64 * self.cell_m);
                let is_near = offset[0].hypot(offset[1]) <= radius_m * (1.0 + 1e-9);
                if step == [0, 0] || !inside || !is_near {
                    return None;
                }
                let other = to[1] as usize * self.size[0] + to[0] as usize;
                self.has_height(other).then_some((other, offset))
            })
    }
}
