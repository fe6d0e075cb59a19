//! Places where a solid hangs together by less than a face: a node or an edge whose tetrahedra fall into several
//! groups that are joined to each other by no face there. Removing tetrahedra leaves such places behind; a model
//! holds two parts together there that nothing but a point or a line joins (Forest, Delingette and Ayache, 2003,
//! as told in seed 000, s. 4.4.2).

use super::Topology;
use crate::mesh::{EdgeId, NodeId, TetId};

/// Nodes and edges whose tetrahedra fall into several face-connected groups.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct SingularEntities {
    /// Nodes held by several groups, ascending.
    pub nodes: Vec<NodeId>,
    /// Edges held by several groups, ascending.
    pub edges: Vec<EdgeId>,
}

impl SingularEntities {
    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.nodes.is_empty() && self.edges.is_empty()
    }
}

/// The tetrahedra at a node in groups that are connected by the faces at that node. Reusable.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct StarGroups {
    /// Group of each of [`Topology::node_tets`], in that order; groups are numbered by their lowest tetrahedron.
    pub of_tet: Vec<u32>,
    /// Number of groups.
    pub count: usize,
    stack: Vec<usize>,
}

const UNSEEN: u32 = u32::MAX;

impl Topology {
    /// Groups of the tetrahedra at `node`, into buffers that are kept.
    pub fn star_groups_into(&self, node: NodeId, groups: &mut StarGroups) {
        self.star_groups_across_into(node, |_, _| true, groups);
    }

    /// Groups of the tetrahedra at `node` joined by the faces at it which `is_joined` lets pass: it is asked with
    /// a tetrahedron and the place of one of its faces. A cut along faces says no to them.
    pub fn star_groups_across_into(
        &self,
        node: NodeId,
        is_joined: impl Fn(TetId, usize) -> bool,
        groups: &mut StarGroups,
    ) {
        let star = self.node_tets(node);
        groups.of_tet.clear();
        groups.of_tet.resize(star.len(), UNSEEN);
        groups.count = 0;
        for start in 0..star.len() {
            if groups.of_tet[start] != UNSEEN {
                continue;
            }
            let group = groups.count as u32;
            groups.count += 1;
            groups.of_tet[start] = group;
            groups.stack.push(start);
            while let Some(at) = groups.stack.pop() {
                let tet = star[at];
                let opposite = self.local_node(tet, node);
                for (face, next) in self.tet_neighbours(tet).into_iter().enumerate() {
                    let Some(next) = next.get().filter(|_| face != opposite && is_joined(tet, face)) else {
                        continue;
                    };
                    let next = star.binary_search(&next).expect("the face has the node");
                    if groups.of_tet[next] == UNSEEN {
                        groups.of_tet[next] = group;
                        groups.stack.push(next);
                    }
                }
            }
        }
    }

    /// The singular ones among `nodes` and the edges at them. After an edit only nodes of tetrahedra that it took
    /// out or brought in can have become singular: [`Topology::nodes_near`].
    pub fn singular_entities(&self, nodes: &[NodeId]) -> SingularEntities {
        let mut found = SingularEntities::default();
        let mut groups = StarGroups::default();
        for &node in nodes {
            if !self.is_surface_node(node) {
                continue;
            }
            self.star_groups_into(node, &mut groups);
            if groups.count > 1 {
                found.nodes.push(node);
            }
            // Each group at an edge of the surface ends in two surface triangles.
            found.edges.extend(self.node_edges(node).iter().filter(|&&e| self.is_pinched_edge(e)));
        }
        found.nodes.sort_unstable();
        found.nodes.dedup();
        found.edges.sort_unstable();
        found.edges.dedup();
        found
    }
}
