//! The shape of the surface at a vertex, from the vertex and its three neighbours.
//!
//! The neighbours A, B, C span a plane with unit normal n and lie on a circle of centre c and radius r; with
//! the vertex P they lie on a sphere of radius R. The foot F of P on the plane has barycentric coordinates
//! (e1, e2, e3), the metric parameters, and the distance d from c; h is P's height above the plane.
//!
//! Simplex angle: sin phi = (r / R) sign(h), tan phi = 2 h r / (r^2 - d^2 - h^2), in (-pi, pi). Positive where
//! the surface bulges along n (Delingette's sign is the opposite, with his normals inward).
//! Mean curvature of the sphere through the four points: H = sin phi / r [1/m]; 1 / R on a sphere.
//!
//! P = e1 A + e2 B + e3 C + L(r, d, phi) n, with L = (r^2 - d^2) tan phi / (r + s sqrt(r^2 + (r^2 - d^2) tan^2
//! phi)), s = 1 for |phi| < pi / 2, else -1. Multiplied through by cos phi it has no pole:
//! L = (r^2 - d^2) sin phi / (r cos phi + sqrt(r^2 cos^2 phi + (r^2 - d^2) sin^2 phi)).
//! Valid for d < r; beyond, two heights have the same angle and the upper one comes out.
//! Source: H. Delingette 1999, doi 10.1023/A:1008157432188.

use super::mesh::SimplexMesh;
use crate::math::DVec3;
use rayon::prelude::*;

/// The plane and the circle of a vertex's three neighbours.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct NeighbourCircle {
    /// The neighbours [m].
    pub corners_m: [DVec3; 3],
    /// Unit normal of their plane, outward: the normal of the surface at the vertex.
    pub normal: DVec3,
    /// Centre of the circle through them [m].
    pub centre_m: DVec3,
    /// Its radius r [m].
    pub radius_m: f64,
}

/// Where a vertex is over its neighbours.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct VertexShape {
    /// Barycentric coordinates of the foot; their sum is 1.
    pub metric: [f64; 3],
    /// Height over the neighbours' plane h [m], positive outward.
    pub height_m: f64,
    /// Simplex angle phi [rad].
    pub simplex_angle_rad: f64,
    /// Mean curvature H [1/m], positive where the surface is convex.
    pub mean_curvature_per_m: f64,
}

impl NeighbourCircle {
    /// The circle through three points; none when they are on a line.
    pub fn through(corners_m: [DVec3; 3]) -> Option<Self> {
        let [a, b, c] = corners_m;
        let (u, v) = (b - a, c - a);
        let cross = u.cross(v);
        let squared = cross.length_squared();
        let to_centre =
            (u.length_squared() * v.cross(cross) + v.length_squared() * cross.cross(u)) / (2.0 * squared);
        let circle = Self {
            corners_m,
            normal: cross / squared.sqrt(),
            centre_m: a + to_centre,
            radius_m: to_centre.length(),
        };
        (circle.normal.is_finite() && circle.radius_m.is_finite()).then_some(circle)
    }

    /// The point of the plane with these barycentric coordinates [m].
    pub fn foot_m(&self, metric: [f64; 3]) -> DVec3 {
        self.corners_m.iter().zip(metric).map(|(&p, e)| e * p).sum()
    }

    /// The shape at a vertex `position_m` with these neighbours.
    pub fn shape_of(&self, position_m: DVec3) -> VertexShape {
        let [a, b, c] = self.corners_m;
        let height_m = self.normal.dot(position_m - a);
        let foot_m = position_m - height_m * self.normal;
        let doubled_area = self.normal.dot((b - a).cross(c - a));
        let share = |p: DVec3, q: DVec3| self.normal.dot((p - foot_m).cross(q - foot_m)) / doubled_area;
        let (second, third) = (share(c, a), share(a, b));
        let foot_distance_m = foot_m.distance(self.centre_m);
        let power_m2 = self.radius_m.powi(2) - foot_distance_m.powi(2);
        let simplex_angle_rad = libm::atan2(2.0 * height_m * self.radius_m, power_m2 - height_m * height_m);
        VertexShape {
            metric: [1.0 - second - third, second, third],
            height_m,
            simplex_angle_rad,
            mean_curvature_per_m: libm::sin(simplex_angle_rad) / self.radius_m,
        }
    }

    /// L of the module's head [m].
    pub fn height_of_angle_m(&self, foot_distance_m: f64, simplex_angle_rad: f64) -> f64 {
        let power_m2 = self.radius_m.powi(2) - foot_distance_m.powi(2);
        let (sin, cos) = libm::sincos(simplex_angle_rad);
        let root = ((self.radius_m * cos).powi(2) + power_m2 * sin * sin).max(0.0).sqrt();
        let height_m = power_m2 * sin / (self.radius_m * cos + root);
        // Flat at an angle of 0 or pi over the circle itself.
        if height_m.is_finite() { height_m } else { 0.0 }
    }

    /// The vertex with these metric parameters and this simplex angle [m].
    pub fn vertex_m(&self, metric: [f64; 3], simplex_angle_rad: f64) -> DVec3 {
        let foot_m = self.foot_m(metric);
        let distance_m = foot_m.distance(self.centre_m);
        foot_m + self.height_of_angle_m(distance_m, simplex_angle_rad) * self.normal
    }
}

/// Circle and shape of a vertex of a mesh; none where its neighbours are on a line.
pub fn vertex_shape(mesh: &SimplexMesh, vertex: usize) -> Option<(NeighbourCircle, VertexShape)> {
    let circle = NeighbourCircle::through(mesh.neighbours_m(vertex))?;
    Some((circle, circle.shape_of(mesh.positions_m()[vertex])))
}

/// Circle and shape of every vertex of a mesh.
pub(super) type VertexShapes = Vec<Option<(NeighbourCircle, VertexShape)>>;

/// [`vertex_shape`] of all vertices.
pub(super) fn vertex_shapes(mesh: &SimplexMesh) -> VertexShapes {
    (0..mesh.n_vertices()).into_par_iter().map(|v| vertex_shape(mesh, v)).collect()
}

/// The mean curvatures in `shapes` [1/m].
pub(super) fn mean_curvatures_of(shapes: &[Option<(NeighbourCircle, VertexShape)>]) -> Vec<f64> {
    shapes.iter().map(|s| s.map_or(0.0, |(_, shape)| shape.mean_curvature_per_m)).collect()
}

/// Mean curvature at each vertex [1/m], positive where convex; 0 where the neighbours are on a line.
pub fn mean_curvatures_per_m(mesh: &SimplexMesh) -> Vec<f64> {
    mean_curvatures_of(&vertex_shapes(mesh))
}

/// Outward unit normal at each vertex; zero where the neighbours are on a line.
pub fn vertex_normals(mesh: &SimplexMesh) -> Vec<DVec3> {
    let of = |v| NeighbourCircle::through(mesh.neighbours_m(v)).map_or(DVec3::ZERO, |c| c.normal);
    (0..mesh.n_vertices()).into_par_iter().map(of).collect()
}
