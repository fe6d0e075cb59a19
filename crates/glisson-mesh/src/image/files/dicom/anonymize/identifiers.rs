//! Identifiers of copies, out of those of the original.

/// New identifiers for old ones.
#[derive(Clone, Debug)]
pub(super) struct NewIdentifiers {
    key: [u8; 32],
}

impl NewIdentifiers {
    pub(super) fn with_key(key: [u8; 32]) -> Self {
        Self { key }
    }

    /// The new one for an old one: equal for equal ones.
    pub(super) fn of(&self, old: &str) -> String {
        let hash = blake3::keyed_hash(&self.key, old.as_bytes());
        let mut bytes = [0; 16];
        bytes.copy_from_slice(&hash.as_bytes()[..16]);
        // A UUID of version 8, as identifiers under 2.25 have to be (DICOM PS3.5, B.2; RFC 9562, 5.8).
        bytes[6] = bytes[6] & 0x0f | 0x80;
        bytes[8] = bytes[8] & 0x3f | 0x80;
        format!("2.25.{}", u128::from_be_bytes(bytes))
    }
}
