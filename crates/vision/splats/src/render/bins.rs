//! Lists of Gaussians per tile, by depth.
//!
//! A Gaussian belongs to a tile if its ellipse (where alpha reaches its minimum) crosses the tile's
//! pixels, row of tiles by row of tiles: exact along x, where the box of the ellipse would name
//! tiles at its corners that it does not reach.

use std::ops::Range;
use std::sync::atomic::{AtomicU32, Ordering::Relaxed};

use rayon::prelude::*;

use super::project::Footprint;
use super::view::{TILE, View};

/// Gaussians of a task. A constant, so that results do not depend on the number of threads.
const CHUNK: usize = 1024;

/// Slack of the intervals for rounding, px.
const SLACK_PX: f32 = 0.02;

/// Lists of Gaussians per tile.
#[derive(Debug)]
pub(super) struct Bins {
    /// First entry of each tile, and their number.
    first: Vec<u32>,
    /// Indices of footprints, tile by tile.
    entries: Vec<u32>,
    /// First pair of each footprint in the order of depth, and their number.
    first_pair: Vec<u32>,
    /// Entry of each pair, footprint by footprint in the order of depth.
    entry_of_pair: Vec<u32>,
    /// Position of each footprint in the order of depth.
    rank: Vec<u32>,
}

/// Tiles of one Gaussian in a row of tiles.
struct Span {
    /// Position in the order of depth, from the start of the chunk.
    position: u32,
    tiles: Range<u32>,
}

impl Bins {
    pub(super) fn new(footprints: &[Footprint], order: &[u32], view: &View) -> Self {
        let tiles = view.tile_columns() * view.tile_rows();
        let chunks: Vec<(Vec<Span>, Vec<u32>)> = order
            .par_chunks(CHUNK)
            .map(|chunk| spans(footprints, chunk, view, tiles))
            .collect();
        let mut first_pair = Vec::with_capacity(order.len() + 1);
        first_pair.push(0);
        let mut pairs = 0;
        for ((spans, _), chunk) in chunks.iter().zip(order.chunks(CHUNK)) {
            let mut spans = spans.iter().peekable();
            for position in 0..chunk.len() as u32 {
                while let Some(span) = spans.next_if(|span| span.position == position) {
                    pairs += span.tiles.len() as u32;
                }
                first_pair.push(pairs);
            }
        }
        // Where each chunk's entries of a tile begin.
        let mut first = Vec::with_capacity(tiles + 1);
        let mut begins = vec![vec![0; tiles]; chunks.len()];
        let mut sum = 0;
        for tile in 0..tiles {
            first.push(sum);
            for ((_, counts), begin) in chunks.iter().zip(&mut begins) {
                begin[tile] = sum;
                sum += counts[tile];
            }
        }
        first.push(sum);
        // Every element is written once, by whichever thread; atomics are what Rust offers for
        // that.
        let zeros = || (0..sum).map(|_| AtomicU32::new(0)).collect::<Vec<_>>();
        let (entries, entry_of_pair) = (zeros(), zeros());
        chunks
            .par_iter()
            .zip(begins)
            .enumerate()
            .for_each(|(chunk, ((spans, _), mut next))| {
                let mut pair = first_pair[chunk * CHUNK];
                for span in spans {
                    let footprint = order[chunk * CHUNK + span.position as usize];
                    for tile in span.tiles.clone() {
                        let entry = &mut next[tile as usize];
                        entries[*entry as usize].store(footprint, Relaxed);
                        entry_of_pair[pair as usize].store(*entry, Relaxed);
                        *entry += 1;
                        pair += 1;
                    }
                }
            });
        let mut rank = vec![0; order.len()];
        for (position, footprint) in (0..).zip(order) {
            rank[*footprint as usize] = position;
        }
        let plain = |of: Vec<AtomicU32>| of.into_iter().map(AtomicU32::into_inner).collect();
        Self {
            first,
            entries: plain(entries),
            first_pair,
            entry_of_pair: plain(entry_of_pair),
            rank,
        }
    }

    /// Number of tiles.
    pub(super) fn tiles(&self) -> usize {
        self.first.len() - 1
    }

    /// Number of pairs of a Gaussian and a tile.
    pub(super) fn pairs(&self) -> usize {
        self.entries.len()
    }

    /// Footprints of a tile, nearest first.
    pub(super) fn entries(&self, tile: usize) -> &[u32] {
        &self.entries[self.first[tile] as usize..self.first[tile + 1] as usize]
    }
}

impl Bins {
    /// Entries of a footprint, in the order of its tiles.
    pub(super) fn entries_of(&self, footprint: usize) -> &[u32] {
        let rank = self.rank[footprint] as usize;
        &self.entry_of_pair[self.first_pair[rank] as usize..self.first_pair[rank + 1] as usize]
    }

    /// Parts of a slice with one element per entry, tile by tile.
    pub(super) fn split<'a, T>(&self, mut all: &'a mut [T]) -> Vec<&'a mut [T]> {
        let mut parts = Vec::with_capacity(self.tiles());
        for tile in 0..self.tiles() {
            let (part, rest) = all.split_at_mut(self.entries(tile).len());
            parts.push(part);
            all = rest;
        }
        parts
    }
}

/// Spans of some Gaussians, and their number of tiles per tile.
fn spans(
    footprints: &[Footprint],
    order: &[u32],
    view: &View,
    tiles: usize,
) -> (Vec<Span>, Vec<u32>) {
    let mut spans = Vec::with_capacity(order.len() * 2);
    let mut counts = vec![0; tiles];
    let columns = view.tile_columns() as u32;
    for (position, index) in (0..).zip(order) {
        let f = &footprints[*index as usize];
        let Some(rows) = pixels(f.mean[1], -f.extent[1], f.extent[1], view.height) else {
            continue;
        };
        for row in rows.start / TILE as u32..rows.end.div_ceil(TILE as u32) {
            let Some(across) = across(f, row, view) else {
                continue;
            };
            let start = row * columns;
            let tiles =
                start + across.start / TILE as u32..start + across.end.div_ceil(TILE as u32);
            for tile in tiles.clone() {
                counts[tile as usize] += 1;
            }
            spans.push(Span { position, tiles });
        }
    }
    (spans, counts)
}

/// Pixels whose centers are in `mean + low ..= mean + high`.
fn pixels(mean: f32, low: f32, high: f32, size: usize) -> Option<Range<u32>> {
    // First pixel at or above the lower end, last one at or below the upper end.
    let low = (mean + low - SLACK_PX).clamp(0.0, size as f32);
    let high = (mean + high + SLACK_PX).clamp(-1.0, (size - 1) as f32);
    let start = low as u32 + u32::from(low > low as u32 as f32);
    let end = (high + 1.0) as u32;
    (start < end).then_some(start..end)
}

/// Columns of pixels that the ellipse reaches within a row of tiles.
fn across(f: &Footprint, row: u32, view: &View) -> Option<Range<u32>> {
    let [a, b, c] = f.conic;
    let top = (row * TILE as u32) as f32 - f.mean[1] - SLACK_PX;
    let bottom = top + (TILE - 1) as f32 + 2.0 * SLACK_PX;
    // Heights at which the ellipse is rightmost; leftmost at the negative of it.
    let rightmost = -b / c * f.extent[0];
    let width = |dy: f32| (f.reach * a - f.determinant * dy * dy).max(0.0).sqrt();
    let high = match rightmost >= top && rightmost <= bottom {
        true => f.extent[0],
        false => {
            let dy = rightmost.clamp(top, bottom);
            (width(dy) - b * dy) / a
        }
    };
    let low = match -rightmost >= top && -rightmost <= bottom {
        true => -f.extent[0],
        false => {
            let dy = (-rightmost).clamp(top, bottom);
            (-width(dy) - b * dy) / a
        }
    };
    // Rounding of wide ellipses.
    let slack = 1e-5 * f.extent[0];
    pixels(f.mean[0], low - slack, high + slack, view.width)
}
