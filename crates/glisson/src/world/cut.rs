//! What the instrument would cut: the tetrahedra at its tip.

use super::World;
use crate::math::{DVec3, closest_point_barycentric, tetrahedron_volume_m3};
use crate::mesh::TetId;
use crate::mesh::topology::TET_TRIANGLES;

/// A tip that stands on the surface touches it but for rounding: this share of its radius is added to it.
const REACH: f64 = 1.01;

impl World {
    /// The live tetrahedra that the tip touches, in their present shape, ascending.
    pub fn touched_tetrahedra(&self) -> Vec<TetId> {
        let positions_m = self.model.state().positions_m;
        let (tip_m, reach_m) = (self.tool.tip_in_world_m, REACH * self.spec.tool.tip_radius_m);
        let topology = self.organ.body().topology();
        topology
            .live_tets()
            .filter(|&tet| {
                let corners_m = topology.tet_nodes(tet).map(|n| positions_m[n.index()]);
                is_within(tip_m, reach_m, corners_m)
            })
            .collect()
    }
}

/// Whether a point lies in a tetrahedron or no further from it than `reach_m`.
fn is_within(point_m: DVec3, reach_m: f64, corners_m: [DVec3; 4]) -> bool {
    let low_m = corners_m.into_iter().fold(corners_m[0], DVec3::min) - reach_m;
    let high_m = corners_m.into_iter().fold(corners_m[0], DVec3::max) + reach_m;
    if !(point_m.cmpge(low_m).all() && point_m.cmple(high_m).all()) {
        return false;
    }
    let volume_m3 = tetrahedron_volume_m3(corners_m);
    let is_inside = (0..4).all(|i| {
        let mut part_m = corners_m;
        part_m[i] = point_m;
        tetrahedron_volume_m3(part_m) * volume_m3.signum() >= 0.0
    });
    is_inside
        || TET_TRIANGLES.into_iter().any(|triangle| {
            let [a, b, c] = triangle.map(|i| corners_m[i]);
            let [u, v, w] = closest_point_barycentric(point_m, [a, b, c]);
            (a * u + b * v + c * w).distance(point_m) <= reach_m
        })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_point_touches_what_it_lies_in_and_what_is_near() {
        let corners_m = [DVec3::ZERO, DVec3::X, DVec3::Y, DVec3::Z];
        assert!(is_within(DVec3::splat(0.2), 1e-9, corners_m));
        assert!(is_within(DVec3::new(0.2, 0.2, -0.1), 0.11, corners_m));
        assert!(!is_within(DVec3::new(0.2, 0.2, -0.1), 0.09, corners_m));
        assert!(is_within(DVec3::new(1.1, 0.0, 0.0), 0.11, corners_m));
        // In the box around it, but beyond the slanted face.
        assert!(!is_within(DVec3::splat(0.6), 0.2, corners_m));
        let [a, b, c, d] = corners_m;
        assert!(is_within(DVec3::splat(0.2), 1e-9, [b, a, c, d]), "an inverted one as well");
    }
}
