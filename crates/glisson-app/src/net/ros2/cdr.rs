//! CDR, little endian (OMG's Common Data Representation in its first version, as DDS and ROS 2 use it): every number is
//! aligned to its size, counted from behind the encapsulation header of 4 bytes.

/// Kind of encapsulation: CDR, little endian.
const ENCAPSULATION: [u8; 4] = [0, 1, 0, 0];

/// Writes one message.
#[derive(Debug)]
pub(super) struct CdrWriter(Vec<u8>);

impl CdrWriter {
    /// With room for `n_bytes`.
    pub(super) fn with_capacity(n_bytes: usize) -> Self {
        let mut bytes = Vec::with_capacity(ENCAPSULATION.len() + n_bytes);
        bytes.extend(ENCAPSULATION);
        Self(bytes)
    }

    fn align(&mut self, size: usize) {
        let used = self.0.len() - ENCAPSULATION.len();
        self.0.resize(self.0.len() + used.next_multiple_of(size) - used, 0);
    }

    pub(super) fn u8(&mut self, number: u8) {
        self.0.push(number);
    }

    pub(super) fn u32(&mut self, number: u32) {
        self.align(4);
        self.0.extend(number.to_le_bytes());
    }

    pub(super) fn i32(&mut self, number: i32) {
        self.align(4);
        self.0.extend(number.to_le_bytes());
    }

    pub(super) fn f64s(&mut self, numbers: &[f64]) {
        for number in numbers {
            self.align(8);
            self.0.extend(number.to_le_bytes());
        }
    }

    /// Its length with the zero at its end, its bytes, the zero.
    pub(super) fn string(&mut self, text: &str) {
        self.u32(text.len() as u32 + 1);
        self.0.extend(text.as_bytes());
        self.0.push(0);
    }

    /// A sequence of numbers: how many, then they; an empty one has no padding behind its length.
    pub(super) fn f64_sequence(&mut self, numbers: &[f64]) {
        self.u32(numbers.len() as u32);
        self.f64s(numbers);
    }

    pub(super) fn byte_sequence(&mut self, bytes: impl ExactSizeIterator<Item = [u8; 12]>) {
        self.u32(12 * bytes.len() as u32);
        bytes.for_each(|piece| self.0.extend(piece));
    }

    pub(super) fn finish(self) -> Vec<u8> {
        self.0
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_are_aligned_to_their_size_behind_the_encapsulation() {
        let mut writer = CdrWriter::with_capacity(0);
        writer.u8(7);
        writer.u32(1);
        writer.f64_sequence(&[]);
        writer.string("ab");
        writer.f64_sequence(&[1.0]);
        let expected = [
            &[0, 1, 0, 0][..], // little endian
            &[7, 0, 0, 0],     // and padding to 4
            &[1, 0, 0, 0],
            &[0, 0, 0, 0],                   // an empty sequence
            &[3, 0, 0, 0, b'a', b'b', 0, 0], // and padding to 4
            &[1, 0, 0, 0],
            // 24 bytes: aligned to 8 already
            &[0, 0, 0, 0, 0, 0, 0xF0, 0x3F],
        ];
        assert_eq!(writer.finish(), expected.concat());
    }
}
