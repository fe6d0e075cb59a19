//! Repair where remeshing cannot help: a bad tetrahedron whose corners lie on the body's surface, between outer triangles that
//! flips must keep. Its corners slide along the surface and its sharp edges, as watched moves, which keep the volume.

use super::moving::{MoveLimits, watched_move};
use crate::math::DVec3;
use crate::mesh::edit::{EditableMesh, MeshEdit};
use crate::mesh::quality::radius_ratio;
use crate::mesh::{NodeId, TetId};

/// Times that the step of the search is halved, from a quarter of the longest edge on: a choice.
const N_HALVINGS: usize = 5;

/// A move counts as better from this share on.
const BETTER: f64 = 1.0 + 1e-6;

/// The move of one corner of the live tetrahedron `tet` that lifts the worst tetrahedron at that corner most, if `tet` is
/// this worst one and there is such a move. It keeps the volume of the body and its sharp edges; a surface that is curved
/// changes its shape a little.
pub fn slide(body: &EditableMesh, tet: TetId, limits: &MoveLimits) -> Option<MeshEdit> {
    let corners_m = body.mesh().corners_m(tet);
    let own = radius_ratio(corners_m);
    let reach_m = corners_m.iter().flat_map(|a| corners_m.map(|b| a.distance(b))).fold(0.0, f64::max);
    let mut best: Option<(f64, NodeId, DVec3)> = None;
    for node in body.topology().tet_nodes(tet) {
        let start_m = body.mesh().positions_m[node.index()];
        let before = worst_at(body, node, start_m);
        if before < own {
            continue;
        }
        let (mut so_far, mut place_m) = (before * BETTER, start_m);
        let mut step_m = 0.25 * reach_m;
        for _ in 0..N_HALVINGS {
            let center_m = place_m;
            for way in [DVec3::X, DVec3::Y, DVec3::Z].into_iter().flat_map(|axis| [axis, -axis]) {
                // From where the node is: the surface tells where it may go from there.
                let wanted_m = center_m + step_m * way;
                let Ok(moved) = watched_move(body, node, wanted_m, limits) else { continue };
                let worst = worst_at(body, node, moved.position_m);
                if worst > so_far {
                    (so_far, place_m) = (worst, moved.position_m);
                }
            }
            step_m *= 0.5;
        }
        if place_m != start_m && best.is_none_or(|(ratio, ..)| so_far > ratio) {
            best = Some((so_far, node, place_m));
        }
    }
    best.map(|(_, node, position_m)| MeshEdit::MoveVertex { node, position_m })
}

/// Smallest radius ratio at a node that is at `place_m`.
fn worst_at(body: &EditableMesh, node: NodeId, place_m: DVec3) -> f64 {
    let topology = body.topology();
    topology.node_tets(node).iter().fold(f64::INFINITY, |least: f64, &tet| {
        let mut corners_m = body.mesh().corners_m(tet);
        corners_m[topology.local_node(tet, node)] = place_m;
        least.min(radius_ratio(corners_m))
    })
}
