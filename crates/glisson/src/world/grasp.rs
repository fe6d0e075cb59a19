//! Tissue between closed jaws.
//!
//! When the jaws have closed, the surface nodes between them follow the tool, position and turn. The hold is friction: a
//! pull beyond the coefficient times the closing force makes the tissue slide along the jaws until the pull is what they
//! hold; nodes that slide out are let go one by one. Opening the jaws lets go of all.

use super::organ::Organ;
use crate::contact::shapes::Capsule;
use crate::contact::tool_contact::ToolContact;
use crate::math::DVec3;
use crate::mesh::NodeId;
use crate::tool::pose::ToolFrame;
use crate::tool::{Jaws, Tool, ToolInput};

/// Jaws that are closed this far hold tissue: a choice.
pub(super) const HOLDS_BELOW: f64 = 0.25;
/// Jaws that are open this far let go; more than the above, so that a trembling hand does not drop what it holds.
pub(super) const LETS_GO_ABOVE: f64 = 0.35;

/// Nodes that one pair of jaws holds at most: some models take 64 imposed nodes in all.
pub(super) const MOST_HELD_NODES: usize = 14;

/// Jaws reach by so many radii of their ends for tissue: jaws that press on a flat triangle take it. A choice.
pub(super) const REACH: f64 = 1.1;

/// Triangles between the jaws that are looked at.
const MOST_TRIANGLES: usize = 64;

/// Tissue slides out of the jaws no faster than this [m/s]: a choice, which keeps the step after a sudden pull smooth.
const SLIP_M_PER_S: f64 = 0.5;

/// A node that jaws hold, and where in the tool's frame [m].
#[derive(Clone, Copy, Debug, PartialEq)]
struct HeldNode {
    node: NodeId,
    in_tool_m: DVec3,
    /// Force of the jaws on it in the last step [N], where that is known for each.
    force_n: DVec3,
}

/// Nodes between jaws. In a list of fixed length, because a step that grasps allocates nothing.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Grasp {
    held: [HeldNode; MOST_HELD_NODES],
    n_held: usize,
    /// How open the jaws were when they began to close: what they enclose.
    opening: f64,
    /// Middle of what is held, where the tissue would be without pull [m].
    free_middle_m: DVec3,
    /// How far out of the organ the tissue was from the jaws that took it, in the tool's frame [m]: by what the mesh is too coarse for.
    further_out_in_tool_m: DVec3,
}

/// How jaws hold.
pub(super) struct Hold {
    /// Force of the organ on the tool [N].
    pub(super) force_on_tool_n: DVec3,
    /// Time step [s].
    pub(super) dt_s: f64,
}

impl Grasp {
    /// What jaws that just closed hold: surface nodes between them as far as they were open at `opening`. `None` when
    /// there is nothing between them that can move. On the mesh the jaws are `further_out_m` from where they are.
    pub(super) fn close(
        tool: &Tool,
        jaws: &Jaws,
        (pose, further_out_m): (&ToolInput, DVec3),
        opening: f64,
        organ: &Organ,
        near: &mut Vec<ToolContact>,
    ) -> Option<Self> {
        let held_in = ToolFrame::of(pose);
        let pose = &pose.moved_by(further_out_m);
        let frame = ToolFrame::of(pose);
        let axis = Capsule {
            from_m: pose.tip_in_world_m,
            to_m: frame.to_world_m(jaws.hinge_in_tool_m()),
            radius_m: 0.0,
        };
        let [end, _] = jaws.ends_in_tool_m(opening);
        let margin_m = REACH * tool.tip_radius_m;
        let reach_m = end.x + 0.5 * jaws.width_m + margin_m;
        near.clear();
        organ.skin().near_into(&axis, reach_m, near);
        let positions_m = organ.positions_m();
        let is_between = |place_m: DVec3| jaws.are_around(frame.to_tool_m(place_m), opening, margin_m);
        let mut found: [(f64, NodeId); MOST_HELD_NODES] =
            [(f64::INFINITY, NodeId(u32::MAX)); MOST_HELD_NODES];
        for place in near.iter().map(|&contact| organ.skin().place_of(contact)) {
            let corners_m = place.nodes.map(|n| positions_m[n.index()]);
            let weights = place.found.weights;
            let nearest_m: DVec3 = (0..3).map(|v| corners_m[v] * weights[v]).sum();
            // Of a triangle larger than the jaws, all corners are held if any of it is between them.
            let holds_all = is_between(nearest_m);
            for (node, &corner_m) in place.nodes.into_iter().zip(&corners_m) {
                if !organ.is_fixed(node) && (holds_all || is_between(corner_m)) {
                    insert_nearest(&mut found, (corner_m.distance(pose.tip_in_world_m), node));
                }
            }
        }
        let n_held = found.iter().filter(|(distance_m, _)| distance_m.is_finite()).count();
        if n_held == 0 {
            return None;
        }
        found[..n_held].sort_unstable_by_key(|&(_, node)| node);
        let place_m = |node: NodeId| positions_m.get(node.index()).copied().unwrap_or(DVec3::ZERO);
        let held = found.map(|(_, node)| HeldNode {
            node,
            in_tool_m: held_in.to_tool_m(place_m(node)),
            force_n: DVec3::ZERO,
        });
        let middle_m = found[..n_held].iter().map(|&(_, n)| place_m(n)).sum::<DVec3>() / n_held as f64;
        let further_out_in_tool_m = frame.world_from_tool.transpose() * further_out_m;
        Some(Self { held, n_held, opening, free_middle_m: middle_m, further_out_in_tool_m })
    }

    /// How far out of the organ what is held is from the jaws, where the tool is so turned [m].
    pub(super) fn further_out_m(&self, pose: &ToolInput) -> DVec3 {
        ToolFrame::of(pose).world_from_tool * self.further_out_in_tool_m
    }

    /// The nodes, ascending.
    pub(super) fn nodes(&self) -> impl Iterator<Item = NodeId> + '_ {
        self.held[..self.n_held].iter().map(|held| held.node)
    }

    /// Number of nodes.
    pub(super) fn n_nodes(&self) -> usize {
        self.n_held
    }

    /// The nodes, ascending, and where each has to be [m].
    pub(super) fn places_m(&self, frame: ToolFrame) -> impl Iterator<Item = (NodeId, DVec3)> + '_ {
        self.held[..self.n_held].iter().map(move |held| (held.node, frame.to_world_m(held.in_tool_m)))
    }

    /// Force on the organ in the last step [N].
    pub(super) fn force_on_organ_n(&self) -> DVec3 {
        self.held[..self.n_held].iter().map(|held| held.force_n).sum()
    }

    /// Force on one of the nodes in the last step [N].
    pub(super) fn force_on_node_n(&self, node: NodeId) -> DVec3 {
        let found = self.held[..self.n_held].iter().find(|held| held.node == node);
        found.map_or(DVec3::ZERO, |held| held.force_n)
    }

    /// Tells the force on one of the nodes in this step [N].
    pub(super) fn set_force_n(&mut self, node: NodeId, force_n: DVec3) {
        if let Some(held) = self.held[..self.n_held].iter_mut().find(|held| held.node == node) {
            held.force_n = force_n;
        }
    }

    /// Whether the jaws still hold.
    pub(super) fn holds(&self, pose: &ToolInput) -> bool {
        self.n_held > 0 && pose.jaw_opening < LETS_GO_ABOVE
    }

    /// Forgets nodes that are gone.
    pub(super) fn retain_nodes(&mut self, is_there: impl Fn(NodeId) -> bool) {
        self.retain(|held| is_there(held.node));
    }

    fn retain(&mut self, keeps: impl Fn(&HeldNode) -> bool) {
        let mut n_kept = 0;
        for i in 0..self.n_held {
            if keeps(&self.held[i]) {
                self.held[n_kept] = self.held[i];
                n_kept += 1;
            }
        }
        self.n_held = n_kept;
    }

    /// After a step with an imposed motion: lets the tissue slide where the pull is more than friction bears; answers how far [m].
    pub(super) fn slip(&mut self, tool: &Tool, jaws: &Jaws, pose: &ToolInput, hold: &Hold) -> f64 {
        let pull_n = hold.force_on_tool_n.length();
        let limit_n = pull_limit_n(tool, jaws, pose);
        let exceeds = pull_n > limit_n;
        if tool.grip.is_sticky || !exceeds || self.n_held == 0 {
            return 0.0;
        }
        // Elastic: the pull grows with the way. What is too much of the way is given back, along the pull.
        let frame = ToolFrame::of(pose);
        let middle_m = self.places_m(frame).map(|(_, p)| p).sum::<DVec3>() / self.n_held as f64;
        let way_m = middle_m.distance(self.free_middle_m);
        let back_m = hold.force_on_tool_n / pull_n * (way_m * (1.0 - limit_n / pull_n));
        self.slide((tool, jaws), pose, back_m, hold.dt_s)
    }

    /// Lets the tissue slide along the jaws; nodes that come out are let go. Answers how far, which is no faster than tissue
    /// slides [m].
    pub(super) fn slide(
        &mut self,
        (tool, jaws): (&Tool, &Jaws),
        pose: &ToolInput,
        way_m: DVec3,
        dt_s: f64,
    ) -> f64 {
        if way_m == DVec3::ZERO || !way_m.is_finite() {
            return 0.0;
        }
        let slide_m =
            ToolFrame::of(pose).world_from_tool.transpose() * way_m.clamp_length_max(SLIP_M_PER_S * dt_s);
        for held in &mut self.held[..self.n_held] {
            held.in_tool_m += slide_m;
        }
        let (opening, margin_m) = (self.opening, 2.0 * tool.tip_radius_m);
        let further_out_m = self.further_out_in_tool_m;
        self.retain(|held| jaws.are_around(held.in_tool_m - further_out_m, opening, margin_m));
        slide_m.length()
    }

    /// Everything that its next steps depend on.
    pub(super) fn numbers(&self) -> impl Iterator<Item = f64> + '_ {
        let held = self.held[..self.n_held].iter();
        let numbers = held.flat_map(|h| {
            let force = (h.force_n != DVec3::ZERO).then(|| h.force_n.to_array()).into_iter().flatten();
            [f64::from(h.node.0), h.in_tool_m.x, h.in_tool_m.y, h.in_tool_m.z].into_iter().chain(force)
        });
        let further = self.further_out_in_tool_m;
        let further = (further != DVec3::ZERO).then(|| further.to_array()).into_iter().flatten();
        numbers.chain(self.free_middle_m.to_array()).chain([self.opening]).chain(further)
    }
}

/// Pull that the jaws hold [N]: Coulomb's friction under the force with which they close, which fades to nothing where
/// they are open enough to hold nothing.
pub(super) fn pull_limit_n(tool: &Tool, jaws: &Jaws, pose: &ToolInput) -> f64 {
    let closed = 1.0 - (pose.jaw_opening / LETS_GO_ABOVE).clamp(0.0, 1.0);
    tool.grip.friction_coefficient * jaws.closing_force_n * closed
}

/// Work on jaws that hold tissue, for their whole way [J], and how it falls when they open by that way [J], from the stiffness
/// of what they hold along the way that they close [N/m].
///
/// The jaws close as a spring that is slack where they let go and at their closing force where they are closed: what
/// [`pull_limit_n`] takes for granted. It presses in series with the tissue: firm tissue bears the whole closing force, soft
/// tissue gives way. Both act at the middle of the jaws. A choice: no model of this project squeezes tissue between jaws.
pub(super) fn squeeze_j(jaws: &Jaws, pose: &ToolInput, tissue_n_per_m: f64) -> [f64; 2] {
    // Half the gap at the jaws' middle, for the whole way.
    let gap_m = 0.25 * jaws.length_m * jaws.greatest_opening_rad;
    let jaw_n_per_m = jaws.closing_force_n / (gap_m * LETS_GO_ABOVE);
    let sum_n_per_m = jaw_n_per_m + tissue_n_per_m;
    if !(tissue_n_per_m > 0.0 && sum_n_per_m.is_finite() && sum_n_per_m > 0.0) {
        return [0.0; 2];
    }
    let pressed_n_per_m = jaw_n_per_m * tissue_n_per_m / sum_n_per_m;
    let slope_j = 2.0 * gap_m * gap_m * pressed_n_per_m;
    [slope_j * (LETS_GO_ABOVE - pose.jaw_opening).max(0.0), slope_j]
}

/// Keeps a list of the nearest, ascending, each once.
pub(super) fn insert_nearest(list: &mut [(f64, NodeId)], new: (f64, NodeId)) {
    if list.iter().any(|&(_, node)| node == new.1) {
        return;
    }
    let before = |a: &(f64, NodeId), b: &(f64, NodeId)| a.0 < b.0 || a.0 == b.0 && a.1 < b.1;
    let Some(place) = list.iter().position(|old| before(&new, old)) else { return };
    list[place..].rotate_right(1);
    list[place] = new;
}

/// Room for the search of what is between jaws.
pub(super) fn room_for_search() -> Vec<ToolContact> {
    Vec::with_capacity(MOST_TRIANGLES)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The closing force in series with what is held: all of it on what is firm, a share on what is soft, none on nothing.
    #[test]
    fn jaws_are_pushed_open_by_what_they_squeeze() {
        let jaws = Jaws { length_m: 0.02, width_m: 4e-3, greatest_opening_rad: 1.0, closing_force_n: 5.0 };
        let pose = |jaw_opening: f64| ToolInput { jaw_opening, ..ToolInput::at(DVec3::ZERO, DVec3::Z) };
        // Both jaws at their middle move by 5 mm each when they open by 1 rad.
        let firm = |opening: f64| squeeze_j(&jaws, &pose(opening), 1e12)[0];
        assert!((firm(0.0) - 2.0 * 5.0 * 5e-3).abs() < 1e-9 && (firm(0.175) - 5.0 * 5e-3).abs() < 1e-9);
        assert_eq!(firm(0.5), 0.0);
        let jaw_n_per_m = 5.0 / (0.35 * 5e-3);
        let [half_j, slope_j] = squeeze_j(&jaws, &pose(0.1), jaw_n_per_m);
        assert!((half_j - 0.5 * firm(0.1)).abs() < 1e-9);
        let [less_j, _] = squeeze_j(&jaws, &pose(0.2), jaw_n_per_m);
        assert!((half_j - less_j - 0.1 * slope_j).abs() < 1e-12);
        for nothing in [0.0, -1.0, f64::NAN] {
            assert_eq!(squeeze_j(&jaws, &pose(0.0), nothing), [0.0; 2]);
        }
    }

    #[test]
    fn the_nearest_are_kept_once_each_in_order() {
        let mut list = [(f64::INFINITY, NodeId(u32::MAX)); 3];
        for (d, n) in [(3.0, 1), (1.0, 2), (3.0, 1), (2.0, 3), (2.0, 0), (9.0, 4)] {
            insert_nearest(&mut list, (d, NodeId(n)));
        }
        assert_eq!(list, [(1.0, NodeId(2)), (2.0, NodeId(0)), (2.0, NodeId(3))]);
    }
}
