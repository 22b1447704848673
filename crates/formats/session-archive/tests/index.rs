//! The derived index and the hand-off.

mod support;

use std::sync::Arc;

use session_archive::handoff::{Check, HandOff, HandOffError, Verdict};
use session_archive::index::{Access, FrameEntry, Index, IndexError};
use session_archive::layout;
use session_archive::reader::SessionReader;
use session_archive::record::{FrameSet, paws::frame_set::Member};
use session_archive::recover::recover;
use session_archive::storage::FaultStorage;
use session_archive::time::{CivilTime, HostTime};
use session_archive::writer::SessionWriter;
use support::{MS, START, Sample, put, samples, spec, stop, unit};

/// Three seconds with a frame set for every frame of `feet`.
fn session() -> FaultStorage {
    let disk = FaultStorage::new();
    let mut writer = SessionWriter::create(Arc::new(disk.clone()), spec()).expect("create");
    let mut sets = 0;
    for sample in samples(3.0) {
        put(&mut writer, &sample, 200).expect("put");
        if let Sample::Frame {
            camera: 1,
            number,
            time,
            ..
        } = sample
        {
            let member = Member {
                camera: "feet".to_owned(),
                number,
                time: time.0,
            };
            let set = FrameSet {
                number: sets,
                time: time.0,
                members: vec![member],
                missing: vec!["left_shoulder".to_owned()],
            };
            writer.append("", time, time, &set).expect("set");
            sets += 1;
        }
    }
    writer.close(stop(START)).expect("close");
    disk
}

fn open(disk: &FaultStorage) -> SessionReader {
    SessionReader::open(Arc::new(disk.clone())).expect("open")
}

#[test]
fn every_frame_is_found_where_the_index_says() {
    let disk = session();
    let reader = open(&disk);
    let index = Index::build(&reader, |_| {}).expect("build");
    let access = Access::open(&disk, &index).expect("access");
    assert_eq!(index.cameras[0].frames.len(), 91);
    assert_eq!(index.cameras[1].frames.len(), 60);
    for (camera, list) in index.cameras.iter().enumerate() {
        assert_eq!(list.undecodable, 0);
        for frame in &list.frames {
            let bytes = access.unit(frame).expect("unit");
            assert_eq!(bytes[..], unit(camera as u64, frame.number, 200)[..]);
        }
    }
    let feet = index.camera("feet").expect("feet");
    assert_eq!(
        feet.gop(13),
        10..20,
        "20 Hz and half a second: key frames at 0, 10, 20, ..."
    );
    let batches = &index.imu("feet/imu").expect("imu").batches;
    assert_eq!(batches.len(), 30);
    for (batch, first) in batches.iter().zip((0..).step_by(20)) {
        assert_eq!(access.batch(batch).expect("batch").first_number, first);
    }
}

#[test]
fn frame_sets_by_number_and_time() {
    let disk = session();
    let index = Index::build(&open(&disk), |_| {}).expect("build");
    assert_eq!(index.sets.len(), 60);
    assert_eq!(index.set(17), Some(17));
    assert_eq!(index.sets[17].frames, [None, Some(17)]);
    assert_eq!(index.set(60), None);
    let near = index.set_at(START + 7 * MS + 20 * 50 * MS + 24 * MS);
    assert_eq!(near, Some(20));
    assert_eq!(index.set_at(HostTime::MAX), Some(59));
}

#[test]
fn an_index_is_stored_and_refused_when_it_does_not_fit() {
    let disk = session();
    let reader = open(&disk);
    let index = Index::build(&reader, |_| {}).expect("build");
    let bytes = index.to_bytes().expect("encode");
    assert!(
        matches!(Index::read(&reader), Err(IndexError::Io(_))),
        "there is none yet"
    );
    disk.set_content(layout::INDEX, bytes.clone());
    assert_eq!(Index::read(&reader).expect("read"), index);
    for at in 0..bytes.len() {
        let mut broken = bytes.clone();
        broken[at] ^= 0x40;
        // The claimed size is not under the checksum; too large a claim only reserves.
        if let Ok(found) = Index::from_bytes(&broken) {
            assert_eq!(found, index, "byte {at}");
        }
    }
    let mut segment = disk.content(&layout::segment(0)).expect("segment");
    segment.push(0);
    disk.set_content(&layout::segment(0), segment);
    assert!(matches!(
        Index::read(&open(&disk)),
        Err(IndexError::Stale(_))
    ));
}

#[test]
fn a_changed_session_is_noticed_when_it_is_read() {
    let disk = session();
    let index = Index::build(&open(&disk), |_| {}).expect("build");
    let frame = index.cameras[0].frames[40];
    let path = layout::segment(frame.segment);
    let mut segment = disk.content(&path).expect("segment");
    segment[frame.offset as usize + 7] ^= 1;
    disk.set_content(&path, segment);
    let access = Access::open(&disk, &index).expect("access");
    assert!(matches!(
        access.unit(&frame),
        Err(IndexError::Mismatch { .. })
    ));
    assert!(access.unit(&index.cameras[0].frames[41]).is_ok());
    // Rebuilt, the index leaves out what lies in the damaged chunk, and nothing else.
    let again = Index::build(&open(&disk), |_| {}).expect("build");
    assert_eq!(again.cameras[0].frames.len(), 91 - 15);
    assert_eq!(again.cameras[1].frames.len(), 60 - 10);
    assert_eq!((again.damaged, index.damaged), (1, 0));
}

/// Gap records of a recovered copy stand where damage was noticed in the source. Frames behind them
/// refer to frames that are not there, whichever of the two tells.
#[test]
fn frames_behind_lost_ones_are_not_decoded_without_them() {
    let disk = FaultStorage::new();
    let mut writer = SessionWriter::create(Arc::new(disk.clone()), spec()).expect("create");
    for mut sample in samples(3.0) {
        // A key frame in a second and a half: chunks do not wait for it, so some begin without.
        if let Sample::Frame {
            camera: 1,
            number,
            key,
            ..
        } = &mut sample
        {
            *key = (*number - 100) % 30 == 0;
        }
        put(&mut writer, &sample, 200).expect("put");
    }
    writer.close(stop(START)).expect("close");
    let whole = Index::build(&open(&disk), |_| {}).expect("build");
    assert_eq!(whole.cameras[1].undecodable, 0);
    let lost = whole.cameras[1].position(105).expect("position");
    let frame = whole.cameras[1].frames[lost];
    let path = layout::segment(frame.segment);
    let mut segment = disk.content(&path).expect("segment");
    segment[frame.offset as usize] ^= 1;
    disk.set_content(&path, segment);

    let damaged = Index::build(&open(&disk), |_| {}).expect("build");
    assert!(damaged.cameras[1].undecodable > 0);
    let copy = FaultStorage::new();
    recover(&open(&disk), Arc::new(copy.clone()), |_| {}).expect("recover");
    let recovered = Index::build(&open(&copy), |_| {}).expect("build");
    // All but the damaged frame is in the copy; those behind it refer to it, up to the key frame.
    let numbers = |index: &Index| -> Vec<(u64, u64)> {
        let frames = &index.cameras[1].frames;
        let key = |f: &FrameEntry| frames[f.key as usize].number;
        frames.iter().map(|f| (f.number, key(f))).collect()
    };
    let mut expected = numbers(&whole);
    expected.retain(|(number, _)| *number < 105 || *number >= 130);
    assert_eq!(numbers(&recovered), expected);
    assert_eq!(recovered.cameras[1].undecodable, 24);
    assert_eq!(
        recovered.cameras[0].frames.len(),
        whole.cameras[0].frames.len()
    );
}

/// A program that can write a folder can write the checksum of an index.
#[test]
fn what_an_index_claims_is_not_allocated() {
    // No identifier, then a list of 2^50 segments.
    let mut plain = vec![0, 253];
    plain.extend((1_u64 << 50).to_le_bytes());
    let packed = zstd::bulk::compress(&plain, 1).expect("pack");
    let mut bytes = b"PAWSIDX3".to_vec();
    bytes.extend(crc32fast::hash(&packed).to_le_bytes());
    bytes.extend((plain.len() as u64).to_le_bytes());
    bytes.extend(packed);
    let refused = Index::from_bytes(&bytes);
    assert!(
        matches!(&refused, Err(IndexError::Unreadable(why)) if why.contains("LimitExceeded")),
        "{refused:?}"
    );
}

#[test]
fn an_access_unit_without_bytes_is_found() {
    let disk = FaultStorage::new();
    let mut writer = SessionWriter::create(Arc::new(disk.clone()), spec()).expect("create");
    for sample in samples(0.5) {
        let bytes = match sample {
            Sample::Frame { number: 103, .. } => 0,
            _ => 20,
        };
        put(&mut writer, &sample, bytes).expect("put");
    }
    writer.close(stop(START)).expect("close");
    let index = Index::build(&open(&disk), |_| {}).expect("build");
    let access = Access::open(&disk, &index).expect("access");
    let frame = index.cameras[0].frame(103).expect("frame");
    assert!(access.unit(frame).expect("unit").is_empty());
}

#[test]
fn a_hand_off_is_sealed() {
    let disk = session();
    let id = open(&disk).manifest().session_id.clone();
    let files = [
        layout::MANIFEST.to_owned(),
        layout::segment(0),
        layout::rig_file("rig.toml"),
    ];
    let seal = |verdict| {
        HandOff::seal(&disk, &id, verdict, "tests", CivilTime(7), &files, |_| {}).expect("seal")
    };
    let sealed = seal(Verdict::Warn);
    let opened = HandOff::open(&disk, Check::Content, |_| {}).expect("open");
    assert_eq!(opened, sealed);

    let text = disk.content(layout::HANDOFF).expect("text");
    let edited = String::from_utf8(text)
        .expect("utf-8")
        .replace("WARN", "PASS");
    disk.set_content(layout::HANDOFF, edited.into_bytes());
    let refused = HandOff::open(&disk, Check::Lengths, |_| {});
    assert!(
        matches!(refused, Err(HandOffError::Invalid(_))),
        "{refused:?}"
    );

    seal(Verdict::Fail);
    let refused = HandOff::open(&disk, Check::Content, |_| {});
    assert!(matches!(refused, Err(HandOffError::Failed)), "{refused:?}");

    seal(Verdict::Pass);
    disk.set_content("rig/rig.toml", b"revision = 2\n".to_vec());
    assert!(
        HandOff::open(&disk, Check::Lengths, |_| {}).is_ok(),
        "the length is the same"
    );
    let refused = HandOff::open(&disk, Check::Content, |_| {});
    assert!(
        matches!(refused, Err(HandOffError::Changed { .. })),
        "{refused:?}"
    );
}
