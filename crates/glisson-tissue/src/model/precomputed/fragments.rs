//! A piece that was cut loose from a pre-computed body: it falls, swings and deforms by explicit dynamics.
//!
//! The piece is a body of its own on the explicit kernel. It can rotate far, so its law is stable neo-Hookean with the
//! same moduli at small strain. Its hinges (nodes that the held body or another piece moves) are driven; the force that
//! this takes acts on the held body with a delay ([`MOST_PULL_SHARE`]). It does not act on other pieces.

use super::NONE;
use super::low_rank::RemovedTet;
use crate::material::LinearElastic;
use crate::model::explicit_kernel::{ExplicitKernel, ExplicitKernelError, ExplicitKernelParams};
use crate::model::kernel::KernelLaw;
use crate::model::{
    Constraints, DeformableModel, DynamicBody, FixedNode, ImposedDisplacement, LocalModel, LocalWork,
    ModelReport, NodalForce, Rayleigh, TopologyRefusal,
};
use crate::solve::{BoundaryConditions, StaticProblem, solve_static};
use glisson_mesh::math::DVec3;
use glisson_mesh::mesh::edit::{EditableMesh, TopologyChange};
use glisson_mesh::mesh::topology::TET_TRIANGLES;
use glisson_mesh::mesh::{NodeId, TetId, TetMesh};

/// Largest share of a new pull that acts on the held body in each step: a choice. The held body responds at once and has
/// no mass. The whole pull of a piece that is k times stiffer at the hinge would oscillate with growing amplitude for
/// k > 1; with a share s it does not for s < 2/(1 + k). For a large k the share is smaller.
pub(super) const MOST_PULL_SHARE: f64 = 1.0 / 32.0;

/// A hinge pulls no harder than tissue as stiff as at rest that is stretched to so many times its length: a choice, beyond
/// what tissue bears.
const MOST_REACH: f64 = 4.0;

/// Mass damping of a fragment [1/s]: a choice, so that a swing fades within seconds.
const DAMPING_PER_S: f64 = 1.0;

/// Stiffness damping as a share of the stable step: a choice, so that motions too fast to be seen fade within a few steps.
const STIFFNESS_DAMPING_SHARE: f64 = 0.5;

/// The piece's step as a share of the largest stable one.
const STEP_SHARE: f64 = 0.9;

/// Shortest internal step [s]: where tetrahedra of a piece would ask for shorter ones, they become heavier instead. A
/// choice: twenty parts of a millisecond, enough for soft tissue of tetrahedra above about 0.2 mm.
const SHORTEST_STEP_S: f64 = 5e-5;

/// Number of parts into which a step may be divided once the piece itself is cut, if each stays that long.
const MOST_PARTS: f64 = 64.0;

/// What moves a node of a piece in a step.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Mover {
    /// The owner of a hinge: place among the hinges.
    Owner(u32),
    /// A tool: place among the constraints of the whole body.
    Tool(u32),
}

/// A hinge.
#[derive(Clone, Copy, Debug)]
pub(super) struct Hinge {
    pub(super) node: NodeId,
    local: u32,
    /// Force on the owner [N].
    pub(super) pull_n: DVec3,
}

/// One piece, or several that came loose in the same edit.
#[derive(Debug)]
pub(super) struct Fragment {
    /// Ascending; local numbers are the places in it.
    pub(super) nodes: Vec<NodeId>,
    /// Ascending.
    tets: Vec<TetId>,
    body: EditableMesh,
    kernel: ExplicitKernel,
    /// Lambda + 2 mu: stiffness at rest against a plane stretch [Pa].
    stiffness_pa: f64,
    local: LocalModel,
    /// Nodes that are heavier than their tissue from the start.
    n_heavier: u32,
    pub(super) hinges: Vec<Hinge>,
    movers: Vec<(u32, Mover, DVec3)>,
    constraints: Constraints,
    scratch_m: Vec<DVec3>,
}

impl Clone for Fragment {
    /// A copy with the same capacity, so that it allocates as little in a step.
    fn clone(&self) -> Self {
        let mut movers = Vec::with_capacity(self.movers.capacity());
        movers.extend_from_slice(&self.movers);
        let mut constraints = room_for(self.nodes.len());
        constraints.displacements.extend_from_slice(&self.constraints.displacements);
        constraints.forces.extend_from_slice(&self.constraints.forces);
        Self {
            nodes: self.nodes.clone(),
            tets: self.tets.clone(),
            body: self.body.clone(),
            kernel: self.kernel.clone(),
            stiffness_pa: self.stiffness_pa,
            local: LocalModel::new(),
            n_heavier: self.n_heavier,
            hinges: self.hinges.clone(),
            movers,
            constraints,
            scratch_m: self.scratch_m.clone(),
        }
    }
}

fn room_for(n_nodes: usize) -> Constraints {
    Constraints { displacements: Vec::with_capacity(n_nodes), forces: Vec::with_capacity(n_nodes) }
}

/// Parameters of a piece.
pub(super) struct FragmentParams<'a> {
    pub(super) mesh: &'a TetMesh,
    pub(super) material: &'a LinearElastic,
    /// Ascending.
    pub(super) tets: &'a [TetId],
    pub(super) is_fixed: &'a [bool],
    pub(super) positions_m: &'a [DVec3],
    /// Nodes whose position is given; the others follow by linear elasticity.
    pub(super) is_placed: &'a dyn Fn(NodeId) -> bool,
    pub(super) gravity_m_per_s2: DVec3,
}

impl Fragment {
    /// A piece with the present shape, at rest, without hinges.
    pub(super) fn new(params: &FragmentParams<'_>) -> Result<Self, ExplicitKernelError> {
        let mesh = params.mesh;
        let of_tet = |t: &TetId| mesh.tetrahedra[t.index()];
        let mut nodes: Vec<NodeId> = params.tets.iter().flat_map(of_tet).collect();
        nodes.sort_unstable();
        nodes.dedup();
        let local = |n: NodeId| NodeId::from_index(nodes.binary_search(&n).expect("nodes of the piece"));
        let own = TetMesh {
            positions_m: nodes.iter().map(|n| mesh.positions_m[n.index()]).collect(),
            tetrahedra: params.tets.iter().map(|t| of_tet(t).map(local)).collect(),
            ..TetMesh::default()
        };
        let fixed: Vec<FixedNode> = nodes
            .iter()
            .filter(|n| params.is_fixed[n.index()])
            .map(|&n| FixedNode::all_axes(local(n)))
            .collect();
        let material = params.material;
        let body = DynamicBody {
            fixed: &fixed,
            gravity_m_per_s2: params.gravity_m_per_s2,
            damping: Rayleigh::of_mass(DAMPING_PER_S),
            ..DynamicBody::new(&own, material.density_kg_per_m3())
        };
        let materials = std::slice::from_ref(material);
        // A piece comes in an edit, and few are cut again.
        let mut kernel_params = ExplicitKernelParams {
            expects_edits: false,
            ..ExplicitKernelParams::new(body, KernelLaw::StableNeoHooke, materials)
        };
        let undamped_s = ExplicitKernel::stable_step(&kernel_params)?.step_s;
        kernel_params.body.damping.stiffness_s = STIFFNESS_DAMPING_SHARE * undamped_s;
        let stable = ExplicitKernel::stable_step(&kernel_params)?;
        let step_s = STEP_SHARE * stable.step_s;
        kernel_params.body.most_parts = (step_s / SHORTEST_STEP_S).floor().clamp(1.0, MOST_PARTS) as u32;
        let mut n_heavier = 0;
        let mut kernel = if step_s >= SHORTEST_STEP_S {
            kernel_params.body.time_step_s = step_s;
            ExplicitKernel::build(&kernel_params)?
        } else {
            // Build with a step that needs no mass scaling, then lengthen the step.
            kernel_params.body.time_step_s = stable.after_cuts_s;
            let mut kernel = ExplicitKernel::build(&kernel_params)?;
            let (density, stretch) = (material.density_kg_per_m3(), kernel_params.largest_stretch);
            n_heavier = kernel.lengthen_step(material, density, stretch, SHORTEST_STEP_S);
            kernel
        };
        kernel.take_over(&shape(params, &nodes, &own));
        let n = nodes.len();
        let body = EditableMesh::new(own).map_err(|_| crate::solve::SolveError::EmptyMesh)?;
        Ok(Self {
            tets: params.tets.to_vec(),
            body,
            kernel,
            stiffness_pa: material.lambda_pa() + 2.0 * material.mu_pa(),
            local: LocalModel::new(),
            n_heavier,
            hinges: Vec::new(),
            movers: Vec::with_capacity(n),
            constraints: room_for(n),
            scratch_m: vec![DVec3::ZERO; n],
            nodes,
        })
    }

    pub(super) fn local(&self, node: NodeId) -> Option<u32> {
        self.nodes.binary_search(&node).ok().map(|n| n as u32)
    }

    pub(super) fn has_tet(&self, tet: TetId) -> bool {
        self.tets.binary_search(&tet).is_ok()
    }

    /// Removes tetrahedra of the piece.
    ///
    /// # Errors
    /// [`TopologyRefusal`] when its model cannot follow; the piece is of no use then.
    pub(super) fn remove(&mut self, tets: &[TetId]) -> Result<(), TopologyRefusal> {
        let local: Vec<TetId> = tets
            .iter()
            .filter_map(|t| self.tets.binary_search(t).ok())
            .map(TetId::from_index)
            .filter(|&t| self.body.topology().is_live_tet(t))
            .collect();
        if local.is_empty() {
            return Ok(());
        }
        let mut change = TopologyChange::default();
        self.body.remove_into(&local, &mut change).expect("live tetrahedra, each once");
        self.kernel.topology_changed(self.body.mesh(), &change)
    }

    /// Whether a node still has a tetrahedron of the piece.
    pub(super) fn moves(&self, local: u32) -> bool {
        self.body.topology().is_live_node(NodeId(local))
    }

    /// Sets the nodes that others drive; hinges that stay keep their pull.
    pub(super) fn set_hinges(&mut self, is_driven: impl Fn(NodeId) -> bool) {
        let old = std::mem::take(&mut self.hinges);
        for (local, &node) in self.nodes.iter().enumerate() {
            let local = local as u32;
            if is_driven(node) && self.moves(local) {
                let pull_n = old.iter().find(|h| h.node == node).map_or(DVec3::ZERO, |hinge| hinge.pull_n);
                self.hinges.push(Hinge { node, local, pull_n });
            }
        }
        let hinges = &self.hinges;
        self.movers.retain(|(local, _, _)| hinges.iter().all(|h| h.local != *local));
    }

    /// Clears the loads and tools.
    pub(super) fn release(&mut self) {
        self.movers.clear();
        self.constraints.forces.clear();
    }

    /// Lets a tool move a node in the coming steps; returns whether the node can be moved.
    pub(super) fn impose(&mut self, local: u32, place: u32, displacement_m: DVec3) -> bool {
        let is_free = self.moves(local) && self.hinges.iter().all(|h| h.local != local);
        if is_free && self.movers.len() < self.movers.capacity() {
            self.movers.push((local, Mover::Tool(place), displacement_m));
            return true;
        }
        false
    }

    /// Applies a force to a node in the coming steps; returns whether it can act.
    pub(super) fn push(&mut self, local: u32, force_n: DVec3) -> bool {
        let has_room = self.constraints.forces.len() < self.constraints.forces.capacity();
        let moves = self.moves(local) && has_room;
        if moves {
            self.constraints.forces.push(NodalForce { node: NodeId(local), force_n });
        }
        moves
    }

    /// Advances by one step. `displacement_m` gives the hinges' displacements from rest [m], `pull_share` is the share of a
    /// new pull that acts on the held body, `feel` is called with the force of each tool (place, force [N]).
    pub(super) fn step(
        &mut self,
        dt_s: f64,
        displacement_m: impl Fn(NodeId) -> DVec3,
        pull_share: f64,
        mut feel: impl FnMut(u32, DVec3),
    ) {
        self.movers.retain(|(_, mover, _)| matches!(mover, Mover::Tool(_)));
        for (h, hinge) in self.hinges.iter().enumerate() {
            if self.movers.len() < self.movers.capacity() {
                self.movers.push((hinge.local, Mover::Owner(h as u32), displacement_m(hinge.node)));
            }
        }
        self.movers.sort_unstable_by_key(|(local, _, _)| *local);
        self.constraints.displacements.clear();
        let imposed =
            |&(local, _, displacement_m)| ImposedDisplacement { node: NodeId(local), displacement_m };
        self.constraints.displacements.extend(self.movers.iter().map(imposed));
        self.kernel.apply(&self.constraints);
        self.kernel.step(dt_s);
        for (&(_, mover, _), &force_n) in self.movers.iter().zip(self.kernel.constraint_forces_n()) {
            let force_n = if force_n.is_finite() { force_n } else { DVec3::ZERO };
            match mover {
                Mover::Tool(place) => feel(place, force_n),
                Mover::Owner(h) => {
                    let most_n = self.most_pull_n(self.hinges[h as usize].local);
                    let pull_n = &mut self.hinges[h as usize].pull_n;
                    *pull_n += ((-force_n).clamp_length_max(most_n) - *pull_n) * pull_share;
                }
            }
        }
    }

    /// The most that the held body feels of a hinge [N]: what its tetrahedra, as stiff as at rest, would do if it were as far
    /// from its place between their other nodes as the furthest of these is, [`MOST_REACH`] edges at most. The share of a new pull
    /// is made for that stiffness; tissue that is stretched further is stiffer by orders, and would swing up without end.
    ///
    /// A node's own stiffness in a tetrahedron of volume V is at most V (lambda + 2 mu) / h^2 = (lambda + 2 mu) A^2 / (9 V), h
    /// its height over the opposite face, A that face's area.
    fn most_pull_n(&self, local: u32) -> f64 {
        let (topology, mesh) = (self.body.topology(), self.body.mesh());
        let now_m = self.positions_m();
        let (mut stiffness_n_per_m, mut furthest_m, mut edge_m) = (0.0, 0.0_f64, 0.0_f64);
        let away_m = |all_m: &[DVec3], n: NodeId| all_m[n.index()].distance(all_m[local as usize]);
        for &tet in topology.node_tets(NodeId(local)) {
            let nodes = topology.tet_nodes(tet);
            let own = nodes.iter().position(|n| n.0 == local).unwrap_or(0);
            let [a, b, c] = TET_TRIANGLES[own].map(|i| mesh.positions_m[nodes[i].index()]);
            let area_m2 = 0.5 * (b - a).cross(c - a).length();
            stiffness_n_per_m += self.stiffness_pa * area_m2 * area_m2 / (9.0 * mesh.tet_volume_m3(tet));
            for n in nodes {
                furthest_m = furthest_m.max(away_m(now_m, n));
                edge_m = edge_m.max(away_m(&mesh.positions_m, n));
            }
        }
        stiffness_n_per_m * furthest_m.min(MOST_REACH * edge_m)
    }

    /// Adds K x over the hinges to `force_n`, for displacements x of the hinges and K of the uncut rest shape: the
    /// stiffness with which the piece answers to its hinges at once.
    pub(super) fn add_hinge_forces(&self, material: &LinearElastic, x_m: &[DVec3], force_n: &mut [DVec3]) {
        let of = |local: u32| self.hinges.iter().position(|h| h.local == local);
        let topology = self.body.topology();
        let mut tets: Vec<TetId> =
            self.hinges.iter().flat_map(|h| topology.node_tets(NodeId(h.local))).copied().collect();
        tets.sort_unstable();
        tets.dedup();
        for t in tets {
            let nodes = topology.tet_nodes(t);
            let tet =
                RemovedTet::new(nodes, self.body.mesh().corners_m(t), material.lambda_pa(), material.mu_pa());
            let hinges = nodes.map(|n| of(n.0));
            let forces_n = tet.forces_n(hinges.map(|h| h.map_or(DVec3::ZERO, |h| x_m[h])));
            for (hinge, f) in hinges.into_iter().zip(forces_n) {
                if let Some(hinge) = hinge {
                    force_n[hinge] += f;
                }
            }
        }
    }

    pub(super) fn positions_m(&self) -> &[DVec3] {
        self.kernel.state().positions_m
    }

    pub(super) fn take_over(&mut self, positions_m: &[DVec3]) {
        for (own, node) in self.scratch_m.iter_mut().zip(&self.nodes) {
            *own = positions_m[node.index()];
        }
        self.kernel.take_over(&self.scratch_m);
        for hinge in &mut self.hinges {
            hinge.pull_n = DVec3::ZERO;
        }
    }

    pub(super) fn set_gravity(&mut self, gravity_m_per_s2: DVec3) {
        self.kernel.set_gravity(gravity_m_per_s2);
    }

    /// The local model of some of its nodes over a period; hinges that are not in the patch are held.
    pub(super) fn local_model(
        &mut self,
        locals: impl Iterator<Item = NodeId>,
        period_s: f64,
        work: &mut LocalWork,
    ) -> &LocalModel {
        let mut patch = [NodeId(0); LocalModel::MOST_NODES];
        let mut n = 0;
        for (to, local) in patch.iter_mut().zip(locals) {
            *to = local;
            n += 1;
        }
        self.kernel.local_model_into(&patch[..n], period_s, work, &mut self.local);
        &self.local
    }

    /// Sets its velocities [m/s] from those of all nodes of the whole body.
    pub(super) fn start_with(&mut self, velocities_m_per_s: &[DVec3]) {
        let nodes = &self.nodes;
        self.kernel.start_with(|local| velocities_m_per_s[nodes[local.index()].index()]);
    }

    pub(super) fn velocities_m_per_s(&self) -> &[DVec3] {
        self.kernel.state().velocities_m_per_s
    }

    pub(super) fn report(&self) -> ModelReport {
        let report = self.kernel.report();
        let n_mass_scaled_nodes = report.n_mass_scaled_nodes.max(self.n_heavier);
        ModelReport { n_mass_scaled_nodes, ..report }
    }

    /// Appends the state that the next step depends on besides the positions.
    pub(super) fn history_into(&self, numbers: &mut Vec<f64>) {
        let pulls_n = self.hinges.iter().map(|hinge| hinge.pull_n);
        let of_vectors = self.velocities_m_per_s().iter().copied().chain(pulls_n);
        numbers.extend(of_vectors.flat_map(|v| v.to_array()));
        self.kernel.history_into(numbers);
    }
}

/// Present positions of the piece's nodes [m]: those that are not placed follow by linear elasticity.
fn shape(params: &FragmentParams<'_>, nodes: &[NodeId], own: &TetMesh) -> Vec<DVec3> {
    let now: Vec<DVec3> = nodes.iter().map(|n| params.positions_m[n.index()]).collect();
    let mut conditions = BoundaryConditions::new();
    let mut n_open = 0;
    for (local, &node) in nodes.iter().enumerate() {
        if (params.is_placed)(node) || params.is_fixed[node.index()] {
            conditions.impose_node(NodeId::from_index(local), now[local] - own.positions_m[local]);
        } else {
            n_open += 1;
        }
    }
    if n_open == 0 {
        return now;
    }
    let nodal_force_n = vec![DVec3::ZERO; nodes.len()];
    let problem = StaticProblem {
        mesh: own,
        material: params.material,
        conditions: &conditions,
        nodal_force_n: &nodal_force_n,
    };
    match solve_static(&problem) {
        Ok(solution) => {
            own.positions_m.iter().zip(&solution.displacement_m).map(|(rest, u)| *rest + *u).collect()
        }
        // Too few of its nodes are given: it starts with its published shape.
        Err(_) => now,
    }
}

/// The piece that moves each node, if one does.
#[derive(Clone, Debug)]
pub(super) struct Owners(Vec<u32>);

impl Owners {
    pub(super) fn none(n_nodes: usize) -> Self {
        Self(vec![NONE; n_nodes])
    }

    pub(super) fn of(&self, node: NodeId) -> Option<usize> {
        let piece = *self.0.get(node.index())?;
        (piece != NONE).then_some(piece as usize)
    }

    pub(super) fn set(&mut self, node: NodeId, piece: usize) {
        self.0[node.index()] = piece as u32;
    }
}
