//! Collision geometry in readers that are not ours.

use scene_bundle::export::Format;
use serde_json::{Value, json};

use crate::ground;
use crate::ground_interop::{assert_near, exported, numbers, seen};
use crate::sample::{Sample, keyframe_table, rig_model};

#[test]
fn open_usd_sees_colliders_cameras_and_gravity() {
    let sample = Sample::new();
    let path = exported(&sample, Format::Usda, "ground.usda");
    let keyframe = keyframe_table(&rig_model())[0];
    let first_ns = keyframe_table(&rig_model()).iter().map(|k| k.time_ns).min();
    let seconds = 1e-9 * (keyframe.time_ns - first_ns.unwrap()) as f64;
    let camera = &rig_model().cameras[usize::from(keyframe.camera)];
    let at = [0.3, -0.2, 1.5];
    let point = keyframe.world_from_left.apply(at);
    let size = [camera.left.width, camera.left.height];
    let arguments = json!({
        "path": path,
        "points": [[camera.name, seconds, point, size]],
    });
    let Some(seen) = seen("usd", &arguments) else {
        return;
    };
    let pixel = [
        camera.left.fx * at[0] / at[2] + camera.left.cx,
        camera.left.fy * at[1] / at[2] + camera.left.cy,
    ];
    assert_near(&numbers(&seen["pixels"][0]), &pixel, 1e-3, "pixel");
    assert_near(
        &numbers(&seen["gravity"]),
        &[0.0, 0.0, -1.0, 9.81],
        1e-6,
        "gravity",
    );
    assert_colliders(&seen);
}

/// Colliders of a stage are the parts and layers of the sample, and the mesh is none.
fn assert_colliders(seen: &Value) {
    assert_eq!(seen["enabled"], false);
    let shape = ground::collision();
    for (number, part) in shape.parts.iter().enumerate() {
        let own = &seen["colliders"][format!("{}_{number}", part.kind.name())];
        assert_eq!(own["approximation"], "convexHull");
        assert_eq!(own["enabled"], true);
        let corners = part.vertices_m.as_flattened();
        assert_near(&numbers(&own["points"]), corners, 1e-6, "corners");
        assert_eq!(own["indices"], json!(part.triangles.as_flattened()));
    }
    for (number, layer) in shape.layers.iter().enumerate() {
        let own = &seen["colliders"][format!("layer_{number}")];
        assert_eq!(own["approximation"], "none");
        let points = numbers(&own["points"]);
        let mut seen_cells = 0;
        for point in points.chunks(3) {
            // Coordinates of 32 bits.
            let cell = layer.grid.cell([point[0], point[1]]).expect("in the grid");
            let [x, y] = layer.grid.center_m(cell);
            let expected = [x, y, f64::from(layer.heights_m[cell])];
            assert_near(point, &expected, 1e-6, "vertex of a layer");
            seen_cells += 1;
        }
        let known = layer.heights_m.iter().filter(|v| !v.is_nan()).count();
        assert!(seen_cells > 0 && seen_cells <= known);
    }
}

#[test]
fn mujoco_reads_parts_of_the_description_where_they_are() {
    let sample = Sample::new();
    let folder = exported(&sample, Format::Urdf, "urdf");
    let Some(seen) = seen("urdf", &json!(folder.join("scene.urdf"))) else {
        return;
    };
    // All parts are of the world.
    assert_eq!((&seen["bodies"], &seen["joints"]), (&json!(1), &json!(0)));
    let parts = ground::collision().parts;
    assert_eq!(seen["parts"].as_object().unwrap().len(), parts.len());
    for (number, part) in parts.iter().enumerate() {
        let name = format!("{}_{number}", part.kind.name());
        let found = numbers(&seen["parts"][&name]);
        // In any order; a mirrored part would have corners elsewhere.
        for corner in found.chunks(3) {
            let near = |own: &&[f64; 3]| (0..3).all(|k| (own[k] - corner[k]).abs() < 1e-5);
            assert!(
                part.vertices_m.iter().any(|own| near(&own)),
                "{name}: {corner:?}"
            );
        }
        assert_eq!(found.len(), 3 * part.vertices_m.len(), "{name}");
    }
}
