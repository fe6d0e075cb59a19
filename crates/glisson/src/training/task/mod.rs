//! A task in a world: its stages, one after the other, and what came of it.

mod landmark;
mod cut_line;
mod excision;
mod goal;
mod events;
mod result;
mod run;

pub use cut_line::CutQuality;
pub use events::{Effects, EventNews};
pub use excision::Excised;
pub use result::{GateLine, GestureTime, MetricLine, Outcome, StageResult, TaskRecord, TaskResult};
pub use run::{MarkKind, TaskError, TaskMark, TaskProgress, TaskRun, TaskStatus};
