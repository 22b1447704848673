//! Sets of directions: a bit for each of 62 directions of a sphere.

use std::sync::LazyLock;

/// The golden ratio.
const PHI: f64 = 1.618_033_988_749_895;

/// Number of directions: the axes of symmetry of an icosahedron, both ways.
pub const DIRECTIONS: usize = 62;

/// Directions of unit length: 12 vertices, 20 centers of faces and 30 centers of edges of an
/// icosahedron. The nearest one of any direction is less than 22° away.
static ALL: LazyLock<[[f32; 3]; DIRECTIONS]> = LazyLock::new(all);

/// A set of directions from a point. A direction is in the set if the nearest one of
/// [`DIRECTIONS`] directions is.
///
/// ```
/// use splats::Directions;
///
/// let mut seen = Directions::default();
/// seen.insert([0.0, 0.1, 1.0]);
/// assert!(seen.angle_rad([0.0, 0.0, 2.0]) < 0.4);
/// assert!(seen.angle_rad([1.0, 0.0, 0.0]) > 1.2);
/// ```
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Directions(pub u64);

impl Directions {
    /// Adds a direction of any length above 0.
    pub fn insert(&mut self, direction: [f32; 3]) {
        let (mut best, mut largest) = (0, f32::NEG_INFINITY);
        for (k, other) in ALL.iter().enumerate() {
            let along = dot(&direction, other);
            if along > largest {
                (best, largest) = (k, along);
            }
        }
        self.0 |= 1 << best;
    }

    /// Adds all directions of another set.
    pub fn insert_all(&mut self, other: Self) {
        self.0 |= other.0;
    }

    /// Number of directions.
    pub fn len(self) -> u32 {
        self.0.count_ones()
    }

    /// Whether there are none.
    pub fn is_empty(self) -> bool {
        self.0 == 0
    }

    /// Whether only bits of the directions are set.
    pub fn is_valid(self) -> bool {
        self.0 >> DIRECTIONS == 0
    }

    /// Angle between a direction of any length above 0 and the nearest one of the set, rad; π for
    /// an empty set. Rounded to the set's directions, which are up to 22° from what was added.
    pub fn angle_rad(self, direction: [f32; 3]) -> f32 {
        let (mut rest, mut largest) = (self.0, -1.0_f32);
        while rest != 0 {
            let k = rest.trailing_zeros() as usize;
            rest &= rest - 1;
            if let Some(other) = ALL.get(k) {
                largest = largest.max(dot(&direction, other));
            }
        }
        let length = dot(&direction, &direction).sqrt();
        match self.is_empty() {
            true => std::f32::consts::PI,
            false => libm::acosf((largest / length).clamp(-1.0, 1.0)),
        }
    }
}

fn dot(a: &[f32; 3], b: &[f32; 3]) -> f32 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

fn all() -> [[f32; 3]; DIRECTIONS] {
    // One of each kind; the others by cyclic exchange of the axes and by signs.
    let kinds = [
        [0.0, 1.0, PHI],
        [1.0, 1.0, 1.0],
        [0.0, PHI, 1.0 / PHI],
        [0.0, 0.0, 1.0],
        [1.0, PHI * PHI, PHI],
    ];
    let mut directions: Vec<[f32; 3]> = Vec::with_capacity(DIRECTIONS);
    for kind in kinds {
        let length = kind.iter().map(|v| v * v).sum::<f64>().sqrt();
        for turn in 0..3 {
            for signs in 0..8 {
                let direction = [0, 1, 2].map(|k| {
                    let value = kind[(k + turn) % 3] / length;
                    (if signs >> k & 1 == 1 { -value } else { value }) as f32
                });
                // A sign of a 0, and turns of (1, 1, 1), give the same direction again.
                if !directions.contains(&direction) {
                    directions.push(direction);
                }
            }
        }
    }
    std::array::from_fn(|k| directions[k])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn directions_are_distinct_and_cover_the_sphere() {
        for (k, a) in ALL.iter().enumerate() {
            assert!((dot(a, a) - 1.0).abs() < 1e-6);
            for b in &ALL[..k] {
                assert!(dot(a, b) < 0.935, "{a:?} and {b:?}");
            }
        }
        let mut largest = 0.0_f32;
        for i in 0..20_000 {
            let z = 2.0 * counter_random::uniform(1, 0, i) - 1.0;
            let turn = 2.0 * std::f64::consts::PI * counter_random::uniform(1, 1, i);
            let across = (1.0 - z * z).sqrt();
            let direction = [across * libm::cos(turn), across * libm::sin(turn), z];
            let direction = direction.map(|v| 3.0 * v as f32);
            let mut set = Directions::default();
            set.insert(direction);
            assert_eq!(set.len(), 1);
            assert!(set.is_valid());
            largest = largest.max(set.angle_rad(direction));
        }
        assert!(largest < 22.0_f32.to_radians(), "{}", largest.to_degrees());
    }
}
