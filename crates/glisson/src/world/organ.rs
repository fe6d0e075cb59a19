//! The organ as the world sees it: mesh, supports, and the surface that is displayed and touched.

use super::spec::{Support, fixed_nodes};
use crate::contact::buckets::BucketGrid;
use crate::contact::sphere::SurfaceView;
use crate::math::DVec3;
use crate::mesh::edit::{EditError, EditableMesh, MeshEdit, TopologyChange};
use crate::mesh::remap::EntityArray;
use crate::mesh::topology::{TopologyError, surface_of};
use crate::mesh::{NodeId, TetId, TetMesh};
use crate::record::snapshot::DisplayTopology;

/// Why a mesh is not an organ.
#[derive(Debug, thiserror::Error)]
pub enum OrganError {
    /// The mesh is no mesh.
    #[error(transparent)]
    Topology(#[from] TopologyError),
    /// No tetrahedra.
    #[error("the mesh has no tetrahedra")]
    Empty,
}

/// Mesh, supports and moving surface of one organ.
#[derive(Clone, Debug)]
pub struct Organ {
    body: EditableMesh,
    /// Held along every axis.
    fixed: EntityArray<NodeId, bool>,
    surface_nodes: Vec<NodeId>,
    surface_triangles: Vec<[u32; 3]>,
    surface_positions_m: Vec<DVec3>,
    buckets: BucketGrid,
    topology_version: u32,
}

impl Organ {
    /// An organ at rest.
    ///
    /// # Errors
    /// [`OrganError`] when the mesh is not a body.
    pub fn new(mesh: TetMesh, supports: &[Support]) -> Result<Self, OrganError> {
        if mesh.tetrahedra.is_empty() {
            return Err(OrganError::Empty);
        }
        let mut fixed = vec![false; mesh.positions_m.len()];
        for held in fixed_nodes(supports, &mesh.positions_m) {
            fixed[held.node.index()] = held.axes == [true; 3];
        }
        let body = EditableMesh::new(mesh)?;
        let (surface, surface_nodes) = surface_of(body.topology(), body.mesh());
        let buckets = BucketGrid::new(&surface.positions_m, &surface.triangles);
        Ok(Self {
            body,
            fixed: EntityArray::new(fixed),
            surface_nodes,
            surface_triangles: surface.triangles,
            surface_positions_m: surface.positions_m,
            buckets,
            topology_version: 1,
        })
    }

    /// Edits the mesh; the supports and the surface follow, the model has to.
    ///
    /// # Errors
    /// [`EditError`] when the edit cannot be done; nothing changed then.
    pub fn edit(&mut self, edit: &MeshEdit, positions_m: &[DVec3]) -> Result<TopologyChange, EditError> {
        let change = self.body.apply(edit)?;
        self.fixed.follow(&change);
        let (surface, surface_nodes) = surface_of(self.body.topology(), self.body.mesh());
        // A node that the edit made has no place in the model yet.
        let at_rest = |n: &NodeId| self.body.mesh().positions_m[n.index()];
        let now = |n: &NodeId| positions_m.get(n.index()).copied().unwrap_or_else(|| at_rest(n));
        self.surface_positions_m = surface_nodes.iter().map(now).collect();
        self.surface_nodes = surface_nodes;
        self.surface_triangles = surface.triangles;
        self.buckets = BucketGrid::new(&self.surface_positions_m, &self.surface_triangles);
        self.topology_version += 1;
        Ok(change)
    }

    /// The mesh at rest.
    pub fn mesh(&self) -> &TetMesh {
        self.body.mesh()
    }

    /// Which tetrahedra are still there.
    pub fn live_tetrahedra(&self) -> &[bool] {
        self.body.topology().live_tet_flags()
    }

    /// The tetrahedra that were removed, ascending; node and tetrahedron numbers are still those of the start.
    pub fn removed_tetrahedra(&self) -> Vec<TetId> {
        let live = self.live_tetrahedra();
        (0..live.len()).filter(|&t| !live[t]).map(TetId::from_index).collect()
    }

    /// Mesh and adjacency.
    pub fn body(&self) -> &EditableMesh {
        &self.body
    }

    /// Whether `node` is held at rest along every axis.
    pub fn is_fixed(&self, node: NodeId) -> bool {
        self.fixed.as_slice()[node.index()]
    }

    /// The nodes held along every axis, ascending.
    pub fn fixed_nodes(&self) -> Vec<NodeId> {
        let fixed = self.fixed.as_slice();
        (0..fixed.len()).filter(|&i| fixed[i]).map(NodeId::from_index).collect()
    }

    /// The nodes of the surface, ascending.
    pub fn surface_nodes(&self) -> &[NodeId] {
        &self.surface_nodes
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
            rest_positions_m: self.surface_nodes.iter().map(|n| self.mesh().positions_m[n.index()]).collect(),
            triangles: self.surface_triangles.clone(),
        }
    }
}
