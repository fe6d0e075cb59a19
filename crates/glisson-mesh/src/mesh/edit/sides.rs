//! Triangles that bound some tetrahedra, and whether others fit within.

use super::plan::Plan;
use super::{EditError, EditableMesh};
use crate::mesh::topology::TET_TRIANGLES;
use crate::mesh::topology::build::sorted_face;
use crate::mesh::{NodeId, TetId};

/// A triangle by ascending nodes, 32 bits each, and whether its outward order is an odd permutation of them: one number
/// sorts several times as fast as four.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
struct Side(u128);

impl Side {
    fn of(corners: [NodeId; 4], face: usize) -> Self {
        let ([a, b, c], odd) = sorted_face(corners, face);
        Self(u128::from(a) << 65 | u128::from(b) << 33 | u128::from(c) << 1 | u128::from(odd))
    }

    /// The triangle alone.
    fn triangle(self) -> u128 {
        self.0 >> 1
    }

    fn is_odd(self) -> bool {
        self.0 & 1 == 1
    }

    /// Ascending.
    fn nodes(self) -> [NodeId; 3] {
        [65, 33, 1].map(|shift| NodeId((self.0 >> shift) as u32))
    }
}

/// The triangles of some tetrahedra, both lists ascending.
struct Sides {
    /// Those that belong to one of them alone.
    outer: Vec<Side>,
    /// Those between two of them, in the order that is not odd.
    inner: Vec<Side>,
}

/// The triangles of `tets`; an error with one that belongs to more than two, or to two on the same side of it.
fn sides_of(tets: impl Iterator<Item = [NodeId; 4]>) -> Result<Sides, Side> {
    let mut sides: Vec<Side> =
        tets.flat_map(|corners| (0..TET_TRIANGLES.len()).map(move |face| Side::of(corners, face))).collect();
    sides.sort_unstable();
    let mut found =
        Sides { outer: Vec::with_capacity(sides.len()), inner: Vec::with_capacity(sides.len() / 2) };
    for same in sides.chunk_by(|a, b| a.triangle() == b.triangle()) {
        match same {
            [alone] => found.outer.push(*alone),
            [a, b] if !a.is_odd() && b.is_odd() => found.inner.push(*a),
            _ => return Err(same[0]),
        }
    }
    Ok(found)
}

fn differs(side: Side) -> EditError {
    let [a, b, c] = side.nodes();
    EditError::OuterTriangleDiffers { nodes: if side.is_odd() { [a, c, b] } else { [a, b, c] } }
}

impl EditableMesh {
    /// Refuses new tetrahedra whose outer triangles are not those of the old ones, or whose inner triangles
    /// are triangles of others.
    pub(super) fn check_outer_sides(&self, plan: &Plan, new: &[[NodeId; 4]]) -> Result<(), EditError> {
        let old = plan.doomed.iter().map(|&tet| self.topology.tet_nodes(tet));
        let Sides { outer: old, .. } = sides_of(old).map_err(differs)?;
        let Sides { outer, inner } = sides_of(new.iter().copied()).map_err(differs)?;
        if let Some(&other) = old
            .iter()
            .find(|s| outer.binary_search(s).is_err())
            .or_else(|| outer.iter().find(|s| old.binary_search(s).is_err()))
        {
            return Err(differs(other));
        }
        self.check_inner_sides(plan, &inner)
    }

    /// Refuses triangles between two new tetrahedra that one which stays has already.
    fn check_inner_sides(&self, plan: &Plan, inner: &[Side]) -> Result<(), EditError> {
        let n_nodes = self.topology.n_nodes();
        for &side in inner {
            let nodes = side.nodes();
            if nodes[2].index() >= n_nodes {
                continue;
            }
            let Some(triangle) = self.topology.triangle_between(nodes) else { continue };
            let of_others = |tet: TetId| plan.doomed.binary_search(&tet).is_err();
            if self.topology.triangle_tets(triangle).into_iter().filter_map(|t| t.get()).any(of_others) {
                return Err(differs(side));
            }
        }
        Ok(())
    }

    /// Refuses tetrahedra that leave a triangle towards a neighbour that stays without its other side, or that
    /// meet others in a triangle from the same side.
    pub(super) fn check_borders(&self, plan: &Plan, new: &[[NodeId; 4]]) -> Result<(), EditError> {
        let Sides { outer, inner } = sides_of(new.iter().copied()).map_err(differs)?;
        let stays = |tet: TetId| plan.doomed.binary_search(&tet).is_err();
        let mut n_borders = 0;
        for &tet in &plan.doomed {
            for (face, neighbour) in self.topology.tet_neighbours(tet).into_iter().enumerate() {
                if neighbour.get().is_some_and(stays) {
                    let border = Side::of(self.topology.tet_nodes(tet), face);
                    n_borders += 1;
                    if outer.binary_search(&border).is_err() {
                        return Err(differs(border));
                    }
                }
            }
        }
        // No other triangle may meet a tetrahedron that stays.
        let n_nodes = self.topology.n_nodes();
        let mut n_meetings = 0;
        for &side in &outer {
            let nodes = side.nodes();
            if nodes[2].index() >= n_nodes {
                continue;
            }
            let Some(triangle) = self.topology.triangle_between(nodes) else { continue };
            if self.topology.triangle_tets(triangle).into_iter().filter_map(|t| t.get()).any(stays) {
                n_meetings += 1;
                if n_meetings > n_borders {
                    return Err(differs(side));
                }
            }
        }
        self.check_inner_sides(plan, &inner)
    }
}
