//! When and where a moving ball first touches a surface.
//!
//! The ball's path of one step is walked in pieces shorter than its radius, so that it cannot jump through the
//! surface; within the piece that brings it too close, bisection finds the touch.

use super::buckets::BucketGrid;
use crate::math::{DVec3, closest_point_barycentric};

/// The ball's centre moves from `from_m` to `to_m`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BallPath {
    /// Centre at the start of the step [m].
    pub from_m: DVec3,
    /// Centre at its end [m].
    pub to_m: DVec3,
    /// Radius [m].
    pub radius_m: f64,
}

/// A place of the surface that a ball touches.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Touch {
    /// Which triangle.
    pub triangle: usize,
    /// Barycentric weights of the touched point.
    pub weights: [f64; 3],
    /// The touched point [m].
    pub point_m: DVec3,
    /// Unit normal from the surface towards the ball.
    pub normal: DVec3,
    /// Centre of the ball at the touch [m].
    pub center_m: DVec3,
    /// Distance of surface and ball [m]: about zero after a clean approach, negative when the ball already
    /// overlapped at the start of the path.
    pub gap_m: f64,
}

/// Pieces of one path at most: a tool that moves further in one step is walked in longer pieces, and may miss
/// what is thinner than them.
const MAX_PIECES: f64 = 256.0;

/// Bisections of the piece in which the ball first overlaps: 1/1024 of half a radius.
const BISECTIONS: usize = 10;

/// Overlap below which a ball counts as not yet touching: lies far above rounding, far below any tissue's
/// geometry, so that a released tool that rests at the surface is not caught again at once.
pub const TOUCH_TOLERANCE_M: f64 = 1e-6;

/// The surface as it is now.
#[derive(Clone, Copy, Debug)]
pub struct SurfaceView<'a> {
    /// Vertices [m].
    pub positions_m: &'a [DVec3],
    /// Vertex indices, counter-clockwise from outside.
    pub triangles: &'a [[u32; 3]],
    /// Buckets over these triangles, up to date.
    pub buckets: &'a BucketGrid,
}

impl SurfaceView<'_> {
    fn corners_m(&self, triangle: usize) -> [DVec3; 3] {
        self.triangles[triangle].map(|v| self.positions_m[v as usize])
    }

    /// The triangle closest to `center_m` among those within `distance_m`, with weights and distance [m];
    /// the lower index wins a tie.
    pub fn closest(&self, center_m: DVec3, distance_m: f64) -> Option<(usize, [f64; 3], f64)> {
        let mut best: Option<(usize, [f64; 3], f64)> = None;
        self.buckets.for_each_near(center_m, distance_m, |t| {
            let corners = self.corners_m(t);
            let k = closest_point_barycentric(center_m, corners);
            let distance = at_weights(corners, k).distance(center_m);
            let closer = match best {
                Some((best_t, _, best_distance)) => {
                    distance < best_distance || (distance == best_distance && t < best_t)
                }
                None => distance <= distance_m,
            };
            if closer {
                best = Some((t, k, distance));
            }
        });
        best
    }

    /// First place that the ball touches on its way, or `None`.
    pub fn first_touch(&self, path: &BallPath) -> Option<Touch> {
        let overlap_m = path.radius_m - TOUCH_TOLERANCE_M;
        let motion = path.to_m - path.from_m;
        let n_pieces = (motion.length() / (0.5 * path.radius_m)).ceil().clamp(1.0, MAX_PIECES);
        let overlaps = |t: f64| self.closest(path.from_m + motion * t, overlap_m).is_some();
        if overlaps(0.0) {
            return self.touch_at(path.from_m, path.radius_m);
        }
        let mut free = 0.0;
        for piece in 1..=n_pieces as usize {
            let mut hit = piece as f64 / n_pieces;
            if !overlaps(hit) {
                free = hit;
                continue;
            }
            for _ in 0..BISECTIONS {
                let middle = 0.5 * (free + hit);
                if overlaps(middle) {
                    hit = middle;
                } else {
                    free = middle;
                }
            }
            return self.touch_at(path.from_m + motion * hit, path.radius_m);
        }
        None
    }

    fn touch_at(&self, center_m: DVec3, radius_m: f64) -> Option<Touch> {
        let (triangle, weights, distance) = self.closest(center_m, radius_m)?;
        let corners = self.corners_m(triangle);
        let point_m = at_weights(corners, weights);
        let face = (corners[1] - corners[0]).cross(corners[2] - corners[0]).normalize_or_zero();
        let outward = (center_m - point_m).normalize_or_zero();
        // A centre on or below the surface: the ball has to come out along the face's own normal.
        let inside = outward.dot(face) <= 0.0;
        let (normal, gap_m) =
            if inside { (face, -distance - radius_m) } else { (outward, distance - radius_m) };
        Some(Touch { triangle, weights, point_m, normal, center_m, gap_m })
    }
}

fn at_weights(corners: [DVec3; 3], k: [f64; 3]) -> DVec3 {
    corners[0] * k[0] + corners[1] * k[1] + corners[2] * k[2]
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A flat square of side 2 m in z = 0, seen from above, in 2 n^2 triangles.
    fn plate(n: usize) -> (Vec<DVec3>, Vec<[u32; 3]>) {
        let mut positions = Vec::new();
        let mut triangles = Vec::new();
        for j in 0..=n {
            for i in 0..=n {
                positions.push(DVec3::new(
                    2.0 * i as f64 / n as f64 - 1.0,
                    2.0 * j as f64 / n as f64 - 1.0,
                    0.0,
                ));
            }
        }
        let at = |i: usize, j: usize| (i + (n + 1) * j) as u32;
        for j in 0..n {
            for i in 0..n {
                triangles.push([at(i, j), at(i + 1, j), at(i + 1, j + 1)]);
                triangles.push([at(i, j), at(i + 1, j + 1), at(i, j + 1)]);
            }
        }
        (positions, triangles)
    }

    fn touch(from_m: DVec3, to_m: DVec3) -> Option<Touch> {
        let (positions, triangles) = plate(8);
        let buckets = BucketGrid::new(&positions, &triangles);
        let surface = SurfaceView { positions_m: &positions, triangles: &triangles, buckets: &buckets };
        surface.first_touch(&BallPath { from_m, to_m, radius_m: 0.05 })
    }

    #[test]
    fn a_ball_stops_one_radius_above_the_plate() {
        let found = touch(DVec3::new(0.1, 0.2, 0.5), DVec3::new(0.1, 0.2, -0.5)).unwrap();
        assert!((found.center_m.z - 0.05).abs() < 1e-4, "{found:?}");
        assert!(found.point_m.distance(DVec3::new(0.1, 0.2, 0.0)) < 1e-12);
        assert!(found.normal.distance(DVec3::Z) < 1e-9 && found.gap_m.abs() < 1e-4);
    }

    #[test]
    fn even_a_fast_ball_does_not_jump_through() {
        assert!(touch(DVec3::new(0.0, 0.0, 3.0), DVec3::new(0.0, 0.0, -3.0)).is_some());
    }

    #[test]
    fn a_ball_that_passes_beside_or_stays_above_touches_nothing() {
        assert!(touch(DVec3::new(1.2, 0.0, 0.5), DVec3::new(1.2, 0.0, -0.5)).is_none());
        assert!(touch(DVec3::new(0.0, 0.0, 0.5), DVec3::new(0.5, 0.0, 0.06)).is_none());
    }

    #[test]
    fn a_ball_that_starts_below_the_surface_reports_its_depth() {
        let found = touch(DVec3::new(0.0, 0.1, -0.02), DVec3::new(0.0, 0.1, -0.02)).unwrap();
        assert!((found.gap_m + 0.07).abs() < 1e-12 && found.normal == DVec3::Z, "{found:?}");
    }
}
