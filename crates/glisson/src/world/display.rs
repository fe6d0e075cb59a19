//! The surface as a viewer is told it, kept up to date edit by edit: only what changed is worked on.

use super::capsule::Capsule;
use super::skin::{LEAST_SPARE, SurfaceChange, spare_beside};
use crate::math::DVec3;
use crate::mesh::topology::Topology;
use crate::mesh::{NodeId, TriangleId};
use crate::record::snapshot::DisplayTopology;

/// Nodes of the surface, which are the vertices of its triangles.
#[derive(Clone, Debug)]
pub(super) struct DisplaySurface {
    /// Ascending.
    nodes: Vec<NodeId>,
    /// Ascending.
    ids: Vec<TriangleId>,
    /// Places in `nodes`, the lowest first, counter-clockwise from outside.
    triangles: Vec<[u32; 3]>,
    is_cut: Vec<bool>,
    /// Where in the lists something goes or comes.
    places: Vec<usize>,
}

/// Nodes and triangles that came to a surface, or left it.
pub(super) struct DisplayChange<'a> {
    pub(super) nodes_added: &'a [NodeId],
    pub(super) nodes_removed: &'a [NodeId],
    pub(super) triangles: SurfaceChange<'a>,
}

impl DisplaySurface {
    pub(super) fn new(topology: &Topology, capsule: &Capsule) -> Self {
        let (nodes, ids) = (topology.surface_nodes().collect::<Vec<_>>(), topology.surface_triangles());
        let ids: Vec<TriangleId> = ids.collect();
        let n_places = ids.len() + spare_beside(ids.len());
        let mut surface = Self {
            nodes: Vec::with_capacity(n_places),
            ids: Vec::with_capacity(n_places),
            triangles: Vec::with_capacity(n_places),
            is_cut: Vec::with_capacity(n_places),
            places: Vec::with_capacity(LEAST_SPARE),
        };
        let triangles = SurfaceChange { added: &ids, removed: &[] };
        surface.follow(
            topology,
            capsule,
            &DisplayChange { nodes_added: &nodes, nodes_removed: &[], triangles },
        );
        surface
    }

    /// Ascending.
    pub(super) fn nodes(&self) -> &[NodeId] {
        &self.nodes
    }

    /// Follows an edit, whose lists ascend. Allocates nothing as long as there is room.
    pub(super) fn follow(&mut self, topology: &Topology, capsule: &Capsule, change: &DisplayChange<'_>) {
        let SurfaceChange { added, removed } = change.triangles;
        let Self { nodes, ids, triangles, is_cut, places } = self;
        places.clear();
        places.extend(removed.iter().filter_map(|triangle| ids.binary_search(triangle).ok()));
        take_out(ids, places);
        take_out(triangles, places);
        take_out(is_cut, places);

        for node in change.nodes_removed {
            if let Ok(at) = nodes.binary_search(node) {
                nodes.remove(at);
                let at = at as u32;
                triangles.as_flattened_mut().iter_mut().for_each(|v| *v -= u32::from(*v > at));
            }
        }
        for node in change.nodes_added {
            if let Err(at) = nodes.binary_search(node) {
                nodes.insert(at, *node);
                // Nothing is above the last one.
                if at + 1 < nodes.len() {
                    let at = at as u32;
                    triangles.as_flattened_mut().iter_mut().for_each(|v| *v += u32::from(*v >= at));
                }
            }
        }

        places.clear();
        places.extend(added.iter().map(|triangle| ids.partition_point(|known| known < triangle)));
        let vertex_of = |node: NodeId| nodes.binary_search(&node).expect("it is on the surface") as u32;
        put_in(ids, places, TriangleId(0), |new| added[new]);
        let outward = |new: usize| topology.outward_nodes(added[new]).map(vertex_of);
        put_in(triangles, places, [0; 3], |new| from_lowest(outward(new)));
        put_in(is_cut, places, false, |new| capsule.is_cut(added[new]));
    }

    /// For a viewer; of all nodes the places at rest [m], and the bodies.
    pub(super) fn topology(&self, version: u32, rest_m: &[DVec3], body_of: &[u32]) -> DisplayTopology {
        DisplayTopology {
            version,
            nodes: self.nodes.clone(),
            rest_positions_m: self.nodes.iter().map(|n| rest_m[n.index()]).collect(),
            triangles: self.triangles.clone(),
            is_cut: self.is_cut.clone(),
            body_of: self.nodes.iter().map(|n| body_of[n.index()] as u8).collect(),
        }
    }
}

/// The same triangle from its lowest vertex on, so that it does not matter which edits led here.
fn from_lowest([a, b, c]: [u32; 3]) -> [u32; 3] {
    if a < b && a < c {
        [a, b, c]
    } else if b < c {
        [b, c, a]
    } else {
        [c, a, b]
    }
}

/// Takes what is at ascending places out of a list.
fn take_out<T: Copy>(list: &mut Vec<T>, places: &[usize]) {
    let Some(&(mut to)) = places.first() else { return };
    for (nth, place) in places.iter().enumerate() {
        let end = places.get(nth + 1).copied().unwrap_or(list.len());
        list.copy_within(place + 1..end, to);
        to += end - (place + 1);
    }
    list.truncate(to);
}

/// Puts the values of `new` into a list, each before what is at its place; places ascend. `blank`: any value.
fn put_in<T: Copy>(list: &mut Vec<T>, places: &[usize], blank: T, new: impl Fn(usize) -> T) {
    let mut end = list.len();
    list.resize(end + places.len(), blank);
    for (nth, &place) in places.iter().enumerate().rev() {
        list.copy_within(place..end, place + nth + 1);
        list[place + nth] = new(nth);
        end = place;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::SeededRandom;
    use crate::mesh::TetId;
    use crate::mesh::box_mesh::box_of_five;
    use crate::mesh::edit::{EdgeSplit, MeshEdit, MeshUndo, TopologyChange};
    use crate::world::organ::{Organ, OrganBefore};

    #[test]
    fn values_go_and_come_at_their_places() {
        let mut list = vec![0, 1, 2, 3, 4, 5];
        take_out(&mut list, &[0, 2, 3]);
        assert_eq!(list, [1, 4, 5]);
        put_in(&mut list, &[0, 0, 2, 3], 7, |new| [-1, 0, 4, 9][new]);
        assert_eq!(list, [-1, 0, 1, 4, 4, 5, 9]);
    }

    /// What a viewer is told of an organ, and what it would be told of one that was always so.
    fn check(organ: &Organ) {
        let shown = organ.display_topology();
        let topology = organ.body().topology();
        let nodes: Vec<NodeId> = topology.surface_nodes().collect();
        assert_eq!(shown.nodes, nodes);
        let triangles: Vec<[u32; 3]> = topology
            .surface_triangles()
            .map(|t| topology.outward_nodes(t).map(|n| nodes.binary_search(&n).unwrap() as u32))
            .collect();
        assert_eq!(shown.triangles.len(), triangles.len());
        for (found, [a, b, c]) in shown.triangles.iter().zip(triangles) {
            assert!([[a, b, c], [b, c, a], [c, a, b]].contains(found) && found[0] < found[1].min(found[2]));
        }
        let is_cut: Vec<bool> = topology.surface_triangles().map(|t| organ.is_cut(t)).collect();
        assert_eq!(shown.is_cut, is_cut);
    }

    #[test]
    fn edits_and_undo_leave_what_would_be_put_together_anew() {
        let mesh = box_of_five([3; 3], DVec3::ONE);
        let body_of = vec![0; mesh.positions_m.len()];
        let mut organ = Organ::new(mesh, &[], body_of).unwrap();
        let mut random = SeededRandom::new(3);
        check(&organ);
        for at in 0..120 {
            let live: Vec<TetId> = organ.body().topology().live_tets().collect();
            let n_gone = 1 + at % 4;
            let of = |random: &mut SeededRandom| live[(random.uniform() * live.len() as f64) as usize];
            let mut tets: Vec<TetId> = (0..n_gone).map(|_| of(&mut random)).collect();
            tets.sort_unstable();
            tets.dedup();
            let edit = if at % 3 == 2 {
                let [a, b, ..] = organ.body().topology().tet_nodes(tets[0]);
                let edge = organ.body().topology().edge_between(a, b).unwrap();
                MeshEdit::Split { edges: vec![EdgeSplit { edge, fraction: 0.4 }] }
            } else {
                MeshEdit::Remove { tets }
            };
            let (mut change, mut undo) = (TopologyChange::default(), MeshUndo::default());
            organ.body_mut().apply_saving(&edit, &mut change, &mut undo).unwrap();
            let (before, mut overwritten) = (organ.display_topology(), OrganBefore::default());
            organ.follow_edit(&change, &mut overwritten);
            check(&organ);
            if at % 5 == 0 {
                organ.undo_edit(&undo, &change, &mut overwritten);
                check(&organ);
                let after = organ.display_topology();
                assert_eq!((after.nodes, after.triangles), (before.nodes, before.triangles));
                assert_eq!(after.is_cut, before.is_cut);
            }
        }
    }
}
