use super::*;

#[test]
fn counts_and_si_values_come_out_in_si() {
    let batch = ImuBatch {
        first_number: 7,
        device_ticks: vec![1, 2],
        times: vec![100, 200],
        gyro_counts: vec![1, -2, 3, 4, 5, -6],
        gyro_scale: 0.1,
        time_unreliable: true,
        accel: vec![0.5, 9.81, -0.25, 0.1, 0.2, 0.3],
        temperature_counts: vec![2500],
        temperature_scale_c: 0.01,
        ..ImuBatch::default()
    };
    let found = samples(&batch).expect("convert");
    let second = ImuSample {
        number: 8,
        ticks: 2,
        time_ns: 200,
        gyro_rad_s: [4.0 * 0.1, 5.0 * 0.1, -6.0 * 0.1],
        accel_m_s2: [0.1, 0.2, 0.3],
        temperature_c: None,
        time_unreliable: true,
    };
    assert_eq!((found.len(), found[1]), (2, second));
    assert_eq!(found[0].temperature_c, Some(25.0));
    let complete = complete_samples(&batch).map(|(_, sample)| sample);
    assert_eq!(complete.collect::<Vec<_>>(), found);
}

#[test]
fn a_batch_that_contradicts_itself_is_refused() {
    let whole = ImuBatch {
        device_ticks: vec![1, 2],
        times: vec![100, 200],
        gyro: vec![0.0; 6],
        accel: vec![0.0; 6],
        ..ImuBatch::default()
    };
    assert!(samples(&whole).is_ok());
    // Numbers that no device reaches are odd, but must not panic.
    let last = ImuBatch {
        first_number: u64::MAX,
        ..whole.clone()
    };
    assert_eq!(samples(&last).expect("convert")[1].number, u64::MAX);
    let breaks: [fn(&mut ImuBatch); 4] = [
        |b| b.times.truncate(1),
        |b| b.gyro.truncate(5),
        |b| b.gyro_counts.push(3),
        |b| b.accel.clear(),
    ];
    for break_it in breaks {
        let mut batch = whole.clone();
        break_it(&mut batch);
        assert!(samples(&batch).is_err(), "{batch:?}");
    }
}

#[test]
fn incomplete_samples_are_left_out() {
    let batch = ImuBatch {
        first_number: 3,
        times: vec![1, 2, 3],
        device_ticks: vec![5, 6],
        gyro_counts: vec![1, 2, 3, -4, -5, -6],
        gyro_scale: 0.5,
        accel: vec![0.1, 0.2, 0.3],
        ..ImuBatch::default()
    };
    let found: Vec<(usize, ImuSample)> = complete_samples(&batch).collect();
    assert_eq!(found.len(), 1);
    let (position, sample) = found[0];
    assert_eq!((position, sample.number, sample.time_ns), (0, 3, 1));
    assert_eq!(sample.gyro_rad_s, [0.5, 1.0, 1.5]);
    assert_eq!(sample.accel_m_s2, [0.1, 0.2, 0.3]);
}

/// Samples by number and time, as where the clock map was replaced after the third.
fn replaced_map() -> Vec<ImuSample> {
    let of = |(number, time_ns): (u64, i64)| ImuSample {
        number,
        ticks: number as i64,
        time_ns,
        gyro_rad_s: [0.0; 3],
        accel_m_s2: [0.0; 3],
        temperature_c: None,
        time_unreliable: false,
    };
    let samples = [(0, 0), (1, 5), (2, 10), (3, 7), (4, 10), (5, 15)];
    samples.map(of).to_vec()
}

#[test]
fn overlapping_times_are_sorted_and_come_once() {
    let mut samples = replaced_map();
    sort_by_time(&mut samples);
    let found: Vec<_> = samples.iter().map(|s| (s.number, s.time_ns)).collect();
    assert_eq!(found, [(0, 0), (1, 5), (3, 7), (2, 10), (5, 15)]);
}

#[test]
fn times_that_do_not_increase_are_left_out() {
    let samples = replaced_map();
    let found = increasing_in_time(&samples).map(|s| s.number);
    assert_eq!(found.collect::<Vec<_>>(), [0, 1, 2, 5]);
}
