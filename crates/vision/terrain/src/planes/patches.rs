//! Mean heights of patches of a plane: bumps that the noise of single depths hides show in them.

use nalgebra::Vector3;

use super::support::SupportGrid;
use crate::config::PlaneConfig;

/// Edge of a patch, m: smaller than a sole.
const PATCH_M: f64 = 0.06;
/// Patches with less than this share of the median information are at borders and do not count.
const MIN_SHARE: f64 = 0.25;

/// See the module.
#[derive(Clone, Debug, Default)]
pub(crate) struct Patches {
    /// Coordinates of the corner of the first patch, m.
    from: [f64; 2],
    /// Patches along both axes.
    size: [usize; 2],
    /// Sums of inverse variances, of heights times these, and numbers of depths.
    sums: Vec<[f64; 3]>,
}

impl Patches {
    /// Patches of the area of a grid.
    pub(crate) fn around(grid: &SupportGrid) -> Self {
        let from = grid.from.map(|k| f64::from(k) * grid.cell_m);
        let size = grid
            .size
            .map(|count| (count as f64 * grid.cell_m / PATCH_M).ceil() as usize);
        Self {
            from,
            size,
            sums: vec![[0.0; 3]; size[0] * size[1]],
        }
    }

    /// Adds a depth by its coordinates, its height above the plane and one standard deviation, m.
    pub(crate) fn add(&mut self, at: [f64; 2], height: f64, sigma: f64) {
        let [x, y] = [0, 1].map(|k| ((at[k] - self.from[k]) / PATCH_M).floor());
        let inside = x >= 0.0 && y >= 0.0 && x < self.size[0] as f64 && y < self.size[1] as f64;
        if inside {
            let weight = 1.0 / (sigma * sigma);
            let sums = &mut self.sums[y as usize * self.size[0] + x as usize];
            *sums = [sums[0] + weight, sums[1] + weight * height, sums[2] + 1.0];
        }
    }

    /// Whether the ground is rough: its bumps are larger than those that the matcher makes of
    /// depths with this noise.
    pub(crate) fn is_rough(&self, plane: &Vector3<f64>, config: &PlaneConfig) -> bool {
        let sum = |k: usize| self.sums.iter().map(|sums| sums[k]).sum::<f64>();
        // The root of the harmonic mean variance.
        let sigma_m = (sum(2) / sum(0)).sqrt();
        let limit_m = (config.max_roughness_sigmas * sigma_m)
            .clamp(config.min_roughness_m, config.max_roughness_m);
        self.roughness_m(plane, config.correlated_samples) > limit_m
    }

    /// Root mean square distance of the patches from a plane beyond their own errors, m. The plane
    /// is given by its height at the origin and per metre along both axes.
    fn roughness_m(&self, plane: &Vector3<f64>, correlated_samples: f64) -> f64 {
        let mut weights: Vec<f64> = self.sums.iter().map(|sums| sums[0]).collect();
        weights.retain(|weight| *weight > 0.0);
        weights.sort_unstable_by(f64::total_cmp);
        let median = weights.get(weights.len() / 2).copied().unwrap_or(0.0);
        let (mut square, mut count) = (0.0, 0.0);
        for (i, [weight, sum, _]) in self.sums.iter().enumerate() {
            if *weight <= MIN_SHARE * median {
                continue;
            }
            let place = [i % self.size[0], i / self.size[0]];
            let [s, t] = [0, 1].map(|k| self.from[k] + (place[k] as f64 + 0.5) * PATCH_M);
            let away = sum / weight - plane.dot(&Vector3::new(1.0, s, t));
            square += away * away - correlated_samples / weight;
            count += 1.0;
        }
        (square / f64::max(count, 1.0)).max(0.0).sqrt()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const PLANE: [f64; 3] = [0.02, 0.1, 0.0];

    /// A square metre with waves, and depths with noise.
    fn patches(bump: f64, sigma: f64) -> Patches {
        let corners = [[-0.5, -0.5], [0.5, 0.5]];
        let grid = SupportGrid::around(0.01, corners.into_iter(), 0.03);
        let mut patches = Patches::around(&grid);
        for i in 0..40_000 {
            let at = [0, 1].map(|k| counter_random::uniform(6, k, i) - 0.5);
            let wave = (at[0] * 12.0).sin() * (at[1] * 12.0).sin();
            let height = PLANE[0] + PLANE[1] * at[0] + bump * wave;
            let noise = sigma * counter_random::bell(7, 0, i);
            patches.add(at, height + noise, sigma);
        }
        patches
    }

    #[test]
    fn bumps_below_the_noise_show_in_the_mean() {
        let roughness = |bump: f64| patches(bump, 0.01).roughness_m(&PLANE.into(), 1.0);
        assert!(roughness(0.0) < 0.001, "{}", roughness(0.0));
        // The root mean square of the waves is a half; patches smooth them somewhat.
        let rough = roughness(0.01);
        assert!((0.0038..0.0055).contains(&rough), "{rough}");
    }

    #[test]
    fn bumps_of_the_matcher_grow_with_its_noise() {
        let config = PlaneConfig {
            correlated_samples: 1.0,
            ..PlaneConfig::default()
        };
        let is_rough =
            |bump: f64, sigma: f64| patches(bump, sigma).is_rough(&PLANE.into(), &config);
        // Roughness is 0.45 times the bump.
        assert!(!is_rough(0.012, 0.012));
        assert!(is_rough(0.012, 0.007));
        assert!(!is_rough(0.008, 0.002), "below the least limit");
        assert!(is_rough(0.024, 0.025), "above the largest limit");
    }
}
