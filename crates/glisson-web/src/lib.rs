//! The simulation in a page: what its Worker (`web/src/local/worker.ts`) calls, built for WebAssembly by `cargo xtask web`.
//!
//! ```text
//! scene and its files (in the Worker's memory) -> LocalPage: Simulation, Turns
//! page -> Conversation -> Command -> Turns -> Published -> Conversation -> page
//! files of an image -> NewPatient -> scene and its files, for another Worker
//! ```
//!
//! The page says and hears what it would of a server (`docs/protocol.md`): one viewer, who controls.

mod local_page;
mod new_patient;
mod progress;
pub mod calls;

pub use local_page::LocalPage;
pub use new_patient::NewPatient;
