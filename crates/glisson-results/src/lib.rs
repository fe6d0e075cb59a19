//! Who did which task when, and how well: a store of results, and where a result lies among others.
//!
//! ```text
//! TaskResult -> Attempt -> Store (a SQLite file) -> statistics: quartiles, learning curves -> compare -> whoever shows it
//!                                                -> export: CSV, JSON
//! ```
//!
//! The store is behind the feature `store`; without it the rest needs no SQLite.
//!
//! There is no reference group but the ones that users make: nobody was measured for this program. Nothing here reads a
//! clock; dates come from the caller.

pub mod utc;
pub mod name;
pub mod attempt;
pub mod statistics;
pub mod comparison;
#[cfg(feature = "store")]
mod settings;
#[cfg(feature = "store")]
pub mod error;
#[cfg(feature = "store")]
mod schema;
#[cfg(feature = "store")]
pub mod store;
#[cfg(feature = "store")]
mod groups;
#[cfg(feature = "store")]
pub mod compare;
#[cfg(feature = "store")]
pub mod export;

pub use attempt::{Attempt, AttemptResult, Kept};
pub use comparison::Comparison;
#[cfg(feature = "store")]
pub use error::StoreError;
#[cfg(feature = "store")]
pub use store::{Added, Filter, Store};
