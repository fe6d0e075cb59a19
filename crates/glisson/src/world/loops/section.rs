//! Where the plane of an open loop cuts the surface of the tissue: what it is around, and what its thread is in.

use crate::contact::shapes::Capsule;
use crate::contact::tool_contact::ToolContact;
use crate::math::DVec3;
use crate::mesh::NodeId;
use crate::model::bounded_vec::BoundedVec;
use crate::tool::ligating_loop::Ring;
use crate::world::organ::Organ;
use crate::world::sutures::surface_at;

/// Triangles that are looked at, at most.
const MOST_TRIANGLES: usize = 2048;
/// Places of a ring that are looked at whether they are in tissue: a choice.
const LOOKED_AT: usize = 8;

/// Where the plane cuts an edge of a triangle.
#[derive(Clone, Copy, Debug)]
pub(super) struct Crossing {
    /// Ends of the edge, ascending, and the weight of the second one.
    pub(super) edge: [NodeId; 2],
    pub(super) weight: f64,
    /// Place in the ring's plane, from its middle [m].
    pub(super) in_plane_m: [f64; 2],
    /// Whether it is on what the ring is around.
    is_around: bool,
}

impl Crossing {
    fn radius_m(&self) -> f64 {
        libm::hypot(self.in_plane_m[0], self.in_plane_m[1])
    }
}

/// What a section found.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Found {
    /// Whether there is tissue that lies wholly within the ring.
    pub(super) is_around: bool,
    /// Whether there is any tissue within the ring, or in its way.
    pub(super) has_tissue: bool,
    /// How deep the thread is in tissue [m].
    pub(super) deep_m: f64,
}

/// Room for a section.
#[derive(Debug)]
pub(super) struct Section {
    near: Vec<ToolContact>,
    nearest: Vec<ToolContact>,
    /// Two of each triangle that is cut, one after the other.
    crossings: Vec<Crossing>,
    /// Pieces of curves that hang together: one further on in the same, or itself.
    next: Vec<u32>,
    order: Vec<u32>,
    /// Of each curve by its last piece: nearest to the middle of the ring and furthest [m].
    reaches_m: Vec<[f64; 2]>,
    hull: Vec<u32>,
}

impl Section {
    pub(super) fn new() -> Self {
        let n = 2 * MOST_TRIANGLES;
        Self {
            near: Vec::with_capacity(MOST_TRIANGLES),
            nearest: Vec::with_capacity(1),
            crossings: Vec::with_capacity(n),
            next: Vec::with_capacity(MOST_TRIANGLES),
            order: Vec::with_capacity(n),
            reaches_m: Vec::with_capacity(MOST_TRIANGLES),
            hull: Vec::with_capacity(n),
        }
    }

    /// Looks what is within a ring, and as far as `beyond_m` around it. Allocates nothing.
    pub(super) fn look(&mut self, ring: &Ring, beyond_m: f64, organ: &Organ) -> Found {
        self.near.clear();
        let ball = Capsule::ball(ring.middle_m, ring.radius_m);
        let n_left_out = organ.skin().near_into(&ball, beyond_m, &mut self.near);
        self.crossings.clear();
        for found in &self.near {
            let place = organ.skin().place_of(*found);
            cut(place.nodes, (ring, organ.positions_m()), &mut self.crossings);
        }
        self.join();
        let mut found = self.measure(ring.radius_m);
        found.deep_m = found.deep_m.max(self.deep_inside_m(ring, organ));
        found.has_tissue |= found.deep_m > 0.0;
        // Where not all was looked at a piece of a curve may look like a whole one.
        found.is_around &= n_left_out == 0;
        found
    }

    /// How deep places of the ring are in tissue at most [m]: a ring that is wholly inside crosses no surface.
    fn deep_inside_m(&mut self, ring: &Ring, organ: &Organ) -> f64 {
        let mut deepest_m = 0.0_f64;
        for i in 0..LOOKED_AT {
            let at_m = ring.point_m(i as f64 / LOOKED_AT as f64);
            organ.skin().nearest_into(&Capsule::ball(at_m, 0.0), 2.0 * ring.radius_m, &mut self.nearest);
            let Some(place) = self.nearest.first().map(|contact| organ.skin().place_of(*contact)) else {
                continue;
            };
            let (point_m, normal) = surface_at(organ, place.nodes, place.found.weights);
            let out_m = (at_m - point_m).dot(normal);
            deepest_m = deepest_m.max(if out_m < 0.0 { at_m.distance(point_m) } else { 0.0 });
        }
        deepest_m
    }

    /// Joins pieces with an end in common.
    fn join(&mut self) {
        let n_pieces = self.crossings.len() / 2;
        self.next.clear();
        self.next.extend(0..n_pieces as u32);
        self.order.clear();
        self.order.extend(0..2 * n_pieces as u32);
        let Self { crossings, order, .. } = self;
        order.sort_unstable_by_key(|&i| (crossings[i as usize].edge, i));
        for at in 1..self.order.len() {
            let [one, other] = [self.order[at - 1], self.order[at]].map(|i| i as usize);
            if self.crossings[one].edge == self.crossings[other].edge {
                let (one, other) = (self.curve_of(one / 2), self.curve_of(other / 2));
                self.next[one.min(other)] = one.max(other) as u32;
            }
        }
    }

    /// The curve of a piece, by its last piece.
    fn curve_of(&mut self, piece: usize) -> usize {
        let mut at = piece;
        while self.next[at] as usize != at {
            // Half the way for who asks next.
            self.next[at] = self.next[self.next[at] as usize];
            at = self.next[at] as usize;
        }
        at
    }

    fn measure(&mut self, radius_m: f64) -> Found {
        let n_pieces = self.crossings.len() / 2;
        self.reaches_m.clear();
        self.reaches_m.resize(n_pieces, [f64::INFINITY, 0.0]);
        for i in 0..2 * n_pieces {
            let (curve, r_m) = (self.curve_of(i / 2), self.crossings[i].radius_m());
            let [nearest_m, furthest_m] = &mut self.reaches_m[curve];
            (*nearest_m, *furthest_m) = (nearest_m.min(r_m), furthest_m.max(r_m));
        }
        let mut found = Found::default();
        for i in 0..2 * n_pieces {
            let curve = self.curve_of(i / 2);
            let [nearest_m, furthest_m] = self.reaches_m[curve];
            let is_around = furthest_m <= radius_m;
            self.crossings[i].is_around = is_around;
            found.is_around |= is_around;
            found.has_tissue |= nearest_m < radius_m;
            found.deep_m = found.deep_m.max((radius_m - nearest_m).min(furthest_m - radius_m));
        }
        found
    }

    /// The triangles that were looked at.
    pub(super) fn near(&self) -> &[ToolContact] {
        &self.near
    }

    /// The corners of the shortest way around what the ring is around, counter-clockwise in its plane: at most so many, about evenly
    /// along it. Allocates nothing.
    pub(super) fn around_into(&mut self, around: &mut BoundedVec<Crossing>) {
        let Self { crossings, order, hull, .. } = self;
        order.clear();
        order.extend((0..crossings.len() as u32).filter(|&i| crossings[i as usize].is_around));
        let at = |i: u32| crossings[i as usize].in_plane_m;
        convex_hull(order, &at, hull);
        around.clear();
        let n = hull.len();
        let side_m = |i: usize| distance(at(hull[i]), at(hull[(i + 1) % n]));
        let girth_m: f64 = (0..n).map(side_m).sum();
        let apart_m = girth_m / around.capacity() as f64;
        let (mut along_m, mut wanted_m) = (0.0, 0.0);
        for (i, &corner) in hull.iter().enumerate() {
            if along_m >= wanted_m {
                around.try_push(crossings[corner as usize]);
                wanted_m = along_m + apart_m;
            }
            along_m += side_m(i);
        }
    }
}

/// Adds where the plane of a ring cuts a triangle.
fn cut(nodes: [NodeId; 3], (ring, positions_m): (&Ring, &[DVec3]), crossings: &mut Vec<Crossing>) {
    let heights_m = nodes.map(|node| (positions_m[node.index()] - ring.middle_m).dot(ring.normal));
    for (a, b) in [(0, 1), (1, 2), (2, 0)] {
        if (heights_m[a] >= 0.0) == (heights_m[b] >= 0.0) {
            continue;
        }
        // Always from the lower node on, so that both triangles of an edge find the same place.
        let (a, b) = if nodes[a] < nodes[b] { (a, b) } else { (b, a) };
        let weight = heights_m[a] / (heights_m[a] - heights_m[b]);
        let place_m = positions_m[nodes[a].index()].lerp(positions_m[nodes[b].index()], weight);
        let edge = [nodes[a], nodes[b]];
        let in_plane_m = ring.in_plane_m(place_m);
        if crossings.len() < crossings.capacity() {
            crossings.push(Crossing { edge, weight, in_plane_m, is_around: false });
        }
    }
}

fn distance([ax, ay]: [f64; 2], [bx, by]: [f64; 2]) -> f64 {
    libm::hypot(ax - bx, ay - by)
}

/// Corners of the convex hull of points, counter-clockwise (A. M. Andrew 1979, doi 10.1016/0020-0190(79)90072-3). Sorts the points.
pub(super) fn convex_hull(points: &mut [u32], at: &impl Fn(u32) -> [f64; 2], hull: &mut Vec<u32>) {
    points.sort_unstable_by(|&a, &b| {
        let ([ax, ay], [bx, by]) = (at(a), at(b));
        ax.total_cmp(&bx).then(ay.total_cmp(&by)).then(a.cmp(&b))
    });
    let turns_left = |[ax, ay]: [f64; 2], [bx, by]: [f64; 2], [cx, cy]: [f64; 2]| {
        (bx - ax) * (cy - ay) - (by - ay) * (cx - ax) > 0.0
    };
    hull.clear();
    let mut chain = |points: &mut dyn Iterator<Item = u32>| {
        let from = hull.len();
        for point in points {
            while hull.len() >= from + 2
                && !turns_left(at(hull[hull.len() - 2]), at(hull[hull.len() - 1]), at(point))
            {
                hull.pop();
            }
            hull.push(point);
        }
        // It is the first one of the other chain.
        hull.pop();
    };
    chain(&mut points.iter().copied());
    chain(&mut points.iter().rev().copied());
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::SeededRandom;

    #[test]
    fn a_convex_hull_is_around_all_points_and_turns_left() {
        let mut random = SeededRandom::new(7);
        for n in 3..60 {
            let mut points: Vec<[f64; 2]> =
                (0..n).map(|_| [random.uniform(), random.uniform()].map(|x| (8.0 * x).round())).collect();
            points.sort_by(|a, b| a[0].total_cmp(&b[0]).then(a[1].total_cmp(&b[1])));
            points.dedup();
            let mut order: Vec<u32> = (0..points.len() as u32).collect();
            let mut hull = Vec::new();
            convex_hull(&mut order, &|i| points[i as usize], &mut hull);
            let corner = |i: usize| points[hull[i % hull.len()] as usize];
            for i in 0..hull.len() {
                let ([ax, ay], [bx, by]) = (corner(i), corner(i + 1));
                for &[x, y] in &points {
                    assert!((bx - ax) * (y - ay) - (by - ay) * (x - ax) >= 0.0);
                }
            }
        }
    }
}
