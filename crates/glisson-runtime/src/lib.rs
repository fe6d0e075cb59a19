//! Time, threads, recording, the haptic loop.
//!
//! ```text
//! scene -> Simulation (world + recorder) -> live: steps in real time -> Published -> whoever shows it
//!                 ^ commands (steering)          ^ motions   v models
//!                                            haptic_loop <-> OpenDevice (devices/: one file a device)
//! ```
//!
//! The loop knows no device and no wire: devices implement `glisson::haptics::HapticDevice`, other machines (`glisson-net`)
//! hold the far ends of the same exchanges. The modules stand in data-flow order; a module uses only modules above it
//! (`xtask/tests/layering.rs`).

mod background;
pub mod exchange;
pub mod histogram;
pub mod workers;
pub mod realtime;
mod effort;
pub mod pace;
pub mod account;
pub mod recorder;
mod incidents;
pub mod script;
pub mod simulation;
pub mod replay;
pub mod cut_off;
pub mod elsewhere;
pub mod force_choices;
pub mod page_hand;
pub mod open_device;
pub mod haptic_loop;
pub mod remote_figures;
pub mod inside;
pub mod watchers;
pub mod published;
pub mod display;
pub mod shown;
pub mod live;
pub mod passive;
pub mod control;
pub mod steering;
#[cfg(not(target_family = "wasm"))]
pub mod devices;
pub mod tasks;

pub use incidents::Notice;
pub use simulation::{Broken, OpenScene, ParameterState, Parameters, Simulation, Turn};
