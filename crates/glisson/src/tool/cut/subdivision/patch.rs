//! The tetrahedra that a cut changes, worked on beside the mesh until the cut is whole.

use super::blend::Blend;
use crate::math::{DVec3, is_inverted, tetrahedron_volume_m3};
use crate::mesh::edit::EditableMesh;
use crate::mesh::quality::{FACES, dihedral_cosine_range};
use crate::mesh::topology::TET_EDGES;
use crate::mesh::{NodeId, TetId};

/// A node or tetrahedron of the mesh that is not in the patch.
const ABSENT: u32 = u32::MAX;

/// The label of a node whose side has not been looked at.
pub(super) const UNKNOWN: i8 = 2;

/// The mesh and where its nodes are now.
#[derive(Clone, Copy)]
pub(super) struct Body<'a> {
    pub(super) mesh: &'a EditableMesh,
    pub(super) present_m: &'a [DVec3],
}

/// What gives the place of a node.
#[derive(Clone, Copy, Debug)]
enum MadeOf {
    /// A node of the mesh alone.
    Node(NodeId),
    /// A place in [`Patch::blends`].
    Blend(u32),
}

#[derive(Clone, Copy, Debug)]
pub(super) struct PatchNode {
    /// The node of the mesh that this is, unless it is new.
    pub(super) old: Option<NodeId>,
    pub(super) rest_m: DVec3,
    pub(super) present_m: DVec3,
    made_of: MadeOf,
    /// It is not where it was.
    pub(super) is_moved: bool,
    /// Signed distance [m] from the plane of the sweep at hand; not a number before it is asked for.
    pub(super) distance_m: f64,
    /// Its sign, or 0 for a node that counts as on the plane.
    pub(super) label: i8,
    /// The side of each line of the sweep, 0 for a node that counts as on it.
    pub(super) line_labels: [i8; 4],
    /// On the front of the stroke so far.
    pub(super) is_front: bool,
    /// Where the front meets the way of the blade's end.
    pub(super) is_front_end: bool,
    /// On a face at the front of the stroke so far.
    pub(super) is_wake: bool,
    /// All tetrahedra at the node are in the patch.
    has_whole_star: bool,
    /// [`Patch::n_changes`] when a tetrahedron at the node was last taken out.
    pub(super) changed_at: usize,
}

/// Where a new node comes in.
struct NewPlace {
    rest_m: DVec3,
    present_m: DVec3,
    blend: Blend,
    /// [`PatchNode::distance_m`].
    distance_m: f64,
}

#[derive(Clone, Copy, Debug)]
pub(super) struct PatchTet {
    pub(super) nodes: [u32; 4],
    /// The tetrahedron of the mesh that this one comes from.
    pub(super) parent: TetId,
    pub(super) is_live: bool,
    /// This is the parent itself.
    pub(super) is_old: bool,
    /// A node of it moved.
    pub(super) is_reshaped: bool,
    /// It took the place of others, too, and not of the parent alone. What nodes of the mesh took along when they moved does
    /// not count.
    pub(super) is_mixed: bool,
}

impl PatchTet {
    /// Whether it is new or has another shape.
    pub(super) fn is_changed(&self) -> bool {
        !self.is_old || self.is_reshaped
    }
}

/// Nodes and tetrahedra of the mesh by need, and what becomes of them.
#[derive(Clone, Debug, Default)]
pub(super) struct Patch {
    pub(super) nodes: Vec<PatchNode>,
    pub(super) tets: Vec<PatchTet>,
    /// Apart from the nodes, which are read much more often than these.
    blends: Vec<Blend>,
    /// How many tetrahedra were taken out.
    pub(super) n_changes: usize,
    /// Live tetrahedra at each node; longer than `nodes`, the rest to be used again.
    stars: Vec<Vec<u32>>,
    node_here: Vec<u32>,
    tet_here: Vec<u32>,
    pulled_nodes: Vec<NodeId>,
    pulled_tets: Vec<TetId>,
    /// Whether each node of the mesh has to stay; nodes beyond the end may move.
    pub(super) is_still: Vec<bool>,
    /// Whether all nodes have to, new ones as well.
    pub(super) all_stay: bool,
    /// Where the nodes of the mesh are ([`Sweep::outside_into`](super::sweep::Sweep::outside_into)).
    pub(super) outside: Vec<u8>,
    /// Faces to be opened, corners ascending.
    pub(super) cut: Vec<[u32; 3]>,
    /// Nodes of these faces where the blade is now, and whether its end is there.
    pub(super) front: Vec<(u32, bool)>,
    /// Around each node of the faces that gets copies, where its tetrahedra begin in `parted`.
    pub(super) parting: Vec<(u32, usize)>,
    /// Tetrahedra around the nodes of `parting`, ascending around each, and the copy of the node that each gets.
    pub(super) parted: Vec<(u32, u32)>,
    /// Whether the faces still are those that `parting` knows, for certain: none was divided.
    pub(super) is_parting_known: bool,
}

/// A moved node leaves the volume of its tetrahedra the same to this share: it stays on flat skin.
const SAME_VOLUME: f64 = 1e-11;

/// Skin is flat enough to slide along if the sum of its area vectors has this share of the area.
const FLAT_SKIN: f64 = 0.99;

/// A barycentric weight nearer to zero than this is zero.
const ON_FACE: f64 = 1e-9;

/// Least gain in the cosine of an angle that is worth a move.
const LEAST_GAIN: f64 = 1e-5;

/// How good the tetrahedra at a moved node have to be: largest cosine of their dihedral angles at rest.
#[derive(Clone, Copy, Debug)]
pub(super) enum Accept {
    /// No larger than this, or than before.
    UpTo(f64),
    /// Smaller than before.
    Better,
}

/// The tetrahedra at a node, at rest.
pub(super) struct StarState {
    volume_m3: f64,
    /// Cosine of their smallest dihedral angle, and whose it is.
    max_cosine: f64,
    worst: Option<u32>,
}

/// Barycentric weights of a point; no numbers for a flat tetrahedron.
pub(super) fn barycentric([a, b, c, d]: [DVec3; 4], p: DVec3) -> [f64; 4] {
    let whole = tetrahedron_volume_m3([a, b, c, d]);
    let parts = [[p, b, c, d], [a, p, c, d], [a, b, p, d], [a, b, c, p]];
    parts.map(|part| tetrahedron_volume_m3(part) / whole)
}

/// The three corners, ascending.
pub(super) fn sorted(mut face: [u32; 3]) -> [u32; 3] {
    face.sort_unstable();
    face
}

/// Two nodes as one number, whatever their order.
pub(super) fn pair_key(a: u32, b: u32) -> u64 {
    u64::from(a.min(b)) << 32 | u64::from(a.max(b))
}

impl Patch {
    /// Empties the patch for work on `mesh`.
    pub(super) fn start(&mut self, mesh: &EditableMesh) {
        for node in self.pulled_nodes.drain(..) {
            self.node_here[node.index()] = ABSENT;
        }
        for tet in self.pulled_tets.drain(..) {
            self.tet_here[tet.index()] = ABSENT;
        }
        self.node_here.resize(mesh.topology().n_nodes(), ABSENT);
        self.tet_here.resize(mesh.topology().n_tets(), ABSENT);
        self.nodes.clear();
        self.tets.clear();
        self.blends.clear();
        self.n_changes = 0;
        self.is_parting_known = false;
        self.cut.clear();
        self.front.clear();
    }

    /// Whether the tetrahedron of the mesh was in the patch, changed or not, when it had `n_before`.
    pub(super) fn had_tet(&self, tet: TetId, n_before: u32) -> bool {
        self.tet_here[tet.index()] < n_before
    }

    pub(super) fn node_here(&self, node: NodeId) -> Option<u32> {
        self.node_here.get(node.index()).copied().filter(|&n| n != ABSENT)
    }

    /// Whether a node has to stay.
    pub(super) fn is_still(&self, node: u32) -> bool {
        let old = self.nodes[node as usize].old;
        self.all_stay || old.is_some_and(|old| self.is_still.get(old.index()).copied().unwrap_or(false))
    }

    pub(super) fn star(&self, node: u32) -> &[u32] {
        &self.stars[node as usize]
    }

    fn push_node(&mut self, node: PatchNode) -> u32 {
        let here = self.nodes.len() as u32;
        self.nodes.push(node);
        match self.stars.get_mut(here as usize) {
            Some(star) => star.clear(),
            None => self.stars.push(Vec::with_capacity(32)),
        }
        here
    }

    fn push_blend(&mut self, blend: Blend) -> MadeOf {
        self.blends.push(blend);
        MadeOf::Blend(self.blends.len() as u32 - 1)
    }

    /// What a node is made of.
    pub(super) fn blend(&self, node: u32) -> Blend {
        match self.nodes[node as usize].made_of {
            MadeOf::Node(node) => Blend::of(node),
            MadeOf::Blend(at) => self.blends[at as usize],
        }
    }

    /// Puts a node between others of the plane of a sweep.
    fn push_new(&mut self, NewPlace { rest_m, present_m, blend, distance_m }: NewPlace) -> u32 {
        let made_of = self.push_blend(blend);
        self.push_node(PatchNode {
            old: None,
            rest_m,
            present_m,
            made_of,
            is_moved: false,
            distance_m,
            label: 0,
            line_labels: [UNKNOWN; 4],
            is_front: false,
            is_front_end: false,
            is_wake: false,
            has_whole_star: true,
            changed_at: 0,
        })
    }

    fn pull_node(&mut self, body: Body<'_>, node: NodeId) -> u32 {
        if let Some(here) = self.node_here(node) {
            return here;
        }
        let here = self.push_node(PatchNode {
            old: Some(node),
            rest_m: body.mesh.mesh().positions_m[node.index()],
            present_m: body.present_m[node.index()],
            made_of: MadeOf::Node(node),
            is_moved: false,
            distance_m: f64::NAN,
            label: UNKNOWN,
            line_labels: [UNKNOWN; 4],
            is_front: false,
            is_front_end: false,
            is_wake: false,
            has_whole_star: false,
            changed_at: 0,
        });
        self.node_here[node.index()] = here;
        self.pulled_nodes.push(node);
        here
    }

    /// Moves a node to another place of the present shape, with the tissue at rest in the same place of its
    /// tetrahedron. Refused (false) if a tetrahedron would turn inside out in either shape, or become worse
    /// than accepted, or if the outside of the body would change.
    pub(super) fn move_node(&mut self, body: Body<'_>, node: u32, to_m: DVec3, accept: Accept) -> bool {
        self.pull_star(body, node);
        let before = self.star_state(node);
        self.move_node_from(body, node, to_m, accept, &before)
    }

    /// [`Patch::move_node`] for a node with its whole star in the patch, which is `before` now.
    pub(super) fn move_node_from(
        &mut self,
        body: Body<'_>,
        node: u32,
        to_m: DVec3,
        accept: Accept,
        before: &StarState,
    ) -> bool {
        if self.is_still(node) {
            return false;
        }
        let from = self.nodes[node as usize];
        let star = std::mem::take(&mut self.stars[node as usize]);
        self.nodes[node as usize].present_m = to_m;
        let mut moved = None;
        // Cheap refusals first.
        if !star.iter().any(|&t| is_inverted(tetrahedron_volume_m3(self.present_m(t))))
            && let Some((blend, rest_m)) = self.locate(body, &star, to_m)
        {
            self.nodes[node as usize].rest_m = rest_m;
            if self.is_better_star(&star, accept, before) {
                moved = Some(blend);
            }
        }
        match moved {
            Some(blend) => {
                let made_of = self.push_blend(blend);
                let this = &mut self.nodes[node as usize];
                this.made_of = made_of;
                this.is_moved = true;
                this.has_whole_star = true;
                let is_new = this.old.is_none();
                for &tet in &star {
                    let tet = &mut self.tets[tet as usize];
                    tet.is_reshaped = true;
                    tet.is_mixed |= is_new;
                }
            }
            None => self.nodes[node as usize] = from,
        }
        self.stars[node as usize] = star;
        moved.is_some()
    }

    /// Whether the tetrahedra of a star, as they are at rest now, are acceptable after what they were `before`.
    fn is_better_star(&self, star: &[u32], accept: Accept, before: &StarState) -> bool {
        let is_shaped = |cosine: f64| match accept {
            Accept::UpTo(max_cosine) => cosine <= max_cosine.max(before.max_cosine),
            Accept::Better => cosine < before.max_cosine - LEAST_GAIN,
        };
        let cosine_of = |tet: u32| dihedral_cosine_range(self.rest_m(tet))[1];
        // The worst one is the likeliest to refuse.
        if before.worst.is_some_and(|tet| !is_shaped(cosine_of(tet))) {
            return false;
        }
        let mut volume_m3 = 0.0;
        for &tet in star {
            let rest_m = self.rest_m(tet);
            let tet_m3 = tetrahedron_volume_m3(rest_m);
            if is_inverted(tet_m3) || !is_shaped(dihedral_cosine_range(rest_m)[1]) {
                return false;
            }
            volume_m3 += tet_m3;
        }
        (volume_m3 - before.volume_m3).abs() <= SAME_VOLUME * before.volume_m3
    }

    /// Faces at a node, with its whole star in the patch, that belong to one tetrahedron: the surface of the body.
    /// Counter-clockwise from outside.
    pub(super) fn single_sides(&self, node: u32) -> Vec<[u32; 3]> {
        // The two other nodes, ascending, stand for the face: one number sorts faster than three.
        let mut faces: Vec<(u64, [u32; 3])> = Vec::with_capacity(3 * self.stars[node as usize].len());
        for &tet in &self.stars[node as usize] {
            let nodes = self.tets[tet as usize].nodes;
            for [i, j, k] in FACES {
                let face = [nodes[i], nodes[j], nodes[k]];
                if let Some(at) = face.iter().position(|&n| n == node) {
                    faces.push((pair_key(face[(at + 1) % 3], face[(at + 2) % 3]), face));
                }
            }
        }
        faces.sort_unstable_by_key(|face| face.0);
        faces.chunk_by(|p, q| p.0 == q.0).filter(|same| same.len() == 1).map(|same| same[0].1).collect()
    }

    /// Unit normal, in the present shape, of the surface of the body at a node with its whole star in the patch;
    /// `None` inside, and where the sides of an earlier cut meet.
    pub(super) fn skin_normal(&self, node: u32) -> Option<DVec3> {
        self.normal_of(&self.single_sides(node))
    }

    /// Unit normal of faces in the present shape; `None` if they are not flat together, or none.
    pub(super) fn normal_of(&self, faces: &[[u32; 3]]) -> Option<DVec3> {
        let mut sum = DVec3::ZERO;
        let mut length = 0.0;
        for face in faces {
            let [a, b, c] = face.map(|n| self.nodes[n as usize].present_m);
            let area = (b - a).cross(c - a);
            sum += area;
            length += area.length();
        }
        (sum.length() > FLAT_SKIN * length).then(|| sum.normalize_or_zero())
    }

    /// Where a point of the present shape within a star is at rest.
    fn locate(&self, body: Body<'_>, star: &[u32], to_m: DVec3) -> Option<(Blend, DVec3)> {
        let mut best: Option<(f64, [NodeId; 4], [f64; 4])> = None;
        let mut last = None;
        for &tet in star {
            let parent = self.tets[tet as usize].parent;
            // Parts of one tetrahedron tend to follow each other.
            if last.replace(parent) == Some(parent) {
                continue;
            }
            let corners = body.mesh.topology().tet_nodes(parent);
            let weights = barycentric(corners.map(|n| body.present_m[n.index()]), to_m);
            let least = weights.into_iter().fold(f64::INFINITY, f64::min);
            if best.is_none_or(|b| least > b.0) {
                best = Some((least, corners, weights));
            }
        }
        let (least, corners, mut weights) = best?;
        if least.is_nan() || least < -ON_FACE {
            return None;
        }
        // A point on a face takes nothing from beyond.
        for weight in &mut weights {
            if weight.abs() <= ON_FACE {
                *weight = 0.0;
            }
        }
        let sum: f64 = weights.iter().sum();
        let weights = weights.map(|w| w / sum);
        let rest_of = |n: NodeId| body.mesh.mesh().positions_m[n.index()];
        let rest_m = corners.iter().zip(weights).map(|(&n, w)| w * rest_of(n)).sum();
        Some((Blend::of_corners(corners, weights), rest_m))
    }

    /// What the star of a node is at rest.
    pub(super) fn star_state(&self, node: u32) -> StarState {
        let mut state = StarState { volume_m3: 0.0, max_cosine: -1.0, worst: None };
        for &tet in self.star(node) {
            let rest_m = self.rest_m(tet);
            state.volume_m3 += tetrahedron_volume_m3(rest_m);
            let cosine = dihedral_cosine_range(rest_m)[1];
            if cosine > state.max_cosine {
                state.max_cosine = cosine;
                state.worst = Some(tet);
            }
        }
        state
    }

    /// Brings a node of the stroke's front in.
    pub(super) fn pull_front(&mut self, body: Body<'_>, node: NodeId, is_end: bool) {
        let here = self.pull_node(body, node);
        self.nodes[here as usize].is_front_end = is_end;
        self.nodes[here as usize].is_front = true;
    }

    /// Brings a node of the faces at the stroke's front in.
    pub(super) fn pull_wake(&mut self, body: Body<'_>, node: NodeId) {
        let here = self.pull_node(body, node);
        self.nodes[here as usize].is_wake = true;
    }

    /// Brings a face in that an earlier step left closed.
    pub(super) fn pull_closed(&mut self, body: Body<'_>, face: [NodeId; 3]) {
        let topology = body.mesh.topology();
        let [a, b, c] = face;
        let has_face = |&&t: &&TetId| {
            let nodes = topology.tet_nodes(t);
            nodes.contains(&b) && nodes.contains(&c)
        };
        let tets: Vec<TetId> = topology.node_tets(a).iter().filter(has_face).copied().collect();
        if tets.len() == 2 {
            for tet in tets {
                self.pull_tet(body, tet);
            }
            let face = face.map(|n| self.pull_node(body, n));
            self.cut.push(sorted(face));
        }
    }

    /// Whether a face of the patch that has one tetrahedron there has one beside the patch too: a face of the mesh.
    pub(super) fn has_neighbour_outside(&self, body: Body<'_>, face: [u32; 3]) -> bool {
        let [Some(a), Some(b), Some(c)] = face.map(|n| self.nodes[n as usize].old) else { return false };
        let topology = body.mesh.topology();
        topology.node_tets(a).iter().any(|&tet| {
            let nodes = topology.tet_nodes(tet);
            self.tet_here[tet.index()] == ABSENT && nodes.contains(&b) && nodes.contains(&c)
        })
    }

    /// Area [m2] of a face in the present shape.
    pub(super) fn face_area_m2(&self, face: [u32; 3]) -> f64 {
        let [a, b, c] = face.map(|n| self.nodes[n as usize].present_m);
        0.5 * (b - a).cross(c - a).length()
    }

    /// The place of a tetrahedron of the mesh in the patch.
    pub(super) fn pull_tet(&mut self, body: Body<'_>, tet: TetId) -> u32 {
        let here = self.tet_here[tet.index()];
        if here != ABSENT {
            return here;
        }
        let nodes = body.mesh.topology().tet_nodes(tet).map(|n| self.pull_node(body, n));
        let here = self.push_tet(PatchTet {
            nodes,
            parent: tet,
            is_live: true,
            is_old: true,
            is_reshaped: false,
            is_mixed: false,
        });
        self.tet_here[tet.index()] = here;
        self.pulled_tets.push(tet);
        here
    }

    /// Brings all tetrahedra at a node in.
    pub(super) fn pull_star(&mut self, body: Body<'_>, node: u32) {
        let PatchNode { old, has_whole_star, .. } = self.nodes[node as usize];
        if let (Some(old), false) = (old, has_whole_star) {
            for &tet in body.mesh.topology().node_tets(old) {
                self.pull_tet(body, tet);
            }
            self.nodes[node as usize].has_whole_star = true;
        }
    }

    /// Brings all tetrahedra at an edge in.
    fn pull_edge(&mut self, body: Body<'_>, [a, b]: [u32; 2]) {
        let (a, b) = (self.nodes[a as usize], self.nodes[b as usize]);
        if a.has_whole_star || b.has_whole_star {
            return;
        }
        if let (Some(a), Some(b)) = (a.old, b.old)
            && let Some(edge) = body.mesh.topology().edge_between(a, b)
        {
            for &tet in body.mesh.topology().edge_tets(edge) {
                self.pull_tet(body, tet);
            }
        }
    }

    pub(super) fn push_tet(&mut self, tet: PatchTet) -> u32 {
        let here = self.tets.len() as u32;
        self.tets.push(tet);
        for node in tet.nodes {
            self.stars[node as usize].push(here);
        }
        here
    }

    pub(super) fn take_out(&mut self, tet: u32) {
        self.tets[tet as usize].is_live = false;
        self.n_changes += 1;
        for node in self.tets[tet as usize].nodes {
            self.nodes[node as usize].changed_at = self.n_changes;
            self.stars[node as usize].retain(|&t| t != tet);
        }
    }

    /// Changed tetrahedra whose smallest dihedral angle at rest has a cosine above `max_cosine`, worst first.
    pub(super) fn bad_tets(&self, max_cosine: f64) -> Vec<(f64, u32)> {
        let mut bad: Vec<(f64, u32)> = self
            .live_tets()
            .filter(|&t| self.tets[t as usize].is_changed())
            .map(|t| (dihedral_cosine_range(self.rest_m(t))[1], t))
            .filter(|b| b.0 > max_cosine)
            .collect();
        bad.sort_unstable_by(|p, q| q.0.total_cmp(&p.0).then(p.1.cmp(&q.1)));
        bad
    }

    /// Puts a node on the edge from `a` to `b` and divides the tetrahedra there; `None` (and nothing done) if
    /// it would be a blend of too many nodes.
    pub(super) fn split_edge(&mut self, body: Body<'_>, [a, b]: [u32; 2], share: f64) -> Option<u32> {
        self.pull_edge(body, [a, b]);
        let (from, to) = (self.nodes[a as usize], self.nodes[b as usize]);
        let middle = self.push_new(NewPlace {
            rest_m: from.rest_m.lerp(to.rest_m, share),
            present_m: from.present_m.lerp(to.present_m, share),
            blend: self.blend(a).towards(&self.blend(b), share)?,
            distance_m: (1.0 - share) * from.distance_m + share * to.distance_m,
        });
        let star = std::mem::take(&mut self.stars[a as usize]);
        for &tet in &star {
            let old = self.tets[tet as usize];
            if !old.nodes.contains(&b) {
                continue;
            }
            let swapped = |gone: u32| old.nodes.map(|n| if n == gone { middle } else { n });
            for node in old.nodes {
                if node != a {
                    self.stars[node as usize].retain(|&t| t != tet);
                }
            }
            let half = |nodes| PatchTet { nodes, is_old: false, ..old };
            // The half at `a` enters the star of `a` below.
            let here = self.tets.len() as u32;
            let nodes = swapped(b);
            self.tets.push(half(nodes));
            for node in nodes {
                if node != a {
                    self.stars[node as usize].push(here);
                }
            }
            self.push_tet(half(swapped(a)));
            self.tets[tet as usize].is_live = false;
        }
        let mut kept = star;
        kept.retain(|&t| self.tets[t as usize].is_live);
        let at_a: Vec<u32> = self.stars[middle as usize]
            .iter()
            .copied()
            .filter(|&t| self.tets[t as usize].nodes.contains(&a))
            .collect();
        kept.extend(at_a);
        self.stars[a as usize] = kept;
        self.divide_cut_faces([a, b], middle);
        Some(middle)
    }

    /// Largest cosine of a dihedral angle at rest among what would come of dividing an edge.
    pub(super) fn cosine_of_parts(&mut self, body: Body<'_>, [a, b]: [u32; 2], share: f64) -> f64 {
        self.pull_edge(body, [a, b]);
        let middle_m = self.nodes[a as usize].rest_m.lerp(self.nodes[b as usize].rest_m, share);
        let mut cosine: f64 = -1.0;
        for &tet in self.stars[a as usize].iter().filter(|&&t| self.tets[t as usize].nodes.contains(&b)) {
            let corners_m = self.rest_m(tet);
            for gone in [a, b] {
                let at = self.tets[tet as usize].nodes.iter().position(|&n| n == gone).unwrap_or(0);
                let mut part_m = corners_m;
                part_m[at] = middle_m;
                cosine = cosine.max(dihedral_cosine_range(part_m)[1]);
            }
        }
        cosine
    }

    /// The tetrahedra at a face.
    pub(super) fn tets_at_face(&self, [a, b, c]: [u32; 3]) -> impl Iterator<Item = u32> + '_ {
        let has_face = move |&t: &u32| {
            let nodes = self.tets[t as usize].nodes;
            nodes.contains(&b) && nodes.contains(&c)
        };
        self.stars[a as usize].iter().copied().filter(has_face)
    }

    /// The tetrahedra on both sides of a face.
    pub(super) fn pair_at_face(&self, face: [u32; 3]) -> [Option<u32>; 2] {
        let mut tets = self.tets_at_face(face);
        [tets.next(), tets.next()]
    }

    /// Largest cosine of a dihedral angle at rest among what would come of dividing a face at its centre.
    pub(super) fn cosine_of_thirds(&mut self, body: Body<'_>, face: [u32; 3]) -> f64 {
        self.pull_star(body, face[0]);
        let center_m = face.map(|n| self.nodes[n as usize].rest_m).into_iter().sum::<DVec3>() / 3.0;
        let mut cosine: f64 = -1.0;
        for tet in self.tets_at_face(face) {
            for gone in face {
                let at = self.tets[tet as usize].nodes.iter().position(|&n| n == gone).unwrap_or(0);
                let mut third_m = self.rest_m(tet);
                third_m[at] = center_m;
                cosine = cosine.max(dihedral_cosine_range(third_m)[1]);
            }
        }
        cosine
    }

    /// Puts a node at the centre of a face of the cut, with the star of its first node in the patch, and divides the
    /// tetrahedra there; `None` (and nothing done) if it would be a blend of too many nodes.
    pub(super) fn split_face(&mut self, face: [u32; 3]) -> Option<u32> {
        let [a, b, c] = face.map(|n| self.nodes[n as usize]);
        let [of_a, of_b, of_c] = face.map(|n| self.blend(n));
        let third = 1.0 / 3.0;
        let middle = self.push_new(NewPlace {
            rest_m: a.rest_m.lerp(b.rest_m, 0.5).lerp(c.rest_m, third),
            present_m: a.present_m.lerp(b.present_m, 0.5).lerp(c.present_m, third),
            blend: of_a.towards(&of_b, 0.5)?.towards(&of_c, third)?,
            distance_m: (a.distance_m + b.distance_m + c.distance_m) * third,
        });
        let swapped = |nodes: [u32; 4], gone: u32| nodes.map(|n| if n == gone { middle } else { n });
        for tet in self.tets_at_face(face).collect::<Vec<u32>>() {
            let old = self.tets[tet as usize];
            self.take_out(tet);
            for gone in face {
                self.push_tet(PatchTet { nodes: swapped(old.nodes, gone), is_old: false, ..old });
            }
        }
        self.cut.retain(|f| *f != face);
        self.cut.extend(face.map(|gone| sorted(face.map(|n| if n == gone { middle } else { n }))));
        Some(middle)
    }

    fn divide_cut_faces(&mut self, [a, b]: [u32; 2], middle: u32) {
        for at in 0..self.cut.len() {
            let face = self.cut[at];
            if face.contains(&a) && face.contains(&b) {
                self.cut[at] = sorted(face.map(|n| if n == b { middle } else { n }));
                self.cut.push(sorted(face.map(|n| if n == a { middle } else { n })));
            }
        }
    }

    /// A second node in the place of `node`.
    pub(super) fn push_copy(&mut self, node: u32) -> u32 {
        let copied = self.nodes[node as usize];
        self.push_node(PatchNode { old: None, has_whole_star: true, ..copied })
    }

    /// Gives a tetrahedron `new` for its corner `old`.
    pub(super) fn swap_node(&mut self, tet: u32, old: u32, new: u32) {
        let this = &mut self.tets[tet as usize];
        this.nodes = this.nodes.map(|n| if n == old { new } else { n });
        this.is_old = false;
        self.stars[old as usize].retain(|&t| t != tet);
        self.stars[new as usize].push(tet);
    }

    /// Tetrahedra of the mesh that others take the place of.
    pub(super) fn replaced_tets(&self) -> impl Iterator<Item = TetId> + '_ {
        let is_replaced = |tet: &TetId| {
            let here = self.here(*tet);
            !(here.is_live && here.is_old)
        };
        self.pulled_tets.iter().copied().filter(is_replaced)
    }

    /// Tetrahedra of the mesh that are not what they were.
    pub(super) fn changed_tets(&self) -> impl Iterator<Item = TetId> + '_ {
        let is_changed = |tet: &TetId| {
            let here = self.here(*tet);
            !here.is_live || here.is_changed()
        };
        self.pulled_tets.iter().copied().filter(is_changed)
    }

    /// What has become of a tetrahedron of the mesh that is in the patch.
    fn here(&self, tet: TetId) -> PatchTet {
        self.tets[self.tet_here[tet.index()] as usize]
    }

    /// Largest cosine of a dihedral angle at rest among what is new or has another shape; -1 without any.
    pub(super) fn max_new_cosine(&self) -> f64 {
        let new = self.live_tets().filter(|&t| self.tets[t as usize].is_changed());
        let cosine = |t| {
            let cosine = dihedral_cosine_range(self.rest_m(t))[1];
            if cosine.is_nan() { 1.0 } else { cosine }
        };
        new.map(cosine).fold(-1.0, f64::max)
    }

    pub(super) fn rest_m(&self, tet: u32) -> [DVec3; 4] {
        self.tets[tet as usize].nodes.map(|n| self.nodes[n as usize].rest_m)
    }

    pub(super) fn present_m(&self, tet: u32) -> [DVec3; 4] {
        self.tets[tet as usize].nodes.map(|n| self.nodes[n as usize].present_m)
    }

    pub(super) fn live_tets(&self) -> impl Iterator<Item = u32> + '_ {
        (0..self.tets.len() as u32).filter(|&t| self.tets[t as usize].is_live)
    }

    /// Length [m] of an edge in the present shape.
    pub(super) fn length_m(&self, [a, b]: [u32; 2]) -> f64 {
        self.nodes[a as usize].present_m.distance(self.nodes[b as usize].present_m)
    }

    /// Edges of a tetrahedron, lower node first.
    pub(super) fn tet_edges(&self, tet: u32) -> [[u32; 2]; 6] {
        let nodes = self.tets[tet as usize].nodes;
        TET_EDGES.map(|[i, j]| [nodes[i].min(nodes[j]), nodes[i].max(nodes[j])])
    }
}
