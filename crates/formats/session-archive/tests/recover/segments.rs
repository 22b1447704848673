//! Segments and manifests that are missing, damaged, or of another session.

use super::*;

/// Two minutes in three segments, with a clock map in each.
fn long() -> (Vec<Sample>, FaultStorage) {
    let samples = samples_at([500 * MS, 500 * MS], 125.0);
    let disk = FaultStorage::new();
    let mut writer = SessionWriter::create(Arc::new(disk.clone()), spec()).expect("create");
    for sample in &samples {
        let since = sample.time() - START;
        if matches!(sample, Sample::Mark { .. }) && since % (50_000 * MS) == 0 {
            let map = ClockMap {
                clock: "feet".to_owned(),
                version: (since / (50_000 * MS)) as u32 + 1,
                ..ClockMap::default()
            };
            writer
                .append("feet", sample.time(), sample.time(), &map)
                .expect("map");
        }
        put(&mut writer, sample, 40).expect("put");
    }
    writer.close(stop(START)).expect("close");
    assert_eq!(writer.manifest().segments.len(), 3);
    (samples, disk)
}

fn clock_versions(reader: &SessionReader) -> Vec<u32> {
    let id = reader
        .manifest()
        .stream::<ClockMap>("feet")
        .expect("stream")
        .id;
    let all = messages(reader);
    let maps = all.iter().filter(|m| m.stream == id);
    maps.map(|m| m.decode::<ClockMap>().expect("map").version)
        .collect()
}

#[test]
fn a_missing_segment_is_lost_by_number_and_its_state_is_not() {
    let (samples, disk) = long();
    for segment in 0..3 {
        let gone = chunks(&disk, segment);
        let source = without(&disk, &layout::segment(segment));
        let (result, target) = recovered(&source);
        assert_eq!(result.source.missing_segments, [segment]);
        let all: Vec<&ChunkAt> = gone.iter().collect();
        assert_eq!(result.source.lost, lost(&samples, &all));
        assert_eq!(segments(&target).len(), 3, "numbers stay what they were");
        // What a later head repeats is not lost; of the first minute's two maps that is the second.
        let known: &[u32] = if segment == 0 { &[2, 3] } else { &[1, 2, 3] };
        assert_eq!(clock_versions(&open(&source)), known, "segment {segment}");
        assert_eq!(clock_versions(&open(&target)), known, "segment {segment}");
    }
}

#[test]
fn a_damaged_head_is_made_again_with_the_state_so_far() {
    let (_, disk) = long();
    change(&disk, 2, |bytes| bytes[3000] ^= 1);
    let (result, target) = recovered(&disk);
    assert_eq!(result.source.lost, []);
    let alone = FaultStorage::new();
    let path = layout::segment(2);
    alone.set_content(&path, target.content(&path).expect("segment"));
    let alone = open(&alone);
    assert_eq!(alone.manifest().cameras.len(), 2);
    assert_eq!(clock_versions(&alone), [3]);
}

#[test]
fn a_session_without_its_manifest() {
    let (_, disk) = long();
    let whole = messages(&open(&disk)).len();
    let path = layout::MANIFEST;
    let content = disk.content(path).expect("manifest");
    let torn = disk.snapshot();
    torn.set_content(path, content[..content.len() / 2].to_vec());
    let changed = disk.snapshot();
    let text = String::from_utf8(content).expect("text");
    changed.set_content(
        path,
        text.replace("\"rate_hz\": 30", "\"rate_hz\": 31").into(),
    );
    for (source, note) in [
        (without(&disk, path), "missing"),
        (torn, "no checksum"),
        (changed, "does not match"),
    ] {
        let (result, target) = recovered(&source);
        let found = result.source.manifest_note.expect("note");
        assert!(found.contains(note), "{found}");
        assert_eq!(messages(&open(&target)).len(), whole);
        assert_eq!(segments(&target), segments(&disk));
        let (was, is) = (
            open(&disk).manifest().clone(),
            open(&target).manifest().clone(),
        );
        assert_eq!((was.cameras, was.extents), (is.cameras, is.extents));
        assert_eq!(is.state, State::Recovered);
    }
}

/// The heads of a recovered copy fit the copy, whose segments have other lengths: they would be
/// used if its manifest were lost.
#[test]
fn a_recovered_copy_stands_without_its_manifest() {
    let (_, disk) = long();
    let at = chunks(&disk, 0)[20].bytes.start;
    change(&disk, 0, |bytes| bytes[at + 100] ^= 1);
    let (_, copy) = recovered(&disk);
    let bare = without(&copy, layout::MANIFEST);
    let (result, _) = recovered(&bare);
    assert_eq!(result.source.damage, []);
    assert_eq!(messages(&open(&bare)).len(), messages(&open(&copy)).len());
}

/// Without a manifest, the heads alone tell that a segment was given up and what of it counts.
#[test]
fn bytes_of_a_segment_that_was_given_up_do_not_count() {
    let samples = samples(3.0);
    let log = clean(&samples).log();
    let is_large = |o: &Operation| matches!(o, Operation::Append(n) if *n > 5000);
    let summary = log.iter().rposition(is_large).expect("summary");
    let last_chunk = log[..summary].iter().rposition(is_large).expect("chunk") as u64;
    let fault = Fault {
        at: last_chunk + 1,
        kind: FaultKind::InputOutput,
        keep: 0,
    };
    let disk = FaultStorage::with_faults([fault]);
    record(Arc::new(disk.clone()), &samples, UNIT).expect("record");
    let disk = disk.snapshot();
    let segments = open(&disk).manifest().segments.clone();
    assert_eq!(segments.len(), 2);
    // The bad place remains taken, or the file system would give it to the next segment.
    let kept = disk.content(&layout::segment(0)).expect("segment").len() as u64;
    assert!(kept > segments[0].bytes, "{kept} {segments:?}");
    let whole = messages(&open(&disk)).len();
    assert_eq!(whole, messages(&open(&clean(&samples))).len());
    assert!(verify(&open(&disk), |_| {}).expect("verify").is_sound());
    let source = without(&disk, layout::MANIFEST);
    let (result, target) = recovered(&source);
    assert_eq!(result.source.streams["feet"].repeated, 0);
    assert_eq!(messages(&open(&target)).len(), whole);
}

/// Another session of the same rig: the same streams, and numbers that go on.
fn other() -> FaultStorage {
    let disk = FaultStorage::new();
    let mut spec = spec();
    spec.session_id = "0192aa00-0000-7000-8000-000000000002".to_owned();
    let mut writer = SessionWriter::create(Arc::new(disk.clone()), spec).expect("create");
    for sample in samples(1.0) {
        put(&mut writer, &sample, UNIT).expect("put");
    }
    writer.close(stop(START)).expect("close");
    disk
}

/// Every checksum of such a segment holds, and it is not what was recorded.
#[test]
fn a_segment_of_another_session_or_number_is_damage() {
    let (_, disk) = long();
    let mine = disk.content(&layout::segment(1)).expect("segment");
    let theirs = other().content(&layout::segment(0)).expect("segment");
    for (number, content) in [(0, &theirs), (1, &theirs), (0, &mine)] {
        let disk = disk.snapshot();
        disk.set_content(&layout::segment(number), content.clone());
        let (result, copy) = recovered(&disk);
        let damage = &result.source.damage;
        assert_eq!(damage.len(), 1, "{damage:?}");
        assert_eq!(damage[0].segment, number);
        assert_eq!(damage[0].damage.kind, DamageKind::Foreign);
        assert_eq!(damage[0].damage.bytes, 0..content.len() as u64);
        assert!(result.source.streams["feet"].lost > 0);
        assert_eq!(result.source.streams["feet"].repeated, 0);
        // Nothing of it is in the copy: those that were in their place are.
        let bytes = |disk: &FaultStorage| -> Vec<Vec<u8>> {
            let messages = messages(&open(disk)).into_iter();
            messages
                .filter(|m| m.segment != number)
                .map(|m| m.data.to_vec())
                .collect()
        };
        let (kept, whole) = (bytes(&copy), bytes(&disk));
        assert_eq!(kept[..whole.len()], whole);
    }
}

/// A whole file of the same session and number, that somebody made in another way.
#[test]
fn a_closed_segment_has_the_length_that_the_manifest_says() {
    let disk = clean(&samples(3.0));
    let shorter = clean(&samples(1.0));
    let path = layout::segment(0);
    disk.set_content(&path, shorter.content(&path).expect("segment"));
    let report = verify(&open(&disk), |_| {}).expect("verify");
    let kinds: Vec<_> = report.damage.iter().map(|d| d.damage.kind).collect();
    assert_eq!(kinds, [DamageKind::Length]);
    let disk = clean(&samples(1.0));
    let longer = clean(&samples(3.0));
    disk.set_content(&path, longer.content(&path).expect("segment"));
    let report = verify(&open(&disk), |_| {}).expect("verify");
    let kinds: Vec<_> = report.damage.iter().map(|d| d.damage.kind).collect();
    assert_eq!(kinds, [DamageKind::Length]);
}

/// A file with a number far away costs nothing, with the manifest and without.
#[test]
fn a_stray_file_does_not_make_a_million_segments() {
    let disk = clean(&samples(1.0));
    disk.set_content(&layout::segment(999_999), b"not ours".to_vec());
    for manifest in [true, false] {
        let disk = match manifest {
            true => disk.snapshot(),
            false => without(&disk, layout::MANIFEST),
        };
        assert_eq!(open(&disk).segment_numbers().count(), 1);
        let (result, copy) = recovered(&disk);
        let damage = &result.source.damage;
        assert_eq!((damage.len(), damage[0].segment), (1, 999_999));
        assert_eq!(damage[0].damage.kind, DamageKind::Foreign);
        assert_eq!(damage[0].damage.bytes, 0..8);
        assert_eq!(segments(&copy).len(), 1);
    }
}
