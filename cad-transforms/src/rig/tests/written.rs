//! The optional keys, rigs made by programs, and writing.

use super::*;
use crate::output::Existing;

/// Two cameras with all that a file may hold; the rotation of the loop can be given an error.
fn full(loop_turn_deg: f64) -> String {
    let half = (0.5 * loop_turn_deg).to_radians();
    format!(
        "format = 1\nname = \"a \\\"plate\\\"\"\nrevision = \"C\"\n\
         [provenance]\nkind = \"cad\"\nnote = \"drawing 3\"\ncad_file = \"plate.step\"\ncad_blake3 = \"{}\"\n\
         [[camera]]\nname = \"a\"\nserial = 12345678\nmodel = \"ZED Mini\"\n\
         [[camera]]\nname = \"b\"\nserial = \"SN-7\"\n\
         [[parent_from_child]]\nparent = \"rig\"\nchild = \"a/left\"\nrotation_wxyz = [0.5, -0.5, 0.5, -0.5]\n\
         translation_m = [0.1, 0.2, 0.3]\nsigma_translation_mm = 0.2\nsigma_rotation_deg = [0.1, 0.2, 0.3]\n\
         [[parent_from_child]]\nparent = \"b/left\"\nchild = \"rig\"\nrotation_rows = [[0, -1, 0], [0, 0, -1], [1, 0, 0]]\n\
         translation_m = [0, 0.1, -0.2]\nsigma_translation_m = [1e-3, 2e-3, 3e-3]\nsigma_rotation_rad = 0.01\n\
         [[parent_from_child]]\nparent = \"a/left\"\nchild = \"a/right\"\n{PLAIN}\n\
         [[closes_loop]]\nparent = \"a/right\"\nchild = \"a/left\"\nrotation_wxyz = [{:?}, 0, 0, {:?}]\n\
         translation_m = [-0.1, 0, 0]\nwithin_mm = 0.5\nwithin_deg = 0.1\n",
        "0a".repeat(32),
        half.cos(),
        half.sin(),
    )
}

#[test]
fn optional_keys_are_read() {
    let rig = Rig::parse(&full(0.0)).unwrap();
    assert_eq!(rig.serial("a"), Some("12345678"));
    assert_eq!(rig.serial("b"), Some("SN-7"));
    assert_eq!(rig.serial("c"), None);
    assert_eq!(rig.provenance().cad.as_ref().unwrap().file, "plate.step");
    let sigmas = rig.edges()[0].covariance.unwrap().sigmas();
    assert_eq!(sigmas[0], 2e-4);
    assert!((sigmas[5] - 0.3_f64.to_radians()).abs() < 1e-18);
    assert_eq!(rig.edges()[2].covariance, None);
    assert!((rig.closures()[0].within_rad - 0.1_f64.to_radians()).abs() < 1e-18);
}

#[test]
fn what_is_written_reads_back_to_the_bit() {
    let rig = Rig::parse(&full(0.0)).unwrap();
    let text = rig.to_toml();
    assert_eq!(Rig::parse(&text).unwrap(), rig, "{text}");
    assert_eq!(Rig::parse(&text).unwrap().to_toml(), text);
    assert!(text.contains("sigma_translation_m = 0.0002\n"), "{text}");

    let example = include_str!("../../../rigs/example.toml");
    let rig = Rig::parse(example).unwrap();
    assert_eq!(Rig::parse(&rig.to_toml()).unwrap(), rig);

    // A covariance that is no list of sigmas.
    let (parent, child) = (frame("rig"), frame("feet/left"));
    let mut rows = [[0.0; 6]; 6];
    for (i, row) in rows.iter_mut().enumerate() {
        row[i] = 1.1e-7 * (1 + i) as f64;
    }
    (rows[0][4], rows[4][0]) = (1e-8, 1e-8);
    let covariance = Covariance::from_rows(rows).unwrap();
    let moved =
        RigidTransform::from_rotation_vector([1.0, -0.3, 0.2], [1e-3, 1e-17, -0.0]).unwrap();
    let rig = rig
        .with_edge(&parent, &child, moved, Some(covariance))
        .unwrap();
    let again = Rig::parse(&rig.to_toml()).unwrap();
    assert_eq!(again, rig);
    assert_eq!(again.covariance(&parent, &child).unwrap(), Some(covariance));
}

#[test]
fn covariances_add_up_along_the_chain() {
    let rig = Rig::parse(&full(0.0)).unwrap();
    let of = |b: &str, a: &str| rig.covariance(&frame(b), &frame(a)).unwrap();
    let stored = rig.edges()[0].covariance.unwrap();
    assert_eq!(of("rig", "a/left").unwrap(), stored);
    assert_eq!(of("rig", "a/right"), None, "an entry without tolerance");
    assert_eq!(of("a/left", "a/left"), Some(Covariance::zero()));
    // The entry of b is stored as b_from_rig: its tolerance moves `rig` in the axes of `rig`.
    let close = |found: Covariance, expected: Covariance| {
        let off = (found.matrix() - expected.matrix()).amax();
        assert!(off < 1e-18, "{found:?} {expected:?}");
    };
    let of_b = rig.edges()[1].covariance.unwrap();
    close(of("b/left", "rig").unwrap(), of_b);
    let rig_from_b = rig.transform(&frame("rig"), &frame("b/left")).unwrap();
    close(
        of("rig", "b/left").unwrap(),
        of_b.moved(&rig_from_b.inverse()),
    );
    let a_from_rig = rig.transform(&frame("a/left"), &frame("rig")).unwrap();
    close(
        of("b/left", "a/left").unwrap(),
        stored.plus(&of_b.moved(&a_from_rig)),
    );
}

#[test]
fn an_edge_can_be_given_either_way_round() {
    let rig = Rig::parse(&full(0.0)).unwrap();
    let (b, r) = (frame("b/left"), frame("rig"));
    let rig_from_b =
        RigidTransform::from_rotation_vector([0.1, 0.2, 0.3], [1.0, 2.0, 3.0]).unwrap();
    let sigma = Covariance::from_sigmas([1e-3; 3], [1e-3, 2e-3, 3e-3]).unwrap();
    let changed = rig.with_edge(&r, &b, rig_from_b, Some(sigma)).unwrap();
    let back = changed.transform(&r, &b).unwrap();
    assert!((back.inverse() * rig_from_b).angle_rad() < 1e-15);
    let off = changed.covariance(&r, &b).unwrap().unwrap().matrix() - sigma.matrix();
    assert!(off.amax() < 1e-18);
    assert_eq!(rig.edges()[0], changed.edges()[0]);

    let error = rig
        .with_edge(&frame("a/left"), &b, rig_from_b, None)
        .unwrap_err();
    let expected = "changing rig \"a \\\"plate\\\"\": no entry connects a/left and b/left, expected one of rig - a/left";
    assert!(error.to_string().starts_with(expected), "{error}");
}

#[test]
fn loops_have_to_close() {
    let found = problems(&full(0.2));
    assert_eq!(found.len(), 1, "{found:?}");
    let expected = "line 35: the loop of a/right and a/left does not close: the other way round is off by 0.000 mm and 0.2000 deg, allowed are 0.500 mm and 0.1000 deg";
    assert_eq!(found[0], expected);

    let rig = Rig::parse(&full(0.0)).unwrap();
    let far = RigidTransform::from_translation_m([0.101, 0.0, 0.0]).unwrap();
    let rig = rig
        .with_edge(&frame("a/left"), &frame("a/right"), far, None)
        .unwrap();
    assert_eq!(rig.open_loops().len(), 1);
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("rig.toml");
    let error = rig.write(&path, Existing::Refuse).unwrap_err().to_string();
    assert!(error.contains("off by 1.000 mm"), "{error}");
    assert!(!path.exists());
}

#[test]
fn writing_keeps_what_is_there() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("rig.toml");
    let rig = Rig::parse(&full(0.0)).unwrap();
    rig.write(&path, Existing::Refuse).unwrap();
    let next = rig.clone().with_revision("D");
    let error = next.write(&path, Existing::Refuse).unwrap_err();
    assert!(matches!(error, RigError::Write(_)), "{error}");
    assert_eq!(Rig::read(&path).unwrap(), rig);
    next.write(&path, Existing::Replace).unwrap();
    assert_eq!(Rig::read(&path).unwrap().revision(), "D");
    assert!(
        next.with_revision(" ")
            .write(&path, Existing::Replace)
            .is_err()
    );
    assert_eq!(Rig::read(&path).unwrap().revision(), "D");
}

#[test]
fn mistakes_in_optional_keys_are_all_reported() {
    let text = full(0.0)
        .replace("cad_blake3 = \"0a", "cad_blake3 = \"xy")
        .replace("SN-7", "12345678")
        .replace("sigma_translation_mm = 0.2", "sigma_translation_mm = -0.2")
        .replace("sigma_rotation_rad = 0.01", "")
        .replace("within_mm = 0.5", "within_mm = 0.5\nwithin_m = 0.5")
        .replace("parent = \"a/right\"", "parent = \"d/left\"");
    let found = problems(&text);
    for expected in [
        "line 8: cad_blake3 in [provenance] is not 64 hexadecimal digits in lower case",
        "line 13: serial of b is that of a too",
        "line 21: sigma_translation_mm in [[parent_from_child]] is not one or three numbers above 0 (found -0.2)",
        "line 23: sigma_rotation_rad is missing in [[parent_from_child]]",
        "line 35: both within_m and within_mm in [[closes_loop]], expected one",
    ] {
        assert!(
            found.iter().any(|f| f.starts_with(expected)),
            "no {expected:?} in {found:#?}"
        );
    }
    let text = full(0.0).replace("parent = \"a/right\"", "parent = \"d/left\"");
    let found = problems(&text);
    assert_eq!(
        found,
        ["line 35: d/left is in no [[parent_from_child]] connected to rig"]
    );
}

#[test]
fn a_joint_is_never_exact() {
    let wide = "covariance = [[0, 0, 0, 0, 0, 0], [0, 1, 0, 0, 0, 0], [0, 0, 1, 0, 0, 0], \
                [0, 0, 0, 1, 0, 0], [0, 0, 0, 0, 1, 0], [0, 0, 0, 0, 0, 1]]";
    let sigmas = "sigma_translation_mm = 0.2\nsigma_rotation_deg = [0.1, 0.2, 0.3]";
    let place = "in [[parent_from_child]]";
    let after = "expected above 0: leave the tolerance out where it is not known";
    for (to, expected) in [
        (
            "sigma_translation_mm = 0.2\nsigma_rotation_deg = 0",
            format!("line 22: sigma_rotation_deg {place}: found 0, {after}"),
        ),
        (
            "sigma_translation_mm = [1, 0, 1]\nsigma_rotation_deg = 1",
            format!("line 21: sigma_translation_mm {place}: found [1, 0, 1], {after}"),
        ),
        (
            "sigma_translation_m = 1e-170\nsigma_rotation_deg = 1",
            format!("line 21: sigma_translation_m {place}: found 1e-170, {after}"),
        ),
        (
            wide,
            format!("line 21: entry 0 of the diagonal of covariance {place}: found 0, {after}"),
        ),
    ] {
        assert_eq!(problems(&full(0.0).replace(sigmas, to)), [expected]);
    }
    // A program cannot write such a file either.
    let rig = Rig::parse(&full(0.0)).unwrap();
    let exact = Some(Covariance::zero());
    let rig = rig
        .with_edge(
            &frame("a/left"),
            &frame("a/right"),
            RigidTransform::from_translation_m([0.1, 0.0, 0.0]).unwrap(),
            exact,
        )
        .unwrap();
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("rig.toml");
    let error = rig.write(&path, Existing::Refuse).unwrap_err().to_string();
    assert!(error.contains("found 0.0, expected above 0"), "{error}");
    assert!(!path.exists());
}

#[test]
fn only_a_wrong_count_is_taken_for_decimal_commas() {
    let with = |value: &str| {
        let text = full(0.0).replace("[0.1, 0.2, 0.3]\nsigma", &format!("{value}\nsigma"));
        problems(&text)
    };
    let found = with("[0,1, 0,2, 0,3]");
    let expected = "line 20: translation_m in [[parent_from_child]] is not three finite numbers \
                    (found [0,1, 0,2, 0,3], a list of 6; decimals are written with a point)";
    assert_eq!(found[0], expected);
    let found = with("[0,\n 0,\n \"0.1\"]");
    let expected = "line 20: translation_m in [[parent_from_child]] is not three finite numbers (found [0, 0, \"0.1\"])";
    assert_eq!(found[0], expected);
    let long = with(&format!("\"{}\"", "x".repeat(99)));
    assert!(
        long[0].ends_with(&format!("(found \"{}…)", "x".repeat(59))),
        "{long:?}"
    );
}
