//! Steps after edits: stable whatever comes in, the same on every path and for any number of threads, with the memory and
//! the velocity that the parents had.

use glisson_mesh::math::{DVec3, SeededRandom};
use glisson_mesh::mesh::edit::{EdgeSplit, EditableMesh, MeshEdit, TopologyChange};
use glisson_mesh::mesh::{EdgeId, NodeId};
use glisson_tissue::model::StateHash;
use glisson_tissue::model::explicit_kernel::{ExplicitKernel, ExplicitKernelParams};
use glisson_tissue::model::kernel::{KernelLaw, KernelPath};
use glisson_tissue::model::{Constraints, DeformableModel, ImposedDisplacement};

use crate::team::team;

use super::bodies::{Body, kinds, series};
use super::{large_mesh, mesh_of, next_edit, pick};

#[test]
fn edits_give_the_same_bits_on_every_path_and_for_any_number_of_threads() {
    let mut paths = KernelPath::available();
    let fastest = paths[0];
    paths.push(fastest);
    let mut expected = None;
    for (at, path) in paths.into_iter().enumerate() {
        let mut random = SeededRandom::new(4);
        let mut mesh = EditableMesh::new(large_mesh()).unwrap();
        let body = Body::of(mesh.mesh().clone(), &mut random);
        let series = series();
        let mut params =
            ExplicitKernelParams::new(body.dynamic(), KernelLaw::StVenantKirchhoff, &body.materials);
        (params.path, params.fibres, params.relaxation) = (path, &body.fibres, Some(&series));
        if at > 0 && path.name() == fastest.name() {
            params.workers = team(3);
        }
        let mut model = ExplicitKernel::build(&params).unwrap();
        model.set_gravity(DVec3::new(0.0, -3.0, 1.0));
        // Enough for the layout to be made anew once.
        for turn in 0..60 {
            let (change, _) = next_edit(&mut random, &mut mesh, turn);
            model.topology_changed(mesh.mesh(), &change).unwrap();
            model.step(2e-4);
        }
        assert!(model.report().n_reanalyses > 0);
        let hash = StateHash::of_model(&model, &[], &[]);
        assert_eq!(*expected.get_or_insert(hash), hash, "{}", path.name());
    }
}

/// Nodes very near to others, again and again.
fn sliver_edit(random: &mut SeededRandom, mesh: &EditableMesh) -> MeshEdit {
    let edges: Vec<EdgeId> = mesh.topology().live_edges().collect();
    let edge = pick(random, &edges);
    MeshEdit::Split { edges: vec![EdgeSplit { edge, fraction: 0.003 }] }
}

#[test]
fn slivers_make_no_step_unstable() {
    // Implicit steps are stable at any length; the others divide their steps or make nodes heavier.
    for kind in kinds().iter().filter(|kind| kind.is_explicit()) {
        for most_parts in [1, 1000] {
            let mut random = SeededRandom::new(9);
            let mut mesh = EditableMesh::new(mesh_of(1, 3)).unwrap();
            let mut body = Body::of(mesh.mesh().clone(), &mut random);
            body.most_parts = most_parts;
            let mut model = kind.build(&body);
            let mut change = TopologyChange::default();
            for _ in 0..6 {
                let edit = sliver_edit(&mut random, &mesh);
                mesh.apply_into(&edit, &mut change).unwrap();
                model.topology_changed(mesh.mesh(), &change).unwrap();
            }
            let report = model.report();
            model.set_gravity(DVec3::new(0.0, 0.3, -1.0));
            let n_steps = if most_parts == 1 { 400 } else { 40 };
            let mut most_parts_made = 0;
            for _ in 0..n_steps {
                model.step(body.time_step_s);
                let report = model.report();
                assert!(!report.energy_was_limited && report.n_recovered_nodes == 0, "{}", kind.name);
                most_parts_made = most_parts_made.max(report.n_parts);
            }
            if kind.has_law() {
                assert_eq!(report.n_mass_scaled_nodes > 0, most_parts == 1, "{}: {report:?}", kind.name);
                assert_eq!(most_parts_made > 1, most_parts > 1, "{}: {most_parts_made}", kind.name);
            }
            let rest_m = &mesh.mesh().positions_m;
            let moved = model.state().positions_m.iter().zip(rest_m).map(|(x, rest)| x.distance(*rest));
            let farthest_m = moved.fold(0.0, f64::max);
            assert!(farthest_m < 0.02, "{}: {farthest_m}", kind.name);
        }
    }
}

/// The stress that relaxes is remembered by new tetrahedra as by their parents: a body split while it is held equals one
/// that was split before.
#[test]
fn new_tetrahedra_remember_what_their_parents_do() {
    for kind in kinds().iter().filter(|kind| kind.name.contains("everything") || kind.name.contains("stable"))
    {
        let mut random = SeededRandom::new(6);
        let mut mesh = EditableMesh::new(mesh_of(0, 3)).unwrap();
        let mut body = Body::of(mesh.mesh().clone(), &mut random);
        body.fixed.clear();
        let mut late = kind.build(&body);
        let at = |n: usize, x: DVec3| ImposedDisplacement {
            node: NodeId::from_index(n),
            displacement_m: DVec3::new(0.2 * x.z, -0.1 * x.y, 0.15 * x.x),
        };
        let hold = |model: &mut dyn DeformableModel, rest_m: &[DVec3], n_steps: usize| {
            let displacements = rest_m.iter().enumerate().map(|(n, x)| at(n, *x)).collect();
            model.apply(&Constraints { displacements, ..Constraints::default() });
            (0..n_steps).for_each(|_| model.step(2e-4));
            model.constraint_forces_n().to_vec()
        };
        let before_m = mesh.mesh().positions_m.clone();
        let mut changes = Vec::new();
        let mut snapshots = Vec::new();
        for _ in 0..4 {
            // Splits, so that the deformation of every part is that of the whole.
            let edges: Vec<EdgeId> = mesh.topology().live_edges().collect();
            let edit =
                MeshEdit::Split { edges: vec![EdgeSplit { edge: pick(&mut random, &edges), fraction: 0.4 }] };
            changes.push(mesh.apply(&edit).unwrap());
            snapshots.push(mesh.mesh().clone());
            body.follow(&mesh, changes.last().unwrap());
        }
        let mut early = kind.build(&Body { time_step_s: body.time_step_s, ..body.live(&mesh) });
        hold(late.as_mut(), &before_m, 150);
        for (change, mesh) in changes.iter().zip(&snapshots) {
            late.topology_changed(mesh, change).unwrap();
        }
        let rest_m = &mesh.mesh().positions_m;
        let found = hold(late.as_mut(), rest_m, 50);
        let expected = hold(early.as_mut(), rest_m, 200);
        let largest_n = expected.iter().map(|f| f.length()).fold(0.0, f64::max);
        for (n, (found, expected)) in found.iter().zip(&expected).enumerate() {
            assert!(
                (*found - *expected).length() < 1e-9 * largest_n,
                "{}, {n}: {found} {expected}",
                kind.name
            );
        }
    }
}

#[test]
fn nodes_move_on_with_the_mean_velocity_of_their_parents() {
    for kind in kinds() {
        let mut random = SeededRandom::new(12);
        let mut mesh = EditableMesh::new(mesh_of(0, 3)).unwrap();
        let body = Body::of(mesh.mesh().clone(), &mut random);
        let mut model = kind.build(&body);
        model.set_gravity(DVec3::new(0.3, -1.0, 2.0));
        (0..20).for_each(|_| model.step(2e-4));
        for turn in [3, 1, 3, 5] {
            let before = model.state().velocities_m_per_s.to_vec();
            let (change, _) = next_edit(&mut random, &mut mesh, turn);
            model.topology_changed(mesh.mesh(), &change).unwrap();
            let after = model.state().velocities_m_per_s;
            let largest = before.iter().map(|v| v.length()).fold(0.0, f64::max);
            for (node, parents) in change.nodes.added.iter() {
                let mean: DVec3 = parents.iter().map(|(p, weight)| before[p.index()] * *weight).sum();
                let off = (after[node.index()] - mean).length();
                assert!(off < 1e-9 * largest, "{}, {node}: {} {mean}", kind.name, after[node.index()]);
            }
            for (n, v) in before.iter().enumerate() {
                let stays = !change.nodes.removed.contains(&NodeId::from_index(n));
                assert!(!stays || (after[n] - *v).length() < 1e-9 * largest, "{}, {n}", kind.name);
            }
        }
    }
}

/// A node with one tetrahedron, whose shape changes because another of its corners moves, goes on as fast as it was.
#[test]
fn a_corner_goes_on_when_its_only_tetrahedron_gets_another_shape() {
    for kind in kinds() {
        let mut random = SeededRandom::new(12);
        let mut mesh = EditableMesh::new(mesh_of(0, 5)).unwrap();
        let body = Body::of(mesh.mesh().clone(), &mut random);
        let mut model = kind.build(&body);
        let place_m = |mesh: &EditableMesh, n: NodeId| mesh.mesh().positions_m[n.index()];
        let live = mesh.topology().live_nodes();
        let furthest = live.max_by(|&a, &b| place_m(&mesh, a).x.total_cmp(&place_m(&mesh, b).x));
        let corner = furthest.expect("there are nodes");
        let [tet, others @ ..] = mesh.topology().node_tets(corner) else { panic!("the node is live") };
        let (tet, others) = (*tet, others.to_vec());
        if !others.is_empty() {
            let change = mesh.apply(&MeshEdit::Remove { tets: others }).unwrap();
            model.topology_changed(mesh.mesh(), &change).unwrap();
        }
        model.set_gravity(DVec3::new(0.0, -9.81, 0.0));
        for _ in 0..20 {
            model.step(2e-4);
        }
        let before_m_per_s = model.state().velocities_m_per_s.to_vec();
        assert!(before_m_per_s[corner.index()].length() > 1e-3, "{}", kind.name);
        let moved = mesh.topology().tet_nodes(tet).into_iter().find(|&n| n != corner).expect("four corners");
        let to_m = place_m(&mesh, moved).lerp(place_m(&mesh, corner), 0.01);
        let change = mesh.apply(&MeshEdit::MoveVertex { node: moved, position_m: to_m }).unwrap();
        assert_eq!(change.reshaped_tets, mesh.topology().node_tets(moved));
        model.topology_changed(mesh.mesh(), &change).unwrap();
        for (n, before) in before_m_per_s.iter().enumerate() {
            let after = model.state().velocities_m_per_s[n];
            assert!(after.distance(*before) <= 1e-12, "{}, node {n}: {before} {after}", kind.name);
        }
    }
}
