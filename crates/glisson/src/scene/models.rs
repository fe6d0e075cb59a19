//! From an organ's description to the models that move it.

use super::body::{BuildError, OrganBody};
use crate::material::{LawChoice, PronySeries};
use crate::math::Aabb;
use crate::mesh::TetId;
use crate::mesh::zones::Zones;
use crate::model::explicit_kernel::{ExplicitKernel, ExplicitKernelParams};
use crate::model::extended_mass_spring::{EdgeLaw, ExtendedMassSpring, ExtendedMassSpringParams};
use crate::model::hybrid::condensed::{CondensedHybrid, CondensedParams, ZoneLaw};
use crate::model::implicit::{ImplicitEuler, ImplicitLaw, ImplicitParams};
use crate::model::kernel::{KernelLaw, SharedMaterial};
use crate::model::kind::ModelKind;
use crate::model::mass_spring::{MassSpring, MassSpringParams, NodalMasses};
use crate::model::nonlinear_tensor_mass::{
    Fibre, NonlinearElasticity, NonlinearTensorMass, NonlinearTensorMassParams,
};
use crate::model::precomputed::{
    Precision, Precomputed, PrecomputedError, PrecomputedExpectation, PrecomputedParams, StoredNodes,
};
use crate::model::quasi_nonlinear::{Correction, LinearSample, MeasuredCurve, QuasiNonlinear, fit_curve};
use crate::model::reduced::{Reduced, ReducedParams};
use crate::model::tensor_mass::{TensorMass, TensorMassParams};
use crate::model::{DeformableModel, Integration};
use crate::solve::is_stable_under;
use crate::world::spec::nodes_in;
use std::iter::repeat_n;
use std::sync::Arc;

/// St Venant-Kirchhoff tissue stiffens as it is stretched: its stable step is computed for principal stretches up
/// to this one. A choice, not a measurement: the law itself is meant for strains well below it.
const LARGEST_STRETCH: f64 = 1.3;

/// How many times its value at rest the highest frequency of springs may become under deformation: the same
/// stretch, with the stiffness of a squared length in proportion to it.
const FREQUENCY_RESERVE: f64 = LARGEST_STRETCH;

/// Makes a model of an organ at rest; a saved pre-computation is loaded if the organ names one.
///
/// # Errors
/// [`BuildError`] of the model: a file that belongs to another organ, a time step above the stable one, something
/// that the model cannot do.
pub fn build_model(body: &OrganBody, kind: ModelKind) -> Result<Box<dyn DeformableModel>, BuildError> {
    let material = &body.material;
    let law = body.law.as_ref().filter(|law| kind.follows(law.name()));
    let integration = Integration { frequency_reserve: FREQUENCY_RESERVE, ..Integration::default() };
    body.refuse_what_it_lacks(kind)?;
    let is_linear = law.map(LawChoice::name).or(kind.laws().first().copied()) == Some("linear");
    let has_nonlinear_zone = body.zones.iter().any(|zone| zone.law == ZoneLaw::NonlinearTensorMass);
    if !is_linear || kind == ModelKind::Hybrid && has_nonlinear_zone {
        body.refuse_to_buckle(kind)?;
    }
    Ok(match kind {
        ModelKind::Precomputed => {
            let mut model = precomputed(body)?;
            // At the first cut it would hold up the simulation.
            model.prepare_cutting(&body.mesh).map_err(PrecomputedError::Solve)?;
            Box::new(model)
        }
        ModelKind::TensorMass => {
            Box::new(TensorMass::build(&TensorMassParams { body: body.dynamic(), material })?)
        }
        ModelKind::NonlinearTensorMass => Box::new(nonlinear_tensor_mass(body)?),
        ModelKind::Explicit => Box::new(explicit(body, law)?),
        ModelKind::Implicit => Box::new(implicit(body, law)?),
        ModelKind::MassSpring => Box::new(MassSpring::build(&MassSpringParams {
            body: body.dynamic(),
            young_modulus_pa: material.young_modulus_pa(),
            masses: NodalMasses::VolumeWeighted,
            link_damping_n_s_per_m: 0.0,
            node_damping_n_s_per_m: 0.0,
            integration,
        })?),
        ModelKind::ExtendedMassSpring => Box::new(ExtendedMassSpring::build(&ExtendedMassSpringParams {
            body: body.dynamic(),
            law: match law.map(LawChoice::name) {
                Some("neo_hooke_log") => EdgeLaw::NeoHooke,
                _ => EdgeLaw::StVenantKirchhoff,
            },
            material,
            viscosity_kg_per_m3_s: 0.0,
            integration,
        })?),
        ModelKind::Hybrid => Box::new(hybrid(body, law)?),
        ModelKind::Reduced => Box::new(reduced(body)?),
        ModelKind::QuasiNonlinear => Box::new(quasi_nonlinear(body)?),
    })
}

/// Makes a model of an organ from which tetrahedra are already gone: the pre-computed one of what is left, every other
/// one of the whole, which then has to follow the removals ([`crate::world::World::deliver_model`] sees to that).
///
/// # Errors
/// As [`build_model`].
pub fn build_model_as_cut(
    body: &OrganBody,
    kind: ModelKind,
    live: &[bool],
) -> Result<Box<dyn DeformableModel>, BuildError> {
    if kind != ModelKind::Precomputed || live.iter().all(|live| *live) {
        return build_model(body, kind);
    }
    body.refuse_what_it_lacks(kind)?;
    let (stored, precision) = match &body.precomputed {
        Some(file) => Precomputed::kept_in(file)?,
        None => (StoredNodes::Surface, Precision::F64),
    };
    let params = PrecomputedParams {
        mesh: &body.mesh,
        material: &body.material,
        fixed_nodes: &body.nodes_fixed_wholly(kind)?,
        stored,
        precision,
        progress: None,
    };
    Ok(Box::new(under_gravity(Precomputed::build_cut(&params, live)?, body)))
}

impl OrganBody {
    /// The fibre of every tetrahedron, or none.
    fn fibres(&self) -> Vec<Fibre> {
        self.fibre.iter().flat_map(|&fibre| repeat_n(fibre, self.mesh.tetrahedra.len())).collect()
    }

    fn relaxation(&self) -> Result<Option<PronySeries>, BuildError> {
        if self.relaxation.is_empty() {
            return Ok(None);
        }
        Ok(Some(PronySeries::new(&self.relaxation)?))
    }

    /// A linear body carries any stress at rest; for the others it may be more than the tissue's own stiffness bears.
    fn refuse_to_buckle(&self, model: ModelKind) -> Result<(), BuildError> {
        if self.rest_stress_pa.is_empty() {
            return Ok(());
        }
        match is_stable_under(&self.mesh, &self.material, &self.fixed, &self.rest_stress_pa) {
            Ok(true) => Ok(()),
            Ok(false) => Err(BuildError::Buckles { model }),
            Err(error) => Err(BuildError::RestStress(error)),
        }
    }

    fn refuse_what_it_lacks(&self, model: ModelKind) -> Result<(), BuildError> {
        let knows_fibres = matches!(model, ModelKind::NonlinearTensorMass | ModelKind::Explicit);
        let knows_relaxation = matches!(model, ModelKind::Implicit | ModelKind::Explicit);
        let asked = [
            (self.fibre.is_some() && !knows_fibres, "fibres"),
            (self.volume_penalty_pa != 0.0 && !knows_fibres, "penalties of volume changes"),
            (!self.relaxation.is_empty() && !knows_relaxation, "relaxation terms"),
        ];
        match asked.into_iter().find(|(lacks, _)| *lacks) {
            Some((_, what)) => Err(BuildError::Unsupported { model, what }),
            None => Ok(()),
        }
    }
}

fn nonlinear_tensor_mass(body: &OrganBody) -> Result<NonlinearTensorMass, BuildError> {
    let elasticity = NonlinearElasticity {
        material: &body.material,
        fibres: &body.fibres(),
        volume_penalty_pa: body.volume_penalty_pa,
        largest_stretch: LARGEST_STRETCH,
    };
    Ok(NonlinearTensorMass::build(&NonlinearTensorMassParams { body: body.dynamic(), elasticity })?)
}

fn implicit(body: &OrganBody, law: Option<&LawChoice>) -> Result<ImplicitEuler, BuildError> {
    let law = match law {
        None => ImplicitLaw::neo_hooke(&body.material),
        Some(law) => ImplicitLaw::from(&law.with_moduli_of(&body.material)?),
    };
    let relaxation = body.relaxation()?;
    let params =
        ImplicitParams { relaxation: relaxation.as_ref(), ..ImplicitParams::new(body.dynamic(), &law) };
    Ok(ImplicitEuler::build(&params)?)
}

fn explicit(body: &OrganBody, law: Option<&LawChoice>) -> Result<ExplicitKernel, BuildError> {
    let material = &body.material;
    let mut laws: Vec<SharedMaterial> = Vec::new();
    let law = match law {
        None => KernelLaw::StVenantKirchhoff,
        Some(law) => match KernelLaw::named(law.name()) {
            Some(fast) => fast,
            None => {
                laws.push(law.with_moduli_of(material)?.into_shared());
                KernelLaw::General
            }
        },
    };
    let relaxation = body.relaxation()?;
    let params = ExplicitKernelParams {
        fibres: &body.fibres(),
        volume_penalty_pa: body.volume_penalty_pa,
        laws: &laws,
        relaxation: relaxation.as_ref(),
        largest_stretch: LARGEST_STRETCH,
        workers: Arc::clone(&body.workers),
        ..ExplicitKernelParams::new(body.dynamic(), law, std::slice::from_ref(material))
    };
    Ok(ExplicitKernel::build(&params)?)
}

/// Zones into which what no zone of the scene has is cut across its longest axis: so much becomes dynamic with the first
/// cut there. A choice: more zones have more frontier to solve.
const REST_ZONES: usize = 4;

fn hybrid(body: &OrganBody, law: Option<&LawChoice>) -> Result<CondensedHybrid, BuildError> {
    let mesh = &body.mesh;
    let bounds = Aabb::of_points(&mesh.positions_m);
    let longest = bounds.size_m().max_position();
    let n_tets = mesh.tetrahedra.len();
    let mut of_tet = vec![usize::MAX; n_tets];
    let mut laws: Vec<ZoneLaw> = Vec::new();
    for (z, zone) in body.zones.iter().enumerate() {
        let mut is_in = vec![false; mesh.positions_m.len()];
        nodes_in(&[zone.region], &mesh.positions_m).iter().for_each(|n| is_in[n.index()] = true);
        let is_free = |t: &usize| of_tet[*t] == usize::MAX;
        let own: Vec<usize> = (0..n_tets)
            .filter(is_free)
            .filter(|&t| mesh.tetrahedra[t].iter().all(|n| is_in[n.index()]))
            .collect();
        if own.is_empty() {
            return Err(BuildError::EmptyZone { number: z + 1 });
        }
        own.into_iter().for_each(|t| of_tet[t] = z);
        laws.push(zone.law);
    }
    // Those of the rest that have tetrahedra, in their order.
    let mut rest: [Option<usize>; REST_ZONES] = [None; REST_ZONES];
    for t in 0..n_tets {
        if of_tet[t] == usize::MAX {
            let middle_m = mesh.corners_m(TetId::from_index(t)).iter().map(|p| p[longest]).sum::<f64>() / 4.0;
            let share = (middle_m - bounds.min_m[longest]) / bounds.size_m()[longest];
            let slice = ((share * REST_ZONES as f64) as usize).min(REST_ZONES - 1);
            of_tet[t] = *rest[slice].get_or_insert_with(|| {
                laws.push(ZoneLaw::Precomputed);
                laws.len() - 1
            });
        }
    }
    let zones = Zones::new(mesh, of_tet.into_iter().map(|z| z as u32).collect())
        .map_err(|error| BuildError::Hybrid(error.into()))?;
    let dynamic = body.dynamic();
    let mut params = CondensedParams::new(dynamic, &body.material, &zones, &laws);
    // Inner nodes are not seen; the factor gives their places.
    params.stored = StoredNodes::Surface;
    if law.map(LawChoice::name) == Some("st_venant_kirchhoff") {
        params.cut_law = ZoneLaw::NonlinearTensorMass;
    }
    params.largest_stretch = LARGEST_STRETCH;
    Ok(CondensedHybrid::build(&params)?)
}

fn reduced(body: &OrganBody) -> Result<Reduced, BuildError> {
    if !body.attachments.is_empty() {
        return Err(BuildError::Unsupported { model: ModelKind::Reduced, what: "ligaments" });
    }
    let mut model = Reduced::build(&ReducedParams::new(&body.mesh, &body.material, &body.fixed))?;
    if body.is_imaged_under_gravity {
        model.carry_at_rest(body.gravity_m_per_s2);
    } else {
        model.set_gravity(body.gravity_m_per_s2);
    }
    Ok(model)
}

fn quasi_nonlinear(body: &OrganBody) -> Result<QuasiNonlinear, BuildError> {
    let measured = body.measured.as_ref().ok_or(BuildError::NoCurves)?;
    let curve = MeasuredCurve::read(&measured.curve)?;
    let fit = |y: &[f64], quantity| {
        if y.is_empty() {
            return Ok(None);
        }
        match fit_curve(&curve.axial_displacement_m, y, measured.degree) {
            Ok(fit) => Ok(Some(fit.polynomial)),
            Err(error) => Err(BuildError::Fit { file: measured.curve.clone(), quantity, error }),
        }
    };
    let force_n = fit(&curve.force_n, "force")?;
    let radial_m = fit(&curve.radial_displacement_m, "radial displacement")?;
    let sample = LinearSample::cylinder(measured.height_m, measured.radius_m, &body.material);
    let correction =
        Correction::of_sample(force_n.as_ref(), radial_m.as_ref(), &sample).map_err(|error| {
            BuildError::NoLinearAnswer {
                file: measured.curve.clone(),
                poisson_ratio: body.material.poisson_ratio(),
                error,
            }
        })?;
    Ok(QuasiNonlinear::new(Box::new(precomputed(body)?), &body.mesh, correction)?)
}

fn precomputed(body: &OrganBody) -> Result<Precomputed, BuildError> {
    let (mesh, material, fixed_nodes) =
        (&body.mesh, &body.material, &body.nodes_fixed_wholly(ModelKind::Precomputed)?);
    let model = match &body.precomputed {
        Some(file) => Precomputed::load(file, &PrecomputedExpectation { mesh, material, fixed_nodes })?,
        None => {
            let (stored, precision) = (StoredNodes::Surface, Precision::F64);
            Precomputed::build(&PrecomputedParams {
                mesh,
                material,
                fixed_nodes,
                stored,
                precision,
                progress: None,
            })?
        }
    };
    Ok(under_gravity(model, body))
}

fn under_gravity(mut model: Precomputed, body: &OrganBody) -> Precomputed {
    if body.is_imaged_under_gravity {
        model.carry_at_rest(body.gravity_m_per_s2);
    } else {
        model.set_gravity(body.gravity_m_per_s2);
    }
    model
}
