use super::*;

const HEAD: &str = "format = 1\nname = \"plate\"\nrevision = \"A\"\nprovenance = { kind = \"nominal\", note = \"made up\" }\n";

/// A file with one entry per `(parent, child, rest)`; entries of five lines start on lines 5, 10,
/// 15, ….
pub(super) fn file(entries: &[(&str, &str, &str)]) -> String {
    let mut text = HEAD.to_owned();
    for (parent, child, rest) in entries {
        text +=
            &format!("[[parent_from_child]]\nparent = \"{parent}\"\nchild = \"{child}\"\n{rest}\n");
    }
    text
}

const PLAIN: &str = "rotation_wxyz = [1, 0, 0, 0]\ntranslation_m = [0.1, 0, 0]";

fn problems(text: &str) -> Vec<String> {
    match Rig::parse(text) {
        Err(RigError::Invalid {
            problems,
            path: None,
        }) => problems.0.iter().map(Problem::to_string).collect(),
        other => panic!("expected problems, found {other:?}"),
    }
}

pub(super) fn frame(name: &str) -> Frame {
    name.parse().unwrap()
}

fn assert_close(found: [f64; 3], expected: [f64; 3], tolerance: f64) {
    for (f, e) in found.iter().zip(expected) {
        assert!(
            (f - e).abs() <= tolerance,
            "found {found:?}, expected {expected:?}"
        );
    }
}

#[test]
fn the_example_rig_is_what_it_says() {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("rigs/example.toml");
    let rig = Rig::read(&path).unwrap();
    assert_eq!(rig.provenance().kind, ProvenanceKind::Nominal);
    assert_eq!(rig.cameras(), ["feet", "left_shoulder", "right_shoulder"]);
    assert_eq!(rig.frames().count(), 10);
    for (camera, baseline_m) in [
        ("left_shoulder", 0.04988),
        ("right_shoulder", 0.04988),
        ("feet", 0.063),
    ] {
        let left = Frame::of_camera(camera, FramePart::Left).unwrap();
        let right = Frame::of_camera(camera, FramePart::Right).unwrap();
        let left_from_right = rig.transform(&left, &right).unwrap();
        assert_eq!(left_from_right.translation_m(), [baseline_m, 0.0, 0.0]);
        let rig_from_left = rig.transform(&Frame::rig(), &left).unwrap();
        // No camera hangs upside down or is tilted sideways: right in the image is level.
        assert!(rig_from_left.rotate([1.0, 0.0, 0.0])[2].abs() < 1e-9);
        assert!(rig_from_left.rotate([0.0, 1.0, 0.0])[2] < 0.0);
    }
    let ahead = [0.0, 0.0, 1.0];
    let (sin, cos) = 30f64.to_radians().sin_cos();
    let look = |name: &str| {
        rig.transform(&Frame::rig(), &frame(name))
            .unwrap()
            .rotate(ahead)
    };
    assert_close(look("left_shoulder/left"), [cos, sin, 0.0], 1e-12);
    assert_close(look("right_shoulder/left"), [cos, -sin, 0.0], 1e-12);
    let (sin, cos) = 80f64.to_radians().sin_cos();
    assert_close(look("feet/left"), [cos, 0.0, -sin], 1e-12);
    // One tag on each shoe, which faces up and back and is upright for the wearer.
    let tags: Vec<(u32, Foot)> = rig.shoe_tags().iter().map(|t| (t.id, t.foot)).collect();
    assert_eq!(tags, [(0, Foot::Left), (1, Foot::Right)]);
    for tag in rig.shoe_tags() {
        let (sin, cos) = 0.1f64.sin_cos();
        assert_close(
            tag.foot_from_tag.rotate([0.0, 0.0, -1.0]),
            [-sin, 0.0, cos],
            1e-12,
        );
        assert_close(
            tag.foot_from_tag.rotate([1.0, 0.0, 0.0]),
            [0.0, -1.0, 0.0],
            1e-12,
        );
        assert_eq!((tag.family, tag.size_m), (TagFamily::Tag36h11, 0.06));
    }
    // The shoulders mirror each other: the camera centres, not the left lenses.
    let centre = |name: &str| {
        rig.transform(&Frame::rig(), &frame(name))
            .unwrap()
            .translation_m()
    };
    assert_close(centre("left_shoulder/imu"), [0.02, 0.14, 0.10], 1e-5);
    assert_close(centre("right_shoulder/imu"), [0.02, -0.14, 0.10], 1e-5);
}

#[test]
fn composes_through_the_tree() {
    let text = file(&[
        (
            "rig",
            "a/left",
            "rotation_wxyz = [0.5, -0.5, 0.5, -0.5]\ntranslation_m = [1, 2, 3]",
        ),
        (
            "a/left",
            "a/right",
            "rotation_wxyz = [1, 0, 0, 0]\ntranslation_m = [0.1, 0, 0]",
        ),
        // Written the other way round: the tree does not care.
        (
            "b/left",
            "rig",
            "rotation_rows = [[0, -1, 0], [0, 0, -1], [1, 0, 0]]\ntranslation_m = [0, 0, -2]",
        ),
    ]);
    let rig = Rig::parse(&text).unwrap();
    let rig_from_right = rig.transform(&frame("rig"), &frame("a/right")).unwrap();
    assert_close(
        rig_from_right.apply([0.0, 0.0, 5.0]),
        [6.0, 1.9, 3.0],
        1e-14,
    );

    let b_from_right = rig.transform(&frame("b/left"), &frame("a/right")).unwrap();
    let b_from_rig = rig.transform(&frame("b/left"), &frame("rig")).unwrap();
    assert_close(b_from_rig.apply([6.0, 1.9, 3.0]), [-1.9, -3.0, 4.0], 1e-14);
    assert_close(
        b_from_right.apply([0.0, 0.0, 5.0]),
        [-1.9, -3.0, 4.0],
        1e-14,
    );
    assert_eq!(
        rig.transform(&frame("a/left"), &frame("a/left")).unwrap(),
        RigidTransform::identity()
    );
    assert_eq!(
        rig.transform(&frame("a/left"), &frame("a/right")).unwrap(),
        rig.edges()[1].parent_from_child,
        "neighbours get the stored transform"
    );

    let error = rig
        .transform(&frame("c/left"), &frame("rig"))
        .unwrap_err()
        .to_string();
    assert!(
        error.contains("c/left") && error.contains("rig, a/left, a/right, b/left"),
        "{error}"
    );
    assert!(rig.transform(&frame("rig"), &frame("world")).is_err());
}

#[test]
fn tells_everything_at_once_with_lines() {
    let text = concat!(
        "format = 1\n",
        "nam = \"plate\"\n",
        "revision = 3\n",
        "provenance = { kind = \"guessed\", note = \"\" }\n",
        "colour = \"red\"\n",
        "[[parent_from_child]]\n",
        "parent = \"rig\"\n",
        "child = \"feet/lft\"\n",
        "rotation_xyzw = [0, 0, 0, 1]\n",
        "translation_m = [0, 0]\n",
        "[[parent_from_child]]\n",
        "parent = \"world\"\n",
        "child = \"rig\"\n",
        "rotation_wxyz = [0.9, 0, 0, 0]\n",
        "translation_m = [0, 0, 0]\n",
    );
    let found = problems(text);
    let expected = [
        "line 1: name is missing in the rig file, expected a text that is not empty",
        "line 2: unknown key nam in the rig file; did you mean name?",
        "line 3: revision in the rig file is not a text that is not empty (found 3)",
        "line 4: kind is \"guessed\", expected one of nominal, cad, measured, calibrated",
        "line 4: note in [provenance] is not a text that is not empty (found \"\")",
        "line 5: unknown key colour in the rig file; known are format, name, revision, provenance, parent_from_child",
        "line 6: neither of rotation_wxyz and rotation_rows in [[parent_from_child]], expected exactly one",
        "line 8: \"feet/lft\" is not a frame",
        "line 9: unknown key rotation_xyzw in [[parent_from_child]]; did you mean rotation_wxyz?",
        "line 10: translation_m in [[parent_from_child]] is not three finite numbers (found [0, 0], a list of 2; decimals are written with a point)",
        "line 12: parent is world, but the rig moves in the world",
        "line 14: the quaternion's norm is 0.9, expected 1 within",
    ];
    for line in expected {
        assert!(
            found.iter().any(|problem| problem.starts_with(line)),
            "no {line:?} in {found:#?}"
        );
    }
    assert_eq!(found.len(), expected.len(), "{found:#?}");
}

#[test]
fn reports_what_is_wrong_with_the_tree() {
    let entries = |list: &[(&str, &str)]| {
        file(
            &list
                .iter()
                .map(|(p, c)| (*p, *c, PLAIN))
                .collect::<Vec<_>>(),
        )
    };
    let check = |list: &[(&str, &str)], expected: &[&str]| {
        let found = problems(&entries(list));
        assert_eq!(found.len(), expected.len(), "{found:#?}");
        for (f, e) in found.iter().zip(expected) {
            assert!(f.starts_with(e), "found {f:?}, expected {e:?}");
        }
    };
    let good = ("rig", "a/left");
    check(
        &[good, good],
        &["line 10: rig and a/left are already connected on line 5"],
    );
    check(
        &[good, ("a/left", "rig")],
        &["line 10: a/left and rig are already connected on line 5"],
    );
    check(
        &[good, ("rig", "a/right"), ("a/right", "a/left")],
        &["line 15: connecting a/right and a/left closes a loop"],
    );
    check(
        &[good, ("b/left", "b/right")],
        &["line 10: b/left has no connection to rig"],
    );
    check(
        &[("b/left", "b/right")],
        &["line 5: b/left has no connection to rig"],
    );
    check(
        &[good, ("a/left", "a/left")],
        &["line 10: a/left is its own parent"],
    );
    check(
        &[("rig", "a/right")],
        &["line 5: a/right is there but a/left is not"],
    );
}

#[test]
fn refuses_mirrored_and_doubled_rotations() {
    let text = file(&[
        (
            "rig",
            "a/left",
            "rotation_rows = [[0, 1, 0], [0, 0, -1], [1, 0, 0]]\ntranslation_m = [0, 0, 0]",
        ),
        (
            "rig",
            "b/left",
            "rotation_rows = [[1, 0, 0], [0, 1, 0], [0, 0.01, 1]]\ntranslation_m = [0, 0, 0]",
        ),
        (
            "rig",
            "c/left",
            "rotation_wxyz = [1, 0, 0, 0]\nrotation_rows = [[1, 0, 0], [0, 1, 0], [0, 0, 1]]\ntranslation_m = [0, 0, 0]",
        ),
        (
            "rig",
            "d/left",
            "rotation_wxyz = [1, 0, 0, 0]\ntranslation_m = [nan, 0, 0]",
        ),
    ]);
    let found = problems(&text);
    assert_eq!(found.len(), 4, "{found:#?}");
    assert!(
        found[0].starts_with("line 8: the rotation matrix is left-handed"),
        "{found:#?}"
    );
    assert!(
        found[1].starts_with("line 13: the rotation matrix is not orthonormal"),
        "{found:#?}"
    );
    assert!(
        found[2].starts_with("line 15: both of rotation_wxyz and rotation_rows"),
        "{found:#?}"
    );
    assert_eq!(
        found[3],
        "line 25: translation_m in [[parent_from_child]] is not three finite numbers (found [nan, 0, 0])"
    );
}

#[test]
fn a_newer_format_is_the_only_complaint() {
    let found = problems("format = 2\nplates = []\n");
    assert_eq!(found, ["line 1: format is 2, this program reads 1"]);
}

#[test]
fn broken_toml_and_missing_files_are_named() {
    let found = problems("format = 1\nname = \"plate\nrevision = 1\n");
    assert!(found[0].starts_with("line 2: not TOML"), "{found:?}");

    let error = Rig::read(Path::new("no/such/rig.toml"))
        .unwrap_err()
        .to_string();
    assert_eq!(error, "reading a rig file: no/such/rig.toml");
    let error = Rig::parse("format = 1\n").unwrap_err().to_string();
    assert!(
        error.starts_with("checking a rig file: 4 problems\n  line 1: name is missing"),
        "{error}"
    );
}

#[test]
fn tags_on_shoes_are_checked() {
    let tag = |what: &str| {
        format!(
            "{}[[shoe_tag]]\n{what}\n{PLAIN}\n",
            file(&[("rig", "a/left", PLAIN)])
        )
    };
    let good = "family = \"36h11\"\nid = 586\nfoot = \"right_foot\"\nsize_m = 0.05";
    let rig = Rig::parse(&tag(good)).unwrap();
    let [found] = rig.shoe_tags() else {
        panic!("{:?}", rig.shoe_tags())
    };
    assert_eq!(
        (found.id, found.foot, found.size_m),
        (586, Foot::Right, 0.05)
    );
    assert_eq!(found.foot_from_tag.translation_m(), [0.1, 0.0, 0.0]);
    // No tags are fine.
    let none = Rig::parse(&file(&[("rig", "a/left", PLAIN)])).unwrap();
    assert!(none.shoe_tags().is_empty());

    for (from, to, expected) in [
        ("36h11", "25h9", "family is \"25h9\", expected one of 36h11"),
        ("586", "587", "id is 587, family 36h11 has 0 to 586"),
        ("586", "-1", "id is -1, family 36h11 has 0 to 586"),
        ("586", "1.5", "id in [[shoe_tag]] is not an integer"),
        (
            "right_foot",
            "foot",
            "foot is \"foot\", expected one of left_foot, right_foot",
        ),
        (
            "0.05",
            "0",
            "size_m in [[shoe_tag]] is not a number above 0 (found 0)",
        ),
        (
            "0.05",
            "nan",
            "size_m in [[shoe_tag]] is not a number above 0 (found nan)",
        ),
        ("size_m", "size", "unknown key size in [[shoe_tag]]"),
    ] {
        let found = problems(&tag(&good.replace(from, to)));
        assert!(
            found.iter().any(|p| p.contains(expected)),
            "{to}: {found:?}"
        );
    }
    let twice = tag(good) + "[[shoe_tag]]\n" + good + "\n" + PLAIN;
    let found = problems(&twice);
    assert_eq!(found.len(), 1, "{found:?}");
    assert!(
        found[0].contains("tag 586 is on a shoe already, on line"),
        "{found:?}"
    );
}

mod written;

#[test]
fn tolerances_of_tags_and_soles_are_read_and_written_back() {
    let text = file(&[("rig", "a/left", PLAIN)])
        + "[[shoe_tag]]\nfamily = \"36h11\"\nid = 3\nfoot = \"left_foot\"\nsize_m = 0.08\n\
           sigma_size_mm = 0.3\nsigma_translation_mm = [2, 3, 1]\nsigma_rotation_deg = 2\n"
        + PLAIN
        + "\n[[sole]]\nfoot = \"left_foot\"\nsigma_mm = 3\n\
           outline_m = [[0.15, 0], [0.1, 0.045], [-0.13, 0.04], [-0.13, -0.04]]\n";
    let rig = Rig::parse(&text).unwrap();
    let (tag, sole) = (&rig.shoe_tags()[0], &rig.soles()[0]);
    assert_eq!(tag.size_sigma_m, Some(0.3 * 1e-3));
    assert_eq!(tag.covariance.unwrap().sigmas()[1], 3.0 * 1e-3);
    assert_eq!((sole.foot, sole.sigma_m), (Foot::Left, Some(3.0 * 1e-3)));
    assert_eq!(sole.outline_m[1], [0.1, 0.045]);
    assert_eq!(Rig::parse(&rig.to_toml()).unwrap(), rig);

    for (from, to, expected) in [
        (
            "sigma_mm = 3",
            "sigma_mm = 0",
            "sigma_mm in [[sole]] is not a number above 0",
        ),
        (
            "sigma_size_mm",
            "sigma_size_m = 0\nsigma_size_mm",
            "both sigma_size_m and sigma_size_mm",
        ),
        (
            "[[0.15, 0], ",
            "[[1.5, 0], ",
            "vertex 0 of outline_m in [[sole]] is 1.5 m from the middle",
        ),
        (
            "0.04], [-0.13, -0.04]]",
            "0.04]]",
            "does not go counter-clockwise",
        ),
        (
            ", [0.1, 0.045], [-0.13, 0.04], [-0.13, -0.04]]",
            "]",
            "three or more pairs of numbers",
        ),
        (
            "[[sole]]\nfoot = \"left_foot\"",
            "[[sole]]\nfoot = \"foot\"",
            "foot is \"foot\"",
        ),
    ] {
        assert!(text.contains(from), "{from}");
        let found = problems(&text.replacen(from, to, 1));
        assert!(
            found.iter().any(|p| p.contains(expected)),
            "{to}: {found:?}"
        );
    }
    let sole = &text[text.find("[[sole]]").unwrap()..];
    let found = problems(&(text.clone() + sole));
    assert_eq!(found.len(), 1, "{found:?}");
    assert!(
        found[0].contains("left_foot has a sole already, on line"),
        "{found:?}"
    );
}
