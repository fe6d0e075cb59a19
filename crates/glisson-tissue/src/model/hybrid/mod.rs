//! Hybrid models: zones of one mesh with different ways of solving (seed `003` ch. 4).
//!
//! [`exchange`] is the report's own model, in which zones pass forces and positions to each other until they agree.
//! [`condensed`] couples them exactly, by condensation onto their frontiers; it is the one that scenes use.

pub mod condensed;
pub mod exchange;
mod kirchhoff;
