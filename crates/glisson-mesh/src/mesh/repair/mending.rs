//! Mending after a cut: the worst tetrahedra of a place are remeshed one after the other, and where that does not help an
//! inner edge at them is pulled together; all of it one transaction. The body's surface, cuts included, stays exactly as
//! it is, and so does its volume.

use super::collapse::{CollapseParams, collapse};
use super::remesh::{RemeshParams, remesh_around};
use crate::mesh::edit::{EditError, EditableMesh, MeshEdit, MeshUndo, TopologyChange};
use crate::mesh::quality::radius_ratio;
use crate::mesh::{EdgeId, NodeId, TetId};
use std::collections::VecDeque;

/// What is mended. The numbers are choices.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MendParams {
    /// Radius ratio below which a tetrahedron is to be mended.
    pub bad_radius_ratio: f64,
    /// So many of the worst are tried at most, so that the work has a bound.
    pub most_tried: usize,
    /// How tetrahedra are remeshed.
    pub remesh: RemeshParams,
}

impl Default for MendParams {
    fn default() -> Self {
        Self { bad_radius_ratio: 0.15, most_tried: 16, remesh: RemeshParams::default() }
    }
}

/// What mends a place.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Mending {
    /// One transaction for [`EditableMesh::apply_all_saving`]; empty if nothing gets better.
    pub edits: Vec<MeshEdit>,
    /// Tetrahedra that were to be mended.
    pub n_bad: usize,
    /// Of these, repairs that raise the worst radius ratio of their surroundings by remeshing ...
    pub n_remeshed: usize,
    /// ... and by pulling an edge together.
    pub n_collapsed: usize,
}

/// Repairs under way.
struct Work<'a> {
    params: MendParams,
    stays: &'a dyn Fn(NodeId) -> bool,
    waiting: VecDeque<TetId>,
    /// The rest of the repair that was begun.
    pending: VecDeque<MeshEdit>,
    edits: Vec<MeshEdit>,
    /// Number of edits at the end of each repair, and whether it was a collapse.
    ends: Vec<(usize, bool)>,
}

impl Work<'_> {
    fn next(&mut self, body: &EditableMesh) -> Option<MeshEdit> {
        while self.pending.is_empty() {
            let tet = self.waiting.pop_front()?;
            if !body.topology().is_live_tet(tet) {
                continue;
            }
            if let Some(repair) = remesh_around(body, &[tet], &self.params.remesh, self.stays) {
                self.ends.push((self.edits.len() + repair.edits.len(), false));
                self.pending.extend(repair.edits);
            } else if let Some(edit) = self.collapse_at(body, tet) {
                self.ends.push((self.edits.len() + 1, true));
                self.pending.push_back(edit);
            }
        }
        let edit = self.pending.pop_front()?;
        self.edits.push(edit.clone());
        Some(edit)
    }

    /// The collapse of an edge at a tetrahedron, the shortest first, that lifts the worst of all tetrahedra at its ends. One
    /// end at least is inside, and the other stays: the surface is not touched.
    fn collapse_at(&self, body: &EditableMesh, tet: TetId) -> Option<MeshEdit> {
        let topology = body.topology();
        let rest_m = &body.mesh().positions_m;
        let length_m = |edge: EdgeId| {
            let [a, b] = topology.edge_nodes(edge).map(|n| rest_m[n.index()]);
            a.distance(b)
        };
        let is_inside = |n: NodeId| !topology.is_surface_node(n) && !(self.stays)(n);
        let mut edges: Vec<EdgeId> = topology.tet_edges(tet).to_vec();
        edges.retain(|&edge| topology.edge_nodes(edge).into_iter().any(is_inside));
        edges.sort_by(|&a, &b| length_m(a).total_cmp(&length_m(b)).then(a.cmp(&b)));
        let params = CollapseParams { min_radius_ratio: 0.0, ..CollapseParams::default() };
        edges.into_iter().find_map(|edge| {
            let edit = collapse(body, edge, &params).ok()?;
            let MeshEdit::Collapse { kept, position_m, .. } = edit else { return None };
            let ends = topology.edge_nodes(edge);
            let gone = topology.other_node(edge, kept);
            let is_kept_in_place = is_inside(kept) || position_m == rest_m[kept.index()];
            if !is_inside(gone) || !is_kept_in_place {
                return None;
            }
            let (mut before, mut after) = (f64::INFINITY, f64::INFINITY);
            for &at_end in ends.iter().flat_map(|&end| topology.node_tets(end)) {
                let nodes = topology.tet_nodes(at_end);
                before = before.min(radius_ratio(body.mesh().corners_m(at_end)));
                if !ends.iter().all(|end| nodes.contains(end)) {
                    let moved = |n: NodeId| if ends.contains(&n) { position_m } else { rest_m[n.index()] };
                    after = after.min(radius_ratio(nodes.map(moved)));
                }
            }
            (after > before).then_some(edit)
        })
    }
}

/// Mends the live ones among `tets` that are bad, the worst first, each only if the worst tetrahedron of its surroundings
/// gets better. Nodes that `stays` names neither move nor go. The body is as it was afterwards.
pub fn mending(
    body: &mut EditableMesh,
    tets: &[TetId],
    params: &MendParams,
    stays: &dyn Fn(NodeId) -> bool,
) -> Mending {
    let topology = body.topology();
    let ratio = |tet: TetId| radius_ratio(body.mesh().corners_m(tet));
    let mut bad: Vec<(f64, TetId)> = tets
        .iter()
        .filter(|&&tet| topology.is_live_tet(tet))
        .map(|&tet| (ratio(tet), tet))
        .filter(|(ratio, _)| *ratio < params.bad_radius_ratio)
        .collect();
    bad.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
    bad.dedup();
    let n_bad = bad.len();
    let waiting = bad.into_iter().map(|(_, tet)| tet).take(params.most_tried).collect();
    let (pending, edits, ends) = (VecDeque::new(), Vec::new(), Vec::new());
    let mut work = Work { params: *params, stays, waiting, pending, edits, ends };
    let (mut change, mut undo) = (TopologyChange::default(), MeshUndo::default());
    let done = body.apply_each_saving(&mut change, &mut undo, |body, _| work.next(body));
    let Work { mut edits, mut ends, .. } = work;
    match done {
        Ok(()) => body.undo(&undo),
        Err(EditError::InList { at, .. }) => {
            // Whole repairs only.
            ends.retain(|(end, _)| *end <= at);
            edits.truncate(ends.last().map_or(0, |(end, _)| *end));
        }
        Err(_) => (edits, ends) = (Vec::new(), Vec::new()),
    }
    let n_collapsed = ends.iter().filter(|(_, is_collapse)| *is_collapse).count();
    Mending { edits, n_bad, n_remeshed: ends.len() - n_collapsed, n_collapsed }
}
