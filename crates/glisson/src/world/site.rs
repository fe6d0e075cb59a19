//! Places that go with the tissue: in a tetrahedron, by weights of its corners.

use crate::math::{DVec3, tetrahedron_volume_m3};
use crate::mesh::edit::EditableMesh;
use crate::mesh::topology::Topology;
use crate::mesh::{NodeId, TetId, TriangleId};

/// Tetrahedra that a search walks through, at most: a choice.
const MOST_WALKED: usize = 64;
/// Weights that are not further below zero than this are those of a place inside.
const ROUNDING: f64 = 1e-12;

/// A place in a tetrahedron.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Site {
    pub(super) tet: TetId,
    pub(super) weights: [f64; 4],
}

impl Site {
    /// Where it is [m].
    pub(super) fn place_m(&self, body: &EditableMesh, positions_m: &[DVec3]) -> DVec3 {
        self.nodes(body).into_iter().zip(self.weights).map(|(node, w)| positions_m[node.index()] * w).sum()
    }

    /// Corners of its tetrahedron.
    pub(super) fn nodes(&self, body: &EditableMesh) -> [NodeId; 4] {
        body.topology().tet_nodes(self.tet)
    }

    /// What has become of a way at rest, for a way that is short beside the tetrahedron.
    pub(super) fn way_now(&self, way: DVec3, body: &EditableMesh, positions_m: &[DVec3]) -> DVec3 {
        let now_m = self.nodes(body).map(|node| positions_m[node.index()]);
        carried(way, body.mesh().corners_m(self.tet), now_m)
    }

    /// The way at rest of which `way` has become.
    pub(super) fn way_at_rest(&self, way: DVec3, body: &EditableMesh, positions_m: &[DVec3]) -> DVec3 {
        let now_m = self.nodes(body).map(|node| positions_m[node.index()]);
        carried(way, now_m, body.mesh().corners_m(self.tet))
    }

    /// A place of a triangle of the surface, in the tetrahedron behind it.
    pub(super) fn on_surface(
        topology: &Topology,
        triangle: TriangleId,
        (nodes, weights): ([NodeId; 3], [f64; 3]),
    ) -> Option<Self> {
        let tet = topology.triangle_tets(triangle).into_iter().find_map(|tet| tet.get())?;
        let weight_of = |node: NodeId| nodes.iter().position(|n| *n == node).map_or(0.0, |v| weights[v]);
        Some(Self { tet, weights: topology.tet_nodes(tet).map(weight_of) })
    }

    /// The place at `point_m` where the corners are at `positions_m`, found by walking from a tetrahedron; none where the way there
    /// leaves the tissue, or is long. Allocates nothing.
    pub(super) fn walk(
        topology: &Topology,
        from: TetId,
        point_m: DVec3,
        positions_m: &[DVec3],
    ) -> Option<Self> {
        let mut tet = from;
        for _ in 0..MOST_WALKED {
            let corners_m = topology.tet_nodes(tet).map(|node| positions_m[node.index()]);
            let weights = weights_of(point_m, corners_m);
            let (furthest, least) =
                (0..4).map(|i| (i, weights[i])).min_by(|a, b| a.1.total_cmp(&b.1)).unwrap_or((0, 0.0));
            if least >= -ROUNDING {
                return Some(Self { tet, weights });
            }
            tet = topology.tet_neighbours(tet)[furthest].get()?;
        }
        None
    }
}

/// Barycentric weights of a point; not numbers of a tetrahedron without volume.
fn weights_of(point_m: DVec3, corners_m: [DVec3; 4]) -> [f64; 4] {
    let volume_m3 = tetrahedron_volume_m3(corners_m);
    std::array::from_fn(|i| {
        let mut part_m = corners_m;
        part_m[i] = point_m;
        tetrahedron_volume_m3(part_m) / volume_m3
    })
}

/// What becomes of a way when the corners of its tetrahedron go from one place to another: the deformation gradient times it.
fn carried(way: DVec3, from_m: [DVec3; 4], to_m: [DVec3; 4]) -> DVec3 {
    let weights = weights_of(from_m[0] + way, from_m);
    to_m.into_iter().zip(weights).map(|(corner_m, w)| corner_m * w).sum::<DVec3>() - to_m[0]
}

/// The live tetrahedron of the rest shape that holds `point_m`, the lowest of several.
pub(super) fn site_of(body: &EditableMesh, point_m: DVec3) -> Option<Site> {
    body.topology().live_tets().find_map(|tet| {
        let weights = weights_of(point_m, body.mesh().corners_m(tet));
        weights.iter().all(|&w| w >= -ROUNDING).then_some(Site { tet, weights })
    })
}
