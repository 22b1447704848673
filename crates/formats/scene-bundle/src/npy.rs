//! Tables as NumPy arrays of records (`.npy`; NumPy enhancement proposal 1 and `numpy.lib.format`):
//! a text header with the columns, then rows of fixed size, little-endian, without padding between
//! fields.
//!
//! Contract: the length of the header does not depend on the number of rows, so a table can be
//! written row by row and the number filled in at the end. The reader takes tables written here or
//! saved again by NumPy with the same columns, and nothing else. [`array`] has arrays of numbers.

use std::io::{self, Write};
use std::path::Path;

use crate::draft::{Draft, DraftFile};
use crate::error::{BundleError, doing};

pub(crate) mod array;

/// Type of a field of a row.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Kind {
    I64,
    U64,
    I32,
    U32,
    F64,
    F32,
    U8,
    I8,
    Bool,
}

/// A column: its name, type, and number of values per row.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Column(pub(crate) &'static str, pub(crate) Kind, pub(crate) usize);

impl Kind {
    fn code(self) -> &'static str {
        match self {
            Self::I64 => "<i8",
            Self::U64 => "<u8",
            Self::I32 => "<i4",
            Self::U32 => "<u4",
            Self::F64 => "<f8",
            Self::F32 => "<f4",
            Self::U8 => "|u1",
            Self::I8 => "|i1",
            Self::Bool => "|b1",
        }
    }

    fn bytes(self) -> usize {
        match self {
            Self::I64 | Self::U64 | Self::F64 => 8,
            Self::I32 | Self::U32 | Self::F32 => 4,
            Self::U8 | Self::I8 | Self::Bool => 1,
        }
    }
}

const MAGIC: &[u8] = b"\x93NUMPY\x01\x00";
/// Digits of the largest number of rows.
const COUNT_DIGITS: usize = 20;
/// NumPy aligns what follows the header.
const ALIGNMENT: usize = 64;

fn row_bytes(columns: &[Column]) -> usize {
    columns
        .iter()
        .map(|Column(_, kind, count)| kind.bytes() * count)
        .sum()
}

fn description(columns: &[Column]) -> String {
    let fields = columns.iter().map(|Column(name, kind, count)| match count {
        1 => format!("('{name}', '{}')", kind.code()),
        _ => format!("('{name}', '{}', ({count},))", kind.code()),
    });
    fields.collect::<Vec<_>>().join(", ")
}

fn header(columns: &[Column], rows: u64) -> Vec<u8> {
    let text = format!(
        "{{'descr': [{}], 'fortran_order': False, 'shape': ({rows},), }}",
        description(columns)
    );
    let longest = text.len() - rows.to_string().len() + COUNT_DIGITS;
    start(&text, longest)
}

/// Everything before the data, as long as with a text of `longest` bytes.
fn start(text: &str, longest: usize) -> Vec<u8> {
    // Magic, the length in two bytes, the text, at least one blank, a line feed.
    let whole = (MAGIC.len() + 2 + longest + 2).next_multiple_of(ALIGNMENT);
    let length = whole - MAGIC.len() - 2;
    let mut bytes = MAGIC.to_vec();
    bytes.extend((length as u16).to_le_bytes());
    bytes.extend(text.as_bytes());
    bytes.resize(whole - 1, b' ');
    bytes.push(b'\n');
    bytes
}

/// Writes a table row by row.
pub(crate) struct TableWriter {
    file: DraftFile,
    columns: &'static [Column],
    rows: u64,
    row: Vec<u8>,
}

impl TableWriter {
    pub(crate) fn create(
        draft: &Draft,
        path: &str,
        columns: &'static [Column],
    ) -> Result<Self, BundleError> {
        let mut file = draft.create(path)?;
        let place = file.file_path();
        file.write_all(&header(columns, 0))
            .map_err(doing("writing a table", place))?;
        Ok(Self {
            file,
            columns,
            rows: 0,
            row: Vec::with_capacity(row_bytes(columns)),
        })
    }

    /// Writes one row; `fill` puts in the fields in the order of the columns.
    pub(crate) fn row(&mut self, fill: impl FnOnce(&mut Row<'_>)) -> Result<(), BundleError> {
        self.row.clear();
        fill(&mut Row(&mut self.row));
        debug_assert_eq!(
            self.row.len(),
            row_bytes(self.columns),
            "a row has all its fields"
        );
        self.rows += 1;
        self.file
            .write_all(&self.row)
            .map_err(|e: io::Error| doing("writing a table", self.file.file_path())(e))
    }

    pub(crate) fn finish(mut self) -> Result<(), BundleError> {
        let header = header(self.columns, self.rows);
        let place = self.file.file_path();
        self.file
            .overwrite_start(&header)
            .map_err(doing("writing a table", place))?;
        self.file.finish()
    }
}

/// A row being written.
pub(crate) struct Row<'a>(&'a mut Vec<u8>);

impl Row<'_> {
    pub(crate) fn i64(&mut self, value: i64) {
        self.0.extend(value.to_le_bytes());
    }

    pub(crate) fn u64(&mut self, value: u64) {
        self.0.extend(value.to_le_bytes());
    }

    pub(crate) fn i32(&mut self, value: i32) {
        self.0.extend(value.to_le_bytes());
    }

    pub(crate) fn u32(&mut self, value: u32) {
        self.0.extend(value.to_le_bytes());
    }

    pub(crate) fn f64(&mut self, values: &[f64]) {
        self.0.extend(values.iter().flat_map(|v| v.to_le_bytes()));
    }

    pub(crate) fn f32(&mut self, values: &[f32]) {
        self.0.extend(values.iter().flat_map(|v| v.to_le_bytes()));
    }

    pub(crate) fn u8(&mut self, value: u8) {
        self.0.push(value);
    }

    pub(crate) fn bool(&mut self, value: bool) {
        self.0.push(u8::from(value));
    }
}

/// A row being read, from its first field on.
pub(crate) struct Fields<'a>(&'a [u8]);

impl Fields<'_> {
    fn take<const N: usize>(&mut self) -> [u8; N] {
        let (head, rest) = self
            .0
            .split_first_chunk()
            .expect("a row has all its fields");
        self.0 = rest;
        *head
    }

    pub(crate) fn i64(&mut self) -> i64 {
        i64::from_le_bytes(self.take())
    }

    pub(crate) fn u64(&mut self) -> u64 {
        u64::from_le_bytes(self.take())
    }

    pub(crate) fn i32(&mut self) -> i32 {
        i32::from_le_bytes(self.take())
    }

    pub(crate) fn u32(&mut self) -> u32 {
        u32::from_le_bytes(self.take())
    }

    pub(crate) fn f64<const N: usize>(&mut self) -> [f64; N] {
        std::array::from_fn(|_| f64::from_le_bytes(self.take()))
    }

    pub(crate) fn f32<const N: usize>(&mut self) -> [f32; N] {
        std::array::from_fn(|_| f32::from_le_bytes(self.take()))
    }

    pub(crate) fn u8(&mut self) -> u8 {
        let [value] = self.take();
        value
    }

    pub(crate) fn bool(&mut self) -> bool {
        self.u8() != 0
    }
}

/// The rows of a table with these columns. `path` is for messages.
pub(crate) fn rows<'a>(
    bytes: &'a [u8],
    columns: &[Column],
    path: &Path,
) -> Result<impl Iterator<Item = Fields<'a>>, BundleError> {
    let (text, data) = parts(bytes, path)?;
    let text = blankless(&text);
    let before = blankless(&format!(
        "{{'descr': [{}], 'fortran_order': False, 'shape': (",
        description(columns)
    ));
    let count = text
        .strip_prefix(&before)
        .and_then(|rest| rest.strip_suffix(",),}"))
        .and_then(|count| count.parse::<u64>().ok())
        .ok_or_else(|| wrong(path, "header", text.clone(), format!("{before}ROWS,),}}")))?;
    let size = row_bytes(columns);
    if count.checked_mul(size as u64) != Some(data.len() as u64) {
        let found = format!("{} bytes of rows", data.len());
        return Err(wrong(
            path,
            "rows",
            found,
            format!("{count} rows of {size} bytes"),
        ));
    }
    Ok(data.chunks_exact(size).map(Fields))
}

/// The text of the header and the data behind it.
fn parts<'a>(bytes: &'a [u8], path: &Path) -> Result<(String, &'a [u8]), BundleError> {
    let mut start = Fields(bytes);
    if bytes.len() < MAGIC.len() + 2 || !bytes.starts_with(MAGIC) {
        let found = format!("{:02x?}", &bytes[..bytes.len().min(MAGIC.len())]);
        return Err(wrong(
            path,
            "start",
            found,
            "the start of a NumPy array, format 1.0".to_owned(),
        ));
    }
    start.take::<{ MAGIC.len() }>();
    let length = usize::from(u16::from_le_bytes(start.take()));
    let Some((text, data)) = start.0.split_at_checked(length) else {
        let found = format!("{} bytes", start.0.len());
        return Err(wrong(path, "header", found, format!("{length}")));
    };
    Ok((String::from_utf8_lossy(text).into_owned(), data))
}

fn blankless(text: &str) -> String {
    text.split_ascii_whitespace().collect()
}

fn wrong(path: &Path, place: &str, found: String, expected: String) -> BundleError {
    BundleError::Malformed {
        path: path.to_owned(),
        place: place.to_owned(),
        found,
        expected,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const COLUMNS: [Column; 3] = [
        Column("time_ns", Kind::I64, 1),
        Column("place_m", Kind::F64, 3),
        Column("good", Kind::Bool, 1),
    ];

    #[test]
    fn the_length_of_the_header_does_not_depend_on_the_number_of_rows() {
        let empty = header(&COLUMNS, 0);
        assert_eq!(empty.len() % ALIGNMENT, 0);
        assert_eq!(header(&COLUMNS, u64::MAX).len(), empty.len());
        let text = String::from_utf8_lossy(&empty[10..]).into_owned();
        assert_eq!(
            text.trim_end(),
            "{'descr': [('time_ns', '<i8'), ('place_m', '<f8', (3,)), ('good', '|b1')], 'fortran_order': False, \
             'shape': (0,), }"
        );
        let length = usize::from(u16::from_le_bytes([empty[8], empty[9]]));
        assert_eq!(length + 10, empty.len());
        assert!(text.ends_with(" \n"));
    }

    #[test]
    fn other_tables_are_refused() {
        let path = Path::new("t.npy");
        let message = |bytes: &[u8], columns: &[Column]| match rows(bytes, columns, path) {
            Ok(_) => panic!("refused"),
            Err(error) => error.to_string(),
        };
        let mut good = header(&COLUMNS, 1);
        good.extend([0; 33]);
        assert_eq!(rows(&good, &COLUMNS, path).unwrap().count(), 1);
        let short = message(&good[..good.len() - 1], &COLUMNS);
        assert!(
            short.contains("rows: found 32 bytes of rows, expected 1 rows of 33 bytes"),
            "{short}"
        );
        let other = message(&good, &COLUMNS[..2]);
        assert!(other.contains("header: found {'descr'"), "{other}");
        assert!(message(b"PK\x03\x04", &COLUMNS).contains("found [50, 4b, 03, 04]"));
        assert!(message(&good[..40], &COLUMNS).contains("header: found 30 bytes"));
    }
}
