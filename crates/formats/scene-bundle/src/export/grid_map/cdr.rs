//! Common Data Representation, little-endian, as ROS 2 encodes messages (OMG: DDS-XTypes 1.3,
//! section 7.4.3, XCDR version 1).

/// Bytes before the data: plain CDR, little-endian, no options.
const ENCAPSULATION: [u8; 4] = [0, 1, 0, 0];

/// Writes the fields of a message in order, each aligned to its size.
pub(super) struct CdrWriter(Vec<u8>);

impl CdrWriter {
    pub(super) fn new() -> Self {
        Self(ENCAPSULATION.to_vec())
    }

    /// Alignment counts from the end of the encapsulation.
    fn align(&mut self, size: usize) {
        let length = self.0.len() - ENCAPSULATION.len();
        let aligned = length.next_multiple_of(size) + ENCAPSULATION.len();
        self.0.resize(aligned, 0);
    }

    pub(super) fn u16(&mut self, value: u16) {
        self.align(2);
        self.0.extend(value.to_le_bytes());
    }

    pub(super) fn i32(&mut self, value: i32) {
        self.align(4);
        self.0.extend(value.to_le_bytes());
    }

    pub(super) fn u32(&mut self, value: u32) {
        self.align(4);
        self.0.extend(value.to_le_bytes());
    }

    pub(super) fn f32(&mut self, value: f32) {
        self.align(4);
        self.0.extend(value.to_le_bytes());
    }

    pub(super) fn f64(&mut self, values: &[f64]) {
        for value in values {
            self.align(8);
            self.0.extend(value.to_le_bytes());
        }
    }

    /// A text, with the byte 0 that ends it.
    pub(super) fn string(&mut self, text: &str) {
        self.u32(text.len() as u32 + 1);
        self.0.extend(text.as_bytes());
        self.0.push(0);
    }

    pub(super) fn finish(self) -> Vec<u8> {
        self.0
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn fields_are_aligned_to_their_size() {
        let mut cdr = CdrWriter::new();
        cdr.string("ab");
        cdr.f64(&[1.0]);
        cdr.u16(7);
        cdr.u32(9);
        let bytes = cdr.finish();
        assert_eq!(bytes[..11], [0, 1, 0, 0, 3, 0, 0, 0, b'a', b'b', 0]);
        // One byte of padding to 8 behind the encapsulation.
        assert_eq!(bytes[11], 0);
        assert_eq!(bytes[12..20], 1.0_f64.to_le_bytes());
        assert_eq!(bytes[20..], [7, 0, 0, 0, 9, 0, 0, 0]);
    }
}
