//! Scene files: text -> [`Scene`] -> [`crate::world::World`].
//!
//! A scene is a TOML file in which every quantity names its unit. Unknown keys and units are refused with the
//! line, what was found, what is allowed, and what was probably meant.

mod build_error;
mod build;
mod contact;
mod hand;
mod instrument;
mod law;
mod region;
mod material;
mod when_cut;
mod shape;
mod solids;
mod vessel;
mod organ;
mod reader;
mod place;
mod rigid;
mod simulation;
mod bodies;
mod attachment;
mod carried;
mod build_shape;
mod build_bodies;
mod build_world;
mod suture;
mod task;
mod spec;
mod files;
mod choice;

pub use attachment::{AttachmentKind, AttachmentSource};
pub use bodies::{BodySource, SceneBody};
pub use build::{joint_mesh_hash, mesh_hash, read_organ, read_tools};
pub use build_error::BuildError;
pub use build_world::build_world;
pub use choice::{Choice, choose, with_patient};
pub use instrument::{PathPoint, tool_on_path};
pub use material::{ElasticitySource, MaterialSource, PartPlace, TissuePartSource};
pub use organ::{OrganSource, OrganSurroundings, OrganZone};
pub use reader::{SceneError, SceneProblem};
pub use rigid::RigidSource;
pub use shape::{BodyShape, PhantomOrgan, ShapeSource, TubePath};
pub use spec::Scene;
pub(crate) use task::share_of_jerk;
pub use task::{
    EffectSource, EventSource, EventTime, GateSource, GoalSource, LineSource, StageSource, TaskSource,
};
pub use when_cut::WhenCut;

pub use crate::model::kind::{build_model, build_model_as_cut};
pub use crate::model::{BodyPart, BodySet, MeasuredSample, ModelError, OrganBody};
