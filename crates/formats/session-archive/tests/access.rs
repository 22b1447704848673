//! Random access through an opened index: by number and by time, in a long session.

use session_archive::index::{CameraIndex, FrameEntry, Index, SetEntry};
use session_archive::time::HostTime;

const SETS: u64 = 100_000;
const PERIOD: i64 = 33_333_333;

fn index() -> Index {
    let frame = |number: u64| FrameEntry {
        number,
        time_ns: number as i64 * PERIOD,
        sigma_ns: 1000,
        time_unreliable: false,
        host_time_ns: number as i64 * PERIOD + 5,
        device_ticks: number as i64,
        exposure_ns: Some(8_000_000),
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

/// A lookup that looked at all of the sets would take the first, which claims to be the one looked
/// for. No duration is measured: a busy machine would distort it.
#[test]
fn a_lookup_does_not_look_at_every_set() {
    let bytes = index().to_bytes().expect("bytes");
    let mut index = Index::from_bytes(&bytes).expect("index");
    assert_eq!(index.set(0), Some(0));
    assert_eq!(index.set_at(HostTime(PERIOD / 3)), Some(0));
    for number in (0..1000).map(|i| 1 + (i * 7919) % (SETS - 2)) {
        index.sets[0].number = number;
        let position = index.set(number).expect("set");
        assert_eq!(position, number as usize);

        index.sets[0].time_ns = i64::MAX;
        let at = HostTime(number as i64 * PERIOD + PERIOD / 3);
        assert_eq!(index.set_at(at), Some(position));
        index.sets[0].time_ns = 0;
    }
}

/// The last frame claims to be of the group.
#[test]
fn a_gop_does_not_look_at_every_frame() {
    let mut camera = index().cameras.remove(0);
    let last = SETS as usize - 1;
    for position in (0..1000).map(|i| (i * 7919) % (last - 15)) {
        let key = position / 15 * 15;
        camera.frames[last].key = key as u32;
        assert_eq!(camera.gop(position), key..key + 15);
    }
}
