//! Whole numbers in as few bytes as they need: seven bits to a byte, the lowest first (LEB128); signed ones as 0, -1, 1, -2, ...

/// Why bytes are not what was put there.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum TakeError {
    /// Bytes are missing.
    Ends,
    /// A number has more than 32 bits.
    TooLarge,
}

/// Appends `x`.
pub fn put(out: &mut Vec<u8>, mut x: u32) {
    while x >= 0x80 {
        out.push(x as u8 | 0x80);
        x >>= 7;
    }
    out.push(x as u8);
}

/// Appends `x`, small sizes short.
pub fn put_signed(out: &mut Vec<u8>, x: i32) {
    put(out, ((x << 1) ^ (x >> 31)) as u32);
}

/// Takes from the front of bytes that may be anything.
pub struct Taker<'a>(pub &'a [u8]);

impl<'a> Taker<'a> {
    /// The next `n` bytes.
    pub fn bytes(&mut self, n: usize) -> Result<&'a [u8], TakeError> {
        let (taken, rest) = self.0.split_at_checked(n).ok_or(TakeError::Ends)?;
        self.0 = rest;
        Ok(taken)
    }

    /// The next byte.
    pub fn byte(&mut self) -> Result<u8, TakeError> {
        self.bytes(1).map(|bytes| bytes[0])
    }

    /// What [`put`] wrote.
    pub fn number(&mut self) -> Result<u32, TakeError> {
        let mut x = 0;
        for shift in [0, 7, 14, 21, 28] {
            let byte = self.byte()?;
            let bits = u32::from(byte & 0x7f);
            if shift == 28 && bits > 0xf {
                break;
            }
            x |= bits << shift;
            if byte & 0x80 == 0 {
                return Ok(x);
            }
        }
        Err(TakeError::TooLarge)
    }

    /// What [`put_signed`] wrote.
    pub fn signed(&mut self) -> Result<i32, TakeError> {
        self.number().map(|x| (x >> 1) as i32 ^ -((x & 1) as i32))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_come_back_and_broken_ones_are_refused() {
        let all = [0, 1, -1, 63, 64, -65, 8191, -8193, i32::MAX, i32::MIN];
        let mut bytes = Vec::new();
        all.iter().for_each(|&x| put_signed(&mut bytes, x));
        let mut taker = Taker(&bytes);
        assert_eq!(all.map(|_| taker.signed().unwrap()), all);
        assert!(taker.0.is_empty() && taker.byte().is_err());
        assert!(Taker(&[0x80]).number().is_err());
        assert!(Taker(&[0xff, 0xff, 0xff, 0xff, 0x1f]).number().is_err());
        assert_eq!(Taker(&[0xff, 0xff, 0xff, 0xff, 0x0f]).number().unwrap(), u32::MAX);
    }
}
