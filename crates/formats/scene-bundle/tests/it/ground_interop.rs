//! Exports of the ground in readers that are not ours: trimesh, MuJoCo, OpenUSD, rosbags, OpenCV
//! with the rule of `map_server`, and tifffile.

use std::path::Path;
use std::process::Command;

use scene_bundle::export::{Format, Options, export};
use scene_bundle::outputs::maps::MapLevel;
use serde_json::{Value, json};

use crate::ground;
use crate::interop::python;
use crate::sample::Sample;

/// What a reader of the script sees, where it can run.
pub(crate) fn seen(reader: &str, arguments: &Value) -> Option<Value> {
    let python = match reader {
        // Not among the packages of the tests, for its size.
        "usd" => match std::env::var_os("PAWS_USD_PYTHON") {
            Some(python) => python.into(),
            None => {
                eprintln!("skipped: PAWS_USD_PYTHON is not set; `cargo xtask bench usd` sets it");
                return None;
            }
        },
        _ => python()?,
    };
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/it/ground_interop_check.py");
    let output = Command::new(python)
        .arg(script)
        .args([reader, &arguments.to_string()])
        .output()
        .expect("start python");
    let errors = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{reader} says: {errors}");
    let seen: Value = serde_json::from_slice(&output.stdout).expect("JSON");
    if let Some(package) = seen.get("absent") {
        eprintln!("skipped: the interpreter of PAWS_PYTHON has no package {package}");
        return None;
    }
    Some(seen)
}

pub(crate) fn exported(sample: &Sample, format: Format, name: &str) -> std::path::PathBuf {
    let out = sample.out(name);
    export(&sample.scene(), format, &Options::default(), &out).unwrap();
    out
}

pub(crate) fn numbers(value: &Value) -> Vec<f64> {
    match value {
        Value::Array(values) => values.iter().flat_map(numbers).collect(),
        Value::Null => vec![f64::NAN],
        Value::String(_) => vec![f64::INFINITY],
        number => vec![number.as_f64().expect("a number")],
    }
}

pub(crate) fn assert_near(found: &[f64], expected: &[f64], tolerance: f64, what: &str) {
    assert_eq!(found.len(), expected.len(), "{what}");
    for (i, (found, expected)) in found.iter().zip(expected).enumerate() {
        let is_near = found == expected
            || found.is_nan() && expected.is_nan()
            || (found - expected).abs() <= tolerance;
        assert!(is_near, "{what}, {i}: {found}, expected {expected}");
    }
}

#[test]
fn trimesh_sees_the_mesh() {
    let sample = Sample::new();
    let arguments = json!({
        "ply": exported(&sample, Format::TerrainPly, "mesh.ply"),
        "obj": exported(&sample, Format::TerrainObj, "mesh.obj"),
        "glb": exported(&sample, Format::TerrainGlb, "mesh.glb"),
    });
    let Some(seen) = seen("trimesh", &arguments) else {
        return;
    };
    let mesh = ground::simplified();
    let of_corners = |values: &[[f64; 3]]| -> Vec<f64> {
        let corners = mesh.triangles.as_flattened().iter();
        corners.flat_map(|i| values[*i as usize]).collect()
    };
    let positions: Vec<[f64; 3]> = mesh.positions.iter().map(|v| v.map(f64::from)).collect();
    let normals: Vec<[f64; 3]> = mesh.normals.iter().map(|v| v.map(f64::from)).collect();
    let y_up = |values: &[[f64; 3]]| -> Vec<[f64; 3]> {
        values.iter().map(|[x, y, z]| [*x, *z, -*y]).collect()
    };
    let colors: Vec<[f64; 3]> = mesh.colors.iter().map(|v| v.map(f64::from)).collect();
    for name in ["ply", "obj", "glb"] {
        let (positions, normals) = match name {
            "glb" => (y_up(&positions), y_up(&normals)),
            _ => (positions.clone(), normals.clone()),
        };
        let of = &seen[name];
        let triangles = numbers(&of["triangles"]);
        // Decimals of OBJ, of 32 bits, are read with 64.
        assert_near(&triangles, &of_corners(&positions), 2e-7, name);
        assert_near(&numbers(&of["normals"]), &of_corners(&normals), 1e-6, name);
        let bound = |k: usize, pick: fn(f64, f64) -> f64| {
            positions.iter().map(|x| x[k]).reduce(pick).unwrap()
        };
        let low = [0, 1, 2].map(|k| bound(k, f64::min));
        let high = [0, 1, 2].map(|k| bound(k, f64::max));
        assert_near(&numbers(&of["bounds"]), &[low, high].concat(), 1e-6, name);
        // Those of glTF are linear, in floating point.
        let srgb = |v: f64| match v {
            v if v <= 0.003_130_8 => 255.0 * 12.92 * v,
            v => 255.0 * (1.055 * v.powf(1.0 / 2.4) - 0.055),
        };
        let found = numbers(&of["colors"]);
        let found: Vec<f64> = match name {
            "glb" => found.into_iter().map(srgb).collect(),
            _ => found,
        };
        // Four decimals in OBJ.
        assert_near(&found, &of_corners(&colors), 1.0, name);
    }
}

#[test]
fn balls_come_to_rest_on_the_ground_in_mujoco() {
    let sample = Sample::new();
    let folder = exported(&sample, Format::Mjcf, "mujoco");
    let layer = ground::terraces();
    let [low, high] = ground::TREADS_M;
    // The lower tread, the upper one, the middles of terraces.
    let terraces = [[0, 0], [2, 0], [3, 1], [1, 2]].map(|[column, row]: [usize; 2]| {
        let cell = (row * 5 + 2) * layer.grid.columns + column * 3 + 1;
        let [x, y] = layer.grid.center_m(cell);
        [x, y, f64::from(layer.heights_m[cell])]
    });
    let mut places = vec![[1.0, 0.5, low], [2.6, 1.4, high]];
    places.extend(terraces);
    let radius = 0.04;
    let drops: Vec<[f64; 3]> = places
        .iter()
        .map(|[x, y, z]| [*x, *y, z + radius + 0.15])
        .collect();
    let beside = [[1.0, 2.9], [2.5, 2.5], [3.5, 1.0], [-0.1, 1.0], [0.3, 2.5]];
    // The last vertex of a terrace and the first one of the next, where a shift would show.
    let corners =
        [([2, 4], -1e-6), ([3, 5], 1e-6)].map(|([column, row], inside): ([usize; 2], _)| {
            let cell = row * layer.grid.columns + column;
            let [x, y] = layer.grid.center_m(cell).map(|v| v + inside);
            [x, y, f64::from(layer.heights_m[cell])]
        });
    // In both triangles between three terraces and the unknown one, which is 1 m below the lowest
    // height: those of the other diagonal have other heights.
    let first = 9 * layer.grid.columns + 8;
    let of_corner = |cell: usize| f64::from(layer.heights_m[cell]);
    let above = of_corner(first + layer.grid.columns);
    let unknown = f64::from(layer.heights_m[0]) - 1.0;
    let between = [([0.75, 0.25], of_corner(first + 1)), ([0.25, 0.75], above)].map(
        |(share, own): ([f64; 2], f64)| {
            let [x, y] = layer.grid.center_m(first);
            let at = [
                x + share[0] * layer.grid.cell_m,
                y + share[1] * layer.grid.cell_m,
            ];
            [
                at[0],
                at[1],
                0.25 * of_corner(first) + 0.5 * own + 0.25 * unknown,
            ]
        },
    );
    let measured = [places.as_slice(), &corners, &between].concat();
    let rays: Vec<[f64; 2]> = measured
        .iter()
        .map(|[x, y, _]| [*x, *y])
        .chain(beside)
        .collect();
    let arguments = json!({
        "model": folder.join("model.xml"),
        "radius": radius,
        "drops": drops,
        "rays": rays,
        "seconds": 3.0,
    });
    let Some(seen) = seen("mujoco", &arguments) else {
        return;
    };
    for (i, [x, y, z]) in places.iter().enumerate() {
        let rest = numbers(&seen["rest"][i]);
        // A ball sinks into a soft contact by less than a millimetre.
        assert_near(&rest[2..], &[z + radius], 1e-3, "height at rest");
        assert_near(&rest[..2], &[*x, *y], 0.01, "place at rest");
        assert!(
            seen["speeds"][i].as_f64().unwrap() < 1e-3,
            "{}",
            seen["speeds"]
        );
    }
    for (i, [_, _, z]) in measured.iter().enumerate() {
        let height = numbers(&seen["rays"][i][0]);
        assert_near(&height, &[*z], 1e-4, "height below a ray");
    }
    let below = |i: usize| seen["rays"][measured.len() + i].as_array().unwrap().clone();
    assert_eq!(below(0)[1], "ground_0");
    for i in 1..4 {
        assert_eq!(
            below(i),
            [json!(null), json!(null)],
            "nothing beside the ground"
        );
    }
    assert_eq!(below(4)[1], "obstacle_3");

    let of_layer = &seen["layers"][0];
    assert_eq!(of_layer["rows"], 15);
    assert_eq!(of_layer["columns"], 12);
    let lowest = layer.heights_m.iter().copied().reduce(f32::min).unwrap();
    let expected: Vec<f64> = layer
        .heights_m
        .iter()
        .map(|v| match v.is_nan() {
            true => f64::from(lowest) - 1.0,
            false => f64::from(*v),
        })
        .collect();
    // Shares of 32 bits of a range of 1.75 m.
    assert_near(&numbers(&of_layer["heights"]), &expected, 1e-6, "heights");
}

#[test]
fn open_usd_sees_the_mesh_and_no_problem() {
    let sample = Sample::new();
    let path = exported(&sample, Format::Usda, "ground.usda");
    let arguments = json!({ "path": path, "points": [] });
    let Some(seen) = seen("usd", &arguments) else {
        return;
    };
    let mesh = ground::simplified();
    assert_eq!(seen["problems"], json!([]));
    assert!(seen["validators"].as_u64() > Some(10));
    assert_eq!((&seen["up"], &seen["metres"]), (&json!("Z"), &json!(1.0)));
    assert_eq!(seen["default"], "/Terrain");
    assert_eq!(
        seen["schemas"],
        json!(["PhysicsCollisionAPI", "PhysicsMeshCollisionAPI"])
    );
    assert_eq!(seen["interpolation"], json!(["vertex", "vertex"]));
    assert_eq!(seen["counts"], json!(vec![3; mesh.triangles.len()]));
    assert_eq!(seen["indices"], json!(mesh.triangles.as_flattened()));
    let flat = |values: &[[f32; 3]]| -> Vec<f64> {
        values
            .as_flattened()
            .iter()
            .map(|v| f64::from(*v))
            .collect()
    };
    assert_eq!(numbers(&seen["points"]), flat(&mesh.positions));
    assert_eq!(numbers(&seen["normals"]), flat(&mesh.normals));
    let low = [0.0, 0.0, ground::TREADS_M[0]];
    let high = [3.0, 3.0, ground::TREADS_M[1]];
    assert_near(
        &numbers(&seen["extent"]),
        &[low, high].concat(),
        1e-6,
        "extent",
    );
    let linear = |v: &u8| ((f64::from(*v) / 255.0 + 0.055) / 1.055).powf(2.4);
    let colors: Vec<f64> = mesh.colors.as_flattened().iter().map(linear).collect();
    // The curve is straight where it is dark, which makes no more of a difference.
    assert_near(&numbers(&seen["colors"]), &colors, 1e-3, "colors");
}

/// Values of cells by their place against those of a layer, each cell once.
fn assert_cells(found: &Value, level: &MapLevel, values: &[f64], what: &str) {
    let grid = &level.grid;
    let mut seen = vec![false; grid.cells()];
    for cell in found.as_array().expect("cells") {
        let [x, y, value] = numbers(cell)[..] else {
            panic!("{what}: {cell}");
        };
        let near = |cell: &usize| {
            let center = grid.center_m(*cell);
            (center[0] - x).abs() < 1e-9 && (center[1] - y).abs() < 1e-9
        };
        let cell = (0..grid.cells()).find(near);
        let cell = cell.unwrap_or_else(|| panic!("{what}: no cell at {x}, {y}"));
        assert!(!seen[cell], "{what}: cell {cell} twice");
        seen[cell] = true;
        assert_near(&[value], &[values[cell]], 0.0, what);
    }
    assert!(seen.iter().all(|seen| *seen), "{what}: a cell is missing");
}

fn widened<T: Copy>(values: &[T]) -> Vec<f64>
where
    f64: From<T>,
{
    values.iter().map(|v| f64::from(*v)).collect()
}

#[test]
fn rosbags_sees_all_layers_as_a_grid_map() {
    let sample = Sample::new();
    let path = exported(&sample, Format::GridMap, "ground.mcap");
    let Some(seen) = seen("rosbags", &json!(path)) else {
        return;
    };
    assert_eq!(seen.as_object().unwrap().len(), 2);
    for (number, level) in ground::levels().iter().enumerate() {
        let of = &seen[format!("/level_{number}")];
        assert_eq!(of["type"], "grid_map_msgs/msg/GridMap");
        // The definitions of the file are those of ROS where it has them.
        let same = of["same"].as_object().unwrap();
        assert!(
            same.len() >= 6 && same.values().all(|same| *same == json!(true)),
            "{same:?}"
        );
        assert_eq!((&of["time"], &of["frame"]), (&json!(0), &json!("map")));
        assert_eq!(of["basic"], json!(["elevation"]));
        assert_eq!(of["start"], json!([0, 0]));
        assert_eq!(of["rotation"], json!([0.0, 0.0, 0.0, 1.0]));
        let layers = &of["layers"];
        assert_eq!(layers.as_object().unwrap().len(), 16);
        for (name, values) in level.numbers() {
            assert_cells(&layers[name], level, &widened(values), name);
        }
        for (k, name) in ["normal_x", "normal_y", "normal_z"].into_iter().enumerate() {
            let values: Vec<f64> = level.normal.iter().map(|n| f64::from(n[k])).collect();
            assert_cells(&layers[name], level, &values, name);
        }
        let mut occupancy = widened(&level.occupancy);
        occupancy
            .iter_mut()
            .filter(|v| **v < 0.0)
            .for_each(|v| *v = f64::NAN);
        assert_cells(&layers["occupancy"], level, &occupancy, "occupancy");
        assert_cells(&layers["views"], level, &widened(&level.views), "views");
        assert_cells(&layers["flags"], level, &widened(&level.flags), "flags");
    }
}

#[test]
fn map_server_reads_unknown_as_unknown() {
    let sample = Sample::new();
    let folder = exported(&sample, Format::MapServer, "maps");
    for (number, level) in ground::levels().iter().enumerate() {
        let path = folder.join(format!("level-{number}.yaml"));
        let Some(seen) = seen("map_server", &json!(path)) else {
            return;
        };
        let occupancy = widened(&level.occupancy);
        if number == 0 {
            let of = |value| occupancy.iter().filter(|v| **v == value).count();
            assert_eq!((of(-1.0), of(0.0), of(100.0)), (6, 87, 3));
        }
        assert_cells(&seen, level, &occupancy, "occupancy");
    }
}

#[test]
fn tifffile_sees_elevations_where_they_are() {
    let sample = Sample::new();
    let folder = exported(&sample, Format::HeightGeotiff, "heights");
    for (number, level) in ground::levels().iter().enumerate() {
        let path = folder.join(format!("level-{number}.tif"));
        let Some(seen) = seen("tifffile", &json!(path)) else {
            return;
        };
        assert_eq!(seen["dtype"], "float32");
        assert_eq!(seen["nodata"].as_str().unwrap().trim(), "nan");
        // User-defined, metres.
        assert_eq!(
            (&seen["model"], &seen["unit"]),
            (&json!(32767), &json!(9001))
        );
        assert_eq!(seen["name"], "world of a scene bundle");
        assert_cells(
            &seen["cells"],
            level,
            &widened(&level.elevation),
            "elevation",
        );
    }
}
