//! The outputs `terrain`, `maps` and `collision`: written and read, and what they refuse.

use scene_bundle::outputs::collision::Collision;
use scene_bundle::outputs::maps::{self, MapLevel};
use scene_bundle::outputs::terrain::{self, MeshDetail, Terrain, TerrainMesh};
use scene_bundle::outputs::{self, collision};
use scene_bundle::verify::verify;
use scene_bundle::{Bundle, BundleError, Draft, OutputReader};

use crate::ground;
use crate::sample::{self, Sample};

#[test]
fn the_ground_reads_back_unchanged() {
    let sample = Sample::new();
    let scene = sample.scene();
    let reader = scene.output(outputs::TERRAIN).unwrap();
    let read = terrain::read(&reader).unwrap();
    assert_eq!(read, ground::terrain());
    let mesh = |detail| terrain::read_mesh(&reader, detail, &read).unwrap();
    assert_eq!(mesh(MeshDetail::Dense), ground::dense());
    assert_eq!(mesh(MeshDetail::Simplified), ground::simplified());

    let reader = scene.output(outputs::MAPS).unwrap();
    let index = maps::read_index(&reader).unwrap();
    assert_eq!(index.levels.len(), 2);
    for (number, expected) in ground::levels().iter().enumerate() {
        let found = maps::read_level(&reader, &index, number).unwrap();
        // As text: NaN is not equal to itself.
        assert_eq!(format!("{found:?}"), format!("{expected:?}"));
    }
    let missing = maps::read_level(&reader, &index, 2).unwrap_err();
    assert!(missing.to_string().contains("level 2 of 2"), "{missing}");

    let reader = scene.output(outputs::COLLISION).unwrap();
    let found = collision::read(&reader).unwrap();
    let expected = ground::collision();
    assert_eq!(format!("{found:?}"), format!("{expected:?}"));
}

#[test]
fn a_sigma_may_be_unknown() {
    let mut mesh = ground::simplified();
    mesh.sigma_m[3] = f32::NAN;
    let (_folder, reader) = committed(|draft| {
        terrain::write(draft, &ground::terrain(), &mesh, &mesh).unwrap();
    });
    let ground = terrain::read(&reader).unwrap();
    let read = terrain::read_mesh(&reader, MeshDetail::Dense, &ground).unwrap();
    assert!(read.sigma_m[3].is_nan() && !read.sigma_m[2].is_nan());
}

#[test]
fn every_layer_is_verified() {
    let sample = Sample::new();
    let scene = sample.scene();
    let reader = scene.output(outputs::MAPS).unwrap();
    let index = maps::read_index(&reader).unwrap();
    // Ten numbers, normal, occupancy, views and flags of two levels, and the index.
    assert_eq!(reader.paths().count(), 2 * 14 + 1);
    for path in reader.paths().filter(|path| path.ends_with(".npy")) {
        let place = reader.file_path(path);
        let bytes = std::fs::read(&place).unwrap();
        let mut changed = bytes.clone();
        *changed.last_mut().unwrap() ^= 1;
        std::fs::write(&place, changed).unwrap();
        let level = usize::from(path.starts_with("level-1/"));
        let error = maps::read_level(&reader, &index, level).unwrap_err();
        assert!(error.to_string().ends_with(path), "{error}");
        assert!(!verify(&scene, |_| {}).unwrap().is_whole(), "{path}");
        std::fs::write(&place, bytes).unwrap();
    }
    assert!(verify(&scene, |_| {}).unwrap().is_whole());
}

/// The error of a write into a new draft.
fn refused(write: impl FnOnce(&Draft) -> Result<(), BundleError>) -> String {
    let folder = tempfile::tempdir().unwrap();
    let bundle = Bundle::create_or_open(&folder.path().join("a"), sample::provenance()).unwrap();
    let draft = bundle.begin("x").unwrap();
    let error = write(&draft).unwrap_err();
    assert!(matches!(error, BundleError::Refused { .. }), "{error}");
    error.to_string()
}

/// An output with files of any content.
fn committed(write: impl FnOnce(&Draft)) -> (tempfile::TempDir, OutputReader) {
    let folder = tempfile::tempdir().unwrap();
    let bundle = Bundle::create_or_open(&folder.path().join("a"), sample::provenance()).unwrap();
    let draft = bundle.begin("x").unwrap();
    write(&draft);
    draft.commit(sample::record("x")).unwrap();
    let reader = bundle.scene().output("x").unwrap();
    (folder, reader)
}

#[test]
fn a_terrain_outside_the_format_is_refused() {
    type Change = fn(&mut Terrain, &mut TerrainMesh);
    let cases: [(Change, &str); 13] = [
        (|t, _| t.voxel_m = 0.0, "voxel_m: 0 m"),
        (
            |t, _| t.planes[1].center_m[2] = f64::NAN,
            "plane 1: a number that is NaN",
        ),
        (
            |t, _| t.planes[0].normal = [0.0, 0.0, -1.0],
            "plane 0: axes",
        ),
        (
            |t, _| t.planes[2].axes[0] = [2.0, 0.0, 0.0],
            "plane 2: axes",
        ),
        (
            |t, _| t.planes[0].polygons[0].holes_m[0].truncate(2),
            "an outline of 2 corners",
        ),
        (|t, _| t.edges[0].planes.1 = Some(3), "edge 0: plane 3 of 3"),
        (
            |t, _| t.edges[0].step.as_mut().unwrap().below = 7,
            "edge 0: plane 7 of 3",
        ),
        (
            |t, _| t.edges[2].sigma_m = -0.1,
            "edge 2: a standard deviation or area of -0.1",
        ),
        (
            |_, m| m.positions[5][1] = f32::INFINITY,
            "vertex 5: position",
        ),
        (
            |_, m| m.sigma_m[4] = f32::INFINITY,
            "vertex 4: a sigma of inf",
        ),
        (|_, m| m.planes[2] = Some(3), "vertex 2: plane 3 of 3"),
        (
            |_, m| m.triangles[1][2] = 12,
            "triangle 1: [0, 2, 12] of 12 vertices",
        ),
        (|_, m| m.colors.truncate(11), "11 colors of 12 positions"),
    ];
    for (change, expected) in cases {
        let (mut terrain, mut mesh) = (ground::terrain(), ground::simplified());
        change(&mut terrain, &mut mesh);
        let error = refused(|draft| terrain::write(draft, &terrain, &ground::dense(), &mesh));
        assert!(error.contains(expected), "{error}");
    }
}

#[test]
fn maps_outside_the_format_are_refused() {
    type Change = fn(&mut MapLevel);
    let cases: [(Change, &str, &str); 13] = [
        (
            |l| l.grid.cell_m = f64::NAN,
            "level 1: cells of NaN m",
            "maps.json",
        ),
        (
            |l| l.grid.columns = 65_536,
            "level 1: 65536 columns",
            "maps.json",
        ),
        (|l| l.step.truncate(5), "5 values of 6 cells", "step.npy"),
        (
            |l| l.normal.truncate(5),
            "5 values of 6 cells",
            "normal.npy",
        ),
        (
            |l| l.elevation[2] = f32::INFINITY,
            "cell 2: inf",
            "elevation.npy",
        ),
        (|l| l.sigma[1] = -0.1, "cell 1: -0.1", "sigma.npy"),
        (
            |l| l.traversability[1] = 1.1,
            "cell 1: 1.1",
            "traversability.npy",
        ),
        (
            |l| l.clearance[1] = f32::NEG_INFINITY,
            "cell 1: -inf",
            "clearance.npy",
        ),
        (
            |l| l.normal[3][0] = f32::INFINITY,
            "cell 3: [inf",
            "normal.npy",
        ),
        (|l| l.flags[3] = 65, "cell 3: 65", "flags.npy"),
        (
            |l| l.flags[3] = maps::EDGE,
            "an elevation where the flags",
            "flags.npy",
        ),
        (|l| l.occupancy[0] = 50, "cell 0: 50", "occupancy.npy"),
        (
            |l| (l.flags[4], l.elevation[4]) = (0, f32::NAN),
            "cell 4: 0, expected an elevation of a free cell",
            "occupancy.npy",
        ),
    ];
    for (change, expected, file) in cases {
        let mut levels = ground::levels();
        change(&mut levels[1]);
        let error = refused(|draft| maps::write(draft, &levels));
        assert!(error.contains(expected) && error.ends_with(file), "{error}");
    }
}

#[test]
fn collision_geometry_outside_the_format_is_refused() {
    type Change = fn(&mut Collision);
    let cases: [(Change, &str); 6] = [
        (
            |c| c.parts[1].vertices_m[3][0] = f64::NAN,
            "part 1: a vertex that is not finite",
        ),
        (|c| c.parts[3].triangles[0][1] = 4, "part 3: vertex 4 of 4"),
        (
            |c| c.parts[3].vertices_m.truncate(3),
            "part 3: 3 vertices and 4 triangles",
        ),
        (
            |c| c.layers[0].heights_m.truncate(179),
            "heights: 179 of 180 cells",
        ),
        (
            |c| c.layers[0].heights_m[7] = f32::INFINITY,
            "cell 7: inf m",
        ),
        (
            |c| c.report.height_errors.p95_m = f64::NAN,
            "report: a number that is NaN",
        ),
    ];
    for (change, expected) in cases {
        let mut collision = ground::collision();
        change(&mut collision);
        let error = refused(|draft| collision::write(draft, &collision));
        assert!(error.contains(expected), "{error}");
    }
}

#[test]
fn files_outside_the_format_are_malformed() {
    let sample = Sample::new();
    let scene = sample.scene();
    let text = |output: &str, file: &str| {
        let bytes = scene.output(output).unwrap().read(file).unwrap();
        String::from_utf8(bytes).unwrap()
    };
    let message = |error: BundleError| {
        assert!(matches!(error, BundleError::Malformed { .. }), "{error}");
        error.to_string()
    };
    let terrain_json = text(outputs::TERRAIN, "terrain.json");
    for (from, to, expected) in [
        (
            r#""voxel_m":0.02"#,
            r#""voxel_m":1e999"#,
            "number out of range",
        ),
        (
            r#""kind":"end""#,
            r#""kind":"edge""#,
            "unknown variant `edge`",
        ),
        (
            r#""planes":[2,1]"#,
            r#""planes":[2,9]"#,
            "edge 0: found plane 9 of 3",
        ),
        (r#""planes":[2,1]"#, r#""planes":[-2,1]"#, "invalid value"),
        (
            r#"{"voxel_m""#,
            r#"{"more":1,"voxel_m""#,
            "unknown field `more`",
        ),
    ] {
        let changed = terrain_json.replacen(from, to, 1);
        assert_ne!(changed, terrain_json, "{from}");
        let (_folder, reader) =
            committed(|draft| draft.write("terrain.json", changed.as_bytes()).unwrap());
        let error = message(terrain::read(&reader).unwrap_err());
        assert!(error.contains(expected), "{error}");
    }
    let mesh = scene
        .output(outputs::TERRAIN)
        .unwrap()
        .read("mesh.ply")
        .unwrap();
    let (_folder, reader) = committed(|draft| {
        draft
            .write("terrain.json", terrain_json.as_bytes())
            .unwrap();
        draft.write("mesh.ply", &mesh[..mesh.len() - 1]).unwrap();
        let mut changed = mesh.clone();
        // The last index becomes negative.
        *changed.last_mut().unwrap() = 0xff;
        draft.write("mesh-simplified.ply", &changed).unwrap();
    });
    let terrain = terrain::read(&reader).unwrap();
    let error = |detail| message(terrain::read_mesh(&reader, detail, &terrain).unwrap_err());
    let short = error(MeshDetail::Dense);
    assert!(
        short.contains("bytes for 15 vertices and 7 faces"),
        "{short}"
    );
    let outside = error(MeshDetail::Simplified);
    assert!(outside.contains("triangle 6: found [12, 13,"), "{outside}");

    // A grid of 4 billion cells takes no memory.
    let huge = r#"{"levels":[{"cell_m":0.04,"origin_m":[0,0],"columns":65535,"rows":65535}]}"#;
    let (_folder, reader) = committed(|draft| {
        draft.write("maps.json", huge.as_bytes()).unwrap();
        let layer = scene.output(outputs::MAPS).unwrap();
        let layer = layer.read("level-0/elevation.npy").unwrap();
        draft.write("level-0/elevation.npy", &layer).unwrap();
    });
    let index = maps::read_index(&reader).unwrap();
    let error = message(maps::read_level(&reader, &index, 0).unwrap_err());
    assert!(
        error.contains("(8,12)") && error.contains("(65535,65535)"),
        "{error}"
    );

    let json = text(outputs::COLLISION, "collision.json");
    for (from, to, expected) in [
        (
            r#""triangles":[[0,2,1]"#,
            r#""triangles":[[0,2,8]"#,
            "part 3: found vertex 8 of 4",
        ),
        (
            r#""rows":15"#,
            r#""rows":0"#,
            "layer 0: found 12 columns and 0 rows",
        ),
        (r#""rows":15"#, r#""rows":14"#, "header: found"),
    ] {
        let changed = json.replacen(from, to, 1);
        assert_ne!(changed, json, "{from}");
        let (_folder, reader) = committed(|draft| {
            draft.write("collision.json", changed.as_bytes()).unwrap();
            let layer = scene
                .output(outputs::COLLISION)
                .unwrap()
                .read("layer-0.npy");
            draft.write("layer-0.npy", &layer.unwrap()).unwrap();
        });
        let error = message(collision::read(&reader).unwrap_err());
        assert!(error.contains(expected), "{error}");
    }
}
