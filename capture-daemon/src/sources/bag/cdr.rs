//! CDR, the encoding of ROS 2 messages, as far as `sensor_msgs` needs it. Pure.
//!
//! OMG's DDS-XTypes and RTPS: four bytes give the representation, then every number is aligned to
//! its own size, counted from behind those four bytes; a string is preceded by its length with the
//! terminating zero, a sequence by the number of its elements. Only the plain representation of
//! XCDR1 is read, which is what ROS 2 writes. Every length is compared with the remaining bytes
//! before anything is taken; nothing is allocated.

/// Error of decoding a message.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum CdrError {
    /// Unsupported representation.
    #[error("its representation is {0:#06x}, expected plain CDR (0x0000 or 0x0001)")]
    Representation(u16),
    /// It ends too soon.
    #[error("it ends {missing} bytes too soon")]
    Short {
        /// Number of missing bytes.
        missing: usize,
    },
    /// A string is not UTF-8 or has no terminating zero.
    #[error("a text in it is not UTF-8 with a closing zero")]
    Text,
    /// An invalid value of this field.
    #[error("{0}")]
    Value(&'static str),
}

/// Takes one value after the other.
#[derive(Clone, Copy, Debug)]
pub(super) struct Reader<'a> {
    /// Behind the representation.
    bytes: &'a [u8],
    at: usize,
    little: bool,
}

impl<'a> Reader<'a> {
    pub(super) fn new(message: &'a [u8]) -> Result<Self, CdrError> {
        let Some((head, bytes)) = message.split_first_chunk::<4>() else {
            let missing = 4 - message.len();
            return Err(CdrError::Short { missing });
        };
        let little = match u16::from_be_bytes([head[0], head[1]]) {
            0 => false,
            1 => true,
            other => return Err(CdrError::Representation(other)),
        };
        Ok(Self {
            bytes,
            at: 0,
            little,
        })
    }

    fn take(&mut self, count: usize) -> Result<&'a [u8], CdrError> {
        let left = self.bytes.len().saturating_sub(self.at);
        if count > left {
            return Err(CdrError::Short {
                missing: count - left,
            });
        }
        let taken = &self.bytes[self.at..self.at + count];
        self.at += count;
        Ok(taken)
    }

    /// `N` bytes at a multiple of `N`, in the order of a little-endian number.
    fn number<const N: usize>(&mut self) -> Result<[u8; N], CdrError> {
        let skipped = self.at.next_multiple_of(N) - self.at;
        self.take(skipped)?;
        let mut number = [0; N];
        number.copy_from_slice(self.take(N)?);
        if !self.little {
            number.reverse();
        }
        Ok(number)
    }

    pub(super) fn u8(&mut self) -> Result<u8, CdrError> {
        self.number::<1>().map(|[byte]| byte)
    }

    pub(super) fn u32(&mut self) -> Result<u32, CdrError> {
        self.number().map(u32::from_le_bytes)
    }

    pub(super) fn i32(&mut self) -> Result<i32, CdrError> {
        self.number().map(i32::from_le_bytes)
    }

    pub(super) fn f64(&mut self) -> Result<f64, CdrError> {
        self.number().map(f64::from_le_bytes)
    }

    pub(super) fn f64s<const N: usize>(&mut self) -> Result<[f64; N], CdrError> {
        let mut values = [0.0; N];
        for value in &mut values {
            *value = self.f64()?;
        }
        Ok(values)
    }

    pub(super) fn text(&mut self) -> Result<&'a str, CdrError> {
        let length = self.u32()? as usize;
        let bytes = self.take(length)?;
        let text = match bytes.split_last() {
            Some((0, text)) => text,
            // Some writers omit the terminating zero of an empty text.
            None => &[],
            Some(_) => return Err(CdrError::Text),
        };
        std::str::from_utf8(text).map_err(|_| CdrError::Text)
    }

    pub(super) fn bytes(&mut self) -> Result<&'a [u8], CdrError> {
        let length = self.u32()? as usize;
        self.take(length)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_are_aligned_in_both_byte_orders() {
        let little = [
            0, 1, 0, 0, // little-endian
            7, 0xff, 0xff, 0xff, // a byte and padding
            1, 2, 0, 0, // 513
            3, 0, 0, 0, b'a', b'b', 0, 0xff, // "ab" and padding
            0, 0, 0, 0, 0, 0, 0xf8, 0x3f, // 1.5, at 16
        ];
        let mut reader = Reader::new(&little).expect("a reader");
        assert_eq!(reader.u8(), Ok(7));
        assert_eq!(reader.u32(), Ok(513));
        assert_eq!(reader.text(), Ok("ab"));
        assert_eq!(reader.f64(), Ok(1.5));
        assert_eq!(reader.u8(), Err(CdrError::Short { missing: 1 }));

        let big = [0, 0, 0, 0, 7, 0, 0, 0, 0, 0, 2, 1, 0, 0, 0, 1, 9];
        let mut reader = Reader::new(&big).expect("a reader");
        assert_eq!((reader.u8(), reader.u32()), (Ok(7), Ok(513)));
        assert_eq!(reader.bytes(), Ok(&[9][..]));
    }

    #[test]
    fn truncated_value_is_an_error() {
        assert_eq!(
            Reader::new(&[0, 1]).err(),
            Some(CdrError::Short { missing: 2 })
        );
        let parameters = Reader::new(&[0, 3, 0, 0]).err();
        assert_eq!(parameters, Some(CdrError::Representation(3)));
        let mut huge = Reader::new(&[0, 1, 0, 0, 0xff, 0xff, 0xff, 0xff]).expect("a reader");
        assert!(matches!(huge.bytes(), Err(CdrError::Short { .. })));
        let mut open = Reader::new(&[0, 1, 0, 0, 1, 0, 0, 0, b'a']).expect("a reader");
        assert_eq!(open.text(), Err(CdrError::Text));
    }
}
