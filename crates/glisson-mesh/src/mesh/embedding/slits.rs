//! Slits that end inside a tetrahedron.
//!
//! A piece with a slit hangs together around the slit's end, so that one copy would carry it, and the slit would stay shut there and
//! in all elements that share a node with it: every cut would open as one that is shallower by most of an element. So a slit counts as
//! going all through each piece that it goes into, and all along a face of an uncut tetrahedron if it lies in more than half of it. A
//! slit in a block opens so as in a conforming mesh, to a few per cent and to either side (`validate embedded_cuts`). Seen from the cut mesh, tissue
//! beside the last part of such a slit is carried by the copy of one side or of the other.

use crate::disjoint_sets::DisjointSets;
use crate::math::DVec3;
use crate::mesh::{NodeId, TetMesh};

/// A face of a tetrahedron, corners ascending, and the tetrahedron's place in the list at hand.
pub(super) type Face = ([NodeId; 3], u32);

/// Faces of one plane differ by this share of the piece's size, and in the cosine of their normals by this much.
const SAME_PLANE: f64 = 1e-7;

/// Spreads bits: the golden ratio in 64 bits (Knuth 1998, The Art of Computer Programming 3, s. 6.4).
const SPREAD: u64 = 0x9E37_79B9_7F4A_7C15;

/// A plane of slits.
#[derive(Clone, Copy, Debug)]
struct Plane {
    /// The set of the piece.
    piece: usize,
    normal: DVec3,
    offset_m: f64,
}

/// The planes of slits that end in a piece.
#[derive(Debug, Default)]
pub(super) struct Slits {
    planes: Vec<Plane>,
    same_m: f64,
}

/// Sorts faces; one number sorts faster than four.
pub(super) fn sort_faces(faces: &mut [Face]) {
    let number = |([a, b, c], at): &Face| {
        u128::from(a.0) << 96 | u128::from(b.0) << 64 | u128::from(c.0) << 32 | u128::from(*at)
    };
    faces.sort_unstable_by_key(number);
}

/// Sets of tetrahedra that hang together by faces which `holds` takes. `faces`: of `n` tetrahedra, ascending.
pub(super) fn joined_pieces(faces: &[Face], n: usize, mut holds: impl FnMut(&Face) -> bool) -> DisjointSets {
    let mut sets = DisjointSets::new(n);
    for pair in faces.windows(2).filter(|pair| pair[0].0 == pair[1].0 && holds(&pair[0])) {
        sets.join(pair[0].1 as usize, pair[1].1 as usize);
    }
    sets
}

impl Slits {
    /// Of the pieces `sets` of one tetrahedron from before all cuts, whose tetrahedra have these faces.
    pub(super) fn in_piece(cut: &TetMesh, faces: &[Face], sets: &mut DisjointSets) -> Self {
        let mut found = Self::default();
        let slits = slit_faces(cut, faces);
        if slits.is_empty() {
            return found;
        }
        let size_m = faces.iter().map(|(face, _)| longest_m(cut, *face)).fold(0.0, f64::max);
        found.same_m = SAME_PLANE * size_m;
        for [(face, a), (_, b)] in slits {
            let piece = sets.root(a as usize);
            if piece == sets.root(b as usize) {
                found.add(cut, face, piece);
            }
        }
        found
    }

    pub(super) fn is_empty(&self) -> bool {
        self.planes.is_empty()
    }

    /// Whether a face in the piece is one that they part.
    pub(super) fn take(&self, cut: &TetMesh, face: [NodeId; 3], piece: usize) -> bool {
        let is_on = |plane: &Plane| {
            let beside_m =
                |node: NodeId| (plane.normal.dot(cut.positions_m[node.index()]) - plane.offset_m).abs();
            face.into_iter().all(|node| beside_m(node) <= self.same_m)
        };
        self.planes.iter().any(|plane| plane.piece == piece && is_on(plane))
    }

    fn add(&mut self, cut: &TetMesh, face: [NodeId; 3], piece: usize) {
        if self.take(cut, face, piece) {
            return;
        }
        if let Some(normal) = area_vector_m2(cut, face).try_normalize() {
            let offset_m = normal.dot(cut.positions_m[face[0].index()]);
            self.planes.push(Plane { piece, normal, offset_m });
        }
    }
}

/// Pairs of candidates, the first before the second, between which a slit lies on more than half of the face that they share.
/// `faces`: of all candidates' tetrahedra, with the candidates' numbers, ascending.
pub(super) fn slits_between(cut: &TetMesh, faces: &[Face]) -> Vec<[u32; 2]> {
    // Open area counts, closed area counts against it.
    let signed = |face: [NodeId; 3], [a, b]: [u32; 2], sign: f64| {
        ([a.min(b), a.max(b)], sign * area_vector_m2(cut, face).length())
    };
    let open = slit_faces(cut, faces);
    let between = open.iter().filter(|[(_, a), (_, b)]| a != b);
    let mut areas: Vec<([u32; 2], f64)> =
        between.map(|&[(face, a), (_, b)]| signed(face, [a, b], 1.0)).collect();
    if areas.is_empty() {
        return Vec::new();
    }
    areas.sort_by_key(|(pair, _)| *pair);
    let n_open = areas.len();
    for pair in faces.windows(2).filter(|pair| pair[0].0 == pair[1].0) {
        let closed = signed(pair[0].0, [pair[0].1, pair[1].1], -1.0);
        if areas[..n_open].binary_search_by_key(&closed.0, |(pair, _)| *pair).is_ok() {
            areas.push(closed);
        }
    }
    areas.sort_by_key(|(pair, _)| *pair);
    let of_pair = areas.chunk_by(|a, b| a.0 == b.0);
    let is_open = |same: &&[([u32; 2], f64)]| same.iter().map(|(_, area_m2)| area_m2).sum::<f64>() > 0.0;
    of_pair.filter(is_open).map(|same| same[0].0).collect()
}

/// Both sides of slits: faces of one tetrahedron alone with their corners at the same places at rest.
fn slit_faces(cut: &TetMesh, faces: &[Face]) -> Vec<[Face; 2]> {
    let is_other =
        |at: usize, other: Option<usize>| other.and_then(|o| faces.get(o)).is_none_or(|f| f.0 != faces[at].0);
    let single = (0..faces.len()).filter(|&at| is_other(at, at.checked_sub(1)) && is_other(at, Some(at + 1)));
    let bits = |node: NodeId| cut.positions_m[node.index()].to_array().map(f64::to_bits);
    let places = |face: [NodeId; 3]| {
        let mut places = face.map(bits);
        places.sort_unstable();
        places
    };
    // A number of the corners' places in any order, so that few faces are looked at closely.
    let number = |face: [NodeId; 3]| {
        let of_node =
            |node: NodeId| bits(node).into_iter().fold(0, |sum: u64, b| (sum ^ b).wrapping_mul(SPREAD));
        face.into_iter().fold(0, |sum: u64, node| sum.wrapping_add(of_node(node) ^ (of_node(node) >> 29)))
    };
    let mut open: Vec<(u64, Face)> = single.map(|at| (number(faces[at].0), faces[at])).collect();
    open.sort_unstable();
    let pairs = open.windows(2).filter(|pair| pair[0].0 == pair[1].0).map(|pair| [pair[0].1, pair[1].1]);
    pairs.filter(|[(a, _), (b, _)]| places(*a) == places(*b)).collect()
}

fn area_vector_m2(cut: &TetMesh, face: [NodeId; 3]) -> DVec3 {
    let [a, b, c] = face.map(|node| cut.positions_m[node.index()]);
    (b - a).cross(c - a) * 0.5
}

fn longest_m(cut: &TetMesh, face: [NodeId; 3]) -> f64 {
    let [a, b, c] = face.map(|node| cut.positions_m[node.index()]);
    a.distance(b).max(b.distance(c)).max(c.distance(a))
}
