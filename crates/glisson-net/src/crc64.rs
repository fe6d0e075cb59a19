//! CRC-64 of ECMA-182 (polynomial 0x42F0E1EBA9EA3693, most significant bit first, start 0), as OpenIGTLink uses it.

const POLYNOMIAL: u64 = 0x42F0_E1EB_A9EA_3693;

/// What the CRC of a byte adds, for each value of the byte.
const TABLE: [u64; 256] = {
    let mut table = [0; 256];
    let mut byte = 0;
    while byte < 256 {
        let mut crc = (byte as u64) << 56;
        let mut bit = 0;
        while bit < 8 {
            crc = if crc >> 63 == 1 { (crc << 1) ^ POLYNOMIAL } else { crc << 1 };
            bit += 1;
        }
        table[byte] = crc;
        byte += 1;
    }
    table
};

/// CRC-64 of `bytes`.
pub(crate) fn crc64(bytes: &[u8]) -> u64 {
    bytes.iter().fold(0, |crc, &byte| (crc << 8) ^ TABLE[usize::from((crc >> 56) as u8 ^ byte)])
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Bit by bit: the definition.
    fn plain(bytes: &[u8]) -> u64 {
        let mut crc = 0_u64;
        for &byte in bytes {
            for bit in (0..8).rev() {
                let carry = (crc >> 63) ^ u64::from(byte >> bit & 1);
                crc = (crc << 1) ^ if carry == 1 { POLYNOMIAL } else { 0 };
            }
        }
        crc
    }

    #[test]
    fn the_check_value_and_the_definition_agree() {
        // The check value that catalogues of CRCs give for CRC-64/ECMA-182.
        assert_eq!(crc64(b"123456789"), 0x6C40_DF5F_0B49_7347);
        let bytes: Vec<u8> = (0..300_u32).map(|i| (i * 7 + i / 11) as u8).collect();
        for n in [0, 1, 2, 57, 300] {
            assert_eq!(crc64(&bytes[..n]), plain(&bytes[..n]), "{n} bytes");
        }
    }
}
