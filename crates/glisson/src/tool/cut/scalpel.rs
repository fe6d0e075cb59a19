//! Cutting by vertex displacement: nodes move onto the path of the blade, and the faces between them open
//! (seed `000` s. 4.4.2, figs 4.13 to 4.16, after Nienhuys and Mendoza). The number of tetrahedra stays.
//!
//! The path is the history of the place where the blade goes through the surface. The surface node nearest to its
//! start is selected and moved there. The next candidate is the nearest neighbour on the surface that is in no
//! triangle with two selected nodes; it is moved onto the path when the blade begins to move away from it. A node
//! between two selected ones opens: the faces at it that go best with the plane of blade and path are the wall of the
//! cut, their inner nodes are moved onto that plane, and the tetrahedra on one side of the wall get a copy of the
//! node. A node deeper down whose whole surroundings have come apart is opened, too.
//!
//! Beyond the seed:
//! - Where the blade enters or leaves through a side, the path goes on along the blade down that side, so that the rim
//!   opens.
//! - If the blade reaches deeper than one layer of tetrahedra, the ground of the cut is opened in the same way,
//!   layer by layer, as far as the blade passed.
//! - Every move keeps the volume of the body exactly, its sharp edges, and the shape of the tetrahedra above a limit
//!   ([`crate::mesh::repair::watched_move`]); what is left of the way is reported. A cut along unmoved nodes is still
//!   a cut, only less exact.
//!
//! An incision that runs into the gap of an earlier one ends there and begins anew behind it.

mod crossing;
mod stroke;
mod wall;

use self::crossing::{Crossing, first_crossing, first_crossing_near};
use self::stroke::{PathPoint, Stroke};
use crate::math::DVec3;
use crate::mesh::TriangleId;
use crate::mesh::edit::{EditableMesh, MeshEdit};
use crate::mesh::repair::{MoveLimits, MoveRefusal};
use crate::mesh::topology::Topology;
use std::collections::VecDeque;

/// Share of an edge that the blade moves between two looks. A choice.
const PART_OF_EDGE: f64 = 0.25;

/// A side is cut if the blade enters or leaves this share of an edge below the surface point. A choice.
const LEAST_SIDE: f64 = 0.5;

/// Least sine of the angle between a blade and a side that it goes through: walls of the cut lie along the blade. A
/// choice.
const STEEP: f64 = 0.15;

/// Least sine where the blade goes in. A choice.
const BRUSH: f64 = 0.02;

/// Most looks at one motion; beyond it they are further apart. A choice.
const MOST_PARTS: usize = 4096;

/// What the scalpel's cut is watched by.
#[derive(Clone, Copy, Debug, PartialEq, Default)]
pub struct ScalpelParams {
    /// What a move of a node may not do.
    pub limits: MoveLimits,
}

/// What a cut did so far.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ScalpelReport {
    /// Strokes begun.
    pub n_strokes: usize,
    /// Surface nodes selected.
    pub n_selected: usize,
    /// Nodes moved, surface and depth.
    pub n_moved: usize,
    /// Moves that went only part of the way.
    pub n_shortened: usize,
    /// Moves that were refused.
    pub n_refused: usize,
    /// The last refused move.
    pub last_refusal: Option<MoveRefusal>,
    /// Copies of nodes made.
    pub n_copies: usize,
    /// Nodes between selected ones at which no way through the depth was found, so that they stayed closed.
    pub n_closed: usize,
    /// Largest distance [m] at rest between where a node was wanted and where it went.
    pub largest_offset_m: f64,
    /// Area [m2] at rest of the wall, one side.
    pub wall_area_m2: f64,
}

/// Why a blade cannot be followed.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum ScalpelRefusal {
    /// A coordinate is no finite number.
    #[error("the blade's ends {blade_m:?} m must be finite: hold the instrument at a valid pose")]
    NotFinite {
        /// The ends [m].
        blade_m: [DVec3; 2],
    },
    /// The positions are not one a node.
    #[error("{found} positions for a mesh of {n_nodes} nodes: pass one a node, dead ones included")]
    BadPositions {
        /// How many there are.
        found: usize,
        /// How many nodes.
        n_nodes: usize,
    },
    /// An edit that was handed out was not carried out.
    #[error("a copy of a node was not made: the stroke ends here; lift the blade and set it down again")]
    EditRefused,
}

/// A motion of the blade that is looked at in parts.
#[derive(Clone, Copy, Debug)]
struct Motion {
    from_m: [DVec3; 2],
    to_m: [DVec3; 2],
    n_parts: usize,
    n_done: usize,
}

impl Motion {
    fn at(&self, part: usize) -> [DVec3; 2] {
        if part == self.n_parts {
            return self.to_m;
        }
        let share = part as f64 / self.n_parts as f64;
        [0, 1].map(|i| self.from_m[i].lerp(self.to_m[i], share))
    }
}

/// What the blade met, in order.
#[derive(Clone, Copy, Debug)]
enum Event {
    /// The blade enters at a surface triangle.
    Start { at: PathPoint, triangle: TriangleId },
    /// The path goes on, at this surface triangle unless it is on a side.
    Point { at: PathPoint, triangle: Option<TriangleId> },
    /// The blade is out.
    End,
}

/// A scalpel that cuts one body by vertex displacement: state of the stroke, and what came of it.
#[derive(Clone, Debug, Default)]
pub struct ScalpelCut {
    params: ScalpelParams,
    report: ScalpelReport,
    motion: Option<Motion>,
    /// Tip and upper end where the last look was [m].
    blade_m: Option<[DVec3; 2]>,
    events: VecDeque<Event>,
    stroke: Option<Stroke>,
    last_entry: Option<(TriangleId, DVec3)>,
    /// Where the path of the last stroke ended [m].
    over_at_m: Option<DVec3>,
    n_nodes_expected: Option<usize>,
}

impl ScalpelCut {
    /// A scalpel that touches nothing yet.
    pub fn new(params: ScalpelParams) -> Self {
        Self { params, ..Self::default() }
    }

    /// What the cut did so far.
    pub fn report(&self) -> &ScalpelReport {
        &self.report
    }

    /// Whether the blade is in the body, or work of a stroke is left.
    pub fn is_cutting(&self) -> bool {
        self.stroke.is_some() || !self.events.is_empty()
    }

    /// The next edits on the blade's way to where it is now, a whole transaction; `None` when there are no more.
    ///
    /// Call it again with the same blade, after carrying the edits out, until `None`. At most one transaction
    /// moves a node or copies one.
    ///
    /// `positions_m`: present positions, one a node. `blade_m`: tip and upper end of the cutting edge.
    ///
    /// # Errors
    /// [`ScalpelRefusal`] if the input is no input, or an edit handed out before was not carried out; the stroke is
    /// then over.
    pub fn advance(
        &mut self,
        body: &EditableMesh,
        positions_m: &[DVec3],
        blade_m: [DVec3; 2],
    ) -> Result<Option<Vec<MeshEdit>>, ScalpelRefusal> {
        if !blade_m.iter().all(|end| end.is_finite()) {
            return Err(ScalpelRefusal::NotFinite { blade_m });
        }
        self.check(body, positions_m)?;
        let is_new = match &self.motion {
            Some(motion) => motion.to_m != blade_m,
            None => self.blade_m != Some(blade_m),
        };
        if is_new {
            let from_m = self.blade_m.unwrap_or(blade_m);
            let way_m = from_m[0].distance(blade_m[0]).max(from_m[1].distance(blade_m[1]));
            let edge_m = self.stroke.as_ref().map_or_else(|| mean_edge_m(body, positions_m), |s| s.edge_m);
            let n_parts = parts_of_way(way_m, edge_m);
            self.motion = Some(Motion { from_m, to_m: blade_m, n_parts, n_done: 0 });
        }
        loop {
            if let Some(edits) = self.work(body, positions_m) {
                return Ok(Some(edits));
            }
            if !self.look(body.topology(), positions_m) {
                return Ok(None);
            }
        }
    }

    /// The next edits that end the stroke where the blade was last, as for [`ScalpelCut::advance`]; afterwards the
    /// scalpel touches nothing.
    ///
    /// # Errors
    /// As [`ScalpelCut::advance`].
    pub fn finish(
        &mut self,
        body: &EditableMesh,
        positions_m: &[DVec3],
    ) -> Result<Option<Vec<MeshEdit>>, ScalpelRefusal> {
        self.check(body, positions_m)?;
        self.motion = None;
        if self.blade_m.take().is_some() {
            self.events.push_back(Event::End);
        }
        let edits = self.work(body, positions_m);
        if edits.is_none() {
            self.last_entry = None;
        }
        Ok(edits)
    }

    fn check(&mut self, body: &EditableMesh, positions_m: &[DVec3]) -> Result<(), ScalpelRefusal> {
        let n_nodes = body.topology().n_nodes();
        if positions_m.len() != n_nodes {
            return Err(ScalpelRefusal::BadPositions { found: positions_m.len(), n_nodes });
        }
        if self.n_nodes_expected.take().is_some_and(|expected| expected != n_nodes) {
            *self = Self { params: self.params, report: std::mem::take(&mut self.report), ..Self::default() };
            return Err(ScalpelRefusal::EditRefused);
        }
        Ok(())
    }

    /// Works through what the blade met until there is something to edit.
    fn work(&mut self, body: &EditableMesh, positions_m: &[DVec3]) -> Option<Vec<MeshEdit>> {
        loop {
            if let Some(stroke) = &mut self.stroke {
                if let Some(edits) = stroke.work(body, positions_m, &self.params, &mut self.report) {
                    self.n_nodes_expected = Some(body.topology().n_nodes() + stroke.n_copies_wanted());
                    return Some(edits);
                }
                if stroke.is_over() {
                    self.over_at_m = Some(positions_m[stroke.last().index()]);
                    self.stroke = None;
                }
            }
            match self.events.pop_front()? {
                Event::Start { at, triangle } => {
                    self.report.n_strokes += 1;
                    self.stroke = Some(Stroke::start(body, positions_m, at, triangle, &self.params));
                }
                Event::Point { at, triangle } => match &mut self.stroke {
                    Some(stroke) => stroke.follow(body, positions_m, at, &self.params),
                    // The blade went through what it cut and is in the body still, or again.
                    None => self.start_again(body, positions_m, at, triangle),
                },
                Event::End => {
                    if let Some(stroke) = &mut self.stroke {
                        stroke.end(positions_m);
                    }
                }
            }
        }
    }

    /// Looks at the next part of the motion and notes what the blade met; false when there is none.
    fn look(&mut self, topology: &Topology, positions_m: &[DVec3]) -> bool {
        let Some(motion) = &mut self.motion else { return false };
        let before_m = motion.at(motion.n_done);
        motion.n_done += 1;
        let now_m = motion.at(motion.n_done);
        if motion.n_done == motion.n_parts {
            self.motion = None;
        }
        let is_first = self.blade_m.replace(now_m).is_none();
        let blade_m = [now_m[1], now_m[0]];
        let near = self
            .last_entry
            .and_then(|(triangle, _)| first_crossing_near(topology, positions_m, blade_m, triangle));
        let entry = near.or_else(|| first_crossing(topology, positions_m, blade_m, BRUSH));
        let moved_m = 0.5 * (now_m[0] + now_m[1] - before_m[0] - before_m[1]);
        let point = |at: DVec3| PathPoint {
            point_m: at,
            tip_m: now_m[0],
            blade: (now_m[0] - now_m[1]).normalize_or_zero(),
            moved_m,
            is_on_side: false,
        };
        match (self.last_entry, entry) {
            (None, None) => {}
            (None, Some(entry)) => {
                let side = if is_first { None } else { side(topology, positions_m, before_m, now_m, &entry) };
                self.start(topology, positions_m, point(entry.point_m), entry.triangle, side);
            }
            (Some((_, last_m)), Some(entry)) => {
                let edge_m = triangle_edge_m(topology, positions_m, entry.triangle);
                if near.is_none() && entry.point_m.distance(last_m) > 2.0 * edge_m {
                    self.events.push_back(Event::End);
                    self.start(topology, positions_m, point(entry.point_m), entry.triangle, None);
                } else {
                    let at = point(entry.point_m);
                    self.events.push_back(Event::Point { at, triangle: Some(entry.triangle) });
                }
            }
            (Some((triangle, last_m)), None) => {
                let last = Crossing { triangle, along: 0.0, point_m: last_m };
                // The blade left: what it did is what it would have done backwards.
                if let Some(side) = side(topology, positions_m, now_m, before_m, &last) {
                    self.go_along_side(topology, positions_m, point(last_m), [last_m, side.point_m]);
                }
                self.events.push_back(Event::End);
            }
        }
        self.last_entry = entry.map(|e| (e.triangle, e.point_m));
        true
    }

    /// Begins a stroke in the middle of a motion, well away from where the last one ended.
    fn start_again(
        &mut self,
        body: &EditableMesh,
        positions_m: &[DVec3],
        at: PathPoint,
        triangle: Option<TriangleId>,
    ) {
        let topology = body.topology();
        let Some(triangle) = triangle.filter(|&t| topology.is_live_triangle(t)) else { return };
        let edge_m = triangle_edge_m(topology, positions_m, triangle);
        if self.over_at_m.is_none_or(|over_m| over_m.distance(at.point_m) > edge_m) {
            self.report.n_strokes += 1;
            self.stroke = Some(Stroke::start(body, positions_m, at, triangle, &self.params));
        }
    }

    fn start(
        &mut self,
        topology: &Topology,
        positions_m: &[DVec3],
        at: PathPoint,
        triangle: TriangleId,
        side: Option<Crossing>,
    ) {
        match side {
            Some(side) => {
                let first = PathPoint { point_m: side.point_m, is_on_side: true, ..at };
                self.events.push_back(Event::Start { at: first, triangle: side.triangle });
                self.go_along_side(topology, positions_m, at, [side.point_m, at.point_m]);
                self.events.push_back(Event::Point { at, triangle: Some(triangle) });
            }
            None => self.events.push_back(Event::Start { at, triangle }),
        }
    }

    /// Path points on the side between two places on the blade.
    fn go_along_side(
        &mut self,
        topology: &Topology,
        positions_m: &[DVec3],
        like: PathPoint,
        [from_m, to_m]: [DVec3; 2],
    ) {
        let edge_m = mean_edge_of(topology, positions_m, self.last_entry.map(|(t, _)| t));
        let n = parts_of_way(from_m.distance(to_m), edge_m);
        for k in 1..=n {
            let point_m = from_m.lerp(to_m, k as f64 / n as f64);
            let at = PathPoint { point_m, is_on_side: true, ..like };
            self.events.push_back(Event::Point { at, triangle: None });
        }
    }
}

/// Where on the blade the cut of a side ends, if the blade came in from outside (or left) well below `entry`: where a
/// blade through the whole body comes out again, else where the tip went in.
fn side(
    topology: &Topology,
    positions_m: &[DVec3],
    outside_m: [DVec3; 2],
    inside_m: [DVec3; 2],
    entry: &Crossing,
) -> Option<Crossing> {
    let edge_m = triangle_edge_m(topology, positions_m, entry.triangle);
    let is_well_below = |point_m: DVec3| point_m.distance(entry.point_m) > LEAST_SIDE * edge_m;
    if !is_well_below(inside_m[0]) {
        return None;
    }
    let along_m = (inside_m[0] - entry.point_m).normalize_or_zero();
    let below_m = entry.point_m + 1e-6 * edge_m * along_m;
    // Backwards from the tip, walls of the cut that the blade brushes near the top do not count.
    let leaves = first_crossing(topology, positions_m, [inside_m[0], below_m], STEEP);
    let met = leaves.or_else(|| first_crossing(topology, positions_m, [outside_m[0], inside_m[0]], STEEP))?;
    is_well_below(met.point_m).then_some(met)
}

/// Into how many parts a way is divided, at least 1; also where a length is no number.
fn parts_of_way(way_m: f64, edge_m: f64) -> usize {
    // Not `clamp`, which leaves what is no number as it is.
    (way_m / (PART_OF_EDGE * edge_m)).ceil().max(1.0).min(MOST_PARTS as f64) as usize
}

/// Mean edge [m] of a surface triangle now.
fn triangle_edge_m(topology: &Topology, positions_m: &[DVec3], triangle: TriangleId) -> f64 {
    let [a, b, c] = topology.triangle_nodes(triangle).map(|n| positions_m[n.index()]);
    (a.distance(b) + b.distance(c) + c.distance(a)) / 3.0
}

/// Mean edge [m] of `triangle`, else of the first triangles of the surface.
fn mean_edge_of(topology: &Topology, positions_m: &[DVec3], triangle: Option<TriangleId>) -> f64 {
    /// Enough for a length scale, and no walk over the whole surface.
    const N_LOOKED_AT: usize = 32;
    match triangle {
        Some(triangle) => triangle_edge_m(topology, positions_m, triangle),
        None => {
            let (sum_m, n) = topology
                .surface_triangles()
                .take(N_LOOKED_AT)
                .fold((0.0, 0), |(sum_m, n), t| (sum_m + triangle_edge_m(topology, positions_m, t), n + 1));
            if n == 0 { 1.0 } else { sum_m / f64::from(n) }
        }
    }
}

fn mean_edge_m(body: &EditableMesh, positions_m: &[DVec3]) -> f64 {
    mean_edge_of(body.topology(), positions_m, None)
}
