//! Repair by local remeshing: the surroundings of bad tetrahedra are arranged anew by flips and by moves of inner
//! nodes, and the result is taken only if the worst tetrahedron gets better (seed `000` s. 4.4.2, after Nienhuys and
//! Paloc; the seed gives no algorithm). The body's surface is kept exactly.

use super::cavity::Cavity;
use crate::mesh::edit::{CavityNode, EditableMesh, MeshEdit};
use crate::mesh::quality::radius_ratio;
use crate::mesh::{NodeId, TetId};

/// How far remeshing goes. The numbers are choices.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RemeshParams {
    /// Radius ratio above which tetrahedra are left alone.
    pub wanted_radius_ratio: f64,
    /// How many layers of tetrahedra around the bad ones may change.
    pub n_layers: usize,
    /// Times that smoothing and flipping take turns.
    pub n_rounds: usize,
}

impl Default for RemeshParams {
    fn default() -> Self {
        Self { wanted_radius_ratio: 0.3, n_layers: 1, n_rounds: 4 }
    }
}

/// Edits that mend a place, and what they bring.
#[derive(Clone, Debug, PartialEq)]
pub struct Repair {
    /// To be carried out in order, as one transaction; later ones name tetrahedra that earlier ones make.
    pub edits: Vec<MeshEdit>,
    /// Smallest radius ratio of the tetrahedra concerned before.
    pub worst_before: f64,
    /// Smallest radius ratio of the tetrahedra in their place.
    pub worst_after: f64,
}

/// Live tetrahedra with a radius ratio below `limit`, the worst first.
pub fn tets_below(body: &EditableMesh, limit: f64) -> Vec<TetId> {
    let mut found: Vec<(f64, TetId)> = body
        .topology()
        .live_tets()
        .map(|t| (radius_ratio(body.mesh().corners_m(t)), t))
        .filter(|(ratio, _)| *ratio < limit)
        .collect();
    found.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
    found.into_iter().map(|(_, t)| t).collect()
}

/// Edits that arrange the surroundings of the live tetrahedra `bad` anew; `None` if that does not lift the worst of
/// them.
pub fn remesh(body: &EditableMesh, bad: &[TetId], params: &RemeshParams) -> Option<Repair> {
    remesh_around(body, bad, params, &|_| false)
}

/// [`remesh`] that moves no node which `stays` names.
pub fn remesh_around(
    body: &EditableMesh,
    bad: &[TetId],
    params: &RemeshParams,
    stays: &dyn Fn(NodeId) -> bool,
) -> Option<Repair> {
    let mut tets = with_layers(body, bad, params.n_layers);
    let mut cavity = Cavity::of(body, &tets, stays);
    let worst_before = cavity.worst();
    let mut edits = Vec::new();
    // The ids of the tetrahedra, place by place as `before` has their corners.
    let mut before: Vec<[usize; 4]> = cavity.tets().collect();
    let mut n_tets = body.topology().n_tets();
    for _ in 0..params.n_rounds {
        let moved = cavity.smooth(params.wanted_radius_ratio);
        for &at in &moved {
            edits.push(MeshEdit::MoveVertex { node: cavity.nodes[at], position_m: cavity.positions_m[at] });
        }
        if cavity.flip(params.wanted_radius_ratio) == 0 {
            if moved.is_empty() {
                break;
            }
            continue;
        }
        let after: Vec<[usize; 4]> = cavity.tets().collect();
        let gone: Vec<usize> = (0..before.len()).filter(|&t| !after.contains(&before[t])).collect();
        let new: Vec<[usize; 4]> = after.iter().copied().filter(|t| !before.contains(t)).collect();
        if new.is_empty() {
            continue;
        }
        let corner = |at: usize| CavityNode::Old(cavity.nodes[at]);
        edits.push(MeshEdit::Retetrahedralise {
            tets: gone.iter().map(|&t| tets[t]).collect(),
            new_nodes: Vec::new(),
            new_tets: new.iter().map(|t| t.map(corner)).collect(),
        });
        for &t in gone.iter().rev() {
            before.remove(t);
            tets.remove(t);
        }
        for corners in new {
            before.push(corners);
            tets.push(TetId::from_index(n_tets));
            n_tets += 1;
        }
    }
    let worst_after = cavity.worst();
    let is_better = worst_after > worst_before * (1.0 + 1e-6);
    is_better.then_some(Repair { edits, worst_before, worst_after })
}

/// Live tetrahedra around some, by common nodes, ascending.
fn with_layers(body: &EditableMesh, seeds: &[TetId], n_layers: usize) -> Vec<TetId> {
    let topology = body.topology();
    let mut tets: Vec<TetId> = seeds.iter().copied().filter(|&t| topology.is_live_tet(t)).collect();
    for _ in 0..n_layers {
        let mut nodes: Vec<NodeId> = tets.iter().flat_map(|&t| topology.tet_nodes(t)).collect();
        nodes.sort_unstable();
        nodes.dedup();
        tets = nodes.iter().flat_map(|&n| topology.node_tets(n)).copied().collect();
        tets.sort_unstable();
        tets.dedup();
    }
    tets.sort_unstable();
    tets.dedup();
    tets
}
