//! Prony viscoelasticity in a step.
//!
//! The recursion of [`crate::material::PronySeries`] on the second Piola-Kirchhoff stress: S at the end of a step is
//! a S_e + C, with S_e the law's stress there, one factor a for all tetrahedra, and C the memory of each. So a step has
//! the law's potential times a, plus that of a constant stress ([`super::elements`]).
//!
//! The pressure relaxes with the rest. A tetrahedron in quarantine keeps its last elastic stress.

use super::elements::{Elements, components};
use crate::material::{PronyHistory, PronySeries, PronyStep};
use glisson_mesh::math::{DMat3, DVec3};
use glisson_mesh::mesh::TetId;
use glisson_mesh::mesh::edit::TopologyChange;

/// A series, its recursion for the present step length, and the history of each tetrahedron of the mesh.
#[derive(Clone, Debug)]
pub(super) struct Relaxation {
    series: PronySeries,
    step: PronyStep,
    step_s: f64,
    pub(super) histories: Vec<PronyHistory>,
}

impl Relaxation {
    pub(super) fn new(series: &PronySeries, step_s: f64, n_tets: usize) -> Self {
        Self {
            step: series.step(step_s),
            step_s,
            histories: vec![series.rest(); n_tets],
            series: series.clone(),
        }
    }

    /// Share of the elastic stiffness that a step of `step_s` has.
    pub(super) fn stiffness_share(&mut self, step_s: f64) -> f64 {
        if step_s != self.step_s {
            self.series.step_into(step_s, &mut self.step);
            self.step_s = step_s;
        }
        self.step.tangent_factor()
    }

    /// Prepares the elements for a step of `step_s`.
    pub(super) fn begin(&mut self, step_s: f64, elements: &mut Elements) {
        let factor = self.stiffness_share(step_s);
        let (step, histories) = (&self.step, &self.histories);
        elements.set_viscous(factor, |tet: TetId| step.stress_pa(&histories[tet.index()], &DMat3::ZERO));
    }

    /// Advances the histories to the end of the step, which is the elements' last evaluation.
    pub(super) fn end(&mut self, elements: &Elements, displacement_m: &[DVec3]) {
        for (t, tet) in elements.tets().iter().enumerate() {
            let history = &mut self.histories[tet.index()];
            let elastic_pa = elements.second_piola_pa(t, displacement_m).unwrap_or(history.elastic_pa);
            self.step.advance(history, &elastic_pa);
        }
    }

    /// Resets the histories, as for a body that was always at rest.
    pub(super) fn forget(&mut self) {
        for history in &mut self.histories {
            history.elastic_pa = DMat3::ZERO;
            history.terms_pa.fill(DMat3::ZERO);
        }
    }

    /// New tetrahedra get the mean history of their parents.
    pub(super) fn grow(&mut self, change: &TopologyChange) {
        self.histories.resize(change.tets.n_after, self.series.rest());
        for (tet, parents) in change.tets.added.iter() {
            let mut blend = self.series.rest();
            for &(parent, weight) in parents {
                let of_parent = &self.histories[parent.index()];
                blend.elastic_pa += of_parent.elastic_pa * weight;
                blend.terms_pa.iter_mut().zip(&of_parent.terms_pa).for_each(|(sum, h)| *sum += *h * weight);
            }
            self.histories[tet.index()] = blend;
        }
    }

    /// All histories as numbers.
    pub(super) fn numbers(&self) -> impl Iterator<Item = f64> + '_ {
        self.histories
            .iter()
            .flat_map(|h| std::iter::once(&h.elastic_pa).chain(&h.terms_pa))
            .flat_map(components)
    }
}
