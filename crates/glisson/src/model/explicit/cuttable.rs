//! How models of removable tetrahedra follow edits of the mesh.

use super::keep;
use crate::mesh::edit::TopologyChange;
use crate::mesh::{NodeId, TetMesh};
use crate::model::TopologyRefusal;
use crate::solve::MeshEdges;

/// A model that takes tetrahedra out.
pub(in crate::model) trait Cuttable {
    /// Scene name.
    const NAME: &'static str;

    fn tets(&self) -> &LiveTets;

    fn tets_mut(&mut self) -> &mut LiveTets;

    fn n_nodes(&self) -> usize;

    /// Takes one tetrahedron out, which is not live any more. Allocates nothing.
    fn remove_tet(&mut self, t: usize);

    /// What depends on all removals of an edit together.
    fn after_removals(&mut self);

    /// Drops dead entities; the order of the others stays. The tetrahedra themselves follow by themselves, afterwards.
    fn compact(&mut self, new_ids: &[Option<NodeId>]);
}

/// Follows removals, which allocate nothing, and compactions, which do.
///
/// # Errors
/// [`TopologyRefusal::Frozen`] for new or moved nodes and new tetrahedra.
pub(in crate::model) fn follow<M: Cuttable>(
    model: &mut M,
    change: &TopologyChange,
) -> Result<(), TopologyRefusal> {
    follows(M::NAME, change)?;
    assert_eq!(change.tets.n_before, model.tets().nodes.len(), "the model missed a change of the mesh");
    assert_eq!(change.nodes.n_before, model.n_nodes(), "the model missed a change of the mesh");
    let mut is_cut = false;
    for t in change.tets.removed.iter().map(|tet| tet.index()) {
        if std::mem::take(&mut model.tets_mut().is_live[t]) {
            model.remove_tet(t);
            is_cut = true;
        }
    }
    if is_cut {
        model.after_removals();
    }
    if change.is_renumbering() {
        model.compact(&change.nodes.new_ids);
        model.tets_mut().compact(&change.nodes.new_ids);
    }
    Ok(())
}

/// Whether a change is one that models with accumulated stiffness follow: removals and compactions.
///
/// # Errors
/// [`TopologyRefusal::Frozen`] for new or moved nodes and new tetrahedra.
pub(in crate::model) fn follows(model: &'static str, change: &TopologyChange) -> Result<(), TopologyRefusal> {
    if change.tets.added.ids().is_empty()
        && change.nodes.added.ids().is_empty()
        && change.moved_nodes.is_empty()
    {
        return Ok(());
    }
    Err(TopologyRefusal::Frozen {
        model,
        reason: "it follows removals of tetrahedra and compactions; build it anew on a mesh with new or moved \
                 nodes",
    })
}

/// The tetrahedra of a model, and which of them are still there.
#[derive(Clone, Debug)]
pub(in crate::model) struct LiveTets {
    pub(in crate::model) nodes: Vec<[NodeId; 4]>,
    pub(in crate::model) is_live: Vec<bool>,
}

impl LiveTets {
    pub(in crate::model) fn of_mesh(mesh: &TetMesh) -> Self {
        Self { nodes: mesh.tetrahedra.clone(), is_live: vec![true; mesh.tetrahedra.len()] }
    }

    /// Live tetrahedra with their nodes.
    pub(in crate::model) fn iter(&self) -> impl Iterator<Item = (usize, &[NodeId; 4])> {
        self.nodes.iter().enumerate().filter(|(t, _)| self.is_live[*t])
    }

    fn compact(&mut self, new_ids: &[Option<NodeId>]) {
        keep(&mut self.nodes, &self.is_live);
        for node in self.nodes.iter_mut().flatten() {
            *node = new_ids[node.index()].expect("what is live has live nodes");
        }
        self.is_live.clear();
        self.is_live.resize(self.nodes.len(), true);
    }
}

/// The edges of a model, and how many of its tetrahedra are at each.
#[derive(Clone, Debug)]
pub(in crate::model) struct LiveEdges {
    pub(in crate::model) edges: MeshEdges,
    /// Live tetrahedra at each edge.
    pub(in crate::model) tets: Vec<u32>,
}

impl LiveEdges {
    pub(in crate::model) fn new(edges: MeshEdges) -> Self {
        let mut tets = vec![0; edges.nodes.len()];
        for &edge in edges.of_tet.iter().flatten() {
            tets[edge as usize] += 1;
        }
        Self { edges, tets }
    }

    /// Whether an edge has a tetrahedron, for each edge.
    pub(in crate::model) fn is_live(&self) -> Vec<bool> {
        self.tets.iter().map(|&n| n > 0).collect()
    }

    /// Takes a tetrahedron from one of its edges; whether it was not the last.
    pub(in crate::model) fn take_tet(&mut self, edge: usize) -> bool {
        self.tets[edge] -= 1;
        self.tets[edge] > 0
    }

    /// Drops edges without a tetrahedron and tetrahedra that do not live; the order of the others stays. Which edges
    /// stayed.
    pub(in crate::model) fn compact(&mut self, new_ids: &[Option<NodeId>], live_tets: &[bool]) -> Vec<bool> {
        let stays = self.is_live();
        let new_edge = renumbered(&stays);
        keep(&mut self.edges.nodes, &stays);
        for node in self.edges.nodes.iter_mut().flatten() {
            *node = new_ids[node.index()].expect("what is live has live nodes");
        }
        keep(&mut self.tets, &stays);
        keep(&mut self.edges.of_tet, live_tets);
        for edge in self.edges.of_tet.iter_mut().flatten() {
            *edge = new_edge[*edge as usize];
        }
        stays
    }
}

/// The new number of each entity that stays, when those that do not are dropped; any number for these.
pub(in crate::model) fn renumbered(stays: &[bool]) -> Vec<u32> {
    let mut n_kept = 0;
    let new_number = |&stays: &bool| {
        n_kept += u32::from(stays);
        n_kept.wrapping_sub(1)
    };
    stays.iter().map(new_number).collect()
}
