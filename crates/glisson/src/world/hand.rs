//! One instrument in a world: where it is, what it touches and holds.

use super::StepInput;
use super::grasp::Grasp;
use super::organ::Organ;
use super::parts::{ToolPart, ToolPoint, capsule, mesh_of, motion, rigid_pose};
use super::skin::SurfacePlace;
use super::tear::{Overload, edge_cuts};
use super::touch::{ContactBegin, HeldContact};
use crate::contact::continuous::FirstContact;
use crate::contact::shapes::MeshShape;
use crate::contact::triangles::closest_weights;
use crate::math::DVec3;
use crate::mesh::topology::Topology;
use crate::tool::fracture::Tearing;
use crate::tool::{Tool, ToolInput};

/// A mesh touches when it is this near [m]: far below what is seen, far above rounding, so that there is a direction
/// from tissue to tool.
const MESH_SKIN_M: f64 = 1e-4;

/// What a tool felt and did in a step.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ToolReport {
    /// Force that the organ exerts on the tool [N].
    pub force_on_tool_n: DVec3,
    /// Whether a part of it touches the organ, or its jaws hold some of it.
    pub in_contact: bool,
    /// Whether it stands on tissue that is held fixed, which cannot give way.
    pub blocked_by_fixed_tissue: bool,
    /// Whether its input was not finite; it then stayed where it was.
    pub input_rejected: bool,
    /// Nodes that the jaws hold.
    pub n_held_nodes: u32,
    /// How far held or touched tissue slid on the tool in this step [m].
    pub slip_m: f64,
}

/// A tool and its contacts.
#[derive(Clone, Debug)]
pub(super) struct Hand {
    pub(super) now: ToolInput,
    /// Where it was at the end of the last step.
    pub(super) before: ToolInput,
    pub(super) contacts: [Option<HeldContact>; 3],
    /// Parts that were put into tissue: they touch nothing until they have come out of it.
    is_buried: [bool; 3],
    pub(super) grasp: Option<Grasp>,
    /// How far the jaws were open before they began to close: what they enclose.
    pub(super) opened_to: f64,
    /// Whether the jaws closed in the last step.
    pub(super) just_closed: bool,
    /// How long the active tip has been on and touching [s].
    pub(super) active_s: f64,
    /// What it does to tissue that stands no more.
    pub(super) overload: Overload,
    pub(super) report: ToolReport,
}

impl Hand {
    /// A tool at its home.
    pub(super) fn at_home(tool: &Tool) -> Self {
        let home = tool.home.through(tool.trocar_m);
        Self {
            now: home,
            before: home,
            contacts: [const { None }; 3],
            is_buried: [false; 3],
            grasp: None,
            opened_to: home.jaw_opening,
            just_closed: false,
            active_s: 0.0,
            overload: Overload::default(),
            report: ToolReport::default(),
        }
    }

    /// Everything that its next steps depend on but where it is.
    pub(super) fn numbers(&self) -> impl Iterator<Item = f64> + '_ {
        let contacts = self.contacts.iter().flatten().flat_map(HeldContact::numbers);
        let grasp = self.grasp.iter().flat_map(Grasp::numbers);
        let active = (self.active_s > 0.0).then_some(self.active_s);
        contacts.chain(grasp).chain(active).chain(self.overload.numbers())
    }

    /// Takes the input of tool number `place` over.
    pub(super) fn move_to(&mut self, tool: &Tool, place: usize, input: &StepInput) {
        self.report = ToolReport::default();
        self.before = self.now;
        let asked = &input.tools[place];
        self.report.input_rejected = !asked.is_finite();
        if !self.report.input_rejected {
            self.now = asked.through(tool.trocar_m);
            self.now.jaw_opening = asked.jaw_opening.clamp(0.0, 1.0);
        }
        if input.placed[place] {
            self.let_go();
            self.before = self.now;
        }
    }

    /// Lets go of everything.
    pub(super) fn let_go(&mut self) {
        self.contacts = [const { None }; 3];
        self.grasp = None;
        self.active_s = 0.0;
        self.overload = Overload::default();
    }

    /// A part goes on through the tissue: it touches nothing until it has come out.
    pub(super) fn bury(&mut self, part: ToolPart) {
        self.is_buried[part.index()] = true;
    }

    /// After an edit: contacts on triangles that are gone end, nodes that are gone are no longer held.
    pub(super) fn follow(&mut self, topology: &Topology) {
        for contact in &mut self.contacts {
            if contact.as_ref().is_some_and(|c| !topology.is_surface_triangle(c.triangle)) {
                *contact = None;
            }
        }
        if let Some(grasp) = &mut self.grasp {
            grasp.retain_nodes(|node| topology.is_live_node(node));
        }
    }

    /// Finds what the parts touch that touch nothing yet.
    pub(super) fn find_contacts(
        &mut self,
        tool: &Tool,
        organ: &Organ,
        tearing: Option<&Tearing>,
        is_placed: bool,
    ) {
        for part in ToolPart::ALL {
            let holds = self.grasp.is_some() && part != ToolPart::Shaft;
            // An edge that cuts does not push.
            if edge_cuts(tool, self, tearing) && part == ToolPart::Tip {
                self.contacts[part.index()] = None;
                continue;
            }
            if self.contacts[part.index()].is_some() || holds {
                continue;
            }
            let Some(resting) = capsule(tool, part, &self.now) else { continue };
            // The tip is the hand's own doing; of the rest nobody sees where it goes in.
            if is_placed && part != ToolPart::Tip || self.is_buried[part.index()] {
                self.is_buried[part.index()] = organ.skin().overlaps(&resting);
            }
            if self.is_buried[part.index()] {
                continue;
            }
            let touch = match mesh_of(tool) {
                Some(shape) if part == ToolPart::Tip => self.mesh_touch(shape, organ, is_placed),
                _ => self.capsule_touch(tool, part, organ, is_placed),
            };
            match touch {
                None | Some(ContactBegin::FromInside) => {}
                Some(ContactBegin::OnFixedTissue) => self.report.blocked_by_fixed_tissue = true,
                Some(ContactBegin::Touches(contact)) => self.contacts[part.index()] = Some(contact),
            }
        }
    }

    fn capsule_touch(
        &self,
        tool: &Tool,
        part: ToolPart,
        organ: &Organ,
        is_placed: bool,
    ) -> Option<ContactBegin> {
        let motion = motion(tool, part, &self.before, &self.now)?;
        let place = organ.skin().first_contact(&motion, !is_placed)?;
        let contact = &place.found.contact;
        let then = motion.at(contact.time);
        let axis = then.to_m - then.from_m;
        let along = (contact.points_m[0] - then.from_m).dot(axis) / axis.length_squared();
        let at = ToolPoint::OnAxis(part, if along.is_finite() { along.clamp(0.0, 1.0) } else { 0.0 });
        let point_m = at.in_world_m(tool, &self.now);
        Some(HeldContact::begin(&place, at, (point_m, motion.radius_m), organ))
    }

    fn mesh_touch(&self, shape: &MeshShape, organ: &Organ, is_placed: bool) -> Option<ContactBegin> {
        let (start, end) = (rigid_pose(&self.before), rigid_pose(&self.now));
        let reach_m = MESH_SKIN_M + shape.path_error_m(&start, &end);
        let mut first: Option<(SurfacePlace, DVec3)> = None;
        for triangle in &shape.triangles {
            let body_m = triangle.map(|v| shape.positions_m[v as usize]);
            let corners_m = [start, end].map(|pose| body_m.map(|p| pose.rotation * p + pose.origin_m));
            let Some(mut place) = organ.skin().first_contact_of_triangle(corners_m, reach_m, !is_placed)
            else {
                continue;
            };
            let found: &mut FirstContact = &mut place.found.contact;
            let is_first = first.as_ref().is_none_or(|(best, _)| {
                let best = &best.found.contact;
                found.time < best.time || found.time == best.time && found.gap_m < best.gap_m
            });
            if is_first {
                let then_m = [0, 1, 2].map(|v| corners_m[0][v].lerp(corners_m[1][v], found.time));
                let weights = closest_weights(found.points_m[0], then_m);
                let in_tool_m = (0..3).map(|v| body_m[v] * weights[v]).sum();
                if found.normal == DVec3::ZERO {
                    // They cross: out along the tissue's own normal.
                    found.normal = organ.face_normal(place.nodes);
                }
                first = Some((place, in_tool_m));
            }
        }
        let (place, in_tool_m) = first?;
        let at = ToolPoint::Fixed(in_tool_m);
        let point_m = end.rotation * in_tool_m + end.origin_m;
        Some(HeldContact::begin(&place, at, (point_m, MESH_SKIN_M), organ))
    }
}
