//! How models of removable tetrahedra follow edits of the mesh.

use super::keep;
use crate::model::TopologyRefusal;
use crate::model::topology_update::TopologyUpdate;
use crate::solve::{LOCAL_EDGES, MeshEdges, P1Gradients};
use glisson_mesh::math::DVec3;
use glisson_mesh::mesh::edit::{EntityChange, TopologyChange};
use glisson_mesh::mesh::{NodeId, TetId, TetMesh};

/// A model that takes tetrahedra out and adds them.
pub(in crate::model) trait Cuttable {
    /// Scene name.
    const NAME: &'static str;

    fn tets(&self) -> &LiveTets;

    fn tets_mut(&mut self) -> &mut LiveTets;

    /// Places of the nodes at rest [m].
    fn rest_m(&self) -> &[DVec3];

    /// Takes one tetrahedron out, which is not live any more. Allocates nothing.
    fn remove_tet(&mut self, t: usize);

    /// What depends on all removals of an edit together.
    fn after_removals(&mut self);

    /// Makes room for what an edit brings in, and puts new and moved nodes in their places. The tetrahedra know all
    /// corners; new and reshaped ones are in no sum yet.
    fn grow(&mut self, mesh: &TetMesh, change: &TopologyChange, growth: &TopologyUpdate);

    /// Adds a tetrahedron up, new or taken out before.
    fn add_tet(&mut self, t: usize);

    /// What depends on a whole edit that added or moved something.
    fn after_growth(&mut self);

    /// Drops dead entities; the order of the others stays. The tetrahedra themselves follow by themselves, afterwards.
    fn compact(&mut self, new_ids: &[Option<NodeId>]);
}

/// Follows all edits. Removals allocate nothing.
///
/// # Errors
/// [`TopologyRefusal`]: the change of another mesh, and those of [`TopologyUpdate::of`]; nothing changed then.
pub(in crate::model) fn follow<M: Cuttable>(
    model: &mut M,
    mesh: &TetMesh,
    change: &TopologyChange,
) -> Result<(), TopologyRefusal> {
    TopologyRefusal::of_other_mesh(M::NAME, change, [model.tets().nodes.len(), model.rest_m().len()])?;
    let growth = TopologyUpdate::of(M::NAME, mesh, change, model.rest_m(), model.tets().iter())?;
    let mut is_cut = false;
    for t in change.tets.removed.iter().map(|tet| tet.index()) {
        if model.tets().is_live.get(t) == Some(&true) {
            model.tets_mut().is_live[t] = false;
            model.remove_tet(t);
            is_cut = true;
        }
    }
    if let Some(growth) = growth {
        for t in growth.reshaped.iter().map(|tet| tet.index()) {
            model.tets_mut().is_live[t] = false;
            model.remove_tet(t);
        }
        model.tets_mut().grow(mesh, &change.tets);
        model.grow(mesh, change, &growth);
        for t in growth.attached().map(TetId::index) {
            model.tets_mut().is_live[t] = true;
            model.add_tet(t);
        }
        model.after_growth();
    } else if is_cut {
        model.after_removals();
    }
    if change.is_renumbering() {
        model.compact(&change.nodes.new_ids);
        model.tets_mut().compact(&change.nodes.new_ids);
    }
    Ok(())
}

/// The tetrahedra of a model, and which of them are still there.
#[derive(Clone, Debug)]
pub(in crate::model) struct LiveTets {
    pub(in crate::model) nodes: Vec<[NodeId; 4]>,
    pub(in crate::model) is_live: Vec<bool>,
    /// How much of each is material ([`TetMesh::shares`]).
    pub(in crate::model) shares: Vec<f64>,
}

impl LiveTets {
    pub(in crate::model) fn of_mesh(mesh: &TetMesh) -> Self {
        Self {
            nodes: mesh.tetrahedra.clone(),
            is_live: vec![true; mesh.tetrahedra.len()],
            shares: mesh.shares.clone(),
        }
    }

    /// Room for what comes in, which does not live yet.
    fn grow(&mut self, mesh: &TetMesh, change: &EntityChange<TetId>) {
        self.nodes.extend_from_slice(&mesh.tetrahedra[change.n_before..change.n_after]);
        self.is_live.resize(change.n_after, false);
        if !mesh.shares.is_empty() {
            self.shares.resize(change.n_before, 1.0);
            self.shares.extend_from_slice(&mesh.shares[change.n_before..change.n_after]);
        }
    }

    /// How much of a tetrahedron is material.
    pub(in crate::model) fn share(&self, t: usize) -> f64 {
        self.shares.get(t).copied().unwrap_or(1.0)
    }

    /// Gradients of a tetrahedron, with the volume of its material. `rest_m`: all nodes at rest.
    pub(in crate::model) fn gradients(&self, t: usize, rest_m: &[DVec3]) -> P1Gradients {
        let whole = P1Gradients::new(self.nodes[t].map(|n| rest_m[n.index()]));
        P1Gradients { volume_m3: whole.volume_m3 * self.share(t), ..whole }
    }

    /// Live tetrahedra with their nodes.
    pub(in crate::model) fn iter(&self) -> impl Iterator<Item = (usize, &[NodeId; 4])> {
        self.nodes.iter().enumerate().filter(|(t, _)| self.is_live[*t])
    }

    fn compact(&mut self, new_ids: &[Option<NodeId>]) {
        keep(&mut self.nodes, &self.is_live);
        if !self.shares.is_empty() {
            keep(&mut self.shares, &self.is_live);
        }
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

    /// Adds the edges of tetrahedra that are not counted yet, and room for all of `tets`. Where new edges come into the
    /// lists by edge.
    pub(in crate::model) fn grow(&mut self, tets: &LiveTets, added: &[TetId]) -> Insertions {
        let ends = |tet: &TetId| {
            let nodes = tets.nodes[tet.index()];
            LOCAL_EDGES.map(|[j, k]| [nodes[j].min(nodes[k]), nodes[j].max(nodes[k])])
        };
        let insertions = Insertions::into(&mut self.edges.nodes, added.iter().flat_map(ends).collect());
        insertions.spread(&mut self.tets, 0);
        insertions.renumber(self.edges.of_tet.as_flattened_mut());
        self.edges.of_tet.resize(tets.nodes.len(), [0; 6]);
        for tet in added {
            self.edges.of_tet[tet.index()] = ends(tet).map(|key| place_of(&self.edges.nodes, &key));
        }
        insertions
    }

    /// Counts a tetrahedron at its edges.
    pub(in crate::model) fn add_tet(&mut self, t: usize) {
        for edge in self.edges.of_tet[t] {
            self.tets[edge as usize] += 1;
        }
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

/// Where new entries come into an ascending list, and into all lists that go with it.
pub(in crate::model) struct Insertions {
    /// Old place before which each comes; ascending.
    at: Vec<u32>,
    n_before: usize,
}

impl Insertions {
    /// Adds those of `keys` to an ascending list that are not in it.
    pub(in crate::model) fn into<K: Copy + Ord>(list: &mut Vec<K>, mut keys: Vec<K>) -> Self {
        keys.retain(|key| list.binary_search(key).is_err());
        keys.sort_unstable();
        keys.dedup();
        let place = |key: &K| list.partition_point(|other| other < key) as u32;
        let insertions = Self { at: keys.iter().map(place).collect(), n_before: list.len() };
        if let Some(&filler) = keys.first() {
            insertions.spread(list, filler);
            for (i, key) in keys.into_iter().enumerate() {
                list[insertions.at[i] as usize + i] = key;
            }
        }
        insertions
    }

    /// The same in a list that goes with it: `filler` for each new entry.
    pub(in crate::model) fn spread<T: Copy>(&self, values: &mut Vec<T>, filler: T) {
        let mut end = values.len();
        debug_assert_eq!(end, self.n_before);
        values.resize(end + self.at.len(), filler);
        for (i, at) in self.at.iter().enumerate().rev() {
            let at = *at as usize;
            values.copy_within(at..end, at + i + 1);
            values[at + i] = filler;
            end = at;
        }
    }

    /// Makes places in the old list places in the new one.
    pub(in crate::model) fn renumber(&self, places: &mut [u32]) {
        if self.at.is_empty() {
            return;
        }
        let mut n_new = 0;
        let new: Vec<u32> = (0..self.n_before as u32)
            .map(|place| {
                while self.at.get(n_new).is_some_and(|at| *at <= place) {
                    n_new += 1;
                }
                place + n_new as u32
            })
            .collect();
        for place in places {
            *place = new[*place as usize];
        }
    }
}

/// Place of a key that is in an ascending list.
pub(in crate::model) fn place_of<K: Ord>(list: &[K], key: &K) -> u32 {
    list.binary_search(key).expect("it was added before") as u32
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn entries_come_to_their_places_and_the_old_ones_are_found_again() {
        let old = vec![10, 20, 30, 40];
        for keys in [vec![], vec![5], vec![45, 20, 45], vec![25, 26, 5, 10, 41, 24]] {
            let mut list = old.clone();
            let mut doubled: Vec<i32> = old.iter().map(|k| 2 * k).collect();
            let insertions = Insertions::into(&mut list, keys.clone());
            insertions.spread(&mut doubled, -1);
            assert!(list.is_sorted() && keys.iter().all(|k| list.contains(k)));
            assert_eq!(list.len(), doubled.len());
            let mut places = [0, 1, 2, 3];
            insertions.renumber(&mut places);
            for (place, key) in places.into_iter().zip(&old) {
                assert_eq!((list[place as usize], doubled[place as usize]), (*key, 2 * key));
            }
            let n_fillers = doubled.iter().filter(|v| **v == -1).count();
            assert_eq!(n_fillers, list.len() - old.len());
        }
    }
}
