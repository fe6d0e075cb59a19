//! What the models of a seed are made from, and how.

use super::draw::Draw;
use glisson::material::{
    LawChoice, LinearElastic, Material, MaterialSpec, PronySeries, PronyTerm, StableNeoHooke, law_named,
};
use glisson::math::DMat3;
use glisson::mesh::TetMesh;
use glisson::model::explicit_kernel::{ExplicitKernel, ExplicitKernelParams};
use glisson::model::kernel::{KernelLaw, MOST_STRESS, SharedMaterial};
use glisson::model::kind::ModelKind;
use glisson::model::{Attachment, DeformableModel, DynamicBody, FixedNode, Rayleigh};
use glisson::scene::{ModelError, OrganBody, build_model, build_model_as_cut};

pub(super) const DENSITY_KG_PER_M3: f64 = 1060.0;
/// A step that no model divides.
pub(super) const AT_ONCE_S: f64 = 1e-12;

/// Three materials, by place; most models are made from the first.
fn materials() -> [LinearElastic; 3] {
    [4100.0, 6150.0, 2050.0].map(|young_pa| {
        LinearElastic::from_young_poisson(young_pa, 0.45, DENSITY_KG_PER_M3).expect("they are sound")
    })
}

const RELAXATION: [PronyTerm; 2] =
    [PronyTerm { share: 0.3, time_s: 0.05 }, PronyTerm { share: 0.2, time_s: 2.0 }];

/// What models are made from, but for mesh, supports and ligaments.
pub(super) struct Substance {
    kind: ModelKind,
    law: Option<LawChoice>,
    relaxation: Vec<PronyTerm>,
    damping: Rayleigh,
    /// Where there are fewer, they are the same.
    pub(super) materials: [LinearElastic; 3],
    /// The law of each material; linear for springs, which have none.
    pub(super) laws: [MaterialSpec; 3],
}

/// What a model is made on.
pub(super) struct Held<'a> {
    pub(super) mesh: &'a TetMesh,
    /// Number of the material of each tetrahedron.
    pub(super) material: &'a [u8],
    pub(super) fixed: &'a [FixedNode],
    pub(super) ligaments: &'a [Attachment],
}

impl Substance {
    /// First Piola-Kirchhoff stress [Pa] of a material at `f`: of its law, or in the explicit kernel of the stable neo-Hookean
    /// one where the law does not count.
    pub(super) fn stress_pa(&self, number: usize, f: &DMat3) -> DMat3 {
        let law = self.laws[number].material();
        let stress_pa = law.first_piola_pa(f);
        if self.kind != ModelKind::Explicit || law.returns_from_inversion() {
            return stress_pa;
        }
        let [lambda_pa, mu_pa] = law.lame_at_rest_pa();
        let greatest_pa = stress_pa.to_cols_array().into_iter().fold(0.0, |most: f64, x| most.max(x.abs()));
        let counts = f.determinant() > 0.0
            && stress_pa.is_finite()
            && greatest_pa <= MOST_STRESS * (lambda_pa + 2.0 * mu_pa);
        let stand_in = StableNeoHooke::new(lambda_pa, mu_pa).expect("the soak's laws are stiff at rest");
        if counts { stress_pa } else { stand_in.first_piola_pa(f) }
    }

    pub(super) fn of(draw: &Draw) -> Self {
        let all = materials();
        let law = draw.law.clone().or_else(|| law_named("linear")).expect("the linear law is known");
        let materials = if has_three_materials(draw) { all } else { [all[0]; 3] };
        Self {
            kind: draw.kind,
            law: draw.law.clone(),
            relaxation: if draw.relaxes { RELAXATION.to_vec() } else { Vec::new() },
            damping: Rayleigh::of_mass(draw.damping_per_s),
            laws: materials.map(|material| law.with_moduli_of(&material).expect("the numbers are sound")),
            materials,
        }
    }

    /// A model for steps of `time_step_s`.
    ///
    /// # Errors
    /// Why there is none: a step above the stable one.
    pub(super) fn model(&self, on: &Held<'_>, time_step_s: f64) -> Result<Box<dyn DeformableModel>, String> {
        if self.kind == ModelKind::Explicit {
            return self.explicit(on, time_step_s);
        }
        build_model(&self.body(on, time_step_s), self.kind).map_err(|error| format!("{error}: {error:?}"))
    }

    /// A model for forces alone: its step may be as short as a sliver asks for.
    pub(super) fn model_for_forces(&self, on: &Held<'_>) -> Box<dyn DeformableModel> {
        self.model(on, AT_ONCE_S).unwrap_or_else(|e| panic!("no model afresh: {e}"))
    }

    /// The pre-computed model of what is left of a body.
    ///
    /// # Errors
    /// Why there is none: nothing that is held is left.
    pub(super) fn model_as_cut(
        &self,
        on: &Held<'_>,
        live: &[bool],
    ) -> Result<Box<dyn DeformableModel>, ModelError> {
        build_model_as_cut(&self.body(on, AT_ONCE_S), self.kind, live)
    }

    fn body(&self, on: &Held<'_>, time_step_s: f64) -> OrganBody {
        let mut body = OrganBody::new(on.mesh.clone(), self.materials[0], time_step_s);
        body.law.clone_from(&self.law);
        body.relaxation.clone_from(&self.relaxation);
        body.fixed = on.fixed.to_vec();
        body.attachments = on.ligaments.to_vec();
        body.damping = self.damping;
        body
    }

    /// As scenes make it, but from three materials.
    fn explicit(&self, on: &Held<'_>, time_step_s: f64) -> Result<Box<dyn DeformableModel>, String> {
        let of_tets: Vec<LinearElastic> =
            on.material.iter().map(|&number| self.materials[usize::from(number)]).collect();
        let (law, laws) = self.kernel_law();
        let relaxation =
            (!self.relaxation.is_empty()).then(|| PronySeries::new(&self.relaxation).expect("it is sound"));
        let body = DynamicBody {
            fixed: on.fixed,
            attachments: on.ligaments,
            damping: self.damping,
            time_step_s,
            ..DynamicBody::new(on.mesh, DENSITY_KG_PER_M3)
        };
        let params = ExplicitKernelParams {
            relaxation: relaxation.as_ref(),
            laws: &laws,
            ..ExplicitKernelParams::new(body, law, &of_tets)
        };
        let model = ExplicitKernel::build(&params).map_err(|error| error.to_string())?;
        Ok(Box::new(model))
    }

    fn kernel_law(&self) -> (KernelLaw, Vec<SharedMaterial>) {
        let Some(law) = &self.law else { return (KernelLaw::StVenantKirchhoff, Vec::new()) };
        match KernelLaw::named(law.name()) {
            Some(fast) => (fast, Vec::new()),
            // One for all: its stable step is a long search.
            None => (KernelLaw::General, vec![self.laws[0].clone().into_shared()]),
        }
    }
}

/// Whether the model is made of three materials: the explicit one with a law of its own kernels.
fn has_three_materials(draw: &Draw) -> bool {
    let own_kernels = ["linear", "st_venant_kirchhoff", "neo_hooke_log", "stable_neo_hooke"];
    draw.kind == ModelKind::Explicit && own_kernels.contains(&draw.law_name())
}

/// The material that tells tearing when tissue is stretched too far.
pub(super) fn torn_material() -> LinearElastic {
    materials()[0]
}
