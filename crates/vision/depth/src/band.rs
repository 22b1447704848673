//! Which disparities are looked for.
//!
//! Contract: a [`Band`] has a range for each row. What lies outside is never an answer: pixels whose place is there are
//! absent or wrong. So a band that is narrower than all there can be is made of what is known of the scene ([`plan`]),
//! and [`crate::BandedMatcher`] checks each time that nothing was cut off.

pub mod plan;

use crate::aggregation::{MAX_DISPARITIES, MAX_NEGATIVE_PX};
use crate::error::DepthError;

/// Disparities to look for, for each row.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Band {
    first: i32,
    count: usize,
    /// From `first` on: the first one and the one behind the last.
    rows: Vec<[u16; 2]>,
}

impl Band {
    /// The same for all rows: `count` disparities from `first` on.
    ///
    /// # Errors
    /// [`DepthError::Band`] for none or too many.
    pub fn full(first: i32, count: usize, height: usize) -> Result<Self, DepthError> {
        match i32::try_from(count) {
            Ok(of @ 1..) if first.checked_add(of - 1).is_some() => {
                Self::rows(&vec![[first, first + of - 1]; height])
            }
            _ => Err(DepthError::Band {
                found: format!("{count} disparities from {first} px on"),
                expected: format!(
                    "1 to {MAX_DISPARITIES}, from {} on",
                    -(MAX_NEGATIVE_PX as i32)
                ),
            }),
        }
    }

    /// The least and the greatest disparity of each row, both included.
    ///
    /// # Errors
    /// [`DepthError::Band`] for rows without any, or for more disparities than can be looked for.
    pub fn rows(rows: &[[i32; 2]]) -> Result<Self, DepthError> {
        let invalid = |found: String, expected: String| Err(DepthError::Band { found, expected });
        let Some(first) = rows.iter().map(|row| row[0]).min() else {
            return invalid(
                "no rows".to_owned(),
                "one for each of the picture".to_owned(),
            );
        };
        if let Some([low, high]) = rows.iter().find(|[low, high]| low > high) {
            return invalid(
                format!("a row from {low} to {high} px"),
                "the least one first".to_owned(),
            );
        }
        let last = rows.iter().map(|row| row[1]).max().unwrap_or(first);
        let count = i64::from(last) - i64::from(first) + 1;
        if count > MAX_DISPARITIES as i64 || first < -(MAX_NEGATIVE_PX as i32) {
            return invalid(
                format!("{first} to {last} px"),
                format!(
                    "{MAX_DISPARITIES} disparities at most, from {} on",
                    -(MAX_NEGATIVE_PX as i32)
                ),
            );
        }
        let of = |[low, high]: &[i32; 2]| [(low - first) as u16, (high - first + 1) as u16];
        Ok(Self {
            first,
            count: count as usize,
            rows: rows.iter().map(of).collect(),
        })
    }

    /// The least disparity of any row, px.
    pub fn first(&self) -> i32 {
        self.first
    }

    /// Disparities from the least of any row to the greatest.
    pub fn count(&self) -> usize {
        self.count
    }

    /// Rows.
    pub fn height(&self) -> usize {
        self.rows.len()
    }

    /// The least and the greatest disparity of a row, px.
    ///
    /// # Panics
    /// There is no such row.
    pub fn row(&self, y: usize) -> [i32; 2] {
        let [low, high] = self.rows[y].map(i32::from);
        [self.first + low, self.first + high - 1]
    }

    /// Disparities of all rows together, as a share of `count` in each of them.
    pub fn searched_ratio(&self, count: usize) -> f64 {
        let all: u64 = self
            .rows
            .iter()
            .map(|[low, high]| u64::from(high - low))
            .sum();
        all as f64 / (count * self.rows.len()).max(1) as f64
    }

    pub(crate) fn lanes(&self) -> &[[u16; 2]] {
        &self.rows
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rows_are_kept_as_they_are() {
        let rows = [[3, 9], [-2, 4], [5, 5]];
        let band = Band::rows(&rows).unwrap();
        assert_eq!((band.first(), band.count(), band.height()), (-2, 12, 3));
        assert_eq!([0, 1, 2].map(|y| band.row(y)), rows);
        assert_eq!(band.searched_ratio(12), 15.0 / 36.0);
        assert_eq!(Band::full(0, 64, 2).unwrap().row(1), [0, 63]);
    }

    #[test]
    fn impossible_bands_are_refused() {
        for bad in [
            Band::full(0, 0, 4),
            Band::full(0, 300, 4),
            Band::full(-40, 50, 4),
            Band::full(i32::MAX, 10, 4),
            Band::rows(&[]),
            Band::rows(&[[0, 3], [4, 2]]),
        ] {
            let error = bad.unwrap_err();
            assert!(error.to_string().contains("expected"), "{error}");
        }
    }
}
