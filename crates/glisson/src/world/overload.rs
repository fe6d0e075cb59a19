//! What one tool does to tissue that stands no more: the work of its parts against the fracture energy.

use super::parts::ToolPart;
use crate::math::DVec3;
use crate::tool::fracture::{Breakthrough, CrackFront, FractureEnergy};

/// Place of the jaws in the list of what loads tissue, after the parts.
pub(super) const OF_JAWS: usize = ToolPart::ALL.len();

/// A contact under so many times the force at which a crack runs gives way at once, whatever the work: a choice. A
/// tip that comes at 1 m/s on a millimetre's mesh stays below it.
const GREATEST_OVERLOAD: f64 = 4.0;

/// What one tool does to tissue that stands no more.
#[derive(Clone, Debug)]
pub(super) struct Overload {
    pub(super) work: [Breakthrough; OF_JAWS + 1],
    /// Which broke through in the last step.
    pub(super) breaks: [bool; OF_JAWS + 1],
    /// Share of its strength that the tissue at the tip, or between closed jaws, has left: heat takes the rest.
    pub(super) strength_left: f64,
    /// Whether the edge has broken in and cuts freely.
    pub(super) edge_is_in: bool,
    /// From where it broke in: to outside of the tissue, and to where it is when the tissue that it pressed in has sprung
    /// back over it [m].
    pub(super) entry_m: Option<[DVec3; 2]>,
    /// Energy of the cracks that the edge opened and the hand has not paid for yet [J].
    pub(super) owed_j: f64,
}

impl Default for Overload {
    fn default() -> Self {
        Self {
            work: [Breakthrough::default(); OF_JAWS + 1],
            breaks: [false; OF_JAWS + 1],
            strength_left: 1.0,
            edge_is_in: false,
            entry_m: None,
            owed_j: 0.0,
        }
    }
}

/// What one part, or the jaws, did in a step.
pub(super) struct Load {
    pub(super) force_on_tool_n: DVec3,
    /// How far it moved [m].
    pub(super) motion_m: DVec3,
    pub(super) front: CrackFront,
}

impl Overload {
    /// Everything that its next steps depend on, as far as it is not as in the beginning.
    pub(super) fn numbers(&self) -> impl Iterator<Item = f64> + '_ {
        let work = self.work.iter().map(Breakthrough::available_j);
        let edge = [f64::from(u8::from(self.edge_is_in)), self.owed_j];
        let entry = self.entry_m.into_iter().flatten().flat_map(|v| v.to_array());
        let heat = [1.0 - self.strength_left];
        work.chain(edge)
            .chain(entry)
            .chain(heat)
            .enumerate()
            .filter(|(_, x)| *x != 0.0)
            .flat_map(|(i, x)| [i as f64, x])
    }

    /// After a step in which `place` (a part, or the jaws after all parts) loaded the tissue; `None`: it did not.
    pub(super) fn push(&mut self, place: usize, energy: FractureEnergy, load: Option<&Load>) {
        let Some(load) = load else {
            (self.work[place], self.breaks[place]) = (Breakthrough::default(), false);
            return;
        };
        let is_heated = place != ToolPart::Shaft.index();
        let energy = if is_heated { energy.weakened(self.strength_left) } else { energy };
        let force_n = load.force_on_tool_n;
        let much_n = GREATEST_OVERLOAD * energy.cutting_force_n(load.front.length_m);
        let gives_way = self.work[place].push(energy, load.front, force_n, load.motion_m);
        self.breaks[place] |= gives_way || force_n.length() > much_n;
    }

    /// A stroke of the edge is over, or none is asked for.
    pub(super) fn end_stroke(&mut self) {
        (self.edge_is_in, self.entry_m, self.owed_j) = (false, None, 0.0);
    }

    /// Force on a tool whose edge moved by `motion_m` in a step, beside `others_n` [N]: it holds the edge back so that the hand's work
    /// pays for the cracks, the most of what is owed over a way of `over_m`. Cuts come in jumps, the force does not. A hand that gives
    /// way at `most_n` pays the rest later.
    pub(super) fn pay_for_cuts_n(
        &mut self,
        motion_m: DVec3,
        over_m: f64,
        (others_n, most_n): (DVec3, f64),
    ) -> DVec3 {
        let way_m = motion_m.length();
        if !self.edge_is_in || way_m == 0.0 {
            return DVec3::ZERO;
        }
        let back = -motion_m / way_m;
        let paid_j = self.owed_j * (way_m / over_m).min(1.0);
        let paid_j = paid_j.min(left_along_n(others_n, back, most_n) * way_m);
        self.owed_j -= paid_j;
        back * (paid_j / way_m)
    }
}

/// What a force along a unit vector may add to another until both make `most_n` [N]; none where that is more already.
fn left_along_n(other_n: DVec3, along: DVec3, most_n: f64) -> f64 {
    let (aside, behind) = (other_n.reject_from_normalized(along), other_n.dot(along));
    let whole_n2 = most_n * most_n - aside.length_squared();
    if whole_n2.is_nan() || whole_n2 <= 0.0 { 0.0 } else { (whole_n2.sqrt() - behind).max(0.0) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_hand_pays_for_cuts_what_its_limit_leaves_and_the_rest_later() {
        let mut overload = Overload { edge_is_in: true, owed_j: 1.0, ..Overload::default() };
        let motion_m = DVec3::X * 1e-3;
        let free_n = overload.pay_for_cuts_n(motion_m, 1e-2, (DVec3::ZERO, f64::INFINITY));
        assert!((free_n - DVec3::NEG_X * 100.0).length() < 1e-9 && (overload.owed_j - 0.9).abs() < 1e-12);
        // Others bear it back, aside, or press it on.
        for others_n in [DVec3::NEG_X * 20.0, DVec3::Y * 18.0, DVec3::X * 25.0, DVec3::new(20.0, 20.0, 0.0)] {
            let before_j = overload.owed_j;
            let paid_n = overload.pay_for_cuts_n(motion_m, 1e-2, (others_n, 30.0));
            assert!(((others_n + paid_n).length() - 30.0).abs() < 1e-9, "{others_n}: {paid_n}");
            assert!((before_j - overload.owed_j - paid_n.length() * 1e-3).abs() < 1e-12);
        }
        assert_eq!(overload.pay_for_cuts_n(motion_m, 1e-2, (DVec3::Y * 30.1, 30.0)), DVec3::ZERO);
    }

    #[test]
    fn heat_weakens_tip_and_jaws_and_not_the_shaft() {
        let energy = FractureEnergy { energy_j_per_m2: 100.0 };
        let front = CrackFront::blunt(3e-3);
        // A tenth of the strength is left, and a fifth of the force that cold tissue stands: its work pays for the weak crack.
        let fifth_n = 0.2 * energy.cutting_force_n(front.length_m);
        let load = Load { force_on_tool_n: DVec3::Z * fifth_n, motion_m: DVec3::NEG_Z * 2e-3, front };
        let breaks = |place: usize, strength_left: f64| {
            let mut overload = Overload { strength_left, ..Overload::default() };
            overload.push(place, energy, Some(&load));
            overload.breaks[place]
        };
        for place in 0..=OF_JAWS {
            assert!(!breaks(place, 1.0), "{place}: cold");
            assert_eq!(breaks(place, 0.1), place != ToolPart::Shaft.index(), "{place}: warm");
        }
    }
}
