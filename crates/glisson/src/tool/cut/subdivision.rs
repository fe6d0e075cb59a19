//! Cutting by subdivision along the swept blade.
//!
//! A blade is a segment from its tip to its heel. From one place to the next it sweeps a quadrilateral, which
//! is cut as one flat polygon or as two triangles, in the deformed shape: the present positions decide what
//! is cut, and what is new has the same place within its tetrahedron in both shapes. In each step
//!
//! 1. every edge through the swept plane is divided where it crosses, in the tetrahedra that the polygon
//!    meets; a crossing near an end of its edge snaps to that end, which moves into the plane if it can;
//! 2. within the plane the same happens at the lines that bound the polygon, so that the polygon is a union
//!    of faces, and the area that opens is the area swept. Where the stroke turns, this plane may leave a gap to
//!    the faces of the last step; of embedded cuts the smallest faces that close it are cut, too (`closing`);
//! 3. the faces open: each of their nodes gets as many copies as its tetrahedra form groups around it. At the
//!    rim of the cut they form one, and the node stays one; the next step goes on from there.
//!
//! Sides of the plane come from exact predicates (Shewchuk 1997, doi 10.1007/PL00009321) and belong to nodes:
//! whatever the blade does, neighbours agree, and earlier cuts are nothing but surface. If the shapes come out
//! too bad, the step is tried again with more snapping; at the end every crossing snaps, and the cut runs
//! along faces that are there.
//!
//! Beyond the seeds, which remove tetrahedra or move nodes (seed `000` s. 4.4.2). Related: Bielser, Maiwald and
//! Gross 1999 (doi 10.1111/1467-8659.00325) divide by templates; Steinemann et al. 2006
//! ("Hybrid cutting of deformable solids", IEEE VR) snap nodes and divide edges.

mod blend;
pub mod carving;
mod closing;
mod opening;
mod patch;
mod relaxing;
mod section;
mod swapping;
mod sweep;
#[cfg(test)]
mod tests;

use self::closing::keep_crumbs;
use self::patch::{Body, Patch};
use self::relaxing::relax;
use self::section::{Snapping, conform};
use self::swapping::swap;
use self::sweep::Sweep;
use crate::math::DVec3;
use crate::mesh::NodeId;
use crate::mesh::edit::{EditableMesh, Replacement, TopologyChange};
use crate::mesh::quality::dihedral_cosine_range;

/// How a stroke cuts.
#[derive(Clone, Debug, PartialEq)]
pub struct SubdivisionParams {
    /// The blade's ends move at least this far [m] before the next piece is cut.
    pub min_advance_m: f64,
    /// A crossing nearer than this share of its edge to an end snaps to the end [1]. A choice: an edge is
    /// never divided more unevenly than 1 to 4.
    pub snap_share: f64,
    /// A crossing nearer than this [m] to an end snaps to it.
    pub snap_length_m: f64,
    /// The cut goes on from its front if the front is this near [m] to the blade's former place.
    pub front_reach_m: f64,
    /// Smallest dihedral angle [degrees] of a new or reshaped tetrahedron, unless one in its place had a smaller one.
    pub min_dihedral_deg: f64,
    /// Share of that angle which is enough for a stroke that has not turned.
    pub straight_share: f64,
    /// Whether no node moves and no faces are swapped: every new tetrahedron lies in one from before.
    pub is_nested: bool,
}

impl SubdivisionParams {
    /// What suits a mesh with this mean edge [m].
    pub fn for_mean_edge(mean_edge_m: f64) -> Self {
        Self {
            min_advance_m: 0.75 * mean_edge_m,
            snap_share: 0.2,
            snap_length_m: 0.05 * mean_edge_m,
            front_reach_m: 0.3 * mean_edge_m,
            min_dihedral_deg: 3.0,
            straight_share: 1.0,
            is_nested: false,
        }
    }

    /// For a mesh that copies of its tetrahedra carry ([`crate::model::embedded`]), with this mean edge [m]: slivers do no harm, so
    /// little snaps. Those that snap to avoid slivers leave the two sides hanging together: straight strokes 15 of 60 pyramids with a
    /// smallest angle of 0.05 degrees, 4 with 0.01 and none with 0.002, with which a linear hybrid that is cut twice at one place shook.
    /// Of strokes that turn, the smallest angle makes no difference to that (8 and 9 of 180).
    pub fn embedded(mean_edge_m: f64) -> Self {
        Self {
            snap_share: 0.04,
            snap_length_m: 0.01 * mean_edge_m,
            min_dihedral_deg: 0.05,
            straight_share: 0.2,
            is_nested: true,
            ..Self::for_mean_edge(mean_edge_m)
        }
    }

    /// Smallest dihedral angle [degrees] that a piece of a stroke may leave.
    fn least_dihedral_deg(&self, has_turned: bool) -> f64 {
        self.min_dihedral_deg * if has_turned { 1.0 } else { self.straight_share }
    }
}

/// What a step of a stroke, or a whole one, did.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CutReport {
    /// Area [m2] that the blade swept inside the body, in the deformed shape.
    pub swept_area_m2: f64,
    /// Area [m2] of the faces that opened, one side, in the deformed shape.
    pub cut_area_m2: f64,
    /// Smallest dihedral angle [degrees] at rest among new and reshaped tetrahedra; 180 without any.
    pub min_dihedral_deg: f64,
    /// Smallest dihedral angle [degrees] at rest among the tetrahedra that were there before; 180 without any.
    pub min_dihedral_before_deg: f64,
    /// Tetrahedra that the blade met.
    pub n_touched: usize,
    /// Crossings that snapped to a node.
    pub n_snapped: usize,
    /// Steps that needed more snapping than wished.
    pub n_coarser: usize,
    /// Strokes whose opened area differs from the swept one by more than two per cent, because faces merged with
    /// others by snapping: cuts that run along the skin or an earlier cut.
    pub n_merged: usize,
    /// Steps that were refused.
    pub n_refused: usize,
    /// Steps that changed the mesh.
    pub n_edits: usize,
}

impl Default for CutReport {
    fn default() -> Self {
        Self {
            swept_area_m2: 0.0,
            cut_area_m2: 0.0,
            min_dihedral_deg: 180.0,
            min_dihedral_before_deg: 180.0,
            n_touched: 0,
            n_snapped: 0,
            n_coarser: 0,
            n_merged: 0,
            n_refused: 0,
            n_edits: 0,
        }
    }
}

impl CutReport {
    /// Adds a further step.
    fn add(&mut self, step: &Self) {
        self.swept_area_m2 += step.swept_area_m2;
        self.cut_area_m2 += step.cut_area_m2;
        self.min_dihedral_deg = self.min_dihedral_deg.min(step.min_dihedral_deg);
        self.min_dihedral_before_deg = self.min_dihedral_before_deg.min(step.min_dihedral_before_deg);
        self.n_touched += step.n_touched;
        self.n_snapped += step.n_snapped;
        self.n_coarser += step.n_coarser;
        self.n_merged += step.n_merged;
        self.n_refused += step.n_refused;
        self.n_edits += step.n_edits;
    }
}

/// Why a step of the blade cut nothing. The stroke goes on from the blade's new place.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum CutRefusal {
    /// A coordinate is not a finite number.
    #[error("the blade cannot go from {from_m} to {to_m} m: coordinates must be finite")]
    NotFinite {
        /// Where its tip was [m].
        from_m: DVec3,
        /// Where its tip should go [m].
        to_m: DVec3,
    },
    /// The positions are those of another mesh.
    #[error("{n_positions} positions were given for {n_nodes} nodes; each node needs one")]
    WrongNumberOfPositions {
        /// How many were given.
        n_positions: usize,
        /// How many nodes there are.
        n_nodes: usize,
    },
    /// However much snaps, a tetrahedron would be worse than allowed.
    #[error(
        "the cut would leave a dihedral angle of {found_deg} degrees; it must stay above {limit_deg} degrees"
    )]
    BadShape {
        /// Smallest dihedral angle that it would leave [degrees].
        found_deg: f64,
        /// Smallest one allowed [degrees].
        limit_deg: f64,
    },
}

/// How much more snaps with every further attempt: shares of an edge for nodes that can move onto the cut, and
/// for those that cannot. With one half everything snaps.
const COARSER: [[f64; 2]; 6] = [[0.2, 0.2], [0.25, 0.15], [0.25, 0.25], [0.3, 0.3], [0.4, 0.4], [0.5, 0.5]];

/// Further attempts where the stroke would be off by more than [`AREA_LIMIT`] otherwise; the third number is a share of
/// [`SubdivisionParams::snap_length_m`]. Nodes on curved skin cannot move, and where they snap, the cut ends beside
/// where the plane meets the skin.
const OTHER: [[f64; 3]; 8] = [
    [0.2, 0.05, 0.4],
    [0.2, 0.02, 0.2],
    [0.1, 0.05, 0.4],
    [0.1, 0.02, 0.2],
    [0.05, 0.0, 0.1],
    [0.15, 0.25, 1.0],
    [0.3, 0.1, 1.0],
    [0.3, 0.2, 1.0],
];

/// Largest difference between what opens and what was swept, as a share of what the stroke swept: the requirement is
/// 0.02.
const AREA_LIMIT: f64 = 0.01;

/// A corner that is closed at the end of the stroke, and more than this share of it, is opened at all costs.
const ALONE: f64 = 0.007;

/// Strokes that differ by more are counted as merged.
const MERGED: f64 = 0.02;

/// Nearer to the plane or a line than this share of [`SubdivisionParams::snap_length_m`] is rounding.
const SAME_PLACE: f64 = 1e-6;

/// What opens may differ from what was swept by this share of the stroke so far, and by this share of the step
/// while the front will still move, before other ways to snap are tried.
const AREA_TOLERANCE: [f64; 2] = [0.004, 0.015];

/// How much of the way is cut at once: less of it where all of it comes out badly, as what follows begins
/// elsewhere then.
const EXTENTS: [f64; 3] = [1.0, 0.7, 0.85];

/// What stays uncut behind the blade until the stroke ends, as a share of
/// [`SubdivisionParams::min_advance_m`]: the last piece should not be a sliver.
const RESERVE_OF_ADVANCE: f64 = 0.5;

/// Angles below this multiple of the smallest allowed one are bettered, for the sake of later strokes.
const RESERVE: f64 = 1.5;

/// Faces of the cut and what was swept may lie beside each other by this share of it before other ways to snap are
/// tried: where too much at one place makes up for too little at another, what follows is off.
const MOST_STRAYED: f64 = 0.06;

/// How much such area counts against an attempt, as a share of it, while the front will still move and at the end.
const WEIGHT_OF_STRAYED: [f64; 2] = [1.0, 0.1];

/// How much the swaps after it may change the area of a cut, as a share of it, when one is judged before them.
const LEEWAY: f64 = 0.01;

/// What a cut parts is left at its neighbour if its volume is less than this share of the third power of
/// [`SubdivisionParams::front_reach_m`]: a fiftieth of a tetrahedron of mean edges.
const CRUMB: f64 = 0.09;

/// What came of one way to cut a step.
#[derive(Clone, Copy, Debug, Default)]
struct Attempt {
    report: CutReport,
    /// Area [m2] of faces that earlier steps left closed for now.
    closed_before_m2: f64,
    /// Area [m2] of faces that stay closed for good.
    closed_m2: f64,
    /// Area [m2] of faces outside what was swept, and of what was swept outside the faces.
    strayed_m2: f64,
    /// Whether the stroke has turned, by now or in this piece.
    has_turned: bool,
}

/// The best attempt so far.
#[derive(Clone, Copy, Debug)]
struct Best {
    badness_m2: f64,
    /// By how much the stroke would be off, as a share of what it swept.
    off_share: f64,
    at: usize,
    extent: f64,
    snap: [f64; 3],
}

/// What the blade sweeps over on the first part of its way.
fn swept(from_m: [DVec3; 2], to_m: [DVec3; 2], extent: f64) -> [Option<Sweep>; 2] {
    Sweep::of_blade(from_m, [0, 1].map(|i| from_m[i].lerp(to_m[i], extent)))
}

fn degrees_of(cosine: f64) -> f64 {
    libm::acos(cosine.clamp(-1.0, 1.0)).to_degrees()
}

/// A stroke of a blade.
#[derive(Clone, Debug)]
pub struct SubdivisionCut {
    params: SubdivisionParams,
    stroke: Stroke,
    /// The stroke before the last edit, should the edit not be carried out.
    before: Stroke,
    patch: Patch,
    /// [`LEEWAY`]; where it is large, every way to cut is worked out to the end.
    leeway: f64,
}

/// What a stroke remembers from step to step.
#[derive(Clone, Debug, Default)]
struct Stroke {
    /// Tip and heel where the last piece ended [m].
    blade_m: Option<[DVec3; 2]>,
    /// The inner end of the cut, along the blade, and whether an end of the blade is there.
    front: Vec<(NodeId, bool)>,
    /// Nodes of the faces at that end, of both sides.
    wake: Vec<NodeId>,
    /// Faces of the cut that are closed for now: all of their nodes are on its rim.
    closed: Vec<[NodeId; 3]>,
    /// Whether a piece lay at an angle to the one before it.
    has_turned: bool,
    /// By how much the faces of the cut, open or closed for now, exceed what was swept [m2].
    off_m2: f64,
    /// First and last of the front along the blade, with where the blade's ends are between and beyond them
    /// (share) and beside them [m].
    anchor: Option<Anchor>,
    report: CutReport,
}

#[derive(Clone, Copy, Debug)]
struct Anchor {
    nodes: [NodeId; 2],
    shares: [f64; 2],
    beside_m: [DVec3; 2],
}

impl SubdivisionCut {
    /// A stroke that has not begun.
    pub fn new(params: SubdivisionParams) -> Self {
        Self {
            params,
            stroke: Stroke::default(),
            before: Stroke::default(),
            patch: Patch::default(),
            leeway: LEEWAY,
        }
    }

    /// How it cuts.
    pub fn params(&self) -> &SubdivisionParams {
        &self.params
    }

    /// Whether each node of the mesh has to stay where it is at rest: those that something holds, loads or pulls. Beyond the
    /// list, and without one, all may move.
    pub fn hold_still(&mut self, is_still: impl Iterator<Item = bool>) {
        self.patch.is_still.clear();
        self.patch.is_still.extend(is_still);
    }

    /// All steps of the stroke together.
    pub fn report(&self) -> &CutReport {
        &self.stroke.report
    }

    /// Takes the blade out: the next place begins a new stroke.
    pub fn lift(&mut self) {
        self.stroke = Stroke::default();
        self.before = Stroke::default();
    }

    /// Brings the blade (tip, heel) to a new place: what has to be done to the mesh, if anything. The first
    /// place of a stroke cuts nothing, nor does one that is nearer than
    /// [`SubdivisionParams::min_advance_m`] to where the last piece ended. `positions_m`: where the nodes are now.
    ///
    /// The edit has to be carried out before the next call, or else [`SubdivisionCut::take_back`] called.
    ///
    /// # Errors
    /// [`CutRefusal`]; the stroke goes on from the new place then.
    pub fn advance(
        &mut self,
        body: &EditableMesh,
        positions_m: &[DVec3],
        blade_m: [DVec3; 2],
    ) -> Result<Option<Replacement>, CutRefusal> {
        let Some(from_m) = self.begin(body, positions_m, blade_m)? else { return Ok(None) };
        let moved_m = from_m[0].distance(blade_m[0]).max(from_m[1].distance(blade_m[1]));
        let kept_m = RESERVE_OF_ADVANCE * self.params.min_advance_m;
        if moved_m < self.params.min_advance_m + kept_m {
            return Ok(None);
        }
        let to_m = [0, 1].map(|i| blade_m[i].lerp(from_m[i], kept_m / moved_m));
        self.cut(Body { mesh: body, present_m: positions_m }, [from_m, to_m], false)
    }

    /// Like [`SubdivisionCut::advance`], however short the way: the end of a stroke.
    ///
    /// # Errors
    /// As for [`SubdivisionCut::advance`].
    pub fn finish(
        &mut self,
        body: &EditableMesh,
        positions_m: &[DVec3],
        blade_m: [DVec3; 2],
    ) -> Result<Option<Replacement>, CutRefusal> {
        let Some(from_m) = self.begin(body, positions_m, blade_m)? else { return Ok(None) };
        self.cut(Body { mesh: body, present_m: positions_m }, [from_m, blade_m], true)
    }

    /// The last edit was not carried out: the stroke goes on as if the blade had not moved.
    pub fn take_back(&mut self) {
        self.stroke = self.before.clone();
    }

    /// Follows an edit that is not its own.
    pub fn topology_changed(&mut self, change: &TopologyChange) {
        let lost = |n: NodeId| {
            change.nodes.removed.binary_search(&n).is_ok() || change.moved_nodes.binary_search(&n).is_ok()
        };
        self.stroke.front.retain(|&(n, _)| !lost(n));
        self.stroke.wake.retain(|&n| !lost(n));
        self.stroke.closed.retain(|face| !face.iter().any(|&n| lost(n)));
        if self.stroke.anchor.is_some_and(|a| a.nodes.into_iter().any(lost)) {
            self.stroke.anchor = None;
        }
        if change.nodes.new_ids.is_empty() {
            return;
        }
        let renumbered = |n: NodeId| change.nodes.new_ids[n.index()];
        let front = std::mem::take(&mut self.stroke.front);
        self.stroke.front =
            front.into_iter().filter_map(|(n, is_end)| Some((renumbered(n)?, is_end))).collect();
        let wake = std::mem::take(&mut self.stroke.wake);
        self.stroke.wake = wake.into_iter().filter_map(renumbered).collect();
        let closed = std::mem::take(&mut self.stroke.closed);
        let of_face = |[a, b, c]: [NodeId; 3]| Some([renumbered(a)?, renumbered(b)?, renumbered(c)?]);
        self.stroke.closed = closed.into_iter().filter_map(of_face).collect();
        self.stroke.anchor = self.stroke.anchor.and_then(|anchor| {
            let [a, b] = anchor.nodes.map(renumbered);
            Some(Anchor { nodes: [a?, b?], ..anchor })
        });
    }

    /// Checks the input; where the blade was, carried along by the tissue.
    fn begin(
        &mut self,
        body: &EditableMesh,
        positions_m: &[DVec3],
        blade_m: [DVec3; 2],
    ) -> Result<Option<[DVec3; 2]>, CutRefusal> {
        let n_nodes = body.topology().n_nodes();
        if positions_m.len() != n_nodes {
            return Err(CutRefusal::WrongNumberOfPositions { n_positions: positions_m.len(), n_nodes });
        }
        if !blade_m.iter().all(|p| p.is_finite()) {
            let from_m = self.stroke.blade_m.map_or(DVec3::ZERO, |b| b[0]);
            return Err(CutRefusal::NotFinite { from_m, to_m: blade_m[0] });
        }
        let Some(mut from_m) = self.stroke.blade_m else {
            self.stroke.blade_m = Some(blade_m);
            return Ok(None);
        };
        if let Some(Anchor { nodes, shares, beside_m }) = self.stroke.anchor {
            let [p, q] = nodes.map(|n| positions_m[n.index()]);
            from_m = [0, 1].map(|i| p.lerp(q, shares[i]) + beside_m[i]);
        }
        Ok(Some(from_m))
    }

    fn cut(
        &mut self,
        body: Body<'_>,
        [from_m, blade_m]: [[DVec3; 2]; 2],
        is_last: bool,
    ) -> Result<Option<Replacement>, CutRefusal> {
        self.before = self.stroke.clone();
        let extents = if is_last { &EXTENTS[..1] } else { &EXTENTS };
        let wished = self.params.snap_share;
        let snaps = std::iter::once([wished, 0.5 * wished])
            .chain(COARSER.into_iter().filter(move |c| c[0] >= wished))
            .map(|[share, share_of_fixed]| [share, share_of_fixed, 1.0]);
        let attempts = extents.iter().flat_map(|&extent| snaps.clone().map(move |snap| (extent, snap)));
        let n_first = attempts.clone().count();
        let attempts = attempts.chain(OTHER.into_iter().map(|snap| (1.0, snap)));
        let mut tried = Attempt::default();
        let mut best: Option<Best> = None;
        let mut last = 0;
        for (at, (extent, snap)) in attempts.enumerate() {
            if at >= n_first && best.is_some_and(|b| b.off_share <= AREA_LIMIT) {
                break;
            }
            last = at;
            let sweeps = swept(from_m, blade_m, extent);
            tried = self.divide(body, &sweeps, snap);
            if best.is_some_and(|b| self.is_beaten(&tried, b.badness_m2, is_last)) {
                continue;
            }
            self.better_shapes(body, &sweeps, is_last, &mut tried);
            let report = &tried.report;
            let least_deg = self.params.least_dihedral_deg(tried.has_turned);
            if report.min_dihedral_deg < least_deg.min(report.min_dihedral_before_deg) {
                continue;
            }
            let off_m2 = self.off_m2(&tried).abs();
            let badness_m2 = off_m2 + WEIGHT_OF_STRAYED[usize::from(is_last)] * tried.strayed_m2;
            if best.is_none_or(|b| badness_m2 < b.badness_m2) {
                let swept_m2 = self.stroke.report.swept_area_m2 + report.swept_area_m2;
                let off_share = if swept_m2 > 0.0 { off_m2 / swept_m2 } else { 0.0 };
                best = Some(Best { badness_m2, off_share, at, extent, snap });
            }
            let (allowed_m2, is_close) = self.allowed(&tried, is_last);
            if off_m2 <= allowed_m2 && is_close {
                break;
            }
        }
        if let Some(Best { at, extent, snap, off_share, .. }) = best {
            if at != last {
                let sweeps = swept(from_m, blade_m, extent);
                tried = self.divide(body, &sweeps, snap);
                self.better_shapes(body, &sweeps, is_last, &mut tried);
            }
            let mut report = tried.report;
            report.n_coarser = usize::from(at > 0);
            report.n_merged = usize::from(is_last && off_share > MERGED);
            self.stroke.has_turned = tried.has_turned;
            let reached_m = [0, 1].map(|i| from_m[i].lerp(blade_m[i], extent));
            return Ok(self.accept(body, reached_m, report));
        }
        Err(self.refuse(blade_m, &tried))
    }

    /// Goes on at `blade_m` as after a new beginning, without the part of the stroke that was tried.
    fn refuse(&mut self, blade_m: [DVec3; 2], tried: &Attempt) -> CutRefusal {
        let report = &tried.report;
        self.stroke.blade_m = Some(blade_m);
        self.stroke.front.clear();
        self.stroke.wake.clear();
        self.stroke.closed.clear();
        self.stroke.anchor = None;
        self.stroke.report.add(&CutReport {
            swept_area_m2: report.swept_area_m2,
            n_refused: 1,
            ..CutReport::default()
        });
        let least_deg = self.params.least_dihedral_deg(tried.has_turned);
        let limit_deg = least_deg.min(report.min_dihedral_before_deg);
        CutRefusal::BadShape { found_deg: report.min_dihedral_deg, limit_deg }
    }

    /// By how much [m2] the faces of the cut would exceed what the stroke swept.
    fn off_m2(&self, tried: &Attempt) -> f64 {
        self.stroke.off_m2 + tried.report.cut_area_m2 - tried.report.swept_area_m2 - tried.closed_m2
    }

    /// What an attempt may be off by [m2] so that no other is tried, and whether its faces are where they should be.
    fn allowed(&self, tried: &Attempt, is_last: bool) -> (f64, bool) {
        let step_m2 = tried.report.swept_area_m2;
        let [of_stroke, of_step] = AREA_TOLERANCE;
        let mut allowed_m2 = of_stroke * (self.stroke.report.swept_area_m2 + step_m2);
        if !is_last {
            allowed_m2 += of_step * step_m2;
        }
        // What earlier steps left over is not made up for by force.
        allowed_m2 = allowed_m2.max(self.stroke.off_m2.abs() + of_stroke * step_m2);
        (allowed_m2, is_last || tried.strayed_m2 <= MOST_STRAYED * step_m2)
    }

    /// Whether an attempt is neither good enough nor better than the best one, whatever becomes of its shapes. Most
    /// attempts in tissue that is cut to pieces are, and bettering shapes is nine tenths of the work.
    fn is_beaten(&self, tried: &Attempt, best_m2: f64, is_last: bool) -> bool {
        let off_m2 = self.off_m2(tried);
        // At the end of the stroke, faces that stay closed may make up for too much area.
        let least_m2 = if is_last && off_m2 > 0.0 { 0.0 } else { off_m2.abs() };
        let least_m2 = least_m2 - self.leeway * tried.report.cut_area_m2.abs();
        let (allowed_m2, is_close) = self.allowed(tried, is_last);
        let is_good_enough = least_m2 <= allowed_m2 && is_close;
        let strayed_m2 = WEIGHT_OF_STRAYED[usize::from(is_last)] * tried.strayed_m2;
        !is_good_enough && least_m2.max(0.0) + strayed_m2 >= best_m2
    }

    /// Works the cut out in the patch, not opened yet and whatever the shapes.
    fn divide(
        &mut self,
        body: Body<'_>,
        sweeps: &[Option<Sweep>; 2],
        [share, share_of_fixed, of_length]: [f64; 3],
    ) -> Attempt {
        let Self { params, stroke, patch, .. } = self;
        patch.start(body.mesh);
        patch.all_stay = params.is_nested;
        let snapping = Snapping {
            share,
            share_of_fixed,
            length_m: of_length * params.snap_length_m,
            same_m: SAME_PLACE * params.snap_length_m,
            front_m: params.front_reach_m,
            max_cosine: libm::cos((2.0 * params.min_dihedral_deg).to_radians()),
        };
        for &(node, is_end) in &stroke.front {
            if body.mesh.topology().is_live_node(node) {
                patch.pull_front(body, node, is_end);
            }
        }
        for &node in stroke.wake.iter().filter(|&&n| body.mesh.topology().is_live_node(n)) {
            patch.pull_wake(body, node);
        }
        for &face in &stroke.closed {
            patch.pull_closed(body, face);
        }
        let closed_before_m2: f64 = patch.cut.iter().map(|&face| patch.face_area_m2(face)).sum();
        let mut report = CutReport::default();
        let (mut strayed_m2, mut has_turned) = (0.0, stroke.has_turned);
        for sweep in sweeps.iter().flatten() {
            let section = conform(patch, body, sweep, snapping);
            report.swept_area_m2 += section.swept_area_m2;
            report.n_touched += section.n_touched;
            report.n_snapped += section.n_snapped;
            strayed_m2 += section.strayed_m2;
            has_turned |= section.turns;
        }
        if params.is_nested {
            let reach_m = params.front_reach_m;
            keep_crumbs(patch, body, CRUMB * reach_m * reach_m * reach_m);
        }
        let area_m2: f64 = patch.cut.iter().map(|&face| patch.face_area_m2(face)).sum();
        report.cut_area_m2 = area_m2 - closed_before_m2;
        Attempt { report, closed_before_m2, closed_m2: 0.0, strayed_m2, has_turned }
    }

    /// Betters the shapes in the patch and opens its corners: the attempt is whole.
    fn better_shapes(
        &mut self,
        body: Body<'_>,
        sweeps: &[Option<Sweep>; 2],
        is_last: bool,
        tried: &mut Attempt,
    ) {
        let Self { params, stroke, patch, .. } = self;
        let report = &mut tried.report;
        let least_deg = params.least_dihedral_deg(tried.has_turned);
        let wished_cosine = libm::cos((RESERVE * least_deg).to_radians());
        let mut max_cosine = patch.max_new_cosine();
        if !params.is_nested
            && max_cosine > wished_cosine
            && let [Some(sweep), None] | [None, Some(sweep)] = sweeps
        {
            swap(patch, body, wished_cosine);
            relax(patch, body, sweep.normal, wished_cosine);
            swap(patch, body, wished_cosine);
            max_cosine = patch.max_new_cosine();
        }
        let area_m2: f64 = patch.cut.iter().map(|&face| patch.face_area_m2(face)).sum();
        report.cut_area_m2 = area_m2 - tried.closed_before_m2;
        let front = std::mem::take(&mut patch.front);
        let is_front = |n: u32| front.binary_search_by_key(&n, |f| f.0).is_ok();
        let stays = |face: [u32; 3]| !is_last && face.into_iter().any(is_front);
        let swept_m2 = stroke.report.swept_area_m2 + report.swept_area_m2;
        let alone_m2 = if is_last { ALONE * swept_m2 } else { f64::INFINITY };
        let allowed_cosine = libm::cos(least_deg.to_radians());
        let closed_m2 = opening::divide_closed(patch, body, alone_m2, stays, [wished_cosine, allowed_cosine]);
        patch.front = front;
        // Until the end of the stroke it may open yet.
        tried.closed_m2 = if is_last { closed_m2 } else { 0.0 };
        if !patch.is_parting_known {
            max_cosine = max_cosine.max(patch.max_new_cosine());
        }
        let before = patch.changed_tets().map(|t| body.mesh.mesh().corners_m(t));
        let cosine_before = before.map(|c| dihedral_cosine_range(c)[1]).fold(-1.0, f64::max);
        // The largest cosine is that of the smallest angle.
        report.min_dihedral_deg = degrees_of(max_cosine);
        report.min_dihedral_before_deg = degrees_of(cosine_before);
    }

    /// Opens the cut that is in the patch, and goes on from there.
    fn accept(&mut self, body: Body<'_>, blade_m: [DVec3; 2], mut report: CutReport) -> Option<Replacement> {
        let Self { stroke, patch, .. } = self;
        let front = patch.front.clone();
        stroke.off_m2 += report.cut_area_m2 - report.swept_area_m2;
        let is_front = |n: u32| front.binary_search_by_key(&n, |f| f.0).is_ok();
        let opened = opening::open(patch, body, is_front);
        report.cut_area_m2 = opened.area_m2;
        let (edit, ids) = opening::replacement(patch, body.mesh.topology().n_nodes());
        stroke.blade_m = Some(blade_m);
        stroke.front = front.iter().filter_map(|&(n, is_end)| Some((ids[n as usize]?, is_end))).collect();
        let of_face = |face: &[u32; 3]| -> Option<[NodeId; 3]> {
            let [a, b, c] = face.map(|n| ids[n as usize]);
            Some([a?, b?, c?])
        };
        stroke.wake = opened.wake.iter().filter_map(|&n| ids[n as usize]).collect();
        stroke.closed = opened.closed.iter().filter_map(of_face).collect();
        stroke.anchor = None;
        let along = blade_m[1] - blade_m[0];
        let place = |n: u32| (patch.nodes[n as usize].present_m - blade_m[0]).dot(along);
        let first = front.iter().map(|f| f.0).min_by(|&a, &b| place(a).total_cmp(&place(b)));
        let last = front.iter().map(|f| f.0).max_by(|&a, &b| place(a).total_cmp(&place(b)));
        if let (Some(first), Some(last)) = (first, last)
            && let (Some(a), Some(b)) = (ids[first as usize], ids[last as usize])
        {
            let [p, q] = [first, last].map(|n| patch.nodes[n as usize].present_m);
            let reach = (q - p).length_squared();
            let shares = blade_m.map(|e| if reach > 0.0 { (e - p).dot(q - p) / reach } else { 0.0 });
            let beside_m = [0, 1].map(|i| blade_m[i] - p.lerp(q, shares[i]));
            stroke.anchor = Some(Anchor { nodes: [a, b], shares, beside_m });
        }
        let is_change = !(edit.tets.is_empty() && edit.moved_nodes.is_empty());
        report.n_edits = usize::from(is_change);
        stroke.report.add(&report);
        is_change.then_some(edit)
    }
}
