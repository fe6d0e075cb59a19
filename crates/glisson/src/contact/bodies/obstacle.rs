//! Rigid bodies that do not answer to forces: supports, walls and instruments.

use crate::contact::shapes::RigidPose;
use crate::contact::triangles::{at_weights, closest_weights};
use crate::math::DVec3;
use crate::surface::TriMesh;

/// What an obstacle looks like, in its own frame.
#[derive(Clone, Debug, PartialEq)]
pub enum ObstacleShape {
    /// All points with z below 0.
    HalfSpace,
    /// A ball around the origin.
    Ball {
        /// Its radius [m].
        radius_m: f64,
    },
    /// A cylinder whose axis is z and whose flat end, which presses, is at z = 0; the rest is above.
    FlatPunch {
        /// Its radius [m].
        radius_m: f64,
        /// Its length [m].
        length_m: f64,
    },
    /// Triangles, counter-clockwise from outside.
    Mesh(TriMesh),
}

/// A rigid body with a prescribed motion.
#[derive(Clone, Debug, PartialEq)]
pub struct Obstacle {
    /// Its shape.
    pub shape: ObstacleShape,
    /// Where it is.
    pub pose: RigidPose,
    /// Coefficient of friction, combined with that of what touches it: see [`super::pair_friction`].
    pub friction: f64,
}

impl Obstacle {
    /// The half-space below the plane through `point_m` with the unit normal `normal`.
    pub fn half_space(point_m: DVec3, normal: DVec3, friction: f64) -> Self {
        let (x, y) = normal.any_orthonormal_pair();
        let rotation = crate::math::DMat3::from_cols(x, y, normal);
        Self { shape: ObstacleShape::HalfSpace, pose: RigidPose { rotation, origin_m: point_m }, friction }
    }
}

/// The place of an obstacle's surface nearest to a point.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct NearPlace {
    /// Distance [m], negative inside.
    pub(super) distance_m: f64,
    /// Unit normal out of the obstacle, in the world.
    pub(super) normal: DVec3,
}

/// The shape as seen from a point in its frame: distance [m] and normal. Nothing for a mesh.
fn nearest(shape: &ObstacleShape, p_m: DVec3) -> Option<(f64, DVec3)> {
    match *shape {
        ObstacleShape::HalfSpace => Some((p_m.z, DVec3::Z)),
        ObstacleShape::Ball { radius_m } => {
            let length_m = p_m.length();
            let normal = if length_m > 0.0 { p_m / length_m } else { DVec3::Z };
            Some((length_m - radius_m, normal))
        }
        ObstacleShape::FlatPunch { radius_m, length_m } => {
            let flat = DVec3::new(p_m.x, p_m.y, 0.0);
            let from_axis_m = flat.length();
            let outward = if from_axis_m > 0.0 { flat / from_axis_m } else { DVec3::X };
            let (below_m, beside_m, above_m) = (-p_m.z, from_axis_m - radius_m, p_m.z - length_m);
            let (end_m, end) = if below_m >= above_m { (below_m, -DVec3::Z) } else { (above_m, DVec3::Z) };
            if end_m > 0.0 && beside_m > 0.0 {
                let off = end * end_m + outward * beside_m;
                let distance_m = off.length();
                return Some((distance_m, off / distance_m));
            }
            Some(if end_m >= beside_m { (end_m, end) } else { (beside_m, outward) })
        }
        ObstacleShape::Mesh(_) => None,
    }
}

/// An obstacle during a step.
#[derive(Clone, Debug)]
pub(super) struct MovingObstacle {
    pub(super) obstacle: Obstacle,
    /// Where it is at the end of the step.
    pub(super) end: RigidPose,
}

impl MovingObstacle {
    pub(super) fn place_near(&self, point_m: DVec3) -> Option<NearPlace> {
        let RigidPose { rotation, origin_m } = self.obstacle.pose;
        let (distance_m, normal) =
            nearest(&self.obstacle.shape, rotation.transpose() * (point_m - origin_m))?;
        Some(NearPlace { distance_m, normal: rotation * normal })
    }

    /// Whether it may touch a surface between its vertices: a ball.
    pub(super) fn is_round(&self) -> bool {
        matches!(self.obstacle.shape, ObstacleShape::Ball { .. })
    }

    /// The place between the edges of a triangle that is nearest to a ball's centre, as weights; nothing where that is on an
    /// edge or too far.
    pub(super) fn between_edges(&self, corners_m: [DVec3; 3], within_m: f64) -> Option<[f64; 3]> {
        let ObstacleShape::Ball { radius_m } = self.obstacle.shape else { return None };
        let center_m = self.obstacle.pose.origin_m;
        let longest_m = corners_m[0].distance(corners_m[1]).max(corners_m[0].distance(corners_m[2]));
        if corners_m[0].distance(center_m) > radius_m + within_m + longest_m {
            return None;
        }
        let weights = closest_weights(center_m, corners_m);
        let is_near = at_weights(corners_m, weights).distance(center_m) <= radius_m + within_m;
        (is_near && weights.iter().all(|w| *w > AT_END)).then_some(weights)
    }

    /// The place between the ends of an edge that is nearest to a ball's centre, as a share of the way; nothing where that is
    /// at an end or too far.
    pub(super) fn between_ends(&self, [a_m, b_m]: [DVec3; 2], within_m: f64) -> Option<f64> {
        let ObstacleShape::Ball { radius_m } = self.obstacle.shape else { return None };
        let center_m = self.obstacle.pose.origin_m;
        let share = (center_m - a_m).dot(b_m - a_m) / (b_m - a_m).length_squared();
        let is_between = share > AT_END && share < 1.0 - AT_END;
        (is_between && a_m.lerp(b_m, share).distance(center_m) <= radius_m + within_m).then_some(share)
    }

    /// How far the obstacle's own point at `point_m` goes in the step [m].
    pub(super) fn motion_at_m(&self, point_m: DVec3) -> DVec3 {
        let RigidPose { rotation, origin_m } = self.obstacle.pose;
        let body_m = rotation.transpose() * (point_m - origin_m);
        self.end.rotation * body_m + self.end.origin_m - point_m
    }

    pub(super) fn end_step(&mut self) {
        self.obstacle.pose = self.end;
    }
}

/// A weight below which a corner or an end has no part.
const AT_END: f64 = 1e-6;

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::{DMat3, SeededRandom};

    #[test]
    fn the_distance_from_a_shape_has_its_normal_as_slope() {
        let mut random = SeededRandom::new(4);
        let shapes = [
            ObstacleShape::HalfSpace,
            ObstacleShape::Ball { radius_m: 0.5 },
            ObstacleShape::FlatPunch { radius_m: 0.4, length_m: 1.0 },
        ];
        for shape in shapes {
            for _ in 0..500 {
                let p = DVec3::new(random.normal(), random.normal(), random.normal());
                let (d, n) = nearest(&shape, p).unwrap();
                assert!((n.length() - 1.0).abs() < 1e-12);
                let (ahead, _) = nearest(&shape, p + n * 1e-6).unwrap();
                assert!((ahead - d - 1e-6).abs() < 1e-9, "{shape:?} {p}");
                // The nearest place is on the surface.
                assert!(nearest(&shape, p - n * d).unwrap().0.abs() < 1e-9, "{shape:?} {p}");
            }
        }
    }

    #[test]
    fn a_point_of_a_turned_obstacle_moves_with_it() {
        let mut moving = MovingObstacle {
            obstacle: Obstacle::half_space(DVec3::new(0.0, 0.0, 0.1), DVec3::X, 0.0),
            end: RigidPose::IDENTITY,
        };
        moving.end = moving.obstacle.pose;
        moving.end.origin_m += DVec3::Y;
        assert!(moving.motion_at_m(DVec3::new(0.3, 0.2, 0.1)).distance(DVec3::Y) < 1e-15);
        moving.end.rotation = DMat3::from_rotation_x(0.1) * moving.end.rotation;
        let place = moving.place_near(DVec3::new(0.3, 0.2, 0.1)).unwrap();
        assert!((place.distance_m - 0.3).abs() < 1e-15 && place.normal.distance(DVec3::X) < 1e-15);
    }
}
