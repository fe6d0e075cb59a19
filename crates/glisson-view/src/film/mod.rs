//! A recorded session as a film.
//!
//! ```text
//! Simulation, step by step -> frames: how many are due -> view: picture -> encoder (ffmpeg) -> MP4
//! ```
//!
//! The same session gives the same pictures. The film is encoded by a program that the user has; none is part of ours.

pub mod frames;
pub mod view;
pub mod encoder;
