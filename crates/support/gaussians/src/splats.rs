//! The Gaussians as a structure of arrays.
//!
//! Contract: [`Splats`] that exist are finite and their rotations are not zero, so that renderers
//! need not check. Every parameter is a *plane*, an array over all Gaussians, in the order of
//! [`Plane`]: kernels load eight neighbors in one step, and optimizers treat all planes alike.

use cad_transforms::RigidTransform;
use nalgebra::Quaternion;

use crate::error::GaussianError;

/// Largest degree of the spherical harmonics.
pub const MAX_DEGREE: usize = 3;

/// Smallest squared norm of a rotation. Below it the direction of the quaternion is noise.
const MIN_SQUARED_NORM: f32 = 1e-12;

/// Number of coefficients of spherical harmonics per color channel: 1, 4, 9, 16.
pub const fn coefficients(degree: usize) -> usize {
    (degree + 1) * (degree + 1)
}

/// Indices of the planes of [`Splats`].
pub struct Plane;

impl Plane {
    /// First of three planes: the mean in the world, m.
    pub const POSITION: usize = 0;
    /// First of three planes: natural logarithms of the standard deviations along the axes, m.
    pub const SCALE: usize = 3;
    /// First of four planes: the rotation `w x y z`, `world_from_axes`, of any length.
    pub const ROTATION: usize = 6;
    /// The opacity's logit: opacity is `1 / (1 + exp(-logit))`.
    pub const OPACITY: usize = 10;
    /// First of `3 (degree + 1)²` planes: spherical harmonics, red, green and blue of a coefficient
    /// beside each other.
    pub const HARMONICS: usize = 11;

    /// Number of planes.
    pub const fn count(degree: usize) -> usize {
        Self::HARMONICS + 3 * coefficients(degree)
    }
}

/// Gaussians, as planes of parameters.
///
/// ```
/// use gaussians::{Plane, Splat, Splats};
///
/// let mut splats = Splats::empty(1)?;
/// splats.push(&Splat { position_m: [0.0, 0.0, 2.0], ..Splat::sphere(0.1, [1.0, 0.5, 0.0]) })?;
/// assert_eq!((splats.len(), splats.planes().len()), (1, 23));
/// assert_eq!(splats.planes()[Plane::POSITION + 2], [2.0]);
///
/// let broken = Splat { position_m: [f32::NAN, 0.0, 0.0], ..Splat::sphere(0.1, [0.5; 3]) };
/// assert!(splats.push(&broken).is_err());
/// # Ok::<(), gaussians::GaussianError>(())
/// ```
#[derive(Clone, Debug, PartialEq)]
pub struct Splats {
    degree: usize,
    planes: Vec<Vec<f32>>,
}

/// One Gaussian.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Splat {
    /// Mean in the world, m.
    pub position_m: [f32; 3],
    /// Natural logarithms of the standard deviations along the axes, m.
    pub log_scale: [f32; 3],
    /// `world_from_axes`, `w x y z`, of any length but zero.
    pub rotation_wxyz: [f32; 4],
    /// Logit of the opacity.
    pub opacity_logit: f32,
    /// Coefficients of the spherical harmonics, red, green and blue. Those beyond the degree of the
    /// [`Splats`] are ignored.
    pub harmonics: [[f32; 3]; coefficients(MAX_DEGREE)],
}

impl Splat {
    /// A sphere at the origin with a standard deviation in m, one color (0 to 1) from all sides and
    /// an opacity of a half.
    pub fn sphere(sigma_m: f32, color: [f32; 3]) -> Self {
        let mut harmonics = [[0.0; 3]; coefficients(MAX_DEGREE)];
        harmonics[0] = color.map(crate::harmonics::from_color);
        Self {
            position_m: [0.0; 3],
            log_scale: [libm::logf(sigma_m); 3],
            rotation_wxyz: [1.0, 0.0, 0.0, 0.0],
            opacity_logit: 0.0,
            harmonics,
        }
    }
}

impl Splats {
    /// No Gaussians.
    ///
    /// # Errors
    /// [`GaussianError::Degree`] above [`MAX_DEGREE`].
    pub fn empty(degree: usize) -> Result<Self, GaussianError> {
        if degree > MAX_DEGREE {
            return Err(GaussianError::Degree { found: degree });
        }
        Ok(Self {
            degree,
            planes: vec![Vec::new(); Plane::count(degree)],
        })
    }

    /// From planes in the order of [`Plane`].
    ///
    /// # Errors
    /// [`GaussianError::Degree`], [`GaussianError::Planes`] if their number or lengths are wrong,
    /// [`GaussianError::NotFinite`], [`GaussianError::ZeroRotation`].
    pub fn from_planes(degree: usize, planes: Vec<Vec<f32>>) -> Result<Self, GaussianError> {
        if degree > MAX_DEGREE {
            return Err(GaussianError::Degree { found: degree });
        }
        let count = planes.first().map_or(0, Vec::len);
        let expected = Plane::count(degree);
        if planes.len() != expected || planes.iter().any(|plane| plane.len() != count) {
            let lengths = planes.iter().map(Vec::len).collect();
            return Err(GaussianError::Planes { lengths, expected });
        }
        let splats = Self { degree, planes };
        splats.check()?;
        Ok(splats)
    }

    /// Appends a Gaussian.
    ///
    /// # Errors
    /// [`GaussianError::NotFinite`], [`GaussianError::ZeroRotation`]; nothing is appended then.
    pub fn push(&mut self, splat: &Splat) -> Result<(), GaussianError> {
        let row = self.row(splat);
        check_row(self.len(), &row)?;
        for (plane, value) in self.planes.iter_mut().zip(row) {
            plane.push(value);
        }
        Ok(())
    }

    /// The Gaussian at an index.
    ///
    /// # Panics
    /// If the index is not below [`Self::len`].
    pub fn get(&self, index: usize) -> Splat {
        let at = |plane: usize| self.planes[plane][index];
        let mut harmonics = [[0.0; 3]; coefficients(MAX_DEGREE)];
        for (k, rgb) in harmonics
            .iter_mut()
            .take(coefficients(self.degree))
            .enumerate()
        {
            *rgb = std::array::from_fn(|c| at(Plane::HARMONICS + 3 * k + c));
        }
        Splat {
            position_m: std::array::from_fn(|i| at(Plane::POSITION + i)),
            log_scale: std::array::from_fn(|i| at(Plane::SCALE + i)),
            rotation_wxyz: std::array::from_fn(|i| at(Plane::ROTATION + i)),
            opacity_logit: at(Plane::OPACITY),
            harmonics,
        }
    }

    /// Largest scale of a Gaussian, m.
    ///
    /// # Panics
    /// If the index is not below [`Self::len`].
    pub fn largest_scale_m(&self, index: usize) -> f32 {
        let scales = &self.planes[Plane::SCALE..Plane::SCALE + 3];
        let logs = scales.iter().map(|plane| plane[index]);
        libm::expf(logs.fold(f32::NEG_INFINITY, f32::max))
    }

    /// Number of Gaussians.
    pub fn len(&self) -> usize {
        self.planes[0].len()
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Degree of the spherical harmonics, 0 to [`MAX_DEGREE`].
    pub fn degree(&self) -> usize {
        self.degree
    }

    /// The planes, in the order of [`Plane`].
    pub fn planes(&self) -> &[Vec<f32>] {
        &self.planes
    }

    /// The same Gaussians with another degree: coefficients are appended as zeros or dropped.
    ///
    /// # Errors
    /// [`GaussianError::Degree`] above [`MAX_DEGREE`].
    pub fn with_degree(mut self, degree: usize) -> Result<Self, GaussianError> {
        if degree > MAX_DEGREE {
            return Err(GaussianError::Degree { found: degree });
        }
        let count = self.len();
        self.planes.resize(Plane::count(degree), vec![0.0; count]);
        self.degree = degree;
        Ok(self)
    }

    /// A selection of Gaussians, in the given order; an index may repeat.
    ///
    /// # Panics
    /// If an index is not below [`Self::len`].
    #[must_use]
    pub fn select(&self, indices: &[u32]) -> Self {
        let pick = |plane: &Vec<f32>| indices.iter().map(|i| plane[*i as usize]).collect();
        Self {
            degree: self.degree,
            planes: self.planes.iter().map(pick).collect(),
        }
    }

    /// The same Gaussians in another frame: positions, rotations and harmonics.
    ///
    /// A band of harmonics of degree l is closed under rotations: its coefficients are multiplied
    /// with a matrix of `(2 l + 1)²` entries, which follows from the values of the band in `2 l +
    /// 1` directions before and after the rotation.
    #[must_use]
    pub fn transformed(&self, b_from_a: &RigidTransform) -> Self {
        let mut out = self.clone();
        let turn = b_from_a.rotation();
        for i in 0..self.len() {
            let splat = self.get(i);
            let position = b_from_a.apply(splat.position_m.map(f64::from));
            let [w, x, y, z] = splat.rotation_wxyz.map(f64::from);
            let rotation = turn.quaternion() * Quaternion::new(w, x, y, z);
            let rotation = [rotation.w, rotation.i, rotation.j, rotation.k];
            for (plane, value) in out.planes.iter_mut().zip(position) {
                plane[i] = value as f32;
            }
            for (plane, value) in out.planes[Plane::ROTATION..].iter_mut().zip(rotation) {
                plane[i] = value as f32;
            }
        }
        for degree in 1..=self.degree {
            let matrix = crate::harmonics::rotation_of_band(degree, turn);
            let first = Plane::HARMONICS + 3 * degree * degree;
            for (row, column, c) in (0..matrix.nrows()).flat_map(|row| {
                (0..matrix.ncols()).flat_map(move |column| (0..3).map(move |c| (row, column, c)))
            }) {
                let factor = matrix[(row, column)] as f32;
                let to = &mut out.planes[first + 3 * row + c];
                if column == 0 {
                    to.fill(0.0);
                }
                for (to, from) in to.iter_mut().zip(&self.planes[first + 3 * column + c]) {
                    *to += factor * from;
                }
            }
        }
        out
    }

    /// The planes, for optimizers, which keep the contract: no value may become infinite or NaN, no
    /// rotation zero, and all planes keep their length.
    pub fn planes_mut(&mut self) -> &mut [Vec<f32>] {
        &mut self.planes
    }

    fn row(&self, splat: &Splat) -> Vec<f32> {
        let mut row = Vec::with_capacity(self.planes.len());
        row.extend(splat.position_m);
        row.extend(splat.log_scale);
        row.extend(splat.rotation_wxyz);
        row.push(splat.opacity_logit);
        row.extend(splat.harmonics[..coefficients(self.degree)].as_flattened());
        row
    }

    fn check(&self) -> Result<(), GaussianError> {
        let finite = |plane: &Vec<f32>| plane.iter().all(|value| value.is_finite());
        let rotations = &self.planes[Plane::ROTATION..Plane::ROTATION + 4];
        let norm = |i: usize| {
            rotations
                .iter()
                .map(|plane| plane[i] * plane[i])
                .sum::<f32>()
        };
        let valid = self.planes.iter().all(finite)
            && (0..self.len()).all(|i| norm(i) >= MIN_SQUARED_NORM && norm(i).is_finite());
        if valid {
            return Ok(());
        }
        // The slow search for the first invalid value, for the message.
        for index in 0..self.len() {
            let row: Vec<f32> = self.planes.iter().map(|plane| plane[index]).collect();
            check_row(index, &row)?;
        }
        Ok(())
    }
}

/// Checks the parameters of the Gaussian with this index.
fn check_row(index: usize, row: &[f32]) -> Result<(), GaussianError> {
    if let Some(plane) = row.iter().position(|value| !value.is_finite()) {
        let parameter = plane_name(plane);
        return Err(GaussianError::NotFinite { index, parameter });
    }
    let rotation = &row[Plane::ROTATION..Plane::ROTATION + 4];
    let norm: f32 = rotation.iter().map(|value| value * value).sum();
    if !(norm >= MIN_SQUARED_NORM && norm.is_finite()) {
        return Err(GaussianError::ZeroRotation { index });
    }
    Ok(())
}

fn plane_name(plane: usize) -> &'static str {
    match plane {
        0..Plane::SCALE => "position",
        Plane::SCALE..Plane::ROTATION => "scale",
        Plane::ROTATION..Plane::OPACITY => "rotation",
        Plane::OPACITY => "opacity",
        _ => "spherical harmonics",
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn invalid_parameters_are_refused_with_index_and_name() {
        let mut splats = Splats::empty(0).unwrap();
        splats.push(&Splat::sphere(1.0, [0.5; 3])).unwrap();
        let mut cases = vec![("opacity", Splat::sphere(1.0, [0.5; 3])); 1];
        cases[0].1.opacity_logit = f32::INFINITY;
        cases.push(("scale", Splat::sphere(f32::NAN, [0.5; 3])));
        cases.push(("spherical harmonics", Splat::sphere(1.0, [f32::NAN; 3])));
        for (name, splat) in cases {
            let error = splats.push(&splat).unwrap_err();
            assert_eq!(
                error,
                GaussianError::NotFinite {
                    index: 1,
                    parameter: name
                },
            );
        }
        let mut none = Splat::sphere(1.0, [0.5; 3]);
        none.rotation_wxyz = [0.0; 4];
        assert_eq!(
            splats.push(&none),
            Err(GaussianError::ZeroRotation { index: 1 })
        );
        assert_eq!(splats.len(), 1);

        let mut planes = splats.planes().to_vec();
        planes[4][0] = f32::NAN;
        let error = Splats::from_planes(0, planes.clone()).unwrap_err();
        assert!(error.to_string().contains("scale of Gaussian 0"), "{error}");
        planes.pop();
        let error = Splats::from_planes(0, planes).unwrap_err();
        assert!(matches!(error, GaussianError::Planes { expected: 14, .. }));
        assert!(matches!(
            Splats::empty(4),
            Err(GaussianError::Degree { found: 4 })
        ));
    }

    #[test]
    fn degree_and_selection_keep_the_other_parameters() {
        let mut splats = Splats::empty(2).unwrap();
        for i in 0..3 {
            let mut splat = Splat::sphere(0.1, [0.2, 0.4, 0.6]);
            splat.position_m[0] = i as f32;
            splat.harmonics[8] = [1.0, 2.0, 3.0];
            splats.push(&splat).unwrap();
        }
        let back = splats.clone().with_degree(3).unwrap();
        assert_eq!(back.get(1).harmonics[8], [1.0, 2.0, 3.0]);
        assert_eq!(back.get(1).harmonics[15], [0.0; 3]);
        assert_eq!(back.with_degree(2).unwrap(), splats);
        let selected = splats.select(&[2, 0]);
        assert_eq!(selected.planes()[0], [2.0, 0.0]);
    }
}
