//! How deep two parts of a body are in each other: a plain measure, tetrahedron by tetrahedron, for tests and validation.

use super::triangles::{at_weights, closest_weights};
use crate::math::{DVec3, tetrahedron_volume_m3};
use crate::mesh::{NodeId, TetMesh};
use std::collections::BTreeMap;

/// The deepest node of one part inside the tetrahedra of the other, either way: its distance from the other's surface [m], 0
/// if they do not cross. `part` tells by the place at rest which of the two a node or the middle of a tetrahedron belongs to,
/// `None` for neither; `is_live` tells which tetrahedra of `rest` there are, and the nodes are at `now_m`.
pub fn crossing_m(
    rest: &TetMesh,
    is_live: &[bool],
    now_m: &[DVec3],
    part: impl Fn(DVec3) -> Option<bool>,
) -> f64 {
    let mut deepest_m = 0.0_f64;
    for side in [false, true] {
        let mut tets = Vec::new();
        let mut faces: BTreeMap<[NodeId; 3], usize> = BTreeMap::new();
        for (tet, _) in rest.tetrahedra.iter().zip(is_live).filter(|(_, is_live)| **is_live) {
            let middle_m = tet.iter().map(|n| rest.positions_m[n.index()]).sum::<DVec3>() / 4.0;
            if part(middle_m) == Some(side) {
                tets.push(tet.map(|n| now_m[n.index()]));
                for [i, j, k] in [[0, 1, 2], [0, 1, 3], [0, 2, 3], [1, 2, 3]] {
                    let mut face = [tet[i], tet[j], tet[k]];
                    face.sort_unstable();
                    *faces.entry(face).or_default() += 1;
                }
            }
        }
        let others = rest.positions_m.iter().zip(now_m).filter(|(rest_m, _)| part(**rest_m) == Some(!side));
        for (_, &p) in others {
            if tets.iter().any(|&tet| is_inside(p, tet)) {
                let outer = faces.iter().filter(|(_, count)| **count == 1);
                let distances_m = outer.map(|(face, _)| {
                    let corners_m = face.map(|n| now_m[n.index()]);
                    at_weights(corners_m, closest_weights(p, corners_m)).distance(p)
                });
                deepest_m = deepest_m.max(distances_m.fold(f64::INFINITY, f64::min));
            }
        }
    }
    deepest_m
}

/// Whether a point is in a tetrahedron, whichever way round that is.
fn is_inside(p: DVec3, [a, b, c, d]: [DVec3; 4]) -> bool {
    let whole = tetrahedron_volume_m3([a, b, c, d]);
    let parts = [[p, b, c, d], [a, p, c, d], [a, b, p, d], [a, b, c, p]].map(tetrahedron_volume_m3);
    parts.iter().all(|part| part / whole >= 0.0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::box_mesh::box_of_five;

    #[test]
    fn a_box_pushed_into_another_crosses_it_by_the_way_of_its_nodes() {
        // Two unit boxes with a gap of 1 between them; the right one, of eight cells, is pushed to the left.
        let mut rest = box_of_five([1; 3], DVec3::ONE);
        let right = box_of_five([2; 3], DVec3::ONE);
        let n_left = rest.positions_m.len();
        rest.positions_m.extend(right.positions_m.iter().map(|&p| p + DVec3::new(2.0, 0.1, 0.1)));
        let moved = |tet: &[NodeId; 4]| tet.map(|n| NodeId::from_index(n.index() + n_left));
        rest.tetrahedra.extend(right.tetrahedra.iter().map(moved));
        let part = |rest_m: DVec3| Some(rest_m.x > 1.5);
        let mut is_live = vec![true; rest.tetrahedra.len()];
        let crossing_after_m = |way_m: f64, is_live: &[bool]| {
            let mut now_m = rest.positions_m.clone();
            now_m[n_left..].iter_mut().for_each(|p| p.x -= way_m);
            crossing_m(&rest, is_live, &now_m, part)
        };
        assert_eq!(crossing_after_m(0.99, &is_live), 0.0);
        assert!((crossing_after_m(1.25, &is_live) - 0.25).abs() < 1e-12);
        // Where the tetrahedra are gone there is nothing to be inside of.
        is_live[..5].fill(false);
        let without_left_m = crossing_after_m(1.25, &is_live);
        assert!(without_left_m < 0.25, "{without_left_m}");
    }
}
