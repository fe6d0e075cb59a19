//! Repair by collapse and by local remeshing (seed `000` s. 4.4.2), and local refinement (seed `003` s. 3.5).

use glisson_mesh::math::{DVec3, SeededRandom};
use glisson_mesh::mesh::box_mesh::{box_of_five, irregular_cube};
use glisson_mesh::mesh::edit::{EditableMesh, MeshEdit};
use glisson_mesh::mesh::quality::{MeshQuality, radius_ratio};
use glisson_mesh::mesh::refine::{FineRegion, refine};
use glisson_mesh::mesh::repair::{
    CollapseParams, Freedom, MoveLimits, MoveRefusal, RemeshParams, collapse, freedom, remesh, rest_place_m,
    short_surface_edges, tets_below, watched_move,
};
use glisson_mesh::mesh::{NodeId, TetMesh};

fn worst(body: &EditableMesh) -> f64 {
    let topology = body.topology();
    topology.live_tets().map(|t| radius_ratio(body.mesh().corners_m(t))).fold(1.0, f64::min)
}

/// Nodes moved at random as far as they can go with positive volumes: slivers, caps and short edges.
fn spoilt(mesh: TetMesh, seed: u64, share: f64) -> EditableMesh {
    let mut body = EditableMesh::new(mesh).unwrap();
    let mut random = SeededRandom::new(seed);
    let limits = MoveLimits { min_radius_ratio: 1e-4, ..MoveLimits::default() };
    for n in 0..body.topology().n_nodes() {
        let node = NodeId::from_index(n);
        let edge = body.topology().node_edges(node)[0];
        let [a, b] = body.topology().edge_nodes(edge).map(|n| body.mesh().positions_m[n.index()]);
        let reach_m = share * a.distance(b);
        let step = DVec3::new(random.normal(), random.normal(), random.normal());
        let wanted_m = body.mesh().positions_m[n] + reach_m * step;
        if let Ok(moved) = watched_move(&body, node, wanted_m, &limits) {
            body.apply(&MeshEdit::MoveVertex { node, position_m: moved.position_m }).unwrap();
        }
    }
    body
}

fn surface(body: &EditableMesh) -> Vec<[NodeId; 3]> {
    let topology = body.topology();
    let mut triangles: Vec<_> = topology.surface_triangles().map(|t| topology.triangle_nodes(t)).collect();
    triangles.sort_unstable();
    triangles
}

#[test]
fn remeshing_lifts_the_worst_and_keeps_surface_and_volume() {
    let (mut n_done, mut lifted) = (0, 0.0);
    for seed in 0..3 {
        let mut body = spoilt(irregular_cube(0.05, seed), seed, 0.25);
        let (before, volume_m3, outside) = (worst(&body), body.volume_m3(), surface(&body));
        let params = RemeshParams::default();
        let mut tries = tets_below(&body, params.wanted_radius_ratio);
        while let Some(tet) = tries.first().copied() {
            tries.remove(0);
            if !body.topology().is_live_tet(tet) {
                continue;
            }
            let Some(repair) = remesh(&body, &[tet], &params) else { continue };
            assert!(repair.worst_after > repair.worst_before);
            for edit in &repair.edits {
                body.apply(edit).unwrap();
            }
            n_done += 1;
        }
        assert!((body.volume_m3() / volume_m3 - 1.0).abs() < 1e-9);
        assert_eq!(surface(&body), outside);
        assert!(worst(&body) >= before);
        lifted += worst(&body) - before;
    }
    assert!(n_done > 10 && lifted > 0.0, "{n_done} {lifted}");
}

#[test]
fn a_good_mesh_is_left_alone() {
    let body = EditableMesh::new(box_of_five([3, 3, 3], DVec3::splat(0.03))).unwrap();
    let all: Vec<_> = body.topology().live_tets().collect();
    assert_eq!(remesh(&body, &all[..5], &RemeshParams::default()), None);
    assert!(short_surface_edges(&body, &CollapseParams::default()).is_empty());
}

#[test]
fn the_edge_of_three_tetrahedra_flips_away() {
    // A thin bipyramid on a large triangle: three slivers around the short axis would be better as two.
    let corner = |turn: f64| DVec3::new((turn * 2.1).cos(), (turn * 2.1).sin(), 0.0);
    let mesh = TetMesh {
        positions_m: vec![corner(0.0), corner(1.0), corner(2.0), -0.9 * DVec3::Z, 0.9 * DVec3::Z],
        tetrahedra: [[0, 1], [1, 2], [2, 0]].map(|[a, b]| [3, 4, a, b].map(NodeId)).to_vec(),
        ..TetMesh::default()
    };
    let mut body = EditableMesh::new(mesh).unwrap();
    let (before, volume_m3) = (worst(&body), body.volume_m3());
    let tet = body.topology().live_tets().next().unwrap();
    let params = RemeshParams { wanted_radius_ratio: 1.0, ..RemeshParams::default() };
    let repair = remesh(&body, &[tet], &params).unwrap();
    for edit in &repair.edits {
        body.apply(edit).unwrap();
    }
    assert_eq!(body.topology().live_counts().tets, 2);
    assert!(worst(&body) > before && (worst(&body) - repair.worst_after).abs() < 1e-12);
    assert!((body.volume_m3() / volume_m3 - 1.0).abs() < 1e-12);
}

#[test]
fn collapse_takes_short_surface_edges_away_and_keeps_the_volume() {
    let mut n_done = 0;
    for seed in 0..8 {
        let mut body = EditableMesh::new(box_of_five([5, 4, 4], DVec3::new(0.05, 0.04, 0.04))).unwrap();
        // Two neighbours inside the top come close to each other.
        let mut random = SeededRandom::new(seed);
        let topology = body.topology();
        let tops: Vec<_> = topology
            .live_edges()
            .filter(|&e| topology.is_surface_edge(e))
            .filter(|&e| {
                let is_flat = |n| matches!(freedom(&body, n, 0.6), Freedom::Surface { .. });
                topology.edge_nodes(e).into_iter().all(is_flat)
            })
            .collect();
        let edge = tops[(random.uniform() * tops.len() as f64) as usize];
        let [a, b] = body.topology().edge_nodes(edge);
        let [at_a_m, at_b_m] = [a, b].map(|n| body.mesh().positions_m[n.index()]);
        let limits = MoveLimits { min_radius_ratio: 1e-4, ..MoveLimits::default() };
        for (node, share) in [(a, 0.4), (b, 0.6)] {
            let wanted_m = at_a_m.lerp(at_b_m, share);
            let moved = watched_move(&body, node, wanted_m, &limits).unwrap();
            body.apply(&MeshEdit::MoveVertex { node, position_m: moved.position_m }).unwrap();
        }
        let (before, volume_m3, n_tets) =
            (worst(&body), body.volume_m3(), body.topology().live_counts().tets);
        let found =
            short_surface_edges(&body, &CollapseParams { short_edge: 0.3, ..CollapseParams::default() });
        assert_eq!(found, [edge]);
        let n_at_edge = body.topology().edge_tets(edge).len();
        let edit = collapse(&body, edge, &CollapseParams::default()).unwrap();
        body.apply(&edit).unwrap();
        assert_eq!(body.topology().live_counts().tets, n_tets - n_at_edge);
        assert!((body.volume_m3() / volume_m3 - 1.0).abs() < 1e-12);
        // What stays is no worse than the limit, or than what there was.
        assert!(worst(&body) >= before.min(CollapseParams::default().min_radius_ratio));
        assert!(short_surface_edges(&body, &CollapseParams::default()).is_empty());
        assert!(body.topology().pinches().is_empty());
        n_done += 1;
    }
    assert_eq!(n_done, 8);
}

#[test]
fn moves_keep_volume_ridges_and_corners() {
    let body = EditableMesh::new(box_of_five([4, 4, 4], DVec3::splat(0.04))).unwrap();
    let node = |x: u32, y: u32, z: u32| NodeId(x + 5 * (y + 5 * z));
    let limits = MoveLimits::default();
    let wanted = DVec3::new(0.003, 0.002, 0.004);
    let at = |n: NodeId| body.mesh().positions_m[n.index()];
    let go = |n: NodeId| watched_move(&body, n, at(n) + wanted, &limits).map(|m| m.position_m - at(n));
    assert_eq!(go(node(0, 0, 0)), Err(MoveRefusal::Corner { node: node(0, 0, 0) }));
    assert!(go(node(2, 0, 0)).unwrap().abs_diff_eq(DVec3::new(0.003, 0.0, 0.0), 1e-15));
    assert!(go(node(2, 2, 4)).unwrap().abs_diff_eq(DVec3::new(0.003, 0.002, 0.0), 1e-15));
    assert!(go(node(2, 2, 2)).unwrap().abs_diff_eq(wanted, 1e-15));
    // Across a neighbour: part of the way, and never inside out.
    let far = watched_move(&body, node(2, 2, 2), at(node(2, 2, 2)) + DVec3::new(0.011, 0.0, 0.0), &limits);
    assert!(far.is_ok_and(|m| m.share < 1.0));
    let refused = watched_move(&body, node(2, 2, 2), at(node(2, 2, 2)) + DVec3::new(0.2, 0.0, 0.0), &limits);
    assert!(matches!(refused, Err(MoveRefusal::Quality { .. })));
}

#[test]
fn a_rest_place_is_found_through_any_deformation_that_is_linear_on_tetrahedra() {
    let body = EditableMesh::new(irregular_cube(0.05, 2)).unwrap();
    let deform = |p: DVec3| DVec3::new(1.3 * p.x + 0.4 * p.y, 0.8 * p.y - 0.1 * p.z, 0.02 + p.z + 0.3 * p.x);
    let positions_m: Vec<DVec3> = body.mesh().positions_m.iter().map(|&p| deform(p)).collect();
    for n in [3, 40, 77, 120] {
        let rest_m = body.mesh().positions_m[n] + DVec3::new(0.001, -0.002, 0.0015);
        let found = rest_place_m(&body, &positions_m, NodeId(n as u32), deform(rest_m)).unwrap();
        assert!(found.abs_diff_eq(rest_m, 1e-14));
    }
}

#[test]
fn a_region_of_interest_gets_fine_and_stays_good() {
    for mesh in [box_of_five([4, 4, 4], DVec3::splat(0.04)), irregular_cube(0.04, 5)] {
        let original = mesh.clone();
        let mut body = EditableMesh::new(mesh).unwrap();
        let before = MeshQuality::of(&original);
        let region = FineRegion { center_m: DVec3::new(0.02, 0.015, 0.03), radius_m: 0.008, edge_m: 0.0045 };
        let mut n_edits = 0;
        while let Some(edit) = refine(&body, &region, 50) {
            body.apply(&edit).unwrap();
            n_edits += 1;
            assert!(n_edits < 500);
        }
        let topology = body.topology();
        for tet in topology.live_tets().filter(|&t| region.contains(&body, t)) {
            for edge in topology.tet_edges(tet) {
                let [a, b] = topology.edge_nodes(edge).map(|n| body.mesh().positions_m[n.index()]);
                assert!(a.distance(b) <= region.edge_m);
            }
        }
        let after = MeshQuality::of(&body.live_mesh());
        // Conforming: the same ball with the same surface, and no more volume than before.
        assert_eq!((topology.euler_characteristic(), topology.surface_euler_characteristic()), (1, 2));
        assert!((after.volume_m3 / before.volume_m3 - 1.0).abs() < 1e-12);
        assert!((after.surface_area_m2 / before.surface_area_m2 - 1.0).abs() < 1e-12);
        assert!(after.tetrahedra > 2 * before.tetrahedra);
        // Bisection of longest edges: a bounded loss of shape.
        assert!(after.min_radius_ratio > 0.2 * before.min_radius_ratio);
        // At the far corner nothing changed.
        let corner = DVec3::new(0.04, 0.04, 0.0);
        let is_far = |p: &&DVec3| p.distance(corner) < 0.009;
        let n_far = |positions_m: &[DVec3]| positions_m.iter().filter(is_far).count();
        assert_eq!(n_far(&body.live_mesh().positions_m), n_far(&original.positions_m));
    }
}
