//! Several bodies in one world: who is who in the joint mesh, what holds each, and how they touch.

use super::World;
use super::organ::Organ;
use super::spec::{BodySpec, Ligament, Load, WorldSpec, fixed_nodes, nodes_in};
use crate::contact::response::bodies::ResponseReport;
use crate::contact::response::persistent::{BodiesOfSurface, BodyContact, ContactMemory};
use crate::contact::response::self_contact::{SelfContact, SelfContactResponse};
use crate::math::DVec3;
use crate::mesh::NodeId;
use crate::model::{DeformableModel, FixedNode, NodalForce};

impl BodySpec {
    fn own<'a>(&self, positions_m: &'a [DVec3]) -> &'a [DVec3] {
        &positions_m[self.nodes.start as usize..self.nodes.end as usize]
    }

    fn joint(&self, own: NodeId) -> NodeId {
        NodeId(own.0 + self.nodes.start)
    }
}

impl WorldSpec {
    /// The nodes that supports hold and those of rigid bodies, ascending, with places at rest [m].
    pub fn fixed_nodes(&self, positions_m: &[DVec3]) -> Vec<FixedNode> {
        if self.bodies.is_empty() {
            return fixed_nodes(&self.supports, positions_m);
        }
        let mut all = Vec::new();
        for body in &self.bodies {
            if body.is_rigid {
                all.extend(body.nodes.clone().map(|n| FixedNode { node: NodeId(n), axes: [true; 3] }));
            } else {
                let own = fixed_nodes(&body.supports, body.own(positions_m)).into_iter();
                all.extend(own.map(|held| FixedNode { node: body.joint(held.node), ..held }));
            }
        }
        all
    }

    /// The nodes of all ligaments, with places at rest [m].
    pub(super) fn ligament_nodes(&self, positions_m: &[DVec3]) -> Vec<NodeId> {
        let nodes = |ligaments: &[Ligament], positions_m: &[DVec3]| -> Vec<NodeId> {
            ligaments.iter().flat_map(|ligament| nodes_in(&[ligament.region], positions_m)).collect()
        };
        let mut all = nodes(&self.ligaments, positions_m);
        for body in &self.bodies {
            all.extend(nodes(&body.ligaments, body.own(positions_m)).into_iter().map(|n| body.joint(n)));
        }
        all
    }

    /// All loads with the nodes of their regions, with places at rest [m].
    pub(super) fn loaded_nodes(&self, positions_m: &[DVec3]) -> Vec<(Load, Vec<NodeId>)> {
        let of_one = self.loads.iter().map(|load| (*load, nodes_in(&[load.region], positions_m)));
        let mut all: Vec<(Load, Vec<NodeId>)> = of_one.collect();
        for body in &self.bodies {
            for load in &body.loads {
                let own = nodes_in(&[load.region], body.own(positions_m)).into_iter();
                all.push((*load, own.map(|node| body.joint(node)).collect()));
            }
        }
        all
    }

    /// The body of each node at the start; all of one when there is one alone.
    pub fn body_of_nodes(&self, n_nodes: usize) -> Vec<u32> {
        let mut body_of = vec![0; n_nodes];
        for (number, body) in (0..).zip(&self.bodies) {
            let nodes = body.nodes.start as usize..body.nodes.end as usize;
            body_of[nodes].fill(number);
        }
        body_of
    }
}

impl World {
    /// Starts with these forces between bodies, which are those of the rest shape.
    pub(crate) fn start_in_touch(&mut self, memory: ContactMemory) {
        if let Some(contact) = self.self_contact.take() {
            self.self_contact = Some(contact.with_memory(Some(&memory)));
        }
        self.touch_at_start = memory;
    }

    /// How several bodies touch each other.
    pub fn body_contact(&self) -> Option<&BodyContact> {
        match self.self_contact.as_deref()? {
            SurfaceContact::Own(_) => None,
            SurfaceContact::Bodies(bodies) => Some(bodies),
        }
    }
}

/// How the surface touches itself: one organ its own folds, or several bodies each other.
#[derive(Clone, Debug)]
pub(super) enum SurfaceContact {
    /// By the present state alone.
    Own(SelfContact),
    /// With forces that last.
    Bodies(BodyContact),
}

impl SurfaceContact {
    /// For the organ as it is, if the scene wants it.
    pub(super) fn of(spec: &WorldSpec, organ: &Organ, model: &dyn DeformableModel) -> Option<Box<Self>> {
        let (topology, mesh) = (organ.body().topology(), organ.mesh());
        let positions_m = model.state().positions_m;
        if let Some(params) = spec.body_contact.as_ref().filter(|_| !spec.bodies.is_empty()) {
            let is_rigid: Vec<bool> = spec.bodies.iter().map(|body| body.is_rigid).collect();
            let body_of = organ.body_of_nodes();
            let bodies = BodiesOfSurface { topology, mesh, body_of, is_rigid: &is_rigid };
            let contact = BodyContact::new(params, &bodies, &spec.bonds, positions_m);
            return Some(Box::new(Self::Bodies(contact)));
        }
        let params = spec.self_contact.as_ref()?;
        Some(Box::new(Self::Own(SelfContact::new(params, topology, mesh, positions_m))))
    }

    /// Whether forces act in steps, beside corrections of them.
    pub(super) fn acts_by_forces(&self) -> bool {
        match self {
            Self::Own(own) => matches!(own.params().response, SelfContactResponse::Penalty(_)),
            Self::Bodies(_) => true,
        }
    }

    /// The forces in the next step of `dt_s`, ascending by node.
    pub(super) fn forces(&mut self, model: &dyn DeformableModel, dt_s: f64) -> &[NodalForce] {
        match self {
            Self::Own(own) => own.forces(model, dt_s),
            Self::Bodies(bodies) => bodies.forces(),
        }
    }

    pub(super) fn respond_to_step(&mut self, model: &mut dyn DeformableModel, dt_s: f64) {
        match self {
            Self::Own(own) => own.respond_to_step(model, dt_s),
            Self::Bodies(bodies) => bodies.respond_to_step(model, dt_s),
        }
    }

    pub(super) fn report(&self) -> ResponseReport {
        match self {
            Self::Own(own) => own.report(),
            Self::Bodies(bodies) => bodies.report(),
        }
    }

    /// Forgets what was found, and what lasts.
    pub(super) fn forget(&mut self) {
        match self {
            Self::Own(own) => own.forget(),
            Self::Bodies(bodies) => bodies.forget(),
        }
    }

    /// What lasts.
    pub(super) fn memory(&self) -> Option<ContactMemory> {
        match self {
            Self::Own(_) => None,
            Self::Bodies(bodies) => Some(bodies.memory()),
        }
    }

    /// Goes on with what lasted, after [`SurfaceContact::forget`].
    pub(super) fn go_on_with(&mut self, memory: &ContactMemory) {
        if let Self::Bodies(bodies) = self {
            bodies.go_on_with(memory);
        }
    }

    /// Goes on with what lasted.
    pub(super) fn with_memory(self: Box<Self>, memory: Option<&ContactMemory>) -> Box<Self> {
        match (*self, memory) {
            (Self::Bodies(bodies), Some(memory)) => Box::new(Self::Bodies(bodies.with_memory(memory))),
            (other, _) => Box::new(other),
        }
    }

    /// What the next step depends on.
    pub(super) fn numbers(&self) -> impl Iterator<Item = f64> + '_ {
        let bodies = if let Self::Bodies(bodies) = self { Some(bodies) } else { None };
        bodies.into_iter().flat_map(BodyContact::numbers)
    }
}
