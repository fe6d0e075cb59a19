//! The parts of `glisson demo`: the scene it writes, the scripted operation, the report.

pub(crate) mod bed;
mod clips;
pub(crate) mod operation;
pub(crate) mod patient;
mod plan;
pub(crate) mod report;
pub(crate) mod resection;
pub(crate) mod scenery;
mod script;
mod specimen;
