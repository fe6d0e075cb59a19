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
    /// A picture shows it so much further out [m]: it is that far in the surface of a mesh that is too coarse to show its dimple.
    pub shown_further_out_m: DVec3,
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
    /// Clips whose tissue is still there.
    pub clips: Vec<ClipSnapshot>,
}

/// An open end of a vessel.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BleedingEnd {
    /// Where it is now [m].
    pub position_m: DVec3,
    /// Blood that comes out [m3/s].
    pub rate_m3_per_s: f64,
}

/// A clip on a vessel.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ClipSnapshot {
    /// Its middle, on the vessel's axis [m].
    pub position_m: DVec3,
    /// Unit vector along the vessel.
    pub along: DVec3,
    /// Unit vector across the vessel, along the clip's legs to their bend.
    pub legs: DVec3,
    /// Radius of the vessel there, at rest [m].
    pub radius_m: f64,
}

/// A thread.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ThreadSnapshot {
    /// Its radius [m].
    pub radius_m: f64,
    /// Its nodes, from the first end [m].
    pub nodes_m: Vec<DVec3>,
    /// How many of them are the needle's.
    pub n_needle_nodes: u32,
    /// Where clips are on it [m].
    pub clips_m: Vec<DVec3>,
}

impl ThreadSnapshot {
    /// Begins anew with a thread of this radius, without places.
    pub fn begin(&mut self, radius_m: f64) {
        (self.radius_m, self.n_needle_nodes) = (radius_m, 0);
        self.nodes_m.clear();
        self.clips_m.clear();
    }
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
    /// Threads, in the scene's order.
    pub threads: Vec<ThreadSnapshot>,
    /// Strands of attachments between bodies that hold: both ends of each [m].
    pub strands_m: Vec<[DVec3; 2]>,
    /// How often everything went back to rest.
    pub n_resets: u32,
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

/// What touches what.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ContactKind {
    /// An instrument and tissue, which it presses or holds.
    ToolOrgan,
    /// An instrument and a rigid body.
    ToolRigid,
    /// Two bodies.
    Bodies,
    /// A body and itself.
    Itself,
    /// Two instruments.
    Tools,
}

impl ContactKind {
    /// All kinds, by their numbers.
    pub const ALL: [Self; 5] = [Self::ToolOrgan, Self::ToolRigid, Self::Bodies, Self::Itself, Self::Tools];

    /// Whether an instrument touches.
    pub fn is_of_tool(self) -> bool {
        matches!(self, Self::ToolOrgan | Self::ToolRigid | Self::Tools)
    }
}

/// A place of a surface that bears a force.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ContactPoint {
    /// What touches what.
    pub kind: ContactKind,
    /// The body that is touched: of two bodies the one with the higher number, of two instruments that one's number.
    pub touched: u8,
    /// Number of the instrument that touches it, or of the body.
    pub by: u8,
    /// Where [m].
    pub place_m: DVec3,
    /// Unit normal out of what is touched; zero where jaws hold.
    pub normal: DVec3,
    /// Force of what is touched on what touches it [N].
    pub force_n: DVec3,
}

impl ContactPoint {
    /// The same with the two bodies exchanged.
    pub(crate) fn seen_from_other_side(self) -> Self {
        let (touched, by) = (self.by, self.touched);
        Self { touched, by, normal: -self.normal, force_n: -self.force_n, ..self }
    }
}

/// All contacts of a kind.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ContactSum {
    /// How many bear a force.
    pub n: u32,
    /// Sum of the sizes of their forces [N].
    pub force_n: f64,
}

/// Where surfaces bear forces. Buffers are reused.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ContactPoints {
    /// Those of instruments, then the others; of each the greatest force first, and no more than [`ContactPoints::MOST_OF_TOOLS`]
    /// and [`ContactPoints::MOST_OF_BODIES`].
    pub points: Vec<ContactPoint>,
    /// Of each kind, in the order of [`ContactKind::ALL`]: also of those that are left out.
    pub sums: [ContactSum; ContactKind::ALL.len()],
}

impl ContactPoints {
    /// Points of instruments at most: as many as one of their parts has. A choice.
    pub const MOST_OF_TOOLS: usize = 64;
    /// Other points at most: a choice, 10 kB of a snapshot.
    pub const MOST_OF_BODIES: usize = 256;

    /// Forgets all points.
    pub fn clear(&mut self) {
        self.points.clear();
        self.sums = Default::default();
    }

    /// Adds a point; nothing for one without a force, or with one that is no number, which a broken model brings about.
    pub fn add(&mut self, point: ContactPoint) {
        if point.force_n == DVec3::ZERO || !point.force_n.is_finite() || !point.place_m.is_finite() {
            return;
        }
        let sum = &mut self.sums[point.kind as usize];
        sum.n += 1;
        sum.force_n += point.force_n.length();
        self.points.push(point);
    }

    /// Of the points from number `first` on, leaves the `most` with the greatest forces, the greatest first.
    pub fn keep_greatest(&mut self, first: usize, most: usize) {
        let Some(points) = self.points.get_mut(first..) else { return };
        let place = |point: &ContactPoint| point.place_m.to_array();
        let by_force = |a: &ContactPoint, b: &ContactPoint| {
            let force = b.force_n.length().total_cmp(&a.force_n.length());
            // The same order whatever order they came in.
            place(a).iter().zip(place(b)).fold(force, |order, (a, b)| order.then_with(|| a.total_cmp(&b)))
        };
        if points.len() > most {
            points.select_nth_unstable_by(most, by_force);
            points[..most].sort_unstable_by(by_force);
            self.points.truncate(first + most);
        } else {
            points.sort_unstable_by(by_force);
        }
    }

    /// Points that bear a force and are not in the list.
    pub fn n_left_out(&self) -> usize {
        let n: usize = self.sums.iter().map(|sum| sum.n as usize).sum();
        n.saturating_sub(self.points.len())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn point(kind: ContactKind, size_n: f64) -> ContactPoint {
        let (touched, by) = (0, 1);
        ContactPoint {
            kind,
            touched,
            by,
            place_m: DVec3::X * size_n,
            normal: DVec3::Z,
            force_n: DVec3::Z * size_n,
        }
    }

    #[test]
    fn the_greatest_forces_are_kept_and_the_others_counted() {
        let mut all = ContactPoints::default();
        for i in 1..=100 {
            all.add(point(ContactKind::ToolOrgan, f64::from(i * 37 % 101)));
        }
        all.keep_greatest(0, 10);
        for i in 1..=5 {
            all.add(point(ContactKind::Itself, 1000.0 * f64::from(i)));
        }
        all.keep_greatest(10, 3);
        let sizes: Vec<f64> = all.points.iter().map(|point| point.force_n.z).collect();
        let tools: Vec<f64> = (91..=100).rev().map(f64::from).collect();
        assert_eq!(sizes[..10], tools);
        assert_eq!(sizes[10..], [5000.0, 4000.0, 3000.0]);
        assert_eq!(all.sums.map(|sum| sum.n), [100, 0, 0, 5, 0]);
        assert_eq!(all.sums.map(|sum| sum.force_n), [5050.0, 0.0, 0.0, 15_000.0, 0.0]);
        assert_eq!(all.n_left_out(), 105 - 13);
        all.keep_greatest(14, 1);
        all.clear();
        assert_eq!(all, ContactPoints::default());
    }

    #[test]
    fn what_bears_nothing_or_is_broken_is_no_point() {
        let mut all = ContactPoints::default();
        for size_n in [0.0, f64::NAN, f64::INFINITY] {
            all.add(point(ContactKind::Bodies, size_n));
        }
        assert_eq!(all, ContactPoints::default());
    }
}
