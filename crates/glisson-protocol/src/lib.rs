//! What a page and a simulation say to each other (`docs/protocol.md`), whatever carries it: a WebSocket of the server, or the Worker of
//! a page that has its simulation in itself.
//!
//! ```text
//! Published (glisson_runtime) -> frames, messages -> Conversation -> page
//! page -> Conversation -> Command -> control (one controls, all may watch) -> Simulation
//! ```
//!
//! The modules stand in data-flow order; a module uses only modules above it (`xtask/tests/layering.rs`).

pub mod quantized;
pub mod inside;
pub mod positions;
pub mod frames;
mod shared_frames;
pub mod class;
pub mod hands;
pub mod messages;
pub mod conversation;
