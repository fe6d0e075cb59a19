//! What viewers, recorders, tests and other programs see of a world.

use crate::math::DVec3;
use crate::mesh::NodeId;
use crate::tool::ToolInput;

/// Where a tool touches an organ.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ContactReport {
    /// The touched point [m].
    pub point_m: DVec3,
    /// Unit normal, out of the organ.
    pub normal: DVec3,
    /// Nodes of the touched triangle.
    pub nodes: [NodeId; 3],
    /// Barycentric weights of the touched point.
    pub weights: [f64; 3],
}

/// What one instrument does.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ToolSnapshot {
    /// Where it is.
    pub pose: ToolInput,
    /// Force that the organ exerts on it [N].
    pub force_n: DVec3,
    /// Where its tip (or first jaw), its second jaw and its shaft touch.
    pub contacts: [Option<ContactReport>; 3],
    /// Nodes that its jaws hold.
    pub n_held_nodes: u32,
}

/// Blood from severed vessels.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct BleedingSnapshot {
    /// Whether the organ has vessels at all.
    pub has_vessels: bool,
    /// Blood lost so far [m3].
    pub lost_m3: f64,
    /// Blood that is lost now [m3/s].
    pub rate_m3_per_s: f64,
    /// Clips that were set.
    pub n_clips: u32,
    /// Open ends.
    pub ends: Vec<BleedingEnd>,
}

/// An open end of a vessel.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BleedingEnd {
    /// Where it is now [m].
    pub position_m: DVec3,
    /// Blood that comes out [m3/s].
    pub rate_m3_per_s: f64,
}

/// The displayed state of a world after a step. Buffers are reused: filling one allocates only the first time.
#[derive(Clone, Debug, PartialEq)]
pub struct Snapshot {
    /// Steps made so far.
    pub step: u64,
    /// Simulated time [s].
    pub time_s: f64,
    /// Changes whenever the displayed triangles change.
    pub topology_version: u32,
    /// Positions of the displayed vertices [m].
    pub positions_m: Vec<DVec3>,
    /// The instruments, in the scene's order.
    pub tools: Vec<ToolSnapshot>,
    /// Blood from severed vessels.
    pub bleeding: BleedingSnapshot,
}

/// What a viewer needs to know once, and again after each change of topology.
#[derive(Clone, Debug, PartialEq)]
pub struct DisplayTopology {
    /// Counts up with every change.
    pub version: u32,
    /// Mesh node of each displayed vertex.
    pub nodes: Vec<NodeId>,
    /// Rest positions of the displayed vertices [m].
    pub rest_positions_m: Vec<DVec3>,
    /// Indices of displayed vertices, counter-clockwise from outside.
    pub triangles: Vec<[u32; 3]>,
    /// Whether each triangle lies in a cut: it is no part of the surface that the organ had at the start.
    pub is_cut: Vec<bool>,
    /// The body of each displayed vertex; all 0 of one organ.
    pub body_of: Vec<u8>,
}
