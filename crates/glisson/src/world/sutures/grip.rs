//! What instruments do with a thread: jaws hold it, and clip appliers set clips on it.

use crate::math::DVec3;
use crate::suture::Rod;
use crate::tool::pose::ToolFrame;
use crate::tool::{Jaws, Tool};
use crate::world::grasp::{LETS_GO_ABOVE, REACH};
use crate::world::tool_state::ToolState;

/// Half of what a clip takes of a thread: nothing passes it nearer [m]. A choice, for clips of some millimetres.
pub(super) const HALF_CLIP_M: f64 = 1e-3;
/// Clips of a thread at most.
pub(super) const MOST_CLIPS: usize = 8;

/// A clip on a thread: on one strand, where both places are the same, or on two that it holds together.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct ThreadClip {
    pub(super) along_m: [f64; 2],
}

impl ThreadClip {
    pub(super) fn joins(&self) -> bool {
        self.along_m[0] != self.along_m[1]
    }
}

/// Jaws that hold a thread: at one place, or a needle at two.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Grip {
    /// Which places of the thread [m].
    pub(super) along_m: [f64; 2],
    /// Where they are in the tool's frame [m].
    pub(super) in_tool_m: [DVec3; 2],
    pub(super) is_on_needle: bool,
}

impl Grip {
    pub(super) fn n_places(&self) -> usize {
        if self.is_on_needle { 2 } else { 1 }
    }

    pub(super) fn numbers(self) -> impl Iterator<Item = f64> {
        let places = std::iter::once(self.n_places() as f64);
        places.chain(self.along_m).chain(self.in_tool_m.into_iter().flat_map(|p| p.to_array()))
    }

    /// Takes what is between jaws that are open by `opening`: the place of the thread that is nearest to their tip. Of a needle, which
    /// reaches so far along, two places beside it.
    pub(super) fn close(
        rod: &Rod,
        needle_m: Option<f64>,
        (tool, jaws, opening): (&Tool, &Jaws, f64),
        state: &ToolState,
    ) -> Option<Self> {
        let frame = ToolFrame::of(&state.now);
        let between = strands(rod, (tool, jaws, opening), state);
        let along_m = between.min_by(|a, b| a.tip_m.total_cmp(&b.tip_m))?.along_m;
        let is_on_needle = needle_m.is_some_and(|length_m| along_m <= length_m);
        let along_m = match needle_m.filter(|_| is_on_needle) {
            Some(length_m) => {
                let middle_m = along_m.clamp(0.25 * length_m, 0.75 * length_m);
                [middle_m - 0.2 * length_m, middle_m + 0.2 * length_m]
            }
            None => [along_m; 2],
        };
        let in_tool_m = along_m.map(|at_m| frame.to_tool_m(rod.place_at(at_m).point_m(&rod.positions_m)));
        Some(Self { along_m, in_tool_m, is_on_needle })
    }
}

/// Whether jaws let go of what they hold.
pub(super) fn lets_go(state: &ToolState) -> bool {
    state.now.jaw_opening > LETS_GO_ABOVE
}

/// A piece of a thread between jaws.
pub(super) struct Strand {
    /// Its place nearest to the instrument's tip: along the thread, and how far away [m].
    pub(super) along_m: f64,
    tip_m: f64,
}

/// The pieces of a thread between jaws that are open by `opening`, from its first end on.
pub(super) fn strands<'a>(
    rod: &'a Rod,
    (tool, jaws, opening): (&'a Tool, &'a Jaws, f64),
    state: &ToolState,
) -> impl Iterator<Item = Strand> + 'a {
    let (frame, tip_m) = (ToolFrame::of(&state.now), state.now.tip_in_world_m);
    let margin_m = REACH * tool.tip_radius_m + rod.radius_m();
    // Nodes and middles.
    let n_places = 2 * rod.n_nodes() - 1;
    let mut next = 0;
    std::iter::from_fn(move || {
        let mut strand: Option<Strand> = None;
        while next < n_places {
            let along_m = 0.5 * rod.spacing_m() * next as f64;
            next += 1;
            let point_m = rod.place_at(along_m).point_m(&rod.positions_m);
            if jaws.are_around(frame.to_tool_m(point_m), opening, margin_m) {
                let away_m = point_m.distance(tip_m);
                if strand.as_ref().is_none_or(|strand| away_m < strand.tip_m) {
                    strand = Some(Strand { along_m, tip_m: away_m });
                }
            } else if strand.is_some() {
                break;
            }
        }
        strand
    })
}
