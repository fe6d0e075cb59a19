//! Repair by collapse: a surface edge much shorter than the others of its tetrahedra is pulled together, and the
//! tetrahedra at it vanish (seed `000` s. 4.4.2, "ecrasement", after Mendoza).

use super::moving::{Freedom, MoveLimits, freedom};
use crate::math::{DVec3, tetrahedron_volume_m3};
use crate::mesh::edit::{EditableMesh, MeshEdit};
use crate::mesh::quality::radius_ratio;
use crate::mesh::topology::TET_TRIANGLES;
use crate::mesh::{EdgeId, NodeId, TetId};

/// When an edge is pulled together. The numbers are choices.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CollapseParams {
    /// An edge below this share of the longest edge of each of its tetrahedra is much shorter.
    pub short_edge: f64,
    /// Radius ratio that the tetrahedra which stay must have, unless the worst one was worse before.
    pub min_radius_ratio: f64,
    /// Largest distance of a surface node that vanishes from the place where it is drawn, as a share of the
    /// longest edge at it.
    pub surface_tolerance: f64,
}

impl Default for CollapseParams {
    fn default() -> Self {
        Self { short_edge: 0.25, min_radius_ratio: 0.08, surface_tolerance: 0.5 }
    }
}

/// Why an edge is not pulled together.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum CollapseRefusal {
    /// There is no such live edge.
    #[error("there is no live edge {edge}")]
    NoSuchEdge {
        /// The one named.
        edge: EdgeId,
    },
    /// The edge joins two parts of the surface through the inside.
    #[error(
        "edge {edge} joins two parts of the surface through the inside: together they would pinch the body"
    )]
    WouldPinch {
        /// The edge.
        edge: EdgeId,
    },
    /// The nodes around the two ends do not fit together.
    #[error("edge {edge}: its ends have {found} common neighbours and {allowed} are at its tetrahedra")]
    Linked {
        /// The edge.
        edge: EdgeId,
        /// Common neighbours.
        found: usize,
        /// Neighbours at the edge's tetrahedra.
        allowed: usize,
    },
    /// Both ends are corners or on different sharp edges of the surface.
    #[error("edge {edge} has two ends that must stay where they are")]
    BothFixed {
        /// The edge.
        edge: EdgeId,
    },
    /// No place of the node leaves good tetrahedra.
    #[error(
        "pulling edge {edge} together would leave a radius ratio of {radius_ratio:.3}; {limit:.3} is allowed"
    )]
    Quality {
        /// The edge.
        edge: EdgeId,
        /// The best worst radius ratio.
        radius_ratio: f64,
        /// What is allowed.
        limit: f64,
    },
}

/// Surface edges much shorter than the others, the shortest in proportion first.
pub fn short_surface_edges(body: &EditableMesh, params: &CollapseParams) -> Vec<EdgeId> {
    let topology = body.topology();
    let length_m = |edge: EdgeId| {
        let [a, b] = topology.edge_nodes(edge).map(|n| body.mesh().positions_m[n.index()]);
        a.distance(b)
    };
    let mut found: Vec<(f64, EdgeId)> = topology
        .live_edges()
        .filter(|&e| topology.is_surface_edge(e))
        .filter_map(|edge| {
            let share = topology.edge_tets(edge).iter().fold(0.0, |most: f64, &t| {
                let longest_m = topology.tet_edges(t).into_iter().map(length_m).fold(0.0, f64::max);
                most.max(length_m(edge) / longest_m)
            });
            (share < params.short_edge).then_some((share, edge))
        })
        .collect();
    found.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
    found.into_iter().map(|(_, e)| e).collect()
}

/// The edit that pulls `edge` together where that leaves the best tetrahedra. The volume of the body stays, as far as
/// one node's place can keep it.
///
/// # Errors
/// [`CollapseRefusal`] says why it must not be.
pub fn collapse(
    body: &EditableMesh,
    edge: EdgeId,
    params: &CollapseParams,
) -> Result<MeshEdit, CollapseRefusal> {
    let topology = body.topology();
    if edge.index() >= topology.n_edges() || !topology.is_live_edge(edge) {
        return Err(CollapseRefusal::NoSuchEdge { edge });
    }
    let [a, b] = topology.edge_nodes(edge);
    if topology.is_surface_node(a) && topology.is_surface_node(b) && !topology.is_surface_edge(edge) {
        return Err(CollapseRefusal::WouldPinch { edge });
    }
    check_links(body, edge, [a, b])?;
    let [at_a_m, at_b_m] = [a, b].map(|n| body.mesh().positions_m[n.index()]);
    let places = kept_places(body, edge)?;
    let (stay, before_m3, worst_before) = survivors(body, edge, [a, b]);
    let limit = params.min_radius_ratio.min(worst_before);
    let mut best: Option<(f64, NodeId, DVec3)> = None;
    for (kept, place_m) in places {
        let gone = if kept == a { b } else { a };
        let keeps_place = place_m == at_a_m || place_m == at_b_m;
        let place_m =
            if keeps_place { place_m } else { with_volume(body, &stay, [a, b], place_m, before_m3) };
        if !is_near(body, gone, place_m, params.surface_tolerance) {
            continue;
        }
        let worst = stay.iter().fold(f64::INFINITY, |least: f64, &t| {
            least.min(radius_ratio(corners_with(body, t, [a, b], place_m)))
        });
        if best.is_none_or(|(so_far, ..)| worst > so_far) {
            best = Some((worst, kept, place_m));
        }
    }
    match best {
        Some((worst, kept, position_m)) if worst > 0.0 && worst >= limit => {
            Ok(MeshEdit::Collapse { edge, kept, position_m })
        }
        _ => {
            let radius_ratio = best.map_or(0.0, |(worst, ..)| worst);
            Err(CollapseRefusal::Quality { edge, radius_ratio, limit })
        }
    }
}

/// The nodes that may be kept and the places [m] to try for them.
fn kept_places(body: &EditableMesh, edge: EdgeId) -> Result<Vec<(NodeId, DVec3)>, CollapseRefusal> {
    let [a, b] = body.topology().edge_nodes(edge);
    let [at_a_m, at_b_m] = [a, b].map(|n| body.mesh().positions_m[n.index()]);
    let middle_m = 0.5 * (at_a_m + at_b_m);
    let sharp_cosine = MoveLimits::default().sharp_cosine;
    // The node with less freedom stays where it is.
    Ok(match [a, b].map(|n| freedom(body, n, sharp_cosine)) {
        [Freedom::Fixed, Freedom::Fixed] => return Err(CollapseRefusal::BothFixed { edge }),
        [Freedom::Ridge { towards: of_a, .. }, Freedom::Ridge { .. }] => {
            if !of_a.contains(&b) {
                return Err(CollapseRefusal::BothFixed { edge });
            }
            vec![(a, middle_m), (a, at_a_m), (b, at_b_m)]
        }
        [Freedom::Fixed, Freedom::Ridge { towards, .. }] if !towards.contains(&a) => {
            return Err(CollapseRefusal::BothFixed { edge });
        }
        [Freedom::Ridge { towards, .. }, Freedom::Fixed] if !towards.contains(&b) => {
            return Err(CollapseRefusal::BothFixed { edge });
        }
        [of_a, of_b] if rank(&of_a) == rank(&of_b) => vec![(a, middle_m), (a, at_a_m), (b, at_b_m)],
        [of_a, of_b] if rank(&of_a) > rank(&of_b) => vec![(a, at_a_m)],
        _ => vec![(b, at_b_m)],
    })
}

fn rank(freedom: &Freedom) -> u8 {
    match freedom {
        Freedom::Free => 0,
        Freedom::Surface { .. } => 1,
        Freedom::Ridge { .. } => 2,
        Freedom::Fixed => 3,
    }
}

/// The common neighbours of the ends must be the nodes at the edge's tetrahedra, or nodes that vanish would leave
/// folded tetrahedra (link condition of Dey, Edelsbrunner, Guha and Nekhayev 1999, as far as nodes go).
fn check_links(body: &EditableMesh, edge: EdgeId, [a, b]: [NodeId; 2]) -> Result<(), CollapseRefusal> {
    let topology = body.topology();
    let neighbours = |n: NodeId| topology.node_edges(n).iter().map(move |&e| topology.other_node(e, n));
    let found = neighbours(a).filter(|&n| neighbours(b).any(|m| m == n)).count();
    let mut around: Vec<NodeId> = topology
        .edge_tets(edge)
        .iter()
        .flat_map(|&t| topology.tet_nodes(t))
        .filter(|&n| n != a && n != b)
        .collect();
    around.sort_unstable();
    around.dedup();
    if found == around.len() {
        Ok(())
    } else {
        Err(CollapseRefusal::Linked { edge, found, allowed: around.len() })
    }
}

/// Tetrahedra at one end only; volume [m3] and smallest radius ratio of all at either end.
fn survivors(body: &EditableMesh, edge: EdgeId, ends: [NodeId; 2]) -> (Vec<TetId>, f64, f64) {
    let topology = body.topology();
    let mut stay = Vec::new();
    let (mut volume_m3, mut worst) = (0.0, f64::INFINITY);
    for end in ends {
        for &tet in topology.node_tets(end) {
            let is_at_edge = topology.edge_tets(edge).binary_search(&tet).is_ok();
            if !is_at_edge {
                stay.push(tet);
            }
            if !is_at_edge || end == ends[0] {
                volume_m3 += body.mesh().tet_volume_m3(tet);
                worst = worst.min(radius_ratio(body.mesh().corners_m(tet)));
            }
        }
    }
    (stay, volume_m3, worst)
}

fn corners_with(body: &EditableMesh, tet: TetId, ends: [NodeId; 2], place_m: DVec3) -> [DVec3; 4] {
    let nodes = body.topology().tet_nodes(tet);
    nodes.map(|n| if ends.contains(&n) { place_m } else { body.mesh().positions_m[n.index()] })
}

/// The place nearest to `place_m` where the tetrahedra have the volume wanted; the volume is linear in the place.
fn with_volume(
    body: &EditableMesh,
    stay: &[TetId],
    ends: [NodeId; 2],
    place_m: DVec3,
    wanted_m3: f64,
) -> DVec3 {
    let (mut volume_m3, mut gradient_m2, mut area_m2) = (0.0, DVec3::ZERO, 0.0);
    for &tet in stay {
        let corners_m = corners_with(body, tet, ends, place_m);
        volume_m3 += tetrahedron_volume_m3(corners_m);
        let nodes = body.topology().tet_nodes(tet);
        let apex = nodes.iter().position(|n| ends.contains(n)).expect("these tetrahedra are at one end");
        let [p, q, r] = TET_TRIANGLES[apex].map(|k| corners_m[k]);
        // Outward from the opposite face is away from the node.
        let share_m2 = (q - p).cross(r - p) / 6.0;
        gradient_m2 -= share_m2;
        area_m2 += share_m2.length();
    }
    // Around an inner node the faces close, and no place changes the volume.
    if gradient_m2.length() <= 1e-6 * area_m2 {
        return place_m;
    }
    place_m + gradient_m2 * ((wanted_m3 - volume_m3) / gradient_m2.length_squared())
}

/// Whether a surface node that vanishes is near the place where it is drawn.
fn is_near(body: &EditableMesh, gone: NodeId, place_m: DVec3, tolerance: f64) -> bool {
    let topology = body.topology();
    if !topology.is_surface_node(gone) {
        return true;
    }
    let at_m = body.mesh().positions_m[gone.index()];
    let longest_m = topology
        .node_edges(gone)
        .iter()
        .map(|&e| body.mesh().positions_m[topology.other_node(e, gone).index()].distance(at_m))
        .fold(0.0, f64::max);
    at_m.distance(place_m) <= tolerance * longest_m
}
