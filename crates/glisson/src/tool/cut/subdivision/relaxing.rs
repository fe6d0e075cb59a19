//! Moves nodes around tetrahedra that came out too thin, one at a time, as long as the worst angle grows.

use super::patch::{Accept, Body, Patch};
use crate::math::DVec3;

/// How often all bad tetrahedra are visited.
const N_ROUNDS: usize = 4;

/// Lengths of the trial moves, as shares of the shortest edge at the node.
const STEPS: [f64; 3] = [0.4, 0.15, 0.05];

/// Betters the changed tetrahedra whose smallest dihedral angle at rest has a cosine above `max_cosine`.
/// Nodes of the cut stay in their plane (of unit normal `normal`), those on its rim stay.
pub(super) fn relax(patch: &mut Patch, body: Body<'_>, normal: DVec3, max_cosine: f64) {
    let mut cut_nodes: Vec<u32> = patch.cut.iter().flatten().copied().collect();
    cut_nodes.sort_unstable();
    cut_nodes.dedup();
    let rim_nodes = rim_nodes(&patch.cut);
    let (u, v) = normal.any_orthonormal_pair();
    // Nodes that no move helps, as long as the nodes of their tetrahedra stay. Bad tetrahedra share nodes.
    let mut is_settled: Vec<bool> = Vec::new();
    for _ in 0..N_ROUNDS {
        let mut is_better = false;
        for (_, tet) in patch.bad_tets(max_cosine) {
            for node in patch.tets[tet as usize].nodes {
                if patch.nodes[node as usize].is_front || rim_nodes.binary_search(&node).is_ok() {
                    continue;
                }
                patch.pull_star(body, node);
                is_settled.resize(patch.nodes.len(), false);
                if is_settled[node as usize] {
                    continue;
                }
                let is_on_cut = cut_nodes.binary_search(&node).is_ok();
                let (directions, n) = match (patch.skin_normal(node), is_on_cut) {
                    (None, false) => ([u, v, normal], 3),
                    (None, true) => ([u, v, normal], 2),
                    // Along the skin.
                    (Some(skin), false) => {
                        let (s, t) = skin.any_orthonormal_pair();
                        ([s, t, s], 2)
                    }
                    (Some(skin), true) => ([skin.cross(normal).normalize_or_zero(); 3], 1),
                };
                if better(patch, body, node, &directions[..n]) {
                    is_better = true;
                    for &around in patch.star(node).iter().flat_map(|&t| &patch.tets[t as usize].nodes) {
                        is_settled[around as usize] = false;
                    }
                } else {
                    is_settled[node as usize] = true;
                }
            }
        }
        if !is_better {
            return;
        }
    }
}

/// Tries moves of one node, long ones first; the first that betters its worst tetrahedron stays.
fn better(patch: &mut Patch, body: Body<'_>, node: u32, directions: &[DVec3]) -> bool {
    let from_m = patch.nodes[node as usize].present_m;
    let length = |&t: &u32| {
        let others = patch.tets[t as usize].nodes.into_iter().filter(|&n| n != node);
        others.map(|n| patch.length_m([node, n])).fold(f64::INFINITY, f64::min)
    };
    let before = patch.star_state(node);
    let shortest_m = patch.star(node).iter().map(length).fold(f64::INFINITY, f64::min);
    STEPS.iter().any(|step| {
        let moves = directions.iter().flat_map(|&d| [d, -d]);
        moves.into_iter().any(|d| {
            let to_m = from_m + step * shortest_m * d;
            patch.move_node_from(body, node, to_m, Accept::Better, &before)
        })
    })
}

fn rim_nodes(faces: &[[u32; 3]]) -> Vec<u32> {
    let mut edges: Vec<[u32; 2]> = faces.iter().flat_map(|&[a, b, c]| [[a, b], [b, c], [a, c]]).collect();
    edges.sort_unstable();
    let single = edges.chunk_by(|e, f| e == f).filter(|same| same.len() == 1);
    let mut nodes: Vec<u32> = single.flat_map(|same| same[0]).collect();
    nodes.sort_unstable();
    nodes.dedup();
    nodes
}
