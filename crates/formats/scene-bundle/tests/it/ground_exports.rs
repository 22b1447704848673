//! Exports of the ground: what they cannot hold, and where there is nothing to hold.

use scene_bundle::export::{ExportError, Format, Options, Summary, export};
use scene_bundle::outputs::collision::{Collision, CollisionReport, HeightLayer};
use scene_bundle::outputs::terrain::{Terrain, TerrainMesh};
use scene_bundle::outputs::{self, collision, maps, terrain};
use scene_bundle::{Bundle, Draft, Scene};
use serde_json::Value;

use crate::ground;
use crate::sample::{self, Sample};

const FORMATS: [Format; 9] = [
    Format::TerrainPly,
    Format::TerrainObj,
    Format::TerrainGlb,
    Format::Usda,
    Format::MapServer,
    Format::GridMap,
    Format::HeightGeotiff,
    Format::Mjcf,
    Format::Urdf,
];

/// A bundle of one output.
fn bundle(output: &str, write: impl FnOnce(&Draft)) -> (tempfile::TempDir, Scene) {
    let folder = tempfile::tempdir().unwrap();
    let bundle = Bundle::create_or_open(&folder.path().join("a"), sample::provenance()).unwrap();
    let draft = bundle.begin(output).unwrap();
    write(&draft);
    draft.commit(sample::record(output)).unwrap();
    let scene = bundle.scene();
    (folder, scene)
}

fn exported(scene: &Scene, format: Format, out: &std::path::Path) -> Summary {
    export(scene, format, &Options::default(), out).unwrap()
}

#[test]
fn every_export_says_what_it_leaves_out() {
    let sample = Sample::new();
    for (format, expected) in FORMATS.into_iter().zip([
        "",
        "sigma, views and planes of vertices cannot be represented in OBJ",
        "y is up in glTF: x, y, z of the world are written as x, z, -y",
        "sigma, views and planes of vertices cannot be represented in this USD mesh",
        "map-server has occupancy only",
        "unknown occupancy to not-a-number",
        "height-geotiff has elevations only",
        "unknown cells are 1 m below the lowest known one",
        "URDF has no height fields",
    ]) {
        let summary = exported(&sample.scene(), format, &sample.out(format.name()));
        let has = |note: &String| note.contains(expected);
        assert!(
            expected.is_empty() || summary.notes.iter().any(has),
            "{}: {summary:?}",
            format.name()
        );
        assert!(summary.lost.is_empty(), "{summary:?}");
    }
    let ply = std::fs::read(sample.out("terrain-ply")).unwrap();
    let reader = sample.scene().output(outputs::TERRAIN).unwrap();
    assert_eq!(ply, reader.read("mesh-simplified.ply").unwrap());
}

#[test]
fn a_bundle_without_the_ground_is_refused() {
    let (folder, scene) = bundle("notes", |draft| draft.write("a.txt", b"a").unwrap());
    for format in FORMATS {
        let out = folder.path().join("out");
        let error = export(&scene, format, &Options::default(), &out).unwrap_err();
        assert!(matches!(error, ExportError::Bundle(_)), "{error}");
        assert!(!out.exists() && !folder.path().join("out.partial").exists());
    }
}

#[test]
fn ground_that_nobody_saw_is_exported_empty() {
    let empty = Terrain {
        voxel_m: 0.02,
        planes: Vec::new(),
        edges: Vec::new(),
    };
    let none = TerrainMesh::default();
    let (folder, scene) = bundle(outputs::TERRAIN, |draft| {
        terrain::write(draft, &empty, &none, &none).unwrap();
    });
    let out = |name: &str| folder.path().join(name);
    for format in [Format::TerrainObj, Format::TerrainPly, Format::Usda] {
        exported(&scene, format, &out(format.name()));
    }
    exported(&scene, Format::TerrainGlb, &out("glb"));
    let bytes = std::fs::read(out("glb")).unwrap();
    let length = u32::from_le_bytes(bytes[8..12].try_into().unwrap());
    assert_eq!(length as usize, bytes.len());
    let content: Value = serde_json::from_slice(&bytes[20..]).unwrap();
    // No mesh: the standard has no accessors of nothing.
    assert!(content.get("meshes").is_none() && content["scenes"][0] == serde_json::json!({}));

    let (folder, scene) = bundle(outputs::MAPS, |draft| maps::write(draft, &[]).unwrap());
    for format in [Format::MapServer, Format::GridMap, Format::HeightGeotiff] {
        let summary = exported(&scene, format, &folder.path().join(format.name()));
        assert!(summary.description.ends_with("0 levels"), "{summary:?}");
    }
}

#[test]
fn mujoco_gets_no_flat_part_and_no_line_of_heights() {
    let mut flat = ground::collision().parts.swap_remove(3);
    for vertex in &mut flat.vertices_m {
        vertex[2] = 0.1;
    }
    let layer = ground::terraces();
    let columns = layer.grid.columns;
    let line = HeightLayer {
        grid: scene_bundle::outputs::grid::Grid {
            rows: 1,
            ..layer.grid
        },
        heights_m: layer.heights_m[..columns].to_vec(),
    };
    let unseen = HeightLayer {
        heights_m: vec![f32::NAN; layer.grid.cells()],
        ..layer
    };
    let mut parts = ground::collision().parts;
    parts.insert(1, flat);
    let geometry = Collision {
        parts,
        layers: vec![line, unseen, ground::terraces()],
        report: CollisionReport::default(),
    };
    let (folder, scene) = bundle(outputs::COLLISION, |draft| {
        collision::write(draft, &geometry).unwrap();
    });
    let out = folder.path().join("mujoco");
    let summary = exported(&scene, Format::Mjcf, &out);
    assert_eq!(summary.description, "4 convex parts and 1 height fields");
    assert_eq!(summary.lost.len(), 2, "{summary:?}");
    assert!(summary.lost[0].starts_with("layer 0 of 12 by 1 cells"));
    assert!(summary.lost[1].starts_with("part 1 of "));
    let names: Vec<String> = sample::files(&out).into_keys().collect();
    assert_eq!(names, ["layer-2.bin", "model.xml"]);
    let model = std::fs::read_to_string(out.join("model.xml")).unwrap();
    assert!(
        model.contains("ground_0") && !model.contains("part_1"),
        "{model}"
    );
    let heights = std::fs::read(out.join("layer-2.bin")).unwrap();
    assert_eq!(heights.len(), 8 + 4 * 180);
    assert_eq!(heights[..8], [15, 0, 0, 0, 12, 0, 0, 0]);
}
