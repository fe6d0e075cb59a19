//! Impulse: contacts exchange momentum at once, from the conservation of momentum and of a share of the energy.
//!
//! The thesis names the principle and prints no formula (seed `000`, s. 4.3.2); the usual one is
//!
//! J = (1 + e) m v,   |J_t| <= mu J,
//!
//! with the speed of approach v, the contact's mass m and the restitution e (Moore and Wilhelms 1988, "Collision detection and
//! response for computer animation", SIGGRAPH). Contacts are taken one after the other, each with the velocities that the
//! ones before have left: none can add energy of motion.

use super::{Answer, Blow, NodeContact};
use crate::math::DVec3;

/// Numbers of the impulse response.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ImpulseParams {
    /// Gap below which an approach is answered [m].
    pub rest_gap_m: f64,
    /// e: 1 is elastic, 0 stops the approach.
    pub restitution: f64,
    /// Coulomb's coefficient.
    pub friction: f64,
    /// Rounds over all contacts.
    pub n_sweeps: u32,
}

impl ImpulseParams {
    /// Elastic, without friction, one round: what conserves energy.
    pub const ELASTIC: Self = Self { rest_gap_m: 0.0, restitution: 1.0, friction: 0.0, n_sweeps: 1 };
}

/// Changes the velocities [m/s] and adds the impulses to `answer`. Never fails, never allocates.
pub fn respond(
    params: &ImpulseParams,
    contacts: &[NodeContact],
    inverse_mass_per_kg: &[DVec3],
    velocities_m_per_s: &mut [DVec3],
    answer: &mut Answer,
) {
    let blow = Blow { restitution: params.restitution, friction: params.friction };
    for _ in 0..params.n_sweeps {
        for contact in contacts {
            if contact.gap_m <= params.rest_gap_m {
                blow.strike(contact, inverse_mass_per_kg, velocities_m_per_s, &mut answer.impulses_n_s);
            }
        }
    }
}
