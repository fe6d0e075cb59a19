//! What the database is opened with.

/// Version of the tables; stands in the file (`PRAGMA user_version`).
pub(crate) const SCHEMA_VERSION: i64 = 1;

/// Tells the file from other programs' databases (`PRAGMA application_id`): "GLRS".
pub(crate) const APPLICATION_ID: i64 = 0x474C_5253;

/// How long somebody else may write before that is an error [s]: writing a result takes some milliseconds.
pub(crate) const BUSY_S: u64 = 10;
