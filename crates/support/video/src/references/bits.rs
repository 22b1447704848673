//! Bits of a NAL unit's payload, without its emulation prevention bytes.

/// Headers are read from at most this many payload bytes; the ones we need are far shorter.
const HEADER_BYTES: usize = 512;

/// Reads from the front. `None` once the bytes are used up, for good.
#[derive(Debug)]
pub(super) struct Bits {
    bytes: Vec<u8>,
    at: usize,
}

impl Bits {
    /// Behind the first `header` bytes of a NAL unit.
    pub(super) fn new(nal: &[u8], header: usize) -> Bits {
        let payload = nal.get(header..).unwrap_or(&[]);
        let mut bytes = Vec::with_capacity(payload.len().min(HEADER_BYTES));
        let mut zeros = 0;
        for &byte in payload.iter().take(HEADER_BYTES) {
            if zeros >= 2 && byte == 3 {
                zeros = 0;
                continue;
            }
            zeros = if byte == 0 { zeros + 1 } else { 0 };
            bytes.push(byte);
        }
        Bits { bytes, at: 0 }
    }

    pub(super) fn flag(&mut self) -> Option<bool> {
        let byte = self.bytes.get(self.at / 8)?;
        let bit = byte >> (7 - self.at % 8) & 1;
        self.at += 1;
        Some(bit == 1)
    }

    /// `u(count)`, at most 32 bits.
    pub(super) fn number(&mut self, count: u32) -> Option<u32> {
        let mut value = 0;
        for _ in 0..count {
            value = value << 1 | u32::from(self.flag()?);
        }
        Some(value)
    }

    pub(super) fn skip(&mut self, count: u32) -> Option<()> {
        (0..count).try_for_each(|_| self.flag().map(|_| ()))
    }

    /// `ue(v)`: Exp-Golomb, unsigned.
    pub(super) fn unsigned(&mut self) -> Option<u32> {
        let mut zeros = 0;
        while !self.flag()? {
            zeros += 1;
            if zeros > 31 {
                return None;
            }
        }
        Some((1 << zeros) - 1 + self.number(zeros)?)
    }

    /// `ue(v)` that the standard limits to `most`.
    pub(super) fn at_most(&mut self, most: u32) -> Option<u32> {
        self.unsigned().filter(|&value| value <= most)
    }

    /// `se(v)`: Exp-Golomb, signed.
    pub(super) fn signed(&mut self) -> Option<i32> {
        let code = i64::from(self.unsigned()?);
        let magnitude = (code + 1) / 2;
        i32::try_from(if code % 2 == 1 { magnitude } else { -magnitude }).ok()
    }
}
