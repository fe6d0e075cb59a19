//! Where a blade goes through the surface of a body.

use crate::math::DVec3;
use crate::mesh::TriangleId;
use crate::mesh::topology::Topology;

/// Slack of the barycentric weights, so that no segment slips through between two triangles.
const WEIGHT_SLACK: f64 = 1e-9;

/// A segment goes through a surface triangle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Crossing {
    /// The triangle.
    pub(super) triangle: TriangleId,
    /// Where on the segment, from 0 to 1.
    pub(super) along: f64,
    /// Where [m].
    pub(super) point_m: DVec3,
}

/// Where the segment goes into the body through `triangle` (Moeller and Trumbore 1997, doi 10.1080/10867651.1997.10487468).
fn crossing(
    topology: &Topology,
    positions_m: &[DVec3],
    triangle: TriangleId,
    [from_m, to_m]: [DVec3; 2],
    least_sine: f64,
) -> Option<Crossing> {
    let nodes = topology.triangle_nodes(triangle);
    let [a, b, c] = nodes.map(|n| positions_m[n.index()]);
    let (u_axis, v_axis, direction) = (b - a, c - a, to_m - from_m);
    let p = direction.cross(v_axis);
    let determinant = u_axis.dot(p);
    if determinant == 0.0 {
        return None;
    }
    let start = from_m - a;
    let u = start.dot(p) / determinant;
    if !(-WEIGHT_SLACK..=1.0 + WEIGHT_SLACK).contains(&u) {
        return None;
    }
    let q = start.cross(u_axis);
    let v = direction.dot(q) / determinant;
    let along = v_axis.dot(q) / determinant;
    if v < -WEIGHT_SLACK || u + v > 1.0 + WEIGHT_SLACK || !(0.0..=1.0).contains(&along) {
        return None;
    }
    let area_m2 = topology.area_vector_m2(triangle, positions_m);
    let outward = direction.dot(area_m2);
    let is_steep = outward.abs() >= least_sine * direction.length() * area_m2.length();
    (outward < 0.0 && is_steep).then_some(Crossing { triangle, along, point_m: from_m + along * direction })
}

/// The first place where the segment goes into the body, through triangles to which it has at least an angle
/// of this sine.
pub(super) fn first_crossing(
    topology: &Topology,
    positions_m: &[DVec3],
    segment_m: [DVec3; 2],
    least_sine: f64,
) -> Option<Crossing> {
    first_of(topology.surface_triangles(), |t| crossing(topology, positions_m, t, segment_m, least_sine))
}

/// [`first_crossing`] inwards among the surface triangles at the corners of `near` and at their neighbours.
pub(super) fn first_crossing_near(
    topology: &Topology,
    positions_m: &[DVec3],
    segment_m: [DVec3; 2],
    near: TriangleId,
) -> Option<Crossing> {
    if !topology.is_live_triangle(near) || !topology.is_surface_triangle(near) {
        return None;
    }
    let mut seen = vec![near];
    let mut start = 0;
    for _ in 0..2 {
        let end = seen.len();
        for at in start..end {
            for node in topology.triangle_nodes(seen[at]) {
                for triangle in topology.surface_triangles_at(node) {
                    if !seen.contains(&triangle) {
                        seen.push(triangle);
                    }
                }
            }
        }
        start = end;
        // The first ring holds the blade in nearly every step.
        let found =
            first_of(seen.iter().copied(), |t| crossing(topology, positions_m, t, segment_m, super::BRUSH));
        if found.is_some() {
            return found;
        }
    }
    None
}

fn first_of(
    triangles: impl Iterator<Item = TriangleId>,
    crossing: impl Fn(TriangleId) -> Option<Crossing>,
) -> Option<Crossing> {
    let mut first: Option<Crossing> = None;
    for found in triangles.filter_map(crossing) {
        if first.is_none_or(|f| found.along < f.along) {
            first = Some(found);
        }
    }
    first
}
