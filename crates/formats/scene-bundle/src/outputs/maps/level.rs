//! Layers of a walkable level.

use crate::outputs::Fault;
use crate::outputs::grid::Grid;

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
/// The sigma of the height is more than a centimetre.
pub const UNCERTAIN: u8 = 32;

/// Occupancy of a cell that is walkable and clear.
pub const FREE: i8 = 0;
/// Occupancy of a cell with an obstacle.
pub const OCCUPIED: i8 = 100;
/// Occupancy of a cell that was not seen: it is not free.
pub const UNKNOWN: i8 = -1;

pub(super) const NORMAL: &str = "normal";
pub(super) const OCCUPANCY: &str = "occupancy";
pub(super) const VIEWS: &str = "views";
pub(super) const FLAGS: &str = "flags";

/// Layers of a walkable level, each with a value per cell of the grid, row-major. Numbers are NaN
/// where they are not known.
#[derive(Clone, Debug, PartialEq)]
pub struct MapLevel {
    /// Its cells.
    pub grid: Grid,
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
    /// Horizontal distance to the nearest edge, obstacle or unknown cell, m; negative in those,
    /// infinite if there is none.
    pub distance: Vec<f32>,
    /// [`FREE`], [`OCCUPIED`] or [`UNKNOWN`].
    pub occupancy: Vec<i8>,
    /// Views that saw the ground, at most 255.
    pub views: Vec<u8>,
    /// Bits: [`KNOWN`], [`FILLED`], [`SAMPLED`], [`CONTRADICTED`], [`EDGE`],
    /// [`UNCERTAIN`].
    pub flags: Vec<u8>,
}

impl MapLevel {
    /// A level of which nothing is known yet.
    pub fn unknown(grid: Grid) -> Self {
        Self::of_cells(grid, grid.cells())
    }

    /// A level without values: a grid of a file takes no memory before its layers were read.
    pub(super) fn empty(grid: Grid) -> Self {
        Self::of_cells(grid, 0)
    }

    fn of_cells(grid: Grid, count: usize) -> Self {
        let nan = || vec![f32::NAN; count];
        Self {
            grid,
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

    /// Whether a cell has a height.
    pub fn has_height(&self, cell: usize) -> bool {
        self.flags[cell] & (KNOWN | FILLED | SAMPLED) != 0
    }

    /// Layers of one number per cell, by their names.
    pub fn numbers(&self) -> [(&'static str, &[f32]); 10] {
        [
            ("elevation", &self.elevation),
            ("lower", &self.lower),
            ("upper", &self.upper),
            ("sigma", &self.sigma),
            ("slope", &self.slope),
            ("step", &self.step),
            ("roughness", &self.roughness),
            ("clearance", &self.clearance),
            ("traversability", &self.traversability),
            ("distance", &self.distance),
        ]
    }

    pub(super) fn numbers_mut(&mut self) -> [(&'static str, &mut Vec<f32>); 10] {
        [
            ("elevation", &mut self.elevation),
            ("lower", &mut self.lower),
            ("upper", &mut self.upper),
            ("sigma", &mut self.sigma),
            ("slope", &mut self.slope),
            ("step", &mut self.step),
            ("roughness", &mut self.roughness),
            ("clearance", &mut self.clearance),
            ("traversability", &mut self.traversability),
            ("distance", &mut self.distance),
        ]
    }

    /// Whether all layers are as the format has them, or the layer that is not.
    pub(super) fn check(&self) -> Result<(), (&'static str, Fault)> {
        let cells = self.grid.cells();
        let others = [
            (NORMAL, self.normal.len()),
            (OCCUPANCY, self.occupancy.len()),
            (VIEWS, self.views.len()),
            (FLAGS, self.flags.len()),
        ];
        let lengths = self.numbers().map(|(layer, values)| (layer, values.len()));
        let mut lengths = lengths.into_iter().chain(others);
        if let Some((layer, length)) = lengths.find(|(_, length)| *length != cells) {
            let found = format!("{length} values of {cells} cells");
            return Err((layer, Fault::new("values", found, "one for each cell")));
        }
        for (layer, values) in self.numbers() {
            let (is_allowed, expected) = rule(layer);
            if let Some(cell) = values.iter().position(|v| !v.is_nan() && !is_allowed(*v)) {
                return Err((layer, fault(cell, &values[cell], expected)));
            }
        }
        for cell in 0..cells {
            self.check_cell(cell)?;
        }
        Ok(())
    }

    fn check_cell(&self, cell: usize) -> Result<(), (&'static str, Fault)> {
        let normal = self.normal[cell];
        if normal.iter().any(|v| v.is_infinite()) {
            return Err((
                NORMAL,
                fault(cell, &normal, "finite numbers, or not-a-number"),
            ));
        }
        let flags = self.flags[cell];
        if flags & !(KNOWN | FILLED | SAMPLED | CONTRADICTED | EDGE | UNCERTAIN) != 0 {
            return Err((FLAGS, fault(cell, &flags, "bits of the format, up to 63")));
        }
        if self.has_height(cell) == self.elevation[cell].is_nan() {
            let found = (flags, self.elevation[cell]);
            let expected = "an elevation where the flags name its source, and nowhere else";
            return Err((FLAGS, fault(cell, &found, expected)));
        }
        let occupancy = self.occupancy[cell];
        if ![FREE, OCCUPIED, UNKNOWN].contains(&occupancy) {
            return Err((OCCUPANCY, fault(cell, &occupancy, "-1, 0 or 100")));
        }
        if occupancy == FREE && !self.has_height(cell) {
            let expected = "an elevation of a free cell";
            return Err((OCCUPANCY, fault(cell, &occupancy, expected)));
        }
        Ok(())
    }
}

fn fault(cell: usize, found: &impl std::fmt::Debug, expected: &'static str) -> Fault {
    Fault::new(&format!("cell {cell}"), format!("{found:?}"), expected)
}

/// Numbers that a layer may have besides NaN.
fn rule(layer: &str) -> (fn(f32) -> bool, &'static str) {
    match layer {
        "sigma" | "slope" | "step" | "roughness" => {
            (|v| v.is_finite() && v >= 0.0, "a number of 0 or more")
        }
        "clearance" => (|v| v >= 0.0, "a number of 0 or more, or infinity"),
        "traversability" => (|v| (0.0..=1.0).contains(&v), "a number from 0 to 1"),
        "distance" => (|_| true, "any number"),
        _ => (f32::is_finite, "a finite number"),
    }
}
