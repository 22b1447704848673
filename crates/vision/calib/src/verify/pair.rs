//! The lenses and the relative pose of a stereo camera, with the unknowns of its calibration.
//!
//! With the right eye rotated by a small `w` about its own centre, and that centre displaced by `d`
//! normal to the baseline, `x_in_right = exp(w) (R x_in_left + t + d)`. The projection then differs
//! from the nominal one by the difference between the two lenses: focal length, radial distortion
//! and decentering, linear in their parameters (Brown 1966). It has separate parameters across
//! epipolar lines and along them, because what real rectified images deviate by in rows does not
//! tell what they deviate by in disparity. The length of the baseline is not an unknown: without a
//! known distance it is not observable.

use cad_transforms::so3;
use camera_models::{Lens, StereoCalibration};
use nalgebra::{
    Matrix2x4, Matrix3x2, RowSVector, RowVector2, SMatrix, SVector, UnitQuaternion, Vector2,
    Vector3,
};

/// Rotation, displacement, differences of the lenses across and along epipolar lines.
pub(super) const STEREO_PARAMETERS: usize = 13;
/// First parameters of the differences of the lenses.
const ACROSS: usize = 5;
const ALONG: usize = 9;

/// Largest tangent of the angle from the axis at which differences of the lenses are evaluated.
const MAX_TANGENT: f64 = 2.5;

/// See the module.
#[derive(Clone, Debug)]
pub(super) struct StereoPair {
    lenses: [Lens; 2],
    nominal_turn: UnitQuaternion<f64>,
    nominal_origin: Vector3<f64>,
    /// Two directions normal to the baseline.
    across: Matrix3x2<f64>,
    unknowns: SVector<f64, STEREO_PARAMETERS>,
    turn: UnitQuaternion<f64>,
    origin: Vector3<f64>,
}

/// A triangulated match.
pub(super) struct TriangulatedMatch {
    /// Inverse distance along the left ray, 1/m.
    pub(super) per_metre: f64,
    /// Its derivative with respect to the unknowns.
    pub(super) per_metre_by: RowSVector<f64, STEREO_PARAMETERS>,
    /// Motion of the right pixel with the inverse distance, px m.
    pub(super) px_per: f64,
    /// Epipolar error, px, and the Jacobian of its prediction with respect to the unknowns.
    pub(super) epipolar_error: f64,
    pub(super) epipolar_by: RowSVector<f64, STEREO_PARAMETERS>,
}

impl StereoPair {
    pub(super) fn new(nominal: &StereoCalibration) -> Self {
        let [turn, origin] = [
            so3::log(nominal.right_from_left.rotation()),
            *nominal.right_from_left.translation(),
        ];
        let along = origin.normalize();
        let first = along.cross(&Vector3::y()).try_normalize(1e-3);
        let first = first.unwrap_or_else(|| along.cross(&Vector3::z()).normalize());
        Self {
            lenses: [Lens::new(&nominal.left), Lens::new(&nominal.right)],
            nominal_turn: so3::exp(turn),
            nominal_origin: origin,
            across: Matrix3x2::from_columns(&[first, along.cross(&first)]),
            unknowns: SVector::zeros(),
            turn: so3::exp(turn),
            origin,
        }
    }

    pub(super) fn baseline_m(&self) -> f64 {
        self.origin.norm()
    }

    pub(super) fn left(&self) -> &Lens {
        &self.lenses[0]
    }

    /// Deviations from the nominal calibration: rotation `w`, rad; displacement `d`, m; focal
    /// length (relative), `k1`, `p1`, `p2` of the right lens minus those of the left one, across
    /// and along epipolar lines.
    pub(super) fn unknowns(&self) -> &SVector<f64, STEREO_PARAMETERS> {
        &self.unknowns
    }

    pub(super) fn set(&mut self, unknowns: &SVector<f64, STEREO_PARAMETERS>) {
        let turn = so3::exp(unknowns.fixed_rows::<3>(0).into_owned());
        let displaced = self.across * unknowns.fixed_rows::<2>(3);
        self.unknowns = *unknowns;
        self.turn = turn * self.nominal_turn;
        self.origin = turn * (self.nominal_origin + displaced);
    }

    /// Rotation of the right eye that adds `per_metre` to the inverse distance of all points on the
    /// axis.
    pub(super) fn rotation_of_offset(&self, per_metre: f64) -> Vector3<f64> {
        self.origin.cross(&Vector3::z()) * per_metre
    }

    /// The point on the left ray whose projection is nearest to the right pixel.
    pub(super) fn triangulate(
        &self,
        ray: &Vector3<f64>,
        right: [f64; 2],
    ) -> Option<TriangulatedMatch> {
        let far = self.turn * ray;
        let across_lens = self.unknowns.fixed_rows::<4>(ACROSS);
        let along_lens = self.unknowns.fixed_rows::<4>(ALONG);
        let mut per_metre = 0.3;
        for round in 0.. {
            let point = far + self.origin * per_metre;
            let projected = self.lenses[1].project_with_jacobians(point.into())?;
            let by_lens = self.by_lens(&point);
            let along = projected.by_point * self.origin;
            let px_per = along.norm();
            if px_per < 1e-9 {
                return None;
            }
            let along = along / px_per;
            let off = Vector2::from(right) - Vector2::from(projected.pixel);
            let step = along.dot(&(off - by_lens * along_lens)) / px_per;
            if round == 6 || step.abs() < 1e-7 {
                let by_center = (self.turn * self.nominal_turn.inverse()).to_rotation_matrix()
                    * self.across
                    * per_metre;
                let mut by = SMatrix::<f64, 2, STEREO_PARAMETERS>::zeros();
                by.fixed_columns_mut::<3>(0)
                    .copy_from(&(-projected.by_point * point.cross_matrix()));
                by.fixed_columns_mut::<2>(3)
                    .copy_from(&(projected.by_point * by_center));
                let across = RowVector2::new(-along.y, along.x);
                let mut epipolar_by = across * by;
                let mut along_by = along.transpose() * by;
                epipolar_by
                    .fixed_columns_mut::<4>(ACROSS)
                    .copy_from(&(across * by_lens));
                along_by
                    .fixed_columns_mut::<4>(ALONG)
                    .copy_from(&(along.transpose() * by_lens));
                return Some(TriangulatedMatch {
                    per_metre,
                    per_metre_by: along_by * (-1.0 / px_per),
                    px_per,
                    epipolar_error: (across * (off - by_lens * across_lens))[0],
                    epipolar_by,
                });
            }
            per_metre += step;
        }
        None
    }

    /// Motion of a right pixel with the differences of the lenses, px.
    fn by_lens(&self, point: &Vector3<f64>) -> Matrix2x4<f64> {
        let model = self.lenses[1].model();
        let aside = point.xy().norm().max(1e-12);
        let tangent = if point.z * MAX_TANGENT > aside {
            aside / point.z
        } else {
            MAX_TANGENT
        };
        let (x, y) = (point.x / aside * tangent, point.y / aside * tangent);
        let square = tangent * tangent;
        Matrix2x4::new(
            model.fx * x,
            model.fx * x * square,
            model.fx * 2.0 * x * y,
            model.fx * (square + 2.0 * x * x),
            model.fy * y,
            model.fy * y * square,
            model.fy * (square + 2.0 * y * y),
            model.fy * 2.0 * x * y,
        )
    }
}
