//! The sky behind all sectors.

use super::part::Part;
use crate::confidence::ObservedSky;
use crate::error::SplatError;
use crate::scene::{Background, Sky};

/// The background of all parts: in each direction the mean of the skies of those that saw sky
/// there; of all where none did. Of one part it is its own. Black without parts.
///
/// # Errors
/// [`SplatError::Sky`] if skies have different sizes.
pub fn merged_background(parts: &[&Part]) -> Result<Background, SplatError> {
    let Some(first) = parts.first() else {
        return Ok(Background::Constant([0.0; 3]));
    };
    let Background::Sky(sky) = &first.background else {
        let colors = parts
            .iter()
            .map(|part| part.background.color([0.0, 0.0, 1.0]));
        return Ok(Background::Constant(mean(&colors.collect::<Vec<_>>())));
    };
    let size = sky.size();
    let mut skies: Vec<(&Sky, &ObservedSky)> = Vec::new();
    for part in parts {
        match &part.background {
            Background::Sky(sky) if sky.size() == size => skies.push((sky, part.coverage.sky())),
            _ => return Err(SplatError::Sky { size, texels: 0 }),
        }
    }
    let texel = |index: usize| {
        let direction = direction(size, index);
        let saw = skies.iter().filter(|(_, seen)| seen.contains(direction));
        let mut colors: Vec<[f32; 3]> = saw.map(|(sky, _)| sky.texels()[index]).collect();
        if colors.is_empty() {
            colors = skies.iter().map(|(sky, _)| sky.texels()[index]).collect();
        }
        mean(&colors)
    };
    let texels = (0..size * size).map(texel).collect();
    Ok(Background::Sky(Sky::from_texels(size, texels)?))
}

/// Of one color the color itself.
fn mean(colors: &[[f32; 3]]) -> [f32; 3] {
    [0, 1, 2].map(|c| {
        let sum: f64 = colors.iter().map(|color| f64::from(color[c])).sum();
        (sum / colors.len() as f64) as f32
    })
}

/// The direction of a texel of an octahedral map: the reverse of its lookup.
fn direction(size: usize, index: usize) -> [f32; 3] {
    let at = |k: usize| 2.0 * k as f32 / (size - 1) as f32 - 1.0;
    let (u, v) = (at(index % size), at(index / size));
    let z = 1.0 - u.abs() - v.abs();
    let sign = |of: f32| if of < 0.0 { -1.0 } else { 1.0 };
    match z < 0.0 {
        true => [(1.0 - v.abs()) * sign(u), (1.0 - u.abs()) * sign(v), z],
        false => [u, v, z],
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::confidence::{Coverage, ObservedSpace};
    use crate::scene::{Splats, taps};

    fn part(color: [f32; 3], seen: &[[f32; 3]]) -> Part {
        let mut sky = ObservedSky::none(16);
        // With those around them: colors come from four texels.
        for (direction, around) in seen.iter().flat_map(|d| (0..27).map(move |k| (d, k))) {
            let aside = [around % 3, around / 3 % 3, around / 9].map(|k| 0.2 * k as f32 - 0.2);
            sky.insert([0, 1, 2].map(|k| direction[k] + aside[k]));
        }
        Part {
            splats: Splats::empty(0).expect("a degree"),
            background: Background::Sky(Sky::uniform(32, color).expect("a size")),
            coverage: Coverage::new(Vec::new(), ObservedSpace::new(0.25, 20.0), sky),
            start_count: 0,
            checks: Vec::new(),
        }
    }

    #[test]
    fn directions_are_those_of_the_lookup() {
        for index in 0..32 * 32 {
            let taps = taps(32, direction(32, index));
            let of = taps.iter().filter(|(k, _)| *k == index);
            // At the outer edge of the map two texels have one direction.
            let is_edge = [index % 32, index / 32].iter().any(|k| [0, 31].contains(k));
            assert!(
                is_edge || of.map(|(_, w)| w).sum::<f32>() > 0.999,
                "{index}"
            );
        }
    }

    #[test]
    fn a_sky_is_that_of_the_parts_which_saw_it() {
        let (up, ahead, down) = ([0.1, 0.1, 1.0], [1.0, 0.2, 0.2], [-0.2, 0.3, -1.0]);
        let one = part([0.25, 0.5, 1.0], &[up, ahead]);
        let other = part([0.75, 0.5, 0.0], &[up]);
        assert_eq!(merged_background(&[&one]).expect("a sky"), one.background);
        let both = merged_background(&[&one, &other]).expect("a sky");
        let is_near = |direction, color: [f32; 3]| {
            let found = both.color(direction);
            let errors = [0, 1, 2].map(|c| (found[c] - color[c]).abs());
            assert!(errors.iter().all(|e| *e < 1e-6), "{direction:?} {found:?}");
        };
        is_near(up, [0.5; 3]);
        is_near(ahead, [0.25, 0.5, 1.0]);
        is_near(down, [0.5; 3]);
        let mut constant = part([0.0; 3], &[]);
        constant.background = Background::Constant([0.5, 0.25, 1.0]);
        assert!(merged_background(&[&one, &constant]).is_err());
        let found = merged_background(&[&constant, &constant]).expect("a color");
        assert_eq!(found, constant.background);
    }
}
