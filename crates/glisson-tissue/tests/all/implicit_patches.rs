//! Local models of implicit bodies: entries of the inverse of their factor, against whole solutions with it.

use crate::model_meshes::{nodes_below, shaken_block};
use glisson_mesh::math::{DVec3, SeededRandom};
use glisson_mesh::mesh::{NodeId, TetMesh};
use glisson_tissue::material::{LinearElastic, StableNeoHooke};
use glisson_tissue::model::implicit::{ImplicitEuler, ImplicitLaw, ImplicitParams};
use glisson_tissue::model::kernel::KernelPath;
use glisson_tissue::model::{
    Answered, Constraints, DeformableModel, DynamicBody, FixedNode, LocalModel, LocalWork, NodalForce,
    Rayleigh,
};

const STEP_S: f64 = 2e-3;
const DENSITY_KG_PER_M3: f64 = 1060.0;

/// A block that is held on one side and slides along another.
fn body() -> (TetMesh, ImplicitEuler) {
    let mesh = shaken_block([7, 6, 6], DVec3::new(0.09, 0.08, 0.08), 0.15, 4);
    let material = LinearElastic::from_young_poisson(5e3, 0.45, DENSITY_KG_PER_M3).unwrap();
    let below = nodes_below(&mesh, 2, 2e-3);
    let aside = nodes_below(&mesh, 0, 2e-3);
    let mut fixed: Vec<FixedNode> = below.iter().map(|&node| FixedNode { node, axes: [true; 3] }).collect();
    let slides = aside.iter().filter(|node| !below.contains(node));
    fixed.extend(slides.map(|&node| FixedNode { node, axes: [true, false, false] }));
    let body = DynamicBody {
        fixed: &fixed,
        damping: Rayleigh::of_mass(20.0),
        time_step_s: STEP_S,
        ..DynamicBody::new(&mesh, DENSITY_KG_PER_M3)
    };
    let law = ImplicitLaw::StableNeoHooke(StableNeoHooke::from(&material));
    let model = ImplicitEuler::build(&ImplicitParams::new(body, &law)).unwrap();
    (mesh, model)
}

/// `n` different nodes, held ones among them.
fn some_nodes(mesh: &TetMesh, n: usize, random: &mut SeededRandom) -> Vec<NodeId> {
    let mut nodes: Vec<(u64, NodeId)> =
        (0..mesh.positions_m.len()).map(|n| (random.uniform().to_bits(), NodeId::from_index(n))).collect();
    nodes.sort_unstable();
    nodes.into_iter().take(n).map(|(_, node)| node).collect()
}

fn asked(model: &mut dyn DeformableModel, patch: &[NodeId], period_s: f64, work: LocalWork) -> LocalModel {
    let (mut work, mut out) = (work, LocalModel::new());
    model.local_model_into(patch, period_s, &mut work, &mut out);
    out
}

fn work() -> LocalWork {
    LocalWork::with_room_for(500)
}

/// What forces do by the whole factor.
fn answer(model: &mut ImplicitEuler, forces: &[NodalForce]) -> Vec<DVec3> {
    let mut moves_m = vec![DVec3::ZERO; model.state().positions_m.len()];
    model.answer_into(forces, &mut moves_m, Answered::Everywhere);
    moves_m
}

/// Compares every column of a local model with a whole solution.
fn check(model: &mut ImplicitEuler, patch: &[NodeId], period_s: f64) {
    let found = asked(model, patch, period_s, work());
    assert_eq!((found.n_rings, found.n_left_out), (None, 0));
    for (j, &node) in patch.iter().enumerate() {
        for axis in DVec3::AXES {
            let moves_m = answer(model, &[NodalForce { node, force_n: axis }]);
            let largest = moves_m.iter().fold(0.0, |most: f64, m| most.max(m.length()));
            for (i, of) in patch.iter().enumerate() {
                let off = (found.tensor_m_per_n(i, j) * axis).distance(moves_m[of.index()]);
                assert!(off <= 1e-11 * largest, "{i} {j}: {off:e} of {largest:e}");
                assert_eq!(found.tensor_m_per_n(i, j), found.tensor_m_per_n(j, i).transpose());
            }
        }
    }
}

#[test]
fn a_patch_has_the_entries_of_whole_solutions_before_and_after_a_new_factor() {
    let (mesh, mut model) = body();
    let mut random = SeededRandom::new(5);
    let many = some_nodes(&mesh, LocalModel::MOST_NODES, &mut random);
    check(&mut model, &many, STEP_S);
    check(&mut model, &many[..3], STEP_S);
    let pull = NodalForce { node: many[7], force_n: DVec3::new(0.3, 0.1, 0.4) };
    model.apply(&Constraints { displacements: vec![], forces: vec![pull] });
    // A step of another length has a factor of its own.
    model.step(4.0 * STEP_S);
    assert_eq!(model.step_report().n_factors, 1);
    check(&mut model, &many[..20], 4.0 * STEP_S);
}

#[test]
fn answers_at_the_nodes_of_the_forces_have_the_bits_of_whole_ones() {
    let (mesh, mut model) = body();
    let mut random = SeededRandom::new(8);
    let mut at_forces_m = vec![DVec3::ZERO; mesh.positions_m.len()];
    for round in 0..3 {
        for n in [1, 2, 12, 60, mesh.positions_m.len()] {
            let mut forces: Vec<NodalForce> = some_nodes(&mesh, n, &mut random)
                .into_iter()
                // Some are there to be asked about alone, others nearly so.
                .map(|node| NodalForce { node, force_n: DVec3::Z * (3.0 * random.uniform() - 1.0).max(0.0) })
                .collect();
            forces.sort_by_key(|force| force.node);
            let whole_m = answer(&mut model, &forces);
            model.answer_into(&forces, &mut at_forces_m, Answered::AtForces);
            for NodalForce { node, .. } in forces {
                assert_eq!(at_forces_m[node.index()], whole_m[node.index()], "{n} nodes in round {round}");
            }
        }
        // Another shape and step, and so another factor.
        let pull = NodalForce { node: NodeId::from_index(100), force_n: DVec3::new(0.3, 0.1, 0.4) };
        model.apply(&Constraints { displacements: vec![], forces: vec![pull] });
        model.step(4.0 * STEP_S * f64::from(round + 1));
    }
}

#[test]
fn what_was_asked_before_changes_no_bit() {
    let (mesh, mut model) = body();
    let mut random = SeededRandom::new(6);
    let pristine = model.duplicate();
    // Together more nodes than are kept.
    for n in [3, 40, 90, 96, 7, 60] {
        let patch = some_nodes(&mesh, n, &mut random);
        let found = asked(&mut model, &patch, STEP_S, work().telling_drift());
        for path in KernelPath::available() {
            let mut other = work().telling_drift();
            other.set_path(path);
            let fresh = asked(&mut *pristine.duplicate(), &patch, STEP_S, other);
            assert_eq!(found, fresh, "{n} nodes, {}", path.name());
        }
    }
}

#[test]
fn drift_is_what_the_momentum_does() {
    let (mesh, mut model) = body();
    let mut random = SeededRandom::new(7);
    let mut velocity = || DVec3::new(random.normal(), random.normal(), random.normal()) * 0.1;
    let velocities: Vec<DVec3> = mesh.positions_m.iter().map(|_| velocity()).collect();
    model.set_velocities(&velocities);
    let patch = some_nodes(&mesh, 30, &mut random);
    let found = asked(&mut model, &patch, STEP_S, work().telling_drift());
    let moving = model.state().velocities_m_per_s.to_vec();
    let momentum = |n: usize| NodalForce {
        node: NodeId::from_index(n),
        force_n: moving[n] * (model.mass_kg(NodeId::from_index(n)) * (1.0 / STEP_S + 20.0)),
    };
    let forces: Vec<NodalForce> = (0..moving.len()).map(momentum).collect();
    let moves_m = answer(&mut model, &forces);
    let largest = moves_m.iter().fold(0.0, |most: f64, m| most.max(m.length()));
    assert!(largest > 1e-5);
    for (node, drift_m) in patch.iter().zip(&found.drift_m) {
        assert!(drift_m.distance(moves_m[node.index()]) <= 1e-11 * largest, "{node}");
    }
}
