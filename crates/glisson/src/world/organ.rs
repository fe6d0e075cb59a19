//! The organ as the world sees it: mesh, supports, and the surface that is displayed and touched.

use super::spec::{FixedRegion, nodes_in};
use crate::contact::buckets::BucketGrid;
use crate::contact::sphere::SurfaceView;
use crate::math::DVec3;
use crate::mesh::{NodeId, TetMesh};
use crate::record::snapshot::DisplayTopology;

/// Why a mesh is not an organ.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum OrganError {
    /// No tetrahedra.
    #[error("the mesh has no tetrahedra")]
    Empty,
}

/// Mesh, supports and moving surface of one organ.
#[derive(Clone, Debug)]
pub struct Organ {
    mesh: TetMesh,
    live: Vec<bool>,
    fixed: Vec<bool>,
    surface_nodes: Vec<NodeId>,
    surface_triangles: Vec<[u32; 3]>,
    surface_positions_m: Vec<DVec3>,
    buckets: BucketGrid,
    topology_version: u32,
}

/// Boundary triangles by node ids, sorted: faces that one tetrahedron alone has.
fn boundary(mesh: &TetMesh) -> Vec<[NodeId; 3]> {
    let mut faces: Vec<([NodeId; 3], [NodeId; 3])> = Vec::new();
    for &[a, b, c, d] in &mesh.tetrahedra {
        for face in [[b, c, d], [a, d, c], [a, b, d], [a, c, b]] {
            let mut key = face;
            key.sort_unstable();
            faces.push((key, face));
        }
    }
    faces.sort_unstable();
    faces.chunk_by(|a, b| a.0 == b.0).filter(|run| run.len() == 1).map(|run| run[0].1).collect()
}

impl Organ {
    /// An organ at rest.
    ///
    /// # Errors
    /// [`OrganError`] when the mesh is not a body.
    pub fn new(mesh: TetMesh, regions: &[FixedRegion]) -> Result<Self, OrganError> {
        if mesh.tetrahedra.is_empty() {
            return Err(OrganError::Empty);
        }
        let mut fixed = vec![false; mesh.positions_m.len()];
        for node in nodes_in(regions, &mesh.positions_m) {
            fixed[node.index()] = true;
        }
        let triangles = boundary(&mesh);
        let mut surface_nodes: Vec<NodeId> = triangles.iter().flatten().copied().collect();
        surface_nodes.sort_unstable();
        surface_nodes.dedup();
        let vertex = |n: NodeId| surface_nodes.binary_search(&n).expect("a boundary node") as u32;
        let surface_triangles: Vec<[u32; 3]> = triangles.iter().map(|t| t.map(vertex)).collect();
        let surface_positions_m: Vec<DVec3> =
            surface_nodes.iter().map(|n| mesh.positions_m[n.index()]).collect();
        let buckets = BucketGrid::new(&surface_positions_m, &surface_triangles);
        Ok(Self {
            live: vec![true; mesh.tetrahedra.len()],
            mesh,
            fixed,
            surface_nodes,
            surface_triangles,
            surface_positions_m,
            buckets,
            topology_version: 1,
        })
    }

    /// The mesh at rest.
    pub fn mesh(&self) -> &TetMesh {
        &self.mesh
    }

    /// Which tetrahedra are still there.
    pub fn live_tetrahedra(&self) -> &[bool] {
        &self.live
    }

    /// Whether `node` is held at rest.
    pub fn is_fixed(&self, node: NodeId) -> bool {
        self.fixed[node.index()]
    }

    /// The held nodes, ascending.
    pub fn fixed_nodes(&self) -> Vec<NodeId> {
        (0..self.fixed.len()).filter(|&i| self.fixed[i]).map(NodeId::from_index).collect()
    }

    /// Nodes of a surface triangle.
    pub fn surface_triangle(&self, triangle: usize) -> [NodeId; 3] {
        self.surface_triangles[triangle].map(|v| self.surface_nodes[v as usize])
    }

    /// Positions of the surface's vertices now [m].
    pub fn surface_positions_m(&self) -> &[DVec3] {
        &self.surface_positions_m
    }

    /// Changes whenever the surface's triangles change.
    pub fn topology_version(&self) -> u32 {
        self.topology_version
    }

    /// The surface now, for contact queries.
    pub fn surface_view(&self) -> SurfaceView<'_> {
        SurfaceView {
            positions_m: &self.surface_positions_m,
            triangles: &self.surface_triangles,
            buckets: &self.buckets,
        }
    }

    /// Moves the surface to these node positions. Allocates nothing.
    pub fn follow(&mut self, positions_m: &[DVec3]) {
        for (vertex, node) in self.surface_positions_m.iter_mut().zip(&self.surface_nodes) {
            *vertex = positions_m[node.index()];
        }
        self.buckets.update(&self.surface_positions_m, &self.surface_triangles);
    }

    /// The surface for a viewer.
    pub fn display_topology(&self) -> DisplayTopology {
        DisplayTopology {
            version: self.topology_version,
            nodes: self.surface_nodes.clone(),
            rest_positions_m: self.surface_nodes.iter().map(|n| self.mesh.positions_m[n.index()]).collect(),
            triangles: self.surface_triangles.clone(),
        }
    }
}
