//! Who did which task when, and how well: a store of results, and where a result lies among others.
//!
//! ```text
//! TaskResult -> Attempt -> Store (a SQLite file) -> statistics: quartiles, learning curves -> compare -> whoever shows it
//!                                                -> export: CSV, JSON
//! ```
//!
//! There is no reference group but the ones that users make: nobody was measured for this program. Nothing here reads a
//! clock; dates come from the caller.

pub mod utc;
pub mod name;
pub mod attempt;
pub mod statistics;
mod settings;
pub mod error;
mod schema;
pub mod store;
mod groups;
pub mod compare;
pub mod export;

pub use attempt::{Attempt, AttemptResult, Kept};
pub use compare::Comparison;
pub use error::StoreError;
pub use store::{Added, Filter, Store};
