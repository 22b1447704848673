//! Rows with padding, as cameras and decoders give them, into I420.
//!
//! Contract: one pass, no intermediate image. What is written is a window of an I420 image,
//! so that two eyes can be put beside each other while they are converted. Luma is taken as it is;
//! chroma of 4:2:2 is the mean of two rows, halves rounded up. A source that is shorter than its
//! size says is an error, and nothing is written then.

use super::{PixelFormat, RawImageError};

/// One plane: bytes, and the distance from a row to the next.
#[derive(Debug, Clone, Copy)]
pub(crate) struct PlaneView<'a> {
    pub(crate) data: &'a [u8],
    pub(crate) stride: usize,
}

impl<'a> PlaneView<'a> {
    /// `count` rows of `bytes` each. The last one needs no padding behind it.
    fn rows(
        self,
        bytes: usize,
        count: usize,
    ) -> Result<impl Iterator<Item = &'a [u8]>, RawImageError> {
        // A row cannot begin inside the one before it.
        let expected = count.saturating_sub(1) * self.stride.max(bytes) + bytes;
        if self.stride < bytes || self.data.len() < expected {
            return Err(RawImageError::WrongLength {
                found: self.data.len(),
                expected,
            });
        }
        let rows = self.data.chunks(self.stride.max(1)).take(count);
        Ok(rows.map(move |row| &row[..bytes]))
    }
}

/// An uncompressed image in one of the layouts that cameras and decoders use.
#[derive(Debug, Clone, Copy)]
pub(crate) enum Layout<'a> {
    /// Luma.
    Grey(PlaneView<'a>),
    /// Luma, Cb, Cr.
    I420([PlaneView<'a>; 3]),
    /// Luma, then Cb and Cr in turn.
    Nv12([PlaneView<'a>; 2]),
    /// Y Cb Y Cr, also called YUY2.
    Yuyv(PlaneView<'a>),
    /// Cb Y Cr Y.
    Uyvy(PlaneView<'a>),
}

/// Where to write: `columns` columns from column `x` on, which is even, of an I420 image that is
/// `width` wide.
#[derive(Debug)]
pub(crate) struct Window<'a> {
    pub(crate) data: &'a mut [u8],
    pub(crate) width: u32,
    pub(crate) height: u32,
    pub(crate) x: u32,
    pub(crate) columns: u32,
}

impl<'a> Window<'a> {
    /// All of an image.
    pub(crate) fn whole(data: &'a mut [u8], width: u32, height: u32) -> Window<'a> {
        Window {
            data,
            width,
            height,
            x: 0,
            columns: width,
        }
    }
}

/// Writes `source`, which is as large as the window.
pub(crate) fn write(source: Layout<'_>, window: Window<'_>) -> Result<(), RawImageError> {
    let Window {
        data,
        width,
        height,
        x,
        columns,
    } = window;
    PixelFormat::I420.bytes(columns, height)?;
    if !x.is_multiple_of(2) || x.checked_add(columns).is_none_or(|end| end > width) {
        return Err(RawImageError::OddSize { width: x, height });
    }
    let expected = PixelFormat::I420.bytes(width, height)?;
    if data.len() != expected {
        let found = data.len();
        return Err(RawImageError::WrongLength { found, expected });
    }
    let [width, height, x, columns] = [width, height, x, columns].map(|n| n as usize);
    let (luma, chroma) = data.split_at_mut(width * height);
    let (cb, cr) = chroma.split_at_mut(chroma.len() / 2);
    let luma = cut(luma, width, x, columns);
    let (half, rows) = (columns.div_ceil(2), height.div_ceil(2));
    let cb = cut(cb, width.div_ceil(2), x / 2, half);
    let cr = cut(cr, width.div_ceil(2), x / 2, half);
    match source {
        Layout::Grey(plane) => {
            copy(plane.rows(columns, height)?, luma);
            cb.chain(cr).for_each(|row| row.fill(128));
        }
        Layout::I420([y, u, v]) => {
            let y = y.rows(columns, height)?;
            let u = u.rows(half, rows)?;
            let v = v.rows(half, rows)?;
            copy(y, luma);
            copy(u, cb);
            copy(v, cr);
        }
        Layout::Nv12([y, pairs]) => {
            let y = y.rows(columns, height)?;
            let pairs = pairs.rows(2 * half, rows)?;
            copy(y, luma);
            for (pairs, (cb, cr)) in pairs.zip(cb.zip(cr)) {
                for (pair, (cb, cr)) in pairs.chunks_exact(2).zip(cb.iter_mut().zip(cr)) {
                    *cb = pair[0];
                    *cr = pair[1];
                }
            }
        }
        Layout::Yuyv(_) | Layout::Uyvy(_) if !columns.is_multiple_of(2) => {
            let [width, height] = [columns, height].map(|n| n as u32);
            return Err(RawImageError::OddSize { width, height });
        }
        Layout::Yuyv(plane) => unpack::<0>(plane.rows(2 * columns, height)?, luma, cb.zip(cr)),
        Layout::Uyvy(plane) => unpack::<1>(plane.rows(2 * columns, height)?, luma, cb.zip(cr)),
    }
    Ok(())
}

/// The part of every row of `plane` that begins at `x`.
fn cut(
    plane: &mut [u8],
    width: usize,
    x: usize,
    columns: usize,
) -> impl Iterator<Item = &mut [u8]> {
    plane
        .chunks_exact_mut(width)
        .map(move |row| &mut row[x..x + columns])
}

fn copy<'a>(source: impl Iterator<Item = &'a [u8]>, target: impl Iterator<Item = &'a mut [u8]>) {
    for (source, target) in source.zip(target) {
        target.copy_from_slice(source);
    }
}

/// Packed 4:2:2, with luma at bytes `Y` and `Y + 2` of every four.
fn unpack<'a, const Y: usize>(
    mut source: impl Iterator<Item = &'a [u8]>,
    mut luma: impl Iterator<Item = &'a mut [u8]>,
    chroma: impl Iterator<Item = (&'a mut [u8], &'a mut [u8])>,
) {
    for (cb, cr) in chroma {
        let Some(upper) = source.next() else {
            return;
        };
        // An odd last row has the chroma to itself.
        let lower = source.next().unwrap_or(upper);
        for (row, luma) in [upper, lower].into_iter().zip(&mut luma) {
            for (pair, luma) in row.chunks_exact(2).zip(luma) {
                *luma = pair[Y];
            }
        }
        let blocks = upper.chunks_exact(4).zip(lower.chunks_exact(4));
        for ((upper, lower), (cb, cr)) in blocks.zip(cb.iter_mut().zip(cr)) {
            let mean = |at: usize| (u16::from(upper[at]) + u16::from(lower[at])).div_ceil(2) as u8;
            *cb = mean(1 - Y);
            *cr = mean(3 - Y);
        }
    }
}
