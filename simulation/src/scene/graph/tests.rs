use super::*;
use crate::scene::SceneData;
use crate::testing::SyntheticScene;

fn corridor() -> Vec<Sector> {
    SyntheticScene::corridor_loop()
        .unwrap()
        .scene
        .sectors
        .clone()
}

/// The error of sectors that were changed.
fn error(change: impl FnOnce(&mut Vec<Sector>)) -> String {
    let mut sectors = corridor();
    change(&mut sectors);
    let error = SceneData::new("changed", sectors).unwrap_err();
    assert!(matches!(error, SimulationError::Scene { .. }), "{error}");
    error.to_string()
}

/// Moves the sector behind an edge by a similarity in the frame of that sector.
fn moved(edge: &SectorEdge, scale: f64, rotation_deg: f64, shift_m: f64) -> Similarity {
    let half = 0.5 * rotation_deg.to_radians();
    let rotation = [libm::cos(half), 0.0, 0.0, libm::sin(half)];
    let [x, y] = edge.overlap.center_m();
    let center = Vector3::from(edge.to_from_here.apply([x, y, 0.0]));
    let about_zero = Similarity::new(scale, rotation, [0.0; 3]).unwrap();
    let shift = center - Vector3::from(about_zero.apply(center.into()));
    let shift = shift + Vector3::new(shift_m, 0.0, 0.0);
    let by = Similarity::new(scale, rotation, shift.into()).unwrap();
    by.compose(&edge.to_from_here)
}

#[test]
fn the_loop_closes() {
    let sectors = corridor();
    let cycles = cycles(&sectors);
    assert_eq!(cycles.len(), 8);
    for (_, _, gap) in cycles {
        assert!(gap.distance_m < 1e-12 && gap.angle_deg < 1e-5, "{gap:?}");
    }
}

#[test]
fn cycles_that_do_not_close_are_errors_with_their_gap() {
    for (scale, rotation, shift, expected) in [
        (1.0, 0.0, 0.012, "does not close by 0.0120 m"),
        (1.0, 0.25, 0.0, "0.250 degrees"),
        (1.002, 0.0, 0.0, "scale of 1.002"),
    ] {
        // There and back: a cycle of two.
        let text = error(|sectors| {
            let edge = &mut sectors[3].edges[0];
            edge.to_from_here = moved(edge, scale, rotation, shift);
        });
        assert!(text.contains(expected), "{text}");
        assert!(text.contains("edge from side"), "{text}");
        // Both directions agree with each other, and not with the rest of the loop.
        let text = error(|sectors| {
            let edge = &mut sectors[2].edges[0];
            edge.to_from_here = moved(edge, scale, rotation, shift);
            let back = edge.to_from_here.inverse();
            assert_eq!((edge.to, sectors[3].edges[1].to), (3, 2));
            sectors[3].edges[1].to_from_here = back;
        });
        assert!(text.contains("does not close"), "{text}");
    }
    // Within the limits.
    let mut sectors = corridor();
    let edge = &mut sectors[3].edges[0];
    edge.to_from_here = moved(edge, 1.0, 0.15, 0.006);
    SceneData::new("changed", sectors).unwrap();
}

#[test]
fn edges_are_checked() {
    let text = error(|sectors| sectors[1].edges[0].to = 7);
    assert!(
        text.contains("edge from side 1 to number 7: found sector 7 of 4"),
        "{text}"
    );
    let text = error(|sectors| sectors[1].edges[0].to = 1);
    assert!(text.contains("an edge to itself"), "{text}");
    let text = error(|sectors| sectors[2].name = "side 0".to_owned());
    assert!(text.contains("the name \"side 0\" of sector 0"), "{text}");
    let text = error(Vec::clear);
    assert!(text.contains("found none"), "{text}");
    // A scale, though it closes, inside of a recording.
    let text = error(|sectors| {
        for (from, to) in [(0, 1), (1, 0)] {
            let edge = sectors[from]
                .edges
                .iter_mut()
                .find(|edge| edge.to == to)
                .unwrap();
            edge.is_imported = false;
        }
        let edge = &mut sectors[0].edges[0];
        edge.to_from_here = moved(edge, 1.0005, 0.0, 0.0);
    });
    assert!(text.contains("found a scale of 1.0005"), "{text}");
}
