//! Pairs of triangles of one surface that meet where they should not.
//!
//! Two triangles may meet in their common vertex or edge only. Candidates come from a tree of boxes; the
//! decision uses exact orientation predicates (J. Shewchuk, "Adaptive precision floating-point arithmetic and
//! fast robust geometric predicates", 1997, doi 10.1007/PL00009321), so touching counts and rounding cannot
//! hide or invent a pair. Triangles with no area must be sorted out before.

use rayon::prelude::*;
use robust::{Coord, Coord3D, orient2d, orient3d};

use super::TriMesh;
use super::box_tree::{BoxTree, overlap};
use crate::math::DVec3;

/// As many pairs of nodes are enough to share among threads.
const ENOUGH_TASKS: usize = 512;
/// Rounding of a sum of three products of differences, each rounded, relative to the products' sizes; the
/// exact bound is below 1e-15.
const ROUNDING: f64 = 1e-14;

/// Up to `limit` pairs of intersecting triangles of `mesh`, each ascending, the list ascending. Without a
/// limit that is reached, it holds all of them. The same at any number of threads.
pub fn self_intersections(mesh: &TriMesh, limit: usize) -> Vec<[u32; 2]> {
    crossings_in(mesh, &BoxTree::of_triangles(mesh), limit)
}

/// The pairs of intersecting triangles of a surface of which few vertices move at a time.
pub(super) struct Crossings {
    tree: BoxTree,
    /// As [`self_intersections`] gives them.
    pub(super) pairs: Vec<[u32; 2]>,
}

impl Crossings {
    /// Those of `mesh`.
    pub(super) fn of(mesh: &TriMesh) -> Self {
        let tree = BoxTree::of_triangles(mesh);
        Self { pairs: crossings_in(mesh, &tree, usize::MAX), tree }
    }

    /// Follows `mesh`, the same but for the places of the vertices that `is_moved`.
    pub(super) fn follow(&mut self, mesh: &TriMesh, is_moved: &[bool]) {
        let touched = |t: u32| mesh.triangles[t as usize].iter().any(|&v| is_moved[v as usize]);
        let moved: Vec<u32> = (0..mesh.triangles.len() as u32).filter(|&t| touched(t)).collect();
        self.tree.refit(mesh, &moved);
        self.pairs.retain(|&[s, t]| !touched(s) && !touched(t));
        let found = moved.par_iter().flat_map_iter(|&s| {
            let beside = self.tree.boxes_touching(&self.tree.boxes[s as usize]);
            // A pair of two moved ones is found by its first.
            let others = beside.into_iter().filter(move |&t| t > s || (t < s && !touched(t)));
            others.filter(move |&t| meet(mesh, s, t)).map(move |t| [s.min(t), s.max(t)])
        });
        self.pairs.par_extend(found);
        self.pairs.sort_unstable();
    }
}

fn meet(mesh: &TriMesh, s: u32, t: u32) -> bool {
    !only_share_a_vertex(mesh, s, t) && triangles_intersect(mesh, s, t)
}

fn crossings_in(mesh: &TriMesh, tree: &BoxTree, limit: usize) -> Vec<[u32; 2]> {
    if tree.nodes.is_empty() || limit == 0 {
        return Vec::new();
    }
    // Level by level, until there are enough pairs of nodes to share.
    let mut tasks = vec![[0u32, 0u32]];
    while tasks.len() < ENOUGH_TASKS {
        let mut next = Vec::with_capacity(3 * tasks.len());
        for &pair in &tasks {
            match parts(tree, pair) {
                Parts::Apart => {}
                Parts::Leaves => next.push(pair),
                Parts::Two(pairs) => next.extend(pairs),
                Parts::Three(pairs) => next.extend(pairs),
            }
        }
        if next.len() <= tasks.len() {
            break;
        }
        tasks = next;
    }
    let found = tasks.par_iter().map(|&task| crossings_between(mesh, tree, task, limit));
    let mut found: Vec<[u32; 2]> = found.flatten_iter().collect();
    found.sort_unstable();
    found.truncate(limit);
    found
}

/// What a pair of nodes splits into.
enum Parts {
    /// Nothing: their boxes have no point in common.
    Apart,
    /// Both are leaves.
    Leaves,
    Two([[u32; 2]; 2]),
    /// A node with itself.
    Three([[u32; 2]; 3]),
}

fn parts(tree: &BoxTree, [a, b]: [u32; 2]) -> Parts {
    let (node_a, node_b) = (&tree.nodes[a as usize], &tree.nodes[b as usize]);
    if !overlap(&node_a.bounds, &node_b.bounds) {
        return Parts::Apart;
    }
    match (node_a.children, node_b.children) {
        (None, None) => Parts::Leaves,
        (Some([l, r]), _) if a == b => Parts::Three([[l, l], [r, r], [l, r]]),
        (Some([l, r]), Some(_)) if node_a.end - node_a.first >= node_b.end - node_b.first => {
            Parts::Two([[l, b], [r, b]])
        }
        (_, Some([l, r])) => Parts::Two([[a, l], [a, r]]),
        (Some([l, r]), None) => Parts::Two([[l, b], [r, b]]),
    }
}

/// Pairs of intersecting triangles of two nodes, at least `limit` if there are as many.
fn crossings_between(mesh: &TriMesh, tree: &BoxTree, task: [u32; 2], limit: usize) -> Vec<[u32; 2]> {
    let mut found = Vec::new();
    let mut pending = vec![task];
    while let Some([a, b]) = pending.pop() {
        match parts(tree, [a, b]) {
            Parts::Apart => {}
            Parts::Two(pairs) => pending.extend(pairs),
            Parts::Three(pairs) => pending.extend(pairs),
            Parts::Leaves => {
                let (node_a, node_b) = (&tree.nodes[a as usize], &tree.nodes[b as usize]);
                for at in node_a.first as usize..node_a.end as usize {
                    let s = tree.order[at];
                    let from = if a == b { at + 1 } else { node_b.first as usize };
                    for &t in &tree.order[from..node_b.end as usize] {
                        let is_crossing =
                            overlap(&tree.boxes[s as usize], &tree.boxes[t as usize]) && meet(mesh, s, t);
                        if is_crossing {
                            found.push([s.min(t), s.max(t)]);
                        }
                    }
                }
                if found.len() >= limit {
                    break;
                }
            }
        }
    }
    found
}

/// Quick and on the safe side: whether two triangles share one vertex and a plane through it has the other
/// corners of one strictly on one side, those of the other on the other. Most neighbours on a smooth surface
/// are parted by the plane across the line that joins the middles of their opposite edges.
fn only_share_a_vertex(mesh: &TriMesh, s: u32, t: u32) -> bool {
    let (a, b) = (mesh.triangles[s as usize], mesh.triangles[t as usize]);
    let mut common = (0..9).filter(|c| a[c / 3] == b[c % 3]);
    let (Some(place), None) = (common.next(), common.next()) else { return false };
    let (at_a, at_b) = (place / 3, place % 3);
    let apex = mesh.positions_m[a[at_a] as usize];
    let arm = |v: u32| mesh.positions_m[v as usize] - apex;
    let arms_a = [arm(a[(at_a + 1) % 3]), arm(a[(at_a + 2) % 3])];
    let arms_b = [arm(b[(at_b + 1) % 3]), arm(b[(at_b + 2) % 3])];
    let across = (arms_a[0] + arms_a[1]) - (arms_b[0] + arms_b[1]);
    let clearly_positive = |x: DVec3| {
        let terms = across * x;
        terms.element_sum() > ROUNDING * terms.abs().element_sum() + f64::MIN_POSITIVE
    };
    arms_a.into_iter().all(clearly_positive) && arms_b.into_iter().all(|x| clearly_positive(-x))
}

/// Whether triangles `s` and `t` meet anywhere but in the vertices or the edge they share by index.
pub fn triangles_intersect(mesh: &TriMesh, s: u32, t: u32) -> bool {
    let (mut a, mut b) = (mesh.triangles[s as usize], mesh.triangles[t as usize]);
    let shared = a.iter().filter(|v| b.contains(v)).count();
    if shared == 0 {
        let at = |v: u32| mesh.positions_m[v as usize];
        return disjoint_triangles_meet(a.map(at), b.map(at));
    }
    // Shared vertices first, in the same order.
    let rank = |list: &[u32; 3], v: u32| usize::from(!list.contains(&v));
    let (old_a, old_b) = (a, b);
    a.sort_by_key(|&v| (rank(&old_b, v), v));
    b.sort_by_key(|&v| (rank(&old_a, v), v));
    let p = a.map(|v| mesh.positions_m[v as usize]);
    let q = b.map(|v| mesh.positions_m[v as usize]);
    match shared {
        1 => segment_meets_triangle(p[1], p[2], q) || segment_meets_triangle(q[1], q[2], p),
        2 => {
            // Folded onto each other: in one plane and on the same side of the common edge.
            let axis = dominant_axis(p);
            side(p[0], p[1], p[2], q[2]) == 0 && turn(axis, p[0], p[1], p[2]) == turn(axis, p[0], p[1], q[2])
        }
        _ => true,
    }
}

/// Whether two triangles with no vertex in common meet; touching counts. Neither may be without area.
pub fn disjoint_triangles_meet(p: [DVec3; 3], q: [DVec3; 3]) -> bool {
    let p_sides = p.map(|x| side(q[0], q[1], q[2], x));
    if p_sides[0] != 0 && p_sides.iter().all(|&s| s == p_sides[0]) {
        return false;
    }
    let q_sides = q.map(|x| side(p[0], p[1], p[2], x));
    if q_sides[0] != 0 && q_sides.iter().all(|&s| s == q_sides[0]) {
        return false;
    }
    (0..3).any(|e| {
        let n = (e + 1) % 3;
        segment_meets(p[e], p[n], [p_sides[e], p_sides[n]], q)
            || segment_meets(q[e], q[n], [q_sides[e], q_sides[n]], p)
    })
}

/// Whether the closed segment (u, v) meets the closed triangle.
pub fn segment_meets_triangle(u: DVec3, v: DVec3, triangle: [DVec3; 3]) -> bool {
    let [a, b, c] = triangle;
    segment_meets(u, v, [side(a, b, c, u), side(a, b, c, v)], triangle)
}

fn segment_meets(u: DVec3, v: DVec3, sides: [i8; 2], [a, b, c]: [DVec3; 3]) -> bool {
    if sides[0] * sides[1] > 0 {
        return false;
    }
    if sides == [0, 0] {
        return coplanar_segment_meets(u, v, [a, b, c]);
    }
    let turns = [side(u, v, a, b), side(u, v, b, c), side(u, v, c, a)];
    turns.iter().all(|&s| s >= 0) || turns.iter().all(|&s| s <= 0)
}

fn coplanar_segment_meets(u: DVec3, v: DVec3, triangle: [DVec3; 3]) -> bool {
    let axis = dominant_axis(triangle);
    let inside = |p: DVec3| {
        let turns = [0, 1, 2].map(|e| turn(axis, triangle[e], triangle[(e + 1) % 3], p));
        turns.iter().all(|&s| s >= 0) || turns.iter().all(|&s| s <= 0)
    };
    inside(u)
        || inside(v)
        || (0..3).any(|e| segments_meet(axis, [u, v], [triangle[e], triangle[(e + 1) % 3]]))
}

/// Whether two closed segments of one plane meet, seen along `axis`.
pub fn segments_meet(axis: usize, [u, v]: [DVec3; 2], [a, b]: [DVec3; 2]) -> bool {
    let (ua, va) = (turn(axis, a, b, u), turn(axis, a, b, v));
    let (au, bu) = (turn(axis, u, v, a), turn(axis, u, v, b));
    if [ua, va, au, bu] == [0; 4] {
        // On one line: do their boxes overlap?
        return (u.min(v)).cmple(a.max(b)).all() && (a.min(b)).cmple(u.max(v)).all();
    }
    ua * va <= 0 && au * bu <= 0
}

/// The axis along which the triangle is seen largest.
fn dominant_axis([a, b, c]: [DVec3; 3]) -> usize {
    let normal = (b - a).cross(c - a).abs();
    (0..3).max_by(|&i, &j| normal[i].total_cmp(&normal[j])).expect("three axes")
}

/// Exact side of `d` of the plane through a, b, c.
pub fn side(a: DVec3, b: DVec3, c: DVec3, d: DVec3) -> i8 {
    let at = |p: DVec3| Coord3D { x: p.x, y: p.y, z: p.z };
    sign(orient3d(at(a), at(b), at(c), at(d)))
}

/// Exact turn of a, b, c seen along `axis`.
pub fn turn(axis: usize, a: DVec3, b: DVec3, c: DVec3) -> i8 {
    let at = |p: DVec3| Coord { x: p[(axis + 1) % 3], y: p[(axis + 2) % 3] };
    sign(orient2d(at(a), at(b), at(c)))
}

fn sign(x: f64) -> i8 {
    i8::from(x > 0.0) - i8::from(x < 0.0)
}
