//! Exchanges tetrahedra that came out too thin for others over the same nodes, where the worst angle grows: an
//! edge gives way to triangles across its ring, or a face to an edge through it (Freitag and Ollivier-Gooch 1997,
//! "Tetrahedral mesh improvement using swapping and smoothing"). Faces of the cut and of the surface stay.

use super::patch::{Body, Patch, PatchTet, sorted};
use crate::math::{DVec3, tetrahedron_volume_m3};
use crate::mesh::TetId;
use crate::mesh::quality::{FACES, dihedral_cosine_range};

/// How often all bad tetrahedra are visited.
const N_ROUNDS: usize = 3;

/// Most tetrahedra around an edge that is taken out.
const MAX_RING: usize = 7;

/// How much a collapse may change the area of the cut, as a share of it.
const AREA_CHANGE: f64 = 1e-3;

/// Least gain in the cosine of an angle that is worth an exchange.
const LEAST_GAIN: f64 = 1e-4;

/// Stands for a cosine where a tetrahedron is flat or inside out.
const INSIDE_OUT: f64 = 2.0;

/// How much the volume may differ, as a share of it: rounding, not a fold.
const SAME_VOLUME: f64 = 1e-11;

/// Betters the changed tetrahedra whose smallest dihedral angle at rest has a cosine above `max_cosine`. Needs
/// `patch.cut` in order.
pub(super) fn swap(patch: &mut Patch, body: Body<'_>, max_cosine: f64) {
    let area_m2: f64 = patch.cut.iter().map(|&face| patch.face_area_m2(face)).sum();
    let max_area_change_m2 = AREA_CHANGE * area_m2;
    let mut memory = Memory::default();
    for _ in 0..N_ROUNDS {
        let mut is_better = false;
        for (_, tet) in patch.bad_tets(max_cosine) {
            if !patch.tets[tet as usize].is_live || memory.is_hopeless(patch, tet) {
                continue;
            }
            if swap_at(patch, body, tet, max_area_change_m2, &mut memory) {
                is_better = true;
            } else {
                memory.note_failure(patch, tet);
            }
        }
        if !is_better {
            return;
        }
    }
}

/// What the exchanges so far have found out. Bad tetrahedra share nodes, and most of them stay as they are.
#[derive(Default)]
struct Memory {
    /// For each tetrahedron that could not be bettered, how many changes there had been, and one more.
    failures: Vec<usize>,
    leaving: Vec<Option<Leaving>>,
}

impl Memory {
    /// Whether a tetrahedron could not be bettered and nothing around has changed.
    fn is_hopeless(&self, patch: &Patch, tet: u32) -> bool {
        let Some(n_changes) = self.failures.get(tet as usize).and_then(|n| n.checked_sub(1)) else {
            return false;
        };
        let around = patch.tets[tet as usize].nodes.into_iter().flat_map(|n| patch.star(n));
        let mut nodes = around.flat_map(|&t| patch.tets[t as usize].nodes);
        nodes.all(|n| patch.nodes[n as usize].changed_at <= n_changes)
    }

    fn note_failure(&mut self, patch: &Patch, tet: u32) {
        self.failures.resize(patch.tets.len(), 0);
        self.failures[tet as usize] = patch.n_changes + 1;
    }

    /// What a node is like that could leave.
    fn leaving(&mut self, patch: &Patch, node: u32) -> &mut Leaving {
        if self.leaving.len() < patch.nodes.len() {
            self.leaving.resize_with(patch.nodes.len(), || None);
        }
        let known = &mut self.leaving[node as usize];
        if known.as_ref().is_some_and(|known| patch.nodes[node as usize].changed_at > known.n_changes) {
            *known = None;
        }
        known.get_or_insert_with(|| Leaving::of(patch, node))
    }
}

/// A node that could be pulled onto another.
struct Leaving {
    /// How many changes there had been in the patch.
    n_changes: usize,
    /// Faces of the cut at the node.
    faces: Vec<[u32; 3]>,
    is_on_rim: bool,
    /// Known when the whole star is in the patch.
    star: Option<LeavingStar>,
}

struct LeavingStar {
    /// Faces of the body's surface at the node.
    sides: Vec<[u32; 3]>,
    is_flat: bool,
    max_cosine: f64,
}

impl Leaving {
    fn of(patch: &Patch, node: u32) -> Self {
        let faces: Vec<[u32; 3]> = patch.cut.iter().filter(|f| f.contains(&node)).copied().collect();
        let is_on_rim = |&other: &u32| faces.iter().filter(|f| f.contains(&other)).count() == 1;
        let is_on_rim = faces.iter().flatten().any(|n| *n != node && is_on_rim(n));
        Self { n_changes: patch.n_changes, faces, is_on_rim, star: None }
    }
}

impl LeavingStar {
    fn of(patch: &mut Patch, body: Body<'_>, node: u32) -> Self {
        patch.pull_star(body, node);
        let sides = patch.single_sides(node);
        let is_flat = patch.normal_of(&sides).is_some();
        Self { sides, is_flat, max_cosine: max_cosine(patch, patch.star(node)) }
    }
}

/// The first exchange of an edge or face of a tetrahedron that betters what goes.
fn swap_at(
    patch: &mut Patch,
    body: Body<'_>,
    tet: u32,
    max_area_change_m2: f64,
    memory: &mut Memory,
) -> bool {
    let nodes = patch.tets[tet as usize].nodes;
    let mut edges = patch.tet_edges(tet);
    edges.sort_by(|&p, &q| patch.length_m(p).total_cmp(&patch.length_m(q)));
    let mut ways = edges.into_iter().flat_map(|[a, b]| [[a, b], [b, a]]);
    ways.any(|[gone, kept]| {
        let leaving = memory.leaving(patch, gone);
        collapse(patch, body, [gone, kept], leaving, max_area_change_m2)
    }) || edges.into_iter().any(|edge| remove_edge(patch, body, edge))
        || FACES.into_iter().any(|face| remove_face(patch, body, tet, face.map(|i| nodes[i])))
}

/// The corners of a tetrahedron other than `a` and `b`, so that (a, b, first, second) has positive volume.
fn other_two(nodes: [u32; 4], [a, b]: [u32; 2]) -> [u32; 2] {
    /// Even permutations of the corners.
    const EVEN: [[usize; 4]; 12] = [
        [0, 1, 2, 3],
        [0, 2, 3, 1],
        [0, 3, 1, 2],
        [1, 0, 3, 2],
        [1, 2, 0, 3],
        [1, 3, 2, 0],
        [2, 0, 1, 3],
        [2, 1, 3, 0],
        [2, 3, 0, 1],
        [3, 0, 2, 1],
        [3, 1, 0, 2],
        [3, 2, 1, 0],
    ];
    let found = EVEN.into_iter().map(|p| p.map(|i| nodes[i])).find(|p| p[0] == a && p[1] == b);
    let [_, _, p, q] = found.expect("both are corners");
    [p, q]
}

/// Whether an edge between two nodes is in the patch; `a` has its whole star there.
fn are_joined(patch: &Patch, a: u32, b: u32) -> bool {
    patch.star(a).iter().any(|&t| patch.tets[t as usize].nodes.contains(&b))
}

/// Whether pulling `gone` onto `kept` leaves the cut where it is: along it, along its rim for a node there, and with about
/// its area.
#[inline]
fn stays_on_cut(patch: &Patch, [gone, kept]: [u32; 2], leaving: &Leaving, max_area_change_m2: f64) -> bool {
    if leaving.faces.is_empty() {
        return true;
    }
    let n_common = leaving.faces.iter().filter(|f| f.contains(&kept)).count();
    if n_common == 0 || (leaving.is_on_rim && n_common != 1) {
        return false;
    }
    let mut area_change_m2 = 0.0;
    for &face in &leaving.faces {
        let after = if face.contains(&kept) {
            0.0
        } else {
            patch.face_area_m2(face.map(|n| if n == gone { kept } else { n }))
        };
        area_change_m2 += after - patch.face_area_m2(face);
    }
    let is_too_much = area_change_m2.abs() > max_area_change_m2;
    !is_too_much
}

/// Pulls `gone` onto `kept`. Nodes inside may go anywhere, those on flat skin along the skin, those on the cut along
/// the cut, and those on the rim of the cut along the rim.
fn collapse(
    patch: &mut Patch,
    body: Body<'_>,
    [gone, kept]: [u32; 2],
    leaving: &mut Leaving,
    max_area_change_m2: f64,
) -> bool {
    if patch.nodes[gone as usize].is_front || patch.is_still(gone) {
        return false;
    }
    if !stays_on_cut(patch, [gone, kept], leaving, max_area_change_m2) {
        return false;
    }
    let LeavingStar { sides, is_flat, max_cosine } =
        leaving.star.get_or_insert_with(|| LeavingStar::of(patch, body, gone));
    if !(sides.is_empty() || (*is_flat && sides.iter().any(|s| s.contains(&kept)))) {
        return false;
    }
    let star: Vec<u32> = patch.star(gone).to_vec();
    let stays = |t: &&u32| !patch.tets[**t as usize].nodes.contains(&kept);
    let new: Vec<[u32; 4]> = star
        .iter()
        .filter(stays)
        .map(|&t| patch.tets[t as usize].nodes.map(|n| if n == gone { kept } else { n }))
        .collect();
    if new.is_empty() {
        return false;
    }
    if !exchange(patch, &star, &new, *max_cosine) {
        return false;
    }
    patch.cut.retain(|f| !(f.contains(&gone) && f.contains(&kept)));
    for face in &mut patch.cut {
        if face.contains(&gone) {
            *face = sorted(face.map(|n| if n == gone { kept } else { n }));
        }
    }
    patch.cut.sort_unstable();
    if let Some(at) = patch.front.iter().position(|f| f.0 == gone) {
        let (_, is_end) = patch.front.remove(at);
        match patch.front.iter_mut().find(|f| f.0 == kept) {
            Some(front) => front.1 |= is_end,
            None => patch.front.push((kept, is_end)),
        }
        patch.front.sort_unstable();
    }
    true
}

fn remove_edge(patch: &mut Patch, body: Body<'_>, edge: [u32; 2]) -> bool {
    let [a, b] = edge;
    if patch.cut.iter().any(|face| face.contains(&a) && face.contains(&b)) {
        return false;
    }
    patch.pull_star(body, a);
    let around: Vec<u32> =
        patch.star(a).iter().copied().filter(|&t| patch.tets[t as usize].nodes.contains(&b)).collect();
    let n = around.len();
    if !(3..=MAX_RING).contains(&n) {
        return false;
    }
    let sides: Vec<[u32; 2]> =
        around.iter().map(|&t| other_two(patch.tets[t as usize].nodes, edge)).collect();
    let mut ring = vec![sides[0][0]];
    for _ in 1..n {
        let last = ring[ring.len() - 1];
        let Some(next) = sides.iter().find(|s| s[0] == last) else { return false };
        ring.push(next[1]);
    }
    // On the surface the ring has two ends.
    if !sides.contains(&[ring[n - 1], ring[0]]) || (1..n).any(|i| ring[..i].contains(&ring[i])) {
        return false;
    }
    let mut best: Option<(f64, Vec<[u32; 4]>)> = None;
    for first in 0..if n == 3 { 1 } else { n } {
        let at = |i: usize| ring[(first + i) % n];
        let fan: Vec<[u32; 4]> =
            (1..n - 1).flat_map(|i| [[at(0), at(i), at(i + 1), b], [at(0), at(i + 1), at(i), a]]).collect();
        let most = best.as_ref().map_or(f64::INFINITY, |b| b.0);
        let worst = worst_cosine(patch, &fan, most);
        if worst < most {
            for i in 0..n {
                patch.pull_star(body, ring[i]);
            }
            let is_new = (2..n - 1).all(|i| !are_joined(patch, at(0), at(i)))
                && (n > 3 || !has_face(patch, [ring[0], ring[1], ring[2]]));
            if is_new {
                best = Some((worst, fan));
            }
        }
    }
    best.is_some_and(|(_, fan)| {
        let max_cosine = max_cosine(patch, &around);
        exchange(patch, &around, &fan, max_cosine)
    })
}

fn has_face(patch: &Patch, [a, b, c]: [u32; 3]) -> bool {
    patch.star(a).iter().any(|&t| {
        let nodes = patch.tets[t as usize].nodes;
        nodes.contains(&b) && nodes.contains(&c)
    })
}

/// `face`: counter-clockwise seen from outside the tetrahedron.
fn remove_face(patch: &mut Patch, body: Body<'_>, tet: u32, face: [u32; 3]) -> bool {
    if patch.cut.binary_search(&sorted(face)).is_ok() {
        return false;
    }
    patch.pull_star(body, face[0]);
    let has_face = |&&t: &&u32| face.iter().all(|n| patch.tets[t as usize].nodes.contains(n));
    let Some(other) = patch.star(face[0]).iter().filter(has_face).copied().find(|&t| t != tet) else {
        return false;
    };
    let apex = |t: u32| patch.tets[t as usize].nodes.into_iter().find(|n| !face.contains(n));
    let (Some(below), Some(above)) = (apex(tet), apex(other)) else { return false };
    let [x, y, z] = face;
    let three = [[below, above, x, y], [below, above, y, z], [below, above, z, x]];
    patch.pull_star(body, below);
    let old = [tet, other];
    !are_joined(patch, below, above) && exchange(patch, &old, &three, max_cosine(patch, &old))
}

/// Largest cosine of a dihedral angle at rest; more if one would be flat or inside out in either shape. Where it is
/// above `most`, no further ones are looked at.
fn worst_cosine(patch: &Patch, tets: &[[u32; 4]], most: f64) -> f64 {
    let mut worst: f64 = -1.0;
    for nodes in tets {
        let rest_m = nodes.map(|n| patch.nodes[n as usize].rest_m);
        let present_m = nodes.map(|n| patch.nodes[n as usize].present_m);
        if tetrahedron_volume_m3(rest_m) <= 0.0 || tetrahedron_volume_m3(present_m) <= 0.0 {
            return INSIDE_OUT;
        }
        worst = worst.max(dihedral_cosine_range(rest_m)[1]);
        if worst > most {
            return worst;
        }
    }
    worst
}

/// Largest cosine of a dihedral angle at rest.
fn max_cosine(patch: &Patch, tets: &[u32]) -> f64 {
    tets.iter().map(|&t| dihedral_cosine_range(patch.rest_m(t))[1]).fold(-1.0, f64::max)
}

/// Puts `new` in the place of `old`, whose worst cosine is `cosine_before`, if that betters the worst angle.
fn exchange(patch: &mut Patch, old: &[u32], new: &[[u32; 4]], cosine_before: f64) -> bool {
    let most = cosine_before - LEAST_GAIN;
    if worst_cosine(patch, new, most) > most {
        return false;
    }
    let rest_m = |nodes: &[u32; 4]| -> [DVec3; 4] { nodes.map(|n| patch.nodes[n as usize].rest_m) };
    let old_m3: f64 = old.iter().map(|&t| tetrahedron_volume_m3(patch.rest_m(t))).sum();
    let new_m3: f64 = new.iter().map(|nodes| tetrahedron_volume_m3(rest_m(nodes))).sum();
    if (new_m3 - old_m3).abs() > SAME_VOLUME * old_m3 {
        return false;
    }
    let parent: TetId = patch.tets[old[0] as usize].parent;
    let is_mixed = old.iter().any(|&t| {
        let tet = patch.tets[t as usize];
        tet.is_mixed || tet.parent != parent
    });
    for &tet in old {
        patch.take_out(tet);
    }
    for &nodes in new {
        patch.push_tet(PatchTet {
            nodes,
            parent,
            is_live: true,
            is_old: false,
            is_reshaped: false,
            is_mixed,
        });
    }
    true
}
