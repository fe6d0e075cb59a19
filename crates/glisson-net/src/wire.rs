//! Numbers in messages: written, read back, and why bytes are no message for us.

use glisson::math::DVec3;
use glisson::tool::MAX_TOOLS;

/// Beyond it no number is taken: metres, newtons and seconds of an operation are far below, stiffnesses (times this) too.
pub(super) const MOST: f64 = 1e6;

/// Version of the messages; another one is refused.
pub(crate) const VERSION: u16 = 2;

/// Why bytes are not a message for us.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub(crate) enum MessageError {
    #[error("{0} bytes are too few or too many for a message")]
    Length(usize),
    #[error("it does not begin like a message of Glisson")]
    Magic,
    #[error(
        "it is of version {0}, this program speaks version {VERSION}: use the same release on both machines"
    )]
    Version(u16),
    #[error("its tag is wrong: damaged on the way, or the two machines do not have the same --link-key")]
    Tag,
    #[error("content {0} is unknown")]
    Kind(u8),
    #[error("{0} instruments: a scene has 1 to {MAX_TOOLS}")]
    Tools(u8),
    #[error("{0} is out of its range or not a number")]
    Number(&'static str),
}

pub(super) fn put(bytes: &mut Vec<u8>, numbers: &[f64]) {
    bytes.extend(numbers.iter().flat_map(|x| x.to_le_bytes()));
}

/// Takes from the front; None where too little is left.
pub(super) struct Reader<'a>(pub(super) &'a [u8]);

impl Reader<'_> {
    pub(super) fn take<const N: usize>(&mut self) -> Option<[u8; N]> {
        let (taken, rest) = self.0.split_first_chunk()?;
        self.0 = rest;
        Some(*taken)
    }

    pub(super) fn u64(&mut self) -> Option<u64> {
        self.take().map(u64::from_le_bytes)
    }

    pub(super) fn f64(&mut self) -> Option<f64> {
        self.take().map(f64::from_le_bytes)
    }

    pub(super) fn vector(&mut self) -> Option<DVec3> {
        Some(DVec3::new(self.f64()?, self.f64()?, self.f64()?))
    }
}
