//! Penalty: springs and dampers between what comes closer than a rest gap.
//!
//! With the gap g, the rest gap d0 and the speed of approach v the force on the vertex along the normal is
//!
//! linear f = k (d0 - g),   inverse f = k1 / g,   both + k2 v, never below zero
//!
//! (seed `000`, s. 4.3.1; the damper after Thalmann, a share of the spring while receding after Moore and Wilhelms 1988,
//! "Collision detection and response for computer animation", SIGGRAPH). Friction is Coulomb's, smoothed below a speed.
//! The rest gap lets the force begin before the surfaces meet. Where the surfaces have met the inverse law goes on
//! at its value at the least gap. A spring k on a vertex of mass m is stable for steps below 2 sqrt(m/k).

use super::NodeContact;
use crate::math::DVec3;

/// The spring.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum PenaltyLaw {
    /// k [N/m].
    Linear {
        /// Stiffness of a vertex's contact [N/m].
        stiffness_n_per_m: f64,
    },
    /// k1 [N m].
    Inverse {
        /// Force times distance [N m].
        strength_n_m: f64,
        /// Below this gap the force grows no more [m].
        least_gap_m: f64,
    },
}

/// Numbers of the penalty response.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PenaltyParams {
    /// The spring.
    pub law: PenaltyLaw,
    /// d0 [m].
    pub rest_gap_m: f64,
    /// k2 [N s/m].
    pub damping_n_s_per_m: f64,
    /// Share of the spring's force while the surfaces recede: 1 is elastic, e^2 gives a restitution of e.
    pub receding_share: f64,
    /// Coulomb's coefficient.
    pub friction: f64,
    /// Speed of sliding at which friction is full [m/s].
    pub sliding_speed_m_per_s: f64,
}

impl PenaltyParams {
    /// An elastic linear spring without friction.
    pub const fn linear(stiffness_n_per_m: f64, rest_gap_m: f64) -> Self {
        Self {
            law: PenaltyLaw::Linear { stiffness_n_per_m },
            rest_gap_m,
            damping_n_s_per_m: 0.0,
            receding_share: 1.0,
            friction: 0.0,
            sliding_speed_m_per_s: 1e-3,
        }
    }

    /// Force [N] on the vertex of a contact, along its normal and across.
    pub fn force_n(&self, contact: &NodeContact, velocities_m_per_s: &[DVec3]) -> DVec3 {
        if contact.gap_m.is_nan() || contact.gap_m >= self.rest_gap_m {
            return DVec3::ZERO;
        }
        let n = contact.normal;
        let relative_m_per_s = contact.relative_m_per_s(velocities_m_per_s);
        let approach_m_per_s = -relative_m_per_s.dot(n);
        let spring_n = match self.law {
            PenaltyLaw::Linear { stiffness_n_per_m } => stiffness_n_per_m * (self.rest_gap_m - contact.gap_m),
            PenaltyLaw::Inverse { strength_n_m, least_gap_m } => {
                strength_n_m / contact.gap_m.max(least_gap_m)
            }
        };
        let share = if approach_m_per_s < 0.0 { self.receding_share } else { 1.0 };
        let normal_n = (share * spring_n + self.damping_n_s_per_m * approach_m_per_s).max(0.0);
        let across_m_per_s = relative_m_per_s + n * approach_m_per_s;
        let full_m_per_s = across_m_per_s.length().max(self.sliding_speed_m_per_s);
        n * normal_n - across_m_per_s * (self.friction * normal_n / full_m_per_s)
    }
}

/// Adds the forces [N] of all contacts to those of the vertices.
pub fn add_forces(
    params: &PenaltyParams,
    contacts: &[NodeContact],
    velocities_m_per_s: &[DVec3],
    forces_n: &mut [DVec3],
) {
    for contact in contacts {
        let force_n = params.force_n(contact, velocities_m_per_s);
        for (v, w) in contact.sides() {
            forces_n[v] += force_n * w;
        }
    }
}
