//! Why bytes are no recording.

use super::VERSION;
use glisson_protocol::quantized::numbers::TakeError;

/// Why bytes are no recording.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum RecordingError {
    /// It begins with something else.
    #[error("it does not begin with GLSR, so it is no recording")]
    NoRecording,
    /// It was made by another version.
    #[error("it has version {0} of the format; this program reads {VERSION}")]
    Version(u32),
    /// Bytes are missing.
    #[error("it ends too early")]
    Ends,
    /// Bytes that nothing writes.
    #[error("it is broken: {0}")]
    Broken(&'static str),
}

impl From<TakeError> for RecordingError {
    fn from(error: TakeError) -> Self {
        match error {
            TakeError::Ends => Self::Ends,
            TakeError::TooLarge => Self::Broken("a number has more than 32 bits"),
        }
    }
}
