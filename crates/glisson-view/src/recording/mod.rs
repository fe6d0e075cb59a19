//! A recorded session as one file that plays without a server: what is displayed, in the format "GLSR" (`docs/replay.md`).
//!
//! ```text
//! hello, snapshots, topologies -> write -> bytes -> page -> HTML;  bytes -> read -> the frames of docs/protocol.md
//! ```
//!
//! Positions are whole numbers of a step, as differences from the frame before, then deflated; all else of a frame keeps its bits, but for
//! contact points, of which the greatest are kept, rounded.
//!
//! For other programs: `series` (ParaView, PyVista, meshio) and `usd`.

pub mod error;
mod surface;
pub mod write;
pub mod read;
pub mod page;
pub mod series;
pub mod usd;

/// The first bytes of a recording.
pub const MAGIC: &[u8; 4] = b"GLSR";
/// Of the format.
pub const VERSION: u32 = 1;
/// Frames that are packed together at most: what has to be unpacked to jump to one. A choice: two seconds of 30 frames a second.
pub const FRAMES_OF_BLOCK: usize = 60;
/// What a block may have unpacked [bytes]: a choice, ten times what 60 frames of 100,000 vertices need.
pub const MOST_UNPACKED: usize = 1 << 28;
/// A block that has so much ends early [bytes]: what is far from what a reader allows, also with one frame more.
const ENOUGH_IN_BLOCK: usize = MOST_UNPACKED / 8;

#[cfg(test)]
mod tests;
