//! Numbers as little-endian bytes.

use crate::SimulationError;

/// Numbers of states are below this.
const MAX_NUMBER: f64 = 1e9;

pub(super) fn damaged(found: &str) -> SimulationError {
    SimulationError::Snapshot {
        found: found.to_owned(),
        expected: "an undamaged snapshot".to_owned(),
    }
}

#[derive(Default)]
pub(super) struct Writer(Vec<u8>);

impl Writer {
    pub(super) fn bytes(&mut self, bytes: &[u8]) {
        self.0.extend_from_slice(bytes);
    }

    pub(super) fn u8(&mut self, value: u8) {
        self.0.push(value);
    }

    pub(super) fn u32(&mut self, value: u32) {
        self.bytes(&value.to_le_bytes());
    }

    pub(super) fn u64(&mut self, value: u64) {
        self.bytes(&value.to_le_bytes());
    }

    pub(super) fn f64(&mut self, value: f64) {
        self.bytes(&value.to_le_bytes());
    }

    pub(super) fn into_bytes(self) -> Vec<u8> {
        self.0
    }
}

pub(super) struct Reader<'a>(&'a [u8]);

impl<'a> Reader<'a> {
    pub(super) fn new(bytes: &'a [u8]) -> Self {
        Self(bytes)
    }

    pub(super) fn bytes(&mut self, count: usize) -> Result<&'a [u8], SimulationError> {
        let early_end = || damaged("an early end");
        let (head, tail) = self.0.split_at_checked(count).ok_or_else(early_end)?;
        self.0 = tail;
        Ok(head)
    }

    fn array<const N: usize>(&mut self) -> Result<[u8; N], SimulationError> {
        let mut array = [0; N];
        array.copy_from_slice(self.bytes(N)?);
        Ok(array)
    }

    pub(super) fn u8(&mut self) -> Result<u8, SimulationError> {
        self.array().map(|[byte]| byte)
    }

    pub(super) fn u32(&mut self) -> Result<u32, SimulationError> {
        self.array().map(u32::from_le_bytes)
    }

    pub(super) fn u64(&mut self) -> Result<u64, SimulationError> {
        self.array().map(u64::from_le_bytes)
    }

    /// A length, angle, rate or duration: finite and not absurd.
    pub(super) fn f64(&mut self) -> Result<f64, SimulationError> {
        let value = self.array().map(f64::from_le_bytes)?;
        match value.abs() < MAX_NUMBER {
            true => Ok(value),
            false => Err(damaged(&format!("the number {value}"))),
        }
    }

    pub(super) fn bool(&mut self) -> Result<bool, SimulationError> {
        match self.u8()? {
            0 => Ok(false),
            1 => Ok(true),
            other => Err(damaged(&format!("the flag {other}"))),
        }
    }

    /// Everything was read.
    pub(super) fn end(&self) -> Result<(), SimulationError> {
        match self.0.len() {
            0 => Ok(()),
            count => Err(damaged(&format!("{count} bytes too many"))),
        }
    }
}
