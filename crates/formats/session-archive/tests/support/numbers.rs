//! The numbers in a session, counted without the code under test.

use std::collections::BTreeMap;

use session_archive::reader::SessionReader;
use session_archive::record::{Frame, Gap, ImuBatch, Record as _};

use super::messages;

/// How often each number of each stream is in a sample, and whether a gap record has it.
pub(crate) fn numbers(reader: &SessionReader) -> BTreeMap<(String, u64), (usize, bool)> {
    let mut numbers: BTreeMap<(String, u64), (usize, bool)> = BTreeMap::new();
    for m in messages(reader) {
        let stream = reader.stream(m.stream).expect("stream");
        let of = |n| (stream.of.clone(), n);
        if stream.schema == Frame::SCHEMA.name {
            let frame: Frame = m.decode().expect("frame");
            numbers.entry(of(frame.number)).or_default().0 += 1;
        } else if stream.schema == ImuBatch::SCHEMA.name {
            let batch: ImuBatch = m.decode().expect("batch");
            for n in (batch.first_number..).take(batch.times.len()) {
                numbers.entry(of(n)).or_default().0 += 1;
            }
        } else if stream.schema == Gap::SCHEMA.name {
            let gap: Gap = m.decode().expect("gap");
            for n in gap.first..=gap.last {
                numbers.entry((gap.stream.clone(), n)).or_default().1 = true;
            }
        }
    }
    numbers
}

/// Every sample of the source is in its recovered copy, as often as there; what was saved beside
/// them is there once, and no number of a sample is in a gap record.
pub(crate) fn check_numbers(source: &SessionReader, copy: &SessionReader) {
    let (source, copy) = (numbers(source), numbers(copy));
    for (number, (samples, is_gap)) in &copy {
        let before = source.get(number).map_or(0, |n| n.0);
        let expected = if before == 0 { 0..=1 } else { before..=before };
        assert!(
            expected.contains(samples),
            "{number:?}: {samples} of {before}"
        );
        assert!(*samples == 0 || !is_gap, "{number:?} is in a gap record");
    }
    assert!(source.keys().all(|number| copy.contains_key(number)));
}
