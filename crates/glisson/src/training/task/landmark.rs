//! A place of the tissue, found at rest, that goes with it.

use crate::math::DVec3;
use crate::mesh::{TetId, TetMesh};
use crate::world::World;

/// A place may lie so far outside of the tissue [m]: where a surface is flatter than what it was meshed from.
const OUTSIDE_M: f64 = 5e-3;

/// A place of the tissue.
#[derive(Clone, Debug)]
pub(super) struct Landmark {
    rest_m: DVec3,
    /// The tetrahedron that it is in, and the weights of its corners.
    at: (TetId, [f64; 4]),
    topology_version: u32,
}

impl Landmark {
    /// The place at rest; none where there is no tissue.
    pub(super) fn find(rest_m: DVec3, world: &World) -> Option<Self> {
        let (tet, weights) = nearest(rest_m, world)?;
        let mesh = world.organ().mesh();
        let off_m = mean(mesh.corners_m(tet), weights).distance(rest_m);
        let topology_version = world.organ().topology_version();
        (off_m <= OUTSIDE_M).then_some(Self { rest_m, at: (tet, weights), topology_version })
    }

    /// After edits: in the tissue that is left.
    fn follow(&mut self, world: &World) {
        let version = world.organ().topology_version();
        if std::mem::replace(&mut self.topology_version, version) == version {
            return;
        }
        if world.organ().live_tetrahedra()[self.at.0.index()] {
            return;
        }
        if let Some(at) = nearest(self.rest_m, world) {
            self.at = at;
        }
    }

    /// Where it is now [m].
    pub(super) fn position_m(&mut self, world: &World) -> DVec3 {
        self.follow(world);
        let corners = world.organ().mesh().tetrahedra[self.at.0.index()];
        mean(corners.map(|node| world.state().positions_m[node.index()]), self.at.1)
    }

    /// Where it is at rest [m].
    pub(super) fn rest_m(&self) -> DVec3 {
        self.rest_m
    }

    /// The tetrahedron that it is in.
    pub(super) fn tet(&mut self, world: &World) -> TetId {
        self.follow(world);
        self.at.0
    }
}

fn mean(corners_m: [DVec3; 4], weights: [f64; 4]) -> DVec3 {
    corners_m.into_iter().zip(weights).map(|(corner_m, weight)| corner_m * weight).sum()
}

/// The live tetrahedron that a place at rest is in, or that it is least far out of, with weights within it.
fn nearest(rest_m: DVec3, world: &World) -> Option<(TetId, [f64; 4])> {
    let (mesh, topology) = (world.organ().mesh(), world.organ().body().topology());
    let off = |(_, weights): &(TetId, [f64; 4])| weights.iter().map(|weight| weight.min(0.0)).sum::<f64>();
    let found = topology.live_tets().map(|tet| (tet, weights_in(mesh, tet, rest_m)));
    let (tet, weights) = found.max_by(|a, b| off(a).total_cmp(&off(b)))?;
    let within = weights.map(|weight| weight.max(0.0));
    let sum: f64 = within.iter().sum();
    Some((tet, within.map(|weight| weight / sum)))
}

/// Barycentric weights of a place; some are negative outside.
fn weights_in(mesh: &TetMesh, tet: TetId, p_m: DVec3) -> [f64; 4] {
    let [a, b, c, d] = mesh.corners_m(tet);
    let volume = |a: DVec3, b: DVec3, c: DVec3, d: DVec3| (b - a).cross(c - a).dot(d - a);
    let whole = volume(a, b, c, d);
    [volume(p_m, b, c, d), volume(a, p_m, c, d), volume(a, b, p_m, d), volume(a, b, c, p_m)]
        .map(|part| part / whole)
}
