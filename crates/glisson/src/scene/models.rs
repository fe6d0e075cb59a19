//! From an organ's description to the models that move it.

use super::build::{BuildError, OrganBody};
use crate::material::LawChoice;
use crate::mesh::NodeId;
use crate::model::DeformableModel;
use crate::model::Dynamics;
use crate::model::extended_mass_spring::{EdgeLaw, ExtendedMassSpring, ExtendedMassSpringParams};
use crate::model::implicit::{DEFAULT_TOLERANCE, ImplicitEuler, ImplicitParams, VolumeResistance};
use crate::model::kind::ModelKind;
use crate::model::mass_spring::{MassSpring, MassSpringParams, NodalMasses};
use crate::model::nonlinear_tensor_mass::{
    NonlinearElasticity, NonlinearTensorMass, NonlinearTensorMassParams,
};
use crate::model::precomputed::{Precomputed, PrecomputedExpectation, PrecomputedParams, StoredNodes};
use crate::model::tensor_mass::{TensorMass, TensorMassParams};

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
    Ok(match kind {
        ModelKind::Precomputed => Box::new(precomputed(body)?),
        ModelKind::TensorMass => Box::new(TensorMass::build(&TensorMassParams { body: body.dynamic(), material: &body.material })?),
        ModelKind::NonlinearTensorMass => {
            let fibres: Vec<_> =
                body.fibre.iter().cycle().take(body.mesh.tetrahedra.len()).copied().collect();
            Box::new(NonlinearTensorMass::build(&NonlinearTensorMassParams {
                mesh: &body.mesh,
                elasticity: NonlinearElasticity {
                    material: &body.material,
                    fibres: &fibres,
                    volume_penalty_pa: body.volume_penalty_pa,
                    largest_stretch: LARGEST_STRETCH,
                },
                fixed_nodes: &body.nodes_fixed_wholly(kind)?,
                damping_per_s: body.damping.mass_per_s,
                gravity_m_per_s2: body.gravity_m_per_s2,
                time_step_s: body.time_step_s,
            })?)
        }
        ModelKind::Implicit => Box::new(ImplicitEuler::build(&ImplicitParams {
            mesh: &body.mesh,
            material: &body.material,
            volume: VolumeResistance::Element,
            fixed_nodes: &body.nodes_fixed_wholly(kind)?,
            mass_damping_per_s: body.damping.mass_per_s,
            stiffness_damping_s: body.damping.stiffness_s,
            gravity_m_per_s2: body.gravity_m_per_s2,
            time_step_s: body.time_step_s,
            tolerance: DEFAULT_TOLERANCE,
        })?),
        ModelKind::MassSpring => Box::new(MassSpring::build(&MassSpringParams {
            mesh: &body.mesh,
            young_modulus_pa: body.material.young_modulus_pa(),
            density_kg_per_m3: body.material.density_kg_per_m3(),
            masses: NodalMasses::VolumeWeighted,
            link_damping_n_s_per_m: 0.0,
            node_damping_n_s_per_m: 0.0,
            dynamics: dynamics(body, &body.nodes_fixed_wholly(kind)?),
        })?),
        ModelKind::ExtendedMassSpring => Box::new(ExtendedMassSpring::build(&ExtendedMassSpringParams {
            mesh: &body.mesh,
            law: match body.law {
                Some(LawChoice::NeoHookeLog) => EdgeLaw::NeoHooke,
                _ => EdgeLaw::StVenantKirchhoff,
            },
            material: &body.material,
            viscosity_kg_per_m3_s: 0.0,
            dynamics: dynamics(body, &body.nodes_fixed_wholly(kind)?),
        })?),
    })
}

fn dynamics<'a>(body: &OrganBody, fixed_nodes: &'a [NodeId]) -> Dynamics<'a> {
    Dynamics {
        fixed_nodes,
        damping_per_s: body.damping.mass_per_s,
        gravity_m_per_s2: body.gravity_m_per_s2,
        time_step_s: body.time_step_s,
        frequency_reserve: FREQUENCY_RESERVE,
        ..Dynamics::default()
    }
}

fn precomputed(body: &OrganBody) -> Result<Precomputed, BuildError> {
    let (mesh, material, fixed_nodes) =
        (&body.mesh, &body.material, &body.nodes_fixed_wholly(ModelKind::Precomputed)?);
    let mut model = match &body.precomputed {
        Some(file) => Precomputed::load(file, &PrecomputedExpectation { mesh, material, fixed_nodes })?,
        None => {
            let stored = StoredNodes::Surface;
            Precomputed::build(&PrecomputedParams { mesh, material, fixed_nodes, stored, progress: None })?
        }
    };
    if body.is_imaged_under_gravity {
        model.carry_at_rest(body.gravity_m_per_s2);
    } else {
        model.set_gravity(body.gravity_m_per_s2);
    }
    Ok(model)
}
