//! Makes the mesh conform to a swept polygon: afterwards no edge crosses it, so that it is a union of faces.
//!
//! First across the plane: a node near the plane counts as on it, every other edge through the plane is
//! divided there. Then inside the plane: the same with the lines that bound the polygon. Every decision
//! hangs on the labels of nodes alone, so that neighbours cannot disagree.

use super::closing::Network;
use super::patch::{Accept, Body, Patch, PatchNode, UNKNOWN, pair_key, sorted};
use super::sweep::{Side, Sweep};
use crate::math::{DVec3, tetrahedron_volume_m3};
use crate::mesh::TetId;
use crate::mesh::quality::FACES;

/// How near is on it, and what is too little to be cut.
#[derive(Clone, Copy, Debug)]
pub(super) struct Snapping {
    /// Share of an edge [1].
    pub(super) share: f64,
    /// The same for nodes that cannot move onto the cut.
    pub(super) share_of_fixed: f64,
    /// Length along an edge [m].
    pub(super) length_m: f64,
    /// Nearer to the plane or a line than this [m] is rounding.
    pub(super) same_m: f64,
    /// Distance of the stroke's front from the plane [m].
    pub(super) front_m: f64,
    /// A node that snaps moves there unless a tetrahedron would become worse than this: cosine of a dihedral
    /// angle.
    pub(super) max_cosine: f64,
}

/// A tetrahedron whose section is inside the polygon by less than this share is left alone.
const LEAST_SHARE_OF_SECTION: f64 = 0.02;

/// A face that is inside the polygon by less than this share is left closed, one that is outside by less is
/// not divided.
const LEAST_SHARE_OF_FACE: f64 = 0.02;

/// Sine of the least angle between skin and plane, or skin and line, for a node to slide there.
const LEAST_SINE: f64 = 0.2;

/// Faces that join a piece of the stroke to the last one have less than this multiple of the square of [`Snapping::front_m`]. More
/// would be a cut of its own.
const LARGEST_JOINT: f64 = 11.0;

/// Where no node moves, the front of a cut that snaps as much as it may is up to half an edge beside the blade: this multiple of
/// [`Snapping::front_m`], a little more than that.
const FRONT_OF_FIXED: f64 = 2.0;

/// A cut that snaps more than this share has its front so far beside the blade: what snaps less stays within [`Snapping::front_m`].
const MUCH_SNAPPED: f64 = 0.25;

/// Cosine of the angle below which a piece of a stroke goes straight on: 2 degrees, a choice.
const STRAIGHT_ON: f64 = 0.9994;

/// What came of one polygon.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Section {
    pub(super) swept_area_m2: f64,
    pub(super) n_touched: usize,
    pub(super) n_snapped: usize,
    /// Area [m2] of the faces beyond the polygon, or more than they have when flat, and of what they leave out; what
    /// reaches back to the front of the stroke so far is not counted.
    pub(super) strayed_m2: f64,
    /// Whether it lies at an angle to the cut so far.
    pub(super) turns: bool,
}

fn sign(x: f64) -> i8 {
    i8::from(x > 0.0) - i8::from(x < 0.0)
}

struct Work<'a> {
    patch: &'a mut Patch,
    body: Body<'a>,
    sweep: &'a Sweep,
    snapping: Snapping,
    n_snapped: usize,
}

/// Divides the patch along the polygon and adds its faces to `patch.cut`.
pub(super) fn conform(patch: &mut Patch, body: Body<'_>, sweep: &Sweep, snapping: Snapping) -> Section {
    for node in &mut patch.nodes {
        node.label = UNKNOWN;
        node.distance_m = f64::NAN;
        node.line_labels = [UNKNOWN; 4];
    }
    let mut work = Work { patch, body, sweep, snapping, n_snapped: 0 };
    let (touched, swept_area_m2) = work.touched();
    let n_touched = touched.len();
    work.divide_across_plane(touched);
    let (mut faces, mut is_settled) = work.faces_of_plane();
    for k in 0..sweep.n_lines() {
        if work.divide_across_line(k, &faces) || !is_settled {
            (faces, is_settled) = work.faces_of_plane();
        }
    }
    let turns = work.turns();
    let mut inside: Vec<[u32; 3]> = faces.into_iter().filter(|&f| work.is_inside(f, turns)).collect();
    let is_nested = work.patch.all_stay;
    if is_nested && turns {
        work.join_to_front(&mut inside);
    }
    let n_snapped = work.n_snapped;
    let rim_m =
        if is_nested && snapping.share > MUCH_SNAPPED { work.front_reach_m() } else { snapping.front_m };
    let (mut covered_m2, mut strayed_m2) = (0.0, 0.0);
    for &face in &inside {
        let corners_m = face.map(|n| work.patch.nodes[n as usize].present_m);
        let [within_m2, with_behind_m2] = sweep.parts_m2(corners_m);
        covered_m2 += within_m2;
        strayed_m2 += work.patch.face_area_m2(face) - with_behind_m2;
    }
    let strayed_m2 = strayed_m2 + (swept_area_m2 - covered_m2).abs();
    if let Some(k) = (0..sweep.n_lines()).find(|&k| sweep.side(k) == Side::Front) {
        add_front(patch, sweep, k, &inside, rim_m);
    }
    patch.cut.extend(inside);
    patch.cut.sort_unstable();
    patch.cut.dedup();
    Section { swept_area_m2, n_touched, n_snapped, strayed_m2, turns }
}

/// Adds the nodes on the rim of `faces` that are at line `k`.
fn add_front(patch: &mut Patch, sweep: &Sweep, k: usize, faces: &[[u32; 3]], reach_m: f64) {
    let mut rim: Vec<[u32; 2]> = faces.iter().flat_map(|&[a, b, c]| [[a, b], [b, c], [a, c]]).collect();
    rim.sort_unstable();
    for edge in rim.chunk_by(|e, f| e == f).filter(|same| same.len() == 1).map(|same| same[0]) {
        let nodes = edge.map(|n| patch.nodes[n as usize]);
        if nodes.iter().any(|n| sweep.inside_m(k, n.present_m).abs() > reach_m) {
            continue;
        }
        for (place, node) in edge.into_iter().zip(nodes) {
            let is_end = (0..sweep.n_lines()).any(|k| sweep.side(k) == Side::Way && node.line_labels[k] == 0);
            patch.front.push((place, is_end));
        }
    }
    patch.front.sort_unstable();
    patch.front.dedup();
}

impl Work<'_> {
    /// The side of a node, from exact arithmetic at first sight.
    fn label(&mut self, node: u32) -> i8 {
        if self.patch.nodes[node as usize].label == UNKNOWN {
            let distance_m = self.distance_m(node);
            let Snapping { same_m, front_m, .. } = self.snapping;
            let all_stay = self.patch.all_stay;
            let node = &mut self.patch.nodes[node as usize];
            let reach_m = match (node.is_front, node.is_wake) {
                // The sides of the cut so far have theirs: the next face begins at the front and nowhere else.
                (false, true) if all_stay => same_m,
                (true, _) if all_stay => same_m.max(FRONT_OF_FIXED * front_m),
                (true, _) | (_, true) => same_m.max(front_m),
                (false, false) => same_m,
            };
            node.label = if distance_m.abs() <= reach_m { 0 } else { sign(distance_m) };
        }
        self.patch.nodes[node as usize].label
    }

    /// How far [m] a node is from the plane, worked out at first sight.
    fn distance_m(&mut self, node: u32) -> f64 {
        let node = &mut self.patch.nodes[node as usize];
        if node.distance_m.is_nan() {
            node.distance_m = self.sweep.distance_m(node.present_m);
        }
        node.distance_m
    }

    /// Tetrahedra that the polygon cuts, in the patch, and the area [m2] inside the body.
    fn touched(&mut self) -> (Vec<u32>, f64) {
        // With room for rounding: corners that an earlier step put into the plane may be a little beside it.
        let flat_m = self.snapping.same_m;
        let [low_m, high_m] = self.sweep.bounds_m();
        let [low_m, high_m] = [low_m - DVec3::splat(flat_m), high_m + DVec3::splat(flat_m)];
        let near = |corners_m: [DVec3; 4]| {
            let low = corners_m[0].min(corners_m[1]).min(corners_m[2].min(corners_m[3]));
            let high = corners_m[0].max(corners_m[1]).max(corners_m[2].max(corners_m[3]));
            low.cmple(high_m).all() && high.cmpge(low_m).all()
        };
        let mut touched = Vec::new();
        let mut area_m2 = 0.0;
        let n_before = self.patch.tets.len() as u32;
        for tet in self.patch.live_tets().collect::<Vec<u32>>() {
            let corners_m = self.patch.present_m(tet);
            if near(corners_m) {
                let distance_m = self.patch.tets[tet as usize].nodes.map(|n| self.distance_m(n));
                let (is_touched, inside_m2) = self.meets(tet, corners_m, distance_m);
                area_m2 += inside_m2;
                if is_touched {
                    touched.push(tet);
                }
            }
        }
        let topology = self.body.mesh.topology();
        let (is_live, nodes) = (topology.live_tet_flags(), &self.body.mesh.mesh().tetrahedra);
        let mut outside = std::mem::take(&mut self.patch.outside);
        self.sweep.outside_into(self.body.present_m, flat_m, &mut outside);
        for at in 0..nodes.len() {
            let is_apart = nodes[at].iter().fold(u8::MAX, |all, n| all & outside[n.index()]) != 0;
            if is_apart || !is_live[at] || self.patch.had_tet(TetId::from_index(at), n_before) {
                continue;
            }
            let corners_m = nodes[at].map(|n| self.body.present_m[n.index()]);
            let distance_m = nodes[at].map(|n| match self.patch.node_here(n) {
                Some(here) => self.distance_m(here),
                None => self.sweep.distance_m(self.body.present_m[n.index()]),
            });
            if distance_m.iter().all(|&d| d > flat_m) || distance_m.iter().all(|&d| d < -flat_m) {
                continue;
            }
            let here = self.patch.pull_tet(self.body, TetId::from_index(at));
            let (is_touched, inside_m2) = self.meets(here, corners_m, distance_m);
            area_m2 += inside_m2;
            if is_touched {
                touched.push(here);
            }
        }
        self.patch.outside = outside;
        (touched, area_m2)
    }

    /// Whether the polygon cuts a tetrahedron enough, and by how much [m2].
    fn meets(&mut self, tet: u32, corners_m: [DVec3; 4], distance_m: [f64; 4]) -> (bool, f64) {
        if tetrahedron_volume_m3(corners_m) <= 0.0 {
            return (false, 0.0);
        }
        // Corners that an earlier step put into the plane are there but for rounding.
        let flat_m = self.snapping.same_m;
        let distance_m = distance_m.map(|d| if d.abs() <= flat_m { 0.0 } else { d });
        let n_zero = distance_m.iter().filter(|&&d| d == 0.0).count();
        let (n_above, n_below) = (
            distance_m.iter().filter(|&&d| d > 0.0).count(),
            distance_m.iter().filter(|&&d| d < 0.0).count(),
        );
        if n_zero == 3 {
            // The section is a face, which the tetrahedron shares with the one on the other side.
            let apex = distance_m.iter().position(|&d| d != 0.0).unwrap_or(0);
            let face = FACES[apex].map(|i| corners_m[i]);
            let [whole_m2, inside_m2] = self.sweep.triangle_areas_m2(face);
            let nodes = FACES[apex].map(|i| self.patch.tets[tet as usize].nodes[i]);
            // Next to the former place of the blade the cut may be open already.
            let is_counted = !self.is_on_skin(nodes) || self.is_at_start(face);
            let share = if is_counted { 0.5 } else { 0.0 };
            return (inside_m2 > LEAST_SHARE_OF_SECTION * whole_m2, share * inside_m2);
        }
        let inside_m2 = if n_above == 0 || n_below == 0 { 0.0 } else { self.sweep.area_in_tet_m2(corners_m) };
        (self.is_cut(tet), inside_m2)
    }

    /// Whether enough of the section through a tetrahedron, as the labels of its nodes have it, is inside the
    /// polygon, seen along the normal.
    fn is_cut(&mut self, tet: u32) -> bool {
        let nodes = self.patch.tets[tet as usize].nodes;
        let labels = nodes.map(|n| self.label(n));
        if !(labels.contains(&1) && labels.contains(&-1)) {
            return false;
        }
        let at = |i: usize| self.patch.nodes[nodes[i] as usize];
        let mut corners_m = [DVec3::ZERO; 4];
        let mut n = 0;
        for i in 0..4 {
            if labels[i] == 0 {
                corners_m[n] = at(i).present_m;
                n += 1;
            }
        }
        // Around a quadrilateral, neighbouring edges share a node.
        const AROUND: [[usize; 2]; 6] = [[0, 1], [0, 2], [0, 3], [1, 2], [1, 3], [2, 3]];
        let mut crossed: Vec<[usize; 2]> =
            AROUND.into_iter().filter(|&[i, j]| labels[i] * labels[j] < 0).collect();
        if crossed.len() == 4 {
            let first = crossed[0];
            let opposite = crossed.iter().position(|e| !e.contains(&first[0]) && !e.contains(&first[1]));
            crossed.swap(2, opposite.unwrap_or(2));
        }
        for &[i, j] in &crossed {
            let (p, q) = (at(i), at(j));
            corners_m[n] = p.present_m.lerp(q.present_m, p.distance_m / (p.distance_m - q.distance_m));
            n += 1;
        }
        let [mut whole_m2, mut inside_m2] = [0.0; 2];
        for k in 2..n {
            let [whole, inside] =
                self.sweep.triangle_areas_m2([corners_m[0], corners_m[k - 1], corners_m[k]]);
            whole_m2 += whole;
            inside_m2 += inside;
        }
        inside_m2 > LEAST_SHARE_OF_SECTION * whole_m2
    }

    /// Whether a face reaches the place where the blade was.
    fn is_at_start(&self, face_m: [DVec3; 3]) -> bool {
        let start = (0..self.sweep.n_lines()).find(|&k| self.sweep.side(k) == Side::Start);
        start.is_some_and(|k| face_m.iter().any(|&p| self.sweep.inside_m(k, p) <= self.snapping.front_m))
    }

    /// Whether a face of the patch has no tetrahedron on its other side.
    fn is_on_skin(&mut self, face: [u32; 3]) -> bool {
        self.patch.pull_star(self.body, face[0]);
        let star = self.patch.star(face[0]);
        star.iter().filter(|&&t| face.iter().all(|n| self.patch.tets[t as usize].nodes.contains(n))).count()
            < 2
    }

    fn divide_across_plane(&mut self, mut touched: Vec<u32>) {
        let mut is_touched = vec![false; self.patch.tets.len()];
        let mut n_done = 0;
        // Where nodes snap the section shifts, perhaps into tetrahedra that the polygon does not meet.
        while n_done < touched.len() {
            for &tet in &touched[n_done..] {
                is_touched[tet as usize] = true;
            }
            let shares = self.crossings(&touched[n_done..]);
            n_done = touched.len();
            for node in self.snap(&shares, |node| &mut node.label, None) {
                self.patch.pull_star(self.body, node);
                is_touched.resize(self.patch.tets.len(), false);
                for tet in self.patch.star(node).to_vec() {
                    if !is_touched[tet as usize] && self.is_cut(tet) {
                        is_touched[tet as usize] = true;
                        touched.push(tet);
                    }
                }
            }
        }
        let shares = self.crossings(&touched);
        self.split(shares, |node| &mut node.label);
    }

    /// Edges of tetrahedra through the plane, and where they cross.
    fn crossings(&mut self, tets: &[u32]) -> Vec<([u32; 2], f64)> {
        // One number sorts faster than two.
        let mut edges: Vec<u64> = Vec::with_capacity(6 * tets.len());
        for &tet in tets {
            for node in self.patch.tets[tet as usize].nodes {
                self.label(node);
            }
            edges.extend(self.patch.tet_edges(tet).map(|[a, b]| pair_key(a, b)));
        }
        edges.sort_unstable();
        edges.dedup();
        let share = |&edge: &u64| {
            let [a, b] = [(edge >> 32) as u32, edge as u32];
            let (p, q) = (&self.patch.nodes[a as usize], &self.patch.nodes[b as usize]);
            (p.label * q.label < 0).then(|| ([a, b], p.distance_m / (p.distance_m - q.distance_m)))
        };
        edges.iter().filter_map(share).collect()
    }

    /// Faces of the plane, each between a tetrahedron above and one below; and whether they would be the same if asked for
    /// again: a node beside them may turn out to be on the plane, too.
    fn faces_of_plane(&mut self) -> (Vec<[u32; 3]>, bool) {
        let mut is_settled = true;
        for node in 0..self.patch.nodes.len() as u32 {
            if self.patch.nodes[node as usize].label == 0 {
                self.patch.pull_star(self.body, node);
            }
        }
        // Faces, 32 bits a node, and the side of their tetrahedra, one more than its sign: one number sorts faster.
        let mut sides: Vec<u128> = Vec::with_capacity(self.patch.tets.len());
        for tet in 0..self.patch.tets.len() {
            let tet = self.patch.tets[tet];
            if !tet.is_live {
                continue;
            }
            let is_zero = tet.nodes.map(|n| self.patch.nodes[n as usize].label == 0);
            let n_zero = is_zero.iter().filter(|&&z| z).count();
            if n_zero < 3 {
                continue;
            }
            let side = if n_zero == 4 {
                let sum: f64 = tet.nodes.iter().map(|&n| self.patch.nodes[n as usize].distance_m).sum();
                if sum >= 0.0 { 1 } else { -1 }
            } else {
                let apex = is_zero.iter().position(|&z| !z).unwrap_or(0);
                let side = self.label(tet.nodes[apex]);
                is_settled &= side != 0;
                side
            };
            for (opposite, face) in FACES.iter().enumerate() {
                if n_zero == 4 || !is_zero[opposite] {
                    let [a, b, c] = sorted(face.map(|i| tet.nodes[i])).map(u128::from);
                    sides.push(a << 66 | b << 34 | c << 2 | u128::from((side + 1) as u8));
                }
            }
        }
        sides.sort_unstable();
        let is_parted = |w: &&[u128]| w[0] >> 2 == w[1] >> 2 && w[0] & 3 == 0 && w[1] & 3 == 2;
        let parted = sides.windows(2).filter(is_parted);
        (parted.map(|w| [66, 34, 2].map(|shift| (w[0] >> shift) as u32)).collect(), is_settled)
    }

    /// The side of a node on line `k`.
    fn line_label(&mut self, k: usize, node: u32) -> (i8, f64) {
        let Self { sweep, snapping, .. } = *self;
        let node = &mut self.patch.nodes[node as usize];
        let inside_m = sweep.inside_m(k, node.present_m);
        if node.line_labels[k] == UNKNOWN {
            node.line_labels[k] = sign(inside_m);
            if inside_m.abs() <= snapping.same_m {
                node.line_labels[k] = 0;
            }
            let is_there = match sweep.side(k) {
                Side::Start => node.is_front,
                Side::Front | Side::Way => node.is_front_end && inside_m.abs() <= snapping.front_m,
            };
            if is_there {
                node.line_labels[k] = 0;
            }
        }
        (node.line_labels[k], inside_m)
    }

    /// Divides faces of the plane; whether there was anything to divide, so that they may be others now.
    fn divide_across_line(&mut self, k: usize, faces: &[[u32; 3]]) -> bool {
        let mut shares = Vec::new();
        for &face in faces {
            let inside = face.map(|n| self.line_label(k, n));
            let labels = inside.map(|i| i.0);
            if !(labels.contains(&1) && labels.contains(&-1)) {
                continue;
            }
            let corners_m = face.map(|n| self.patch.nodes[n as usize].present_m);
            let [whole_m2, inside_m2] = self.sweep.triangle_areas_m2(corners_m);
            if inside_m2 <= LEAST_SHARE_OF_FACE * whole_m2
                || inside_m2 >= (1.0 - LEAST_SHARE_OF_FACE) * whole_m2
            {
                continue;
            }
            let mut crossings = Vec::with_capacity(2);
            let mut reach = [f64::INFINITY, f64::NEG_INFINITY];
            let mut length_m = 0.0;
            for (i, j) in [(0, 1), (1, 2), (0, 2)] {
                let (along, length) = self.sweep.along_m(k, corners_m[i]);
                length_m = length;
                if labels[i] == 0 {
                    reach = [reach[0].min(along), reach[1].max(along)];
                }
                if labels[i] * labels[j] < 0 {
                    let share = inside[i].1 / (inside[i].1 - inside[j].1);
                    let (along, _) = self.sweep.along_m(k, corners_m[i].lerp(corners_m[j], share));
                    reach = [reach[0].min(along), reach[1].max(along)];
                    crossings.push(([face[i], face[j]], share));
                }
            }
            let common_m = reach[1].min(length_m) - reach[0].max(0.0);
            if common_m > LEAST_SHARE_OF_FACE * (reach[1] - reach[0]) {
                shares.extend(crossings);
            }
        }
        shares.sort_unstable_by_key(|s| s.0);
        shares.dedup_by_key(|s| s.0);
        if shares.is_empty() {
            return false;
        }
        self.snap(&shares, |node| &mut node.line_labels[k], Some(k));
        self.split(shares, |node| &mut node.line_labels[k]);
        true
    }

    /// Gives the ends of edges that are near the crossing label 0, and moves them there if they can.
    fn snap(
        &mut self,
        edges: &[([u32; 2], f64)],
        label: impl Fn(&mut PatchNode) -> &mut i8,
        line: Option<usize>,
    ) -> Vec<u32> {
        let Snapping { share: near_share, length_m: near_m, .. } = self.snapping;
        let mut near: Vec<(f64, u32, u32)> = Vec::new();
        for &([a, b], share) in edges {
            let length_m = self.patch.length_m([a, b]);
            for (node, other, share) in [(a, b, share), (b, a, 1.0 - share)] {
                if share <= near_share || share * length_m <= near_m {
                    near.push((share, node, other));
                }
            }
        }
        near.sort_unstable_by(|p, q| p.0.total_cmp(&q.0).then(p.1.cmp(&q.1)).then(p.2.cmp(&q.2)));
        let mut snapped = Vec::new();
        for (share, node, other) in near {
            let other_label = *label(&mut self.patch.nodes[other as usize]);
            let this = label(&mut self.patch.nodes[node as usize]);
            let own = *this;
            if own * other_label >= 0 {
                continue;
            }
            *this = 0;
            if !self.move_onto(node, line) && share > self.snapping.share_of_fixed {
                *label(&mut self.patch.nodes[node as usize]) = own;
            } else {
                snapped.push(node);
            }
        }
        self.n_snapped += snapped.len();
        snapped
    }

    /// Moves a node onto the plane, or onto a line in it, if it can.
    fn move_onto(&mut self, node: u32, line: Option<usize>) -> bool {
        let PatchNode { present_m, is_front, distance_m, line_labels, .. } = self.patch.nodes[node as usize];
        let is_elsewhere = line_labels.iter().enumerate().any(|(k, &l)| Some(k) != line && l == 0);
        if is_front || is_elsewhere {
            return false;
        }
        let mut to_m = present_m - self.sweep.normal * distance_m;
        if let Some(k) = line {
            to_m = self.sweep.onto_line_m(k, to_m);
        }
        let accept = Accept::UpTo(self.snapping.max_cosine);
        let mut is_moved = self.patch.move_node(self.body, node, to_m, accept);
        if !is_moved && let Some(skin) = self.patch.skin_normal(node) {
            // On flat skin, or on the side of an earlier cut, it can slide.
            let normal = self.sweep.normal;
            let way = match line {
                None => normal.reject_from_normalized(skin),
                Some(_) => normal.cross(skin),
            };
            let (from_m, reach) = match line {
                None => (distance_m, way.dot(normal)),
                Some(k) => self.sweep.towards_line(k, present_m, way),
            };
            if way.length() >= LEAST_SINE && reach.abs() >= LEAST_SINE * way.length() {
                let to_m = present_m - way * (from_m / reach);
                is_moved = self.patch.move_node(self.body, node, to_m, accept);
            }
        }
        if is_moved {
            self.patch.nodes[node as usize].distance_m = 0.0;
        }
        is_moved
    }

    /// Divides the edges that still cross, longest first.
    fn split(&mut self, mut edges: Vec<([u32; 2], f64)>, label: impl Fn(&mut PatchNode) -> &mut i8) {
        edges.retain(|&([a, b], _)| {
            let a = *label(&mut self.patch.nodes[a as usize]);
            let b = *label(&mut self.patch.nodes[b as usize]);
            a * b < 0
        });
        let mut by_length: Vec<(f64, [u32; 2], f64)> =
            edges.iter().map(|&(edge, share)| (self.patch.length_m(edge), edge, share)).collect();
        by_length.sort_unstable_by(|p, q| q.0.total_cmp(&p.0).then(p.1.cmp(&q.1)));
        for (_, edge, share) in by_length {
            if let Some(middle) = self.patch.split_edge(self.body, edge, share) {
                *label(&mut self.patch.nodes[middle as usize]) = 0;
            }
        }
    }

    /// Nodes of the front, ascending.
    fn front(&self) -> Vec<u32> {
        let is_front = |n: &u32| self.patch.nodes[*n as usize].is_front;
        (0..self.patch.nodes.len() as u32).filter(is_front).collect()
    }

    /// Tetrahedra at any of these nodes, ascending.
    fn stars(&mut self, nodes: &[u32]) -> Vec<u32> {
        let mut tets = Vec::new();
        for &node in nodes {
            self.patch.pull_star(self.body, node);
            tets.extend_from_slice(self.patch.star(node));
        }
        tets.sort_unstable();
        tets.dedup();
        tets
    }

    /// Whether this piece of the stroke lies at an angle to the sides of the cut so far, by the mean over their area near the front. One
    /// that goes straight on has no gap to close.
    fn turns(&mut self) -> bool {
        let normal = self.sweep.normal;
        let front = self.front();
        if front.is_empty() {
            return false;
        }
        let tets = self.stars(&front);
        // Of no sides at all the sum is zero, which is along nothing.
        let mut sum_m2 = DVec3::ZERO;
        for tet in tets {
            let nodes = self.patch.tets[tet as usize].nodes;
            for face in FACES.map(|face| face.map(|i| nodes[i])) {
                let here = face.map(|n| self.patch.nodes[n as usize]);
                if !here.iter().all(|n| n.is_front || n.is_wake) || !here.iter().any(|n| n.is_front) {
                    continue;
                }
                if !self.is_on_skin(face) {
                    continue;
                }
                let [a, b, c] = here.map(|n| n.present_m);
                let area_m2 = (b - a).cross(c - a);
                sum_m2 += if area_m2.dot(normal) < 0.0 { -area_m2 } else { area_m2 };
            }
        }
        sum_m2.normalize_or_zero().dot(normal) < STRAIGHT_ON
    }

    /// Joins the faces of the polygon to the cut so far. Where two pieces of the stroke meet at an angle, and the front of the
    /// former is not quite straight, the plane of the latter may leave a gap between them that keeps the sides together; the faces
    /// of the least area that close it are cut, too, and those that end in it are not.
    fn join_to_front(&mut self, inside: &mut Vec<[u32; 3]>) {
        let Some(start) = (0..self.sweep.n_lines()).find(|&k| self.sweep.side(k) == Side::Start) else {
            return;
        };
        let gaps = self.gaps(start, inside);
        if gaps.is_empty() {
            return;
        }
        let around: Vec<u32> = gaps.iter().flatten().copied().chain(self.front()).collect();
        let tets = self.stars(&around);
        let before = inside.clone();
        let price = |face: [u32; 3]| match self.patch.cut.binary_search(&face) {
            Ok(_) => None,
            Err(_) if before.contains(&face) => Some(0.0),
            Err(_) => Some(self.patch.face_area_m2(face)),
        };
        let mut network = Network::of(self.patch, &tets, price);
        for &tet in &tets {
            let nodes = self.patch.tets[tet as usize].nodes;
            for face in FACES.map(|face| face.map(|i| nodes[i])) {
                let here = face.map(|n| self.patch.nodes[n as usize]);
                let side = if before.contains(&sorted(face)) {
                    let mut is_ahead = face.iter().zip(here);
                    // Behind the front and beside it the plane need not be where the cut is.
                    if is_ahead.all(|(&n, node)| node.is_front || self.line_label(start, n).0 > 0) {
                        self.side_of(tet)
                    } else {
                        0
                    }
                } else if here.iter().all(|n| n.is_front || n.is_wake) && self.is_on_skin(face) {
                    // A side of the cut so far, which looks across it.
                    let [a, b, c] = here.map(|n| n.present_m);
                    -sign((b - a).cross(c - a).dot(self.sweep.normal))
                } else {
                    0
                };
                network.set_side(tet, side);
            }
        }
        let Some((faces, area_m2)) = network.least_cut() else { return };
        inside.retain(|face| self.patch.tets_at_face(*face).any(|t| tets.binary_search(&t).is_err()));
        inside.extend(faces);
        inside.sort_unstable();
        inside.dedup();
        let most_m2 = LARGEST_JOINT * self.snapping.front_m * self.snapping.front_m;
        if area_m2 > most_m2 || self.gaps(start, inside).len() >= gaps.len() {
            *inside = before;
        }
    }

    /// How far [m] the front of a piece may be from where the blade was.
    fn front_reach_m(&self) -> f64 {
        let share = if self.patch.all_stay { FRONT_OF_FIXED } else { 1.0 };
        share * self.snapping.front_m
    }

    /// The side of a tetrahedron at the plane.
    fn side_of(&self, tet: u32) -> i8 {
        let nodes = self.patch.tets[tet as usize].nodes.map(|n| self.patch.nodes[n as usize]);
        match nodes.iter().find(|n| n.label != 0) {
            Some(node) => node.label,
            None if nodes.iter().map(|n| n.distance_m).sum::<f64>() >= 0.0 => 1,
            None => -1,
        }
    }

    /// Edges inside the body where `inside` and what is in `patch.cut` end near line `start`.
    fn gaps(&mut self, start: usize, inside: &[[u32; 3]]) -> Vec<[u32; 2]> {
        let mut edges: Vec<[u32; 2]> = self
            .patch
            .cut
            .iter()
            .chain(inside.iter().filter(|f| self.patch.cut.binary_search(f).is_err()))
            .flat_map(|&[a, b, c]| [[a, b], [b, c], [a, c]])
            .collect();
        edges.sort_unstable();
        let mut gaps: Vec<[u32; 2]> =
            edges.chunk_by(|e, f| e == f).filter(|same| same.len() % 2 == 1).map(|same| same[0]).collect();
        gaps.retain(|edge| {
            let start_m = edge.map(|n| self.line_label(start, n).1);
            let reach_m = self.front_reach_m();
            let is_near = start_m.iter().all(|&m| m <= reach_m) && start_m.iter().any(|&m| m >= -reach_m);
            let is_at_end = (0..self.sweep.n_lines()).filter(|&k| k != start).any(|k| {
                edge.iter().all(|&n| {
                    let (label, inside_m) = self.line_label(k, n);
                    label == 0 || inside_m <= 0.0
                })
            });
            is_near && !is_at_end && !self.is_skin_edge(*edge)
        });
        gaps
    }

    /// Whether an edge of the patch is on the surface of the body.
    fn is_skin_edge(&mut self, [a, b]: [u32; 2]) -> bool {
        self.patch.pull_star(self.body, a);
        let star = self.patch.star(a).iter().map(|&t| self.patch.tets[t as usize].nodes);
        let mut around: Vec<u32> =
            star.filter(|n| n.contains(&b)).flatten().filter(|&n| n != a && n != b).collect();
        around.sort_unstable();
        around.chunk_by(|m, n| m == n).any(|same| same.len() == 1)
    }

    /// Whether a face of the plane belongs to the polygon. Where the stroke goes straight on, one with an edge on the front lies ahead
    /// of the cut so far, also where the front is not straight and the line through its ends is beyond; where it turns, `join_to_front`
    /// finds what leads there.
    fn is_inside(&mut self, face: [u32; 3], turns: bool) -> bool {
        let n_at_front = face.iter().filter(|&&n| self.patch.nodes[n as usize].is_front).count();
        (0..self.sweep.n_lines()).all(|k| {
            if !turns && n_at_front > 1 && self.sweep.side(k) == Side::Start {
                return true;
            }
            let sides = face.map(|n| self.line_label(k, n));
            let (n_in, n_out) =
                (sides.iter().filter(|s| s.0 > 0).count(), sides.iter().filter(|s| s.0 < 0).count());
            match (n_in, n_out) {
                (1.., 0) => true,
                (0, 1..) => false,
                _ => sides.iter().map(|s| s.1).sum::<f64>() > 0.0,
            }
        })
    }
}
