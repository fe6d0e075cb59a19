//! Pulling the ends of an edge together.
//!
//! Allowed where that leaves the shape as connected as it was: whatever both ends are joined to, the edge must
//! be joined to (the link condition of Dey, Edelsbrunner, Guha and Nekhayev, Topology preserving edge
//! contraction, Publ. Inst. Math. Belgrade 66, 1999), the outside counted as one more node that is joined to
//! the whole surface.

use super::plan::{Move, Plan};
use super::{EditError, EditableMesh, NodeWeights};
use crate::math::{DVec3, is_inverted, tetrahedron_volume_m3};
use crate::mesh::{EdgeId, NodeId, TetId};

/// What the tetrahedra at a node have opposite to it: nodes, pairs and triples, ascending, each once. The surface
/// adds the nodes and pairs that it joins to the node.
struct Link {
    nodes: Vec<NodeId>,
    pairs: Vec<[NodeId; 2]>,
    triples: Vec<[NodeId; 3]>,
    on_surface: bool,
    surface_nodes: Vec<NodeId>,
    surface_pairs: Vec<[NodeId; 2]>,
}

fn sorted<T: Ord>(mut items: Vec<T>) -> Vec<T> {
    items.sort_unstable();
    items.dedup();
    items
}

/// The first thing in both `a` and `b`, ascending, that is not in `allowed`, ascending.
fn first_common<T: Ord + Copy>(a: &[T], b: &[T], allowed: &[T]) -> Option<T> {
    a.iter().copied().find(|x| b.binary_search(x).is_ok() && allowed.binary_search(x).is_err())
}

impl EditableMesh {
    fn link(&self, node: NodeId) -> Link {
        let topology = &self.topology;
        let mut pairs = Vec::new();
        let mut triples = Vec::new();
        for &tet in topology.node_tets(node) {
            let mut others = topology.tet_nodes(tet);
            others.sort_unstable_by_key(|&n| (n == node, n));
            let [a, b, c, _] = others;
            pairs.extend([[a, b], [a, c], [b, c]]);
            triples.push([a, b, c]);
        }
        let nodes = topology.node_edges(node).iter().map(|&e| topology.other_node(e, node)).collect();
        let surface_edges = topology.node_edges(node).iter().filter(|&&e| topology.is_surface_edge(e));
        let surface_nodes = surface_edges.map(|&e| topology.other_node(e, node)).collect();
        let surface_pairs = topology
            .surface_triangles_at(node)
            .map(|t| {
                let mut others = topology.triangle_nodes(t);
                others.sort_unstable_by_key(|&n| (n == node, n));
                [others[0], others[1]]
            })
            .collect();
        Link {
            nodes: sorted(nodes),
            pairs: sorted(pairs),
            triples: sorted(triples),
            on_surface: topology.is_surface_node(node),
            surface_nodes: sorted(surface_nodes),
            surface_pairs: sorted(surface_pairs),
        }
    }

    fn check_link_condition(&self, edge: EdgeId) -> Result<(), EditError> {
        let topology = &self.topology;
        let [a, b] = topology.edge_nodes(edge);
        let mut pairs = Vec::new();
        for &tet in topology.edge_tets(edge) {
            let mut others = topology.tet_nodes(tet);
            others.sort_unstable_by_key(|&n| (n == a || n == b, n));
            pairs.push([others[0], others[1]]);
        }
        let pairs = sorted(pairs);
        let nodes = sorted(pairs.iter().flatten().copied().collect());
        let surface_nodes = sorted(
            topology
                .surface_triangles_at_edge(edge)
                .flat_map(|t| topology.triangle_nodes(t))
                .filter(|&n| n != a && n != b)
                .collect(),
        );
        let (la, lb) = (self.link(a), self.link(b));
        let found = first_common(&la.nodes, &lb.nodes, &nodes)
            .map(|n| vec![n])
            .or_else(|| first_common(&la.pairs, &lb.pairs, &pairs).map(|p| p.to_vec()))
            .or_else(|| first_common(&la.triples, &lb.triples, &[]).map(|t| t.to_vec()))
            .or_else(|| first_common(&la.surface_nodes, &lb.surface_nodes, &surface_nodes).map(|n| vec![n]))
            .or_else(|| first_common(&la.surface_pairs, &lb.surface_pairs, &[]).map(|p| p.to_vec()))
            .or_else(|| (la.on_surface && lb.on_surface && !topology.is_surface_edge(edge)).then(|| vec![a]));
        match found {
            Some(nodes) => Err(EditError::WouldPinch { edge, nodes }),
            None => Ok(()),
        }
    }

    pub(super) fn plan_collapse(
        &self,
        edge: EdgeId,
        kept: NodeId,
        position_m: DVec3,
        plan: &mut Plan,
    ) -> Result<(), EditError> {
        self.check_edge(edge)?;
        let topology = &self.topology;
        let ends = topology.edge_nodes(edge);
        if !ends.contains(&kept) {
            return Err(EditError::NotAnEnd { edge, node: kept });
        }
        if !position_m.is_finite() {
            return Err(EditError::NotFinite { node: kept, position_m });
        }
        self.check_link_condition(edge)?;

        let gone = topology.other_node(edge, kept);
        if position_m != self.mesh.positions_m[kept.index()] {
            let parents = self.locate_near_edge(position_m, [kept, gone]);
            plan.moved.push(Move { node: kept, position_m, parents, is_blend: false });
        }
        for &tet in topology.node_tets(kept) {
            if topology.tet_nodes(tet).contains(&gone) {
                continue;
            }
            let corners_m = topology.tet_nodes(tet).map(|n| plan.position_m(&self.mesh, n));
            let volume_m3 = tetrahedron_volume_m3(corners_m);
            if is_inverted(volume_m3) {
                return Err(EditError::WouldInvert { node: kept, tet, volume_m3 });
            }
        }
        plan.doomed.extend_from_slice(topology.node_tets(gone));
        for &tet in topology.node_tets(gone) {
            let corners = topology.tet_nodes(tet);
            if !corners.contains(&kept) {
                plan.add_tet(corners.map(|n| if n == gone { kept } else { n }), &[(tet, 1.0)]);
            }
        }
        plan.check_volumes(&self.mesh)
    }

    /// [`EditableMesh::locate`] on an edge where the point lies on it, else in the tetrahedra at its ends.
    fn locate_near_edge(&self, point_m: DVec3, ends: [NodeId; 2]) -> NodeWeights {
        // As a share of the edge's length: rounding of a point that was meant to lie on the edge.
        const ON_EDGE: f64 = 1e-12;
        let [a_m, b_m] = ends.map(|n| self.mesh.positions_m[n.index()]);
        let along_m = b_m - a_m;
        let fraction = (point_m - a_m).dot(along_m) / along_m.length_squared();
        if point_m.distance(a_m + fraction * along_m) <= ON_EDGE * along_m.length() {
            let of_ends = [(ends[0], 1.0 - fraction), (ends[1], fraction)];
            return of_ends.into_iter().filter(|w| w.1 != 0.0).collect();
        }
        let mut weights = NodeWeights::new();
        let around: Vec<TetId> = ends.iter().flat_map(|&n| self.topology.node_tets(n)).copied().collect();
        self.locate(point_m, &around, &mut weights);
        weights
    }
}
