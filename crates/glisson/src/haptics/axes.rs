//! What the tissue does to an instrument about its own axis and at its jaws, beside the force at its tip: the self-rotation
//! and the handle's force of the active trocar (seed `000`, s. 5.3.2), torque and gripper of other devices.
//!
//! Both are the work of the tissue for a motion of the instrument alone: M = sum of f_i . (a x r_i) for a turn about the shaft
//! a of the places r_i that turn with it, and J = sum of f_i . dr_i/du for jaws that open by the share u of their way. Near the
//! published place they fall along straight lines, M - k (turn - turn_0) and J - s (u - u_0).

use super::spread::{MOST_RATE_N_PER_S, SPREAD_S};

/// Moment about the shaft and work on the jaws as functions of turn and opening. Plain data; nothing by default.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct AxesModel {
    /// Moment of the tissue on the instrument about its shaft, whose direction runs from the tip to the hand [N m] ...
    pub twist_n_m: f64,
    /// ... at this turn about it [rad].
    pub roll_rad: f64,
    /// How it falls when the instrument turns on [N m/rad]; not negative.
    pub twist_stiffness_n_m_per_rad: f64,
    /// Work of the tissue on the jaws for their way from closed to wide open [J]: positive where it pushes them open ...
    pub jaw_j: f64,
    /// ... at this opening: 0 closed, 1 wide open.
    pub jaw_opening: f64,
    /// How it falls when they open by their whole way [J]; not negative.
    pub jaw_stiffness_j: f64,
}

impl AxesModel {
    /// Moment about the shaft [N m] at a turn of `roll_rad` [rad]; turns count by their shorter way.
    pub fn twist_at_n_m(&self, roll_rad: f64) -> f64 {
        let turned = roll_rad - self.roll_rad;
        let turned = turned - std::f64::consts::TAU * (turned / std::f64::consts::TAU).round();
        self.twist_n_m - self.twist_stiffness_n_m_per_rad * turned
    }

    /// Work on the jaws for their whole way [J] at an opening; what pushes them one way never pulls them the other.
    pub fn jaw_at_j(&self, opening: f64) -> f64 {
        let linear_j = self.jaw_j - self.jaw_stiffness_j * (opening - self.jaw_opening);
        if self.jaw_j > 0.0 { linear_j.max(0.0) } else { linear_j.min(0.0) }
    }

    /// Whether every number is one.
    pub fn is_finite(&self) -> bool {
        [
            self.twist_n_m,
            self.roll_rad,
            self.twist_stiffness_n_m_per_rad,
            self.jaw_j,
            self.jaw_opening,
            self.jaw_stiffness_j,
        ]
        .iter()
        .all(|x| x.is_finite())
    }

    /// With slopes of at most these [N m/rad, J].
    #[must_use]
    pub fn no_stiffer_than(self, twist_n_m_per_rad: f64, jaw_j: f64) -> Self {
        Self {
            twist_stiffness_n_m_per_rad: self.twist_stiffness_n_m_per_rad.clamp(0.0, twist_n_m_per_rad),
            jaw_stiffness_j: self.jaw_stiffness_j.clamp(0.0, jaw_j),
            ..self
        }
    }
}

/// One of the two, from one published model to the next without a jump, as [`super::Handover`] has it for the force.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct Spread {
    last: f64,
    offset: f64,
    rate: f64,
}

impl Spread {
    /// `now_at` is what the model says at the place of this tick, `was_at` at that of the last one, `most_rate` the fastest
    /// change a second that no motion explains.
    fn step(&mut self, is_new: bool, was_at: f64, now_at: f64, most_rate: f64, ramp_dt_s: f64) -> f64 {
        if is_new {
            self.offset = self.last - was_at;
            self.rate = (self.offset.abs() / SPREAD_S).min(most_rate);
        }
        let less = self.rate * ramp_dt_s;
        self.offset = if self.offset.abs() <= less { 0.0 } else { self.offset - less.copysign(self.offset) };
        self.last = now_at + self.offset;
        self.last
    }
}

/// Where instrument and jaws are at a tick.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct AxesPlace {
    /// Turn about the shaft [rad].
    pub roll_rad: f64,
    /// Opening of the jaws: 0 closed, 1 wide open.
    pub jaw_opening: f64,
}

/// Moment and work that a hand feels, from the models that the simulation publishes.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct AxesHandover {
    latest: AxesModel,
    place: AxesPlace,
    spreads: [Spread; 2],
    has_place: bool,
}

impl AxesHandover {
    /// The device was away: begins at nothing again.
    pub fn restart(&mut self) {
        *self = Self::default();
    }

    /// Moment about the shaft [N m] and work on the jaws for their whole way [J] at `place`. `jaw_travel_m` [m] is the handle's
    /// way, so that its force changes by no more than [`MOST_RATE_N_PER_S`]; `ramp_dt_s` [s] as in
    /// [`super::Handover::force_in`]. A model that is not finite counts as none.
    pub fn efforts(
        &mut self,
        latest: &AxesModel,
        place: AxesPlace,
        jaw_travel_m: f64,
        ramp_dt_s: f64,
    ) -> [f64; 2] {
        let latest = if latest.is_finite() { *latest } else { AxesModel::default() };
        let is_new = latest != self.latest;
        self.latest = latest;
        if !self.has_place {
            (self.place, self.has_place) = (place, true);
        }
        let was = std::mem::replace(&mut self.place, place);
        let [twist, jaw] = &mut self.spreads;
        // A moment changes as a force at the end of an arm of that length would.
        let most = [MOST_RATE_N_PER_S * TWIST_ARM_M, MOST_RATE_N_PER_S * jaw_travel_m];
        let twist_at = [was, place].map(|p| latest.twist_at_n_m(p.roll_rad));
        let jaw_at = [was, place].map(|p| latest.jaw_at_j(p.jaw_opening));
        [
            twist.step(is_new, twist_at[0], twist_at[1], most[0], ramp_dt_s),
            jaw.step(is_new, jaw_at[0], jaw_at[1], most[1], ramp_dt_s),
        ]
    }
}

/// Half the width of a handle that fingers turn [m]: a choice.
const TWIST_ARM_M: f64 = 0.01;

#[cfg(test)]
mod tests {
    use super::*;

    const MODEL: AxesModel = AxesModel {
        twist_n_m: 0.02,
        roll_rad: 3.0,
        twist_stiffness_n_m_per_rad: 0.1,
        jaw_j: 0.05,
        jaw_opening: 0.2,
        jaw_stiffness_j: 0.25,
    };

    #[test]
    fn they_fall_along_straight_lines_and_jaws_are_only_pushed() {
        assert!((MODEL.twist_at_n_m(3.1) - 0.01).abs() < 1e-12);
        // The shorter way round.
        assert!((MODEL.twist_at_n_m(3.1 - std::f64::consts::TAU) - 0.01).abs() < 1e-12);
        assert!((MODEL.jaw_at_j(0.1) - 0.075).abs() < 1e-12);
        assert_eq!(MODEL.jaw_at_j(0.9), 0.0);
        let spread = AxesModel { jaw_j: -0.05, ..MODEL };
        assert!((spread.jaw_at_j(0.3) + 0.075).abs() < 1e-12);
        assert_eq!((spread.jaw_at_j(0.0), AxesModel::default().jaw_at_j(0.0)), (0.0, 0.0));
        let soft = MODEL.no_stiffer_than(0.05, 0.1);
        assert_eq!((soft.twist_stiffness_n_m_per_rad, soft.jaw_stiffness_j), (0.05, 0.1));
        assert!(!AxesModel { jaw_j: f64::NAN, ..MODEL }.is_finite());
    }

    #[test]
    fn a_new_model_is_met_without_a_jump_and_felt_in_the_end() {
        let mut handover = AxesHandover::default();
        let place = AxesPlace { roll_rad: 3.0, jaw_opening: 0.2 };
        let mut last = [0.0; 2];
        for tick in 0..200 {
            let model = if tick < 100 { MODEL } else { AxesModel::default() };
            let now = handover.efforts(&model, place, 0.02, 1e-3);
            assert!((now[0] - last[0]).abs() <= 0.4e-3 + 1e-12 && (now[1] - last[1]).abs() <= 0.8e-3 + 1e-12);
            last = now;
            if tick == 99 {
                assert_eq!(now, [0.02, 0.05]);
            }
        }
        assert_eq!(last, [0.0, 0.0]);
        let broken = AxesModel { twist_n_m: f64::NAN, ..MODEL };
        assert_eq!(handover.efforts(&broken, place, 0.02, 1e-3), [0.0, 0.0]);
    }
}
