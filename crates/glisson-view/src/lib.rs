//! Films and the pages: the viewer and its server.
//!
//! ```text
//! session, step by step -> pictures (glisson_picture) -> film -> MP4 (by ffmpeg)
//! Published (glisson_runtime) -> server: frames, messages (glisson_protocol) -> WebSocket -> page (web/dist, embedded)
//! page -> commands -> Simulation
//! scene, files -> local_page -> HTML that simulates without a server
//! session -> recording -> HTML that plays without a server
//! image -> patient (its own page; steps of glisson_patient) -> scene -> Simulation
//! tasks, scene files -> start (its own page) -> Simulation
//! ```
//!
//! The modules stand in data-flow order; a module uses only modules above it (`xtask/tests/layering.rs`).

pub mod film;
pub mod server;
pub mod local_page;
pub mod recording;
mod job;
pub mod patient;
pub mod start;
