//! The dynamic zones as one body: tensor-mass with the other zones condensed onto its nodes.
//!
//! Linear zones use tensors on vertices and edges, St Venant-Kirchhoff zones their tetrahedra ([`KirchhoffTet`]). Both
//! start from the same rest shape, so their forces add up at shared nodes. The other zones stay linear.
//!
//! All dynamic zones are one body, so zones that touch need no coupling (seed `003` s. 4.3.2.1). It moves by the
//! central differences of the tensor-mass model on the dynamic tetrahedra. The pre-computed tetrahedra around them
//! count for the masses and the stable step; their other corners are held.

use super::ZoneLaw;
use super::columns::SymmetricTiles;
use super::zone::{SubMesh, Whole};
use crate::model::explicit::{
    ExplicitError, ExplicitMotion, LiveTets, Mover, Padded, Quarantine, Stability, StiffTet, unpadded,
};
use crate::model::hybrid::kirchhoff::KirchhoffTet;
use crate::model::tensor_mass::VertexEdgeTensors;
use crate::model::tet_law::TetLaw;
use crate::model::{Attachment, DynamicBody, FixedNode, ModelReport};
use crate::solve::P1Gradients;
use glisson_mesh::math::DVec3;
use glisson_mesh::mesh::{NodeId, TetId, TetMesh};

/// Marks a node or tetrahedron that is no longer in the mesh.
const GONE: u32 = u32::MAX;

/// The dynamic zones.
#[derive(Clone)]
pub(super) struct DynamicPart {
    /// Node of the mesh for each of the body's.
    nodes: Vec<u32>,
    /// Tetrahedron of the mesh for each of the body's: linear dynamic ones, non-linear dynamic ones, those around them.
    /// Each group ascends but for those that are gone.
    tets: Vec<u32>,
    mesh: TetMesh,
    live: LiveTets,
    n_linear_tets: usize,
    n_dynamic_tets: usize,
    /// Number of live dynamic tetrahedra at each node; a node with any is dynamic.
    dynamic_tets: Vec<u32>,
    /// Number of live linear dynamic tetrahedra at each node.
    linear_tets: Vec<u32>,
    /// Tensors of the linear zones, if there are any.
    tensors: Option<VertexEdgeTensors>,
    /// The non-linear dynamic tetrahedra in order, and their law.
    kirchhoff: Vec<KirchhoffTet>,
    law: TetLaw,
    pub(super) motion: ExplicitMotion,
    /// Nodes of the body on the frontier with pre-computed zones, in the interface's order.
    frontier: Vec<u32>,
    /// Their displacements [m], and the forces [N] on them, padded to whole tiles.
    frontier_m: Vec<f64>,
    frontier_n: Vec<f64>,
}

/// What the dynamic part is cut from.
pub(super) struct DynamicSource<'a> {
    pub(super) whole: &'a Whole<'a>,
    pub(super) body: &'a DynamicBody<'a>,
    /// The law of each tetrahedron, and whether it is live.
    pub(super) law_of_tet: &'a [ZoneLaw],
    pub(super) is_live_tet: &'a [bool],
    /// The stable step holds while the principal stretches of St Venant-Kirchhoff zones stay within [1/s, s] for this s.
    pub(super) largest_stretch: f64,
    /// Nodes of live dynamic tetrahedra.
    pub(super) is_dynamic: &'a [bool],
    /// Whether edits brought something in: then the stable step is that of the worst tetrahedron alone.
    pub(super) is_cut: bool,
    /// The part before, under the same laws: tetrahedra that are as they were keep their bounds.
    pub(super) before: Option<&'a DynamicPart>,
}

/// The tetrahedra of the dynamic part, and the mesh that they make.
struct CutOut {
    /// Linear dynamic ones, non-linear dynamic ones, those around them.
    tets: Vec<usize>,
    n_linear_tets: usize,
    n_dynamic_tets: usize,
    part: SubMesh,
}

impl CutOut {
    fn of(source: &DynamicSource<'_>) -> Self {
        let DynamicSource { whole, law_of_tet, is_live_tet, is_dynamic, .. } = *source;
        let live = |t: &usize| is_live_tet[*t];
        let n_tets = whole.mesh.tetrahedra.len();
        let of = |law: ZoneLaw| (0..n_tets).filter(live).filter(move |&t| law_of_tet[t] == law);
        let mut tets: Vec<usize> = of(ZoneLaw::TensorMass).collect();
        let n_linear_tets = tets.len();
        tets.extend(of(ZoneLaw::NonlinearTensorMass));
        let n_dynamic_tets = tets.len();
        let beside = |t: &usize| {
            !law_of_tet[*t].is_dynamic() && whole.mesh.tetrahedra[*t].iter().any(|n| is_dynamic[n.index()])
        };
        tets.extend((0..n_tets).filter(live).filter(beside));
        let part = SubMesh::of(whole.mesh, tets.iter().map(|&t| TetId::from_index(t)));
        Self { tets, n_linear_tets, n_dynamic_tets, part }
    }

    /// The part's supports; nodes that are not dynamic are held along all axes.
    fn fixed_nodes(&self, source: &DynamicSource<'_>) -> Vec<FixedNode> {
        let axes_of = |n: &NodeId| {
            if source.is_dynamic[n.index()] { source.whole.held[n.index()] } else { [true; 3] }
        };
        let nodes = self.part.nodes.iter().enumerate();
        nodes
            .map(|(l, n)| FixedNode { node: NodeId::from_index(l), axes: axes_of(n) })
            .filter(|f| f.axes.contains(&true))
            .collect()
    }

    /// Masses, supports, ligaments and stable step of the part. `stiffening`: the factor by which St Venant-Kirchhoff
    /// tetrahedra may stiffen.
    fn motion(&self, source: &DynamicSource<'_>, stiffening: f64) -> Result<ExplicitMotion, ExplicitError> {
        let DynamicSource { whole, body, .. } = *source;
        let mesh = &self.part.mesh;
        let fixed = self.fixed_nodes(source);
        let local = |a: &Attachment| self.part.local(a.node).map(|node| Attachment { node, ..*a });
        let attachments: Vec<Attachment> = body.attachments.iter().filter_map(local).collect();
        let (lambda_pa, mu_pa) = (whole.material.lambda_pa(), whole.material.mu_pa());
        let is_kirchhoff = |t: TetId| (self.n_linear_tets..self.n_dynamic_tets).contains(&t.index());
        let stiff_tet = |t: TetId, g: &P1Gradients| {
            let mut at_rest = g.stiffness(lambda_pa, mu_pa);
            let stress_pa = whole.rest_stress_pa.get(self.tets[t.index()]).filter(|_| is_kirchhoff(t));
            if let Some(&stress_pa) = stress_pa {
                at_rest.add_multiples(g.stress_stiffness_n_per_m(stress_pa));
            }
            StiffTet { at_rest, stiffening: if is_kirchhoff(t) { stiffening } else { 1.0 } }
        };
        let density_kg_per_m3 = whole.density_kg_per_m3;
        let stability = if source.is_cut {
            let known = |t: TetId| {
                let is_stressed = is_kirchhoff(t) && !whole.rest_stress_pa.is_empty();
                let before = source.before.filter(|_| !is_stressed)?;
                before.bound_per_s2(self.tets[t.index()], mesh, t)
            };
            Stability::of_pieces(mesh, density_kg_per_m3, known, stiff_tet)
        } else {
            Stability::of_stiffness(mesh, density_kg_per_m3, stiff_tet)
        }?;
        let strained_j = 0.5 * (lambda_pa + 2.0 * mu_pa) * mesh.volume_m3();
        let again = stability.clone();
        let own =
            DynamicBody { mesh, fixed: &fixed, attachments: &attachments, rest_stress_pa: &[], ..*body };
        let made = match ExplicitMotion::new(&own, stability, strained_j) {
            // Take shorter steps instead of refusing: a zone can become dynamic after the step was chosen.
            Err(ExplicitError::UnstableStep { allowed_s, .. }) => {
                ExplicitMotion::new(&DynamicBody { time_step_s: allowed_s, ..own }, again, strained_j)
            }
            made => made,
        };
        let mut motion = made?;
        if source.is_cut {
            motion.go_on_in_steps_of(body.time_step_s, &LiveTets::of_mesh(mesh));
        }
        Ok(motion)
    }
}

/// Number of these tetrahedra at each node.
fn count_tets(tetrahedra: &[[NodeId; 4]], n_nodes: usize) -> Vec<u32> {
    let mut n_tets = vec![0; n_nodes];
    tetrahedra.iter().flatten().for_each(|n| n_tets[n.index()] += 1);
    n_tets
}

impl DynamicPart {
    /// The live dynamic tetrahedra as a body at rest, or nothing when there are none.
    ///
    /// # Errors
    /// [`ExplicitError`] for impossible supports and loads.
    pub(super) fn build(source: &DynamicSource<'_>) -> Result<Option<Self>, ExplicitError> {
        let cut_out = CutOut::of(source);
        let CutOut { tets, n_linear_tets, n_dynamic_tets, .. } = &cut_out;
        let (n_linear_tets, n_dynamic_tets) = (*n_linear_tets, *n_dynamic_tets);
        if n_dynamic_tets == 0 {
            return Ok(None);
        }
        let whole = source.whole;
        let (nodes, mesh) = (&cut_out.part.nodes, &cut_out.part.mesh);
        let (lambda_pa, mu_pa) = (whole.material.lambda_pa(), whole.material.mu_pa());
        let law = TetLaw::isotropic(whole.material);
        let mut motion = cut_out.motion(source, law.stiffening(source.largest_stretch, 0.0))?;
        let linear = TetMesh {
            positions_m: mesh.positions_m.clone(),
            tetrahedra: mesh.tetrahedra[..n_linear_tets].to_vec(),
            shares: mesh.shares.iter().copied().take(n_linear_tets).collect(),
        };
        let tensors = match n_linear_tets {
            0 => None,
            _ => Some(VertexEdgeTensors::accumulate(&linear, |_, g| g.stiffness(lambda_pa, mu_pa))?),
        };
        let kirchhoff = (n_linear_tets..n_dynamic_tets)
            .map(|l| {
                let gradients = P1Gradients::in_mesh(mesh, TetId::from_index(l));
                KirchhoffTet::new(gradients, whole.rest_stress_pa.get(tets[l]))
            })
            .collect();
        for (l, &t) in tets[..n_dynamic_tets].iter().enumerate() {
            if let Some(&stress_pa) = whole.rest_stress_pa.get(t) {
                let gradients = P1Gradients::in_mesh(mesh, TetId::from_index(l));
                motion.add_rest_forces(mesh.tetrahedra[l], gradients.stress_forces_n(stress_pa), 1.0);
            }
        }
        Ok(Some(Self {
            nodes: nodes.iter().map(|n| n.0).collect(),
            tets: tets.iter().map(|&t| t as u32).collect(),
            live: LiveTets::of_mesh(mesh),
            dynamic_tets: count_tets(&mesh.tetrahedra[..n_dynamic_tets], nodes.len()),
            linear_tets: count_tets(&linear.tetrahedra, nodes.len()),
            n_linear_tets,
            n_dynamic_tets,
            tensors,
            kirchhoff,
            law,
            motion,
            frontier: Vec::new(),
            frontier_m: Vec::new(),
            frontier_n: Vec::new(),
            mesh: cut_out.part.mesh,
        }))
    }

    /// Sets the dynamic nodes of the interface, in its order.
    pub(super) fn set_frontier(&mut self, nodes: &[NodeId], padded_len: usize) {
        let local = |n: &NodeId| self.local(*n).expect("a dynamic node").0;
        self.frontier = nodes.iter().map(local).collect();
        self.frontier_m = vec![0.0; padded_len];
        self.frontier_n = vec![0.0; padded_len];
    }

    /// The body's node for one of the mesh.
    pub(super) fn local(&self, node: NodeId) -> Option<NodeId> {
        // Removed nodes are marked, so the list is not sorted as a whole.
        let found = self.nodes.iter().position(|&n| n == node.0)?;
        Some(NodeId::from_index(found))
    }

    /// The dynamic tetrahedra and those around them, at rest.
    pub(super) fn mesh(&self) -> &TetMesh {
        &self.mesh
    }

    /// Bound of the squared frequency [1/s2] of a tetrahedron of the mesh, if it was in the body with the rest shape and share that it has
    /// as `tet` of `now`.
    fn bound_per_s2(&self, tet_of_mesh: usize, now: &TetMesh, tet: TetId) -> Option<f64> {
        let ends = [0, self.n_linear_tets, self.n_dynamic_tets, self.tets.len()];
        let found = ends.windows(2).find_map(|ends| {
            let group = &self.tets[ends[0]..ends[1]];
            group.binary_search(&(tet_of_mesh as u32)).ok().map(|at| TetId::from_index(ends[0] + at))
        })?;
        let is_same =
            self.mesh.corners_m(found) == now.corners_m(tet) && self.mesh.share(found) == now.share(tet);
        is_same.then(|| self.motion.tet_per_s2(found.index()))
    }

    /// Whether a tetrahedron of the body is still there.
    pub(super) fn is_live(&self, tet: usize) -> bool {
        self.live.is_live[tet]
    }

    /// The law of a tetrahedron of the body, if it is a St Venant-Kirchhoff one.
    pub(super) fn kirchhoff_law(&self, tet: usize) -> Option<TetLaw> {
        (self.n_linear_tets..self.n_dynamic_tets).contains(&tet).then_some(self.law)
    }

    /// The mesh's number of a tetrahedron of the body.
    pub(super) fn tet_of_mesh(&self, tet: usize) -> usize {
        self.tets[tet] as usize
    }

    /// Displacement [m] of a node of the body.
    pub(super) fn displacement_m(&self, local: usize) -> DVec3 {
        unpadded(&self.motion.displacements()[local])
    }

    /// How the last step went, with the mesh's numbers.
    pub(super) fn report(&self) -> ModelReport {
        let report = self.motion.report();
        let of_mesh = |t: TetId| TetId(self.tets[t.index()]);
        ModelReport { first_quarantined: report.first_quarantined.map(of_mesh), ..report }
    }

    /// Place among the interface's dynamic nodes of one of the body's.
    pub(super) fn frontier_place(&self, local: NodeId) -> Option<usize> {
        self.frontier.iter().position(|&n| n == local.0)
    }

    /// Dynamic nodes: their numbers in the body and in the mesh.
    pub(super) fn moving(&self) -> impl Iterator<Item = (usize, usize)> + '_ {
        let moves = |&(l, n): &(usize, &u32)| *n != GONE && self.dynamic_tets[l] > 0;
        self.nodes.iter().enumerate().filter(moves).map(|(l, &n)| (l, n as usize))
    }

    /// Starts the dynamic nodes from these positions of the mesh's nodes [m]; at rest when no velocities are given.
    pub(super) fn start(&mut self, rest_m: &[DVec3], positions_m: &[DVec3], velocities: Option<&[DVec3]>) {
        for l in 0..self.nodes.len() {
            if self.nodes[l] != GONE && self.dynamic_tets[l] > 0 {
                let n = self.nodes[l] as usize;
                let velocity = velocities.map_or(DVec3::ZERO, |v| v[n]);
                self.motion.start_node(l, positions_m[n] - rest_m[n], velocity);
            }
        }
    }

    /// Displacements [m] of the interface's dynamic nodes.
    pub(super) fn frontier_displacements(&mut self) -> &[f64] {
        gather(&self.frontier, self.motion.displacements(), &mut self.frontier_m);
        self.last_frontier_m()
    }

    /// The displacements [m] found last.
    pub(super) fn last_frontier_m(&self) -> &[f64] {
        &self.frontier_m[..3 * self.frontier.len()]
    }

    /// Advances by `dt_s`. The pre-computed zones bear `stiffness` times the frontier's displacements, minus `force_n`,
    /// minus the forces that `add_contact(displacements, forces)` adds for tools in these zones.
    pub(super) fn step(
        &mut self,
        dt_s: f64,
        stiffness: &SymmetricTiles,
        force_n: &[f64],
        mut add_contact: impl FnMut(&[f64], &mut [f64]),
    ) {
        let Self { tensors, motion, frontier, frontier_m, frontier_n, .. } = self;
        let n_linear_tets = self.n_linear_tets;
        motion.step(dt_s, |u, force| {
            if let Some(tensors) = tensors {
                tensors.add_forces(u, force);
            }
            let mut quarantine = Quarantine::default();
            for (k, tet) in self.kirchhoff.iter().enumerate() {
                let t = n_linear_tets + k;
                if !self.live.is_live[t] {
                    continue;
                }
                let nodes = self.mesh.tetrahedra[t].map(NodeId::index);
                let (f, is_inverted) = tet.forces_n(&self.law, nodes.map(|n| unpadded(&u[n])));
                if is_inverted {
                    quarantine.add(t);
                }
                for (n, f) in nodes.into_iter().zip(f) {
                    let to = &mut force[n];
                    (0..3).for_each(|axis| to[axis] += f[axis]);
                }
            }
            if frontier.is_empty() {
                return quarantine;
            }
            gather(frontier, u, frontier_m);
            for (to, f) in frontier_n.iter_mut().zip(force_n) {
                *to = -f;
            }
            stiffness.add_times(frontier_m, frontier_n);
            let n = 3 * frontier.len();
            add_contact(&frontier_m[..n], &mut frontier_n[..n]);
            for (node, f) in frontier.iter().zip(frontier_n.chunks_exact(3)) {
                let to = &mut force[*node as usize];
                (0..3).for_each(|axis| to[axis] += f[axis]);
            }
            quarantine
        });
    }

    /// Whether a frontier node has no dynamic tetrahedron left after these removals, which ascend.
    pub(super) fn would_strand(&self, removed: &[TetId]) -> bool {
        let goes = |t: &usize| self.live.is_live[*t] && removed.binary_search(&TetId(self.tets[*t])).is_ok();
        (0..self.n_dynamic_tets).filter(goes).any(|t| {
            self.mesh.tetrahedra[t].iter().filter(|n| self.frontier.contains(&n.0)).any(|n| {
                let at_node = |t: &usize| self.mesh.tetrahedra[*t].contains(n);
                let n_gone = (0..self.n_dynamic_tets).filter(goes).filter(at_node).count();
                n_gone == self.dynamic_tets[n.index()] as usize
            })
        })
    }

    /// Removes a tetrahedron of the mesh.
    pub(super) fn remove_tet(&mut self, tet: TetId, whole: &Whole<'_>) {
        let dynamic = &self.tets[..self.n_dynamic_tets];
        let Some(t) = dynamic.iter().position(|&t| t == tet.0) else { return };
        if !std::mem::take(&mut self.live.is_live[t]) {
            return;
        }
        let nodes = self.mesh.tetrahedra[t];
        let gradients = P1Gradients::in_mesh(&self.mesh, TetId::from_index(t));
        for n in nodes {
            self.dynamic_tets[n.index()] -= 1;
        }
        self.motion.remove_tet(nodes, gradients.volume_m3);
        if let Some(&stress_pa) = whole.rest_stress_pa.get(tet.index()) {
            self.motion.add_rest_forces(nodes, gradients.stress_forces_n(stress_pa), -1.0);
        }
        if t < self.n_linear_tets
            && let Some(tensors) = &mut self.tensors
        {
            nodes.iter().for_each(|n| self.linear_tets[n.index()] -= 1);
            let stiffness = gradients.stiffness(whole.material.lambda_pa(), whole.material.mu_pa());
            tensors.subtract_tet(t, nodes, &stiffness, nodes.map(|n| self.linear_tets[n.index()] > 0));
        }
    }

    /// Updates the bounds of the step after all removals of an edit.
    pub(super) fn after_removals(&mut self) {
        self.motion.after_removals(&self.live);
    }

    /// Follows a renumbering of the mesh.
    pub(super) fn renumber(&mut self, nodes: &[Option<NodeId>], tets: &[Option<TetId>]) {
        for n in self.nodes.iter_mut().filter(|n| **n != GONE) {
            *n = nodes[*n as usize].map_or(GONE, |n| n.0);
        }
        for t in self.tets.iter_mut().filter(|t| **t != GONE) {
            *t = tets[*t as usize].map_or(GONE, |t| t.0);
        }
    }

    /// Displacement [m] and velocity of a node of the body.
    pub(super) fn state_of(&self, local: usize) -> (DVec3, DVec3) {
        let velocity = self.motion.state().velocities_m_per_s[local];
        (unpadded(&self.motion.displacements()[local]), velocity)
    }
}

fn gather(frontier: &[u32], u: &[Padded], to: &mut [f64]) {
    for (node, to) in frontier.iter().zip(to.chunks_exact_mut(3)) {
        to.copy_from_slice(&u[*node as usize][..3]);
    }
}
