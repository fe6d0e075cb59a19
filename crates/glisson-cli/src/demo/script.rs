//! The scripted resection as it goes: the hands' ways of the scene, which wait at every look while an assistant sets clips on
//! what bleeds.

use super::clips::ClipApplier;
use super::plan::Plan;
use super::specimen::Specimen;
use anyhow::Context;
use glisson::scene::Scene;
use glisson::world::World;
use glisson_runtime::script::{Clip, Lead, Script, bleeding_ml_per_min};
use std::collections::VecDeque;

/// The instruments, as the scene has them.
pub(super) const GRASPER: usize = 0;
pub(super) const HOOK: usize = 1;
pub(super) const CLIP_APPLIER: usize = 2;

/// Leads the instruments along the paths of the scene, which wait while vessels are clipped.
pub(super) struct Operation {
    plan: Plan,
    scene: Scene,
    /// Step of the paths, and their last.
    step: u64,
    last_step: u64,
    /// When the hook rests [s] on the paths' clock.
    looks_s: VecDeque<f64>,
    is_looking: bool,
    applier: ClipApplier,
    n_clips: usize,
}

impl Operation {
    /// At its beginning. `world` has the instruments of the scene.
    pub(super) fn new(plan: Plan, scene: Scene, world: &World) -> anyhow::Result<Self> {
        let end_s = scene.end_of_paths_s().context("the scene has paths")?;
        let looks_s = plan.hook().1.into_iter().chain([end_s]).collect();
        let last_step = (end_s / world.spec().time_step_s).ceil() as u64;
        let applier = ClipApplier::new(world.tools()[CLIP_APPLIER].home);
        Ok(Self { plan, scene, step: 0, last_step, looks_s, is_looking: false, applier, n_clips: 0 })
    }

    /// At a look: what bleeds most comes first; a clip on one vessel may close others.
    fn look(&mut self, world: &World) {
        let ends = world.snapshot().bleeding.ends;
        match ends.iter().max_by(|a, b| a.rate_m3_per_s.total_cmp(&b.rate_m3_per_s)) {
            Some(end) => self.applier.send(self.plan.to_clip(end.position_m)),
            None => self.look_no_more(),
        }
    }

    fn look_no_more(&mut self) {
        self.applier.go_home();
        self.is_looking = false;
    }
}

impl Script for Operation {
    fn lead(&mut self, world: &World) -> Option<Lead> {
        let time_step_s = world.spec().time_step_s;
        let now_s = self.step as f64 * time_step_s;
        if self.looks_s.front().is_some_and(|look_s| *look_s <= now_s) {
            self.looks_s.pop_front();
            self.is_looking = true;
        }
        if self.is_looking && !self.applier.is_busy() {
            self.look(world);
        }
        let waits = self.applier.is_busy();
        if !waits && self.step == self.last_step {
            return None;
        }
        self.step += u64::from(!waits);
        let mut tools = self.scene.input_at(self.step as f64 * time_step_s).tools;
        if waits {
            tools[HOOK].trigger = 0.0;
        }
        let (pose, clips) = self.applier.advance(time_step_s);
        tools[CLIP_APPLIER] = pose;
        Some(Lead { tools, clips: clips.then_some(CLIP_APPLIER).into_iter().collect() })
    }

    fn see(&mut self, clip: &Clip) {
        if clip.holds() {
            self.n_clips += 1;
        } else {
            // Out of reach, of which a notice tells: until the next look.
            self.look_no_more();
        }
    }

    fn progress(&self) -> f64 {
        self.step as f64 / self.last_step as f64
    }

    fn result(&self, world: &World) -> anyhow::Result<String> {
        let specimen = Specimen::of(world, &self.plan.tumour)?;
        let lost_ml = world.vessels().map_or(0.0, |vessels| 1e6 * vessels.lost_m3());
        Ok(format!(
            "{}; {} clips, {lost_ml:.1} ml of blood lost, {:.0} ml/min now",
            specimen.text(),
            self.n_clips,
            bleeding_ml_per_min(world)
        ))
    }
}
