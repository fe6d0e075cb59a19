//! How models follow edits that bring something in or move it: where new and moved nodes stand, and what new
//! entities take from their parents.
//!
//! With X the places at rest before the edit, u the displacements, w_p the parents' weights and G the mean displacement
//! gradient of the tetrahedra at a node, weighted by volume, all before the edit:
//!
//! - a moved node: u' = u + G (X' - X). The tissue keeps its place in space, for x' = x + (Id + G)(X' - X);
//! - a new node, and a moved one of which the edit says where in the tissue it goes: u' = sum w_p u_p + G (X' - sum w_p X_p),
//!   G at its heaviest old ancestor. It is at its place in the deformed tissue, also where its weights do not say where it
//!   is at rest;
//! - velocities of new nodes: sum w_p v_p. Those of moved nodes stay, and so do displacements along axes along which they
//!   are held.
//!
//! A new node is held along the axes along which all its parents are, and stays there where they are: that of a held
//! node's copy, and of a cut along a held surface. Ligaments stay with the node that they were at.

use super::TopologyRefusal;
use crate::solve::P1Gradients;
use glisson_mesh::fault;
use glisson_mesh::math::{DMat3, DVec3, outer};
use glisson_mesh::mesh::edit::TopologyChange;
use glisson_mesh::mesh::remap::Carried;
use glisson_mesh::mesh::{NodeId, TetId, TetMesh};

/// A place that differs from the mean of its parents' by less than this share of their distance is that mean.
const SAME_PLACE: f64 = 1e-9;

/// A tetrahedron at rest before the edit.
struct Around {
    nodes: [NodeId; 4],
    gradients: P1Gradients,
}

/// A new or moved node.
struct Placed {
    node: NodeId,
    /// X' less the mean of its parents' places at rest [m].
    offset_m: DVec3,
    /// Range of the tetrahedra that tell G.
    around: std::ops::Range<usize>,
    /// Where its parents are in the list of all of them; its own id for a moved node without any.
    parents: std::ops::Range<usize>,
}

/// What an edit brings in and moves, worked out before anything follows it.
pub(super) struct TopologyUpdate {
    n_nodes_before: usize,
    /// Nodes afterwards, dead ones included.
    pub(super) n_nodes: usize,
    /// Tetrahedra afterwards, dead ones included.
    pub(super) n_tets: usize,
    /// Live tetrahedra from before that have another shape at rest, ascending.
    pub(super) reshaped: Vec<TetId>,
    /// New tetrahedra that live, ascending.
    pub(super) added: Vec<TetId>,
    /// Their volumes at rest [m3].
    added_m3: Vec<f64>,
    placed: Vec<Placed>,
    parents: Vec<(NodeId, f64)>,
    around: Vec<Around>,
    /// The tetrahedron from before that each new one, from the first on, takes after most.
    sources: Vec<Option<TetId>>,
}

impl TopologyUpdate {
    /// None for an edit that only takes out or renumbers. `rest_m` and `tets` (those that live): as they were before.
    ///
    /// # Errors
    /// [`TopologyRefusal`] for a tetrahedron without volume, and for an edit that also renumbers.
    pub(super) fn of<'a>(
        model: &'static str,
        mesh: &TetMesh,
        change: &TopologyChange,
        rest_m: &[DVec3],
        tets: impl Iterator<Item = (usize, &'a [NodeId; 4])>,
    ) -> Result<Option<Self>, TopologyRefusal> {
        fault::check("model: shape of an edit")?;
        if !grows(change) {
            return Ok(None);
        }
        if change.is_renumbering() {
            let reason =
                "it follows additions and compactions one after the other; compact in an edit of its own";
            return Err(TopologyRefusal::Frozen { model, reason });
        }
        let n_before = change.nodes.n_before;
        let is_gone = |tet: &TetId| change.tets.removed.binary_search(tet).is_ok();
        let mut growth = Self {
            n_nodes_before: n_before,
            n_nodes: change.nodes.n_after,
            n_tets: change.tets.n_after,
            reshaped: Vec::new(),
            added: change.tets.added.ids().iter().copied().filter(|tet| !is_gone(tet)).collect(),
            added_m3: Vec::new(),
            placed: Vec::new(),
            parents: Vec::new(),
            around: Vec::new(),
            sources: sources(change),
        };
        growth.place_nodes(mesh, change, rest_m);
        growth.look_around(mesh, change, rest_m, tets);
        for &tet in growth.reshaped.iter().chain(&growth.added) {
            let is_finite = mesh.corners_m(tet).iter().all(|x| x.is_finite());
            if !is_finite || P1Gradients::of_tet(mesh, tet).is_err() {
                return Err(TopologyRefusal::Unsound { model, tet, volume_m3: mesh.tet_volume_m3(tet) });
            }
        }
        growth.added_m3 = growth.added.iter().map(|&tet| mesh.tet_volume_m3(tet)).collect();
        Ok(Some(growth))
    }

    fn place_nodes(&mut self, mesh: &TetMesh, change: &TopologyChange, rest_m: &[DVec3]) {
        let n_before = self.n_nodes_before;
        for (&node, parents) in change.moved_nodes.iter().zip(&change.moved_parents) {
            if node.index() < n_before {
                let own = [(node, 1.0)];
                self.place(mesh, rest_m, node, if parents.is_empty() { &own } else { parents });
            }
        }
        for (node, parents) in change.nodes.added.iter() {
            self.place(mesh, rest_m, node, parents);
        }
    }

    fn place(&mut self, mesh: &TetMesh, rest_m: &[DVec3], node: NodeId, parents: &[(NodeId, f64)]) {
        let start = self.parents.len();
        self.parents.extend_from_slice(parents);
        let place_m = mesh.positions_m[node.index()];
        let of_parent = |p: NodeId| {
            if p.index() < self.n_nodes_before { rest_m[p.index()] } else { mesh.positions_m[p.index()] }
        };
        let mean_m: DVec3 = parents.iter().map(|&(p, weight)| weight * of_parent(p)).sum();
        let reach_m = parents.iter().map(|&(p, _)| of_parent(p).distance(place_m)).fold(0.0, f64::max);
        let offset_m = if parents.is_empty() { DVec3::ZERO } else { place_m - mean_m };
        let is_mean = parents.len() > 1 && offset_m.length() <= SAME_PLACE * reach_m;
        let offset_m = if is_mean { DVec3::ZERO } else { offset_m };
        self.placed.push(Placed { node, offset_m, around: 0..0, parents: start..self.parents.len() });
    }

    /// Takes the tetrahedra whose shape changes, and finds those that tell how the tissue is deformed at placed nodes.
    fn look_around<'a>(
        &mut self,
        mesh: &TetMesh,
        change: &TopologyChange,
        rest_m: &[DVec3],
        tets: impl Iterator<Item = (usize, &'a [NodeId; 4])>,
    ) {
        self.reshaped.extend_from_slice(&change.reshaped_tets);
        let anchors: Vec<Option<NodeId>> = self
            .placed
            .iter()
            .map(|placed| (placed.offset_m != DVec3::ZERO).then(|| self.old_ancestor(placed)).flatten())
            .collect();
        let mut looked_at: Vec<NodeId> = anchors.iter().flatten().copied().collect();
        if looked_at.is_empty() {
            return;
        }
        looked_at.sort_unstable();
        looked_at.dedup();
        let mut around: Vec<(NodeId, [NodeId; 4])> = Vec::new();
        if looked_at.iter().all(|node| change.moved_nodes.binary_search(node).is_ok()) {
            // What was at a moved node has another shape or is gone.
            let gone = change.tets.removed.iter().filter(|tet| tet.index() < change.tets.n_before);
            let mut candidates: Vec<TetId> = self.reshaped.iter().chain(gone).copied().collect();
            candidates.sort_unstable();
            for tet in candidates {
                let nodes = &mesh.tetrahedra[tet.index()];
                let is_looked_at = |n: &&NodeId| looked_at.binary_search(n).is_ok();
                around.extend(nodes.iter().filter(is_looked_at).map(|&n| (n, *nodes)));
            }
        } else {
            // Every tetrahedron is looked at, and few have a marked node.
            let mut marks = vec![false; self.n_nodes_before];
            looked_at.iter().for_each(|node| marks[node.index()] = true);
            for (_, nodes) in tets {
                if nodes.iter().fold(false, |any, n| any | marks[n.index()]) {
                    around.extend(nodes.iter().filter(|n| marks[n.index()]).map(|&n| (n, *nodes)));
                }
            }
        }
        // Stable: the tetrahedra of a node stay in their order.
        around.sort_by_key(|(node, _)| *node);
        for (placed, anchor) in self.placed.iter_mut().zip(&anchors) {
            let Some(anchor) = anchor else { continue };
            let first = around.partition_point(|(node, _)| node < anchor);
            let start = self.around.len();
            for (_, nodes) in around[first..].iter().take_while(|(node, _)| node == anchor) {
                let gradients = P1Gradients::new(nodes.map(|n| rest_m[n.index()]));
                self.around.push(Around { nodes: *nodes, gradients });
            }
            placed.around = start..self.around.len();
        }
    }

    /// The node from before that a node takes after most: itself if it is one.
    fn old_ancestor(&self, placed: &Placed) -> Option<NodeId> {
        let mut parents = placed.parents.clone();
        loop {
            let all = &self.parents[parents];
            let heaviest = all.iter().rev().max_by(|a, b| a.1.total_cmp(&b.1)).map(|(node, _)| *node)?;
            if heaviest.index() < self.n_nodes_before {
                return Some(heaviest);
            }
            let at = self.placed.iter().position(|other| other.node == heaviest)?;
            parents = self.placed[at].parents.clone();
        }
    }

    /// Displacements [m] of the new and moved nodes. `displacement_m`: from before the edit, of old nodes;
    /// `supports`: afterwards, of all nodes.
    pub(super) fn displacements_m(
        &self,
        displacement_m: impl Fn(usize) -> DVec3,
        supports: impl Fn(usize) -> [bool; 3],
    ) -> Vec<(usize, DVec3)> {
        let mut found: Vec<(usize, DVec3)> = Vec::with_capacity(self.placed.len());
        for placed in &self.placed {
            let n = placed.node.index();
            let mut mean_m = self.blend(placed, &displacement_m, &found);
            let mut shift_m = self.gradient(placed, &displacement_m) * placed.offset_m;
            for (axis, is_held) in supports(n).into_iter().enumerate() {
                if is_held || !shift_m[axis].is_finite() {
                    shift_m[axis] = 0.0;
                }
                if is_held && n < self.n_nodes_before {
                    mean_m[axis] = displacement_m(n)[axis];
                }
            }
            found.push((n, mean_m + shift_m));
        }
        found
    }

    /// Values of the new nodes that their parents give them: velocities. Zero along held axes.
    pub(super) fn velocities(
        &self,
        velocity: impl Fn(usize) -> DVec3,
        supports: impl Fn(usize) -> [bool; 3],
    ) -> Vec<(usize, DVec3)> {
        let mut found: Vec<(usize, DVec3)> = Vec::new();
        for placed in self.placed.iter().filter(|placed| placed.node.index() >= self.n_nodes_before) {
            let mut mean = self.blend(placed, &velocity, &found);
            for (axis, is_held) in supports(placed.node.index()).into_iter().enumerate() {
                if is_held {
                    mean[axis] = 0.0;
                }
            }
            found.push((placed.node.index(), mean));
        }
        found
    }

    fn blend(&self, placed: &Placed, old: impl Fn(usize) -> DVec3, new: &[(usize, DVec3)]) -> DVec3 {
        let of = |n: usize| {
            if n < self.n_nodes_before {
                old(n)
            } else {
                new.iter().find(|(node, _)| *node == n).map_or(DVec3::ZERO, |(_, value)| *value)
            }
        };
        self.parents[placed.parents.clone()].iter().map(|&(p, weight)| weight * of(p.index())).sum()
    }

    fn gradient(&self, placed: &Placed, displacement_m: impl Fn(usize) -> DVec3) -> DMat3 {
        let (mut sum, mut volume_m3) = (DMat3::ZERO, 0.0);
        for Around { nodes, gradients } in &self.around[placed.around.clone()] {
            let of_tet = nodes
                .iter()
                .zip(gradients.alpha_per_m)
                .fold(DMat3::ZERO, |sum, (n, alpha)| sum + outer(displacement_m(n.index()), alpha));
            sum += of_tet * gradients.volume_m3;
            volume_m3 += gradients.volume_m3;
        }
        if volume_m3 > 0.0 { sum * (1.0 / volume_m3) } else { DMat3::ZERO }
    }

    /// Axes along which the new nodes are held, one entry a new node. `supports`: of the old nodes.
    pub(super) fn new_supports(&self, supports: impl Fn(usize) -> [bool; 3]) -> Vec<(usize, [bool; 3])> {
        let mut found: Vec<(usize, [bool; 3])> = Vec::new();
        for placed in self.placed.iter().filter(|placed| placed.node.index() >= self.n_nodes_before) {
            let parents = &self.parents[placed.parents.clone()];
            let mut axes = [!parents.is_empty(); 3];
            for (parent, _) in parents {
                let of_parent = if parent.index() < self.n_nodes_before {
                    supports(parent.index())
                } else {
                    found.iter().find(|(n, _)| *n == parent.index()).map_or([false; 3], |(_, axes)| *axes)
                };
                axes = std::array::from_fn(|i| axes[i] && of_parent[i]);
            }
            found.push((placed.node.index(), axes));
        }
        found
    }

    /// Gives each new tetrahedron the value of the old one that it takes after most, that of the first one where there
    /// is none. A list that is not one value a tetrahedron stays as it is.
    pub(super) fn take_over<T: Clone>(&self, values: &mut Vec<T>) {
        if values.len() != self.n_tets - self.sources.len() || values.is_empty() {
            return;
        }
        for source in &self.sources {
            values.push(values[source.map_or(0, TetId::index)].clone());
        }
    }

    /// The tetrahedron from before that a new one takes after most.
    pub(super) fn source(&self, tet: TetId) -> Option<TetId> {
        let n_before = self.n_tets - self.sources.len();
        tet.index().checked_sub(n_before).and_then(|at| self.sources[at])
    }

    /// Volume at rest of a new tetrahedron [m3].
    pub(super) fn volume_m3(&self, tet: TetId) -> f64 {
        self.added.binary_search(&tet).map_or(0.0, |at| self.added_m3[at])
    }

    /// Every tetrahedron to be added up anew: new ones and those of another shape, ascending.
    pub(super) fn attached(&self) -> impl Iterator<Item = TetId> + '_ {
        self.reshaped.iter().chain(&self.added).copied()
    }

    /// Nodes that came in or moved.
    pub(super) fn placed_nodes(&self) -> impl Iterator<Item = NodeId> + '_ {
        self.placed.iter().map(|placed| placed.node)
    }

    /// Whether a node came in or moved, for each node.
    pub(super) fn has_new_place(&self) -> Vec<bool> {
        let mut flags = vec![false; self.n_nodes];
        self.placed.iter().for_each(|placed| flags[placed.node.index()] = true);
        flags
    }
}

/// Whether an edit brings something in or moves it.
pub(super) fn grows(change: &TopologyChange) -> bool {
    !(change.tets.added.ids().is_empty()
        && change.nodes.added.ids().is_empty()
        && change.moved_nodes.is_empty())
}

fn sources(change: &TopologyChange) -> Vec<Option<TetId>> {
    let n_before = change.tets.n_before;
    let mut sources: Vec<Option<TetId>> = vec![None; change.tets.n_after - n_before];
    for (tet, parents) in change.tets.added.iter() {
        // The first among equals, as in `mesh::remap`.
        let heaviest = parents.iter().rev().max_by(|a, b| a.1.total_cmp(&b.1)).map(|(tet, _)| *tet);
        sources[tet.index() - n_before] = heaviest
            .and_then(|parent| parent.index().checked_sub(n_before).map_or(Some(parent), |at| sources[at]));
    }
    sources
}

/// Gives each new tetrahedron the blend of its parents' values. An empty list stays empty.
pub(super) fn blend_tets<T: Carried>(values: &mut Vec<T>, change: &TopologyChange) {
    if values.is_empty() {
        return;
    }
    values.resize(change.tets.n_after, T::cleared());
    for (tet, parents) in change.tets.added.iter() {
        let of_parents = parents.iter().map(|&(parent, weight)| (&values[parent.index()], weight));
        let blend = T::blend(of_parents);
        values[tet.index()] = blend;
    }
}
