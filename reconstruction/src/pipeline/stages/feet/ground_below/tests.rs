use ::feet::events::Event;
use ::feet::stance::Stance;
use cad_transforms::Covariance;
use cad_transforms::rig::TagFamily;

use super::*;

/// Ground that rises by 10 % in x, with vertices 3 cm apart, up to 40 m; within a sole there are
/// none. `edge_m` is the height of a step at y = 0.
fn ground(edge_m: f32) -> TerrainMesh {
    let places = (0..400).flat_map(|i| (-20..=20).map(move |j| [i, j]));
    let positions = places.map(|[i, j]| {
        let [x, y] = [0.03 * i as f32, 0.03 * j as f32];
        [x, y, 0.1 * x + if j > 0 { edge_m } else { 0.0 }]
    });
    let positions: Vec<[f32; 3]> = positions.collect();
    let count = positions.len();
    TerrainMesh {
        positions,
        normals: vec![[0.0, 0.0, 1.0]; count],
        colors: vec![[0; 3]; count],
        sigma_m: vec![0.003; count],
        views: vec![1; count],
        planes: vec![None; count],
        triangles: Vec::new(),
    }
}

/// Foot on that ground, 5 mm above it, rolled by 0.03 and pitched by -0.02 against it, pointing 0.1
/// to the left.
fn contacts() -> Vec<Contact> {
    let turn = |v: [f64; 3]| RigidTransform::from_rotation_vector(v, [0.0; 3]).expect("finite");
    let event = |time_s: f64| Event {
        time_s,
        sigma_s: 0.01,
        is_seen: true,
    };
    (0..10)
        .map(|k| {
            let x = 0.6 + f64::from(k);
            let shift = [x, 0.0, 0.1 * x + 0.005];
            let place = RigidTransform::from_rotation_vector([0.0; 3], shift).expect("finite");
            let slope = turn([0.0, -0.1_f64.atan(), 0.0]);
            let foot = place * slope * turn([0.0, 0.0, 0.1]) * turn([0.03, -0.02, 0.0]);
            let start = f64::from(k);
            Contact {
                stance: Stance {
                    observations: 0..1,
                    times_ns: [0, 1],
                    world_from_foot: foot,
                    covariance: Covariance::from_sigmas([0.003; 3], [0.01; 3]).expect("positive"),
                },
                heel_strike: event(start),
                foot_flat: event(start + 0.1),
                heel_off: event(start + 0.4),
                toe_off: event(start + 0.6),
            }
        })
        .collect()
}

#[test]
fn height_tilt_and_heading_are_those_given() {
    let mesh = ground(0.0);
    let samples = GroundBelow::new(&mesh).samples(&contacts());
    for (k, sample) in samples.iter().enumerate() {
        let height = sample.height_m.expect("plane ground");
        assert!((height - 0.005).abs() < 1e-4, "{sample:?}");
        let [roll, pitch] = sample.tilt_rad.map(|own| own.expect("plane ground"));
        assert!(
            (roll - 0.03).abs() < 1e-3 && (pitch + 0.02).abs() < 1e-3,
            "{sample:?}"
        );
        // The first and the last one have no course.
        assert_eq!(sample.heading_rad.is_some(), (1..9).contains(&k));
        assert!(
            sample
                .heading_rad
                .is_none_or(|own| (own - 0.1).abs() < 2e-3),
            "{sample:?}"
        );
    }
}

#[test]
fn ground_that_is_not_plane_says_nothing() {
    let mesh = ground(0.05);
    let samples = GroundBelow::new(&mesh).samples(&contacts());
    assert!(
        samples.iter().all(|sample| sample.height_m.is_none()),
        "{samples:?}"
    );
    let empty = TerrainMesh {
        positions: Vec::new(),
        normals: Vec::new(),
        colors: Vec::new(),
        sigma_m: Vec::new(),
        views: Vec::new(),
        planes: Vec::new(),
        triangles: Vec::new(),
    };
    let samples = GroundBelow::new(&empty).samples(&contacts());
    assert!(samples.iter().all(|sample| sample.height_m.is_none()));
}

#[test]
fn a_corrected_tag_puts_the_sole_on_the_ground() {
    let turn = |v: [f64; 3]| RigidTransform::from_rotation_vector(v, [0.0; 3]).expect("finite");
    // The tag is 4 mm higher and 2 degrees more askew than the rig file has it.
    let place = RigidTransform::from_rotation_vector([3.0, 0.1, 0.2], [0.08, 0.01, 0.075]);
    let place = place.expect("finite");
    let shift = RigidTransform::from_rotation_vector([0.0; 3], [0.08, 0.01, 0.079]);
    let truth = shift.expect("finite") * turn([0.03, -0.02, 0.0]) * turn(place.rotation_vector());
    let tag = RigShoeTag {
        family: TagFamily::Tag36h11,
        id: 1,
        size_m: 0.06,
        size_sigma_m: None,
        foot_from_tag: place,
        foot_from_tag_covariance: None,
    };
    // The sole that the rig file's placement gives, on level ground.
    let sole = truth * place.inverse();
    let normal = sole.inverse().rotate([0.0, 0.0, 1.0]);
    let sure = |value: f64| Some(Estimate { value, sigma: 1e-4 });
    let error = PlacementError {
        height_m: sure(sole.translation_m()[2]),
        tilt_rad: [sure(normal[1]), sure(-normal[0])],
    };
    let config = PlacementConfig::default();
    let found = corrected(&tag, &error, &config);
    assert!(!found.contradicts);
    let sole = truth * found.foot_from_tag.inverse();
    assert!(sole.translation_m()[2].abs() < 3e-4, "{sole:?}");
    assert!(sole.rotate([0.0, 0.0, 1.0])[2] > 0.999_999, "{sole:?}");

    // More than the tolerance is not believed.
    let high = PlacementError {
        height_m: sure(0.05),
        ..PlacementError::default()
    };
    let found = corrected(&tag, &high, &config);
    assert!(found.contradicts);
    let unchanged = (found.foot_from_tag.inverse() * place).distance_m();
    assert!(unchanged < 1e-12, "{unchanged}");
    // The sole may be as high as the ground says.
    let sigmas = found.uncertain.sigmas();
    assert!(sigmas[2] >= 0.05, "{sigmas:?}");
}

/// A tread of 29 cm between two others: the ground around the sole is no plane, that below it is.
#[test]
fn treads_say_how_high_a_sole_is() {
    let places = (0..60).flat_map(|i| (-30..=30).map(move |j| [i, j]));
    let positions = places.map(|[i, j]| {
        let [x, y] = [0.015 * i as f32, 0.015 * j as f32];
        [x, y, 0.17 * (x / 0.29).floor()]
    });
    let mesh = TerrainMesh {
        positions: positions.collect(),
        ..ground(0.0)
    };
    let mut contact = contacts().remove(0);
    let shift = [0.29 + 0.145, 0.0, 0.17 + 0.02];
    let place = RigidTransform::from_rotation_vector([0.0; 3], shift);
    contact.stance.world_from_foot = place.expect("finite");
    let samples = GroundBelow::new(&mesh).samples(&[contact]);
    let height = samples[0].height_m.expect("a plane");
    assert!((height - 0.02).abs() < 0.002, "{height}");
}

#[test]
fn the_tolerance_of_a_tag_remains_where_the_ground_says_nothing() {
    let tag = RigShoeTag {
        family: TagFamily::Tag36h11,
        id: 0,
        size_m: 0.08,
        size_sigma_m: None,
        foot_from_tag: RigidTransform::from_translation_m([0.05, 0.0, 0.08]).expect("finite"),
        foot_from_tag_covariance: None,
    };
    let config = PlacementConfig::default();
    let sigmas = corrected(&tag, &PlacementError::default(), &config)
        .uncertain
        .sigmas();
    // By its place, and by the tilt about the tag.
    let tilted = |lever_m: f64| lever_m * config.usual_tilt_sigma_rad;
    let height = config.usual_height_sigma_m.hypot(tilted(0.05));
    let along = config.usual_along_sigma_m.hypot(tilted(0.08));
    assert!((sigmas[2] - height).abs() < 1e-9, "{sigmas:?}");
    assert!((sigmas[0] - along).abs() < 1e-9, "{sigmas:?}");
    assert!((sigmas[5] - config.usual_heading_sigma_rad).abs() < 1e-9);
    let known = PlacementError {
        height_m: Some(Estimate {
            value: 0.0,
            sigma: 1e-3,
        }),
        ..PlacementError::default()
    };
    let known = corrected(&tag, &known, &config).uncertain.sigmas();
    assert!(known[2] < sigmas[2], "{known:?}");
}
