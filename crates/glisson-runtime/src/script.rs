//! Operations that lead the instruments by what they see of the organ, in the viewer and without a window alike.

use glisson::model::rigid::RigidMotion;
use glisson::scene::{BodySource, RigidSource, Scene};
use glisson::tool::{MAX_TOOLS, ToolInput};
use glisson::world::World;

/// What a script does in the next step.
#[derive(Clone, Debug)]
pub struct Lead {
    /// Where it has the instruments at the step's end.
    pub tools: [ToolInput; MAX_TOOLS],
    /// Which of them set a clip then, one after the other.
    pub clips: Vec<usize>,
}

/// A clip that a script set, or wanted to.
#[derive(Clone, Copy, Debug, serde::Serialize)]
pub struct Clip {
    pub(crate) time_s: f64,
    /// Blood that the whole organ lost before and after [ml/min].
    pub(crate) before_ml_per_min: f64,
    pub(crate) after_ml_per_min: f64,
}

impl Clip {
    /// Whether it closed something.
    pub fn holds(&self) -> bool {
        self.after_ml_per_min < self.before_ml_per_min
    }
}

/// An operation. What it does depends on the world alone, and not on a clock; but for when it begins.
pub trait Script: Send {
    /// The next step, asked once for each; none when it is over.
    fn lead(&mut self, world: &World) -> Option<Lead>;
    /// Somebody looks from now on: one that is to be seen from its beginning waits for this.
    fn show_begins(&mut self) {}
    /// What a clip that it asked for did.
    fn see(&mut self, clip: &Clip);
    /// Share of it that is done, 0 to 1.
    fn progress(&self) -> f64;
    /// What came of it.
    fn result(&self, world: &World) -> anyhow::Result<String>;
}

/// Blood that the organ loses now [ml/min].
pub fn bleeding_ml_per_min(world: &World) -> f64 {
    world.vessels().map_or(0.0, |vessels| 60e6 * vessels.bleeding_m3_per_s())
}

/// A page shows the organ so long after it came before the instruments move, at least [s]: a choice.
const SEEN_AT_REST_S: f64 = 2.0;

/// Leads the instruments along the paths of their scene, with the clips that are set on the way.
pub struct PathScript {
    scene: Scene,
    /// Step of the paths that comes next, and their last.
    step: u64,
    last_step: u64,
    before: Before,
}

/// What a path script does before its first step: its instruments are at home.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Before {
    /// Nobody looks yet; steps that were made up to now.
    WaitsForViewer { n_made: u64 },
    /// Steps to wait.
    Waits { n_left: u64 },
}

impl Before {
    /// Whether the next step is one of waiting; asked once for each.
    fn waits(&mut self) -> bool {
        match self {
            Self::WaitsForViewer { n_made } => {
                *n_made += 1;
                true
            }
            Self::Waits { n_left } => {
                let waits = *n_left > 0;
                *n_left = n_left.saturating_sub(1);
                waits
            }
        }
    }
}

impl PathScript {
    /// Begins with the first step; none where the scene has no paths.
    pub fn new(scene: Scene) -> Option<Self> {
        let last_step = (scene.end_of_paths_s()? / scene.world.time_step_s).ceil() as u64;
        Some(Self { scene, step: 0, last_step, before: Before::Waits { n_left: 0 } })
    }

    /// Begins a moment after somebody looks; where bodies breathe after whole breaths, so that the paths meet them as without waiting.
    pub fn for_viewers(scene: Scene) -> Option<Self> {
        Some(Self { before: Before::WaitsForViewer { n_made: 0 }, ..Self::new(scene)? })
    }
}

/// The longest breath of a scene's bodies [s], if any breathes.
fn breath_s(scene: &Scene) -> Option<f64> {
    let breaths_s = scene.bodies.iter().filter_map(|body| match &body.source {
        BodySource::Rigid(RigidSource { motion: RigidMotion::Breathing { period_s, .. }, .. }) => {
            Some(*period_s)
        }
        _ => None,
    });
    breaths_s.reduce(f64::max)
}

impl Script for PathScript {
    fn lead(&mut self, _: &World) -> Option<Lead> {
        let time_step_s = self.scene.world.time_step_s;
        if self.before.waits() {
            return Some(Lead { tools: self.scene.input_at(0.0).tools, clips: Vec::new() });
        }
        if self.step == self.last_step {
            return None;
        }
        let [from_s, to_s] = [self.step, self.step + 1].map(|step| step as f64 * time_step_s);
        self.step += 1;
        let clips = self.scene.clips_between(from_s, to_s).collect();
        Some(Lead { tools: self.scene.input_at(to_s).tools, clips })
    }

    fn show_begins(&mut self) {
        let Before::WaitsForViewer { n_made } = self.before else { return };
        let time_step_s = self.scene.world.time_step_s;
        let mut from_start_s = n_made as f64 * time_step_s + SEEN_AT_REST_S;
        if let Some(breath_s) = breath_s(&self.scene) {
            from_start_s = (from_start_s / breath_s).ceil() * breath_s;
        }
        let n_left = ((from_start_s / time_step_s).round() as u64).saturating_sub(n_made);
        self.before = Before::Waits { n_left };
    }

    fn see(&mut self, _: &Clip) {}

    fn progress(&self) -> f64 {
        self.step as f64 / self.last_step.max(1) as f64
    }

    fn result(&self, _: &World) -> anyhow::Result<String> {
        Ok("the instruments are at the ends of their paths".into())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::tasks::task_named;

    fn script_of(task: &str) -> PathScript {
        PathScript::for_viewers(Scene::parse(task_named(task).unwrap()).unwrap()).unwrap()
    }

    /// Steps that a script waits after the `n_alone` that it has made before somebody comes.
    fn n_waited(script: &mut PathScript, n_alone: u64) -> u64 {
        for _ in 0..n_alone {
            assert!(script.before.waits());
        }
        script.show_begins();
        let mut n = 0;
        while script.before.waits() {
            n += 1;
            // Who comes later changes nothing.
            script.show_begins();
        }
        n
    }

    #[test]
    fn paths_begin_a_moment_after_somebody_looks() {
        let mut script = script_of("cholecystectomy");
        let time_step_s = script.scene.world.time_step_s;
        assert!((n_waited(&mut script, 5000) as f64 * time_step_s - SEEN_AT_REST_S).abs() < 1e-9);
    }

    #[test]
    fn paths_of_scenes_that_breathe_begin_with_a_breath() {
        for n_alone in [1, 1900, 2001] {
            let mut script = script_of("breathing_liver");
            let (time_step_s, n) = (script.scene.world.time_step_s, n_waited(&mut script, n_alone));
            let breaths = (n_alone + n) as f64 * time_step_s / 4.0;
            assert!((breaths - breaths.round()).abs() < 1e-9, "{breaths}");
            assert!(n as f64 * time_step_s >= SEEN_AT_REST_S - 1e-9);
        }
    }
}
