//! Operations that lead the instruments by what they see of the organ, in the viewer and without a window alike.

use super::Simulation;
use glisson::record::session::SessionEvent;
use glisson::tool::{MAX_TOOLS, ToolInput};
use glisson::world::{StepInput, World};

/// What a script does in the next step.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Lead {
    /// Where it has the instruments at the step's end.
    pub(crate) tools: [ToolInput; MAX_TOOLS],
    /// Which of them sets a clip then.
    pub(crate) clips: Option<usize>,
}

/// A clip that a script set, or wanted to.
#[derive(Clone, Copy, Debug, serde::Serialize)]
pub(crate) struct Clip {
    pub(crate) time_s: f64,
    /// Blood that the whole organ lost before and after [ml/min].
    pub(crate) before_ml_per_min: f64,
    pub(crate) after_ml_per_min: f64,
}

impl Clip {
    /// Whether it closed something.
    pub(crate) fn holds(&self) -> bool {
        self.after_ml_per_min < self.before_ml_per_min
    }
}

/// An operation. What it does depends on the world alone, and not on a clock.
pub(crate) trait Script: Send {
    /// The next step, asked once for each; none when it is over.
    fn lead(&mut self, world: &World) -> Option<Lead>;
    /// What a clip that it asked for did.
    fn see(&mut self, clip: &Clip);
    /// Share of it that is done, 0 to 1.
    fn progress(&self) -> f64;
    /// What came of it.
    fn result(&self, world: &World) -> anyhow::Result<String>;
}

/// A script that is followed.
pub(super) struct Run {
    script: Box<dyn Script>,
    next: Lead,
    /// Instruments that somebody has taken into the hand.
    is_taken: [bool; MAX_TOOLS],
    clips: Vec<Clip>,
    is_over: bool,
}

/// Blood that the organ loses now [ml/min].
pub(crate) fn bleeding_ml_per_min(world: &World) -> f64 {
    world.vessels().map_or(0.0, |vessels| 60e6 * vessels.bleeding_m3_per_s())
}

impl Simulation {
    /// From now on instruments follow a script until a viewer takes them into the hand, or resets.
    pub(crate) fn follow_script(&mut self, mut script: Box<dyn Script>) {
        let Some(next) = script.lead(&self.world) else { return };
        self.script =
            Some(Run { script, next, is_taken: [false; MAX_TOOLS], clips: Vec::new(), is_over: false });
        self.tell_news(
            "the instruments follow a script; push, or move one, to take it into the hand".to_owned(),
        );
    }

    /// Where the script has an instrument at the end of the next step.
    pub(crate) fn scripted_pose(&self, tool: usize) -> Option<ToolInput> {
        self.script.as_ref().filter(|run| !run.is_taken[tool]).map(|run| run.next.tools[tool])
    }

    /// The next step of a script that has all instruments.
    pub(crate) fn scripted_input(&self) -> Option<StepInput> {
        let n_tools = self.world.tools().len();
        self.script.as_ref().map(|run| StepInput::of(&run.next.tools[..n_tools]))
    }

    /// A viewer moves this instrument.
    pub(crate) fn take_from_script(&mut self, tool: usize) {
        if let Some(run) = &mut self.script {
            run.is_taken[tool] = true;
        }
    }

    /// Share of the script that is done.
    pub(crate) fn script_progress(&self) -> f64 {
        self.script.as_ref().map_or(0.0, |run| run.script.progress())
    }

    /// Whether the script has come to its end.
    pub(crate) fn script_is_over(&self) -> bool {
        self.script.as_ref().is_some_and(|run| run.is_over)
    }

    /// Whether the script sets a clip after the next step.
    pub(crate) fn is_about_to_clip(&self) -> bool {
        self.script.as_ref().is_some_and(|run| run.next.clips.is_some())
    }

    /// Clips of the script that closed something.
    pub(crate) fn scripted_clips(&self) -> &[Clip] {
        self.script.as_ref().map_or(&[], |run| &run.clips)
    }

    /// After a step: what the script does then, and what it wants next.
    pub(super) fn go_on_with_script(&mut self) -> anyhow::Result<()> {
        // Taken out, because a clip goes through the simulation.
        let Some(mut run) = self.script.take_if(|run| !run.is_over) else { return Ok(()) };
        if let Some(tool) = run.next.clips.take() {
            let before_ml_per_min = bleeding_ml_per_min(&self.world);
            // One that somebody has in the hand sets none.
            if !run.is_taken[tool] {
                self.clip_vessel(tool)?;
            }
            let time_s = self.world.steps_made() as f64 * self.world.spec().time_step_s;
            let after_ml_per_min = bleeding_ml_per_min(&self.world);
            let clip = Clip { time_s, before_ml_per_min, after_ml_per_min };
            run.script.see(&clip);
            run.clips.extend(clip.holds().then_some(clip));
        }
        if let Some(next) = run.script.lead(&self.world) {
            run.next = next;
        } else {
            run.is_over = true;
            let (step, state_hash) = (self.world.steps_made(), self.world.state_hash());
            self.record(&SessionEvent::Checkpoint { step, state_hash })?;
            let result = run.script.result(&self.world).unwrap_or_else(|error| format!("{error:#}"));
            self.tell_news(format!("the script is over: {result}; state {state_hash}"));
        }
        self.script = Some(run);
        Ok(())
    }
}
