//! The linear tensor-mass model (seed `003` ch. 3): explicit dynamics on vertices and edges.
//!
//! M u'' + C u' + K u = F (`model/explicit`), C = d M + b K. K lives as tensors on vertices and edges, accumulated from the
//! tetrahedra; the force that balances the deformation is f_p = B^pp u_p + sum over edges B^pj u_j.
//!
//! Removing a tetrahedron subtracts its tensors and masses; what is left without a tetrahedron becomes
//! exactly zero.
//!
//! A stress at rest S0 pulls on corner j of its tetrahedron with V S0 alpha_j, whatever the shape. A linear force
//! brings a tetrahedron back from every shape, also an inverted one: nothing is put in quarantine.

mod tensors;
pub(super) mod row;

pub use super::explicit::{
    ExplicitError as TensorMassError, ExplicitSnapshot as TensorMassSnapshot, MOST_NODES_PROVEN, StableStep,
};

pub(super) use tensors::VertexEdgeTensors;

use super::explicit::{
    Cuttable, ExplicitDynamics, ExplicitMotion, LiveTets, Quarantine, Stability, StiffTet, check_body,
    follow, keep, unpadded,
};
use super::local_model::{self, ElementStiffness, LocalBody, LocalElements, LocalFrame, TangentLaw};
use super::topology_update::{TopologyUpdate, blend_tets, grows};
use super::{DynamicBody, ModelUndo, RestStress, TopologyRefusal};
use crate::material::LinearElastic;
use crate::model::explicit::Mover;
use crate::solve::{P1Gradients, SolveError};
use glisson_mesh::math::{DMat3, DVec3};
use glisson_mesh::mesh::edit::TopologyChange;
use glisson_mesh::mesh::{NodeId, TetId, TetMesh};

/// What a tensor-mass model is made from.
#[derive(Clone, Copy, Debug)]
pub struct TensorMassParams<'a> {
    /// The body, its supports and loads. The step is at most `step_s` of [`TensorMass::stable_step`], less with
    /// ligaments and damping of the stiffness.
    pub body: DynamicBody<'a>,
    /// Lame's numbers; the density is the body's.
    pub material: &'a LinearElastic,
}

/// One organ moved by explicit dynamics.
#[derive(Clone, Debug)]
pub struct TensorMass {
    material: LinearElastic,
    motion: ExplicitMotion,

    // Mechanics, changed by edits only.
    tets: LiveTets,
    tensors: VertexEdgeTensors,
    /// One a tetrahedron, or none.
    rest_stress_pa: Vec<RestStress>,
}

impl TensorMass {
    /// The largest steps for a mesh of a material, and the tetrahedron that limits them.
    ///
    /// # Errors
    /// [`SolveError`] for an unusable mesh.
    pub fn stable_step(mesh: &TetMesh, material: &LinearElastic) -> Result<StableStep, SolveError> {
        StableStep::of(mesh, material)
    }

    /// Accumulates masses and tensors. The mesh must be compact: every tetrahedron of it counts as live.
    ///
    /// # Errors
    /// [`TensorMassError`]: an unusable mesh, a step above the stable one, impossible damping or gravity.
    pub fn build(params: &TensorMassParams<'_>) -> Result<Self, TensorMassError> {
        let TensorMassParams { body, material } = *params;
        check_body(&body)?;
        let mesh = body.mesh;
        let (lambda_pa, mu_pa) = (material.lambda_pa(), material.mu_pa());
        let tensors = VertexEdgeTensors::accumulate(mesh, |_, g| g.stiffness(lambda_pa, mu_pa))?;
        let stability = Stability::of_stiffness(mesh, body.density_kg_per_m3, |_, g| StiffTet {
            at_rest: g.stiffness(lambda_pa, mu_pa),
            stiffening: 1.0,
        })?;
        let strained_j = 0.5 * (lambda_pa + 2.0 * mu_pa) * mesh.volume_m3();
        let mut motion = ExplicitMotion::new(&body, stability, strained_j)?;
        for (t, stress_pa) in body.rest_stress_pa.iter().enumerate() {
            let gradients = P1Gradients::in_mesh(mesh, TetId::from_index(t));
            motion.add_rest_forces(mesh.tetrahedra[t], gradients.stress_forces_n(*stress_pa), 1.0);
        }
        Ok(Self {
            material: *material,
            motion,
            tets: LiveTets::of_mesh(mesh),
            tensors,
            rest_stress_pa: body.rest_stress_pa.to_vec(),
        })
    }

    /// Largest step [s] for which central differences are proven stable now: after the first removal the one
    /// that holds after any further ones.
    pub fn stable_step_s(&self) -> f64 {
        self.motion.stable_step_s()
    }

    /// Into how many equal parts a step of `dt_s` is divided now.
    pub fn parts_of_step(&self, dt_s: f64) -> u64 {
        self.motion.parts_of_step(dt_s)
    }

    /// Largest internal step [s] asked for; a longer [`DeformableModel::step`] is divided into equal parts.
    pub fn time_step_s(&self) -> f64 {
        self.motion.time_step_s()
    }

    /// The material.
    pub fn material(&self) -> &LinearElastic {
        &self.material
    }

    /// Mass [kg] of a node.
    pub fn mass_kg(&self, node: NodeId) -> f64 {
        self.motion.mass_kg(node)
    }

    /// Tensor B^pp [N/m] of a node.
    pub fn vertex_tensor_n_per_m(&self, node: NodeId) -> DMat3 {
        self.tensors.vertex(node)
    }

    /// Edges (lower node first, ascending) with their tensors B^pj [N/m]; edges left without a tetrahedron are
    /// among them, with a zero tensor, until the mesh is compacted.
    pub fn edge_tensors_n_per_m(&self) -> impl Iterator<Item = ([NodeId; 2], DMat3)> + '_ {
        self.tensors.edges()
    }

    /// Constraints of the last [`DeformableModel::apply`] that were left out: on nodes that do not exist, are
    /// fixed or have no tetrahedron, and values that are not finite.
    pub fn ignored_constraints(&self) -> usize {
        self.motion.ignored_constraints()
    }

    /// Constant force [N] that balances the stress at rest at a node.
    pub fn rest_force_n(&self, node: NodeId) -> DVec3 {
        self.motion.rest_force_n(node.index())
    }

    /// Holds a node where it is from now on: pre-stress, with nodes moved before (seed `003`, s. 3.2).
    pub fn fix_in_place(&mut self, node: NodeId) {
        self.motion.fix_in_place(node);
    }

    /// Other damping of the mass from the next step on [1/s]; what is not a finite number from 0 is left out.
    pub fn set_mass_damping(&mut self, mass_per_s: f64) {
        if mass_per_s.is_finite() && mass_per_s >= 0.0 {
            self.motion.set_mass_damping(mass_per_s);
        }
    }

    /// Back to the rest shape at standstill, without constraints. Removed tetrahedra stay removed, nodes that do not
    /// move stay where they are.
    pub fn reset(&mut self) {
        self.motion.reset();
    }

    /// The moving state, to come back to with [`TensorMass::restore`].
    pub fn snapshot(&self) -> TensorMassSnapshot {
        self.motion.snapshot()
    }

    /// Comes back to a state of the same mesh and removals; constraints stay as they are.
    ///
    /// # Panics
    /// When the snapshot has another number of nodes.
    pub fn restore(&mut self, snapshot: &TensorMassSnapshot) {
        self.motion.restore(snapshot);
    }

    /// Kinetic energy of the last half step plus elastic energy 1/2 u(t-h)^T K u(t) and that of the
    /// stress at rest [J]: the scheme keeps it
    /// constant to rounding without damping, outer forces and gravity.
    pub fn energy_j(&self) -> f64 {
        let (now, previous) = (self.motion.displacements(), self.motion.previous_displacements());
        let of_rest = |(n, (u, v)): (usize, (&[f64; 4], &[f64; 4]))| {
            0.5 * self.motion.rest_force_n(n).dot(unpadded(u) + unpadded(v))
        };
        let rest_j: f64 = now.iter().zip(previous).enumerate().map(of_rest).sum();
        self.motion.kinetic_energy_j() + self.tensors.energy_j(previous, now) + rest_j
    }
}

impl TensorMass {
    fn gradients(&self, t: usize) -> P1Gradients {
        self.tets.gradients(t, self.motion.rest_m())
    }
}

impl Cuttable for TensorMass {
    const NAME: &'static str = "tensor_mass";

    fn tets(&self) -> &LiveTets {
        &self.tets
    }

    fn tets_mut(&mut self) -> &mut LiveTets {
        &mut self.tets
    }

    fn rest_m(&self) -> &[DVec3] {
        self.motion.rest_m()
    }

    /// What is left without a tetrahedron becomes exactly zero; a node left alone stays where it is.
    fn remove_tet(&mut self, t: usize) {
        let nodes = self.tets.nodes[t];
        // The rest positions are those from when it was added, so these are the numbers that were added then.
        let gradients = self.gradients(t);
        let stiffness = gradients.stiffness(self.material.lambda_pa(), self.material.mu_pa());
        self.motion.remove_tet(nodes, gradients.volume_m3);
        if let Some(&stress_pa) = self.rest_stress_pa.get(t) {
            self.motion.add_rest_forces(nodes, gradients.stress_forces_n(stress_pa), -1.0);
        }
        self.tensors.subtract_tet(t, nodes, &stiffness, nodes.map(|n| self.motion.has_tets(n)));
    }

    fn after_removals(&mut self) {
        self.motion.after_removals(&self.tets);
    }

    fn grow(&mut self, mesh: &TetMesh, change: &TopologyChange, growth: &TopologyUpdate) {
        self.motion.grow(mesh, change, growth);
        self.tensors.grow(&self.tets, growth);
        blend_tets(&mut self.rest_stress_pa, change);
    }

    fn add_tet(&mut self, t: usize) {
        let nodes = self.tets.nodes[t];
        let gradients = self.gradients(t);
        let at_rest = gradients.stiffness(self.material.lambda_pa(), self.material.mu_pa());
        self.tensors.add_tet(t, nodes, &at_rest);
        self.motion.add_tet(t, nodes, gradients.volume_m3, &StiffTet { at_rest, stiffening: 1.0 });
        if let Some(&stress_pa) = self.rest_stress_pa.get(t) {
            self.motion.add_rest_forces(nodes, gradients.stress_forces_n(stress_pa), 1.0);
        }
    }

    fn after_growth(&mut self) {
        self.motion.after_growth(&self.tets);
    }

    fn compact(&mut self, new_ids: &[Option<NodeId>]) {
        let live_tets = &self.tets.is_live;
        self.motion.compact(new_ids, live_tets);
        self.tensors.compact(new_ids, live_tets);
        if !self.rest_stress_pa.is_empty() {
            keep(&mut self.rest_stress_pa, live_tets);
        }
    }
}

impl LocalBody for TensorMass {
    fn elements(&self) -> LocalElements<'_> {
        LocalElements::Tets(&self.tets.nodes)
    }

    fn is_live(&self, element: usize) -> bool {
        self.tets.is_live[element]
    }

    fn stiffness(&self, element: usize, _: f64) -> ElementStiffness {
        let gradients = self.gradients(element);
        let law = TangentLaw::Linear { lambda_pa: self.material.lambda_pa(), mu_pa: self.material.mu_pa() };
        local_model::tet_tangent(&gradients, [DVec3::ZERO; 4], &law, None)
    }

    fn frame(&self) -> &dyn LocalFrame {
        self.motion.frame()
    }

    fn velocity_m_per_s(&self, n: usize) -> DVec3 {
        self.motion.state().velocities_m_per_s[n]
    }
}

impl ExplicitDynamics for TensorMass {
    type Mover = ExplicitMotion;

    fn mover(&self) -> &ExplicitMotion {
        &self.motion
    }

    fn mover_mut(&mut self) -> &mut ExplicitMotion {
        &mut self.motion
    }

    fn advance(&mut self, dt_s: f64) {
        let tensors = &self.tensors;
        self.motion.step(dt_s, |u, force| {
            tensors.add_forces(u, force);
            Quarantine::default()
        });
    }

    fn follow_change(&mut self, mesh: &TetMesh, change: &TopologyChange) -> Result<(), TopologyRefusal> {
        follow(self, mesh, change)
    }

    /// Short for removals, which allocate nothing in buffers that were used before; else the whole model.
    fn save_before(&self, change: &TopologyChange, undo: &mut ModelUndo) {
        undo.clear();
        if grows(change) || change.is_renumbering() {
            undo.keep_whole(Box::new(self.clone()));
            return;
        }
        self.motion.save(undo);
        for t in change
            .tets
            .removed
            .iter()
            .map(|tet| tet.index())
            .filter(|&t| self.tets.is_live.get(t) == Some(&true))
        {
            undo.push_place(t);
            self.tensors.save_tet(t, self.tets.nodes[t], undo);
        }
    }

    fn put_back(&mut self, undo: &ModelUndo) {
        let mut from = undo.reader();
        self.motion.put_back(undo, &mut from);
        while from.has_places() {
            let t = from.place();
            self.tets.is_live[t] = true;
            self.tensors.put_tet_back(t, self.tets.nodes[t], &mut from);
        }
    }
}
