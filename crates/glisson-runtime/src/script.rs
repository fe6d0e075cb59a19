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

/// An operation. What it does depends on the world alone, and not on a clock.
pub trait Script: Send {
    /// The next step, asked once for each; none when it is over.
    fn lead(&mut self, world: &World) -> Option<Lead>;
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

/// Leads the instruments along the paths of their scene, with the clips that are set on the way.
pub struct PathScript {
    scene: Scene,
    /// Step of the paths that comes next, their last, and steps to wait before the first.
    step: u64,
    last_step: u64,
    n_waiting: u64,
}

impl PathScript {
    /// After `waits_s` of simulated time at home, or where bodies breathe after the whole breaths that are as long or longer, so
    /// that the paths meet them as without waiting; none where the scene has no paths.
    pub fn new(scene: Scene, waits_s: f64) -> Option<Self> {
        let time_step_s = scene.world.time_step_s;
        let waits_s = breath_s(&scene).map_or(waits_s, |breath_s| (waits_s / breath_s).ceil() * breath_s);
        let last_step = (scene.end_of_paths_s()? / time_step_s).ceil() as u64;
        Some(Self { scene, step: 0, last_step, n_waiting: (waits_s / time_step_s).round() as u64 })
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
        if self.n_waiting > 0 {
            self.n_waiting -= 1;
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

    #[test]
    fn paths_of_scenes_that_breathe_begin_with_a_breath() {
        let waits_s = |task: &str| {
            let scene = Scene::parse(task_named(task).unwrap()).unwrap();
            let time_step_s = scene.world.time_step_s;
            PathScript::new(scene, 3.0).unwrap().n_waiting as f64 * time_step_s
        };
        assert!((waits_s("breathing_liver") - 4.0).abs() < 1e-9);
        assert!((waits_s("cholecystectomy") - 3.0).abs() < 1e-9);
    }
}
