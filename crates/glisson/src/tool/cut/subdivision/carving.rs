//! Taking out what lies in a swept ball.
//!
//! With phi(x) the distance of x from a capsule (the ball's way and its radius; negative inside) in the deformed shape,
//!
//! 1. tetrahedra through which phi = 0 goes are halved at their longest edges until the facets of the wall are small enough,
//! 2. edges with ends on both sides are divided where phi = 0; nodes very near to it count as on it,
//! 3. what has no node outside is taken out, and so are crumbs that hang on nothing.
//!
//! A capsule is convex: the facets of the wall lie in it with their corners on its surface. What they leave over is made up for, in
//! the mean, by a slightly larger radius. No node moves, and each new tetrahedron lies in one from before, so that embedded copies
//! can carry what is left ([`crate::model::embedded`]).

use super::opening::replacement;
use super::patch::{Body, Patch, barycentric};
use crate::contact::shapes::Capsule;
use crate::math::{DVec3, closest_point_barycentric, tetrahedron_volume_m3};
use crate::mesh::TetId;
use crate::mesh::edit::{EditableMesh, MeshEdit};
use crate::mesh::quality::FACES;
use crate::mesh::topology::{TET_EDGES, TET_TRIANGLES};

/// Longest edge of a facet of the wall, as a share of the radius: such a chord is a tenth of the radius from the arc. A choice.
const EDGE_SHARE: f64 = 0.9;
/// How far chords of such a length are from the arc, as a share of the radius, and a bit.
const SAGITTA_SHARE: f64 = 1.1 * EDGE_SHARE * EDGE_SHARE / 8.0;
/// Nodes nearer to the wall than this share of such an edge are on it. A choice.
const ON_WALL: f64 = 0.02;
/// How much larger the radius is, as a share, so that the facets take out the capsule's volume: found by carving tubes and balls.
const FACETS: f64 = 0.02;
/// Nodes of the tetrahedra that are divided at most.
const MOST_NODES: usize = 40_000;
/// Crumbs of less than this share of the ball's volume go with what is taken out. A choice.
const CRUMB_SHARE: f64 = 0.05;
/// Rounds to find how deep a tetrahedron reaches into the capsule.
const PROJECTIONS: usize = 4;
/// Steps to find where an edge goes through the wall.
const MOST_STEPS: usize = 24;

/// What carving does.
#[derive(Clone, Debug, PartialEq)]
pub struct Carved {
    /// The edits, to be made as one.
    pub edits: Vec<MeshEdit>,
    /// Volume that goes [m3], at rest.
    pub rest_m3: f64,
    /// Volume that goes [m3], as it is now.
    pub present_m3: f64,
    /// Tetrahedra that go.
    pub n_removed: usize,
}

/// Scratch of carving.
#[derive(Debug, Default)]
pub struct Carving {
    patch: Patch,
    /// phi of each node of the patch [m], zero for those that count as on the wall.
    outside_m: Vec<f64>,
    /// Whether a tetrahedron of the patch goes.
    goes: Vec<bool>,
}

impl Clone for Carving {
    /// Its contents do not matter.
    fn clone(&self) -> Self {
        Self::default()
    }
}

impl Carving {
    /// What has to be done to take `solid` out, from the tetrahedra `near`, which have to be all that it meets. `present_m`: where
    /// the nodes are. `None` where nothing goes, or where too much would have to be divided.
    pub fn plan(
        &mut self,
        mesh: &EditableMesh,
        present_m: &[DVec3],
        near: &[TetId],
        solid: &Capsule,
    ) -> Option<Carved> {
        let body = Body { mesh, present_m };
        let solid = Capsule { radius_m: solid.radius_m * (1.0 + FACETS), ..*solid };
        let longest_m = EDGE_SHARE * solid.radius_m;
        self.start(body, near, &solid, ON_WALL * longest_m);
        self.refine(body, &solid, longest_m)?;
        self.divide_at_wall(body, &solid, ON_WALL * longest_m)?;
        self.find_what_goes(&solid);
        self.take_crumbs(body, solid.radius_m);
        self.carved(mesh)
    }

    fn start(&mut self, body: Body<'_>, near: &[TetId], solid: &Capsule, on_wall_m: f64) {
        let patch = &mut self.patch;
        patch.start(body.mesh);
        patch.all_stay = true;
        for &tet in near {
            patch.pull_tet(body, tet);
        }
        self.outside_m.clear();
        self.look_at_new(solid, on_wall_m);
    }

    /// phi of nodes that have come into the patch.
    fn look_at_new(&mut self, solid: &Capsule, on_wall_m: f64) {
        for node in &self.patch.nodes[self.outside_m.len()..] {
            let outside_m = outside_m(solid, node.present_m);
            self.outside_m.push(if outside_m.abs() <= on_wall_m { 0.0 } else { outside_m });
        }
    }

    /// Halves what the wall goes through until its edges are short.
    fn refine(&mut self, body: Body<'_>, solid: &Capsule, longest_m: f64) -> Option<()> {
        let mut at = 0;
        while at < self.patch.tets.len() {
            let tet = at as u32;
            let edge = self.patch.tets[at].is_live.then(|| self.longest_edge(tet));
            match edge {
                Some((edge, length_m))
                    if length_m > longest_m && self.is_too_coarse(tet, solid, longest_m) =>
                {
                    self.patch.split_edge(body, edge, 0.5)?;
                    self.look_at_new(solid, ON_WALL * longest_m);
                    if self.patch.nodes.len() > MOST_NODES {
                        return None;
                    }
                }
                _ => at += 1,
            }
        }
        Some(())
    }

    fn longest_edge(&self, tet: u32) -> ([u32; 2], f64) {
        let edges = self.patch.tet_edges(tet);
        let mut longest = (edges[0], self.patch.length_m(edges[0]));
        for edge in &edges[1..] {
            let length_m = self.patch.length_m(*edge);
            if length_m > longest.1 {
                longest = (*edge, length_m);
            }
        }
        longest
    }

    /// Whether the facet of the wall in a tetrahedron, or the cap that is beyond all of its corners, is too large.
    fn is_too_coarse(&self, tet: u32, solid: &Capsule, longest_m: f64) -> bool {
        let nodes = self.patch.tets[tet as usize].nodes;
        let outside_m = nodes.map(|n| self.outside_m[n as usize]);
        if outside_m.iter().all(|phi| *phi <= 0.0) {
            return false;
        }
        let corners_m = self.patch.present_m(tet);
        if outside_m.iter().all(|phi| *phi >= 0.0) {
            // Chords of a wall that is there already lie in the capsule by so much.
            let sagitta_m = SAGITTA_SHARE * solid.radius_m;
            return depth_in_m(solid, corners_m) < -sagitta_m;
        }
        let mut facet_m = [DVec3::ZERO; 4];
        let mut n = 0;
        for [i, j] in TET_EDGES {
            let (i, j) = if outside_m[i] < 0.0 { (i, j) } else { (j, i) };
            if outside_m[i] < 0.0 && outside_m[j] > 0.0 {
                let (ends_m, of_ends) = ([corners_m[i], corners_m[j]], [outside_m[i], outside_m[j]]);
                facet_m[n] = ends_m[0].lerp(ends_m[1], share_at_wall(solid, ends_m, of_ends));
                n += 1;
            }
        }
        for i in (0..4).filter(|i| outside_m[*i] == 0.0) {
            facet_m[n] = corners_m[i];
            n += 1;
        }
        let facet_m = &facet_m[..n];
        facet_m.iter().any(|p| facet_m.iter().any(|q| p.distance(*q) > longest_m))
    }

    /// Divides all edges that go through the wall.
    fn divide_at_wall(&mut self, body: Body<'_>, solid: &Capsule, on_wall_m: f64) -> Option<()> {
        let mut at = 0;
        while at < self.patch.tets.len() {
            let through = self.patch.tets[at].is_live.then(|| self.edge_through_wall(at as u32)).flatten();
            let Some([inner, outer]) = through else {
                at += 1;
                continue;
            };
            let [a, b] = [inner, outer].map(|n| self.patch.nodes[n as usize].present_m);
            let ends_m = [inner, outer].map(|n| self.outside_m[n as usize]);
            let middle = self.patch.split_edge(body, [inner, outer], share_at_wall(solid, [a, b], ends_m))?;
            self.look_at_new(solid, on_wall_m);
            self.outside_m[middle as usize] = 0.0;
            if self.patch.nodes.len() > MOST_NODES {
                return None;
            }
        }
        Some(())
    }

    /// An edge of a tetrahedron from inside to outside.
    fn edge_through_wall(&self, tet: u32) -> Option<[u32; 2]> {
        let nodes = self.patch.tets[tet as usize].nodes;
        TET_EDGES.into_iter().map(|[i, j]| [nodes[i], nodes[j]]).find_map(|[a, b]| {
            let [of_a, of_b] = [a, b].map(|n| self.outside_m[n as usize]);
            match (of_a < 0.0 && of_b > 0.0, of_a > 0.0 && of_b < 0.0) {
                (true, _) => Some([a, b]),
                (_, true) => Some([b, a]),
                _ => None,
            }
        })
    }

    fn find_what_goes(&mut self, solid: &Capsule) {
        let Self { patch, outside_m, goes } = self;
        goes.clear();
        goes.resize(patch.tets.len(), false);
        for tet in patch.live_tets() {
            let nodes = patch.tets[tet as usize].nodes;
            let center_m = patch.present_m(tet).into_iter().sum::<DVec3>() * 0.25;
            goes[tet as usize] =
                nodes.iter().all(|n| outside_m[*n as usize] <= 0.0) && self::outside_m(solid, center_m) < 0.0;
        }
    }

    /// Has small pieces go that no face joins to what stays beside the patch.
    fn take_crumbs(&mut self, body: Body<'_>, radius_m: f64) {
        let Self { patch, goes, .. } = self;
        let crumb_m3 = CRUMB_SHARE * 4.0 / 3.0 * std::f64::consts::PI * radius_m * radius_m * radius_m;
        let n_tets = patch.tets.len();
        let mut is_seen = vec![false; n_tets];
        let mut piece = Vec::new();
        for first in 0..n_tets as u32 {
            if is_seen[first as usize] || goes[first as usize] || !patch.tets[first as usize].is_live {
                continue;
            }
            piece.clear();
            piece.push(first);
            is_seen[first as usize] = true;
            let (mut volume_m3, mut is_crumb, mut at) = (0.0, true, 0);
            while at < piece.len() {
                let tet = piece[at];
                at += 1;
                volume_m3 += tetrahedron_volume_m3(patch.present_m(tet));
                let nodes = patch.tets[tet as usize].nodes;
                for face in FACES {
                    let face = face.map(|i| nodes[i]);
                    let other = patch.tets_at_face(face).find(|other| *other != tet);
                    match other {
                        Some(other) if !goes[other as usize] && !is_seen[other as usize] => {
                            is_seen[other as usize] = true;
                            piece.push(other);
                        }
                        Some(_) => {}
                        None => is_crumb &= !patch.has_neighbour_outside(body, face),
                    }
                }
            }
            if is_crumb && volume_m3 < crumb_m3 {
                piece.iter().for_each(|tet| goes[*tet as usize] = true);
            }
        }
    }

    /// The edits: what is divided, then what goes.
    fn carved(&self, mesh: &EditableMesh) -> Option<Carved> {
        let Self { patch, goes, .. } = self;
        let (divided, _) = replacement(patch, mesh.topology().n_nodes());
        let (mut rest_m3, mut present_m3, mut tets) = (0.0, 0.0, Vec::new());
        let mut n_new = 0;
        for tet in patch.live_tets() {
            let this = patch.tets[tet as usize];
            let id = if this.is_old {
                this.parent
            } else {
                n_new += 1;
                TetId::from_index(mesh.topology().n_tets() + n_new - 1)
            };
            if goes[tet as usize] {
                tets.push(id);
                rest_m3 += tetrahedron_volume_m3(patch.rest_m(tet));
                present_m3 += tetrahedron_volume_m3(patch.present_m(tet)).abs();
            }
        }
        if tets.is_empty() {
            return None;
        }
        let n_removed = tets.len();
        tets.sort_unstable();
        let removal = MeshEdit::Remove { tets };
        let edits = match divided.tets.is_empty() {
            true => vec![removal],
            false => vec![MeshEdit::Replace(divided), removal],
        };
        Some(Carved { edits, rest_m3, present_m3, n_removed })
    }
}

/// Whether a tetrahedron meets a capsule, about: the last bit of a touch does not count.
pub fn meets(solid: &Capsule, corners_m: [DVec3; 4]) -> bool {
    corners_m.into_iter().any(|corner_m| outside_m(solid, corner_m) < 0.0)
        || depth_in_m(solid, corners_m) < 0.0
}

/// Distance [m] of a point from a capsule; negative inside.
fn outside_m(solid: &Capsule, point_m: DVec3) -> f64 {
    point_m.distance(nearest_on_axis_m(solid, point_m)) - solid.radius_m
}

fn nearest_on_axis_m(solid: &Capsule, point_m: DVec3) -> DVec3 {
    let way_m = solid.to_m - solid.from_m;
    let square = way_m.length_squared();
    let share = if square > 0.0 { (point_m - solid.from_m).dot(way_m) / square } else { 0.0 };
    solid.axis_point_m(share.clamp(0.0, 1.0))
}

/// About the least phi [m] in a tetrahedron: by projections on axis and tetrahedron in turn.
fn depth_in_m(solid: &Capsule, corners_m: [DVec3; 4]) -> f64 {
    let mut point_m = corners_m.into_iter().sum::<DVec3>() * 0.25;
    for _ in 0..PROJECTIONS {
        let on_axis_m = nearest_on_axis_m(solid, point_m);
        let weights = barycentric(corners_m, on_axis_m);
        if weights.into_iter().all(|w| w >= 0.0) {
            return -solid.radius_m;
        }
        let on_faces = TET_TRIANGLES.into_iter().map(|face| {
            let [a, b, c] = face.map(|i| corners_m[i]);
            let [u, v, w] = closest_point_barycentric(on_axis_m, [a, b, c]);
            a * u + b * v + c * w
        });
        let away_m = |p: &DVec3| p.distance(on_axis_m);
        point_m = on_faces.min_by(|p, q| away_m(p).total_cmp(&away_m(q))).unwrap_or(point_m);
    }
    outside_m(solid, point_m)
}

/// Where the edge from `a` inside to `b` outside goes through the wall, by Illinois' false position (Dowell and Jarratt 1971,
/// doi 10.1007/BF01934364).
fn share_at_wall(solid: &Capsule, [a, b]: [DVec3; 2], [of_a, of_b]: [f64; 2]) -> f64 {
    let [mut low, mut high] = [0.0, 1.0];
    let [mut at_low, mut at_high] = [of_a, of_b];
    let mut share = 0.5;
    for _ in 0..MOST_STEPS {
        share = (low * at_high - high * at_low) / (at_high - at_low);
        let here_m = outside_m(solid, a.lerp(b, share));
        if here_m.abs() <= 1e-9 * solid.radius_m {
            break;
        }
        if here_m < 0.0 {
            (low, at_low, at_high) = (share, here_m, 0.5 * at_high);
        } else {
            (high, at_high, at_low) = (share, here_m, 0.5 * at_low);
        }
    }
    share
}
