//! Bytes of the state of a training.
//!
//! Contract: one pass over the state serves for writing and for reading, so that the two cannot
//! disagree. Numbers are little-endian, floating-point numbers keep their bits. Reading accepts any
//! bytes: it allocates no more than there are, and refuses what is left over.

use crate::error::SplatError;

/// Where the state goes to, or comes from.
pub(crate) enum Codec<'a> {
    /// Bytes so far.
    Write(Vec<u8>),
    /// Bytes that are left.
    Read(&'a [u8]),
}

/// State that can be written and read.
pub(crate) trait State {
    /// Passes all of it to the codec, which replaces it when reading.
    fn visit(&mut self, codec: &mut Codec<'_>) -> Result<(), SplatError>;
}

pub(crate) fn broken(reason: impl Into<String>) -> SplatError {
    SplatError::Checkpoint {
        reason: reason.into(),
    }
}

impl Codec<'_> {
    fn bytes<const N: usize>(&mut self, value: [u8; N]) -> Result<[u8; N], SplatError> {
        match self {
            Self::Write(bytes) => {
                bytes.extend(value);
                Ok(value)
            }
            Self::Read(bytes) => {
                let (value, rest) = bytes
                    .split_first_chunk()
                    .ok_or_else(|| broken("it ends early"))?;
                *bytes = rest;
                Ok(*value)
            }
        }
    }

    /// Length of a list whose elements have this number of bytes each.
    pub(super) fn length(&mut self, length: usize, bytes: usize) -> Result<usize, SplatError> {
        let length = u64::from_le_bytes(self.bytes((length as u64).to_le_bytes())?);
        match self {
            Self::Read(rest) if length > (rest.len() / bytes) as u64 => Err(broken(format!(
                "a list of {length} values and no bytes for it"
            ))),
            _ => Ok(length as usize),
        }
    }
}

macro_rules! number {
    ($($type:ty),*) => {$(
        impl State for $type {
            fn visit(&mut self, codec: &mut Codec<'_>) -> Result<(), SplatError> {
                *self = Self::from_le_bytes(codec.bytes(self.to_le_bytes())?);
                Ok(())
            }
        }
    )*};
}

number!(u16, u32, u64, i32, f32, f64);

impl State for usize {
    fn visit(&mut self, codec: &mut Codec<'_>) -> Result<(), SplatError> {
        let mut value = *self as u64;
        value.visit(codec)?;
        *self = Self::try_from(value).map_err(|_| broken(format!("a number of {value}")))?;
        Ok(())
    }
}

impl State for bool {
    fn visit(&mut self, codec: &mut Codec<'_>) -> Result<(), SplatError> {
        *self = codec.bytes([u8::from(*self)])? != [0];
        Ok(())
    }
}

impl<T: State, const N: usize> State for [T; N] {
    fn visit(&mut self, codec: &mut Codec<'_>) -> Result<(), SplatError> {
        self.iter_mut().try_for_each(|value| value.visit(codec))
    }
}

impl<T: State + Clone + Default> State for Vec<T> {
    fn visit(&mut self, codec: &mut Codec<'_>) -> Result<(), SplatError> {
        // No value has less than a byte.
        let length = codec.length(self.len(), 1)?;
        if let Codec::Read(_) = codec {
            self.clear();
            for _ in 0..length {
                let mut value = T::default();
                value.visit(codec)?;
                self.push(value);
            }
            return Ok(());
        }
        self.iter_mut().try_for_each(|value| value.visit(codec))
    }
}
