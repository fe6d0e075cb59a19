//! The same bits at any number of threads, twice, and in copies.

use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::mpsc::{Sender, channel};
use std::sync::{Arc, Barrier, Mutex};

use glisson_mesh::math::DVec3;
use glisson_mesh::mesh::TetId;
use glisson_mesh::mesh::edit::{EditableMesh, MeshEdit, TopologyChange};
use glisson_tissue::model::StateHash;
use glisson_tissue::model::explicit_kernel::SharedWorkers;
use glisson_tissue::model::kernel::{KernelLaw, Sequential, Task, Workers};
use glisson_tissue::model::{Constraints, DeformableModel};

use super::{body, build, constraints, organ, removals};

/// Threads that wait for work; tasks are taken from the last to the first.
struct Team {
    orders: Vec<Sender<(usize, Task, Arc<AtomicUsize>)>>,
    done: Arc<Barrier>,
    turn: Mutex<()>,
}

fn take_tasks(n_tasks: usize, task: &Task, taken: &AtomicUsize) {
    loop {
        let i = taken.fetch_add(1, Ordering::Relaxed);
        if i >= n_tasks {
            return;
        }
        task(n_tasks - 1 - i);
    }
}

impl Team {
    fn shared(n_threads: usize) -> SharedWorkers {
        if n_threads == 1 {
            return Arc::new(Sequential);
        }
        let done = Arc::new(Barrier::new(n_threads));
        let orders = (1..n_threads)
            .map(|_| {
                let (order, orders) = channel::<(usize, Task, Arc<AtomicUsize>)>();
                let done = Arc::clone(&done);
                std::thread::spawn(move || {
                    for (n_tasks, task, taken) in orders {
                        take_tasks(n_tasks, &task, &taken);
                        drop(task);
                        done.wait();
                    }
                });
                order
            })
            .collect();
        Arc::new(Self { orders, done, turn: Mutex::new(()) })
    }
}

impl Workers for Team {
    fn run(&self, n_tasks: usize, task: &Task) {
        let _turn = self.turn.lock().unwrap();
        let taken = Arc::new(AtomicUsize::new(0));
        for order in &self.orders {
            order.send((n_tasks, Arc::clone(task), Arc::clone(&taken))).unwrap();
        }
        take_tasks(n_tasks, task, &taken);
        self.done.wait();
    }
}

const LONG_STEPS: u64 = 10_000;
const LONG_REMOVALS: usize = 500;

/// A long palpation while the organ is eaten away; the model is replaced by its copy after `copied_at` steps.
fn long_run(law: KernelLaw, n_threads: usize, copied_at: Option<u64>) -> StateHash {
    let (mesh, fixed) = organ();
    let mut first = build(body(&mesh, &fixed), law);
    first.set_workers(Team::shared(n_threads));
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
    StateHash::of(&model.state(), &live, &[])
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
    let hash = |model: &dyn DeformableModel| StateHash::of(&model.state(), &[], &[]);
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
