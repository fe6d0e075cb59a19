//! What of one lattice tetrahedron is inside: the stencils of isosurface stuffing.
//!
//! Corners are inside (+), on the surface (0, warped there) or outside (-). A tetrahedron without + is
//! dropped, one without - is kept, and of the others the part on the + side of the cut points is kept: a
//! tetrahedron, a pyramid (two tetrahedra) or a triangular prism (three).
//!
//! The quadrilaterals in lattice faces are shared with a neighbour, so their diagonal follows from the face
//! alone. With + corners p, q and - corner n:
//! - one of the cut edges pn, qn is long, the other short: the diagonal ends at the long one's cut point;
//! - both are short (pq is long, along an axis): the diagonal ends at the lower of p, q along that axis when
//!   n's offset from the middle of pq has components of equal sign along the other two axes, else at the
//!   upper. Around a long edge the four faces alternate, so a prism gets its two diagonals from different
//!   corners: without this parity rule the smallest dihedral angle falls from 21.9 to 9.6 degrees in the
//!   prism of a long + edge (worst cases of a random search over all positions of warped corners and cut
//!   points).

use super::lattice::Lattice;

/// Where a lattice node is after warping.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Sign {
    Inside,
    OnSurface,
    Outside,
}

/// Node of the output: lattice node, or cut point of a lattice edge; in the order of the output's numbering.
pub(super) type Key = u32;

/// One lattice tetrahedron, positively oriented: corners 0 and 1 are a long edge, 2 and 3 the other.
pub(super) struct Stencil<'a, C: Fn(usize, usize) -> Key> {
    pub(super) lattice: &'a Lattice,
    pub(super) nodes: [usize; 4],
    pub(super) signs: [Sign; 4],
    /// Key of the cut point of the edge between two lattice nodes, the first inside.
    pub(super) cut: C,
    /// Key of a lattice node.
    pub(super) node_key: fn(usize) -> Key,
}

/// Tetrahedra and surface triangles, by keys.
#[derive(Default)]
pub(super) struct Pieces {
    pub(super) tetrahedra: Vec<[Key; 4]>,
    pub(super) triangles: Vec<[Key; 3]>,
}

fn is_long(a: usize, b: usize) -> bool {
    (a < 2) == (b < 2)
}

/// Even permutation of 0..4 that sorts the signs, inside first, outside last.
fn sorted_corners(signs: &[Sign; 4]) -> [usize; 4] {
    let rank = |s: Sign| match s {
        Sign::Inside => 0,
        Sign::OnSurface => 1,
        Sign::Outside => 2,
    };
    let mut order = [0, 1, 2, 3];
    order.sort_by_key(|&c| rank(signs[c]));
    let inversions =
        (0..4).flat_map(|i| (i + 1..4).map(move |j| (i, j))).filter(|&(i, j)| order[i] > order[j]).count();
    if inversions % 2 == 1 {
        // Four corners of three kinds: two neighbours in the order are of one kind and may change places.
        let twin =
            (0..3).find(|&i| signs[order[i]] == signs[order[i + 1]]).expect("three kinds for four corners");
        order.swap(twin, twin + 1);
    }
    order
}

impl<C: Fn(usize, usize) -> Key> Stencil<'_, C> {
    /// Appends what is inside.
    pub(super) fn fill_into(&self, pieces: &mut Pieces) {
        let count = |sign| self.signs.iter().filter(|s| **s == sign).count();
        let (n_inside, n_outside) = (count(Sign::Inside), count(Sign::Outside));
        if n_inside == 0 {
            return;
        }
        if n_outside == 0 {
            pieces.tetrahedra.push(self.nodes.map(self.node_key));
            return;
        }
        let order = sorted_corners(&self.signs);
        let key = |at: usize| (self.node_key)(self.nodes[order[at]]);
        let cut = |from: usize, to: usize| (self.cut)(self.nodes[order[from]], self.nodes[order[to]]);
        match (n_inside, n_outside) {
            (1, _) => {
                let base =
                    [1, 2, 3].map(|c| if self.signs[order[c]] == Sign::Outside { cut(0, c) } else { key(c) });
                pieces.tetrahedra.push([key(0), base[0], base[1], base[2]]);
                pieces.triangles.push(base);
            }
            (2, 1) => {
                let (p, q, z) = (key(0), key(1), key(2));
                let (cut_p, cut_q) = (cut(0, 3), cut(1, 3));
                if self.diagonal_from_first(order[0], order[1], order[3]) {
                    pieces.tetrahedra.extend([[p, q, z, cut_q], [p, cut_q, z, cut_p]]);
                } else {
                    pieces.tetrahedra.extend([[p, q, z, cut_p], [q, cut_q, z, cut_p]]);
                }
                pieces.triangles.push([cut_q, z, cut_p]);
            }
            (3, 1) => {
                let from_first = |i: usize, j: usize| self.diagonal_from_first(order[i], order[j], order[3]);
                let diagonals = [from_first(0, 1), from_first(0, 2), from_first(1, 2)];
                let top = [cut(0, 3), cut(1, 3), cut(2, 3)];
                split_prism([key(0), key(1), key(2)], top, diagonals, pieces);
                pieces.triangles.push(top);
            }
            (2, 2) => {
                let at_2 = self.diagonal_from_first(order[0], order[1], order[2]);
                let at_3 = self.diagonal_from_first(order[0], order[1], order[3]);
                let bottom = [key(0), cut(0, 2), cut(0, 3)];
                let top = [key(1), cut(1, 2), cut(1, 3)];
                // The rules give different ends at 2 and 3; the surface's diagonal joins their cut points,
                // the one way that makes no cycle.
                split_prism(bottom, top, [at_2, at_3, at_3], pieces);
                if at_3 {
                    pieces.triangles.extend([[bottom[1], bottom[2], top[2]], [bottom[1], top[2], top[1]]]);
                } else {
                    pieces.triangles.extend([[bottom[2], top[2], top[1]], [bottom[2], top[1], bottom[1]]]);
                }
            }
            _ => unreachable!("four corners, at least one inside and one outside"),
        }
    }

    /// Whether the quadrilateral of inside corners p, q and outside corner n is split from p to the cut point
    /// of qn (else from q to that of pn).
    fn diagonal_from_first(&self, p: usize, q: usize, n: usize) -> bool {
        if !is_long(p, q) {
            return is_long(q, n);
        }
        let [p_at, q_at, n_at] = [p, q, n].map(|c| self.lattice.half_cells(self.nodes[c]));
        let axis = (0..3).find(|&a| p_at[a] != q_at[a]).expect("a long edge runs along one axis");
        let offset = |a: usize| n_at[a] - p_at[a];
        let product = offset((axis + 1) % 3) * offset((axis + 2) % 3);
        (product > 0) == (p_at[axis] < q_at[axis])
    }
}

/// Three tetrahedra of the prism with triangle `bottom`, lateral edges bottom[i]-top[i], and orientation such
/// that (bottom, top[2]) is positive. `diagonals` tells of the quadrilaterals 01, 02, 12 whether the first's
/// bottom is joined with the second's top; they must not make a cycle.
fn split_prism(bottom: [Key; 3], top: [Key; 3], diagonals: [bool; 3], pieces: &mut Pieces) {
    // Corners in the order in which each one's bottom is joined to all later ones' tops.
    let (order, odd) = match diagonals {
        [true, true, true] => ([0, 1, 2], false),
        [true, true, false] => ([0, 2, 1], true),
        [false, true, true] => ([1, 0, 2], true),
        [false, false, true] => ([1, 2, 0], false),
        [true, false, false] => ([2, 0, 1], false),
        [false, false, false] => ([2, 1, 0], true),
        [true, false, true] | [false, true, false] => unreachable!("the face rules make no cycle"),
    };
    let [i, j, k] = order;
    let mut split = [
        [bottom[i], bottom[j], bottom[k], top[k]],
        [bottom[i], top[j], bottom[j], top[k]],
        [bottom[i], top[i], top[j], top[k]],
    ];
    if odd {
        for tetrahedron in &mut split {
            tetrahedron.swap(2, 3);
        }
    }
    pieces.tetrahedra.extend(split);
}

#[cfg(test)]
mod tests {
    use super::super::lattice::{OWNED_DIRECTIONS, stepped};
    use super::super::{ALPHA_LONG, ALPHA_SHORT};
    use super::*;
    use crate::math::{DVec3, SeededRandom, tetrahedron_volume_m3};
    use crate::mesh::quality::dihedral_cosine_range;

    const CUT: usize = 1 << 20;

    /// Fills one tetrahedron of random cut points, extreme ones often; gives the corners of the pieces and of
    /// the surface triangles.
    fn random_filling(
        random: &mut SeededRandom,
        signs: [Sign; 4],
    ) -> (Vec<[DVec3; 4]>, Vec<[DVec3; 3]>, [DVec3; 4]) {
        let lattice = Lattice { dims: [5; 3], cell_m: 1.0, origin_m: DVec3::ZERO };
        let steps = lattice.neighbour_steps();
        let even = lattice.node([2, 2, 2], false);
        let axis = (random.next_u64() % 3) as usize;
        let (b, c) = ((axis + 1) % 3, (axis + 2) % 3);
        let ring = [0, 1 << b, 1 << b | 1 << c, 1 << c]
            .map(|bits: usize| stepped(even, steps[0][6 + (bits | 1 << axis)]));
        let corner = (random.next_u64() % 4) as usize;
        let next = stepped(even, steps[0][OWNED_DIRECTIONS[axis]]);
        let nodes = [even, next, ring[corner], ring[(corner + 1) % 4]];
        let corners = nodes.map(|n| lattice.position_m(n));
        let mut cuts = [[DVec3::ZERO; 4]; 4];
        for i in 0..4 {
            for j in i + 1..4 {
                let alpha = if is_long(i, j) { ALPHA_LONG } else { ALPHA_SHORT };
                let part = match random.next_u64() % 3 {
                    0 => alpha,
                    1 => 1.0 - alpha,
                    _ => random.uniform_in(alpha, 1.0 - alpha),
                };
                cuts[i][j] = corners[i] + part * (corners[j] - corners[i]);
                cuts[j][i] = cuts[i][j];
            }
        }
        let at = |node: usize| nodes.iter().position(|&n| n == node).unwrap();
        let cut = |from: usize, to: usize| (CUT + 4 * at(from) + at(to)) as Key;
        let mut pieces = Pieces::default();
        Stencil { lattice: &lattice, nodes, signs, cut, node_key: |n| n as Key }.fill_into(&mut pieces);
        let place = |key: Key| match (key as usize).checked_sub(CUT) {
            Some(cut) => cuts[cut / 4][cut % 4],
            None => lattice.position_m(key as usize),
        };
        let tetrahedra = pieces.tetrahedra.iter().map(|t| t.map(place)).collect();
        (tetrahedra, pieces.triangles.iter().map(|t| t.map(place)).collect(), corners)
    }

    fn random_signs(random: &mut SeededRandom, kinds: &[Sign]) -> [Sign; 4] {
        std::array::from_fn(|_| kinds[(random.next_u64() % kinds.len() as u64) as usize])
    }

    #[test]
    fn without_warping_angles_lie_between_12_7_and_155_degrees() {
        let mut random = SeededRandom::new(8);
        let (mut least, mut most) = (180f64, 0f64);
        for _ in 0..200_000 {
            let signs = random_signs(&mut random, &[Sign::Inside, Sign::Outside]);
            for tetrahedron in random_filling(&mut random, signs).0 {
                let [min, max] = dihedral_cosine_range(tetrahedron);
                (least, most) = (least.min(max.acos().to_degrees()), most.max(min.acos().to_degrees()));
            }
        }
        assert!(least > 12.7 && most < 155.0, "{least} {most}");
        assert!(least < 12.8 && most > 154.9, "the extremes are met: {least} {most}");
    }

    #[test]
    fn pieces_are_positive_and_closed_by_the_surface_triangles() {
        let mut random = SeededRandom::new(9);
        for _ in 0..20_000 {
            let signs = random_signs(&mut random, &[Sign::Inside, Sign::OnSurface, Sign::Outside]);
            let (tetrahedra, triangles, corners) = random_filling(&mut random, signs);
            assert!(tetrahedra.iter().all(|&t| tetrahedron_volume_m3(t) > 1e-4));
            let n_outside = signs.iter().filter(|s| **s == Sign::Outside).count();
            let n_inside = signs.iter().filter(|s| **s == Sign::Inside).count();
            assert_eq!(triangles.is_empty(), n_inside == 0 || n_outside == 0);
            // Seen from an outside corner all surface triangles show their fronts.
            for c in (0..4).filter(|&c| signs[c] == Sign::Outside) {
                for [p, q, r] in &triangles {
                    assert!((*q - *p).cross(*r - *p).dot(corners[c] - *p) > 0.0);
                }
            }
            // What one outside corner cuts off and the rest make up the whole.
            if n_outside == 1 && n_inside == 3 {
                let [p, q, r] = triangles[0];
                let cut_off_m3 = {
                    let c = (0..4).find(|&c| signs[c] == Sign::Outside).unwrap();
                    tetrahedron_volume_m3([p, q, r, corners[c]])
                };
                let kept_m3: f64 = tetrahedra.iter().map(|&t| tetrahedron_volume_m3(t)).sum();
                assert!((kept_m3 + cut_off_m3 - 1.0 / 12.0).abs() < 1e-14);
            }
        }
    }
}
