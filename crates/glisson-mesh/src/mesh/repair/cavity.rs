//! A few tetrahedra taken out of a mesh to be arranged anew: flips and moves of inner nodes, the outer triangles kept.
//!
//! Flips: two tetrahedra at a face become three around a new edge, and the tetrahedra around an inner edge make way
//! for the best others without it (3-2, 4-4 and beyond), found by dynamic programming over the triangulations of
//! the ring (Shewchuk, Two discrete optimization algorithms for the topological improvement of tetrahedral meshes,
//! 2002, after Klincsek).

use crate::math::{DVec3, tetrahedron_volume_m3};
use crate::mesh::edit::EditableMesh;
use crate::mesh::quality::radius_ratio;
use crate::mesh::topology::{TET_EDGES, TET_TRIANGLES};
use crate::mesh::{NodeId, TetId};

/// Longest ring of tetrahedra around an edge that is tried; rings of good meshes have five or six.
const LONGEST_RING: usize = 8;

/// A change counts as better from this share on, so that no two arrangements alternate.
const BETTER: f64 = 1.0 + 1e-9;

/// Tetrahedra that may be arranged anew.
#[derive(Clone, Debug)]
pub(super) struct Cavity {
    /// Nodes, ascending; the tetrahedra name places here.
    pub(super) nodes: Vec<NodeId>,
    /// Where they are at rest [m].
    pub(super) positions_m: Vec<DVec3>,
    /// Whether a node is inside: all its tetrahedra are here and it is not on the body's surface.
    is_inside: Vec<bool>,
    /// The tetrahedra with their radius ratios.
    tets: Vec<([usize; 4], f64)>,
}

impl Cavity {
    /// Takes the live tetrahedra `tets` (ascending) out of the body. Nodes that `stays` names do not move.
    pub(super) fn of(body: &EditableMesh, tets: &[TetId], stays: &dyn Fn(NodeId) -> bool) -> Self {
        let topology = body.topology();
        let mut nodes: Vec<NodeId> = tets.iter().flat_map(|&t| topology.tet_nodes(t)).collect();
        nodes.sort_unstable();
        nodes.dedup();
        let positions_m: Vec<DVec3> = nodes.iter().map(|n| body.mesh().positions_m[n.index()]).collect();
        let is_inside = nodes
            .iter()
            .map(|&n| {
                !topology.is_surface_node(n)
                    && !stays(n)
                    && topology.node_tets(n).iter().all(|t| tets.binary_search(t).is_ok())
            })
            .collect();
        let place = |n: NodeId| nodes.binary_search(&n).expect("the cavity has its tetrahedra's nodes");
        let tets = tets
            .iter()
            .map(|&t| (topology.tet_nodes(t).map(place), radius_ratio(body.mesh().corners_m(t))))
            .collect();
        Self { nodes, positions_m, is_inside, tets }
    }

    /// Corners of the tetrahedra, as places in `nodes`.
    pub(super) fn tets(&self) -> impl Iterator<Item = [usize; 4]> + '_ {
        self.tets.iter().map(|(corners, _)| *corners)
    }

    /// Smallest radius ratio.
    pub(super) fn worst(&self) -> f64 {
        self.tets.iter().fold(f64::INFINITY, |least, (_, ratio)| ratio.min(least))
    }

    fn ratio(&self, corners: [usize; 4]) -> f64 {
        radius_ratio(corners.map(|n| self.positions_m[n]))
    }

    /// Moves inner nodes of tetrahedra below `wanted` so that the worst tetrahedron at the node gets better; returns
    /// the moves in their order. Each of them leaves every tetrahedron with a positive volume.
    pub(super) fn smooth(&mut self, wanted: f64) -> Vec<usize> {
        let mut moved = Vec::new();
        for node in 0..self.nodes.len() {
            if !self.is_inside[node] {
                continue;
            }
            let star: Vec<usize> = (0..self.tets.len()).filter(|&t| self.tets[t].0.contains(&node)).collect();
            let worst = star.iter().fold(f64::INFINITY, |least: f64, &t| least.min(self.tets[t].1));
            if worst < wanted && self.smooth_node(node, &star, worst) {
                moved.push(node);
            }
        }
        moved
    }

    /// Looks for a better place along the six directions of the axes and towards the middle of the neighbours, with
    /// steps that halve.
    fn smooth_node(&mut self, node: usize, star: &[usize], worst: f64) -> bool {
        const N_HALVINGS: usize = 5;
        let start_m = self.positions_m[node];
        let (mut sum_m, mut n) = (DVec3::ZERO, 0.0);
        for other in star.iter().flat_map(|&t| self.tets[t].0).filter(|&o| o != node) {
            sum_m += self.positions_m[other];
            n += 1.0;
        }
        let middle_m = sum_m / n;
        let reach_m = star
            .iter()
            .flat_map(|&t| self.tets[t].0)
            .map(|o| self.positions_m[o].distance(start_m))
            .fold(0.0, f64::max);
        let (mut best, mut best_m) = (worst * BETTER, start_m);
        let mut step_m = 0.25 * reach_m;
        for _ in 0..N_HALVINGS {
            let center_m = best_m;
            let steps = [DVec3::X, DVec3::Y, DVec3::Z].into_iter().flat_map(|axis| [axis, -axis]);
            let trials = steps.map(|s| center_m + step_m * s);
            for trial_m in trials.chain([0.5, 1.0].map(|share| center_m.lerp(middle_m, share))) {
                self.positions_m[node] = trial_m;
                let ratio = star.iter().fold(f64::INFINITY, |least: f64, &t| {
                    if least <= best { least } else { least.min(self.ratio(self.tets[t].0)) }
                });
                if ratio > best {
                    (best, best_m) = (ratio, trial_m);
                }
            }
            step_m *= 0.5;
        }
        self.positions_m[node] = best_m;
        for &t in star {
            self.tets[t].1 = self.ratio(self.tets[t].0);
        }
        best_m != start_m
    }

    /// Flips while a flip lifts the worst of the tetrahedra that it replaces, the worst tetrahedra first; returns how
    /// many.
    pub(super) fn flip(&mut self, wanted: f64) -> usize {
        // Every flip lifts a tetrahedron above its ratio; the bound only guards against long waits.
        let most = 4 * self.tets.len();
        let mut n_flips = 0;
        while n_flips < most {
            let mut order: Vec<usize> = (0..self.tets.len()).filter(|&t| self.tets[t].1 < wanted).collect();
            order.sort_by(|&a, &b| self.tets[a].1.total_cmp(&self.tets[b].1).then(a.cmp(&b)));
            let Some((old, new)) = order.into_iter().find_map(|t| self.best_flip(t)) else { break };
            self.replace(old, new);
            n_flips += 1;
        }
        n_flips
    }

    fn replace(&mut self, mut old: Vec<usize>, new: Vec<[usize; 4]>) {
        old.sort_unstable();
        for t in old.into_iter().rev() {
            self.tets.remove(t);
        }
        for corners in new {
            self.tets.push((corners, self.ratio(corners)));
        }
    }

    /// The flip that takes tetrahedron `tet` away and leaves the best worst one: what goes and what comes.
    fn best_flip(&self, tet: usize) -> Option<(Vec<usize>, Vec<[usize; 4]>)> {
        let corners = self.tets[tet].0;
        let mut best: Option<(f64, Vec<usize>, Vec<[usize; 4]>)> = None;
        let mut offer = |ratio: f64, old: Vec<usize>, new: Vec<[usize; 4]>| {
            let before = old.iter().fold(f64::INFINITY, |least: f64, &t| least.min(self.tets[t].1));
            if ratio > before * BETTER
                && ratio > 0.0
                && best.as_ref().is_none_or(|(so_far, ..)| ratio > *so_far)
            {
                best = Some((ratio, old, new));
            }
        };
        for [i, j] in TET_EDGES {
            if let Some((ratio, old, new)) = self.without_edge(corners[i], corners[j]) {
                offer(ratio, old, new);
            }
        }
        for (apex, triangle) in TET_TRIANGLES.into_iter().enumerate() {
            let [a, b, c] = triangle.map(|k| corners[k]);
            let top = corners[apex];
            let Some((other, bottom)) = self.across(tet, [a, b, c]) else { continue };
            // Outward from the first tetrahedron a, b, c turn to the right hand around the way to the other's apex.
            let new = [[a, b, top, bottom], [b, c, top, bottom], [c, a, top, bottom]].map(|t| self.turned(t));
            let ratio = new.iter().fold(f64::INFINITY, |least: f64, &t| least.min(self.ratio(t)));
            // Without the test of volumes a non-convex pair would give an overlapping triple.
            if self.fills(&[tet, other], &new) {
                offer(ratio, vec![tet, other], new.to_vec());
            }
        }
        best.map(|(_, old, new)| (old, new))
    }

    fn turned(&self, corners: [usize; 4]) -> [usize; 4] {
        let [a, b, c, d] = corners;
        if tetrahedron_volume_m3(corners.map(|n| self.positions_m[n])) > 0.0 { corners } else { [b, a, c, d] }
    }

    /// Whether the new tetrahedra have the volume of the old ones.
    fn fills(&self, old: &[usize], new: &[[usize; 4]]) -> bool {
        /// Relative error of sums of a few volumes, far below what an overlap makes.
        const ROUNDING: f64 = 1e-10;
        let volume = |corners: [usize; 4]| tetrahedron_volume_m3(corners.map(|n| self.positions_m[n]));
        let before: f64 = old.iter().map(|&t| volume(self.tets[t].0)).sum();
        let after: f64 = new.iter().map(|&t| volume(t)).sum();
        (after - before).abs() <= ROUNDING * before.abs()
    }

    /// The other tetrahedron at a face, and its fourth node.
    fn across(&self, tet: usize, face: [usize; 3]) -> Option<(usize, usize)> {
        self.tets.iter().enumerate().find_map(|(t, (corners, _))| {
            let fourth = corners.iter().find(|n| !face.contains(n))?;
            (t != tet && face.iter().all(|n| corners.contains(n))).then_some((t, *fourth))
        })
    }

    /// The best tetrahedra in place of those around the edge from `p` to `q`: the worst of them, what goes, what comes.
    /// `None` if the edge is not inside or has a long ring.
    fn without_edge(&self, p: usize, q: usize) -> Option<(f64, Vec<usize>, Vec<[usize; 4]>)> {
        let around: Vec<usize> = (0..self.tets.len())
            .filter(|&t| self.tets[t].0.contains(&p) && self.tets[t].0.contains(&q))
            .collect();
        if !(3..=LONGEST_RING).contains(&around.len()) {
            return None;
        }
        let ring = self.ring(&around, p, q)?;
        let n = ring.len();
        let pair =
            |i: usize, j: usize, k: usize| [[ring[i], ring[j], ring[k], q], [ring[i], ring[k], ring[j], p]];
        // best[i][j]: how good the polygon from ring[i] to ring[j] can be filled, and by which third node.
        let mut best = [[(f64::INFINITY, 0); LONGEST_RING]; LONGEST_RING];
        for width in 2..n {
            for i in 0..n - width {
                let j = i + width;
                best[i][j] = (f64::NEG_INFINITY, 0);
                for k in i + 1..j {
                    let [upper, lower] = pair(i, k, j);
                    let ratio = best[i][k].0.min(best[k][j].0).min(self.ratio(upper)).min(self.ratio(lower));
                    if ratio > best[i][j].0 {
                        best[i][j] = (ratio, k);
                    }
                }
            }
        }
        let mut new = Vec::with_capacity(2 * (n - 2));
        let mut open = vec![(0, n - 1)];
        while let Some((i, j)) = open.pop() {
            if j - i >= 2 {
                let k = best[i][j].1;
                new.extend(pair(i, k, j));
                open.extend([(i, k), (k, j)]);
            }
        }
        let ratio = best[0][n - 1].0;
        (ratio > 0.0 && self.fills(&around, &new)).then_some((ratio, around, new))
    }

    /// The nodes around the edge from `p` to `q`, to the right hand; `None` if they do not close.
    fn ring(&self, around: &[usize], p: usize, q: usize) -> Option<Vec<usize>> {
        let sides: Vec<[usize; 2]> = around
            .iter()
            .map(|&t| {
                let mut others = self.tets[t].0.into_iter().filter(|&n| n != p && n != q);
                let [a, b] = [others.next()?, others.next()?];
                let is_right = tetrahedron_volume_m3([p, q, a, b].map(|n| self.positions_m[n])) > 0.0;
                Some(if is_right { [a, b] } else { [b, a] })
            })
            .collect::<Option<_>>()?;
        let mut ring = vec![sides[0][0]];
        let mut at = sides[0][1];
        while at != ring[0] {
            ring.push(at);
            at = sides.iter().find(|side| side[0] == at)?[1];
            if ring.len() > sides.len() {
                return None;
            }
        }
        (ring.len() == sides.len()).then_some(ring)
    }
}
