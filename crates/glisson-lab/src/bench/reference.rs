//! Cases of what the fast kernel is compared with: the reference of the non-linear tensor-mass, mass-spring and
//! extended mass-spring; and the removal of a tetrahedron.

use std::hint::black_box;

use glam::DVec3;
use glisson::math::SeededRandom;
use glisson::mesh::TetId;
use glisson::mesh::edit::{EditableMesh, TopologyChange};
use glisson::model::explicit_kernel::{ExplicitKernel, ExplicitKernelParams};
use glisson::model::{DeformableModel, DynamicBody, FixedNode, Integration};

use glisson::model::extended_mass_spring::{EdgeLaw, ExtendedMassSpring, ExtendedMassSpringParams};
use glisson::model::kernel::KernelLaw;
use glisson::model::mass_spring::{MassSpring, MassSpringParams, NodalMasses};
use glisson::model::nonlinear_tensor_mass::{
    NonlinearElasticity, NonlinearTensorMass, NonlinearTensorMassParams,
};

use super::body::StandardBody;
use super::kernel::bent_m;
use super::{Case, Prepared, Settings, Work};

/// Far below every stable step: only the cost counts.
const STEP_S: f64 = 1e-5;

pub(super) const CASES: &[Case] = &[
    Case {
        name: "nonlinear_tensor_mass_force",
        about: "St Venant-Kirchhoff forces by the reference: sums over vertices, edges, triangles, tetrahedra",
        per: "step",
        sizes: &[6_300],
        parallel: false,
        prepare: nonlinear_tensor_mass_force,
    },
    Case {
        name: "mass_spring_step",
        about: "one explicit step of springs on the edges: forces once, positions, velocities",
        per: "step",
        sizes: &[6_300],
        parallel: false,
        prepare: mass_spring_step,
    },
    Case {
        name: "extended_mass_spring_step",
        about: "one explicit step of the St Venant-Kirchhoff extended mass-spring: forces once, positions, velocities",
        per: "step",
        sizes: &[6_300],
        parallel: false,
        prepare: extended_mass_spring_step,
    },
    Case {
        name: "remove_tetrahedron",
        about: "one tetrahedron out of the mesh's topology and out of the fast kernel, in random order",
        per: "edit",
        sizes: &[6_300],
        parallel: false,
        prepare: remove_tetrahedron,
    },
];

fn prepared(size: usize, note: String, run: Box<dyn FnMut() + Send>) -> Prepared {
    Prepared { size, isa: "portable", precision: "f64", work: None::<Work>, note, run }
}

fn nonlinear_tensor_mass_force(settings: Settings) -> anyhow::Result<Prepared> {
    let body = StandardBody::shared(settings.size)?;
    let elasticity = NonlinearElasticity {
        material: &body.material,
        fibres: &[],
        volume_penalty_pa: 0.0,
        largest_stretch: 1.0,
    };
    let mut model = NonlinearTensorMass::build(&NonlinearTensorMassParams {
        body: dynamic_body(&body, &[]),
        elasticity,
    })?;
    let bent_m = bent_m(&body);
    let mut force_n = vec![DVec3::ZERO; bent_m.len()];
    let note = format!("{:?}", model.operation_counts());
    Ok(prepared(
        body.mesh.tetrahedra.len(),
        note,
        Box::new(move || {
            model.elastic_forces_into(black_box(&bent_m), &mut force_n);
            black_box(&force_n);
        }),
    ))
}

fn step_of<M: DeformableModel + Send + 'static>(body: &StandardBody, mut model: M) -> Prepared {
    let moved_m: Vec<DVec3> =
        body.mesh.positions_m.iter().zip(bent_m(body)).map(|(&p, bent_m)| p + bent_m).collect();
    model.take_over(&moved_m);
    prepared(
        body.mesh.tetrahedra.len(),
        format!("{} nodes", moved_m.len()),
        Box::new(move || {
            model.step(STEP_S);
            black_box(model.state().positions_m);
        }),
    )
}

fn dynamic_body<'a>(body: &'a StandardBody, fixed: &'a [FixedNode]) -> DynamicBody<'a> {
    let density_kg_per_m3 = body.material.density_kg_per_m3();
    DynamicBody { fixed, time_step_s: STEP_S, ..DynamicBody::new(&body.mesh, density_kg_per_m3) }
}

fn held(body: &StandardBody) -> Vec<FixedNode> {
    body.fixed_nodes.iter().copied().map(FixedNode::all_axes).collect()
}

fn mass_spring_step(settings: Settings) -> anyhow::Result<Prepared> {
    let body = StandardBody::shared(settings.size)?;
    let model = MassSpring::build(&MassSpringParams {
        body: dynamic_body(&body, &held(&body)),
        young_modulus_pa: body.material.young_modulus_pa(),
        masses: NodalMasses::VolumeWeighted,
        link_damping_n_s_per_m: 0.0,
        node_damping_n_s_per_m: 0.0,
        integration: Integration::default(),
    })?;
    Ok(step_of(&body, model))
}

fn extended_mass_spring_step(settings: Settings) -> anyhow::Result<Prepared> {
    let body = StandardBody::shared(settings.size)?;
    let model = ExtendedMassSpring::build(&ExtendedMassSpringParams {
        body: dynamic_body(&body, &held(&body)),
        law: EdgeLaw::StVenantKirchhoff,
        material: &body.material,
        viscosity_kg_per_m3_s: 0.0,
        integration: Integration::default(),
    })?;
    Ok(step_of(&body, model))
}

/// Removes one after the other until half are gone; then a whole body comes in, which one call in some thousand
/// pays for: it does not show in the median.
fn remove_tetrahedron(settings: Settings) -> anyhow::Result<Prepared> {
    let body = StandardBody::shared(settings.size)?;
    let n_tets = body.mesh.tetrahedra.len();
    let whole_mesh = EditableMesh::new(body.mesh.clone())?;
    let mut order: Vec<TetId> = (0..n_tets).map(TetId::from_index).collect();
    let mut random = SeededRandom::new(1);
    for i in (1..n_tets).rev() {
        order.swap(i, (random.next_u64() % (i as u64 + 1)) as usize);
    }
    order.truncate(n_tets.div_ceil(2));
    let params = ExplicitKernelParams::new(
        dynamic_body(&body, &[]),
        KernelLaw::StVenantKirchhoff,
        std::slice::from_ref(&body.material),
    );
    let whole = ExplicitKernel::build(&params)?;
    let (mut mesh, mut model) = (whole_mesh.clone(), whole.clone());
    let mut change = TopologyChange::with_room_for_removals(n_tets);
    let mut next = 0;
    Ok(prepared(
        n_tets,
        "St Venant-Kirchhoff, mesh and explicit model".to_owned(),
        Box::new(move || {
            if next == order.len() {
                (mesh, model, next) = (whole_mesh.clone(), whole.clone(), 0);
            }
            let tet = order[next];
            next += 1;
            mesh.remove_into(&[tet], &mut change).expect("each is removed once");
            model.topology_changed(mesh.mesh(), &change).expect("the model follows removals");
            black_box((&change, &model));
        }),
    ))
}
