use super::inputs::Edit;
use super::outcome::outcome;
use super::*;

/// A black eye, and a covered camera, on four seconds of a walk: neither is silent.
#[test]
fn faults_of_a_short_walk_are_not_silent() {
    const SECONDS: f64 = 4.0;
    let walk = Walk {
        begin_s: 2.0,
        long_s: SECONDS,
        has_plane_ground: false,
        has_depth: false,
        seed: 720,
        ..WALKS[0]
    };
    let simulation = walk.simulation(&Faults::default(), None).unwrap();
    let frames = walk
        .render(&simulation, &Faults::default(), SECONDS)
        .unwrap();
    let inputs = inputs(&walk, &simulation, frames, SECONDS).unwrap();
    let ground = ground::ground(&walk).unwrap();
    let scored = |inputs: &Inputs| evaluate(&walk, &simulation, inputs, &ground, SECONDS).unwrap();
    let (clean, found) = scored(&inputs);
    assert!(found.losses.is_empty(), "{:?}", found.losses);
    assert!(clean.iter().all(|foot| foot.found >= 2), "{clean:?}");
    let mut covered = inputs.clone();
    for frame in &mut covered.frames {
        Arc::make_mut(frame).i420.fill(0);
    }
    for faulty in [inputs.edited(Edit::BlackEye, 1.0).unwrap(), covered] {
        let (scores, found) = scored(&faulty);
        let clean = Clean {
            feet: clean.clone(),
            losses: Vec::new(),
        };
        let outcome = outcome(&scores, &clean, true, &found.losses);
        assert_eq!(outcome, Outcome::Flagged, "{:?}: {scores:?}", found.losses);
    }
}

#[test]
fn a_device_with_faults_delivers_frames_of_the_walk() {
    let walk = WALKS[0];
    let simulation = walk.simulation(&Faults::default(), None).unwrap();
    let settings = simulation.settings();
    let frame = |number: u64| {
        Arc::new(StereoFrame {
            number,
            time_ns: settings.frame_ns(number),
            exposure: rig_sim::camera::sensor::Exposure {
                seconds: 0.004,
                gain: 1.0,
            },
            width: 4,
            height: 2,
            i420: vec![number as u8; 12],
        })
    };
    let frames: Vec<Arc<StereoFrame>> = (0..90).map(frame).collect();
    let sweep = |name: &str| SWEEPS.iter().find(|own| own.name == name).unwrap();
    let of = |name: &str, strength: f64| {
        let faults = sweep(name).faults(&walk, strength);
        delivered(&simulation, &frames, &faults).unwrap()
    };
    assert_eq!(of("late frames", 1.0), frames);
    // From 2 to 4.5 s.
    let dropped = of("dropped frames", 1.0);
    assert_eq!(dropped, [&frames[..30], &frames[67..]].concat());
    let frozen = of("frozen frames", 1.0);
    assert_eq!(frozen.len(), frames.len());
    assert_eq!(frozen[60].i420, frames[29].i420);
    assert_eq!(frozen[60].time_ns, frames[60].time_ns);
}
