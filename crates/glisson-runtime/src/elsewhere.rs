//! What a machine that detects touches elsewhere is told of the organ's surface with each step: where the nodes near the
//! instruments are, some of the others in turn, and after a cut the new surface.

use crate::Simulation;
use crate::realtime::now_ns;
use glisson::math::DVec3;
use glisson::mesh::NodeId;
use glisson::world::detection::{NearbyNodes, SurfaceList};
use std::sync::Arc;

/// Nodes of the whole surface that are told in turn with each step, and nodes near the instruments: for all of them together,
/// so that a message for one instrument fits into one packet of Ethernet.
const TURN_NODES: usize = 16;
const NEAR_NODES: usize = 36;
/// With several instruments each has at least so many.
const LEAST_NODES: usize = 12;
/// A surface that changed is handed over when it stood for so long [ns]: a blade at work changes it with every step.
const SETTLED_NS: u64 = 50_000_000;

/// Nodes that are told for an instrument with each step, at most.
pub const MOST_NODES: usize = 64;

/// Where a node is; 32 bits are 0.06 um in half a metre.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct NodePlace {
    /// The node's number.
    pub node: u32,
    /// Where it is [m].
    pub position_m: [f32; 3],
}

impl NodePlace {
    /// That of a node at this place [m].
    pub fn of(node: NodeId, position_m: DVec3) -> Self {
        Self { node: node.0, position_m: position_m.as_vec3().to_array() }
    }

    /// Where it is [m].
    pub fn position_m(&self) -> DVec3 {
        DVec3::from_array(self.position_m.map(f64::from))
    }
}

/// The surface near an instrument.
#[derive(Clone, Debug)]
pub struct Nearby {
    /// Version of the surface now.
    pub version: u32,
    /// The surface that is handed over: of an older version while this one is being cut.
    pub whole: Arc<SurfaceList>,
    nodes: [NodePlace; MOST_NODES],
    n_nodes: usize,
}

impl Default for Nearby {
    fn default() -> Self {
        Self { version: 0, whole: Arc::default(), nodes: [NodePlace::default(); MOST_NODES], n_nodes: 0 }
    }
}

impl Nearby {
    /// A surface of which nothing near is told.
    pub fn of(whole: &Arc<SurfaceList>) -> Self {
        Self { version: whole.version, whole: Arc::clone(whole), ..Self::default() }
    }

    /// Where nodes are now.
    pub fn nodes(&self) -> &[NodePlace] {
        &self.nodes[..self.n_nodes]
    }

    fn tell(&mut self, node: NodeId, simulation: &Simulation) {
        let Some(position_m) = simulation.world().surface_position_m(node) else { return };
        if let Some(place) = self.nodes.get_mut(self.n_nodes) {
            *place = NodePlace::of(node, position_m);
            self.n_nodes += 1;
        }
    }
}

/// Makes them.
#[derive(Default)]
pub(crate) struct NearbyMaker {
    found: NearbyNodes,
    whole: Arc<SurfaceList>,
    /// Version that was seen last, and since when [ns].
    version: u32,
    since_ns: u64,
    /// Next node whose turn it is.
    turn: usize,
}

impl NearbyMaker {
    /// For one of `n_tools` instruments that are held elsewhere. Allocates when the surface changed.
    pub(crate) fn at(&mut self, simulation: &Simulation, tool: usize, n_tools: usize) -> Nearby {
        let world = simulation.world();
        let version = world.organ().topology_version();
        let is_first = self.version == 0;
        if std::mem::replace(&mut self.version, version) != version {
            self.since_ns = now_ns();
        }
        let is_settled = is_first || now_ns() - self.since_ns >= SETTLED_NS;
        if self.whole.version != version && is_settled {
            self.whole = Arc::new(world.surface_list());
        }
        let nodes = [NodePlace::default(); MOST_NODES];
        let mut nearby = Nearby { version, whole: Arc::clone(&self.whole), nodes, n_nodes: 0 };
        let most = (NEAR_NODES / n_tools.max(1)).max(LEAST_NODES);
        world.nodes_near_into(tool, most, &mut self.found);
        for &node in self.found.nodes() {
            nearby.tell(node, simulation);
        }
        for _ in 0..(TURN_NODES / n_tools.max(1)).min(self.whole.nodes.len()) {
            self.turn = (self.turn + 1) % self.whole.nodes.len();
            nearby.tell(self.whole.nodes[self.turn].0, simulation);
        }
        nearby
    }
}
