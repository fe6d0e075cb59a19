//! One body of a composite model, with what a step of it needs.

use super::super::bounded_vec::BoundedVec;
use super::super::{
    Answered, Constraints, Correction, DeformableModel, ImposedDisplacement, NodalForce, StepAnswer,
};
use glisson_mesh::math::DVec3;
use glisson_mesh::mesh::{NodeId, TetMesh};

/// A body's model and its share of what comes from outside; all numbers are the body's own.
pub(super) struct Part {
    pub(super) model: Box<dyn DeformableModel>,
    pub(super) has_clock: bool,
    /// Whether what was saved last for an undo is short: then the model has to follow that edit, also where it does not touch
    /// the body, so that it can be undone.
    pub(super) follows_all: bool,
    pub(super) constraints: Constraints,
    /// Length of the step under way [s].
    pub(super) dt_s: f64,
    /// Forces that a contact asks about or corrects the step by.
    pub(super) forces: BoundedVec<NodalForce>,
    /// How the nodes answer to them [m]; places and velocities when another model is taken over.
    pub(super) moves_m: Vec<DVec3>,
    pub(super) velocities_m_per_s: Vec<DVec3>,
    /// With forces added to the constraints: for models that answer by another step.
    loaded: Constraints,
    /// The body's mesh, made anew at each edit of it.
    pub(super) mesh: TetMesh,
}

/// Displacements imposed on a body in a step at most, for which room is kept; more are rare, and make room.
const IMPOSED: usize = 128;

impl Part {
    pub(super) fn new(model: Box<dyn DeformableModel>, has_clock: bool) -> Self {
        let mut part = Self {
            model,
            has_clock,
            follows_all: false,
            constraints: Constraints::default(),
            dt_s: 0.0,
            forces: BoundedVec::with_capacity(0),
            moves_m: Vec::new(),
            velocities_m_per_s: Vec::new(),
            loaded: Constraints::default(),
            mesh: TetMesh::default(),
        };
        part.make_room();
        part
    }

    /// Room for the forces on all nodes.
    pub(super) fn make_room(&mut self) {
        let n_nodes = self.n_nodes();
        for constraints in [&mut self.constraints, &mut self.loaded] {
            let n_forces = constraints.forces.len();
            constraints.forces.reserve(n_nodes.saturating_sub(n_forces));
            let n_imposed = constraints.displacements.len();
            constraints.displacements.reserve(IMPOSED.saturating_sub(n_imposed));
        }
        self.forces.make_room(n_nodes);
        self.moves_m.resize(n_nodes, DVec3::ZERO);
        self.velocities_m_per_s.resize(n_nodes, DVec3::ZERO);
    }

    pub(super) fn duplicate(&self) -> Self {
        let mut copy = Self::new(self.model.duplicate(), self.has_clock);
        copy.constraints.forces.extend_from_slice(&self.constraints.forces);
        copy.constraints.displacements.extend_from_slice(&self.constraints.displacements);
        copy.dt_s = self.dt_s;
        copy
    }

    pub(super) fn n_nodes(&self) -> usize {
        self.model.state().positions_m.len()
    }

    pub(super) fn impose(&mut self, local: u32, displacement_m: DVec3) {
        self.constraints.displacements.push(ImposedDisplacement { node: NodeId(local), displacement_m });
    }

    /// How the nodes answer to the forces asked about, in `moves_m`.
    pub(super) fn answer(&mut self, at: Answered) {
        let Self { model, forces, moves_m, dt_s, .. } = self;
        match model.step_answer() {
            _ if forces.is_empty() => moves_m.fill(DVec3::ZERO),
            StepAnswer::NodeByNode => {
                moves_m.fill(DVec3::ZERO);
                for force in forces.iter() {
                    let answer_m_per_n = model.node_answer_m_per_n(force.node, *dt_s);
                    moves_m[force.node.index()] = answer_m_per_n * force.force_n;
                }
            }
            StepAnswer::Coupled { .. } => model.answer_into(forces, moves_m, at),
            StepAnswer::Static => self.answer_by_steps(),
            StepAnswer::Unknown => moves_m.fill(DVec3::ZERO),
        }
    }

    /// A quasi-static model tells by another step under the forces, and comes back by one without them.
    fn answer_by_steps(&mut self) {
        self.add_forces();
        for (move_m, now_m) in self.moves_m.iter_mut().zip(self.model.state().positions_m) {
            *move_m = -*now_m;
        }
        self.model.apply(&self.loaded);
        self.model.step(self.dt_s);
        for (move_m, now_m) in self.moves_m.iter_mut().zip(self.model.state().positions_m) {
            *move_m += *now_m;
        }
        self.model.apply(&self.constraints);
        self.model.step(self.dt_s);
    }

    /// Corrects the last step by the forces.
    pub(super) fn correct(&mut self, dt_s: f64, correction: Correction) {
        if self.forces.is_empty() {
            return;
        }
        match self.model.step_answer() {
            StepAnswer::NodeByNode | StepAnswer::Coupled { .. } => {
                self.model.correct_step(&self.forces, dt_s, correction);
            }
            StepAnswer::Static => {
                self.add_forces();
                std::mem::swap(&mut self.constraints, &mut self.loaded);
                self.model.apply(&self.constraints);
                self.model.step(dt_s);
            }
            StepAnswer::Unknown => {}
        }
    }

    /// The constraints with the forces, both ascending by node, in `loaded`.
    fn add_forces(&mut self) {
        let Self { constraints, loaded, forces, .. } = self;
        loaded.displacements.clear();
        loaded.displacements.extend_from_slice(&constraints.displacements);
        loaded.forces.clear();
        let mut before = constraints.forces.iter().copied().peekable();
        for &NodalForce { node, force_n } in forces.iter() {
            while let Some(earlier) = before.next_if(|f| f.node < node) {
                loaded.forces.push(earlier);
            }
            let also_n = before.next_if(|f| f.node == node).map_or(DVec3::ZERO, |f| f.force_n);
            loaded.forces.push(NodalForce { node, force_n: force_n + also_n });
        }
        loaded.forces.extend(before);
    }
}
