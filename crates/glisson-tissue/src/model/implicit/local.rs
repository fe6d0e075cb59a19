//! The local models of an implicit body: from its factor where that is of the same step, else on rings of tetrahedra.

use super::ImplicitEuler;
use super::lagged::Lagged;
use crate::model::local_model::{
    ElementStiffness, LocalBody, LocalElements, LocalFrame, TangentLaw, add_rest_stress, compute, tet_tangent,
};
use crate::model::{LocalModel, LocalWork, Rayleigh};
use crate::solve::P1Gradients;
use glisson_mesh::math::DVec3;
use glisson_mesh::mesh::{NodeId, TetId};

/// Largest difference between a factor's step and the period, as a share of the mass term.
const SAME_STEP: f64 = 1e-9;

/// A body with the share of its stiffness that viscosity leaves to the period.
struct Relaxing<'a> {
    body: &'a ImplicitEuler,
    share: f64,
}

impl ImplicitEuler {
    /// The factor is used when it is of the mesh as it is, was made for steps of the period and no node of the patch is held, since held nodes are
    /// decoupled from their neighbours in it (fixed nodes have none, and a C of zero). It is that of the shape at which it was
    /// made. Entries between nodes that were asked for before with the same factor are kept ([`super::patch_inverse`]).
    pub(super) fn fill_local_model(
        &mut self,
        patch: &[NodeId],
        period_s: f64,
        work: &mut LocalWork,
        out: &mut LocalModel,
    ) {
        out.start(patch, period_s, &self.positions_m);
        let per_mass = 1.0 / (period_s * period_s) + self.damping.mass_per_s / period_s;
        let serves = self.successor.is_none()
            && self.lagged.as_mut().is_some_and(|lagged| {
                let is_of_period = (lagged.state.per_mass - per_mass).abs() <= SAME_STEP * per_mass;
                lagged.direct().is_some_and(|direct| direct.tells_entries())
                    && is_of_period
                    && out.nodes.iter().all(|n| !lagged.state.held[n.index()])
            });
        if !serves {
            let share = self.relaxation.as_mut().map_or(1.0, |r| r.stiffness_share(period_s));
            compute(&Relaxing { body: self, share }, work, out);
            return;
        }
        for (i, node) in out.nodes.iter().enumerate() {
            out.force_n[i] = self.load_on_n(node.index());
            out.mass_kg[i] = self.mass_kg[node.index()];
        }
        let Some(direct) = self.lagged.as_mut().and_then(Lagged::direct) else { return };
        direct.fill_compliance(work.path(), out);
        if work.tells_drift() {
            let per_s = 1.0 / period_s + self.damping.mass_per_s;
            // No scratch of a step that is read between steps.
            let momentum_n = &mut self.scratch.product_n;
            for (n, momentum_n) in momentum_n.iter_mut().enumerate() {
                *momentum_n = self.velocities_m_per_s[n] * (self.mass_kg[n] * per_s) * self.mask[n];
            }
            direct.fill_drift(momentum_n, work.path(), out);
        }
    }

    fn load_on_n(&self, n: usize) -> DVec3 {
        let held = self.held.iter().filter(|held| held.node as usize == n);
        self.outer_n[n] + held.map(|held| self.constraint_forces_n[held.place as usize]).sum::<DVec3>()
    }
}

impl LocalBody for Relaxing<'_> {
    fn elements(&self) -> LocalElements<'_> {
        LocalElements::Tets(&self.body.mesh.tetrahedra)
    }

    fn is_live(&self, element: usize) -> bool {
        self.body.tet_is_live[element]
    }

    /// The stiffness of the law in each tetrahedron, also where volume or strain are averaged over nodes.
    fn stiffness(&self, element: usize, _: f64) -> ElementStiffness {
        let body = self.body;
        let nodes = body.mesh.tetrahedra[element].map(NodeId::index);
        let gradients = P1Gradients::in_mesh(&body.mesh, TetId::from_index(element));
        let u_m = nodes.map(|n| body.displacement_m[n]);
        let law = TangentLaw::Any(body.law.of_tet(element));
        let mut stiffness = tet_tangent(&gradients, u_m, &law, None);
        stiffness.iter_mut().flatten().for_each(|block| *block *= self.share);
        if let Some(stress_pa) = body.rest_stress_pa.get(element) {
            add_rest_stress(&gradients, stress_pa, &mut stiffness);
        }
        stiffness
    }

    fn frame(&self) -> &dyn LocalFrame {
        self
    }

    fn velocity_m_per_s(&self, n: usize) -> DVec3 {
        self.body.velocities_m_per_s[n]
    }

    fn is_explicit(&self) -> bool {
        false
    }
}

impl LocalFrame for Relaxing<'_> {
    fn inertia_kg(&self, n: usize) -> f64 {
        self.body.mass_kg[n]
    }

    fn free_axes(&self, n: usize) -> [bool; 3] {
        if self.body.moves[n] {
            self.body.free_axes[n].to_array().map(|free| free != 0.0)
        } else {
            [false; 3]
        }
    }

    fn is_held(&self, n: usize) -> bool {
        self.body.is_held[n]
    }

    fn load_on_n(&self, n: usize) -> DVec3 {
        self.body.load_on_n(n)
    }

    fn damping(&self) -> Rayleigh {
        self.body.damping
    }
}
