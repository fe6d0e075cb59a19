//! What the tissue at an instrument does nearby and soon: a plain record that the simulation publishes and the haptic loop
//! evaluates.

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

/// The force of the tissue on an instrument as a function of where its tip is. Plain data, the same size always.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct HapticModel {
    /// Step after which it was made, and that moment [s] in the simulation's time.
    pub step: u64,
    /// [s]
    pub time_s: f64,
    /// Simulated time [s] between two of them.
    pub period_s: f64,
    /// How they are together.
    pub touch: Touch,
    /// Where the tip's centre was [m].
    pub tip_m: DVec3,
    /// How fast the tip moved [m/s].
    pub tip_velocity_m_per_s: DVec3,
    /// Force of the tissue on the instrument then [N].
    pub force_n: DVec3,
    /// -dF/dx: how the force falls when the tip moves on [N/m]; symmetric, not negative.
    pub stiffness_n_per_m: DMat3,
    /// The nearest place of the surface [m], where the tip will touch or touches ...
    pub surface_m: DVec3,
    /// ... its outward unit normal, and ...
    pub normal: DVec3,
    /// ... how far the ball at the tip is from it [m]; below zero inside.
    pub gap_m: f64,
    /// How fast the surface moves there [m/s].
    pub surface_velocity_m_per_s: DVec3,
    /// Coulomb's coefficient of friction.
    pub friction_coefficient: f64,
}

impl HapticModel {
    /// Force [N] of the tissue on the tip at `tip_m` [m], `age_s` [s] after the model was made.
    pub fn force_at(&self, tip_m: DVec3, _age_s: f64) -> DVec3 {
        let linear_n = self.force_n - self.stiffness_n_per_m * (tip_m - self.tip_m);
        match self.touch {
            Touch::Free => DVec3::ZERO,
            Touch::Grasp => linear_n,
            Touch::Contact if linear_n.dot(self.normal) > 0.0 => linear_n,
            Touch::Contact => DVec3::ZERO,
        }
    }
}
