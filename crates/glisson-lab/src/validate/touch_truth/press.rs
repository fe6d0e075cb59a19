//! A ball pressed into an organ by a hand that gives way, held until the force stands still.
//!
//! What counts for the depth is where the ball **is**: the hand goes on until the ball, which stays behind it by what its spring
//! gives way, is as deep as wanted.

use anyhow::Context;
use glisson::material::{LinearElastic, law_named};
use glisson::math::DVec3;
use glisson::mesh::TetMesh;
use glisson::model::kind::{ModelKind, build_model};
use glisson::model::{DeformableModel, OrganBody, Rayleigh};
use glisson::record::snapshot::Snapshot;
use glisson::tool::{Grip, Tool, ToolInput};
use glisson::world::spec::{Hand, Region, Support, WorldSpec, fixed_nodes};
use glisson::world::{StepInput, World};
use std::collections::VecDeque;

/// The ball goes so fast [m/s]: slow beside shear waves in the tissue (1.2 m/s). A choice.
const SPEED_M_PER_S: f64 = 0.02;
/// Near the critical damping of the slowest motions of a block 60 mm high (waves of 1.2 m/s: 5 Hz) [1/s]. A choice; what
/// stands still is not damped.
const DAMPING_PER_S: f64 = 60.0;
/// The force stands still when it stays within [`STANDSTILL`] of its mean, and the ball within [`ON_DEPTH`] radii of its depth,
/// for so long [s].
const WINDOW_S: f64 = 0.04;
const STANDSTILL: f64 = 2e-3;
const ON_DEPTH: f64 = 1e-3;
/// The hand makes up for its spring in this time [s].
const FOLLOW_S: f64 = 0.01;
/// A ball that does not stand still by then is read as it is [s].
const LONGEST_HOLD_S: f64 = 1.0;
/// Steps shorter than this [s] are not tried.
const SHORTEST_STEP_S: f64 = 1e-5;
/// Where the ball waits before it is pressed in: so far above the skin [m].
const ABOVE_M: f64 = 1e-3;

/// A model with its law.
#[derive(Clone, Copy, Debug)]
pub(super) struct Subject {
    pub(super) kind: ModelKind,
    /// None: the model's own.
    law: Option<&'static str>,
    /// The longest step that is tried [s]; halved until the model takes it.
    step_s: f64,
    /// Whether it is linear in the displacements.
    pub(super) is_linear: bool,
}

/// The models that are judged.
pub(super) const SUBJECTS: [Subject; 4] = [
    Subject { kind: ModelKind::Precomputed, law: None, step_s: 1e-3, is_linear: true },
    Subject { kind: ModelKind::Hybrid, law: None, step_s: 1e-3, is_linear: true },
    Subject { kind: ModelKind::Explicit, law: Some("stable_neo_hooke"), step_s: 1e-3, is_linear: false },
    Subject { kind: ModelKind::Implicit, law: Some("stable_neo_hooke"), step_s: 4e-3, is_linear: false },
];

/// An organ with a model, at rest.
pub(super) struct ReadyOrgan {
    mesh: TetMesh,
    supports: Vec<Support>,
    kind: ModelKind,
    model: Box<dyn DeformableModel>,
    step_s: f64,
    material: LinearElastic,
}

impl ReadyOrgan {
    pub(super) fn new(
        mesh: &TetMesh,
        material: LinearElastic,
        support: Region,
        subject: &Subject,
    ) -> anyhow::Result<Self> {
        let supports = vec![Support::all_axes(support)];
        let mut body = OrganBody::new(mesh.clone(), material, subject.step_s);
        body.fixed = fixed_nodes(&supports, &mesh.positions_m);
        body.damping = Rayleigh::of_mass(DAMPING_PER_S);
        if let Some(law) = subject.law {
            body.law = Some(law_named(law).with_context(|| format!("no law {law}"))?);
        }
        let kind = subject.kind;
        let model = loop {
            match build_model(&body, kind) {
                Ok(model) => break model,
                Err(error) if body.time_step_s < 2.0 * SHORTEST_STEP_S || !is_step_too_long(&error) => {
                    return Err(error.into());
                }
                Err(_) => body.time_step_s *= 0.5,
            }
        };
        Ok(Self { mesh: mesh.clone(), supports, kind, model, step_s: body.time_step_s, material })
    }

    pub(super) fn world(&self, tool: Tool) -> anyhow::Result<World> {
        let mut spec = WorldSpec::new("touched organ", self.step_s, tool);
        spec.supports.clone_from(&self.supports);
        spec.hand = Some(Hand::default());
        spec.tissue = Some(self.material);
        Ok(World::new(spec, self.mesh.clone(), self.model.duplicate(), self.kind)?)
    }
}

fn is_step_too_long(error: &glisson::model::ModelError) -> bool {
    let is_it = |cause: &dyn std::error::Error| cause.to_string().contains("is above the stable one");
    let mut cause: Option<&dyn std::error::Error> = Some(error);
    while let Some(error) = cause {
        if is_it(error) {
            return true;
        }
        cause = error.source();
    }
    false
}

/// Where and with what an organ is touched.
#[derive(Clone, Copy, Debug)]
pub(super) struct Press {
    /// The place of the undeformed skin [m].
    pub(super) skin_m: DVec3,
    /// Unit vector along which the ball goes.
    pub(super) inwards: DVec3,
    pub(super) radius_m: f64,
}

/// What was felt at a depth.
#[derive(Clone, Copy, Debug)]
pub(super) struct Felt {
    /// How far the ball's foremost point was under the place of the undeformed skin [m].
    pub(super) depth_m: f64,
    /// Force against the ball's way [N].
    pub(super) force_n: f64,
    /// Half the range of the force while it was read, over its mean.
    pub(super) unrest: f64,
}

impl Press {
    /// A frictionless ball on a shaft that is too thin to touch anything.
    fn tool(&self) -> Tool {
        let grip = Grip { friction_coefficient: 0.0, is_sticky: false };
        let home = ToolInput::at(self.skin_m - self.inwards * 0.2, -self.inwards);
        Tool { grip, shaft_radius_m: 0.25 * self.radius_m, ..Tool::probe("ball", self.radius_m, home) }
    }

    fn input(&self, depth_m: f64) -> StepInput {
        let centre_m = self.skin_m + self.inwards * (depth_m - self.radius_m);
        StepInput::of(&[ToolInput::at(centre_m, -self.inwards)])
    }

    /// Presses to one depth after the other, ascending.
    pub(super) fn run(&self, organ: &ReadyOrgan, depths_m: &[f64]) -> anyhow::Result<Vec<Felt>> {
        let mut world = organ.world(self.tool())?;
        let mut snapshot = world.snapshot();
        world.step(&self.input(-ABOVE_M).placed());
        // Where the hand is; what it adds because its spring gives way; where the ball should be.
        let (mut ahead_m, mut wanted_m) = (0.0, -ABOVE_M);
        let mut felt = Vec::new();
        let n_window = (WINDOW_S / organ.step_s).ceil() as usize;
        for &depth_m in depths_m {
            let mut recent = VecDeque::with_capacity(n_window + 1);
            let mut held_s = 0.0;
            loop {
                wanted_m = depth_m.min(wanted_m + SPEED_M_PER_S * organ.step_s);
                let report = world.step(&self.input(wanted_m + ahead_m)).tools[0];
                let actual_m = self.depth_m(&world, &mut snapshot);
                ahead_m += (organ.step_s / FOLLOW_S).min(1.0) * (wanted_m - actual_m);
                if wanted_m < depth_m {
                    continue;
                }
                held_s += organ.step_s;
                recent.push_back((actual_m, -report.force_on_tool_n.dot(self.inwards)));
                if recent.len() > n_window {
                    recent.pop_front();
                    let now = self.read(&recent);
                    let is_there = (now.depth_m - depth_m).abs() <= ON_DEPTH * self.radius_m;
                    if (is_there && now.unrest <= STANDSTILL) || held_s > LONGEST_HOLD_S {
                        felt.push(now);
                        break;
                    }
                }
            }
        }
        Ok(felt)
    }

    /// How deep the ball is.
    fn depth_m(&self, world: &World, snapshot: &mut Snapshot) -> f64 {
        world.snapshot_into(snapshot);
        let centre_m = snapshot.tools[0].pose.tip_in_world_m;
        (centre_m - self.skin_m).dot(self.inwards) + self.radius_m
    }

    fn read(&self, recent: &VecDeque<(f64, f64)>) -> Felt {
        let n = recent.len() as f64;
        let force_n = recent.iter().map(|(_, force_n)| force_n).sum::<f64>() / n;
        let depth_m = recent.iter().map(|(depth_m, _)| depth_m).sum::<f64>() / n;
        let (least_n, most_n) = recent
            .iter()
            .fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), (_, f)| (low.min(*f), high.max(*f)));
        Felt { depth_m, force_n, unrest: 0.5 * (most_n - least_n) / force_n.abs().max(1e-9) }
    }
}
