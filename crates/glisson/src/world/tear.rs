//! What tissue does not stand: contacts and grasps that push or pull harder than it bears break through, tissue that is
//! stretched too far tears, an edge needs force before it cuts. One law for all: the fracture energy
//! ([`crate::tool::fracture`]).
//!
//! A step only measures; what tears is taken out between steps ([`World::cut_with_tools`]). It depends on the world
//! alone: a replay tears the same tetrahedra without being told.

use super::organ::Organ;
use super::overload::{Load, OF_JAWS};
use super::parts::{ToolPart, capsule};
use super::tool_state::ToolState;
use super::touch::HeldContact;
use super::{ToolCuts, World};
use crate::contact::shapes::Capsule;
use crate::contact::tool_contact::ToolContact;
use crate::math::DVec3;
use crate::mesh::TetId;
use crate::mesh::edit::TopologyChange;
use crate::tool::cautery::HeatedTissue;
use crate::tool::fracture::{CrackFront, Tearing};
use crate::tool::{Jaws, Tool, ToolInput};

/// Every tetrahedron is looked at once in so many steps, those that jaws hold after a step with too much pull: a choice.
const STEPS_FOR_ALL: u64 = 16;

/// An edge has left the tissue when it is this share of its radius away: it breaks in from where it just touches.
const LEAVES_BEYOND: f64 = 0.5;

/// Motion of the middle of the edge in the last step [m].
pub(super) fn edge_motion_m(tool: &Tool, before: &ToolInput, now: &ToolInput) -> DVec3 {
    let Some(blade) = tool.kind.blade() else { return DVec3::ZERO };
    let middle = |pose: &ToolInput| pose.tip_in_world_m + pose.shaft_in_world * (0.5 * blade.length_m);
    middle(now) - middle(before)
}

/// The crack before a part that touches. Allocates nothing.
fn front_of_part(
    tool: &Tool,
    part: ToolPart,
    pose: &ToolInput,
    organ: &Organ,
    near: &mut Vec<ToolContact>,
) -> CrackFront {
    let Some(blade) = tool.kind.blade().filter(|_| part == ToolPart::Tip && pose.is_triggered()) else {
        return CrackFront::blunt(if part == ToolPart::Shaft {
            tool.shaft_radius_m
        } else {
            tool.tip_radius_m
        });
    };
    let length_m = capsule(tool, part, pose).map_or(0.0, |edge| pressed_length_m(&edge, organ, near));
    CrackFront::edge(length_m.max(2.0 * blade.edge_radius_m), blade.edge_radius_m)
}

/// How much of a capsule's length is at the surface.
fn pressed_length_m(edge: &Capsule, organ: &Organ, near: &mut Vec<ToolContact>) -> f64 {
    near.clear();
    organ.skin().near_into(edge, 0.5 * edge.radius_m, near);
    let axis = (edge.to_m - edge.from_m).normalize_or_zero();
    let along = near.iter().map(|found| (found.contact.points_m[0] - edge.from_m).dot(axis));
    let (low_m, high_m) =
        along.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), x| (low.min(x), high.max(x)));
    (high_m - low_m).max(0.0)
}

/// What the forces of a step did to the tissue that a tool touches and holds.
impl World {
    /// After a step: whether what a part did breaks the tissue; `force_on_tool_n` is none for a part that does not touch.
    pub(super) fn load_part(&mut self, place: usize, part: ToolPart, force_on_tool_n: Option<DVec3>) {
        let Some(tearing) = self.spec.tearing else { return };
        let on_mesh = self.pose_on_mesh(place);
        let (hand, tool) = (&mut self.tool_states[place], &self.spec.tools[place]);
        let contact = hand.contacts[part.index()].as_ref();
        let load = contact.zip(force_on_tool_n).map(|(contact, force_on_tool_n)| {
            let at_m = |pose: &ToolInput| contact.at.in_world_m(tool, pose);
            let motion_m = at_m(&hand.now) - at_m(&hand.before);
            let front = front_of_part(tool, part, &on_mesh, &self.organ, &mut self.between_jaws);
            Load { force_on_tool_n, motion_m, front }
        });
        hand.overload.push(part.index(), tearing.energy, load.as_ref());
    }

    /// The same of jaws that hold.
    pub(super) fn load_jaws(&mut self, place: usize, jaws: &Jaws, force_on_tool_n: Option<DVec3>) {
        let Some(tearing) = self.spec.tearing else { return };
        let hand = &mut self.tool_states[place];
        let motion_m = hand.now.tip_in_world_m - hand.before.tip_in_world_m;
        let front = CrackFront::around(jaws.length_m, jaws.width_m);
        let load = force_on_tool_n.map(|force_on_tool_n| Load { force_on_tool_n, motion_m, front });
        hand.overload.push(OF_JAWS, tearing.energy, load.as_ref());
    }

    /// Between steps: takes out what the last step broke and what is stretched too far.
    pub(super) fn tear(&mut self, cuts: &mut ToolCuts) {
        let Some(tearing) = self.spec.tearing else { return };
        for tool in 0..self.tool_states.len() {
            for part in ToolPart::ALL {
                if std::mem::take(&mut self.tool_states[tool].overload.breaks[part.index()]) {
                    self.break_through(tool, part, cuts);
                }
            }
            if std::mem::take(&mut self.tool_states[tool].overload.breaks[OF_JAWS]) {
                let held = self.held_nodes(tool);
                let topology = self.organ.body().topology();
                let mut tets: Vec<TetId> =
                    held.iter().flat_map(|&node| topology.node_tets(node).iter().copied()).collect();
                tets.sort_unstable();
                tets.dedup();
                tets.retain(|&tet| self.is_torn(&tearing, tet));
                self.tool_states[tool].grasp = None;
                self.take_out(Some(tool), tets, cuts);
            }
        }
        let n_tets = self.organ.body().topology().n_tets() as u64;
        let n = n_tets.div_ceil(STEPS_FOR_ALL);
        let first = (self.step % STEPS_FOR_ALL) * n;
        let looked_at = (first..(first + n).min(n_tets)).map(|t| TetId::from_index(t as usize));
        let topology = self.organ.body().topology();
        let tets: Vec<TetId> =
            looked_at.filter(|&tet| topology.is_live_tet(tet) && self.is_torn(&tearing, tet)).collect();
        self.take_out(None, tets, cuts);
    }

    fn is_torn(&self, tearing: &Tearing, tet: TetId) -> bool {
        let of_mesh = || {
            let nodes = self.organ.body().topology().tet_nodes(tet);
            let now_m = self.model.state().positions_m;
            [self.organ.mesh().corners_m(tet), nodes.map(|n| now_m[n.index()])]
        };
        // Of tissue that an element carries only the element's strain is known.
        let [rest_m, now_m] = self.model.carrier_m(tet).unwrap_or_else(of_mesh);
        // What several instruments warmed adds up.
        let heat_j_per_m3: f64 = self.active.iter().map(|active| active.heat_of(tet)).sum();
        let energy = tearing.energy.weakened(HeatedTissue::LIVER.strength_left(heat_j_per_m3));
        energy.tears(&tearing.material, rest_m, now_m)
    }

    /// A part came through the tissue that it touched: an edge is in it from now on, anything else has torn it.
    fn break_through(&mut self, tool: usize, part: ToolPart, cuts: &mut ToolCuts) {
        let (hand, spec) = (&mut self.tool_states[tool], &self.spec.tools[tool]);
        let Some(contact) = hand.contacts[part.index()].take() else { return };
        let is_edge = spec.kind.blade().is_some() && part == ToolPart::Tip;
        if is_edge && hand.now.is_triggered() {
            hand.overload.edge_is_in = true;
            let inward_m = contact.normal() * -contact.depth_m();
            hand.overload.entry_m = Some([contact.normal() * (2.0 * spec.tip_radius_m), inward_m]);
            return;
        }
        let tets = self.tetrahedra_under(tool, part, &contact);
        if !self.take_out(Some(tool), tets, cuts) {
            // It cannot be torn: it lets the tool through.
            self.tool_states[tool].bury(part);
        }
    }

    /// Live tetrahedra that a part touches at a contact, at least that behind the touched triangle.
    fn tetrahedra_under(&self, tool: usize, part: ToolPart, contact: &HeldContact) -> Vec<TetId> {
        let (hand, spec) = (&self.tool_states[tool], &self.spec.tools[tool]);
        let at_m = contact.at.in_world_m(spec, &hand.now) + self.further_out_m(tool);
        let tets = self.tetrahedra_near(at_m, part.radius_m(spec));
        if !tets.is_empty() {
            return tets;
        }
        let topology = self.organ.body().topology();
        let is_there = topology.is_surface_triangle(contact.triangle);
        topology.triangle_tets(contact.triangle)[0].get().filter(|_| is_there).into_iter().collect()
    }

    /// Answers whether anything was taken out.
    fn take_out(&mut self, tool: Option<usize>, tets: Vec<TetId>, cuts: &mut ToolCuts) -> bool {
        if tets.is_empty() {
            return false;
        }
        let n_tets = tets.len();
        match self.remove_and_part(tets) {
            Ok(()) => {
                cuts.n_torn += n_tets;
                true
            }
            Err(refusal) => {
                match tool {
                    Some(tool) => cuts.refusals.push((tool, refusal)),
                    None => cuts.tear_refusal = Some(refusal),
                }
                false
            }
        }
    }

    /// An edge made a cut: the hand owes its price.
    pub(super) fn owe_for_cut(&mut self, tool: usize, area_m2: f64) {
        let Some(tearing) = self.spec.tearing else { return };
        self.tool_states[tool].overload.owed_j += tearing.energy.energy_j_per_m2 * area_m2;
    }

    /// Area that a cut laid open, at rest [m2]: half of what the surface gained.
    pub(super) fn crack_area_m2(&self, change: &TopologyChange) -> f64 {
        let (topology, rest_m) = (self.organ.body().topology(), &self.organ.mesh().positions_m);
        let area_m2 = |triangles: &[crate::mesh::TriangleId]| -> f64 {
            let of_one = |&t: &crate::mesh::TriangleId| {
                let [a, b, c] = topology.triangle_nodes(t).map(|n| rest_m[n.index()]);
                0.5 * (b - a).cross(c - a).length()
            };
            triangles.iter().map(of_one).sum()
        };
        let gained_m2 = area_m2(&change.surface_triangles_added) - area_m2(&change.surface_triangles_removed);
        0.5 * gained_m2.max(0.0)
    }
}

impl ToolState {
    /// In a step: follows an edge that cuts, and ends its stroke where it has left the tissue. Allocates nothing.
    pub(super) fn follow_edge(&mut self, tool: &Tool, organ: &Organ) {
        if !self.now.is_triggered() || !self.overload.edge_is_in {
            self.overload.end_stroke();
            return;
        }
        let is_out = |edge: Capsule| {
            !organ.skin().overlaps(&Capsule { radius_m: edge.radius_m * (1.0 + LEAVES_BEYOND), ..edge })
        };
        if capsule(tool, ToolPart::Tip, &self.now).is_none_or(is_out) {
            self.overload.end_stroke();
        }
    }
}
