//! Chunks that are there twice or out of order, of which some are damaged. No recorder leaves them
//! so; the copy must nevertheless have no fault that the source does not have.

use std::sync::LazyLock;

use super::*;
use damaged_frames::units;
use proptest::prelude::*;
use support::numbers::{check_numbers, numbers};

/// What happens to a chunk.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Harm {
    No,
    /// One bit of this access unit is wrong.
    Unit(usize),
    /// One bit of the checksum is wrong, so that nothing can be saved.
    Checksum,
}
use Harm::{Checksum, No, Unit};

/// A session of one segment with a head and six chunks, some frames of which are in gap records.
struct Whole {
    disk: FaultStorage,
    bytes: Vec<u8>,
    chunks: Vec<ChunkAt>,
    /// Places in the access units of each chunk, with stream and number.
    units: Vec<Vec<(Range<usize>, String, u64)>>,
}

static WHOLE: LazyLock<Whole> = LazyLock::new(|| {
    let mut samples = samples(3.0);
    for sample in &mut samples {
        if let Sample::Frame {
            camera,
            number,
            time,
            key: false,
        } = *sample
            && number % 7 == 3
        {
            *sample = Sample::Gap {
                camera,
                number,
                time,
            };
        }
    }
    let disk = clean(&samples);
    let bytes = disk.content(&layout::segment(0)).expect("segment");
    let chunks = chunks(&disk, 0);
    assert_eq!(chunks.len(), 7);
    let manifest = open(&disk).manifest().clone();
    let units = chunks.iter().map(|c| units(&bytes, c, &manifest)).collect();
    Whole {
        disk,
        bytes,
        chunks,
        units,
    }
});

/// The session with these chunks of its own.
fn session(order: &[(usize, Harm)]) -> FaultStorage {
    let Whole {
        disk,
        bytes,
        chunks,
        units,
    } = &*WHOLE;
    let mut segment = bytes[..chunks[0].bytes.start].to_vec();
    for (i, harm) in order {
        let chunk = &chunks[*i];
        let start = segment.len();
        segment.extend(&bytes[chunk.bytes.start..chunk.indexes.end]);
        match harm {
            Unit(k) if !units[*i].is_empty() => {
                let at = units[*i][k % units[*i].len()].0.start;
                segment[start + at - chunk.bytes.start] ^= 0x20;
            }
            No | Unit(_) => {}
            Checksum => segment[start + 33] ^= 1,
        }
    }
    segment.extend(&bytes[chunks[6].indexes.end..]);
    let disk = disk.snapshot();
    disk.set_content(&layout::segment(0), segment);
    disk
}

/// Recovers these chunks into a sound copy: numbers of gap records that recovery wrote, by stream,
/// and how many chunks were saved.
fn gaps_of_recovery(order: &[(usize, Harm)]) -> (Missing, u64) {
    let disk = session(order);
    let (result, target) = recovered(&disk);
    let copy = open(&target);
    check_numbers(&open(&disk), &copy);
    let mut missing = Missing::new();
    for gap in recorded_gaps(&messages(&copy), copy.manifest()) {
        if gap.cause() == Cause::Damaged {
            missing
                .entry(gap.stream)
                .or_default()
                .extend(gap.first..=gap.last);
        }
    }
    (missing, result.saved_chunks)
}

/// The frame of this access unit.
fn frame(chunk: usize, unit: usize) -> Missing {
    let (_, camera, number) = &WHOLE.units[chunk][unit];
    Missing::from([(camera.clone(), BTreeSet::from([*number]))])
}

const HEAD: (usize, Harm) = (0, No);

#[test]
fn nothing_is_saved_of_a_chunk_of_which_a_sound_one_is_there() {
    let all = |first: &[(usize, Harm)], rest: Range<usize>| {
        let mut order = first.to_vec();
        order.extend(rest.map(|i| (i, No)));
        gaps_of_recovery(&order)
    };
    let none = (Missing::new(), 0);
    assert_eq!(all(&[HEAD], 1..7), none);
    // In front of the sound one, behind it, far behind it, and in front of the head.
    assert_eq!(all(&[HEAD, (1, Unit(3))], 1..7), none);
    assert_eq!(all(&[HEAD, (1, No), (1, Unit(3))], 2..7), none);
    assert_eq!(
        all(&[HEAD, (1, No), (2, No), (3, No), (1, Unit(3))], 4..7),
        none
    );
    assert_eq!(all(&[(1, Unit(3)), HEAD], 1..7), none);
}

#[test]
fn of_two_damaged_chunks_the_first_is_saved() {
    let order = [
        HEAD,
        (1, Unit(3)),
        (1, Unit(5)),
        (2, No),
        (3, No),
        (4, No),
        (5, No),
        (6, No),
    ];
    assert_eq!(gaps_of_recovery(&order), (frame(1, 3), 1));
}

/// It would bring the sound chunk behind it out of order, or is so itself.
#[test]
fn a_damaged_chunk_out_of_order_is_lost() {
    let rest = [(4, No), (5, No), (6, No)];
    let known = numbers(&open(&session(
        &[&[HEAD, (1, No), (2, No)], &rest[..]].concat(),
    )));
    let mut expected = Missing::new();
    for (stream, number) in numbers(&open(&WHOLE.disk)).into_keys() {
        if !known.contains_key(&(stream.clone(), number)) {
            expected.entry(stream).or_default().insert(number);
        }
    }
    assert_eq!(expected.len(), 3, "two cameras and an IMU");
    for order in [
        [HEAD, (1, No), (3, Unit(3)), (2, No)],
        [HEAD, (1, No), (2, No), (3, Checksum)],
    ] {
        let order = [&order, &rest[..]].concat();
        assert_eq!(gaps_of_recovery(&order), (expected.clone(), 0));
    }
    let order = [
        HEAD,
        (1, No),
        (2, No),
        rest[0],
        (3, Unit(3)),
        rest[1],
        rest[2],
    ];
    assert_eq!(gaps_of_recovery(&order), (expected, 0));
}

/// Damage in front of the head of another session does not make it this one's.
#[test]
fn a_foreign_segment_with_damage_in_front_of_its_head() {
    let disk = session(&[(1, Unit(3)), HEAD, (1, No), (2, No)]);
    let mut manifest = open(&disk).manifest().clone();
    manifest.session_id = "0192aa00-0000-7000-8000-000000000002".to_owned();
    disk.set_content(layout::MANIFEST, manifest.to_bytes());
    let (result, target) = recovered(&disk);
    let kinds = result.source.damage.iter().map(|d| d.damage.kind);
    assert!(kinds.eq([DamageKind::Checksum, DamageKind::Foreign]));
    assert_eq!(result.saved_chunks, 0);
    assert!(
        result
            .copy
            .streams
            .values()
            .all(|stream| stream.samples == 0)
    );
    let recorded =
        |m: &&Message| Some(m.stream) != open(&target).manifest().stream::<Gap>("").map(|s| s.id);
    assert_eq!(
        messages(&open(&target)).iter().filter(recorded).count(),
        1,
        "the event of recovery"
    );
}

fn harm() -> impl Strategy<Value = Harm> {
    prop_oneof![3 => Just(No), 3 => (0..40_usize).prop_map(Unit), 1 => Just(Checksum)]
}

proptest! {
    #![proptest_config(ProptestConfig {
        failure_persistence: None,
        ..ProptestConfig::default()
    })]

    /// Any of its own chunks in any order.
    #[test]
    fn the_copy_has_no_new_fault(
        order in proptest::collection::vec((0..7_usize, harm()), 0..12),
        head_first: bool,
        with_manifest: bool,
    ) {
        let mut order = order;
        if head_first {
            order.insert(0, HEAD);
        }
        let mut source = session(&order);
        if !with_manifest {
            source = without(&source, layout::MANIFEST);
        }
        if let Ok(reader) = SessionReader::open(Arc::new(source.clone())) {
            let target = FaultStorage::new();
            let result = recover(&reader, Arc::new(target.clone()), |_| {}).expect("recover");
            prop_assert_eq!(&result.copy.lost, &[]);
            prop_assert_eq!(&result.copy.damage, &[]);
            for (name, stream) in &result.copy.streams {
                let source = result.source.streams.get(name).cloned().unwrap_or_default();
                prop_assert_eq!(stream.repeated, source.repeated, "{}", name);
                prop_assert_eq!((stream.contradicted, stream.bad_payloads), (0, 0), "{}", name);
                prop_assert_eq!(stream.samples + stream.gaps, stream.expected(), "{}", name);
            }
            check_numbers(&reader, &open(&target));
        }
    }
}
