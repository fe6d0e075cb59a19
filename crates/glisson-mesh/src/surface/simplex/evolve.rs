//! Deformation: P(t+1) = P(t) + (1 - gamma) (P(t) - P(t-1)) + alpha F_int + beta F_ext, a damped second-order
//! law with explicit steps (H. Delingette 1999, doi 10.1023/A:1008157432188). All vertices move at once, from
//! the same positions: the same bits at any number of threads.

use super::external::Attraction;
use super::geometry::vertex_shapes;
use super::internal::{Smoothness, Spacing, forces_of_shapes_m};
use super::mesh::SimplexMesh;
use super::neighbourhood::Neighbourhoods;
use crate::math::DVec3;
use rayon::prelude::*;

/// The constants of the law.
#[derive(Clone, Debug, PartialEq)]
pub struct DeformationLaw {
    /// Damping gamma: 1 forgets the motion of the step before, 0 keeps all of it.
    pub damping: f64,
    /// Weight alpha of the internal force, 0 to 0.5: above, neighbours overtake each other.
    pub internal: f64,
    /// Weight beta of the external force close to the data, 0 to 1.
    pub external: f64,
    /// Distance to the data at which beta has doubled and alpha halved [m]: by the factor 1 + (distance / this)^2,
    /// so that data say little within their own uncertainty and much beyond it. Infinite for constant weights.
    pub data_uncertainty_m: f64,
    /// What the simplex angles should be.
    pub smoothness: Smoothness,
    /// What the metric parameters should be.
    pub spacing: Spacing,
    /// Largest move of a vertex in one step [m].
    pub largest_move_m: f64,
}

/// What one step did.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DeformationStep {
    /// Mean distance that a vertex moved [m].
    pub mean_move_m: f64,
    /// Mean absolute distance to the data along the normal before the step [m], where there were data.
    pub mean_offset_m: f64,
    /// Vertices without data within reach.
    pub n_without_data: usize,
}

/// Largest beta far from the data.
const LARGEST_EXTERNAL: f64 = 0.6;

/// A mesh under way: its motion and the neighbourhoods of its vertices.
pub struct Deformation {
    before_m: Vec<DVec3>,
    within: Neighbourhoods,
}

impl Deformation {
    /// At rest. Neighbourhoods reach the rigidity of `law`, or two edges.
    pub fn at_rest(mesh: &SimplexMesh, law: &DeformationLaw) -> Self {
        let rings = if let Smoothness::Curvature { rigidity } = law.smoothness { rigidity } else { 2 };
        Self { before_m: mesh.positions_m().to_vec(), within: Neighbourhoods::within(mesh, rings) }
    }

    /// One step. A vertex whose new place would not be finite stays.
    pub fn step(
        &mut self,
        mesh: &mut SimplexMesh,
        law: &DeformationLaw,
        attraction: Option<&Attraction<'_>>,
    ) -> DeformationStep {
        let shapes = vertex_shapes(mesh);
        let internal_m = forces_of_shapes_m(mesh, &shapes, &self.within, &law.smoothness, law.spacing);
        let at_m = mesh.positions_m();
        let moved = |v: usize| {
            let normal = shapes[v].map_or(DVec3::ZERO, |(circle, _)| circle.normal);
            let offset_m = attraction.and_then(|a| a.offset_m(at_m[v], normal));
            let distance_m = offset_m.unwrap_or(0.0);
            let certainty = 1.0 + (distance_m / law.data_uncertainty_m).powi(2);
            let external = law.external * certainty;
            let external_m = external.min(LARGEST_EXTERNAL.max(law.external)) * distance_m * normal;
            let inertia_m = (1.0 - law.damping) * (at_m[v] - self.before_m[v]);
            let step_m = inertia_m + law.internal / certainty * internal_m[v] + external_m;
            let step_m = step_m.clamp_length_max(law.largest_move_m);
            (if step_m.is_finite() { at_m[v] + step_m } else { at_m[v] }, offset_m)
        };
        let places: Vec<(DVec3, Option<f64>)> = (0..at_m.len()).into_par_iter().map(moved).collect();
        let n = places.len() as f64;
        let mean_move_m = places.iter().zip(at_m).map(|((p, _), q)| p.distance(*q)).sum::<f64>() / n;
        let offsets = places.iter().filter_map(|&(_, offset_m)| offset_m);
        let (sum, count) = offsets.fold((0.0, 0usize), |(sum, count), o| (sum + o.abs(), count + 1));
        self.before_m.copy_from_slice(at_m);
        for (position, (place, _)) in mesh.positions_m_mut().iter_mut().zip(&places) {
            *position = *place;
        }
        DeformationStep {
            mean_move_m,
            mean_offset_m: if count > 0 { sum / count as f64 } else { 0.0 },
            n_without_data: places.len() - count,
        }
    }
}
