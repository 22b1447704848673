use proptest::prelude::*;

use super::*;
use crate::cad::map::rig_of_frames;
use crate::cad::{Format, read_bytes};
use crate::rig::{CadSource, Edge, Provenance, ProvenanceKind, RigParts};

const EXAMPLE: &str = include_str!("../../../rigs/example.toml");

fn source() -> CadSource {
    CadSource {
        file: "a".to_owned(),
        blake3: "0".repeat(64),
    }
}

/// Writes a rig in each format, reads it back and compares every transform from `rig`.
fn goes_round(rig: &Rig) {
    let scene = Scene {
        depth_m: 1.0,
        ..Scene::default()
    };
    for (text, format) in [
        (urdf(rig), Format::Urdf),
        (gltf(rig, &scene), Format::Gltf),
        (csv(rig), Format::Csv),
        (toml(rig), Format::Toml),
    ] {
        let cad = read_bytes(text.as_bytes(), format).unwrap_or_else(|e| panic!("{e}\n{text}"));
        let again = rig_of_frames(&cad, rig.name(), source()).unwrap();
        let frames = |rig: &Rig| rig.frames().collect::<Vec<_>>();
        assert_eq!(frames(&again), frames(rig));
        for frame in rig.frames() {
            let was = rig.transform(&Frame::rig(), &frame).unwrap();
            let off = was.inverse() * again.transform(&Frame::rig(), &frame).unwrap();
            assert!(
                off.distance_m() < 1e-9 && off.angle_rad() < 1e-9,
                "{format} {frame}: {off:?}\n{text}"
            );
        }
    }
}

#[test]
fn the_example_goes_round() {
    goes_round(&Rig::parse(EXAMPLE).unwrap());
}

#[test]
fn entries_written_the_other_way_round_go_round() {
    let text = EXAMPLE.replacen(
        "parent = \"rig\"\nchild = \"feet/left\"",
        "parent = \"feet/left\"\nchild = \"rig\"",
        1,
    );
    assert_ne!(text, EXAMPLE);
    goes_round(&Rig::parse(&text).unwrap());
}

fn any_transform() -> impl Strategy<Value = RigidTransform> {
    // Some exactly at the places where angles stop being unique.
    let quarter = std::f64::consts::FRAC_PI_2;
    let special = prop::sample::select(vec![
        0.0,
        quarter,
        -quarter,
        2.0 * quarter,
        1e-9,
        quarter - 1e-9,
    ]);
    let angle = prop_oneof![3 => -3.2..3.2, 2 => special];
    let turn = prop::array::uniform3(angle);
    let shift = prop::array::uniform3(-1.0..1.0_f64);
    (turn, shift).prop_map(|([a, b, c], t)| {
        let about = |v: [f64; 3]| RigidTransform::from_rotation_vector(v, [0.0; 3]).unwrap();
        RigidTransform::from_translation_m(t).unwrap()
            * about([0.0, 0.0, c])
            * about([0.0, b, 0.0])
            * about([a, 0.0, 0.0])
    })
}

proptest! {
    #![proptest_config(ProptestConfig { failure_persistence: None, ..ProptestConfig::with_cases(128) })]

    #[test]
    fn any_rig_goes_round(transforms in prop::collection::vec(any_transform(), 4)) {
        let ends = [("rig", "a/left"), ("a/left", "a/right"), ("a/left", "a/imu"), ("b/left", "a/right")];
        let edges = ends.iter().zip(&transforms).map(|((parent, child), transform)| Edge {
            parent: parent.parse().unwrap(),
            child: child.parse().unwrap(),
            parent_from_child: *transform,
            covariance: None,
        });
        let rig = Rig::from_parts(RigParts {
            name: "a <\"plate\"> & more".to_owned(),
            revision: "1\n2".to_owned(),
            provenance: Provenance { kind: ProvenanceKind::Nominal, note: "x".to_owned(), cad: None },
            cameras: Vec::new(),
            edges: edges.collect(),
            closures: Vec::new(),
            shoe_tags: Vec::new(),
            soles: Vec::new(),
        })
        .unwrap();
        goes_round(&rig);
        prop_assert_eq!(Rig::parse(&rig.to_toml()).unwrap(), rig);
    }
}

#[test]
fn digits_of_base64() {
    // RFC 4648, section 10.
    let cases = [
        ("", ""),
        ("f", "Zg=="),
        ("fo", "Zm8="),
        ("foo", "Zm9v"),
        ("foob", "Zm9vYg=="),
        ("foobar", "Zm9vYmFy"),
    ];
    for (text, expected) in cases {
        assert_eq!(base64(text.as_bytes()), expected);
    }
}

#[test]
fn gltf_holds_what_a_viewer_needs() {
    let rig = Rig::parse(EXAMPLE).unwrap();
    let scene = Scene {
        views: vec![(
            "feet/left".parse().unwrap(),
            FieldOfView::from_degrees(85.0, 54.0).unwrap(),
        )],
        depth_m: 1.0,
        ground_z_m: Some(-1.2),
        outlines: vec![(
            "shoes".to_owned(),
            vec![[0.0, 0.0, -1.2], [0.1, 0.0, -1.2], [0.1, 0.1, -1.2]],
        )],
    };
    let text = gltf(&rig, &scene);
    assert_eq!(text, gltf(&rig, &scene));
    let document: Value = serde_json::from_str(&text).unwrap();
    let nodes = document["nodes"].as_array().unwrap();
    assert_eq!(nodes.len(), 10 + 3);
    let feet = nodes.iter().find(|n| n["name"] == "feet/left").unwrap();
    let view = nodes
        .iter()
        .position(|n| n["name"] == "view of feet/left")
        .unwrap();
    assert!(feet["children"].as_array().unwrap().contains(&json!(view)));
    // Every accessor lies within the buffer.
    let length = document["buffers"][0]["byteLength"].as_u64().unwrap();
    for accessor in document["accessors"].as_array().unwrap() {
        let view = &document["bufferViews"][accessor["bufferView"].as_u64().unwrap() as usize];
        let size = 12 * accessor["count"].as_u64().unwrap();
        assert_eq!(view["byteLength"].as_u64().unwrap(), size);
        assert!(view["byteOffset"].as_u64().unwrap() + size <= length);
    }
}
