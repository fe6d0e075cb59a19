//! New nodes on edges. A tetrahedron with several divided edges is cut in two at the first of them in the edit's
//! list, its parts that have the second one at that, and so on. How a face is divided depends on its own edges
//! and their order alone, so neighbours match.

use super::plan::Plan;
use super::{EdgeSplit, EditError, EditableMesh};
use crate::mesh::{EdgeId, NodeId};

impl EditableMesh {
    /// Refuses an edge that is not there or has no tetrahedron.
    pub(super) fn check_edge(&self, edge: EdgeId) -> Result<(), EditError> {
        let n_edges = self.topology.n_edges();
        if edge.index() >= n_edges || !self.topology.is_live_edge(edge) {
            return Err(EditError::NoSuchEdge { edge, n_edges });
        }
        Ok(())
    }

    pub(super) fn plan_split(&self, edges: &[EdgeSplit], plan: &mut Plan) -> Result<(), EditError> {
        // Edge, place in the list, new node.
        let mut divided: Vec<(EdgeId, usize, NodeId)> = Vec::with_capacity(edges.len());
        for (place, &EdgeSplit { edge, fraction }) in edges.iter().enumerate() {
            self.check_edge(edge)?;
            if !(fraction > 0.0 && fraction < 1.0) {
                return Err(EditError::BadFraction { edge, fraction });
            }
            let [a, b] = self.topology.edge_nodes(edge);
            let [a_m, b_m] = [a, b].map(|n| self.mesh.positions_m[n.index()]);
            let node = plan.add_node(a_m.lerp(b_m, fraction), &[(a, 1.0 - fraction), (b, fraction)]);
            divided.push((edge, place, node));
            plan.doomed.extend_from_slice(self.topology.edge_tets(edge));
        }
        divided.sort_unstable();
        if let Some(pair) = divided.windows(2).find(|pair| pair[0].0 == pair[1].0) {
            return Err(EditError::RepeatedEdge { edge: pair[0].0 });
        }
        plan.doomed.sort_unstable();
        plan.doomed.dedup();

        let mut cuts: Vec<(usize, [NodeId; 2], NodeId)> = Vec::with_capacity(6);
        let mut parts: Vec<[NodeId; 4]> = Vec::with_capacity(16);
        for at in 0..plan.doomed.len() {
            let tet = plan.doomed[at];
            cuts.clear();
            for edge in self.topology.tet_edges(tet) {
                if let Ok(found) = divided.binary_search_by_key(&edge, |d| d.0) {
                    let (_, place, node) = divided[found];
                    cuts.push((place, self.topology.edge_nodes(edge), node));
                }
            }
            cuts.sort_unstable();
            parts.clear();
            parts.push(self.topology.tet_nodes(tet));
            for &(_, ends, node) in &cuts {
                for part in 0..parts.len() {
                    let places = ends.map(|end| parts[part].iter().position(|&n| n == end));
                    if let [Some(a), Some(b)] = places {
                        let mut other = parts[part];
                        other[a] = node;
                        parts[part][b] = node;
                        parts.push(other);
                    }
                }
            }
            for &part in &parts {
                plan.add_tet(part, &[(tet, 1.0)]);
            }
        }
        plan.check_volumes(&self.mesh)
    }
}
