use super::*;

const EXAMPLE: &str = include_str!("../../../rigs/example.toml");

/// What the factory files of the example's cameras would say.
fn facts() -> Facts {
    let camera = |baseline_m: f64, view: [f64; 2]| CameraFacts {
        source: "SN1.conf".to_owned(),
        left_from_right: RigidTransform::from_translation_m([baseline_m, 0.0, 0.0]).ok(),
        view: FieldOfView::from_degrees(view[0], view[1]),
        serial: None,
    };
    Facts::from([
        ("feet".to_owned(), camera(0.0631, [85.0, 54.0])),
        ("left_shoulder".to_owned(), camera(0.0499, [105.0, 78.0])),
        ("right_shoulder".to_owned(), camera(0.0499, [105.0, 78.0])),
    ])
}

/// All findings, but for notes that serials were not checked: the example has none.
fn found(text: &str, facts: &Facts) -> Vec<String> {
    let findings = check(text, facts).into_iter();
    let others = findings.filter(|finding| !finding.message.starts_with("serial of"));
    others.map(|finding| finding.to_string()).collect()
}

#[test]
fn the_example_passes() {
    assert_eq!(found(EXAMPLE, &facts()), Vec::<String>::new());
    // Without facts there are notes and nothing else.
    let notes = found(EXAMPLE, &Facts::new());
    assert_eq!(notes.len(), 3, "{notes:#?}");
    // Without a model the view of the feet camera is not known.
    let bare = EXAMPLE.replace("model = \"ZED Mini\"", "");
    let notes_of_bare = found(&bare, &Facts::new());
    assert!(
        notes_of_bare
            .iter()
            .any(|n| n.contains("the field of view of feet is not known")),
        "{notes_of_bare:#?}"
    );
    assert!(notes.iter().all(|n| n.contains(": note: ")), "{notes:#?}");
}

/// Replaces the rotation of the entry of a child, or its translation, and gives the findings.
fn with(child: &str, key: &str, value: &str) -> Vec<String> {
    let at = EXAMPLE.find(&format!("child = \"{child}\"")).unwrap();
    let start = at + EXAMPLE[at..].find(key).unwrap();
    let end = start + EXAMPLE[start..].find('\n').unwrap();
    let text = format!("{}{key} = {value}{}", &EXAMPLE[..start], &EXAMPLE[end..]);
    found(&text, &facts())
}

#[test]
fn each_mistake_is_found_with_its_line() {
    let check = |found: Vec<String>, expected: &[&str]| {
        assert_eq!(found.len(), expected.len(), "{found:#?}");
        for (f, e) in found.iter().zip(expected) {
            assert!(f.starts_with(e), "found {f:?}, expected {e:?}");
        }
    };
    check(
        with("feet/right", "translation_m", "[-0.063, 0, 0]"),
        &["line 52: error: left and right of feet are swapped: the right lens is at x = -63.00 mm"],
    );
    check(
        with("feet/right", "translation_m", "[0.0, 0.063, 0]"),
        &["line 52: error: left and right of feet are swapped: the right lens is at x = 0.00 mm"],
    );
    check(
        with("feet/right", "translation_m", "[0.06, 0.02, 0]"),
        &[
            "line 52: error: the right lens of feet is not beside the left one: it is at [60.00, 20.00, 0.00] mm",
        ],
    );
    check(
        with("feet/right", "translation_m", "[0.065, 0, 0]"),
        &[
            "line 52: error: the baseline of feet is 65.000 mm, SN1.conf has 63.100 mm: off by +1.900 mm, allowed are 0.500 mm",
        ],
    );
    check(
        with("feet/right", "translation_m", "[63, 0, 0]"),
        &[
            "line 52: error: the baseline of feet is 63000.00 mm, expected 10 to 300 mm: not in metres?",
            "line 52: error: the baseline of feet is 63000.000 mm, SN1.conf has",
        ],
    );
    // The optical frame written as if it were x forward, y left, z up: it looks at the sky.
    check(
        with("feet/left", "rotation_wxyz", "[1, 0, 0, 0]"),
        &[
            "line 46: error: the field of view of feet misses the feet: left toe, which is behind it, right toe, which",
            "line 46: warning: feet is turned on its side",
        ][..1],
    );
    // Rotated about z by 180°: it looks back.
    check(
        with(
            "left_shoulder/left",
            "rotation_wxyz",
            "[0.5, -0.5, -0.5, 0.5]",
        ),
        &[
            "line 19: error: left_shoulder looks into the wearer: its optical axis points 90.0 deg behind the plate",
        ],
    );
    check(
        with(
            "left_shoulder/left",
            "rotation_wxyz",
            "[0.5, 0.5, 0.5, 0.5]",
        ),
        &["line 19: warning: left_shoulder hangs upside down"],
    );
    check(
        with(
            "left_shoulder/left",
            "translation_m",
            "[0.00753, -0.2616, 0.1]",
        ),
        &["line 19: error: left_shoulder and right_shoulder are swapped: they are at y = -283."],
    );
    check(
        with("left_shoulder/left", "translation_m", "[7.53, 161.6, 100]"),
        &[
            "line 19: error: left_shoulder/left is 190.187 m from the rig's datum, expected at most 1 m: not in metres?",
        ],
    );
    // Looking 30 degrees down only, the shoes are out of the image.
    let half = 60_f64.to_radians();
    let turned = format!(
        "[{:?}, {:?}, {:?}, {:?}]",
        0.5 * half.cos() + 0.5 * half.sin(),
        -0.5 * half.cos() - 0.5 * half.sin(),
        0.5 * half.cos() - 0.5 * half.sin(),
        0.5 * half.sin() - 0.5 * half.cos()
    );
    let all = with("feet/left", "rotation_wxyz", &turned);
    assert!(
        all.iter().any(|f| f.contains("misses the feet")),
        "{all:#?}"
    );
}

#[test]
fn tolerances_widen_what_is_allowed() {
    let text = EXAMPLE.replacen(
        "translation_m = [0.063, 0, 0]",
        "translation_m = [0.065, 0, 0]\nsigma_translation_mm = 0.7\nsigma_rotation_deg = 0.1",
        1,
    );
    assert_eq!(found(&text, &facts()), Vec::<String>::new());
}

#[test]
fn serials_and_strangers() {
    let mut facts = facts();
    facts.get_mut("feet").unwrap().serial = Some("42".to_owned());
    let with_serial = |serial: &str| {
        let with = format!("model = \"ZED Mini\"\nserial = {serial}");
        EXAMPLE.replace("model = \"ZED Mini\"", &with)
    };
    assert_eq!(found(&with_serial("42"), &facts), Vec::<String>::new());
    let other = found(&with_serial("43"), &facts);
    assert_eq!(other.len(), 1);
    assert!(
        other[0].contains("error: the serial of feet is 43, SN1.conf is for 42"),
        "{other:?}"
    );
    let with_text = |serial: &str| check(&with_serial(&format!("\"{serial}\"")), &facts);
    for same in ["0042", "SN00042"] {
        assert!(with_text(same).iter().all(|f| f.severity == Severity::Note));
    }
    let notes = |text: &str| {
        let notes: Vec<String> = check(text, &facts).iter().map(Finding::to_string).collect();
        assert!(
            notes.iter().all(|n| n.contains("note: serial of ")),
            "{notes:?}"
        );
        notes
    };
    let notes = [notes(EXAMPLE), notes(&with_serial("42"))].map(|notes| notes.join("\n"));
    let expected =
        "serial of feet not checked: it has none here, so whose file SN1.conf is is not known";
    assert!(notes[0].contains(expected), "{notes:?}");
    assert!(!notes[1].contains("serial of feet"), "{notes:?}");
    assert!(notes[1].contains("serial of left_shoulder not checked: SN1.conf tells none"));
    facts.insert("belly".to_owned(), CameraFacts::default());
    let all = found(EXAMPLE, &facts);
    assert!(
        all[0].starts_with("error: belly has a calibration but no frames here"),
        "{all:?}"
    );
}

#[test]
fn unreadable_and_senseless_are_reported_together() {
    let text = EXAMPLE
        .replace("revision = \"nominal-1\"", "")
        .replacen(
            "rotation_wxyz = [1, 0, 0, 0]",
            "rotation_rows = [[1, 0, 0], [0, 1, 0], [0, 0, -1]]",
            1,
        )
        .replacen(
            "translation_m = [0.063, 0, 0]",
            "translation_m = [-0.063, 0, 0]",
            1,
        );
    let all = found(&text, &facts());
    let has = |what: &str| {
        assert!(
            all.iter().any(|f| f.contains(what)),
            "no {what:?} in {all:#?}"
        )
    };
    has("revision is missing");
    has("left-handed");
    has("left and right of feet are swapped");
    // Of what is not TOML, nothing else is said.
    let text = EXAMPLE.replacen("[0.063, 0, 0]", "[0,063, 0, 0]", 1);
    let all = found(&text, &facts());
    let expected = "line 56: error: not TOML: unexpected leading zero, expected nothing in `translation_m = [0,063, 0, 0]`; decimals are written with a point, not a comma";
    assert_eq!(all, [expected]);
    let text = EXAMPLE.replacen("[0.063, 0, 0]", "[0,63, 0, 0]", 1);
    let all = found(&text, &facts());
    let expected = "line 56: error: translation_m in [[parent_from_child]] is not three finite numbers (found [0,63, 0, 0], a list of 4; decimals";
    assert!(all.iter().any(|f| f.starts_with(expected)), "{all:#?}");
}

/// A rig from boards alone has the axes of its first camera, here one that looks at the ground.
#[test]
fn a_rig_whose_origin_is_a_camera_is_not_judged_by_how_it_is_worn() {
    let rig = Rig::parse(EXAMPLE).unwrap();
    let feet: Frame = "feet/left".parse().unwrap();
    let new_from_rig =
        RigidTransform::body_from_optical() * rig.transform(&feet, &Frame::rig()).unwrap();
    let mut parts = rig.to_parts();
    for edge in parts.edges.iter_mut().filter(|e| e.parent == Frame::rig()) {
        edge.parent_from_child = new_from_rig * edge.parent_from_child;
        if edge.child == feet {
            edge.parent_from_child = RigidTransform::body_from_optical();
        }
    }
    // As a drawing it cannot be: the shoulders look up and back.
    let drawn = Rig::from_parts(parts.clone()).unwrap();
    assert_eq!(drawn.origin_camera(), None);
    let wrong = found(&drawn.to_toml(), &facts());
    assert!(
        wrong.iter().any(|f| f.contains("misses the feet")),
        "{wrong:#?}"
    );
    parts.provenance.kind = super::super::ProvenanceKind::Calibrated;
    let calibrated = Rig::from_parts(parts.clone()).unwrap();
    assert_eq!(calibrated.origin_camera(), Some("feet"));
    let notes = found(&calibrated.to_toml(), &facts());
    assert_eq!(notes.len(), 1, "{notes:#?}");
    assert!(
        notes[0].contains("note: the rig's frame is that of feet"),
        "{notes:#?}"
    );
    // What does not depend on it is looked at as ever.
    for edge in parts
        .edges
        .iter_mut()
        .filter(|e| e.child.as_str() == "feet/right")
    {
        edge.parent_from_child = edge.parent_from_child.inverse();
    }
    let swapped = found(&Rig::from_parts(parts).unwrap().to_toml(), &facts());
    assert!(
        swapped
            .iter()
            .any(|f| f.contains("left and right of feet are swapped")),
        "{swapped:#?}"
    );
}
