//! What the tissue at an instrument does nearby and soon: a plain record that the simulation publishes and the haptic loop
//! evaluates.
//!
//! A touch answers to the tip's motion d by F - S d, with S = -dF/dx the stiffness of the touched patch
//! ([`super::patch`]). Contact only pushes, and along the surface it bears Coulomb's friction: what is more slips until the
//! force is on the cone. Jaws pull up to what
//! they hold. Free tissue is met where its surface is by then, and pushes back along the normal.
//!
//! An instrument that turns about its trocar has a lever: a place r from the tip moves by W d, with the shaft's direction a and
//! the tip's distance L from the trocar W d = (1 - a.r/L) d + a (r.d)/L. A force f there is felt at the tip as W^T f: the same
//! axial force and the same moment about the trocar across the shaft, as the sum of several contacts needs (seed `000`,
//! s. 5.4.4). What f turns the instrument about itself is in [`AxesModel`].

use super::axes::AxesModel;
use crate::math::{DMat3, DVec3};

/// How an instrument and the tissue are together.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Touch {
    /// Apart.
    #[default]
    Free,
    /// They touch and can come apart.
    Contact,
    /// Held: pulls as well as pushes.
    Grasp,
}

/// One of several places where an instrument and the tissue are together.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TouchedPart {
    /// How: never free.
    pub touch: Touch,
    /// Its force on the instrument where they touch [N].
    pub force_n: DVec3,
    /// How that falls when the instrument moves on there [N/m]; symmetric, not negative.
    pub stiffness_n_per_m: DMat3,
    /// Outward unit normal.
    pub normal: DVec3,
    /// Coulomb's coefficient of friction; infinite for what sticks.
    pub friction_coefficient: f64,
    /// W: how that place moves for a motion of the tip.
    pub lever: DMat3,
}

impl Default for TouchedPart {
    fn default() -> Self {
        Self {
            touch: Touch::Free,
            force_n: DVec3::ZERO,
            stiffness_n_per_m: DMat3::ZERO,
            normal: DVec3::ZERO,
            friction_coefficient: f64::INFINITY,
            lever: DMat3::IDENTITY,
        }
    }
}

/// The force of the tissue on an instrument as a function of where its tip is. Plain data, the same size always.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct HapticModel {
    /// Step after which it was made, and that moment [s] in the simulation's time.
    pub step: u64,
    /// [s]
    pub time_s: f64,
    /// Time [s] that it is meant for: at least that between two of them.
    pub period_s: f64,
    /// How they are together.
    pub touch: Touch,
    /// Where the tip's centre was [m].
    pub tip_m: DVec3,
    /// How fast the tip moved [m/s].
    pub tip_velocity_m_per_s: DVec3,
    /// Force of the tissue on the instrument then [N]: of all parts, as it is felt at the tip.
    pub force_n: DVec3,
    /// -dF/dx: how the force falls when the tip moves on [N/m]; symmetric, not negative; of all parts. Of free tissue that
    /// is near: of the place where the tip will touch.
    pub stiffness_n_per_m: DMat3,
    /// The nearest place of the surface [m], where the tip will touch or touches ...
    pub surface_m: DVec3,
    /// ... its outward unit normal, and ...
    pub normal: DVec3,
    /// ... how far the ball at the tip is from it [m]; below zero inside.
    pub gap_m: f64,
    /// How fast the surface moves there [m/s].
    pub surface_velocity_m_per_s: DVec3,
    /// Coulomb's coefficient of friction; infinite for what sticks.
    pub friction_coefficient: f64,
    /// The largest force that jaws hold [N]; infinite without a limit.
    pub hold_n: f64,
    /// When there are several, or one that is not felt where it is, the parts one by one: the first `n_parts` of these. None
    /// when there is just one at the tip.
    pub parts: [TouchedPart; HapticModel::MOST_PARTS],
    /// How many.
    pub n_parts: u32,
    /// What turns the instrument about itself and moves its jaws.
    pub axes: AxesModel,
}

impl Default for HapticModel {
    fn default() -> Self {
        Self {
            step: 0,
            time_s: 0.0,
            period_s: 0.0,
            touch: Touch::Free,
            tip_m: DVec3::ZERO,
            tip_velocity_m_per_s: DVec3::ZERO,
            force_n: DVec3::ZERO,
            stiffness_n_per_m: DMat3::ZERO,
            surface_m: DVec3::ZERO,
            normal: DVec3::ZERO,
            gap_m: 0.0,
            surface_velocity_m_per_s: DVec3::ZERO,
            friction_coefficient: f64::INFINITY,
            hold_n: f64::INFINITY,
            parts: [TouchedPart::default(); Self::MOST_PARTS],
            n_parts: 0,
            axes: AxesModel::default(),
        }
    }
}

/// Periods of the simulation after which the surface of free tissue is taken to stand still: what it did so long ago says
/// nothing.
const MOST_PERIODS: f64 = 3.0;

/// What sticks bears along the surface at least and at most so many times the push: choices. Finite, so that the force fades
/// and does not jump where the push ends.
const LEAST_STICKING: f64 = 5.0;
const MOST_STICKING: f64 = 20.0;

impl HapticModel {
    /// What jaws hold, or tip and second jaw; the shaft; and other instruments.
    pub const MOST_PARTS: usize = 4;

    /// Force [N] of the tissue on the tip at `tip_m` [m], `age_s` [s] after the model was made.
    ///
    /// It follows the tip without jumps: by no more than (2 + friction)^2 times the stiffness times the motion, with 20 for
    /// the friction of what sticks, and the square of the lever's norm.
    pub fn force_at(&self, tip_m: DVec3, age_s: f64) -> DVec3 {
        let moved_m = tip_m - self.tip_m;
        if self.n_parts > 0 {
            let parts = self.parts.iter().take(self.n_parts as usize);
            return parts.map(|part| self.part_at(part, moved_m)).sum();
        }
        match self.touch {
            Touch::Free => {
                let stiffness_n_per_m = self.normal.dot(self.stiffness_n_per_m * self.normal);
                self.normal * (stiffness_n_per_m * self.overlap_m(moved_m, age_s))
            }
            touch => {
                let whole = TouchedPart {
                    touch,
                    force_n: self.force_n,
                    stiffness_n_per_m: self.stiffness_n_per_m,
                    normal: self.normal,
                    friction_coefficient: self.friction_coefficient,
                    lever: DMat3::IDENTITY,
                };
                self.part_at(&whole, moved_m)
            }
        }
    }

    /// How deep the tip is in free tissue [m].
    fn overlap_m(&self, moved_m: DVec3, age_s: f64) -> f64 {
        let age_s = age_s.clamp(0.0, MOST_PERIODS * self.period_s.max(0.0));
        let approach_m = self.normal.dot(moved_m - self.surface_velocity_m_per_s * age_s);
        (-(self.gap_m + approach_m)).max(0.0)
    }

    fn part_at(&self, part: &TouchedPart, moved_m: DVec3) -> DVec3 {
        let linear_n = part.force_n - part.stiffness_n_per_m * (part.lever * moved_m);
        let there_n = match part.touch {
            Touch::Free => DVec3::ZERO,
            Touch::Grasp => shortened(linear_n, self.hold_n),
            Touch::Contact => pushed(part, linear_n),
        };
        part.at_tip_n(there_n)
    }

    /// Whether every number that `force_at` uses is one.
    pub fn is_finite(&self) -> bool {
        let parts = &self.parts[..(self.n_parts as usize).min(Self::MOST_PARTS)];
        let of_parts = parts.iter().all(|p| {
            p.force_n.is_finite()
                && p.stiffness_n_per_m.is_finite()
                && p.normal.is_finite()
                && p.friction_coefficient >= 0.0
                && p.lever.is_finite()
        });
        of_parts
            && self.axes.is_finite()
            && self.tip_m.is_finite()
            && self.force_n.is_finite()
            && self.stiffness_n_per_m.is_finite()
            && self.normal.is_finite()
            && self.gap_m.is_finite()
            && self.surface_velocity_m_per_s.is_finite()
            && self.period_s.is_finite()
            && self.friction_coefficient >= 0.0
            && self.hold_n >= 0.0
    }
}

impl TouchedPart {
    /// A force where they touch [N] as it is felt at the tip [N].
    pub fn at_tip_n(&self, force_n: DVec3) -> DVec3 {
        self.lever.transpose() * force_n
    }

    /// Its stiffness as it is felt at the tip [N/m].
    pub fn stiffness_at_tip_n_per_m(&self) -> DMat3 {
        self.lever.transpose() * self.stiffness_n_per_m * self.lever
    }

    /// Coulomb's coefficient; of what sticks one that bears twice the published force.
    fn friction(&self) -> f64 {
        if self.friction_coefficient.is_finite() {
            return self.friction_coefficient;
        }
        let push_n = self.force_n.dot(self.normal);
        let along_n = (self.force_n - self.normal * push_n).length();
        // Without a push there is no ratio: the largest.
        let ratio = if push_n > 0.0 { 2.0 * along_n / push_n } else { MOST_STICKING };
        ratio.clamp(LEAST_STICKING, MOST_STICKING)
    }
}

/// Contact without pull, under Coulomb's friction. Where the linear force leaves the cone the touched point slips along the
/// surface by s = (|along| - mu push)/k, with k the mean stiffness along it; the push falls by c s, with c the coupling of
/// push and drag, and what is left along the surface is mu times it. c counts as far as the force then follows the tip by no
/// more than [`HapticModel::force_at`] says: up to k/2, and to k/(2 mu).
fn pushed(part: &TouchedPart, linear_n: DVec3) -> DVec3 {
    let normal = part.normal;
    let push_n = linear_n.dot(normal);
    let along_n = linear_n - normal * push_n;
    let (size_n, friction) = (along_n.length(), part.friction());
    if size_n <= friction * push_n {
        return linear_n;
    }
    let direction = along_n.normalize_or_zero();
    let of_push = part.stiffness_n_per_m * normal;
    let (trace, stiffness) = (part.stiffness_n_per_m.diagonal().element_sum(), of_push.dot(normal));
    let of_drag = 0.5 * (trace - stiffness);
    let mut left_n = push_n;
    if of_drag > 0.0 {
        let coupling = shortened(of_push - normal * stiffness, 0.5 * of_drag / friction.max(1.0));
        left_n -= coupling.dot(direction) * (size_n - friction * push_n.max(0.0)) / of_drag;
    }
    if left_n > 0.0 { normal * left_n + direction * (friction * left_n) } else { DVec3::ZERO }
}

/// The vector, or as much of it as `most` allows.
fn shortened(vector: DVec3, most: f64) -> DVec3 {
    let length = vector.length();
    if length > most { vector * (most / length) } else { vector }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn contact(friction_coefficient: f64) -> HapticModel {
        HapticModel {
            touch: Touch::Contact,
            force_n: DVec3::Z,
            stiffness_n_per_m: DMat3::from_diagonal(DVec3::new(50.0, 50.0, 100.0)),
            normal: DVec3::Z,
            friction_coefficient,
            ..HapticModel::default()
        }
    }

    #[test]
    fn contact_pushes_and_never_pulls() {
        let model = contact(f64::INFINITY);
        assert_eq!(model.force_at(DVec3::ZERO, 0.0), DVec3::Z);
        assert!((model.force_at(DVec3::Z * -5e-3, 0.02) - DVec3::Z * 1.5).length() < 1e-12);
        assert_eq!(model.force_at(DVec3::Z * 0.011, 0.02), DVec3::ZERO);
        assert!((model.force_at(DVec3::X * 2e-3, 0.0) - DVec3::new(-0.1, 0.0, 1.0)).length() < 1e-12);
    }

    #[test]
    fn friction_bears_its_share_of_the_push() {
        let model = contact(0.2);
        let found_n = model.force_at(DVec3::new(0.03, 0.0, -1e-2), 0.0);
        assert!((found_n - DVec3::new(-0.4, 0.0, 2.0)).length() < 1e-12, "{found_n}");
        assert_eq!(contact(0.0).force_at(DVec3::X, 0.0), DVec3::Z);
    }

    #[test]
    fn what_slips_slips_until_the_force_is_on_the_cone() {
        let mut model = contact(0.3);
        model.stiffness_n_per_m.x_axis.z = 15.0;
        model.stiffness_n_per_m.z_axis.x = 15.0;
        let tip_m = DVec3::new(0.02, 0.0, -5e-3);
        let found_n = model.force_at(tip_m, 0.0);
        let push_n = found_n.z;
        assert!((found_n.x + 0.3 * push_n).abs() < 1e-12, "{found_n}");
        let linear_n = model.force_n - model.stiffness_n_per_m * tip_m;
        let slip_m = (-linear_n.x - 0.3 * linear_n.z) / 50.0;
        assert!((push_n - (linear_n.z + 15.0 * slip_m)).abs() < 1e-12, "{push_n} {slip_m}");
        // From the edge of the cone on without a jump.
        let near = |x_m: f64| model.force_at(DVec3::new(x_m, 0.0, 0.0), 0.0);
        let mut last_n = near(0.0);
        for i in 1..=4000 {
            let next_n = near(f64::from(i) * 1e-5);
            assert!(next_n.distance(last_n) < 2.3 * 2.3 * 110.0 * 1e-5, "{i}");
            last_n = next_n;
        }
    }

    #[test]
    fn jaws_pull_up_to_what_they_hold() {
        let model = HapticModel { touch: Touch::Grasp, hold_n: 3.0, ..contact(0.5) };
        let found_n = model.force_at(DVec3::Z * 0.02, 0.0);
        assert!((found_n + DVec3::Z).length() < 1e-12, "{found_n}");
        assert!((model.force_at(DVec3::Z, 0.0) + DVec3::Z * 3.0).length() < 1e-12);
    }

    #[test]
    fn free_tissue_is_met_where_its_surface_is_by_then() {
        let model = HapticModel {
            period_s: 0.03,
            stiffness_n_per_m: DMat3::IDENTITY * 200.0,
            normal: DVec3::Z,
            gap_m: 2e-3,
            surface_velocity_m_per_s: DVec3::new(1.0, 0.0, 0.05),
            ..HapticModel::default()
        };
        assert_eq!(model.force_at(DVec3::Z * -1.9e-3, 0.0), DVec3::ZERO);
        let found_n = model.force_at(DVec3::Z * -3e-3, 0.0);
        assert!((found_n - DVec3::Z * 0.2).length() < 1e-12, "{found_n}");
        let found_n = model.force_at(DVec3::Z * -3e-3, 0.02);
        assert!((found_n - DVec3::Z * 0.4).length() < 1e-12, "{found_n}");
        assert_eq!(model.force_at(DVec3::Z * -3e-3, 9.0), model.force_at(DVec3::Z * -3e-3, 0.09));
    }

    #[test]
    fn parts_let_go_one_by_one() {
        let part = |normal: DVec3| TouchedPart {
            touch: Touch::Contact,
            force_n: normal,
            stiffness_n_per_m: DMat3::IDENTITY * 100.0,
            normal,
            friction_coefficient: f64::INFINITY,
            lever: DMat3::IDENTITY,
        };
        let mut model = contact(f64::INFINITY);
        (model.parts[0], model.parts[1], model.n_parts) = (part(DVec3::X), part(DVec3::Z), 2);
        assert_eq!(model.force_at(DVec3::ZERO, 0.0), DVec3::X + DVec3::Z);
        let found_n = model.force_at(DVec3::X * 0.02, 0.0);
        assert!((found_n - DVec3::new(-2.0, 0.0, 1.0)).length() < 1e-12, "the first lets go: {found_n}");
    }

    /// Half-way to the trocar a contact counts half across the shaft and all along it; so does its stiffness, once more.
    #[test]
    fn a_part_with_a_lever_is_felt_at_the_tip_by_its_work() {
        let part = TouchedPart {
            touch: Touch::Contact,
            force_n: DVec3::new(2.0, 0.0, 0.3),
            stiffness_n_per_m: DMat3::from_diagonal(DVec3::new(100.0, 60.0, 40.0)),
            normal: DVec3::X,
            friction_coefficient: 0.5,
            lever: DMat3::from_diagonal(DVec3::new(0.5, 0.5, 1.0)),
        };
        let mut model = contact(f64::INFINITY);
        (model.parts[0], model.n_parts) = (part, 1);
        assert_eq!(model.force_at(DVec3::ZERO, 0.0), DVec3::new(1.0, 0.0, 0.3));
        let found_n = model.force_at(DVec3::new(4e-3, 0.0, 5e-3), 0.0);
        assert!((found_n - DVec3::new(0.5 * 1.8, 0.0, 0.1)).length() < 1e-12, "{found_n}");
        // The cone is that of the contact: 0.5 of the push there, not of what is felt of it.
        let found_n = model.force_at(DVec3::Z * -1.0, 0.0);
        assert!((found_n - DVec3::new(1.0, 0.0, 1.0)).length() < 1e-12, "{found_n}");
        assert_eq!(part.stiffness_at_tip_n_per_m(), DMat3::from_diagonal(DVec3::new(25.0, 15.0, 40.0)));
    }
}
