//! Internal forces: where smoothness alone would put a vertex.
//!
//! The force is the displacement [m] from a vertex P to P~ = e1 A + e2 B + e3 C + L(r, d, phi~) n, the place
//! with the wanted metric parameters e and the wanted simplex angle phi~ over the present neighbours (see
//! [`super::geometry`]). Metric parameters act along the surface, the angle across it. Forces of all vertices
//! are computed from the same positions, in parallel, each in a fixed order: the same bits at any number of
//! threads.
//!
//! Source: H. Delingette 1999, doi 10.1023/A:1008157432188. Where this differs: curvature continuity averages
//! the mean curvature H, not the angle itself, and takes phi~ = asin(r H~); on a mesh of even size that is the
//! same, on one whose cells differ in size the angle is proportional to the size and its mean would bend the
//! surface where the size changes.

use super::geometry::{VertexShapes, mean_curvatures_of, vertex_shapes};
use super::mesh::SimplexMesh;
use super::neighbourhood::Neighbourhoods;
use crate::math::DVec3;
use rayon::prelude::*;

/// What the simplex angle should be.
#[derive(Clone, Debug, PartialEq)]
pub enum Smoothness {
    /// As it is (C0): the surface may bend freely, vertices only move along it.
    Position,
    /// Zero (C1): continuous normals. With even metric parameters this is the Laplacian, and shrinks.
    Orientation,
    /// That of the mean of the mean curvatures within so many edges (C2): spheres stay as they are.
    Curvature {
        /// Reach of the mean in edges: the rigidity. Waves shorter than this are smoothed away.
        rigidity: usize,
    },
    /// That of a reference shape [rad], one a vertex (C2 with shape memory): any similar shape stays as it is.
    Shape {
        /// Simplex angles of the reference.
        angles_rad: Vec<f64>,
    },
}

/// What the metric parameters should be.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Spacing {
    /// As they are: no force along the surface.
    Free,
    /// A third each: a vertex over the middle of its neighbours.
    Even,
    /// 1/3 + gain (|H_k| - H-) / H-, H- being the mean of the neighbours' |H_k|: nearer to the neighbour
    /// where the curvature is high, so that vertices gather there.
    TowardsCurvature {
        /// Strength, 0 to 0.3.
        gain: f64,
    },
}

/// Least metric parameter that [`Spacing::TowardsCurvature`] asks for: the foot stays inside its triangle.
const LEAST_METRIC: f64 = 0.1;

/// The internal force on each vertex [m].
///
/// `within` reaches [`Smoothness::Curvature`]'s rigidity and is not looked at by the others, except for
/// [`Spacing::TowardsCurvature`], whose curvatures are means over it.
pub fn internal_forces_m(
    mesh: &SimplexMesh,
    within: &Neighbourhoods,
    smoothness: &Smoothness,
    spacing: Spacing,
) -> Vec<DVec3> {
    forces_of_shapes_m(mesh, &vertex_shapes(mesh), within, smoothness, spacing)
}

/// [`internal_forces_m`] with the shapes of the vertices at hand.
pub(super) fn forces_of_shapes_m(
    mesh: &SimplexMesh,
    shapes: &VertexShapes,
    within: &Neighbourhoods,
    smoothness: &Smoothness,
    spacing: Spacing,
) -> Vec<DVec3> {
    let needs_means = matches!(smoothness, Smoothness::Curvature { .. })
        || matches!(spacing, Spacing::TowardsCurvature { .. });
    let means_per_m = if needs_means { within.means(&mean_curvatures_of(shapes)) } else { Vec::new() };
    let force = |v: usize| {
        let at_m = mesh.positions_m()[v];
        let Some((circle, shape)) = &shapes[v] else {
            // Neighbours on a line: to their middle, where there will be a plane.
            return mesh.neighbours_m(v).into_iter().sum::<DVec3>() / 3.0 - at_m;
        };
        let metric = match spacing {
            Spacing::Free => shape.metric,
            Spacing::Even => [1.0 / 3.0; 3],
            Spacing::TowardsCurvature { gain } => {
                metric_towards_curvature(mesh.neighbours()[v].map(|n| means_per_m[n as usize].abs()), gain)
            }
        };
        let foot_m = circle.foot_m(metric);
        let height_of = |angle_rad| circle.height_of_angle_m(foot_m.distance(circle.centre_m), angle_rad);
        let height_m = match smoothness {
            Smoothness::Position => shape.height_m,
            Smoothness::Orientation => 0.0,
            Smoothness::Curvature { .. } => {
                height_of(libm::asin((circle.radius_m * means_per_m[v]).clamp(-1.0, 1.0)))
            }
            Smoothness::Shape { angles_rad } => height_of(angles_rad[v]),
        };
        foot_m + height_m * circle.normal - at_m
    };
    (0..mesh.n_vertices()).into_par_iter().map(force).collect()
}

/// Metric parameters of a vertex whose neighbours have these absolute curvatures [1/m]: positive, with sum 1.
pub fn metric_towards_curvature(curvatures_per_m: [f64; 3], gain: f64) -> [f64; 3] {
    let mean = curvatures_per_m.iter().sum::<f64>() / 3.0;
    if mean.is_nan() || mean <= f64::MIN_POSITIVE {
        return [1.0 / 3.0; 3];
    }
    let metric = curvatures_per_m.map(|h| (1.0 / 3.0 + gain * (h - mean) / mean).max(LEAST_METRIC));
    let sum: f64 = metric.iter().sum();
    metric.map(|e| e / sum)
}
