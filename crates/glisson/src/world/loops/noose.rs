//! A closed thread around tissue.
//!
//! It goes through places of the surface that it was around when it was drawn (they do not slip along the stump), and through the tip
//! of the instrument that draws it, if one does. It slides through all of them without friction, so that one tension pulls on all
//! ([`super::tension`]). Places that are not on the shortest way around it leaves aside. How tissue and hand give way is known by
//! [`crate::world::tissue_patch`].

use super::section::{Crossing, convex_hull};
use super::tension::ClosedThread;
use crate::contact::tool_contact::ToolContact;
use crate::math::{DMat3, DVec3, tetrahedron_volume_m3};
use crate::mesh::NodeId;
use crate::mesh::topology::Topology;
use crate::model::bounded_vec::BoundedVec;
use crate::model::{NodalForce, NodalSpring};
use crate::tool::ligating_loop::LigatingLoop;
use crate::world::grasp::insert_nearest;
use crate::world::organ::Organ;
use crate::world::tissue_patch::{PatchMemory, TissuePatch, add_force};

/// Places of the tissue that a noose goes through at most: a choice.
pub(super) const MOST_ANCHORS: usize = 16;
/// The thread is drawn no further where tissue at it is pressed to the first share of its volume, and ever more slowly from the second
/// one on: choices. No law of tissue holds further on, and no mesh is fine enough.
const CRUSHED: [f64; 2] = [0.3, 0.6];

/// Stiffness of the springs for the model, over tension and a mean side: a choice. Across, the thread has 2 at each of its corners.
const STEADYING: f64 = 2.0;
/// Nodes that a place is held by, at most: those of all places fit into a patch.
const MOST_HELD: usize = TissuePatch::MOST_NODES / MOST_ANCHORS;
/// Around fewer places nothing is held.
const FEWEST_ANCHORS: usize = 3;
/// The thread presses on a band of the surface so far to both of its sides [m], or as far as a share of the sides of the triangles:
/// choices. Pulled on along a line, tissue of a mesh gives way node by node.
const BAND_M: f64 = 3e-3;
const BAND_OF_SIDE: f64 = 1.2;

/// A place of the tissue that a noose goes through: the mean of nodes of the surface.
#[derive(Clone, Copy, Debug)]
struct Anchor {
    nodes: [NodeId; MOST_HELD],
    /// Zero where there is no further node; their sum is one.
    weights: [f64; MOST_HELD],
    /// How far it is inside of the surface at rest [m].
    deep_m: f64,
    /// Force of the thread on it in the last step [N].
    force_n: DVec3,
}

impl Anchor {
    /// About a place of the surface at rest; none where there are no nodes.
    fn about(place_m: DVec3, side_m: f64, organ: &Organ, near: &[ToolContact]) -> Option<Self> {
        let reach_m = BAND_M.max(BAND_OF_SIDE * side_m);
        let rest_m = &organ.mesh().positions_m;
        let mut found = [(f64::INFINITY, NodeId(u32::MAX)); MOST_HELD];
        for node in near.iter().flat_map(|contact| organ.skin().place_of(*contact).nodes) {
            let away_m = rest_m[node.index()].distance(place_m);
            if away_m < reach_m {
                insert_nearest(&mut found, (away_m, node));
            }
        }
        // A node of few tetrahedra, as on an edge, bears little.
        let topology = organ.body().topology();
        let weights = found.map(|(away_m, node)| match away_m < reach_m {
            true => (1.0 - (away_m / reach_m).powi(2)) * topology.node_tets(node).len() as f64,
            false => 0.0,
        });
        let nodes = found.map(|(_, node)| node);
        let anchor = Self { nodes, weights, deep_m: 0.0, force_n: DVec3::ZERO }.normalized()?;
        Some(Self { deep_m: anchor.place_m(rest_m).distance(place_m), ..anchor })
    }

    /// With weights that add up to one; none where there are no nodes.
    fn normalized(mut self) -> Option<Self> {
        let sum: f64 = self.weights.iter().sum();
        self.weights.iter_mut().for_each(|w| *w /= sum);
        (sum > 0.0).then_some(self)
    }

    /// Its nodes with their weights.
    fn held(&self) -> impl Iterator<Item = (NodeId, f64)> + use<> {
        self.nodes.into_iter().zip(self.weights).filter(|(_, w)| *w != 0.0)
    }

    /// Where it is [m].
    fn place_m(&self, positions_m: &[DVec3]) -> DVec3 {
        self.held().map(|(node, w)| positions_m[node.index()] * w).sum()
    }
}

/// A closed thread around tissue.
#[derive(Clone, Debug)]
pub(super) struct Noose {
    /// In their order around it.
    anchors: BoundedVec<Anchor>,
    /// How long the thread may be [m].
    pub(super) length_m: f64,
    tension_n: f64,
    /// Greatest tension [N].
    greatest_n: f64,
    /// Radius of the thread [m].
    radius_m: f64,
    memory: PatchMemory,
    /// Forces on nodes in the last step, ascending by node.
    forces: BoundedVec<NodalForce>,
    /// Springs that keep the nodes where they are expected in the step.
    springs: BoundedVec<NodalSpring>,
    /// Force on the instrument that draws it in the last step [N].
    on_tool_n: DVec3,
}

/// The tip of an instrument that draws a noose.
#[derive(Clone, Copy, Debug)]
pub(super) struct Tip {
    /// Where it would be without the thread's pull [m].
    pub(super) place_m: DVec3,
    /// How it gives way [m/N].
    pub(super) m_per_n: f64,
}

/// Room for a step of a noose.
#[derive(Debug)]
pub(super) struct NooseScratch {
    pub(super) patch: TissuePatch,
    thread: ClosedThread,
    pub(super) way: Way,
}

impl NooseScratch {
    pub(super) fn new() -> Self {
        Self {
            patch: TissuePatch::new(),
            thread: ClosedThread::with_room_for(MOST_ANCHORS + 1),
            way: Way::new(),
        }
    }
}

/// The shortest way around some places.
#[derive(Debug)]
pub(super) struct Way {
    /// The places, the tip last [m]: in space, and in a plane along them.
    places_m: Vec<DVec3>,
    in_plane_m: Vec<[f64; 2]>,
    order: Vec<u32>,
    /// Where it is bent, once around.
    bent: Vec<u32>,
}

impl Way {
    pub(super) fn new() -> Self {
        let n = MOST_ANCHORS + 1;
        Self {
            places_m: Vec::with_capacity(n),
            in_plane_m: Vec::with_capacity(n),
            order: Vec::with_capacity(n),
            bent: Vec::with_capacity(2 * n),
        }
    }

    /// Finds where it is bent around `places_m`. A plane along the first ones is that of the thread.
    fn find_bent(&mut self, n_anchors: usize) {
        let Self { places_m, in_plane_m, order, bent } = self;
        let around_m = &places_m[..n_anchors];
        let middle_m = around_m.iter().sum::<DVec3>() / n_anchors.max(1) as f64;
        let normal = (0..n_anchors)
            .map(|i| (around_m[i] - middle_m).cross(around_m[(i + 1) % n_anchors] - middle_m))
            .sum::<DVec3>()
            .normalize_or(DVec3::Z);
        let x = normal.any_orthonormal_vector();
        let y = normal.cross(x);
        in_plane_m.clear();
        in_plane_m.extend(places_m.iter().map(|p| [(*p - middle_m).dot(x), (*p - middle_m).dot(y)]));
        order.clear();
        order.extend(0..places_m.len() as u32);
        convex_hull(order, &|i| in_plane_m[i as usize], bent);
    }

    /// Its length around some places, of which `n_anchors` are the thread's and a last one may be a tip [m].
    fn length_m(&mut self, places_m: impl Iterator<Item = DVec3>, n_anchors: usize) -> f64 {
        self.places_m.clear();
        self.places_m.extend(places_m);
        self.find_bent(n_anchors);
        let at = |i: usize| self.places_m[self.bent[i % self.bent.len()] as usize];
        (0..self.bent.len()).map(|i| at(i).distance(at(i + 1))).sum()
    }
}

/// What is told of a patch's nodes, at an anchor.
fn carried(anchor: &Anchor, patch: &TissuePatch, of_node: impl Fn(usize) -> DVec3) -> DVec3 {
    // All of them are in it: there is room ([`MOST_HELD`]).
    anchor.held().filter_map(|(node, w)| Some(of_node(patch.place_of(node)?) * w)).sum()
}

/// How far an anchor goes for a force on another one [m/N].
fn answer_m_per_n((to, from): (&Anchor, &Anchor), patch: &TissuePatch) -> DMat3 {
    let mut sum = DMat3::ZERO;
    for (i, of_to) in to.held() {
        for (j, of_from) in from.held() {
            if let (Some(i), Some(j)) = (patch.place_of(i), patch.place_of(j)) {
                sum += patch.tensor_m_per_n(i, j) * (of_to * of_from);
            }
        }
    }
    sum
}

impl Noose {
    /// Around nothing, with the thread of such a loop.
    pub(super) fn new(size: &LigatingLoop) -> Self {
        Self {
            anchors: BoundedVec::with_capacity(MOST_ANCHORS),
            length_m: f64::INFINITY,
            tension_n: 0.0,
            greatest_n: size.greatest_pull_n,
            radius_m: 0.5 * size.thread_m,
            memory: PatchMemory::new(),
            forces: BoundedVec::with_capacity(MOST_HELD * MOST_ANCHORS),
            springs: BoundedVec::with_capacity(TissuePatch::MOST_NODES),
            on_tool_n: DVec3::ZERO,
        }
    }

    /// Springs for the model, after the forces.
    pub(super) fn springs(&self) -> &[NodalSpring] {
        &self.springs
    }

    /// Whether it is around nothing.
    pub(super) fn is_empty(&self) -> bool {
        self.anchors.len() < FEWEST_ANCHORS
    }

    /// Radius of the thread [m].
    pub(super) fn radius_m(&self) -> f64 {
        self.radius_m
    }

    /// The forces of the last step are no more: the tissue was put elsewhere.
    pub(super) fn forget(&mut self) {
        self.forces.clear();
        self.springs.clear();
        self.memory.forget();
        self.anchors.iter_mut().for_each(|anchor| anchor.force_n = DVec3::ZERO);
        (self.tension_n, self.on_tool_n) = (0.0, DVec3::ZERO);
    }

    /// Goes around nothing any more.
    pub(super) fn clear(&mut self) {
        self.forget();
        self.anchors.clear();
        self.length_m = f64::INFINITY;
    }

    /// Goes around what a section found.
    pub(super) fn go_around(&mut self, around: &[Crossing], organ: &Organ, near: &[ToolContact]) {
        self.clear();
        let rest_m = &organ.mesh().positions_m;
        for crossing in around {
            let [a_m, b_m] = crossing.edge.map(|node| rest_m[node.index()]);
            let place_m = a_m.lerp(b_m, crossing.weight);
            if let Some(anchor) = Anchor::about(place_m, a_m.distance(b_m), organ, near) {
                self.anchors.try_push(anchor);
            }
        }
    }

    /// Where the thread is, once around, and through the tip of the instrument that draws it [m].
    pub(super) fn places_m<'a>(
        &'a self,
        organ: &'a Organ,
        tip_m: Option<DVec3>,
    ) -> impl Iterator<Item = DVec3> + 'a {
        let anchors = self.anchors.iter().map(|anchor| anchor.place_m(organ.positions_m()));
        anchors.chain(tip_m)
    }

    /// The same on the surface, where it lies and is seen [m].
    pub(super) fn seen_m(&self, positions_m: &[DVec3]) -> impl Iterator<Item = DVec3> {
        let places_m = self.anchors.iter().map(|anchor| anchor.place_m(positions_m));
        let middle_m = places_m.sum::<DVec3>() / self.anchors.len().max(1) as f64;
        self.anchors.iter().map(move |anchor| {
            let place_m = anchor.place_m(positions_m);
            place_m + (place_m - middle_m).normalize_or_zero() * (anchor.deep_m + self.radius_m)
        })
    }

    /// Its length around what it is around as that is now, and through a tip [m].
    pub(super) fn girth_m(&self, organ: &Organ, tip_m: Option<DVec3>, way: &mut Way) -> f64 {
        way.length_m(self.places_m(organ, tip_m), self.anchors.len())
    }

    /// Its length around the same places at rest [m].
    pub(super) fn girth_at_rest_m(&self, organ: &Organ, way: &mut Way) -> f64 {
        let rest_m = &organ.mesh().positions_m;
        way.length_m(self.anchors.iter().map(|anchor| anchor.place_m(rest_m)), self.anchors.len())
    }

    /// The middle at rest of what it is around [m].
    pub(super) fn middle_at_rest_m(&self, organ: &Organ) -> DVec3 {
        let rest_m = &organ.mesh().positions_m;
        let places_m = self.anchors.iter().map(|anchor| anchor.place_m(rest_m));
        places_m.sum::<DVec3>() / self.anchors.len().max(1) as f64
    }

    /// What is known of the tissue that it pulls on.
    pub(super) fn memory(&self) -> &PatchMemory {
        &self.memory
    }

    /// The same thread without an instrument: as long as it is around now.
    pub(super) fn tied_off(&self, organ: &Organ, way: &mut Way) -> Self {
        let length_m = self.girth_m(organ, None, way);
        Self { length_m, on_tool_n: DVec3::ZERO, ..self.clone() }
    }

    /// Tension [N].
    pub(super) fn tension_n(&self) -> f64 {
        self.tension_n
    }

    /// Forces on nodes in the last step, ascending by node.
    pub(super) fn forces(&self) -> &[NodalForce] {
        &self.forces
    }

    /// Force on the instrument that draws it in the last step [N].
    pub(super) fn on_tool_n(&self) -> DVec3 {
        self.on_tool_n
    }

    /// Draws the thread towards a length, by so much at most and no further than tissue bears of whose `volume` this share is left;
    /// lets it out at once.
    pub(super) fn draw(&mut self, to_m: f64, most_m: f64, (now_m, volume): (f64, f64)) {
        let [crushed, free] = CRUSHED;
        let share = ((volume - crushed) / (free - crushed)).clamp(-1.0, 1.0);
        let from_m = if share > 0.0 { self.length_m } else { self.length_m.max(now_m) };
        self.length_m = to_m.max(from_m - share * most_m);
    }

    /// Whether tissue at it is pressed so far that it is drawn ever more slowly.
    pub(super) fn is_at_its_limit(&self, organ: &Organ) -> bool {
        self.least_volume(organ) < CRUSHED[1]
    }

    /// The least volume, over that at rest, of the tetrahedra at the nodes that it pulls on.
    pub(super) fn least_volume(&self, organ: &Organ) -> f64 {
        let topology = organ.body().topology();
        let volume_m3 = |tet, positions_m: &[DVec3]| {
            tetrahedron_volume_m3(topology.tet_nodes(tet).map(|node| positions_m[node.index()]))
        };
        let tets = self.forces.iter().flat_map(|force| topology.node_tets(force.node));
        let shares =
            tets.map(|&tet| volume_m3(tet, organ.positions_m()) / volume_m3(tet, &organ.mesh().positions_m));
        shares.fold(1.0, f64::min)
    }

    /// Before a step: nodes that the model is asked for.
    pub(super) fn gather(&mut self, organ: &Organ, patch: &mut TissuePatch) {
        self.memory.learn_softness(organ.positions_m());
        patch.nodes.clear();
        for anchor in self.anchors.iter() {
            for (node, _) in anchor.held() {
                patch.ask_for(&[node]);
            }
        }
        patch.set_before(&self.forces);
    }

    /// A step, the patch having learned: finds the tension, and the forces that it makes. Allocates nothing.
    pub(super) fn settle(
        &mut self,
        organ: &Organ,
        velocities_m_per_s: &[DVec3],
        tip: Option<Tip>,
        scratch: &mut NooseScratch,
    ) {
        let n_anchors = self.anchors.len();
        let NooseScratch { patch, way: Way { places_m, .. }, .. } = &mut *scratch;
        // Where all is without the thread's pull.
        for (change_n, before_n) in patch.change_n.iter_mut().zip(&patch.before_n) {
            *change_n = -*before_n;
        }
        patch.answer();
        places_m.clear();
        let goes_to_m = |place: usize| patch.free_m[place];
        places_m.extend(self.anchors.iter().map(|anchor| carried(anchor, patch, goes_to_m)));
        places_m.extend(tip.map(|tip| tip.place_m + self.on_tool_n * tip.m_per_n));
        scratch.way.find_bent(n_anchors);
        self.tell_thread(tip, scratch);
        let NooseScratch { patch, thread, way: Way { bent, .. } } = &mut *scratch;
        self.tension_n = thread.solve(self.length_m, self.tension_n, self.greatest_n);
        self.anchors.iter_mut().for_each(|anchor| anchor.force_n = DVec3::ZERO);
        self.on_tool_n = DVec3::ZERO;
        for (corner, &place) in bent.iter().enumerate() {
            let force_n = thread.force_n(corner, self.tension_n);
            match self.anchors.get_mut(place as usize) {
                Some(anchor) => anchor.force_n = force_n,
                None => self.on_tool_n = force_n,
            }
        }
        self.forces.clear();
        for anchor in self.anchors.iter() {
            for (node, w) in anchor.held() {
                add_force(&mut self.forces, NodalForce { node, force_n: anchor.force_n * w });
                if let Some(place) = patch.place_of(node) {
                    patch.change_n[place] += anchor.force_n * w;
                }
            }
        }
        patch.answer();
        patch.keep(velocities_m_per_s, organ.positions_m(), &mut self.memory);
        self.keep_springs(scratch);
    }

    /// The springs with which the model keeps the nodes where they are expected, at least as stiff across the thread as that is.
    fn keep_springs(&mut self, scratch: &NooseScratch) {
        let NooseScratch { patch, thread, .. } = scratch;
        let n_per_m = STEADYING * self.tension_n / thread.mean_side_m();
        self.springs.clear();
        for anchor in self.anchors.iter().filter(|anchor| anchor.force_n != DVec3::ZERO) {
            for (node, w) in anchor.held() {
                let Some(place) = patch.place_of(node) else { continue };
                match self.springs.iter_mut().find(|spring| spring.node == node) {
                    Some(spring) => spring.stiffness_n_per_m += n_per_m * w,
                    None => {
                        let (place_m, stiffness_n_per_m) = (patch.expected_m(place), n_per_m * w);
                        self.springs.try_push(NodalSpring { node, place_m, stiffness_n_per_m });
                    }
                }
            }
        }
    }

    /// Tells the thread where its corners are and how they answer.
    fn tell_thread(&self, tip: Option<Tip>, scratch: &mut NooseScratch) {
        let NooseScratch { patch, thread, way: Way { places_m, bent, .. } } = scratch;
        thread.start_m.clear();
        thread.start_m.extend(bent.iter().map(|&place| places_m[place as usize]));
        let without_m = |place: usize| patch.free_m[place] + patch.moves_m[place];
        thread.free_m.clear();
        thread.free_m.extend(bent.iter().filter_map(|&place| match self.anchors.get(place as usize) {
            Some(anchor) => Some(carried(anchor, patch, without_m)),
            None => Some(tip?.place_m),
        }));
        thread.answers_m_per_n.clear();
        for (&to, &from) in bent.iter().flat_map(|to| bent.iter().map(move |from| (to, from))) {
            let of = |place: u32| self.anchors.get(place as usize);
            let tensor = match (of(to), of(from), tip) {
                (Some(to), Some(from), _) => answer_m_per_n((to, from), patch),
                (None, None, Some(tip)) => DMat3::IDENTITY * tip.m_per_n,
                _ => DMat3::ZERO,
            };
            thread.answers_m_per_n.push(tensor);
        }
    }

    /// After an edit of the tissue: nodes that are gone are let go, or `went_elsewhere` in it, and places without any are given up.
    /// Allocates nothing.
    pub(super) fn follow_edit(&mut self, topology: &Topology, went_elsewhere: impl Fn(NodeId) -> bool) {
        let is_there = |node: NodeId| {
            node.index() < topology.n_nodes() && topology.is_live_node(node) && !went_elsewhere(node)
        };
        self.anchors.retain_mut(|anchor| {
            let kept = |at: usize| if is_there(anchor.nodes[at]) { anchor.weights[at] } else { 0.0 };
            let left = Anchor { weights: std::array::from_fn(kept), ..*anchor }.normalized();
            *anchor = left.unwrap_or(*anchor);
            left.is_some()
        });
        self.memory.retain(is_there);
        self.forces.retain(|force| is_there(force.node));
        self.springs.clear();
    }

    /// Everything that its next steps depend on.
    pub(super) fn numbers(&self) -> impl Iterator<Item = f64> + '_ {
        let of_anchor = |anchor: &Anchor| {
            let held = anchor.held().flat_map(|(node, w)| [f64::from(node.0), w]);
            held.chain(anchor.force_n.to_array())
        };
        let of_force = |f: &NodalForce| [f64::from(f.node.0), f.force_n.x, f.force_n.y, f.force_n.z];
        let counts = [self.anchors.len(), self.forces.len()].map(|n| n as f64);
        let own = counts.into_iter().chain([self.length_m, self.tension_n]).chain(self.on_tool_n.to_array());
        let forces = self.forces.iter().flat_map(of_force);
        self.anchors.iter().flat_map(of_anchor).chain(self.memory.numbers()).chain(forces).chain(own)
    }
}
