//! A simulation whose instruments follow a script until somebody takes them into the hand.

use super::Simulation;
use crate::script::{Clip, Lead, Script, bleeding_ml_per_min};
use glisson::record::session::SessionEvent;
use glisson::scene::Scene;
use glisson::tool::{MAX_TOOLS, ToolInput};
use glisson::world::{StepInput, StepReport};

/// A script that is followed.
pub(super) struct Run {
    script: Box<dyn Script>,
    next: Lead,
    /// Instruments that somebody has taken into the hand.
    is_taken: [bool; MAX_TOOLS],
    clips: Vec<Clip>,
    is_over: bool,
}

impl Simulation {
    /// From now on instruments follow a script until a viewer takes them into the hand, or resets.
    pub fn follow_script(&mut self, mut script: Box<dyn Script>) {
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
    pub fn scripted_input(&self) -> Option<StepInput> {
        let n_tools = self.world.tools().len();
        self.script.as_ref().map(|run| StepInput::of(&run.next.tools[..n_tools]))
    }

    /// Makes step number `step` (from 1) along the paths of its scene, with the clips that are set on the way.
    ///
    /// # Errors
    /// As [`Simulation::advance`].
    pub fn follow_paths(&mut self, scene: &Scene, step: u64) -> anyhow::Result<(StepInput, StepReport)> {
        let [from_s, to_s] = [step - 1, step].map(|step| step as f64 * scene.world.time_step_s);
        let input = scene.input_at(to_s);
        let report = self.advance(&input)?;
        for tool in scene.clips_between(from_s, to_s) {
            self.clip_vessel(tool)?;
        }
        Ok((input, report))
    }

    /// Somebody looks from now on.
    pub(crate) fn show_begins(&mut self) {
        if let Some(run) = &mut self.script {
            run.script.show_begins();
        }
    }

    /// A viewer moves this instrument.
    pub(crate) fn take_from_script(&mut self, tool: usize) {
        if let Some(run) = &mut self.script {
            run.is_taken[tool] = true;
        }
    }

    /// Share of the script that is done.
    pub fn script_progress(&self) -> f64 {
        self.script.as_ref().map_or(0.0, |run| run.script.progress())
    }

    /// Whether the script has come to its end.
    pub fn script_is_over(&self) -> bool {
        self.script.as_ref().is_some_and(|run| run.is_over)
    }

    /// Whether the script sets a clip after the next step.
    pub fn is_about_to_clip(&self) -> bool {
        self.script.as_ref().is_some_and(|run| !run.next.clips.is_empty())
    }

    /// Clips of the script that closed something.
    pub fn scripted_clips(&self) -> &[Clip] {
        self.script.as_ref().map_or(&[], |run| &run.clips)
    }

    /// After a step: what the script does then, and what it wants next.
    pub(super) fn go_on_with_script(&mut self) -> anyhow::Result<()> {
        // Taken out, because a clip goes through the simulation.
        let Some(mut run) = self.script.take_if(|run| !run.is_over) else { return Ok(()) };
        for tool in std::mem::take(&mut run.next.clips) {
            let before_ml_per_min = bleeding_ml_per_min(&self.world);
            // One that somebody has in the hand sets none.
            if !run.is_taken[tool] {
                self.clip_vessel(tool)?;
            }
            let time_s = self.world.time_s();
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
            self.record(&SessionEvent::Checkpoint { step, state_hash });
            let result = run.script.result(&self.world).unwrap_or_else(|error| format!("{error:#}"));
            self.tell_news(format!("the script is over: {result}; state {state_hash}"));
        }
        self.script = Some(run);
        Ok(())
    }
}
