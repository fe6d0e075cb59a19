//! A tree of boxes over the triangles of a mesh, halved at the median of the longest side.

use rayon::prelude::*;

use super::TriMesh;
use crate::math::{Aabb, DVec3, closest_point_barycentric};

/// Triangles of one leaf of the tree.
const LEAF_SIZE: usize = 6;
/// Halves of more triangles than this are split by two threads.
const PARALLEL_ABOVE: usize = 4096;

/// Nodes that wait while the tree is walked depth first: one a level and one more. Halving 2^32 triangles
/// takes 32 levels.
pub(super) const DEEPEST: usize = 64;

/// Whether two boxes have a point in common.
pub(super) fn overlap(a: &Aabb, b: &Aabb) -> bool {
    a.min_m.cmple(b.max_m).all() && b.min_m.cmple(a.max_m).all()
}

/// One box of the tree.
pub(super) struct BoxNode {
    /// Around the node's triangles.
    pub(super) bounds: Aabb,
    /// Range of `order`.
    pub(super) first: u32,
    pub(super) end: u32,
    pub(super) children: Option<[u32; 2]>,
}

/// Boxes around halves of halves of a mesh's triangles, down to a few triangles.
pub(super) struct BoxTree {
    /// The root first, a node before its children.
    pub(super) nodes: Vec<BoxNode>,
    /// Triangles, those of a node next to each other.
    pub(super) order: Vec<u32>,
    /// Box of each triangle.
    pub(super) boxes: Vec<Aabb>,
}

impl BoxTree {
    /// The tree of all triangles of `mesh`; no node without triangles.
    pub(super) fn of_triangles(mesh: &TriMesh) -> Self {
        let triangles = (0..mesh.triangles.len()).into_par_iter().with_min_len(PARALLEL_ABOVE);
        let boxes: Vec<Aabb> = triangles.map(|t| Aabb::of_points(&mesh.corners_m(t))).collect();
        let n = u32::try_from(boxes.len()).expect("meshes have fewer than 2^32 triangles");
        // Sorted with their centres: looking those up costs more than the comparisons.
        let centre = |t: u32| boxes[t as usize].min_m + boxes[t as usize].max_m;
        let mut order: Vec<(DVec3, u32)> = (0..n).map(|t| (centre(t), t)).collect();
        let mut nodes = Vec::new();
        if n > 0 {
            split(&boxes, &mut order, 0, &mut nodes);
        }
        Self { nodes, order: order.into_iter().map(|(_, t)| t).collect(), boxes }
    }

    /// Makes the boxes fit again after the triangles `moved` have moved; their order stays.
    pub(super) fn refit(&mut self, mesh: &TriMesh, moved: &[u32]) {
        for &t in moved {
            self.boxes[t as usize] = Aabb::of_points(&mesh.corners_m(t as usize));
        }
        for at in (0..self.nodes.len()).rev() {
            let node = &self.nodes[at];
            let bounds = match node.children {
                Some([l, r]) => self.nodes[l as usize].bounds.joined(&self.nodes[r as usize].bounds),
                None => {
                    let own = &self.order[node.first as usize..node.end as usize];
                    own.iter().fold(Aabb::EMPTY, |bounds, &t| bounds.joined(&self.boxes[t as usize]))
                }
            };
            self.nodes[at].bounds = bounds;
        }
    }

    /// The triangles whose boxes have a point in common with `bounds`.
    pub(super) fn boxes_touching(&self, bounds: &Aabb) -> Vec<u32> {
        let mut found = Vec::new();
        let mut pending = if self.nodes.is_empty() { Vec::new() } else { vec![0u32] };
        while let Some(at) = pending.pop() {
            let node = &self.nodes[at as usize];
            if overlap(&node.bounds, bounds) {
                match node.children {
                    Some(children) => pending.extend(children),
                    None => {
                        let own = &self.order[node.first as usize..node.end as usize];
                        found.extend(own.iter().filter(|&&t| overlap(&self.boxes[t as usize], bounds)));
                    }
                }
            }
        }
        found
    }

    /// The point of `mesh`, the tree's own, that is closest to `point_m`, if one is within `reach_m`: its
    /// triangle, itself and its distance [m].
    pub(super) fn closest(&self, mesh: &TriMesh, point_m: DVec3, reach_m: f64) -> Option<(u32, DVec3, f64)> {
        let mut best = None;
        let mut best_squared = reach_m * reach_m;
        let mut pending = [0u32; DEEPEST];
        let mut n_pending = usize::from(!self.nodes.is_empty());
        while n_pending > 0 {
            n_pending -= 1;
            let node = &self.nodes[pending[n_pending] as usize];
            if squared_distance(&node.bounds, point_m) > best_squared {
                continue;
            }
            let Some([l, r]) = node.children else {
                for &t in &self.order[node.first as usize..node.end as usize] {
                    if squared_distance(&self.boxes[t as usize], point_m) > best_squared {
                        continue;
                    }
                    let corners_m = mesh.corners_m(t as usize);
                    let weights = closest_point_barycentric(point_m, corners_m);
                    let at_m: DVec3 = corners_m.iter().zip(weights).map(|(&p, w)| w * p).sum();
                    let squared = at_m.distance_squared(point_m);
                    if squared < best_squared || (best.is_none() && squared <= best_squared) {
                        best_squared = squared;
                        best = Some((t, at_m));
                    }
                }
                continue;
            };
            let [near, far] = [l, r].map(|n| squared_distance(&self.nodes[n as usize].bounds, point_m));
            // The nearer one on top.
            let pair = if near <= far { [r, l] } else { [l, r] };
            pending[n_pending..n_pending + 2].copy_from_slice(&pair);
            n_pending += 2;
        }
        best.map(|(t, at_m)| (t, at_m, best_squared.sqrt()))
    }
}

/// Squared distance [m2] from a point to a box: 0 inside.
fn squared_distance(bounds: &Aabb, point_m: DVec3) -> f64 {
    point_m.clamp(bounds.min_m, bounds.max_m).distance_squared(point_m)
}

/// Adds the nodes above `order`, the part of the tree's order that begins at `first`, each triangle with twice
/// its box's centre [m], their root before them; answers where it is. Each range is split by itself: the tree is
/// the same at any number of threads.
fn split(boxes: &[Aabb], order: &mut [(DVec3, u32)], first: usize, nodes: &mut Vec<BoxNode>) -> u32 {
    let id = nodes.len();
    let end = first + order.len();
    nodes.push(BoxNode { bounds: Aabb::EMPTY, first: first as u32, end: end as u32, children: None });
    if order.len() <= LEAF_SIZE {
        nodes[id].bounds = order.iter().fold(Aabb::EMPTY, |sum, &(_, t)| sum.joined(&boxes[t as usize]));
    } else {
        let size = order.iter().fold(Aabb::EMPTY, |sum, &(centre, _)| sum.including(centre)).size_m();
        let axis = (0..3).max_by(|&a, &b| size[a].total_cmp(&size[b])).expect("three axes");
        let middle = order.len() / 2;
        order.select_nth_unstable_by(middle, |(p, s), (q, t)| p[axis].total_cmp(&q[axis]).then(s.cmp(t)));
        let parallel = order.len() > PARALLEL_ABOVE;
        let (left, right) = order.split_at_mut(middle);
        let children = if parallel {
            let (mut of_left, mut of_right) = (Vec::new(), Vec::new());
            rayon::join(
                || split(boxes, left, first, &mut of_left),
                || split(boxes, right, first + middle, &mut of_right),
            );
            [of_left, of_right].map(|half| append(nodes, half))
        } else {
            let left = split(boxes, left, first, nodes);
            [left, split(boxes, right, first + middle, nodes)]
        };
        let [l, r] = children.map(|child| nodes[child as usize].bounds);
        nodes[id].bounds = l.joined(&r);
        nodes[id].children = Some(children);
    }
    id as u32
}

/// Adds the nodes of a tree to `nodes`; answers where its root is.
fn append(nodes: &mut Vec<BoxNode>, tree: Vec<BoxNode>) -> u32 {
    let by = nodes.len() as u32;
    nodes.extend(tree.into_iter().map(|node| {
        let children = node.children.map(|both| both.map(|child| child + by));
        BoxNode { children, ..node }
    }));
    by
}
