//! What is right and wrong with a mesh, by index, and with a surface.

use super::faults::{ImportReport, SharedTriangle, listed};
use super::quality::{MeshQuality, SurfaceShape, surface_triangles};
use super::{TetId, TetMesh};
use crate::surface::TriMesh;
use crate::surface::check::{SurfaceTopology, check_closed};

/// A mesh that was looked at: its numbers, and what makes it unfit for simulation.
#[derive(Clone, Debug, serde::Serialize)]
pub struct MeshCheck {
    /// Always "tetrahedra".
    pub kind: &'static str,
    /// Its numbers.
    #[serde(flatten)]
    pub quality: MeshQuality,
    /// Everything wrong.
    pub faults: FaultIndices,
}

/// Everything wrong, by index from 0 in the order of the file.
#[derive(Clone, Debug, serde::Serialize)]
pub struct FaultIndices {
    /// Node, and the first one at its place.
    pub duplicate_nodes: Vec<[u32; 2]>,
    /// Nodes of no tetrahedron.
    pub loose_nodes: Vec<u32>,
    /// Tetrahedra that name a node twice.
    pub tetrahedra_with_repeated_nodes: Vec<u32>,
    /// Tetrahedron, and the first one with its nodes.
    pub repeated_tetrahedra: Vec<[u32; 2]>,
    /// Tetrahedra that were, or are, inside out.
    pub inverted_tetrahedra: Vec<u32>,
    /// Tetrahedra without a volume.
    pub flat_tetrahedra: Vec<u32>,
    /// Nodes of triangles with more than two tetrahedra.
    pub crowded_triangles: Vec<[u32; 3]>,
    /// Nodes of triangles whose two tetrahedra lie on the same side.
    pub folded_triangles: Vec<[u32; 3]>,
    /// Nodes of each.
    pub surface_edges_not_between_two_triangles: Vec<[u32; 2]>,
    /// By their numbers.
    pub nodes_where_the_surface_touches_itself: Vec<u32>,
}

impl MeshCheck {
    /// Looks at a mesh as it was imported; answers the faults in words, too: a line for each kind, none where the mesh is fit for
    /// simulation.
    pub fn of(mesh: &TetMesh, import: &ImportReport) -> (Self, Vec<String>) {
        let (triangles, _) = surface_triangles(mesh);
        let shape = SurfaceShape::of(mesh.positions_m.len(), &triangles);
        let faults = FaultIndices::of(import, &shape);
        let mut lines = import.faults.lines();
        let inverted = "tetrahedra inside out in the file (volume below 0)";
        let edges = &faults.surface_edges_not_between_two_triangles;
        let edges: Vec<String> = edges.iter().map(|[a, b]| format!("({a}, {b})")).collect();
        lines.extend(listed(&import.winding_fixed, inverted, ""));
        lines.extend(listed(&edges, "surface edges that are not between two triangles", ""));
        lines.extend(listed(&shape.pinched_vertices, "nodes at which the surface touches itself", ""));
        (Self { kind: "tetrahedra", quality: MeshQuality::of(mesh), faults }, lines)
    }
}

impl FaultIndices {
    fn of(import: &ImportReport, shape: &SurfaceShape) -> Self {
        let faults = &import.faults;
        let tets = |list: &[TetId]| list.iter().map(|t| t.0).collect::<Vec<_>>();
        let triangles = |list: &[SharedTriangle]| list.iter().map(|s| s.nodes.map(|n| n.0)).collect();
        let mut inverted_tetrahedra = tets(&import.winding_fixed);
        inverted_tetrahedra.extend(tets(&faults.inverted));
        inverted_tetrahedra.sort_unstable();
        let edges = shape.pinched_edges.iter().chain(&shape.open_edges);
        Self {
            duplicate_nodes: faults.duplicate_nodes.iter().map(|(node, first)| [node.0, first.0]).collect(),
            loose_nodes: faults.loose_nodes.iter().map(|n| n.0).collect(),
            tetrahedra_with_repeated_nodes: tets(&faults.repeated_nodes),
            repeated_tetrahedra: faults.repeated_tets.iter().map(|(t, first)| [t.0, first.0]).collect(),
            inverted_tetrahedra,
            flat_tetrahedra: tets(&faults.flat),
            crowded_triangles: triangles(&faults.crowded_triangles),
            folded_triangles: triangles(&faults.folded_triangles),
            surface_edges_not_between_two_triangles: edges.copied().collect(),
            nodes_where_the_surface_touches_itself: shape.pinched_vertices.clone(),
        }
    }
}

/// A surface that was looked at: its numbers, and what makes it unfit for meshing.
#[derive(Clone, Debug, serde::Serialize)]
pub struct SurfaceCheck {
    /// Always "surface".
    pub kind: &'static str,
    /// Vertices.
    pub nodes: usize,
    /// Triangles.
    pub triangles: usize,
    /// Enclosed volume [m3].
    pub volume_m3: f64,
    /// Area [m2], where it is closed.
    pub surface_area_m2: Option<f64>,
    /// Vertices - edges + triangles.
    pub surface_euler_characteristic: i64,
    /// Connected pieces.
    pub surface_pieces: usize,
    /// What is wrong, in words: the first violation of [`check_closed`].
    pub faults: Vec<String>,
}

impl SurfaceCheck {
    /// Looks at a surface; answers its topology, too, where it is closed.
    pub fn of(mesh: &TriMesh) -> (Self, Option<SurfaceTopology>) {
        let checked = check_closed(mesh);
        let shape = SurfaceShape::of(mesh.positions_m.len(), &mesh.triangles);
        let check = Self {
            kind: "surface",
            nodes: mesh.positions_m.len(),
            triangles: mesh.triangles.len(),
            volume_m3: mesh.volume_m3(),
            surface_area_m2: checked.as_ref().ok().map(|topology| topology.area_m2),
            surface_euler_characteristic: shape.euler_characteristic,
            surface_pieces: shape.pieces,
            faults: checked.as_ref().err().map(ToString::to_string).into_iter().collect(),
        };
        (check, checked.ok())
    }
}
