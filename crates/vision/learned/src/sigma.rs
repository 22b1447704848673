//! Standard deviation of disparities, which the network does not provide.

use depth::DisparityMap;

use crate::settings::StereoSettings;

/// Radius of the window over which left-right differences are averaged, px.
const REACH: usize = 4;

/// Disparities with the configured sigma. Those that are not finite or lie outside the right image
/// are absent.
pub(crate) fn constant_sigma(
    width: usize,
    disparity: Vec<f32>,
    settings: &StereoSettings,
) -> DisparityMap {
    let outside = |x: usize, disparity: f32| right_column(width, x, disparity).is_none();
    let mut map = map(width, disparity);
    for (at, disparity) in map.disparity.iter_mut().enumerate() {
        if outside(at % width, *disparity) {
            *disparity = f32::NAN;
        } else {
            map.sigma[at] = settings.sigma_px;
        }
    }
    map
}

/// Left-right check: disparities of the left image, compared with those of the right one.
///
/// A disparity is also absent where the two differ by more than [`StereoSettings::apart_px`]. If
/// the errors of both are independent with equal variance, the variance of their difference is
/// twice that of one; it is estimated as the mean over a window. Errors common to both directions
/// do not show in the difference; [`StereoSettings::sigma_px`] covers them.
pub(crate) fn left_right_check(
    width: usize,
    left: Vec<f32>,
    right: &[f32],
    settings: &StereoSettings,
) -> DisparityMap {
    let mut map = map(width, left);
    let mut squared_difference = vec![f32::NAN; map.disparity.len()];
    for (at, disparity) in map.disparity.iter_mut().enumerate() {
        let (x, row) = (at % width, at / width * width);
        let difference = right_column(width, x, *disparity)
            .map(|column| *disparity - interpolate(&right[row..row + width], column));
        match difference {
            Some(difference) if difference.abs() <= settings.apart_px => {
                squared_difference[at] = difference * difference
            }
            _ => *disparity = f32::NAN,
        }
    }
    let variance = settings.sigma_px * settings.sigma_px;
    for (at, sigma) in map.sigma.iter_mut().enumerate() {
        if !squared_difference[at].is_nan() {
            *sigma = (variance + mean_around(&squared_difference, width, at) / 2.0).sqrt();
        }
    }
    map
}

fn map(width: usize, disparity: Vec<f32>) -> DisparityMap {
    DisparityMap {
        width,
        height: disparity.len() / width,
        sigma: vec![f32::NAN; disparity.len()],
        disparity,
    }
}

/// Column of the matching point in the right image; `None` outside the image.
fn right_column(width: usize, x: usize, disparity: f32) -> Option<f32> {
    let column = x as f32 - disparity;
    (column >= 0.0 && column <= (width - 1) as f32).then_some(column)
}

/// Linear interpolation in a row.
fn interpolate(row: &[f32], column: f32) -> f32 {
    let before = column as usize;
    let part = column - before as f32;
    if part == 0.0 {
        return row[before];
    }
    row[before] * (1.0 - part) + row[before + 1] * part
}

/// Mean of the values that are present in the window around a pixel. The value of the pixel itself
/// must be present.
fn mean_around(values: &[f32], width: usize, at: usize) -> f32 {
    let height = values.len() / width;
    let (x, y) = (at % width, at / width);
    let columns = x.saturating_sub(REACH)..(x + REACH + 1).min(width);
    let rows = y.saturating_sub(REACH)..(y + REACH + 1).min(height);
    let (mut sum, mut count) = (0.0, 0.0);
    for row in rows {
        let row = &values[row * width..][columns.clone()];
        for value in row.iter().filter(|v| !v.is_nan()) {
            sum += value;
            count += 1.0;
        }
    }
    sum / count
}

#[cfg(test)]
mod tests {
    use super::*;

    fn settings() -> StereoSettings {
        StereoSettings {
            apart_px: 1.0,
            sigma_px: 0.3,
            ..StereoSettings::default()
        }
    }

    #[test]
    fn disparity_outside_the_right_image_is_absent() {
        let map = constant_sigma(
            4,
            vec![1.0, 1.0, f32::INFINITY, -0.5, 0.0, f32::NAN, 0.0, -0.5],
            &settings(),
        );
        assert_eq!(map.height, 2);
        let present: Vec<bool> = map.disparity.iter().map(|d| !d.is_nan()).collect();
        assert_eq!(
            present,
            [false, true, false, false, true, false, true, false]
        );
        assert_eq!(map.sigma[1], 0.3);
        assert!(
            map.sigma
                .iter()
                .zip(&present)
                .all(|(s, present)| s.is_nan() != *present)
        );
    }

    #[test]
    fn left_right_difference_above_the_limit_is_absent() {
        // A wall at 2 px in front of one at 1 px; the exact right row would be 2, 2, 1, 1, 1, 1.
        let left = vec![f32::NAN, 1.0, 2.0, 2.0, 1.0, 1.0];
        let right = [2.0, 2.0, 4.0, 1.4, 1.0, 1.0];
        let map = left_right_check(6, left, &right, &settings());
        // Column 4 maps to 3, where the right value is 1.4; column 5 maps to 4, with 1.0; column 1
        // maps to 0, with 2.0, which is within the limit.
        let present: Vec<bool> = map.disparity.iter().map(|d| !d.is_nan()).collect();
        assert_eq!(present, [false, true, true, true, true, true]);
        let mean = (1.0 + 0.0 + 0.0 + 0.16 + 0.0) / 5.0;
        let sigma = (0.09_f32 + mean / 2.0).sqrt();
        assert!((map.sigma[3] - sigma).abs() < 1e-6, "{:?}", map.sigma);
        let far = left_right_check(
            6,
            vec![0.0; 6],
            &[0.0, 1.1, f32::NAN, 0.0, 0.0, 0.0],
            &settings(),
        );
        let present: Vec<bool> = far.disparity.iter().map(|d| !d.is_nan()).collect();
        assert_eq!(present, [true, false, false, true, true, true]);
    }

    #[test]
    fn right_disparity_is_interpolated_on_a_slope() {
        // The left disparity is 0.5 + 0.5 x, so that x maps to x' = 0.5 x - 0.5, where the right
        // disparity must be 1 + x'.
        let left: Vec<f32> = (0..8).map(|x| 0.5 + 0.5 * x as f32).collect();
        let right: Vec<f32> = (0..8).map(|x| 1.0 + x as f32).collect();
        let map = left_right_check(8, left, &right, &settings());
        assert!(map.disparity[0].is_nan());
        assert!(
            map.sigma[1..].iter().all(|s| (s - 0.3).abs() < 1e-6),
            "{:?}",
            map.sigma
        );
    }
}
