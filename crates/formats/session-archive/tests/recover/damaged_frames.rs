//! Damage in access units, which costs their frames and nothing else.

use super::*;
use session_archive::index::Index;

/// The bytes of each access unit of a chunk in its segment's file, with camera and frame number.
pub(super) fn units(
    segment: &[u8],
    chunk: &ChunkAt,
    manifest: &Manifest,
) -> Vec<(Range<usize>, String, u64)> {
    let records = &segment[chunk.bytes.start + CHUNK_PREFIX..chunk.bytes.end];
    let base = segment.as_ptr() as usize;
    let mut units = Vec::new();
    for record in RecordIter::new(records).flatten() {
        let Record::Message(m) = record else { continue };
        let stream = &manifest.streams[usize::from(m.channel_id) - 1];
        if stream.schema == CompressedVideo::SCHEMA.name {
            let unit = CompressedVideo::decode(m.data).expect("video").data;
            let at = m.data.windows(unit.len()).position(|w| w == &unit[..]);
            let at = m.data.as_ptr() as usize - base + at.expect("the unit");
            let range = at..at + unit.len();
            units.push((range, stream.of.clone(), u64::from(m.sequence)));
        }
    }
    units
}

/// The frames of a chunk whose access units are damaged; `None` if anything else of the chunk is.
pub(super) fn damaged_frames(
    original: &[u8],
    damaged: &[u8],
    chunk: &ChunkAt,
    manifest: &Manifest,
) -> Option<Missing> {
    if original.len() != damaged.len() {
        return None;
    }
    let units = units(original, chunk, manifest);
    let mut missing = Missing::new();
    for at in chunk.bytes.clone().filter(|&i| original[i] != damaged[i]) {
        let (_, camera, number) = units.iter().find(|(range, ..)| range.contains(&at))?;
        missing.entry(camera.clone()).or_default().insert(*number);
    }
    Some(missing)
}

/// One flip in each of these units of one chunk: the frames are lost, and nothing else is.
#[test]
fn flips_in_access_units_cost_their_frames_alone() {
    let samples = samples(4.0);
    let whole = clean(&samples);
    let manifest = open(&whole).manifest().clone();
    let original = whole.content(&layout::segment(0)).expect("segment");
    let chunk = chunks(&whole, 0).swap_remove(4);
    let units = units(&original, &chunk, &manifest);
    let all = messages(&open(&whole));
    let is_in_chunk = |m: &&Message| m.chunk_offset == chunk.bytes.start as u64;
    let in_chunk = all.iter().filter(is_in_chunk).count();
    assert!(units.len() > 20 && in_chunk > 50, "{in_chunk}");
    for hit in [&[0][..], &[7], &[units.len() - 1], &[3, 4, 12]] {
        let disk = whole.snapshot();
        change(&disk, 0, |bytes| {
            for &k in hit {
                let range = &units[k].0;
                bytes[range.start + range.len() / 3] ^= 0x40;
            }
        });
        // A reader uses nothing of the chunk, recovery all but these frames.
        let read = messages(&open(&disk)).len();
        assert_eq!(read, all.len() - in_chunk);
        let (result, target) = recovered(&disk);
        assert_eq!(result.saved_chunks, 1);
        assert_eq!(result.saved_messages as usize, in_chunk - 2 * hit.len());
        let gaps: u64 = result.copy.streams.values().map(|s| s.gaps).sum();
        assert_eq!(gaps as usize, hit.len());
        let copied = messages(&open(&target)).len();
        let of_recovery = recorded_gaps(&messages(&open(&target)), &manifest).len() + 1;
        assert_eq!(copied - of_recovery, all.len() - 2 * hit.len());

        // Frames behind a lost one cannot be decoded up to the next key frame, and the index of
        // the copy does not offer them.
        let index = Index::build(&open(&target), |_| {}).expect("index");
        for (_, camera, number) in hit.iter().map(|&k| &units[k]) {
            let camera = index.camera(camera).expect("camera");
            let last = chunk.numbers[&camera.name].1;
            assert!((*number..=last).all(|n| camera.frame(n).is_none()));
            assert!(camera.frame(last + 1).is_some());
        }
    }
}

/// Without proof nothing is saved: of a chunk with one damaged byte outside of the access units no
/// frame, although every unit's own checksum holds.
#[test]
fn damage_outside_of_access_units_saves_nothing() {
    let whole = clean(&samples(4.0));
    let manifest = open(&whole).manifest().clone();
    let original = whole.content(&layout::segment(0)).expect("segment");
    let chunk = chunks(&whole, 0).swap_remove(4);
    let units = units(&original, &chunk, &manifest);
    let is_unit = |at: &usize| units.iter().any(|(range, ..)| range.contains(at));
    let outside = (chunk.bytes.start + CHUNK_PREFIX..chunk.bytes.end).filter(|at| !is_unit(at));
    for at in outside.step_by(61) {
        let disk = whole.snapshot();
        change(&disk, 0, |bytes| bytes[at] ^= 0x08);
        let (result, _) = recovered(&disk);
        assert_eq!(
            (result.saved_chunks, result.saved_messages),
            (0, 0),
            "byte {at}"
        );
        assert_eq!(result.lost, result.source.lost, "byte {at}");
    }
}
