//! Linear tetrahedra that lock neither in volume nor in bending: selective strain smoothing, for any law.
//!
//! A deformation gradient that is constant in each tetrahedron is averaged over smoothing domains d, an edge's or
//! a node's share of the tetrahedra around it (a sixth of V per edge, a quarter per node):
//!
//! F_d = 1/V_d sum over the tetrahedra t around d of v_td F_t,   V_d = sum of v_td.
//!
//! The energy of a law W is split without knowing the law: U(J) = W(J^(1/3) Id) is what a pure change of volume
//! costs, W(F) - U(det F) what the change of shape costs on top (for a law with isochoric invariants exactly its
//! two terms). Shape counts in tetrahedra, edges and nodes with the shares of [`Smoothing`]; volume in nodes, with the
//! mean of the volume ratios J_a = 1/V_a sum of v_ta det F_t (Bonet and Burton 1998, doi
//! 10.1002/(SICI)1099-0887(199805)14:5<437::AID-CNM162>3.0.CO;2-W):
//!
//! W_body = sum over kinds k of s_k sum over domains d of V_d [W(F_d) - U(det F_d)] + sum over nodes a of V_a U(J_a).
//!
//! J_a is used instead of det F_a because it adds up to the true volume, so that a uniform pressure does no work inside the
//! body.
//!
//! Node-based domains do not lock in volume and are too soft in shape, with spurious modes; edge-based ones have no
//! spurious modes and are a little too stiff (Liu 2019, doi 10.1007/s11709-019-0519-5, a review of the smoothed
//! finite element method; for nearly incompressible finite strain Lee et al. 2021, doi
//! 10.32604/cmes.2021.014947, who add bubble functions where we mix kinds of domains). The stiffness of a beam in
//! bending is linear in the shares; [`Smoothing::BENDING`] has the round ones for which a square cantilever of two,
//! and equally of four, cells in height vibrates at the beam's frequency to half a per cent.
//! The energy is a function of the displacements: forces are its gradient, the stiffness is exact and symmetric. An
//! affine displacement has the same F everywhere, so W_body = V W(F) and the patch test is passed, for any shares
//! that add up to 1. The pressure -U'(J_a) still oscillates a little from node to node.
//!
//! The stiffness couples all nodes around a common node, about six times as many as share an edge: for static
//! cases of some 10,000 nodes. Where tetrahedra of several laws meet, a domain has the mean of their energies at
//! its common F: an interface between very different laws is smeared over one row of tetrahedra.

use super::nonlinear::{StaticBody, check_laws, contracted_columns, contracted_rows, solve_body};
use super::static_problem::solve_assembled;
use super::{
    MeshEdges, NonlinearError, NonlinearProblem, NonlinearSolution, P1Gradients, SolveError, StaticProblem,
    StaticSolution, StiffnessTensors, TangentKind,
};
use crate::material::{Material, Tangent, cofactor, cofactor_differential, projected};
use glisson_mesh::math::{DMat3, DVec3, is_inverted, outer};
use glisson_mesh::mesh::{NodeId, TetId, TetMesh};

/// Shares of the energy of shape in tetrahedra, edge domains and node domains: none negative, sum 1. The energy of volume is
/// always in the node domains.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Smoothing {
    /// Share in the tetrahedra.
    pub element: f64,
    /// Share averaged over edges.
    pub edge: f64,
    /// Share averaged over nodes.
    pub node: f64,
}

impl Smoothing {
    /// Only the volume is averaged: no volumetric locking, bending as stiff as in plain tetrahedra.
    pub const VOLUME: Self = Self { element: 1.0, edge: 0.0, node: 0.0 };
    /// Neither volumetric nor bending locking.
    pub const BENDING: Self = Self { element: 0.0, edge: 0.6, node: 0.4 };
}

/// Part of the body over which the deformation gradient is averaged.
#[derive(Clone, Copy, Debug)]
struct Domain {
    volume_m3: f64,
    /// Factor of the energy of shape.
    shape: f64,
    /// Where its nodes begin, and how many there are.
    first_node: usize,
    n_nodes: usize,
    first_pair: usize,
    first_law: usize,
    n_laws: usize,
}

/// A body of smoothed tetrahedra: energy, forces and stiffness as functions of the displacements.
#[derive(Clone, Debug)]
pub struct SmoothedBody<'a, M> {
    mesh: &'a TetMesh,
    laws: &'a [M],
    pairs: MeshEdges,
    gradients: Vec<P1Gradients>,
    domains: Vec<Domain>,
    /// Nodes of all domains, one after the other; ascending in each.
    node: Vec<NodeId>,
    /// The gradient of F_d by each node's displacement [1/m].
    gradient_per_m: Vec<DVec3>,
    /// Place in `pairs` of a domain's pairs (0, 1), (0, 2) ... (1, 2) ...
    pair: Vec<u32>,
    /// Laws of a domain with their shares of its volume.
    law: Vec<(u32, f64)>,
    /// The tetrahedra around each node that has some, and the place of its domain.
    around_nodes: Vec<(Vec<usize>, usize)>,
}

impl<'a, M: Material> SmoothedBody<'a, M> {
    /// The body of one law (`laws` of length 1) or of one law per tetrahedron.
    ///
    /// # Errors
    /// [`NonlinearError`]: an unusable mesh, a wrong number of laws, a law without finite stiffness at rest.
    ///
    /// # Panics
    /// When the shares are negative or do not add up to 1.
    pub fn new(mesh: &'a TetMesh, laws: &'a [M], smoothing: Smoothing) -> Result<Self, NonlinearError> {
        let Smoothing { element, edge, node } = smoothing;
        assert!(
            element >= 0.0 && edge >= 0.0 && node >= 0.0 && (element + edge + node - 1.0).abs() < 1e-12,
            "shares of the energy of shape: from 0, together 1"
        );
        let edges = MeshEdges::of_mesh(mesh)?;
        let n_tets = mesh.tetrahedra.len();
        check_laws(laws, n_tets)?;
        let gradients: Result<Vec<P1Gradients>, SolveError> =
            (0..n_tets).map(|t| P1Gradients::of_tet(mesh, TetId::from_index(t))).collect();
        let around_nodes = incidence(
            mesh.positions_m.len(),
            mesh.tetrahedra.iter().map(|nodes| nodes.iter().map(|n| n.index()).collect()),
        );
        let pairs = node_pairs(mesh, &around_nodes);
        let mut body = Self {
            mesh,
            laws,
            pairs,
            gradients: gradients?,
            domains: Vec::new(),
            node: Vec::new(),
            gradient_per_m: Vec::new(),
            pair: Vec::new(),
            law: Vec::new(),
            around_nodes: Vec::new(),
        };
        if element > 0.0 {
            for t in 0..n_tets {
                body.push_domain(&[t], 1.0, element);
            }
        }
        if edge > 0.0 {
            let around_edges = incidence(
                edges.nodes.len(),
                edges.of_tet.iter().map(|six| six.iter().map(|&e| e as usize).collect()),
            );
            for tets in &around_edges {
                body.push_domain(tets, 1.0 / 6.0, edge);
            }
        }
        for tets in around_nodes.into_iter().filter(|tets| !tets.is_empty()) {
            body.push_domain(&tets, 0.25, node);
            body.around_nodes.push((tets, body.domains.len() - 1));
        }
        Ok(body)
    }

    /// The domain that has `share` of the volume of each of `tets`.
    fn push_domain(&mut self, tets: &[usize], share: f64, shape: f64) {
        let volume_m3: f64 = tets.iter().map(|&t| self.gradients[t].volume_m3 * share).sum();
        let (first_node, first_pair, first_law) = (self.node.len(), self.pair.len(), self.law.len());
        let mut nodes: Vec<NodeId> = tets.iter().flat_map(|&t| self.mesh.tetrahedra[t]).collect();
        nodes.sort_unstable();
        nodes.dedup();
        let mut gradient_per_m = vec![DVec3::ZERO; nodes.len()];
        for &t in tets {
            let weight = self.gradients[t].volume_m3 * share / volume_m3;
            for (n, alpha) in self.mesh.tetrahedra[t].iter().zip(self.gradients[t].alpha_per_m) {
                let place = nodes.binary_search(n).expect("its own node");
                gradient_per_m[place] += alpha * weight;
            }
            if self.laws.len() > 1 {
                self.law.push((t as u32, weight));
            }
        }
        if self.laws.len() == 1 {
            self.law.push((0, 1.0));
        }
        for (i, &p) in nodes.iter().enumerate() {
            for &q in &nodes[i + 1..] {
                let place = self.pairs.nodes.binary_search(&[p, q]).expect("nodes around a common node");
                self.pair.push(u32::try_from(place).expect("fewer than 2^32 pairs"));
            }
        }
        self.domains.push(Domain {
            volume_m3,
            shape,
            first_node,
            n_nodes: nodes.len(),
            first_pair,
            first_law,
            n_laws: self.law.len() - first_law,
        });
        self.node.extend(nodes);
        self.gradient_per_m.extend(gradient_per_m);
    }

    fn members(&self, domain: &Domain) -> (&[NodeId], &[DVec3]) {
        let range = domain.first_node..domain.first_node + domain.n_nodes;
        (&self.node[range.clone()], &self.gradient_per_m[range])
    }

    fn laws_of(&self, domain: &Domain) -> impl Iterator<Item = (&M, f64)> {
        self.law[domain.first_law..domain.first_law + domain.n_laws]
            .iter()
            .map(|&(law, share)| (&self.laws[law as usize], share))
    }

    fn mean_deformation_gradient(&self, domain: &Domain, displacement_m: &[DVec3]) -> DMat3 {
        let (nodes, gradients) = self.members(domain);
        // Relative to one node, so that a translation of the body does not cost digits.
        let first_m = displacement_m[nodes[0].index()];
        nodes.iter().zip(gradients).fold(DMat3::IDENTITY, |f, (n, &gradient)| {
            f + outer(displacement_m[n.index()] - first_m, gradient)
        })
    }

    /// The pairs of nodes that the stiffness couples, for tensors of the right length; `of_tet` is empty.
    pub fn pairs(&self) -> &MeshEdges {
        &self.pairs
    }

    fn deformation_gradient(&self, t: usize, displacement_m: &[DVec3]) -> DMat3 {
        let nodes = &self.mesh.tetrahedra[t];
        let first_m = displacement_m[nodes[0].index()];
        (1..4).fold(DMat3::IDENTITY, |f, k| {
            f + outer(displacement_m[nodes[k].index()] - first_m, self.gradients[t].alpha_per_m[k])
        })
    }

    /// Share of tetrahedron `t` in the volume of a node's domain.
    fn node_share(&self, t: usize, domain: &Domain) -> f64 {
        0.25 * self.gradients[t].volume_m3 / domain.volume_m3
    }

    /// J_a of each node that has tetrahedra, in the order of `around_nodes`.
    fn node_volume_ratios(&self, displacement_m: &[DVec3]) -> Vec<f64> {
        let of_tet: Vec<f64> = (0..self.gradients.len())
            .map(|t| self.deformation_gradient(t, displacement_m).determinant())
            .collect();
        let mean = |(tets, domain): &(Vec<usize>, usize)| {
            tets.iter().map(|&t| self.node_share(t, &self.domains[*domain]) * of_tet[t]).sum()
        };
        self.around_nodes.iter().map(mean).collect()
    }

    /// U'(J_a) and U''(J_a) [Pa] of each node that has tetrahedra, and the mean of U' over each tetrahedron's nodes.
    fn node_swelling(&self, displacement_m: &[DVec3]) -> (Vec<[f64; 2]>, Vec<f64>) {
        let mut of_tet = vec![0.0; self.gradients.len()];
        let mut of_node = Vec::with_capacity(self.around_nodes.len());
        for ((tets, domain), j) in self.around_nodes.iter().zip(self.node_volume_ratios(displacement_m)) {
            let mut derivatives_pa = [0.0; 2];
            for (law, share) in self.laws_of(&self.domains[*domain]) {
                let [first, second] = swelling_derivatives(law, j);
                derivatives_pa[0] += share * first;
                derivatives_pa[1] += share * second;
            }
            for &t in tets {
                of_tet[t] += 0.25 * derivatives_pa[0];
            }
            of_node.push(derivatives_pa);
        }
        (of_node, of_tet)
    }

    /// Elastic energy [J].
    pub fn energy_j(&self, displacement_m: &[DVec3]) -> f64 {
        let mut sum = 0.0;
        for domain in self.domains.iter().filter(|d| d.shape > 0.0) {
            let f = self.mean_deformation_gradient(domain, displacement_m);
            for (law, share) in self.laws_of(domain) {
                let swelling = swelling_energy(law, f.determinant());
                if !swelling.is_finite() {
                    // Infinity minus infinity would not be a number.
                    return f64::INFINITY;
                }
                let shape = law.energy_density_j_per_m3(&f) - swelling;
                sum += domain.volume_m3 * share * domain.shape * shape;
            }
        }
        for ((_, domain), j) in self.around_nodes.iter().zip(self.node_volume_ratios(displacement_m)) {
            let domain = &self.domains[*domain];
            for (law, share) in self.laws_of(domain) {
                sum += domain.volume_m3 * share * swelling_energy(law, j);
            }
        }
        sum
    }

    /// Overwrites `force_n` with the forces that balance the deformation, dW/du.
    pub fn force_into(&self, displacement_m: &[DVec3], force_n: &mut [DVec3]) {
        force_n.fill(DVec3::ZERO);
        for domain in self.domains.iter().filter(|d| d.shape > 0.0) {
            let f = self.mean_deformation_gradient(domain, displacement_m);
            let normal = cofactor(&f);
            let mut stress = DMat3::ZERO;
            for (law, share) in self.laws_of(domain) {
                let [slope_pa, _] = swelling_derivatives(law, f.determinant());
                stress += (law.first_piola_pa(&f) - normal * slope_pa) * (share * domain.shape);
            }
            let (nodes, gradients) = self.members(domain);
            for (n, gradient) in nodes.iter().zip(gradients) {
                force_n[n.index()] += stress * *gradient * domain.volume_m3;
            }
        }
        let (_, slope_pa) = self.node_swelling(displacement_m);
        for (t, nodes) in self.mesh.tetrahedra.iter().enumerate() {
            let P1Gradients { alpha_per_m, volume_m3 } = self.gradients[t];
            let stress = cofactor(&self.deformation_gradient(t, displacement_m)) * (slope_pa[t] * volume_m3);
            for (n, alpha) in nodes.iter().zip(alpha_per_m) {
                force_n[n.index()] += stress * alpha;
            }
        }
    }

    /// Overwrites `tensors` with d2W/du2 on nodes and [`SmoothedBody::pairs`], accumulated in a fixed order.
    pub fn stiffness_into(
        &self,
        displacement_m: &[DVec3],
        kind: TangentKind,
        tensors: &mut StiffnessTensors,
    ) {
        tensors.vertex.fill(DMat3::ZERO);
        tensors.edge.fill(DMat3::ZERO);
        for domain in self.domains.iter().filter(|d| d.shape > 0.0) {
            let f = self.mean_deformation_gradient(domain, displacement_m);
            let mut tangent = self.shape_tangent_pa(domain, &f);
            if kind == TangentKind::Projected {
                tangent = projected(&tangent);
            }
            let (nodes, gradients) = self.members(domain);
            let mut pair = domain.first_pair;
            for (i, gradient) in gradients.iter().enumerate() {
                let half = contracted_rows(&tangent, *gradient * domain.volume_m3);
                tensors.vertex[nodes[i].index()] += contracted_columns(&half, *gradient);
                for other in &gradients[i + 1..] {
                    tensors.edge[self.pair[pair] as usize] += contracted_columns(&half, *other);
                    pair += 1;
                }
            }
        }
        self.add_swelling_stiffness(displacement_m, kind, tensors);
    }

    /// Adds the second derivative of the energy of volume: V_a U'' dJ_a (x) dJ_a of each node, and U' d2J of each
    /// tetrahedron.
    fn add_swelling_stiffness(
        &self,
        displacement_m: &[DVec3],
        kind: TangentKind,
        tensors: &mut StiffnessTensors,
    ) {
        let (of_node, slope_pa) = self.node_swelling(displacement_m);
        let f: Vec<DMat3> =
            (0..self.gradients.len()).map(|t| self.deformation_gradient(t, displacement_m)).collect();
        let normal: Vec<DMat3> = f.iter().map(cofactor).collect();
        let mut change: Vec<DVec3> = Vec::new();
        for ((tets, domain), [_, curvature_pa]) in self.around_nodes.iter().zip(&of_node) {
            let domain = &self.domains[*domain];
            let (nodes, _) = self.members(domain);
            change.clear();
            change.resize(nodes.len(), DVec3::ZERO);
            for &t in tets {
                let share = self.node_share(t, domain);
                for (n, alpha) in self.mesh.tetrahedra[t].iter().zip(self.gradients[t].alpha_per_m) {
                    let place = nodes.binary_search(n).expect("its own node");
                    change[place] += normal[t] * alpha * share;
                }
            }
            let least_pa = if kind == TangentKind::Projected { 0.0 } else { f64::NEG_INFINITY };
            let stiffness = domain.volume_m3 * curvature_pa.max(least_pa);
            let mut pair = domain.first_pair;
            for (i, gradient) in change.iter().enumerate() {
                tensors.vertex[nodes[i].index()] += outer(*gradient, *gradient) * stiffness;
                for other in &change[i + 1..] {
                    tensors.edge[self.pair[pair] as usize] += outer(*gradient, *other) * stiffness;
                    pair += 1;
                }
            }
        }
        for (t, nodes) in self.mesh.tetrahedra.iter().enumerate() {
            let mut tangent = [[0.0; 9]; 9];
            add_volume_tangent(&mut tangent, &f[t], [slope_pa[t], 0.0]);
            if kind == TangentKind::Projected {
                tangent = projected(&tangent);
            }
            let P1Gradients { alpha_per_m: alpha, volume_m3 } = self.gradients[t];
            for j in 0..4 {
                let half = contracted_rows(&tangent, alpha[j] * volume_m3);
                tensors.vertex[nodes[j].index()] += contracted_columns(&half, alpha[j]);
                for k in (0..4).filter(|&k| nodes[k] > nodes[j]) {
                    let place =
                        self.pairs.nodes.binary_search(&[nodes[j], nodes[k]]).expect("an edge is a pair");
                    tensors.edge[place] += contracted_columns(&half, alpha[k]);
                }
            }
        }
    }

    /// Second derivative of a domain's energy of shape per volume by its F.
    fn shape_tangent_pa(&self, domain: &Domain, f: &DMat3) -> Tangent {
        let mut sum = [[0.0; 9]; 9];
        let mut swelling_pa = [0.0; 2];
        for (law, share) in self.laws_of(domain) {
            for (row, add) in sum.iter_mut().zip(&law.tangent_pa(f)) {
                for (x, y) in row.iter_mut().zip(add) {
                    *x += share * domain.shape * y;
                }
            }
            let [slope_pa, curvature_pa] = swelling_derivatives(law, f.determinant());
            swelling_pa[0] -= share * domain.shape * slope_pa;
            swelling_pa[1] -= share * domain.shape * curvature_pa;
        }
        add_volume_tangent(&mut sum, f, swelling_pa);
        sum
    }

    /// First tetrahedron whose volume is not positive.
    pub fn first_inverted(&self, displacement_m: &[DVec3]) -> Option<TetId> {
        (0..self.gradients.len()).map(TetId::from_index).find(|&tet| {
            let nodes = &self.mesh.tetrahedra[tet.index()];
            let corners_m = nodes.map(|n| self.mesh.positions_m[n.index()] + displacement_m[n.index()]);
            is_inverted(glisson_mesh::math::tetrahedron_volume_m3(corners_m))
        })
    }
}

/// Adds the second derivative by F of a function of J = det F with these first and second derivatives.
fn add_volume_tangent(tangent: &mut Tangent, f: &DMat3, [first_pa, second_pa]: [f64; 2]) {
    let normal = cofactor(f).to_cols_array();
    for entry in 0..9 {
        let mut unit = DMat3::ZERO;
        unit.col_mut(entry / 3)[entry % 3] = 1.0;
        let turn = cofactor_differential(f, &unit).to_cols_array();
        for k in 0..9 {
            tangent[entry][k] += second_pa * normal[entry] * normal[k] + first_pa * turn[k];
        }
    }
}

/// U(J) = W(J^(1/3) Id) [J/m3].
fn swelling_energy<M: Material>(law: &M, j: f64) -> f64 {
    law.energy_density_j_per_m3(&DMat3::from_diagonal(DVec3::splat(libm::cbrt(j))))
}

/// U'(J) and U''(J) [Pa].
fn swelling_derivatives<M: Material>(law: &M, j: f64) -> [f64; 2] {
    // With s the cube root of J and w(s) = W(s Id): U' = w'/(3 s^2), U'' = (w'' - 2 w'/s)/(9 s^4).
    let s = libm::cbrt(j);
    let f = DMat3::from_diagonal(DVec3::splat(s));
    let trace = |m: DMat3| m.x_axis.x + m.y_axis.y + m.z_axis.z;
    let slope = trace(law.first_piola_pa(&f));
    let curvature = trace(law.first_piola_differential_pa(&f, &DMat3::IDENTITY));
    [slope / (3.0 * s * s), (curvature - 2.0 * slope / s) / (9.0 * s * s * s * s)]
}

/// For each of `n` items the tetrahedra that name it, ascending.
fn incidence(n: usize, of_tet: impl Iterator<Item = Vec<usize>>) -> Vec<Vec<usize>> {
    let mut around = vec![Vec::new(); n];
    for (t, items) in of_tet.enumerate() {
        for item in items {
            around[item].push(t);
        }
    }
    around
}

/// All pairs of nodes around a common node, ascending.
fn node_pairs(mesh: &TetMesh, around_nodes: &[Vec<usize>]) -> MeshEdges {
    let neighbours: Vec<Vec<NodeId>> = around_nodes
        .iter()
        .map(|tets| {
            let mut nodes: Vec<NodeId> = tets.iter().flat_map(|&t| mesh.tetrahedra[t]).collect();
            nodes.sort_unstable();
            nodes.dedup();
            nodes
        })
        .collect();
    let mut nodes = Vec::new();
    for (p, near) in neighbours.iter().enumerate() {
        // Two nodes meet when one is around a neighbour of the other.
        let mut far: Vec<NodeId> =
            near.iter().flat_map(|a| &neighbours[a.index()]).copied().filter(|q| q.index() > p).collect();
        far.sort_unstable();
        far.dedup();
        nodes.extend(far.into_iter().map(|q| [NodeId::from_index(p), q]));
    }
    MeshEdges { nodes, of_tet: Vec::new() }
}

impl<M: Material> StaticBody for SmoothedBody<'_, M> {
    fn edges(&self) -> &MeshEdges {
        &self.pairs
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

/// [`super::solve_nonlinear`] with smoothed tetrahedra.
///
/// # Errors
/// As [`super::solve_nonlinear`].
///
/// # Panics
/// When there is not one force per node, or the shares do not add up to 1.
pub fn solve_nonlinear_smoothed<M: Material>(
    problem: &NonlinearProblem<'_, M>,
    smoothing: Smoothing,
) -> Result<NonlinearSolution, NonlinearError> {
    solve_body(SmoothedBody::new(problem.mesh, problem.laws, smoothing)?, problem)
}

/// [`super::solve_static`] with smoothed tetrahedra: linear in the load.
///
/// # Errors
/// As [`super::solve_static`].
///
/// # Panics
/// When there is not one force per node, or the shares do not add up to 1.
pub fn solve_static_smoothed(
    problem: &StaticProblem<'_>,
    smoothing: Smoothing,
) -> Result<StaticSolution, SolveError> {
    let laws = std::slice::from_ref(problem.material);
    let body = SmoothedBody::new(problem.mesh, laws, smoothing).map_err(|error| match error {
        NonlinearError::Solve(error) => error,
        other => unreachable!("one linear law with finite moduli: {other}"),
    })?;
    let n_nodes = problem.mesh.positions_m.len();
    let mut tensors = StiffnessTensors::zeros(n_nodes, &body.pairs);
    body.stiffness_into(&vec![DVec3::ZERO; n_nodes], TangentKind::Exact, &mut tensors);
    solve_assembled(problem, &body.pairs, &tensors)
}

/// Deformation gradient of each node: the mean over the tetrahedra around it, by volume. Identity for a node without
/// a tetrahedron. A law's stress at it is the smoothed stress of the node.
///
/// # Errors
/// [`SolveError::Volume`] for a flat or inverted tetrahedron at rest.
///
/// # Panics
/// When there is not one displacement per node.
pub fn node_deformation_gradients(
    mesh: &TetMesh,
    displacement_m: &[DVec3],
) -> Result<Vec<DMat3>, SolveError> {
    assert_eq!(displacement_m.len(), mesh.positions_m.len(), "one displacement a node");
    let mut sum = vec![(DMat3::ZERO, 0.0); displacement_m.len()];
    for (t, nodes) in mesh.tetrahedra.iter().enumerate() {
        let P1Gradients { alpha_per_m, volume_m3 } = P1Gradients::of_tet(mesh, TetId::from_index(t))?;
        let first_m = displacement_m[nodes[0].index()];
        let change = (1..4)
            .fold(DMat3::ZERO, |m, k| m + outer(displacement_m[nodes[k].index()] - first_m, alpha_per_m[k]));
        for n in nodes {
            sum[n.index()].0 += change * volume_m3;
            sum[n.index()].1 += volume_m3;
        }
    }
    let mean =
        |(change, volume_m3): (DMat3, f64)| if volume_m3 > 0.0 { change / volume_m3 } else { DMat3::ZERO };
    Ok(sum.into_iter().map(|s| DMat3::IDENTITY + mean(s)).collect())
}
