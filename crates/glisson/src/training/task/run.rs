//! A task that somebody does: which stage it is at, and what is written down for its assessment.

use super::events::{Effects, EventNews, Events};
use super::goal::{CannotBe, Goal, Look, Press};
use super::result::{Outcome, StageResult, TaskRecord};
use crate::math::DVec3;
use crate::scene::{EffectSource, GoalSource, TaskSource};
use crate::training::moments::{Fault, Moment};
use crate::training::trace::TraceRecorder;
use crate::world::World;
use serde::Serialize;

/// Why a task cannot be done in a scene.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum TaskError {
    /// A place of a goal is not in the tissue.
    #[error(
        "stage {stage} of the task, \"{title}\": there is no tissue at ({:.1}, {:.1}, {:.1}) mm; give a place at rest within 5 mm of it",
        1e3 * point_m.x, 1e3 * point_m.y, 1e3 * point_m.z
    )]
    NoTissue {
        /// Which stage, from 1.
        stage: usize,
        /// What it is called.
        title: String,
        /// The place [m].
        point_m: DVec3,
    },
    /// A ball to be excised that the mesh does not resolve.
    #[error(
        "stage {stage} of the task, \"{title}\": the ball to be excised holds the middle of no tetrahedron; give a greater radius, or the \
         organ more tetrahedra"
    )]
    SmallBall {
        /// Which stage, from 1.
        stage: usize,
        /// What it is called.
        title: String,
    },
    /// Two places that are to be parted and do not hang together.
    #[error(
        "stage {stage} of the task, \"{title}\": its two places do not hang together at the beginning; take two of one piece"
    )]
    Apart {
        /// Which stage, from 1.
        stage: usize,
        /// What it is called.
        title: String,
    },
    /// An event that lets a vessel bleed in an organ without any.
    #[error(
        "the task's event \"{title}\" lets a vessel bleed, and the organ has none: give it [[organ.vessel]], \
         vessels = \"vessels.csv\", or phantom = {{ vessels = true }}"
    )]
    NothingBleeds {
        /// What it is called.
        title: String,
    },
    /// A goal about vessels in an organ without any.
    #[error(
        "stage {stage} of the task, \"{title}\", is about vessels, and the organ has none: give it [[organ.vessel]], \
         vessels = \"vessels.csv\", or phantom = {{ vessels = true }}"
    )]
    NoVessels {
        /// Which stage, from 1.
        stage: usize,
        /// What it is called.
        title: String,
    },
    /// Nothing holds the bodies together.
    #[error(
        "stage {stage} of the task, \"{title}\": nothing attaches {} to {}, or nothing parts what does; give them an [[attachment]] with \
         cut = true or a strength", names[0], names[1]
    )]
    NotAttached {
        /// Which stage, from 1.
        stage: usize,
        /// What it is called.
        title: String,
        /// The bodies.
        names: [String; 2],
    },
}

/// Where something is to be done, for a picture.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct TaskMark {
    /// What the points are.
    pub kind: MarkKind,
    /// A place, or the points of a line, of a closed one the first again at the end [m]; of the tissue at rest, but for [`MarkKind::Space`].
    pub points_m: Vec<DVec3>,
}

/// What is marked.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum MarkKind {
    /// A place of the tissue.
    Place,
    /// A line on the tissue.
    Line,
    /// A place in space.
    Space,
}

impl TaskMark {
    /// Where a goal is to be reached, if that is to be seen: what has to be found is not.
    fn of(goal: &GoalSource) -> Option<Self> {
        let (kind, points_m) = match goal {
            GoalSource::Reach { point_m, .. } => (MarkKind::Space, vec![*point_m]),
            GoalSource::Cut { line, .. } => {
                let first_again = line.points_m.first().filter(|_| line.is_closed);
                (MarkKind::Line, line.points_m.iter().chain(first_again).copied().collect())
            }
            GoalSource::Lift { point_m, .. }
            | GoalSource::See { point_m, .. }
            | GoalSource::Excise { center_m: point_m, .. } => (MarkKind::Place, vec![*point_m]),
            GoalSource::Touch { near_m, .. }
            | GoalSource::Grasp { near_m, .. }
            | GoalSource::Ligate { near_m, .. } => (MarkKind::Place, vec![near_m.as_ref()?.0]),
            GoalSource::Mark { .. }
            | GoalSource::Part { .. }
            | GoalSource::Detach { .. }
            | GoalSource::Clip { .. }
            | GoalSource::Bleed { .. } => return None,
        };
        Some(Self { kind, points_m })
    }
}

/// What who does a task is shown.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct TaskStatus {
    /// What the task is called.
    pub title: String,
    /// Whether it begins with the endoscope's picture.
    pub begins_in_theatre: bool,
    /// What is to be done now; empty when it is over.
    pub stage: String,
    /// Stages that are done.
    pub n_done: usize,
    /// Stages in all.
    pub n_stages: usize,
    /// How far the stage is, 0 to 1, in hundredths.
    pub share: f64,
    /// Help, when it takes long.
    pub hint: Option<String>,
    /// Where something is to be done now.
    pub mark: Option<TaskMark>,
    /// Mistakes so far.
    pub n_mistakes: usize,
    /// The last one.
    pub mistake: Option<String>,
    /// Simulated time at which it began [s]; none before an instrument has moved.
    pub began_s: Option<f64>,
    /// Simulated time at which it ended [s], once it has.
    pub ended_s: Option<f64>,
    /// How long it may take [s].
    pub time_limit_s: f64,
    /// Whether the endoscope's lamp is out.
    pub is_dark: bool,
    /// What can happen, and what has.
    pub events: Vec<EventNews>,
    /// Once it is over.
    pub outcome: Option<Outcome>,
}

/// How far a task is, in numbers.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct TaskProgress {
    /// Stages that are done.
    pub n_done: usize,
    /// Stages in all.
    pub n_stages: usize,
    /// How far the stage is, 0 to 1.
    pub share: f64,
    /// Mistakes so far.
    pub n_mistakes: usize,
}

/// The clock of a task starts when the tip of an instrument has gone so far from where it was [m]: a choice.
const BEGINS_M: f64 = 1e-3;

/// A task that is being done. It begins when an instrument moves.
#[derive(Clone, Debug)]
pub struct TaskRun {
    source: TaskSource,
    /// Where the tips were before it began [m].
    waiting_m: Vec<DVec3>,
    goals: Vec<Goal>,
    recorder: TraceRecorder,
    events: Events,
    stage: usize,
    /// When the stage began, and since when its goal holds [s after the task's beginning].
    stage_began_s: f64,
    holds_since_s: Option<f64>,
    look: Look,
    /// Which triggers were pressed after the last step, and which have been pressed since the last sample.
    was_triggered: Vec<bool>,
    presses: Vec<Press>,
    stages: Vec<StageResult>,
    mistakes: Vec<Moment>,
    began_s: Option<f64>,
    outcome: Option<Outcome>,
}

impl TaskRun {
    /// A task in a world at rest.
    ///
    /// # Errors
    /// [`TaskError`] where the scene has not what a goal is about.
    pub fn new(source: &TaskSource, world: &World) -> Result<Self, TaskError> {
        let bleeds = |effect: &EffectSource| matches!(effect, EffectSource::Bleed { .. });
        if let Some(event) = source.events.iter().find(|event| bleeds(&event.effect))
            && world.vessels().is_none()
        {
            return Err(TaskError::NothingBleeds { title: event.title.clone() });
        }
        let mut goals = Vec::new();
        for (stage, of) in (1..).zip(&source.stages) {
            let title = of.title.clone();
            if of.goal.is_about_vessels() && world.vessels().is_none() {
                return Err(TaskError::NoVessels { stage, title });
            }
            let goal = Goal::new(of.goal.clone(), world);
            let mut goal = goal.map_err(|cannot| match cannot {
                CannotBe::NoTissue { point_m } => {
                    TaskError::NoTissue { stage, title: title.clone(), point_m }
                }
                CannotBe::SmallBall => TaskError::SmallBall { stage, title: title.clone() },
                CannotBe::NotAttached { bodies } => {
                    let names = bodies.map(|body| world.spec().bodies[body].name.clone());
                    TaskError::NotAttached { stage, title: title.clone(), names }
                }
            })?;
            if matches!(of.goal, GoalSource::Part { .. }) && goal.look(world, &[]).holds {
                return Err(TaskError::Apart { stage, title });
            }
            goals.push(goal);
        }
        Ok(Self {
            source: source.clone(),
            waiting_m: (0..world.tools().len()).map(|tool| tip_m(world, tool)).collect(),
            goals,
            recorder: TraceRecorder::new(world),
            events: Events::new(&source.events),
            stage: 0,
            stage_began_s: 0.0,
            holds_since_s: None,
            look: Look::default(),
            was_triggered: vec![false; world.tools().len()],
            presses: Vec::new(),
            stages: Vec::new(),
            mistakes: Vec::new(),
            began_s: None,
            outcome: None,
        })
    }

    /// The same task from its beginning.
    ///
    /// # Errors
    /// As [`TaskRun::new`]: tissue that a goal is about may be gone.
    pub fn anew(&self, world: &World) -> Result<Self, TaskError> {
        Self::new(&self.source, world)
    }

    /// After each step. Once the task is over nothing more is written down.
    pub fn after_step(&mut self, world: &World) {
        if self.outcome.is_some() {
            return;
        }
        self.note_presses(world);
        if !self.has_begun(world) || !self.recorder.after_step(world) {
            return;
        }
        let now_s = self.recorder.trace().duration_s();
        self.events.advance(now_s, self.stage, self.stage_began_s);
        self.goals.iter_mut().for_each(|goal| goal.measure(world));
        let look = self.goals[self.stage].look(world, &self.presses);
        self.presses.clear();
        if let Some(mistake) = &look.mistake {
            let detail = format!("{}: {mistake}", self.source.stages[self.stage].title);
            self.mistakes.push(Moment {
                fault: Fault::Mistake,
                from_s: now_s,
                to_s: now_s,
                tool: None,
                detail,
            });
        }
        self.holds_since_s = look.holds.then(|| self.holds_since_s.unwrap_or(now_s));
        self.look = look;
        let hold_s = self.source.stages[self.stage].hold_s;
        // A sample's time is a sum of steps.
        if self.holds_since_s.is_some_and(|since_s| now_s - since_s >= hold_s - 1e-9) {
            self.end_stage(now_s);
        }
        if self.outcome.is_none() && now_s >= self.source.time_limit_s {
            self.outcome = Some(Outcome::TimeOver);
        }
    }

    /// Notes triggers that were pressed in this step.
    fn note_presses(&mut self, world: &World) {
        let Effects { fails, .. } = self.effects(world);
        for (tool, was_triggered) in self.was_triggered.iter_mut().enumerate() {
            if fails[tool] {
                // Who holds the trigger of an instrument that fails does not press it when it works again.
                *was_triggered = true;
                continue;
            }
            let is_triggered = world.tool_pose(tool).is_triggered();
            if is_triggered && !std::mem::replace(was_triggered, is_triggered) {
                self.presses.push(Press { tool, touched_at_rest_m: world.touched_at_rest_m(tool) });
            }
            *was_triggered = is_triggered;
        }
    }

    /// Whether it has begun before this step.
    fn has_begun(&mut self, world: &World) -> bool {
        if self.began_s.is_some() {
            return true;
        }
        let moved = |(tool, from_m): (usize, &DVec3)| tip_m(world, tool).distance(*from_m) > BEGINS_M;
        if self.waiting_m.iter().enumerate().any(moved) {
            self.recorder = TraceRecorder::new(world);
            self.began_s = Some(world.time_s());
        }
        false
    }

    fn end_stage(&mut self, now_s: f64) {
        self.stages.push(StageResult {
            title: self.source.stages[self.stage].title.clone(),
            began_s: self.stage_began_s,
            ended_s: now_s,
        });
        (self.stage, self.stage_began_s, self.holds_since_s) = (self.stage + 1, now_s, None);
        self.look = Look::default();
        if self.stage == self.goals.len() {
            self.outcome = Some(Outcome::Done);
        }
    }

    /// Simulated time since it began [s].
    fn now_s(&self, world: &World) -> Option<f64> {
        let now_s = world.time_s();
        self.began_s.filter(|_| self.outcome.is_none()).map(|began_s| now_s - began_s)
    }

    /// What events do to the next step.
    pub fn effects(&self, world: &World) -> Effects {
        self.now_s(world).map(|now_s| self.events.effects(now_s)).unwrap_or_default()
    }

    /// A place at rest [m] where a vessel tears now because an event says so; told once.
    pub fn take_tear(&mut self) -> Option<DVec3> {
        self.events.take_tear()
    }

    /// Lets an event come now, as who teaches says; answers whether it did: not before the task has begun, nor twice.
    pub fn let_come(&mut self, event: usize, world: &World) -> bool {
        self.now_s(world).is_some_and(|now_s| self.events.come(event, now_s))
    }

    /// How it ended, once it has.
    pub fn outcome(&self) -> Option<Outcome> {
        self.outcome
    }

    /// How far it is.
    pub fn progress(&self) -> TaskProgress {
        TaskProgress {
            n_done: self.stage,
            n_stages: self.goals.len(),
            share: self.look.share,
            n_mistakes: self.mistakes.len(),
        }
    }

    /// Where something is to be done now, if that is a place.
    pub fn mark(&self) -> Option<TaskMark> {
        let stage = self.source.stages.get(self.stage).filter(|_| self.outcome.is_none());
        stage.and_then(|stage| TaskMark::of(&stage.goal))
    }

    /// What who does it is shown now.
    pub fn status(&self) -> TaskStatus {
        let stage = self.source.stages.get(self.stage);
        let in_stage_s = self.recorder.trace().duration_s() - self.stage_began_s;
        let hint = stage.filter(|stage| self.outcome.is_none() && in_stage_s >= stage.hint_after_s);
        TaskStatus {
            title: self.source.title.clone(),
            begins_in_theatre: self.source.begins_in_theatre,
            stage: stage.map(|stage| stage.title.clone()).unwrap_or_default(),
            n_done: self.stage,
            n_stages: self.goals.len(),
            share: (self.look.share * 100.0).floor() / 100.0,
            hint: hint.and_then(|stage| stage.hint.clone()),
            mark: self.mark(),
            n_mistakes: self.mistakes.len(),
            mistake: self.mistakes.last().map(|mistake| mistake.detail.clone()),
            began_s: self.began_s,
            // Nothing is written down after the end.
            ended_s: self
                .outcome
                .and(self.began_s)
                .map(|began_s| began_s + self.recorder.trace().duration_s()),
            time_limit_s: self.source.time_limit_s,
            is_dark: self.outcome.is_none() && self.events.is_dark(self.recorder.trace().duration_s()),
            events: self.events.news(),
            outcome: self.outcome,
        }
    }

    /// What was written down of it so far.
    pub fn record(&self) -> TaskRecord {
        TaskRecord {
            source: self.source.clone(),
            trace: self.recorder.trace().clone(),
            outcome: self.outcome,
            began_s: self.began_s,
            stages: self.stages.clone(),
            mistakes: self.mistakes.clone(),
            events: self.events.news(),
            qualities: self.goals.iter().filter_map(Goal::cut_quality).collect(),
            excised: self.goals.iter().find_map(Goal::excised),
        }
    }
}

fn tip_m(world: &World, tool: usize) -> DVec3 {
    world.tool_pose(tool).tip_in_world_m
}
