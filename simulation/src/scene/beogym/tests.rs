use std::path::PathBuf;

use gaussians::files::ply;
use gaussians::{Plane, Splats};
use scene_bundle::outputs::maps::{FREE, MapLevel, OCCUPIED, UNKNOWN};

use super::*;
use crate::testing;

/// A made-up folder of generation 1, whose second sector is 10 m away.
struct Folder {
    folder: tempfile::TempDir,
}

impl Folder {
    fn new() -> Self {
        let folder = tempfile::tempdir().unwrap();
        testing::beogym::write(folder.path(), 10.0).unwrap();
        Self { folder }
    }

    fn path(&self) -> &Path {
        self.folder.path()
    }

    fn open(&self) -> Result<SceneData, SimulationError> {
        SceneData::open_beogym(self.path(), &BeogymConfig::default())
    }

    /// The error after a file was changed.
    fn error(&self, file: &str, content: &[u8]) -> String {
        fs::write(self.path().join(file), content).unwrap();
        let error = self.open().unwrap_err();
        assert!(matches!(error, SimulationError::Scene { .. }), "{error}");
        let text = error.to_string();
        let name = PathBuf::from(file);
        assert!(
            text.contains(&*name.file_name().unwrap().to_string_lossy()),
            "{text}"
        );
        text
    }
}

fn level(scene: &SceneData, number: usize) -> &MapLevel {
    &scene.sectors[0].levels.as_ref().unwrap()[number]
}

#[test]
fn sectors_are_carried_into_a_world_with_z_up() {
    let folder = Folder::new();
    let scene = folder.open().unwrap();
    assert_eq!(scene.sectors.len(), 2);
    assert!(scene.missing().is_empty(), "{:?}", scene.missing());
    let gaussians = scene.sectors[1].gaussians.as_ref().unwrap().load().unwrap();
    // By hand: R (0, 0, 2) + t = (12, -0.5, 3) in the LiDAR frame, (12, -3, -0.5) with z up.
    let expected = [12.0, -3.0, -0.5];
    for (k, expected) in expected.into_iter().enumerate() {
        let found = gaussians.splats.planes()[Plane::POSITION + k][1];
        assert!((found - expected).abs() < 1e-5, "{k}: {found} {expected}");
    }
    // So are the cameras: forward, z of the sector, is x of the world.
    let pose = scene.sectors[1].references[1];
    assert!((pose.translation_m()[0] - 12.0).abs() < 1e-6, "{pose:?}");
    let forward = pose.rotate([0.0, 0.0, 1.0]);
    assert!((forward[0] - 1.0).abs() < 1e-6, "{forward:?}");
    // Areas are 0..2 and 10..12 m with margins of 3 m: they do not meet, so there is no edge.
    assert!(scene.sectors.iter().all(|sector| sector.edges.is_empty()));
    let config = BeogymConfig {
        margin_m: 4.5,
        ..BeogymConfig::default()
    };
    let wide = SceneData::open_beogym(folder.path(), &config).unwrap();
    let edges: Vec<usize> = wide
        .sectors
        .iter()
        .flat_map(|s| &s.edges)
        .map(|e| e.to)
        .collect();
    assert_eq!(edges, [1, 0]);
    // They meet in the middle.
    assert!(wide.leaves(0, [5.9, -3.0, 0.0]).is_none());
    assert_eq!(wide.leaves(0, [6.2, -3.0, 0.0]).unwrap().to, 1);
}

#[test]
fn maps_keep_holes_walls_and_both_heights_of_a_bridge() {
    let folder = Folder::new();
    let scene = folder.open().unwrap();
    // y of the world is -z of the LiDAR frame.
    let cell = |x: f64, z: f64| level(&scene, 0).grid.cell([x, -z]).unwrap();
    let ground = level(&scene, 0);
    assert!((ground.elevation[cell(1.0, 1.0)] + 1.5).abs() < 1e-6);
    assert_eq!(ground.occupancy[cell(1.0, 1.0)], FREE);
    assert_eq!(ground.occupancy[cell(4.5, 4.5)], UNKNOWN);
    assert_eq!(ground.occupancy[cell(2.1, 3.0)], OCCUPIED);
    let below = cell(7.0, 2.0);
    assert_eq!(ground.occupancy[below], FREE);
    assert!((ground.clearance[below] - 3.0).abs() < 1e-5);
    let bridge = level(&scene, 1);
    assert!((bridge.elevation[below] - 1.5).abs() < 1e-6);
    assert_eq!(bridge.occupancy[cell(1.0, 1.0)], UNKNOWN);
}

#[test]
fn binary_and_ascii_maps_are_the_same() {
    let folder = Folder::new();
    let ascii = folder.open().unwrap();
    fs::write(
        folder.path().join("surfaceMap.pcd"),
        testing::beogym::map("binary"),
    )
    .unwrap();
    assert_eq!(ascii.hash(), folder.open().unwrap().hash());
    let error = folder.error("surfaceMap.pcd", &testing::beogym::map("binary_compressed"));
    assert!(error.contains("pcl_convert_pcd_ascii_binary"), "{error}");
    let half = testing::beogym::map("binary");
    let error = folder.error("surfaceMap.pcd", &half[..half.len() / 2]);
    assert!(error.contains("points"), "{error}");
}

#[test]
fn transforms_as_printed_are_checked() {
    let file = "sec1/transformation.txt";
    for (text, expected) in [
        ("[[1 0 0]\n [0 1 0]\n [0 0 -1]\n [0 0 0]]", "not mirrored"),
        ("[[1 0 0]\n [0 2 0]\n [0 0 1]\n [0 0 0]]", "not orthonormal"),
        ("[[1 0 0]\n [0 1 0]\n [0 0 1]]", "9 numbers"),
        ("[[1 0 0]\n ...\n [0 0 0]]", "abbreviated"),
        (
            "[[nan 0 0]\n [0 1 0]\n [0 0 1]\n [0 0 0]]",
            "\"nan\" as number 0",
        ),
    ] {
        let error = Folder::new().error(file, text.as_bytes());
        assert!(error.contains(expected), "{error}");
    }
    // A scaled rotation is one of structure from motion.
    let folder = Folder::new();
    fs::write(
        folder.path().join(file),
        "[[2 0 0] [0 2 0] [0 0 2] [0 0 0]]",
    )
    .unwrap();
    let scene = folder.open().unwrap();
    let gaussians = scene.sectors[0].gaussians.as_ref().unwrap().load().unwrap();
    let planes = gaussians.splats.planes();
    // y up to z up: z = 2 becomes y = -4.
    assert!((planes[Plane::POSITION + 1][1] + 4.0).abs() < 1e-5);
    assert!((libm::expf(planes[Plane::SCALE][0]) - 0.2).abs() < 1e-5);
}

#[test]
fn damaged_gaussians_are_named_with_their_index() {
    let file = "sec2/point_cloud.ply";
    let bytes = fs::read(Folder::new().path().join(file)).unwrap();
    let body = bytes.len() - 2 * 4 * 26;
    let mut nan = bytes.clone();
    // x of Gaussian 1 of 26 numbers each.
    let at = body + 4 * 26;
    nan[at..at + 4].copy_from_slice(&f32::NAN.to_le_bytes());
    let mut zero = bytes.clone();
    zero[at + 4 * 22..at + 4 * 26].fill(0);
    let empty = ply::write(&Splats::empty(1).unwrap(), false);
    let points = b"ply\nformat binary_little_endian 1.0\nelement vertex 0\nproperty float x\n\
                   property float y\nproperty float z\nend_header\n";
    for (content, expected) in [
        (nan.as_slice(), "Gaussian 1"),
        (zero.as_slice(), "rotation of Gaussian 1"),
        (empty.as_slice(), "0 Gaussians"),
        (&bytes[..bytes.len() - 7], "bytes, expected"),
        (points.as_slice(), "Open3D saved"),
    ] {
        let error = Folder::new().error(file, content);
        assert!(error.contains(expected), "{error}");
    }
}

#[test]
fn the_same_file_in_two_sectors_is_an_error() {
    let folder = Folder::new();
    let first = fs::read(folder.path().join("sec1/point_cloud.ply")).unwrap();
    let error = folder.error("sec2/point_cloud.ply", &first);
    assert!(error.contains("the same file as in sec1"), "{error}");
}

#[test]
fn databases_and_pickles_are_refused_with_a_remedy() {
    for name in [
        "sequence_graph.gpickle",
        "graph.pickle",
        "CURRENT",
        "000012.sst",
    ] {
        let error = Folder::new().error(name, b"x");
        assert!(
            error.contains("Conversion of Beogym's databases"),
            "{error}"
        );
    }
    let empty = tempfile::tempdir().unwrap();
    let error = SceneData::open_beogym(empty.path(), &BeogymConfig::default()).unwrap_err();
    assert!(error.to_string().contains("no sector"), "{error}");
}

#[test]
fn what_a_folder_lacks_is_listed() {
    let folder = Folder::new();
    fs::remove_file(folder.path().join("surfaceMap.pcd")).unwrap();
    fs::remove_file(folder.path().join("sec2/cameras.json")).unwrap();
    let scene = folder.open().unwrap();
    let missing: Vec<&str> = scene.missing().iter().map(|m| m.output.as_str()).collect();
    assert_eq!(missing, ["cameras.json", "surfaceMap.pcd"]);
}

#[test]
fn places_that_cannot_be_true_are_reported() {
    let folder = Folder::new();
    let path = folder.path();
    fs::copy(
        path.join("sec1/transformation.txt"),
        path.join("sec2/transformation.txt"),
    )
    .unwrap();
    let scene = folder.open().unwrap();
    let last = &scene.missing()[0];
    assert_eq!(
        (last.place.as_str(), last.output.as_str()),
        ("sec2", "transformation.txt of its own")
    );
    assert!(last.features.contains("that of sec1"), "{}", last.features);
    // The second sector lies 100 m beyond the map.
    let folder = tempfile::tempdir().unwrap();
    testing::beogym::write(folder.path(), 100.0).unwrap();
    let scene = SceneData::open_beogym(folder.path(), &BeogymConfig::default()).unwrap();
    let last = &scene.missing()[0];
    assert_eq!(
        (last.place.as_str(), last.output.as_str()),
        ("sec2", "map where it was recorded")
    );
    assert!(
        last.features.contains("0 % of its camera poses"),
        "{}",
        last.features
    );
}

/// A file of numpy.
fn npy(kind: &str, shape: [usize; 2], data: &[u8]) -> Vec<u8> {
    let [rows, columns] = shape;
    let mut header =
        format!("{{'descr': '{kind}', 'fortran_order': False, 'shape': ({rows}, {columns}), }}");
    while (header.len() + 11) % 64 != 0 {
        header.push(' ');
    }
    header.push('\n');
    let mut bytes = b"\x93NUMPY\x01\x00".to_vec();
    bytes.extend((header.len() as u16).to_le_bytes());
    bytes.extend(header.into_bytes());
    bytes.extend(data);
    bytes
}

fn sequence(folder: &Path, sectors: &str, edges: &str) -> Result<SceneData, SimulationError> {
    let text = format!(
        "{{\"format\": \"beogym-sequence\", \"name\": \"s\", \"sectors\": [{sectors}], \
         \"edges\": [{edges}]}}"
    );
    fs::write(folder.join("sequence.json"), text).unwrap();
    SceneData::open_beogym(folder, &BeogymConfig::default())
}

#[test]
fn generation_2_needs_what_its_arrays_do_not_say() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path();
    // Three rows along x, four columns along y; height = x index + 0.1 y index.
    let heights = (0..12).map(|i| (i / 4) as f64 + 0.1 * (i % 4) as f64);
    let heights: Vec<u8> = heights.flat_map(f64::to_le_bytes).collect();
    fs::write(path.join("e.npy"), npy("<f8", [3, 4], &heights)).unwrap();
    let occupied: Vec<u8> = (0..12).map(|i| u8::from(i == 7)).collect();
    fs::write(path.join("o.npy"), npy("|b1", [3, 4], &occupied)).unwrap();
    let sector = |name: &str, rest: &str| {
        format!("{{\"name\": {name}, \"elevation\": \"e.npy\", \"occupancy\": \"o.npy\"{rest}}}")
    };
    let place = ", \"origin_m\": [5.0, 7.0], \"cell_m\": 0.5";
    // Numbers and texts are both names.
    let sectors = format!("{}, {}", sector("0", place), sector("\"1\"", place));
    let edge = "{\"from\": \"0\", \"to\": 1, \"to_from_here\": {\"rotation_wxyz\": [1, 0, 0, 0], \
                \"translation_m\": [1.0, 0.0, 0.0]}}";
    let scene = sequence(path, &sectors, edge).unwrap();
    let level = level(&scene, 0);
    assert_eq!((level.grid.columns, level.grid.rows), (3, 4));
    let cell = level.grid.cell([5.5, 8.5]).unwrap();
    assert!((level.elevation[cell] - 1.3).abs() < 1e-6);
    assert_eq!(
        (level.occupancy[cell], level.occupancy[cell - 1]),
        (OCCUPIED, FREE)
    );
    assert_eq!(
        scene.sectors[1].edges[0].to_from_here.translation_m(),
        [-1.0, 0.0, 0.0]
    );
    assert_eq!(scene.missing().len(), 2);

    let error = sequence(path, &sector("0", ""), "")
        .unwrap_err()
        .to_string();
    assert!(
        error.contains("no origin_m or cell_m of sector 0"),
        "{error}"
    );
    let lost = edge.replace("\"to\": 1", "\"to\": 9");
    let error = sequence(path, &sectors, &lost).unwrap_err().to_string();
    assert!(error.contains("an edge with the sector \"9\""), "{error}");
    let flat: Vec<u8> = (0..12)
        .map(|i| f64::from(i % 2))
        .flat_map(f64::to_le_bytes)
        .collect();
    for (content, expected) in [
        (npy("<f8", [3, 4], &flat), "heights of 0 and 1 only"),
        (npy("|O", [3, 4], &[]), "a pickle"),
        (npy("<f8", [3, 5], &heights), "12 values of 3 x 5"),
        (npy("<c16", [3, 4], &heights), "type <c16"),
        (b"not numpy".to_vec(), "no header"),
    ] {
        fs::write(path.join("e.npy"), content).unwrap();
        let error = sequence(path, &sectors, edge).unwrap_err().to_string();
        assert!(error.contains(expected), "{error}");
    }
}
