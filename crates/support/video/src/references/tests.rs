//! Headers written by hand; streams of real encoders are in `tests/it/references.rs`.

use super::bits::Bits;
use super::*;

/// Writes bits.
#[derive(Default)]
struct Writer(Vec<bool>);

impl Writer {
    fn number(mut self, value: u32, count: u32) -> Writer {
        self.0
            .extend((0..count).rev().map(|bit| u64::from(value) >> bit & 1 == 1));
        self
    }

    fn unsigned(self, value: u32) -> Writer {
        let bits = 32 - (value + 1).leading_zeros();
        self.number(value + 1, 2 * bits - 1)
    }

    /// The NAL unit: header bytes, these bits, the stop bit, emulation prevention.
    fn nal(mut self, header: &[u8]) -> Vec<u8> {
        self.0.push(true);
        let mut unit = [&[0, 0, 0, 1], header].concat();
        let mut zeros = 0;
        for byte in self.0.chunks(8) {
            let byte = byte
                .iter()
                .enumerate()
                .fold(0u8, |sum, (at, &bit)| sum | u8::from(bit) << (7 - at));
            if zeros >= 2 && byte <= 3 {
                unit.push(3);
                zeros = 0;
            }
            zeros = if byte == 0 { zeros + 1 } else { 0 };
            unit.push(byte);
        }
        unit
    }
}

#[test]
fn bits_are_read_as_written() {
    let values = [0, 1, 2, 3, 7, 8, 254, 255, 65_534, 1 << 20];
    let written = values
        .iter()
        .fold(Writer::default(), |writer, &value| writer.unsigned(value));
    let written = written.number(0, 30).number(1, 1);
    let unit = written.nal(&[0x67]);
    let mut bits = Bits::new(&unit[4..], 1);
    for value in values {
        assert_eq!(bits.unsigned(), Some(value));
    }
    assert_eq!(bits.number(31), Some(1));
    let mut signs = Bits::new(&[0b0101_0010, 0b0011_0000], 0);
    for value in [1, 0, 2, -1] {
        assert_eq!(signs.signed(), Some(value));
    }
    assert_eq!(Bits::new(&[0; 8], 0).unsigned(), None);
    assert_eq!(Bits::new(&[], 3).flag(), None);
}

/// H.264 with 4 bits of frame_num.
fn h264(kind: u8, reference: u8, number: u32) -> Vec<u8> {
    let mut unit = Vec::new();
    if kind == 5 {
        let sps = Writer::default()
            .number(66, 8)
            .number(0, 16)
            .unsigned(0)
            .unsigned(0);
        let sps = sps.unsigned(2).unsigned(1).number(0, 1);
        unit.extend(sps.nal(&[0x67]));
        unit.extend(Writer::default().unsigned(0).unsigned(0).nal(&[0x68]));
    }
    let slice = Writer::default()
        .unsigned(0)
        .unsigned(0)
        .unsigned(0)
        .number(number, 4);
    unit.extend(slice.number(0, 20).nal(&[reference << 5 | kind]));
    unit
}

#[test]
fn h264_numbers_must_not_jump() {
    let mut stream = Continuity::new(Codec::H264);
    assert_eq!(
        stream.next(&h264(1, 3, 1)),
        Step::Broken,
        "before the first key frame"
    );
    assert_eq!(stream.next(&h264(5, 3, 0)), Step::Key);
    for number in 1..40 {
        assert_eq!(stream.next(&h264(1, 2, number % 16)), Step::Follows);
    }
    // Nothing refers to these, so any of them may be missing.
    assert_eq!(stream.next(&h264(1, 0, 8)), Step::Follows);
    assert_eq!(stream.next(&h264(1, 0, 8)), Step::Follows);
    assert_eq!(stream.next(&h264(1, 2, 8)), Step::Follows);
    assert_eq!(stream.next(&h264(1, 2, 10)), Step::Broken);
    assert_eq!(
        stream.next(&h264(1, 2, 11)),
        Step::Broken,
        "it refers to a broken one"
    );
    assert_eq!(stream.next(&h264(5, 3, 0)), Step::Key);
    assert_eq!(stream.next(&h264(1, 2, 1)), Step::Follows);
    assert_eq!(stream.next(&[0, 0, 1, 0x41]), Step::Unknown);
}

/// H.265 with 4 bits of image order count. The SPS has two sets: the frame before, and
/// (written as a difference to that) the two before.
fn h265(kind: u8, order: u32, set: u32) -> Vec<u8> {
    let mut unit = Vec::new();
    if kind == 19 {
        let mut sps = Writer::default()
            .number(0, 8)
            .number(0, 32)
            .number(0, 32)
            .number(0, 32);
        sps = sps
            .unsigned(0)
            .unsigned(1)
            .unsigned(64)
            .unsigned(64)
            .number(0, 1);
        sps = sps.unsigned(0).unsigned(0).unsigned(0).number(0, 1);
        for _ in 0..9 {
            sps = sps.unsigned(1);
        }
        sps = sps.number(0, 1).number(0, 2).number(0, 1).unsigned(2);
        // One frame before: distance 1, used.
        sps = sps.unsigned(1).unsigned(0).unsigned(0).number(1, 1);
        // Shifted by -1: the set's own becomes -2 (used), the shift itself -1 (used).
        sps = sps
            .number(1, 1)
            .number(1, 1)
            .unsigned(0)
            .number(1, 1)
            .number(1, 1);
        unit.extend(sps.nal(&[33 << 1, 1]));
        unit.extend(
            Writer::default()
                .unsigned(0)
                .unsigned(0)
                .number(0, 5)
                .nal(&[34 << 1, 1]),
        );
    }
    let mut slice = Writer::default().number(1, 1);
    if kind >= 16 {
        slice = slice.number(0, 1);
    }
    slice = slice.unsigned(0).unsigned(1);
    if kind != 19 {
        slice = slice.number(order % 16, 4).number(1, 1).number(set, 1);
    }
    unit.extend(slice.number(0, 20).nal(&[kind << 1, 1]));
    unit
}

#[test]
fn h265_references_must_be_there() {
    let mut stream = Continuity::new(Codec::H265);
    assert_eq!(
        stream.next(&h265(1, 1, 0)),
        Step::Broken,
        "before the first key frame"
    );
    assert_eq!(stream.next(&h265(19, 0, 0)), Step::Key);
    assert_eq!(stream.next(&h265(1, 1, 0)), Step::Follows);
    for order in 2..40 {
        assert_eq!(stream.next(&h265(1, order, 1)), Step::Follows, "{order}");
    }
    assert_eq!(stream.next(&h265(1, 40, 0)), Step::Follows);
    // That one kept only its neighbour, so 39 is there and 38 is not.
    assert_eq!(stream.clone().next(&h265(1, 41, 1)), Step::Follows);
    assert_eq!(stream.clone().next(&h265(1, 42, 0)), Step::Broken);
    assert_eq!(stream.next(&h265(1, 42, 1)), Step::Broken);
    assert_eq!(
        stream.next(&h265(1, 43, 0)),
        Step::Broken,
        "it refers to a broken one"
    );
    assert_eq!(stream.next(&h265(19, 0, 0)), Step::Key);
    assert_eq!(stream.next(&[0, 0, 1, 0x02, 0x01]), Step::Unknown);
    assert_eq!(
        stream.next(&h265(1, 1, 0)),
        Step::Unknown,
        "it is not known what was kept"
    );
    assert_eq!(stream.next(&h265(19, 0, 0)), Step::Key);
}

#[test]
fn never_panics_on_any_bytes() {
    let mut state = 0x9e37_79b9_7f4a_7c15u64;
    let mut random = move || {
        state ^= state << 13;
        state ^= state >> 7;
        state ^= state << 17;
        state
    };
    for codec in [Codec::H264, Codec::H265] {
        let mut stream = Continuity::new(codec);
        for round in 0..20_000 {
            let mut bytes: Vec<u8> = match (codec, round % 3) {
                (Codec::H264, 0) => h264(5, 3, 0),
                (Codec::H264, _) => h264(1, 2, round % 16),
                (Codec::H265, 0) => h265(19, 0, 0),
                (Codec::H265, _) => h265(1, round, round % 2),
            };
            for _ in 0..random() % 8 {
                let at = random() as usize % bytes.len();
                bytes[at] = (random() >> 32) as u8;
            }
            bytes.truncate(random() as usize % (2 * bytes.len()));
            stream.next(&bytes);
        }
    }
}
