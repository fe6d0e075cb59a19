//! The tag at the end of a message: a check against damage, or with a key proof that the sender has it too.

use super::crc64::crc64;
use anyhow::{Context, ensure};
use std::path::Path;

/// Bytes of a tag.
pub(crate) const TAG_BYTES: usize = 16;
/// Least bytes of a key file: what cannot be guessed.
const LEAST_KEY_BYTES: usize = 16;

/// How messages are tagged.
#[derive(Clone)]
pub enum Seal {
    /// CRC-64: finds damage, keeps nobody out.
    Check,
    /// BLAKE3 with a key: only who has the key can write messages. It hides nothing.
    Key(Box<[u8; 32]>),
}

impl Seal {
    /// With the key that a file's content makes.
    pub(crate) fn from_file(path: &Path) -> anyhow::Result<Self> {
        let content =
            std::fs::read(path).with_context(|| format!("{}: cannot read the key", path.display()))?;
        ensure!(
            content.len() >= LEAST_KEY_BYTES,
            "{}: a key of {} bytes can be guessed; at least {LEAST_KEY_BYTES} random ones, for example: \
             head -c 32 /dev/urandom > {}",
            path.display(),
            content.len(),
            path.display()
        );
        Ok(Self::Key(Box::new(blake3::derive_key("glisson link 1", &content))))
    }

    /// Whether only who has a key can write messages.
    pub(crate) fn has_key(&self) -> bool {
        matches!(self, Self::Key(_))
    }

    /// The tag of `bytes`.
    pub(crate) fn tag(&self, bytes: &[u8]) -> [u8; TAG_BYTES] {
        let mut tag = [0; TAG_BYTES];
        match self {
            Self::Check => tag[..8].copy_from_slice(&crc64(bytes).to_le_bytes()),
            Self::Key(key) => tag.copy_from_slice(&blake3::keyed_hash(key, bytes).as_bytes()[..TAG_BYTES]),
        }
        tag
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_key_is_long_enough_and_makes_its_own_tags() {
        let folder = tempfile::tempdir().unwrap();
        let file = |name: &str, content: &[u8]| {
            let path = folder.path().join(name);
            std::fs::write(&path, content).unwrap();
            path
        };
        let seal = |name, content| Seal::from_file(&file(name, content)).unwrap();
        let (one, two) = (seal("one", b"0123456789abcdef"), seal("two", b"0123456789abcdeg"));
        assert_eq!(one.tag(b"message"), one.clone().tag(b"message"));
        assert_ne!(one.tag(b"message"), two.tag(b"message"));
        assert_ne!(one.tag(b"message"), one.tag(b"massage"));
        assert_ne!(one.tag(b"message"), Seal::Check.tag(b"message"));
        let error = Seal::from_file(&file("short", b"secret\n")).err().unwrap().to_string();
        assert!(error.contains("7 bytes") && error.contains("/dev/urandom"), "{error}");
    }
}
