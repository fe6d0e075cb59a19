//! What an instrument did, one gesture after the other: rested, moved, pushed, grasped, pulled, cut.

use super::motion::REST_M_PER_S;
use super::trace::{ToolTrace, Trace};

/// A gesture that is shorter than this belongs to the one before it [s]: a choice.
const SHORTEST_S: f64 = 0.15;
/// Jaws that hold tissue pull it when the tip is so far from where they closed [m]: a choice.
const PULLED_M: f64 = 5e-3;
/// Jaws that have opened by this share since they took tissue let go; tissue that goes without it has slipped: a choice.
const OPENED: f64 = 0.02;

/// What an instrument does.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum GestureKind {
    /// It rests, and touches nothing.
    Rest,
    /// It moves, and touches nothing.
    Move,
    /// It touches tissue.
    Push,
    /// Its jaws hold tissue.
    Grasp,
    /// They hold it, and have drawn it away.
    Pull,
    /// It divides tissue or takes it out.
    Cut,
}

impl GestureKind {
    /// Its name.
    pub fn name(self) -> &'static str {
        match self {
            Self::Rest => "rest",
            Self::Move => "move",
            Self::Push => "push",
            Self::Grasp => "grasp",
            Self::Pull => "pull",
            Self::Cut => "cut",
        }
    }
}

/// A gesture: from one sample to another.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Gesture {
    /// What.
    pub kind: GestureKind,
    /// First sample.
    pub from: usize,
    /// Behind the last sample.
    pub to: usize,
}

/// The gestures of an instrument, without gaps.
pub fn gestures(trace: &Trace, tool: &ToolTrace) -> Vec<Gesture> {
    let shortest = (SHORTEST_S / trace.period_s).round() as usize;
    let mut found: Vec<Gesture> = Vec::new();
    let mut closed_at = None;
    for at in 0..trace.n_samples() {
        let tip_m = tool.poses[at].tip_in_world_m;
        closed_at = (tool.n_held_nodes[at] > 0).then(|| closed_at.unwrap_or(tip_m));
        let kind = match closed_at {
            Some(closed_m) if tip_m.distance(closed_m) > PULLED_M => GestureKind::Pull,
            Some(_) => GestureKind::Grasp,
            None if cuts(trace, tool, at) => GestureKind::Cut,
            None if tool.touches[at] => GestureKind::Push,
            None if speed_m_per_s(trace, tool, at) >= REST_M_PER_S => GestureKind::Move,
            None => GestureKind::Rest,
        };
        match found.last_mut() {
            Some(last) if last.kind == kind => last.to = at + 1,
            _ => found.push(Gesture { kind, from: at, to: at + 1 }),
        }
    }
    merged(found, shortest)
}

/// Whether tissue was divided since the sample before, and this instrument may have done it: it is switched on, or its jaws part what
/// they close on.
pub(super) fn cuts(trace: &Trace, tool: &ToolTrace, at: usize) -> bool {
    let before = at.saturating_sub(1);
    let grew = |values: &[f64]| values[at] > values[before];
    (grew(&trace.cut_area_m2) || grew(&trace.removed_m3))
        && (tool.poses[at].is_triggered() || tool.poses[at].jaw_opening < tool.poses[before].jaw_opening)
}

fn speed_m_per_s(trace: &Trace, tool: &ToolTrace, at: usize) -> f64 {
    let before = &tool.poses[at.saturating_sub(1)];
    tool.poses[at].tip_in_world_m.distance(before.tip_in_world_m) / trace.period_s
}

/// Short ones joined to the one before, and what is alike then.
fn merged(found: Vec<Gesture>, shortest: usize) -> Vec<Gesture> {
    let mut kept: Vec<Gesture> = Vec::new();
    for gesture in found {
        match kept.last_mut() {
            Some(last) if last.kind == gesture.kind || gesture.to - gesture.from < shortest => {
                last.to = gesture.to;
            }
            _ => kept.push(gesture),
        }
    }
    kept
}

/// Samples at which tissue slipped out of jaws that had not opened since they took it. Tissue that an edit of the mesh took away, or
/// its undoing, has not slipped.
pub fn slips(trace: &Trace, tool: &ToolTrace) -> Vec<usize> {
    let (mut found, mut closed_to) = (Vec::new(), f64::INFINITY);
    for at in 1..tool.n_held_nodes.len() {
        let holds = [at - 1, at].map(|at| tool.n_held_nodes[at] > 0);
        let opening = tool.poses[at].jaw_opening;
        if holds == [true, false] && opening <= closed_to + OPENED && !trace.is_edited[at] {
            found.push(at);
        }
        closed_to = if holds[1] { closed_to.min(opening) } else { f64::INFINITY };
    }
    found
}
