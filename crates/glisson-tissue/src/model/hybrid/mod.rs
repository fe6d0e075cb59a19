//! Hybrid models: zones of one mesh, each solved by its own method (seed `003` ch. 4).
//!
//! [`exchange`] is the report's own model, in which zones pass forces and positions to each other until they agree.
//! [`condensed`] couples them exactly, by static condensation onto their frontiers; scenes use this one.

pub mod condensed;
pub mod exchange;
mod kirchhoff;
pub(super) mod row;

/// Scene name.
const NAME: &str = "hybrid";
