//! H.265: every frame lists the frames it needs by their distance in picture order count.

use super::bits::Bits;
use crate::{Codec, annexb};

#[derive(Debug, Clone, Default)]
pub(super) struct Reader {
    /// By `sps_seq_parameter_set_id`, 16 of them at most.
    sequences: Vec<(u32, Sequence)>,
    /// By `pps_pic_parameter_set_id`, 64 of them at most.
    pictures: Vec<(u32, PictureSet)>,
    /// Picture order counts of the frames that the decoder has kept, if they are known.
    kept: Option<Vec<i64>>,
    /// Picture order count of the last frame that counts for the next one's (`prevTid0Pic`).
    previous: i64,
}

#[derive(Debug, Clone)]
struct Sequence {
    separate_planes: bool,
    order_bits: u32,
    sets: Vec<ReferenceSet>,
}

#[derive(Debug, Clone, Copy)]
struct PictureSet {
    sequence: u32,
    output_flag: bool,
    extra_bits: u32,
}

/// A reference picture set: distance, and whether the current frame itself uses it.
#[derive(Debug, Clone, Default)]
struct ReferenceSet {
    /// Earlier frames, nearest first; distances are negative.
    before: Vec<(i64, bool)>,
    /// Later frames, nearest first.
    after: Vec<(i64, bool)>,
}

impl Reader {
    /// Whether the frame's references are there; `None` if that cannot be determined.
    pub(super) fn read(&mut self, access_unit: &[u8]) -> Option<bool> {
        for nal in annexb::heads(access_unit) {
            match nal.unit_type(Codec::H265) {
                33 => {
                    // A set that cannot be read replaces one that could.
                    let mut bits = Bits::new(nal.bytes, 2);
                    if let Some((id, sequence)) = sequence(&mut bits) {
                        self.sequences.retain(|known| known.0 != id);
                        self.sequences.push((id, sequence));
                    } else {
                        self.sequences.clear();
                    }
                }
                34 => {
                    if let Some((id, set)) = picture_set(nal.bytes) {
                        self.pictures.retain(|known| known.0 != id);
                        self.pictures.push((id, set));
                    }
                }
                kind @ 0..=31 => return self.slice(nal.bytes, kind),
                _ => {}
            }
        }
        None
    }

    fn slice(&mut self, nal: &[u8], kind: u8) -> Option<bool> {
        let kept = self.kept.take();
        let mut bits = Bits::new(nal, 2);
        let is_first = bits.flag()?;
        if (16..=23).contains(&kind) {
            bits.skip(1)?;
        }
        let id = bits.at_most(63)?;
        let set = self.pictures.iter().find(|known| known.0 == id)?.1;
        let sequence = &self
            .sequences
            .iter()
            .find(|known| known.0 == set.sequence)?
            .1;
        if !is_first {
            // The first slice is missing, and with it the beginning of the frame.
            return Some(false);
        }
        bits.skip(set.extra_bits)?;
        let _slice_kind = bits.at_most(2)?;
        if set.output_flag {
            bits.skip(1)?;
        }
        if sequence.separate_planes {
            bits.skip(2)?;
        }
        if kind == 19 || kind == 20 {
            (self.previous, self.kept) = (0, Some(vec![0]));
            return Some(true);
        }
        let random_access = (16..=21).contains(&kind);
        let before = if random_access { 0 } else { self.previous };
        let order = order(
            before,
            bits.number(sequence.order_bits)?,
            sequence.order_bits,
        );
        let count = sequence.sets.len() as u32;
        let references = if !bits.flag()? {
            reference_set(&mut bits, count, &sequence.sets, true)?
        } else {
            let index = if count > 1 {
                bits.number(32 - (count - 1).leading_zeros())?
            } else {
                0
            };
            sequence.sets.get(index as usize)?.clone()
        };
        // A random access frame needs nothing and leaves nothing from before it.
        let kept = if random_access { Vec::new() } else { kept? };
        let listed = || references.before.iter().chain(&references.after);
        let there = |distance: i64| kept.contains(&(order + distance));
        let complete = listed().all(|&(distance, used)| !used || there(distance));
        self.kept = Some(
            listed()
                .filter(|entry| there(entry.0))
                .map(|entry| order + entry.0)
                .chain([order])
                .collect(),
        );
        let is_sub_layer = nal.get(1)? & 7 != 1;
        let is_leading_or_unreferenced =
            (6..=9).contains(&kind) || (kind < 16 && kind.is_multiple_of(2));
        if !is_sub_layer && !is_leading_or_unreferenced {
            self.previous = order;
        }
        Some(complete || random_access)
    }
}

/// Clause 8.3.1: the picture order count nearest to the previous one that ends in these bits.
fn order(previous: i64, low: u32, bits: u32) -> i64 {
    let modulus = 1i64 << bits;
    let (low, previous_low) = (i64::from(low), previous.rem_euclid(modulus));
    let high = previous - previous_low;
    if low < previous_low && previous_low - low >= modulus / 2 {
        high + modulus + low
    } else if low > previous_low && low - previous_low > modulus / 2 {
        high - modulus + low
    } else {
        high + low
    }
}

fn picture_set(nal: &[u8]) -> Option<(u32, PictureSet)> {
    let mut bits = Bits::new(nal, 2);
    let id = bits.at_most(63)?;
    let sequence = bits.at_most(15)?;
    bits.skip(1)?;
    let output_flag = bits.flag()?;
    let extra_bits = bits.number(3)?;
    Some((
        id,
        PictureSet {
            sequence,
            output_flag,
            extra_bits,
        },
    ))
}

/// A sequence parameter set and its identifier.
fn sequence(bits: &mut Bits) -> Option<(u32, Sequence)> {
    bits.skip(4)?;
    let sub_layers = bits.number(3)?;
    bits.skip(1)?;
    profile_and_level(bits, sub_layers)?;
    let id = bits.at_most(15)?;
    let separate_planes = bits.at_most(3)? == 3 && bits.flag()?;
    let _size = (bits.unsigned()?, bits.unsigned()?);
    if bits.flag()? {
        for _ in 0..4 {
            bits.unsigned()?;
        }
    }
    let _depths = (bits.at_most(8)?, bits.at_most(8)?);
    let order_bits = bits.at_most(12)? + 4;
    let layers = if bits.flag()? { sub_layers + 1 } else { 1 };
    // Buffering of each layer, then block and transform sizes.
    for _ in 0..3 * layers + 6 {
        bits.unsigned()?;
    }
    if bits.flag()? && bits.flag()? {
        return None;
    }
    bits.skip(2)?;
    if bits.flag()? {
        bits.skip(8)?;
        let _pcm_sizes = (bits.unsigned()?, bits.unsigned()?);
        bits.skip(1)?;
    }
    let count = bits.at_most(64)?;
    let mut sets = Vec::new();
    for index in 0..count {
        let set = reference_set(bits, index, &sets, false)?;
        sets.push(set);
    }
    Some((
        id,
        Sequence {
            separate_planes,
            order_bits,
            sets,
        },
    ))
}

fn profile_and_level(bits: &mut Bits, sub_layers: u32) -> Option<()> {
    bits.skip(96)?;
    let mut present = [(false, false); 8];
    for layer in present.iter_mut().take(sub_layers as usize) {
        *layer = (bits.flag()?, bits.flag()?);
    }
    if sub_layers > 0 {
        bits.skip(2 * (8 - sub_layers))?;
    }
    for &(profile, level) in present.iter().take(sub_layers as usize) {
        bits.skip(if profile { 88 } else { 0 })?;
        bits.skip(if level { 8 } else { 0 })?;
    }
    Some(())
}

/// `st_ref_pic_set(index)`, clauses 7.3.7 and 7.4.8. `known` are the sets of the SPS before it.
fn reference_set(
    bits: &mut Bits,
    index: u32,
    known: &[ReferenceSet],
    in_slice: bool,
) -> Option<ReferenceSet> {
    if index != 0 && bits.flag()? {
        return predicted_set(bits, index, known, in_slice);
    }
    let (before, after) = (bits.at_most(16)?, bits.at_most(16)?);
    let mut side = |count: u32, sign: i64| -> Option<Vec<(i64, bool)>> {
        let mut distance = 0;
        (0..count)
            .map(|_| {
                distance += sign * (i64::from(bits.at_most(1 << 15)?) + 1);
                Some((distance, bits.flag()?))
            })
            .collect()
    };
    Some(ReferenceSet {
        before: side(before, -1)?,
        after: side(after, 1)?,
    })
}

/// A set written as a difference to another one.
fn predicted_set(
    bits: &mut Bits,
    index: u32,
    known: &[ReferenceSet],
    in_slice: bool,
) -> Option<ReferenceSet> {
    // Only a slice header may choose which set; in the SPS it is the one before.
    let back = if in_slice {
        bits.at_most(index - 1)? + 1
    } else {
        1
    };
    let base = known.get((index - back) as usize)?;
    let negative = bits.flag()?;
    let distance = i64::from(bits.at_most(1 << 15)?) + 1;
    let shift = if negative { -distance } else { distance };
    let count = base.before.len() + base.after.len();
    let mut flags = Vec::new();
    for _ in 0..=count {
        let used = bits.flag()?;
        flags.push((used, used || bits.flag()?));
    }
    let mut set = ReferenceSet::default();
    let entries = base.before.iter().chain(&base.after).map(|entry| entry.0);
    for (distance, (used, kept)) in entries.chain([0]).zip(flags) {
        match distance + shift {
            moved if kept && moved < 0 => set.before.push((moved, used)),
            moved if kept && moved > 0 => set.after.push((moved, used)),
            _ => {}
        }
    }
    // The standard's own order of derivation comes to the same: nearest first.
    set.before.sort_by_key(|entry| -entry.0);
    set.after.sort_by_key(|entry| entry.0);
    Some(set)
}
