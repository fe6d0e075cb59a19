//! Parts of one body that the lattice sees apart, joined along the body.
//!
//! A body thinner than the lattice's cells, such as a duct, shows as a chain of crumbs. Each point of space is within
//! [`COVERING_RADIUS`] of a lattice node, and the nodes nearest to the points of a curve follow each other by edges of
//! the lattice (their Voronoi cells, truncated octahedra, meet in faces only across such edges, but for single points
//! of the curve). So two crumbs that hang together in the body are linked by nodes no farther outside than that; the
//! link whose nodes are least far outside in sum is found by the shortest path (Dijkstra 1959, doi 10.1007/BF01386390).

use super::lattice::N_DIRECTIONS;
use super::signs::{OrderedNumber, SignGrid};
use std::cmp::Reverse;
use std::collections::{BTreeMap, BTreeSet, BinaryHeap};

/// Farthest that a point can be from the nodes of a body-centred cubic lattice, in cells: a quarter of the root of 5.
const COVERING_RADIUS: f64 = 0.559_017;

impl SignGrid<'_> {
    /// Joins the connected sets of inside nodes, the smallest to what is nearest, by nodes at most the covering radius
    /// above the level that are not `closed`, until there are `n_bodies` or nothing links more. Answers the nodes that
    /// were turned.
    pub(super) fn join_crumbs(
        &self,
        inside: &mut [bool],
        distance_m: &[f64],
        level_m: f64,
        n_bodies: usize,
        is_closed: impl Fn(usize) -> bool,
    ) -> Vec<usize> {
        let mut turned = Vec::new();
        let (mut set_of, sizes) = self.components(inside, true);
        // Sets that may still be joined to others, by size.
        let mut open: BTreeSet<(usize, u32)> = sizes.iter().copied().zip(0..).collect();
        let mut n_sets = sizes.len();
        while n_sets > n_bodies && open.len() > 1 {
            let Some((size, crumb)) = open.pop_first() else { break };
            let is_goal = |node: usize| inside[node] && set_of[node] != crumb;
            let outside_m = |node: usize| match is_closed(node) {
                true => f64::INFINITY,
                false => (distance_m[node] - level_m).max(0.0),
            };
            let starts = (0..inside.len()).filter(|&n| inside[n] && set_of[n] == crumb);
            let Some((goal, path)) = self.shortest_path(starts, is_goal, outside_m) else { continue };
            let joined = set_of[goal];
            let joined_size = set_of.iter().filter(|set| **set == joined).count();
            if open.remove(&(joined_size, joined)) {
                open.insert((joined_size + size + path.len(), joined));
            }
            set_of.iter_mut().filter(|set| **set == crumb).for_each(|set| *set = joined);
            for node in path {
                inside[node] = true;
                set_of[node] = joined;
                turned.push(node);
            }
            n_sets -= 1;
        }
        turned
    }

    /// Whether no node was turned to inside that is more than the covering radius outside: such nodes
    /// are a bar through the void, put there for the sake of the topology.
    pub(super) fn keeps_to_the_body(
        &self,
        before: &[bool],
        after: &[bool],
        distance_m: &[f64],
        level_m: f64,
    ) -> bool {
        let most_m = COVERING_RADIUS * self.cell_m();
        (0..before.len()).all(|n| before[n] || !after[n] || distance_m[n] - level_m <= most_m)
    }

    /// The path of least cost from the starts to a goal, over nodes that cost at most the covering radius [m]; the
    /// goal and the nodes before it, without the start.
    fn shortest_path(
        &self,
        starts: impl Iterator<Item = usize>,
        is_goal: impl Fn(usize) -> bool,
        cost_m: impl Fn(usize) -> f64,
    ) -> Option<(usize, Vec<usize>)> {
        let most_m = COVERING_RADIUS * self.cell_m();
        let mut before = BTreeMap::new();
        let mut heap = BinaryHeap::new();
        for start in starts {
            before.insert(start, start);
            heap.push(Reverse((OrderedNumber(0.0), start, start)));
        }
        while let Some(Reverse((OrderedNumber(so_far_m), node, from))) = heap.pop() {
            if node != from && before.contains_key(&node) {
                continue;
            }
            before.insert(node, from);
            if is_goal(node) {
                let mut path = Vec::new();
                let mut at = from;
                while before[&at] != at {
                    path.push(at);
                    at = before[&at];
                }
                return Some((node, path));
            }
            for other in (0..N_DIRECTIONS).map(|direction| self.neighbour(node, direction)) {
                let cost = cost_m(other);
                if self.may_be_inside(other) && cost <= most_m && !before.contains_key(&other) {
                    heap.push(Reverse((OrderedNumber(so_far_m + cost), other, node)));
                }
            }
        }
        None
    }
}

#[cfg(test)]
mod tests {
    use super::super::{Lattice, Stuffing, WantedTopology};
    use crate::math::{DVec3, segment_distance};

    #[test]
    fn what_the_lattice_sees_of_a_thin_duct_stays_wherever_it_lies() {
        let end = DVec3::new(9.3, 1.7, -2.1);
        let field = |p: DVec3| (p.length() - 3.0).min(segment_distance([DVec3::ZERO, end], [p, p]) - 0.42);
        let mut n_joined = 0;
        for place in 0..20 {
            let shift = (DVec3::new(0.37, 0.61, 0.83) * f64::from(place)).fract();
            let origin_m = DVec3::new(-6.0, -7.0, -7.0) + shift;
            let lattice = Lattice { dims: [20, 14, 14], cell_m: 1.0, origin_m };
            let mut stuffing = Stuffing::new(lattice, field, WantedTopology::BALL);
            let filling = stuffing.fill(0.0).unwrap();
            assert_eq!(filling.sign_changes.crumb_nodes, 0, "{place}");
            n_joined += usize::from(stuffing.n_changed_signs() > 0);
            let farthest = filling.mesh.positions_m.iter().map(|&p| field(p)).fold(0.0, f64::max);
            assert!(farthest < 0.6, "{place}: tissue {farthest} cells outside");
        }
        assert!(n_joined > 5, "{n_joined} ducts show as crumbs");
    }
}
