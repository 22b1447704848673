//! H.264: reference frames are numbered; a jump in the numbers is a loss.

use super::bits::Bits;
use crate::{Codec, annexb};

#[derive(Debug, Clone, Default)]
pub(super) struct Reader {
    /// By `seq_parameter_set_id`, 32 of them at most.
    sequences: Vec<(u32, Sequence)>,
    /// `seq_parameter_set_id` by `pic_parameter_set_id`, 256 of them at most.
    images: Vec<(u32, u32)>,
    /// `PrevRefFrameNum`.
    previous: Option<u32>,
}

#[derive(Debug, Clone, Copy)]
struct Sequence {
    separate_planes: bool,
    frame_number_bits: u32,
    gaps_allowed: bool,
}

impl Reader {
    /// Whether the frame's references are there; `None` if that cannot be determined.
    pub(super) fn read(&mut self, access_unit: &[u8]) -> Option<bool> {
        for nal in annexb::heads(access_unit) {
            match nal.unit_type(Codec::H264) {
                7 => {
                    if let Some((id, sequence)) = sequence(nal.bytes) {
                        self.sequences.retain(|known| known.0 != id);
                        self.sequences.push((id, sequence));
                    }
                }
                8 => {
                    let mut bits = Bits::new(nal.bytes, 1);
                    if let (Some(id), Some(of)) = (bits.at_most(255), bits.at_most(31)) {
                        self.images.retain(|known| known.0 != id);
                        self.images.push((id, of));
                    }
                }
                1..=5 => return self.slice(nal.bytes),
                _ => {}
            }
        }
        None
    }

    fn slice(&mut self, nal: &[u8]) -> Option<bool> {
        let previous = self.previous.take();
        let mut bits = Bits::new(nal, 1);
        let _first_macroblock = bits.unsigned()?;
        let _kind = bits.at_most(9)?;
        let image = bits.at_most(255)?;
        let of = self.images.iter().find(|known| known.0 == image)?.1;
        let sequence = self.sequences.iter().find(|known| known.0 == of)?.1;
        if sequence.separate_planes {
            bits.skip(2)?;
        }
        let number = bits.number(sequence.frame_number_bits)?;
        let is_reference = nal.first()? & 0x60 != 0;
        let is_idr = nal.first()? & 0x1f == 5;
        self.previous = if is_reference { Some(number) } else { previous };
        if is_idr || sequence.gaps_allowed {
            return is_idr.then_some(true);
        }
        let previous = previous?;
        let next = (previous + 1) & ((1 << sequence.frame_number_bits) - 1);
        // Equal numbers: the second field of a frame.
        Some(number == next || number == previous)
    }
}

/// A sequence parameter set and its identifier.
fn sequence(nal: &[u8]) -> Option<(u32, Sequence)> {
    let mut bits = Bits::new(nal, 1);
    let profile = bits.number(8)?;
    bits.skip(16)?;
    let id = bits.at_most(31)?;
    let mut separate_planes = false;
    if [100, 110, 122, 244, 44, 83, 86, 118, 128, 138, 139, 134, 135].contains(&profile) {
        let chroma = bits.at_most(3)?;
        if chroma == 3 {
            separate_planes = bits.flag()?;
        }
        let _depths = (bits.at_most(6)?, bits.at_most(6)?);
        bits.skip(1)?;
        if bits.flag()? {
            for list in 0..if chroma == 3 { 12 } else { 8 } {
                if bits.flag()? {
                    scaling_list(&mut bits, if list < 6 { 16 } else { 64 })?;
                }
            }
        }
    }
    let frame_number_bits = bits.at_most(12)? + 4;
    match bits.at_most(2)? {
        0 => {
            bits.at_most(12)?;
        }
        1 => {
            bits.skip(1)?;
            let _offsets = (bits.signed()?, bits.signed()?);
            for _ in 0..bits.at_most(255)? {
                bits.signed()?;
            }
        }
        _ => {}
    }
    let _references = bits.at_most(16)?;
    let gaps_allowed = bits.flag()?;
    Some((
        id,
        Sequence {
            separate_planes,
            frame_number_bits,
            gaps_allowed,
        },
    ))
}

fn scaling_list(bits: &mut Bits, length: usize) -> Option<()> {
    let (mut last, mut next) = (8, 8);
    for _ in 0..length {
        if next != 0 {
            next = (last + bits.signed()?).rem_euclid(256);
        }
        if next != 0 {
            last = next;
        }
    }
    Some(())
}
