//! Generalised winding number of triangles that need not be closed.
//!
//! How often the triangles go around a point q: the sum of their solid angles over 4 pi (A. Jacobson,
//! L. Kavan and O. Sorkine-Hornung, "Robust inside-outside segmentation using generalized winding numbers",
//! 2013, doi 10.1145/2461912.2461916). A whole number for a closed surface; over a hole it passes smoothly
//! from 1 inside to 0 outside.
//!
//! The fast form (G. Barill, N. Dickson, R. Schmidt, D. Levin and A. Jacobson, "Fast winding numbers for
//! soups and clouds", 2018, doi 10.1145/3197517.3201337) replaces far triangles by the first three
//! terms of their expansion about the centre p, with r = p - q, the normals n, and d from p to the points of
//! the triangles:
//!
//! ```text
//! 4 pi w = N . r / |r|^3 + tr(M) / |r|^3 - 3 r . M r / |r|^5
//!          - 3 (sum_i e_i . Q_i r + (1/2) sum_i r_i tr(Q_i)) / |r|^5 + (15/2) sum_i r_i r . Q_i r / |r|^7
//! N = int n,   M = int n d^T,   Q_i = int n_i d d^T
//! ```

use super::TriMesh;
use super::box_tree::{BoxTree, DEEPEST};
use crate::math::{DMat3, DVec3, outer};
use std::f64::consts::PI;

/// A group is far where its centre is more than this many of its radii away: the value of Barill et al.
const FAR_RADII: f64 = 2.0;

/// Solid angle [sr] of a triangle seen from `point_m`, positive from its inner side, 0 at a corner
/// (A. van Oosterom and J. Strackee, "The solid angle of a plane triangle", 1983,
/// doi 10.1109/TBME.1983.325207).
pub fn solid_angle_sr(point_m: DVec3, corners_m: [DVec3; 3]) -> f64 {
    let [a, b, c] = corners_m.map(|p| p - point_m);
    let (la, lb, lc) = (a.length(), b.length(), c.length());
    let below = la * lb * lc + a.dot(b) * lc + b.dot(c) * la + c.dot(a) * lb;
    2.0 * libm::atan2(a.dot(b.cross(c)), below)
}

/// Winding number of all triangles of `mesh` about `point_m`: the exact sum, the reference of
/// [`WindingTree`].
pub fn winding_number(mesh: &TriMesh, point_m: DVec3) -> f64 {
    let angles = (0..mesh.triangles.len()).map(|t| solid_angle_sr(point_m, mesh.corners_m(t)));
    angles.sum::<f64>() / (4.0 * PI)
}

/// What a group of triangles looks like from afar.
struct Group {
    /// Middle, weighted by area [m].
    centre_m: DVec3,
    /// Largest squared distance of a corner from the middle [m2].
    radius_squared_m2: f64,
    /// N of the module's head [m2].
    area_m2: DVec3,
    /// M of the module's head [m3].
    moment_m3: DMat3,
    /// The three Q of the module's head [m4].
    second_m4: [DMat3; 3],
}

/// Triangles arranged for fast winding numbers.
pub struct WindingTree<'a> {
    mesh: &'a TriMesh,
    pub(super) boxes: BoxTree,
    groups: Vec<Group>,
}

impl<'a> WindingTree<'a> {
    /// Arranges the triangles of `mesh`, whose indices must be right.
    pub fn of_triangles(mesh: &'a TriMesh) -> Self {
        let boxes = BoxTree::of_triangles(mesh);
        let group_of = |first: u32, end: u32| Group::of(mesh, &boxes.order[first as usize..end as usize]);
        let groups = boxes.nodes.iter().map(|node| group_of(node.first, node.end)).collect();
        Self { mesh, boxes, groups }
    }

    /// Winding number about `point_m`, within about 0.02 of [`winding_number`].
    pub fn winding_number(&self, point_m: DVec3) -> f64 {
        let mut sum_sr = 0.0;
        let mut pending = [0u32; DEEPEST];
        let mut n_pending = usize::from(!self.groups.is_empty());
        while n_pending > 0 {
            n_pending -= 1;
            let at = pending[n_pending] as usize;
            let group = &self.groups[at];
            let r = group.centre_m - point_m;
            let squared = r.length_squared();
            if squared > FAR_RADII * FAR_RADII * group.radius_squared_m2 {
                sum_sr += group.solid_angle_sr(r, squared);
                continue;
            }
            let node = &self.boxes.nodes[at];
            if let Some(children) = node.children {
                pending[n_pending..n_pending + 2].copy_from_slice(&children);
                n_pending += 2;
            } else {
                for &t in &self.boxes.order[node.first as usize..node.end as usize] {
                    sum_sr += solid_angle_sr(point_m, self.mesh.corners_m(t as usize));
                }
            }
        }
        sum_sr / (4.0 * PI)
    }

    /// The point of the triangles closest to `point_m`, if one is within `reach_m`: its triangle, itself and
    /// its distance [m].
    pub fn closest(&self, point_m: DVec3, reach_m: f64) -> Option<(u32, DVec3, f64)> {
        self.boxes.closest(self.mesh, point_m, reach_m)
    }
}

impl Group {
    fn of(mesh: &TriMesh, triangles: &[u32]) -> Self {
        let (mut area, mut weighted, mut middle) = (0.0, DVec3::ZERO, DVec3::ZERO);
        for &t in triangles {
            let [a, b, c] = mesh.corners_m(t as usize);
            let size = (b - a).cross(c - a).length();
            area += size;
            weighted += size * ((a + b + c) / 3.0);
            middle += (a + b + c) / (3.0 * triangles.len() as f64);
        }
        let centre_m = if area > 0.0 { weighted / area } else { middle };
        let (mut radius_squared_m2, mut area_m2, mut moment_m3) = (0.0f64, DVec3::ZERO, DMat3::ZERO);
        let mut second_m4 = [DMat3::ZERO; 3];
        for &t in triangles {
            let [a, b, c] = mesh.corners_m(t as usize);
            let vector = 0.5 * (b - a).cross(c - a);
            area_m2 += vector;
            moment_m3 += outer(vector, (a + b + c) / 3.0 - centre_m);
            let [a_d, b_d, c_d] = [a, b, c].map(|p| p - centre_m);
            let sum = a_d + b_d + c_d;
            let squares = outer(a_d, a_d) + outer(b_d, b_d) + outer(c_d, c_d) + outer(sum, sum);
            for i in 0..3 {
                second_m4[i] += squares * (vector[i] / 12.0);
            }
            for p in [a, b, c] {
                radius_squared_m2 = radius_squared_m2.max(p.distance_squared(centre_m));
            }
        }
        Self { centre_m, radius_squared_m2, area_m2, moment_m3, second_m4 }
    }

    /// The expansion of the module's head; `r` from the point to the middle, `squared` its square.
    fn solid_angle_sr(&self, r: DVec3, squared: f64) -> f64 {
        let cube = squared * squared.sqrt();
        let m = &self.moment_m3;
        let trace = |m: &DMat3| m.x_axis.x + m.y_axis.y + m.z_axis.z;
        let first = self.area_m2.dot(r) + trace(m) - 3.0 * r.dot(*m * r) / squared;
        let (mut contracted, mut cubic) = (0.0, 0.0);
        for (i, q) in self.second_m4.iter().enumerate() {
            let along = *q * r;
            contracted += along[i] + 0.5 * r[i] * trace(q);
            cubic += r[i] * r.dot(along);
        }
        (first + (7.5 * cubic / squared - 3.0 * contracted) / squared) / cube
    }
}
