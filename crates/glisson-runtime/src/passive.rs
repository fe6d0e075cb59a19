//! A simulation that another program steps, before pages: what they are shown, and what they ask.

use crate::Simulation;
use crate::live::Command;
use crate::pace::{FRAME, Pace, PaceMeter};
use crate::published::{Lateness, Published};
use crate::shown::Shown;
use glisson::tool::{MAX_TOOLS, ToolInput};
use std::sync::Arc;
use std::sync::mpsc::Receiver;
use std::time::{Duration, Instant};
use tokio::sync::watch;

/// What pages asked for; who steps the simulation may do it.
#[derive(Clone, Copy, Debug, Default)]
pub struct Asked {
    /// Where they have instruments.
    pub poses: [Option<ToolInput>; MAX_TOOLS],
    /// Whether time is to stand still.
    pub is_paused: bool,
    /// How many single steps were asked for.
    pub n_steps: u64,
    /// How often everything was asked to go back to rest.
    pub n_resets: u64,
}

/// The simulation's end.
pub struct Passive {
    shown: Shown,
    commands: Receiver<Command>,
    asked: Asked,
    pace: PaceMeter,
    /// At the last look.
    steps: u64,
    /// When something was shown, and what could be told of it: steps, version of the surface, notices.
    last_shown: Option<(Instant, [u64; 3])>,
}

impl Passive {
    /// Shows a simulation as it is now; `commands` is what pages ask.
    ///
    /// # Errors
    /// When no thread can be started.
    pub fn start(
        simulation: &Simulation,
        commands: Receiver<Command>,
    ) -> anyhow::Result<(Self, watch::Receiver<Arc<Published>>)> {
        let (shown, published) = Shown::start(simulation)?;
        let steps = simulation.world().steps_made();
        let (asked, pace) = (Asked::default(), PaceMeter::new(Instant::now()));
        Ok((Self { shown, commands, asked, pace, steps, last_shown: None }, published))
    }

    /// What pages asked for up to the last [`Passive::sync`].
    pub fn asked(&self) -> &Asked {
        &self.asked
    }

    /// Lets go of an instrument that a page had moved.
    pub fn let_go(&mut self, tool: usize) {
        if let Some(pose) = self.asked.poses.get_mut(tool) {
            *pose = None;
        }
    }

    /// Tells that the simulation came back to an earlier moment, which may have another surface of the same version.
    pub fn went_back(&mut self) {
        self.shown.went_back();
        self.last_shown = None;
    }

    /// Takes what pages asked, and shows the simulation as it is now, but no more often than displays do.
    pub fn sync(&mut self, simulation: &mut Simulation) {
        let mut must_show = false;
        while let Ok(command) = self.commands.try_recv() {
            must_show = true;
            self.take(command, simulation);
        }
        if simulation.broken().is_some() {
            self.shown.show_broken(simulation, self.pace.pace);
            return;
        }
        let (now, steps) = (Instant::now(), simulation.world().steps_made());
        let dt_s = simulation.world().spec().time_step_s;
        // Going back to rest, or to a saved moment, is no pace.
        self.pace.count(steps.saturating_sub(self.steps), Duration::ZERO, dt_s);
        self.steps = steps;
        let version = simulation.world().organ().topology_version();
        let state = [steps, u64::from(version), simulation.n_notices() as u64];
        let is_due = |(shown, last): &(Instant, [u64; 3])| {
            now - *shown >= FRAME && (*last != state || self.shown.lacks_what_is_watched())
        };
        if must_show || self.last_shown.as_ref().is_none_or(is_due) {
            let pace = Pace { paused: self.asked.is_paused, ..self.pace.pace };
            self.shown.show(simulation, pace, Lateness::default());
            self.last_shown = Some((now, state));
        }
    }

    fn take(&mut self, command: Command, simulation: &mut Simulation) {
        let n_tools = simulation.world().tools().len();
        match command {
            Command::Tool { tool, pose } if tool < n_tools => self.asked.poses[tool] = Some(pose),
            Command::Tool { tool, .. } => simulation.refuse_tool(tool),
            Command::Pause(is_paused) => self.asked.is_paused = is_paused,
            Command::SingleStep => {
                self.asked.is_paused = true;
                self.asked.n_steps += 1;
            }
            Command::Reset => {
                self.asked.n_resets += 1;
                self.asked.poses = [None; MAX_TOOLS];
            }
            Command::Note(note) => simulation.note(note),
            Command::Viewed | Command::Stop => {}
            Command::Speed(_)
            | Command::TaskEvent { .. }
            | Command::Model(_)
            | Command::Gravity(_)
            | Command::Turn(_)
            | Command::Cut { .. }
            | Command::Refine { .. }
            | Command::Clip { .. }
            | Command::Undo => {
                simulation.tell("another program steps this simulation: do that there".to_owned());
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::OpenScene;
    use crate::tasks::task_named;
    use glisson::math::DVec3;
    use glisson::scene::Scene;
    use std::path::PathBuf;

    #[test]
    fn what_pages_ask_is_told_and_changes_nothing_by_itself() {
        let source = OpenScene {
            scene: Scene::parse(task_named("grasp_and_lift").unwrap()).unwrap(),
            folder: PathBuf::from("."),
            origin: "task".into(),
            n_threads: 1,
        };
        let mut simulation = Simulation::open(source, None).unwrap();
        let (commands, comes) = std::sync::mpsc::channel();
        let (mut passive, published) = Passive::start(&simulation, comes).unwrap();
        let hash = simulation.world().state_hash();
        let pose = ToolInput::at(DVec3::new(0.01, 0.02, 0.03), DVec3::Z);
        for command in [
            Command::Tool { tool: 0, pose },
            Command::Tool { tool: 9, pose },
            Command::SingleStep,
            Command::Undo,
        ] {
            commands.send(command).unwrap();
        }
        passive.sync(&mut simulation);
        assert_eq!(passive.asked().poses[0], Some(pose));
        assert!(passive.asked().is_paused && passive.asked().n_steps == 1);
        assert_eq!(simulation.world().state_hash(), hash);
        let told: Vec<&str> = simulation.notices().iter().map(|notice| notice.text.as_str()).collect();
        assert!(told.iter().any(|text| text.contains("no instrument 9")), "{told:?}");
        assert!(told.iter().any(|text| text.contains("another program")), "{told:?}");
        let version = published.borrow().topology.version;
        passive.went_back();
        commands.send(Command::Reset).unwrap();
        passive.sync(&mut simulation);
        assert!(passive.asked().poses[0].is_none() && passive.asked().n_resets == 1);
        drop(passive);
        let last = published.borrow();
        assert!(last.pace.paused, "what was shown last is there when it ends");
        assert!(last.topology.version > version, "a browser takes the surface anew");
        assert_eq!(last.snapshot.topology_version, last.topology.version);
    }
}
