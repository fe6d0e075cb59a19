//! The organ's surface as instruments meet it: where it moved in the last step, and a search over it that follows edits
//! triangle by triangle.

use super::detection::SearchedSurface;
use crate::contact::broad_phase::BroadPhaseKind;
use crate::contact::proxy::ProxySurface;
use crate::contact::proxy_surface::SurfaceAdjacency;
use crate::contact::shapes::Capsule;
use crate::contact::tool_contact::{SurfaceSearch, ToolContact};
use crate::math::DVec3;
use crate::mesh::edit::EditableMesh;
use crate::mesh::{NodeId, TriangleId};

/// Room for edits before what is kept of a surface has to be made anew: this share of its triangles or nodes ...
const SPARE_SHARE: usize = 2;
/// ... and at least so many.
pub(super) const LEAST_SPARE: usize = 64;

/// Room for edits beside so many triangles or nodes.
pub(super) fn spare_beside(n: usize) -> usize {
    LEAST_SPARE.max(n / SPARE_SHARE)
}

/// Triangles around a node that are told, at most.
const MOST_AROUND: usize = 32;
/// A slot without a triangle, a triangle without a slot.
const NONE: u32 = u32::MAX;

/// Surface triangles in slots, over the nodes of the mesh.
#[derive(Clone, Debug)]
pub(super) struct Skin {
    search: SurfaceSearch,
    adjacency: SurfaceAdjacency,
    /// Slot of each triangle of the mesh.
    slots: Vec<u32>,
    /// Triangle in each slot.
    triangles: Vec<u32>,
    /// Its nodes, counter-clockwise from outside.
    nodes: Vec<[NodeId; 3]>,
    /// Empty slots; the last one is filled first, so that an undone edit leaves them as they were.
    empty: Vec<u32>,
    /// Positions of all nodes at the start and at the end of the last step [m], with room for more nodes.
    start_m: Vec<DVec3>,
    end_m: Vec<DVec3>,
    /// Whether slots changed since the search was brought up to date.
    is_stale: bool,
}

/// Triangles that came to a surface, or left it.
#[derive(Clone, Copy)]
pub(super) struct SurfaceChange<'a> {
    pub(super) added: &'a [TriangleId],
    pub(super) removed: &'a [TriangleId],
}

/// A place of the surface near an instrument.
#[derive(Clone, Copy, Debug)]
pub(super) struct SurfacePlace {
    pub(super) triangle: TriangleId,
    pub(super) nodes: [NodeId; 3],
    pub(super) found: ToolContact,
}

impl Skin {
    /// A surface that stands still.
    pub(super) fn new(body: &EditableMesh, positions_m: &[DVec3]) -> Self {
        let topology = body.topology();
        let on_surface: Vec<TriangleId> = topology.surface_triangles().collect();
        let n = on_surface.len();
        let n_spare = spare_beside(n);
        let n_slots = n + n_spare;
        let mut skin = Self {
            // Replaced below, when the slots are filled.
            search: SurfaceSearch::new(BroadPhaseKind::Hierarchy, &[], &[], 0),
            adjacency: SurfaceAdjacency::new(0, &[], 0),
            slots: vec![NONE; topology.n_triangles()],
            triangles: vec![NONE; n_slots],
            nodes: vec![[NodeId(0); 3]; n_slots],
            empty: (n..n_slots).rev().map(|slot| slot as u32).collect(),
            start_m: Vec::new(),
            end_m: Vec::new(),
            is_stale: false,
        };
        let resting_m = positions_m.first().copied().unwrap_or(DVec3::ZERO);
        skin.end_m.extend_from_slice(positions_m);
        skin.end_m.resize(positions_m.len() + spare_beside(positions_m.len()), resting_m);
        skin.start_m.clone_from(&skin.end_m);
        for (slot, &triangle) in on_surface.iter().enumerate() {
            skin.slots[triangle.index()] = slot as u32;
            skin.triangles[slot] = triangle.0;
            skin.nodes[slot] = topology.outward_nodes(triangle);
        }
        let filled: Vec<[u32; 3]> = skin.nodes[..n].iter().map(|nodes| nodes.map(|n| n.0)).collect();
        skin.adjacency = SurfaceAdjacency::new(skin.end_m.len(), &filled, n_spare);
        skin.search = SurfaceSearch::new(BroadPhaseKind::Hierarchy, &skin.end_m, &filled, n_spare);
        skin
    }

    /// Follows an edit. Nodes that it brought in start at their places at rest, until [`Skin::place`] is told better.
    /// Without room left everything is made anew; then the surface as it was comes back.
    pub(super) fn follow(&mut self, body: &EditableMesh, change: &SurfaceChange<'_>) -> Option<Self> {
        let n_nodes = body.topology().n_nodes();
        let has_room = change.added.len() <= self.empty.len() + change.removed.len();
        if !has_room || n_nodes > self.end_m.len() {
            let n_known = self.end_m.len().min(n_nodes);
            let new_m = &body.mesh().positions_m[n_known..];
            let positions_m: Vec<DVec3> = self.end_m[..n_known].iter().chain(new_m).copied().collect();
            let mut new = Self::new(body, &positions_m);
            new.start_m[..n_known].copy_from_slice(&self.start_m[..n_known]);
            new.is_stale = true;
            return Some(std::mem::replace(self, new));
        }
        self.slots.resize(self.slots.len().max(body.topology().n_triangles()), NONE);
        for &triangle in change.removed {
            let slot = std::mem::replace(&mut self.slots[triangle.index()], NONE);
            self.triangles[slot as usize] = NONE;
            self.search.set_triangle(slot, None);
            self.adjacency.set_triangle(slot, None);
            self.empty.push(slot);
        }
        for &triangle in change.added {
            let slot = self.empty.pop().expect("there is room, as was just seen");
            let nodes = body.topology().outward_nodes(triangle);
            self.slots[triangle.index()] = slot;
            self.triangles[slot as usize] = triangle.0;
            self.nodes[slot as usize] = nodes;
            self.search.set_triangle(slot, Some(nodes.map(|n| n.0)));
            self.adjacency.set_triangle(slot, Some(nodes.map(|n| n.0)));
        }
        self.is_stale = true;
        None
    }

    /// Nodes of a triangle of the surface, counter-clockwise from outside; none for others.
    pub(super) fn nodes_of(&self, triangle: TriangleId) -> Option<[NodeId; 3]> {
        let slot = *self.slots.get(triangle.index())?;
        (slot != NONE).then(|| self.nodes[slot as usize])
    }

    /// Takes an edit back that was followed last.
    pub(super) fn unfollow(&mut self, body: &EditableMesh, change: &SurfaceChange<'_>) {
        // The opposite order: the slots are emptied and filled as a stack.
        let backwards = |triangles: &[TriangleId]| triangles.iter().rev().copied().collect::<Vec<_>>();
        let (added, removed) = (backwards(change.removed), backwards(change.added));
        // The slots that the edit took are free again: nothing is made anew.
        self.follow(body, &SurfaceChange { added: &added, removed: &removed });
    }

    /// Where a node was at the start and at the end of the last step [m].
    pub(super) fn way_m(&self, node: NodeId) -> Option<[DVec3; 2]> {
        Some([*self.start_m.get(node.index())?, *self.end_m.get(node.index())?])
    }

    /// Puts a node at these places at the start and at the end of the last step [m].
    pub(super) fn place(&mut self, node: NodeId, way_m: [DVec3; 2]) {
        if let (Some(start), Some(end)) =
            (self.start_m.get_mut(node.index()), self.end_m.get_mut(node.index()))
        {
            [*start, *end] = way_m;
            self.is_stale = true;
        }
    }

    /// The surface went to these positions during a step. Allocates nothing.
    pub(super) fn move_to(&mut self, positions_m: &[DVec3]) {
        std::mem::swap(&mut self.start_m, &mut self.end_m);
        let n = positions_m.len().min(self.end_m.len());
        self.end_m[..n].copy_from_slice(&positions_m[..n]);
        self.search.update(&self.start_m, &self.end_m);
        self.is_stale = false;
    }

    /// The surface is at these positions and did not move there.
    pub(super) fn rest_at(&mut self, positions_m: &[DVec3]) {
        self.move_to(positions_m);
        self.move_to(positions_m);
    }

    /// Brings the search up to date after edits. Allocates nothing.
    pub(super) fn refresh(&mut self) {
        if std::mem::take(&mut self.is_stale) {
            self.search.update(&self.start_m, &self.end_m);
        }
    }

    /// The surface as it moved in the last step, or as it is now, to be searched.
    pub(super) fn searched(&self, surface_moves: bool) -> SearchedSurface<'_> {
        let start_m = if surface_moves { &self.start_m } else { &self.end_m };
        SearchedSurface { search: &self.search, start_m, end_m: &self.end_m }
    }

    /// Whether a resting capsule overlaps the surface. Allocates nothing.
    pub(super) fn overlaps(&self, capsule: &Capsule) -> bool {
        let mut none = Vec::new();
        self.search.near_into(capsule, 0.0, &self.end_m, &mut none) > 0
    }

    /// Appends what is within `margin_m` of a resting capsule, as far as there is room; answers how many found none.
    pub(super) fn near_into(&self, capsule: &Capsule, margin_m: f64, found: &mut Vec<ToolContact>) -> usize {
        self.search.near_into(capsule, margin_m, &self.end_m, found)
    }

    /// Puts what is nearest to a resting capsule, and within `reach_m` of it, into `found`, nearest first, as far as there is room.
    pub(super) fn nearest_into(&self, capsule: &Capsule, reach_m: f64, found: &mut Vec<ToolContact>) {
        self.search.nearest_into(capsule, reach_m, &self.end_m, found);
    }

    /// The surface as it is now, for proxies.
    pub(super) fn proxy_surface(&self) -> ProxySurface<'_> {
        ProxySurface { positions_m: &self.end_m, adjacency: &self.adjacency }
    }

    /// Slot of a triangle of the surface.
    pub(super) fn slot_of(&self, triangle: TriangleId) -> Option<u32> {
        self.slots.get(triangle.index()).copied().filter(|&slot| slot != NONE)
    }

    /// Nodes of the triangles around a node, ascending by triangle: the order does not depend on past edits. Beyond
    /// [`MOST_AROUND`] none.
    pub(super) fn around(&self, node: NodeId) -> impl Iterator<Item = [NodeId; 3]> + '_ {
        let mut slots = [NONE; MOST_AROUND];
        let n = slots
            .iter_mut()
            .zip(self.adjacency.around(node.0))
            .map(|(slot, (found, _))| *slot = found)
            .count();
        slots[..n].sort_unstable_by_key(|slot| self.triangles[*slot as usize]);
        slots.into_iter().take(n).map(|slot| self.nodes[slot as usize])
    }

    /// Triangle in a filled slot, and its nodes, counter-clockwise from outside.
    pub(super) fn place_in_slot(&self, slot: u32) -> (TriangleId, [NodeId; 3]) {
        (TriangleId(self.triangles[slot as usize]), self.nodes[slot as usize])
    }

    /// Triangle and nodes of what was found.
    pub(super) fn place_of(&self, found: ToolContact) -> SurfacePlace {
        let slot = found.triangle as usize;
        SurfacePlace { triangle: TriangleId(self.triangles[slot]), nodes: self.nodes[slot], found }
    }

    /// How fast a place of a triangle moved in the last step of `dt_s` [m/s].
    pub(super) fn velocity_m_per_s(&self, nodes: [NodeId; 3], weights: [f64; 3], dt_s: f64) -> DVec3 {
        let way_m = |v: usize| self.end_m[nodes[v].index()] - self.start_m[nodes[v].index()];
        (0..3).map(|v| way_m(v) * (weights[v] / dt_s)).sum()
    }

    /// Positions of all nodes now [m]; there may be more than nodes.
    pub(super) fn positions_m(&self) -> &[DVec3] {
        &self.end_m
    }
}
