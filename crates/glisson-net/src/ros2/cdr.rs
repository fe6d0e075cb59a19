//! CDR, little endian (OMG's Common Data Representation in its first version, as DDS and ROS 2 use it): every number is
//! aligned to its size, counted from behind the encapsulation header of 4 bytes. Read are both orders of bytes.

/// Kind of encapsulation: CDR, little endian.
const ENCAPSULATION: [u8; 4] = [0, 1, 0, 0];

/// Why bytes are no message.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub(super) enum CdrError {
    #[error("{0} bytes are too few for a message")]
    NoHeader(usize),
    #[error("encapsulation {0:#06x}; known are 0 and 1 (CDR in big and little endian)")]
    Encapsulation(u16),
    #[error("it ends at byte {end}, where {wanted} more are expected from byte {at} on")]
    Short {
        /// From behind the encapsulation header.
        at: usize,
        wanted: usize,
        end: usize,
    },
    #[error("a text at byte {0} is not UTF-8 with a zero at its end")]
    Text(usize),
}

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

/// Reads one message of somebody else: of any content, never beyond its end.
#[derive(Debug)]
pub(super) struct CdrReader<'a> {
    /// Behind the encapsulation header.
    bytes: &'a [u8],
    at: usize,
    is_big_endian: bool,
}

impl<'a> CdrReader<'a> {
    pub(super) fn new(message: &'a [u8]) -> Result<Self, CdrError> {
        let Some((head, bytes)) = message.split_at_checked(ENCAPSULATION.len()) else {
            return Err(CdrError::NoHeader(message.len()));
        };
        let is_big_endian = match [head[0], head[1]] {
            [0, 0] => true,
            [0, 1] => false,
            other => return Err(CdrError::Encapsulation(u16::from_be_bytes(other))),
        };
        Ok(Self { bytes, at: 0, is_big_endian })
    }

    fn take(&mut self, n_bytes: usize) -> Result<&'a [u8], CdrError> {
        let (at, end) = (self.at, self.bytes.len());
        let short = CdrError::Short { at, wanted: n_bytes, end };
        let taken = self.bytes.get(at..).and_then(|rest| rest.get(..n_bytes)).ok_or(short)?;
        self.at = at + n_bytes;
        Ok(taken)
    }

    fn number<const N: usize>(&mut self) -> Result<[u8; N], CdrError> {
        self.at = self.at.next_multiple_of(N);
        let mut bytes = [0; N];
        bytes.copy_from_slice(self.take(N)?);
        if self.is_big_endian {
            bytes.reverse();
        }
        Ok(bytes)
    }

    pub(super) fn u32(&mut self) -> Result<u32, CdrError> {
        self.number().map(u32::from_le_bytes)
    }

    pub(super) fn f64(&mut self) -> Result<f64, CdrError> {
        self.number().map(f64::from_le_bytes)
    }

    pub(super) fn f64s<const N: usize>(&mut self) -> Result<[f64; N], CdrError> {
        let mut numbers = [0.0; N];
        for number in &mut numbers {
            *number = self.f64()?;
        }
        Ok(numbers)
    }

    /// A text. Some write the empty one without its zero.
    pub(super) fn string(&mut self) -> Result<&'a str, CdrError> {
        let n_bytes = self.u32()? as usize;
        let at = self.at;
        let bytes = self.take(n_bytes)?;
        let text = match bytes.split_last() {
            None => bytes,
            Some((0, text)) => text,
            Some(_) => return Err(CdrError::Text(at)),
        };
        std::str::from_utf8(text).map_err(|_| CdrError::Text(at))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_written_is_read_in_both_orders_of_bytes() {
        let mut writer = CdrWriter::with_capacity(0);
        writer.u32(7);
        writer.string("ab");
        writer.f64s(&[1.5, -2.0]);
        writer.string("");
        let bytes = writer.finish();
        let mut reader = CdrReader::new(&bytes).unwrap();
        assert_eq!((reader.u32(), reader.string()), (Ok(7), Ok("ab")));
        assert_eq!((reader.f64s(), reader.string()), (Ok([1.5, -2.0]), Ok("")));
        assert_eq!(reader.u32(), Err(CdrError::Short { at: 40, wanted: 4, end: 37 }));
        let big = [&[0, 0, 0, 0][..], &[0, 0, 0, 7], &[0; 4], &1.5_f64.to_be_bytes()].concat();
        let mut reader = CdrReader::new(&big).unwrap();
        assert_eq!((reader.u32(), reader.f64()), (Ok(7), Ok(1.5)));
    }

    #[test]
    fn what_is_no_message_is_told_why() {
        assert_eq!(CdrReader::new(&[0, 1]).err(), Some(CdrError::NoHeader(2)));
        // XCDR2, which ROS 2 does not use here.
        assert_eq!(CdrReader::new(&[0, 7, 0, 0]).err(), Some(CdrError::Encapsulation(7)));
        let text = |bytes: &[u8]| {
            let message = [&ENCAPSULATION[..], bytes].concat();
            CdrReader::new(&message).unwrap().string().map(str::to_owned)
        };
        assert_eq!(text(&[2, 0, 0, 0, b'a', b'b']), Err(CdrError::Text(4)));
        assert_eq!(text(&[2, 0, 0, 0, 0xFF, 0]), Err(CdrError::Text(4)));
        assert_eq!(
            text(&[255, 255, 255, 255, b'a']),
            Err(CdrError::Short { at: 4, wanted: u32::MAX as usize, end: 5 })
        );
        assert_eq!(text(&[0; 4]), Ok(String::new()));
    }

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
