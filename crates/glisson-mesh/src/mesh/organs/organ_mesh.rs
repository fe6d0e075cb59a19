//! The mesh of several organs, and the surfaces in it.

use super::report::OrganMeshReport;
use crate::mesh::topology::TET_TRIANGLES;
use crate::mesh::topology::build::sorted_faces;
use crate::mesh::{NodeId, TetMesh};
use crate::surface::TriMesh;

/// One conforming mesh of several organs.
#[derive(Clone, Debug, PartialEq)]
pub struct OrganMesh {
    /// All tetrahedra; those of one organ share nodes and faces with those of the next.
    pub mesh: TetMesh,
    /// Label of each tetrahedron.
    pub label_of: Vec<u16>,
    /// How well it met what was wanted.
    pub report: OrganMeshReport,
}

/// A surface cut out of a mesh.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct OrganSurface {
    /// The triangles, counter-clockwise seen from outside the organ whose surface it is.
    pub surface: TriMesh,
    /// Node of the mesh at each vertex, ascending.
    pub nodes: Vec<NodeId>,
}

/// A face of the mesh between two labels, as the first of them sees it.
struct LabelFace {
    nodes: [NodeId; 3],
    labels: [u16; 2],
}

impl OrganMesh {
    /// Labels that have tetrahedra, ascending.
    pub fn labels(&self) -> Vec<u16> {
        let mut labels = self.label_of.clone();
        labels.sort_unstable();
        labels.dedup();
        labels
    }

    /// Pairs of labels that share faces, ascending; 0 is outside.
    pub fn neighbours(&self) -> Vec<[u16; 2]> {
        let mut pairs: Vec<[u16; 2]> = Vec::new();
        self.for_each_label_face(|face| {
            if face.labels[0] < face.labels[1] {
                pairs.push(face.labels);
            }
        });
        pairs.sort_unstable();
        pairs.dedup();
        pairs
    }

    /// The closed surface of all tetrahedra of `label`, inner surfaces included; of all organs together for label 0, seen
    /// from outside them.
    pub fn surface_of(&self, label: u16) -> OrganSurface {
        self.surface_where(|labels| match label {
            0 => labels[1] == 0,
            _ => labels[0] == label,
        })
    }

    /// The interface of two labels, counter-clockwise seen from `other`; 0 is outside. Empty where they do not touch.
    pub fn interface(&self, label: u16, other: u16) -> OrganSurface {
        self.surface_where(|labels| labels == [label, other])
    }

    fn surface_where(&self, is_wanted: impl Fn([u16; 2]) -> bool) -> OrganSurface {
        let mut faces = Vec::new();
        self.for_each_label_face(|face| {
            if is_wanted(face.labels) {
                faces.push(face.nodes);
            }
        });
        let mut nodes: Vec<NodeId> = faces.iter().flatten().copied().collect();
        nodes.sort_unstable();
        nodes.dedup();
        let mut vertex_of = vec![u32::MAX; self.mesh.positions_m.len()];
        for (vertex, node) in (0u32..).zip(&nodes) {
            vertex_of[node.index()] = vertex;
        }
        let surface = TriMesh {
            positions_m: nodes.iter().map(|n| self.mesh.positions_m[n.index()]).collect(),
            triangles: faces.iter().map(|f| f.map(|n| vertex_of[n.index()])).collect(),
        };
        OrganSurface { surface, nodes }
    }

    /// Calls `visit` with every face between two labels, from both sides, in the order of their ascending nodes.
    fn for_each_label_face(&self, mut visit: impl FnMut(LabelFace)) {
        let tets = &self.mesh.tetrahedra;
        let label = |record: u32| self.label_of[record as usize / 4];
        let nodes = |record: u32| TET_TRIANGLES[record as usize % 4].map(|k| tets[record as usize / 4][k]);
        for same in sorted_faces(tets).chunk_by(|a, b| a.0 == b.0) {
            match *same {
                [(_, only)] => {
                    visit(LabelFace { nodes: nodes(only), labels: [label(only), 0] });
                    let [a, b, c] = nodes(only);
                    visit(LabelFace { nodes: [a, c, b], labels: [0, label(only)] });
                }
                [(_, a), (_, b)] if label(a) != label(b) => {
                    visit(LabelFace { nodes: nodes(a), labels: [label(a), label(b)] });
                    visit(LabelFace { nodes: nodes(b), labels: [label(b), label(a)] });
                }
                _ => {}
            }
        }
    }
}
