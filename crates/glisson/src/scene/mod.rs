//! Scene files: text -> [`Scene`] -> [`crate::world::World`].
//!
//! A scene is a TOML file in which every quantity names its unit. Unknown keys and units are refused with the
//! line, what was found, what is allowed, and what was probably meant.

pub mod reader;
pub mod spec;

pub use reader::SceneError;
pub use spec::{MaterialSource, OrganSource, PathPoint, Scene};
