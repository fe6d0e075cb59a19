//! Factors of implicit bodies that are made in slices over several steps.

use crate::implicit::bits;
use crate::model_meshes::{nodes_below, shaken_block};
use glisson_mesh::math::DVec3;
use glisson_mesh::mesh::edit::{EditableMesh, MeshEdit};
use glisson_mesh::mesh::{NodeId, TetId, TetMesh};
use glisson_tissue::material::{LinearElastic, PronySeries, PronyTerm};
use glisson_tissue::model::implicit::{ImplicitEuler, ImplicitLaw, ImplicitParams, ImplicitReport};
use glisson_tissue::model::{
    Constraints, DeformableModel, DynamicBody, FixedNode, ImposedDisplacement, LocalModel, LocalWork,
    ModelUndo, Rayleigh, StepAnswer,
};

const SIZE_M: DVec3 = DVec3::new(0.12, 0.1, 0.08);
const STEP_S: f64 = 0.01;
/// Steps after which a factor has become due, and has come to serve, for certain.
const N_STEPS: usize = 120;

/// A block that a tool drags, so that its factors soon are old.
struct Dragged {
    mesh: TetMesh,
    fixed: Vec<FixedNode>,
    held: Vec<NodeId>,
    law: ImplicitLaw,
    series: PronySeries,
}

impl Dragged {
    fn new() -> Self {
        let mesh = shaken_block([8, 7, 7], SIZE_M, 0.15, 12);
        let fixed = nodes_below(&mesh, 2, 0.002);
        let material = LinearElastic::from_young_poisson(5e3, 0.45, 1000.0).unwrap();
        let held = (0..mesh.positions_m.len())
            .filter(|&n| mesh.positions_m[n].z > 0.076)
            .filter(|&n| mesh.positions_m[n].distance(SIZE_M * DVec3::new(0.5, 0.5, 1.0)) < 0.02)
            .map(NodeId::from_index)
            .collect();
        Self {
            mesh,
            fixed: fixed.into_iter().map(FixedNode::all_axes).collect(),
            held,
            law: ImplicitLaw::neo_hooke(&material),
            series: PronySeries::new(&[PronyTerm { share: 0.3, time_s: 0.1 }]).unwrap(),
        }
    }

    fn model(&self) -> ImplicitEuler {
        let body = DynamicBody {
            fixed: &self.fixed,
            damping: Rayleigh { mass_per_s: 1.0, stiffness_s: 0.001 },
            time_step_s: STEP_S,
            ..DynamicBody::new(&self.mesh, 1000.0)
        };
        let params =
            ImplicitParams { relaxation: Some(&self.series), ..ImplicitParams::new(body, &self.law) };
        ImplicitEuler::build(&params).unwrap()
    }

    fn constraints(&self, step: usize) -> Constraints {
        let (phase, reach_m) = (0.05 * step as f64, 0.03);
        let displacement_m =
            DVec3::new(libm::sin(phase), libm::sin(0.7 * phase), -0.3 * libm::sin(phase).abs()) * reach_m;
        let of_node = |&node: &NodeId| ImposedDisplacement { node, displacement_m };
        Constraints { displacements: self.held.iter().map(of_node).collect(), forces: Vec::new() }
    }

    /// Steps from `step` on until a factor was ordered; returns the next step.
    fn until_pending(&self, model: &mut ImplicitEuler, from: usize) -> usize {
        for step in from..from + N_STEPS {
            model.apply(&self.constraints(step));
            model.step(STEP_S);
            if model.step_report().factor_is_pending {
                return step + 1;
            }
        }
        panic!("no factor became due");
    }

    fn go_on(&self, model: &mut dyn DeformableModel, steps: std::ops::Range<usize>) {
        for step in steps {
            model.apply(&self.constraints(step));
            model.step(STEP_S);
        }
    }
}

fn version(model: &ImplicitEuler) -> u64 {
    match model.step_answer() {
        StepAnswer::Coupled { version } => version,
        other => panic!("{other:?}"),
    }
}

/// The compliance of a patch away from the tool.
fn compliance(model: &mut ImplicitEuler, patch: &[NodeId]) -> Vec<[u64; 9]> {
    let (mut work, mut out) = (LocalWork::with_room_for(500), LocalModel::new());
    model.local_model_into(patch, STEP_S, &mut work, &mut out);
    assert_eq!(out.n_rings, None, "the factor serves");
    let n = out.nodes.len();
    (0..n * n).map(|k| out.tensor_m_per_n(k / n, k % n).to_cols_array().map(f64::to_bits)).collect()
}

#[test]
fn the_old_factor_serves_until_the_new_one_is_complete() {
    let body = Dragged::new();
    let mut model = body.model();
    let patch: Vec<NodeId> = (0..body.mesh.positions_m.len())
        .filter(|&n| body.mesh.positions_m[n].x > 0.118 && body.mesh.positions_m[n].z > 0.03)
        .map(NodeId::from_index)
        .take(6)
        .collect();
    let (mut n_swaps, mut n_slices, mut known) = (0, 0, compliance(&mut model, &patch));
    let mut before = version(&model);
    for step in 0..N_STEPS {
        let was_pending = model.step_report().factor_is_pending;
        body.go_on(&mut model, step..step + 1);
        let ImplicitReport { n_factors, factor_is_pending, .. } = *model.step_report();
        let (now, of_patch) = (version(&model), compliance(&mut model, &patch));
        assert_eq!(now, before + u64::from(n_factors));
        assert_eq!(of_patch == known, n_factors == 0, "step {step}");
        if n_factors > 0 && was_pending {
            assert!(!factor_is_pending && (3..=20).contains(&n_slices), "{n_slices} slices");
            n_swaps += 1;
        }
        n_slices = if factor_is_pending { n_slices + 1 } else { 0 };
        (known, before) = (of_patch, now);
    }
    assert!(n_swaps >= 2, "{n_swaps} factors came to serve");
}

#[test]
fn with_a_factor_pending_a_restored_snapshot_and_a_copy_have_the_same_bits() {
    let body = Dragged::new();
    let mut model = body.model();
    let ordered_at = body.until_pending(&mut model, 0);
    let step = ordered_at + 2;
    body.go_on(&mut model, ordered_at..step);
    assert!(model.step_report().factor_is_pending);
    let (snapshot, at_snapshot) = (model.snapshot(), bits(&model));
    let mut copy = model.duplicate();
    body.go_on(&mut model, step..step + 60);
    let expected = bits(&model);
    let mut fresh = body.model();
    fresh.restore(&snapshot);
    assert_eq!(bits(&fresh), at_snapshot);
    // Back from a state with another factor, pending or not.
    body.until_pending(&mut model, step + 60);
    model.restore(&snapshot);
    assert_eq!(model.snapshot(), snapshot);
    for model in [&mut model, &mut fresh, &mut *copy as &mut dyn DeformableModel] {
        body.go_on(model, step..step + 60);
        assert_eq!(bits(model), expected);
    }
    // A snapshot without one gives up what is pending.
    let earlier = body.model().snapshot();
    body.until_pending(&mut fresh, step + 60);
    fresh.restore(&earlier);
    let mut anew = body.model();
    for model in [&mut fresh, &mut anew] {
        body.go_on(model, 0..20);
    }
    assert_eq!(bits(&fresh), bits(&anew));
}

/// The slices done are part of the state: two states that differ in nothing else are told apart.
#[test]
fn what_is_pending_is_part_of_the_history() {
    let body = Dragged::new();
    let mut model = body.model();
    let n_without = model.history().len();
    let step = body.until_pending(&mut model, 0);
    let n_with = model.history().len();
    assert!(n_with > n_without);
    let slices_done = |model: &ImplicitEuler| model.history()[n_with - 5 - 12 * body.mesh.tetrahedra.len()];
    assert_eq!(slices_done(&model), 1.0);
    body.go_on(&mut model, step..step + 1);
    assert_eq!(slices_done(&model), 2.0);
}

#[test]
fn a_factor_that_is_needed_at_once_replaces_the_pending_one() {
    let body = Dragged::new();
    let mut model = body.model();
    let step = body.until_pending(&mut model, 0);
    let snapshot = model.snapshot();
    let report = |model: &mut ImplicitEuler, step_s: f64| {
        model.apply(&body.constraints(step));
        model.step(step_s);
        (model.step_report().n_factors > 0, model.step_report().factor_is_pending)
    };
    assert_eq!(report(&mut model, STEP_S), (false, true));
    model.restore(&snapshot);
    assert_eq!(report(&mut model, STEP_S / 4.0), (true, false), "another step length");

    // Tetrahedra in quarantine.
    model.restore(&snapshot);
    let mut shape = model.state().positions_m.to_vec();
    shape[body.held[0].index()].z -= 0.05;
    model.take_over(&shape);
    assert_eq!(report(&mut model, STEP_S), (true, false), "quarantine");
    assert!(model.step_report().n_quarantined_tets > 0);

    // An edit.
    model.restore(&snapshot);
    let before = version(&model);
    let mut editable = EditableMesh::new(body.mesh.clone()).unwrap();
    let change = editable.apply(&MeshEdit::Remove { tets: vec![TetId(0)] }).unwrap();
    model.topology_changed(editable.mesh(), &change).unwrap();
    assert_eq!(version(&model), before + 1);
    assert_eq!(report(&mut model, STEP_S), (false, true), "an edit");
    assert_eq!(report(&mut model, STEP_S / 4.0), (true, false), "another step length after an edit");
}

/// Takes out a slot between two planes, from the far side to the middle, and one more tetrahedron.
fn slot(mesh: &TetMesh) -> [MeshEdit; 2] {
    let center = |t: &[NodeId; 4]| t.iter().map(|n| mesh.positions_m[n.index()]).sum::<DVec3>() * 0.25;
    let is_in = |c: DVec3| (0.055..0.065).contains(&c.x) && c.y > 0.5 * SIZE_M.y;
    let tets = mesh.tetrahedra.iter().enumerate().filter(|(_, t)| is_in(center(t)));
    let tets: Vec<TetId> = tets.map(|(t, _)| TetId::from_index(t)).collect();
    assert!(tets.len() > 30);
    [MeshEdit::Remove { tets }, MeshEdit::Remove { tets: vec![TetId(3)] }]
}

/// After an edit the old factor serves, with more iterations; the new one comes in a few steps, and with it the patches' entries.
#[test]
fn the_factor_of_an_edited_mesh_comes_in_stages() {
    let body = Dragged::new();
    let mut model = body.model();
    body.go_on(&mut model, 0..10);
    let mut mesh = EditableMesh::new(body.mesh.clone()).unwrap();
    let first = mesh.apply(&slot(&body.mesh)[0]).unwrap();
    model.topology_changed(mesh.mesh(), &first).unwrap();
    let (mut work, mut out) = (LocalWork::with_room_for(500), LocalModel::new());
    let patch = [NodeId::from_index(body.mesh.positions_m.len() - 1)];
    let (mut iterations, mut copies, mut n_steps) = (Vec::new(), Vec::new(), 0);
    while model.step_report().factor_is_pending || n_steps == 0 {
        body.go_on(&mut model, 10 + n_steps..11 + n_steps);
        n_steps += 1;
        assert!(n_steps < 30 && !model.report().missed_tolerance, "{n_steps}: {:?}", model.step_report());
        model.local_model_into(&patch, STEP_S, &mut work, &mut out);
        assert_eq!(out.n_rings.is_none(), !model.step_report().factor_is_pending);
        iterations.push(model.step_report().cg_iterations);
        copies.push((n_steps, model.duplicate()));
    }
    assert!(n_steps > 5 && model.step_report().n_factors == 1);
    assert!(iterations.iter().all(|n| *n <= 40), "{iterations:?}");
    body.go_on(&mut model, 10 + n_steps..60);
    for (made, mut copy) in copies {
        body.go_on(copy.as_mut(), 10 + made..60);
        assert_eq!(bits(copy.as_ref()), bits(&model), "a copy after {made} steps");
    }
}

/// An edit that comes before the factor is there begins it anew; what is taken back goes on where it was.
#[test]
fn an_edit_overtakes_the_factor_and_is_taken_back() {
    let body = Dragged::new();
    let mut model = body.model();
    let mut mesh = EditableMesh::new(body.mesh.clone()).unwrap();
    let [first, second] = slot(&body.mesh);
    for n_steps in [0, 1, 2, 4, 7] {
        let mut model: Box<dyn DeformableModel> = Box::new(model.clone());
        let mut mesh = mesh.clone();
        let change = mesh.apply(&first).unwrap();
        model.topology_changed(mesh.mesh(), &change).unwrap();
        body.go_on(model.as_mut(), 0..n_steps);
        let mut kept = model.duplicate();
        let change = mesh.apply(&second).unwrap();
        let mut undo = ModelUndo::default();
        model.follow_saving(mesh.mesh(), &change, &mut undo).unwrap();
        body.go_on(model.as_mut(), n_steps..n_steps + 25);
        assert!(!model.report().missed_tolerance);
        undo.put_back(&mut model);
        for model in [&mut model, &mut kept] {
            body.go_on(model.as_mut(), n_steps..n_steps + 25);
        }
        assert_eq!(bits(model.as_ref()), bits(kept.as_ref()), "{n_steps} steps");
    }
    // One that is restored has the factor at once, before it is there and after.
    let before = model.snapshot();
    let change = mesh.apply(&first).unwrap();
    model.topology_changed(mesh.mesh(), &change).unwrap();
    body.go_on(&mut model, 0..2);
    let pending = model.snapshot();
    for (snapshot, n_steps) in [(&before, 0), (&pending, 25)] {
        body.go_on(&mut model, 2..2 + n_steps);
        model.restore(snapshot);
        body.go_on(&mut model, 2..3);
        assert!(!model.step_report().factor_is_pending && !model.report().missed_tolerance);
    }
}

#[test]
fn slices_and_the_exchange_allocate_nothing() {
    let body = Dragged::new();
    let mut model = body.model();
    let inputs: Vec<Constraints> = (0..N_STEPS).map(|step| body.constraints(step)).collect();
    let mut n_swaps = 0;
    let mut was_pending = false;
    for input in &inputs {
        let count = allocation_counter::measure(|| {
            model.apply(input);
            model.step(STEP_S);
        });
        assert_eq!(count.count_total, 0);
        let ImplicitReport { n_factors, factor_is_pending, .. } = *model.step_report();
        n_swaps += u32::from(n_factors > 0 && was_pending);
        was_pending = factor_is_pending;
    }
    assert!(n_swaps >= 2, "{n_swaps} factors came to serve");
}
