//! Digits and a few letters as dots, three columns by five rows.

/// Columns of a glyph.
pub(crate) const COLUMNS: usize = 3;
/// Rows of a glyph.
pub(crate) const ROWS: usize = 5;
/// Columns from one glyph to the next.
pub(crate) const ADVANCE: usize = COLUMNS + 1;

/// Rows of three dots each, from the top, the highest bit first.
const GLYPHS: [(char, u16); 13] = [
    ('0', 0b111_101_101_101_111),
    ('1', 0b010_110_010_010_111),
    ('2', 0b111_001_111_100_111),
    ('3', 0b111_001_111_001_111),
    ('4', 0b101_101_111_001_001),
    ('5', 0b111_100_111_001_111),
    ('6', 0b111_100_111_101_111),
    ('7', 0b111_001_010_010_010),
    ('8', 0b111_101_111_101_111),
    ('9', 0b111_101_111_001_111),
    ('.', 0b000_000_000_000_010),
    ('s', 0b011_100_010_001_110),
    ('m', 0b000_110_111_101_101),
];

/// Column and row of each dot of a character; none if the character is unsupported.
pub(crate) fn dots(character: char) -> impl Iterator<Item = [usize; 2]> {
    let glyph = GLYPHS.iter().find(|(c, _)| *c == character);
    let bits = glyph.map_or(0, |(_, bits)| *bits);
    let count = COLUMNS * ROWS;
    (0..count)
        .filter(move |k| bits >> (count - 1 - k) & 1 == 1)
        .map(|k| [k % COLUMNS, k / COLUMNS])
}
