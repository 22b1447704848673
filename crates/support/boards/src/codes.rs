//! Codes of the markers: AprilTag family 36h11 and the ArUco dictionaries of ChArUco boards.
//!
//! Contract: a code is read row by row from the top left of the upright marker, most significant
//! bit first; a set bit is white. The orientation of the markers on each kind of board is
//! documented with its geometry ([`Target`](crate::Target)).

mod aruco;
mod tag36h11;

use aruco::{ARUCO_4X4, ARUCO_5X5, ARUCO_6X6};
use tag36h11::TAG36H11;

/// A set of square markers with binary codes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Dictionary {
    /// AprilTag 36h11: 587 markers of 6 x 6 bits, at least 11 bits apart in every rotation.
    AprilTag36h11,
    /// The first `count` (50, 100 or 250) ArUco markers of 4 x 4 bits; at least 4, 3, 3 bits apart.
    Aruco4x4 {
        /// Number of markers.
        count: u32,
    },
    /// The first `count` (50, 100 or 250) ArUco markers of 5 x 5 bits; at least 8, 7, 6 bits apart.
    Aruco5x5 {
        /// Number of markers.
        count: u32,
    },
    /// The first `count` (50, 100 or 250) ArUco markers of 6 x 6 bits; at least 13, 12, 11 bits
    /// apart.
    Aruco6x6 {
        /// Number of markers.
        count: u32,
    },
}

/// Dictionary names accepted in a ChArUco file, without OpenCV's `DICT_`.
pub const ARUCO_NAMES: [&str; 9] = [
    "4X4_50", "4X4_100", "4X4_250", "5X5_50", "5X5_100", "5X5_250", "6X6_50", "6X6_100", "6X6_250",
];

impl Dictionary {
    /// An ArUco dictionary by OpenCV's name, with or without `DICT_`, for example `4X4_50`.
    pub fn aruco(name: &str) -> Option<Self> {
        let name = name.to_ascii_uppercase();
        let name = name.strip_prefix("DICT_").unwrap_or(&name);
        let known = ARUCO_NAMES.contains(&name);
        let (bits, count) = name.split_once('_').filter(|_| known)?;
        let count = count.parse().ok()?;
        match bits {
            "4X4" => Some(Self::Aruco4x4 { count }),
            "5X5" => Some(Self::Aruco5x5 { count }),
            _ => Some(Self::Aruco6x6 { count }),
        }
    }

    /// The name that [`aruco`](Self::aruco) reads, or `36H11`.
    pub fn name(self) -> String {
        match self {
            Self::AprilTag36h11 => "36H11".to_owned(),
            Self::Aruco4x4 { count } => format!("4X4_{count}"),
            Self::Aruco5x5 { count } => format!("5X5_{count}"),
            Self::Aruco6x6 { count } => format!("6X6_{count}"),
        }
    }

    /// Bits along a side.
    pub fn bits(self) -> u32 {
        match self {
            Self::AprilTag36h11 | Self::Aruco6x6 { .. } => 6,
            Self::Aruco5x5 { .. } => 5,
            Self::Aruco4x4 { .. } => 4,
        }
    }

    /// Number of markers.
    pub fn count(self) -> u32 {
        match self {
            Self::AprilTag36h11 => TAG36H11.len() as u32,
            Self::Aruco4x4 { count } | Self::Aruco5x5 { count } | Self::Aruco6x6 { count } => count,
        }
    }

    /// The code of a marker; `None` for an id that is not below [`count`](Self::count).
    pub fn code(self, id: u32) -> Option<u64> {
        if id >= self.count() {
            return None;
        }
        let id = id as usize;
        match self {
            Self::AprilTag36h11 => TAG36H11.get(id).copied(),
            Self::Aruco4x4 { .. } => ARUCO_4X4.get(id).copied().map(u64::from),
            Self::Aruco5x5 { .. } => ARUCO_5X5.get(id).copied().map(u64::from),
            Self::Aruco6x6 { .. } => ARUCO_6X6.get(id).copied(),
        }
    }

    /// The minimum Hamming distance of two markers, over all rotations, including rotations of one
    /// marker.
    pub fn distance(self) -> u32 {
        let by_count =
            |count: u32, of: [u32; 3]| of[usize::from(count > 50) + usize::from(count > 100)];
        match self {
            Self::AprilTag36h11 => 11,
            Self::Aruco4x4 { count } => by_count(count, [4, 3, 3]),
            Self::Aruco5x5 { count } => by_count(count, [8, 7, 6]),
            Self::Aruco6x6 { count } => by_count(count, [13, 12, 11]),
        }
    }
}

/// The code of a marker of `bits` bits along a side after a quarter turn clockwise.
pub fn quarter_turn(code: u64, bits: u32) -> u64 {
    let mut rotated = 0;
    for row in 0..bits {
        for column in 0..bits {
            // The bit at (row, column) comes from (last - column, row).
            let from = (bits - 1 - column) * bits + row;
            rotated = rotated << 1 | code >> (bits * bits - 1 - from) & 1;
        }
    }
    rotated
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The distances verify the tables: one wrong digit reduces the distance of two markers.
    #[test]
    fn markers_are_as_far_apart_as_their_makers_say() {
        let mut all = vec![Dictionary::AprilTag36h11];
        all.extend(
            ARUCO_NAMES
                .iter()
                .filter_map(|name| Dictionary::aruco(name)),
        );
        assert_eq!(all.len(), 10);
        for dictionary in all {
            let (bits, count) = (dictionary.bits(), dictionary.count());
            let codes: Vec<u64> = (0..count).map(|id| dictionary.code(id).unwrap()).collect();
            let mut closest = u32::MAX;
            for (i, &code) in codes.iter().enumerate() {
                let mut rotated = code;
                for _ in 0..3 {
                    rotated = quarter_turn(rotated, bits);
                    closest = closest.min((rotated ^ code).count_ones());
                }
                for &other in &codes[..i] {
                    let mut rotated = code;
                    for _ in 0..4 {
                        rotated = quarter_turn(rotated, bits);
                        closest = closest.min((rotated ^ other).count_ones());
                    }
                }
            }
            assert_eq!(closest, dictionary.distance(), "{}", dictionary.name());
            assert_eq!(dictionary.code(count), None);
        }
    }

    #[test]
    fn a_quarter_turn_is_clockwise() {
        // A set bit at the top left moves to the top right, then to the bottom right.
        let top_left = 1 << 8;
        assert_eq!(quarter_turn(top_left, 3), 1 << 6);
        assert_eq!(quarter_turn(quarter_turn(top_left, 3), 3), 1);
    }
}
