//! The same bits at any number of threads, twice, and in copies.

use glisson_mesh::math::DVec3;
use glisson_mesh::mesh::TetId;
use glisson_mesh::mesh::edit::{EditableMesh, MeshEdit, TopologyChange};
use glisson_tissue::model::StateHash;
use glisson_tissue::model::kernel::KernelLaw;
use glisson_tissue::model::{Constraints, DeformableModel};

use crate::team::team;

use super::{body, build, constraints, organ, removals};

const LONG_STEPS: u64 = 10_000;
const LONG_REMOVALS: usize = 500;

/// A long palpation while the organ is eaten away; the model is replaced by its copy after `copied_at` steps.
fn long_run(law: KernelLaw, n_threads: usize, copied_at: Option<u64>) -> StateHash {
    let (mesh, fixed) = organ();
    let mut first = build(body(&mesh, &fixed), law);
    first.set_workers(team(n_threads));
    let mut model: Box<dyn DeformableModel> = Box::new(first);
    let dt_s = 0.5 * body(&mesh, &fixed).time_step_s;
    let mut editable = EditableMesh::new(mesh.clone()).unwrap();
    let mut change = TopologyChange::default();
    let tets = removals(&mesh, LONG_REMOVALS, 6);
    let every = LONG_STEPS / LONG_REMOVALS as u64;
    let mut inputs = Constraints::default();
    for step in 0..LONG_STEPS {
        constraints(&mesh, step, &mut inputs);
        model.apply(&inputs);
        if copied_at == Some(step) {
            assert!(!inputs.displacements.is_empty(), "in contact");
            model = model.duplicate();
        }
        model.step(dt_s);
        let report = model.report();
        assert!(!report.energy_was_limited && report.n_recovered_nodes == 0, "step {step}: {report:?}");
        if step % every == every - 1 {
            let tet = tets[(step / every) as usize];
            editable.remove_into(&[tet], &mut change).unwrap();
            model.topology_changed(editable.mesh(), &change).unwrap();
        }
    }
    let live: Vec<bool> = (0..mesh.tetrahedra.len()).map(|t| !tets.contains(&TetId::from_index(t))).collect();
    assert!(model.state().positions_m.iter().all(|p| p.is_finite()));
    StateHash::of_model(model.as_ref(), &live, &[])
}

fn check_long_runs(law: KernelLaw) {
    let expected = long_run(law, 1, None);
    assert_eq!(long_run(law, 1, Some(5_017)), expected, "again, and copied");
    assert_eq!(long_run(law, 2, None), expected, "2 threads");
    assert_eq!(long_run(law, 4, Some(7_233)), expected, "4 threads, copied");
}

#[test]
fn long_linear_runs_have_the_same_bits_at_any_number_of_threads_and_in_copies() {
    check_long_runs(KernelLaw::Linear);
}

#[test]
fn long_st_venant_kirchhoff_runs_have_the_same_bits_at_any_number_of_threads_and_in_copies() {
    check_long_runs(KernelLaw::StVenantKirchhoff);
}

#[test]
fn a_copy_shares_nothing() {
    let (mesh, fixed) = organ();
    let body = body(&mesh, &fixed);
    let mut model = build(body, KernelLaw::StVenantKirchhoff);
    let mut inputs = Constraints::default();
    let mut advance = |model: &mut dyn DeformableModel, steps: std::ops::Range<u64>| {
        for step in steps {
            constraints(&mesh, step, &mut inputs);
            model.apply(&inputs);
            model.step(body.time_step_s);
        }
    };
    advance(&mut model, 0..100);
    let hash = |model: &dyn DeformableModel| StateHash::of_model(model, &[], &[]);
    let mut copy = model.duplicate();
    let before = hash(&model);
    advance(copy.as_mut(), 100..200);
    copy.set_gravity(DVec3::ZERO);
    let mut editable = EditableMesh::new(mesh.clone()).unwrap();
    let change = editable.apply(&MeshEdit::Remove { tets: removals(&mesh, 20, 7) }).unwrap();
    copy.topology_changed(editable.mesh(), &change).unwrap();
    assert_eq!(hash(&model), before);
    let mut again = model.duplicate();
    advance(again.as_mut(), 100..200);
    advance(&mut model, 100..200);
    assert_eq!(hash(&model), hash(again.as_ref()));
}
