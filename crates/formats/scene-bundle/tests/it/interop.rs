//! What this crate writes in readers that are not ours: NumPy, plyfile, laspy, pycolmap and OpenCV.

use std::path::{Path, PathBuf};
use std::process::Command;

use scene_bundle::export::{Format, Options, export};
use serde_json::{Value, json};

use crate::sample::{self, Sample};

/// The interpreter with the packages, where there is one.
pub(crate) fn python() -> Option<PathBuf> {
    let found = std::env::var_os("PAWS_PYTHON").map(PathBuf::from);
    if found.is_none() {
        eprintln!(
            "skipped: PAWS_PYTHON names no interpreter with the packages of crates/dev/xtask/interop-requirements.txt"
        );
    }
    found
}

#[test]
fn other_readers_see_the_same() {
    let Some(python) = python() else {
        return;
    };
    let sample = Sample::new();
    let scene = sample.scene();
    let options = Options::default();
    let exports: Vec<(&str, PathBuf)> = [
        Format::Tum,
        Format::Ply,
        Format::Las,
        Format::Laz,
        Format::ColmapText,
        Format::ColmapBinary,
    ]
    .into_iter()
    .map(|format| {
        let extension = if format == Format::Tum {
            "txt"
        } else {
            format.name()
        };
        let out = sample.out(&format!("export.{extension}"));
        export(&scene, format, &options, &out).unwrap();
        (format.name(), out)
    })
    .collect();
    let place = |output: &str, file: &str| scene.output(output).unwrap().file_path(file);
    let mut arguments = json!({
        "trajectory": place("trajectory", "trajectory.npy"),
        "keyframes": place("keyframes", "keyframes.npy"),
        "depth": place("depth", "feet/depth/1000010.png"),
        "sigma": place("depth", "feet/sigma/1000010.png"),
    });
    for (name, out) in &exports {
        arguments[*name] = json!(out);
    }
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/it/interop_check.py");
    let output = Command::new(python)
        .arg(script)
        .arg(arguments.to_string())
        .output()
        .expect("start python");
    let errors = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "the Python readers say: {errors}");
    let seen: Value = serde_json::from_slice(&output.stdout).expect("JSON");

    let walk = sample::walk(0.0);
    let table = &seen["trajectory"];
    assert_eq!(
        table["names"],
        json!([
            "time_ns",
            "position_m",
            "rotation_wxyz",
            "velocity_m_s",
            "covariance",
            "status",
            "has_velocity",
            "has_covariance"
        ])
    );
    assert_eq!(table["rows"].as_array().unwrap().len(), walk.len());
    for (row, pose) in table["rows"].as_array().unwrap().iter().zip(walk.poses()) {
        assert_eq!(row[0], pose.time_ns);
        assert_eq!(row[1], json!(pose.world_from_rig.translation_m()));
        assert_eq!(row[2], json!(pose.world_from_rig.rotation_wxyz()));
        // NaN becomes null in JSON.
        let velocity = pose
            .velocity_in_world
            .map_or(json!([null, null, null]), |v| json!(v));
        assert_eq!(row[3], velocity);
        if let Some(covariance) = &pose.covariance {
            let rows = covariance.rows();
            // np.triu_indices(6) gives the order of the upper triangle, rows first.
            assert_eq!(row[4], json!(rows));
        }
        assert_eq!(row[5], pose.status.code());
        assert_eq!(row[6], pose.velocity_in_world.is_some());
        assert_eq!(row[7], pose.covariance.is_some());
    }
    let mut keyframes = sample::keyframe_table(&sample::rig_model());
    keyframes.sort_by_key(|k| (k.camera, k.time_ns));
    for (row, keyframe) in seen["keyframes"].as_array().unwrap().iter().zip(&keyframes) {
        assert_eq!(
            *row,
            json!([
                keyframe.set,
                keyframe.frame,
                keyframe.time_ns,
                keyframe.camera
            ])
        );
    }

    let poses: Vec<Value> = walk
        .usable()
        .map(|p| {
            let [w, x, y, z] = p.world_from_rig.rotation_wxyz();
            json!([p.world_from_rig.translation_m(), [x, y, z, w]])
        })
        .collect();
    assert_eq!(seen["tum"], json!(poses));

    let stored = sample::depth_image(1_000_010);
    assert_eq!(
        seen["depth"],
        json!({ "dtype": "uint16", "shape": [40, 60], "values": stored.depth })
    );
    assert_eq!(
        seen["sigma"],
        json!({ "dtype": "uint16", "shape": [40, 60], "values": stored.sigma })
    );

    let points = sample::points();
    for name in ["ply", "las", "laz"] {
        let rows = seen[name].as_array().unwrap();
        assert_eq!(rows.len(), points.len(), "{name}");
        for (row, point) in rows.iter().zip(&points) {
            let number = |i: usize| row[i].as_f64().unwrap();
            for (i, expected) in point.x_in_world.into_iter().enumerate() {
                // Exact in PLY, half a step of 0.1 mm in LAS.
                let tolerance = if name == "ply" { 0.0 } else { 0.5e-4 + 1e-9 };
                assert!(
                    (number(i) - f64::from(expected)).abs() <= tolerance,
                    "{name}"
                );
            }
            let spread = if name == "ply" { 1.0 } else { 257.0 };
            for (i, expected) in point.color.into_iter().enumerate() {
                assert_eq!(number(3 + i), f64::from(expected) * spread, "{name}");
            }
        }
    }

    let rig = sample::rig_model();
    for name in ["colmap-text", "colmap-binary"] {
        let images = seen[name]["images"].as_array().unwrap();
        assert_eq!(images.len(), 6, "{name}");
        for image in images {
            let (camera, file) = image["name"]
                .as_str()
                .unwrap()
                .rsplit_once("/left/")
                .unwrap();
            let (place, model) = rig.camera(camera).unwrap();
            let frame: u64 = file.trim_end_matches(".png").parse().unwrap();
            let keyframe = keyframes
                .iter()
                .find(|k| (usize::from(k.camera), k.frame) == (place, frame))
                .unwrap();
            // A point two metres in front of the camera: pycolmap projects it from the world into
            // the image.
            let x_in_left = [0.2, -0.1, 2.0];
            let x_in_world = keyframe.world_from_left.apply(x_in_left);
            let expected = camera_models::Lens::new(&model.left)
                .project(x_in_left)
                .unwrap();
            let rows = &image["camera_from_world"];
            let entry = |i: usize, j: usize| rows[i][j].as_f64().unwrap();
            let x_in_camera: [f64; 3] = std::array::from_fn(|i| {
                (0..3).map(|j| entry(i, j) * x_in_world[j]).sum::<f64>() + entry(i, 3)
            });
            for (found, expected) in x_in_camera.into_iter().zip(x_in_left) {
                assert!((found - expected).abs() < 1e-12, "{name}");
            }
            // Projection of [0.1, -0.05, 1] in COLMAP's coordinates, half a pixel from ours.
            for (i, expected) in expected.into_iter().enumerate() {
                let found = image["projected"][i].as_f64().unwrap();
                assert!(
                    (found - 0.5 - expected).abs() < 1e-9,
                    "{name}: {found} {expected}"
                );
            }
        }
        assert_eq!(seen[name]["points"], 500);
        assert_eq!(
            seen[name]["first_point"],
            json!([f64::from(points[0].x_in_world[0]), points[0].color])
        );
    }
}
