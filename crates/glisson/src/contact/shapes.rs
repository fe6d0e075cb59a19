//! Shapes of instruments, and how they move during a step.
//!
//! A motion is exact where every point moves on a straight line at constant speed. Where a body turns, its points
//! move on curves; they are replaced by their chords, and the largest distance between the two is told as
//! `path_error_m`, so that a query can grow the shape by it and miss nothing. For a path p(t), t from 0 to 1, that
//! distance is at most max |p''| / 8 (error of linear interpolation).

use super::boxes::ThickSegment;
use crate::math::{DMat3, DVec3};

/// All points within `radius_m` of a segment; a ball when the ends are one point.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Capsule {
    /// One end of the axis [m]; of an instrument the tip.
    pub from_m: DVec3,
    /// The other end of the axis [m].
    pub to_m: DVec3,
    /// Radius [m].
    pub radius_m: f64,
}

impl Capsule {
    /// A ball.
    pub fn ball(center_m: DVec3, radius_m: f64) -> Self {
        Self { from_m: center_m, to_m: center_m, radius_m }
    }

    /// Point of the axis at the share `along` from `from_m`.
    pub fn axis_point_m(&self, along: f64) -> DVec3 {
        self.from_m.lerp(self.to_m, along)
    }

    /// Where it reaches with `margin_m` around.
    pub fn reach(&self, margin_m: f64) -> ThickSegment {
        ThickSegment { from_m: self.from_m, to_m: self.to_m, radius_m: self.radius_m + margin_m }
    }
}

/// A capsule whose ends move on straight lines during a step.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CapsuleMotion {
    /// Axis at the start of the step [m].
    pub start_m: [DVec3; 2],
    /// Axis at its end [m].
    pub end_m: [DVec3; 2],
    /// Radius [m].
    pub radius_m: f64,
    /// How far the true path can be from the straight lines [m]: queries grow the radius by it.
    pub path_error_m: f64,
}

/// An instrument that turns about the pivot of a trocar and slides through it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TrocarPose {
    /// Unit vector from the pivot into the body, along the shaft.
    pub direction: DVec3,
    /// Depth of the tip below the pivot [m]; negative outside.
    pub insertion_m: f64,
}

impl CapsuleMotion {
    /// A capsule that does not turn, or whose ends do move on straight lines.
    pub fn straight(start: &Capsule, end: &Capsule) -> Self {
        Self {
            start_m: [start.from_m, start.to_m],
            end_m: [end.from_m, end.to_m],
            radius_m: start.radius_m.max(end.radius_m),
            path_error_m: 0.0,
        }
    }

    /// A shaft of `length_m` and `radius_m` behind the tip that turns about `pivot_m` and slides through it at
    /// constant rates. An end at depth l on the shaft, turning by the angle a, has |p''| <= l a^2 + 2 |dl| a.
    pub fn through_trocar(
        pivot_m: DVec3,
        start: &TrocarPose,
        end: &TrocarPose,
        length_m: f64,
        radius_m: f64,
    ) -> Self {
        let ends = |pose: &TrocarPose| {
            [0.0, length_m].map(|behind_m| pivot_m + pose.direction * (pose.insertion_m - behind_m))
        };
        let cosine = start.direction.dot(end.direction);
        let angle_rad = libm::atan2(start.direction.cross(end.direction).length(), cosine);
        let depth_m = |pose: &TrocarPose| pose.insertion_m.abs().max((pose.insertion_m - length_m).abs());
        let lever_m = depth_m(start).max(depth_m(end));
        let slide_m = (end.insertion_m - start.insertion_m).abs();
        Self {
            start_m: ends(start),
            end_m: ends(end),
            radius_m,
            path_error_m: angle_rad * (lever_m * angle_rad + 2.0 * slide_m) / 8.0,
        }
    }

    /// The capsule at the share `time` of the step.
    pub fn at(&self, time: f64) -> Capsule {
        Capsule {
            from_m: self.start_m[0].lerp(self.end_m[0], time),
            to_m: self.start_m[1].lerp(self.end_m[1], time),
            radius_m: self.radius_m,
        }
    }

    /// Motion of the two ends over the step [m].
    pub fn moves_m(&self) -> [DVec3; 2] {
        [self.end_m[0] - self.start_m[0], self.end_m[1] - self.start_m[1]]
    }

    /// Where it can be during the step, with `margin_m` around: no point is further from the axis at half time
    /// than half the longer move.
    pub fn reach(&self, margin_m: f64) -> ThickSegment {
        let middle = self.at(0.5);
        let half_move_m = 0.5 * self.moves_m().iter().fold(0.0_f64, |m, v| m.max(v.length()));
        middle.reach(self.path_error_m + half_move_m + margin_m)
    }
}

/// Where a rigid body is: x_world = rotation x_body + origin.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RigidPose {
    /// Turns body axes into world axes.
    pub rotation: DMat3,
    /// The body's origin in the world [m].
    pub origin_m: DVec3,
}

impl RigidPose {
    /// The body frame is the world's.
    pub const IDENTITY: Self = Self { rotation: DMat3::IDENTITY, origin_m: DVec3::ZERO };

    /// Writes where the body's points are in the world.
    ///
    /// # Panics
    /// When the lists differ in length.
    pub fn place_into(&self, body_points_m: &[DVec3], world_points_m: &mut [DVec3]) {
        assert_eq!(body_points_m.len(), world_points_m.len(), "one place for each point");
        for (world, body) in world_points_m.iter_mut().zip(body_points_m) {
            *world = self.rotation * *body + self.origin_m;
        }
    }

    /// How far a point within `radius_m` of the body's origin can be from its chord [m] when the body goes from
    /// this pose to `end`, its origin on a straight line, turning by the angle a at a constant rate:
    /// radius a^2 / 8.
    pub fn path_error_m(&self, end: &Self, radius_m: f64) -> f64 {
        let turn = end.rotation * self.rotation.transpose();
        let trace = turn.x_axis.x + turn.y_axis.y + turn.z_axis.z;
        let skew = DVec3::new(
            turn.y_axis.z - turn.z_axis.y,
            turn.z_axis.x - turn.x_axis.z,
            turn.x_axis.y - turn.y_axis.x,
        );
        let angle_rad = libm::atan2(skew.length(), trace - 1.0);
        radius_m * angle_rad * angle_rad / 8.0
    }
}

/// An instrument with the shape of a closed triangle mesh, in its own frame.
#[derive(Clone, Debug, PartialEq)]
pub struct MeshShape {
    /// Vertices in the body's frame [m].
    pub positions_m: Vec<DVec3>,
    /// Vertex indices, counter-clockwise from outside.
    pub triangles: Vec<[u32; 3]>,
    radius_m: f64,
}

impl MeshShape {
    /// A shape; whether the mesh is closed is for `surface::check` to say.
    pub fn new(positions_m: Vec<DVec3>, triangles: Vec<[u32; 3]>) -> Self {
        let radius_m = positions_m.iter().fold(0.0_f64, |r, p| r.max(p.length()));
        Self { positions_m, triangles, radius_m }
    }

    /// Distance of the furthest vertex from the frame's origin [m].
    pub fn radius_m(&self) -> f64 {
        self.radius_m
    }

    /// How far its points can be from their chords between two poses [m].
    pub fn path_error_m(&self, start: &RigidPose, end: &RigidPose) -> f64 {
        start.path_error_m(end, self.radius_m)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::SeededRandom;

    fn unit(random: &mut SeededRandom) -> DVec3 {
        DVec3::new(random.normal(), random.normal(), random.normal()).normalize()
    }

    fn largest_deviation_m(path: impl Fn(f64) -> DVec3) -> f64 {
        let chord = |t: f64| path(0.0).lerp(path(1.0), t);
        (0..=100).map(|i| f64::from(i) / 100.0).fold(0.0, |d, t| d.max(path(t).distance(chord(t))))
    }

    #[test]
    fn a_turned_and_pushed_shaft_stays_within_its_path_error() {
        let mut random = SeededRandom::new(3);
        let mut closest = f64::INFINITY;
        for _ in 0..500 {
            let (axis, first) = (unit(&mut random), unit(&mut random));
            let direction = (first - axis * axis.dot(first)).normalize();
            let angle = random.uniform_in(0.0, 0.5);
            let (from, to) = (random.uniform_in(0.0, 0.2), random.uniform_in(0.0, 0.2));
            let turned = |t: f64| DMat3::from_axis_angle(axis, angle * t) * direction;
            let pose = |t: f64| TrocarPose { direction: turned(t), insertion_m: from + (to - from) * t };
            let pivot = unit(&mut random);
            let motion = CapsuleMotion::through_trocar(pivot, &pose(0.0), &pose(1.0), 0.3, 2e-3);
            let mut worst = 0.0_f64;
            for behind_m in [0.0, 0.1, 0.3] {
                worst = worst.max(largest_deviation_m(|t| {
                    let pose = pose(t);
                    pivot + pose.direction * (pose.insertion_m - behind_m)
                }));
            }
            assert!(worst <= motion.path_error_m + 1e-15, "{worst} above {}", motion.path_error_m);
            closest = closest.min(motion.path_error_m / worst);
        }
        assert!(closest < 1.1, "the bound should be sharp: {closest}");
    }

    #[test]
    fn a_rigid_turn_stays_within_its_path_error() {
        let mut random = SeededRandom::new(4);
        for _ in 0..200 {
            let (axis, point) = (unit(&mut random), unit(&mut random) * 0.05);
            let angle = random.uniform_in(0.0, 0.5);
            let pose = |t: f64| RigidPose {
                rotation: DMat3::from_axis_angle(axis, angle * t),
                origin_m: DVec3::X * t,
            };
            let bound = pose(0.0).path_error_m(&pose(1.0), 0.05);
            let worst = largest_deviation_m(|t| {
                let mut place = [DVec3::ZERO];
                pose(t).place_into(&[point], &mut place);
                place[0]
            });
            assert!(worst <= bound + 1e-15 && bound <= 0.05 * angle * angle / 8.0 * 1.001 + 1e-12);
        }
    }

    #[test]
    fn the_reach_of_a_motion_holds_the_capsule_at_every_time() {
        let mut random = SeededRandom::new(8);
        for _ in 0..200 {
            let capsule = |random: &mut SeededRandom| Capsule {
                from_m: unit(random),
                to_m: unit(random),
                radius_m: 0.1,
            };
            let motion = CapsuleMotion::straight(&capsule(&mut random), &capsule(&mut random));
            let reach = motion.reach(0.0);
            for i in 0..=10 {
                let now = motion.at(f64::from(i) / 10.0);
                for j in 0..=10 {
                    let p = now.axis_point_m(f64::from(j) / 10.0);
                    let axis = reach.to_m - reach.from_m;
                    let s = ((p - reach.from_m).dot(axis) / axis.length_squared()).clamp(0.0, 1.0);
                    assert!(p.distance(reach.from_m + axis * s) + 0.1 <= reach.radius_m + 1e-12);
                }
            }
        }
    }
}
