//! Several bodies as one model: each has the bits that it has alone, through steps, edits, undo, refusals and copies.

use std::sync::Arc;

use glisson_mesh::fault;
use glisson_mesh::math::{DVec3, SeededRandom};
use glisson_mesh::mesh::edit::{EdgeSplit, EditableMesh, MeshEdit, TopologyChange};
use glisson_mesh::mesh::{NodeId, TetId, TetMesh};
use glisson_tissue::model::composite::{Composite, CompositePart};
use glisson_tissue::model::rigid::{RigidBody, RigidMotion};
use glisson_tissue::model::{
    Answered, Constraints, Correction, DeformableModel, ImposedDisplacement, LocalModel, LocalWork,
    ModelUndo, NodalForce, follow_edit,
};
use glisson_tissue::workers::Sequential;

use super::bodies::{Body, Kind, kinds};
use super::{mesh_of, next_edit};

/// A body alone, and where its nodes and tetrahedra are in the joint mesh.
struct Alone {
    mesh: EditableMesh,
    model: Box<dyn DeformableModel>,
    nodes: Vec<NodeId>,
    tets: Vec<TetId>,
}

/// Two bodies alone, and both as one model.
struct Twice {
    alone: [Alone; 2],
    mesh: EditableMesh,
    model: Box<dyn DeformableModel>,
}

impl Twice {
    fn new(of: [&Kind; 2]) -> Self {
        let mut joint = TetMesh::default();
        let mut parts = Vec::new();
        let mut random = SeededRandom::new(11);
        let alone = [0, 1].map(|at| {
            let mut mesh = mesh_of(at, 3 + at as u64);
            // Apart from each other, and not in the region that is held.
            mesh.positions_m.iter_mut().for_each(|p| p.z += 0.3 * at as f64);
            let body = Body::of(mesh.clone(), &mut random);
            let (first, first_tet) = (joint.positions_m.len(), joint.tetrahedra.len());
            let moved = |tet: &[NodeId; 4]| tet.map(|n| NodeId::from_index(n.index() + first));
            joint.positions_m.extend_from_slice(&mesh.positions_m);
            joint.tetrahedra.extend(mesh.tetrahedra.iter().map(moved));
            let n_tets = mesh.tetrahedra.len();
            parts.push(CompositePart { model: of[at].build(&body), n_tets, has_clock: false });
            Alone {
                nodes: (first..joint.positions_m.len()).map(NodeId::from_index).collect(),
                tets: (first_tet..joint.tetrahedra.len()).map(TetId::from_index).collect(),
                mesh: EditableMesh::new(mesh).unwrap(),
                model: of[at].build(&body),
            }
        });
        let model = Box::new(Composite::new(parts, Arc::new(Sequential), true));
        Self { alone, mesh: EditableMesh::new(joint).unwrap(), model }
    }

    /// The same edit of one body, alone and in the joint mesh.
    fn edit(&mut self, random: &mut SeededRandom, turn: u64) -> TopologyChange {
        let of = (turn % 2) as usize;
        let Alone { mesh, model, nodes, tets } = &mut self.alone[of];
        let mut trial = mesh.clone();
        // Removals and divisions, which are told in the joint numbers easily.
        let removes = turn.is_multiple_of(3);
        let live: Vec<TetId> = trial.topology().live_tets().collect();
        let tet = live[(random.next_u64() % live.len() as u64) as usize];
        let [a, b, ..] = trial.topology().tet_nodes(tet);
        let split = |edge| MeshEdit::Split { edges: vec![EdgeSplit { edge, fraction: 0.4 }] };
        let (own, joint) = if removes {
            (MeshEdit::Remove { tets: vec![tet] }, MeshEdit::Remove { tets: vec![tets[tet.index()]] })
        } else {
            let edge = trial.topology().edge_between(a, b).unwrap();
            let [a, b] = [a, b].map(|n| nodes[n.index()]);
            (split(edge), split(self.mesh.topology().edge_between(a, b).unwrap()))
        };
        let (own, joint) = (trial.apply(&own).unwrap(), self.mesh.apply(&joint).unwrap());
        *mesh = trial;
        nodes.extend_from_slice(joint.nodes.added.ids());
        tets.extend_from_slice(joint.tets.added.ids());
        model.topology_changed(mesh.mesh(), &own).unwrap();
        self.model.topology_changed(self.mesh.mesh(), &joint).unwrap();
        joint
    }

    fn step(&mut self, step: usize) {
        let mut all = Constraints::default();
        for Alone { model, nodes, .. } in &mut self.alone {
            let node = |at: usize| NodeId::from_index(at % nodes.len());
            let depth_m = DVec3::new(1e-4, 0.0, -2e-4) * (step % 20) as f64;
            let own = Constraints {
                displacements: vec![ImposedDisplacement { node: node(20), displacement_m: depth_m }],
                forces: vec![NodalForce { node: node(25), force_n: DVec3::new(0.01, 0.02, -0.01) }],
            };
            model.apply(&own);
            let joint =
                own.displacements.iter().map(|d| ImposedDisplacement { node: nodes[d.node.index()], ..*d });
            all.displacements.extend(joint);
            all.forces.extend(own.forces.iter().map(|f| NodalForce { node: nodes[f.node.index()], ..*f }));
            model.step(2e-4);
        }
        self.model.apply(&all);
        self.model.step(2e-4);
    }

    fn check(&self, what: &str) {
        let joint = self.model.state();
        let forces_n = self.alone.iter().flat_map(|alone| alone.model.constraint_forces_n());
        assert_eq!(self.model.constraint_forces_n(), forces_n.copied().collect::<Vec<_>>(), "{what}: forces");
        for Alone { model, nodes, .. } in &self.alone {
            let own = model.state();
            assert_eq!(own.positions_m.len(), nodes.len());
            for (n, node) in nodes.iter().enumerate() {
                assert_eq!(joint.positions_m[node.index()], own.positions_m[n], "{what}: {node}");
                let velocity = own.velocities_m_per_s.get(n).copied().unwrap_or(DVec3::ZERO);
                assert_eq!(joint.velocities_m_per_s[node.index()], velocity, "{what}: {node}");
            }
        }
    }
}

/// Neighbours in the list of kinds, so that all meet somebody.
fn pairs() -> Vec<[Kind; 2]> {
    let kinds = kinds();
    (0..kinds.len()).step_by(2).map(|i| [kinds[i], kinds[(i + 5) % kinds.len()]]).collect()
}

#[test]
fn bodies_joined_have_the_bits_that_they_have_alone_through_steps_and_edits() {
    for [a, b] in &pairs() {
        let name = format!("{} and {}", a.name, b.name);
        let mut twice = Twice::new([a, b]);
        let mut random = SeededRandom::new(5);
        let gravity_m_per_s2 = DVec3::new(0.0, -2.0, 0.5);
        twice.model.set_gravity(gravity_m_per_s2);
        twice.alone.iter_mut().for_each(|alone| alone.model.set_gravity(gravity_m_per_s2));
        for turn in 0..6 {
            (0..6).for_each(|step| twice.step(step));
            twice.check(&name);
            twice.edit(&mut random, turn);
        }
        (0..6).for_each(|step| twice.step(step));
        twice.check(&name);
    }
}

fn bits(model: &dyn DeformableModel) -> Vec<u64> {
    let state = model.state();
    let vectors = state.positions_m.iter().chain(state.velocities_m_per_s).chain(model.constraint_forces_n());
    vectors.flat_map(|v| v.to_array()).chain(model.history()).map(f64::to_bits).collect()
}

#[test]
fn undone_edits_of_a_body_leave_no_trace_in_any() {
    for [a, b] in &pairs() {
        let mut twice = Twice::new([a, b]);
        let mut random = SeededRandom::new(8);
        (0..6).for_each(|step| twice.step(step));
        for turn in 0..6 {
            let before = bits(twice.model.as_ref());
            let mut copy = twice.model.duplicate();
            assert_eq!(bits(copy.as_ref()), before, "a copy");
            let mut mesh = twice.mesh.clone();
            let (change, _) = next_edit(&mut random, &mut mesh, turn);
            let mut undo = ModelUndo::default();
            twice.model.save_for_undo(&change, &mut undo);
            twice.model.topology_changed(mesh.mesh(), &change).unwrap();
            twice.model.step(2e-4);
            undo.put_back(&mut twice.model);
            assert!(bits(twice.model.as_ref()) == before, "{} and {}", a.name, b.name);
            copy.step(2e-4);
            twice.model.step(2e-4);
            assert!(bits(copy.as_ref()) == bits(twice.model.as_ref()), "{} and {}", a.name, b.name);
        }
    }
}

#[test]
#[cfg(debug_assertions)]
fn a_refusal_by_any_body_leaves_all_as_they_were() {
    for [a, b] in &pairs() {
        let mut twice = Twice::new([a, b]);
        (0..6).for_each(|step| twice.step(step));
        // A tetrahedron of each body goes.
        let tets = vec![TetId(3), twice.alone[1].tets[3]];
        let mut mesh = twice.mesh.clone();
        let change = mesh.apply(&MeshEdit::Remove { tets }).unwrap();
        let before = bits(twice.model.as_ref());
        let mut undo = ModelUndo::default();
        for place in 0.. {
            let follow = || follow_edit(&mut twice.model, mesh.mesh(), &change, &mut undo);
            let (done, failed) = fault::order(place, follow);
            if failed.is_none() {
                assert!(place >= 4, "both bodies have places that fail: {place}");
                done.unwrap();
                break;
            }
            assert!(done.is_err());
            assert_eq!(bits(twice.model.as_ref()), before, "{} and {}: {failed:?}", a.name, b.name);
        }
    }
}

#[test]
fn answers_and_local_models_are_those_of_the_bodies() {
    let kinds = kinds();
    let [explicit, implicit] =
        ["explicit neo-Hooke", "implicit"].map(|name| kinds.iter().find(|kind| kind.name == name).unwrap());
    let mut twice = Twice::new([explicit, implicit]);
    (0..6).for_each(|step| twice.step(step));
    let at = |alone: &Alone, n: usize| alone.nodes[n];
    let own = [NodalForce { node: NodeId(30), force_n: DVec3::new(0.1, -0.2, 0.05) }];
    let joint = twice.alone.each_ref().map(|alone| NodalForce { node: at(alone, 30), ..own[0] });
    let mut moves_m = vec![DVec3::ONE; twice.mesh.mesh().positions_m.len()];
    twice.model.answer_into(&joint, &mut moves_m, Answered::Everywhere);
    let mut expected_m = vec![DVec3::ZERO; twice.alone[1].nodes.len()];
    twice.alone[1].model.answer_into(&own, &mut expected_m, Answered::Everywhere);
    for (n, expected_m) in expected_m.iter().enumerate() {
        assert_eq!(moves_m[at(&twice.alone[1], n).index()], *expected_m);
    }
    let single_m = twice.alone[0].model.node_answer_m_per_n(NodeId(30), 2e-4) * own[0].force_n;
    assert_eq!(moves_m[at(&twice.alone[0], 30).index()], single_m);
    assert_eq!(moves_m[at(&twice.alone[0], 31).index()], DVec3::ZERO);

    twice.model.correct_step(&joint, 2e-4, Correction::Motion);
    twice.alone.iter_mut().for_each(|alone| alone.model.correct_step(&own, 2e-4, Correction::Motion));
    twice.check("after a correction");

    let patch: Vec<NodeId> = twice.alone.iter().flat_map(|alone| [at(alone, 30), at(alone, 31)]).collect();
    let mut work = LocalWork::with_room_for(moves_m.len());
    let (mut all, mut own) = (LocalModel::new(), LocalModel::new());
    twice.model.local_model_into(&patch, 1e-3, &mut work, &mut all);
    for (b, alone) in twice.alone.iter_mut().enumerate() {
        alone.model.local_model_into(&[NodeId(30), NodeId(31)], 1e-3, &mut work, &mut own);
        for i in 0..2 {
            assert_eq!(all.mass_kg[2 * b + i], own.mass_kg[i]);
            for j in 0..2 {
                assert_eq!(all.tensor_m_per_n(2 * b + i, 2 * b + j), own.tensor_m_per_n(i, j));
                assert_eq!(all.tensor_m_per_n(2 * b + i, 2 * (1 - b) + j), glisson_mesh::math::DMat3::ZERO);
            }
        }
    }
}

#[test]
fn a_rigid_body_goes_where_time_puts_it_and_comes_back_with_it() {
    let rest_m = vec![DVec3::ZERO, DVec3::X];
    let motion =
        RigidMotion::Breathing { direction: DVec3::Z, amplitude_m: 0.01, period_s: 4.0, sharpness: 2 };
    let mut body = RigidBody::new(rest_m.clone(), motion.clone());
    (0..200).for_each(|_| body.step(0.01));
    // Half a period: inhaled.
    let highest = body.state().positions_m[1];
    assert!((highest - DVec3::new(1.0, 0.0, 0.01)).length() < 1e-9, "{highest}");
    let mut fastest = 0.0_f64;
    for _ in 0..200 {
        body.step(0.01);
        fastest = fastest.max(body.state().velocities_m_per_s[0].length());
    }
    assert!((body.state().positions_m[0]).length() < 1e-9);
    assert!(fastest > 0.005 && fastest <= motion.greatest_speed_m_per_s(0.0), "{fastest}");
    body.take_over(&rest_m);
    assert_eq!((body.state().positions_m, body.history()), (&rest_m[..], vec![0.0]));
}
