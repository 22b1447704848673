//! Geometry of the three boards: corners and black areas.
//!
//! Contract: the board's frame has its origin at the top left of the pattern (the outermost point
//! that is printed black or would be), x right, y down, z into the board, away from the viewer;
//! metres. Every board is upright in it, so that no coordinate in the pattern is negative.
//!
//! - **Chessboard**: squares side by side, the top left one black. Corner `row * columns + column`,
//!   row by row from the top left. A board on which both sides, or neither, have an even number of
//!   inner corners is symmetric under half a turn; see [`Target::is_rotationally_symmetric`].
//! - **AprilGrid**, as Kalibr's `kalibr_create_target_pdf` draws it: tags of family 36h11 with a
//!   border two cells wide, black squares in the crossings of the gaps, so that every corner of a
//!   tag is a crossing of black and white. Tag `first_id` is at the **bottom** left, ids grow to
//!   the right and then upwards. Corner `4 * tag id + k` with `k` 0 bottom left, 1 bottom right, 2
//!   top right, 3 top left of the tag. This is Kalibr's order of a tag's corners; Kalibr's own y
//!   axis points up from the bottom left.
//! - **ChArUco**, as OpenCV draws it since 4.6 (no legacy pattern): a chessboard with the top left
//!   square black and ArUco markers in the white squares, ids row by row from the top left. Corner
//!   `row * (columns - 1) + column` of the inner corners, row by row from the top left.

use crate::codes::Dictionary;

/// Cells of an AprilGrid tag along a side: 6 bits and a border of two cells on either side.
const TAG_CELLS: u32 = 10;

/// A planar calibration target.
#[derive(Clone, Debug, PartialEq)]
pub enum Target {
    /// A plain chessboard.
    Chessboard {
        /// Inner corners along x.
        columns: u32,
        /// Inner corners along y.
        rows: u32,
        /// Side of a square, metres.
        square_m: f64,
    },
    /// A grid of AprilTags of family 36h11, as Kalibr draws it.
    AprilGrid {
        /// Tags along x.
        columns: u32,
        /// Tags along y.
        rows: u32,
        /// Side of a tag's black square, metres.
        tag_m: f64,
        /// Gap between tags over the side of a tag.
        spacing: f64,
        /// Id of the tag at the bottom left.
        first_id: u32,
    },
    /// A chessboard with a marker in every white square.
    Charuco {
        /// Squares along x.
        columns: u32,
        /// Squares along y.
        rows: u32,
        /// Side of a square, metres.
        square_m: f64,
        /// Side of a marker with its black border, metres.
        marker_m: f64,
        /// Which markers.
        dictionary: Dictionary,
        /// Id of the first marker.
        first_id: u32,
    },
}

/// A corner of a board.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Corner {
    /// Id of the corner, the same in every image; see the module.
    pub id: u32,
    /// Position in the board's frame, metres; z is 0.
    pub at_m: [f64; 2],
}

/// A rectangle along the axes of the board's frame, metres.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Rectangle {
    /// The corner at the top left.
    pub min_m: [f64; 2],
    /// The corner at the bottom right.
    pub max_m: [f64; 2],
}

impl Rectangle {
    /// Width and height, metres.
    pub fn size_m(&self) -> [f64; 2] {
        [self.max_m[0] - self.min_m[0], self.max_m[1] - self.min_m[1]]
    }

    fn square(min_m: [f64; 2], side_m: f64) -> Self {
        Self {
            min_m,
            max_m: min_m.map(|v| v + side_m),
        }
    }
}

/// A marker on a board: its id and its square with border.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Marker {
    /// Id in the board's dictionary.
    pub id: u32,
    /// The outer edge of its black border.
    pub place: Rectangle,
}

impl Target {
    /// All detectable corners, ascending by id.
    ///
    /// ```
    /// use boards::Target;
    ///
    /// let board = Target::Chessboard { columns: 7, rows: 5, square_m: 0.03 };
    /// let corners = board.corners();
    /// assert_eq!(corners.len(), 35);
    /// // Neighbours along x are one square apart.
    /// assert!((corners[1].at_m[0] - corners[0].at_m[0] - 0.03).abs() < 1e-12);
    ///
    /// let grid = Target::AprilGrid { columns: 6, rows: 6, tag_m: 0.088, spacing: 0.3, first_id: 0 };
    /// assert_eq!((grid.markers().len(), grid.corners().len()), (36, 144));
    /// ```
    pub fn corners(&self) -> Vec<Corner> {
        match *self {
            Self::Chessboard {
                columns,
                rows,
                square_m,
            } => inner_corners(columns, rows, square_m),
            Self::Charuco {
                columns,
                rows,
                square_m,
                ..
            } => inner_corners(columns.saturating_sub(1), rows.saturating_sub(1), square_m),
            Self::AprilGrid { .. } => self
                .markers()
                .iter()
                .flat_map(|tag| {
                    let ([left, top], [right, bottom]) = (tag.place.min_m, tag.place.max_m);
                    [[left, bottom], [right, bottom], [right, top], [left, top]]
                        .into_iter()
                        .zip(4 * tag.id..)
                        .map(|(at_m, id)| Corner { id, at_m })
                })
                .collect(),
        }
    }

    /// The markers, ascending by id; empty for a chessboard.
    pub fn markers(&self) -> Vec<Marker> {
        match *self {
            Self::Chessboard { .. } => Vec::new(),
            Self::AprilGrid {
                columns,
                rows,
                tag_m,
                spacing,
                first_id,
            } => (0..rows)
                .flat_map(|up| (0..columns).map(move |column| (up, column)))
                .map(|(up, column)| {
                    let at = |i: u32| f64::from(i) * tag_m * (1.0 + spacing) + tag_m * spacing;
                    Marker {
                        id: first_id + up * columns + column,
                        place: Rectangle::square([at(column), at(rows - 1 - up)], tag_m),
                    }
                })
                .collect(),
            Self::Charuco {
                columns,
                rows,
                square_m,
                marker_m,
                first_id,
                ..
            } => {
                let margin = 0.5 * (square_m - marker_m);
                squares(columns, rows)
                    .filter(|(x, y)| !is_black(*x, *y))
                    .zip(first_id..)
                    .map(|((x, y), id)| Marker {
                        id,
                        place: Rectangle::square(
                            [x, y].map(|i| f64::from(i) * square_m + margin),
                            marker_m,
                        ),
                    })
                    .collect()
            }
        }
    }

    /// Black rectangles, without overlap; everything else on the sheet is white.
    ///
    /// # Panics
    /// For a board whose [`invalid_reason`](Self::invalid_reason) is that its dictionary has too
    /// few markers.
    pub fn black(&self) -> Vec<Rectangle> {
        let chessboard = |columns, rows, square_m: f64| {
            squares(columns, rows)
                .filter(|(x, y)| is_black(*x, *y))
                .map(move |(x, y)| {
                    Rectangle::square([x, y].map(|i| f64::from(i) * square_m), square_m)
                })
        };
        let mut black: Vec<Rectangle> = match *self {
            Self::Chessboard {
                columns,
                rows,
                square_m,
            } => chessboard(columns + 1, rows + 1, square_m).collect(),
            Self::Charuco {
                columns,
                rows,
                square_m,
                ..
            } => chessboard(columns, rows, square_m).collect(),
            Self::AprilGrid {
                columns,
                rows,
                tag_m,
                spacing,
                ..
            } => squares(columns + 1, rows + 1)
                .map(|crossing| {
                    let [x, y] =
                        [crossing.0, crossing.1].map(|i| f64::from(i) * tag_m * (1.0 + spacing));
                    Rectangle::square([x, y], tag_m * spacing)
                })
                .collect(),
        };
        if let Some((dictionary, border)) = self.dictionary() {
            for marker in self.markers() {
                let code = dictionary
                    .code(marker.id)
                    .expect("objection() counts the markers");
                marker_black(&marker.place, code, dictionary.bits(), border, &mut black);
            }
        }
        black
    }

    /// The sheet with its white margin: half a square, or a whole gap, all around the pattern.
    pub fn sheet_m(&self) -> Rectangle {
        let (columns, rows, step, margin) = match *self {
            Self::Chessboard {
                columns,
                rows,
                square_m,
            } => (columns + 1, rows + 1, square_m, 0.5 * square_m),
            Self::Charuco {
                columns,
                rows,
                square_m,
                ..
            } => (columns, rows, square_m, 0.5 * square_m),
            Self::AprilGrid {
                columns,
                rows,
                tag_m,
                spacing,
                ..
            } => {
                let (step, gap) = (tag_m * (1.0 + spacing), tag_m * spacing);
                return Rectangle {
                    min_m: [-gap; 2],
                    max_m: [columns, rows].map(|n| f64::from(n) * step + 2.0 * gap),
                };
            }
        };
        Rectangle {
            min_m: [-margin; 2],
            max_m: [columns, rows].map(|n| f64::from(n) * step + margin),
        }
    }

    /// The markers' dictionary and the width of their black border in cells; `None` for a
    /// chessboard.
    pub fn dictionary(&self) -> Option<(Dictionary, u32)> {
        match *self {
            Self::Chessboard { .. } => None,
            Self::AprilGrid { .. } => {
                let dictionary = Dictionary::AprilTag36h11;
                Some((dictionary, (TAG_CELLS - dictionary.bits()) / 2))
            }
            Self::Charuco { dictionary, .. } => Some((dictionary, 1)),
        }
    }

    /// Whether the pattern is symmetric under half a turn, so that its orientation is ambiguous.
    /// Views of two cameras, or of two times, then cannot be matched corner by corner without
    /// additional information.
    pub fn is_rotationally_symmetric(&self) -> bool {
        // With columns, rows inner corners, square (x, y) maps to (columns - x, rows - y): the
        // colour is the same if their sum is even.
        matches!(self, Self::Chessboard { columns, rows, .. } if (columns + rows) % 2 == 0)
    }

    /// Reason why this board cannot be printed or detected, if any, with the key in question.
    pub fn invalid_reason(&self) -> Option<(&'static str, String)> {
        let count = |key, found: u32, least: u32| {
            (found < least || found > 100)
                .then(|| (key, format!("{found}, expected {least} to 100")))
        };
        let length = |key, found: f64| {
            (!(0.001..=5.0).contains(&found)).then(|| {
                let expected = "expected metres, 0.001 to 5: another unit?";
                (key, format!("{found}, {expected}"))
            })
        };
        let ids = |dictionary: Dictionary, first_id: u32, needed: u32| {
            let there = dictionary.count();
            (first_id.checked_add(needed).is_none_or(|end| end > there)).then(|| {
                let name = dictionary.name();
                (
                    "first_id",
                    format!("{first_id} and {needed} markers from it, but {name} has {there}"),
                )
            })
        };
        match *self {
            Self::Chessboard {
                columns,
                rows,
                square_m,
            } => {
                let wrong = count("columns", columns, 3).or_else(|| count("rows", rows, 3));
                wrong.or_else(|| length("square_m", square_m))
            }
            Self::AprilGrid {
                columns,
                rows,
                tag_m,
                spacing,
                first_id,
            } => {
                let wrong = count("columns", columns, 1).or_else(|| count("rows", rows, 1));
                let wrong = wrong.or_else(|| length("tag_m", tag_m));
                let wrong = wrong.or_else(|| {
                    (!(0.1..=1.0).contains(&spacing)).then(|| {
                        let found = format!("{spacing}, expected gap over tag size, 0.1 to 1");
                        ("spacing", found)
                    })
                });
                wrong.or_else(|| ids(Dictionary::AprilTag36h11, first_id, columns * rows))
            }
            Self::Charuco {
                columns,
                rows,
                square_m,
                marker_m,
                dictionary,
                first_id,
            } => {
                let wrong = count("columns", columns, 3).or_else(|| count("rows", rows, 3));
                let wrong = wrong.or_else(|| length("square_m", square_m));
                let wrong = wrong.or_else(|| length("marker_m", marker_m));
                let wrong = wrong.or_else(|| {
                    (marker_m > 0.95 * square_m || marker_m < 0.4 * square_m).then(|| {
                        let found =
                            format!("{marker_m}, expected 0.4 to 0.95 of a square of {square_m}");
                        ("marker_m", found)
                    })
                });
                wrong.or_else(|| ids(dictionary, first_id, columns * rows / 2))
            }
        }
    }
}

/// Whether the square in this column and row of a chessboard is black.
fn is_black(x: u32, y: u32) -> bool {
    (x + y).is_multiple_of(2)
}

/// Columns and rows, row by row.
fn squares(columns: u32, rows: u32) -> impl Iterator<Item = (u32, u32)> {
    (0..rows).flat_map(move |y| (0..columns).map(move |x| (x, y)))
}

fn inner_corners(columns: u32, rows: u32, square_m: f64) -> Vec<Corner> {
    squares(columns, rows)
        .zip(0..)
        .map(|((x, y), id)| Corner {
            id,
            at_m: [x, y].map(|i| f64::from(i + 1) * square_m),
        })
        .collect()
}

/// The black cells of a marker as runs along its rows.
fn marker_black(place: &Rectangle, code: u64, bits: u32, border: u32, black: &mut Vec<Rectangle>) {
    let cells = bits + 2 * border;
    let is_black = |row: u32, column: u32| {
        let inside = border..border + bits;
        let bit = |row: u32, column: u32| code >> (bits * bits - 1 - (row * bits + column)) & 1;
        !inside.contains(&row)
            || !inside.contains(&column)
            || bit(row - border, column - border) == 0
    };
    let edge = |axis: usize, i: u32| {
        place.min_m[axis]
            + (place.max_m[axis] - place.min_m[axis]) * f64::from(i) / f64::from(cells)
    };
    for row in 0..cells {
        let mut column = 0;
        while column < cells {
            let end = (column..cells)
                .find(|&c| !is_black(row, c))
                .unwrap_or(cells);
            if end > column {
                black.push(Rectangle {
                    min_m: [edge(0, column), edge(1, row)],
                    max_m: [edge(0, end), edge(1, row + 1)],
                });
            }
            column = end.max(column + 1);
        }
    }
}

#[cfg(test)]
mod tests;
