use super::*;
use scene_bundle::outputs::maps::{FREE, MapLevel, OCCUPIED, UNKNOWN};

fn all() -> Vec<SyntheticScene> {
    [
        SyntheticScene::tilted_plane([0.1, -0.05]),
        SyntheticScene::stairs(),
        SyntheticScene::kerb(0.12),
        SyntheticScene::wall(),
        SyntheticScene::room(),
        SyntheticScene::bridge(),
        SyntheticScene::corridor_loop(),
    ]
    .map(Result::unwrap)
    .into()
}

fn levels(scene: &SyntheticScene, sector: usize) -> &[MapLevel] {
    scene.scene.sectors[sector].levels.as_ref().unwrap()
}

#[test]
fn maps_are_the_surfaces() {
    for scene in all() {
        for (number, surfaces) in scene.surfaces.iter().enumerate() {
            let mut free = 0;
            for level in levels(&scene, number) {
                for cell in 0..level.grid.cells() {
                    if level.occupancy[cell] != FREE {
                        continue;
                    }
                    free += 1;
                    let z = f64::from(level.elevation[cell]);
                    let (truth, normal) = surfaces.ground(level.grid.center_m(cell), z).unwrap();
                    assert!((z - truth).abs() < 1e-6, "{} {cell}", scene.scene.name);
                    let difference =
                        [0, 1, 2].map(|k| f64::from(level.normal[cell][k]) - normal[k]);
                    assert!(difference.iter().all(|v| v.abs() < 1e-6), "{normal:?}");
                }
            }
            assert!(free > 1000, "{} has {free} free cells", scene.scene.name);
        }
    }
}

#[test]
fn the_wall_is_one_cell_thick() {
    let scene = SyntheticScene::wall().unwrap();
    let level = &levels(&scene, 0)[0];
    let occupied: Vec<usize> = (0..level.grid.cells())
        .filter(|cell| level.occupancy[*cell] == OCCUPIED)
        .collect();
    assert_eq!(occupied.len(), 112);
    assert!(occupied.iter().all(|cell| cell % level.grid.columns == 75));
    // Two cells beside of it, the distance to its side is one and a half cells.
    let beside = occupied[10] + 2;
    assert!((f64::from(level.distance[beside]) - 1.5 * CELL_M).abs() < 1e-6);
    assert!((f64::from(level.distance[occupied[10]]) + 0.5 * CELL_M).abs() < 1e-6);
}

#[test]
fn what_is_above_limits_the_clearance() {
    let scene = SyntheticScene::bridge().unwrap();
    let level = &levels(&scene, 0)[0];
    let below = level.grid.cell([12.0, 4.0]).unwrap();
    assert!((level.clearance[below] - 2.4).abs() < 1e-5);
    let beside = level.grid.cell([12.0, 1.0]).unwrap();
    assert_eq!(level.clearance[beside], f32::INFINITY);
    let deck = &levels(&scene, 0)[1];
    assert_eq!(deck.occupancy[beside], UNKNOWN);
    assert!((deck.elevation[below] - 2.4).abs() < 1e-6);
}

#[test]
fn walks_have_their_contacts_on_the_ground() {
    for scene in all() {
        for (sector, surfaces) in scene.scene.sectors.iter().zip(&scene.surfaces) {
            let contacts = &sector.recording.contacts;
            assert!(contacts.len() >= 5, "{}: {}", sector.name, contacts.len());
            for contact in contacts {
                let [x, y, z] = contact.world_from_foot.translation_m();
                let (height, _) = surfaces.ground([x, y], z).unwrap();
                assert!((z - height).abs() < 1e-9);
            }
            let count = sector.recording.trajectory.as_ref().unwrap().len();
            assert_eq!(sector.references.len(), count);
        }
    }
}

#[test]
fn sides_of_the_corridor_are_the_same_world() {
    let scene = SyntheticScene::corridor_loop().unwrap();
    for (number, sector) in scene.scene.sectors.iter().enumerate() {
        for edge in &sector.edges {
            let [x, y] = edge.overlap.center_m();
            let z = edge.overlap.height_m[0];
            let [here, there] = [[x, y, z], edge.to_from_here.apply([x, y, z])];
            let heights = [(number, here), (edge.to, there)].map(|(sector, at)| {
                scene.surfaces[sector]
                    .ground([at[0], at[1]], at[2])
                    .unwrap()
                    .0
                    - at[2]
            });
            assert!(
                heights.iter().all(|height| height.abs() < 1e-9),
                "{heights:?}"
            );
            // Rays to the walls have the same length from both.
            for direction in [[1.0, 0.2, 0.1], [-0.3, 1.0, 0.05], [-1.0, 0.1, 0.02]] {
                let up = |at: [f64; 3]| [at[0], at[1], at[2] + 1.0];
                let a = scene.surfaces[number].ray_m(up(here), direction);
                let b =
                    scene.surfaces[edge.to].ray_m(up(there), edge.to_from_here.rotate(direction));
                assert!((a.unwrap() - b.unwrap()).abs() < 1e-9, "{a:?} {b:?}");
            }
        }
    }
}

#[test]
fn surfaces_that_are_not_finite_are_refused() {
    for slope in [f64::INFINITY, f64::NAN] {
        let error = SyntheticScene::tilted_plane([slope, 0.0]).unwrap_err();
        assert!(error.to_string().contains("not finite"), "{error}");
    }
}
