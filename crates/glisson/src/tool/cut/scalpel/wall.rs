//! The wall of a cut: faces of tetrahedra that are to come apart, and the groups into which they part the
//! tetrahedra at a node.

use crate::math::DVec3;
use crate::mesh::edit::EditableMesh;
use crate::mesh::topology::Topology;
use crate::mesh::{NodeId, TetId, TriangleId};

/// Cosine of the widest angle [150 degrees] that one face of the wall may have at the node that it opens: a flatter
/// one would lie along the surface instead of going into the depth. A choice.
const WIDEST_COSINE: f64 = -0.866;

/// Cost of each face of the wall beside the squared distances of its nodes from the plane: prefers few faces.
const FACE_COST: f64 = 0.02;

/// A plane [m] through `point_m` across `normal`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Plane {
    pub(super) point_m: DVec3,
    pub(super) normal: DVec3,
}

impl Plane {
    /// Signed distance [m].
    pub(super) fn height_m(&self, point_m: DVec3) -> f64 {
        (point_m - self.point_m).dot(self.normal)
    }

    /// The nearest point of the plane [m].
    pub(super) fn nearest_m(&self, point_m: DVec3) -> DVec3 {
        point_m - self.height_m(point_m) * self.normal
    }
}

/// Three nodes of a face, ascending.
pub(super) fn face(a: NodeId, b: NodeId, c: NodeId) -> [NodeId; 3] {
    let mut nodes = [a, b, c];
    nodes.sort_unstable();
    nodes
}

/// The live triangle with these nodes.
pub(super) fn triangle_of(topology: &Topology, nodes: [NodeId; 3]) -> Option<TriangleId> {
    topology
        .node_tets(nodes[0])
        .iter()
        .flat_map(|&tet| topology.tet_triangles(tet))
        .find(|&t| topology.triangle_nodes(t) == nodes)
}

/// The nodes between `ends` of the cheapest way around `node`, from neighbour to neighbour across inner faces at
/// `node`: with `node` they make the wall that goes with the plane. `None` if there is no way.
///
/// The price of a neighbour is its squared distance from the plane over its squared distance from `node`; it must
/// be joined to `node` by an inner edge. Dijkstra's algorithm on the few neighbours of one node.
pub(super) fn way_around(
    body: &EditableMesh,
    positions_m: &[DVec3],
    node: NodeId,
    ends: [NodeId; 2],
    plane: &Plane,
) -> Option<Vec<NodeId>> {
    let topology = body.topology();
    let around = prices_around(topology, positions_m, (node, ends), plane);
    let place = |n: NodeId| around.iter().position(|&(other, _)| other == n);
    let links = links_around(topology, positions_m, node, place)?;
    let [start, end] = [place(ends[0])?, place(ends[1])?];
    if start == end {
        // The cut's front comes back to itself: there is no way from one end to the other.
        return None;
    }
    let before = cheapest_before(&around, &links, [start, end])?;
    let mut way = Vec::new();
    let mut at = before[end];
    while at != start {
        way.push(around[at].0);
        at = before[at];
    }
    way.reverse();
    Some(way)
}

/// The neighbours of the node, and the price of each for a way between the ends: infinite where it may not pass.
fn prices_around(
    topology: &Topology,
    positions_m: &[DVec3],
    (node, ends): (NodeId, [NodeId; 2]),
    plane: &Plane,
) -> Vec<(NodeId, f64)> {
    let at_m = |n: NodeId| positions_m[n.index()];
    let center_m = at_m(node);
    let mut around: Vec<(NodeId, f64)> = Vec::new();
    for &edge in topology.node_edges(node) {
        let other = topology.other_node(edge, node);
        let is_end = ends.contains(&other);
        let height_m = plane.height_m(at_m(other));
        let price = match (is_end, topology.is_surface_edge(edge)) {
            (true, _) => 0.0,
            (false, true) => f64::INFINITY,
            (false, false) => height_m * height_m / at_m(other).distance_squared(center_m),
        };
        around.push((other, price));
    }
    around
}

/// The pairs of neighbours, by their `place`, that an inner face at `node` joins and that are not seen from it too far
/// apart. `None` when a neighbour has no place.
fn links_around(
    topology: &Topology,
    positions_m: &[DVec3],
    node: NodeId,
    place: impl Fn(NodeId) -> Option<usize>,
) -> Option<Vec<[usize; 2]>> {
    let at_m = |n: NodeId| positions_m[n.index()];
    let center_m = at_m(node);
    let mut links: Vec<[usize; 2]> = Vec::new();
    for &tet in topology.node_tets(node) {
        for triangle in topology.tet_triangles(tet) {
            let [first, second] = topology.triangle_tets(triangle);
            if second.is_none() || first.get() != Some(tet) {
                continue;
            }
            let others = topology.triangle_nodes(triangle);
            let Some(own) = others.iter().position(|&n| n == node) else { continue };
            let [a, b] = [others[(own + 1) % 3], others[(own + 2) % 3]];
            let [to_a, to_b] = [a, b].map(|n| (at_m(n) - center_m).normalize_or_zero());
            if to_a.dot(to_b) > WIDEST_COSINE {
                links.push([place(a)?, place(b)?]);
            }
        }
    }
    Some(links)
}

/// For each neighbour the one before it on the cheapest way from `start`, as far as it takes to reach `end`. `None` if
/// there is no way.
fn cheapest_before(
    around: &[(NodeId, f64)],
    links: &[[usize; 2]],
    [start, end]: [usize; 2],
) -> Option<Vec<usize>> {
    let mut cost = vec![f64::INFINITY; around.len()];
    let mut before = vec![usize::MAX; around.len()];
    let mut done = vec![false; around.len()];
    cost[start] = 0.0;
    loop {
        let mut here = None;
        for i in 0..around.len() {
            if !done[i] && cost[i].is_finite() && here.is_none_or(|h: usize| cost[i] < cost[h]) {
                here = Some(i);
            }
        }
        let here = here?;
        if here == end {
            return Some(before);
        }
        done[here] = true;
        for &[a, b] in links {
            let next = if a == here {
                b
            } else if b == here {
                a
            } else {
                continue;
            };
            let price = cost[here] + around[next].1 + FACE_COST;
            if price < cost[next] {
                cost[next] = price;
                before[next] = here;
            }
        }
    }
}

/// The groups of tetrahedra at `node` that hang together through faces at `node` which are not in `wall`; each
/// ascending, in the order of their lowest tetrahedra.
pub(super) fn groups_at(topology: &Topology, node: NodeId, wall: &[[NodeId; 3]]) -> Vec<Vec<TetId>> {
    let tets = topology.node_tets(node);
    let mut group: Vec<usize> = (0..tets.len()).collect();
    for (at, &tet) in tets.iter().enumerate() {
        let neighbours = topology.tet_neighbours(tet);
        let triangles = topology.tet_triangles(tet);
        for (neighbour, triangle) in neighbours.into_iter().zip(triangles) {
            let Some(other) = neighbour.get().and_then(|n| tets.binary_search(&n).ok()) else { continue };
            let nodes = topology.triangle_nodes(triangle);
            if other < at || !nodes.contains(&node) || wall.contains(&nodes) {
                continue;
            }
            let (low, high) = (group[at].min(group[other]), group[at].max(group[other]));
            if low != high {
                for g in &mut group {
                    if *g == high {
                        *g = low;
                    }
                }
            }
        }
    }
    let mut groups: Vec<(usize, Vec<TetId>)> = Vec::new();
    for (&g, &tet) in group.iter().zip(tets) {
        match groups.iter_mut().find(|(of, _)| *of == g) {
            Some((_, members)) => members.push(tet),
            None => groups.push((g, vec![tet])),
        }
    }
    groups.into_iter().map(|(_, members)| members).collect()
}
