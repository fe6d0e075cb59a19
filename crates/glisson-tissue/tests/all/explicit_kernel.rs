//! The explicit model on the fast kernel: against the tensor-mass models and after edits; further tests in the
//! modules below.

mod faults;
mod outside;
mod threads;

use glisson_mesh::math::{DVec3, SeededRandom};
use glisson_mesh::mesh::edit::{EditableMesh, MeshEdit};
use glisson_mesh::mesh::{NodeId, TetId, TetMesh};
use glisson_tissue::material::LinearElastic;
use glisson_tissue::model::StateHash;
use glisson_tissue::model::explicit_kernel::{ExplicitKernel, ExplicitKernelParams};
use glisson_tissue::model::kernel::KernelLaw;
use glisson_tissue::model::nonlinear_tensor_mass::{
    NonlinearElasticity, NonlinearTensorMass, NonlinearTensorMassParams,
};
use glisson_tissue::model::tensor_mass::{TensorMass, TensorMassParams};
use glisson_tissue::model::{
    Attachment, Constraints, DeformableModel, DynamicBody, FixedNode, ImposedDisplacement, NodalForce,
    Rayleigh,
};

use crate::model_meshes::{nodes_below, relative_difference, rounded_block, shaken_block};

const LAWS: [KernelLaw; 2] = [KernelLaw::Linear, KernelLaw::StVenantKirchhoff];
const DENSITY_KG_PER_M3: f64 = 1060.0;
const SIZE_M: DVec3 = DVec3::new(0.12, 0.08, 0.07);
/// A twentieth of the earth's: under the full one so soft a beam would hang down.
const GRAVITY_M_PER_S2: DVec3 = DVec3::new(0.0, 0.1, -0.5);

fn material() -> LinearElastic {
    LinearElastic::from_young_poisson(5000.0, 0.45, DENSITY_KG_PER_M3).unwrap()
}

/// About 2,000 tetrahedra of a rounded body, and where it is held.
fn organ() -> (TetMesh, Vec<FixedNode>) {
    let mesh = rounded_block([9, 6, 6], SIZE_M);
    let lowest_m = mesh.positions_m.iter().map(|p| p.x).fold(f64::INFINITY, f64::min);
    let fixed = nodes_below(&mesh, 0, lowest_m + 0.1 * SIZE_M.x);
    (mesh, fixed.into_iter().map(FixedNode::all_axes).collect())
}

/// The longest time step, for the law that stiffens more.
fn time_step_s(mesh: &TetMesh) -> f64 {
    let materials = &[material()];
    let body = DynamicBody::new(mesh, DENSITY_KG_PER_M3);
    let params = ExplicitKernelParams::new(body, KernelLaw::StVenantKirchhoff, materials);
    0.95 * ExplicitKernel::stable_step(&params).unwrap().step_s
}

fn body<'a>(mesh: &'a TetMesh, fixed: &'a [FixedNode]) -> DynamicBody<'a> {
    DynamicBody {
        fixed,
        gravity_m_per_s2: GRAVITY_M_PER_S2,
        damping: Rayleigh { mass_per_s: 20.0, stiffness_s: 0.0 },
        time_step_s: time_step_s(mesh),
        ..DynamicBody::new(mesh, DENSITY_KG_PER_M3)
    }
}

fn build(body: DynamicBody<'_>, law: KernelLaw) -> ExplicitKernel {
    ExplicitKernel::build(&ExplicitKernelParams::new(body, law, &[material()])).unwrap()
}

/// The reference of the same physics.
fn reference(body: &DynamicBody<'_>, law: KernelLaw) -> Box<dyn DeformableModel> {
    let material = &material();
    match law {
        KernelLaw::Linear => {
            Box::new(TensorMass::build(&TensorMassParams { body: *body, material }).unwrap())
        }
        KernelLaw::StVenantKirchhoff => {
            let elasticity =
                NonlinearElasticity { material, fibres: &[], volume_penalty_pa: 0.0, largest_stretch: 1.3 };
            Box::new(
                NonlinearTensorMass::build(&NonlinearTensorMassParams { body: *body, elasticity }).unwrap(),
            )
        }
        _ => unreachable!("{law:?} has no tensor-mass model"),
    }
}

/// Three nodes at the far end.
fn touched(mesh: &TetMesh) -> [NodeId; 3] {
    let mut order: Vec<usize> = (0..mesh.positions_m.len()).collect();
    order.sort_by(|&a, &b| mesh.positions_m[b].x.total_cmp(&mesh.positions_m[a].x));
    let mut nodes = [order[0], order[1], order[2]].map(NodeId::from_index);
    nodes.sort();
    nodes
}

/// A tool that pushes the far end in and out, sometimes lets it go, and a force beside it.
fn constraints(mesh: &TetMesh, step: u64, constraints: &mut Constraints) {
    constraints.displacements.clear();
    constraints.forces.clear();
    let t = step as f64 * 0.02;
    if step % 300 < 220 {
        let depth_m = 0.06 * SIZE_M.x * (1.0 - libm::cos(t));
        let displacement_m = DVec3::new(-depth_m, 0.3 * depth_m, 2e-3 * libm::sin(0.7 * t));
        let held = touched(mesh).map(|node| ImposedDisplacement { node, displacement_m });
        constraints.displacements.extend(held);
    }
    let force_n = DVec3::new(0.02, -0.05, 0.05) * libm::sin(0.31 * t);
    let node = NodeId::from_index(mesh.positions_m.len() / 2);
    constraints.forces.push(NodalForce { node, force_n });
}

/// Removals in a random order, away from the touched nodes.
fn removals(mesh: &TetMesh, n: usize, seed: u64) -> Vec<TetId> {
    let keep = touched(mesh);
    let mut random = SeededRandom::new(seed);
    let mut tets: Vec<usize> = (0..mesh.tetrahedra.len())
        .filter(|&t| mesh.tetrahedra[t].iter().all(|node| !keep.contains(node)))
        .collect();
    for i in (1..tets.len()).rev() {
        tets.swap(i, (random.next_u64() % (i as u64 + 1)) as usize);
    }
    tets.truncate(n);
    tets.into_iter().map(TetId::from_index).collect()
}

#[test]
fn trajectories_equal_those_of_the_tensor_mass_models() {
    let (mesh, fixed) = organ();
    // As many parts as the step has anyway: where tissue is strained only one of the models would divide it further.
    let body = DynamicBody { most_parts: 2, ..body(&mesh, &fixed) };
    let dt_s = 1.4 * body.time_step_s;
    for law in LAWS {
        let mut model = build(body, law);
        let mut expected = reference(&body, law);
        let mut editable = EditableMesh::new(mesh.clone()).unwrap();
        let tets = removals(&mesh, 40, 5);
        let mut inputs = Constraints::default();
        for step in 0..500 {
            constraints(&mesh, step, &mut inputs);
            model.apply(&inputs);
            expected.apply(&inputs);
            model.step(dt_s);
            expected.step(dt_s);
            if step >= 150 && step % 5 == 0 && step < 350 {
                let tet = tets[(step as usize - 150) / 5];
                let change = editable.apply(&MeshEdit::Remove { tets: vec![tet] }).unwrap();
                model.topology_changed(editable.mesh(), &change).unwrap();
                expected.topology_changed(editable.mesh(), &change).unwrap();
            }
            if step % 50 == 49 {
                let (found, wanted) = (model.state(), expected.state());
                let moved = |positions_m: &[DVec3]| -> Vec<DVec3> {
                    positions_m.iter().zip(&mesh.positions_m).map(|(p, rest)| *p - *rest).collect()
                };
                let off = relative_difference(&moved(found.positions_m), &moved(wanted.positions_m));
                assert!(off < 1e-9, "{law:?} after {step} steps: {off:e}");
                let off = relative_difference(found.velocities_m_per_s, wanted.velocities_m_per_s);
                assert!(off < 1e-9, "{law:?} after {step} steps, velocity: {off:e}");
                if !inputs.displacements.is_empty() {
                    let off =
                        relative_difference(model.constraint_forces_n(), expected.constraint_forces_n());
                    assert!(off < 1e-9, "{law:?} after {step} steps, force: {off:e}");
                }
            }
        }
        let report = model.report();
        assert_eq!(report.n_recovered_nodes, 0, "{report:?}");
        assert!(report.n_parts >= 2 && u64::from(report.n_parts) == model.parts_of_step(dt_s), "{report:?}");
        assert!(!report.energy_was_limited && report.kinetic_energy_j > 0.0);
    }
}

#[test]
fn steps_and_removals_allocate_nothing_in_the_model_and_its_copies() {
    let (mesh, fixed) = organ();
    let ligament = Attachment {
        node: NodeId(3),
        anchor_m: mesh.positions_m[3] + DVec3::splat(0.02),
        slack_length_m: 0.01,
        stiffness_n_per_m: 5.0,
    };
    let damping = Rayleigh { mass_per_s: 20.0, stiffness_s: 1e-5 };
    let mut body = DynamicBody { attachments: &[ligament], damping, ..body(&mesh, &fixed) };
    body.time_step_s *= 0.8;
    let model = build(body, KernelLaw::StVenantKirchhoff);
    let inputs: Vec<Constraints> = (0..400)
        .map(|step| {
            let mut inputs = Constraints::default();
            constraints(&mesh, step, &mut inputs);
            inputs
        })
        .collect();
    let mut editable = EditableMesh::new(mesh.clone()).unwrap();
    let changes: Vec<_> = removals(&mesh, 40, 8)
        .into_iter()
        .map(|tet| editable.apply(&MeshEdit::Remove { tets: vec![tet] }).unwrap())
        .collect();
    for mut model in [model.duplicate(), model.duplicate().duplicate()] {
        let count = allocation_counter::measure(|| {
            for (step, inputs) in inputs.iter().enumerate() {
                model.apply(inputs);
                model.step(body.time_step_s);
                if step % 10 == 9 {
                    model.topology_changed(editable.mesh(), &changes[step / 10]).unwrap();
                }
                if step == 200 {
                    model.set_gravity(DVec3::Y);
                }
            }
        });
        assert_eq!(count.count_total, 0);
        assert_eq!(model.report().n_ignored_constraints, 0);
    }
}

/// A block with ligaments and supports, of which every seventh tetrahedron and all at one node go.
struct CutBlock {
    mesh: TetMesh,
    removed: Vec<TetId>,
    /// What remains, on the same nodes.
    rest: TetMesh,
    /// The node that is left without a tetrahedron.
    bare: NodeId,
    fixed: Vec<FixedNode>,
    ligaments: Vec<Attachment>,
    step_s: f64,
}

impl CutBlock {
    fn new() -> Self {
        let mesh = shaken_block([7, 5, 4], SIZE_M, 0.12, 10);
        let ligament = |n: usize| Attachment {
            node: NodeId::from_index(n),
            anchor_m: mesh.positions_m[n] + DVec3::splat(0.01),
            slack_length_m: 0.002,
            stiffness_n_per_m: 3.0,
        };
        let bare = mesh.tetrahedra[0][0];
        let goes = |t: usize| t % 7 == 3 || mesh.tetrahedra[t].contains(&bare);
        let (removed, kept): (Vec<usize>, Vec<usize>) = (0..mesh.tetrahedra.len()).partition(|&t| goes(t));
        let slides = |node| FixedNode { node, axes: [true, false, true] };
        Self {
            removed: removed.iter().map(|&t| TetId::from_index(t)).collect(),
            rest: TetMesh {
                positions_m: mesh.positions_m.clone(),
                tetrahedra: kept.iter().map(|&t| mesh.tetrahedra[t]).collect(),
                ..TetMesh::default()
            },
            bare,
            fixed: nodes_below(&mesh, 0, 0.01).into_iter().map(slides).collect(),
            ligaments: (0..mesh.positions_m.len()).step_by(5).map(ligament).collect(),
            step_s: 0.3 * time_step_s(&mesh),
            mesh,
        }
    }

    fn model(&self, mesh: &TetMesh, law: KernelLaw) -> ExplicitKernel {
        let (attachments, time_step_s) = (&self.ligaments[..], self.step_s);
        let body = body_of(mesh, &self.fixed, time_step_s);
        build(DynamicBody { attachments, time_step_s, ..body }, law)
    }
}

#[test]
fn after_removals_it_equals_a_model_of_the_remaining_mesh() {
    let block = CutBlock::new();
    let mut random = SeededRandom::new(11);
    let moved: Vec<DVec3> = block
        .mesh
        .positions_m
        .iter()
        .map(|p| *p + DVec3::from_array(std::array::from_fn(|_| random.uniform_in(-1e-3, 1e-3))))
        .collect();
    for law in LAWS {
        let mut cut = block.model(&block.mesh, law);
        let mut editable = EditableMesh::new(block.mesh.clone()).unwrap();
        let change = editable.apply(&MeshEdit::Remove { tets: block.removed.clone() }).unwrap();
        cut.topology_changed(editable.mesh(), &change).unwrap();
        let mut fresh = block.model(&block.rest, law);
        for model in [&mut cut, &mut fresh] {
            model.take_over(&moved);
            model.step(block.step_s);
        }
        assert_same_kernel_forces(&cut, &fresh, block.bare);
        let mut compacted = compacted_in_motion(&mut cut, &mut editable, block.step_s);
        remove_the_rest(&mut compacted, &mut editable, block.step_s);
    }
}

fn assert_same_kernel_forces(cut: &ExplicitKernel, fresh: &ExplicitKernel, bare: NodeId) {
    let (law, n_nodes) = (cut.kernel().law(), cut.state().positions_m.len());
    let forces = |model: &ExplicitKernel| {
        let mut force_n = vec![DVec3::ZERO; n_nodes];
        model.kernel().forces_into(&mut force_n);
        let outer = (0..n_nodes).map(|n| model.kernel().outer_force_n(NodeId::from_index(n)));
        (force_n, outer.collect::<Vec<_>>())
    };
    let (found, expected) = (forces(cut), forces(fresh));
    assert!(relative_difference(&found.0, &expected.0) < 1e-12, "{law:?}");
    assert_eq!(found.0[bare.index()], DVec3::ZERO);
    let live = |n: &usize| cut.kernel().has_tets(NodeId::from_index(*n));
    for n in (0..n_nodes).filter(live) {
        assert!((found.1[n] - expected.1[n]).length() < 1e-14 * 10.0, "{n}");
    }
}

/// A copy that is compacted in the middle of a motion and moves on with the model.
fn compacted_in_motion(cut: &mut ExplicitKernel, editable: &mut EditableMesh, step_s: f64) -> ExplicitKernel {
    let law = cut.kernel().law();
    let mut compacted = cut.clone();
    let change = editable.compact();
    compacted.topology_changed(editable.mesh(), &change).unwrap();
    assert_eq!(compacted.report().n_reanalyses, 1);
    for _ in 0..200 {
        cut.step(step_s);
        compacted.step(step_s);
    }
    let pick = |vectors: &[DVec3]| -> Vec<DVec3> {
        let stays = change.nodes.new_ids.iter().map(Option::is_some);
        vectors.iter().zip(stays).filter(|(_, stays)| *stays).map(|(v, _)| *v).collect()
    };
    let found = compacted.state();
    let off = relative_difference(found.velocities_m_per_s, &pick(cut.state().velocities_m_per_s));
    assert!(off < 1e-9, "{law:?}: {off:e}");
    let off = relative_difference(found.positions_m, &pick(cut.state().positions_m));
    assert!(off < 1e-12, "{law:?}: {off:e}");
    compacted
}

/// Cuts down to nothing.
fn remove_the_rest(model: &mut ExplicitKernel, editable: &mut EditableMesh, step_s: f64) {
    let tets = editable.topology().live_tets().collect();
    let change = editable.apply(&MeshEdit::Remove { tets }).unwrap();
    model.topology_changed(editable.mesh(), &change).unwrap();
    model.step(step_s);
    let change = editable.compact();
    model.topology_changed(editable.mesh(), &change).unwrap();
    model.step(step_s);
    assert!(model.state().positions_m.is_empty());
    assert_eq!(model.duplicate().report().kinetic_energy_j, 0.0);
}

fn body_of<'a>(mesh: &'a TetMesh, fixed: &'a [FixedNode], time_step_s: f64) -> DynamicBody<'a> {
    let damping = Rayleigh { mass_per_s: 20.0, stiffness_s: 0.0 };
    let gravity_m_per_s2 = GRAVITY_M_PER_S2;
    DynamicBody { fixed, gravity_m_per_s2, damping, time_step_s, ..DynamicBody::new(mesh, DENSITY_KG_PER_M3) }
}

#[test]
fn limiting_tetrahedra_become_heavier_when_the_body_is_cut_and_no_step_is_divided() {
    let (mesh, fixed) = organ();
    for law in LAWS {
        let mut whole = DynamicBody { most_parts: 1, ..body(&mesh, &fixed) };
        let params = ExplicitKernelParams::new(whole, law, &[]);
        let params = ExplicitKernelParams { materials: &[material()], ..params };
        whole.time_step_s = 0.95 * ExplicitKernel::stable_step(&params).unwrap().step_s;
        let mut model = build(whole, law);
        assert_eq!((model.report().n_mass_scaled_nodes, model.parts_of_step(whole.time_step_s)), (0, 1));
        let mass_kg = |model: &ExplicitKernel| -> f64 {
            (0..mesh.positions_m.len()).map(|n| model.kernel().mass_kg(NodeId::from_index(n))).sum()
        };
        let before_kg = mass_kg(&model);
        let mut editable = EditableMesh::new(mesh.clone()).unwrap();
        let tets = removals(&mesh, 600, 13);
        let gone_m3: f64 = tets.iter().map(|&t| mesh.tet_volume_m3(t)).sum();
        let change = editable.apply(&MeshEdit::Remove { tets: tets[..1].to_vec() }).unwrap();
        model.topology_changed(editable.mesh(), &change).unwrap();
        let n_scaled = model.report().n_mass_scaled_nodes;
        assert!(n_scaled > 0);
        assert_eq!(model.parts_of_step(whole.time_step_s), 1);
        let change = editable.apply(&MeshEdit::Remove { tets: tets[1..].to_vec() }).unwrap();
        model.topology_changed(editable.mesh(), &change).unwrap();
        // Their weight stays that of the tissue.
        let gone_kg = before_kg - mass_kg(&model);
        assert!((gone_kg / (DENSITY_KG_PER_M3 * gone_m3) - 1.0).abs() < 1e-9);
        let mut inputs = Constraints::default();
        for step in 0..3000 {
            constraints(&mesh, step, &mut inputs);
            inputs.forces.clear();
            model.apply(&inputs);
            model.step(whole.time_step_s);
            let report = model.report();
            // Tissue that turns inside out changes its law, which may cost energy that has to be taken out.
            let is_calm = !report.energy_was_limited || report.n_quarantined_tets > 0;
            assert!(is_calm && report.n_parts == 1, "step {step}: {report:?}");
        }
        // Everything gone: nothing is heavier.
        let tets = editable.topology().live_tets().collect();
        let change = editable.apply(&MeshEdit::Remove { tets }).unwrap();
        model.topology_changed(editable.mesh(), &change).unwrap();
        assert_eq!(model.report().n_mass_scaled_nodes, 0);
        // With room for it, the step is divided instead.
        let mut model = build(DynamicBody { most_parts: 4, ..whole }, law);
        let mut editable = EditableMesh::new(mesh.clone()).unwrap();
        let change = editable.apply(&MeshEdit::Remove { tets: vec![TetId(0)] }).unwrap();
        model.topology_changed(editable.mesh(), &change).unwrap();
        assert_eq!(model.report().n_mass_scaled_nodes, 0);
        assert!(model.parts_of_step(whole.time_step_s) > 1);
    }
}

#[test]
fn a_snapshot_brings_the_motion_back() {
    let (mesh, fixed) = organ();
    let body = body(&mesh, &fixed);
    let mut model = build(body, KernelLaw::StVenantKirchhoff);
    let mut inputs = Constraints::default();
    let mut advance = |model: &mut ExplicitKernel| {
        for step in 200..300 {
            constraints(&mesh, step, &mut inputs);
            model.apply(&inputs);
            model.step(body.time_step_s);
        }
        StateHash::of_model(model, &[], &[])
    };
    advance(&mut model);
    let snapshot = model.snapshot();
    let expected = advance(&mut model);
    model.restore(&snapshot);
    assert_eq!(advance(&mut model), expected);
}
