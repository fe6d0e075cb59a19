//! Static equilibrium of a body of any law: Newton's method with load stepping and line search on P1 tetrahedra.
//!
//! Total Lagrangian: F = Id + sum_j u_j (x) alpha_j is constant in a tetrahedron of rest volume V, its energy is
//! V W(F), the force that balances it at node j is V P(F) alpha_j, and its stiffness between nodes j and k
//! contracts the tangent: K^jk_rs = V sum_cd alpha_j,c (d2W/dF_rc dF_sd) alpha_k,d
//! (Bonet and Wood, Nonlinear Continuum Mechanics for Finite Element Analysis, 2nd edition 2008, ch. 8 and 9).
//!
//! The load, forces and prescribed displacements alike, grows from 0 to 1 in steps. A step starts from a linear
//! prediction and ends with the residual below a share of the forces that act. Newton takes the true tangent where
//! it is positive definite and the one without negative eigenvalues elsewhere; a step must lower the total energy
//! (Armijo; Nocedal and Wright, Numerical Optimization, 2nd edition 2006, algorithm 3.1) or halve the residual.
//! A load step that does not converge, or that ends with an inverted tetrahedron, is halved.

use super::{
    BoundaryConditions, Factorization, FreeSystem, LOCAL_EDGES, MeshEdges, P1Gradients, SolveError,
    StiffnessTensors,
};
use crate::material::{Material, Tangent};
use glisson_mesh::math::{DMat3, DVec3, outer};
use glisson_mesh::mesh::{NodeId, TetId, TetMesh};
use glisson_mesh::progress::tell;

/// Why no solution of a non-linear static case was found.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum NonlinearError {
    /// The mesh, its supports or the stiffness at rest are unusable.
    #[error(transparent)]
    Solve(#[from] SolveError),
    /// The number of laws is neither one nor that of the tetrahedra.
    #[error("{found} laws for {n_tets} tetrahedra; allowed: 1 or {n_tets}")]
    LawCount {
        /// Number of laws given.
        found: usize,
        /// Number of tetrahedra.
        n_tets: usize,
    },
    /// A stress at rest.
    #[error("the law has no finite stiffness at rest in tetrahedron {tet}")]
    NotFinite {
        /// Which tetrahedron.
        tet: TetId,
    },
    /// Equilibrium was lost on the way to the full load.
    #[error(
        "no equilibrium found beyond {:.2} % of the load: the next step of {:.2} % fails after {iterations} Newton \
         iterations with residual {residual_n:e} N (allowed: {allowed_n:e} N), because {cause}. \
         Reduce the load, refine the mesh, or take a law that fits such strains",
        100.0 * load_reached, 100.0 * load_step
    )]
    NotConverged {
        /// Share of the load in equilibrium, 0 to 1.
        load_reached: f64,
        /// Share of the load of the step that failed.
        load_step: f64,
        /// Newton iterations in that step.
        iterations: usize,
        /// Residual's Euclidean norm at its end [N].
        residual_n: f64,
        /// What it should have been [N].
        allowed_n: f64,
        /// What went wrong.
        cause: StepFailure,
    },
}

/// Why a load step failed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum StepFailure {
    /// Too many iterations.
    #[error("the iterations ran out")]
    Iterations,
    /// No shorter step lowers energy or residual.
    #[error("the line search found no better state")]
    LineSearch,
    /// The prediction left the law's range.
    #[error("the predicted state has no finite energy")]
    Prediction,
    /// Equilibrium with an inverted tetrahedron.
    #[error("tetrahedron {0} turns inside out")]
    Inverted(TetId),
    /// The stiffness has no factor.
    #[error("the stiffness matrix is singular")]
    Singular,
}

/// A body of elastic tetrahedra: energy, forces and stiffness as functions of the displacements.
#[derive(Clone, Debug)]
pub struct ElasticBody<'a, M> {
    mesh: &'a TetMesh,
    edges: &'a MeshEdges,
    laws: &'a [M],
    gradients: Vec<P1Gradients>,
}

/// The kind of second derivative of the energy.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum TangentKind {
    /// The true one.
    Exact,
    /// Without the negative eigenvalues of the law in each tetrahedron or smoothing domain.
    Projected,
}

/// Energy, forces and stiffness as functions of the displacements: what Newton's method needs of a body.
pub(super) trait StaticBody {
    /// The pairs of nodes that the stiffness couples.
    fn edges(&self) -> &MeshEdges;

    /// Elastic energy [J].
    fn energy_j(&self, displacement_m: &[DVec3]) -> f64;

    /// Overwrites `force_n` with dW/du.
    fn force_into(&self, displacement_m: &[DVec3], force_n: &mut [DVec3]);

    /// Overwrites `tensors` with d2W/du2.
    fn stiffness_into(&self, displacement_m: &[DVec3], kind: TangentKind, tensors: &mut StiffnessTensors);

    /// First tetrahedron whose volume is not positive.
    fn first_inverted(&self, displacement_m: &[DVec3]) -> Option<TetId>;
}

/// Checks the number of laws, and that each has a finite stiffness at rest.
pub(super) fn check_laws<M: Material>(laws: &[M], n_tets: usize) -> Result<(), NonlinearError> {
    if laws.len() != 1 && laws.len() != n_tets {
        return Err(NonlinearError::LawCount { found: laws.len(), n_tets });
    }
    let is_finite = |law: &M| law.tangent_pa(&DMat3::IDENTITY).iter().flatten().all(|x| x.is_finite());
    match laws.iter().position(|law| !is_finite(law)) {
        Some(t) => Err(NonlinearError::NotFinite { tet: TetId::from_index(t) }),
        None => Ok(()),
    }
}

impl<'a, M: Material> ElasticBody<'a, M> {
    /// The body of one law (`laws` of length 1) or of one law per tetrahedron.
    ///
    /// # Errors
    /// [`NonlinearError::LawCount`], or [`SolveError::Volume`] for a flat or inverted tetrahedron.
    pub fn new(mesh: &'a TetMesh, edges: &'a MeshEdges, laws: &'a [M]) -> Result<Self, NonlinearError> {
        let n_tets = mesh.tetrahedra.len();
        if laws.len() != 1 && laws.len() != n_tets {
            return Err(NonlinearError::LawCount { found: laws.len(), n_tets });
        }
        let gradients: Result<Vec<P1Gradients>, SolveError> =
            (0..n_tets).map(|t| P1Gradients::of_tet(mesh, TetId::from_index(t))).collect();
        Ok(Self { mesh, edges, laws, gradients: gradients? })
    }

    fn law(&self, t: usize) -> &M {
        &self.laws[if self.laws.len() == 1 { 0 } else { t }]
    }

    /// F of tetrahedron number `t`.
    pub fn deformation_gradient(&self, t: usize, displacement_m: &[DVec3]) -> DMat3 {
        let nodes = &self.mesh.tetrahedra[t];
        let mut f = DMat3::IDENTITY;
        // Relative to the first corner: a translation of the body changes no bit that matters.
        let first_m = displacement_m[nodes[0].index()];
        for j in 1..4 {
            f += outer(displacement_m[nodes[j].index()] - first_m, self.gradients[t].alpha_per_m[j]);
        }
        f
    }

    /// Elastic energy [J].
    pub fn energy_j(&self, displacement_m: &[DVec3]) -> f64 {
        let mut sum = 0.0;
        for t in 0..self.gradients.len() {
            let f = self.deformation_gradient(t, displacement_m);
            sum += self.gradients[t].volume_m3 * self.law(t).energy_density_j_per_m3(&f);
        }
        sum
    }

    /// Overwrites `force_n` with the forces that balance the deformation, dW/du: the tissue pulls on its nodes
    /// with the opposite.
    pub fn force_into(&self, displacement_m: &[DVec3], force_n: &mut [DVec3]) {
        force_n.fill(DVec3::ZERO);
        for (t, nodes) in self.mesh.tetrahedra.iter().enumerate() {
            let gradients = &self.gradients[t];
            let stress = self.law(t).first_piola_pa(&self.deformation_gradient(t, displacement_m));
            for (node, alpha) in nodes.iter().zip(&gradients.alpha_per_m) {
                force_n[node.index()] += stress * *alpha * gradients.volume_m3;
            }
        }
    }

    /// Overwrites `tensors` with d2W/du2, accumulated in the order of the tetrahedra.
    pub fn stiffness_into(
        &self,
        displacement_m: &[DVec3],
        kind: TangentKind,
        tensors: &mut StiffnessTensors,
    ) {
        tensors.vertex.fill(DMat3::ZERO);
        tensors.edge.fill(DMat3::ZERO);
        for (t, nodes) in self.mesh.tetrahedra.iter().enumerate() {
            let f = self.deformation_gradient(t, displacement_m);
            let tangent = match kind {
                TangentKind::Exact => self.law(t).tangent_pa(&f),
                TangentKind::Projected => self.law(t).projected_tangent_pa(&f),
            };
            let P1Gradients { alpha_per_m: alpha, volume_m3 } = self.gradients[t];
            let half: [[[f64; 9]; 3]; 4] =
                std::array::from_fn(|j| contracted_rows(&tangent, alpha[j] * volume_m3));
            for j in 0..4 {
                tensors.vertex[nodes[j].index()] += contracted_columns(&half[j], alpha[j]);
            }
            for (e, [j, k]) in LOCAL_EDGES.into_iter().enumerate() {
                let block = contracted_columns(&half[j], alpha[k]);
                let along = if nodes[j] < nodes[k] { block } else { block.transpose() };
                tensors.edge[self.edges.of_tet[t][e] as usize] += along;
            }
        }
    }

    /// First tetrahedron whose volume is not positive.
    pub fn first_inverted(&self, displacement_m: &[DVec3]) -> Option<TetId> {
        (0..self.gradients.len())
            .find(|&t| {
                let ratio = self.deformation_gradient(t, displacement_m).determinant();
                ratio <= 0.0 || ratio.is_nan()
            })
            .map(TetId::from_index)
    }
}

impl<M: Material> StaticBody for ElasticBody<'_, M> {
    fn edges(&self) -> &MeshEdges {
        self.edges
    }

    fn energy_j(&self, displacement_m: &[DVec3]) -> f64 {
        self.energy_j(displacement_m)
    }

    fn force_into(&self, displacement_m: &[DVec3], force_n: &mut [DVec3]) {
        self.force_into(displacement_m, force_n);
    }

    fn stiffness_into(&self, displacement_m: &[DVec3], kind: TangentKind, tensors: &mut StiffnessTensors) {
        self.stiffness_into(displacement_m, kind, tensors);
    }

    fn first_inverted(&self, displacement_m: &[DVec3]) -> Option<TetId> {
        self.first_inverted(displacement_m)
    }
}

/// Row r: sum over c of a_c T[3 c + r].
pub(crate) fn contracted_rows(tangent: &Tangent, a: DVec3) -> [[f64; 9]; 3] {
    std::array::from_fn(|r| {
        std::array::from_fn(|k| a.x * tangent[r][k] + a.y * tangent[3 + r][k] + a.z * tangent[6 + r][k])
    })
}

/// Entry (r, s): sum over d of rows[r][3 d + s] a_d.
pub(crate) fn contracted_columns(rows: &[[f64; 9]; 3], a: DVec3) -> DMat3 {
    let entry = |r: usize, s: usize| rows[r][s] * a.x + rows[r][3 + s] * a.y + rows[r][6 + s] * a.z;
    let column = |s: usize| DVec3::new(entry(0, s), entry(1, s), entry(2, s));
    DMat3::from_cols(column(0), column(1), column(2))
}

/// A non-linear static case.
#[derive(Clone, Copy, Debug)]
pub struct NonlinearProblem<'a, M> {
    /// The body at rest.
    pub mesh: &'a TetMesh,
    /// One law, or one per tetrahedron.
    pub laws: &'a [M],
    /// What is held where.
    pub conditions: &'a BoundaryConditions,
    /// Force on each node [N], of fixed direction; length of the mesh's nodes.
    pub nodal_force_n: &'a [DVec3],
    /// How to solve.
    pub settings: NonlinearSettings,
}

/// How to solve.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct NonlinearSettings {
    /// Residual over the largest of applied forces, reactions (Euclidean norms) that ends a load step.
    pub residual_tolerance: f64,
    /// Newton iterations a load step may take before it is halved.
    pub most_iterations: usize,
    /// Share of the load of the first step, above 0 and at most 1.
    pub first_load_step: f64,
    /// Share of the load below which a step is not halved.
    pub least_load_step: f64,
}

impl Default for NonlinearSettings {
    fn default() -> Self {
        Self {
            residual_tolerance: 1e-10,
            most_iterations: 30,
            first_load_step: 0.25,
            least_load_step: 1.0 / 1024.0,
        }
    }
}

/// Its equilibrium.
#[derive(Clone, Debug, PartialEq)]
pub struct NonlinearSolution {
    /// Displacement of each node [m].
    pub displacement_m: Vec<DVec3>,
    /// Force [N] that the support exerts at each prescribed component; zero elsewhere.
    pub reaction_n: Vec<DVec3>,
    /// Load steps that converged.
    pub n_load_steps: usize,
    /// Newton iterations in all, failed steps included.
    pub n_iterations: usize,
    /// Residual's Euclidean norm [N].
    pub residual_n: f64,
    /// Elastic energy [J].
    pub energy_j: f64,
}

/// Share of the predicted decrease that a step must bring.
const ARMIJO: f64 = 1e-4;
/// Shortest Newton step that is tried; shorter ones make no useful progress.
const LEAST_STEP: f64 = 1e-4;
/// A load step that took at most this many iterations lets the next one be twice as long.
const FEW_ITERATIONS: usize = 8;
/// Rounding of forces, as a share of the largest stiffness times the largest displacement.
const ROUNDING: f64 = 4.0 * f64::EPSILON;

/// Displacements and reactions of a non-linear static case.
///
/// # Errors
/// [`NonlinearError`]: an unusable mesh, conditions on missing nodes, a piece that floats; or equilibrium is lost
/// on the way, with the load reached and the residual.
///
/// # Panics
/// When there is not one force per node.
pub fn solve_nonlinear<M: Material>(
    problem: &NonlinearProblem<'_, M>,
) -> Result<NonlinearSolution, NonlinearError> {
    let edges = MeshEdges::of_mesh(problem.mesh)?;
    check_laws(problem.laws, problem.mesh.tetrahedra.len())?;
    solve_body(ElasticBody::new(problem.mesh, &edges, problem.laws)?, problem)
}

/// [`solve_nonlinear`] with energy, forces and stiffness of `body`.
pub(super) fn solve_body<M, B: StaticBody>(
    body: B,
    problem: &NonlinearProblem<'_, M>,
) -> Result<NonlinearSolution, NonlinearError> {
    let NonlinearProblem { mesh, conditions, nodal_force_n, settings, .. } = *problem;
    assert_eq!(nodal_force_n.len(), mesh.positions_m.len(), "one force a node");
    conditions.check(mesh, body.edges())?;
    if let Some(n) = nodal_force_n.iter().position(|f| !f.is_finite()) {
        return Err(SolveError::NonFiniteCondition { node: NodeId::from_index(n) }.into());
    }
    let mut newton = Newton::new(body, problem)?;
    let mut load = 0.0;
    let mut load_step = settings.first_load_step.clamp(settings.least_load_step, 1.0);
    let mut n_load_steps = 0;
    while load < 1.0 {
        // The last step ends at 1 exactly, and leaves no sliver behind.
        let next = if load + load_step > 1.0 - 1e-9 { 1.0 } else { load + load_step };
        let before = newton.displacement_m.clone();
        let at_start = newton.n_iterations;
        match newton.load_step(load, next) {
            Ok(()) => {
                n_load_steps += 1;
                load = next;
                if newton.n_iterations - at_start <= FEW_ITERATIONS {
                    load_step *= 2.0;
                }
            }
            Err(cause) => {
                let iterations = newton.n_iterations - at_start;
                newton.displacement_m = before;
                let failed = next - load;
                load_step = 0.5 * failed;
                if load_step < settings.least_load_step {
                    return Err(NonlinearError::NotConverged {
                        load_reached: load,
                        load_step: failed,
                        iterations,
                        residual_n: newton.residual_n,
                        allowed_n: newton.allowed_n,
                        cause,
                    });
                }
            }
        }
    }
    Ok(newton.into_solution(n_load_steps))
}

/// A load step's state and scratch.
struct Newton<'a, B> {
    body: B,
    conditions: &'a BoundaryConditions,
    nodal_force_n: &'a [DVec3],
    settings: NonlinearSettings,
    tensors: StiffnessTensors,
    system: FreeSystem,
    factor: Factorization,
    displacement_m: Vec<DVec3>,
    /// dW/du at `displacement_m`.
    force_n: Vec<DVec3>,
    balance_n: Vec<DVec3>,
    trial_m: Vec<DVec3>,
    change: Vec<f64>,
    change_m: Vec<DVec3>,
    residual_n: f64,
    allowed_n: f64,
    n_iterations: usize,
}

impl<'a, B: StaticBody> Newton<'a, B> {
    fn new<M>(body: B, problem: &NonlinearProblem<'a, M>) -> Result<Self, NonlinearError> {
        let n_nodes = problem.mesh.positions_m.len();
        let zero = vec![DVec3::ZERO; n_nodes];
        let mut tensors = StiffnessTensors::zeros(n_nodes, body.edges());
        body.stiffness_into(&zero, TangentKind::Exact, &mut tensors);
        let system = FreeSystem::new(body.edges(), &tensors, problem.conditions)?;
        let factor = system.factorize()?;
        Ok(Self {
            body,
            conditions: problem.conditions,
            nodal_force_n: problem.nodal_force_n,
            settings: problem.settings,
            tensors,
            change: vec![0.0; system.n_free()],
            system,
            factor,
            displacement_m: zero.clone(),
            force_n: zero.clone(),
            balance_n: zero.clone(),
            trial_m: zero.clone(),
            change_m: zero,
            residual_n: 0.0,
            allowed_n: 0.0,
            n_iterations: 0,
        })
    }

    /// Equilibrium at the load `next` from the one at `load`.
    fn load_step(&mut self, load: f64, next: f64) -> Result<(), StepFailure> {
        self.predict(load, next)?;
        self.measure(next);
        let mut last_energy_j = self.total_energy_j(next, false);
        if !(last_energy_j.is_finite() && self.residual_n.is_finite()) {
            return Err(StepFailure::Prediction);
        }
        let at_start = self.n_iterations;
        while self.residual_n > self.allowed_n {
            if self.n_iterations - at_start >= self.settings.most_iterations {
                return Err(StepFailure::Iterations);
            }
            self.n_iterations += 1;
            // Who waits may break off between two iterations.
            tell(load);
            self.factor_tangent()?;
            self.system.gather_into(&self.balance_n, &mut self.change);
            let right: Vec<f64> = self.change.clone();
            self.factor.solve_in_place(&mut self.change, 1, &mut self.factor.scratch(1));
            // dE/dstep = -(f - dW/du) . change: negative, for the factored matrix is positive definite.
            let slope_j: f64 = -right.iter().zip(&self.change).map(|(r, c)| r * c).sum::<f64>();
            last_energy_j = self.line_search(next, last_energy_j, slope_j)?;
        }
        match self.body.first_inverted(&self.displacement_m) {
            Some(tet) => Err(StepFailure::Inverted(tet)),
            None => Ok(()),
        }
    }

    /// Moves to the linear prediction of the state at `next`: new prescribed displacements, and the free ones that
    /// the tangent at `load` answers with.
    fn predict(&mut self, load: f64, next: f64) -> Result<(), StepFailure> {
        self.factor_tangent()?;
        self.change_m.fill(DVec3::ZERO);
        for (node, axis, value) in self.conditions.iter() {
            self.change_m[node.index()][axis] = (next - load) * value;
        }
        self.tensors.force_into(self.body.edges(), &self.change_m, &mut self.balance_n);
        self.body.force_into(&self.displacement_m, &mut self.force_n);
        for n in 0..self.balance_n.len() {
            self.balance_n[n] = self.nodal_force_n[n] * next - self.force_n[n] - self.balance_n[n];
        }
        self.system.gather_into(&self.balance_n, &mut self.change);
        self.factor.solve_in_place(&mut self.change, 1, &mut self.factor.scratch(1));
        self.system.add_scattered(&self.change, &mut self.change_m);
        for (u, d) in self.displacement_m.iter_mut().zip(&self.change_m) {
            *u += *d;
        }
        for (node, axis, value) in self.conditions.iter() {
            self.displacement_m[node.index()][axis] = next * value;
        }
        Ok(())
    }

    /// Factors the true tangent, or the projected one where that is not positive definite.
    fn factor_tangent(&mut self) -> Result<(), StepFailure> {
        for kind in [TangentKind::Exact, TangentKind::Projected] {
            self.body.stiffness_into(&self.displacement_m, kind, &mut self.tensors);
            self.system.refill(&self.tensors);
            if self.factor.refactor(&self.system).is_ok() {
                return Ok(());
            }
        }
        Err(StepFailure::Singular)
    }

    /// Energy of body and load [J], at the trial state or the current one.
    fn total_energy_j(&self, load: f64, at_trial: bool) -> f64 {
        let u = if at_trial { &self.trial_m } else { &self.displacement_m };
        let work_j: f64 = self.nodal_force_n.iter().zip(u).map(|(f, u)| f.dot(*u)).sum();
        self.body.energy_j(u) - load * work_j
    }

    /// The residual and its allowed value at the current state.
    fn measure(&mut self, load: f64) {
        self.body.force_into(&self.displacement_m, &mut self.force_n);
        self.measure_forces(load);
    }

    fn measure_forces(&mut self, load: f64) {
        let mut applied = 0.0;
        for n in 0..self.force_n.len() {
            let applied_n = self.nodal_force_n[n] * load;
            applied += applied_n.length_squared();
            self.balance_n[n] = applied_n - self.force_n[n];
        }
        let mut reactions = 0.0;
        for (node, axis, _) in self.conditions.iter() {
            let r = self.balance_n[node.index()][axis];
            reactions += r * r;
        }
        self.system.gather_into(&self.balance_n, &mut self.change);
        let square: f64 = self.change.iter().map(|x| x * x).sum();
        self.residual_n = square.sqrt();
        let stiffest = self.tensors.vertex.iter().map(|b| b.x_axis.x.max(b.y_axis.y).max(b.z_axis.z));
        let farthest_m = self.displacement_m.iter().map(|u| u.length()).fold(0.0, f64::max);
        let rounding_n =
            ROUNDING * stiffest.fold(0.0, f64::max) * farthest_m * (self.change.len() as f64).sqrt();
        self.allowed_n = (self.settings.residual_tolerance * applied.max(reactions).sqrt()).max(rounding_n);
    }

    /// Moves along `change` as far as the energy or the residual decreases; returns the energy there.
    fn line_search(&mut self, load: f64, energy_j: f64, slope_j: f64) -> Result<f64, StepFailure> {
        self.change_m.fill(DVec3::ZERO);
        self.system.add_scattered(&self.change, &mut self.change_m);
        let residual_before_n = self.residual_n;
        let start_m = self.displacement_m.clone();
        let mut step = 1.0;
        while step >= LEAST_STEP {
            for (n, trial) in self.trial_m.iter_mut().enumerate() {
                *trial = start_m[n] + self.change_m[n] * step;
            }
            let trial_energy_j = self.total_energy_j(load, true);
            if trial_energy_j.is_finite() {
                std::mem::swap(&mut self.displacement_m, &mut self.trial_m);
                self.measure(load);
                let enough = trial_energy_j <= energy_j + ARMIJO * step * slope_j;
                if self.residual_n.is_finite() && (enough || self.residual_n <= 0.5 * residual_before_n) {
                    return Ok(trial_energy_j);
                }
                std::mem::swap(&mut self.displacement_m, &mut self.trial_m);
            }
            step *= 0.5;
        }
        self.measure(load);
        Err(StepFailure::LineSearch)
    }

    fn into_solution(mut self, n_load_steps: usize) -> NonlinearSolution {
        self.measure(1.0);
        let mut reaction_n = vec![DVec3::ZERO; self.force_n.len()];
        for (node, axis, _) in self.conditions.iter() {
            let n = node.index();
            reaction_n[n][axis] = self.force_n[n][axis] - self.nodal_force_n[n][axis];
        }
        NonlinearSolution {
            energy_j: self.body.energy_j(&self.displacement_m),
            displacement_m: self.displacement_m,
            reaction_n,
            n_load_steps,
            n_iterations: self.n_iterations,
            residual_n: self.residual_n,
        }
    }
}
