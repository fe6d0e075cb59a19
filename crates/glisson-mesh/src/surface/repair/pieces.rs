//! Which way triangles and pieces face, and which pieces lie inside others.

use super::mending::compact;
use super::report::{FaultsFound, RepairsDone};
use crate::disjoint_sets::DisjointSets;
use crate::math::{Aabb, DVec3};
use crate::surface::TriMesh;
use crate::surface::check::Side;
use crate::surface::winding::WindingTree;

/// A piece whose area vectors sum to more than this share of its area is too open to have an inside of its
/// own: 0 is closed, 1 flat.
const MOST_OPEN: f64 = 0.1;

/// Vertices of a piece that are asked whether they lie inside another; all of them have to, else the two
/// cross.
const N_PROBES: usize = 64;

/// A piece joined by edges.
pub(super) struct Piece {
    /// Its triangles, ascending.
    pub(super) triangles: Vec<u32>,
    /// Volume [m3] about its own middle, negative inside out.
    pub(super) volume_m3: f64,
    /// A corner of its first triangle [m].
    pub(super) place_m: DVec3,
    /// Its area vectors nearly cancel.
    pub(super) is_nearly_closed: bool,
    /// All its edges belong to two triangles, which agreed as given.
    is_sound: bool,
    /// Pieces around it, by their place in the list.
    around: Vec<usize>,
}

/// Turns triangles so that neighbours agree, with the larger area of each patch; then pieces so that they
/// face outward. A piece inside another stays inward only as a cavity: when it was sound as given.
pub(super) fn orient(
    mesh: &mut TriMesh,
    sides: &[Side],
    found: &mut FaultsFound,
    done: &mut RepairsDone,
) -> Vec<Piece> {
    let is_turned = turned_against_their_patch(mesh, sides);
    for (t, _) in is_turned.iter().enumerate().filter(|&(_, &turned)| turned) {
        found.turned_triangles.add(mesh.corners_m(t)[0]);
        mesh.triangles[t].swap(1, 2);
    }
    let mut pieces = pieces_of(mesh, sides, &is_turned);
    nest(mesh, &mut pieces);
    let was_negative: Vec<bool> = pieces.iter().map(|p| p.volume_m3 < 0.0).collect();
    let mut turns = vec![false; pieces.len()];
    for (p, piece) in pieces.iter().enumerate().filter(|(_, piece)| piece.is_nearly_closed) {
        let outermost = piece.around.iter().copied().find(|&o| pieces[o].around.is_empty());
        turns[p] = match outermost {
            None => was_negative[p],
            // What faces against the piece around it, whichever way that was given, bounds a cavity.
            Some(outer) if piece.is_sound => was_negative[outer],
            Some(_) => was_negative[p],
        };
    }
    found.pieces = pieces.len();
    done.triangles_turned = found.turned_triangles.count;
    for (piece, _) in pieces.iter_mut().zip(&turns).filter(|&(_, &turns)| turns) {
        found.turned_pieces.add(piece.place_m);
        done.triangles_turned += piece.triangles.len();
        piece.volume_m3 = -piece.volume_m3;
        for &t in &piece.triangles {
            mesh.triangles[t as usize].swap(1, 2);
        }
    }
    pieces
}

/// The pieces that border the solid where the winding number is above one half, if pieces do not cross: for
/// each whether it does.
pub(super) fn are_borders(pieces: &[Piece]) -> Vec<bool> {
    let sign = |p: &Piece| if p.volume_m3 < 0.0 { -1 } else { 1 };
    let is_border = |piece: &Piece| {
        let outside: i32 = piece.around.iter().map(|&o| sign(&pieces[o])).sum();
        (outside > 0) != (outside + sign(piece) > 0)
    };
    pieces.iter().map(is_border).collect()
}

/// Each triangle's neighbour over an edge of two: the triangle and whether both run the same way.
fn neighbours(n_triangles: usize, sides: &[Side]) -> Vec<[Option<(u32, bool)>; 3]> {
    let mut list = vec![[None; 3]; n_triangles];
    for edge in sides.chunk_by(|a, b| (a.low, a.high) == (b.low, b.high)) {
        let [a, b] = edge else { continue };
        let agree = a.ascending != b.ascending;
        for (of, other) in [(a, b), (b, a)] {
            let free = list[of.triangle as usize].iter_mut().find(|n| n.is_none());
            *free.expect("a triangle has three sides") = Some((other.triangle, agree));
        }
    }
    list
}

fn turned_against_their_patch(mesh: &TriMesh, sides: &[Side]) -> Vec<bool> {
    let n = mesh.triangles.len();
    let next_to = neighbours(n, sides);
    let mut is_turned = vec![false; n];
    let mut is_reached = vec![false; n];
    for start in 0..n {
        if is_reached[start] {
            continue;
        }
        is_reached[start] = true;
        let mut patch = vec![start];
        let mut next = 0;
        while next < patch.len() {
            let t = patch[next];
            next += 1;
            for &(other, agree) in next_to[t].iter().flatten() {
                let other = other as usize;
                if !std::mem::replace(&mut is_reached[other], true) {
                    is_turned[other] = is_turned[t] == agree;
                    patch.push(other);
                }
            }
        }
        let area = |t: usize| {
            let [a, b, c] = mesh.corners_m(t);
            (b - a).cross(c - a).length()
        };
        let area_of = |turned: bool, is_turned: &[bool]| -> f64 {
            patch.iter().filter(|&&t| is_turned[t] == turned).map(|&t| area(t)).sum()
        };
        if area_of(true, &is_turned) > area_of(false, &is_turned) {
            for &t in &patch {
                is_turned[t] = !is_turned[t];
            }
        }
    }
    is_turned
}

fn pieces_of(mesh: &TriMesh, sides: &[Side], is_turned: &[bool]) -> Vec<Piece> {
    let n = mesh.triangles.len();
    let mut sets = DisjointSets::new(n);
    let mut is_sound = vec![true; n];
    for edge in sides.chunk_by(|a, b| (a.low, a.high) == (b.low, b.high)) {
        for side in edge {
            sets.join(edge[0].triangle as usize, side.triangle as usize);
            is_sound[side.triangle as usize] &= edge.len() == 2;
        }
    }
    let mut label = vec![usize::MAX; n];
    let mut lists: Vec<Vec<u32>> = Vec::new();
    for t in 0..n {
        let root = sets.root(t);
        if root == t {
            label[t] = lists.len();
            lists.push(Vec::new());
        }
        label[t] = label[root];
        lists[label[t]].push(t as u32);
    }
    let piece = |triangles: Vec<u32>| {
        let (mut area, mut middle, mut vector) = (0.0, DVec3::ZERO, DVec3::ZERO);
        for &t in &triangles {
            let [a, b, c] = mesh.corners_m(t as usize);
            let doubled = (b - a).cross(c - a);
            area += doubled.length();
            middle += doubled.length() * (a + b + c) / 3.0;
            vector += doubled;
        }
        middle /= area;
        let volume_m3 = triangles
            .iter()
            .map(|&t| {
                let [a, b, c] = mesh.corners_m(t as usize).map(|p| p - middle);
                a.dot(b.cross(c)) / 6.0
            })
            .sum();
        Piece {
            volume_m3,
            place_m: mesh.corners_m(triangles[0] as usize)[0],
            is_nearly_closed: triangles.len() >= 4 && vector.length() <= MOST_OPEN * area,
            is_sound: triangles.iter().all(|&t| is_sound[t as usize] && !is_turned[t as usize]),
            around: Vec::new(),
            triangles,
        }
    };
    lists.into_iter().map(piece).collect()
}

/// Finds what is around each piece: nearly closed ones alone can be.
fn nest(mesh: &TriMesh, pieces: &mut [Piece]) {
    let meshes: Vec<TriMesh> = pieces
        .iter()
        .map(|piece| {
            let triangles: Vec<[u32; 3]> =
                piece.triangles.iter().map(|&t| mesh.triangles[t as usize]).collect();
            TriMesh::over(&mesh.positions_m, &triangles)
        })
        .collect();
    let bounds: Vec<Aabb> = meshes.iter().map(|m| Aabb::of_points(&m.positions_m)).collect();
    let probes: Vec<Vec<DVec3>> = meshes
        .iter()
        .map(|m| {
            let n = m.positions_m.len();
            (0..N_PROBES.min(n)).map(|i| m.positions_m[i * n / N_PROBES.min(n)]).collect()
        })
        .collect();
    for outer in (0..pieces.len()).filter(|&p| pieces[p].is_nearly_closed).collect::<Vec<_>>() {
        let mut tree = None;
        for inner in 0..pieces.len() {
            let may_hold = inner != outer
                && pieces[inner].volume_m3.abs() <= pieces[outer].volume_m3.abs()
                && probes[inner].iter().any(|&p| bounds[outer].contains(p));
            if !may_hold {
                continue;
            }
            let tree = tree.get_or_insert_with(|| WindingTree::of_triangles(&meshes[outer]));
            let is_inside = |p: DVec3| bounds[outer].contains(p) && tree.winding_number(p).abs() > 0.5;
            if probes[inner].iter().all(|&p| is_inside(p)) {
                pieces[inner].around.push(outer);
            }
        }
    }
}

/// `mesh` without the triangles of the pieces that `stays` denies.
pub(super) fn kept(mesh: &TriMesh, pieces: &[Piece], stays: &[bool]) -> TriMesh {
    if stays.iter().all(|&s| s) {
        return mesh.clone();
    }
    let mut triangle_stays = vec![true; mesh.triangles.len()];
    for (piece, &stays) in pieces.iter().zip(stays) {
        for &t in &piece.triangles {
            triangle_stays[t as usize] = stays;
        }
    }
    let triangles: Vec<[u32; 3]> =
        mesh.triangles.iter().zip(&triangle_stays).filter(|&(_, &s)| s).map(|(&t, _)| t).collect();
    compact(&mesh.positions_m, &triangles)
}
