//! Base64 (RFC 4648), also as VTK uses it: several encoded strings one behind the other, each with its own
//! padding, and blanks anywhere.

/// Decodes from the front, as much as is asked for.
pub(crate) struct Base64Reader<'a> {
    encoded: &'a [u8],
    /// Decoded bytes not handed out yet.
    pending: [u8; 3],
    n_pending: usize,
}

impl<'a> Base64Reader<'a> {
    pub(crate) fn new(encoded: &'a [u8]) -> Self {
        Self { encoded, pending: [0; 3], n_pending: 0 }
    }

    /// Most bytes that can still come out.
    pub(crate) fn most_left(&self) -> usize {
        self.encoded.len() / 4 * 3 + 3 + self.n_pending
    }

    /// The next `n` bytes; none if the text ends before, or is no base64.
    pub(crate) fn read(&mut self, n: usize) -> Option<Vec<u8>> {
        if n > self.most_left() {
            return None;
        }
        let mut bytes = Vec::with_capacity(n);
        while bytes.len() < n {
            if self.n_pending == 0 {
                self.read_group()?;
            }
            let wanted = self.n_pending.min(n - bytes.len());
            bytes.extend_from_slice(&self.pending[..wanted]);
            self.pending.copy_within(wanted.., 0);
            self.n_pending -= wanted;
        }
        Some(bytes)
    }

    /// Decodes the next four characters.
    fn read_group(&mut self) -> Option<()> {
        let mut bits = 0u32;
        let (mut n_digits, mut n_padding) = (0, 0);
        while n_digits + n_padding < 4 {
            let (&character, rest) = self.encoded.split_first()?;
            self.encoded = rest;
            let digit = match character {
                b'A'..=b'Z' => character - b'A',
                b'a'..=b'z' => character - b'a' + 26,
                b'0'..=b'9' => character - b'0' + 52,
                b'+' => 62,
                b'/' => 63,
                b'=' => {
                    n_padding += 1;
                    bits <<= 6;
                    continue;
                }
                c if c.is_ascii_whitespace() => continue,
                _ => return None,
            };
            if n_padding > 0 {
                return None;
            }
            n_digits += 1;
            bits = bits << 6 | u32::from(digit);
        }
        if n_digits < 2 {
            return None;
        }
        let [_, a, b, c] = bits.to_be_bytes();
        self.pending = [a, b, c];
        self.n_pending = n_digits - 1;
        Some(())
    }
}

/// The bytes of one encoded string; none if it is no base64.
pub fn decode(text: &str) -> Option<Vec<u8>> {
    let n_digits = text.bytes().filter(|c| !c.is_ascii_whitespace() && *c != b'=').count();
    Base64Reader::new(text.as_bytes()).read(n_digits * 3 / 4)
}

/// `bytes` as base64 with padding.
pub fn encode(bytes: &[u8]) -> String {
    const DIGITS: &[u8; 64] = b"ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
    let mut text = String::with_capacity(bytes.len().div_ceil(3) * 4);
    for group in bytes.chunks(3) {
        let at = |i: usize| u32::from(group.get(i).copied().unwrap_or(0));
        let bits = at(0) << 16 | at(1) << 8 | at(2);
        for i in 0..4 {
            let digit = DIGITS[(bits >> (18 - 6 * i) & 63) as usize];
            text.push(if i <= group.len() { char::from(digit) } else { '=' });
        }
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn vectors_of_rfc_4648() {
        let cases =
            [("f", "Zg=="), ("fo", "Zm8="), ("foo", "Zm9v"), ("foob", "Zm9vYg=="), ("foobar", "Zm9vYmFy")];
        for (plain, coded) in cases {
            assert_eq!(encode(plain.as_bytes()), coded);
            assert_eq!(decode(coded).unwrap(), plain.as_bytes());
            let mut reader = Base64Reader::new(coded.as_bytes());
            assert_eq!(reader.read(plain.len()).unwrap(), plain.as_bytes());
            assert_eq!(reader.read(1), None);
        }
        // Two strings one behind the other, read across their border.
        assert_eq!(Base64Reader::new(b" Zg==\n Zm9v").read(4).unwrap(), b"ffoo");
        for bad in ["Zm9", "Z===", "Zm=v", "Zm9*"] {
            assert_eq!(Base64Reader::new(bad.as_bytes()).read(2), None, "{bad}");
        }
        assert_eq!(Base64Reader::new(b"Zg==").read(usize::MAX), None);
    }
}
