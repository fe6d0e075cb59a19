//! What an explicit model on the kernel is made from, and what is wrong with it.

use std::sync::Arc;

use super::ExplicitError;
use crate::material::{LinearElastic, MaterialError, NeoHookeLog, PronySeries, StableNeoHooke};
use crate::model::explicit::keep;
use crate::model::kernel::{
    FastKernel, KernelError, KernelExtras, KernelLaw, KernelParams, KernelPath, SharedMaterial,
};
use crate::model::local_model::TangentLaw;
use crate::model::tet_law::{Fibre, TetLaw, linear_stiffness};
use crate::model::topology_update::{TopologyUpdate, blend_tets};
use crate::model::{DynamicBody, RestStress};
use crate::solve::{P1Gradients, SolveError, TetStiffness};
use crate::workers::{Sequential, SharedWorkers};
use glisson_mesh::mesh::edit::TopologyChange;
use glisson_mesh::mesh::{TetId, TetMesh};

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
    /// Something beside a law that it does not go with.
    #[error("{what} go with the laws linear and st_venant_kirchhoff only")]
    NotBeside {
        /// What, in the plural.
        what: &'static str,
        /// The law.
        law: KernelLaw,
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
    /// Mesh, density, supports, loads, damping, time step, stress in the rest shape.
    pub body: DynamicBody<'a>,
    /// The law of every tetrahedron.
    pub law: KernelLaw,
    /// One material, or one for each tetrahedron. Their densities do not count, the body's does.
    pub materials: &'a [LinearElastic],
    /// Stiffness along a direction, none or one a tetrahedron; with the laws Linear and StVenantKirchhoff.
    pub fibres: &'a [Fibre],
    /// gamma of the signed penalty of volume changes [Pa], from 0, which is none; with the same laws.
    pub volume_penalty_pa: f64,
    /// The laws of [`KernelLaw::General`], one or one a tetrahedron; none for other laws. Their moduli at small
    /// strain are those of `materials`.
    pub laws: &'a [SharedMaterial],
    /// How the stress of law and fibres relaxes.
    pub relaxation: Option<&'a PronySeries>,
    /// The stable step holds while all principal stretches stay within [1/s, s] for this s, from 1, if the law
    /// stiffens as it is stretched; and the kinetic energy is held against the elastic one at this stretch.
    pub largest_stretch: f64,
    /// Whether what edits need is computed at once, as it is unless said otherwise, or in the first one.
    pub expects_edits: bool,
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
            fibres: &[],
            volume_penalty_pa: 0.0,
            laws: &[],
            relaxation: None,
            largest_stretch: DEFAULT_LARGEST_STRETCH,
            expects_edits: true,
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
        let law = self.law;
        if !matches!(law, KernelLaw::Linear | KernelLaw::StVenantKirchhoff) {
            if !self.fibres.is_empty() {
                return Err(ExplicitKernelError::NotBeside { what: "fibres", law });
            }
            if self.volume_penalty_pa != 0.0 {
                return Err(ExplicitKernelError::NotBeside { what: "penalties of volume changes", law });
            }
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

/// What the kernel of a body is made from beside its mesh: kept for compactions. Lists have an entry a tetrahedron or
/// none.
#[derive(Clone)]
pub(super) struct Substance {
    materials: Vec<LinearElastic>,
    rest_stress_pa: Vec<RestStress>,
    fibres: Vec<Fibre>,
    volume_penalty_pa: f64,
    laws: Vec<SharedMaterial>,
    relaxation: Option<PronySeries>,
}

impl Substance {
    pub(super) fn of(params: &ExplicitKernelParams<'_>) -> Result<Self, MaterialError> {
        let n_tets = params.body.mesh.tetrahedra.len();
        let mut materials = params.materials_with_density()?;
        if let [one] = materials[..] {
            materials = vec![one; n_tets];
        }
        let laws = match params.laws {
            [one] => vec![one.clone(); n_tets],
            laws => laws.to_vec(),
        };
        Ok(Self {
            materials,
            rest_stress_pa: params.body.rest_stress_pa.to_vec(),
            fibres: params.fibres.to_vec(),
            volume_penalty_pa: params.volume_penalty_pa,
            laws,
            relaxation: params.relaxation.cloned(),
        })
    }

    pub(super) fn kernel(
        &self,
        mesh: &TetMesh,
        law: KernelLaw,
        path: KernelPath,
    ) -> Result<FastKernel, KernelError> {
        FastKernel::with_extras(&self.kernel_params(mesh, law, path), &self.extras())
    }

    pub(super) fn kernel_params<'a>(
        &'a self,
        mesh: &'a TetMesh,
        law: KernelLaw,
        path: KernelPath,
    ) -> KernelParams<'a> {
        KernelParams { mesh, law, materials: &self.materials, path }
    }

    pub(super) fn extras(&self) -> KernelExtras<'_> {
        KernelExtras {
            rest_stress_pa: &self.rest_stress_pa,
            fibres: &self.fibres,
            volume_penalty_pa: self.volume_penalty_pa,
            laws: &self.laws,
            relaxation: self.relaxation.as_ref(),
        }
    }

    /// Tensors of a tetrahedron at rest under its moduli at small strain.
    pub(super) fn stiffness_at_rest(&self, tet: TetId, gradients: &P1Gradients) -> TetStiffness {
        let material = &self.materials[tet.index()];
        let with_fibre = |fibre: &Fibre| TetLaw::with_fibre(material, fibre, tet).ok();
        let law = self.fibres.get(tet.index()).and_then(with_fibre);
        linear_stiffness(&law.unwrap_or_else(|| TetLaw::isotropic(material)), gradients)
    }

    /// New tetrahedra take material, fibre and law of the one that they take after most, and the mean stress of their
    /// parents.
    pub(super) fn grow(&mut self, change: &TopologyChange, growth: &TopologyUpdate) {
        growth.take_over(&mut self.materials);
        growth.take_over(&mut self.fibres);
        growth.take_over(&mut self.laws);
        blend_tets(&mut self.rest_stress_pa, change);
    }

    /// Forgets the tetrahedra beyond the first `n_tets`.
    pub(super) fn truncate(&mut self, n_tets: usize) {
        self.materials.truncate(n_tets);
        self.fibres.truncate(n_tets);
        self.laws.truncate(n_tets);
        self.rest_stress_pa.truncate(n_tets);
    }

    /// Hands out the law of a tetrahedron and its stress at rest.
    pub(super) fn with_law<R>(
        &self,
        tet: usize,
        law: KernelLaw,
        use_law: impl FnOnce(&TangentLaw<'_>, Option<&RestStress>) -> R,
    ) -> R {
        let material = &self.materials[tet];
        let rest_stress_pa = self.rest_stress_pa.get(tet);
        let (lambda_pa, mu_pa) = (material.lambda_pa(), material.mu_pa());
        let isotropic = TetLaw::isotropic(material);
        let fibre = self.fibres.get(tet);
        let with_fibre =
            |f: &Fibre| TetLaw::with_fibre(material, f, TetId::from_index(tet)).unwrap_or(isotropic);
        match law {
            // The small-strain law has no stiffness from its stress at rest.
            KernelLaw::Linear if fibre.is_none() => use_law(&TangentLaw::Linear { lambda_pa, mu_pa }, None),
            KernelLaw::Linear | KernelLaw::StVenantKirchhoff => {
                use_law(&TangentLaw::Kirchhoff(fibre.map_or(isotropic, with_fibre)), rest_stress_pa)
            }
            KernelLaw::NeoHookeLog => use_law(&TangentLaw::Any(&NeoHookeLog::from(material)), rest_stress_pa),
            KernelLaw::StableNeoHooke => {
                use_law(&TangentLaw::Any(&StableNeoHooke::from(material)), rest_stress_pa)
            }
            KernelLaw::General => use_law(&TangentLaw::Any(&*self.laws[tet]), rest_stress_pa),
        }
    }

    /// Drops the tetrahedra that do not stay.
    pub(super) fn keep(&mut self, tet_stays: &[bool]) {
        keep(&mut self.materials, tet_stays);
        if !self.rest_stress_pa.is_empty() {
            keep(&mut self.rest_stress_pa, tet_stays);
        }
        if !self.fibres.is_empty() {
            keep(&mut self.fibres, tet_stays);
        }
        if !self.laws.is_empty() {
            keep(&mut self.laws, tet_stays);
        }
    }
}
