//! Opens the faces of a cut: every node gets as many copies as its tetrahedra form groups.

use super::patch::{Body, Patch, sorted};
use crate::mesh::NodeId;
use crate::mesh::edit::{CavityNode, MovedNode, NewNode, NewTet, Replacement};
use crate::mesh::quality::FACES;

/// Where an edge is divided so that its faces open.
const SHARES: [f64; 3] = [0.5, 0.35, 0.65];

/// What opened.
#[derive(Clone, Debug, Default)]
pub(super) struct Opened {
    /// Area [m2] of the faces that came apart, one side, in the present shape.
    pub(super) area_m2: f64,
    /// Faces that stay closed for now, because all of their nodes are on the rim of the cut.
    pub(super) closed: Vec<[u32; 3]>,
    /// Nodes of the faces at the front, of both sides.
    pub(super) wake: Vec<u32>,
}

/// Divides faces of `patch.cut` that would stay closed for good, so that they get a node that opens. `stays`: what
/// may still open with a later step. `alone_m2`: faces of a larger area [m2] open alone if need be. Only where no dihedral angle at rest gets a cosine above the first of
/// `max_cosines`, or else the second. Returns the area [m2] that stays closed nevertheless.
pub(super) fn divide_closed(
    patch: &mut Patch,
    body: Body<'_>,
    alone_m2: f64,
    stays: impl Fn([u32; 3]) -> bool,
    max_cosines: [f64; 2],
) -> f64 {
    pull_stars(patch, body);
    let mut groups = Groups::of(patch);
    let (mut starts, mut stars) = (std::mem::take(&mut patch.parting), std::mem::take(&mut patch.parted));
    starts.clear();
    stars.clear();
    for node in nodes_of_cut(patch) {
        if groups.find(patch, node) > 1 {
            starts.push((node, stars.len()));
            stars.extend(groups.star.iter().copied().zip(groups.group.iter().copied()));
        }
    }
    let group_at = |node: usize, tet: u32| {
        let end = starts.get(node + 1).map_or(stars.len(), |s| s.1);
        let star = &stars[starts[node].1..end];
        star.binary_search_by_key(&tet, |s| s.0).map(|at| star[at].1)
    };
    let is_open = |face: [u32; 3]| {
        let [Some(above), Some(below)] = patch.pair_at_face(face) else { return true };
        face.into_iter().any(|n| {
            let node = starts.binary_search_by_key(&n, |s| s.0);
            node.is_ok_and(|node| group_at(node, above) != group_at(node, below))
        })
    };
    let is_closed = |face: &[u32; 3]| !stays(*face) && !is_open(*face);
    let closed: Vec<[u32; 3]> = patch.cut.iter().copied().filter(is_closed).collect();
    let (mut closed_m2, n_nodes) = (0.0, patch.nodes.len());
    for face in closed {
        // An earlier face may have divided it.
        if patch.cut.binary_search(&face).is_err() {
            continue;
        }
        let area_m2 = patch.face_area_m2(face);
        let mut is_divided = max_cosines.into_iter().any(|max_cosine| divide(patch, body, face, max_cosine));
        if !is_divided && area_m2 > alone_m2 {
            // It opens alone, and the surface meets itself along its edges; else it would stay closed for good.
            is_divided =
                patch.cosine_of_thirds(body, face) <= max_cosines[1] && patch.split_face(face).is_some();
        }
        if !is_divided {
            closed_m2 += area_m2;
        }
        patch.cut.sort_unstable();
    }
    (patch.parting, patch.parted) = (starts, stars);
    patch.is_parting_known = patch.nodes.len() == n_nodes;
    closed_m2
}

/// Puts a node on an edge of a face of the cut that it shares with others of the cut, so that they open together.
fn divide(patch: &mut Patch, body: Body<'_>, [a, b, c]: [u32; 3], max_cosine: f64) -> bool {
    let is_inner =
        |edge: &[u32; 2]| patch.cut.iter().filter(|f| edge.iter().all(|n| f.contains(n))).count() > 1;
    let mut edges = [[a, b], [b, c], [a, c]];
    edges.sort_by(|p, q| patch.length_m(*q).total_cmp(&patch.length_m(*p)));
    let inner: Vec<[u32; 2]> = edges.into_iter().filter(is_inner).collect();
    SHARES.into_iter().any(|share| {
        inner.iter().any(|&edge| {
            patch.cosine_of_parts(body, edge, share) <= max_cosine
                && patch.split_edge(body, edge, share).is_some()
        })
    })
}

fn nodes_of_cut(patch: &Patch) -> Vec<u32> {
    let mut nodes: Vec<u32> = patch.cut.iter().flatten().copied().collect();
    nodes.sort_unstable();
    nodes.dedup();
    nodes
}

fn pull_stars(patch: &mut Patch, body: Body<'_>) {
    for node in nodes_of_cut(patch) {
        patch.pull_star(body, node);
    }
}

/// Opens `patch.cut`. At the rim of a cut the tetrahedra still hang together around the node, which stays one.
pub(super) fn open(patch: &mut Patch, body: Body<'_>, is_front: impl Fn(u32) -> bool) -> Opened {
    pull_stars(patch, body);
    let nodes = nodes_of_cut(patch);
    let mut sides: Vec<([u32; 3], [Option<u32>; 2])> = Vec::with_capacity(patch.cut.len());
    // Both sides of what opens belong to the edit, also where only one gets copies.
    for at in 0..patch.cut.len() {
        let face = patch.cut[at];
        let tets = patch.pair_at_face(face);
        for tet in tets.into_iter().flatten() {
            patch.tets[tet as usize].is_old = false;
        }
        sides.push((face, tets));
    }
    // Copies of other nodes change nothing around a node: only faces of the cut come apart.
    let is_known = std::mem::take(&mut patch.is_parting_known);
    let mut groups = if is_known { Groups::default() } else { Groups::of(patch) };
    let mut origin: Vec<u32> = (0..patch.nodes.len() as u32).collect();
    let (starts, stars) = (std::mem::take(&mut patch.parting), std::mem::take(&mut patch.parted));
    for &node in &nodes {
        let n_groups = if is_known {
            let Ok(at) = starts.binary_search_by_key(&node, |s| s.0) else { continue };
            let end = starts.get(at + 1).map_or(stars.len(), |s| s.1);
            groups.set(&stars[starts[at].1..end])
        } else {
            groups.find(patch, node)
        };
        if n_groups < 2 {
            continue;
        }
        let mut copies = vec![node; n_groups];
        for copy in copies.iter_mut().skip(1) {
            *copy = patch.push_copy(node);
            origin.push(origin[node as usize]);
        }
        for at in 0..groups.star.len() {
            let (tet, group) = (groups.star[at], groups.group[at] as usize);
            if group > 0 {
                patch.swap_node(tet, node, copies[group]);
            }
        }
    }
    (patch.parting, patch.parted) = (starts, stars);
    what_opened(patch, &sides, &origin, is_front)
}

/// What came of the faces of the cut: those whose two sides still share all nodes stay closed, the others count as area.
/// `origin` is the node that each one is a copy of.
fn what_opened(
    patch: &Patch,
    sides: &[([u32; 3], [Option<u32>; 2])],
    origin: &[u32],
    is_front: impl Fn(u32) -> bool,
) -> Opened {
    let mut opened = Opened::default();
    for &(face, tets) in sides {
        let [Some(a), Some(b)] = tets else { continue };
        if face.into_iter().any(&is_front) {
            for tet in [a, b] {
                let nodes = patch.tets[tet as usize].nodes.into_iter();
                opened.wake.extend(nodes.filter(|&n| face.contains(&origin[n as usize])));
            }
        }
        let [a, b] = [a, b].map(|t| patch.tets[t as usize].nodes);
        let mut common = a.into_iter().filter(|n| b.contains(n));
        match [common.next(), common.next(), common.next()] {
            [Some(a), Some(b), Some(c)] => opened.closed.push([a, b, c]),
            _ => opened.area_m2 += patch.face_area_m2(face),
        }
    }
    opened.wake.sort_unstable();
    opened.wake.dedup();
    opened
}

/// The tetrahedra at a node, grouped.
#[derive(Default)]
struct Groups {
    /// For each tetrahedron, the one beyond the face opposite each corner; [`NONE`] at the surface, across a face of the cut, and
    /// for faces without a node of the cut.
    across: Vec<[u32; 4]>,
    star: Vec<u32>,
    /// Group of each; 0 is the one that keeps the node.
    group: Vec<u32>,
    /// The place in `star` of each tetrahedron of it.
    places: Vec<u32>,
    /// The number of the group of each root.
    numbers: Vec<u32>,
}

/// No tetrahedron.
const NONE: u32 = u32::MAX;

impl Groups {
    /// For the nodes of the cut, whose stars are in the patch.
    fn of(patch: &Patch) -> Self {
        let mut is_at_cut = vec![false; patch.nodes.len()];
        for &node in patch.cut.iter().flatten() {
            is_at_cut[node as usize] = true;
        }
        let at_cut = |tet: u32| patch.tets[tet as usize].nodes.map(|n| is_at_cut[n as usize]);
        let tets: Vec<u32> = patch.live_tets().filter(|&tet| at_cut(tet).contains(&true)).collect();
        let mut across = vec![[NONE; 4]; patch.tets.len()];
        let mut faces = FaceTable::with_room_for(FACES.len() * tets.len());
        for tet in tets {
            let (nodes, is_at_cut) = (patch.tets[tet as usize].nodes, at_cut(tet));
            for (at, face) in FACES.iter().enumerate() {
                let n_at_cut = face.iter().filter(|&&i| is_at_cut[i]).count();
                if n_at_cut == 0 {
                    continue;
                }
                let face = sorted(face.map(|i| nodes[i]));
                let Some([other, there]) = faces.meet(face, [tet, at as u32]) else { continue };
                if n_at_cut < 3 || patch.cut.binary_search(&face).is_err() {
                    across[tet as usize][at] = other;
                    across[other as usize][there as usize] = tet;
                }
            }
        }
        Self { across, places: vec![0; patch.tets.len()], ..Self::default() }
    }

    /// Groups the star of `node` through the faces at it that are not cut; returns how many there are.
    fn find(&mut self, patch: &Patch, node: u32) -> usize {
        self.star.clear();
        self.star.extend_from_slice(patch.star(node));
        self.star.sort_unstable();
        self.group.clear();
        self.group.extend(0..self.star.len() as u32);
        for (at, &tet) in self.star.iter().enumerate() {
            self.places[tet as usize] = at as u32;
        }
        for at in 0..self.star.len() {
            let tet = self.star[at];
            for (&other, corner) in self.across[tet as usize].iter().zip(patch.tets[tet as usize].nodes) {
                // Each face once; the one opposite the node is not at it.
                if other < tet && corner != node {
                    let (a, b) = (
                        root(&mut self.group, at as u32),
                        root(&mut self.group, self.places[other as usize]),
                    );
                    self.group[a.max(b) as usize] = a.min(b);
                }
            }
        }
        // The group of the first tetrahedron keeps the node; the others are numbered as they come. Roots come first.
        self.numbers.clear();
        self.numbers.resize(self.star.len(), 0);
        let mut n_groups = 0;
        for at in 0..self.star.len() {
            let first = root(&mut self.group, at as u32) as usize;
            if first == at {
                self.numbers[at] = n_groups;
                n_groups += 1;
            } else {
                self.numbers[at] = self.numbers[first];
            }
        }
        std::mem::swap(&mut self.group, &mut self.numbers);
        n_groups as usize
    }

    /// Takes a star and its groups as they are known; returns how many groups there are.
    fn set(&mut self, star: &[(u32, u32)]) -> usize {
        self.star.clear();
        self.star.extend(star.iter().map(|s| s.0));
        self.group.clear();
        self.group.extend(star.iter().map(|s| s.1));
        star.iter().map(|s| s.1 as usize + 1).max().unwrap_or(0)
    }
}

/// Which tetrahedron has a face already.
struct FaceTable {
    /// Each where its nodes hash to: the nodes, and the tetrahedron with the place of the face in it.
    places: Vec<([u32; 3], [u32; 2])>,
    n_bits: u32,
}

/// Nodes of no face.
const EMPTY: [u32; 3] = [u32::MAX; 3];

/// Spreads keys over a table (the golden ratio as a share of 2^64; Knuth, The Art of Computer Programming 3, s. 6.4).
const SPREAD: u64 = 0x9e37_79b9_7f4a_7c15;

impl FaceTable {
    /// At most half of it will be full.
    fn with_room_for(n_faces: usize) -> Self {
        let n_bits = (2 * n_faces).max(2).next_power_of_two().ilog2();
        Self { places: vec![(EMPTY, [NONE; 2]); 1 << n_bits], n_bits }
    }

    /// Who has the face with these nodes, ascending, already, or else `this` has it from now on.
    fn meet(&mut self, face: [u32; 3], this: [u32; 2]) -> Option<[u32; 2]> {
        let [a, b, c] = face.map(u64::from);
        let key = (a.wrapping_mul(SPREAD) ^ b).wrapping_mul(SPREAD) ^ c;
        let mut place = (key.wrapping_mul(SPREAD) >> (64 - self.n_bits)) as usize;
        loop {
            let (there, other) = self.places[place];
            if there == face {
                return Some(other);
            }
            if there == EMPTY {
                self.places[place] = (face, this);
                return None;
            }
            place = (place + 1) & ((1 << self.n_bits) - 1);
        }
    }
}

fn root(parents: &mut [u32], mut of: u32) -> u32 {
    while parents[of as usize] != of {
        parents[of as usize] = parents[parents[of as usize] as usize];
        of = parents[of as usize];
    }
    of
}

/// The patch as one edit, and the node of the edited mesh that each of its nodes is (`None`: unused).
pub(super) fn replacement(patch: &Patch, n_nodes: usize) -> (Replacement, Vec<Option<NodeId>>) {
    let mut edit = Replacement { tets: patch.replaced_tets().collect(), ..Replacement::default() };
    let mut ids = Vec::with_capacity(patch.nodes.len());
    let mut corner = vec![CavityNode::New(u32::MAX); patch.nodes.len()];
    for (at, node) in patch.nodes.iter().enumerate() {
        ids.push(node.old);
        let is_used = !patch.star(at as u32).is_empty();
        let (position_m, blend) = (node.rest_m, patch.blend(at as u32));
        if let Some(old) = node.old {
            corner[at] = CavityNode::Old(old);
            if node.is_moved && is_used {
                edit.moved_nodes.push(MovedNode {
                    node: old,
                    position_m,
                    parents: blend.parents().collect(),
                });
            }
        } else if is_used {
            let new = edit.new_nodes.len();
            corner[at] = CavityNode::New(new as u32);
            ids[at] = Some(NodeId::from_index(n_nodes + new));
            edit.new_nodes.push(NewNode { position_m, parents: blend.parents().collect() });
        }
    }
    for tet in patch.tets.iter().filter(|t| t.is_live && !t.is_old) {
        edit.new_tets.push(NewTet {
            corners: tet.nodes.map(|n| corner[n as usize]),
            parents: if tet.is_mixed { Vec::new() } else { vec![(tet.parent, 1.0)] },
        });
    }
    (edit, ids)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::{DVec3, SeededRandom};
    use crate::mesh::box_mesh::box_of_five;
    use crate::mesh::edit::EditableMesh;

    /// The group of each tetrahedron around a node, ascending: those that one comes to through faces that are not cut.
    fn by_spreading(patch: &Patch, node: u32) -> (Vec<u32>, Vec<u32>) {
        let mut star = patch.star(node).to_vec();
        star.sort_unstable();
        let mut first: Vec<usize> = (0..star.len()).collect();
        let nodes = |at: usize| patch.tets[star[at] as usize].nodes;
        let mut is_changed = true;
        while is_changed {
            is_changed = false;
            for (a, b) in (0..star.len()).flat_map(|a| (0..star.len()).map(move |b| (a, b))) {
                let common: Vec<u32> = nodes(a).into_iter().filter(|n| nodes(b).contains(n)).collect();
                let Ok(face) = <[u32; 3]>::try_from(common) else { continue };
                if !patch.cut.contains(&sorted(face)) && first[b] < first[a] {
                    first[a] = first[b];
                    is_changed = true;
                }
            }
        }
        let roots: Vec<usize> = (0..star.len()).filter(|&at| first[at] == at).collect();
        let groups = first.iter().map(|root| roots.binary_search(root).unwrap() as u32).collect();
        (star, groups)
    }

    #[test]
    fn what_hangs_together_around_a_node_is_a_group() {
        let mesh = EditableMesh::new(box_of_five([3; 3], DVec3::ONE)).unwrap();
        let present_m = mesh.mesh().positions_m.clone();
        let body = Body { mesh: &mesh, present_m: &present_m };
        let mut random = SeededRandom::new(5);
        let mut n_of_groups = [0; 8];
        for share in [0.1, 0.3, 0.5, 0.8] {
            let mut patch = Patch::default();
            patch.start(&mesh);
            mesh.topology().live_tets().for_each(|tet| _ = patch.pull_tet(body, tet));
            let faces = |tet: u32| FACES.map(|face| sorted(face.map(|i| patch.tets[tet as usize].nodes[i])));
            let mut inner: Vec<[u32; 3]> = patch.live_tets().flat_map(faces).collect();
            inner.sort_unstable();
            let inner = inner.chunk_by(|a, b| a == b).filter(|same| same.len() == 2).map(|same| same[0]);
            patch.cut = inner.filter(|_| random.uniform() < share).collect();
            pull_stars(&mut patch, body);
            let mut groups = Groups::of(&patch);
            for node in nodes_of_cut(&patch) {
                let n_groups = groups.find(&patch, node);
                assert_eq!((groups.star.clone(), groups.group.clone()), by_spreading(&patch, node));
                n_of_groups[n_groups.min(7)] += 1;
            }
        }
        assert!(n_of_groups[1..].iter().all(|&n| n > 0) && n_of_groups[0] == 0, "{n_of_groups:?}");
    }
}
