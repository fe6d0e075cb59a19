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
    /// Whether the segment goes inwards there.
    pub(super) is_entering: bool,
}

/// Where the segment crosses `triangle` (Moeller and Trumbore 1997, doi 10.1080/10867651.1997.10487468).
fn crossing(
    topology: &Topology,
    positions_m: &[DVec3],
    triangle: TriangleId,
    [from_m, to_m]: [DVec3; 2],
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
    let is_entering = direction.dot(topology.area_vector_m2(triangle, positions_m)) < 0.0;
    Some(Crossing { triangle, along, point_m: from_m + along * direction, is_entering })
}

/// The first place where the segment goes into (or out of, as wanted) the body.
pub(super) fn first_crossing(
    topology: &Topology,
    positions_m: &[DVec3],
    segment_m: [DVec3; 2],
    is_entering: bool,
) -> Option<Crossing> {
    first_of(topology, positions_m, segment_m, is_entering, topology.surface_triangles())
}

/// [`first_crossing`] among the surface triangles at the corners of `near` and at their neighbours.
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
        let found = first_of(topology, positions_m, segment_m, true, seen.iter().copied());
        if found.is_some() {
            return found;
        }
    }
    None
}

fn first_of(
    topology: &Topology,
    positions_m: &[DVec3],
    segment_m: [DVec3; 2],
    is_entering: bool,
    triangles: impl Iterator<Item = TriangleId>,
) -> Option<Crossing> {
    let mut first: Option<Crossing> = None;
    for triangle in triangles {
        if let Some(found) = crossing(topology, positions_m, triangle, segment_m)
            && found.is_entering == is_entering
            && first.is_none_or(|f| found.along < f.along)
        {
            first = Some(found);
        }
    }
    first
}
