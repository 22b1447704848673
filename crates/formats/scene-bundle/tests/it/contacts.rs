//! Output `contacts`, written and read, and what it refuses.

use std::fs;

use cad_transforms::rig::Foot;
use cad_transforms::{Covariance, RigidTransform};
use scene_bundle::outputs::contacts::{
    ContactEvent, ContactPatch, ContactView, FootContact, read, read_patches, read_views, write,
};
use scene_bundle::{Bundle, BundleError, OutputReader, outputs};

use crate::sample;

fn contact(number: i64) -> FootContact {
    let s = number as f64;
    let pose = RigidTransform::from_rotation_vector([0.0, 0.1, 0.3 * s], [0.7 * s, 0.1, -0.2]);
    FootContact {
        foot: Foot::ALL[number as usize % 2],
        events: [0, 80, 350, 600].map(|later| ContactEvent {
            time_ns: 1_000_000 * (550 * number + later),
            sigma_s: 0.01 + 1e-3 * later as f32,
            is_seen: later < 100,
        }),
        world_from_foot: pose.expect("finite"),
        covariance: Covariance::from_sigmas([0.003, 0.004, 0.002], [0.01; 3]).expect("positive"),
    }
}

/// A sole, and one whose toe hangs free and of whose ground nothing is known.
fn patches() -> Vec<ContactPatch> {
    let outline = [
        [-0.1, -0.05, 0.0],
        [0.1, -0.05, 0.01],
        [0.1, 0.05, 0.01],
        [-0.1, 0.05, 0.0],
    ];
    vec![
        ContactPatch {
            outline_m: outline.to_vec(),
            area_share: 1.0,
            ground_share: 0.75,
            gap_m: Some(-0.002),
        },
        ContactPatch {
            outline_m: outline[..3].to_vec(),
            area_share: 0.5,
            ground_share: 0.0,
            gap_m: None,
        },
    ]
}

fn view(contact: u64) -> ContactView {
    ContactView {
        contact,
        camera: 2,
        frame: 17,
        time_ns: 3_000_000_000,
        pixel: [320.5, 170.25],
        distance_m: 2.5,
        visible_share: 0.9,
    }
}

fn written(patches: &[ContactPatch]) -> Result<(tempfile::TempDir, OutputReader), BundleError> {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("walk.scene");
    let bundle = Bundle::create_or_open(&path, sample::provenance()).expect("a bundle");
    let draft = bundle.begin(outputs::CONTACTS).expect("a draft");
    write(&draft, &[contact(0), contact(1)], patches, &[view(1)])?;
    draft
        .commit(sample::record(outputs::CONTACTS))
        .expect("committed");
    let reader = bundle
        .scene()
        .output(outputs::CONTACTS)
        .expect("the output");
    Ok((folder, reader))
}

#[test]
fn contacts_read_back_unchanged() {
    let (_folder, reader) = written(&patches()).expect("written");
    assert_eq!(read(&reader).expect("contacts"), [contact(0), contact(1)]);
    assert_eq!(read_patches(&reader, 2).expect("patches"), patches());
    assert_eq!(read_views(&reader, 2).expect("views"), [view(1)]);
}

#[test]
fn patches_outside_the_format_are_refused() {
    type Change = fn(&mut Vec<ContactPatch>);
    let cases: [(Change, &str); 6] = [
        (|p| p.truncate(1), "table: 1 rows"),
        (
            |p| p[1].outline_m.truncate(2),
            "row 1: an outline of 2 vertices",
        ),
        (
            |p| p[0].outline_m[2][1] = f64::NAN,
            "row 0: a vertex that is not finite",
        ),
        (|p| p[1].area_share = 1.5, "row 1: shares [1.5, 0.0]"),
        (|p| p[0].ground_share = f32::NAN, "row 0: shares [1.0, NaN]"),
        (|p| p[0].gap_m = Some(f32::INFINITY), "row 0: gap_m inf"),
    ];
    for (change, expected) in cases {
        let mut changed = patches();
        change(&mut changed);
        let error = written(&changed).map(drop).expect_err("refused");
        assert!(matches!(error, BundleError::Refused { .. }), "{error}");
        assert!(error.to_string().contains(expected), "{error}");
    }
}

/// The error of reading an output whose table of patches states other numbers of vertices.
fn with_counts(counts: [u32; 2]) -> String {
    let (folder, reader) = written(&patches()).expect("written");
    let path = reader.file_path("patches.npy");
    let mut bytes = fs::read(&path).expect("a table");
    let rows = bytes.len() - 2 * 16;
    for (row, count) in counts.into_iter().enumerate() {
        bytes[rows + 16 * row..][..4].copy_from_slice(&count.to_le_bytes());
    }
    // Another output with these bytes.
    let bundle = Bundle::create_or_open(&folder.path().join("b"), sample::provenance());
    let bundle = bundle.expect("a bundle");
    let draft = bundle.begin(outputs::CONTACTS).expect("a draft");
    draft.write("patches.npy", &bytes).expect("written");
    let vertices = fs::read(reader.file_path("patch-vertices.npy")).expect("a table");
    draft
        .write("patch-vertices.npy", &vertices)
        .expect("written");
    draft
        .commit(sample::record(outputs::CONTACTS))
        .expect("committed");
    let reader = bundle
        .scene()
        .output(outputs::CONTACTS)
        .expect("the output");
    read_patches(&reader, 2).expect_err("malformed").to_string()
}

#[test]
fn patches_and_their_vertices_have_to_agree() {
    let missing = with_counts([4, 5]);
    assert!(
        missing.contains("5 vertices, of which 3 are there"),
        "{missing}"
    );
    let left = with_counts([3, 3]);
    assert!(
        left.contains("patch-vertices.npy") && left.contains("1 rows too many"),
        "{left}"
    );
    let huge = with_counts([u32::MAX, 3]);
    assert!(
        huge.contains("4294967295 vertices, of which 7 are there"),
        "{huge}"
    );
}
