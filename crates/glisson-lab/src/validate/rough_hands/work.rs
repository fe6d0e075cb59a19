//! What hands do to instruments, and instruments to the tissue: work, step by step.
//!
//! The work of a hand on its instrument is minus the tissue's force times the tip's way, and minus the torque times the turn: of all
//! places of a rigid instrument together. The work on the tissue is that of the forces on its nodes. What is between them went into friction,
//! the damper of what the mesh is too coarse for, and gaps that a step leaves; more work on the tissue than the hands did is energy from
//! nowhere.

use glisson::math::DVec3;
use glisson::record::snapshot::Snapshot;
use glisson::tool::pose::{ToolFrame, rotation_vector_rad};
use glisson::world::{StepInput, World};

/// Work of a motion [J].
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Work {
    /// Of the hands on their instruments, as far as these pass it on.
    pub(crate) of_hands_j: f64,
    /// Of the instruments on the tissue.
    pub(crate) on_tissue_j: f64,
}

/// What a step starts from.
#[derive(Debug)]
pub(crate) struct WorkMeter {
    positions_m: Vec<DVec3>,
    snapshot: Snapshot,
}

impl WorkMeter {
    pub(crate) fn new(world: &World) -> Self {
        Self { positions_m: world.state().positions_m.to_vec(), snapshot: world.snapshot() }
    }

    /// Before a step.
    pub(crate) fn look(&mut self, world: &World) {
        self.positions_m.clear();
        self.positions_m.extend_from_slice(world.state().positions_m);
        world.snapshot_into(&mut self.snapshot);
    }

    /// After the step with this input, which left the snapshot. Instruments that are put elsewhere do no work.
    pub(crate) fn add(&self, world: &World, input: &StepInput, after: &Snapshot, work: &mut Work) {
        let positions_m = world.state().positions_m;
        let on_node = |force: &glisson::model::NodalForce| {
            let n = force.node.index();
            force.force_n.dot(positions_m[n] - self.positions_m[n])
        };
        work.on_tissue_j += world.touch_forces().iter().map(on_node).sum::<f64>();
        let poses =
            self.snapshot.tools.iter().zip(&after.tools).map(|(before, after)| [&before.pose, &after.pose]);
        for (tool, [before, after]) in poses.enumerate().filter(|(tool, _)| !input.placed[*tool]) {
            let report = &world.report().tools[tool];
            let way_m = after.tip_in_world_m - before.tip_in_world_m;
            let [from, to] = [before, after].map(|pose| ToolFrame::of(pose).world_from_tool);
            let turn_rad = rotation_vector_rad(&(to * from.transpose()));
            work.of_hands_j -= report.force_on_tool_n.dot(way_m) + report.torque_on_tool_n_m.dot(turn_rad);
        }
    }
}
