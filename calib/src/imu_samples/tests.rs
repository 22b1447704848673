use super::*;

fn recording(name: &str, numbers: &[u64]) -> (ImuRecording, Vec<u64>) {
    let samples = numbers.iter().map(|&n| ImuSample {
        time: n as i64 * 5_000_000,
        ticks: n as i64 * 128,
        gyro: [n as f64, 0.0, 0.0],
        accel: [0.0; 3],
        temperature_c: None,
        time_unreliable: false,
    });
    let recording = ImuRecording {
        name: name.to_owned(),
        rate_hz: 200.0,
        tick: TickLength::ZED_MINI,
        source: String::new(),
        count: [None; 2],
        samples: samples.collect(),
        gaps: Vec::new(),
    };
    (recording, numbers.to_vec())
}

fn gap(stream: &str, first: u64, last: u64, cause: paws::gap::Cause) -> Gap {
    Gap {
        stream: stream.to_owned(),
        first,
        last,
        cause: cause.into(),
        ..Gap::default()
    }
}

#[test]
fn number_jumps_are_gaps_with_a_cause() {
    let (mut imu, numbers) = recording("feet/imu", &[5, 6, 7, 10, 11, 20]);
    let gaps = [
        gap("left/imu", 12, 19, paws::gap::Cause::Storage),
        gap("feet/imu", 8, 9, paws::gap::Cause::Disconnected),
    ];
    order(&mut imu, numbers, &gaps);
    let gap = |at, missing, cause: &str| ImuGap {
        at,
        missing,
        cause: cause.to_owned(),
    };
    assert_eq!(imu.gaps, [gap(3, 2, "disconnected"), gap(5, 8, "unknown")]);
    assert_eq!(imu.continuous_runs(), [0..3, 3..5, 5..6]);
}

#[test]
fn late_samples_are_sorted_and_duplicates_dropped() {
    let (mut imu, numbers) = recording("feet/imu", &[1, 2, 4, 3, 3, 5]);
    order(&mut imu, numbers, &[]);
    let order: Vec<f64> = imu.samples.iter().map(|s| s.gyro[0]).collect();
    assert_eq!(order, [1.0, 2.0, 3.0, 4.0, 5.0]);
    assert!(imu.gaps.is_empty());
}

#[test]
fn counts_are_scaled_and_incomplete_samples_are_dropped() {
    let batch = ImuBatch {
        times: vec![1, 2],
        device_ticks: vec![5, 6],
        gyro_counts: vec![1, 2, 3, -4, -5, -6],
        gyro_scale: 0.5,
        accel: vec![0.1, 0.2, 0.3],
        temperature_counts: vec![2500],
        temperature_scale_c: 0.01,
        ..ImuBatch::default()
    };
    let first = sample(&batch, 0).unwrap();
    assert_eq!(first.gyro, [0.5, 1.0, 1.5]);
    assert_eq!(first.accel, [0.1, 0.2, 0.3]);
    assert_eq!(first.temperature_c, Some(25.0));
    assert_eq!(sample(&batch, 1), None);
}
