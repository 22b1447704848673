//! Damaged chunks: what they cost, and how that is recorded.

use super::*;
use damaged_frames::damaged_frames;

/// Damages a session of four seconds in one way; `gone` are the chunks (0 is the head) that a
/// reader cannot use. If the damage is in access units alone, recovery loses no more than their
/// frames, else those chunks. Everything else must survive.
fn check(name: &str, damage: impl FnOnce(&mut Vec<u8>, &[ChunkAt]), gone: &[usize]) {
    let samples = samples(4.0);
    let disk = clean(&samples);
    let chunks = chunks(&disk, 0);
    assert_eq!(chunks.len(), 9);
    let whole = messages(&open(&disk));
    let original = disk.content(&layout::segment(0)).expect("segment");
    change(&disk, 0, |bytes| damage(bytes, &chunks));
    let damaged = disk.content(&layout::segment(0)).expect("segment");

    let (result, target) = recovered(&disk);
    assert!(!result.source.is_sound(), "{name}: not noticed");
    assert!(!result.source.damage.is_empty(), "{name}: no damage");
    let gone: Vec<&ChunkAt> = gone.iter().map(|i| &chunks[*i]).collect();
    assert_eq!(result.source.lost, lost(&samples, &gone), "{name}");

    let manifest = open(&disk).manifest().clone();
    let mut missing_numbers = Missing::new();
    let mut missing_places = BTreeSet::new();
    for chunk in &gone {
        let frames = damaged_frames(&original, &damaged, chunk, &manifest);
        for m in whole
            .iter()
            .filter(|m| m.chunk_offset == chunk.bytes.start as u64)
        {
            let camera = &manifest.streams[usize::from(m.stream) - 1].of;
            let is_gone = frames.as_ref().is_none_or(|frames| {
                let numbers = frames.get(camera);
                numbers.is_some_and(|n| n.contains(&u64::from(m.sequence)))
            });
            if is_gone {
                missing_places.insert((m.chunk_offset, m.payload_offset));
            }
        }
        for (stream, numbers) in frames.unwrap_or_else(|| missing(&[chunk])) {
            missing_numbers.entry(stream).or_default().extend(numbers);
        }
    }
    let expected = lost_without(&samples, &missing_numbers);
    assert_eq!(result.lost, expected, "{name}");

    // The copy says so itself.
    let copy = open(&target);
    let found = messages(&copy);
    let gaps = recorded_gaps(&found, copy.manifest());
    assert_eq!(gaps.len(), expected.len(), "{name}");
    for (gap, lost) in gaps.iter().zip(&expected) {
        assert_eq!(gap.cause(), Cause::Damaged, "{name}");
        let span = (gap.first, gap.last, gap.time_before, gap.time_after);
        let (after, before) = (Some(lost.after.0), Some(lost.before.0));
        assert_eq!(span, (lost.first, lost.last, after, before), "{name}");
        assert_eq!(gap.stream, lost.stream, "{name}");
    }
    for (stream, report) in &result.copy.streams {
        let whole = report.samples + report.gaps;
        assert_eq!(whole, report.expected(), "{name}: {stream}");
    }

    // And holds everything else, byte for byte.
    let is_gone = |m: &Message| missing_places.contains(&(m.chunk_offset, m.payload_offset));
    let kept = whole.iter().filter(|m| !is_gone(m));
    let of_recovery = if gaps.is_empty() { 0 } else { gaps.len() + 1 };
    let (found, added) = found.split_at(found.len() - of_recovery);
    assert_eq!(added.len(), of_recovery);
    assert!(
        kept.map(|m| (m.stream, m.sequence, m.time, &m.data))
            .eq(found
                .iter()
                .map(|m| (m.stream, m.sequence, m.time, &m.data))),
        "{name}: the copy holds something else"
    );
}

#[test]
fn a_flip_costs_the_chunk_that_it_is_in_and_no_other() {
    for i in [0, 1, 4, 8] {
        check("payload", |b, c| b[c[i].bytes.start + 200] ^= 0x10, &[i]);
        check("last byte", |b, c| b[c[i].bytes.end - 1] ^= 0x80, &[i]);
        check("opcode", |b, c| b[c[i].bytes.start] ^= 1, &[i]);
        check(
            "opcode of a data end",
            |b, c| b[c[i].bytes.start] = 0x0F,
            &[i],
        );
        check("length", |b, c| b[c[i].bytes.start + 1] ^= 1, &[i]);
        check("huge length", |b, c| b[c[i].bytes.start + 8] = 0xFF, &[i]);
        check("size", |b, c| b[c[i].bytes.start + 26] ^= 1, &[i]);
        check("checksum", |b, c| b[c[i].bytes.start + 33] ^= 1, &[i]);
        check("compression", |b, c| b[c[i].bytes.start + 37] ^= 1, &[i]);
        check(
            "records' length",
            |b, c| b[c[i].bytes.start + 41] ^= 1,
            &[i],
        );
    }
}

#[test]
fn damage_beside_the_messages_costs_no_message() {
    for i in [0, 1, 4, 8] {
        check("start time", |b, c| b[c[i].bytes.start + 9] ^= 1, &[]);
        check("end time", |b, c| b[c[i].bytes.start + 23] ^= 1, &[]);
        check("index opcode", |b, c| b[c[i].indexes.start] ^= 0x20, &[]);
        check("index as chunk", |b, c| b[c[i].indexes.start] = 0x06, &[]);
        check(
            "index as data end",
            |b, c| b[c[i].indexes.start] = 0x0F,
            &[],
        );
        check("index length", |b, c| b[c[i].indexes.start + 1] ^= 3, &[]);
        check("index entry", |b, c| b[c[i].indexes.end - 3] ^= 1, &[]);
    }
    let end = |c: &[ChunkAt]| c[8].indexes.end;
    check("magic", |b, _| b[0] = 0, &[]);
    check("header", |b, _| b[12] ^= 1, &[]);
    check("header length", |b, _| b[9] ^= 1, &[]);
    check("data end", |b, c| b[end(c)] ^= 1, &[]);
    check("data end length", |b, c| b[end(c) + 1] ^= 1, &[]);
    check("data checksum", |b, c| b[end(c) + 9] ^= 1, &[]);
    check("summary", |b, c| b[end(c) + 100] ^= 1, &[]);
    check(
        "footer",
        |b, _| b.iter_mut().rev().nth(20).map_or((), |b| *b ^= 1),
        &[],
    );
    check(
        "last magic",
        |b, _| b.iter_mut().last().map_or((), |b| *b ^= 1),
        &[],
    );
    check("summary gone", |b, c| b.truncate(end(c)), &[]);
    check("summary cut", |b, c| b.truncate(end(c) + 40), &[]);
    check("longer", |b, _| b.extend([0; 512]), &[]);
}

#[test]
fn blocks_and_ends_that_are_gone() {
    // Zeros where the disk lost a block: over the seam of two chunks, and inside one.
    check(
        "seam",
        |b, c| b[c[3].bytes.end - 2000..][..4096].fill(0),
        &[3, 4],
    );
    check(
        "inside",
        |b, c| b[c[3].bytes.start + 100..][..4096].fill(0),
        &[3],
    );
    check("the magic and the head", |b, _| b[..4096].fill(0), &[0]);
    // Blocks that are not there at all, so that everything behind has moved.
    let cut = |b: &mut Vec<u8>, r: Range<usize>| drop(b.drain(r));
    check(
        "inside, removed",
        |b, c| cut(b, c[5].bytes.start + 100..c[5].bytes.start + 612),
        &[5],
    );
    // Where chunk 5 said it would end there is now the middle of chunk 6, which is whole.
    check(
        "much removed",
        |b, c| cut(b, c[5].bytes.start + 100..c[5].bytes.start + 3100),
        &[5],
    );
    check(
        "seam, removed",
        |b, c| cut(b, c[5].bytes.end - 100..c[6].bytes.start + 400),
        &[5, 6],
    );
    check(
        "a chunk, removed",
        |b, c| cut(b, c[5].bytes.start..c[5].indexes.end),
        &[5],
    );
    check("a record, removed", |b, c| cut(b, c[5].bytes.clone()), &[5]);
    // Bytes that do not belong there.
    check(
        "inserted",
        |b, c| drop(b.splice(c[6].bytes.start..c[6].bytes.start, [7; 1000])),
        &[],
    );
    check(
        "cut in the last chunk",
        |b, c| b.truncate(c[8].bytes.end - 1),
        &[8],
    );
    check(
        "cut in a chunk",
        |b, c| b.truncate(c[6].bytes.start + 3000),
        &[6, 7, 8],
    );
    check(
        "cut between chunks",
        |b, c| b.truncate(c[6].indexes.end),
        &[7, 8],
    );
    check(
        "cut to the magic",
        |b, _| b.truncate(8),
        &[0, 1, 2, 3, 4, 5, 6, 7, 8],
    );
    check(
        "cut to nothing",
        |b, _| b.clear(),
        &[0, 1, 2, 3, 4, 5, 6, 7, 8],
    );
    // Two kinds simultaneously.
    check(
        "everywhere",
        |b, c| {
            b[c[1].bytes.start + 60] ^= 1;
            b[c[3].bytes.start + 1] ^= 0xFF;
            b[c[8].bytes.end - 1] ^= 1;
            let n = b.len();
            b[n - 12] ^= 1;
        },
        &[1, 3, 8],
    );
}

/// Cut off, so that no checksum over the whole file helps: a header that contradicts the chunk's
/// content is noticed all the same, and costs nothing.
#[test]
fn a_wrong_header_in_a_session_that_was_cut_off() {
    let whole = clean(&samples(3.0));
    let chunks = chunks(&whole, 0);
    let disk = whole.snapshot();
    disk.set_content(layout::MANIFEST, {
        let mut manifest = open(&whole).manifest().clone();
        manifest.state = State::Recording;
        manifest.segments.clear();
        manifest.extents.clear();
        manifest.to_bytes()
    });
    let at = chunks[3].bytes.start;
    change(&disk, 0, |bytes| {
        bytes.truncate(chunks[5].indexes.end);
        bytes[at + 10] ^= 1;
    });
    let (result, target) = recovered(&disk);
    let kinds: Vec<_> = result.source.damage.iter().map(|d| d.damage.kind).collect();
    assert_eq!(kinds, [DamageKind::Header]);
    change(&disk, 0, |bytes| bytes[at + 10] ^= 1);
    assert_eq!(messages(&open(&target)).len(), messages(&open(&disk)).len());
}

#[test]
fn damage_is_an_entry_like_any_other() {
    let disk = clean(&samples(3.0));
    let at = chunks(&disk, 0)[3].bytes.clone();
    change(&disk, 0, |bytes| bytes[at.start + 77] ^= 1);
    let reader = open(&disk);
    let mut damage = Vec::new();
    for entry in reader.entries() {
        if let Entry::Damage { segment, damage: d } = entry.expect("read") {
            damage.push((segment, d.bytes));
        }
    }
    assert_eq!(damage, [(0, at.start as u64..at.end as u64)]);
}
