//! Disparity search range per row.
//!
//! Contract: a [`Band`] has one range per row. Disparities outside are never returned: pixels whose
//! true disparity lies outside are absent or wrong. A band that is narrower than the full range is
//! therefore planned from prior knowledge of the scene ([`plan`]), and [`crate::BandedMatcher`]
//! checks after each run that the band clipped nothing.

pub mod plan;

use crate::aggregation::{MAX_DISPARITIES, MAX_NEGATIVE_PX};
use crate::error::DepthError;

/// Range of searched disparities for each row.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Band {
    first: i32,
    count: usize,
    /// Half-open range of each row, counted from `first`.
    rows: Vec<[u16; 2]>,
}

impl Band {
    /// The same range for all rows: `count` disparities from `first`.
    ///
    /// # Errors
    /// [`DepthError::Band`] if `count` is 0 or too large.
    pub fn full(first: i32, count: usize, height: usize) -> Result<Self, DepthError> {
        match i32::try_from(count) {
            Ok(of @ 1..) if first.checked_add(of - 1).is_some() => {
                Self::rows(&vec![[first, first + of - 1]; height])
            }
            _ => Err(DepthError::Band {
                found: format!("{count} disparities from {first} px"),
                expected: format!(
                    "1 to {MAX_DISPARITIES} disparities, from {} px or more",
                    -(MAX_NEGATIVE_PX as i32)
                ),
            }),
        }
    }

    /// Minimum and maximum disparity of each row, px, both inclusive.
    ///
    /// # Errors
    /// [`DepthError::Band`] if a row is empty or the total range is too large.
    ///
    /// ```
    /// use depth::Band;
    ///
    /// // The sky in the upper half, the ground in the lower one.
    /// let mut rows = [[0, 15]; 48];
    /// rows[24..].fill([16, 63]);
    /// let band = Band::rows(&rows)?;
    /// assert_eq!((band.first(), band.count(), band.height()), (0, 64, 48));
    /// assert_eq!(band.row(47), [16, 63]);
    /// assert_eq!(band.searched_ratio(64), 0.5);
    ///
    /// assert!(Band::rows(&[[5, 4]]).is_err());
    /// # Ok::<(), depth::DepthError>(())
    /// ```
    pub fn rows(rows: &[[i32; 2]]) -> Result<Self, DepthError> {
        let invalid = |found: String, expected: String| Err(DepthError::Band { found, expected });
        let Some(first) = rows.iter().map(|row| row[0]).min() else {
            return invalid(
                "no rows".to_owned(),
                "one range for each image row".to_owned(),
            );
        };
        if let Some([low, high]) = rows.iter().find(|[low, high]| low > high) {
            return invalid(
                format!("a row from {low} to {high} px"),
                "the minimum first".to_owned(),
            );
        }
        let last = rows.iter().map(|row| row[1]).max().unwrap_or(first);
        let count = i64::from(last) - i64::from(first) + 1;
        if count > MAX_DISPARITIES as i64 || first < -(MAX_NEGATIVE_PX as i32) {
            return invalid(
                format!("{first} to {last} px"),
                format!(
                    "at most {MAX_DISPARITIES} disparities, from {} px or more",
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

    /// Minimum disparity of any row, px.
    pub fn first(&self) -> i32 {
        self.first
    }

    /// Number of disparities from the minimum of all rows to the maximum.
    pub fn count(&self) -> usize {
        self.count
    }

    /// Number of rows.
    pub fn height(&self) -> usize {
        self.rows.len()
    }

    /// Minimum and maximum disparity of a row, px.
    ///
    /// # Panics
    /// If `y` is not below [`Band::height`].
    pub fn row(&self, y: usize) -> [i32; 2] {
        let [low, high] = self.rows[y].map(i32::from);
        [self.first + low, self.first + high - 1]
    }

    /// Disparities of all rows, as a fraction of `count` per row.
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
    fn row_ranges_are_returned_unchanged() {
        let rows = [[3, 9], [-2, 4], [5, 5]];
        let band = Band::rows(&rows).unwrap();
        assert_eq!((band.first(), band.count(), band.height()), (-2, 12, 3));
        assert_eq!([0, 1, 2].map(|y| band.row(y)), rows);
        assert_eq!(band.searched_ratio(12), 15.0 / 36.0);
        assert_eq!(Band::full(0, 64, 2).unwrap().row(1), [0, 63]);
    }

    #[test]
    fn invalid_bands_are_rejected() {
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
