//! The mesh of several organs, and the surfaces in it.

use super::label_faces::{LabelFace, label_faces};
use super::report::OrganMeshReport;
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
    /// Faces between labels, from both sides.
    faces: Vec<LabelFace>,
}

/// A surface cut out of a mesh.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct OrganSurface {
    /// The triangles, counter-clockwise seen from outside the organ whose surface it is.
    pub surface: TriMesh,
    /// Node of the mesh at each vertex, ascending.
    pub nodes: Vec<NodeId>,
}

impl OrganMesh {
    /// A mesh whose tetrahedra have these labels.
    pub(super) fn new(mesh: TetMesh, label_of: Vec<u16>, report: OrganMeshReport) -> Self {
        let faces = label_faces(&mesh.tetrahedra, &label_of);
        Self { mesh, label_of, report, faces }
    }

    /// Labels that have tetrahedra, ascending.
    pub fn labels(&self) -> Vec<u16> {
        let mut labels = self.label_of.clone();
        labels.sort_unstable();
        labels.dedup();
        labels
    }

    /// Pairs of labels that share faces, ascending; 0 is outside.
    pub fn neighbours(&self) -> Vec<[u16; 2]> {
        let faces = self.faces.iter().map(|face| face.labels);
        let mut pairs: Vec<[u16; 2]> = faces.filter(|[low, high]| low < high).collect();
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

    /// Number of faces between two labels; 0 is outside.
    pub fn n_faces_between(&self, label: u16, other: u16) -> usize {
        self.faces.iter().filter(|face| face.labels == [label, other]).count()
    }

    fn surface_where(&self, is_wanted: impl Fn([u16; 2]) -> bool) -> OrganSurface {
        let wanted = self.faces.iter().filter(|face| is_wanted(face.labels));
        let faces: Vec<[NodeId; 3]> = wanted.map(|face| face.nodes).collect();
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
}
