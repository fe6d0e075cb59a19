//! Pictures without a GPU, plots, and the page: the viewer and its server.
//!
//! ```text
//! snapshot -> picture (software rasterizer) -> PNG;  numbers -> plot -> SVG
//! session, step by step -> picture -> film -> MP4 (by ffmpeg)
//! Published (glisson_runtime) -> server: frames, messages -> WebSocket -> page (web/dist, embedded)
//! page -> commands -> control (one controls, all may watch) -> Simulation
//! positions -> quantized -> frames of the server and of recordings
//! TaskRecord (glisson::training) -> report -> HTML
//! session -> recording -> HTML that plays without a server
//! image -> patient (its own page) -> scene -> Simulation
//! tasks, scene files -> start (its own page) -> Simulation
//! ```
//!
//! The modules stand in data-flow order; a module uses only modules above it (`xtask/tests/layering.rs`).

pub mod plot;
pub mod picture;
pub mod film;
pub mod report;
mod quantized;
pub mod server;
pub mod recording;
mod job;
pub mod patient;
pub mod start;
