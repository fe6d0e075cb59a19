//! The organ as the world sees it: mesh, supports, and the surface that is displayed and touched.

use super::capsule::Capsule;
use super::display::{DisplayChange, DisplaySurface};
use super::node_answer::node_answers_per_m;
use super::skin::{Skin, SurfaceChange};
use super::suture_spec::SutureError;
use crate::image::vessels::TubeError;
use crate::material::LinearElastic;
use crate::math::DVec3;
use crate::mesh::edit::{EditableMesh, MeshUndo, TopologyChange};
use crate::mesh::remap::{Carried, EntityArray};
use crate::mesh::topology::TopologyError;
use crate::mesh::{NodeId, TetId, TetMesh, TriangleId};
use crate::model::FixedNode;
use crate::record::snapshot::DisplayTopology;
use crate::tool::MAX_TOOLS;

/// Why a mesh is not an organ.
#[derive(Debug, thiserror::Error)]
pub enum OrganError {
    /// The mesh is no mesh.
    #[error(transparent)]
    Topology(#[from] TopologyError),
    /// No tetrahedra.
    #[error("the mesh has no tetrahedra")]
    Empty,
    /// A vessel that makes no sense.
    #[error("vessel {number}: {error}")]
    Vessel {
        /// Its number from 0.
        number: usize,
        /// What is wrong.
        error: TubeError,
    },
    /// A thread that cannot be laid.
    #[error("suture: {0}")]
    Suture(#[from] SutureError),
    /// A model of another mesh.
    #[error("the model has {n_nodes} nodes, the mesh {expected}; make the model from this mesh")]
    Model {
        /// Nodes of the model.
        n_nodes: usize,
        /// Nodes of the mesh.
        expected: usize,
    },
    /// No tool, or too many.
    #[error("{n_tools} instruments; a world has 1 to {MAX_TOOLS}")]
    Tools {
        /// How many.
        n_tools: usize,
    },
}

/// What an edit overwrites of an organ beside its mesh.
#[derive(Clone, Debug, Default)]
pub(super) struct OrganBefore {
    /// Whether each node that was removed was held, in the order of the change.
    fixed: Vec<bool>,
    /// How each of them answered [1/m].
    node_answers_per_m: Vec<f64>,
    /// Where the nodes that moved were at the start and at the end of the last step [m].
    ways_m: Vec<(NodeId, [DVec3; 2])>,
    topology_version: u32,
    /// The surface, where it had to be made anew.
    skin: Option<Box<Skin>>,
}

/// Takes back what an edit did to an array by node: drops what came in, writes the values of what was removed back.
pub(super) fn put_back<T: Carried>(
    array: &mut EntityArray<NodeId, T>,
    change: &TopologyChange,
    of_removed: impl Iterator<Item = T>,
) {
    let mut values = std::mem::replace(array, EntityArray::new(Vec::new())).into_vec();
    values.truncate(change.nodes.n_before);
    for (node, value) in change.nodes.removed.iter().zip(of_removed) {
        if let Some(place) = values.get_mut(node.index()) {
            *place = value;
        }
    }
    *array = EntityArray::new(values);
}

/// New nodes are of their parents' body.
fn follow_bodies(body_of: &mut Vec<u32>, change: &TopologyChange) {
    for (_, parents) in change.nodes.added.iter() {
        let parent = parents.first().and_then(|(parent, _)| body_of.get(parent.index()).copied());
        body_of.push(parent.unwrap_or(0));
    }
    if !change.nodes.new_ids.is_empty() {
        let kept = change.nodes.new_ids.iter().zip(&*body_of).filter(|(id, _)| id.is_some());
        *body_of = kept.map(|(_, body)| *body).collect();
    }
}

/// Tetrahedra that cuts may add before tables have to be moved: a choice.
const SPARE_TETS: usize = 1000;

/// Mesh, supports and moving surface of one organ.
#[derive(Clone, Debug)]
pub struct Organ {
    body: EditableMesh,
    /// Held along every axis.
    fixed: EntityArray<NodeId, bool>,
    /// The body of each node.
    body_of: Vec<u32>,
    /// g E* of each node [1/m] ([`node_answers_per_m`]); not a number where it is not known, as of what edits lay bare.
    node_answers_per_m: EntityArray<NodeId, f64>,
    skin: Skin,
    capsule: Capsule,
    display: DisplaySurface,
    topology_version: u32,
}

impl Organ {
    /// An organ at rest; `fixed` are the nodes that are held, along some axes or all, and `body_of` the body of each node.
    ///
    /// # Errors
    /// [`OrganError`] when the mesh is not a body.
    pub fn new(mesh: TetMesh, held: &[FixedNode], body_of: Vec<u32>) -> Result<Self, OrganError> {
        if mesh.tetrahedra.is_empty() {
            return Err(OrganError::Empty);
        }
        let mut fixed = vec![false; mesh.positions_m.len()];
        let unknown = vec![f64::NAN; mesh.positions_m.len()];
        for held in held {
            fixed[held.node.index()] = held.axes == [true; 3];
        }
        let mut body = EditableMesh::new(mesh)?;
        // The first cuts move no tables.
        body.reserve(SPARE_TETS);
        let capsule = Capsule::default();
        let display = DisplaySurface::new(body.topology(), &capsule);
        let skin = Skin::new(&body, &body.mesh().positions_m);
        Ok(Self {
            body,
            fixed: EntityArray::new(fixed),
            body_of,
            node_answers_per_m: EntityArray::new(unknown),
            skin,
            capsule,
            display,
            topology_version: 1,
        })
    }

    /// Finds how the nodes of the surface answer to forces on them alone, of bodies whose tissue is told by their number.
    pub(super) fn learn_node_answers<'a>(&mut self, tissue_of: impl Fn(usize) -> Option<&'a LinearElastic>) {
        let of_node = |node: NodeId| tissue_of(self.body_of[node.index()] as usize);
        let found = node_answers_per_m(self.body.topology(), self.body.mesh(), of_node);
        self.node_answers_per_m = EntityArray::new(found);
    }

    /// Mesh and adjacency, to be edited; what follows has to be told.
    pub(super) fn body_mut(&mut self) -> &mut EditableMesh {
        &mut self.body
    }

    /// The body was edited: supports and surface follow; `before` keeps what that overwrites.
    pub(super) fn follow_edit(&mut self, change: &TopologyChange, before: &mut OrganBefore) {
        before.fixed.clear();
        before
            .fixed
            .extend(change.nodes.removed.iter().map(|n| n.index() < change.nodes.n_before && self.fixed[*n]));
        before.node_answers_per_m.clear();
        let of_node = self.node_answers_per_m.as_slice();
        let answers =
            change.nodes.removed.iter().map(|n| of_node.get(n.index()).copied().unwrap_or(f64::NAN));
        before.node_answers_per_m.extend(answers);
        before.topology_version = self.topology_version;
        let held = self.held_of_new(change);
        follow_bodies(&mut self.body_of, change);
        self.fixed.follow(change);
        self.node_answers_per_m.follow(change);
        for (node, is_held) in change.nodes.added.ids().iter().zip(held) {
            self.fixed[*node] = is_held && !change.nodes.removed.contains(node);
        }
        let triangles = SurfaceChange {
            added: &change.surface_triangles_added,
            removed: &change.surface_triangles_removed,
        };
        before.ways_m.clear();
        before.ways_m.extend(change.moved_nodes.iter().filter_map(|&n| Some((n, self.skin.way_m(n)?))));
        self.capsule.follow(&self.body, change, |triangle| self.skin.nodes_of(triangle));
        before.skin = self.skin.follow(&self.body, &triangles).map(Box::new);
        let display = DisplayChange {
            nodes_added: &change.surface_nodes_added,
            nodes_removed: &change.surface_nodes_removed,
            triangles,
        };
        self.display.follow(self.body.topology(), &self.capsule, &display);
        self.topology_version += 1;
    }

    /// Whether each new node is held: where all its parents are, as in the models. One beside a held node moves.
    fn held_of_new(&self, change: &TopologyChange) -> Vec<bool> {
        let n_before = change.nodes.n_before;
        let mut held: Vec<bool> = Vec::new();
        for (_, parents) in change.nodes.added.iter() {
            let is_held = |parent: NodeId| match parent.index().checked_sub(n_before) {
                None => self.fixed[parent],
                Some(new) => held.get(new).copied().unwrap_or(false),
            };
            let all = !parents.is_empty() && parents.iter().all(|&(parent, _)| is_held(parent));
            held.push(all);
        }
        held
    }

    /// Undoes the last edit.
    pub(super) fn undo_edit(&mut self, undo: &MeshUndo, change: &TopologyChange, before: &mut OrganBefore) {
        self.body.undo(undo);
        put_back(&mut self.fixed, change, before.fixed.iter().copied());
        put_back(&mut self.node_answers_per_m, change, before.node_answers_per_m.iter().copied());
        self.body_of.truncate(change.nodes.n_before);
        let triangles = SurfaceChange {
            added: &change.surface_triangles_added,
            removed: &change.surface_triangles_removed,
        };
        match before.skin.take() {
            Some(skin) => self.skin = *skin,
            None => self.skin.unfollow(&self.body, &triangles),
        }
        for &(node, way_m) in &before.ways_m {
            self.skin.place(node, way_m);
        }
        let back = DisplayChange {
            nodes_added: &change.surface_nodes_removed,
            nodes_removed: &change.surface_nodes_added,
            triangles: SurfaceChange { added: triangles.removed, removed: triangles.added },
        };
        self.display.follow(self.body.topology(), &self.capsule, &back);
        self.topology_version += 1;
    }

    /// The edit that was just undone is not to be seen.
    pub(super) fn forget_edit(&mut self, before: &OrganBefore) {
        self.topology_version = before.topology_version;
    }

    /// Puts the nodes that an edit brought in or moved where the model has them.
    pub(super) fn place_nodes(&mut self, change: &TopologyChange, positions_m: &[DVec3]) {
        for &node in change.nodes.added.ids().iter().chain(&change.moved_nodes) {
            if let Some(&position_m) = positions_m.get(node.index()) {
                self.skin.place(node, [position_m; 2]);
            }
        }
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

    /// The body of each node, by its number; all 0 of one organ.
    pub fn body_of_nodes(&self) -> &[u32] {
        &self.body_of
    }

    /// g E* [1/m] of a node of the surface, where it is known ([`super::node_answer`]).
    pub(super) fn node_answer_per_m(&self, node: NodeId) -> Option<f64> {
        self.node_answers_per_m.as_slice().get(node.index()).copied().filter(|answer| *answer > 0.0)
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
        self.display.nodes()
    }

    /// Changes whenever the surface's triangles change.
    pub fn topology_version(&self) -> u32 {
        self.topology_version
    }

    /// The surface for contact queries.
    pub(super) fn skin(&self) -> &Skin {
        &self.skin
    }

    /// Brings the surface's search up to date after edits. Allocates nothing.
    pub(super) fn refresh(&mut self) {
        self.skin.refresh();
    }

    /// Positions of all nodes now [m]; the list may be longer.
    pub(super) fn positions_m(&self) -> &[DVec3] {
        self.skin.positions_m()
    }

    /// Outward unit normal of a triangle now; zero for one without area.
    pub(super) fn face_normal(&self, nodes: [NodeId; 3]) -> DVec3 {
        let [a, b, c] = nodes.map(|n| self.positions_m()[n.index()]);
        (b - a).cross(c - a).normalize_or_zero()
    }

    /// Moves the surface to these node positions during a step. Allocates nothing.
    pub fn follow(&mut self, positions_m: &[DVec3]) {
        self.skin.move_to(positions_m);
    }

    /// Puts the surface at these node positions without a motion. Allocates nothing.
    pub fn rest_at(&mut self, positions_m: &[DVec3]) {
        self.skin.rest_at(positions_m);
    }

    /// Whether a triangle of the surface lies in a cut and not in the organ's own skin.
    pub fn is_cut(&self, triangle: TriangleId) -> bool {
        self.capsule.is_cut(triangle)
    }

    /// The surface for a viewer: asked for when the version changed, not in steps.
    pub fn display_topology(&self) -> DisplayTopology {
        self.display.topology(self.topology_version, &self.body.mesh().positions_m, &self.body_of)
    }
}
