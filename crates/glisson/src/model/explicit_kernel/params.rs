//! What an explicit model on the kernel is made from, and what is wrong with it.

use std::sync::Arc;

use super::{ExplicitError, SharedWorkers};
use crate::material::{LinearElastic, MaterialError};
use crate::mesh::TetId;
use crate::model::DynamicBody;
use crate::model::kernel::{KernelError, KernelLaw, KernelPath, Sequential};
use crate::solve::SolveError;

/// Stretch for which the step is made, unless told otherwise: a choice, not a measurement.
pub const DEFAULT_LARGEST_STRETCH: f64 = 1.3;
/// Why there is no such model.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum ExplicitKernelError {
    /// The mesh, the time step or a number.
    #[error(transparent)]
    Explicit(#[from] ExplicitError),
    /// The mesh or the number of materials.
    #[error(transparent)]
    Kernel(#[from] KernelError),
    /// A material with the body's density.
    #[error(transparent)]
    Material(#[from] MaterialError),
    /// Stress in the rest shape was given.
    #[error(
        "{n_stresses} rest stresses are given; the kernel's laws have none: leave them out, or take a tensor-mass model"
    )]
    RestStress {
        /// How many.
        n_stresses: usize,
    },
}

impl From<SolveError> for ExplicitKernelError {
    fn from(error: SolveError) -> Self {
        Self::Explicit(error.into())
    }
}

/// What an explicit model on the kernel is made from.
#[derive(Clone)]
pub struct ExplicitKernelParams<'a> {
    /// Mesh, density, supports, loads, damping, time step. The rest stress must be empty.
    pub body: DynamicBody<'a>,
    /// The law of every tetrahedron.
    pub law: KernelLaw,
    /// One material, or one for each tetrahedron. Their densities do not count, the body's does.
    pub materials: &'a [LinearElastic],
    /// The stable step holds while all principal stretches stay within [1/s, s] for this s, from 1, if the law
    /// stiffens as it is stretched; and the kinetic energy is held against the elastic one at this stretch.
    pub largest_stretch: f64,
    /// How to compute; [`KernelPath::fastest`] unless paths are compared.
    pub path: KernelPath,
    /// Who computes.
    pub workers: SharedWorkers,
}

impl std::fmt::Debug for ExplicitKernelParams<'_> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("ExplicitKernelParams")
            .field("body", &self.body)
            .field("law", &self.law)
            .field("largest_stretch", &self.largest_stretch)
            .finish_non_exhaustive()
    }
}

impl<'a> ExplicitKernelParams<'a> {
    /// On the fastest path and the calling thread, for stretches up to [`DEFAULT_LARGEST_STRETCH`].
    pub fn new(body: DynamicBody<'a>, law: KernelLaw, materials: &'a [LinearElastic]) -> Self {
        Self {
            body,
            law,
            materials,
            largest_stretch: DEFAULT_LARGEST_STRETCH,
            path: KernelPath::fastest(),
            workers: Arc::new(Sequential),
        }
    }

    pub(super) fn material(&self, tet: TetId) -> &LinearElastic {
        &self.materials[if self.materials.len() == 1 { 0 } else { tet.index() }]
    }

    pub(super) fn materials_with_density(&self) -> Result<Vec<LinearElastic>, MaterialError> {
        let density = self.body.density_kg_per_m3;
        self.materials.iter().map(|m| LinearElastic::from_lame(m.lambda_pa(), m.mu_pa(), density)).collect()
    }

    pub(super) fn materials_of_tets(&self) -> Result<Vec<LinearElastic>, MaterialError> {
        let mut materials = self.materials_with_density()?;
        if let [one] = materials[..] {
            materials = vec![one; self.body.mesh.tetrahedra.len()];
        }
        Ok(materials)
    }

    pub(super) fn check(&self) -> Result<(), ExplicitKernelError> {
        let body = &self.body;
        let parameter = |what, found, allowed| Err(ExplicitError::Parameter { what, found, allowed }.into());
        let from_zero = "a finite number from 0";
        if !(body.damping.mass_per_s.is_finite() && body.damping.mass_per_s >= 0.0) {
            return parameter("damping over mass [1/s]", body.damping.mass_per_s, from_zero);
        }
        if !(body.damping.stiffness_s.is_finite() && body.damping.stiffness_s >= 0.0) {
            return parameter("damping over stiffness [s]", body.damping.stiffness_s, from_zero);
        }
        if !body.gravity_m_per_s2.is_finite() {
            return parameter("gravity [m/s2]", body.gravity_m_per_s2.length(), "finite numbers");
        }
        if !(body.time_step_s.is_finite() && body.time_step_s > 0.0) {
            return parameter("time step [s]", body.time_step_s, "a finite number above 0");
        }
        if body.most_parts == 0 {
            return parameter("most parts of a step", 0.0, "a whole number from 1");
        }
        if !(self.largest_stretch.is_finite() && self.largest_stretch >= 1.0) {
            return parameter("largest stretch", self.largest_stretch, "a finite number from 1");
        }
        if !body.rest_stress_pa.is_empty() {
            return Err(ExplicitKernelError::RestStress { n_stresses: body.rest_stress_pa.len() });
        }
        let n_nodes = body.mesh.positions_m.len();
        let mut named = body.fixed.iter().map(|f| f.node).chain(body.attachments.iter().map(|a| a.node));
        if let Some(node) = named.find(|node| node.index() >= n_nodes) {
            return Err(SolveError::ConditionOutOfRange { node, n_nodes }.into());
        }
        for attachment in body.attachments {
            let (slack_m, n_per_m) = (attachment.slack_length_m, attachment.stiffness_n_per_m);
            if !(slack_m.is_finite() && slack_m >= 0.0) {
                return parameter("slack length of a ligament [m]", slack_m, from_zero);
            }
            if !(n_per_m.is_finite() && n_per_m >= 0.0) {
                return parameter("stiffness of a ligament [N/m]", n_per_m, from_zero);
            }
            if !attachment.anchor_m.is_finite() {
                return parameter("anchor of a ligament [m]", attachment.anchor_m.length(), "finite numbers");
            }
        }
        Ok(())
    }
}
