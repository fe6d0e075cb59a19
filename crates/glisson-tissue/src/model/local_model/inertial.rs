//! C of the masses alone.
//!
//! Over an implicit step of h that is 1/(m/h^2 + alpha m/h) for each node: where the tangent is not positive definite it
//! stands for C, softer than tissue that resists at all.
//!
//! A step of h in n equal parts of central differences moves a node by
//!
//! h^2/m (n + 1)/(2 n), with 1/(1/k^2 + alpha/(2 k)) for k^2, k = h/n,
//!
//! for a force that acts throughout it, while no other node answers before the second part. What others answer in the parts
//! after that is left out: less than the part of K h^2/M, which is the smaller the shorter h is below the stable step.

use super::{LocalBody, LocalModel};
use glisson_mesh::math::{DMat3, DVec3};

/// C of an implicit step without stiffness.
pub(super) fn of_masses(body: &dyn LocalBody, tells_drift: bool, out: &mut LocalModel) {
    let h_s = out.period_s;
    fill(body, tells_drift, out, 1.0 / ((1.0 / h_s + body.damping().mass_per_s) / h_s));
}

/// C of a step in so many parts of central differences.
pub(super) fn of_short_step(body: &dyn LocalBody, n_parts: u64, tells_drift: bool, out: &mut LocalModel) {
    let n = n_parts as f64;
    let part_s = out.period_s / n;
    let push_s2 = 1.0 / ((1.0 / part_s + 0.5 * body.damping().mass_per_s) / part_s);
    out.n_rings = Some(0);
    fill(body, tells_drift, out, push_s2 * 0.5 * n * (n + 1.0));
}

/// C = s/m with `per_mass_s2` for s along the free axes of each node, and a drift that goes on with what the elements' forces have changed by.
fn fill(body: &dyn LocalBody, tells_drift: bool, out: &mut LocalModel, per_mass_s2: f64) {
    out.compliance_m_per_n.fill(0.0);
    out.is_inertial = true;
    for i in 0..out.nodes.len() {
        let n = out.nodes[i].index();
        let inertia_kg = body.frame().inertia_kg(n);
        let free = body.frame().free_axes(n);
        let free = free.map(|free| if free && inertia_kg > 0.0 { per_mass_s2 / inertia_kg } else { 0.0 });
        let free = DVec3::from_array(free);
        out.set_tensor(i, i, DMat3::from_diagonal(free));
        if tells_drift {
            out.drift_m[i] =
                body.velocity_m_per_s(n) * out.period_s + free * out.changed_n[i].unwrap_or(DVec3::ZERO);
        }
    }
}
