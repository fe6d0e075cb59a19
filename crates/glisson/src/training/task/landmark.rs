//! A place of the tissue, found at rest, that goes with it.

use crate::math::{DVec3, closest_point_barycentric};
use crate::mesh::{NodeId, TetId, TetMesh};
use crate::world::World;

/// A place may lie so far outside of the tissue [m]: where a surface is flatter than what it was meshed from.
const OUTSIDE_M: f64 = 5e-3;

/// A place of the tissue.
#[derive(Clone, Debug)]
pub(super) struct Landmark {
    rest_m: DVec3,
    /// Where that is in the tissue; none where the tissue is gone.
    at: Option<Site>,
    topology_version: u32,
}

/// A place in the mesh.
#[derive(Clone, Copy, Debug)]
struct Site {
    tet: TetId,
    /// Nodes that carry it, and their weights: of the surface where it is near, whose places every model knows.
    nodes: [NodeId; 4],
    weights: [f64; 4],
}

impl Landmark {
    /// The place at rest; none where there is no tissue.
    pub(super) fn find(rest_m: DVec3, world: &World) -> Option<Self> {
        let topology_version = world.organ().topology_version();
        let at = Some(find(rest_m, world)?);
        Some(Self { rest_m, at, topology_version })
    }

    /// After edits, and when they are undone: numbers of tetrahedra may mean others.
    fn follow(&mut self, world: &World) {
        let version = world.organ().topology_version();
        if std::mem::replace(&mut self.topology_version, version) != version {
            self.at = find(self.rest_m, world);
        }
    }

    /// Where it is now [m], if its tissue is there.
    pub(super) fn position_m(&mut self, world: &World) -> Option<DVec3> {
        self.follow(world);
        self.at.map(|site| site.mean(world.state().positions_m))
    }

    /// How far it is from where it was at rest [m], if its tissue is there.
    pub(super) fn moved_m(&mut self, world: &World) -> Option<DVec3> {
        let now_m = self.position_m(world)?;
        self.at.map(|site| now_m - site.mean(&world.organ().mesh().positions_m))
    }

    /// The tetrahedron that it is in, if its tissue is there.
    pub(super) fn tet(&mut self, world: &World) -> Option<TetId> {
        self.follow(world);
        self.at.map(|site| site.tet)
    }
}

impl Site {
    fn mean(&self, positions_m: &[DVec3]) -> DVec3 {
        let nodes = self.nodes.iter().zip(self.weights);
        nodes.map(|(node, weight)| positions_m[node.index()] * weight).sum()
    }
}

/// The live tetrahedron that a place at rest is in, or the nearest; none where that is too far away.
fn find(rest_m: DVec3, world: &World) -> Option<Site> {
    let (mesh, topology) = (world.organ().mesh(), world.organ().body().topology());
    let found = topology.live_tets().map(|tet| {
        let weights = weights_within(mesh, tet, rest_m);
        let site = Site { tet, nodes: mesh.tetrahedra[tet.index()], weights };
        (site.mean(&mesh.positions_m).distance(rest_m), site)
    });
    let (away_m, site) = found.min_by(|a, b| a.0.total_cmp(&b.0))?;
    (away_m <= OUTSIDE_M).then(|| on_surface(rest_m, site, world).unwrap_or(site))
}

/// The same place on the surface of its tetrahedron, if that has one near it.
fn on_surface(rest_m: DVec3, site: Site, world: &World) -> Option<Site> {
    let (mesh, topology) = (world.organ().mesh(), world.organ().body().topology());
    let faces = site.nodes.iter().flat_map(|node| topology.surface_triangles_at(*node));
    let of_face = faces.map(|face| {
        let [a, b, c] = topology.triangle_nodes(face);
        let [x, y, z] = closest_point_barycentric(rest_m, [a, b, c].map(|n| mesh.positions_m[n.index()]));
        let place = Site { nodes: [a, b, c, c], weights: [x, y, z, 0.0], ..site };
        (place.mean(&mesh.positions_m).distance(rest_m), place)
    });
    let (away_m, place) = of_face.min_by(|a, b| a.0.total_cmp(&b.0))?;
    (away_m <= OUTSIDE_M).then_some(place)
}

/// Barycentric weights of a place, those of a place within the tetrahedron near it where it is outside.
fn weights_within(mesh: &TetMesh, tet: TetId, p_m: DVec3) -> [f64; 4] {
    let [a, b, c, d] = mesh.corners_m(tet);
    let volume = |a: DVec3, b: DVec3, c: DVec3, d: DVec3| (b - a).cross(c - a).dot(d - a);
    let parts = [volume(p_m, b, c, d), volume(a, p_m, c, d), volume(a, b, p_m, d), volume(a, b, c, p_m)];
    let whole = volume(a, b, c, d);
    let within = parts.map(|part| (part / whole).max(0.0));
    let sum: f64 = within.iter().sum();
    within.map(|weight| weight / sum)
}
