//! Every claim and every speed.
//!
//! ```text
//! bench: a case a part or a scene -> times, beside the machine's peaks -> JSON
//! validate: an experiment a claim -> expected and obtained -> docs/validation
//! ```
//!
//! The modules stand in data-flow order; a module uses only modules above it (`xtask/tests/layering.rs`).

pub mod scratch;
mod scripted;
mod bodies;
pub mod bed;
pub mod bench;
pub mod validate;
