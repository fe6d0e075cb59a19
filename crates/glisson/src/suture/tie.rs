//! What holds a place of a thread: tissue that it passes through or lies on, and what grips it.
//!
//! The other side gives way as well: under the force F of the thread on it, it goes to
//!
//! P + C (F - f),
//!
//! where f is the force of the step before and P where it would go under that. So the thread's place x is drawn to P by
//! f + C^-1 (x - P). At a wall, the part of that along its normal only pushes, and the part across it is friction, up to Coulomb's limit.

use super::banded::Banded;
use super::rod::RodPlace;
use crate::math::{DMat3, DVec3, outer};

/// How a place is held.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum TieLaw {
    /// In all directions.
    Held,
    /// From one side: it stays outside of a plane.
    Wall {
        /// Outward.
        normal: DVec3,
        /// Greatest force across the normal in this round [N].
        most_friction_n: f64,
    },
}

/// A place of a thread that something holds.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Tie {
    /// Which place.
    pub at: RodPlace,
    /// How.
    pub law: TieLaw,
    /// C^-1 [N/m], the same in all directions.
    pub stiffness_n_per_m: f64,
    /// P [m].
    pub place_m: DVec3,
    /// f: force of the thread on the other side in the last step [N].
    pub force_before_n: DVec3,
}

/// What a tie does where the thread is now.
struct Action {
    /// On the other side [N].
    force_n: DVec3,
    /// How that grows with the way of the thread [N/m].
    tensor: DMat3,
}

impl Tie {
    fn action(&self, positions_m: &[DVec3]) -> Action {
        let k = self.stiffness_n_per_m;
        let trial_n = self.force_before_n + (self.at.point_m(positions_m) - self.place_m) * k;
        match self.law {
            TieLaw::Held => Action { force_n: trial_n, tensor: DMat3::IDENTITY * k },
            TieLaw::Wall { normal, most_friction_n } => {
                // The thread pushes against the normal.
                let push_n = (-trial_n.dot(normal)).max(0.0);
                if push_n == 0.0 {
                    return Action { force_n: DVec3::ZERO, tensor: DMat3::ZERO };
                }
                let across_n = trial_n - normal * trial_n.dot(normal);
                let pull_n = across_n.length();
                let slides = pull_n > most_friction_n;
                let share = if slides { most_friction_n / pull_n } else { 1.0 };
                let along = outer(normal, normal);
                Action {
                    force_n: across_n * share - normal * push_n,
                    tensor: along * k + (DMat3::IDENTITY - along) * (k * share),
                }
            }
        }
    }

    /// Force on the other side where the thread is now [N].
    pub fn force_n(&self, positions_m: &[DVec3]) -> DVec3 {
        self.action(positions_m).force_n
    }

    pub(super) fn add_to(&self, positions_m: &[DVec3], gradient_n: &mut [DVec3], matrix: &mut Banded) {
        let action = self.action(positions_m);
        for (i, of) in self.at.of_nodes() {
            gradient_n[i] += action.force_n * of;
            for (j, by) in self.at.of_nodes().filter(|(j, _)| *j <= i) {
                matrix.add(i, j, action.tensor * (of * by));
            }
        }
    }
}
