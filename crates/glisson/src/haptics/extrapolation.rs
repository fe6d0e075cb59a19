//! The force between two steps of a slower simulation: held, extrapolated from the last two, or from the patch's compliance.
//!
//! Seed `002` (s. 5) leaves the force loop to an extrapolation (its reference 17: G. Picinbono, J.-C. Lombardo,
//! H. Delingette and N. Ayache, Anisotropic elasticity and force extrapolation to improve realism of surgery simulation, ICRA
//! 2000). From (t, P, F) of the last two steps n - 1 and n it takes
//! - F_n (constant),
//! - F_n + (t - t_n)/(t_n - t_(n-1)) (F_n - F_(n-1)) (linear over time), or
//! - F_n + s (F_n - F_(n-1)) with s = (P - P_n).(P_n - P_(n-1))/|P_n - P_(n-1)|^2 (linear over position: how far the tool
//!   came along its last way).

use super::tissue::HapticModel;
use crate::math::DVec3;

/// A shorter way between two steps [m] has no direction: a choice, a tenth of what devices resolve at least.
const LEAST_WAY_M: f64 = 1e-6;

/// Forces are extrapolated over positions by no more than so many of the last way: a choice. A tool that hardly moved between
/// two steps and then moves on would run to any force.
const MOST_WAYS: f64 = 2.0;

/// How the haptic loop gets from published models to the force now.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum ForceEstimate {
    /// The last force.
    Hold,
    /// Along the last two, by time.
    ExtrapolateInTime,
    /// Along the last two, by position.
    ExtrapolateInPosition,
    /// From the last model ([`HapticModel::force_at`]); [`super::Handover`] adds what a slide changes ([`super::slide`]).
    #[default]
    LocalModel,
}

impl ForceEstimate {
    /// All of them.
    pub const ALL: [Self; 4] =
        [Self::Hold, Self::ExtrapolateInTime, Self::ExtrapolateInPosition, Self::LocalModel];

    /// The name in settings and messages.
    pub fn name(self) -> &'static str {
        match self {
            Self::Hold => "hold",
            Self::ExtrapolateInTime => "extrapolate_in_time",
            Self::ExtrapolateInPosition => "extrapolate_in_position",
            Self::LocalModel => "local_model",
        }
    }

    /// The one with this name.
    pub fn by_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|estimate| estimate.name() == name)
    }

    /// Force [N] on the tip at `tip_m` [m], `age_s` [s] after `latest` was made; `before` is the model before it, itself if
    /// there was none.
    pub fn force_at(self, before: &HapticModel, latest: &HapticModel, tip_m: DVec3, age_s: f64) -> DVec3 {
        let share = match self {
            Self::LocalModel => return latest.force_at(tip_m, age_s),
            Self::Hold => 0.0,
            Self::ExtrapolateInTime => {
                let between_s = latest.time_s - before.time_s;
                if between_s > 0.0 { age_s / between_s } else { 0.0 }
            }
            Self::ExtrapolateInPosition => {
                let way_m = latest.tip_m - before.tip_m;
                let way_m2 = way_m.length_squared();
                if way_m2 > LEAST_WAY_M * LEAST_WAY_M {
                    ((tip_m - latest.tip_m).dot(way_m) / way_m2).clamp(-MOST_WAYS, MOST_WAYS)
                } else {
                    0.0
                }
            }
        };
        latest.force_n + (latest.force_n - before.force_n) * share
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn published(time_s: f64, x_m: f64, force_n: f64) -> HapticModel {
        HapticModel { time_s, tip_m: DVec3::X * x_m, force_n: DVec3::Z * force_n, ..HapticModel::default() }
    }

    #[test]
    fn forces_go_on_in_line() {
        let (before, latest) = (published(1.0, 0.01, 0.5), published(1.05, 0.012, 0.7));
        let at = |estimate: ForceEstimate, tip_m: DVec3, age_s: f64| {
            estimate.force_at(&before, &latest, tip_m, age_s).z
        };
        let tip_m = DVec3::new(0.013, 0.5, 0.0);
        assert!((at(ForceEstimate::Hold, tip_m, 0.025) - 0.7).abs() < 1e-12);
        assert!((at(ForceEstimate::ExtrapolateInTime, tip_m, 0.025) - 0.8).abs() < 1e-12);
        assert!((at(ForceEstimate::ExtrapolateInPosition, tip_m, 0.025) - 0.8).abs() < 1e-12);
        assert_eq!(at(ForceEstimate::LocalModel, tip_m, 0.025), 0.0, "free and far");
    }

    #[test]
    fn without_a_way_or_a_time_between_the_force_is_held() {
        let latest = published(1.0, 0.01, 0.5);
        for estimate in ForceEstimate::ALL {
            assert_eq!(ForceEstimate::by_name(estimate.name()), Some(estimate));
            let force_n = estimate.force_at(&latest, &latest, DVec3::ONE, 1.0);
            assert_eq!(force_n.z, if estimate == ForceEstimate::LocalModel { 0.0 } else { 0.5 });
        }
    }
}
