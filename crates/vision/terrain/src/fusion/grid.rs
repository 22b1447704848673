//! Blocks by their place: a hash table of blocks, and tiles of blocks for views to find theirs.
//!
//! Nothing depends on the order of a hash table: blocks are numbered in the order of their
//! allocation, and what is allocated together is sorted by place.

use std::collections::HashMap;
use std::hash::{BuildHasherDefault, Hasher};

use super::block::Block;

/// Blocks along an edge of a tile, as a power of 2.
const TILE_SHIFT: i32 = 4;
/// Coordinates of blocks are from minus this to this.
pub(crate) const MAX_COORDINATE: i32 = (1 << 20) - 1;

/// Position of a block, in blocks.
pub(crate) type Key = [i32; 3];

/// A key as a number, in the order of z, y, x. Coordinates beyond the maximum alias others.
pub(crate) fn pack(key: Key) -> u64 {
    let part = |k: usize| (i64::from(key[k]) + i64::from(MAX_COORDINATE) + 1) as u64 & 0x1f_ffff;
    part(2) << 42 | part(1) << 21 | part(0)
}

/// The key of [`pack`].
pub(crate) fn unpack(packed: u64) -> Key {
    [0, 21, 42].map(|shift| (packed >> shift & 0x1f_ffff) as i32 - MAX_COORDINATE - 1)
}

/// Hashes a packed key by multiplication (Fibonacci hashing).
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct KeyHasher(u64);

impl Hasher for KeyHasher {
    fn finish(&self) -> u64 {
        self.0
    }

    fn write(&mut self, bytes: &[u8]) {
        for byte in bytes {
            self.write_u64(u64::from(*byte));
        }
    }

    fn write_u64(&mut self, value: u64) {
        let mixed = (self.0 ^ value).wrapping_mul(0x9e37_79b9_7f4a_7c15);
        self.0 = mixed ^ mixed >> 29;
    }
}

pub(crate) type KeyMap<T> = HashMap<u64, T, BuildHasherDefault<KeyHasher>>;

/// All blocks of a volume.
#[expect(clippy::vec_box, reason = "a vector that grows must not copy blocks")]
#[derive(Clone, Debug, Default)]
pub(crate) struct Grid {
    blocks: Vec<Box<Block>>,
    keys: Vec<Key>,
    index: KeyMap<u32>,
    tiles: KeyMap<Vec<u32>>,
}

impl Grid {
    pub(crate) fn len(&self) -> usize {
        self.blocks.len()
    }

    pub(crate) fn get(&self, key: Key) -> Option<&Block> {
        let index = self.index.get(&pack(key))?;
        Some(&self.blocks[*index as usize])
    }

    pub(crate) fn position(&self, key: Key) -> Option<usize> {
        self.index.get(&pack(key)).map(|index| *index as usize)
    }

    /// Block and key of a number.
    pub(crate) fn at(&self, number: usize) -> (&Block, Key) {
        (&self.blocks[number], self.keys[number])
    }

    /// Numbers of all blocks in the order of their places.
    pub(crate) fn sorted(&self) -> Vec<usize> {
        let mut numbers: Vec<usize> = (0..self.len()).collect();
        numbers.sort_unstable_by_key(|number| pack(self.keys[*number]));
        numbers
    }

    /// Adds blocks that are not there yet. Keys must be sorted.
    pub(crate) fn allocate(&mut self, sorted_keys: &[u64]) {
        for packed in sorted_keys {
            if self.index.contains_key(packed) {
                continue;
            }
            let number = self.blocks.len() as u32;
            let key = unpack(*packed);
            self.index.insert(*packed, number);
            self.blocks.push(Block::new());
            self.keys.push(key);
            self.tiles
                .entry(pack(tile_of(key)))
                .or_default()
                .push(number);
        }
    }

    /// Numbers of the blocks of all tiles that a box of blocks touches.
    pub(crate) fn near(&self, from: Key, to: Key) -> Vec<u32> {
        let (from, to) = (tile_of(from), tile_of(to));
        let mut numbers = Vec::new();
        for z in from[2]..=to[2] {
            for y in from[1]..=to[1] {
                for x in from[0]..=to[0] {
                    if let Some(tile) = self.tiles.get(&pack([x, y, z])) {
                        numbers.extend_from_slice(tile);
                    }
                }
            }
        }
        numbers
    }

    pub(crate) fn key(&self, number: u32) -> Key {
        self.keys[number as usize]
    }

    pub(crate) fn has_surface(&self, number: u32) -> bool {
        self.blocks[number as usize].surface.is_some()
    }

    /// Blocks of ascending numbers, for changes in parallel.
    pub(crate) fn select(&mut self, ascending: &[u32]) -> Vec<(Key, &mut Block)> {
        let mut selected = Vec::with_capacity(ascending.len());
        let (mut rest, mut start) = (self.blocks.as_mut_slice(), 0);
        for number in ascending {
            let number = *number as usize;
            let (_, from) = rest.split_at_mut(number - start);
            let Some((block, after)) = from.split_first_mut() else {
                break;
            };
            selected.push((self.keys[number], block.as_mut()));
            (rest, start) = (after, number + 1);
        }
        selected
    }

    pub(crate) fn bytes(&self) -> usize {
        let blocks: usize = self.blocks.iter().map(|block| block.bytes()).sum();
        // Box, key, entry of the table at its load, entry in the tile.
        blocks + self.len() * (8 + size_of::<Key>() + 32 + 4)
    }
}

fn tile_of(key: Key) -> Key {
    key.map(|k| k >> TILE_SHIFT)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn keys_survive_packing_in_order() {
        for key in [[0, 0, 0], [-1, 5, -7], [MAX_COORDINATE, -MAX_COORDINATE, 3]] {
            assert_eq!(unpack(pack(key)), key);
        }
        assert!(pack([-1, 9, 2]) < pack([-2, -9, 3]));
    }

    #[test]
    fn tiles_find_blocks_of_a_box_only() {
        let mut grid = Grid::default();
        let mut keys: Vec<u64> = [[0, 0, 0], [-1, 0, 0], [40, 0, 0]].map(pack).to_vec();
        keys.sort_unstable();
        grid.allocate(&keys);
        grid.allocate(&keys);
        assert_eq!(grid.len(), 3);
        let mut near = grid.near([-3, 0, 0], [3, 0, 0]);
        near.sort_unstable();
        let mut found: Vec<Key> = near.iter().map(|number| grid.key(*number)).collect();
        found.sort_unstable();
        assert_eq!(found, [[-1, 0, 0], [0, 0, 0]]);
        let selected = grid.select(&near);
        assert_eq!(selected.len(), 2);
    }
}
