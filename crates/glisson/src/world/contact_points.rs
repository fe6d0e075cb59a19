//! Where surfaces bear forces, for those who look on: read from what the last step left, nothing is computed for it in a step.

use super::World;
use super::bodies::SurfaceContact;
use super::parts::ToolPart;
use super::press::PairContact;
use crate::contact::response::NodeContact;
use crate::math::DVec3;
use crate::mesh::{NodeId, TriangleId};
use crate::record::snapshot::{ContactKind, ContactPoint, ContactPoints};

impl World {
    /// Writes the contacts that bore a force in the last step into `out`, where they are now: those of the instruments, and those
    /// of bodies with each other and with themselves. After an edit those whose place is gone are left out until the next step.
    pub fn contact_points_into(&self, out: &mut ContactPoints) {
        out.clear();
        self.add_pressed(out);
        self.add_held(out);
        self.add_between_tools(out);
        out.keep_greatest(0, ContactPoints::MOST_OF_TOOLS);
        let n_of_tools = out.points.len();
        match self.self_contact.as_deref() {
            None => {}
            Some(SurfaceContact::Own(own)) => {
                self.add_of_surface((own.contacts(), own.contact_forces_n()), own.nodes(), out);
            }
            Some(SurfaceContact::Bodies(bodies)) => {
                self.add_of_surface((bodies.contacts(), bodies.contact_forces_n()), bodies.nodes(), out);
            }
        }
        out.keep_greatest(n_of_tools, ContactPoints::MOST_OF_BODIES);
    }

    /// Where instruments press: at many points of a part, or at the place that the part follows.
    fn add_pressed(&self, out: &mut ContactPoints) {
        for place in self.press.places() {
            let at = (place.triangle, place.nodes, place.weights);
            self.add_of_tool(place.tool, at, (-place.inward, -place.force_n), out);
        }
        let is_told = |tool: usize, part: ToolPart| {
            self.press.places().any(|place| place.tool == tool && place.part == part.index())
        };
        for (tool, state) in self.tool_states.iter().enumerate() {
            for part in ToolPart::ALL {
                if let Some(held) = &state.contacts[part.index()]
                    && !is_told(tool, part)
                {
                    let at = (held.triangle, held.nodes, held.weights);
                    self.add_of_tool(tool, at, (held.normal, -held.force_on_organ_n()), out);
                }
            }
        }
    }

    fn add_of_tool(
        &self,
        tool: usize,
        (triangle, nodes, weights): (TriangleId, [NodeId; 3], [f64; 3]),
        (normal, force_n): (DVec3, DVec3),
        out: &mut ContactPoints,
    ) {
        if self.organ.skin().nodes_of(triangle) != Some(nodes) {
            return;
        }
        let place_m = (0..3).map(|v| self.organ.positions_m()[nodes[v].index()] * weights[v]).sum();
        let Some(touched) = self.body_of(nodes[0]) else { return };
        let kind = self.kind_of_tool_contact(touched);
        out.add(ContactPoint { kind, touched, by: tool as u8, place_m, normal, force_n });
    }

    /// What jaws hold, node by node.
    fn add_held(&self, out: &mut ContactPoints) {
        for (tool, state) in self.tool_states.iter().enumerate() {
            for node in state.grasp.iter().flat_map(super::grasp::Grasp::nodes) {
                let Some((place_m, touched)) = self.place_and_body(node) else { continue };
                let kind = self.kind_of_tool_contact(touched);
                let force_n = -self.force_on_node_n(tool, node);
                out.add(ContactPoint {
                    kind,
                    touched,
                    by: tool as u8,
                    place_m,
                    normal: DVec3::ZERO,
                    force_n,
                });
            }
        }
    }

    /// Where instruments press on each other.
    fn add_between_tools(&self, out: &mut ContactPoints) {
        for contact in self.press.pair_contacts() {
            let [by, touched] = contact.tools().map(|tool| tool as u8);
            let PairContact { place_m, normal, force_n, .. } = *contact;
            out.add(ContactPoint { kind: ContactKind::Tools, touched, by, place_m, normal, force_n });
        }
    }

    fn kind_of_tool_contact(&self, touched: u8) -> ContactKind {
        let is_rigid = self.spec.bodies.get(usize::from(touched)).is_some_and(|body| body.is_rigid);
        if is_rigid { ContactKind::ToolRigid } else { ContactKind::ToolOrgan }
    }

    /// Contacts of surfaces with each other, over vertices that are these nodes.
    fn add_of_surface(
        &self,
        (contacts, forces_n): (&[NodeContact], &[DVec3]),
        nodes: &[NodeId],
        out: &mut ContactPoints,
    ) {
        for (contact, &force_n) in contacts.iter().zip(forces_n) {
            let [vertex, of_triangle, ..] = contact.vertices.map(|v| nodes.get(v as usize).copied());
            let at = vertex.and_then(|node| self.place_and_body(node));
            let touched = of_triangle.and_then(|node| self.body_of(node));
            let (Some((place_m, by)), Some(touched)) = (at, touched) else { continue };
            let kind = if touched == by { ContactKind::Itself } else { ContactKind::Bodies };
            let point = ContactPoint { kind, touched, by, place_m, normal: contact.normal, force_n };
            // Told alike whichever of the two has the vertex: as what acts on the lower number.
            out.add(if touched < by { point.seen_from_other_side() } else { point });
        }
    }

    fn place_and_body(&self, node: NodeId) -> Option<(DVec3, u8)> {
        Some((*self.organ.positions_m().get(node.index())?, self.body_of(node)?))
    }

    fn body_of(&self, node: NodeId) -> Option<u8> {
        self.organ.body_of_nodes().get(node.index()).map(|body| *body as u8)
    }
}
