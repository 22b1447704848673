use super::*;
use crate::walker::path::Path;

/// A scene before lighting.
fn made(kind: Kind, seed: u64) -> (Builder, SceneParts) {
    let mut builder = Builder::new(seed);
    let made = kind.build(&mut builder);
    (builder, made)
}

#[test]
fn whole_path_has_ground_and_no_obstacles() {
    for kind in Kind::ALL {
        let name = kind.name();
        let scene = by_day(kind, 1);
        let path = Path::closed(&scene.route.points);
        let steps = (path.length_m() / 0.05) as usize;
        let mut below = scene.route.start_below;
        for k in 0..=steps {
            let ([x, y], [dx, dy]) = path.at(0.05 * k as f64);
            let mut level = f64::MIN;
            for aside in [0.0, -0.2, 0.2] {
                let (x, y) = (x - dy * aside, y + dx * aside);
                let ground = scene.ground(x, y, below);
                let ground = ground.unwrap_or_else(|| panic!("{name}: none at {x:.2} {y:.2}"));
                // The sides of roots and stones are steep, and low.
                let steepest = if kind == Kind::Trail { 0.0 } else { 0.8 };
                assert!(
                    ground.normal.z > steepest,
                    "{name} at {x:.2} {y:.2}: {ground:?}"
                );
                let rise = (ground.height - (below - 0.6)).abs();
                assert!(k == 0 || rise < 0.25, "{name} at {x:.2} {y:.2}: {rise}");
                level = level.max(ground.height);
            }
            below = level + 0.6;
            // Free space for hips and shoulders.
            for (height, room) in [(0.5, 0.22), (0.9, 0.27), (1.4, 0.27), (1.7, 0.15)] {
                let at = Vector3::new(x, y, level + height);
                for i in 0..16 {
                    let angle = std::f64::consts::PI * f64::from(i) / 8.0;
                    let direction = Vector3::new(angle.cos(), angle.sin(), 0.0);
                    let hit = scene.solid.hit(&at, &direction, 0.0, room);
                    assert!(hit.is_none(), "{name}: {at} {hit:?}");
                }
            }
        }
    }
}

#[test]
fn no_triangle_is_degenerate() {
    for kind in Kind::ALL {
        let (builder, _) = made(kind, 1);
        for triangle in builder
            .mesh
            .triangles
            .iter()
            .chain(&builder.glass.triangles)
        {
            let [a, b, c] = triangle.corners.map(|c| c.position);
            let area = 0.5 * (b - a).cross(&(c - a)).norm();
            assert!(area > 1e-8, "{}: {triangle:?}", kind.name());
            let uv = triangle.corners.map(|c| c.uv);
            assert!(
                uv.as_flattened().iter().all(|v| v.is_finite()),
                "{triangle:?}"
            );
        }
        let panes = &builder.glass.triangles;
        let is_glass = |t: &mesh::Triangle| {
            builder.materials[t.material as usize].class == surface::Class::Glass
        };
        assert!(panes.iter().all(is_glass), "{}", kind.name());
        assert!(
            !builder.mesh.triangles.iter().any(is_glass),
            "{}",
            kind.name()
        );
    }
}

#[test]
fn scene_is_determined_by_its_seed() {
    for kind in Kind::ALL {
        let [(a, a_made), (b, b_made), (c, _)] = [7, 7, 8].map(|seed| made(kind, seed));
        assert!(a.mesh == b.mesh && a.glass == b.glass, "{}", kind.name());
        assert_eq!(a_made.route, b_made.route);
        assert_eq!(a.materials, b.materials);
        assert!(a.mesh != c.mesh, "{}", kind.name());
    }
}

/// Every lap is the same: leg lengths add up to a whole number of laps where a scene ties speeds to
/// positions.
#[test]
fn stairs_are_climbed_slowly_in_every_lap() {
    let (_, made) = made(Kind::Stairs, 1);
    let round = Path::closed(&made.route.points).length_m();
    let walked: f64 = made
        .route
        .legs
        .iter()
        .map(|leg| match leg {
            route::Leg::Walk { metres, .. } => *metres,
            _ => 0.0,
        })
        .sum();
    assert!((walked - round).abs() < 1e-6, "{walked} {round}");
}

fn fenced(kind: Kind, fence_spacing_m: f64) -> Scene {
    let mut scene = (*by_day(kind, 1)).clone();
    scene.furnish(&Scenery {
        fence_spacing_m,
        ..Scenery::default()
    });
    scene
}

#[test]
fn bars_are_beside_the_path_on_its_ground() {
    for kind in [Kind::Pavement, Kind::Stairs] {
        let scene = fenced(kind, 0.12);
        let path = Path::closed(&scene.route.points);
        let near = |p: &Vector3<f64>| {
            let steps = 0..(path.length_m() / 0.1) as usize;
            let of = |k: usize| {
                let ([x, y], _) = path.at(0.1 * k as f64);
                libm::hypot(p.x - x, p.y - y)
            };
            steps.map(of).fold(f64::MAX, f64::min)
        };
        let corners = scene.fence.triangles.iter().flat_map(|t| &t.corners);
        let corners: Vec<_> = corners.step_by(37).map(|c| c.position).collect();
        assert!(corners.len() > 100, "{kind:?}: {}", corners.len());
        for corner in &corners {
            let distance = near(corner);
            assert!((1.1..1.3).contains(&distance), "{kind:?}: {distance}");
        }
    }
}

#[test]
fn no_spacing_is_no_fence() {
    let (with, without) = (fenced(Kind::Pavement, 0.2), fenced(Kind::Pavement, 0.0));
    assert!(without.fence.triangles.is_empty());
    let [with, without] = [&with, &without].map(crate::camera::placed);
    assert_eq!(with.len(), without.len() + 1);
    assert_eq!(with[1].first, with[0].next());
}
