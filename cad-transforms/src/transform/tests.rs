use std::f64::consts::{FRAC_1_SQRT_2, FRAC_PI_2, PI};

use super::*;

/// A rotation of 90° to the left about z, then a translation of (1, 2, 3).
fn quarter_turn() -> RigidTransform {
    RigidTransform::from_wxyz([FRAC_1_SQRT_2, 0.0, 0.0, FRAC_1_SQRT_2], [1.0, 2.0, 3.0]).unwrap()
}

fn tilted() -> RigidTransform {
    RigidTransform::from_rotation_vector([0.3, -1.1, 0.7], [-0.4, 0.05, 2.5]).unwrap()
}

fn assert_close(found: [f64; 3], expected: [f64; 3]) {
    for (f, e) in found.iter().zip(expected) {
        assert!(
            (f - e).abs() < 1e-14,
            "found {found:?}, expected {expected:?}"
        );
    }
}

#[test]
fn a_known_turn_and_step() {
    let b_from_a = quarter_turn();
    assert_close(b_from_a.apply([1.0, 0.0, 0.0]), [1.0, 3.0, 3.0]);
    assert_close(b_from_a.rotate([1.0, 0.0, 0.0]), [0.0, 1.0, 0.0]);
    assert!((b_from_a.angle_rad() - FRAC_PI_2).abs() < 1e-15);
    assert_close(b_from_a.rotation_vector(), [0.0, 0.0, FRAC_PI_2]);
}

#[test]
fn chains_read_right_to_left() {
    let (b_from_a, c_from_b) = (quarter_turn(), tilted());
    let x_in_a = [0.2, -0.7, 1.9];
    assert_close(
        (c_from_b * b_from_a).apply(x_in_a),
        c_from_b.apply(b_from_a.apply(x_in_a)),
    );
}

#[test]
fn inverse_undoes() {
    let b_from_a = tilted();
    let a_from_a = b_from_a.inverse() * b_from_a;
    assert!(a_from_a.angle_rad() < 1e-15 && a_from_a.distance_m() < 1e-15);
    assert_close(
        b_from_a.inverse().apply(b_from_a.apply([3.0, 1.0, -2.0])),
        [3.0, 1.0, -2.0],
    );
}

#[test]
fn matrices_and_quaternions_agree() {
    let b_from_a = tilted();
    let again =
        RigidTransform::from_rotation_rows(b_from_a.rotation_rows(), b_from_a.translation_m())
            .unwrap();
    assert!((again.inverse() * b_from_a).angle_rad() < 1e-15);

    let r = b_from_a.rotation_rows();
    let t = b_from_a.translation_m();
    let rows = [
        r[0], r[1], r[2], t[0], r[3], r[4], r[5], t[1], r[6], r[7], r[8], t[2], 0.0, 0.0, 0.0, 1.0,
    ];
    assert_eq!(RigidTransform::from_rows_4x4(rows).unwrap(), again);
    // Rows first: the matrix takes x to its first column plus the translation.
    assert_close(
        again.apply([1.0, 0.0, 0.0]),
        [r[0] + t[0], r[3] + t[1], r[6] + t[2]],
    );
}

#[test]
fn a_half_turn_survives_the_matrix() {
    for axis in [[PI, 0.0, 0.0], [0.0, PI, 0.0], [0.0, 0.0, PI]] {
        let b_from_a = RigidTransform::from_rotation_vector(axis, [0.0; 3]).unwrap();
        let again = RigidTransform::from_rotation_rows(b_from_a.rotation_rows(), [0.0; 3]).unwrap();
        assert!((again.inverse() * b_from_a).angle_rad() < 1e-14);
    }
}

#[test]
fn stored_form_is_stable_to_the_bit() {
    let b_from_a = tilted() * quarter_turn();
    let once =
        RigidTransform::from_wxyz(b_from_a.rotation_wxyz(), b_from_a.translation_m()).unwrap();
    assert_eq!(once.rotation_wxyz(), b_from_a.rotation_wxyz());
    // One rotation, one spelling.
    let [w, x, y, z] = b_from_a.rotation_wxyz();
    let flipped = RigidTransform::from_wxyz([-w, -x, -y, -z], b_from_a.translation_m()).unwrap();
    assert_eq!(flipped.rotation_wxyz(), b_from_a.rotation_wxyz());
}

#[test]
fn six_digits_are_enough_and_are_brought_to_a_rotation() {
    let rounded = tilted().rotation_rows().map(|v| (v * 1e6).round() / 1e6);
    let b_from_a = RigidTransform::from_rotation_rows(rounded, [0.0; 3]).unwrap();
    assert!((b_from_a.inverse() * tilted()).angle_rad() < 2e-6);
    let norm: f64 = b_from_a.rotation_wxyz().iter().map(|v| v * v).sum();
    assert!((norm - 1.0).abs() <= 4.0 * f64::EPSILON);
}

#[test]
fn refuses_what_is_not_rigid() {
    let t = [0.0; 3];
    assert!(matches!(
        RigidTransform::from_wxyz([0.9, 0.0, 0.0, 0.0], t),
        Err(TransformError::NotUnit { norm }) if norm == 0.9
    ));
    assert_eq!(
        RigidTransform::from_wxyz([f64::NAN, 0.0, 0.0, 1.0], t),
        Err(TransformError::NotFinite)
    );
    assert_eq!(
        RigidTransform::from_translation_m([0.0, f64::INFINITY, 0.0]),
        Err(TransformError::NotFinite)
    );
    assert!(matches!(
        RigidTransform::from_rotation_rows([1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, -1.0], t),
        Err(TransformError::LeftHanded { .. })
    ));
    assert!(matches!(
        RigidTransform::from_rotation_rows([1.001, 0.0, 0.0, 0.0, 1.001, 0.0, 0.0, 0.0, 1.001], t),
        Err(TransformError::NotOrthonormal { .. })
    ));
    for huge in [1e200, f64::INFINITY, f64::NAN] {
        assert_eq!(
            RigidTransform::from_rotation_vector([huge, 0.0, 0.0], t),
            Err(TransformError::NotFinite)
        );
    }
    // Stored column by column, the translation lands in the last row.
    let mut columns_first = [0.0; 16];
    for i in 0..4 {
        columns_first[5 * i] = 1.0;
    }
    columns_first[12] = 0.5;
    assert!(matches!(
        RigidTransform::from_rows_4x4(columns_first),
        Err(TransformError::LastRow {
            found: [0.5, 0.0, 0.0, 1.0]
        })
    ));
}
