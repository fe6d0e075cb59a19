//! Numbers in the binary data of files.

use crate::math::DVec3;
use crate::scan::FormatError;
use crate::units::LengthUnit;

/// Kinds of number in binary data.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum NumberType {
    I8,
    U8,
    I16,
    U16,
    I32,
    U32,
    I64,
    U64,
    F32,
    F64,
}

/// Byte order of binary data.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum ByteOrder {
    Little,
    Big,
}

impl NumberType {
    /// Bytes of one number.
    pub(crate) fn n_bytes(self) -> usize {
        match self {
            Self::I8 | Self::U8 => 1,
            Self::I16 | Self::U16 => 2,
            Self::I32 | Self::U32 | Self::F32 => 4,
            Self::I64 | Self::U64 | Self::F64 => 8,
        }
    }

    pub(crate) fn is_integer(self) -> bool {
        !matches!(self, Self::F32 | Self::F64)
    }

    /// Up to eight bytes as the bits of an unsigned number.
    fn bits(bytes: &[u8], order: ByteOrder) -> u64 {
        let join = |sum: u64, &byte: &u8| sum << 8 | u64::from(byte);
        match order {
            ByteOrder::Big => bytes.iter().fold(0, join),
            ByteOrder::Little => bytes.iter().rev().fold(0, join),
        }
    }

    /// One number as a float.
    pub(crate) fn float(self, bytes: &[u8], order: ByteOrder) -> f64 {
        let bits = Self::bits(bytes, order);
        match self {
            Self::F32 => f64::from(f32::from_bits(bits as u32)),
            Self::F64 => f64::from_bits(bits),
            Self::U64 => bits as f64,
            _ => self.integer(bytes, order).map_or(f64::NAN, |i| i as f64),
        }
    }

    /// One number as an integer; none for floats and above `i64::MAX`.
    pub(crate) fn integer(self, bytes: &[u8], order: ByteOrder) -> Option<i64> {
        let bits = Self::bits(bytes, order);
        match self {
            Self::I8 => Some(i64::from(bits as i8)),
            Self::I16 => Some(i64::from(bits as i16)),
            Self::I32 => Some(i64::from(bits as i32)),
            Self::I64 => Some(bits as i64),
            Self::U8 | Self::U16 | Self::U32 | Self::U64 => i64::try_from(bits).ok(),
            Self::F32 | Self::F64 => None,
        }
    }
}

/// Positions [m] from binary coordinates, three a point.
pub(crate) fn positions_from_bytes(
    data: &[u8],
    kind: NumberType,
    order: ByteOrder,
    unit: LengthUnit,
) -> Result<Vec<DVec3>, FormatError> {
    let size = kind.n_bytes();
    let mut positions_m = Vec::with_capacity(data.len() / (3 * size));
    for (p, point) in data.chunks_exact(3 * size).enumerate() {
        let [x, y, z] =
            [0, 1, 2].map(|i| unit.to_metres(kind.float(&point[i * size..(i + 1) * size], order)));
        let position_m = DVec3::new(x, y, z);
        if !position_m.is_finite() {
            return Err(FormatError::named(
                format!("point {p}"),
                format!("({x}, {y}, {z})"),
                "finite coordinates",
            ));
        }
        positions_m.push(position_m);
    }
    Ok(positions_m)
}

/// Integers from binary data.
pub(crate) fn integers_from_bytes(
    data: &[u8],
    kind: NumberType,
    order: ByteOrder,
    what: &str,
) -> Result<Vec<i64>, FormatError> {
    data.chunks_exact(kind.n_bytes())
        .enumerate()
        .map(|(i, bytes)| {
            kind.integer(bytes, order).ok_or_else(|| {
                FormatError::named(
                    format!("entry {i} of {what}"),
                    format!("{kind:?} data"),
                    "integers below 2^63",
                )
            })
        })
        .collect()
}
