use super::*;
use crate::camera::TEST_CAMERA;
use crate::scene::body::Body;
use crate::scene::mesh::{Mesh, Stuff};
use crate::scene::{Kind, by_day};

/// A plate of 0.5 m, 1 m ahead, moves to the right by 0.1 m/s in front of a static room.
#[test]
fn flow_follows_moving_surfaces_and_marks_occlusions() {
    let scene = by_day(Kind::Room, 1);
    let model = TEST_CAMERA;
    let turn = UnitQuaternion::from_basis_unchecked(&[-Vector3::y(), -Vector3::z(), Vector3::x()]);
    let eye_at = Vector3::new(2.0, 3.5, 1.2);
    let eye_pose = |_: f64| (eye_at, turn);
    let mut mesh = Mesh::default();
    let stuff = Stuff {
        material: 0,
        instance: 77,
    };
    let size = Vector3::new(0.02, 0.5, 0.5);
    mesh.cuboid(
        Vector3::new(0.01, 0.0, 0.0),
        size,
        UnitQuaternion::identity(),
        1.0,
        stuff,
    );
    let plate = Body::new(&mesh, &vec![[1.0; 3]; mesh.triangles.len()]);
    let slides = |t: f64| {
        let at = eye_at + Vector3::new(1.0, -0.1 * t, 0.0);
        (at, UnitQuaternion::identity())
    };
    let fixed = SceneBody {
        body: &scene.fixed,
        first: 0,
        pose: &Still,
    };
    let placed = [
        fixed,
        SceneBody {
            body: &plate,
            first: fixed.next(),
            pose: &slides,
        },
    ];
    let mut eye = TruthCamera::new(&model, Shutter::Global);
    let from = eye.render(&scene, &placed, &eye_pose, 0.0);
    let to = eye.render(&scene, &placed, &eye_pose, 1.0);
    let flow = eye.flow(&scene, &placed, &from, &to);
    let (mut on_plate, mut hidden) = (0, 0);
    for (i, [du, dv]) in flow.flow_px.iter().enumerate() {
        let column = i % 160;
        if from.instance[i] == 77 {
            on_plate += 1;
            assert!(
                (du - 10.0).abs() < 1e-4 && dv.abs() < 1e-4,
                "{i}: {du} {dv}"
            );
            assert!(flow.shown[i], "{i}");
            assert!((from.depth[i] - 1.0).abs() < 1e-6);
        } else {
            assert!(du.abs().max(dv.abs()) < 1e-4, "{i}: {du} {dv}");
            assert_eq!(flow.shown[i], to.instance[i] != 77, "{column}");
            hidden += usize::from(!flow.shown[i]);
        }
    }
    // 50 x 50 pixels, of which ten columns are new.
    assert_eq!((on_plate, hidden), (2500, 500));

    // A point that leaves the image has flow, but is not visible.
    let late = eye.render(&scene, &placed, &eye_pose, 5.6);
    let flow = eye.flow(&scene, &placed, &from, &late);
    let right_edge = 59 * 160 + 104;
    assert_eq!(from.instance[right_edge], 77);
    assert!((flow.flow_px[right_edge][0] - 56.0).abs() < 1e-3);
    assert!(!flow.shown[right_edge]);
    // Far outside the image the lens model is undefined.
    let left = eye.render(&scene, &placed, &eye_pose, 20.0);
    let flow = eye.flow(&scene, &placed, &from, &left);
    assert!(flow.flow_px[right_edge][0].is_nan() && !flow.shown[right_edge]);
}
