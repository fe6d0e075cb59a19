//! Scene files: text -> [`Scene`] -> [`crate::world::World`].
//!
//! A scene is a TOML file in which every quantity names its unit. Unknown keys and units are refused with the
//! line, what was found, what is allowed, and what was probably meant.

mod reader;
mod spec;

pub use reader::{SceneError, SceneProblem};
pub use spec::{MaterialSource, OrganSource, PathPoint, Scene, tool_on_path};
