//! Faults at rising strength.

use super::world::{MS, Shape, World};

/// A fault of a device or of its transport.
pub(crate) struct Fault {
    pub name: &'static str,
    /// Unit of the strength.
    pub unit: &'static str,
    pub strengths: Vec<f64>,
    /// Label of a strength.
    pub label: fn(f64) -> String,
    /// Length of each run, s.
    pub seconds: f64,
    pub make: fn(World, f64) -> World,
}

/// Seconds into a run at which a clock steps.
const STEP_AT: f64 = 40.0;

/// All faults. Unless stated otherwise, the jitter is exponential with a mean of 1 ms and the
/// device's rate error is 100 ppm.
pub(crate) fn all() -> Vec<Fault> {
    let plain = |name, unit, strengths: &[f64], make: fn(World, f64) -> World| Fault {
        name,
        unit,
        strengths: strengths.to_vec(),
        label: |strength| strength.to_string(),
        seconds: 100.0,
        make,
    };
    vec![
        plain(
            "jitter",
            "ms",
            &[0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0],
            |w, s| World {
                jitter: s * MS,
                ..w
            },
        ),
        Fault {
            label: |strength| Shape::ALL[strength as usize].name().to_owned(),
            strengths: (0..Shape::ALL.len()).map(|i| i as f64).collect(),
            ..plain("latency shape", "", &[], |w, s| World {
                shape: Shape::ALL[s as usize],
                ..w
            })
        },
        plain(
            "bursts",
            "ms late",
            &[1.0, 3.0, 10.0, 30.0, 100.0],
            |w, s| World {
                bursts: Some((10.0, 1.0, s * MS)),
                ..w
            },
        ),
        plain("rate error", "ppm", &[0.0, 10.0, 100.0, 190.0], |w, s| {
            World { drift_ppm: s, ..w }
        }),
        Fault {
            seconds: 600.0,
            ..plain(
                "rate swings",
                "ppm in 5 min",
                &[0.2, 1.0, 5.0, 20.0],
                |w, s| World { swing_ppm: s, ..w },
            )
        },
        plain("clock leaps", "ms", &STEPS, |w, s| World {
            steps: vec![(STEP_AT, s * MS)],
            ..w
        }),
        plain("clock falls back", "ms", &STEPS, |w, s| World {
            steps: vec![(STEP_AT, -s * MS)],
            ..w
        }),
        plain("restarts", "times", &[1.0], |w, _| World {
            restart: Some(STEP_AT),
            ..w
        }),
        plain("lost samples", "share", &[0.01, 0.1, 0.5, 0.9], |w, s| {
            World { lost: s, ..w }
        }),
        plain("doubled samples", "share", &[0.01, 0.1, 0.5], |w, s| {
            World { doubled: s, ..w }
        }),
        plain("overtaken samples", "share", &[0.001, 0.01, 0.1], |w, s| {
            World { overtaken: s, ..w }
        }),
        plain("wrong ticks", "share", &[0.0001, 0.001, 0.01], |w, s| {
            World { corrupt: s, ..w }
        }),
        Fault {
            seconds: 200.0,
            ..plain("counter width", "bit", &[12.0, 16.0, 20.0], |w, s| World {
                bits: Some(s as u8),
                ..w
            })
        },
    ]
}

const STEPS: [f64; 8] = [0.05, 0.1, 0.2, 0.5, 1.0, 3.0, 20.0, 1000.0];
