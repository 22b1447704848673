use super::*;
use crate::camera::Shutter;
use crate::camera::sensor::Exposure;
use crate::faults::{Fault, Faults, Kind as FaultKind};
use crate::lens::Lens;
use crate::random;
use crate::scene::Lighting;
use crate::scene::surface::Class;
use crate::walker::Side;

fn settings() -> Settings {
    Settings {
        kind: Kind::Pavement,
        lighting: Lighting::Day,
        seed: 3,
        seconds: 8.0,
        rate_hz: 10.0,
        width: 160,
        height: 90,
        quality: Quality::FAST,
    }
}

fn example() -> Rig {
    Rig::parse(include_str!(
        "../../../../../cad-transforms/rigs/example.toml"
    ))
    .unwrap()
}

#[test]
fn invalid_settings_are_rejected_with_a_reason() {
    type Change = fn(&mut Settings);
    let cases: [(Change, &str); 9] = [
        (|s| s.seconds = 0.0, "length of the walk is 0,"),
        (|s| s.seconds = -1.0, "length of the walk is -1,"),
        (|s| s.seconds = f64::NAN, "length of the walk is NaN,"),
        (|s| s.seconds = 1e9, "at most 3600 s"),
        (|s| s.seconds = 0.09, "at least one period of 0.1 s"),
        (|s| s.rate_hz = 0.0, "rate of the cameras is 0,"),
        (|s| s.rate_hz = f64::INFINITY, "at most 100 Hz"),
        (
            |s| s.width = 161,
            "width of an eye is 161, expected an even number",
        ),
        (
            |s| s.height = 14,
            "height is 14, expected an even number of pixels from 16",
        ),
    ];
    for (change, expected) in cases {
        let mut wrong = settings();
        change(&mut wrong);
        let message = Simulation::new(&wrong, &example()).unwrap_err().to_string();
        assert!(message.contains(expected), "{message}");
    }
}

#[test]
fn frames_are_in_the_middle_of_whole_periods() {
    let thirds = Settings {
        seconds: 1.0,
        rate_hz: 3.0,
        ..settings()
    };
    let times: Vec<i64> = (0..thirds.frame_count())
        .map(|n| thirds.frame_ns(n))
        .collect();
    assert_eq!(times, [166_666_667, 500_000_000, 833_333_333]);
    for tenths in 1..200 {
        let whole = Settings {
            seconds: f64::from(tenths) * 0.1,
            ..settings()
        };
        assert_eq!(whole.frame_count(), tenths as u64, "{tenths}");
    }
}

#[test]
fn frames_are_reproducible() {
    let short = Settings {
        seconds: 0.5,
        width: 32,
        height: 18,
        ..settings()
    };
    let simulation = Arc::new(Simulation::new(&short, &example()).unwrap());
    let frames: Vec<StereoFrame> = simulation.frames(0).collect();
    assert_eq!(frames.len(), 5);
    assert_eq!(frames, simulation.frames(0).collect::<Vec<_>>());
    let numbers: Vec<u64> = frames.iter().map(|f| f.number).collect();
    assert_eq!(numbers, [0, 1, 2, 3, 4]);
    // The two eyes have different poses and independent noise.
    assert_ne!(frames[0].gray(0), frames[0].gray(1));
    assert_eq!(frames[0].gray(0).len(), 32 * 18);
}

/// The rasterizer agrees with the reference implementation: the depth of a pixel is that of its own
/// ray, except near edges, which the rasterizer places to 0.1 px.
#[test]
fn true_depth_agrees_with_ray_casting() {
    let simulation = Arc::new(Simulation::new(&settings(), &example()).unwrap());
    let (width, height) = (160, 90);
    for (camera, sim_camera) in simulation.cameras().iter().enumerate() {
        let mut ground_truth = simulation.ground_truth(camera);
        let (mut compared, mut looked) = (0, 0);
        for (eye, time_ns) in [(0, 2_000_000_000), (1, 4_700_000_000), (0, 7_300_000_000)] {
            let truth = ground_truth.render(eye, time_ns);
            let lens = Lens::new(&sim_camera.models[eye]);
            for k in 0..300 {
                let pick = |stream, size| (random::bits(9, stream, k) % size) as usize;
                let (u, v) = (pick(0, width), pick(1, height));
                let pixel = v * width as usize + u;
                // Rays are cast at the static scene, not at the wearer.
                if truth.class[pixel] == Class::Person {
                    continue;
                }
                let row_s = match sim_camera.shutter {
                    Shutter::Global => 0.0,
                    Shutter::Rolling { line_s } => line_s * (v as f64 - 0.5 * (height - 1) as f64),
                };
                let rig = simulation.walker.rig(seconds(time_ns) + row_s);
                let (origin, rotation) = sim_camera.world_from_eye(eye, &rig, None);
                let inverse_depth = |du: f64, dv: f64| {
                    let (x, y) = lens.unproject(u as f64 + du, v as f64 + dv);
                    // 1 long along the optical axis, so that the distance is the depth.
                    let direction = rotation * Vector3::new(x, y, 1.0);
                    let hit = simulation.scene().first_hit(&origin, &direction);
                    hit.map_or(0.0, |hit| 1.0 / hit.distance)
                };
                looked += 1;
                // 1/z is linear in the image within a plane, and 0 for the sky.
                let expected = inverse_depth(0.0, 0.0);
                let bent = |du: f64, dv: f64| {
                    let sum = inverse_depth(du, dv) + inverse_depth(-du, -dv);
                    (0.5 * sum - expected).abs() > 1e-4 * expected
                };
                if bent(0.25, 0.0) || bent(0.0, 0.25) {
                    continue;
                }
                let found = 1.0 / f64::from(truth.depth[pixel]);
                assert!(
                    (found - expected).abs() <= 1e-3 * expected,
                    "{} {u} {v}: {} m, by its ray {} m",
                    sim_camera.name,
                    1.0 / found,
                    1.0 / expected
                );
                compared += 1;
            }
        }
        assert!(
            compared > 300 && 4 * compared > 3 * looked,
            "{}: {compared} of {looked}",
            sim_camera.name
        );
    }
}

/// Pixel at which an eye observes a moving point in the image of time `time_s`. Reference
/// implementation: the instant of the row is found by bisection over the rows.
fn slow_point(
    simulation: &Simulation,
    camera: &SimCamera,
    eye: usize,
    time_s: f64,
    point: &dyn Fn(f64) -> Vector3<f64>,
) -> [f64; 2] {
    let lens = Lens::new(&camera.models[eye]);
    let seen = |t: f64| {
        let (origin, rotation) = camera.world_from_eye(eye, &simulation.walker.rig(t), None);
        let at = rotation.inverse() * (point(t) - origin);
        lens.project(at.x / at.z, at.y / at.z)
    };
    let Shutter::Rolling { line_s } = camera.shutter else {
        let (u, v) = seen(time_s);
        return [u, v];
    };
    let height = f64::from(camera.models[eye].height);
    let instant = |row: f64| time_s + line_s * (row - 0.5 * (height - 1.0));
    // The row runs ahead of the point from some row on.
    let (mut low, mut high) = (-height, 2.0 * height);
    for _ in 0..60 {
        let middle = 0.5 * (low + high);
        match seen(instant(middle)).1 > middle {
            true => low = middle,
            false => high = middle,
        }
    }
    let (u, v) = seen(instant(low));
    [u, v]
}

/// True flow agrees with the reference implementation: a ray cast into the scene, its end projected
/// into the next image.
#[test]
fn true_flow_agrees_with_ray_casting() {
    let simulation = Simulation::new(&settings(), &example()).unwrap();
    let (width, height) = (160, 90);
    for (camera, sim_camera) in simulation.cameras().iter().enumerate() {
        let mut ground_truth = simulation.ground_truth(camera);
        let (mut compared, mut shown, mut longest) = (0, 0, 0.0_f64);
        for (eye, time_ns) in [(0, 3_000_000_000), (1, 5_300_000_000)] {
            let next_ns = time_ns + 66_000_000;
            let (from, to) = (
                ground_truth.render(eye, time_ns),
                ground_truth.render(eye, next_ns),
            );
            let flow = ground_truth.flow(eye, &from, &to);
            let lens = Lens::new(&sim_camera.models[eye]);
            for k in 0..500 {
                let pick = |stream, size| (random::bits(11, stream, k) % size) as usize;
                let (u, v) = (pick(0, width), pick(1, height));
                let pixel = v * width as usize + u;
                if matches!(from.class[pixel], Class::Person | Class::Glass) {
                    continue;
                }
                let row_s = sim_camera.shutter.row_s(v, height as usize);
                let rig = simulation.walker.rig(seconds(time_ns) + row_s);
                let (origin, rotation) = sim_camera.world_from_eye(eye, &rig, None);
                let (x, y) = lens.unproject(u as f64, v as f64);
                let direction = rotation * Vector3::new(x, y, 1.0);
                let Some(hit) = simulation.scene().first_hit(&origin, &direction) else {
                    continue;
                };
                // At edges the rasterizer may select the other surface.
                let found = f64::from(from.depth[pixel]);
                if (found - hit.distance).abs() > 1e-3 * found {
                    continue;
                }
                let point = origin + direction * hit.distance;
                let [du, dv] = flow.flow_px[pixel].map(f64::from);
                if du.is_nan() {
                    continue;
                }
                let expected =
                    slow_point(&simulation, sim_camera, eye, seconds(next_ns), &|_| point);
                let (eu, ev) = (expected[0] - u as f64, expected[1] - v as f64);
                // Depth has single precision, and may differ by a thousandth.
                let tolerance = 0.005_f64.max(1e-3 * eu.hypot(ev));
                assert!(
                    (du - eu).abs().max((dv - ev).abs()) < tolerance,
                    "{} {u} {v}: {du} {dv}, by its ray {eu} {ev}",
                    sim_camera.name
                );
                compared += 1;
                shown += i32::from(flow.shown[pixel]);
                longest = longest.max(eu.hypot(ev));
            }
        }
        let name = &sim_camera.name;
        assert!(compared > 400, "{name}: {compared}");
        assert!(
            longest > 2.0,
            "{name}: nothing moved by more than {longest} px"
        );
        assert!(
            (compared / 2..compared).contains(&shown),
            "{name}: {shown} of {compared}"
        );
    }
}

#[test]
fn shoe_tags_are_those_of_the_rig_file() {
    let text = include_str!("../../../../../cad-transforms/rigs/example.toml");
    let simulation = Simulation::new(&settings(), &example()).unwrap();
    let [left, right] = &simulation.scene().wearer.tags[..] else {
        panic!("{:?}", simulation.scene().wearer.tags)
    };
    assert_eq!((left.id, left.size_m, right.id), (0, 0.06, 1));
    let bare = text.split("[[shoe_tag]]").next().unwrap();
    let bare = Simulation::new(&settings(), &Rig::parse(bare).unwrap()).unwrap();
    assert!(bare.scene().wearer.tags.is_empty());
    let unknown = Rig::parse(&text.replace("id = 1", "id = 8")).unwrap();
    let error = Simulation::new(&settings(), &unknown).unwrap_err();
    let message = error.to_string();
    assert!(
        message.contains("tag 8 is on a shoe, expected 0 to 7"),
        "{message}"
    );
}

#[test]
fn tag_corners_move_with_the_feet() {
    let simulation = Simulation::new(&settings(), &example()).unwrap();
    let camera = simulation
        .cameras()
        .iter()
        .position(|camera| camera.name == "feet")
        .unwrap();
    let sim_camera = &simulation.cameras()[camera];
    let mut ground_truth = simulation.ground_truth(camera);
    let (mut compared, mut visible) = (0, 0);
    for k in 0..40 {
        let (eye, time_ns) = (k % 2, 2_000_000_000 + 130_000_000 * k as i64);
        let truth = ground_truth.render(eye, time_ns);
        for seen in ground_truth.tags(eye, &truth) {
            let tag = &simulation.scene().wearer.tags[seen.id];
            for (found, corner) in seen
                .corners
                .iter()
                .zip(crate::scene::tag::corners(tag.size_m))
            {
                let point = |t: f64| {
                    let foot = simulation.walker.foot(tag.side, t);
                    foot.position + foot.rotation * (tag.position + tag.rotation * corner)
                };
                let expected = slow_point(&simulation, sim_camera, eye, seconds(time_ns), &point);
                let off = (found[0] - expected[0]).hypot(found[1] - expected[1]);
                // Outside the image the row time is extrapolated from the last rows.
                let inside = (0.0..=159.0).contains(&found[0]) && (0.0..=89.0).contains(&found[1]);
                let most = if inside { 0.005 } else { 0.05 };
                assert!(off < most, "{time_ns}: {found:?}, expected {expected:?}");
                compared += 1;
            }
            if seen.is_visible() {
                visible += 1;
                let [a, _, c, _] = seen.corners;
                let (u, v) = (0.5 * (a[0] + c[0]), 0.5 * (a[1] + c[1]));
                let middle = (v + 0.5) as usize * 160 + (u + 0.5) as usize;
                assert_eq!(truth.class[middle], Class::Person);
            }
        }
    }
    assert!(
        compared > 100 && visible > 32,
        "{compared} corners, {visible} tags"
    );
}

/// Tags were lit as if they faced the ground, in which no detector found them in some scenes.
#[test]
fn white_margins_of_tags_are_brighter_than_the_shoe() {
    for kind in [Kind::Pavement, Kind::Stairs, Kind::Room] {
        let settings = Settings {
            kind,
            width: 672,
            height: 376,
            ..settings()
        };
        let simulation = Arc::new(Simulation::new(&settings, &example()).unwrap());
        let names = simulation.cameras().iter();
        let camera = names.clone().position(|c| c.name == "feet").unwrap();
        let time_ns = settings.frame_ns(2);
        let image = simulation.frames(camera).render_frame(2, time_ns).gray(0);
        let mut ground_truth = simulation.ground_truth(camera);
        let truth = ground_truth.render(0, time_ns);
        let seen = ground_truth.tags(0, &truth);
        assert_eq!(seen.iter().filter(|tag| tag.is_visible()).count(), 2);
        for tag in seen {
            let [a, b, c, d] = tag.corners;
            // From the middle of the tag towards the toe, 1 is the edge of the black square.
            let gray = |share: f64| {
                let at = |k: usize| {
                    let middle = 0.25 * (a[k] + b[k] + c[k] + d[k]);
                    middle + share * (0.5 * (c[k] + d[k]) - middle)
                };
                image[(at(1) + 0.5) as usize * 672 + (at(0) + 0.5) as usize]
            };
            let (margin, leather) = (gray(1.12), gray(1.6));
            assert!(margin > leather + 20, "{kind:?}: {margin} and {leather}");
        }
    }
}

/// Faults of one kind on the left foot for the whole walk.
fn on_left_foot(kind: FaultKind, strength: f64) -> WearerFaults {
    let fault = Fault {
        kind,
        strength,
        from_s: 0.0,
        to_s: f64::INFINITY,
        camera: None,
        foot: Some(Side::Left),
    };
    let faults = Faults {
        list: vec![fault],
        seed: 5,
    };
    faults.of_wearer()
}

/// The tags in the left eye of the feet camera at 20 instants.
fn tags_with(faults: &WearerFaults) -> Vec<Vec<TagObservation>> {
    let settings = Settings {
        kind: Kind::Room,
        ..settings()
    };
    let simulation = Simulation::with_wearer_faults(&settings, &example(), faults).unwrap();
    let camera = (simulation.cameras().iter()).position(|camera| camera.name == "feet");
    let mut ground_truth = simulation.ground_truth(camera.unwrap());
    let tags = |k: i64| {
        let truth = ground_truth.render(0, 1_000_000_000 + 300_000_000 * k);
        ground_truth.tags(0, &truth)
    };
    (0..20).map(tags).collect()
}

/// Mean visible share of the left and of the right tag where they are visible without faults, and
/// the displacement of the left one, px RMS.
fn compared(with: &[Vec<TagObservation>], clean: &[Vec<TagObservation>]) -> ([f64; 2], f64) {
    let (mut shares, mut counts, mut squares) = ([0.0; 2], [0.0; 2], 0.0);
    for (found, clean) in with.iter().zip(clean) {
        for clean in clean.iter().filter(|tag| tag.is_visible()) {
            let same = found.iter().find(|tag| tag.id == clean.id);
            shares[clean.id] += same.map_or(0.0, |tag| tag.visible_share);
            counts[clean.id] += 1.0;
            if let (0, Some(tag)) = (clean.id, same) {
                let moved = tag.corners.iter().zip(&clean.corners);
                let square =
                    |(a, b): (&[f64; 2], &[f64; 2])| (a[0] - b[0]).powi(2) + (a[1] - b[1]).powi(2);
                squares += moved.map(square).sum::<f64>() / 4.0;
            }
        }
    }
    let shares = [0, 1].map(|id| shares[id] / counts[id]);
    (shares, (squares / counts[0]).sqrt())
}

#[test]
fn faults_hide_and_move_the_tag_of_their_foot_only() {
    let clean = tags_with(&WearerFaults::default());
    let with = |kind, strength| compared(&tags_with(&on_left_foot(kind, strength)), &clean);
    for kind in [FaultKind::TagDirt, FaultKind::TagCovered] {
        let mut last = 1.0;
        for strength in [0.2, 0.6] {
            let ([left, right], moved) = with(kind, strength);
            let hidden = 1.0 - left;
            assert!(
                (0.5 * strength..1.6 * strength).contains(&hidden),
                "{kind:?} {strength}: {left}"
            );
            assert!(
                left < last && right == 1.0 && moved == 0.0,
                "{kind:?} {strength}: {right}"
            );
            last = left;
        }
    }
    let ([half, right], _) = with(FaultKind::Trousers, 0.1);
    let ([none, _], _) = with(FaultKind::Trousers, 0.18);
    assert!(
        none < 0.05 && (0.1..0.9).contains(&half) && right == 1.0,
        "{half} {none}"
    );
    let ([left, right], _) = with(FaultKind::TagLost, 1.0);
    assert_eq!([left, right], [0.0, 1.0]);
    let ([left, _], small) = with(FaultKind::TagSlip, 0.005);
    let (_, large) = with(FaultKind::TagSlip, 0.01);
    assert!(
        left > 0.8 && small > 0.2 && (1.8..2.2).contains(&(large / small)),
        "{left} {small} {large}"
    );
}

#[test]
fn wearer_faults_of_strength_0_change_nothing() {
    let list = FaultKind::ALL.map(|kind| Fault {
        kind,
        strength: 0.0,
        from_s: 0.0,
        to_s: f64::INFINITY,
        camera: None,
        foot: None,
    });
    let faults = Faults {
        list: list.to_vec(),
        seed: 9,
    };
    let with = Simulation::with_wearer_faults(&settings(), &example(), &faults.of_wearer());
    let without = Simulation::new(&settings(), &example()).unwrap();
    let [with, without] = [with.unwrap(), without].map(Arc::new);
    for camera in 0..3 {
        let [a, b] = [&with, &without].map(|s| s.frames(camera).nth(1).unwrap());
        assert!(a == b, "camera {camera}");
    }
    for k in 0..100 {
        let t = 0.05 * f64::from(k);
        assert_eq!(with.walker.rig(t).position, without.walker.rig(t).position);
        for side in [Side::Left, Side::Right] {
            assert_eq!(with.walker.foot(side, t), without.walker.foot(side, t));
        }
    }
}

#[test]
fn shoes_are_visible_in_the_feet_camera_only() {
    let simulation = Arc::new(Simulation::new(&settings(), &example()).unwrap());
    for (camera, sim_camera) in simulation.cameras().iter().enumerate() {
        let truth = simulation.ground_truth(camera).render(0, 4_000_000_000);
        let own = truth.class.iter().filter(|&&class| class == Class::Person);
        let share = own.count() as f64 / truth.class.len() as f64;
        match sim_camera.name == "feet" {
            true => assert!((0.02..0.5).contains(&share), "{share}"),
            false => assert_eq!(share, 0.0, "{}", sim_camera.name),
        }
    }
}

#[test]
fn intrinsics_of_a_calibration_replace_nominal_ones() {
    let small = Settings {
        seconds: 0.2,
        width: 64,
        height: 36,
        ..settings()
    };
    let make = || Simulation::new(&small, &example()).unwrap();
    let mut stereo = make().calibration(0);
    stereo.left.fx *= 0.8;
    let name = make().cameras()[0].name.clone();
    let changed = make().with_lenses(&name, &stereo).unwrap();
    assert_eq!(changed.cameras()[0].models[0].fx, stereo.left.fx);
    assert_eq!(changed.calibration(0).left, stereo.left);
    let first = |simulation: Simulation| Arc::new(simulation).frames(0).next().unwrap();
    assert_ne!(first(changed).gray(0), first(make()).gray(0));
    let error = make().with_lenses("hat", &stereo).unwrap_err().to_string();
    assert!(error.contains("found \"hat\", expected one of"), "{error}");
    stereo.right.width = 100;
    let error = make().with_lenses(&name, &stereo).unwrap_err().to_string();
    assert!(error.contains("is for 100x36, expected 64x36"), "{error}");
}

#[test]
fn views_show_the_static_scene_without_people() {
    let simulation = Simulation::new(&settings(), &example()).unwrap();
    let time_ns = 3_050_000_000;
    let mut hidden = 0;
    for (number, camera) in simulation.cameras().iter().enumerate() {
        let truth = simulation.ground_truth(number).render(0, time_ns);
        let mut renderer = simulation.view_renderer(&camera.models[0], camera.shutter);
        let pose = |time_s: f64| {
            let rig = simulation.walker().rig(time_s);
            camera.world_from_eye(0, &rig, None)
        };
        let exposure = |seconds: f64| Exposure { seconds, gain: 1.0 };
        let mut at = |s: f64| renderer.render(&pose, seconds(time_ns), &exposure(s));
        let image = at(4e-4);
        assert_eq!(image, at(4e-4));
        let pixels = truth.depth.iter().zip(&truth.class).zip(&image.depth_m);
        for ((depth_m, class), found_m) in pixels {
            match class {
                Class::Person => {
                    hidden += 1;
                    assert!(found_m >= depth_m, "{found_m} {depth_m}");
                }
                _ => assert_eq!(found_m, depth_m),
            }
        }
        assert!(!image.class.contains(&Class::Person));
        let sum = |image: &ViewImage| -> u64 {
            let values = image.rgb.as_flattened().iter();
            values.map(|value| u64::from(*value)).sum()
        };
        assert!(sum(&at(1e-4)) < sum(&image));
    }
    assert!(hidden > 0, "nobody was in an image");
}
