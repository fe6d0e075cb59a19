//! How well shaped the tetrahedra around a node are: the measure that guards every move.

use super::complex::{Complex, Stars};
use crate::math::DVec3;
use crate::mesh::quality::FACES;

/// Worse than every angle: a tetrahedron that is flat or inside out.
const INVERTED: f64 = 2.0;

/// Tetrahedra of the outside may have any shape above this part of the cubed cell: they only keep borders apart.
const LEAST_OUTSIDE_VOLUME_OVER_CELL: f64 = 1e-5;

/// Large angles weigh as small ones do whose cosine is greater by this: 160 degrees as 12.
const LARGE_ANGLE_OFFSET: f64 = 0.038;

/// Largest cosine of the six dihedral angles, thus of the smallest angle, or what a large angle counts as;
/// [`INVERTED`] if flat or inside out.
pub(super) fn worst_cosine(corners_m: [DVec3; 4]) -> f64 {
    if volume6(corners_m) <= 0.0 {
        return INVERTED;
    }
    let mut normals = [DVec3::ZERO; 4];
    for (normal, [p, q, r]) in normals.iter_mut().zip(FACES) {
        let across = (corners_m[q] - corners_m[p]).cross(corners_m[r] - corners_m[p]);
        *normal = across * (1.0 / across.length());
    }
    let [m, n, o, p] = normals;
    let cosines = [-m.dot(n), -m.dot(o), -m.dot(p), -n.dot(o), -n.dot(p), -o.dot(p)];
    let [low, high] = cosines.iter().fold([1.0f64, -1.0f64], |[l, h], &c| [l.min(c), h.max(c)]);
    let worst = high.max(LARGE_ANGLE_OFFSET - low);
    if worst.is_finite() { worst } else { INVERTED }
}

fn volume6([a, b, c, d]: [DVec3; 4]) -> f64 {
    (b - a).cross(c - a).dot(d - a)
}

/// What a tetrahedron of the outside has to hold at least [m3]: the same for each of its nodes, whatever cells are around these.
fn least_outside_m3(complex: &Complex, tet: u32) -> f64 {
    let cells_m = complex.tets[tet as usize].map(|n| complex.cell_m[n as usize]);
    let cell_m = cells_m.into_iter().fold(f64::INFINITY, f64::min);
    LEAST_OUTSIDE_VOLUME_OVER_CELL * cell_m * cell_m * cell_m
}

/// Judges the tetrahedra around nodes.
#[derive(Clone, Copy, Debug)]
pub(super) struct StarShape<'a> {
    /// Tetrahedra at each node.
    pub(super) stars: &'a Stars,
}

impl StarShape<'_> {
    /// Largest cosine around `node` if it lay at `at_m`, and the tetrahedron that has it.
    pub(super) fn worst_at(&self, complex: &Complex, node: usize, at_m: DVec3) -> (f64, u32) {
        self.worst_below(complex, node, at_m, f64::INFINITY)
    }

    /// As [`StarShape::worst_at`], but done as soon as one is above `limit`.
    fn worst_below(&self, complex: &Complex, node: usize, at_m: DVec3, limit: f64) -> (f64, u32) {
        let mut worst = (-1.0, u32::MAX);
        for &tet in self.stars.at(node) {
            let corners_m = complex.tets[tet as usize].map(|n| match n as usize == node {
                true => at_m,
                false => complex.positions_m[n as usize],
            });
            let cosine = if complex.tet_regions[tet as usize] != 0 {
                worst_cosine(corners_m)
            } else if volume6(corners_m) > 6.0 * least_outside_m3(complex, tet) {
                -1.0
            } else {
                INVERTED
            };
            if cosine > worst.0 {
                worst = (cosine, tet);
                if cosine > limit {
                    break;
                }
            }
        }
        worst
    }

    /// Whether all cosines around `node` would be at most `limit` if it lay at `at_m`.
    pub(super) fn is_within(&self, complex: &Complex, node: usize, at_m: DVec3, limit: f64) -> bool {
        self.worst_below(complex, node, at_m, limit).0 <= limit
    }
}
