//! The motion of nodes: supports along single axes, masses, the factors of a step, and its input and output. Copies of a
//! kernel are here too.

use std::sync::RwLock;

use super::part::{ForceMode, Part, PartNodes, Parts, read};
use super::rows::{Row, Rows};
use super::step::{StepFactors, StepSums};
use super::{FastKernel, KernelLaw, KernelPath, padded};
use glisson_mesh::math::DVec3;
use glisson_mesh::mesh::NodeId;

/// Motion and inertia of a node.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct NodeMotion {
    /// Displacement u(t) [m].
    pub displacement_m: DVec3,
    /// u(t) - u(t - h) [m].
    pub increment_m: DVec3,
    /// Mass and added mass [kg].
    pub inertia_kg: f64,
}

impl PartNodes {
    /// Updates a node after a change of mass or support. A held axis stops.
    pub(super) fn update_inverse_mass(&mut self, n: usize) {
        let inertia_kg = self.inertia_kg(n);
        for axis in 0..3 {
            let moves = self.n_tets[n] > 0 && !self.is_held[n][axis];
            self.inverse_mass_per_kg[n][axis] = if moves { 1.0 / inertia_kg } else { 0.0 };
            self.moving_inertia_kg[n][axis] = if moves { inertia_kg } else { 0.0 };
            if !moves {
                self.increment_m[n][axis] = 0.0;
            }
        }
    }

    pub(super) fn inertia_kg(&self, n: usize) -> f64 {
        self.mass_kg[n] + self.added_mass_kg[n]
    }

    /// Displacements at which the elastic forces are taken.
    pub(super) fn strained_m(&self, leads: bool) -> &[Row] {
        if leads { &self.led_m } else { &self.displacement_m }
    }
}

impl Parts {
    /// Before the first phase of a step with stiffness damping.
    pub(super) fn lead(&self, p: usize) {
        let Some(lead) = read(&self.step).lead else { return };
        let PartNodes { displacement_m, increment_m, led_m, .. } = &mut *self.all[p].nodes_mut();
        for ((led, u), increment) in led_m.iter_mut().zip(displacement_m).zip(increment_m) {
            for i in 0..4 {
                led[i] = u[i] + lead * increment[i];
            }
        }
    }
}

impl Clone for Part {
    fn clone(&self) -> Self {
        Self {
            layout: RwLock::new(self.layout().clone()),
            elements: RwLock::new(self.elements().clone()),
            progress: RwLock::new(self.progress().clone()),
            nodes: RwLock::new(self.nodes().clone()),
            // Every computation fills them first.
            rows: RwLock::new(Rows::zero()),
        }
    }
}

impl Clone for Parts {
    fn clone(&self) -> Self {
        Self {
            law: self.law,
            laws: read(&self.laws).clone().into(),
            relaxation: self.relaxation.as_ref().map(|relaxation| read(relaxation).clone().into()),
            mode: (*read(&self.mode)).into(),
            path: self.path().into(),
            all: self.all.clone(),
            step: (*read(&self.step)).into(),
        }
    }
}

impl FastKernel {
    /// A body without nodes and tetrahedra, for when all are removed.
    pub fn empty(law: KernelLaw, path: KernelPath) -> Self {
        Self::of_parts(Parts {
            law,
            laws: Vec::new().into(),
            relaxation: None,
            mode: ForceMode::default().into(),
            path: path.into(),
            all: Vec::new(),
            step: StepFactors::default().into(),
        })
    }

    /// Holds a node at rest along some of x, y, z, and releases it along the others.
    pub fn hold_axes(&mut self, node: NodeId, is_held: [bool; 3]) {
        self.change_node(node, |nodes, n| {
            nodes.is_held[n] = is_held;
            nodes.update_inverse_mass(n);
        });
    }

    /// Sets the added mass [kg] of a node.
    pub fn set_added_mass(&mut self, node: NodeId, added_kg: f64) {
        self.change_node(node, |nodes, n| {
            nodes.added_mass_kg[n] = added_kg;
            nodes.update_inverse_mass(n);
        });
    }

    /// Sets what the last step added to a node's displacement [m]: its velocity. A held axis keeps it until the
    /// next step only, for stiffness damping.
    pub fn set_increment(&mut self, node: NodeId, increment_m: DVec3) {
        self.change_node(node, |nodes, n| nodes.increment_m[n] = padded(increment_m));
    }

    fn change_node(&self, node: NodeId, change: impl FnOnce(&mut PartNodes, usize)) {
        if let Some((part, n)) = self.place(node) {
            change(&mut part.nodes_mut(), n);
        }
    }

    fn row(&self, node: NodeId, of: impl Fn(&PartNodes) -> &Vec<Row>) -> DVec3 {
        self.place(node).map_or(DVec3::ZERO, |(part, n)| unpadded(&of(&part.nodes())[n]))
    }

    /// Displacement [m] of a node.
    pub fn displacement_m(&self, node: NodeId) -> DVec3 {
        self.row(node, |nodes| &nodes.displacement_m)
    }

    /// What the last step added to a node's displacement [m].
    pub fn increment_m(&self, node: NodeId) -> DVec3 {
        self.row(node, |nodes| &nodes.increment_m)
    }

    /// Force [N] that balances the deformation on a node, of the last computation or step.
    pub fn force_n(&self, node: NodeId) -> DVec3 {
        self.row(node, |nodes| &nodes.force_n)
    }

    /// Force [N] from outside on a node.
    pub fn outer_force_n(&self, node: NodeId) -> DVec3 {
        self.row(node, |nodes| &nodes.outer_n)
    }

    /// Mass and added mass [kg] of a node.
    pub fn inertia_kg(&self, node: NodeId) -> f64 {
        self.place(node).map_or(0.0, |(part, n)| part.nodes().inertia_kg(n))
    }

    /// Whether a node has a tetrahedron left.
    pub fn has_tets(&self, node: NodeId) -> bool {
        self.place(node).is_some_and(|(part, n)| part.nodes().n_tets[n] > 0)
    }

    /// Stiffness part of Rayleigh damping, beta [s]: forces are taken at u + beta v with the velocity v of the last
    /// half step, from the next step on.
    pub fn set_stiffness_damping(&mut self, stiffness_damping_s: f64) {
        self.stiffness_damping_s = stiffness_damping_s;
        for part in &self.parts.all {
            let nodes = &mut *part.nodes_mut();
            nodes.led_m.resize(nodes.displacement_m.len(), [0.0; 4]);
        }
    }

    /// Length [s] of the last step: increments over it are velocities.
    pub fn last_step_s(&self) -> Option<f64> {
        self.last_step_s
    }

    /// Sets the length [s] that the increments belong to.
    pub fn set_last_step_s(&mut self, last_step_s: Option<f64>) {
        self.last_step_s = last_step_s;
    }

    /// Updates every node that has or had a tetrahedron.
    pub fn for_each_node(&self, mut tell: impl FnMut(NodeId, NodeMotion)) {
        for part in &self.parts.all {
            let nodes = part.nodes();
            for (n, &node) in part.layout().own.iter().enumerate() {
                let motion = NodeMotion {
                    displacement_m: unpadded(&nodes.displacement_m[n]),
                    increment_m: unpadded(&nodes.increment_m[n]),
                    inertia_kg: nodes.inertia_kg(n),
                };
                tell(node, motion);
            }
        }
    }

    /// Report on the last step; the sums do not depend on the number of threads.
    pub fn step_sums(&self) -> StepSums {
        self.parts.all.iter().map(|part| part.nodes().sums).fold(StepSums::default(), |sum, part| StepSums {
            kinetic_before_j: sum.kinetic_before_j + part.kinetic_before_j,
            kinetic_after_j: sum.kinetic_after_j + part.kinetic_after_j,
            outer_work_j: sum.outer_work_j + part.outer_work_j,
            n_recovered: sum.n_recovered + part.n_recovered,
        })
    }

    /// Limits what the last step added to each node's displacement to the length `most_m`; returns whether any was longer.
    pub fn limit_last_increments(&mut self, most_m: f64) -> bool {
        let mut is_any_longer = false;
        for part in &self.parts.all {
            let PartNodes { displacement_m, increment_m, .. } = &mut *part.nodes_mut();
            for (u, increment) in displacement_m.iter_mut().zip(increment_m) {
                let length_m = unpadded(increment).length();
                if length_m > most_m {
                    is_any_longer = true;
                    scale_increment(u, increment, most_m / length_m);
                }
            }
        }
        is_any_longer
    }

    /// Scales what the last step added to the displacements, as for a step shorter by this factor.
    pub fn scale_last_increments(&mut self, factor: f64) {
        for part in &self.parts.all {
            let PartNodes { displacement_m, increment_m, .. } = &mut *part.nodes_mut();
            for (u, increment) in displacement_m.iter_mut().zip(increment_m) {
                scale_increment(u, increment, factor);
            }
        }
    }
}

fn scale_increment(displacement_m: &mut Row, increment_m: &mut Row, factor: f64) {
    for i in 0..3 {
        let scaled = factor * increment_m[i];
        displacement_m[i] += scaled - increment_m[i];
        increment_m[i] = scaled;
    }
}

fn unpadded(row: &Row) -> DVec3 {
    DVec3::new(row[0], row[1], row[2])
}
