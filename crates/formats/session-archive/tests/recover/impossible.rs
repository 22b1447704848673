//! Messages that no recorder can have written, under a checksum that holds.

use super::*;

/// Where the message record of the `k`-th message of a stream is in a chunk's records.
fn record_of(records: &[u8], stream: u16, k: usize) -> Range<usize> {
    let mut iter = RecordIter::new(records);
    let mut seen = 0;
    loop {
        let start = records.len() - iter.remaining();
        match iter.next().expect("a message").expect("a record") {
            Record::Message(m) if m.channel_id == stream => {
                if seen == k {
                    return start..records.len() - iter.remaining();
                }
                seen += 1;
            }
            _ => {}
        }
    }
}

/// Changes one message of a chunk and seals the chunk again: an own checksum over forged bytes.
fn forged(change_message: impl Fn(&mut [u8]), schema: &str, of: &str) -> (FaultStorage, Message) {
    let disk = clean(&samples(4.0));
    let manifest = open(&disk).manifest().clone();
    let mut streams = manifest.streams.iter();
    let stream = streams
        .find(|s| s.schema == schema && s.of == of)
        .expect("stream")
        .id;
    let chunk = chunks(&disk, 0).swap_remove(4);
    let of_chunk = |m: &&Message| m.chunk_offset == chunk.bytes.start as u64 && m.stream == stream;
    let message = messages(&open(&disk))
        .iter()
        .filter(of_chunk)
        .nth(1)
        .cloned();
    change(&disk, 0, |bytes| {
        let mut records = bytes[chunk.bytes.start + CHUNK_PREFIX..chunk.bytes.end].to_vec();
        let range = record_of(&records, stream, 1);
        change_message(&mut records[range]);
        let sealed = sealed_chunk(&records);
        bytes.splice(chunk.bytes.start..chunk.indexes.end, sealed);
    });
    (disk, message.expect("a second message"))
}

/// Bytes of a message record: its header, the channel, the sequence number, the log time.
const CHANNEL: usize = 9;
const LOG_TIME: usize = CHANNEL + 2 + 4;

fn set_log_time(time: u64) -> impl Fn(&mut [u8]) {
    move |record| record[LOG_TIME..LOG_TIME + 8].copy_from_slice(&time.to_le_bytes())
}

fn set_channel(channel: u16) -> impl Fn(&mut [u8]) {
    move |record| record[CHANNEL..CHANNEL + 2].copy_from_slice(&channel.to_le_bytes())
}

#[test]
fn an_impossible_half_of_a_frame_costs_the_frame() {
    type Change = Box<dyn Fn(&mut [u8])>;
    let changes: [(&str, Change); 6] = [
        (
            "log time at the end of time",
            Box::new(set_log_time(u64::MAX)),
        ),
        ("log time below zero", Box::new(set_log_time(1 << 63))),
        ("log time zero", Box::new(set_log_time(0))),
        (
            "log time of an hour later",
            Box::new(|record: &mut [u8]| record[LOG_TIME + 5] ^= 3),
        ),
        ("channel 0", Box::new(set_channel(0))),
        ("channel beyond the streams", Box::new(set_channel(999))),
    ];
    for schema in [CompressedVideo::SCHEMA.name, Frame::SCHEMA.name] {
        for (name, change) in &changes {
            let name = format!("{schema}: {name}");
            let (disk, message) = forged(change, schema, "feet");
            let reader = open(&disk);
            let report = verify(&reader, |_| {}).expect("verify");
            let kinds: BTreeSet<_> = report.damage.iter().map(|d| d.damage.kind as u8).collect();
            assert!(
                kinds.contains(&(DamageKind::Impossible as u8)),
                "{name}: {report:#?}"
            );
            let (result, target) = recovered(&disk);
            let frame = u64::from(message.sequence);
            let lost: Vec<_> = result
                .lost
                .iter()
                .map(|l| (&l.stream[..], l.first, l.last))
                .collect();
            assert_eq!(lost, [("feet", frame, frame)], "{name}");
            assert_eq!(result.copy.damage, [], "{name}");
            let (source, copy) = (messages(&reader), messages(&open(&target)));
            // A gap record and the event that recovery adds.
            assert_eq!(copy.len(), source.len() + 2, "{name}");
            assert!(
                copy.iter().all(|m| m.stream > 0 && m.time >= START),
                "{name}"
            );
        }
    }
}

#[test]
fn an_impossible_imu_batch_costs_its_samples() {
    let (disk, message) = forged(set_log_time(7), ImuBatch::SCHEMA.name, "feet/imu");
    let (result, target) = recovered(&disk);
    let batch: ImuBatch = message.decode().expect("batch");
    let last = batch.first_number + batch.times.len() as u64 - 1;
    let lost: Vec<_> = result.lost.iter().map(|l| (l.first, l.last)).collect();
    assert_eq!(lost, [(batch.first_number, last)]);
    assert!(messages(&open(&target)).iter().all(|m| m.time >= START));
}
