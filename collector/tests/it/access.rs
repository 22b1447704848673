//! Random access through an opened index: by number and by time, in a long session.

#![expect(clippy::disallowed_methods, reason = "compares how long two ways take")]

use std::hint::black_box;
use std::time::{Duration, Instant};

use session_archive::index::{CameraIndex, FrameEntry, Index, SetEntry};
use session_archive::time::HostTime;

const SETS: u64 = 100_000;
const PERIOD: i64 = 33_333_333;

fn index() -> Index {
    let frame = |number: u64| FrameEntry {
        number,
        time_ns: number as i64 * PERIOD,
        sigma_ns: 1000,
        time_doubtful: false,
        host_time_ns: number as i64 * PERIOD + 5,
        device_ticks: number as i64,
        key: (number / 15 * 15) as u32,
        segment: (number / 1800) as u32,
        offset: number * 20_000,
        bytes: 20_000,
        crc32: number as u32,
    };
    let camera = |name: &str| CameraIndex {
        name: name.to_owned(),
        frames: (0..SETS).map(frame).collect(),
        undecodable: 0,
    };
    Index {
        session_id: "x".to_owned(),
        segments: vec![(0, 1)],
        cameras: vec![camera("a"), camera("b"), camera("c")],
        imus: Vec::new(),
        sets: (0..SETS)
            .map(|number| SetEntry {
                number,
                time_ns: number as i64 * PERIOD,
                frames: vec![Some(number as u32); 3],
            })
            .collect(),
        damaged: 0,
    }
}

/// The best of five: whatever else the machine does only makes one slower.
fn time(mut work: impl FnMut()) -> Duration {
    let once = |_| {
        let start = Instant::now();
        work();
        start.elapsed()
    };
    (0..5).map(once).min().expect("five")
}

/// Well under a millisecond on any machine means: not by looking at every set. A search through
/// all of them takes about 100 us here, so a lookup must be far faster than one such search.
#[test]
fn a_lookup_does_not_look_at_every_set() {
    let bytes = index().to_bytes().unwrap();
    let index = Index::from_bytes(&bytes).unwrap();
    let numbers: Vec<u64> = (0..1000).map(|i| (i * 7919) % SETS).collect();
    let searched = time(|| {
        for number in &numbers {
            let set = index.sets.iter().find(|s| s.number == black_box(*number));
            assert!(black_box(set).is_some());
        }
    });
    let by_number = time(|| {
        for number in &numbers {
            let set = &index.sets[index.set(black_box(*number)).unwrap()];
            assert_eq!(set.number, *number);
            let position = set.frames[2].unwrap() as usize;
            black_box(index.cameras[2].gop(position));
        }
    });
    let by_time = time(|| {
        for number in &numbers {
            let at = HostTime(*number as i64 * PERIOD + PERIOD / 3);
            assert_eq!(index.set_at(black_box(at)), Some(*number as usize));
        }
    });
    eprintln!(
        "one lookup among {SETS} sets: by number {:?}, by time {:?}, by searching {:?}",
        by_number / 1000,
        by_time / 1000,
        searched / 1000
    );
    assert!(by_number * 10 < searched, "{by_number:?} {searched:?}");
    assert!(by_time * 10 < searched, "{by_time:?} {searched:?}");
}
