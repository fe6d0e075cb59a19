//! A surgical thread by itself: how it stretches, bends, moves, is held, and meets itself. The world lets it pass through tissue, and
//! instruments hold it (`world/sutures`).

mod banded;
pub mod material;
mod meeting;
mod rod;
mod solver;
mod tie;

pub use meeting::{Bond, nearest_to_itself_m};
pub use rod::{Rod, RodMaterial, RodPlace};
pub use solver::{Solver, Surroundings};
pub use tie::{Tie, TieLaw};
