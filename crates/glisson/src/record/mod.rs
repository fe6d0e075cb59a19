//! Snapshots, sessions and replay.
