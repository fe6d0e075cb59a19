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

/// The triangles of `tets` that belong to one of them alone, ascending; an error with one that belongs to more
/// than two, or to two on the same side of it.
fn outer_sides(tets: impl Iterator<Item = [NodeId; 4]>) -> Result<Vec<Side>, Side> {
    let mut sides: Vec<Side> =
        tets.flat_map(|corners| (0..TET_TRIANGLES.len()).map(move |face| Side::of(corners, face))).collect();
    sides.sort_unstable();
    let mut outer = Vec::new();
    for same in sides.chunk_by(|a, b| a.triangle() == b.triangle()) {
        match same {
            [alone] => outer.push(*alone),
            [a, b] if !a.is_odd() && b.is_odd() => {}
            _ => return Err(same[0]),
        }
    }
    Ok(outer)
}

fn differs(side: Side) -> EditError {
    let [a, b, c] = side.nodes();
    EditError::OuterTriangleDiffers { nodes: if side.is_odd() { [a, c, b] } else { [a, b, c] } }
}

impl EditableMesh {
    /// Refuses new tetrahedra whose outer triangles are not those of the old ones, or whose inner triangles
    /// are triangles of others.
    pub(super) fn check_outer_sides(&self, plan: &Plan, new: &[[NodeId; 4]]) -> Result<(), EditError> {
        let old =
            outer_sides(plan.doomed.iter().map(|&tet| self.topology.tet_nodes(tet))).map_err(differs)?;
        let outer = outer_sides(new.iter().copied()).map_err(differs)?;
        if let Some(&other) = old
            .iter()
            .find(|s| outer.binary_search(s).is_err())
            .or_else(|| outer.iter().find(|s| old.binary_search(s).is_err()))
        {
            return Err(differs(other));
        }
        self.check_inner_sides(plan, new, &outer)
    }

    /// Refuses new tetrahedra with an inner triangle that one which stays has already.
    fn check_inner_sides(&self, plan: &Plan, new: &[[NodeId; 4]], outer: &[Side]) -> Result<(), EditError> {
        let n_nodes = self.topology.n_nodes();
        for &corners in new {
            for face in 0..4 {
                let side = Side::of(corners, face);
                let nodes = side.nodes();
                if nodes[2].index() >= n_nodes || outer.binary_search(&side).is_ok() {
                    continue;
                }
                let Some(triangle) = self.topology.triangle_between(nodes) else { continue };
                let of_others = |tet: TetId| plan.doomed.binary_search(&tet).is_err();
                if self.topology.triangle_tets(triangle).into_iter().filter_map(|t| t.get()).any(of_others) {
                    return Err(differs(side));
                }
            }
        }
        Ok(())
    }

    /// Refuses tetrahedra that leave a triangle towards a neighbour that stays without its other side, or that
    /// meet others in a triangle from the same side.
    pub(super) fn check_borders(&self, plan: &Plan, new: &[[NodeId; 4]]) -> Result<(), EditError> {
        let outer = outer_sides(new.iter().copied()).map_err(differs)?;
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
        self.check_inner_sides(plan, new, &outer)
    }
}
