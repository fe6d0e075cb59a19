//! What bodies were apart, or in each other, in the rest shape.
//!
//! Meshes that were made from one image fit each other no better than its voxels. A vertex X that was at a place of another body
//! then, at the distance g0 along the unit vector m, just touched it there. Against any place Y of that body it counts as touching
//! at the distance
//!
//! (X - Y).m (1 - s/L),   s = |(X - Y) - m (X - Y).m|,
//!
//! which is g0 where it was, and fades as it slides by s. X and Y are places in the rest shape, so that it changes steadily
//! from triangle to triangle. Against another body m is the normal of the triangle at rest.

use super::NodeContact;
use crate::math::DVec3;

/// Way across by which a place no longer counts as the one of the rest shape [m]: a choice, about an edge of a mesh.
const FADES_OVER_M: f64 = 0.01;

/// The rest shape of the surface of several bodies.
#[derive(Clone, Debug)]
pub(super) struct RestGaps {
    touch_m: f64,
    rest_m: Vec<DVec3>,
    body_of: Vec<u32>,
    /// The body that each vertex touched, with the way from there to it; a vertex that touched none has no way.
    touched: Vec<(u32, DVec3)>,
}

impl RestGaps {
    /// Of vertices at `rest_m` with the contacts found there; what is further apart than `touch_m` did not touch.
    pub(super) fn new(touch_m: f64, rest_m: Vec<DVec3>, body_of: Vec<u32>, at_rest: &[NodeContact]) -> Self {
        let mut touched = vec![(0, DVec3::ZERO); rest_m.len()];
        for contact in at_rest.iter().filter(|contact| contact.gap_m <= touch_m) {
            let body = body_of[contact.vertices[1] as usize];
            touched[contact.vertices[0] as usize] = (body, contact.normal);
        }
        Self { touch_m, rest_m, body_of, touched }
    }

    /// The gap at which a contact just touches [m].
    #[inline]
    pub(super) fn gap_m(&self, contact: &NodeContact) -> f64 {
        if self.touch_m == 0.0 {
            return 0.0;
        }
        let at = |v: u32| self.rest_m[v as usize];
        let [vertex, a, b, c] = contact.vertices;
        let apart_m: DVec3 = contact.sides().map(|(v, w)| self.rest_m[v] * w).sum();
        let (body, way) = self.touched[vertex as usize];
        let way = if way != DVec3::ZERO && body == self.body_of[a as usize] {
            way
        } else {
            (at(b) - at(a)).cross(at(c) - at(a)).normalize_or_zero()
        };
        let along_m = apart_m.dot(way);
        let across_m = (apart_m - way * along_m).length();
        let share = (1.0 - across_m / FADES_OVER_M).max(0.0);
        if along_m > self.touch_m { 0.0 } else { along_m.max(-self.touch_m) * share }
    }
}
