//! Geometric alteration: vertices that are behind a surface are put back along its normal, and lose the velocity that
//! brought them there (seed `000`, s. 4.3.3, the response that the thesis prefers).
//!
//! In each step a vertex is moved by the share alpha of its depth, the triangle in the opposite direction, each by its
//! share of the mass; the model then finds the balance of forces. The approach is stopped, and sliding as far as
//! friction reaches: the thesis finds that the method suits contacts with much friction only, and small steps.
//! The shares of the masses are ours: momentum is conserved by it. Energy of motion can only fall; moved
//! vertices strain the tissue, so that the sum with the elastic energy can rise by the work of the shift.

use super::{Answer, Blow, NodeContact};
use crate::math::DVec3;

/// Numbers of the geometric response.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GeometricParams {
    /// Gap that is kept [m].
    pub rest_gap_m: f64,
    /// alpha, the share of the depth that is undone in a step: above 0, at most 1.
    pub share: f64,
    /// Coulomb's coefficient; the thesis wants it high.
    pub friction: f64,
    /// Rounds over all contacts.
    pub n_sweeps: u32,
}

impl GeometricParams {
    /// Half of the depth in a step, friction 1.
    pub const fn sticking(rest_gap_m: f64) -> Self {
        Self { rest_gap_m, share: 0.5, friction: 1.0, n_sweeps: 1 }
    }
}

/// Changes the velocities [m/s] and adds impulses and shifts to `answer`. Never fails, never allocates.
pub fn respond(
    params: &GeometricParams,
    contacts: &[NodeContact],
    inverse_mass_per_kg: &[DVec3],
    velocities_m_per_s: &mut [DVec3],
    answer: &mut Answer,
) {
    respond_noting(params, contacts, inverse_mass_per_kg, velocities_m_per_s, answer, |_, _| {});
}

/// The same; `note` is told each impulse on a contact's vertex [N s], with the contact's place in the list.
pub(super) fn respond_noting(
    params: &GeometricParams,
    contacts: &[NodeContact],
    inverse_mass_per_kg: &[DVec3],
    velocities_m_per_s: &mut [DVec3],
    answer: &mut Answer,
    mut note: impl FnMut(usize, DVec3),
) {
    let stop = Blow { restitution: 0.0, friction: params.friction };
    for _ in 0..params.n_sweeps {
        for (place, contact) in contacts.iter().enumerate() {
            let deeper_m = params.rest_gap_m - contact.gap_m;
            let per_kg = contact.inverse_mass_per_kg(contact.normal, inverse_mass_per_kg);
            if !(deeper_m > 0.0 && per_kg > 0.0) {
                continue;
            }
            // What the contacts before have moved counts.
            let shifts_kg_m = &mut answer.shifts_kg_m;
            let moved_m = |v: usize| inverse_mass_per_kg[v] * shifts_kg_m[v];
            let opened_m = contact.sides().map(|(v, w)| w * contact.normal.dot(moved_m(v))).sum::<f64>();
            let shift_kg_m = (params.share * deeper_m - opened_m).max(0.0) / per_kg;
            for (v, w) in contact.sides() {
                shifts_kg_m[v] += contact.normal * (shift_kg_m * w);
            }
            let impulses_n_s = &mut answer.impulses_n_s;
            note(place, stop.strike(contact, inverse_mass_per_kg, velocities_m_per_s, impulses_n_s));
        }
    }
}
