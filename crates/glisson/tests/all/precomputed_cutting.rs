//! Cutting the pre-computed body: its compliance after removals against fresh pre-computations and static solutions.

use crate::model_meshes::{block, shaken_block};
use glisson::material::LinearElastic;
use glisson::math::{DMat3, DVec3, SeededRandom};
use glisson::mesh::edit::{EditableMesh, MeshEdit};
use glisson::mesh::topology::Through;
use glisson::mesh::{NodeId, TetId, TetMesh};
use glisson::model::StateHash;
use glisson::model::kind::ModelKind;
use glisson::model::precomputed::{Precision, Precomputed, PrecomputedParams, StoredNodes};
use glisson::model::{
    Constraints, DeformableModel, FixedNode, ImposedDisplacement, LocalModel, LocalWork, NodalForce,
};
use glisson::scene::{OrganBody, build_model_as_cut};
use glisson::solve::{BoundaryConditions, StaticProblem, add_gravity_forces, solve_static};

fn material() -> LinearElastic {
    LinearElastic::from_young_poisson(5e3, 0.45, 1060.0).unwrap()
}

/// A model and the mesh that it follows.
struct Cut {
    body: EditableMesh,
    fixed: Vec<NodeId>,
    model: Precomputed,
}

impl Cut {
    fn new(mesh: TetMesh, stored: StoredNodes, precision: Precision) -> Self {
        let lowest = mesh.positions_m.iter().map(|p| p.z).fold(f64::INFINITY, f64::min);
        let fixed: Vec<NodeId> = (0..mesh.positions_m.len())
            .filter(|&n| mesh.positions_m[n].z < lowest + 0.011)
            .map(NodeId::from_index)
            .collect();
        Self::held_at(mesh, fixed, stored, precision)
    }

    fn held_at(mesh: TetMesh, fixed: Vec<NodeId>, stored: StoredNodes, precision: Precision) -> Self {
        let model = Precomputed::build(&params(&mesh, &material(), &fixed, stored, precision)).unwrap();
        Self { body: EditableMesh::new(mesh).unwrap(), fixed, model }
    }

    fn shaken(seed: u64) -> Self {
        let mesh = shaken_block([6, 5, 5], DVec3::new(0.12, 0.1, 0.1), 0.15, seed);
        Self::new(mesh, StoredNodes::Surface, Precision::F64)
    }

    fn remove(&mut self, tets: &[TetId]) {
        let change = self.body.apply(&MeshEdit::Remove { tets: tets.to_vec() }).unwrap();
        assert_eq!(self.model.topology_refusal(), None);
        self.model.topology_changed(self.body.mesh(), &change).unwrap();
    }

    /// The live part of the mesh with the same node numbers, and the nodes to be held: the fixed ones and those that
    /// are left alone.
    fn rest(&self, counts: impl Fn(TetId) -> bool) -> (TetMesh, Vec<NodeId>) {
        let topology = self.body.topology();
        let tetrahedra: Vec<[NodeId; 4]> =
            topology.live_tets().filter(|&t| counts(t)).map(|t| topology.tet_nodes(t)).collect();
        let mut has_tet = vec![false; self.body.mesh().positions_m.len()];
        tetrahedra.iter().flatten().for_each(|n| has_tet[n.index()] = true);
        let mesh =
            TetMesh { positions_m: self.body.mesh().positions_m.clone(), tetrahedra, ..TetMesh::default() };
        let held = (0..mesh.positions_m.len())
            .map(NodeId::from_index)
            .filter(|n| self.fixed.contains(n) || !has_tet[n.index()])
            .collect();
        (mesh, held)
    }

    /// Largest difference of the compliance from that of a fresh pre-computation, over the largest entry.
    fn difference(&self) -> f64 {
        self.difference_of(|_| true)
    }

    /// The same where only these tetrahedra count.
    fn difference_of(&self, counts: impl Fn(TetId) -> bool) -> f64 {
        let (mesh, held) = self.rest(counts);
        let (stored, precision) = (StoredNodes::Surface, Precision::F64);
        let fresh = Precomputed::build(&params(&mesh, &material(), &held, stored, precision)).unwrap();
        let mut nodes = self.model.loadable_nodes().to_vec();
        nodes.sort_unstable();
        assert_eq!(nodes, fresh.loadable_nodes());
        let (mut largest, mut difference) = (0.0_f64, 0.0_f64);
        let size = |m: DMat3| m.to_cols_array().map(f64::abs).into_iter().fold(0.0, f64::max);
        for &l in &nodes {
            for &m in &nodes {
                let expected = fresh.compliance_m_per_n(l, m).unwrap();
                let found = self.model.compliance_m_per_n(l, m).unwrap();
                largest = largest.max(size(expected));
                difference = difference.max(size(found - expected));
            }
        }
        difference / largest
    }

    /// A live tetrahedron on the surface whose removal leaves one piece held by faces.
    fn next(&self, random: &mut SeededRandom) -> TetId {
        let topology = self.body.topology();
        let live: Vec<TetId> = topology.live_tets().collect();
        loop {
            let tet = live[(random.next_u64() % live.len() as u64) as usize];
            if topology.tet_neighbours(tet).iter().all(|n| !n.is_none()) {
                continue;
            }
            let mut after = self.body.clone();
            after.apply(&MeshEdit::Remove { tets: vec![tet] }).unwrap();
            if after.topology().pieces(Through::Faces).count() == 1 {
                return tet;
            }
        }
    }
}

fn params<'a>(
    mesh: &'a TetMesh,
    material: &'a LinearElastic,
    fixed_nodes: &'a [NodeId],
    stored: StoredNodes,
    precision: Precision,
) -> PrecomputedParams<'a> {
    PrecomputedParams { mesh, material, fixed_nodes, stored, precision, progress: None }
}

#[test]
fn one_removal_gives_the_compliance_of_the_remaining_mesh() {
    for (stored, precision, limit) in [
        (StoredNodes::Surface, Precision::F64, 1e-12),
        (StoredNodes::All, Precision::F64, 1e-12),
        (StoredNodes::Surface, Precision::F32, 2e-7),
    ] {
        let mesh = shaken_block([4, 3, 4], DVec3::new(0.08, 0.06, 0.08), 0.15, 7);
        let mut cut = Cut::new(mesh, stored, precision);
        let tet = cut.next(&mut SeededRandom::new(1));
        cut.remove(&[tet]);
        let difference = cut.difference();
        assert!(difference < limit, "{stored:?} {precision:?}: {difference:e}");
        let report = cut.model.cut_report();
        assert_eq!((report.n_edits, report.n_taken_out, report.n_loose), (1, 1, 0));
        // The estimate sums columns.
        assert!(report.least_pivot > 1e-3 && report.error < 10.0 * limit, "{report:?}");
    }
}

#[test]
fn a_hundred_removals_in_a_row_agree_with_a_fresh_precomputation() {
    let mut cut = Cut::shaken(11);
    let mut random = SeededRandom::new(2);
    for _ in 0..100 {
        let tet = cut.next(&mut random);
        cut.remove(&[tet]);
    }
    let (difference, report) = (cut.difference(), cut.model.cut_report());
    assert!(difference < 1e-8, "{difference:e} {report:?}");
    assert!(report.n_laid_bare > 20 && report.n_taken_out == 100, "{report:?}");
    assert!(!report.wants_recomputation && report.error < 1e-8, "{report:?}");
}

/// Largest difference between the compliances of two models of the same nodes, over the largest entry.
fn between(a: &Precomputed, b: &Precomputed) -> f64 {
    let size = |m: DMat3| m.to_cols_array().map(f64::abs).into_iter().fold(0.0, f64::max);
    let (mut largest, mut difference) = (0.0_f64, 0.0_f64);
    for &l in a.loadable_nodes() {
        for &m in a.loadable_nodes() {
            let (x, y) = (a.compliance_m_per_n(l, m).unwrap(), b.compliance_m_per_n(l, m).unwrap());
            largest = largest.max(size(x));
            difference = difference.max(size(x - y));
        }
    }
    assert_eq!(a.loadable_nodes().len(), b.loadable_nodes().len());
    difference / largest
}

#[test]
fn a_batch_is_the_same_as_one_by_one() {
    let mut one_by_one = Cut::shaken(5);
    let mut at_once = Cut::shaken(5);
    let mut random = SeededRandom::new(3);
    let tets: Vec<TetId> = (0..40)
        .map(|_| {
            let tet = one_by_one.next(&mut random);
            one_by_one.remove(&[tet]);
            tet
        })
        .collect();
    at_once.remove(&tets);
    assert!(between(&one_by_one.model, &at_once.model) < 1e-11);
    assert_eq!(at_once.model.cut_report().n_edits, 1);
}

/// Checks the stored nodes against the displacements [m] that are expected.
fn assert_displaced(cut: &Cut, rest_m: &[DVec3], expected_m: &[DVec3], stored: StoredNodes) {
    let largest_m = expected_m.iter().map(|u| u.length()).fold(0.0, f64::max);
    for &node in cut.model.stored_nodes() {
        let found_m = cut.model.state().positions_m[node.index()] - rest_m[node.index()];
        let off_m = found_m.distance(expected_m[node.index()]);
        assert!(off_m < 1e-10 * largest_m, "{stored:?} {node}: {off_m:e} of {largest_m}");
    }
}

#[test]
fn forces_displacements_and_weight_after_cuts_act_as_in_the_static_solver() {
    for stored in [StoredNodes::Surface, StoredNodes::All] {
        let mesh = shaken_block([5, 4, 4], DVec3::new(0.1, 0.08, 0.08), 0.15, 21);
        let mut cut = Cut::new(mesh, stored, Precision::F64);
        cut.model.prepare_cutting(cut.body.mesh()).unwrap();
        let mut random = SeededRandom::new(8);
        let gravity = DVec3::new(2.0, -1.0, -9.0);
        cut.model.set_gravity(gravity);
        for _ in 0..25 {
            let tet = cut.next(&mut random);
            cut.remove(&[tet]);
        }
        let (mesh, held) = cut.rest(|_| true);
        let mut nodes = cut.model.loadable_nodes().to_vec();
        nodes.sort_unstable();
        // Nodes that were laid bare are among them.
        assert!(cut.model.cut_report().n_laid_bare > 3);
        let bare = *cut.model.loadable_nodes().last().unwrap();
        let pushed = [nodes[3], nodes[nodes.len() / 2]];
        let mut conditions = BoundaryConditions::fixed(&held);
        let mut force_n = vec![DVec3::ZERO; mesh.positions_m.len()];
        let mut constraints = Constraints::default();
        for (i, node) in pushed.into_iter().enumerate() {
            let displacement_m = DVec3::new(1e-3, -2e-3 * i as f64, 5e-4);
            conditions.impose_node(node, displacement_m);
            constraints.displacements.push(ImposedDisplacement { node, displacement_m });
        }
        let mut loaded = vec![bare, nodes[7]];
        loaded.sort_unstable();
        loaded.dedup();
        for node in loaded {
            let f = DVec3::new(0.03, 0.01, -0.02);
            force_n[node.index()] += f;
            constraints.forces.push(NodalForce { node, force_n: f });
        }
        add_gravity_forces(&mesh, &material(), gravity, &mut force_n);
        let solution = solve_static(&StaticProblem {
            mesh: &mesh,
            material: &material(),
            conditions: &conditions,
            nodal_force_n: &force_n,
        })
        .unwrap();
        cut.model.apply(&constraints);
        cut.model.step(1e-3);
        assert_eq!(cut.model.report().n_ignored_constraints, 0);
        assert_displaced(&cut, &mesh.positions_m, &solution.displacement_m, stored);
        for (felt_n, node) in cut.model.constraint_forces_n().iter().zip(pushed) {
            let expected_n = solution.reaction_n[node.index()];
            assert!(felt_n.distance(expected_n) < 1e-9 * expected_n.length(), "{felt_n} {expected_n}");
        }
        assert!(
            cut.model.save(std::path::Path::new("/nowhere/cut")).unwrap_err().to_string().contains("cuts")
        );
    }
}

#[test]
fn an_organ_imaged_under_its_weight_opens_where_it_is_cut() {
    let mesh = shaken_block([5, 4, 4], DVec3::new(0.1, 0.08, 0.08), 0.15, 33);
    let mut cut = Cut::new(mesh, StoredNodes::Surface, Precision::F64);
    let (imaged, tilted) = (DVec3::new(9.0, 0.0, -3.0), DVec3::new(7.0, 2.0, -6.0));
    cut.model.carry_at_rest(imaged);
    let under = |cut: &Cut, gravity: DVec3| {
        let (mesh, held) = cut.rest(|_| true);
        let mut force_n = vec![DVec3::ZERO; mesh.positions_m.len()];
        add_gravity_forces(&mesh, &material(), gravity, &mut force_n);
        let conditions = BoundaryConditions::fixed(&held);
        let (material, nodal_force_n) = (material(), &force_n[..]);
        let problem =
            StaticProblem { mesh: &mesh, material: &material, conditions: &conditions, nodal_force_n };
        solve_static(&problem).unwrap().displacement_m
    };
    // The rest shape has the displacements of the whole body; without a cut nothing moves, to the last bit.
    let whole_m = under(&cut, imaged);
    cut.model.prepare_cutting(cut.body.mesh()).unwrap();
    cut.model.step(1e-3);
    assert_eq!(cut.model.state().positions_m, cut.body.mesh().positions_m);
    let mut random = SeededRandom::new(4);
    for _ in 0..20 {
        let tet = cut.next(&mut random);
        cut.remove(&[tet]);
    }
    for gravity in [imaged, tilted] {
        cut.model.set_gravity(gravity);
        cut.model.step(1e-3);
        let now_m = under(&cut, gravity);
        let largest_m = now_m.iter().map(|u| u.length()).fold(0.0, f64::max);
        for &node in cut.model.stored_nodes() {
            let n = node.index();
            let found_m = cut.model.state().positions_m[n] - cut.body.mesh().positions_m[n];
            let off_m = found_m.distance(now_m[n] - whole_m[n]);
            assert!(off_m < 1e-10 * largest_m, "{node}: {off_m:e} of {largest_m}");
        }
    }
}

/// A tower of cubes held below; the third layer of cells is what can be cut.
fn tower() -> Cut {
    Cut::new(block([2, 2, 4], DVec3::new(0.02, 0.02, 0.04)), StoredNodes::Surface, Precision::F64)
}

/// Tetrahedra of the third layer, but for these of its first cell.
fn layer_without(kept: &[usize]) -> Vec<TetId> {
    let first = 6 * 2 * 4;
    (first..first + 24).filter(|t| !kept.iter().any(|k| first + k == *t)).map(TetId::from_index).collect()
}

fn tet_of_layer(place: usize) -> TetId {
    TetId::from_index(6 * 2 * 4 + place)
}

/// Tetrahedra of the top layer.
fn is_top(tet: TetId) -> bool {
    tet.index() >= 6 * 3 * 4
}

fn centre_m(cut: &Cut, nodes: &[NodeId]) -> DVec3 {
    nodes.iter().map(|n| cut.model.state().positions_m[n.index()]).sum::<DVec3>() / nodes.len() as f64
}

#[test]
fn a_piece_held_by_an_edge_then_a_vertex_then_nothing_is_recognised_and_falls() {
    let gravity = DVec3::new(0.0, 0.0, -9.81);
    let mut cut = tower();
    cut.model.set_gravity(gravity);
    cut.model.apply(&Constraints::default());
    cut.model.step(1e-3);
    // Tetrahedra 0 and 5 of the cell hang on the lower part by faces and have two nodes of the upper one.
    cut.remove(&layer_without(&[0, 5]));
    let report = cut.model.cut_report();
    assert_eq!(report.n_loose, 24, "{report:?}");
    let loose = cut.model.loose_nodes();
    assert_eq!(loose.len(), 18 - 2, "all nodes of the top layer but the two of the edge");
    assert!(cut.difference_of(|t| !is_top(t)) < 1e-11);
    assert!(report.error < 1e-11 && report.least_pivot > 1e-6, "{report:?}");
    let start_m = centre_m(&cut, &loose);
    for _ in 0..150 {
        cut.model.step(1e-3);
    }
    // It swings about the edge: that moves with the held part, the rest goes down by more than a cell.
    let fell_m = start_m.z - centre_m(&cut, &loose).z;
    assert!((2e-3..0.06).contains(&fell_m), "{fell_m}");
    assert!(cut.model.report().kinetic_energy_j > 0.0 && !cut.model.history().is_empty());

    // One tetrahedron less: held by a vertex.
    cut.remove(&[tet_of_layer(5)]);
    assert_eq!(cut.model.loose_nodes().len(), 18 - 1);
    assert!(cut.difference_of(|t| !is_top(t)) < 1e-11);
    for _ in 0..300 {
        cut.model.step(1e-3);
    }
    let hinge = *cut.body.topology().tet_nodes(tet_of_layer(0)).iter().max().unwrap();
    let hinge_m = cut.model.state().positions_m[hinge.index()];
    let rest_m = &cut.body.mesh().positions_m;
    for &node in &loose {
        let now_m = cut.model.state().positions_m[node.index()].distance(hinge_m);
        let before_m = rest_m[node.index()].distance(rest_m[hinge.index()]);
        assert!(
            (now_m - before_m).abs() < 0.02,
            "{node} tore off: {now_m} m from the hinge, {before_m} before"
        );
    }
    // The held part feels the pull.
    let pull_m = hinge_m.distance(rest_m[hinge.index()]);
    assert!((1e-6..0.05).contains(&pull_m), "{pull_m}");

    // Nothing holds it any more: it falls freely, slowed by the damping of 1/s alone.
    cut.remove(&[tet_of_layer(0)]);
    assert_eq!(cut.model.loose_nodes().len(), 18);
    let free = cut.model.loose_nodes();
    cut.model.take_over(&cut.body.mesh().positions_m.clone());
    let start_m = centre_m(&cut, &free);
    for _ in 0..100 {
        cut.model.step(1e-3);
    }
    let fell_m = start_m.z - centre_m(&cut, &free).z;
    assert!((fell_m / (0.5 * 9.81 * 0.01) - 0.97).abs() < 0.03, "{fell_m}");
    let report = cut.model.cut_report();
    assert!(!report.wants_recomputation && report.error < 1e-11, "{report:?}");
}

#[test]
fn a_tool_pushes_a_loose_piece_and_a_cut_goes_through_it() {
    let mut cut = tower();
    cut.remove(&layer_without(&[0, 5]));
    let pushed = *cut.model.loose_nodes().last().unwrap();
    let displacement_m = DVec3::new(2e-3, 0.0, 1e-3);
    let imposed = ImposedDisplacement { node: pushed, displacement_m };
    let constraints = Constraints { displacements: vec![imposed], forces: vec![] };
    let mut felt_n = DVec3::ZERO;
    for _ in 0..20 {
        cut.model.apply(&constraints);
        cut.model.step(1e-3);
        felt_n += cut.model.constraint_forces_n()[0];
    }
    let rest_m = cut.body.mesh().positions_m[pushed.index()];
    let moved_m = cut.model.state().positions_m[pushed.index()] - rest_m;
    assert!(moved_m.distance(displacement_m) < 1e-9, "{moved_m}");
    assert!(felt_n.length() > 1e-4 && cut.model.report().n_ignored_constraints == 0, "{felt_n}");
    let mut copy = cut.model.duplicate();
    let top: Vec<TetId> = (6 * 3 * 4..6 * 3 * 4 + 6).map(TetId::from_index).collect();
    let n_taken_out = cut.model.cut_report().n_taken_out;
    cut.remove(&top);
    assert_eq!(cut.model.cut_report().n_taken_out, n_taken_out, "the piece is no part of the compliance");
    for _ in 0..20 {
        cut.model.apply(&constraints);
        cut.model.step(1e-3);
        copy.apply(&constraints);
        copy.step(1e-3);
    }
    assert!(cut.model.state().positions_m.iter().all(|p| p.is_finite()));
    assert_ne!(cut.model.state().positions_m, copy.state().positions_m);
}

#[test]
fn a_copy_of_a_cut_body_goes_on_with_the_same_bits_and_steps_allocate_nothing() {
    let mut cut = tower();
    cut.model.set_gravity(DVec3::new(1.0, 0.0, -9.81));
    cut.remove(&layer_without(&[0]));
    for _ in 0..30 {
        cut.model.step(1e-3);
    }
    let mut copy = cut.model.duplicate();
    let constraints = Constraints::default();
    let count = allocation_counter::measure(|| {
        for _ in 0..30 {
            for model in [&mut cut.model as &mut dyn DeformableModel, copy.as_mut()] {
                model.apply(&constraints);
                model.step(1e-3);
            }
        }
    });
    assert_eq!(count.count_total, 0);
    assert_eq!(cut.model.state().positions_m, copy.state().positions_m);
    assert_eq!(cut.model.history(), copy.history());
}

#[test]
fn a_precomputation_of_the_cut_mesh_takes_over_and_follows_further_cuts() {
    let mut cut = tower();
    cut.remove(&layer_without(&[0, 5]));
    let live = cut.body.topology().live_tet_flags().to_vec();
    let (stored, precision) = (StoredNodes::Surface, Precision::F64);
    let mesh = cut.body.mesh().clone();
    let material = material();
    let params = params(&mesh, &material, &cut.fixed, stored, precision);
    let mut fresh = Precomputed::build_cut(&params, &live).unwrap();
    assert_eq!(fresh.loose_nodes(), cut.model.loose_nodes());
    assert_eq!(fresh.fixed_nodes(), cut.model.fixed_nodes());
    assert!(between(&cut.model, &fresh) < 1e-11);
    assert_eq!(fresh.cut_report().n_columns, 0);
    let change =
        cut.body.apply(&MeshEdit::Remove { tets: vec![tet_of_layer(5), TetId(3), TetId(40)] }).unwrap();
    for model in [&mut cut.model, &mut fresh] {
        model.topology_changed(&mesh, &change).unwrap();
    }
    assert!(between(&cut.model, &fresh) < 1e-11);
    assert_eq!(fresh.loose_nodes(), cut.model.loose_nodes());
}

#[test]
fn everything_can_be_cut_away() {
    let mut cut = tower();
    let all: Vec<TetId> = cut.body.topology().live_tets().collect();
    for tets in all.chunks(10) {
        cut.remove(tets);
        cut.model.apply(&Constraints::default());
        cut.model.step(1e-3);
        assert!(cut.model.state().positions_m.iter().all(|p| p.is_finite()));
    }
    assert!(cut.model.loadable_nodes().is_empty());
}

/// A tall block, and tetrahedra of its middle that leave a wall a third as wide: the body becomes soft.
fn incised() -> (Cut, Vec<TetId>) {
    let cut = Cut::new(
        shaken_block([3, 3, 8], DVec3::new(0.03, 0.03, 0.08), 0.1, 9),
        StoredNodes::Surface,
        Precision::F64,
    );
    let mesh = cut.body.mesh();
    let centre_m = |t: &TetId| mesh.corners_m(*t).into_iter().sum::<DVec3>() / 4.0;
    let is_cut = |t: &TetId| {
        let c = centre_m(t);
        (0.02..0.06).contains(&c.z) && c.x > 0.01
    };
    let tets = cut.body.topology().live_tets().filter(is_cut).take(100).collect();
    (cut, tets)
}

#[test]
fn the_estimate_of_the_error_is_not_below_a_third_of_the_error() {
    let mut most = 0.0_f64;
    let mut compare = |cut: &Cut, counts: &dyn Fn(TetId) -> bool| {
        let (difference, report) = (cut.difference_of(counts), cut.model.cut_report());
        assert!(report.error >= difference / 3.0, "{difference:e} {report:?}");
        most = most.max(report.error / difference);
    };
    let mut shaken = Cut::shaken(17);
    let mut random = SeededRandom::new(6);
    for n in 1..=100 {
        let tet = shaken.next(&mut random);
        shaken.remove(&[tet]);
        if n % 5 == 0 {
            compare(&shaken, &|_| true);
        }
    }
    let (mut soft, tets) = incised();
    assert!(tets.len() > 90, "{}", tets.len());
    for (n, tet) in tets.into_iter().enumerate() {
        soft.remove(&[tet]);
        if n % 5 == 4 {
            assert_eq!(soft.model.cut_report().n_loose, 0);
            compare(&soft, &|_| true);
        }
    }
    assert!(most < 1000.0, "{most}");
}

#[test]
fn cuts_have_the_same_bits_on_any_number_of_threads() {
    let run = |n_threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(n_threads).build().unwrap();
        pool.install(|| {
            let mut cut = tower();
            cut.model.set_gravity(DVec3::new(0.5, 0.0, -9.81));
            for tets in [vec![TetId(3), TetId(40)], layer_without(&[0]), vec![TetId(8)]] {
                cut.remove(&tets);
                for _ in 0..20 {
                    cut.model.step(1e-3);
                }
            }
            let report = cut.model.cut_report();
            assert!(report.n_loose > 0 && report.n_laid_bare > 0, "{report:?}");
            let live = cut.body.topology().live_tet_flags().to_vec();
            (StateHash::of_model(&cut.model, &live, &[report.error]), report)
        })
    };
    let [one, two, four] = [1, 2, 4].map(run);
    assert_eq!(one, two);
    assert_eq!(one, four);
}

#[test]
fn a_piece_with_a_sliver_makes_no_shorter_steps_but_becomes_heavier() {
    let mut mesh = block([2, 2, 4], DVec3::new(0.02, 0.02, 0.04));
    // A node of the top, almost down on the layer below it.
    let top = (0..mesh.positions_m.len())
        .find(|&n| mesh.positions_m[n].distance(DVec3::new(0.02, 0.02, 0.04)) < 1e-9)
        .unwrap();
    mesh.positions_m[top].z = 0.03 + 2e-5;
    let mut cut = Cut::new(mesh, StoredNodes::Surface, Precision::F64);
    cut.model.set_gravity(DVec3::new(0.0, 0.0, -9.81));
    cut.remove(&layer_without(&[]));
    let loose = cut.model.loose_nodes();
    let start_m = centre_m(&cut, &loose);
    for _ in 0..100 {
        cut.model.step(1e-3);
        assert!(cut.model.report().n_parts <= 20, "{:?}", cut.model.report());
    }
    let report = cut.model.report();
    assert!((1..9).contains(&report.n_mass_scaled_nodes), "{report:?}");
    assert_eq!((report.n_recovered_nodes, report.energy_was_limited), (0, false));
    let fell_m = start_m.z - centre_m(&cut, &loose).z;
    // The added inertia, which has no weight, makes it slower.
    assert!((0.6..1.0).contains(&(fell_m / (0.5 * 9.81 * 0.01))), "{fell_m}");
    // Without a sliver nothing is heavier.
    let mut sound = tower();
    sound.remove(&layer_without(&[]));
    sound.model.step(1e-3);
    assert_eq!(sound.model.report().n_mass_scaled_nodes, 0);
}

#[test]
fn a_piece_of_which_no_body_can_be_made_is_told() {
    let mut cut = tower();
    cut.model.set_gravity(DVec3::new(0.0, f64::NAN, 0.0));
    cut.remove(&layer_without(&[]));
    let report = cut.model.cut_report();
    assert_eq!((report.n_loose, report.n_stuck), (0, 24));
    assert_eq!(cut.model.report().n_quarantined_tets, 24);
    assert!(cut.model.loose_nodes().is_empty());
}

#[test]
fn a_falling_piece_goes_on_falling_when_a_fresh_precomputation_takes_over() {
    let mut cut = tower();
    cut.model.set_gravity(DVec3::new(0.0, 0.0, -9.81));
    cut.remove(&layer_without(&[]));
    for _ in 0..60 {
        cut.model.step(1e-3);
    }
    let loose = cut.model.loose_nodes();
    let speed = |model: &Precomputed| {
        let state = model.state();
        loose.iter().map(|n| state.velocities_m_per_s[n.index()].z).sum::<f64>() / loose.len() as f64
    };
    assert!((speed(&cut.model) + 9.81 * 0.06).abs() < 0.03, "{}", speed(&cut.model));
    let live = cut.body.topology().live_tet_flags().to_vec();
    let (mesh, material) = (cut.body.mesh().clone(), material());
    let params = params(&mesh, &material, &cut.fixed, StoredNodes::Surface, Precision::F64);
    let mut fresh = Precomputed::build_cut(&params, &live).unwrap();
    fresh.take_over_in_motion(&cut.model.state(), &[]);
    fresh.set_gravity(DVec3::new(0.0, 0.0, -9.81));
    let mut stopped = Precomputed::build_cut(&params, &live).unwrap();
    stopped.take_over(cut.model.state().positions_m);
    for _ in 0..60 {
        cut.model.step(1e-3);
        fresh.step(1e-3);
        stopped.step(1e-3);
    }
    let off = |model: &Precomputed| {
        let of = |n: &NodeId| {
            model.state().positions_m[n.index()].distance(cut.model.state().positions_m[n.index()])
        };
        loose.iter().map(of).fold(0.0, f64::max)
    };
    assert!(off(&fresh) < 1e-6, "{:e} m", off(&fresh));
    assert!(off(&stopped) > 0.03, "{} m", off(&stopped));
}

#[test]
fn a_loose_piece_answers_a_haptic_loop_as_a_body_that_moves() {
    let mut cut = tower();
    cut.remove(&layer_without(&[0, 5]));
    cut.model.apply(&Constraints::default());
    cut.model.step(1e-3);
    let loose = cut.model.loose_nodes();
    let held = cut.model.loadable_nodes()[3];
    let patch = [*loose.last().unwrap(), held];
    let period_s = 1e-3;
    let mut work = LocalWork::with_room_for(cut.body.mesh().positions_m.len());
    let mut out = LocalModel::new();
    cut.model.local_model_into(&patch, period_s, &mut work, &mut out);
    let count = allocation_counter::measure(|| {
        cut.model.local_model_into(&patch, period_s, &mut work, &mut out);
    });
    assert_eq!(count.count_total, 0);
    let table = cut.model.compliance_m_per_n(held, held).unwrap();
    assert!((out.tensor_m_per_n(1, 1) - table).to_cols_array().iter().all(|x| x.abs() < 1e-15));
    assert_eq!(out.tensor_m_per_n(0, 1), DMat3::ZERO);
    // What a force of short duration does to it, beside a copy without.
    let force_n = DVec3::new(1e-3, -2e-3, 1e-3);
    let mut pushed = cut.model.clone();
    let forces = vec![NodalForce { node: patch[0], force_n }];
    pushed.apply(&Constraints { displacements: vec![], forces });
    pushed.step(period_s);
    cut.model.step(period_s);
    let n = patch[0].index();
    let moved_m = pushed.state().positions_m[n] - cut.model.state().positions_m[n];
    let told_m = out.tensor_m_per_n(0, 0) * force_n;
    // Implicit over the period on one side, explicit parts of it on the other.
    let share = moved_m.dot(told_m) / told_m.length_squared();
    assert!((0.3..2.0).contains(&share) && moved_m.length() > 1e-7, "{moved_m} {told_m}");
    assert!(out.n_rings.is_some() && !out.missed_tolerance);
}

#[test]
fn what_a_file_keeps_is_read_from_its_head() {
    let folder = tempfile::tempdir().unwrap();
    for (stored, precision) in [
        (StoredNodes::All, Precision::F32),
        (StoredNodes::Surface, Precision::F32),
        (StoredNodes::All, Precision::F64),
    ] {
        let mesh = block([3, 3, 4], DVec3::new(0.03, 0.03, 0.04));
        let cut = Cut::new(mesh, stored, precision);
        let file = folder.path().join("tower.compliance");
        cut.model.save(&file).unwrap();
        assert_eq!(Precomputed::kept_in(&file).unwrap(), (stored, precision));
        // The scene's way to a model of the organ as it was cut.
        let mut body = OrganBody::new(cut.body.mesh().clone(), material(), 1e-3);
        body.fixed = cut.fixed.iter().copied().map(FixedNode::all_axes).collect();
        body.precomputed = Some(file);
        let mut live = vec![true; cut.body.mesh().tetrahedra.len()];
        live[5] = false;
        let model = build_model_as_cut(&body, ModelKind::Precomputed, &live).unwrap();
        assert_eq!(model.report().n_reanalyses, 0);
    }
    assert!(Precomputed::kept_in(&folder.path().join("nothing")).is_err());
}
