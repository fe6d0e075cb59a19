//! The non-linear tensor-mass model (seeds `002` and `004`, Picinbono, Delingette and Ayache 2000): St
//! Venant-Kirchhoff elasticity, exact for large displacements, with transverse isotropy and a penalty of volume
//! changes.
//!
//! Energy density W = lambda/2 (tr E)^2 + mu tr(E^2) + kappa (a . E a)^2 of the Green-St Venant strain
//! E = (grad u + grad u^T + grad u^T grad u)/2 ([`TetLaw`]): a polynomial of order four in the nodes'
//! displacements, whose coefficients are accumulated on vertices, edges, triangles and tetrahedra (`law`,
//! `numbers`). The force is summed by a traversal of these (`forces`). This is the reference for faster models of
//! the same physics: clear before fast. [`DirectBody`] computes the same from the definition.
//!
//! Valid for rotations and displacements of any size and moderate strains: under compression below about
//! 1/sqrt(3) of its length St Venant-Kirchhoff tissue softens and can turn inside out; the penalty holds against
//! that. An inverted tetrahedron is left out of the forces, but for the penalty, until it is upright again.
//! The polynomial is in displacements from the rest shape, so a rigid motion of many body sizes loses digits
//! (forces as its cube, energies as its fourth power, over the strain).
//!
//! A stress at rest S0 makes P = F (S + S0): its constant part is a force V S0 alpha_j on corner j, its linear part
//! adds V (alpha_j . S0 alpha_k) Id to B_jk.
//!
//! Explicit dynamics as in [`super::tensor_mass`]. Removing a tetrahedron subtracts its numbers (280, seed `002`,
//! appendix A) and masses; what is left without a tetrahedron becomes exactly zero.

mod adaptive;
mod body;
mod direct;
mod forces;
mod incompressibility;
mod numbers;
mod tearing;
pub(super) mod row;

pub use super::tet_law::{Fibre, FibreError, TetLaw};
pub use adaptive::{AdaptiveReport, NonlinearPart};
pub use direct::DirectBody;
pub use forces::OperationCounts;
pub use numbers::{EdgeStiffness, TetScalars, TriangleStiffness, VertexStiffness};

use self::adaptive::Adaptivity;
use self::body::Body;
use super::explicit::{
    Cuttable, ExplicitDynamics, ExplicitError, ExplicitMotion, ExplicitSnapshot, LiveTets, Padded, Stability,
    StableStep, StiffTet, check_body, follow, padded, unpadded,
};
use super::local_model::{self, ElementStiffness, LocalBody, LocalElements, LocalFrame, TangentLaw};
use super::tet_law::stressed_stiffness;
use super::topology_update::TopologyUpdate;
use super::{DynamicBody, LevelOfDetail, RestStress, TopologyRefusal};
use crate::material::{GuardedStVenantKirchhoff, LinearElastic, SQUEEZED_J};
use crate::model::explicit::Mover;
use crate::solve::SolveError;
use glisson_mesh::math::{DMat3, DVec3, tetrahedron_volume_m3};
use glisson_mesh::mesh::edit::TopologyChange;
use glisson_mesh::mesh::{NodeId, TetId, TetMesh};

/// Why there is no non-linear tensor-mass model.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum NonlinearTensorMassError {
    /// The mesh, the time step, damping or gravity.
    #[error(transparent)]
    Explicit(#[from] ExplicitError),
    /// The fibres.
    #[error(transparent)]
    Fibre(#[from] FibreError),
}

impl From<SolveError> for NonlinearTensorMassError {
    fn from(error: SolveError) -> Self {
        Self::Explicit(error.into())
    }
}

/// What resists in a body: the elastic part of [`NonlinearTensorMassParams`].
#[derive(Clone, Copy, Debug)]
pub struct NonlinearElasticity<'a> {
    /// lambda, mu and density.
    pub material: &'a LinearElastic,
    /// None, or one a tetrahedron: stiffness along a direction.
    pub fibres: &'a [Fibre],
    /// gamma of the volume penalty [Pa]; from 0, which is none.
    pub volume_penalty_pa: f64,
    /// The stable step holds while all principal stretches stay within [1/s, s] for this s, from 1: St
    /// Venant-Kirchhoff tissue stiffens as it is stretched.
    pub largest_stretch: f64,
}

/// What a non-linear tensor-mass model is made from.
#[derive(Clone, Copy, Debug)]
pub struct NonlinearTensorMassParams<'a> {
    /// The body, its supports and loads. The step is at most `step_s` of [`NonlinearTensorMass::stable_step`], less with
    /// ligaments, tension at rest and damping of the stiffness.
    pub body: DynamicBody<'a>,
    /// What resists; the density is the body's.
    pub elasticity: NonlinearElasticity<'a>,
}

/// One organ moved by explicit dynamics with St Venant-Kirchhoff forces.
#[derive(Clone, Debug)]
pub struct NonlinearTensorMass {
    motion: ExplicitMotion,
    body: Body,
    adaptivity: Adaptivity,
    /// For which the step is made.
    largest_stretch: f64,
}

impl NonlinearElasticity<'_> {
    /// The law of each of `n_tets` tetrahedra.
    ///
    /// # Errors
    /// [`NonlinearTensorMassError`] for impossible fibres, penalty or stretch.
    pub fn laws(&self, n_tets: usize) -> Result<Vec<TetLaw>, NonlinearTensorMassError> {
        let parameter = |what, found, allowed| Err(ExplicitError::Parameter { what, found, allowed }.into());
        if !(self.volume_penalty_pa.is_finite() && self.volume_penalty_pa >= 0.0) {
            return parameter("volume penalty [Pa]", self.volume_penalty_pa, "a finite number from 0");
        }
        if !(self.largest_stretch.is_finite() && self.largest_stretch >= 1.0) {
            return parameter("largest stretch", self.largest_stretch, "a finite number from 1");
        }
        if self.fibres.is_empty() {
            return Ok(vec![TetLaw::isotropic(self.material); n_tets]);
        }
        if self.fibres.len() != n_tets {
            return Err(FibreError::Count { n_fibres: self.fibres.len(), n_tets }.into());
        }
        let with_fibre = |(t, fibre)| TetLaw::with_fibre(self.material, fibre, TetId::from_index(t));
        Ok(self.fibres.iter().enumerate().map(with_fibre).collect::<Result<_, FibreError>>()?)
    }
}

/// The stable steps of a body with a stress at rest.
fn stability(
    mesh: &TetMesh,
    density_kg_per_m3: f64,
    elasticity: &NonlinearElasticity<'_>,
    laws: &[TetLaw],
    rest_stress_pa: &[RestStress],
) -> Result<Stability, SolveError> {
    Stability::of_stiffness(mesh, density_kg_per_m3, |tet, gradients| {
        let law = &laws[tet.index()];
        StiffTet {
            at_rest: stressed_stiffness(law, gradients, rest_stress_pa.get(tet.index())),
            stiffening: law.stiffening(elasticity.largest_stretch, elasticity.volume_penalty_pa),
        }
    })
}

impl NonlinearTensorMass {
    /// The largest steps for a body, and the tetrahedron that limits them. The one after cuts is a bound for every
    /// shape within the largest stretch; the uncut one an estimate, exact at rest.
    ///
    /// # Errors
    /// [`NonlinearTensorMassError`] for an unusable mesh or impossible elasticity.
    pub fn stable_step(
        mesh: &TetMesh,
        elasticity: &NonlinearElasticity<'_>,
    ) -> Result<StableStep, NonlinearTensorMassError> {
        let laws = elasticity.laws(mesh.tetrahedra.len())?;
        let density_kg_per_m3 = elasticity.material.density_kg_per_m3();
        Ok(stability(mesh, density_kg_per_m3, elasticity, &laws, &[])?.step)
    }

    /// Accumulates masses and stiffness numbers. The mesh must be compact: every tetrahedron of it counts as live.
    ///
    /// # Errors
    /// [`NonlinearTensorMassError`]: an unusable mesh, a step above the stable one, impossible parameters.
    pub fn build(params: &NonlinearTensorMassParams<'_>) -> Result<Self, NonlinearTensorMassError> {
        let NonlinearTensorMassParams { body: frame, elasticity } = *params;
        check_body(&frame)?;
        let (mesh, rest_stress_pa) = (frame.mesh, frame.rest_stress_pa);
        let laws = elasticity.laws(mesh.tetrahedra.len())?;
        let stability = stability(mesh, frame.density_kg_per_m3, &elasticity, &laws, rest_stress_pa)?;
        let body = Body::accumulate(mesh, laws, elasticity.volume_penalty_pa, rest_stress_pa)?;
        let mut motion = ExplicitMotion::new(&frame, stability, body.full_strain_energy_j())?;
        for (t, stress_pa) in rest_stress_pa.iter().enumerate() {
            let force_n = body.gradients[t].stress_forces_n(*stress_pa);
            motion.add_rest_forces(mesh.tetrahedra[t], force_n, 1.0);
        }
        let adaptivity = Adaptivity::new(mesh.positions_m.len());
        Ok(Self { motion, body, adaptivity, largest_stretch: elasticity.largest_stretch })
    }

    /// Where the non-linear part is computed from now on.
    pub fn set_nonlinear_part(&mut self, part: NonlinearPart) {
        self.adaptivity.part = part;
    }

    /// What the last force evaluation left out: in the last part of the last step.
    pub fn adaptive_report(&self) -> AdaptiveReport {
        self.adaptivity.report
    }

    /// Nodes that got their non-linear force in the last evaluation.
    pub fn is_nonlinear(&self, node: NodeId) -> bool {
        self.adaptivity.part == NonlinearPart::Everywhere || self.adaptivity.is_nonlinear[node.index()]
    }

    /// Overwrites `force_n` with the forces [N] that balance displacements [m], both one a node, by the
    /// non-linear part that is set, with the stress at rest and without quarantine. For checks: allocates, which a step does not.
    pub fn elastic_forces_into(&mut self, displacement_m: &[DVec3], force_n: &mut [DVec3]) {
        let u: Vec<Padded> = displacement_m.iter().copied().map(padded).collect();
        let mut force = vec![[0.0; 4]; u.len()];
        self.body.add_forces(&mut self.adaptivity, &u, &mut force);
        for (n, (out, f)) in force_n.iter_mut().zip(&force).enumerate() {
            *out = unpadded(f) + self.motion.rest_force_n(n);
        }
    }

    /// Elastic energy [J] at displacements [m], one a node, of the full model, the penalty's included. Allocates.
    pub fn elastic_energy_at_j(&self, displacement_m: &[DVec3]) -> f64 {
        let u: Vec<Padded> = displacement_m.iter().copied().map(padded).collect();
        self.energy_of_j(&u)
    }

    /// With the constant forces of the stress at rest, whose energy is zero at rest.
    fn energy_of_j(&self, u: &[Padded]) -> f64 {
        let of_rest = |(n, u): (usize, &Padded)| self.motion.rest_force_n(n).dot(unpadded(u));
        self.body.energy_j(u) + u.iter().enumerate().map(of_rest).sum::<f64>()
    }

    /// Elastic energy now [J], of the full model, the penalty's included.
    pub fn elastic_energy_j(&self) -> f64 {
        self.energy_of_j(self.motion.displacements())
    }

    /// Kinetic energy of the last half step plus the mean of the elastic energies before and after it [J]. The
    /// scheme keeps it near its start without damping, outer forces and gravity.
    pub fn energy_j(&self) -> f64 {
        let before_j = self.energy_of_j(self.motion.previous_displacements());
        self.motion.kinetic_energy_j() + 0.5 * (before_j + self.elastic_energy_j())
    }

    /// Operations of one evaluation of the full force, removed entities included until the mesh is compacted.
    pub fn operation_counts(&self) -> OperationCounts {
        let nonlinear = &self.body.nonlinear;
        OperationCounts::of_counts([
            nonlinear.vertex.len(),
            nonlinear.edge.len(),
            nonlinear.triangle.len(),
            nonlinear.tet.len(),
        ])
    }

    /// Largest step [s] that is stable now: after the first removal the one that holds after any further ones.
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

    /// Mass [kg] of a node.
    pub fn mass_kg(&self, node: NodeId) -> f64 {
        self.motion.mass_kg(node)
    }

    /// Tensor B^pp [N/m] and the non-linear numbers of a node.
    pub fn vertex_stiffness(&self, node: NodeId) -> (DMat3, VertexStiffness) {
        (self.body.linear.vertex(node), self.body.nonlinear.vertex[node.index()])
    }

    /// Edges (lower node first, ascending) with tensor B^pj [N/m] and non-linear numbers; edges left without a
    /// tetrahedron are among them, all zero, until the mesh is compacted.
    pub fn edge_stiffness(&self) -> impl Iterator<Item = ([NodeId; 2], DMat3, EdgeStiffness)> + '_ {
        self.body
            .linear
            .edges()
            .zip(&self.body.nonlinear.edge)
            .map(|((nodes, b), numbers)| (nodes, b, *numbers))
    }

    /// Triangles (nodes ascending) with their numbers; dead ones as with [`NonlinearTensorMass::edge_stiffness`].
    pub fn triangle_stiffness(&self) -> impl Iterator<Item = ([NodeId; 3], TriangleStiffness)> + '_ {
        let nonlinear = &self.body.nonlinear;
        nonlinear.triangles.nodes.iter().copied().zip(nonlinear.triangle.iter().copied())
    }

    /// Numbers of a tetrahedron; zero for one that was removed.
    pub fn tet_scalars(&self, tet: TetId) -> TetScalars {
        self.body.nonlinear.tet[tet.index()]
    }

    /// The law of a tetrahedron.
    pub fn law(&self, tet: TetId) -> &TetLaw {
        &self.body.laws[tet.index()]
    }

    /// Constraints of the last [`DeformableModel::apply`] that were left out: on nodes that do not exist, are
    /// fixed or have no tetrahedron, and values that are not finite.
    pub fn ignored_constraints(&self) -> usize {
        self.motion.ignored_constraints()
    }

    /// Holds a node where it is from now on: pre-stress, with nodes moved before (seed `003`, s. 3.2).
    pub fn fix_in_place(&mut self, node: NodeId) {
        self.motion.fix_in_place(node);
    }

    /// Back to the rest shape at standstill, without constraints. Removed tetrahedra stay removed, nodes that do not
    /// move stay where they are.
    pub fn reset(&mut self) {
        self.motion.reset();
    }

    /// The moving state, to come back to with [`NonlinearTensorMass::restore`].
    pub fn snapshot(&self) -> ExplicitSnapshot {
        self.motion.snapshot()
    }

    /// Comes back to a state of the same mesh and removals; constraints stay as they are.
    ///
    /// # Panics
    /// When the snapshot has another number of nodes.
    pub fn restore(&mut self, snapshot: &ExplicitSnapshot) {
        self.motion.restore(snapshot);
    }
}

impl Cuttable for NonlinearTensorMass {
    const NAME: &'static str = "nonlinear_tensor_mass";

    fn tets(&self) -> &LiveTets {
        &self.body.tets
    }

    fn tets_mut(&mut self) -> &mut LiveTets {
        &mut self.body.tets
    }

    fn rest_m(&self) -> &[DVec3] {
        self.motion.rest_m()
    }

    fn remove_tet(&mut self, t: usize) {
        let (nodes, gradients) = (self.body.tets.nodes[t], self.body.gradients[t]);
        self.motion.remove_tet(nodes, gradients.volume_m3);
        if let Some(&stress_pa) = self.body.rest_stress_pa.get(t) {
            self.motion.add_rest_forces(nodes, gradients.stress_forces_n(stress_pa), -1.0);
        }
        self.body.remove_tet(t, nodes.map(|n| self.motion.has_tets(n)));
    }

    fn after_removals(&mut self) {
        self.motion.after_removals(&self.body.tets);
    }

    fn grow(&mut self, mesh: &TetMesh, change: &TopologyChange, growth: &TopologyUpdate) {
        self.motion.grow(mesh, change, growth);
        self.body.grow(mesh, change, growth);
        self.adaptivity.resize(growth.n_nodes);
    }

    fn add_tet(&mut self, t: usize) {
        self.body.add_tet(t);
        let body = &self.body;
        let (nodes, gradients, law) = (body.tets.nodes[t], body.gradients[t], &body.laws[t]);
        let rest_stress_pa = body.rest_stress_pa.get(t);
        let stiff = StiffTet {
            at_rest: stressed_stiffness(law, &gradients, rest_stress_pa),
            stiffening: law.stiffening(self.largest_stretch, body.volume_penalty_pa),
        };
        self.motion.add_tet(t, nodes, gradients.volume_m3, &stiff);
        if let Some(&stress_pa) = rest_stress_pa {
            self.motion.add_rest_forces(nodes, gradients.stress_forces_n(stress_pa), 1.0);
        }
    }

    fn after_growth(&mut self) {
        self.motion.after_growth(&self.body.tets);
    }

    fn compact(&mut self, new_ids: &[Option<NodeId>]) {
        self.motion.compact(new_ids, &self.body.tets.is_live);
        self.body.compact(new_ids);
        self.adaptivity.resize(self.motion.n_nodes());
    }
}

impl LocalBody for NonlinearTensorMass {
    fn elements(&self) -> LocalElements<'_> {
        LocalElements::Tets(&self.body.tets.nodes)
    }

    fn is_live(&self, element: usize) -> bool {
        self.body.tets.is_live[element]
    }

    /// Without the volume penalty, whose stiffness is zero at rest.
    fn stiffness(&self, element: usize, _: f64) -> ElementStiffness {
        let body = &self.body;
        let nodes = body.tets.nodes[element];
        let u_m = nodes.map(|n| unpadded(&self.motion.displacements()[n.index()]));
        let TetLaw { lambda_pa, mu_pa, .. } = body.laws[element];
        let guarded = GuardedStVenantKirchhoff::of_lame(lambda_pa, mu_pa);
        let corners_m = std::array::from_fn(|k| body.rest_m[nodes[k].index()] + u_m[k]);
        let is_squeezed = tetrahedron_volume_m3(corners_m) < SQUEEZED_J * body.whole_m3(element);
        let law =
            if is_squeezed { TangentLaw::Any(&guarded) } else { TangentLaw::Kirchhoff(body.laws[element]) };
        local_model::tet_tangent(&body.gradients[element], u_m, &law, body.rest_stress_pa.get(element))
    }

    fn frame(&self) -> &dyn LocalFrame {
        self.motion.frame()
    }

    fn velocity_m_per_s(&self, n: usize) -> DVec3 {
        self.motion.state().velocities_m_per_s[n]
    }
}

/// What the force on a node may lack with reduced effort, and with the least [N]: choices, a hundredth and a tenth of what a
/// light touch is.
const REDUCED_TOLERANCE_N: f64 = 1e-3;
const LEAST_TOLERANCE_N: f64 = 1e-2;

impl ExplicitDynamics for NonlinearTensorMass {
    type Mover = ExplicitMotion;

    fn mover(&self) -> &ExplicitMotion {
        &self.motion
    }

    fn mover_mut(&mut self) -> &mut ExplicitMotion {
        &mut self.motion
    }

    fn advance(&mut self, dt_s: f64) {
        let (body, adaptivity) = (&self.body, &mut self.adaptivity);
        self.motion.step(dt_s, |u, force| {
            body.add_forces(adaptivity, u, force);
            body.guard_squeezed(u, force)
        });
    }

    /// Leaves the non-linear part of the force out where it is small (seed `002`, s. 6).
    fn choose_level_of_detail(&mut self, effort: LevelOfDetail) -> bool {
        self.adaptivity.part = match effort {
            LevelOfDetail::Full => NonlinearPart::Everywhere,
            LevelOfDetail::Reduced => NonlinearPart::AboveErrorBound { tolerance_n: REDUCED_TOLERANCE_N },
            LevelOfDetail::Least => NonlinearPart::AboveErrorBound { tolerance_n: LEAST_TOLERANCE_N },
        };
        true
    }

    fn follow_change(&mut self, mesh: &TetMesh, change: &TopologyChange) -> Result<(), TopologyRefusal> {
        follow(self, mesh, change)
    }
}
