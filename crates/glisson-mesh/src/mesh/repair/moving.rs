//! Moves of a node that are watched: the volume of the body, its sharp edges and the shape of the tetrahedra are
//! kept.

use crate::math::DVec3;
use crate::mesh::edit::EditableMesh;
use crate::mesh::quality::radius_ratio;
use crate::mesh::topology::Topology;
use crate::mesh::{EdgeId, NodeId, TetId};

/// Shares of a wanted move that are tried, the whole first.
const SHARES: [f64; 4] = [1.0, 0.75, 0.5, 0.25];

/// Two edges go on straight if the cosine of the angle between them is below this (154 degrees; a choice).
const STRAIGHT_COSINE: f64 = -0.9;

/// What a move may not do. The numbers are choices.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MoveLimits {
    /// Radius ratio below which no tetrahedron may fall by the move; one that is below already may not get worse.
    pub min_radius_ratio: f64,
    /// Cosine of the angle between the normals of two surface triangles below which their edge is sharp and stays.
    pub sharp_cosine: f64,
}

impl Default for MoveLimits {
    fn default() -> Self {
        // Between the normals of neighbours: 50 degrees.
        Self { min_radius_ratio: 0.08, sharp_cosine: 0.643 }
    }
}

/// Where a node may go without a change of the body's outer shape that counts.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Freedom {
    /// Everywhere: it is inside.
    Free,
    /// Along the surface: across this gradient of the body's volume [m2].
    Surface {
        /// Change of volume by a move of the node.
        gradient_m2: DVec3,
    },
    /// Along a sharp edge that goes on straight, towards these two neighbours.
    Ridge {
        /// The sharp edges' other nodes.
        towards: [NodeId; 2],
        /// Change of volume by a move of the node.
        gradient_m2: DVec3,
    },
    /// Nowhere: a corner, or a place where the surface is pinched.
    Fixed,
}

/// Why a node stays where it is.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum MoveRefusal {
    /// It is a corner of the surface.
    #[error("node {node} is a corner of the surface and stays where it is")]
    Corner {
        /// The node.
        node: NodeId,
    },
    /// Already a quarter of the move would spoil a tetrahedron.
    #[error(
        "moving node {node} would leave tetrahedron {tet} with a radius ratio of {radius_ratio:.3}; {limit} is allowed"
    )]
    Quality {
        /// The node.
        node: NodeId,
        /// A tetrahedron that would be spoilt.
        tet: TetId,
        /// The radius ratio that it would have; 0 if it would be inside out.
        radius_ratio: f64,
        /// The least one allowed.
        limit: f64,
    },
}

/// A move that may be done.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct WatchedMove {
    /// Where the node can go [m].
    pub position_m: DVec3,
    /// Share of the way that the shape of the tetrahedra allows.
    pub share: f64,
}

/// Where `node` may go.
pub fn freedom(body: &EditableMesh, node: NodeId, sharp_cosine: f64) -> Freedom {
    let topology = body.topology();
    if !topology.is_surface_node(node) {
        return Freedom::Free;
    }
    let positions_m = &body.mesh().positions_m;
    let (mut sharp, mut n_sharp) = ([node; 2], 0);
    let mut gradient_m2 = DVec3::ZERO;
    for triangle in topology.surface_triangles_at(node) {
        gradient_m2 += topology.area_vector_m2(triangle, positions_m) / 3.0;
    }
    for &edge in topology.node_edges(node) {
        if topology.is_surface_edge(edge) && is_sharp(topology, positions_m, edge, sharp_cosine) {
            if n_sharp < 2 {
                sharp[n_sharp] = topology.other_node(edge, node);
            }
            n_sharp += 1;
        }
    }
    match n_sharp {
        0 => Freedom::Surface { gradient_m2 },
        2 => {
            let [a, b] =
                sharp.map(|n| (positions_m[n.index()] - positions_m[node.index()]).normalize_or_zero());
            if a.dot(b) < STRAIGHT_COSINE {
                Freedom::Ridge { towards: sharp, gradient_m2 }
            } else {
                Freedom::Fixed
            }
        }
        _ => Freedom::Fixed,
    }
}

fn is_sharp(topology: &Topology, positions_m: &[DVec3], edge: EdgeId, sharp_cosine: f64) -> bool {
    if topology.is_pinched_edge(edge) {
        return true;
    }
    let mut normals =
        topology.surface_triangles_at_edge(edge).map(|t| topology.triangle_normal(t, positions_m));
    match (normals.next(), normals.next()) {
        (Some(m), Some(n)) => m.dot(n) < sharp_cosine,
        _ => true,
    }
}

/// How far `node` can go towards `wanted_m` at rest: along the surface and its sharp edges only, without a change of
/// the body's volume, and without spoiling a tetrahedron.
///
/// The volume is linear in the position of one node, so that a move across its gradient keeps it exactly.
///
/// # Errors
/// [`MoveRefusal`] if it cannot go at all.
pub fn watched_move(
    body: &EditableMesh,
    node: NodeId,
    wanted_m: DVec3,
    limits: &MoveLimits,
) -> Result<WatchedMove, MoveRefusal> {
    let positions_m = &body.mesh().positions_m;
    let from_m = positions_m[node.index()];
    let across =
        |move_m: DVec3, g: DVec3| if g == DVec3::ZERO { move_m } else { move_m - move_m.project_onto(g) };
    let wanted_m = wanted_m - from_m;
    let move_m = match freedom(body, node, limits.sharp_cosine) {
        Freedom::Free => wanted_m,
        Freedom::Surface { gradient_m2 } => across(wanted_m, gradient_m2),
        Freedom::Ridge { towards, gradient_m2 } => {
            let [a, b] = towards.map(|n| positions_m[n.index()] - from_m);
            let along_m = if wanted_m.dot(a) > wanted_m.dot(b) { a } else { b };
            let share = wanted_m.dot(along_m) / along_m.length_squared();
            across(share.clamp(0.0, 1.0) * along_m, gradient_m2)
        }
        Freedom::Fixed => return Err(MoveRefusal::Corner { node }),
    };
    let mut refusal = MoveRefusal::Corner { node };
    for share in SHARES {
        let position_m = from_m + share * move_m;
        match first_spoilt(body, node, position_m, limits.min_radius_ratio) {
            None => return Ok(WatchedMove { position_m, share }),
            Some((tet, radius_ratio)) => {
                refusal = MoveRefusal::Quality { node, tet, radius_ratio, limit: limits.min_radius_ratio };
            }
        }
    }
    Err(refusal)
}

/// The first tetrahedron that would fall below the limit, or below its own ratio if that is lower.
fn first_spoilt(body: &EditableMesh, node: NodeId, position_m: DVec3, limit: f64) -> Option<(TetId, f64)> {
    body.topology().node_tets(node).iter().find_map(|&tet| {
        let mut corners_m = body.mesh().corners_m(tet);
        corners_m[body.topology().local_node(tet, node)] = position_m;
        let ratio = radius_ratio(corners_m);
        let is_fine = ratio > 0.0 && (ratio >= limit || ratio >= radius_ratio(body.mesh().corners_m(tet)));
        (!is_fine).then_some((tet, ratio))
    })
}

/// The rest place [m] of the material that is at `point_m` now, by the tetrahedron at `node` that it lies in or is
/// nearest to; `None` if all of them are flat now.
///
/// `positions_m`: present positions, one a node.
pub fn rest_place_m(
    body: &EditableMesh,
    positions_m: &[DVec3],
    node: NodeId,
    point_m: DVec3,
) -> Option<DVec3> {
    let mut best: Option<(f64, DVec3)> = None;
    for &tet in body.topology().node_tets(node) {
        let nodes = body.topology().tet_nodes(tet);
        let [a, b, c, d] = nodes.map(|n| positions_m[n.index()]);
        let six_volumes = (b - a).cross(c - a).dot(d - a);
        if six_volumes.abs() <= f64::MIN_POSITIVE {
            continue;
        }
        let p = point_m - a;
        let u = p.cross(c - a).dot(d - a) / six_volumes;
        let v = (b - a).cross(p).dot(d - a) / six_volumes;
        let w = (b - a).cross(c - a).dot(p) / six_volumes;
        let least = (1.0 - u - v - w).min(u).min(v).min(w);
        if best.is_none_or(|(so_far, _)| least > so_far) {
            let [a, b, c, d] = nodes.map(|n| body.mesh().positions_m[n.index()]);
            best = Some((least, a + u * (b - a) + v * (c - a) + w * (d - a)));
        }
    }
    best.map(|(_, place_m)| place_m)
}
