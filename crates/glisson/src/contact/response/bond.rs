//! Attachments between two bodies: springs with dampers between a node and a place on the other body's surface.

use super::{NodeContact, within_cone};
use crate::math::DVec3;
use crate::mesh::NodeId;

/// What a bond does.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum BondKind {
    /// Holds the node where it was against the triangle: it pulls and pushes along all axes.
    Glue {
        /// The node's place at rest against the place touched, along the triangle's first edge, its normal and across [m].
        offset_m: DVec3,
    },
    /// Pulls when it is longer than this, and never pushes.
    Ligament {
        /// Length up to which it is slack [m].
        slack_length_m: f64,
    },
}

/// A spring between a node and a place of a triangle of another body.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Bond {
    /// The node, then the triangle's.
    pub nodes: [NodeId; 4],
    /// 1, then minus the barycentric weights of the place.
    pub weights: [f64; 4],
    /// What it does.
    pub kind: BondKind,
    /// Stiffness [N/m].
    pub stiffness_n_per_m: f64,
    /// Damping over stiffness [s].
    pub damping_s: f64,
    /// Whether edges and hot tips part it.
    pub can_be_cut: bool,
    /// Pull that tears it [N]; infinite for one that nothing tears.
    pub strength_n: f64,
}

/// The triangle's frame: first edge, normal, across.
fn frame([a, b, c]: [DVec3; 3]) -> [DVec3; 3] {
    let along = (b - a).normalize_or_zero();
    let normal = (b - a).cross(c - a).normalize_or_zero();
    [along, normal, along.cross(normal)]
}

impl Bond {
    /// Glue of a node to the place of a triangle with these barycentric weights.
    pub fn glue(
        nodes: [NodeId; 4],
        at: [f64; 3],
        rest_m: &[DVec3],
        stiffness_n_per_m: f64,
        damping_s: f64,
    ) -> Self {
        let [node, a, b, c] = nodes.map(|n| rest_m[n.index()]);
        let offset_m = node - (a * at[0] + b * at[1] + c * at[2]);
        let offset_m = DVec3::from_array(frame([a, b, c]).map(|axis| axis.dot(offset_m)));
        Self::new(nodes, at, BondKind::Glue { offset_m }, stiffness_n_per_m, damping_s)
    }

    /// A ligament, slack up to its length at rest.
    pub fn ligament(
        nodes: [NodeId; 4],
        at: [f64; 3],
        rest_m: &[DVec3],
        stiffness_n_per_m: f64,
        damping_s: f64,
    ) -> Self {
        let [node, a, b, c] = nodes.map(|n| rest_m[n.index()]);
        let slack_length_m = node.distance(a * at[0] + b * at[1] + c * at[2]);
        Self::new(nodes, at, BondKind::Ligament { slack_length_m }, stiffness_n_per_m, damping_s)
    }

    /// One that nothing parts.
    fn new(nodes: [NodeId; 4], at: [f64; 3], kind: BondKind, stiffness_n_per_m: f64, damping_s: f64) -> Self {
        let weights = [1.0, -at[0], -at[1], -at[2]];
        let (can_be_cut, strength_n) = (false, f64::INFINITY);
        Self { nodes, weights, kind, stiffness_n_per_m, damping_s, can_be_cut, strength_n }
    }
}

/// Of the pull of a ligament so much may act across its direction: a choice.
const MOST_LEAN: f64 = 1.0;

/// A bond as a row of the system of contacts.
#[derive(Clone, Debug)]
pub(super) struct BondRow {
    /// Which vertices, with what weights; of a bond with a node that is not on the surface none.
    pub(super) sides: NodeContact,
    /// What is to be closed [m].
    pub(super) opening_m: DVec3,
    /// Further opening for a force on the node [m/N].
    pub(super) yields_m_per_n: f64,
    /// Of a ligament: direction from the place to the node, or zero where it is slack.
    pull_along: Option<DVec3>,
    /// Whether it holds: it was not parted, and all its nodes are on the surface.
    pub(super) is_whole: bool,
}

impl BondRow {
    pub(super) fn new(bond: &Bond, nodes: &[NodeId]) -> Self {
        let vertices = bond.nodes.map(|node| nodes.binary_search(&node).ok());
        let is_whole = vertices.iter().zip(bond.weights).all(|(v, w)| v.is_some() || w == 0.0);
        let weights = if is_whole { bond.weights } else { [0.0; 4] };
        let vertices = vertices.map(|v| v.unwrap_or(0) as u32);
        let (normal, gap_m, rigid_m_per_s) = (DVec3::Z, 0.0, DVec3::ZERO);
        Self {
            sides: NodeContact { vertices, weights, normal, gap_m, rigid_m_per_s },
            opening_m: DVec3::ZERO,
            yields_m_per_n: 0.0,
            pull_along: None,
            is_whole,
        }
    }

    /// It holds no more.
    pub(super) fn part(&mut self) {
        self.is_whole = false;
        self.sides.weights = [0.0; 4];
    }

    /// Its two ends [m], with the node of each vertex and the places of all nodes [m]; none of one that holds no more.
    pub(super) fn ends_m(&self, nodes: &[NodeId], positions_m: &[DVec3]) -> Option<[DVec3; 2]> {
        let [node, a, b, c] = self.sides.vertices.map(|v| positions_m[nodes[v as usize].index()]);
        let [_, wa, wb, wc] = self.sides.weights;
        self.is_whole.then(|| [node, -(a * wa + b * wb + c * wc)])
    }

    /// How hard a force on the node pulls the two sides apart or along each other [N]: what presses them together does not count.
    pub(super) fn pull_n(&self, force_n: DVec3, positions_m: &[DVec3]) -> f64 {
        let [_, a, b, c] = self.sides.vertices.map(|v| positions_m[v as usize]);
        let normal = (b - a).cross(c - a).normalize_or_zero();
        (force_n - normal * force_n.dot(normal).max(0.0)).length()
    }

    /// The row at these places after a step of `dt_s`.
    pub(super) fn open(
        &mut self,
        bond: &Bond,
        positions_m: &[DVec3],
        velocities_m_per_s: &[DVec3],
        dt_s: f64,
    ) {
        if !self.is_whole {
            (self.opening_m, self.yields_m_per_n) = (DVec3::ZERO, 0.0);
            return;
        }
        let apart_m: DVec3 = self.sides.sides().map(|(v, w)| positions_m[v] * w).sum();
        let way_m = self.sides.relative_m_per_s(velocities_m_per_s) * dt_s;
        let damped = bond.damping_s / (dt_s + bond.damping_s);
        self.yields_m_per_n = (1.0 - damped) / bond.stiffness_n_per_m;
        match bond.kind {
            BondKind::Glue { offset_m } => {
                let [_, a, b, c] = self.sides.vertices.map(|v| positions_m[v as usize]);
                let axes = frame([a, b, c]);
                let wanted_m = axes[0] * offset_m.x + axes[1] * offset_m.y + axes[2] * offset_m.z;
                // k e + d e'/h = (k + d/h)(e - damped (e - way)).
                let stretch_m = apart_m - wanted_m;
                self.opening_m = stretch_m - (stretch_m - way_m) * damped;
                self.pull_along = None;
            }
            BondKind::Ligament { slack_length_m } => {
                let along = apart_m.normalize_or_zero();
                let stretch_m = apart_m.length() - slack_length_m;
                let before_m = (stretch_m - way_m.dot(along)).max(0.0);
                self.opening_m = along * (stretch_m - before_m * damped);
                self.pull_along = Some(along);
            }
        }
    }

    /// The nearest force on the node that the bond can exert. The pull of a ligament may lean: its direction is that before the
    /// response, and what keeps it from swinging past its new one in a step is a force across it, which is none at rest.
    pub(super) fn project(&self, force_n: DVec3) -> DVec3 {
        match self.pull_along {
            _ if !self.is_whole => DVec3::ZERO,
            None => force_n,
            Some(along) => within_cone(-along, force_n, MOST_LEAN),
        }
    }
}
