//! Implicit shapes: functions that are negative inside and close to the signed distance [m] near the surface.

use crate::math::DVec3;

/// Point or size given in millimetres [m].
pub(super) fn mm(x: f64, y: f64, z: f64) -> DVec3 {
    DVec3::new(x, y, z) * 1e-3
}

/// Ellipsoid with half axes `half_m`: f = k (k - 1) / |grad k^2 / 2| with k = |(p - c) / h|, which has unit
/// slope on the surface.
pub(super) fn ellipsoid(point_m: DVec3, center_m: DVec3, half_m: DVec3) -> f64 {
    let scaled = (point_m - center_m) / half_m;
    let k = scaled.length();
    let slope = (scaled / half_m).length();
    if slope < 1e-9 { -half_m.min_element() } else { k * (k - 1.0) / slope }
}

/// Elliptic cylinder along z, of unlimited length.
pub(super) fn cylinder(point_m: DVec3, center_m: DVec3, half_x_m: f64, half_y_m: f64) -> f64 {
    let flat = DVec3::new(point_m.x, point_m.y, center_m.z);
    ellipsoid(flat, center_m, DVec3::new(half_x_m, half_y_m, 1.0))
}

/// A straight tube between two balls.
#[derive(Clone, Copy, Debug)]
pub(super) struct Tube {
    /// Ends of the axis [m].
    pub(super) ends_m: [DVec3; 2],
    /// Radii at the ends [m].
    pub(super) radii_m: [f64; 2],
}

impl Tube {
    /// Distance to the axis less the radius there.
    pub(super) fn signed_distance_m(&self, point_m: DVec3) -> f64 {
        let [a, b] = self.ends_m;
        let axis = b - a;
        let t = ((point_m - a).dot(axis) / axis.length_squared().max(1e-18)).clamp(0.0, 1.0);
        let radius = self.radii_m[0] + t * (self.radii_m[1] - self.radii_m[0]);
        (point_m - a - axis * t).length() - radius
    }
}

/// Union with a fillet of about `blend_m` where the two meet.
pub(super) fn smooth_union(a: f64, b: f64, blend_m: f64) -> f64 {
    let h = (blend_m - (a - b).abs()).max(0.0);
    a.min(b) - h * h / (4.0 * blend_m)
}

/// `a` without `b`, the new edge rounded over about `blend_m`.
pub(super) fn smooth_difference(a: f64, b: f64, blend_m: f64) -> f64 {
    -smooth_union(-a, b, blend_m)
}
