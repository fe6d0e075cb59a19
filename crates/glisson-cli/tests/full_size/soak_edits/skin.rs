//! Which triangles of a body's surface are its own skin, found anew from the skin that it had at the start: where no node
//! moved, what is left of it lies in it exactly.

use glisson::math::{DVec3, tetrahedron_volume_m3};
use glisson::mesh::edit::TopologyChange;
use glisson::world::World;
use std::sync::Arc;

/// How far from the skin at the start something in it may be by rounding [m].
const ROUNDING_M: f64 = 1e-9;

#[derive(Clone)]
pub(super) struct OwnSkin {
    /// Its triangles at rest [m].
    at_start_m: Arc<[[DVec3; 3]]>,
    /// By node: where nodes moved at rest or others took their place, so that the skin may have another shape.
    is_reshaped: Vec<bool>,
}

impl OwnSkin {
    pub(super) fn new(world: &World) -> Self {
        let rest_m = &world.organ().mesh().positions_m;
        let topology = world.organ().body().topology();
        let at_start_m =
            topology.surface_triangles().map(|t| topology.triangle_nodes(t).map(|n| rest_m[n.index()]));
        Self { at_start_m: at_start_m.collect(), is_reshaped: vec![false; rest_m.len()] }
    }

    /// After an edit, and whether it pulled edges together.
    pub(super) fn follow(&mut self, world: &World, change: &TopologyChange, is_mended: bool) {
        change.moved_nodes.iter().for_each(|node| self.is_reshaped[node.index()] = true);
        for (_, parents) in change.nodes.added.iter() {
            let is_reshaped = parents.iter().any(|(parent, _)| self.is_reshaped[parent.index()]);
            self.is_reshaped.push(is_reshaped);
        }
        // What was pulled together or exchanged lies across what was there.
        if is_mended || !(change.nodes.removed.is_empty() || change.nodes.added.ids().is_empty()) {
            let topology = world.organ().body().topology();
            let new_nodes = change.tets.added.ids().iter().flat_map(|&t| topology.tet_nodes(t));
            new_nodes.for_each(|node| self.is_reshaped[node.index()] = true);
        }
    }

    /// Whether the world tells new triangles in the skin from those in cuts.
    pub(super) fn check(&self, world: &World, change: &TopologyChange, label: &str) {
        let topology = world.organ().body().topology();
        let rest_m = &world.organ().mesh().positions_m;
        for &triangle in &change.surface_triangles_added {
            let nodes = topology.triangle_nodes(triangle);
            if !topology.is_surface_triangle(triangle) || nodes.iter().any(|n| self.is_reshaped[n.index()]) {
                continue;
            }
            let corners_m = nodes.map(|n| rest_m[n.index()]);
            // It may lie across several in one plane.
            let [a, b, c] = corners_m;
            let lies_in_skin = |place_m: DVec3| self.at_start_m.iter().any(|t| lies_in(*t, place_m));
            let is_own = [a, b, c, (a + b + c) / 3.0].into_iter().all(lies_in_skin);
            let is_cut = world.organ().is_cut(triangle);
            assert_eq!(is_cut, !is_own, "{label}: {triangle} of the surface is in a cut (found, expected)");
        }
    }
}

/// Whether a place lies in a triangle, but for rounding.
fn lies_in([a, b, c]: [DVec3; 3], place_m: DVec3) -> bool {
    let normal = (b - a).cross(c - a);
    let height_m = 6.0 * tetrahedron_volume_m3([a, b, c, place_m]) / normal.length();
    let is_left = |p: DVec3, q: DVec3| {
        let beside_m = (q - p).cross(place_m - p).dot(normal) / (normal.length() * p.distance(q));
        beside_m >= -ROUNDING_M
    };
    height_m.abs() <= ROUNDING_M && is_left(a, b) && is_left(b, c) && is_left(c, a)
}
