use super::*;

const MS: f64 = 1e6;
const S: f64 = 1e9;

/// A camera and its IMU, seen from outside. Times in ns of the host, which are the ground truth.
#[derive(Clone)]
struct World {
    imu_hz: f64,
    frame_hz: f64,
    /// How much faster the device's clock runs.
    device_ppm: f64,
    /// What the device's clock shows at 0.
    uptime: f64,
    /// When the first frame that the microcontroller counts begins; the driver's sequence begins
    /// with frame `skipped`.
    phase: f64,
    skipped: u32,
    counted_before: u32,
    /// Stamps are late by this and by an exponential jitter of this mean.
    camera: (f64, f64),
    /// Samples reach the host after this; their reader wakes up late by an exponential jitter of
    /// this mean, then takes all that are there.
    imu: (f64, f64),
    /// Arrivals are late by so much more within these times.
    burst: (f64, f64, f64),
    lost_samples: f64,
    lost_frames: f64,
    seed: u64,
}

impl World {
    fn new() -> Self {
        Self {
            imu_hz: 800.0,
            frame_hz: 30.0,
            device_ppm: 37.0,
            uptime: 3600.0 * S,
            phase: 0.4 * S,
            skipped: 3,
            counted_before: 1000,
            camera: (2.0 * MS, 0.1 * MS),
            imu: (0.5 * MS, 0.3 * MS),
            burst: (0.0, 0.0, 0.0),
            lost_samples: 0.0,
            lost_frames: 0.0,
            seed: 1,
        }
    }

    fn device_ns(&self, host: f64) -> f64 {
        self.uptime + host * (1.0 + self.device_ppm * 1e-6)
    }

    fn host_of(&self, device: f64) -> f64 {
        (device - self.uptime) / (1.0 + self.device_ppm * 1e-6)
    }

    fn number(&self) -> i64 {
        i64::from(self.counted_before) + 1 + i64::from(self.skipped)
    }

    /// Feeds a span of it; calls `look` after each frame.
    fn feed(
        &self,
        sync: &mut FrameSync,
        from: f64,
        to: f64,
        mut look: impl FnMut(&FrameSync, f64),
    ) {
        let mut random = Random(self.seed | 1);
        // By arrival: (time, sample or frame).
        let mut frame = ((from - self.phase) * self.frame_hz / S).ceil().max(0.0) as u32;
        let first_frame = frame;
        let begin = |k: u32| self.phase + f64::from(k) * S / self.frame_hz;
        let mut k = (self.device_ns(from) / S * self.imu_hz).ceil() as u64;
        let mut stamps: VecDeque<(f64, u32, i64)> = VecDeque::new();
        let mut arrived = f64::NEG_INFINITY;
        loop {
            let device = k as f64 * S / self.imu_hz;
            let taken = self.host_of(device);
            k += 1;
            if taken > to {
                return;
            }
            let before = frame;
            while begin(frame) <= taken {
                let stamp = begin(frame) + self.camera.0 + random.late(self.camera.1);
                if random.uniform() >= self.lost_frames && frame >= self.skipped {
                    stamps.push_back((
                        begin(frame) + 20.0 * MS,
                        frame - self.skipped,
                        stamp as i64,
                    ));
                }
                frame += 1;
            }
            let mut there = taken + self.imu.0;
            if (self.burst.0..self.burst.1).contains(&taken) {
                there += self.burst.2;
            }
            if there > arrived {
                arrived = there + random.late(self.imu.1);
            }
            while stamps.front().is_some_and(|s| s.0 < arrived) {
                let (_, sequence, stamp) = stamps.pop_front().expect("there is one");
                sync.frame(sequence, stamp);
                look(sync, taken);
            }
            if random.uniform() < self.lost_samples {
                continue;
            }
            let sample = Sample {
                valid: true,
                ticks: (device / TICK_NS + 1e-6) as u64,
                gyro: [0; 3],
                accel: [0; 3],
                frame_sync: frame > before && frame > first_frame,
                sync_active: true,
                sync_count: self.counted_before + frame,
                temperature: 2500,
                magnetic: None,
                environment: None,
                moving_count: 0,
                falling_count: 0,
            };
            sync.sample(&sample, arrived as i64);
        }
    }

    /// Error of the estimate at a time, ns.
    fn error(&self, estimate: &FrameSyncEstimate, host: f64) -> f64 {
        let ticks = (self.device_ns(host) / TICK_NS) as u64;
        let truth = self.host_of(ticks as f64 * TICK_NS) + self.camera.0;
        estimate.host_ns(ticks).expect("in range") as f64 - truth
    }

    /// The error at the end of a run that begins with nothing, ns, with the estimate; before it no
    /// error since the first third may be above half a millisecond, or four sigma.
    fn run(&self, seconds: f64) -> (f64, FrameSyncEstimate) {
        let mut sync = FrameSync::new(Bounds::default());
        self.feed(&mut sync, 0.0, seconds * S, |sync, now| {
            if now > seconds * S / 3.0 {
                let estimate = sync.estimate().expect("a tie");
                for at in [now, now - 5.0 * S] {
                    let error = self.error(estimate, at).abs();
                    assert!(error < 0.5 * MS, "{error} {estimate:?}");
                    assert!(
                        error < 4.0 * estimate.sigma_ns as f64,
                        "{error} {estimate:?}"
                    );
                }
            }
        });
        let estimate = *sync.estimate().expect("a tie");
        assert_eq!(estimate.sync_minus_sequence, self.number(), "{estimate:?}");
        (self.error(&estimate, seconds * S).abs(), estimate)
    }
}

/// xorshift64*.
struct Random(u64);

impl Random {
    fn uniform(&mut self) -> f64 {
        self.0 ^= self.0 >> 12;
        self.0 ^= self.0 << 25;
        self.0 ^= self.0 >> 27;
        (self.0.wrapping_mul(0x2545_f491_4f6c_dd1d) >> 11) as f64 / (1_u64 << 53) as f64
    }

    fn late(&mut self, mean: f64) -> f64 {
        -mean * (1.0 - self.uniform()).ln()
    }
}

#[test]
fn a_quiet_link_is_tied_to_a_few_microseconds() {
    let (error, estimate) = World::new().run(40.0);
    assert!(error < 40_000.0, "{error} {estimate:?}");
    let rate = (estimate.rate_ppb as f64 / -37_000.0 - 1.0).abs();
    assert!(rate < 0.1, "{estimate:?}");
    assert!(
        (estimate.frame_period_ns - 33_333_333).abs() < 500,
        "{estimate:?}"
    );
    assert!(
        (estimate.least_latency_ns as f64 - (0.5 - 2.0) * MS).abs() < 0.2 * MS,
        "{estimate:?}"
    );
}

#[test]
fn late_arrivals_never_enter_the_line() {
    for jitter in [1.0, 5.0, 20.0] {
        let world = World {
            imu: (0.5 * MS, jitter * MS),
            ..World::new()
        };
        let (error, estimate) = world.run(40.0);
        assert!(error < 40_000.0, "{jitter}: {error} {estimate:?}");
    }
}

#[test]
fn late_stamps_enter_it_little() {
    for (jitter, limit) in [(0.3, 0.05), (1.0, 0.1), (5.0, 0.2)] {
        let world = World {
            camera: (2.0 * MS, jitter * MS),
            ..World::new()
        };
        let (error, estimate) = world.run(60.0);
        assert!(error < limit * MS, "{jitter}: {error} {estimate:?}");
    }
}

#[test]
fn thirty_days_of_uptime_change_nothing() {
    let at = |days: f64| {
        let world = World {
            uptime: days * 86_400.0 * S,
            counted_before: 4_294_000_000,
            ..World::new()
        };
        let (error, estimate) = world.run(60.0);
        assert!(error < 40_000.0, "{days} days: {error} {estimate:?}");
    };
    for days in [0.007, 1.0, 30.0, 365.0] {
        at(days);
    }
}

#[test]
fn lost_samples_and_frames_are_counted_and_do_no_harm() {
    let world = World {
        lost_samples: 0.05,
        lost_frames: 0.1,
        ..World::new()
    };
    let (error, estimate) = world.run(40.0);
    assert!(error < 60_000.0, "{error} {estimate:?}");
    let mut sync = FrameSync::new(Bounds::default());
    world.feed(&mut sync, 0.0, 30.0 * S, |_, _| {});
    let counters = sync.counters();
    let all = 30.0 * 29.6;
    assert!(
        (counters.lost_syncs as f64 / all - 0.05).abs() < 0.02,
        "{counters:?}"
    );
    assert!(
        (counters.lost_frames as f64 / all - 0.1).abs() < 0.03,
        "{counters:?}"
    );
    assert!(
        (counters.syncs + counters.lost_syncs).abs_diff(counters.frames + counters.lost_frames) < 8
    );
    assert_eq!(counters.restarts, 0);
}

/// At 400 Hz and 25 or 100 frames per second the flag is always late by the same: the true time may
/// be anywhere within a sample period, and the estimate says so.
#[test]
fn a_delay_that_never_changes_is_owned_up_to() {
    for frame_hz in [25.0, 100.0] {
        for k in 0..8 {
            let world = World {
                imu_hz: 400.0,
                frame_hz,
                device_ppm: 0.0,
                phase: 0.4 * S + f64::from(k) * 0.3 * MS,
                camera: (2.0 * MS, 0.05 * MS),
                ..World::new()
            };
            // The bounds hold one frame period only if they are narrow.
            let bounds = Bounds {
                camera_ns: (0, 4_000_000),
                imu_ns: (0, 2_000_000),
            };
            let mut sync = FrameSync::new(bounds);
            world.feed(&mut sync, 0.0, 20.0 * S, |_, _| {});
            let estimate = sync.estimate().expect("a tie");
            let error = world.error(estimate, 20.0 * S);
            assert!(estimate.unresolved_ns > 2_300_000, "{estimate:?}");
            assert!(
                error.abs() < estimate.unresolved_ns as f64 / 2.0 + 100_000.0,
                "{error} {estimate:?}"
            );
            assert!(
                error.abs() < 2.0 * estimate.sigma_ns as f64,
                "{error} {estimate:?}"
            );
        }
    }
}

#[test]
fn a_wrong_frame_is_never_taken_silently() {
    // So late that the bounds do not hold it: by ten milliseconds at 30 frames per second none
    // fits.
    let late = World {
        imu: (12.0 * MS, 0.3 * MS),
        ..World::new()
    };
    let mut sync = FrameSync::new(Bounds::default());
    late.feed(&mut sync, 0.0, 10.0 * S, |_, _| {});
    let error = sync.estimate().expect_err("out of bounds");
    assert!(matches!(error, NoEstimate::OutOfBounds { .. }), "{error}");
    // At 100 frames per second twelve milliseconds of bounds hold two.
    let fast = World {
        frame_hz: 100.0,
        imu: (0.6 * MS, 0.1 * MS),
        ..World::new()
    };
    let mut sync = FrameSync::new(Bounds {
        camera_ns: (0, 12_000_000),
        imu_ns: (0, 4_000_000),
    });
    fast.feed(&mut sync, 0.0, 10.0 * S, |_, _| {});
    let error = sync.estimate().expect_err("ambiguous");
    let NoEstimate::Ambiguous { numbers, .. } = error else {
        panic!("{error}");
    };
    assert!(numbers.contains(&fast.number()), "{numbers:?}");
}

/// All arrivals of the first ten seconds are late by half a frame: the wrong frame fits, until an
/// arrival shows that it cannot be.
#[test]
fn a_number_taken_in_a_burst_is_taken_back() {
    let world = World {
        frame_hz: 60.0,
        burst: (0.0, 10.0 * S, 14.0 * MS),
        ..World::new()
    };
    let mut sync = FrameSync::new(Bounds::default());
    let mut numbers = Vec::new();
    world.feed(&mut sync, 0.0, 30.0 * S, |sync, _| {
        if let Ok(estimate) = sync.estimate() {
            let seen = (
                estimate.sync_minus_sequence - world.number(),
                estimate.revision,
            );
            if numbers.last() != Some(&seen) {
                numbers.push(seen);
            }
        }
    });
    assert_eq!(numbers, [(-1, 0), (0, 1)]);
}

/// Later bursts, however long, unseat nothing.
#[test]
fn a_number_that_was_taken_stays_in_a_burst() {
    let world = World {
        burst: (10.0 * S, 55.0 * S, 20.0 * MS),
        ..World::new()
    };
    let (error, estimate) = world.run(60.0);
    assert!(error < 40_000.0, "{error} {estimate:?}");
    assert_eq!(estimate.revision, 0);
}

#[test]
fn what_begins_anew_is_tied_anew() {
    let world = World::new();
    let mut sync = FrameSync::new(Bounds::default());
    world.feed(&mut sync, 0.0, 10.0 * S, |_, _| {});
    let before = *sync.estimate().expect("a tie");
    // The microcontroller was reset: ticks and counts restart, and the camera's stream too.
    let again = World {
        uptime: 1.0 * S,
        counted_before: 0,
        phase: 12.4 * S,
        ..World::new()
    };
    again.feed(&mut sync, 12.0 * S, 25.0 * S, |_, _| {});
    let estimate = *sync.estimate().expect("a tie");
    assert!(
        again.error(&estimate, 25.0 * S).abs() < 3.0 * estimate.sigma_ns as f64,
        "{estimate:?}"
    );
    assert_eq!(estimate.sync_minus_sequence, again.number());
    assert!(estimate.revision > before.revision);
    assert!(
        (1..=3).contains(&sync.counters().restarts),
        "{:?}",
        sync.counters()
    );
}

/// The driver misses a frame and does not count it: from then on each stamp is one period late for
/// its number.
#[test]
fn a_counter_that_slips_is_noticed() {
    let world = World::new();
    let mut sync = FrameSync::new(Bounds::default());
    world.feed(&mut sync, 0.0, 10.0 * S, |_, _| {});
    let slipped = World {
        skipped: world.skipped + 1,
        ..world.clone()
    };
    slipped.feed(&mut sync, 10.0 * S, 20.0 * S, |_, _| {});
    let estimate = *sync.estimate().expect("a tie");
    assert_eq!(estimate.sync_minus_sequence, slipped.number());
    assert!(
        slipped.error(&estimate, 20.0 * S).abs() < 3.0 * estimate.sigma_ns as f64,
        "{estimate:?}"
    );
}

#[test]
fn too_little_is_said_to_be_too_little() {
    let mut sync = FrameSync::new(Bounds::default());
    let error = sync.estimate().expect_err("nothing yet");
    assert_eq!(
        error.to_string(),
        "too few frames: the IMU counted 0, the camera sent 0, expected 32 of each"
    );
    World::new().feed(&mut sync, 0.0, 1.0 * S, |_, _| {});
    assert!(
        matches!(sync.estimate(), Err(NoEstimate::TooFew { .. })),
        "{sync:?}"
    );

    // Frame sync was never switched on.
    let mut sync = FrameSync::new(Bounds::default());
    let mut sample = Sample::parse(&[0; 64]).expect("a report");
    for k in 0..100_u32 {
        sample.ticks += 32;
        sync.sample(&sample, sample.device_ns());
        sync.frame(k, i64::from(k) * 33_333_333);
    }
    assert_eq!(sync.estimate(), Err(&NoEstimate::NotActive));
}

#[test]
fn frames_of_another_camera_or_in_unequal_steps_are_no_tie() {
    // The camera's stamps are of twice the rate.
    let world = World::new();
    let mut sync = FrameSync::new(Bounds::default());
    let mut other = 0;
    world.feed(
        &mut FrameSync::new(Bounds::default()),
        0.0,
        0.1 * S,
        |_, _| {},
    );
    let mut merged = FrameSync::new(Bounds::default());
    world.feed(&mut sync, 0.0, 10.0 * S, |_, now| {
        while f64::from(other) * S / 60.0 < now {
            merged.frame(other, (f64::from(other) * S / 60.0) as i64);
            other += 1;
        }
    });
    merged.syncs = sync.syncs.clone();
    merged.numbers = sync.numbers.clone();
    merged.active = true;
    assert!(
        matches!(merged.fit(), Err(NoEstimate::Rates { .. })),
        "{:?}",
        merged.fit()
    );

    // Every other frame takes a few milliseconds longer.
    let mut uneven = sync.clone();
    uneven.syncs.clear();
    for k in 0..400_u32 {
        let late = if k % 2 == 0 { 0 } else { 4_000_000 };
        uneven
            .syncs
            .count(k, Some(i64::from(k) * 33_333_333 + late));
    }
    let irregular = uneven.fit();
    assert!(
        matches!(irregular, Err(NoEstimate::Irregular { .. })),
        "{irregular:?}"
    );
}
