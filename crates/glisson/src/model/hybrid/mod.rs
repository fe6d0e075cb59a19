//! Hybrid models: one mesh, several zones, each with its own law (seed `003` ch. 4).

pub mod condensed;
