//! The page that one begins with: tasks, scenes and a new patient to choose from.
//!
//! ```text
//! tasks of the program, scene files in folders -> listing -> page -> choice -> Simulation | a new patient
//! ```
//!
//! What is started is served at the same address, and this page again after it. Only what is listed can be started.

mod listing;
mod making;
mod api;

pub use api::{StartPage, serve};
pub use making::{Choice, Chosen, OpenChoice};

#[cfg(test)]
mod tests;
