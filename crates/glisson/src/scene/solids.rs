//! Closed surfaces of simple solids, to be filled with tetrahedra.

use crate::math::DVec3;
use crate::surface::TriMesh;
use std::f64::consts::{FRAC_PI_2, PI, TAU};

/// Sides of the polygon that stands for the circle of a cylinder, and rings of triangles on a ball.
const N_AROUND: u32 = 48;
/// Rings of a tube between two points of its path, and at each rounded end. Choices.
const RINGS_BETWEEN: u32 = 12;
const RINGS_AT_END: u32 = 8;

/// A ball.
pub(super) fn ball(center_m: DVec3, radius_m: f64) -> TriMesh {
    let (n_around, n_rings) = (N_AROUND, N_AROUND / 2);
    let mut surface = TriMesh::default();
    surface.positions_m.push(center_m + DVec3::Z * radius_m);
    for ring in 1..n_rings {
        let polar = PI * f64::from(ring) / f64::from(n_rings);
        for i in 0..n_around {
            let angle = TAU * f64::from(i) / f64::from(n_around);
            let around = DVec3::new(libm::cos(angle), libm::sin(angle), 0.0) * libm::sin(polar);
            surface.positions_m.push(center_m + (around + DVec3::Z * libm::cos(polar)) * radius_m);
        }
    }
    surface.positions_m.push(center_m - DVec3::Z * radius_m);
    let last = surface.positions_m.len() as u32 - 1;
    let at = |ring: u32, i: u32| 1 + (ring - 1) * n_around + i % n_around;
    for i in 0..n_around {
        surface.triangles.push([0, at(1, i), at(1, i + 1)]);
        for ring in 1..n_rings - 1 {
            let (a, b) = (at(ring, i), at(ring, i + 1));
            let (c, d) = (at(ring + 1, i), at(ring + 1, i + 1));
            surface.triangles.extend([[a, c, d], [a, d, b]]);
        }
        surface.triangles.push([last, at(n_rings - 1, i + 1), at(n_rings - 1, i)]);
    }
    surface
}

/// A cylinder between the centres of its ends.
pub(super) fn cylinder(from_m: DVec3, to_m: DVec3, radius_m: f64) -> TriMesh {
    let axis = (to_m - from_m).normalize();
    let (x, y) = axis.any_orthonormal_pair();
    let n_around = N_AROUND;
    let mut surface = TriMesh::default();
    for end_m in [from_m, to_m] {
        for i in 0..n_around {
            let angle = TAU * f64::from(i) / f64::from(n_around);
            surface.positions_m.push(end_m + (x * libm::cos(angle) + y * libm::sin(angle)) * radius_m);
        }
    }
    let (base, top) = (2 * n_around, 2 * n_around + 1);
    surface.positions_m.extend([from_m, to_m]);
    for i in 0..n_around {
        let (a, b) = (i, (i + 1) % n_around);
        let (c, d) = (a + n_around, b + n_around);
        surface.triangles.extend([[a, b, d], [a, d, c], [base, b, a], [top, c, d]]);
    }
    surface
}

/// A tube around a smooth line through points (Catmull and Rom 1974), with a radius at each, and rounded ends.
pub(super) fn tube(path_m: &[DVec3], radii_m: &[f64]) -> TriMesh {
    let spine = spine(path_m, radii_m);
    let direction = |i: usize| {
        let (before, after) = (spine[i.saturating_sub(1)].0, spine[(i + 1).min(spine.len() - 1)].0);
        (after - before).normalize()
    };
    let mut across = direction(0).any_orthonormal_vector();
    let mut rings = Vec::new();
    for (i, &(center_m, radius_m)) in spine.iter().enumerate() {
        // Carried along without turning about the line; seen from outside, the surface runs clockwise about it.
        let along = direction(i);
        across = (across - along * across.dot(along)).normalize();
        let ring = Ring { center_m, radius_m, across: [across, across.cross(along)] };
        if i == 0 {
            rings.extend((1..=RINGS_AT_END).map(|k| ring.in_end(-along, k)));
        }
        rings.push(ring);
        if i == spine.len() - 1 {
            rings.extend((1..=RINGS_AT_END).rev().map(|k| ring.in_end(along, k)));
        }
    }
    let [(first_m, first_radius_m), (last_m, last_radius_m)] = [spine[0], spine[spine.len() - 1]];
    let ends_m =
        [first_m - direction(0) * first_radius_m, last_m + direction(spine.len() - 1) * last_radius_m];
    through_rings(&rings, ends_m)
}

/// Centres and radii along a tube. A radius is between those of the points beside it.
fn spine(path_m: &[DVec3], radii_m: &[f64]) -> Vec<(DVec3, f64)> {
    let last = path_m.len() - 1;
    let mut spine = Vec::new();
    for i in 0..last {
        let [b, c] = [path_m[i], path_m[i + 1]];
        // At the ends the line goes on as it came.
        let a = if i > 0 { path_m[i - 1] } else { b * 2.0 - c };
        let d = if i + 1 < last { path_m[i + 2] } else { c * 2.0 - b };
        for k in 0..RINGS_BETWEEN {
            let t = f64::from(k) / f64::from(RINGS_BETWEEN);
            let bend = (c - a) * t
                + (a * 2.0 - b * 5.0 + c * 4.0 - d) * (t * t)
                + (b * 3.0 - a - c * 3.0 + d) * (t * t * t);
            let smooth = t * t * (3.0 - 2.0 * t);
            spine.push((b + bend * 0.5, radii_m[i] + (radii_m[i + 1] - radii_m[i]) * smooth));
        }
    }
    spine.push((path_m[last], radii_m[last]));
    spine
}

/// A circle of vertices; seen from the side to which the next rings lie, they run clockwise.
#[derive(Clone, Copy)]
struct Ring {
    center_m: DVec3,
    radius_m: f64,
    across: [DVec3; 2],
}

impl Ring {
    /// A ring of the half ball that closes this one in a direction; number `k` from the pole.
    fn in_end(&self, outward: DVec3, k: u32) -> Self {
        let angle = FRAC_PI_2 * f64::from(k) / f64::from(RINGS_AT_END + 1);
        Self {
            center_m: self.center_m + outward * (self.radius_m * libm::cos(angle)),
            radius_m: self.radius_m * libm::sin(angle),
            ..*self
        }
    }
}

/// The surface through rings, closed by a point at each end.
fn through_rings(rings: &[Ring], [first_m, last_m]: [DVec3; 2]) -> TriMesh {
    let mut surface = TriMesh::default();
    for ring in rings {
        let [x, y] = ring.across;
        surface.positions_m.extend((0..N_AROUND).map(|i| {
            let angle = TAU * f64::from(i) / f64::from(N_AROUND);
            ring.center_m + (x * libm::cos(angle) + y * libm::sin(angle)) * ring.radius_m
        }));
    }
    let first = surface.positions_m.len() as u32;
    surface.positions_m.extend([first_m, last_m]);
    let (last, n_rings) = (first + 1, rings.len() as u32);
    let at = |ring: u32, i: u32| ring * N_AROUND + i % N_AROUND;
    for i in 0..N_AROUND {
        surface.triangles.push([first, at(0, i), at(0, i + 1)]);
        for ring in 0..n_rings - 1 {
            let (a, b) = (at(ring, i), at(ring, i + 1));
            let (c, d) = (at(ring + 1, i), at(ring + 1, i + 1));
            surface.triangles.extend([[a, c, d], [a, d, b]]);
        }
        surface.triangles.push([last, at(n_rings - 1, i + 1), at(n_rings - 1, i)]);
    }
    surface
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::surface::check::check_closed;

    #[test]
    fn solids_are_closed_and_face_outward() {
        let bent = [DVec3::ZERO, DVec3::X, DVec3::new(2.0, 1.0, 0.0), DVec3::new(2.0, 2.0, 1.0)];
        let solids = [
            (ball(DVec3::Y, 0.5), 4.0 / 3.0 * PI * 0.125),
            (cylinder(DVec3::ZERO, DVec3::new(1.0, 2.0, 2.0), 0.5), PI * 0.25 * 3.0),
            (tube(&[DVec3::ZERO, DVec3::Z * 3.0], &[0.5, 0.5]), PI * 0.25 * 3.0 + 4.0 / 3.0 * PI * 0.125),
        ];
        for (surface, volume_m3) in solids {
            check_closed(&surface).unwrap();
            let off = surface.volume_m3() / volume_m3 - 1.0;
            assert!(off.abs() < 0.01, "{off}");
        }
        let surface = tube(&bent, &[0.3, 0.2, 0.1, 0.1]);
        check_closed(&surface).unwrap();
        assert!(surface.volume_m3() > 0.2, "{}", surface.volume_m3());
    }

    #[test]
    fn a_tube_goes_through_its_points_with_their_radii() {
        let path = [DVec3::ZERO, DVec3::X, DVec3::new(2.0, 1.0, 0.0)];
        let along = spine(&path, &[0.3, 0.2, 0.1]);
        for (nth, point) in path.iter().enumerate() {
            let (center_m, radius_m) = along[nth * RINGS_BETWEEN as usize];
            assert!(center_m.distance(*point) < 1e-12);
            assert!((radius_m - [0.3, 0.2, 0.1][nth]).abs() < 1e-12);
        }
        let straight = spine(&[DVec3::ZERO, DVec3::X], &[0.2, 0.1]);
        assert!(straight.iter().all(|(center_m, _)| center_m.y.abs() + center_m.z.abs() < 1e-12));
        assert!(straight.windows(2).all(|pair| pair[1].0.x > pair[0].0.x && pair[1].1 <= pair[0].1));
    }
}
