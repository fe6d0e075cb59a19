//! One stroke: nodes selected along the path, the front of the cut, and the work that is left.

use super::wall::{Plane, face, groups_at, triangle_of, way_around};
use super::{ScalpelParams, ScalpelReport, triangle_edge_m};
use crate::math::DVec3;
use crate::mesh::edit::{EditableMesh, MeshEdit};
use crate::mesh::repair::{Freedom, freedom, rest_place_m, watched_move};
use crate::mesh::topology::Topology;
use crate::mesh::{NodeId, TetId, TriangleId};

/// Share of an edge by which the blade has to get away from a candidate before it counts as moving away: the hand
/// trembles. A choice.
const AWAY: f64 = 0.02;

/// Share of an edge by which the tip has to be deeper than a node on the ground of the cut to open it. A choice.
const DEEPER: f64 = 0.3;

/// Share of an edge within which a node on the ground counts as passed by the blade. A choice.
const BESIDE: f64 = 0.75;

/// Share of the longest edge at the last selected node beyond which the path has left its neighbourhood. A choice.
const FAR: f64 = 1.25;

/// The same for a path that will not come back. A choice.
const LOST: f64 = 2.5;

/// Share of an edge below which a node stays where it is. A choice.
const NO_MOVE: f64 = 1e-6;

/// Share of an edge over which the direction of the path is taken. A choice.
const CHORD: f64 = 0.5;

/// Places of the blade that are kept. The front hardly reaches further back.
const N_SAMPLES: usize = 128;

/// Share of an edge between places of the blade that are kept, but for the last. A choice.
const APART: f64 = 0.1;

/// One place of the path.
#[derive(Clone, Copy, Debug)]
pub(super) struct PathPoint {
    /// Where the blade goes through the surface [m].
    pub(super) point_m: DVec3,
    /// Where its tip is [m].
    pub(super) tip_m: DVec3,
    /// Unit vector towards the tip.
    pub(super) blade: DVec3,
    /// How far it moved since the last look [m].
    pub(super) moved_m: DVec3,
    /// Whether it is on a side through which the blade came, instead of where the blade goes in.
    pub(super) is_on_side: bool,
}

/// The blade at one time, and the plane that it cut there.
#[derive(Clone, Copy, Debug)]
struct Sample {
    plane: Plane,
    tip_m: DVec3,
}

/// The node that will be selected next.
#[derive(Clone, Copy, Debug)]
struct Candidate {
    node: NodeId,
    /// Least distance so far [m], and where the path was then.
    distance_m: f64,
    at: Sample,
    /// Whether the path was nearer to it than to the last selected node then.
    is_reached: bool,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Kind {
    /// Selected on the surface.
    Selected,
    /// Was inside when the wall reached it.
    Inner,
    /// Was on the surface already, or could not be opened.
    Closed,
    /// Has come apart: the front ends here on both sides.
    Apart,
}

#[derive(Clone, Copy, Debug)]
struct FrontNode {
    node: NodeId,
    kind: Kind,
    sample: Sample,
}

#[derive(Clone, Debug)]
enum Stage {
    Idle,
    /// Selected nodes or nodes of a wall that are to be moved; then the node at this place of the front is opened.
    Move {
        nodes: Vec<(NodeId, DVec3)>,
        then_open: Option<(usize, Vec<NodeId>)>,
    },
    /// Nodes that may have come apart.
    Check(Vec<NodeId>),
}

/// One stroke.
#[derive(Clone, Debug)]
pub(super) struct Stroke {
    /// Mean edge where the blade is [m].
    pub(super) edge_m: f64,
    samples: Vec<Sample>,
    candidate: Option<Candidate>,
    last: NodeId,
    /// The line where cut and uncut meet, from the first selected node to the last.
    front: Vec<FrontNode>,
    /// Faces of the wall that are not open yet.
    wall: Vec<[NodeId; 3]>,
    /// Selected nodes and their copies.
    used: Vec<NodeId>,
    stage: Stage,
    is_ending: bool,
    /// Whether the wall came to the last node before the path did: the path has to come near first.
    is_ahead: bool,
    /// Whether everything along the path has come apart, so that the path does not go on.
    is_through: bool,
    n_copies_wanted: usize,
}

/// Whether a node has to stay where it is.
fn is_corner(body: &EditableMesh, node: NodeId, params: &ScalpelParams) -> bool {
    freedom(body, node, params.limits.sharp_cosine) == Freedom::Fixed
}

impl Stroke {
    /// Selects the surface node nearest to the start.
    pub(super) fn start(
        body: &EditableMesh,
        positions_m: &[DVec3],
        at: PathPoint,
        triangle: TriangleId,
        params: &ScalpelParams,
    ) -> Self {
        let topology = body.topology();
        let rank =
            |n: NodeId| (is_corner(body, n, params), positions_m[n.index()].distance_squared(at.point_m));
        let [a, b, c] = topology.triangle_nodes(triangle);
        let nearest = [b, c].into_iter().fold(a, |best, n| if rank(n) < rank(best) { n } else { best });
        let mut stroke = Self {
            edge_m: triangle_edge_m(topology, positions_m, triangle),
            samples: Vec::new(),
            candidate: None,
            last: nearest,
            front: Vec::new(),
            wall: Vec::new(),
            used: Vec::new(),
            stage: Stage::Idle,
            is_ending: false,
            is_ahead: false,
            is_through: false,
            n_copies_wanted: 0,
        };
        let sample = stroke.sample(at);
        stroke.select(nearest, sample);
        stroke
    }

    /// Whether nothing is left to do.
    pub(super) fn is_over(&self) -> bool {
        (self.is_ending || self.is_through) && matches!(self.stage, Stage::Idle)
    }

    /// The node selected last.
    pub(super) fn last(&self) -> NodeId {
        self.last
    }

    /// How many nodes the edits handed out last bring in.
    pub(super) fn n_copies_wanted(&self) -> usize {
        self.n_copies_wanted
    }

    /// The path goes on to `at`.
    pub(super) fn follow(
        &mut self,
        body: &EditableMesh,
        positions_m: &[DVec3],
        at: PathPoint,
        params: &ScalpelParams,
    ) {
        let topology = body.topology();
        if !topology.is_surface_node(self.last) {
            return;
        }
        let sample = self.sample(at);
        let away_m = |node: NodeId| positions_m[node.index()].distance(at.point_m);
        let mut longest_m: f64 = 0.0;
        let mut around: Vec<(f64, NodeId)> = Vec::new();
        for triangle in topology.surface_triangles_at(self.last) {
            for node in topology.triangle_nodes(triangle) {
                if node != self.last && around.iter().all(|&(_, n)| n != node) {
                    longest_m =
                        longest_m.max(positions_m[node.index()].distance(positions_m[self.last.index()]));
                    around.push((away_m(node), node));
                }
            }
        }
        around.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        around.retain(|&(_, node)| self.may_follow(topology, node));
        // Corners cannot move onto the path: only if there is nothing else.
        let movable = around.iter().find(|(_, node)| !is_corner(body, *node, params));
        let Some(&(distance_m, node)) = movable.or(around.first()) else { return };
        let from_last_m = away_m(self.last);
        let now = Candidate { node, distance_m, at: sample, is_reached: distance_m < from_last_m };
        match self.candidate {
            _ if self.is_ahead && from_last_m > longest_m => {}
            Some(candidate) if candidate.node == node => {
                if distance_m < candidate.distance_m {
                    self.candidate = Some(now);
                } else if candidate.is_reached && distance_m > candidate.distance_m + AWAY * self.edge_m {
                    return self.select(candidate.node, candidate.at);
                }
            }
            Some(candidate) if candidate.is_reached && away_m(candidate.node) > candidate.distance_m => {
                return self.select(candidate.node, candidate.at);
            }
            _ => self.candidate = Some(now),
        }
        if from_last_m <= longest_m {
            self.is_ahead = false;
        } else if !self.is_ahead && from_last_m > FAR * longest_m {
            if distance_m < FAR * longest_m {
                self.select(node, sample);
            } else if from_last_m > LOST * longest_m {
                // No edges lead along the path: it jumped over a gap.
                self.is_ending = true;
            }
        }
    }

    /// The blade is out: a candidate that it came nearer to than to the last node belongs to the cut.
    pub(super) fn end(&mut self, positions_m: &[DVec3]) {
        if let Some(candidate) = self.candidate
            && let Some(last) = self.samples.last()
        {
            let [to_candidate_m, to_last_m] =
                [candidate.node, self.last].map(|n| positions_m[n.index()].distance(last.plane.point_m));
            if candidate.is_reached || to_candidate_m < to_last_m {
                self.select(candidate.node, candidate.at);
            }
        }
        self.is_ending = true;
    }

    /// Whether the node may be selected after the last one: neither used nor in a triangle with two used ones.
    fn may_follow(&self, topology: &Topology, node: NodeId) -> bool {
        let is_taken = |n: NodeId| self.used.contains(&n) || self.front.iter().any(|f| f.node == n);
        !is_taken(node)
            && topology.surface_triangles_at(self.last).all(|triangle| {
                let nodes = topology.triangle_nodes(triangle);
                !nodes.contains(&node) || nodes.iter().all(|&n| n == node || n == self.last || !is_taken(n))
            })
    }

    /// Keeps the blade's place with the plane of blade and path.
    fn sample(&mut self, at: PathPoint) -> Sample {
        let chord_m = self
            .samples
            .iter()
            .rev()
            .map(|s| at.point_m - s.plane.point_m)
            .find(|chord_m| chord_m.length() >= CHORD * self.edge_m);
        // On a side the path runs along the blade: only the motion tells the plane.
        let along_m = if at.is_on_side { at.moved_m } else { chord_m.unwrap_or(at.moved_m) };
        let normal = [along_m, at.moved_m]
            .into_iter()
            .find_map(|way_m| {
                let across = way_m.cross(at.blade);
                (across.length() > 0.1 * way_m.length()).then(|| across.normalize())
            })
            .or(self.samples.last().map(|s| s.plane.normal))
            .unwrap_or_else(|| at.blade.any_orthonormal_vector());
        let sample = Sample { plane: Plane { point_m: at.point_m, normal }, tip_m: at.tip_m };
        // On a side the blade is where it is anyhow.
        if !at.is_on_side {
            if let [.., before, last] = &self.samples[..]
                && before.plane.point_m.distance(last.plane.point_m) < APART * self.edge_m
            {
                self.samples.pop();
            } else if self.samples.len() == N_SAMPLES {
                self.samples.drain(..N_SAMPLES / 2);
            }
            self.samples.push(sample);
        }
        sample
    }

    fn select(&mut self, node: NodeId, sample: Sample) {
        self.front.push(FrontNode { node, kind: Kind::Selected, sample });
        self.used.push(node);
        self.last = node;
        self.candidate = None;
        self.stage = Stage::Move { nodes: vec![(node, sample.plane.point_m)], then_open: None };
    }

    /// The next edits that need no news from the blade.
    pub(super) fn work(
        &mut self,
        body: &EditableMesh,
        positions_m: &[DVec3],
        params: &ScalpelParams,
        report: &mut ScalpelReport,
    ) -> Option<Vec<MeshEdit>> {
        self.n_copies_wanted = 0;
        loop {
            match std::mem::replace(&mut self.stage, Stage::Idle) {
                Stage::Idle => self.stage = self.plan(body, positions_m, report)?,
                Stage::Move { mut nodes, then_open } => match nodes.pop() {
                    Some((node, to_m)) => {
                        report.n_selected += usize::from(then_open.is_none());
                        self.stage = Stage::Move { nodes, then_open };
                        let edit = self.move_node(body, positions_m, node, to_m, params, report);
                        if edit.is_some() {
                            return edit.map(|edit| vec![edit]);
                        }
                    }
                    None => {
                        if let Some((index, way)) = then_open {
                            let edits = self.open(body, index, &way, report);
                            if !edits.is_empty() {
                                return Some(edits);
                            }
                        }
                    }
                },
                Stage::Check(mut nodes) => {
                    if let Some(node) = nodes.pop() {
                        self.stage = Stage::Check(nodes);
                        let groups = groups_at(body.topology(), node, &self.wall);
                        if groups.len() > 1 {
                            self.part_front_at(node);
                            return Some(self.copy(body, node, groups, report));
                        }
                    }
                }
            }
        }
    }

    /// What to do next: open a selected node between two others, else one on the ground of the cut.
    fn plan(
        &mut self,
        body: &EditableMesh,
        positions_m: &[DVec3],
        report: &mut ScalpelReport,
    ) -> Option<Stage> {
        loop {
            let open = |wanted: Kind| {
                (1..self.front.len().saturating_sub(1)).find(|&i| {
                    self.front[i].kind == wanted
                        && self.front[i - 1].kind != Kind::Apart
                        && self.front[i + 1].kind != Kind::Apart
                        && (wanted == Kind::Selected || self.is_passed(positions_m, self.front[i].node))
                })
            };
            let index = open(Kind::Selected).or_else(|| open(Kind::Inner))?;
            let node = self.front[index].node;
            let plane = match self.front[index].kind {
                Kind::Inner => self.nearest_sample(positions_m[node.index()])?.0.plane,
                _ => self.front[index].sample.plane,
            };
            let ends = [self.front[index - 1].node, self.front[index + 1].node];
            match way_around(body, positions_m, node, ends, &plane) {
                Some(way) => {
                    let onto_plane = |&n: &NodeId| (n, plane.nearest_m(positions_m[n.index()]));
                    let nodes = way.iter().map(onto_plane).collect();
                    return Some(Stage::Move { nodes, then_open: Some((index, way)) });
                }
                None => {
                    report.n_closed += 1;
                    self.front[index].kind = Kind::Closed;
                }
            }
        }
    }

    /// The blade's place nearest to a point, and the distance [m].
    fn nearest_sample(&self, point_m: DVec3) -> Option<(Sample, f64)> {
        let mut nearest: Option<(Sample, f64)> = None;
        for sample in &self.samples {
            let top_m = sample.plane.point_m;
            let blade_m = sample.tip_m - top_m;
            let share = (point_m - top_m).dot(blade_m) / blade_m.length_squared().max(f64::MIN_POSITIVE);
            let distance_m = point_m.distance(top_m + share.clamp(0.0, 1.0) * blade_m);
            if nearest.is_none_or(|(_, so_far)| distance_m < so_far) {
                nearest = Some((*sample, distance_m));
            }
        }
        nearest
    }

    /// Whether the blade passed a node on the ground of the cut and reached deeper.
    fn is_passed(&self, positions_m: &[DVec3], node: NodeId) -> bool {
        let point_m = positions_m[node.index()];
        let (Some((sample, distance_m)), [.., last]) = (self.nearest_sample(point_m), &self.samples[..])
        else {
            return false;
        };
        let is_ahead =
            !self.is_ending && sample.plane.point_m == last.plane.point_m && distance_m > AWAY * self.edge_m;
        let blade_m = sample.tip_m - sample.plane.point_m;
        let depth_m = (point_m - sample.plane.point_m).dot(blade_m.normalize_or_zero());
        !is_ahead && distance_m < BESIDE * self.edge_m && depth_m < blade_m.length() - DEEPER * self.edge_m
    }

    fn move_node(
        &self,
        body: &EditableMesh,
        positions_m: &[DVec3],
        node: NodeId,
        to_m: DVec3,
        params: &ScalpelParams,
        report: &mut ScalpelReport,
    ) -> Option<MeshEdit> {
        if to_m.distance(positions_m[node.index()]) < NO_MOVE * self.edge_m {
            return None;
        }
        let wanted_m = rest_place_m(body, positions_m, node, to_m)?;
        let at_m = body.mesh().positions_m[node.index()];
        match watched_move(body, node, wanted_m, &params.limits) {
            Ok(watched) => {
                let off_m = watched.position_m.distance(wanted_m);
                report.largest_offset_m = report.largest_offset_m.max(off_m);
                report.n_shortened += usize::from(watched.share < 1.0);
                if watched.position_m == at_m {
                    return None;
                }
                report.n_moved += 1;
                Some(MeshEdit::MoveVertex { node, position_m: watched.position_m })
            }
            Err(refusal) => {
                report.largest_offset_m = report.largest_offset_m.max(at_m.distance(wanted_m));
                report.n_refused += 1;
                report.last_refusal = Some(refusal);
                None
            }
        }
    }

    /// Opens the node at a place of the front along the wall through `way`.
    fn open(
        &mut self,
        body: &EditableMesh,
        index: usize,
        way: &[NodeId],
        report: &mut ScalpelReport,
    ) -> Vec<MeshEdit> {
        let topology = body.topology();
        let node = self.front[index].node;
        let ends = [self.front[index - 1].node, self.front[index + 1].node];
        let around: Vec<NodeId> = [&ends[..1], way, &ends[1..]].concat();
        for pair in around.windows(2) {
            let nodes = face(node, pair[0], pair[1]);
            if !self.wall.contains(&nodes) {
                self.wall.push(nodes);
                if let Some(triangle) = triangle_of(topology, nodes) {
                    report.wall_area_m2 +=
                        topology.area_vector_m2(triangle, &body.mesh().positions_m).length();
                }
            }
        }
        let sample = self.front[index].sample;
        let kind = |n: NodeId| if topology.is_surface_node(n) { Kind::Closed } else { Kind::Inner };
        let ground: Vec<FrontNode> =
            way.iter().map(|&node| FrontNode { node, kind: kind(node), sample }).collect();
        self.front.splice(index..=index, ground);
        self.take_spikes_off();
        let groups = groups_at(topology, node, &self.wall);
        let edits = if groups.len() > 1 { self.copy(body, node, groups, report) } else { Vec::new() };
        let mut check = around;
        if edits.is_empty() {
            check.push(node);
        }
        self.stage = Stage::Check(check);
        edits
    }

    /// A node of the front has come apart. If it was the last one, the path goes on from the one before it, to
    /// which the wall leads on the surface.
    fn part_front_at(&mut self, node: NodeId) {
        for place in self.front.iter_mut().filter(|f| f.node == node) {
            place.kind = Kind::Apart;
        }
        if node != self.last {
            return;
        }
        while self.front.last().is_some_and(|f| f.kind == Kind::Apart) {
            self.front.pop();
        }
        self.candidate = None;
        match self.front.last_mut() {
            Some(end) => {
                end.kind = Kind::Selected;
                self.last = end.node;
                self.used.push(end.node);
                self.is_ahead = true;
            }
            None => self.is_through = true,
        }
    }

    /// Takes pieces of the front away that go to a node and back.
    fn take_spikes_off(&mut self) {
        let mut at = 0;
        while at + 2 < self.front.len() {
            if self.front[at].node == self.front[at + 2].node && self.front[at].kind != Kind::Apart {
                self.front.drain(at + 1..at + 3);
                at = at.saturating_sub(1);
            } else {
                at += 1;
            }
        }
    }

    /// Gives each group but the first a copy of `node`, and lets the wall follow.
    fn copy(
        &mut self,
        body: &EditableMesh,
        node: NodeId,
        mut groups: Vec<Vec<TetId>>,
        report: &mut ScalpelReport,
    ) -> Vec<MeshEdit> {
        let topology = body.topology();
        let n_nodes = topology.n_nodes();
        groups.remove(0);
        let n_copies = groups.len();
        // A face of the wall between two groups is open now; one that is still closed within a group goes with its copy.
        self.wall.retain_mut(|nodes| {
            if !nodes.contains(&node) {
                return true;
            }
            let Some(triangle) = triangle_of(topology, *nodes) else { return false };
            let [first, second] = topology.triangle_tets(triangle).map(|tet| tet.get());
            let (Some(first), Some(second)) = (first, second) else { return false };
            let group_of = |tet: TetId| groups.iter().position(|group| group.contains(&tet));
            let group = group_of(first);
            if let Some(at) = group {
                let copy = NodeId::from_index(n_nodes + at);
                let [a, b, c] = nodes.map(|n| if n == node { copy } else { n });
                *nodes = face(a, b, c);
            }
            group == group_of(second)
        });
        self.used.extend((n_nodes..n_nodes + n_copies).map(NodeId::from_index));
        report.n_copies += n_copies;
        self.n_copies_wanted = n_copies;
        groups.into_iter().map(|tets_of_copy| MeshEdit::DuplicateVertex { node, tets_of_copy }).collect()
    }
}
