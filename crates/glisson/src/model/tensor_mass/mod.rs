//! The linear tensor-mass model (seed `003` ch. 3): explicit dynamics on vertices and edges.
//!
//! M u'' + C u' + K u = F (`model/explicit`). K lives as tensors on vertices and edges, accumulated from the
//! tetrahedra; the force that balances the deformation is f_p = B^pp u_p + sum over edges B^pj u_j.
//!
//! Removing a tetrahedron subtracts its tensors and masses; what is left without a tetrahedron becomes
//! exactly zero.

mod tensors;

pub use super::explicit::{
    ExplicitError as TensorMassError, ExplicitSnapshot as TensorMassSnapshot, MOST_NODES_PROVEN, StableStep,
};

pub(super) use tensors::VertexEdgeTensors;

use super::explicit::{ExplicitMotion, ExplicitParams, follows, keep};
use super::{Constraints, DeformableModel, ModelState, TopologyRefusal};
use crate::material::LinearElastic;
use crate::math::{DMat3, DVec3};
use crate::mesh::edit::TopologyChange;
use crate::mesh::{NodeId, TetId, TetMesh};
use crate::solve::{P1Gradients, SolveError};

/// What a tensor-mass model is made from.
#[derive(Clone, Copy, Debug)]
pub struct TensorMassParams<'a> {
    /// The body at rest.
    pub mesh: &'a TetMesh,
    /// Its material; the density makes the masses.
    pub material: &'a LinearElastic,
    /// Nodes that never move.
    pub fixed_nodes: &'a [NodeId],
    /// Damping over mass, d [1/s]: a free motion decays as exp(-d t/2).
    pub damping_per_s: f64,
    /// Gravity [m/s2]; zero where the rest shape already carries it.
    pub gravity_m_per_s2: DVec3,
    /// Largest internal step [s]; at most `step_s` of [`TensorMass::stable_step`].
    pub time_step_s: f64,
}

/// One organ moved by explicit dynamics.
#[derive(Clone, Debug)]
pub struct TensorMass {
    material: LinearElastic,
    motion: ExplicitMotion,

    // Mechanics, changed by removals only.
    tet_nodes: Vec<[NodeId; 4]>,
    tet_is_live: Vec<bool>,
    tensors: VertexEdgeTensors,
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
        let TensorMassParams { mesh, material, fixed_nodes, damping_per_s, gravity_m_per_s2, time_step_s } =
            *params;
        let density_kg_per_m3 = material.density_kg_per_m3();
        let motion_params = ExplicitParams {
            mesh,
            density_kg_per_m3,
            fixed_nodes,
            damping_per_s,
            gravity_m_per_s2,
            time_step_s,
        };
        motion_params.check()?;
        let (lambda_pa, mu_pa) = (material.lambda_pa(), material.mu_pa());
        let tensors = VertexEdgeTensors::accumulate(mesh, |_, g| g.stiffness(lambda_pa, mu_pa))?;
        let motion = ExplicitMotion::new(&motion_params, StableStep::of(mesh, material)?)?;
        Ok(Self {
            material: *material,
            motion,
            tet_nodes: mesh.tetrahedra.clone(),
            tet_is_live: vec![true; mesh.tetrahedra.len()],
            tensors,
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

    /// Back to the rest shape at standstill, without constraints. Removed tetrahedra stay removed.
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

    /// Kinetic energy of the last half step plus elastic energy 1/2 u(t-h)^T K u(t) [J]: the scheme keeps it
    /// constant to rounding without damping, outer forces and gravity.
    pub fn energy_j(&self) -> f64 {
        let (now, previous) = (self.motion.displacements(), self.motion.previous_displacements());
        self.motion.kinetic_energy_j() + self.tensors.energy_j(previous, now)
    }

    /// Takes one live tetrahedron out. What is left without a tetrahedron becomes exactly zero; a node left
    /// alone stays where it is.
    fn remove_tet(&mut self, tet: TetId) {
        let t = tet.index();
        self.tet_is_live[t] = false;
        let nodes = self.tet_nodes[t];
        // The rest positions are those of the build, so these are the numbers that were added then.
        let gradients = P1Gradients::new(nodes.map(|n| self.motion.rest_m(n)));
        let stiffness = gradients.stiffness(self.material.lambda_pa(), self.material.mu_pa());
        self.motion.remove_tet(nodes, gradients.volume_m3);
        self.tensors.subtract_tet(t, nodes, &stiffness, nodes.map(|n| self.motion.has_tets(n)));
    }

    /// Drops dead entities; the order of the others stays. Constraints are dropped with their node numbers.
    fn compact(&mut self, new_ids: &[Option<NodeId>]) {
        self.motion.compact(new_ids);
        let live_tets = std::mem::take(&mut self.tet_is_live);
        self.tensors.compact(new_ids, &live_tets);
        keep(&mut self.tet_nodes, &live_tets);
        for node in self.tet_nodes.iter_mut().flatten() {
            *node = new_ids[node.index()].expect("what is live has live nodes");
        }
        self.tet_is_live = vec![true; self.tet_nodes.len()];
    }
}

impl DeformableModel for TensorMass {
    fn apply(&mut self, constraints: &Constraints) {
        self.motion.apply(constraints);
    }

    /// Advances by `dt_s` in the fewest equal parts that are not longer than [`TensorMass::time_step_s`] and
    /// [`TensorMass::stable_step_s`].
    /// Held nodes move evenly to where they are held; the constraint force is the one that balances them at
    /// the last part: elastic force and weight, without the held node's own inertia.
    fn step(&mut self, dt_s: f64) {
        let tensors = &self.tensors;
        self.motion.step(dt_s, |u, force| tensors.add_forces(u, force));
    }

    fn state(&self) -> ModelState<'_> {
        self.motion.state()
    }

    fn constraint_forces_n(&self) -> &[DVec3] {
        self.motion.constraint_forces_n()
    }

    fn take_over(&mut self, positions_m: &[DVec3]) {
        self.motion.take_over(positions_m);
    }

    /// Follows removals, which allocate nothing, and compactions, which do.
    fn duplicate(&self) -> Box<dyn DeformableModel> {
        Box::new(self.clone())
    }

    fn topology_changed(&mut self, _: &TetMesh, change: &TopologyChange) -> Result<(), TopologyRefusal> {
        follows("tensor_mass", change)?;
        assert_eq!(change.tets.n_before, self.tet_nodes.len(), "the model missed a change of the mesh");
        assert_eq!(change.nodes.n_before, self.motion.n_nodes(), "the model missed a change of the mesh");
        for &tet in &change.tets.removed {
            if self.tet_is_live[tet.index()] {
                self.remove_tet(tet);
            }
        }
        if !change.nodes.new_ids.is_empty() || !change.tets.new_ids.is_empty() {
            self.compact(&change.nodes.new_ids);
        }
        Ok(())
    }
}
