//! How touched tissue follows a tool, and slides along it: one point of contact under Coulomb's friction.
//!
//! A tool presses on a point c = sum w_i x_i of a triangle with a force F. A force at a point of an element loads the
//! element's nodes by f_i = w_i F: only then the tool does all the work that the tissue takes up, and a node's force is
//! zero when the point leaves the triangles around it, so that nothing jumps where it crosses an edge. The models take
//! displacements of nodes; with C the compliance of the patch over a step ([`crate::model::LocalModel`]), x and f of the last
//! step and p the place where the tool wants the point,
//!
//! x_i' = x_i + sum_j C_ij (w_j F - f_j), and sum w_i x_i' = p gives G F = p - c + sum w_i C_ij f_j, G = sum w_i w_j C_ij.
//!
//! Sliding does no work but that of friction, while the tissue under the point yields more near the nodes of a coarse mesh than
//! between them: energy that goes in at one place may come out as more or less at another. Over a way that comes back to
//! where it began the hand does work. Pressed in at one place and lifted at another, without friction 10 mm deep in
//! edges of 12 mm, it got 4 mJ more than the 7 mJ that it had put in.
//!
//! What C gets wrong is left in f and made good in the next steps; C over a step is stiffer than the tissue (inertia
//! counts), so that it is approached from one side. Where F leaves Coulomb's cone it is put on the cone so that the
//! condition holds along the normal, and the point slips by what is missing along the surface. The slip is walked over
//! the surface as it is ([`crate::contact::proxy`]): another point of the tissue is pressed from there on, with the same
//! law. The normal is that between the vertices' normals, which does not jump either.

use super::organ::Organ;
use super::touch::HeldContact;
use crate::contact::proxy::{Proxy, ProxyParams};
use crate::contact::spread::motion_weights;
use crate::math::{DMat3, DVec3};
use crate::mesh::NodeId;
use crate::model::{LocalModel, LocalWork};

/// Rings of tetrahedra around a patch that count and how well its columns are solved: choices. Few rings make the patch too
/// stiff, which takes a step more and is safe.
const MOST_RINGS: u32 = 2;
const TOLERANCE: f64 = 1e-2;
/// Compliance of a node of a model that does not tell it [m/N]: a choice, stiffer than a probe feels on liver.
pub(super) const UNKNOWN_M_PER_N: f64 = 1.0 / 300.0;
/// A shorter slip is none [m]: rounding of positions in a room of metres.
const LEAST_SLIP_M: f64 = 1e-10;
/// Beyond the tool's own motion the point slips by this share of an edge in a step, at most, and nodes move by it at most: a
/// choice that keeps what follows a bad compliance within bounds.
const MOST_RELAXED: f64 = 0.1;
/// Moves of the walk that make the way along the surface good for its slope.
const MOST_WALKS: usize = 4;
/// Friction that would wedge the tool in is taken for one that leaves this share of the normal compliance.
const LEAST_YIELDING: f64 = 0.2;

/// Room for the answers of patches.
pub(super) struct SlideScratch {
    pub(super) work: LocalWork,
    /// For patches of many contacts, with where their momentum takes them.
    pub(super) drifting: LocalWork,
    pub(super) local: LocalModel,
    /// Nodes of the body that it was made for.
    pub(super) n_nodes: usize,
}

impl SlideScratch {
    /// For a body of so many nodes, with some more from cuts.
    pub(super) fn for_nodes(n_nodes: usize) -> Self {
        // A copy of one would have no room.
        let room = || LocalWork::with_room_for(n_nodes + n_nodes / 2).estimating(MOST_RINGS, TOLERANCE);
        let [work, drifting] = [room().from_one_ring(), room().from_one_ring().telling_drift()];
        Self { work, drifting, local: LocalModel::new(), n_nodes }
    }

    /// For a moment that is kept, in which no step is made.
    pub(super) fn without_room() -> Self {
        let none = || LocalWork::with_room_for(0);
        // A clone has no room beyond what it holds.
        let local = LocalModel::new().clone();
        Self { work: none(), drifting: none(), local, n_nodes: 0 }
    }
}

/// How the nodes of a triangle answer to forces in a step.
pub(super) struct PatchAnswer {
    /// Displacement of node i for a force on node j [m/N]; zero for those that are fixed or that something else moves.
    compliance_m_per_n: [[DMat3; 3]; 3],
    is_free: [bool; 3],
}

impl PatchAnswer {
    /// Of a patch of three nodes.
    pub(super) fn of(local: &LocalModel, is_free: [bool; 3]) -> Self {
        let is_known = local.nodes.len() == 3 && local.compliance_m_per_n.iter().any(|c| *c != 0.0);
        let tensor = |i: usize, j: usize| match (is_free[i] && is_free[j], is_known) {
            (true, true) => local.tensor_m_per_n(i, j),
            (true, false) if i == j => DMat3::IDENTITY * UNKNOWN_M_PER_N,
            _ => DMat3::ZERO,
        };
        Self { compliance_m_per_n: [0, 1, 2].map(|i| [0, 1, 2].map(|j| tensor(i, j))), is_free }
    }

    fn moves_m(&self, forces_n: [DVec3; 3]) -> [DVec3; 3] {
        [0, 1, 2].map(|i| (0..3).map(|j| self.compliance_m_per_n[i][j] * forces_n[j]).sum())
    }
}

/// What a contact follows.
pub(super) struct Follow<'a> {
    pub(super) organ: &'a Organ,
    /// The tool's touching point [m].
    pub(super) point_m: DVec3,
    /// Radius of the tool there [m].
    pub(super) radius_m: f64,
    /// Coulomb's coefficient; infinite for what sticks.
    pub(super) friction: f64,
    /// How the hand gives way to a force on the tool [m/N]; none where it imposes its motion, and then tissue that is held
    /// fixed is not pressed.
    pub(super) hand_m_per_n: Option<f64>,
}

/// The conditions of a step in the patch's own terms.
struct Condition {
    /// G [m/N].
    point_m_per_n: DMat3,
    /// p - c + sum w_i C_ij f_j [m]: G F where nothing slips.
    wanted_m: DVec3,
}

impl HeldContact {
    /// Displacements from rest that the tool imposes on the nodes in this step; `None` for those that it does not hold. Slides
    /// as far as friction does not hold. Allocates nothing.
    pub(super) fn follow(
        &mut self,
        input: &Follow<'_>,
        answer: impl FnMut([NodeId; 3]) -> PatchAnswer,
    ) -> [Option<DVec3>; 3] {
        let Some((patch, force_n, slides)) = self.slide(input, answer) else { return [None; 3] };
        self.targets_m(input, &patch, force_n, slides)
    }

    /// Slides as far as friction does not hold: the answer of the nodes that are touched then, the force on the point, and
    /// whether it slid; none where the tool presses on nodes that do not yield. Allocates nothing.
    pub(super) fn slide(
        &mut self,
        input: &Follow<'_>,
        mut answer: impl FnMut([NodeId; 3]) -> PatchAnswer,
    ) -> Option<(PatchAnswer, DVec3, bool)> {
        self.slip_m = 0.0;
        let mut patch = answer(self.nodes);
        let mut condition = self.condition(&patch, input)?;
        let mut force_n = condition.stuck_n();
        let mut slides = false;
        if let Some(direction) = self.beyond_cone(force_n, input.friction) {
            let held_n = condition.sliding_n(self.normal, direction, input.friction);
            let slip_m = condition.wanted_m - condition.point_m_per_n * held_n;
            let nodes = self.nodes;
            if self.walk(input, slip_m) {
                if self.nodes != nodes {
                    patch = answer(self.nodes);
                }
                condition = self.condition(&patch, input)?;
            }
            force_n = condition.sliding_n(self.normal, direction, input.friction);
            slides = true;
        }
        Some((patch, force_n, slides))
    }

    /// `None` where the tool presses on nodes that do not yield.
    fn condition(&self, patch: &PatchAnswer, input: &Follow<'_>) -> Option<Condition> {
        let (w, c) = (self.weights, &patch.compliance_m_per_n);
        if input.hand_m_per_n.is_none() {
            motion_weights(w, patch.is_free.map(|is_free| !is_free))?;
        }
        let mut point_m_per_n = DMat3::IDENTITY * input.hand_m_per_n.unwrap_or(0.0);
        for (i, row) in c.iter().enumerate() {
            for (j, tensor) in row.iter().enumerate() {
                point_m_per_n += *tensor * (w[i] * w[j]);
            }
        }
        let answered_m = patch.moves_m(self.forces_n);
        let answered_m: DVec3 = (0..3).map(|i| answered_m[i] * w[i]).sum();
        let touched_m = self.point_m(input.organ.positions_m());
        let wanted_m = input.point_m + self.offset_m - touched_m + answered_m;
        let is_sound = point_m_per_n.is_finite() && wanted_m.is_finite();
        is_sound.then_some(Condition { point_m_per_n, wanted_m })
    }

    /// Direction of the friction on the organ where a force is more than it bears.
    fn beyond_cone(&self, force_n: DVec3, friction: f64) -> Option<DVec3> {
        let push_n = (-force_n.dot(self.normal)).max(0.0);
        let along_n = force_n - self.normal * force_n.dot(self.normal);
        // A push of zero bears nothing, whatever sticks.
        let borne_n = if friction.is_finite() { friction * push_n } else { f64::INFINITY };
        (along_n.length() > borne_n).then(|| along_n.normalize_or_zero())
    }

    /// Moves the touched point by a way along the surface; answers whether it is on another place then.
    fn walk(&mut self, input: &Follow<'_>, slip_m: DVec3) -> bool {
        let organ = input.organ;
        let surface = organ.skin().proxy_surface();
        let along = |way_m: DVec3| way_m - self.normal * way_m.dot(self.normal);
        let before_m = self.point_m(organ.positions_m());
        let corners_m = self.nodes.map(|n| organ.positions_m()[n.index()]);
        let edge_m = corners_m[0].distance(corners_m[1]).max(corners_m[1].distance(corners_m[2]));
        let tool_m = along(input.point_m + self.offset_m - before_m).length();
        let slip_m = along(slip_m).clamp_length_max(tool_m + MOST_RELAXED * edge_m);
        if slip_m.length() <= LEAST_SLIP_M {
            return false;
        }
        let Some(slot) = organ.skin().slot_of(self.triangle) else { return false };
        let Some(mut proxy) = Proxy::at(&surface, slot, self.weights) else { return false };
        let goal_m = before_m + slip_m;
        // The nearest point of a slope falls short of the way along the normal's plane.
        for _ in 0..MOST_WALKS {
            let here_m = proxy.point_m(organ.positions_m());
            let left_m = along(goal_m - here_m);
            proxy.advance_to(&surface, here_m + left_m, &ProxyParams::frictionless(1.0));
        }
        let place = organ.skin().place_in_slot(proxy.slot());
        let weights = proxy.weights();
        let yields = motion_weights(weights, place.1.map(|n| organ.is_fixed(n))).is_some();
        if !yields && input.hand_m_per_n.is_none() {
            return false;
        }
        let after_m = proxy.point_m(organ.positions_m());
        self.slip_m = along(after_m - before_m).length();
        let forces_n = place.1.map(|node| {
            let kept = self.nodes.iter().position(|n| *n == node);
            kept.map_or(DVec3::ZERO, |v| self.forces_n[v])
        });
        // The tool rolls over the tissue as its normal turns: slowly, by a slip of its radius to most of it.
        let turns = self.slip_m / (self.slip_m + input.radius_m.max(f64::MIN_POSITIVE));
        let there = proxy.smooth_normal(&surface).unwrap_or(self.normal);
        let normal = self.normal.lerp(there, turns).normalize_or(self.normal);
        self.offset_m += (self.normal - normal) * input.radius_m;
        (self.triangle, self.nodes) = place;
        (self.weights, self.forces_n, self.normal) = (weights, forces_n, normal);
        true
    }

    /// Displacements of the nodes for a force. What rounding and bounds leave of the condition (of its part along the normal
    /// when the point slides) is spread over the nodes.
    fn targets_m(
        &self,
        input: &Follow<'_>,
        patch: &PatchAnswer,
        force_n: DVec3,
        slides: bool,
    ) -> [Option<DVec3>; 3] {
        let (rest_m, now_m) = (&input.organ.mesh().positions_m, input.organ.positions_m());
        let corners_m = self.nodes.map(|n| now_m[n.index()]);
        let edge_m = corners_m[0].distance(corners_m[1]).max(corners_m[1].distance(corners_m[2]));
        let way_m = input.point_m + self.offset_m - self.point_m(now_m);
        // Spread over nodes beside held ones, a motion is four times as large at most.
        let most_m = 4.0 * way_m.length() + MOST_RELAXED * edge_m;
        let moves_m = patch.moves_m([0, 1, 2].map(|j| force_n * self.weights[j] - self.forces_n[j]));
        let moves_m = moves_m.map(|m| m.clamp_length_max(most_m));
        let mut missing_m = way_m - (0..3).map(|v| moves_m[v] * self.weights[v]).sum::<DVec3>();
        if slides {
            missing_m = self.normal * missing_m.dot(self.normal);
        }
        let spread = motion_weights(self.weights, patch.is_free.map(|is_free| !is_free)).unwrap_or_default();
        [0, 1, 2].map(|v| {
            let is_held = patch.is_free[v] && self.weights[v] > 0.0;
            let move_m = moves_m[v] + missing_m * spread[v];
            is_held.then(|| corners_m[v] + move_m - rest_m[self.nodes[v].index()])
        })
    }
}

impl Condition {
    /// F where nothing slips [N].
    fn stuck_n(&self) -> DVec3 {
        let g = self.point_m_per_n;
        let scale = g.diagonal().element_sum();
        // Axes that do not yield bear nothing.
        let floor = DMat3::IDENTITY * (1e-9 * scale);
        if scale > 0.0 { (g + floor).inverse() * self.wanted_m } else { DVec3::ZERO }
    }

    /// F on the cone, with friction along `direction`, that holds the condition along the normal [N].
    fn sliding_n(&self, normal: DVec3, direction: DVec3, friction: f64) -> DVec3 {
        let direction = (direction - normal * direction.dot(normal)).normalize_or_zero();
        let g = self.point_m_per_n;
        let straight_m_per_n = normal.dot(g * normal);
        if straight_m_per_n <= 0.0 {
            return DVec3::ZERO;
        }
        let yields_m_per_n = normal.dot(g * (normal - direction * friction));
        let push_n = -normal.dot(self.wanted_m) / yields_m_per_n.max(LEAST_YIELDING * straight_m_per_n);
        if push_n > 0.0 {
            direction * (friction * push_n) - normal * push_n
        } else {
            normal * (normal.dot(self.wanted_m) / straight_m_per_n)
        }
    }
}
