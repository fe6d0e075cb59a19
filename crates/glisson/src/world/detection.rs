//! Detection of first touches: inside a world, and beside it on a copy of the organ's surface.
//!
//! The same search serves both ([`first_touch`]): a part of an instrument moves on a known path while the surface moves on
//! another, and their first contact is found without a gap (`contact::continuous`). A machine that has the devices holds a
//! [`SurfaceCopy`] and one [`ToolDetector`] for each instrument; what they find ([`ExternalDetection`]) goes to the world with the
//! hand's pose ([`super::StepInput::detected`]). Cotin, Delingette and Ayache 1998 (RR-3511), s. 5 and 6.2, fig. 14.
//! Looking allocates nothing.

use super::World;
use super::parts::{ToolPart, ToolPoint, capsule, mesh_of, motion, rigid_pose};
use crate::contact::broad_phase::BroadPhaseKind;
use crate::contact::continuous::FirstContact;
use crate::contact::shapes::MeshShape;
use crate::contact::tool_contact::{SurfaceSearch, ToolContact};
use crate::contact::triangles::closest_weights;
use crate::math::DVec3;
use crate::mesh::edit::EditableMesh;
use crate::mesh::topology::{Topology, TopologyError};
use crate::mesh::{NodeId, TetMesh, TriangleId};
use crate::tool::external_detection::{ExternalDetection, ExternalTouch, N_TOUCHING_PARTS, TouchingPoint};
use crate::tool::{Tool, ToolInput};
use std::cell::Cell;

/// Below this cosine between the way from tissue to tool and the outward normal, the tool comes from inside.
pub(super) const FROM_INSIDE: f64 = -0.2;

/// A mesh touches when it is this near [m]: far below what is seen, far above rounding, so that there is a direction
/// from tissue to tool.
pub(super) const MESH_SKIN_M: f64 = 1e-4;

/// A touch has ended when the part is this far from the touched plane [m]: a choice, above what latency leaves of a slow
/// motion, below what is seen.
const APART_M: f64 = 2e-4;
/// An instrument that came further between two looks was put there [m]: a choice, ten times what hands do in a tick.
const JUMP_M: f64 = 0.1;
/// Nodes that moved less than this [m] did not: rounding of positions that travel as 32-bit numbers.
const STILL_M: f64 = 1e-7;
/// The nearest triangles that are looked at around an instrument, and in how far a reach [m]: choices.
const MOST_NEAR: usize = 128;
const NEAR_M: f64 = 0.02;

/// A surface that moves from one list of positions to another, with its search.
pub(super) struct SearchedSurface<'a> {
    pub(super) search: &'a SurfaceSearch,
    pub(super) start_m: &'a [DVec3],
    pub(super) end_m: &'a [DVec3],
}

impl SearchedSurface<'_> {
    /// Outward unit normal of a triangle at the end of its motion; zero for one without area.
    fn face_normal(&self, slot: u32) -> DVec3 {
        let Some(vertices) = self.search.triangle(slot) else { return DVec3::ZERO };
        let [a, b, c] = vertices.map(|v| self.end_m[v as usize]);
        (b - a).cross(c - a).normalize_or_zero()
    }
}

/// A triangle that a part touches, and what of the part touches it. The normal is never zero.
pub(super) struct FirstTouch {
    pub(super) found: ToolContact,
    pub(super) at: TouchingPoint,
}

/// What a part meets on its way.
pub(super) enum Meeting {
    /// Tissue from outside.
    Touch(FirstTouch),
    /// Nothing but tissue that it comes out of.
    FromInside,
}

/// What a part that moves from `before` to `now` meets first, from outside if there is such: at a corner of the surface, and in
/// thin tissue, other triangles that it reaches face away. None of a part that the tool does not have. A capsule whose axis
/// crosses the surface touches nothing there: it says of no side that it is the outer one. A mesh that crosses it does: out
/// along the tissue's own normal.
pub(super) fn first_touch(
    tool: &Tool,
    part: ToolPart,
    way: [&ToolInput; 2],
    surface: &SearchedSurface<'_>,
) -> Option<Meeting> {
    let mesh = if part == ToolPart::Tip { mesh_of(tool) } else { None };
    let comes_from_inside = Cell::new(false);
    let counts = |slot: u32, contact: &FirstContact| {
        if contact.normal == DVec3::ZERO {
            return mesh.is_some();
        }
        let facing = contact.normal.dot(surface.face_normal(slot));
        comes_from_inside.set(comes_from_inside.get() || facing < FROM_INSIDE);
        facing > 0.0
    };
    let touch = match mesh {
        Some(shape) => first_touch_of_mesh(shape, way, surface, &counts),
        None => first_touch_of_capsule(tool, part, way, surface, &counts),
    };
    touch.map(Meeting::Touch).or_else(|| comes_from_inside.get().then_some(Meeting::FromInside))
}

fn first_touch_of_capsule(
    tool: &Tool,
    part: ToolPart,
    [before, now]: [&ToolInput; 2],
    surface: &SearchedSurface<'_>,
    counts: &dyn Fn(u32, &FirstContact) -> bool,
) -> Option<FirstTouch> {
    let motion = motion(tool, part, before, now)?;
    let found = surface.search.first_contact_among(&motion, surface.start_m, surface.end_m, counts)?;
    let then = motion.at(found.contact.time);
    let axis = then.to_m - then.from_m;
    let along = (found.contact.points_m[0] - then.from_m).dot(axis) / axis.length_squared();
    let along = if along.is_finite() { along.clamp(0.0, 1.0) } else { 0.0 };
    Some(FirstTouch { found, at: TouchingPoint::OnAxis(along) })
}

fn first_touch_of_mesh(
    shape: &MeshShape,
    [before, now]: [&ToolInput; 2],
    surface: &SearchedSurface<'_>,
    counts: &dyn Fn(u32, &FirstContact) -> bool,
) -> Option<FirstTouch> {
    let (start, end) = (rigid_pose(before), rigid_pose(now));
    let reach_m = MESH_SKIN_M + shape.path_error_m(&start, &end);
    let mut first: Option<FirstTouch> = None;
    for triangle in &shape.triangles {
        let body_m = triangle.map(|v| shape.positions_m[v as usize]);
        let corners_m = [start, end].map(|pose| body_m.map(|p| pose.rotation * p + pose.origin_m));
        let (start_m, end_m) = (surface.start_m, surface.end_m);
        let way = (corners_m, reach_m);
        let touch = surface.search.first_contact_of_triangle_among(way, start_m, end_m, counts);
        let Some(found) = touch else { continue };
        let contact: &FirstContact = &found.contact;
        let is_first = first.as_ref().is_none_or(|best| {
            let best = &best.found.contact;
            contact.time < best.time || contact.time == best.time && contact.gap_m < best.gap_m
        });
        if is_first {
            let then_m = [0, 1, 2].map(|v| corners_m[0][v].lerp(corners_m[1][v], contact.time));
            let weights = closest_weights(contact.points_m[0], then_m);
            let in_tool_m = (0..3).map(|v| body_m[v] * weights[v]).sum();
            first = Some(FirstTouch { found, at: TouchingPoint::Fixed(in_tool_m) });
        }
    }
    let mut touch = first?;
    let contact = &mut touch.found.contact;
    if contact.normal == DVec3::ZERO {
        contact.normal = surface.face_normal(touch.found.triangle);
    }
    (contact.normal != DVec3::ZERO).then_some(touch)
}

/// Radius with which a part touches [m]; of a mesh the skin around it.
pub(super) fn touching_radius_m(tool: &Tool, part: ToolPart) -> f64 {
    match part {
        ToolPart::Tip if mesh_of(tool).is_some() => MESH_SKIN_M,
        part => part.radius_m(tool),
    }
}

/// An organ's surface as plain data: what a machine that is to hold a copy is told.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct SurfaceList {
    /// Changes whenever the triangles do.
    pub version: u32,
    /// Triangles, ascending, with their nodes counter-clockwise from outside.
    pub triangles: Vec<(TriangleId, [NodeId; 3])>,
    /// Their nodes, ascending, and where they are [m].
    pub nodes: Vec<(NodeId, DVec3)>,
}

/// Why a list is no surface.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum SurfaceListError {
    /// Nothing to touch.
    #[error("the surface has no triangle")]
    Empty,
    /// Lists are ascending, so that nothing is there twice.
    #[error("entry {0} of a list of the surface does not ascend")]
    Order(usize),
    /// A triangle names a node that is not listed.
    #[error("triangle {triangle} has node {node}, which is not among the surface's nodes")]
    Node {
        /// Number of the triangle.
        triangle: u32,
        /// Number of the node.
        node: u32,
    },
    /// A position that is not finite.
    #[error("node {0} has no finite position")]
    Position(u32),
}

impl SurfaceList {
    /// The surface of a mesh at rest: version 1, as a world that begins with it has.
    ///
    /// # Errors
    /// [`TopologyError`] when the mesh is no body.
    pub fn of_mesh(mesh: &TetMesh) -> Result<Self, TopologyError> {
        let body = EditableMesh::new(mesh.clone())?;
        Ok(Self::of(body.topology(), &mesh.positions_m, 1))
    }

    fn of(topology: &Topology, positions_m: &[DVec3], version: u32) -> Self {
        let mut triangles: Vec<_> =
            topology.surface_triangles().map(|t| (t, topology.outward_nodes(t))).collect();
        triangles.sort_unstable_by_key(|(triangle, _)| *triangle);
        let mut nodes: Vec<NodeId> = triangles.iter().flat_map(|(_, nodes)| *nodes).collect();
        nodes.sort_unstable();
        nodes.dedup();
        let nodes = nodes.into_iter().map(|n| (n, positions_m[n.index()])).collect();
        Self { version, triangles, nodes }
    }

    fn check(&self) -> Result<(), SurfaceListError> {
        if self.triangles.is_empty() {
            return Err(SurfaceListError::Empty);
        }
        let unsorted = |at: Option<usize>| at.map_or(Ok(()), |at| Err(SurfaceListError::Order(at + 1)));
        unsorted(self.triangles.windows(2).position(|pair| pair[0].0 >= pair[1].0))?;
        unsorted(self.nodes.windows(2).position(|pair| pair[0].0 >= pair[1].0))?;
        match self.nodes.iter().find(|(_, position_m)| !position_m.is_finite()) {
            Some((node, _)) => Err(SurfaceListError::Position(node.0)),
            None => Ok(()),
        }
    }
}

/// The organ's surface as it is known away from the world: triangles of one version, and nodes where they were last told
/// to be.
#[derive(Clone, Debug)]
pub struct SurfaceCopy {
    version: u32,
    search: SurfaceSearch,
    triangles: Vec<TriangleId>,
    /// Places in `nodes`.
    vertices: Vec<[u32; 3]>,
    /// Ascending.
    nodes: Vec<NodeId>,
    /// Before the last refresh and after it [m].
    start_m: Vec<DVec3>,
    shown_m: Vec<DVec3>,
    /// As placed since [m].
    end_m: Vec<DVec3>,
    /// Whether a node was put elsewhere since the last refresh, and whether the last one moved any.
    is_stale: bool,
    moves: bool,
    /// Refreshes that moved it: who has seen the last move does not meet it again.
    n_moves: u64,
}

impl SurfaceCopy {
    /// A surface that stands still.
    ///
    /// # Errors
    /// [`SurfaceListError`] when the list is none.
    pub fn new(list: &SurfaceList) -> Result<Self, SurfaceListError> {
        list.check()?;
        let nodes: Vec<NodeId> = list.nodes.iter().map(|(node, _)| *node).collect();
        let mut vertices = Vec::with_capacity(list.triangles.len());
        for (triangle, corners) in &list.triangles {
            let mut places = [0; 3];
            for (place, node) in places.iter_mut().zip(corners) {
                let missing = SurfaceListError::Node { triangle: triangle.0, node: node.0 };
                *place = nodes.binary_search(node).map_err(|_| missing)? as u32;
            }
            vertices.push(places);
        }
        let end_m: Vec<DVec3> = list.nodes.iter().map(|(_, position_m)| *position_m).collect();
        Ok(Self {
            version: list.version,
            search: SurfaceSearch::new(BroadPhaseKind::Hierarchy, &end_m, &vertices, 0),
            triangles: list.triangles.iter().map(|(triangle, _)| *triangle).collect(),
            vertices,
            nodes,
            start_m: end_m.clone(),
            shown_m: end_m.clone(),
            end_m,
            is_stale: false,
            moves: false,
            n_moves: 0,
        })
    }

    /// Which version of the surface it is.
    pub fn version(&self) -> u32 {
        self.version
    }

    /// Number of triangles.
    pub fn n_triangles(&self) -> usize {
        self.triangles.len()
    }

    /// A node is here now [m]; counts from the next [`SurfaceCopy::refresh`] on. Nodes that are not of the surface, and
    /// positions that are not finite, do not count.
    pub fn place(&mut self, node: NodeId, position_m: DVec3) {
        let Ok(at) = self.nodes.binary_search(&node) else { return };
        if position_m.is_finite() && self.end_m[at].distance(position_m) > STILL_M {
            self.end_m[at] = position_m;
            self.is_stale = true;
        }
    }

    /// The surface goes to where its nodes were placed; what it meets on its way is found by each instrument's first look before
    /// the next call.
    /// Answers whether it moved. Allocates nothing.
    pub fn refresh(&mut self) -> bool {
        let has_moved = std::mem::replace(&mut self.moves, false);
        if has_moved {
            self.start_m.copy_from_slice(&self.shown_m);
        }
        if std::mem::take(&mut self.is_stale) {
            self.shown_m.copy_from_slice(&self.end_m);
            self.moves = true;
            self.n_moves += 1;
        }
        if self.moves || has_moved {
            self.search.update(&self.start_m, &self.shown_m);
        }
        self.moves
    }

    /// Where a node is known to be [m].
    pub fn position_m(&self, node: NodeId) -> Option<DVec3> {
        self.nodes.binary_search(&node).ok().map(|at| self.end_m[at])
    }

    fn searched(&self, surface_moves: bool) -> SearchedSurface<'_> {
        let start_m = if surface_moves { &self.start_m } else { &self.shown_m };
        SearchedSurface { search: &self.search, start_m, end_m: &self.shown_m }
    }

    fn corners_m(&self, slot: u32) -> [DVec3; 3] {
        self.vertices[slot as usize].map(|v| self.shown_m[v as usize])
    }

    fn point_m(&self, slot: u32, weights: [f64; 3]) -> DVec3 {
        let corners_m = self.corners_m(slot);
        (0..3).map(|v| corners_m[v] * weights[v]).sum()
    }
}

/// A touch that lasts.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LastingTouch {
    /// What is told of it.
    pub found: ExternalTouch,
    /// Where the tip was when the part touched [m].
    pub tip_m: DVec3,
    /// The touched point then [m].
    pub surface_m: DVec3,
    /// Triangle of the copy.
    slot: u32,
}

/// How a part and the surface are together.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
enum PartState {
    #[default]
    Free,
    /// In tissue without touching it: it touches nothing until it has come out.
    Buried,
    Touches(LastingTouch),
}

/// The way that a look looks at.
struct LookedAt<'a> {
    /// At the last look, and now.
    poses: [&'a ToolInput; 2],
    /// Whether the instrument was put there.
    is_placed: bool,
    /// Whether the surface made a move over it.
    surface_moves: bool,
}

/// Looks where the parts of one instrument touch, each time that it moved.
#[derive(Clone, Debug)]
pub struct ToolDetector {
    tool: Tool,
    /// None until it was seen.
    before: Option<ToolInput>,
    version: u32,
    /// Moves of the surface that were made before the last look.
    n_moves_seen: u64,
    parts: [PartState; N_TOUCHING_PARTS],
}

impl ToolDetector {
    /// For an instrument that was not seen yet.
    pub fn new(tool: &Tool) -> Self {
        Self {
            tool: tool.clone(),
            before: None,
            version: 0,
            n_moves_seen: 0,
            parts: [PartState::Free; N_TOUCHING_PARTS],
        }
    }

    /// Nobody holds the instrument: where it is seen next it was put.
    pub fn lift(&mut self) {
        self.before = None;
        self.parts = [PartState::Free; N_TOUCHING_PARTS];
    }

    /// The touches that last, part by part.
    pub fn touches(&self) -> impl Iterator<Item = (ToolPart, &LastingTouch)> {
        ToolPart::ALL.into_iter().zip(&self.parts).filter_map(|(part, state)| match state {
            PartState::Touches(touch) => Some((part, touch)),
            PartState::Free | PartState::Buried => None,
        })
    }

    /// The world knows better: what touches does not, and touches nothing until it has come out.
    pub fn end_touches(&mut self) {
        for part in &mut self.parts {
            if matches!(part, PartState::Touches(_)) {
                *part = PartState::Buried;
            }
        }
    }

    /// Looks at the way from the last look to `pose`, over which the surface made its last move if that look did not see it.
    /// Allocates nothing.
    pub fn look(&mut self, surface: &SurfaceCopy, pose: &ToolInput) -> ExternalDetection {
        if !pose.is_finite() {
            self.lift();
            return self.detected(surface);
        }
        let mut now = self.tool.held(*pose, self.before.as_ref());
        now.jaw_opening = now.jaw_opening.clamp(0.0, 1.0);
        let is_other_surface = std::mem::replace(&mut self.version, surface.version) != surface.version;
        let is_new_move = std::mem::replace(&mut self.n_moves_seen, surface.n_moves) != surface.n_moves;
        if is_other_surface {
            // What touched the other one may touch this one: looked for where it is.
            self.parts = [PartState::Free; N_TOUCHING_PARTS];
        }
        let way_m = |before: ToolInput| before.tip_in_world_m.distance(now.tip_in_world_m);
        let known = self.before.filter(|before| way_m(*before) <= JUMP_M);
        let is_placed = known.is_none() || is_other_surface;
        if known.is_none() {
            self.parts = [PartState::Free; N_TOUCHING_PARTS];
        }
        let before = known.unwrap_or(now);
        let surface_moves = surface.moves && is_new_move;
        let way = LookedAt { poses: [&before, &now], is_placed, surface_moves: surface_moves && !is_placed };
        for part in ToolPart::ALL {
            let state = self.parts[part.index()];
            self.parts[part.index()] = self.look_at_part(part, state, &way, surface);
        }
        self.before = Some(now);
        self.detected(surface)
    }

    fn look_at_part(
        &self,
        part: ToolPart,
        state: PartState,
        way: &LookedAt<'_>,
        surface: &SurfaceCopy,
    ) -> PartState {
        let (tool, [_, now]) = (&self.tool, way.poses);
        if let PartState::Touches(touch) = state {
            let at_m = ToolPoint::of(part, touch.found.at).in_world_m(tool, now);
            let from_plane_m =
                touch.found.normal.dot(at_m - surface.point_m(touch.slot, touch.found.weights));
            let is_apart = from_plane_m - touching_radius_m(tool, part) > APART_M;
            return if is_apart { PartState::Free } else { state };
        }
        let Some(resting) = capsule(tool, part, now) else { return PartState::Free };
        // The tip is the hand's own doing; of the rest nobody sees where it goes in.
        if state == PartState::Buried || way.is_placed && part != ToolPart::Tip {
            let mut none = Vec::new();
            if surface.search.near_into(&resting, 0.0, &surface.shown_m, &mut none) > 0 {
                return PartState::Buried;
            }
            if state == PartState::Buried {
                // It was in the way when it moved off: its next motion counts.
                return PartState::Free;
            }
        }
        let searched = surface.searched(way.surface_moves);
        let FirstTouch { found, at } = match first_touch(tool, part, way.poses, &searched) {
            None => return PartState::Free,
            // It comes out of the organ: nothing holds it back.
            Some(Meeting::FromInside) => return PartState::Buried,
            Some(Meeting::Touch(touch)) => touch,
        };
        let contact = found.contact;
        PartState::Touches(LastingTouch {
            found: ExternalTouch {
                triangle: surface.triangles[found.triangle as usize],
                weights: found.weights,
                normal: contact.normal,
                at,
                gap_m: contact.gap_m,
            },
            tip_m: way.poses[0].tip_in_world_m.lerp(now.tip_in_world_m, contact.time),
            surface_m: contact.points_m[1],
            slot: found.triangle,
        })
    }

    fn detected(&self, surface: &SurfaceCopy) -> ExternalDetection {
        let mut detected =
            ExternalDetection { surface_version: surface.version, ..ExternalDetection::default() };
        for (part, touch) in self.touches() {
            detected.touches[part.index()] = Some(touch.found);
        }
        detected
    }
}

/// Room for the nodes around an instrument.
#[derive(Clone, Debug)]
pub struct NearbyNodes {
    near: Vec<ToolContact>,
    nodes: Vec<NodeId>,
}

impl Default for NearbyNodes {
    fn default() -> Self {
        Self { near: Vec::with_capacity(MOST_NEAR), nodes: Vec::with_capacity(3 * MOST_NEAR) }
    }
}

impl NearbyNodes {
    /// The nodes, the nearest triangle's first.
    pub fn nodes(&self) -> &[NodeId] {
        &self.nodes
    }
}

impl World {
    /// The organ's surface as it is now. Allocates: asked for when its version changed, not in steps.
    pub fn surface_list(&self) -> SurfaceList {
        let topology = self.organ.body().topology();
        SurfaceList::of(topology, self.organ.positions_m(), self.organ.topology_version())
    }

    /// Where a node of the surface is now [m].
    pub fn surface_position_m(&self, node: NodeId) -> Option<DVec3> {
        self.organ.positions_m().get(node.index()).copied()
    }

    /// Finds up to `most` nodes of the surface that are nearest to an instrument's end. Allocates nothing.
    pub fn nodes_near_into(&self, tool: usize, most: usize, found: &mut NearbyNodes) {
        found.nodes.clear();
        let Some(spec) = self.spec.tools.get(tool) else { return };
        let Some(shape) = capsule(spec, ToolPart::Tip, &self.pose_on_mesh(tool)) else { return };
        self.organ.skin().nearest_into(&shape, NEAR_M, &mut found.near);
        for near in &found.near {
            for node in self.organ.skin().place_of(*near).nodes {
                if found.nodes.len() < most && !found.nodes.contains(&node) {
                    found.nodes.push(node);
                }
            }
        }
    }
}
