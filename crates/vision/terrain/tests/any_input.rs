//! Whatever numbers depth images hold, nothing panics and results are finite.

mod scene;

use counter_random::{bits, uniform};
use scene::{Camera, Noise, VGA, climb, stairs};
use terrain::edges::{find_edges, snap};
use terrain::fusion::Volume;
use terrain::maps::{GroundSample, build};
use terrain::mesh::Mesh;
use terrain::planes::PlaneRefiner;
use terrain::simplify::simplify;

#[test]
fn damaged_depths_do_not_panic() {
    let camera = Camera {
        size: [162, 93],
        focal_px: 90.0,
        line_s: 1e-4,
        ..VGA
    };
    let noise = Noise {
        disparity_px: 0.1,
        ..scene::CLEAN
    };
    let clean = climb(&stairs(3), camera, [-0.6, 0.6], 1.0, noise);
    let odd = [
        f32::NAN,
        f32::INFINITY,
        f32::NEG_INFINITY,
        -1.0,
        0.0,
        1e-30,
        1e-3,
        1e30,
        f32::MAX,
    ];
    for seed in 0..12 {
        let mut shots = climb(&stairs(3), camera, [-0.6, 0.6], 1.0, noise);
        // A share of the pixels that grows with the seed.
        let share = 0.09 * seed as f64;
        for (number, shot) in shots.iter_mut().enumerate() {
            let stream = 2 * number as u64;
            for i in 0..shot.depth_m.len() {
                if uniform(seed, stream, i as u64) < share {
                    let word = bits(seed, stream + 1, i as u64);
                    shot.depth_m[i] = odd[word as usize % odd.len()];
                    shot.sigma_m[i] = odd[(word >> 32) as usize % odd.len()];
                }
            }
        }
        let mut volume = Volume::new(Default::default()).unwrap();
        for shot in shots.iter().chain(&clean[..2]) {
            volume.add(&shot.view()).unwrap();
        }
        let mut mesh = Mesh::of(&volume, &Default::default());
        let mut refiner = PlaneRefiner::new(&mesh, &Default::default());
        for shot in &shots {
            refiner.add(&shot.view()).unwrap();
        }
        let planes = refiner.finish();
        let edges = find_edges(&planes, &Default::default());
        snap(&mut mesh, &planes, &edges, 0.02);
        assert!(mesh.positions.iter().flatten().all(|x| x.abs() < 10.0));
        assert!(
            mesh.sigma_m
                .iter()
                .all(|sigma| *sigma > 0.0 && *sigma < 1.0)
        );
        let sample = GroundSample {
            position: [0.1, 0.0, 0.2],
            sigma_m: 0.01,
            contact: 0,
        };
        let levels = build(&mesh, &edges, &[sample], &Default::default());
        let parts = terrain::convex::collision_parts(&planes, &edges, &levels, &Default::default());
        let corners = parts
            .parts
            .iter()
            .flat_map(|part| part.vertices.iter().flatten());
        assert!(corners.clone().all(|x| x.is_finite()));
        let (simplified, _) = simplify(&mesh, &Default::default());
        assert!(simplified.positions.iter().flatten().all(|x| x.is_finite()));
    }
}
