//! Order of Gaussians in which halves, quarters and so on are compact in space.

use rayon::prelude::*;

use crate::scene::Splats;

/// Gaussians from which on both parts are ordered in parallel.
const PARALLEL: usize = 8192;

/// Indices in the order of a k-d tree (Bentley 1975): each part is split across the longest side
/// of its box. The first part has the largest power of two of them that is not all, so that runs of
/// any power of two are parts of the tree.
pub(super) fn order(splats: &Splats) -> Vec<u32> {
    let planes = splats.planes();
    let positions: Vec<[f32; 3]> = (0..splats.len())
        .map(|i| [planes[0][i], planes[1][i], planes[2][i]])
        .collect();
    let mut indices: Vec<u32> = (0..splats.len() as u32).collect();
    split(&positions, &mut indices);
    indices
}

fn split(positions: &[[f32; 3]], indices: &mut [u32]) {
    if indices.len() < 2 {
        return;
    }
    let axis = longest_side(positions, indices);
    let middle = indices.len().next_power_of_two() / 2;
    // Equal positions by their index: the result does not depend on the method.
    indices.select_nth_unstable_by(middle, |a, b| {
        let [x, y] = [a, b].map(|i| positions[*i as usize][axis]);
        x.total_cmp(&y).then(a.cmp(b))
    });
    let is_large = indices.len() >= PARALLEL;
    let (first, second) = indices.split_at_mut(middle);
    match is_large {
        true => [first, second]
            .into_par_iter()
            .for_each(|part| split(positions, part)),
        false => {
            split(positions, first);
            split(positions, second);
        }
    }
}

fn longest_side(positions: &[[f32; 3]], indices: &[u32]) -> usize {
    let mut low = [f32::INFINITY; 3];
    let mut high = [f32::NEG_INFINITY; 3];
    for index in indices {
        for (k, value) in positions[*index as usize].into_iter().enumerate() {
            low[k] = low[k].min(value);
            high[k] = high[k].max(value);
        }
    }
    let mut longest = 0;
    for k in 1..3 {
        if high[k] - low[k] > high[longest] - low[longest] {
            longest = k;
        }
    }
    longest
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::Splat;

    #[test]
    fn runs_of_powers_of_two_lie_side_by_side() {
        // Five times nine positions on a line, mixed.
        let mut splats = Splats::empty(0).unwrap();
        for i in 0..45_u16 {
            let mut splat = Splat::sphere(0.1, [0.5; 3]);
            splat.position_m[1] = f32::from(i * 16 % 45);
            splats.push(&splat).unwrap();
        }
        let order = order(&splats);
        let along: Vec<f32> = order
            .iter()
            .map(|i| splats.planes()[1][*i as usize])
            .collect();
        let expected: Vec<f32> = (0..45_u16).map(f32::from).collect();
        assert_eq!(along, expected);
    }

    #[test]
    fn parts_are_split_across_their_longest_side() {
        // Two rows of four, 10 m apart.
        let mut splats = Splats::empty(0).unwrap();
        for i in 0..8_u16 {
            let mut splat = Splat::sphere(0.1, [0.5; 3]);
            splat.position_m = [f32::from(i / 2), 10.0 * f32::from(i % 2), 0.0];
            splats.push(&splat).unwrap();
        }
        assert_eq!(order(&splats), [0, 2, 4, 6, 1, 3, 5, 7]);
    }
}
