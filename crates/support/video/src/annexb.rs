//! Annex B byte streams, looked at without decoding: where the NAL units are, whether an access
//! unit can start decoding, and whether it carries its own parameter sets.
//!
//! Contract: pure, no allocation, total on any bytes. Bytes before the first start code are
//! skipped; bytes without a start code hold no NAL unit; an empty NAL unit is never returned.
//! [`is_key`] and [`has_parameter_sets`] stop at the first slice, so their cost does not grow with
//! the frame.
//!
//! Sources: ITU-T H.264 (08/2021) Annex B and table 7-1; ITU-T H.265 (08/2021) Annex B and
//! table 7-1.

use crate::Codec;

/// One NAL unit: header and payload as they stand in the stream (emulation prevention bytes
/// included), without start code and without trailing zero bytes. Never empty.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Nal<'a> {
    /// The bytes, header first.
    pub bytes: &'a [u8],
}

impl Nal<'_> {
    /// `nal_unit_type`: 0..=31 for H.264, 0..=63 for H.265.
    pub fn unit_type(&self, codec: Codec) -> u8 {
        let header = self.bytes.first().copied().unwrap_or(0);
        match codec {
            Codec::H264 => header & 0x1f,
            Codec::H265 => (header >> 1) & 0x3f,
        }
    }

    /// Whether this is coded slice data (VCL) rather than a parameter set, SEI or delimiter.
    pub fn is_slice(&self, codec: Codec) -> bool {
        match codec {
            Codec::H264 => (1..=5).contains(&self.unit_type(codec)),
            Codec::H265 => self.unit_type(codec) < 32,
        }
    }
}

/// The NAL units of `bytes`, in order.
pub fn nals(bytes: &[u8]) -> impl Iterator<Item = Nal<'_>> + Clone {
    heads(bytes).map(|Nal { bytes }| {
        let unit = &bytes[..find_start_code(bytes).unwrap_or(bytes.len())];
        // A NAL unit cannot end in zero: such bytes are padding, or the first zero of a four-byte
        // start code.
        let end = unit
            .iter()
            .rposition(|&byte| byte != 0)
            .map_or(0, |last| last + 1);
        Nal {
            bytes: &unit[..end],
        }
    })
}

/// As [`nals`], but each reaches to the end of `bytes`: where it ends is not looked for. Looking at
/// headers up to the first slice then costs nothing that grows with the slice.
pub(crate) fn heads(bytes: &[u8]) -> impl Iterator<Item = Nal<'_>> + Clone {
    let mut rest = bytes;
    std::iter::from_fn(move || {
        loop {
            rest = &rest[find_start_code(rest)? + 3..];
            // Nothing but zeros up to the end or the next start code.
            let zeros = rest.iter().take_while(|&&byte| byte == 0).count();
            if zeros < rest.len() && !(zeros >= 2 && rest[zeros] == 1) {
                return Some(Nal { bytes: rest });
            }
        }
    })
}

/// Whether decoding can start at this access unit: its first slice is of an H.264 IDR frame
/// (type 5) or an H.265 IRAP frame (types 16..=21).
pub fn is_key(codec: Codec, access_unit: &[u8]) -> bool {
    heads(access_unit)
        .find(|nal| nal.is_slice(codec))
        .is_some_and(|slice| {
            let kind = slice.unit_type(codec);
            match codec {
                Codec::H264 => kind == 5,
                Codec::H265 => (16..=21).contains(&kind),
            }
        })
}

/// Whether every kind of parameter set the codec needs stands before the first slice: SPS and PPS
/// for H.264; VPS, SPS and PPS for H.265.
pub fn has_parameter_sets(codec: Codec, access_unit: &[u8]) -> bool {
    let needed: &[u8] = match codec {
        Codec::H264 => &[7, 8],
        Codec::H265 => &[32, 33, 34],
    };
    let mut seen = 0u64;
    for nal in heads(access_unit) {
        if nal.is_slice(codec) {
            break;
        }
        seen |= 1 << nal.unit_type(codec);
    }
    needed.iter().all(|&kind| seen & (1 << kind) != 0)
}

/// Position of the first `00 00 01`.
fn find_start_code(bytes: &[u8]) -> Option<usize> {
    let mut at = 0;
    while let Some(&third) = bytes.get(at + 2) {
        // The third byte alone determines at how many positions no start code can begin.
        match third {
            0 => at += 1,
            1 if bytes[at] == 0 && bytes[at + 1] == 0 => return Some(at),
            _ => at += 3,
        }
    }
    None
}

#[cfg(test)]
mod tests {
    use super::*;

    fn units(bytes: &[u8]) -> Vec<&[u8]> {
        nals(bytes).map(|nal| nal.bytes).collect()
    }

    #[test]
    fn units_are_cut_at_start_codes_of_both_lengths() {
        let stream = [
            0, 0, 0, 1, 0x67, 9, 0, 0, 1, 0x68, 7, 0, 0, 0, 1, 0x65, 1, 2, 3, 0, 0,
        ];
        assert_eq!(
            units(&stream),
            [&[0x67, 9][..], &[0x68, 7], &[0x65, 1, 2, 3]]
        );
        assert_eq!(units(&[5, 6, 0, 0, 1, 0x41]), [&[0x41][..]]);
        assert!(units(&[]).is_empty());
        assert!(units(&[0, 0]).is_empty());
        assert!(units(&[0, 0, 1]).is_empty());
        assert!(units(&[0, 0, 1, 0, 0, 1, 0, 0, 0, 1]).is_empty());
    }

    #[test]
    fn h264_key_and_parameter_sets() {
        let idr = [
            0, 0, 0, 1, 0x09, 0x10, 0, 0, 1, 0x67, 1, 0, 0, 1, 0x68, 1, 0, 0, 1, 0x65, 1,
        ];
        assert!(is_key(Codec::H264, &idr));
        assert!(has_parameter_sets(Codec::H264, &idr));
        let without = [0, 0, 1, 0x67, 1, 0, 0, 1, 0x65, 1];
        assert!(is_key(Codec::H264, &without));
        assert!(!has_parameter_sets(Codec::H264, &without));
        // Parameter sets behind the slice do not help a decoder that starts here.
        let late = [0, 0, 1, 0x65, 1, 0, 0, 1, 0x67, 1, 0, 0, 1, 0x68, 1];
        assert!(!has_parameter_sets(Codec::H264, &late));
        assert!(!is_key(Codec::H264, &[0, 0, 1, 0x41, 1]));
        // An SEI before the slice does not decide.
        assert!(is_key(Codec::H264, &[0, 0, 1, 0x06, 5, 0, 0, 1, 0x25, 1]));
    }

    #[test]
    fn h265_key_and_parameter_sets() {
        let header = |kind: u8| kind << 1;
        let mut unit = Vec::new();
        for kind in [32, 33, 34, 39, 19] {
            unit.extend([0, 0, 0, 1, header(kind), 1, 0xaa]);
        }
        assert!(is_key(Codec::H265, &unit));
        assert!(has_parameter_sets(Codec::H265, &unit));
        for kind in 0..64u8 {
            let slice = [0, 0, 1, header(kind), 1, 0x80];
            assert_eq!(
                is_key(Codec::H265, &slice),
                (16..=21).contains(&kind),
                "type {kind}"
            );
        }
        assert!(!has_parameter_sets(Codec::H265, &unit[7..]));
    }

    /// Slow reference implementation of `find_start_code`.
    fn find_slowly(bytes: &[u8]) -> Option<usize> {
        bytes.windows(3).position(|window| window == [0, 0, 1])
    }

    #[test]
    fn total_on_any_bytes() {
        let mut state = 0x9e37_79b9_7f4a_7c15u64;
        for round in 0..20_000 {
            let length = round % 67;
            let bytes: Vec<u8> = (0..length)
                .map(|_| {
                    state ^= state << 13;
                    state ^= state >> 7;
                    state ^= state << 17;
                    // Mostly zeros and ones, so that start codes really occur.
                    match state >> 61 {
                        0..=3 => 0,
                        4 | 5 => 1,
                        _ => (state >> 40) as u8,
                    }
                })
                .collect();
            assert_eq!(find_start_code(&bytes), find_slowly(&bytes), "{bytes:?}");
            for codec in [Codec::H264, Codec::H265] {
                let _ = (is_key(codec, &bytes), has_parameter_sets(codec, &bytes));
            }
            let total: usize = nals(&bytes).map(|nal| nal.bytes.len()).sum();
            assert!(total <= bytes.len());
            let headers = |nal: Nal<'_>| nal.bytes[0];
            assert!(nals(&bytes).map(headers).eq(heads(&bytes).map(headers)));
            assert!(nals(&bytes).all(|nal| !nal.bytes.is_empty() && nal.bytes.last() != Some(&0)));
        }
    }
}
