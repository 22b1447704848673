//! A square marker of known code and size.

use boards::Dictionary;

/// Cells of the white margin on each side.
const MARGIN: usize = 1;
/// Cells of the black border on each side.
const BORDER: usize = 1;
/// Maximum number of cells along a side, with margins.
const MAX_CELLS: usize = 10;

/// A marker: black border one cell wide around its bits, and a white margin of the same width.
///
/// The frame of a tag has its origin in the middle, x to the right, y down, z into the tag, for a
/// reader who sees it upright.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Tag {
    /// Number in its dictionary.
    pub id: u32,
    /// Side of the black square, m.
    pub size_m: f64,
    cells: usize,
    /// By row and column, with margins: 1 for white and 0 for black.
    whites: [[f32; MAX_CELLS]; MAX_CELLS],
}

impl Tag {
    /// A marker of a dictionary; `None` for an unknown id, a size that is not positive, or more
    /// than 6 bits along a side.
    ///
    /// ```
    /// use boards::Dictionary;
    /// use fiducials::Tag;
    ///
    /// let tag = Tag::new(Dictionary::AprilTag36h11, 0, 0.08).ok_or("a tag")?;
    /// assert_eq!(tag.cell_m(), 0.01);
    /// assert!(Tag::new(Dictionary::AprilTag36h11, 587, 0.08).is_none());
    /// # Ok::<(), &str>(())
    /// ```
    pub fn new(dictionary: Dictionary, id: u32, size_m: f64) -> Option<Self> {
        let code = dictionary.code(id)?;
        let bits = dictionary.bits() as usize;
        let around = MARGIN + BORDER;
        let cells = bits + 2 * around;
        if cells > MAX_CELLS || !(size_m > 0.0 && size_m.is_finite()) {
            return None;
        }
        let mut whites = [[0.0; MAX_CELLS]; MAX_CELLS];
        for (row, whites) in whites.iter_mut().enumerate().take(cells) {
            for (column, white) in whites.iter_mut().enumerate().take(cells) {
                let bit = |i: usize| i.checked_sub(around).filter(|&i| i < bits);
                let is_white = match (bit(row), bit(column)) {
                    (Some(r), Some(c)) => code >> (bits * bits - 1 - (r * bits + c)) & 1 == 1,
                    _ => [row, column]
                        .iter()
                        .any(|&i| i < MARGIN || i >= cells - MARGIN),
                };
                *white = f32::from(u8::from(is_white));
            }
        }
        Some(Self {
            id,
            size_m,
            cells,
            whites,
        })
    }

    /// Side of a cell, m.
    pub fn cell_m(&self) -> f64 {
        self.size_m / (self.cells - 2 * MARGIN) as f64
    }

    /// Cells along a side, with margins.
    pub(crate) fn cells(&self) -> usize {
        self.cells
    }

    /// Cells from the middle to the end of the margin.
    pub(crate) fn half_cells(&self) -> f64 {
        0.5 * self.cells as f64
    }

    /// Cells from the middle to the edge of the black square.
    pub(crate) fn half_square_cells(&self) -> f64 {
        0.5 * self.cells as f64 - MARGIN as f64
    }

    /// Whether the cell in this row and column, with margins, is white.
    ///
    /// # Panics
    /// Beyond them.
    pub fn is_white(&self, row: usize, column: usize) -> bool {
        self.whites[row][column] > 0.5
    }

    /// A row of cells, with margins: 1 for white and 0 for black.
    pub(crate) fn whites(&self, row: usize) -> &[f32; MAX_CELLS] {
        &self.whites[row]
    }

    /// Rows, and columns, of the bits.
    pub(crate) fn bits(&self) -> std::ops::Range<usize> {
        let around = MARGIN + BORDER;
        around..self.cells - around
    }

    /// Corners of the black square in the tag's frame, m, in the order of AprilTag's detections:
    /// bottom left, bottom right, top right, top left.
    pub fn corners(&self) -> [[f64; 3]; 4] {
        let half = 0.5 * self.size_m;
        [(-1.0, 1.0), (1.0, 1.0), (1.0, -1.0), (-1.0, -1.0)].map(|(x, y)| [half * x, half * y, 0.0])
    }
}
