//! Which lattice nodes are inside, with the wanted topology.
//!
//! The tetrahedra of the lattice make digital topology exact: the body bounded by the (unwarped) cut surface
//! deforms onto the sub-complex of the tetrahedra, faces, edges and nodes whose corners are all inside. Hence
//! - its Euler characteristic is a count over that sub-complex;
//! - turning one node is a deformation exactly when the inside part and the outside part of its 14
//!   neighbours, as sub-complexes of the sphere that they form, are both connected and not empty ("simple");
//! - growing or carving by simple nodes alone, most wanted first, keeps a known topology and comes as close
//!   to the wanted signs as it can (homotopic thinning; Lee, Kashyap and Chu 1994, doi 10.1006/cgip.1994.1042,
//!   for cubes).

use super::lattice::{Lattice, N_DIRECTIONS, link_masks, stepped};
use std::cmp::Reverse;
use std::collections::BinaryHeap;

/// What the body's surface should be.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct WantedTopology {
    /// Number of bodies (outer surfaces), at least 1.
    pub bodies: usize,
    /// Number of closed holes inside them.
    pub cavities: usize,
    /// Euler characteristic of the whole surface.
    pub surface_euler_characteristic: i64,
}

impl WantedTopology {
    /// One body like a ball.
    pub const BALL: Self = Self { bodies: 1, cavities: 0, surface_euler_characteristic: 2 };
}

/// What was done to the sampled signs.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct SignChanges {
    /// Inside nodes of bodies beyond the wanted number.
    pub crumb_nodes: usize,
    /// Outside nodes of cavities beyond the wanted number.
    pub filled_nodes: usize,
}

/// Fast neighbourhood queries on one lattice.
pub(super) struct SignGrid<'a> {
    lattice: &'a Lattice,
    steps: [[isize; N_DIRECTIONS]; 2],
    links: [u16; N_DIRECTIONS],
    /// Nodes all of whose neighbours exist.
    interior: Vec<bool>,
    /// Nodes that may be inside: their neighbours own edges, too.
    allowed: Vec<bool>,
}

impl<'a> SignGrid<'a> {
    pub(super) fn new(lattice: &'a Lattice) -> Self {
        Self {
            lattice,
            steps: lattice.neighbour_steps(),
            links: link_masks(),
            interior: (0..lattice.n_nodes()).map(|n| lattice.is_interior(n, 1)).collect(),
            allowed: (0..lattice.n_nodes()).map(|n| lattice.is_interior(n, 2)).collect(),
        }
    }

    pub(super) fn cell_m(&self) -> f64 {
        self.lattice.cell_m
    }

    pub(super) fn is_interior(&self, node: usize) -> bool {
        self.interior[node]
    }

    pub(super) fn may_be_inside(&self, node: usize) -> bool {
        self.allowed[node]
    }

    pub(super) fn neighbour(&self, node: usize, direction: usize) -> usize {
        stepped(node, self.steps[node & 1][direction])
    }

    fn inside_mask(&self, inside: &[bool], node: usize) -> u16 {
        let steps = &self.steps[node & 1];
        (0..N_DIRECTIONS).fold(0, |mask, d| mask | (u16::from(inside[stepped(node, steps[d])]) << d))
    }

    /// Whether the nodes of `mask` are connected on the link.
    fn is_connected(&self, mask: u16) -> bool {
        let mut reached = mask & mask.wrapping_neg();
        loop {
            let mut grown = reached;
            for d in 0..N_DIRECTIONS {
                if reached >> d & 1 == 1 {
                    grown |= self.links[d] & mask;
                }
            }
            if grown == reached {
                return reached == mask;
            }
            reached = grown;
        }
    }

    /// Whether the link splits into one patch inside and one outside.
    pub(super) fn is_simple(&self, inside: &[bool], node: usize) -> bool {
        let mask = self.inside_mask(inside, node);
        self.is_patch(mask) && self.is_patch(!mask & ((1 << N_DIRECTIONS) - 1))
    }

    /// Whether `mask` names at least one link node and all it names are connected.
    pub(super) fn is_patch(&self, mask: u16) -> bool {
        mask != 0 && self.is_connected(mask)
    }

    /// Sizes and members of the connected sets of nodes with `inside == kind`: for each node its set, and for
    /// each set its size. Sets are numbered by their first node.
    pub(super) fn components(&self, inside: &[bool], kind: bool) -> (Vec<u32>, Vec<usize>) {
        let mut set_of = vec![u32::MAX; inside.len()];
        let mut sizes = Vec::new();
        let mut stack = Vec::new();
        for seed in 0..inside.len() {
            if inside[seed] != kind || set_of[seed] != u32::MAX {
                continue;
            }
            let set = sizes.len() as u32;
            sizes.push(0);
            set_of[seed] = set;
            stack.push(seed);
            while let Some(node) = stack.pop() {
                sizes[set as usize] += 1;
                let mut visit = |other: usize| {
                    if inside[other] == kind && set_of[other] == u32::MAX {
                        set_of[other] = set;
                        stack.push(other);
                    }
                };
                if self.interior[node] {
                    for d in 0..N_DIRECTIONS {
                        visit(self.neighbour(node, d));
                    }
                } else {
                    // The border is outside all over and connected along its own kind: steps along the axes.
                    let place = self.lattice.place(node);
                    for axis in 0..3 {
                        let mut near = place;
                        if place[axis] > 0 {
                            near[axis] = place[axis] - 1;
                            visit(self.lattice.node(near, node & 1 == 1));
                        }
                        if place[axis] + 1 < self.lattice.dims[axis] {
                            near[axis] = place[axis] + 1;
                            visit(self.lattice.node(near, node & 1 == 1));
                        }
                    }
                    visit(node ^ 1);
                }
            }
        }
        (set_of, sizes)
    }

    /// Keeps the wanted numbers of bodies and cavities, the largest first, and turns the other nodes.
    pub(super) fn drop_crumbs(&self, inside: &mut [bool], wanted: WantedTopology) -> SignChanges {
        let mut changes = SignChanges::default();
        let (set_of, sizes) = self.components(inside, true);
        let kept = largest(&sizes, wanted.bodies, None);
        for node in 0..inside.len() {
            if inside[node] && !kept[set_of[node] as usize] {
                inside[node] = false;
                changes.crumb_nodes += 1;
            }
        }
        let (set_of, sizes) = self.components(inside, false);
        let kept = largest(&sizes, wanted.cavities, Some(set_of[0]));
        for node in 0..inside.len() {
            if !inside[node] && !kept[set_of[node] as usize] {
                inside[node] = true;
                changes.filled_nodes += 1;
            }
        }
        changes
    }

    /// Numbers of bodies and cavities and the surface's Euler characteristic that the signs stand for.
    pub(super) fn topology(&self, inside: &[bool]) -> WantedTopology {
        let mut solid_euler = 0;
        // Each node counts the simplices whose lowest corner it is: with the inside nodes of its link that
        // come after it, V - E + F - T becomes 1 - nodes + edges - triangles of that part of the link.
        let later: [u16; 2] = [0, 1].map(|odd: usize| {
            (0..N_DIRECTIONS).filter(|&d| self.steps[odd][d] > 0).fold(0, |mask, d| mask | 1 << d)
        });
        for node in 0..inside.len() {
            if inside[node] && self.interior[node] {
                let mask = self.inside_mask(inside, node) & later[node & 1];
                solid_euler += 1 - self.link_euler(mask);
            }
        }
        let bodies = self.components(inside, true).1.len();
        let cavities = self.components(inside, false).1.len().saturating_sub(1);
        WantedTopology { bodies, cavities, surface_euler_characteristic: 2 * solid_euler }
    }

    /// Euler characteristic of the part of the link over the nodes of `mask`.
    pub(super) fn link_euler(&self, mask: u16) -> i64 {
        let mut sum = i64::from(mask.count_ones());
        for a in 0..N_DIRECTIONS {
            if mask >> a & 1 == 0 {
                continue;
            }
            let edges = self.links[a] & mask & !((2u16 << a) - 1);
            sum -= i64::from(edges.count_ones());
            for b in a + 1..N_DIRECTIONS {
                if edges >> b & 1 == 1 {
                    let triangles = edges & self.links[b] & !((2u16 << b) - 1);
                    sum += i64::from(triangles.count_ones());
                }
            }
        }
        sum
    }

    /// Moves `inside` towards `wanted` by simple nodes alone: first away from what is too much, the farthest
    /// outside first, then towards what is missing, the deepest first, until nothing moves.
    fn deform(&self, inside: &mut [bool], wanted: &[bool], distance_m: &[f64]) {
        const MAX_ROUNDS: usize = 8;
        for _ in 0..MAX_ROUNDS {
            let moved = self.deform_one_way(inside, wanted, distance_m, false)
                + self.deform_one_way(inside, wanted, distance_m, true);
            if moved == 0 {
                break;
            }
        }
    }

    fn deform_one_way(
        &self,
        inside: &mut [bool],
        wanted: &[bool],
        distance_m: &[f64],
        towards: bool,
    ) -> usize {
        let urgency = |node: usize| {
            let outwards_m = if towards { -distance_m[node] } else { distance_m[node] };
            (OrderedNumber(outwards_m), Reverse(node))
        };
        let is_candidate = |inside: &[bool], node: usize| {
            self.allowed[node] && inside[node] != towards && wanted[node] == towards
        };
        let mut heap: BinaryHeap<_> = (0..inside.len())
            .filter(|&n| is_candidate(inside, n) && self.is_simple(inside, n))
            .map(urgency)
            .collect();
        let mut moved = 0;
        while let Some((_, Reverse(node))) = heap.pop() {
            if !is_candidate(inside, node) || !self.is_simple(inside, node) {
                continue;
            }
            inside[node] = towards;
            moved += 1;
            for d in 0..N_DIRECTIONS {
                let other = self.neighbour(node, d);
                if is_candidate(inside, other) && self.is_simple(inside, other) {
                    heap.push(urgency(other));
                }
            }
        }
        moved
    }

    /// Signs of the `wanted_topology` that differ least from `natural` (summed |distance to the level|), out
    /// of several starts: the bodies at higher and lower levels that have the topology, and for a ball the
    /// whole lattice and the deepest node. `None` when no start has it.
    pub(super) fn repaired(
        &self,
        natural: &[bool],
        distance_m: &[f64],
        level_m: f64,
        wanted_topology: WantedTopology,
    ) -> Option<Vec<bool>> {
        const LEVELS_EACH_WAY: usize = 10;
        let mut best: Option<(f64, Vec<bool>)> = None;
        let mut consider = |mut signs: Vec<bool>| {
            self.deform(&mut signs, natural, distance_m);
            let cost: f64 = (0..signs.len())
                .filter(|&n| signs[n] != natural[n])
                .map(|n| (distance_m[n] - level_m).abs())
                .sum();
            if best.as_ref().is_none_or(|(found, _)| cost < *found) {
                best = Some((cost, signs));
            }
        };
        for way in [1.0, -1.0] {
            for step in 1..=LEVELS_EACH_WAY {
                let level_m = level_m + way * 0.25 * step as f64 * self.lattice.cell_m;
                let mut signs: Vec<bool> =
                    (0..natural.len()).map(|n| self.allowed[n] && distance_m[n] < level_m).collect();
                self.drop_crumbs(&mut signs, wanted_topology);
                if self.topology(&signs) == wanted_topology {
                    consider(signs);
                    break;
                }
            }
        }
        if wanted_topology == WantedTopology::BALL {
            consider(self.allowed.clone());
            let deepest = (0..natural.len())
                .filter(|&n| self.allowed[n])
                .min_by(|&a, &b| distance_m[a].total_cmp(&distance_m[b]))?;
            let mut signs = vec![false; natural.len()];
            signs[deepest] = true;
            consider(signs);
        }
        best.map(|(_, signs)| signs)
    }
}

/// Marks `n_kept` of the largest sets besides `always`; of equal ones the first.
fn largest(sizes: &[usize], n_kept: usize, always: Option<u32>) -> Vec<bool> {
    let mut order: Vec<usize> = (0..sizes.len()).filter(|&s| always != Some(s as u32)).collect();
    order.sort_by_key(|&s| (Reverse(sizes[s]), s));
    let mut kept = vec![false; sizes.len()];
    for &set in order.iter().take(n_kept) {
        kept[set] = true;
    }
    if let Some(set) = always {
        kept[set as usize] = true;
    }
    kept
}

/// A float with the total order of `f64::total_cmp`.
#[derive(Clone, Copy, Debug)]
pub(super) struct OrderedNumber(pub(super) f64);

impl PartialEq for OrderedNumber {
    fn eq(&self, other: &Self) -> bool {
        self.cmp(other).is_eq()
    }
}

impl Eq for OrderedNumber {}

impl PartialOrd for OrderedNumber {
    fn partial_cmp(&self, other: &Self) -> Option<std::cmp::Ordering> {
        Some(self.cmp(other))
    }
}

impl Ord for OrderedNumber {
    fn cmp(&self, other: &Self) -> std::cmp::Ordering {
        self.0.total_cmp(&other.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::{DVec3, SeededRandom};

    fn lattice(n: usize) -> Lattice {
        Lattice { dims: [n; 3], cell_m: 1.0, origin_m: DVec3::ZERO }
    }

    #[test]
    fn link_is_a_triangulated_sphere() {
        let lattice = lattice(5);
        let grid = SignGrid::new(&lattice);
        assert_eq!(grid.link_euler((1 << N_DIRECTIONS) - 1), 2);
        let degrees: u32 = link_masks().iter().map(|m| m.count_ones()).sum();
        assert_eq!(degrees, 72, "36 edges: the tetrakis hexahedron");
    }

    #[test]
    fn turning_a_simple_node_keeps_the_topology_and_a_non_simple_one_does_not() {
        let lattice = lattice(8);
        let grid = SignGrid::new(&lattice);
        let mut random = SeededRandom::new(5);
        let (mut simple, mut other) = (0, 0);
        for _ in 0..40 {
            let inside: Vec<bool> =
                (0..lattice.n_nodes()).map(|n| grid.may_be_inside(n) && random.uniform() < 0.5).collect();
            let before = grid.topology(&inside);
            for node in (0..lattice.n_nodes()).filter(|&n| grid.may_be_inside(n)).step_by(7) {
                let mut turned = inside.clone();
                turned[node] = !turned[node];
                if grid.is_simple(&inside, node) {
                    assert_eq!(grid.topology(&turned), before);
                    simple += 1;
                } else {
                    // A few leave the counts as they are: one handle opens while another closes.
                    other += usize::from(grid.topology(&turned) != before);
                }
            }
        }
        assert!(simple > 50 && other > 50, "both kinds occur: {simple}, {other}");
    }

    #[test]
    fn a_ring_is_repaired_to_a_ball_and_to_a_torus_stays() {
        let lattice = lattice(14);
        let grid = SignGrid::new(&lattice);
        let distance: Vec<f64> = (0..lattice.n_nodes())
            .map(|n| {
                let p = lattice.position_m(n) - DVec3::splat(6.5);
                DVec3::new(p.x.hypot(p.y) - 3.5, p.z, 0.0).length() - 1.6
            })
            .collect();
        let mut ring: Vec<bool> =
            (0..distance.len()).map(|n| grid.may_be_inside(n) && distance[n] < 0.0).collect();
        let torus = WantedTopology { surface_euler_characteristic: 0, ..WantedTopology::BALL };
        assert_eq!(grid.topology(&ring), torus);
        let repaired = grid.repaired(&ring, &distance, 0.0, WantedTopology::BALL).unwrap();
        assert_eq!(grid.topology(&repaired), WantedTopology::BALL);
        // A cut through the ring breaks it; the torus comes back.
        let cut: Vec<usize> = (0..ring.len())
            .filter(|&n| {
                let p = lattice.position_m(n) - DVec3::splat(6.5);
                ring[n] && p.x > 0.0 && p.y.abs() < 0.6
            })
            .collect();
        assert!(!cut.is_empty());
        let whole = ring.clone();
        for &n in &cut {
            ring[n] = false;
        }
        assert_eq!(grid.topology(&ring), WantedTopology::BALL);
        let repaired = grid.repaired(&ring, &distance, 0.0, torus).unwrap();
        assert_eq!(grid.topology(&repaired), torus);
        assert!(repaired.iter().zip(&whole).all(|(r, w)| *w || !*r), "only nodes of the cut come back");
    }
}
