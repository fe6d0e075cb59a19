//! What the model tells about itself for its local models.

use super::ExplicitKernel;
use crate::model::Rayleigh;
use crate::model::kernel::KernelLaw;
use crate::model::local_model::{
    ElementStiffness, LocalBody, LocalElements, LocalFrame, tet_tangent, tet_tangent_times,
};
use crate::solve::P1Gradients;
use glisson_mesh::math::DVec3;
use glisson_mesh::mesh::{NodeId, TetId};

impl LocalBody for ExplicitKernel {
    fn elements(&self) -> LocalElements<'_> {
        LocalElements::Tets(&self.rest.tetrahedra)
    }

    fn is_live(&self, element: usize) -> bool {
        self.kernel.is_live(TetId::from_index(element))
    }

    /// Without volume penalty, whose stiffness is zero at rest; instantaneous where stress relaxes.
    fn stiffness(&self, element: usize, _: f64) -> ElementStiffness {
        let (gradients, _, u_m) = self.shape_of(element);
        self.substance.with_law(element, self.kernel.law(), |law, rest_stress_pa| {
            tet_tangent(&gradients, u_m, law, rest_stress_pa)
        })
    }

    /// Without the stiffness, which costs many times as much: it is asked for in every step in which jaws hold tissue.
    fn change_n(&self, element: usize, period_s: f64) -> [DVec3; 4] {
        let (gradients, nodes, u_m) = self.shape_of(element);
        let moves_m = nodes.map(|n| self.velocities_m_per_s[n] * period_s);
        self.substance.with_law(element, self.kernel.law(), |law, rest_stress_pa| {
            tet_tangent_times(&gradients, [u_m, moves_m], law, rest_stress_pa).map(|balance_n| -balance_n)
        })
    }

    fn frame(&self) -> &dyn LocalFrame {
        self
    }

    fn velocity_m_per_s(&self, n: usize) -> DVec3 {
        self.velocities_m_per_s[n]
    }

    /// For laws that bring tissue back from every shape. Under others a touched node is better taken for stiffer than it is:
    /// a rough hand that overtakes it leaves a tangle.
    fn short_step_parts(&self, period_s: f64) -> Option<u64> {
        let is_short = period_s <= self.stable_step_s();
        let returns = matches!(self.kernel.law(), KernelLaw::Linear | KernelLaw::StableNeoHooke);
        (is_short && returns).then(|| self.parts_to_come(period_s))
    }
}

impl ExplicitKernel {
    /// Gradients, corners and the corners' displacements [m] of a tetrahedron.
    fn shape_of(&self, element: usize) -> (P1Gradients, [usize; 4], [DVec3; 4]) {
        let nodes = self.rest.tetrahedra[element].map(NodeId::index);
        let gradients = P1Gradients::in_mesh(&self.rest, TetId::from_index(element));
        (gradients, nodes, nodes.map(|n| self.displacements_m[n]))
    }
}

impl LocalFrame for ExplicitKernel {
    fn inertia_kg(&self, n: usize) -> f64 {
        self.kernel.inertia_kg(NodeId::from_index(n))
    }

    fn free_axes(&self, n: usize) -> [bool; 3] {
        if self.takes_load(NodeId::from_index(n)) { self.supports[n].map(|held| !held) } else { [false; 3] }
    }

    fn is_held(&self, n: usize) -> bool {
        self.held.iter().any(|held| held.node.index() == n)
    }

    fn load_on_n(&self, n: usize) -> DVec3 {
        let held = self.held.iter().filter(|held| held.node.index() == n);
        self.loads.on_n(n) + held.map(|held| self.constraint_forces_n[held.place]).sum::<DVec3>()
    }

    fn damping(&self) -> Rayleigh {
        self.damping
    }
}
