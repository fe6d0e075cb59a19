//! Undone edits: every bit is that from before.

use glisson_mesh::math::{DVec3, SeededRandom};
use glisson_mesh::mesh::edit::{EditableMesh, MeshEdit, MeshUndo, TopologyChange};
use glisson_mesh::mesh::{NodeId, TetId};
use glisson_tissue::model::{Constraints, DeformableModel, ImposedDisplacement, ModelUndo, NodalForce};

use super::bodies::{Body, Kind, kinds};
use super::{large_mesh, mesh_of, next_edit};

/// A tool and a force that act on some nodes, some of which an edit may take away.
fn constraints(step: usize, n_nodes: usize) -> Constraints {
    let node = |at: usize| NodeId::from_index(at % n_nodes);
    let depth_m = 1e-4 * (step % 40) as f64;
    let held =
        |at| ImposedDisplacement { node: node(at), displacement_m: DVec3::new(depth_m, 0.0, -depth_m) };
    let force = |at| NodalForce { node: node(at), force_n: DVec3::new(0.01, 0.02, -0.01) };
    Constraints { displacements: vec![held(20), held(37)], forces: vec![force(25), force(43)] }
}

fn bits(model: &dyn DeformableModel) -> Vec<u64> {
    let state = model.state();
    let vectors = state.positions_m.iter().chain(state.velocities_m_per_s).chain(model.constraint_forces_n());
    vectors.flat_map(|v| v.to_array()).chain(model.history()).map(f64::to_bits).collect()
}

fn advance(model: &mut dyn DeformableModel, steps: std::ops::Range<usize>, n_nodes: usize) {
    for step in steps {
        if step % 5 == 0 {
            model.apply(&constraints(step, n_nodes));
        }
        model.step(2e-4);
    }
}

fn check_undo(kind: &Kind, shape: usize, turns: &[u64]) {
    let mut random = SeededRandom::new(21);
    let whole = if kind.has_short_undo[1] && shape == 0 { large_mesh() } else { mesh_of(shape, 3) };
    let mut mesh = EditableMesh::new(whole).unwrap();
    let mut body = Body::of(mesh.mesh().clone(), &mut random);
    body.damping.stiffness_s = if shape == 0 { 1e-6 } else { 0.0 };
    let mut model = kind.build(&body);
    model.set_gravity(DVec3::new(0.0, -2.0, 0.5));
    let n_nodes = mesh.mesh().positions_m.len();
    advance(model.as_mut(), 0..33, n_nodes);
    // One edit upon the other, the first one with a tool just set down.
    model.apply(&constraints(7, n_nodes));
    let mut journal = Vec::new();
    for (place, &turn) in turns.iter().enumerate() {
        let (copy, before) = (model.duplicate(), mesh.clone());
        let (change, mesh_undo) = next_edit(&mut random, &mut mesh, turn);
        let mut undo = ModelUndo::default();
        model.follow_saving(mesh.mesh(), &change, &mut undo).unwrap();
        let is_removal = change.tets.added.ids().is_empty() && change.moved_nodes.is_empty();
        assert_eq!(!undo.numbers.is_empty(), kind.has_short_undo[usize::from(!is_removal)], "{}", kind.name);
        // Some are overtaken by the next edit.
        advance(model.as_mut(), 0..[25, 3, 9][place % 3], mesh.mesh().positions_m.len());
        journal.push((copy, before, change, mesh_undo, undo));
    }
    for (mut copy, before, change, mesh_undo, mut undo) in journal.into_iter().rev() {
        let context = format!("{}, shape {shape}, {} added", kind.name, change.tets.added.ids().len());
        let edited = mesh.clone();
        undo.put_back(&mut model);
        mesh.undo(&mesh_undo);
        assert_eq!(mesh.mesh(), before.mesh());
        assert_eq!(bits(model.as_ref()), bits(copy.as_ref()), "{context}");
        let mut again = model.duplicate();
        let mut copy_again = copy.duplicate();
        let n_nodes = mesh.mesh().positions_m.len();
        let mut undone = model.duplicate();
        advance(undone.as_mut(), 3..60, n_nodes);
        advance(copy.as_mut(), 3..60, n_nodes);
        assert_eq!(bits(undone.as_ref()), bits(copy.as_ref()), "{context}");
        let (found, expected) = (undone.report(), copy.report());
        assert_eq!(
            (found.n_parts, found.n_mass_scaled_nodes),
            (expected.n_parts, expected.n_mass_scaled_nodes)
        );
        // The same edit once more: everything comes to the same place.
        for model in [&mut again, &mut copy_again] {
            model.topology_changed(edited.mesh(), &change).unwrap();
            advance(model.as_mut(), 0..12, edited.mesh().positions_m.len());
        }
        assert_eq!(bits(again.as_ref()), bits(copy_again.as_ref()), "{context}, again");
    }
}

#[test]
fn undone_edits_leave_no_trace() {
    for kind in kinds() {
        check_undo(&kind, 0, &[0, 1, 2, 3, 4, 5, 0]);
        check_undo(&kind, 1, &[3, 0, 0, 4, 2]);
    }
}

#[test]
fn removals_are_saved_and_undone_without_allocation() {
    let mut random = SeededRandom::new(2);
    let whole = EditableMesh::new(mesh_of(0, 3)).unwrap();
    let body = Body::of(whole.mesh().clone(), &mut random);
    for kind in kinds().iter().filter(|kind| kind.has_short_undo[0]) {
        let mut model = kind.build(&body);
        let mut mesh = whole.clone();
        let mut undo = ModelUndo::default();
        let (mut change, mut mesh_undo) =
            (TopologyChange::with_room_for_removals(4), MeshUndo::with_room_for_removals(4));
        for round in 0..2 {
            let edit = MeshEdit::Remove { tets: vec![TetId(17 + round), TetId(40)] };
            mesh.apply_saving(&edit, &mut change, &mut mesh_undo).unwrap();
            let count = allocation_counter::measure(|| {
                model.save_for_undo(&change, &mut undo);
                model.topology_changed(mesh.mesh(), &change).unwrap();
                model.step(2e-4);
                undo.put_back(&mut model);
            });
            // The first round warms the buffers.
            assert!(round == 0 || count.count_total == 0, "{}: {}", kind.name, count.count_total);
            mesh.undo(&mesh_undo);
        }
    }
}
