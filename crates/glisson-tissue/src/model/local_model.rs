//! The response of a touched patch over a short period, small enough for a separate haptic loop: positions, forces and
//! compliance of some nodes.
//!
//! Over a period h the nodes of the patch respond to a change of their forces by C df. For a pre-computed (static) model C
//! is the patch's part of the compliance. For a dynamic one it is the patch's part of
//!
//! (M/h^2 + D/h + K)^-1,
//!
//! the displacement at the end of one implicit step for a force that acts throughout it; K is the tangent at the present
//! shape and D the damping. It is computed on the tetrahedra within some rings around the patch; the nodes beyond are
//! held. The entries of such an inverse decay exponentially with the distance in the graph of the matrix, by
//! q = (sqrt(kappa) - 1)/(sqrt(kappa) + 1) per ring for a condition number kappa (S. Demko, W. F. Moss and P. W. Smith
//! 1984, Decay rates for inverses of band matrices, doi 10.1090/S0025-5718-1984-0758197-9). The effect of the held nodes
//! reaches the patch over twice the number of rings. kappa is bounded by 1 + h^2 omega^2, with Gershgorin's bound of
//! omega^2 in the tetrahedra at the patch.
//!
//! Columns are solved eight at a time by conjugate gradients with a diagonal preconditioner, in a fixed order: the bits are
//! the same on every path and at any number of threads. Ligaments do not count.
//!
//! A period that is a single step of central differences is another matter: no other node answers within it, and C is
//! that of the masses alone, exactly ([`inertial`]). [`LocalWork::from_one_ring`] allows it.

mod columns;
mod inertial;

use self::columns::{Columns, Solved};
use self::inertial::{of_masses, of_short_step};
use super::Rayleigh;
use super::kernel::KernelPath;
use super::tet_law::{TetLaw, linear_stiffness};
use crate::material::Material;
use crate::solve::{LOCAL_EDGES, P1Gradients, RestStress, TetStiffness, stress_tensor_pa};
use glisson_mesh::math::{DMat3, DVec3, outer};
use glisson_mesh::mesh::NodeId;

/// Smallest and largest number of rings, and the effect allowed from beyond them as a share of the compliance: choices.
const LEAST_RINGS: u32 = 2;
const MOST_RINGS: u32 = 12;
const ECHO: f64 = 2e-2;
/// Largest number of nodes of a region; rings that do not fit wholly are left out.
const MOST_REGION: usize = 2048;
/// Conjugate gradients end when each column's residual has fallen by this factor, or after so many iterations.
const TOLERANCE: f64 = 1e-7;
const MOST_ITERATIONS: usize = 400;
/// Neighbours of a node, itself included, for which capacity is reserved.
const NEIGHBOURS: usize = 32;

/// The response of a patch to forces, for a haptic loop.
#[derive(Clone, Debug, PartialEq)]
pub struct LocalModel {
    /// The nodes of the patch, in the requested order.
    pub nodes: Vec<NodeId>,
    /// Their positions [m].
    pub position_m: Vec<DVec3>,
    /// External force [N] on each of them there: of constraints and outer forces, without weight.
    pub force_n: Vec<DVec3>,
    /// C [m/N], 3n x 3n, symmetric, row 3 i + a for axis a of node i. Rows of fixed axes are zero.
    pub compliance_m_per_n: Vec<f64>,
    /// Mass [kg] of each node; zero in a static model.
    pub mass_kg: Vec<f64>,
    /// Where the motion of the tissue takes each node in the period [m] under forces that would hold it as it is: C (M/h + D) v =
    /// h v - C h K v, with the velocities v of the nodes beyond the rings too. Zero unless [`LocalWork::telling_drift`] asks
    /// for it, and in a static model.
    pub drift_m: Vec<DVec3>,
    /// -h K v [N]: by how much the elements' force on each node has changed over the last period, with which an explicit step begins.
    /// Told by explicit models alone, with the drift where [`LocalWork::set_telling_changes`] asks for it.
    pub changed_n: Vec<Option<DVec3>>,
    /// The period [s] that C is for.
    pub period_s: f64,
    /// Rings of tetrahedra around the patch that C takes into account; none when it is exact.
    pub n_rings: Option<u32>,
    /// Whether C is that of the masses alone: the tissue is about to buckle or torn apart here, or the period is a single
    /// explicit step.
    pub is_inertial: bool,
    /// Whether the solution did not reach its tolerance within the iterations of a step: C is an estimate, too stiff.
    pub missed_tolerance: bool,
    /// Number of requested nodes that are not among `nodes`: they do not exist, repeat others or are too many.
    pub n_left_out: u32,
}

impl Default for LocalModel {
    fn default() -> Self {
        Self::new()
    }
}

impl LocalModel {
    /// Most nodes of a patch.
    pub const MOST_NODES: usize = 96;

    /// An empty model with capacity for the largest patch.
    pub fn new() -> Self {
        let n = Self::MOST_NODES;
        Self {
            nodes: Vec::with_capacity(n),
            position_m: Vec::with_capacity(n),
            force_n: Vec::with_capacity(n),
            compliance_m_per_n: Vec::with_capacity(9 * n * n),
            mass_kg: Vec::with_capacity(n),
            drift_m: Vec::with_capacity(n),
            changed_n: Vec::with_capacity(n),
            period_s: 0.0,
            n_rings: None,
            is_inertial: false,
            missed_tolerance: false,
            n_left_out: 0,
        }
    }

    /// Starts with a patch that does not move under forces.
    pub(in crate::model) fn start(&mut self, patch: &[NodeId], period_s: f64, positions_m: &[DVec3]) {
        self.nodes.clear();
        self.position_m.clear();
        self.force_n.clear();
        self.n_left_out = 0;
        for &node in patch {
            match positions_m.get(node.index()) {
                Some(&position_m) if self.nodes.len() < Self::MOST_NODES && !self.nodes.contains(&node) => {
                    self.nodes.push(node);
                    self.position_m.push(position_m);
                    self.force_n.push(DVec3::ZERO);
                }
                _ => self.n_left_out += 1,
            }
        }
        let n = 3 * self.nodes.len();
        self.compliance_m_per_n.clear();
        self.compliance_m_per_n.resize(n * n, 0.0);
        self.mass_kg.clear();
        self.mass_kg.resize(self.nodes.len(), 0.0);
        self.drift_m.clear();
        self.drift_m.resize(self.nodes.len(), DVec3::ZERO);
        self.changed_n.clear();
        self.changed_n.resize(self.nodes.len(), None);
        self.period_s = period_s;
        self.n_rings = None;
        self.is_inertial = false;
        self.missed_tolerance = false;
    }

    /// Tensor [m/N]: displacement of the patch's node `of` for a force on its node `by` (places in `nodes`).
    pub fn tensor_m_per_n(&self, of: usize, by: usize) -> DMat3 {
        let n = 3 * self.nodes.len();
        let column = |d: usize| {
            DVec3::from_array([0, 1, 2].map(|a| self.compliance_m_per_n[n * (3 * of + a) + 3 * by + d]))
        };
        DMat3::from_cols(column(0), column(1), column(2))
    }

    pub(in crate::model) fn set_tensor(&mut self, of: usize, by: usize, tensor: DMat3) {
        let n = 3 * self.nodes.len();
        for d in 0..3 {
            for a in 0..3 {
                self.compliance_m_per_n[n * (3 * of + a) + 3 * by + d] = tensor.col(d)[a];
            }
        }
    }

    /// Overwrites `positions_m` with the positions of the patch's nodes after the period if these forces [N] act instead of
    /// `force_n`, as far as the response is linear. All three lists have one entry per node.
    pub fn predict_into(&self, force_n: &[DVec3], positions_m: &mut [DVec3]) {
        for (i, position_m) in positions_m.iter_mut().enumerate().take(self.nodes.len()) {
            *position_m = self.position_m[i];
            for (j, force_n) in force_n.iter().enumerate().take(self.nodes.len()) {
                *position_m += self.tensor_m_per_n(i, j) * (*force_n - self.force_n[j]);
            }
        }
    }

    /// Replaces C by the mean of C and its transpose.
    pub(in crate::model) fn symmetrize(&mut self) {
        let n = 3 * self.nodes.len();
        let c = &mut self.compliance_m_per_n;
        for i in 0..n {
            for j in 0..i {
                let mean = 0.5 * (c[n * i + j] + c[n * j + i]);
                c[n * i + j] = mean;
                c[n * j + i] = mean;
            }
        }
    }
}

/// Scratch of the computation of local models; may serve several models in turn.
#[derive(Clone, Debug)]
pub struct LocalWork {
    path: KernelPath,
    least_rings: u32,
    most_rings: u32,
    tolerance: f64,
    tells_drift: bool,
    tells_changes: bool,
    /// Place in the region of each node plus one; zero outside.
    place: Vec<u32>,
    /// Nodes, those of the patch first.
    region: Vec<u32>,
    n_patch: usize,
    elements: Vec<u32>,
    /// Head of each node's list of blocks plus one.
    head: Vec<u32>,
    /// Next in the list plus one, column, block.
    blocks: Vec<(u32, u32, [f64; 9])>,
    /// The same by rows.
    row_start: Vec<u32>,
    columns: Vec<u32>,
    entries: Vec<[f64; 9]>,
    /// Of each unknown.
    inverse_diagonal: Vec<f64>,
    /// -h K v of each unknown [N]: what the elements answer to a motion that goes on for a period.
    braking_n: Vec<f64>,
    vectors: [Vec<[f64; 8]>; 4],
}

impl LocalWork {
    /// Scratch with capacity for a body of so many nodes; it grows at its first use with a larger body or with nodes of many
    /// neighbours.
    pub fn with_room_for(n_nodes: usize) -> Self {
        let n = n_nodes.min(MOST_REGION);
        Self {
            path: KernelPath::fastest(),
            least_rings: LEAST_RINGS,
            most_rings: MOST_RINGS,
            tolerance: TOLERANCE,
            tells_drift: false,
            tells_changes: false,
            place: vec![0; n_nodes],
            region: Vec::with_capacity(n),
            n_patch: 0,
            elements: Vec::with_capacity(8 * n),
            head: Vec::with_capacity(n),
            blocks: Vec::with_capacity(NEIGHBOURS * n),
            row_start: Vec::with_capacity(n + 1),
            columns: Vec::with_capacity(NEIGHBOURS * n),
            entries: Vec::with_capacity(NEIGHBOURS * n),
            inverse_diagonal: Vec::with_capacity(3 * n),
            braking_n: Vec::with_capacity(3 * n),
            vectors: std::array::from_fn(|_| Vec::with_capacity(3 * n)),
        }
    }

    /// Settings for a cheaper estimate: at most so many rings, and columns solved to this share of their residual. The body
    /// counts as held beyond the rings, so that the patch seems stiffer. Exact models do not use rings.
    #[must_use]
    pub fn estimating(self, most_rings: u32, tolerance: f64) -> Self {
        Self {
            most_rings: most_rings.clamp(LEAST_RINGS, MOST_RINGS),
            tolerance: tolerance.clamp(TOLERANCE, 0.1),
            ..self
        }
    }

    /// Allows a single ring where the effect from beyond it is small enough, and none where an explicit model answers a period
    /// by its masses alone: for steps that are short for the tissue.
    #[must_use]
    pub fn from_one_ring(self) -> Self {
        Self { least_rings: 1, ..self }
    }

    /// Computes [`LocalModel::drift_m`] as well.
    #[must_use]
    pub fn telling_drift(self) -> Self {
        Self { tells_drift: true, ..self }
    }

    /// Whether [`LocalModel::changed_n`] is told with the drift from now on. In a short step of the kernel's model it costs more than
    /// all the rest.
    pub fn set_telling_changes(&mut self, tells_changes: bool) {
        self.tells_changes = tells_changes;
    }

    /// Whether [`LocalModel::drift_m`] is asked for.
    pub(in crate::model) fn tells_drift(&self) -> bool {
        self.tells_drift
    }

    /// The instruction set to compute with.
    pub(in crate::model) fn path(&self) -> KernelPath {
        self.path
    }

    /// Sets the instruction set to compute with; the bits are the same on every one.
    pub fn set_path(&mut self, path: KernelPath) {
        self.path = path;
    }
}

/// The elements of a body: tetrahedra or edges.
#[derive(Clone, Copy)]
pub(in crate::model) enum LocalElements<'a> {
    /// Corners, and which are live.
    Tets(&'a [[NodeId; 4]]),
    /// Ends.
    Edges(&'a [[NodeId; 2]]),
}

impl LocalElements<'_> {
    fn nodes(&self, e: usize) -> &[NodeId] {
        match self {
            Self::Tets(nodes) => &nodes[e],
            Self::Edges(nodes) => &nodes[e],
        }
    }
}

/// Stiffness of an element between its nodes [N/m].
pub(in crate::model) type ElementStiffness = [[DMat3; 4]; 4];

/// A dynamic model, as its local models see it.
pub(in crate::model) trait LocalBody {
    fn elements(&self) -> LocalElements<'_>;
    fn is_live(&self, element: usize) -> bool;
    /// K of an element at the present shape, with the contribution of dampers over the period.
    fn stiffness(&self, element: usize, period_s: f64) -> ElementStiffness;
    /// Masses, supports and constraints.
    fn frame(&self) -> &dyn LocalFrame;
    fn velocity_m_per_s(&self, n: usize) -> DVec3;
    /// Damping of masses and stiffness.
    fn damping(&self) -> Rayleigh {
        self.frame().damping()
    }
    /// Whether a step acts with the elements' forces in the shape before it.
    fn is_explicit(&self) -> bool {
        true
    }
    /// -h K v of an element at its nodes [N], over a period h.
    fn change_n(&self, element: usize, period_s: f64) -> [DVec3; 4] {
        let elements = self.elements();
        let nodes = elements.nodes(element);
        let velocity = |node: &NodeId| self.velocity_m_per_s(node.index());
        change_of(&self.stiffness(element, period_s), nodes, velocity, period_s)
    }
    /// Into how many parts of central differences the next step of `period_s` is divided, if it is no longer than a single
    /// stable one.
    fn short_step_parts(&self, _period_s: f64) -> Option<u64> {
        None
    }
}

/// -h K v [N] of an element with the stiffness K and these nodes, whose velocities [m/s] `velocity` tells.
fn change_of(
    stiffness: &ElementStiffness,
    nodes: &[NodeId],
    velocity: impl Fn(&NodeId) -> DVec3,
    period_s: f64,
) -> [DVec3; 4] {
    let balance_n = |row: &[DMat3; 4]| {
        nodes.iter().zip(row).map(|(node, block)| *block * (velocity(node) * period_s)).sum::<DVec3>()
    };
    stiffness.each_ref().map(|row| -balance_n(row))
}

/// Masses, supports and loads of a body's nodes.
pub(in crate::model) trait LocalFrame {
    fn inertia_kg(&self, n: usize) -> f64;
    /// Axes along which a node moves freely when no tool holds it.
    fn free_axes(&self, n: usize) -> [bool; 3];
    /// Whether a tool holds a node.
    fn is_held(&self, n: usize) -> bool;
    /// Force [N] of constraints and outer forces on a node, without weight.
    fn load_on_n(&self, n: usize) -> DVec3;
    /// Damping of masses and stiffness.
    fn damping(&self) -> Rayleigh;
}

/// The law of a tetrahedron, for its tangent.
pub(in crate::model) enum TangentLaw<'a> {
    /// Small strain.
    Linear { lambda_pa: f64, mu_pa: f64 },
    /// St Venant-Kirchhoff, with a fibre or without.
    Kirchhoff(TetLaw),
    /// Any.
    Any(&'a dyn Material),
}

/// Tangent of a tetrahedron at its corners' displacements, with a stress in the rest shape.
pub(in crate::model) fn tet_tangent(
    gradients: &P1Gradients,
    u_m: [DVec3; 4],
    law: &TangentLaw<'_>,
    rest_stress_pa: Option<&RestStress>,
) -> ElementStiffness {
    let alpha = gradients.alpha_per_m;
    let volume_m3 = gradients.volume_m3;
    let f: DMat3 = (0..4).fold(DMat3::IDENTITY, |f, k| f + outer(u_m[k], alpha[k]));
    let geometric = |s_pa: DMat3, j: usize, k: usize| {
        DMat3::from_diagonal(DVec3::splat(volume_m3 * alpha[j].dot(s_pa * alpha[k])))
    };
    let mut stiffness = match law {
        TangentLaw::Linear { lambda_pa, mu_pa } => between(&gradients.stiffness(*lambda_pa, *mu_pa)),
        TangentLaw::Kirchhoff(law) => {
            let strain = (f.transpose() * f - DMat3::IDENTITY) * 0.5;
            let s_pa = law.stress_pa(strain);
            let at_rest = between(&linear_stiffness(law, gradients));
            std::array::from_fn(|j| {
                std::array::from_fn(|k| f * at_rest[j][k] * f.transpose() + geometric(s_pa, j, k))
            })
        }
        TangentLaw::Any(law) => {
            let tangent = law.tangent_pa(&f);
            std::array::from_fn(|j| {
                std::array::from_fn(|k| {
                    let entry = |r: usize, c: usize| -> f64 {
                        let pairs = (0..3).flat_map(|p| (0..3).map(move |q| (p, q)));
                        pairs.map(|(p, q)| alpha[j][p] * tangent[3 * p + r][3 * q + c] * alpha[k][q]).sum()
                    };
                    let column = |c: usize| DVec3::new(entry(0, c), entry(1, c), entry(2, c)) * volume_m3;
                    DMat3::from_cols(column(0), column(1), column(2))
                })
            })
        }
    };
    if let Some(stress_pa) = rest_stress_pa {
        add_rest_stress(gradients, stress_pa, &mut stiffness);
    }
    stiffness
}

/// The tangent's product with a motion of the corners, without the tangent: forces [N] that balance the change of the deformation.
pub(in crate::model) fn tet_tangent_times(
    gradients: &P1Gradients,
    [u_m, moves_m]: [[DVec3; 4]; 2],
    law: &TangentLaw<'_>,
    rest_stress_pa: Option<&RestStress>,
) -> [DVec3; 4] {
    let alpha = gradients.alpha_per_m;
    let gradient = |of_corners: [DVec3; 4]| (0..4).map(|k| outer(of_corners[k], alpha[k])).sum::<DMat3>();
    let (f, df) = (DMat3::IDENTITY + gradient(u_m), gradient(moves_m));
    let symmetric = |m: DMat3| (m + m.transpose()) * 0.5;
    let mut change_pa = match law {
        TangentLaw::Linear { lambda_pa, mu_pa } => {
            let strain = symmetric(df);
            let trace = strain.x_axis.x + strain.y_axis.y + strain.z_axis.z;
            strain * (2.0 * mu_pa) + DMat3::from_diagonal(DVec3::splat(lambda_pa * trace))
        }
        TangentLaw::Kirchhoff(law) => {
            let strain = (f.transpose() * f - DMat3::IDENTITY) * 0.5;
            df * law.stress_pa(strain) + f * law.stress_pa(symmetric(f.transpose() * df))
        }
        TangentLaw::Any(law) => law.first_piola_differential_pa(&f, &df),
    };
    if let Some(stress_pa) = rest_stress_pa {
        change_pa += df * stress_tensor_pa(*stress_pa);
    }
    alpha.map(|alpha| change_pa * alpha * gradients.volume_m3)
}

/// Adds the stiffness of a stress in the rest shape, which does not depend on the present shape.
pub(in crate::model) fn add_rest_stress(
    gradients: &P1Gradients,
    stress_pa: &RestStress,
    stiffness: &mut ElementStiffness,
) {
    let (alpha, tensor_pa) = (gradients.alpha_per_m, stress_tensor_pa(*stress_pa));
    for (j, row) in stiffness.iter_mut().enumerate() {
        for (k, block) in row.iter_mut().enumerate() {
            let share = gradients.volume_m3 * alpha[j].dot(tensor_pa * alpha[k]);
            *block += DMat3::from_diagonal(DVec3::splat(share));
        }
    }
}

/// Stiffness of a link that pulls its ends together by the tensor times their distance.
pub(in crate::model) fn of_edge(tensor: DMat3) -> ElementStiffness {
    let mut square = [[DMat3::ZERO; 4]; 4];
    (square[0][0], square[1][1]) = (tensor, tensor);
    (square[0][1], square[1][0]) = (-tensor, -tensor);
    square
}

/// The ten tensors as a square.
fn between(stiffness: &TetStiffness) -> ElementStiffness {
    let mut square = [[DMat3::ZERO; 4]; 4];
    for (j, vertex) in stiffness.vertex.iter().enumerate() {
        square[j][j] = *vertex;
    }
    for ([j, k], edge) in LOCAL_EDGES.into_iter().zip(&stiffness.edge) {
        square[j][k] = *edge;
        square[k][j] = edge.transpose();
    }
    square
}

/// Computes C of a patch after [`LocalModel::start`]. Without a positive period it stays zero.
pub(in crate::model) fn compute(body: &dyn LocalBody, work: &mut LocalWork, out: &mut LocalModel) {
    let h_s = out.period_s;
    for (i, node) in out.nodes.iter().enumerate() {
        out.force_n[i] = body.frame().load_on_n(node.index());
        out.mass_kg[i] = body.frame().inertia_kg(node.index());
    }
    if !(h_s.is_finite() && h_s > 0.0) || out.nodes.is_empty() {
        return;
    }
    if work.least_rings == 1
        && let Some(n_parts) = body.short_step_parts(h_s)
    {
        if work.tells_drift && work.tells_changes {
            work.start(out);
            work.add_ring(body, true);
            work.sum_changes(body, out);
            work.end();
        }
        of_short_step(body, n_parts, work.tells_drift, out);
        return;
    }
    work.start(out);
    // First the tetrahedra at the patch: they determine how many rings are needed.
    work.add_ring(body, true);
    let wanted = rings_for(work.condition_bound(body, h_s)).clamp(work.least_rings, work.most_rings);
    let mut n_rings = 1;
    while n_rings < wanted && work.add_ring(body, false) {
        n_rings += 1;
    }
    // One ring is assembled already, for the bound of the condition.
    if n_rings > 1 {
        work.assemble(body, h_s);
    }
    out.n_rings = Some(n_rings);
    if work.tells_drift {
        for (node, drift_m) in out.nodes.iter().zip(&mut out.drift_m) {
            *drift_m = body.velocity_m_per_s(node.index()) * h_s;
        }
    }
    match work.path.run_by_eight(Columns { work, out }) {
        // A tangent of such tissue tells nothing of what its forces change by either.
        Solved::Never => of_masses(body, work.tells_drift, out),
        solved => {
            out.missed_tolerance = solved == Solved::Partly;
            out.symmetrize();
            if work.tells_changes && body.is_explicit() {
                for (changed_n, of_node) in out.changed_n.iter_mut().zip(work.braking_n.chunks_exact(3)) {
                    *changed_n = Some(DVec3::from_slice(of_node));
                }
            }
        }
    }
    work.end();
}

fn rings_for(condition: f64) -> u32 {
    let root = condition.max(1.0 + 1e-9).sqrt();
    let rings = libm::log(ECHO) / (2.0 * libm::log((root - 1.0) / (root + 1.0)));
    if rings.is_finite() { (rings.ceil() as u32).clamp(1, MOST_RINGS) } else { MOST_RINGS }
}

impl LocalWork {
    fn start(&mut self, out: &LocalModel) {
        let n_nodes = out.nodes.iter().map(|n| n.index() + 1).max().unwrap_or(0);
        if self.place.len() < n_nodes {
            self.place.resize(n_nodes, 0);
        }
        self.region.clear();
        self.elements.clear();
        for node in &out.nodes {
            self.region.push(node.0);
            self.place[node.index()] = self.region.len() as u32;
        }
        self.n_patch = out.nodes.len();
    }

    fn end(&mut self) {
        for n in self.region.drain(..) {
            self.place[n as usize] = 0;
        }
    }

    fn place(&self, node: NodeId) -> Option<usize> {
        (*self.place.get(node.index())? as usize).checked_sub(1)
    }

    /// All live elements at a node of the region, and unless it `is_first` before them the nodes of those found
    /// before. False when the region is full or whole.
    fn add_ring(&mut self, body: &dyn LocalBody, is_first: bool) -> bool {
        let elements = body.elements();
        if !is_first {
            let n_before = self.region.len();
            for i in 0..self.elements.len() {
                for &node in elements.nodes(self.elements[i] as usize) {
                    if self.place(node).is_some() {
                        continue;
                    }
                    if self.region.len() == MOST_REGION {
                        // No part of a ring: which part would be arbitrary.
                        for n in self.region.drain(n_before..) {
                            self.place[n as usize] = 0;
                        }
                        return false;
                    }
                    if self.place.len() <= node.index() {
                        self.place.resize(node.index() + 1, 0);
                    }
                    self.region.push(node.0);
                    self.place[node.index()] = self.region.len() as u32;
                }
            }
            if self.region.len() == n_before {
                return false;
            }
        }
        self.elements.clear();
        // Without a branch for each node: nearly all elements are elsewhere.
        let place = &self.place;
        let mark = |node: NodeId| place.get(node.index()).copied().unwrap_or(0);
        let mut keep = |e: usize, marks: u32| {
            if marks != 0 && body.is_live(e) {
                self.elements.push(e as u32);
            }
        };
        match elements {
            LocalElements::Tets(all) => {
                for (e, &[a, b, c, d]) in all.iter().enumerate() {
                    keep(e, mark(a) | mark(b) | mark(c) | mark(d));
                }
            }
            LocalElements::Edges(all) => {
                for (e, &[a, b]) in all.iter().enumerate() {
                    keep(e, mark(a) | mark(b));
                }
            }
        }
        true
    }

    /// 1 + h^2 times Gershgorin's bound of the squared frequency at the patch, damping included.
    fn condition_bound(&mut self, body: &dyn LocalBody, h_s: f64) -> f64 {
        self.assemble(body, h_s);
        let damping = body.damping();
        let mut worst = 1.0_f64;
        for i in 0..self.region.len() {
            let n = self.region[i] as usize;
            let of_mass = body.frame().inertia_kg(n) * (1.0 / h_s + damping.mass_per_s) / h_s;
            // Held neighbours are not among the columns: twice the diagonal stands for a row of K, whose sum is zero.
            for a in 0..3 {
                let inverse = self.inverse_diagonal[3 * i + a];
                if inverse > 0.0 && of_mass > 0.0 {
                    worst = worst.max(2.0 / (inverse * of_mass) - 1.0);
                }
            }
        }
        worst
    }

    /// What the elements of the region do to the patch as they move on for a period.
    fn sum_changes(&self, body: &dyn LocalBody, out: &mut LocalModel) {
        let elements = body.elements();
        for &element in &self.elements {
            let element = element as usize;
            let changes_n = body.change_n(element, out.period_s);
            for (node, change_n) in elements.nodes(element).iter().zip(changes_n) {
                let place = self.place(*node).filter(|place| *place < self.n_patch);
                if let Some(place) = place.filter(|_| change_n.is_finite()) {
                    *out.changed_n[place].get_or_insert(DVec3::ZERO) += change_n;
                }
            }
        }
    }

    /// The matrix of the region, row after row.
    fn assemble(&mut self, body: &dyn LocalBody, h_s: f64) {
        let n = self.region.len();
        let damping = body.damping();
        self.head.clear();
        self.head.resize(n, 0);
        self.blocks.clear();
        for i in 0..n {
            let of_mass =
                body.frame().inertia_kg(self.region[i] as usize) * (1.0 / h_s + damping.mass_per_s) / h_s;
            self.add_block(i, i, DMat3::from_diagonal(DVec3::splat(of_mass)));
        }
        let per_stiffness = 1.0 + damping.stiffness_s / h_s;
        self.braking_n.clear();
        self.braking_n.resize(if self.tells_drift { 3 * n } else { 0 }, 0.0);
        let elements = body.elements();
        for e in 0..self.elements.len() {
            let e = self.elements[e] as usize;
            let stiffness = body.stiffness(e, h_s);
            let nodes = elements.nodes(e);
            let is_usable =
                stiffness[..nodes.len()].iter().all(|row| row[..nodes.len()].iter().all(|b| b.is_finite()));
            if !is_usable {
                continue;
            }
            let velocity = |node: &NodeId| body.velocity_m_per_s(node.index());
            let braking_n = self.tells_drift.then(|| change_of(&stiffness, nodes, velocity, h_s));
            for (j, &row) in nodes.iter().enumerate() {
                let Some(row) = self.place(row) else { continue };
                if let Some(braking_n) = &braking_n {
                    (0..3).for_each(|axis| self.braking_n[3 * row + axis] += braking_n[j][axis]);
                }
                for (k, &column) in nodes.iter().enumerate() {
                    if let Some(column) = self.place(column) {
                        self.add_block(row, column, stiffness[j][k] * per_stiffness);
                    }
                }
            }
        }
        self.list_rows(body);
    }

    /// The blocks row after row, and what is on the diagonal.
    fn list_rows(&mut self, body: &dyn LocalBody) {
        self.row_start.clear();
        self.columns.clear();
        self.entries.clear();
        self.inverse_diagonal.clear();
        for i in 0..self.region.len() {
            self.row_start.push(self.columns.len() as u32);
            let node = self.region[i] as usize;
            // What other tools hold stays there; the patch itself is let go.
            let free = if i >= self.n_patch && body.frame().is_held(node) {
                [false; 3]
            } else {
                body.frame().free_axes(node)
            };
            let mut at = self.head[i];
            while at != 0 {
                let (next, column, block) = self.blocks[at as usize - 1];
                if column as usize == i {
                    for (a, is_free) in free.into_iter().enumerate() {
                        let inverse = if is_free && block[4 * a] > 0.0 { 1.0 / block[4 * a] } else { 0.0 };
                        self.inverse_diagonal.push(inverse);
                    }
                }
                self.columns.push(column);
                self.entries.push(block);
                at = next;
            }
        }
        self.row_start.push(self.columns.len() as u32);
    }

    /// Adds to a block, row by row in it.
    fn add_block(&mut self, row: usize, column: usize, tensor: DMat3) {
        let t = tensor.transpose().to_cols_array();
        let mut at = self.head[row];
        while at != 0 {
            let (next, of, block) = &mut self.blocks[at as usize - 1];
            if *of as usize == column {
                block.iter_mut().zip(t).for_each(|(b, t)| *b += t);
                return;
            }
            at = *next;
        }
        self.blocks.push((self.head[row], column as u32, t));
        self.head[row] = self.blocks.len() as u32;
    }
}
