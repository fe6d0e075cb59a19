//! OpenIGTLink: tools as TRANSFORM and the organ's surface as POLYDATA for 3D Slicer and others (`docs/network.md`).

pub(crate) mod frame;
pub(crate) mod messages;
mod client;
mod server;

pub(crate) use client::Described;
pub(crate) use messages::Axes;
pub(crate) use server::{bind, spawn};
#[cfg(test)]
pub(crate) mod tests;
