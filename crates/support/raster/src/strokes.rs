//! Letters as lines, for drawings without a font: printable ASCII except a few signs, `°` and `±`.
//!
//! A letter is on a grid of 5 columns and 9 rows, 0 at the lower left. Each is a list of polylines,
//! a column digit and a row digit per point: the baseline is row 2, small letters reach row 6,
//! capitals row 8.

/// Width of the lines, relative to the size of the text.
pub const THICKNESS: f64 = 0.1;

/// Columns from one letter to the next.
const ADVANCE: f64 = 6.0;
/// Column of the grid's left side, from the left of the letter's place.
const LEFT: f64 = 0.8;
/// Row of the baseline.
const BASE: f64 = 2.0;
/// Width of a column and height of a row, relative to the size of the text.
const COLUMN: f64 = 0.1;
const ROW: f64 = 0.115;

const GLYPHS: &[(char, &str)] = &[
    ('A', "02,28,42;14,34"),
    ('B', "02,08,38,47,46,35,05;35,44,43,32,02"),
    ('C', "47,38,18,07,03,12,32,43"),
    ('D', "02,08,28,46,44,22,02"),
    ('E', "48,08,02,42;05,35"),
    ('F', "48,08,02;05,35"),
    ('G', "47,38,18,07,03,12,32,43,45,25"),
    ('H', "02,08;42,48;05,45"),
    ('I', "12,32;18,38;22,28"),
    ('J', "48,43,32,12,03"),
    ('K', "02,08;48,05,42"),
    ('L', "08,02,42"),
    ('M', "02,08,25,48,42"),
    ('N', "02,08,42,48"),
    ('O', "18,38,47,43,32,12,03,07,18"),
    ('P', "02,08,38,47,46,35,05"),
    ('Q', "18,38,47,43,32,12,03,07,18;24,42"),
    ('R', "02,08,38,47,46,35,05;25,42"),
    ('S', "47,38,18,07,06,15,35,44,43,32,12,03"),
    ('T', "08,48;28,22"),
    ('U', "08,03,12,32,43,48"),
    ('V', "08,22,48"),
    ('W', "08,12,26,32,48"),
    ('X', "08,42;02,48"),
    ('Y', "08,25,48;25,22"),
    ('Z', "08,48,02,42"),
    ('a', "05,16,36,45,42;44,14,03,12,32,43"),
    ('b', "08,02;05,16,36,45,43,32,12,03"),
    ('c', "45,36,16,05,03,12,32,43"),
    ('d', "48,42;45,36,16,05,03,12,32,43"),
    ('e', "04,44,45,36,16,05,03,12,32,43"),
    ('f', "38,28,17,12;06,36"),
    ('g', "46,41,30,10,01;45,36,16,05,03,12,32,43"),
    ('h', "08,02;05,16,36,45,42"),
    ('i', "16,26,22;12,32;28,28"),
    ('j', "26,36,31,20,10;38,38"),
    ('k', "08,02;46,04,42"),
    ('l', "18,28,22;12,32"),
    ('m', "02,06;05,16,25,22;25,36,45,42"),
    ('n', "02,06;05,16,36,45,42"),
    ('o', "16,36,45,43,32,12,03,05,16"),
    ('p', "00,06;05,16,36,45,43,32,12,03"),
    ('q', "40,46;45,36,16,05,03,12,32,43"),
    ('r', "02,06;04,26,36,45"),
    ('s', "45,36,16,05,14,34,43,32,12,03"),
    ('t', "18,13,22,32,43;06,36"),
    ('u', "06,03,12,32,43;46,42"),
    ('v', "06,22,46"),
    ('w', "06,12,25,32,46"),
    ('x', "06,42;02,46"),
    ('y', "06,23;46,10"),
    ('z', "06,46,02,42"),
    ('0', "18,38,47,43,32,12,03,07,18;03,47"),
    ('1', "07,28,22;12,32"),
    ('2', "07,18,38,47,46,02,42"),
    ('3', "07,18,38,47,46,35,15;35,44,43,32,12,03"),
    ('4', "32,38,04,44"),
    ('5', "48,08,05,35,44,43,32,12,03"),
    ('6', "38,18,07,03,12,32,43,44,35,05"),
    ('7', "08,48,12"),
    ('8', "15,06,07,18,38,47,46,35,15,04,03,12,32,43,44,35"),
    ('9', "45,15,06,07,18,38,47,43,32,12"),
    (' ', ""),
    ('.', "22,22"),
    (',', "22,11"),
    (':', "25,25;22,22"),
    (';', "25,25;22,11"),
    ('-', "15,35"),
    ('+', "23,27;05,45"),
    ('_', "01,41"),
    ('/', "02,48"),
    ('(', "38,27,23,32"),
    (')', "18,27,23,12"),
    ('[', "38,18,12,32"),
    (']', "18,38,32,12"),
    ('=', "04,44;06,46"),
    ('<', "47,05,43"),
    ('>', "07,45,03"),
    ('°', "18,28,27,17,18"),
    ('±', "24,28;06,46;02,42"),
    ('#', "13,17;33,37;04,44;06,46"),
    ('\'', "28,27"),
    ('"', "18,17;38,37"),
    ('%', "02,48;17,17;33,33"),
    ('*', "23,27;14,36;16,34"),
    ('&', "42,16,17,28,37,36,04,03,12,22,44"),
    ('?', "07,18,38,47,46,25,24;22,22"),
    ('!', "28,24;22,22"),
    ('@', "32,12,03,07,18,38,47,44,34,24,25,36"),
];

/// Glyph of unsupported letters.
const UNKNOWN: &str = "02,08,48,42,02";

/// The polylines of a text whose baseline begins at a point; y down, in the units of `size`.
pub fn text([x, y]: [f64; 2], size: f64, text: &str) -> impl Iterator<Item = Vec<[f64; 2]>> {
    let (u, v) = (COLUMN * size, ROW * size);
    text.chars().enumerate().flat_map(move |(i, letter)| {
        let left = x + u * (ADVANCE * i as f64 + LEFT);
        let place = move |[c, r]: [f64; 2]| [left + u * c, y - v * (r - BASE)];
        lines(letter)
            .into_iter()
            .map(move |line| line.into_iter().map(place).collect())
    })
}

/// Width of a text of this size.
pub fn width(text: &str, size: f64) -> f64 {
    0.6 * size * text.chars().count() as f64
}

/// The polylines of a letter on its grid.
fn lines(letter: char) -> Vec<Vec<[f64; 2]>> {
    let found = GLYPHS.iter().find(|(c, _)| *c == letter);
    let text = found.map_or(UNKNOWN, |(_, text)| *text);
    let digit = |b: u8| f64::from(b - b'0');
    let point = |p: &str| [digit(p.as_bytes()[0]), digit(p.as_bytes()[1])];
    text.split(';')
        .filter(|line| !line.is_empty())
        .map(|line| line.split(',').map(point).collect())
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_glyph_is_inside_its_grid() {
        for (letter, _) in GLYPHS {
            for line in lines(*letter) {
                assert!(line.len() >= 2, "{letter}");
                for [x, y] in line {
                    assert!(
                        (0.0..=4.0).contains(&x) && (0.0..=8.0).contains(&y),
                        "{letter}"
                    );
                }
            }
        }
        let unknown: Vec<char> = (' '..='~')
            .filter(|c| !GLYPHS.iter().any(|(g, _)| g == c))
            .collect();
        assert_eq!(unknown, ['$', '\\', '^', '`', '{', '|', '}', '~']);
    }

    #[test]
    fn a_text_is_as_wide_as_stated() {
        let points: Vec<[f64; 2]> = text([10.0, 50.0], 20.0, "AgE").flatten().collect();
        let high = |axis: usize| points.iter().map(|p| p[axis]).fold(f64::MIN, f64::max);
        let low = |axis: usize| points.iter().map(|p| p[axis]).fold(f64::MAX, f64::min);
        assert_eq!(width("AgE", 20.0), 36.0);
        assert!(low(0) > 10.0 && high(0) < 46.0);
        // Capitals above the baseline, tails below.
        assert!((low(1) - (50.0 - 6.0 * 2.3)).abs() < 1e-9, "{}", low(1));
        assert!((high(1) - (50.0 + 2.0 * 2.3)).abs() < 1e-9, "{}", high(1));
    }
}
