//! The arrays of a `foxglove.CameraCalibration` (and of ROS `sensor_msgs/CameraInfo`), without the
//! message itself.
//!
//! Contract: the arrays describe the images as delivered. Rectification is not computed here: for
//! images that are not rectified, `r` is the identity and `p` repeats the camera matrix, and the
//! extrinsics of the right camera are in its transform only. Only a pair that is already rectified
//! has its baseline in `p`.

use crate::camera::{CameraModel, Distortion};
use crate::stereo::{Eye, StereoCalibration};

/// One camera's calibration as plain arrays, matrices row-major.
#[derive(Clone, Debug, PartialEq)]
pub struct CameraInfo {
    /// Image width, pixels.
    pub width: u32,
    /// Image height, pixels.
    pub height: u32,
    /// `plumb_bob`, `rational_polynomial`, `kannala_brandt`, `double_sphere`, `eucm`, or empty for
    /// none.
    pub distortion_model: &'static str,
    /// Coefficients: 5, 8, 4, 2 or 2 by model, none without one.
    pub d: Vec<f64>,
    /// Camera matrix, 3x3.
    pub k: [f64; 9],
    /// Rectification, 3x3: the identity.
    pub r: [f64; 9],
    /// Projection, 3x4. Of a rectified right camera, entry 3 is `-fx` times the baseline in metres.
    pub p: [f64; 12],
}

impl CameraInfo {
    /// One eye of a stereo camera.
    ///
    /// ```
    /// use cad_transforms::RigidTransform;
    /// use camera_models::{CameraInfo, CameraModel, Distortion, Eye, StereoCalibration};
    /// # use camera_models::Provenance;
    ///
    /// let model = CameraModel::new((640, 480), [500.0, 500.0, 319.5, 239.5], Distortion::None);
    /// let stereo = StereoCalibration {
    ///     left: model,
    ///     right: model,
    ///     right_from_left: RigidTransform::from_translation_m([-0.063, 0.0, 0.0])?,
    ///     imu: None,
    /// #     provenance: Provenance { format: None, files: Vec::new(), part: None },
    /// };
    /// let right = CameraInfo::of(&stereo, Eye::Right);
    /// assert_eq!(right.k, [500.0, 0.0, 319.5, 0.0, 500.0, 239.5, 0.0, 0.0, 1.0]);
    /// assert!((right.p[3] + 500.0 * 0.063).abs() < 1e-9);
    /// assert_eq!(CameraInfo::of(&stereo, Eye::Left).p[3], 0.0);
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
    pub fn of(stereo: &StereoCalibration, eye: Eye) -> Self {
        let camera = stereo.eye(eye);
        let (distortion_model, d) = match camera.distortion {
            Distortion::None => ("", Vec::new()),
            // plumb_bob always has five.
            Distortion::Radial2 { k1, k2 } => ("plumb_bob", vec![k1, k2, 0.0, 0.0, 0.0]),
            Distortion::RadTan4 { k1, k2, p1, p2 } => ("plumb_bob", vec![k1, k2, p1, p2, 0.0]),
            Distortion::RadTan5 { .. } => ("plumb_bob", camera.distortion.coefficients()),
            Distortion::Rational8 { .. } => {
                ("rational_polynomial", camera.distortion.coefficients())
            }
            Distortion::KannalaBrandt4 { .. } => {
                ("kannala_brandt", camera.distortion.coefficients())
            }
            // Not among the names fixed by ROS; readers that do not know them can report it.
            Distortion::DoubleSphere { .. } => ("double_sphere", camera.distortion.coefficients()),
            Distortion::Eucm { .. } => ("eucm", camera.distortion.coefficients()),
        };
        let tx = match eye {
            Eye::Right if stereo.is_rectified() => {
                camera.fx * stereo.right_from_left.translation_m()[0]
            }
            _ => 0.0,
        };
        let (fx, fy, cx, cy) = (camera.fx, camera.fy, camera.cx, camera.cy);
        Self {
            width: camera.width,
            height: camera.height,
            distortion_model,
            d,
            k: camera.k_matrix(),
            r: [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0],
            p: [fx, 0.0, cx, tx, 0.0, fy, cy, 0.0, 0.0, 0.0, 1.0, 0.0],
        }
    }
}

/// The lens of such arrays: image size, model name, coefficients, camera matrix. Missing
/// coefficients are 0. `None` for an unknown model and for an invalid matrix.
pub fn lens(
    [width, height]: [u32; 2],
    distortion_model: &str,
    d: &[f64],
    k: &[f64],
) -> Option<CameraModel> {
    let d = |i: usize| d.get(i).copied().unwrap_or(0.0);
    let distortion = match distortion_model {
        "" => Distortion::None,
        "plumb_bob" => Distortion::RadTan5 {
            k1: d(0),
            k2: d(1),
            p1: d(2),
            p2: d(3),
            k3: d(4),
        },
        "rational_polynomial" => Distortion::Rational8 {
            k1: d(0),
            k2: d(1),
            p1: d(2),
            p2: d(3),
            k3: d(4),
            k4: d(5),
            k5: d(6),
            k6: d(7),
        },
        "kannala_brandt" => Distortion::KannalaBrandt4 {
            k1: d(0),
            k2: d(1),
            k3: d(2),
            k4: d(3),
        },
        "double_sphere" => Distortion::DoubleSphere {
            xi: d(0),
            alpha: d(1),
        },
        "eucm" => Distortion::Eucm {
            alpha: d(0),
            beta: d(1),
        },
        _ => return None,
    };
    let [fx, _, cx, _, fy, cy, ..] = *k else {
        return None;
    };
    Some(CameraModel {
        width,
        height,
        fx,
        fy,
        cx,
        cy,
        distortion,
    })
}

#[cfg(test)]
mod tests {
    use cad_transforms::RigidTransform;

    use super::*;
    use crate::camera::CameraModel;
    use crate::stereo::Provenance;

    fn stereo(distortion: Distortion, right_from_left: RigidTransform) -> StereoCalibration {
        let left = CameraModel {
            width: 640,
            height: 480,
            fx: 500.0,
            fy: 501.0,
            cx: 320.0,
            cy: 240.0,
            distortion,
        };
        StereoCalibration {
            left,
            right: CameraModel { cx: 330.0, ..left },
            right_from_left,
            imu: None,
            provenance: Provenance {
                format: None,
                files: Vec::new(),
                part: None,
            },
        }
    }

    #[test]
    fn a_rectified_pair_carries_its_baseline() {
        let right_from_left = RigidTransform::from_translation_m([-0.12, 0.0, 0.0]).unwrap();
        let stereo = stereo(Distortion::None, right_from_left);
        let left = CameraInfo::of(&stereo, Eye::Left);
        let right = CameraInfo::of(&stereo, Eye::Right);
        assert_eq!((left.distortion_model, left.d.len()), ("", 0));
        assert_eq!(
            left.p,
            [
                500.0, 0.0, 320.0, 0.0, 0.0, 501.0, 240.0, 0.0, 0.0, 0.0, 1.0, 0.0
            ]
        );
        assert_eq!(
            right.p,
            [
                500.0, 0.0, 330.0, -60.0, 0.0, 501.0, 240.0, 0.0, 0.0, 0.0, 1.0, 0.0
            ]
        );
        assert_eq!(
            right.k,
            [500.0, 0.0, 330.0, 0.0, 501.0, 240.0, 0.0, 0.0, 1.0]
        );
        assert_eq!(right.r, [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]);
    }

    #[test]
    fn an_unrectified_pair_does_not() {
        let rotated =
            RigidTransform::from_rotation_vector([0.0, 0.01, 0.0], [-0.12, 0.0, 0.0]).unwrap();
        assert_eq!(
            CameraInfo::of(&stereo(Distortion::None, rotated), Eye::Right).p[3],
            0.0
        );
        let straight = RigidTransform::from_translation_m([-0.12, 0.0, 0.0]).unwrap();
        let radtan = Distortion::RadTan4 {
            k1: 0.1,
            k2: 0.2,
            p1: 0.3,
            p2: 0.4,
        };
        assert_eq!(
            CameraInfo::of(&stereo(radtan, straight), Eye::Right).p[3],
            0.0
        );
    }

    #[test]
    fn models_have_their_names_and_lengths() {
        let straight = RigidTransform::from_translation_m([-0.12, 0.0, 0.0]).unwrap();
        let check = |distortion, name: &str, d: &[f64]| {
            let stereo = stereo(distortion, straight);
            let info = CameraInfo::of(&stereo, Eye::Left);
            assert_eq!((info.distortion_model, info.d.as_slice()), (name, d));
            // The inverse, except that four coefficients of a plumb bob have become five.
            let back = lens([info.width, info.height], name, d, &info.k).unwrap();
            match distortion {
                Distortion::RadTan4 { k1, k2, p1, p2 } => {
                    let five = Distortion::RadTan5 {
                        k1,
                        k2,
                        p1,
                        p2,
                        k3: 0.0,
                    };
                    assert_eq!(
                        back,
                        CameraModel {
                            distortion: five,
                            ..stereo.left
                        }
                    );
                }
                _ => assert_eq!(back, stereo.left),
            }
            assert_eq!(lens([640, 480], "fisheye", d, &info.k), None);
            assert_eq!(lens([640, 480], name, d, &info.k[..4]), None);
        };
        check(Distortion::None, "", &[]);
        let (xi, alpha, beta) = (0.1, 0.5, 1.1);
        check(
            Distortion::DoubleSphere { xi, alpha },
            "double_sphere",
            &[0.1, 0.5],
        );
        check(Distortion::Eucm { alpha, beta }, "eucm", &[0.5, 1.1]);
        let (k1, k2, p1, p2, k3, k4, k5, k6) = (1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0);
        check(
            Distortion::RadTan4 { k1, k2, p1, p2 },
            "plumb_bob",
            &[1.0, 2.0, 3.0, 4.0, 0.0],
        );
        check(
            Distortion::RadTan5 { k1, k2, p1, p2, k3 },
            "plumb_bob",
            &[1.0, 2.0, 3.0, 4.0, 5.0],
        );
        check(
            Distortion::Rational8 {
                k1,
                k2,
                p1,
                p2,
                k3,
                k4,
                k5,
                k6,
            },
            "rational_polynomial",
            &[1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0],
        );
        check(
            Distortion::KannalaBrandt4 { k1, k2, k3, k4 },
            "kannala_brandt",
            &[1.0, 2.0, 5.0, 6.0],
        );
    }
}
