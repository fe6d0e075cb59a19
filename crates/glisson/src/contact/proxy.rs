//! The proxy (god-object): the point of a deforming surface that a tool's point presses against.
//!
//! When the tool has entered the surface, the proxy stays on it and slides to the point that is nearest to the tool; the
//! user feels F = -k (tool - proxy), the tissue the opposite (Zilles and Salisbury 1995, "A constraint-based god-object
//! method for haptic display", IROS; seed `000`, s. 4.4.2, fig. 4.11). The nearest point is sought from the last one on,
//! downhill over the surface: so the tool cannot come through to another side, however deep it is.
//!
//! With d = goal - proxy, depth d_n = -d . n and tangential part d_t the proxy sticks while |d_t| <= mu (d_n + a), and
//! slides just so far that this holds again (Coulomb's cone as in Ruspini, Kolarov and Khatib 1997, "The haptic display
//! of complex graphical environments", SIGGRAPH). a is the depth of adhesion: the proxy stays on the surface until the
//! goal is more than a outside (the sticky objects of seed `000`; there for a time, here up to a force k a).
//!
//! Goal. For a tip of radius r it is the tip's point against the surface, centre - r n, with n the surface's smooth normal
//! at the proxy. n follows by a quarter in each step: for a tip larger than the triangles the exchange between n and proxy
//! would otherwise overshoot.
//!
//! Sliding. In the plane of a triangle the way to the foot of the goal is straight, and its length |d_t| - mu (d_n + a). On
//! an edge the proxy goes on into the triangle, or along the edge, where it comes nearest; on a vertex the same for all
//! triangles and edges around. In a valley it stays on the edge: nothing leads nearer. Each move brings the proxy nearer to the
//! goal, so that it cannot go to and fro.
//!
//! A surface that follows the tool. Where the model is driven by displacements the touched point is where the tool is, and d
//! is unknown but for the force: then the goal is the point + force on the tissue / k with any k (best near the
//! tissue's own stiffness: the slip per step is the excess of force over k).

use super::proxy_surface::SurfaceAdjacency;
use super::tool_contact::ToolContact;
use super::triangles::{at_weights, closest_weights};
use crate::math::DVec3;

/// Triangles and edges that a proxy passes in one step at most: more than any tool can in a step of some milliseconds. What is
/// left is done in the next one.
const MOST_MOVES: usize = 128;
/// A weight up to this is zero: the point is on the opposite edge.
const ON_EDGE: f64 = 1e-9;
/// A shorter way is not gone [m]: far below any mesh, above the rounding of positions in a room of metres.
const SHORTEST_WAY_M: f64 = 1e-12;
/// Share by which the normal under the tip follows in a step.
const NORMAL_FOLLOWS: f64 = 0.25;

/// The surface that a proxy lives on.
#[derive(Clone, Copy, Debug)]
pub struct ProxySurface<'a> {
    /// Vertices now [m].
    pub positions_m: &'a [DVec3],
    /// Triangles over them.
    pub adjacency: &'a SurfaceAdjacency,
}

/// How a tool and a surface hold on to each other.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ProxyParams {
    /// k between tool and proxy [N/m]; sets the stiffness that is felt.
    pub stiffness_n_per_m: f64,
    /// Radius of the tip [m]; 0 for a point.
    pub radius_m: f64,
    /// Coulomb's coefficient at rest; 0 is frictionless, infinity never slides.
    pub static_friction: f64,
    /// Coulomb's coefficient while sliding, at most the one at rest.
    pub kinetic_friction: f64,
    /// Pull up to which tool and surface stick together [N]; 0 for plain contact.
    pub adhesion_n: f64,
}

impl ProxyParams {
    /// A point without friction or adhesion.
    pub fn frictionless(stiffness_n_per_m: f64) -> Self {
        Self {
            stiffness_n_per_m,
            radius_m: 0.0,
            static_friction: 0.0,
            kinetic_friction: 0.0,
            adhesion_n: 0.0,
        }
    }
}

/// What a proxy does in a step.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ProxyState {
    /// It stays at its point of the tissue.
    Sticks,
    /// It slid.
    Slides,
    /// The tool has left: the contact is over.
    Left,
}

/// Where a proxy is, and what the user feels.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ProxyForce {
    /// What it did.
    pub state: ProxyState,
    /// The proxy [m].
    pub point_m: DVec3,
    /// Outward unit normal there.
    pub normal: DVec3,
    /// How deep the goal lies below the surface [m]; negative when adhesion holds it outside.
    pub depth_m: f64,
    /// Force of the tissue on the tool [N], in the axes of the surface's positions; zero once it has left.
    pub on_tool_n: DVec3,
}

/// A point of a surface: its triangle, known by its vertices, and barycentric weights. It moves with the tissue.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Proxy {
    slot: u32,
    vertices: [u32; 3],
    weights: [f64; 3],
    is_sliding: bool,
    /// Lags behind the surface's normal.
    tip_normal: DVec3,
}

/// A way that leads nearer to the goal.
#[derive(Clone, Copy, Debug)]
struct Move {
    slot: u32,
    from: [f64; 3],
    /// Weights after the whole way; some may be below zero.
    to: [f64; 3],
    length_m: f64,
}

impl Proxy {
    /// The proxy of a first contact; `None` when the triangle is not there or has no area.
    pub fn begin(surface: &ProxySurface<'_>, contact: &ToolContact) -> Option<Self> {
        Self::at(surface, contact.triangle, contact.weights)
    }

    /// A proxy at the point with barycentric `weights` of the triangle in `slot`.
    pub fn at(surface: &ProxySurface<'_>, slot: u32, weights: [f64; 3]) -> Option<Self> {
        let vertices = surface.adjacency.triangle(slot)?;
        let weights = cleaned(weights)?;
        let mut proxy = Self { slot, vertices, weights, is_sliding: false, tip_normal: DVec3::ZERO };
        proxy.tip_normal = proxy.smooth_normal(surface)?;
        Some(proxy)
    }

    /// Slot of its triangle.
    pub fn slot(&self) -> u32 {
        self.slot
    }

    /// Vertices of its triangle.
    pub fn vertices(&self) -> [u32; 3] {
        self.vertices
    }

    /// Barycentric weights.
    pub fn weights(&self) -> [f64; 3] {
        self.weights
    }

    /// Where it is now [m].
    pub fn point_m(&self, positions_m: &[DVec3]) -> DVec3 {
        at_weights(self.vertices.map(|v| positions_m[v as usize]), self.weights)
    }

    /// The tip's point against the surface [m] when the tip's centre is at `center_m`.
    pub fn goal_m(&self, center_m: DVec3, radius_m: f64) -> DVec3 {
        center_m - self.tip_normal * radius_m
    }

    /// Everything that its next steps depend on.
    pub fn numbers(&self) -> impl Iterator<Item = f64> + '_ {
        let whole = [f64::from(self.slot), f64::from(u8::from(self.is_sliding))];
        let vertices = self.vertices.map(f64::from);
        whole.into_iter().chain(vertices).chain(self.weights).chain(self.tip_normal.to_array())
    }

    /// Whether its triangle is still where it was.
    pub fn is_on(&self, adjacency: &SurfaceAdjacency) -> bool {
        adjacency.triangle(self.slot) == Some(self.vertices)
    }

    /// After an edit: keeps the proxy when its triangle is still there, else puts it on the nearest triangle around its
    /// vertices, if there is one within `reach_m`. Whether it is still on the surface: if not, let the tool go.
    /// `before_m` is where it was. A triangle of the same vertices may have another slot.
    pub fn follow_edit(&mut self, surface: &ProxySurface<'_>, before_m: DVec3, reach_m: f64) -> bool {
        if self.is_on(surface.adjacency) {
            return true;
        }
        let mut best: Option<(f64, u32, [f64; 3])> = None;
        for vertex in self.vertices {
            for (slot, _) in surface.adjacency.around(vertex) {
                let Some(corners_m) = surface.corners_m(slot) else { continue };
                let weights = closest_weights(before_m, corners_m);
                let distance_m = at_weights(corners_m, weights).distance(before_m);
                let is_better = best.is_none_or(|(d, s, _)| distance_m < d || distance_m == d && slot < s);
                if distance_m <= reach_m && is_better {
                    best = Some((distance_m, slot, weights));
                }
            }
        }
        let Some(moved) = best.and_then(|(_, slot, weights)| Self::at(surface, slot, weights)) else {
            return false;
        };
        *self = Self { is_sliding: self.is_sliding, ..moved };
        true
    }

    /// One step: the surface has moved, the tip's centre is at `center_m`. A proxy whose triangle is gone, or a position that is
    /// not finite, ends the contact. Allocates nothing.
    pub fn advance(
        &mut self,
        surface: &ProxySurface<'_>,
        center_m: DVec3,
        params: &ProxyParams,
    ) -> ProxyForce {
        let goal_m = self.goal_m(center_m, params.radius_m);
        self.advance_to(surface, goal_m, params)
    }

    /// [`Proxy::advance`] with the goal itself.
    pub fn advance_to(
        &mut self,
        surface: &ProxySurface<'_>,
        goal_m: DVec3,
        params: &ProxyParams,
    ) -> ProxyForce {
        if !self.is_on(surface.adjacency) || !goal_m.is_finite() {
            return self.left(DVec3::ZERO, DVec3::ZERO, 0.0);
        }
        let adhesion_m = params.adhesion_n / params.stiffness_n_per_m;
        let cone = |friction: f64| Cone { goal_m, friction, adhesion_m };
        let has_slid = (self.is_sliding || self.best_move(surface, &cone(params.static_friction)).is_some())
            && self.slide(surface, &cone(params.kinetic_friction.min(params.static_friction)));
        self.is_sliding = has_slid;
        let point_m = self.point_m(surface.positions_m);
        let normal = self.normal(surface);
        let offset_m = goal_m - point_m;
        let depth_m = -offset_m.dot(normal);
        if !(offset_m.is_finite() && depth_m >= -adhesion_m) {
            return self.left(point_m, normal, depth_m);
        }
        if let Some(smooth) = self.smooth_normal(surface) {
            self.tip_normal = self.tip_normal.lerp(smooth, NORMAL_FOLLOWS).normalize_or(smooth);
        }
        ProxyForce {
            state: if has_slid { ProxyState::Slides } else { ProxyState::Sticks },
            point_m,
            normal,
            depth_m,
            on_tool_n: offset_m * -params.stiffness_n_per_m,
        }
    }

    fn left(&mut self, point_m: DVec3, normal: DVec3, depth_m: f64) -> ProxyForce {
        self.is_sliding = false;
        ProxyForce { state: ProxyState::Left, point_m, normal, depth_m, on_tool_n: DVec3::ZERO }
    }

    /// Slides until the cone holds; whether it moved at all.
    fn slide(&mut self, surface: &ProxySurface<'_>, cone: &Cone) -> bool {
        let mut has_moved = false;
        for _ in 0..MOST_MOVES {
            let Some(found) = self.best_move(surface, cone) else { break };
            let before_m = self.point_m(surface.positions_m).distance_squared(cone.goal_m);
            let after = self.moved(surface, &found);
            if after.point_m(surface.positions_m).distance_squared(cone.goal_m) >= before_m {
                break;
            }
            *self = after;
            has_moved = true;
        }
        has_moved
    }

    /// As far along a way as the triangle goes.
    fn moved(&self, surface: &ProxySurface<'_>, way: &Move) -> Self {
        let mut share = 1.0_f64;
        for (from, to) in way.from.into_iter().zip(way.to) {
            if to < 0.0 {
                share = share.min(from / (from - to));
            }
        }
        let weights = [0, 1, 2].map(|i| way.from[i] + (way.to[i] - way.from[i]) * share);
        let vertices = surface.adjacency.triangle(way.slot).unwrap_or(self.vertices);
        Self { slot: way.slot, vertices, weights: cleaned(weights).unwrap_or(way.from), ..*self }
    }

    /// The way on which the goal comes nearest, of those that friction allows: the longest; of equal ones that in the
    /// lowest slot.
    fn best_move(&self, surface: &ProxySurface<'_>, cone: &Cone) -> Option<Move> {
        let offset_m = cone.goal_m - self.point_m(surface.positions_m);
        let mut best: Option<Move> = None;
        let mut keep = |found: Option<Move>| {
            let Some(found) = found else { return };
            let is_better = best.as_ref().is_none_or(|b| {
                found.length_m > b.length_m || found.length_m == b.length_m && found.slot < b.slot
            });
            if is_better {
                best = Some(found);
            }
        };
        let free = [0, 1, 2].map(|i| self.weights[i] > 0.0);
        match free.iter().filter(|f| **f).count() {
            3 => keep(surface.way_in_triangle(self.slot, self.weights, offset_m, cone)),
            2 => {
                let lone = free.iter().position(|f| !f).unwrap_or(0);
                let (a, b) = ((lone + 1) % 3, (lone + 2) % 3);
                let press_m = cone.adhesion_m - offset_m.dot(self.normal(surface));
                for (slot, place) in surface.adjacency.around(self.vertices[a]) {
                    let Some(vertices) = surface.adjacency.triangle(slot) else { continue };
                    let Some(other) = vertices.iter().position(|v| *v == self.vertices[b]) else { continue };
                    let mut from = [0.0; 3];
                    (from[place], from[other]) = (self.weights[a], self.weights[b]);
                    keep(surface.way_in_triangle(slot, from, offset_m, cone));
                    keep(surface.way_along_edge(slot, from, [place, other], (offset_m, press_m), cone));
                }
            }
            _ => {
                let corner = free.iter().position(|f| *f).unwrap_or(0);
                let press_m = cone.adhesion_m - offset_m.dot(self.normal(surface));
                for (slot, place) in surface.adjacency.around(self.vertices[corner]) {
                    let mut from = [0.0; 3];
                    from[place] = 1.0;
                    keep(surface.way_in_triangle(slot, from, offset_m, cone));
                    for other in [(place + 1) % 3, (place + 2) % 3] {
                        keep(surface.way_along_edge(slot, from, [place, other], (offset_m, press_m), cone));
                    }
                }
            }
        }
        best
    }

    /// Outward unit normal of the face, edge or vertex that it is on: the mean of the triangles there, at a vertex weighted
    /// by their angles, so that its sign tells inside from outside (Baerentzen and Aanaes 2005, "Signed distance computation
    /// using the angle weighted pseudonormal", IEEE Trans. Vis. Comput. Graph. 11(3)).
    fn normal(&self, surface: &ProxySurface<'_>) -> DVec3 {
        let free = [0, 1, 2].map(|i| self.weights[i] > 0.0);
        let own = surface.face_normal(self.slot).unwrap_or(DVec3::ZERO);
        match free.iter().filter(|f| **f).count() {
            3 => own,
            2 => {
                let lone = free.iter().position(|f| !f).unwrap_or(0);
                let (a, b) = (self.vertices[(lone + 1) % 3], self.vertices[(lone + 2) % 3]);
                let beside = surface.adjacency.around(a).filter(|(slot, _)| {
                    surface.adjacency.triangle(*slot).is_some_and(|vertices| vertices.contains(&b))
                });
                // Of two: the order does not count.
                beside
                    .filter_map(|(slot, _)| surface.face_normal(slot))
                    .fold(DVec3::ZERO, |sum, n| sum + n)
                    .normalize_or(own)
            }
            _ => {
                let corner = free.iter().position(|f| *f).unwrap_or(0);
                surface.vertex_normal(self.vertices[corner]).normalize_or(own)
            }
        }
    }

    /// Unit normal between those of its triangle's vertices, which does not jump from triangle to triangle; `None` when all
    /// around is flat or turned against itself.
    pub fn smooth_normal(&self, surface: &ProxySurface<'_>) -> Option<DVec3> {
        let of_vertices = self.vertices.map(|v| surface.vertex_normal(v).normalize_or_zero());
        at_weights(of_vertices, self.weights).try_normalize().or_else(|| surface.face_normal(self.slot))
    }
}

/// Coulomb's cone about a goal.
#[derive(Clone, Copy, Debug)]
struct Cone {
    goal_m: DVec3,
    friction: f64,
    adhesion_m: f64,
}

impl Cone {
    /// Tangential distance that friction holds under a depth, adhesion included; without pressure none.
    fn held_m(&self, pressed_m: f64) -> f64 {
        if pressed_m > 0.0 { self.friction * pressed_m } else { 0.0 }
    }
}

impl ProxySurface<'_> {
    fn corners_m(&self, slot: u32) -> Option<[DVec3; 3]> {
        Some(self.adjacency.triangle(slot)?.map(|v| self.positions_m[v as usize]))
    }

    fn face_normal(&self, slot: u32) -> Option<DVec3> {
        let [a, b, c] = self.corners_m(slot)?;
        (b - a).cross(c - a).try_normalize()
    }

    /// Sum of the normals around, weighted by angles. The list's order depends on history: sorted by slot where it
    /// would show.
    fn vertex_normal(&self, vertex: u32) -> DVec3 {
        let mut sum = DVec3::ZERO;
        // Smallest slot first, found anew for each: rings are short and have no room of their own.
        let mut last = None;
        loop {
            let after = |slot: u32| last.is_none_or(|l| slot > l);
            let next = self.adjacency.around(vertex).filter(|(slot, _)| after(*slot)).min();
            let Some((slot, place)) = next else { return sum };
            last = Some(slot);
            let Some(corners_m) = self.corners_m(slot) else { continue };
            let at = corners_m[place];
            let (u, v) = (corners_m[(place + 1) % 3] - at, corners_m[(place + 2) % 3] - at);
            let normal = u.cross(v);
            let angle_rad = libm::atan2(normal.length(), u.dot(v));
            sum += normal.normalize_or_zero() * angle_rad;
        }
    }

    /// The way in the plane of a triangle towards the foot of the goal, if it leads into the triangle.
    fn way_in_triangle(&self, slot: u32, from: [f64; 3], offset_m: DVec3, cone: &Cone) -> Option<Move> {
        let [a, b, c] = self.corners_m(slot)?;
        let area = (b - a).cross(c - a);
        let normal = area.try_normalize()?;
        let depth_m = -offset_m.dot(normal);
        let along_m = offset_m + normal * depth_m;
        let way_m = along_m.length();
        let length_m = way_m - cone.held_m(depth_m + cone.adhesion_m);
        if length_m.is_nan() || length_m <= SHORTEST_WAY_M {
            return None;
        }
        // Weight i grows by the gradient n x (opposite edge) / (2 area) along the way.
        let turned = normal.cross(along_m) * (length_m / (way_m * area.length()));
        let grows = [c - b, a - c, b - a].map(|edge| -turned.dot(edge));
        if (0..3).any(|i| from[i] <= 0.0 && grows[i] < 0.0) {
            return None;
        }
        Some(Move { slot, from, to: [0, 1, 2].map(|i| from[i] + grows[i]), length_m })
    }

    /// The way along an edge of a triangle. On an edge all that is across it presses. `(offset_m, press_m)`: to the goal,
    /// and how much of it is inward (adhesion included).
    fn way_along_edge(
        &self,
        slot: u32,
        from: [f64; 3],
        [place, other]: [usize; 2],
        (offset_m, press_m): (DVec3, f64),
        cone: &Cone,
    ) -> Option<Move> {
        let corners_m = self.corners_m(slot)?;
        let edge_m = corners_m[other] - corners_m[place];
        let edge_length_m = edge_m.length();
        let along_m = offset_m.dot(edge_m) / edge_length_m;
        let across_m = (offset_m.length_squared() - along_m * along_m).max(0.0).sqrt();
        let pressed_m = if press_m > 0.0 { across_m + cone.adhesion_m } else { 0.0 };
        let length_m = along_m.abs() - cone.held_m(pressed_m);
        if length_m.is_nan() || length_m <= SHORTEST_WAY_M {
            return None;
        }
        let share = length_m.copysign(along_m) / edge_length_m;
        let mut to = from;
        to[place] -= share;
        to[other] += share;
        if (from[place] <= 0.0 && share > 0.0) || (from[other] <= 0.0 && share < 0.0) {
            return None;
        }
        Some(Move { slot, from, to, length_m })
    }
}

/// Weights of sum 1, those near zero put to zero; `None` when they are no numbers.
fn cleaned(weights: [f64; 3]) -> Option<[f64; 3]> {
    let kept = weights.map(|w| if w <= ON_EDGE { 0.0 } else { w });
    let sum: f64 = kept.iter().sum();
    (sum.is_finite() && sum > 0.0).then(|| kept.map(|w| w / sum))
}
