//! Edits of the mesh alone, each undone at once so that the next call finds the same body.

use std::hint::black_box;

use anyhow::ensure;
use glisson::math::SeededRandom;
use glisson::mesh::edit::{EdgeSplit, EditableMesh, MeshEdit, MeshUndo, TopologyChange};
use glisson::mesh::{EdgeId, TetId};

use super::body::StandardBody;
use super::{Case, Prepared, Settings};

pub(super) const CASES: &[Case] = &[
    Case {
        name: "remove_and_undo",
        about: "one tetrahedron out of the mesh and back in, in random order",
        per: "edit and undo",
        sizes: &[6_300],
        parallel: false,
        prepare: remove_and_undo,
    },
    Case {
        name: "split_and_undo",
        about: "the edges that a plane crosses in 20 neighbouring tetrahedra are split, and the split undone",
        per: "edit and undo",
        sizes: &[6_300],
        parallel: false,
        prepare: split_and_undo,
    },
];

/// Tetrahedra whose edges are split at once: what a blade passes in a step, at most.
const N_PASSED: usize = 20;

/// Places in the body that the splits go through in turn.
const N_PLACES: usize = 100;

fn prepared(size: usize, note: String, run: Box<dyn FnMut() + Send>) -> Prepared {
    Prepared { size, isa: "portable", precision: "f64", work: None, note, run }
}

fn remove_and_undo(settings: Settings) -> anyhow::Result<Prepared> {
    let body = StandardBody::shared(settings.size)?;
    let mut mesh = EditableMesh::new(body.mesh.clone())?;
    let n_tets = mesh.topology().n_tets();
    let mut change = TopologyChange::with_room_for_removals(1);
    let mut undo = MeshUndo::with_room_for_removals(1);
    let mut random = SeededRandom::new(1);
    Ok(prepared(
        n_tets,
        "mesh only".to_owned(),
        Box::new(move || {
            let tet = TetId::from_index((random.next_u64() % n_tets as u64) as usize);
            mesh.remove_saving(&[tet], &mut change, &mut undo).expect("all are live again");
            black_box(&change);
            mesh.undo(&undo);
        }),
    ))
}

fn split_and_undo(settings: Settings) -> anyhow::Result<Prepared> {
    let body = StandardBody::shared(settings.size)?;
    let mut mesh = EditableMesh::new(body.mesh.clone())?;
    mesh.reserve(1_000);
    let mut random = SeededRandom::new(1);
    let mut edits = Vec::new();
    let mut change = TopologyChange::default();
    let mut undo = MeshUndo::default();
    let (mut n_edges, mut n_removed, mut n_added) = (0, 0, 0);
    for _ in 0..N_PLACES {
        let edges = crossed_edges(&mesh, (random.next_u64() % body.mesh.tetrahedra.len() as u64) as usize);
        n_edges += edges.len();
        let edit = MeshEdit::Split { edges };
        mesh.apply_saving(&edit, &mut change, &mut undo)?;
        n_removed += change.tets.removed.len();
        n_added += change.tets.added.ids().len();
        mesh.undo(&undo);
        edits.push(edit);
    }
    ensure!(n_added > n_removed, "the splits divide nothing");
    let mean = |n: usize| n / N_PLACES;
    let note = format!("{} edges, {} tetrahedra go, {} come", mean(n_edges), mean(n_removed), mean(n_added));
    let mut next = 0;
    Ok(prepared(
        body.mesh.tetrahedra.len(),
        note,
        Box::new(move || {
            mesh.apply_saving(&edits[next], &mut change, &mut undo).expect("it was possible before");
            black_box(&change);
            mesh.undo(&undo);
            next = (next + 1) % edits.len();
        }),
    ))
}

/// The edges that the plane across x through the middle of tetrahedron `start` crosses in the first
/// [`N_PASSED`] tetrahedra that it meets on its way from there.
fn crossed_edges(mesh: &EditableMesh, start: usize) -> Vec<EdgeSplit> {
    let start = TetId::from_index(start);
    let plane_m = mesh.mesh().corners_m(start).iter().map(|p| p.x).sum::<f64>() / 4.0;
    let is_crossed = |tet: TetId| {
        let corners_m = mesh.mesh().corners_m(tet);
        corners_m.iter().any(|p| p.x < plane_m) && corners_m.iter().any(|p| p.x > plane_m)
    };
    let mut passed = vec![start];
    let mut next = 0;
    while next < passed.len() && passed.len() < N_PASSED {
        let neighbours = mesh.topology().tet_neighbours(passed[next]).into_iter().filter_map(|n| n.get());
        for tet in neighbours.filter(|&tet| is_crossed(tet)) {
            if !passed.contains(&tet) && passed.len() < N_PASSED {
                passed.push(tet);
            }
        }
        next += 1;
    }
    let mut edges: Vec<EdgeId> = passed.iter().flat_map(|&tet| mesh.topology().tet_edges(tet)).collect();
    edges.sort_unstable();
    edges.dedup();
    let split = |edge: EdgeId| {
        let [a_m, b_m] = mesh.topology().edge_nodes(edge).map(|n| mesh.mesh().positions_m[n.index()].x);
        let fraction = (plane_m - a_m) / (b_m - a_m);
        // Nearer to an end a cut moves the node instead.
        (fraction > 0.05 && fraction < 0.95).then_some(EdgeSplit { edge, fraction })
    };
    edges.into_iter().filter_map(split).collect()
}
