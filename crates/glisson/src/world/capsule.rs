//! Which triangles of the surface are still the organ's own skin, its capsule, and which lie in cuts.
//!
//! An edit that divides or refines skin makes new triangles within old ones; one that opens the organ uncovers others. A new
//! triangle whose nodes all come from those of one old triangle of skin is skin; one whose nodes all come from those of another
//! old triangle, which lay between two tetrahedra or in a cut, is none. What neither holds for was cut through a tetrahedron, or
//! changed its shape when nodes moved or went: it is skin when its middle lies in old skin, at rest, and both face the same way.

use crate::math::DVec3;
use crate::mesh::edit::{EditableMesh, TopologyChange};
use crate::mesh::topology::OptionalTetId;
use crate::mesh::{NodeId, TetId, TriangleId};

/// How far a triangle may be from old skin and still lie in it.
#[derive(Clone, Copy, Debug)]
struct Bounds {
    /// Cosine of the largest angle between the two.
    least_cosine: f64,
    /// How far off the plane the middle may be, as a share of the old triangle's longest edge.
    greatest_height: f64,
    /// How far beside the triangle, as a barycentric weight.
    least_weight: f64,
}

/// Where nodes of the skin moved or went: edges that are swapped and pulled together on a curved surface turn it a little.
/// Faces of a cut leave the skin at an angle, so that the bounds are wide: they are choices.
const RESHAPED: Bounds = Bounds { least_cosine: 0.9, greatest_height: 0.1, least_weight: -0.05 };
/// Where none did it is as it was, but for rounding.
const AS_IT_WAS: Bounds = Bounds { least_cosine: 1.0 - 1e-9, greatest_height: 1e-9, least_weight: -1e-9 };

/// Triangles in cuts. At the start there are none.
#[derive(Clone, Debug, Default)]
pub(super) struct Capsule {
    /// By triangle; those beyond the end are skin. Of triangles inside it means nothing, and an edit that is undone
    /// finds those that it took away as they were: their numbers are used by nobody else before that.
    is_cut: Vec<bool>,
}

/// A triangle of skin that an edit took away.
struct OldSkin {
    nodes: [NodeId; 3],
    /// At rest, and its unit normal.
    corners_m: [DVec3; 3],
    normal: DVec3,
    longest_edge_m: f64,
    bounds: Bounds,
}

impl OldSkin {
    fn new(nodes: [NodeId; 3], corners_m: [DVec3; 3], is_reshaped: bool) -> Self {
        let [a, b, c] = corners_m;
        let normal = (b - a).cross(c - a).normalize_or_zero();
        let longest_edge_m = a.distance(b).max(b.distance(c)).max(c.distance(a));
        let bounds = if is_reshaped { RESHAPED } else { AS_IT_WAS };
        Self { nodes, corners_m, normal, longest_edge_m, bounds }
    }

    /// Whether a triangle with that middle [m] and unit normal lies in it.
    fn has(&self, middle_m: DVec3, normal: DVec3) -> bool {
        let [a, b, c] = self.corners_m;
        let from_a = middle_m - a;
        let height_m = from_a.dot(self.normal);
        if height_m.abs() > self.bounds.greatest_height * self.longest_edge_m
            || normal.dot(self.normal) < self.bounds.least_cosine
        {
            return false;
        }
        let twice_area_m2 = (b - a).cross(c - a).dot(self.normal);
        let weight_b = from_a.cross(c - a).dot(self.normal) / twice_area_m2;
        let weight_c = (b - a).cross(from_a).dot(self.normal) / twice_area_m2;
        weight_b.min(weight_c).min(1.0 - weight_b - weight_c) >= self.bounds.least_weight
    }
}

/// Whether all `nodes` come from among `old`: they are of these, or all their parents are.
fn come_from(change: &TopologyChange, nodes: [NodeId; 3], old: &[NodeId; 3]) -> bool {
    nodes.into_iter().all(|node| match node.index().checked_sub(change.nodes.n_before) {
        None => old.contains(&node),
        Some(new) => change.nodes.added.parents(new).iter().all(|(parent, _)| old.contains(parent)),
    })
}

/// Whether a triangle was there before, or is part of one that was, with copies in the place of nodes: one of an old tetrahedron,
/// or of a parent of a new one.
fn was_there(body: &EditableMesh, change: &TopologyChange, triangle: TriangleId, nodes: [NodeId; 3]) -> bool {
    let topology = body.topology();
    let Some(tet) = topology.triangle_tets(triangle).into_iter().find_map(OptionalTetId::get) else {
        return false;
    };
    let Some(new) = tet.index().checked_sub(change.tets.n_before) else { return true };
    let is_of = |parent: TetId| {
        let [a, b, c, d] = topology.tet_nodes(parent);
        [[a, b, c], [a, b, d], [a, c, d], [b, c, d]].iter().any(|face| come_from(change, nodes, face))
    };
    change.tets.added.parents(new).iter().any(|&(parent, _)| is_of(parent))
}

impl Capsule {
    /// Whether a triangle of the surface lies in a cut.
    pub(super) fn is_cut(&self, triangle: TriangleId) -> bool {
        self.is_cut.get(triangle.index()).copied().unwrap_or(false)
    }

    /// Follows an edit; `nodes_before` are those of a triangle of the surface before it. An edit that is undone needs
    /// nothing: the triangles that come back are as they were.
    pub(super) fn follow(
        &mut self,
        body: &EditableMesh,
        change: &TopologyChange,
        nodes_before: impl Fn(TriangleId) -> Option<[NodeId; 3]>,
    ) {
        let (added, removed) = (&change.surface_triangles_added, &change.surface_triangles_removed);
        let n_triangles = body.topology().n_triangles();
        if !added.is_empty() && self.is_cut.len() < n_triangles {
            self.is_cut.resize(n_triangles, false);
        }
        if change.tets.added.ids().is_empty() {
            // What only lost tetrahedra has no new skin.
            added.iter().for_each(|triangle| self.is_cut[triangle.index()] = true);
            return;
        }
        let rest_m = &body.mesh().positions_m;
        let corners_m = |nodes: [NodeId; 3]| nodes.map(|n| rest_m[n.index()]);
        let is_gone_or_moved = |node: &NodeId| {
            change.nodes.removed.binary_search(node).is_ok() || change.moved_nodes.binary_search(node).is_ok()
        };
        let skin = removed.iter().filter(|triangle| !self.is_cut(**triangle));
        let old: Vec<OldSkin> = skin
            .filter_map(|&triangle| nodes_before(triangle))
            .map(|nodes| OldSkin::new(nodes, corners_m(nodes), nodes.iter().any(is_gone_or_moved)))
            .collect();
        for &triangle in added {
            let nodes = body.topology().outward_nodes(triangle);
            let [a, b, c] = corners_m(nodes);
            let (middle_m, normal) = ((a + b + c) / 3.0, (b - a).cross(c - a).normalize_or_zero());
            let is_skin = old.iter().any(|skin| come_from(change, nodes, &skin.nodes))
                || (!was_there(body, change, triangle, nodes)
                    && old.iter().any(|skin| skin.has(middle_m, normal)));
            self.is_cut[triangle.index()] = !is_skin;
        }
    }
}
