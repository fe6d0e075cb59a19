//! The faces between tetrahedra of different labels.

use crate::mesh::NodeId;
use crate::mesh::topology::TET_TRIANGLES;
use crate::mesh::topology::build::sorted_faces;

/// A face between two labels, as the first of them sees it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct LabelFace {
    /// Nodes, counter-clockwise seen from the second label.
    pub(super) nodes: [NodeId; 3],
    pub(super) labels: [u16; 2],
}

/// Every face between two labels, from both sides, in the order of their ascending nodes; where there is no tetrahedron
/// the label is 0.
pub(super) fn label_faces(tets: &[[NodeId; 4]], label_of: &[u16]) -> Vec<LabelFace> {
    let label = |record: u32| label_of[record as usize / 4];
    let nodes = |record: u32| TET_TRIANGLES[record as usize % 4].map(|k| tets[record as usize / 4][k]);
    let mut found = Vec::new();
    for same in sorted_faces(tets).chunk_by(|a, b| a.0 == b.0) {
        let (a, b) = (same[0].1, same.get(1).map(|second| second.1));
        let labels = [label(a), b.map_or(0, label)];
        if labels[0] == labels[1] {
            continue;
        }
        let turned = || {
            let [p, q, r] = nodes(a);
            [p, r, q]
        };
        found.push(LabelFace { nodes: nodes(a), labels });
        found.push(LabelFace { nodes: b.map_or_else(turned, nodes), labels: [labels[1], labels[0]] });
    }
    found
}
