//! The pre-computation: its file that grows while computing, its two forms, and the references it is held against.

use std::io::Write;
use std::path::Path;
use std::sync::atomic::{AtomicUsize, Ordering};

use glisson_mesh::math::{DMat3, DVec3, SeededRandom};
use glisson_mesh::mesh::box_mesh::box_of_five;
use glisson_mesh::mesh::edit::{EditableMesh, MeshEdit};
use glisson_mesh::mesh::{NodeId, TetId, TetMesh};
use glisson_tissue::material::LinearElastic;
use glisson_tissue::model::ImposedDisplacement;
use glisson_tissue::model::precomputed::{
    Precision, Precomputed, PrecomputedError, PrecomputedExpectation, PrecomputedParams, StoredNodes,
    StreamOptions, StreamSummary, UnitDisplacements, check_compliance, partial_path, precompute_to_file,
};
use glisson_tissue::model::{Constraints, DeformableModel};
use glisson_tissue::solve::{
    BoundaryConditions, FreeSystem, IncompleteCholesky, LagrangeError, LagrangeSolution, LinearConstraint,
    MeshEdges, StaticProblem, StiffnessTensors, solve_lagrange, solve_lagrange_densely, solve_static,
};

use crate::model_meshes::{nodes_below, relative_difference, shaken_block};

fn material() -> LinearElastic {
    LinearElastic::from_young_poisson(5000.0, 0.45, 1060.0).unwrap()
}

/// A shaken block, held at one end: its loadable nodes fill four blocks of a file and a part of a fifth.
fn organ() -> (TetMesh, Vec<NodeId>) {
    let mesh = shaken_block([5, 4, 3], DVec3::new(0.1, 0.06, 0.05), 0.15, 11);
    let fixed = nodes_below(&mesh, 0, 0.012);
    (mesh, fixed)
}

struct Body {
    mesh: TetMesh,
    fixed: Vec<NodeId>,
    material: LinearElastic,
}

impl Body {
    fn new() -> Self {
        let (mesh, fixed) = organ();
        Self { mesh, fixed, material: material() }
    }

    fn params(&self) -> PrecomputedParams<'_> {
        PrecomputedParams {
            mesh: &self.mesh,
            material: &self.material,
            fixed_nodes: &self.fixed,
            stored: StoredNodes::Surface,
            precision: Precision::F64,
            progress: None,
        }
    }

    fn expectation(&self) -> PrecomputedExpectation<'_> {
        PrecomputedExpectation { mesh: &self.mesh, material: &self.material, fixed_nodes: &self.fixed }
    }

    fn model(&self) -> Precomputed {
        Precomputed::build(&self.params()).unwrap()
    }
}

fn stream(params: &PrecomputedParams<'_>, path: &Path) -> Result<StreamSummary, PrecomputedError> {
    precompute_to_file(params, path, &StreamOptions::default())
}

/// Stops when asked for the `n`th time.
fn stopping_at(n: usize) -> impl Fn() -> bool + Sync {
    let asked = AtomicUsize::new(0);
    move || asked.fetch_add(1, Ordering::Relaxed) + 1 >= n
}

fn on_threads<T: Send>(n: usize, work: impl FnOnce() -> T + Send) -> T {
    rayon::ThreadPoolBuilder::new().num_threads(n).build().unwrap().install(work)
}

#[test]
fn a_file_written_while_computing_has_the_bytes_of_a_saved_model() {
    let body = Body::new();
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("c");
    for stored in [StoredNodes::Surface, StoredNodes::All] {
        for precision in [Precision::F64, Precision::F32] {
            let params = PrecomputedParams { stored, precision, ..body.params() };
            let model = Precomputed::build(&params).unwrap();
            let n_bytes = model.save(&path).unwrap();
            let saved = std::fs::read(&path).unwrap();
            for threads in [1, 3] {
                let summary = on_threads(threads, || stream(&params, &path)).unwrap();
                assert_eq!(
                    summary,
                    StreamSummary {
                        n_loadable: model.loadable_nodes().len(),
                        n_stored: model.stored_nodes().len(),
                        n_resumed: 0,
                        n_bytes,
                    }
                );
                assert!(std::fs::read(&path).unwrap() == saved, "{stored:?} {precision:?} {threads}");
                assert!(!partial_path(&path).exists());
            }
            let loaded = Precomputed::load(&path, &body.expectation()).unwrap();
            let (a, b) = (model.stored_nodes()[9], model.loadable_nodes()[7]);
            assert_eq!(loaded.compliance_m_per_n(a, b), model.compliance_m_per_n(a, b));
        }
    }
}

#[test]
fn an_interrupted_precomputation_goes_on_to_the_same_bytes() {
    let body = Body::new();
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("c");
    body.model().save(&path).unwrap();
    let whole = std::fs::read(&path).unwrap();
    std::fs::remove_file(&path).unwrap();
    let partial = partial_path(&path);
    let interrupt = || {
        let stop = stopping_at(2);
        let options = StreamOptions { restart: true, stop: Some(&stop) };
        on_threads(1, || precompute_to_file(&body.params(), &path, &options)).unwrap_err()
    };
    // One thread's first lot: two blocks of 16 nodes.
    let error = interrupt();
    assert!(matches!(error, PrecomputedError::Stopped { done: 32, total: 65.., .. }), "{error}");
    assert!(error.to_string().contains("do the same again to go on"), "{error}");
    assert!(!path.exists());
    let two_blocks = std::fs::read(&partial).unwrap();
    assert!(whole.starts_with(&two_blocks));
    let block_bytes = 16 * 8 * 72 * (body.model().loadable_nodes().len().div_ceil(8)) + 32;
    let head_bytes = two_blocks.len() - 2 * block_bytes;

    let mut told = Vec::new();
    let lock = std::sync::Mutex::new(&mut told);
    let progress = |done: usize, _: usize| lock.lock().unwrap().push(done);
    let params = PrecomputedParams { progress: Some(&progress), ..body.params() };
    assert_eq!(stream(&params, &path).unwrap().n_resumed, 32);
    assert!(std::fs::read(&path).unwrap() == whole);
    assert_eq!(told[0], 32);
    assert_eq!(*told.iter().max().unwrap(), body.model().loadable_nodes().len());

    // Whatever a crash leaves: cut anywhere, or a later part not what was written.
    let cut = |n: usize| whole[..n].to_vec();
    let mut flipped = whole.clone();
    flipped[head_bytes + block_bytes + 5] ^= 1;
    for (left, resumed) in [
        (cut(0), 0),
        (cut(5), 0),
        (cut(head_bytes - 1), 0),
        (cut(head_bytes), 0),
        (cut(head_bytes + block_bytes - 1), 0),
        (cut(head_bytes + block_bytes), 16),
        (cut(head_bytes + 2 * block_bytes + 7), 32),
        (flipped, 16),
        (whole.clone(), body.model().loadable_nodes().len()),
    ] {
        let n = left.len();
        std::fs::write(&partial, left).unwrap();
        match stream(&body.params(), &path) {
            Ok(summary) => assert_eq!(summary.n_resumed, resumed, "{n} bytes"),
            // Too short to be known as ours.
            Err(error) => assert!(n == 5 && matches!(error, PrecomputedError::BadPartial { .. }), "{error}"),
        }
        assert!(std::fs::read(&path).unwrap() == whole, "{n} bytes");
    }
}

#[test]
fn what_is_left_of_another_precomputation_is_refused_and_kept() {
    let body = Body::new();
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("c");
    let partial = partial_path(&path);
    let stop = stopping_at(2);
    let options = StreamOptions { restart: false, stop: Some(&stop) };
    on_threads(1, || precompute_to_file(&body.params(), &path, &options)).unwrap_err();
    let left = std::fs::read(&partial).unwrap();

    let mut moved = body.mesh.clone();
    moved.positions_m[3].x += 1e-15;
    let stiffer = LinearElastic::from_young_poisson(6000.0, 0.45, 1060.0).unwrap();
    let denser = LinearElastic::from_young_poisson(5000.0, 0.45, 1000.0).unwrap();
    let others = [
        (PrecomputedParams { mesh: &moved, ..body.params() }, "the mesh"),
        (PrecomputedParams { material: &stiffer, ..body.params() }, "E = 6000 Pa"),
        (PrecomputedParams { material: &denser, ..body.params() }, "the density 1060 kg/m3"),
        (PrecomputedParams { fixed_nodes: &body.fixed[1..], ..body.params() }, "the fixed nodes"),
        (PrecomputedParams { stored: StoredNodes::All, ..body.params() }, "a number of stored nodes"),
        (PrecomputedParams { precision: Precision::F32, ..body.params() }, "as many bytes as 8"),
    ];
    for (params, difference) in &others {
        let message = stream(params, &path).unwrap_err().to_string();
        assert!(message.contains(difference) && message.contains("--restart"), "{message}");
        assert!(message.starts_with(&partial.display().to_string()), "{message}");
    }
    assert!(std::fs::read(&partial).unwrap() == left);

    let mut old = left.clone();
    old[8] = 3;
    for (bytes, expected) in [(old, "version 3"), (b"my only letter".to_vec(), "not a pre-computed")] {
        std::fs::write(&partial, &bytes).unwrap();
        let message = stream(&body.params(), &path).unwrap_err().to_string();
        assert!(message.contains(expected) && message.contains("--restart"), "{message}");
        assert_eq!(std::fs::read(&partial).unwrap(), bytes);
    }
    // Another program that writes it.
    let other = std::fs::File::open(&partial).unwrap();
    other.lock().unwrap();
    let error = stream(&body.params(), &path).unwrap_err();
    assert!(matches!(error, PrecomputedError::Busy { .. }), "{error}");
    drop(other);

    let options = StreamOptions { restart: true, stop: None };
    assert_eq!(precompute_to_file(&body.params(), &path, &options).unwrap().n_resumed, 0);
    assert!(Precomputed::load(&path, &body.expectation()).is_ok());
}

#[test]
fn what_has_no_solution_leaves_no_file() {
    let body = Body::new();
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("c");
    std::fs::write(&path, "an older file").unwrap();
    let params = PrecomputedParams { fixed_nodes: &body.fixed[..1], ..body.params() };
    let message = stream(&params, &path).unwrap_err().to_string();
    assert!(message.contains("rotation about x, rotation about y, rotation about z"), "{message}");
    // A hinge is noticed by the factor: two tetrahedra on one edge, one of them held.
    let mesh = TetMesh {
        positions_m: [[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1], [0, -1, 0], [1, -1, -1]]
            .map(|p| DVec3::from_array(p.map(f64::from)) * 0.01)
            .to_vec(),
        tetrahedra: vec![[0, 1, 2, 3].map(NodeId), [0, 1, 5, 4].map(NodeId)],
        ..TetMesh::default()
    };
    let mesh = if mesh.tet_volume_m3(glisson_mesh::mesh::TetId(1)) > 0.0 {
        mesh
    } else {
        TetMesh { tetrahedra: vec![mesh.tetrahedra[0], [0, 1, 4, 5].map(NodeId)], ..mesh }
    };
    let fixed_nodes = &[0, 2, 3].map(NodeId)[..];
    let params = PrecomputedParams { mesh: &mesh, fixed_nodes, ..body.params() };
    let message = stream(&params, &path).unwrap_err().to_string();
    assert!(message.contains("hang together by a vertex or an edge"), "{message}");
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1);
    assert_eq!(std::fs::read(&path).unwrap(), b"an older file");
}

#[cfg(target_os = "linux")]
#[test]
fn a_full_disk_is_told_and_what_was_there_stays() {
    let body = Body::new();
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("c");
    std::fs::write(&path, "an older file").unwrap();
    std::os::unix::fs::symlink("/dev/full", partial_path(&path)).unwrap();
    let error = stream(&body.params(), &path).unwrap_err();
    assert!(matches!(error, PrecomputedError::Unfinished { done: 0, .. }), "{error}");
    let message = error.to_string();
    assert!(message.contains("No space left") && message.contains("make room"), "{message}");
    assert_eq!(std::fs::read(&path).unwrap(), b"an older file");
}

#[test]
fn a_file_longer_than_its_compliance_is_refused() {
    let body = Body::new();
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("c");
    stream(&body.params(), &path).unwrap();
    std::fs::OpenOptions::new().append(true).open(&path).unwrap().write_all(b"x").unwrap();
    let message = Precomputed::load(&path, &body.expectation()).unwrap_err().to_string();
    assert!(message.contains("its header asks for"), "{message}");
}

#[test]
fn a_compliance_is_that_of_direct_solutions_and_symmetric() {
    let body = Body::new();
    for (precision, difference, asymmetry) in [(Precision::F64, 1e-10, 1e-12), (Precision::F32, 1e-5, 1e-6)] {
        let params = PrecomputedParams { precision, stored: StoredNodes::All, ..body.params() };
        let model = Precomputed::build(&params).unwrap();
        let check = check_compliance(&model, &body.mesh, 10).unwrap();
        assert!((8..=12).contains(&check.n_compared), "{check:?}");
        assert!(check.difference <= difference && check.asymmetry <= asymmetry, "{check:?}");
        // The check sees: on another mesh nothing agrees.
        let mut other = body.mesh.clone();
        other.positions_m.iter_mut().for_each(|p| p.x *= 1.001);
        let check = check_compliance(&model, &other, 10).unwrap();
        assert!(check.difference > 1e-5, "{check:?}");
    }
}

fn largest(tensors: impl IntoIterator<Item = DMat3>) -> f64 {
    tensors.into_iter().flat_map(|t| t.to_cols_array()).fold(0.0, |most, x| most.max(x.abs()))
}

#[test]
fn unit_displacements_by_compliance_are_those_solved_directly() {
    let body = Body::new();
    let model = body.model();
    let nodes: Vec<NodeId> = model.loadable_nodes().iter().copied().step_by(17).collect();
    let derived = UnitDisplacements::of(&model, &nodes);
    let solved =
        UnitDisplacements::compute(&body.mesh, &body.material, &body.fixed, &nodes, model.stored_nodes())
            .unwrap();
    assert_eq!(derived.nodes().len(), nodes.len());
    for (a, b) in derived.nodes().iter().zip(solved.nodes()) {
        assert_eq!(a.node, b.node);
        let off = largest([a.force_n_per_m - b.force_n_per_m]) / largest([b.force_n_per_m]);
        assert!(off < 1e-11, "{off:e}");
        let off = largest(a.displacement.iter().zip(&b.displacement).map(|(a, b)| *a - *b));
        assert!(off < 1e-11, "{off:e}");
        // And back to the compliance.
        for (tensor, &l) in b.compliance_m_per_n().zip(model.stored_nodes()) {
            let wanted = model.compliance_m_per_n(l, a.node).unwrap();
            assert!(largest([tensor - wanted]) < 1e-11 * largest([wanted]).max(1e-3));
        }
    }
    // Several at once, by the papers' equations 8 to 10 and by the model.
    let mut random = SeededRandom::new(4);
    let imposed: Vec<ImposedDisplacement> = nodes
        .iter()
        .map(|&node| ImposedDisplacement {
            node,
            displacement_m: DVec3::new(random.normal(), random.normal(), random.normal()) * 0.002,
        })
        .collect();
    let (u_m, force_n) = solved.respond(&imposed).unwrap();
    let mut model = model;
    model.apply(&Constraints { displacements: imposed.clone(), forces: vec![] });
    model.step(0.0);
    let place = |n: &NodeId| model.state().positions_m[n.index()] - body.mesh.positions_m[n.index()];
    let expected: Vec<DVec3> = model.stored_nodes().iter().map(place).collect();
    assert!(relative_difference(&u_m, &expected) < 1e-10);
    assert!(relative_difference(&force_n, model.constraint_forces_n()) < 1e-10);
    let (twice, unknown) =
        ([imposed[0], imposed[0]], ImposedDisplacement { node: body.fixed[0], ..imposed[0] });
    assert!(solved.respond(&twice).is_none() && solved.respond(&[unknown]).is_none());
    assert!(
        UnitDisplacements::compute(&body.mesh, &body.material, &body.fixed[..1], &nodes, &nodes).is_err()
    );
}

/// A problem of the body, constraints on it, and both solutions.
fn by_multipliers(
    body: &Body,
    conditions: &BoundaryConditions,
    force_n: &[DVec3],
    constraints: &[LinearConstraint],
) -> [Result<LagrangeSolution, LagrangeError>; 2] {
    let (mesh, material) = (&body.mesh, &body.material);
    let problem = StaticProblem { mesh, material, conditions, nodal_force_n: force_n };
    [solve_lagrange_densely(&problem, constraints), solve_lagrange(&problem, constraints)]
}

#[test]
fn multipliers_are_the_opposite_of_the_forces_that_hold_the_nodes() {
    let body = Body::new();
    let model = body.model();
    let loadable = model.loadable_nodes();
    let mut force_n = vec![DVec3::ZERO; body.mesh.positions_m.len()];
    force_n[loadable[40].index()] = DVec3::new(0.01, -0.02, 0.005);
    let held = [(loadable[3], DVec3::new(1e-3, 0.0, -2e-3)), (loadable[50], DVec3::new(0.0, 2e-3, 1e-3))];
    let constraints: Vec<LinearConstraint> =
        held.iter().flat_map(|&(node, u_m)| LinearConstraint::node(node, u_m)).collect();
    let fixed = BoundaryConditions::fixed(&body.fixed);
    let mut conditions = fixed.clone();
    held.iter().for_each(|&(node, u_m)| conditions.impose_node(node, u_m));
    let reference = solve_static(&StaticProblem {
        mesh: &body.mesh,
        material: &body.material,
        conditions: &conditions,
        nodal_force_n: &force_n,
    })
    .unwrap();
    let reaction_n: Vec<DVec3> = held.iter().map(|(node, _)| reference.reaction_n[node.index()]).collect();
    for solution in by_multipliers(&body, &fixed, &force_n, &constraints) {
        let solution = solution.unwrap();
        assert!(relative_difference(&solution.displacement_m, &reference.displacement_m) < 1e-10);
        let exerted: Vec<DVec3> =
            solution.multiplier_n.chunks_exact(3).map(|l| -DVec3::from_slice(l)).collect();
        assert!(relative_difference(&exerted, &reaction_n) < 1e-9);
    }
}

#[test]
fn points_inside_triangles_are_held_by_weighted_rows() {
    let body = Body::new();
    let model = body.model();
    let (a, b, c) = (model.loadable_nodes()[8], model.loadable_nodes()[9], model.loadable_nodes()[30]);
    let row = |axis, value_m| LinearConstraint {
        terms: vec![(a, axis, 0.5), (b, axis, 0.3), (c, axis, 0.2)],
        value_m,
    };
    // One axis stays free.
    let constraints = [row(0, 1e-3), row(2, -2e-3)];
    let nothing = vec![DVec3::ZERO; body.mesh.positions_m.len()];
    let fixed = BoundaryConditions::fixed(&body.fixed);
    let [dense, sparse] = by_multipliers(&body, &fixed, &nothing, &constraints).map(Result::unwrap);
    assert!(relative_difference(&dense.displacement_m, &sparse.displacement_m) < 1e-10);
    for solution in [&dense, &sparse] {
        let u_m = |n: NodeId, axis: usize| solution.displacement_m[n.index()][axis];
        for (axis, value_m) in [(0, 1e-3), (2, -2e-3)] {
            let found = 0.5 * u_m(a, axis) + 0.3 * u_m(b, axis) + 0.2 * u_m(c, axis);
            assert!((found - value_m).abs() < 1e-14, "{found}");
        }
    }
    // The multipliers over the nodes, by their weights, are the forces of the response.
    let l = DVec3::new(sparse.multiplier_n[0], 0.0, sparse.multiplier_n[1]);
    let response = |n: NodeId| {
        [(a, 0.5), (b, 0.3), (c, 0.2)]
            .iter()
            .map(|&(m, w)| model.compliance_m_per_n(n, m).unwrap() * (-w * l))
            .fold(DVec3::ZERO, |s, u| s + u)
    };
    let stored: Vec<DVec3> = model.stored_nodes().iter().map(|&n| response(n)).collect();
    let solved: Vec<DVec3> = model.stored_nodes().iter().map(|n| sparse.displacement_m[n.index()]).collect();
    assert!(relative_difference(&stored, &solved) < 1e-9);
}

#[test]
fn constraints_that_say_nothing_new_are_refused_and_a_body_may_hang_on_constraints_alone() {
    let body = Body::new();
    let loadable = body.model().loadable_nodes().to_vec();
    let nothing = vec![DVec3::ZERO; body.mesh.positions_m.len()];
    let fixed = BoundaryConditions::fixed(&body.fixed);
    let [x, y, _] = LinearConstraint::node(loadable[5], DVec3::splat(1e-3));
    let repeated = [x.clone(), y, x.clone()];
    let [dense, sparse] = by_multipliers(&body, &fixed, &nothing, &repeated);
    assert!(matches!(dense, Err(LagrangeError::Singular { .. })), "{dense:?}");
    assert_eq!(sparse, Err(LagrangeError::Dependent { constraint: 2 }));
    let supported = [LinearConstraint::component(body.fixed[0], 1, 0.0)];
    assert_eq!(
        by_multipliers(&body, &fixed, &nothing, &supported)[1],
        Err(LagrangeError::Dependent { constraint: 0 })
    );
    let missing = [LinearConstraint::component(NodeId(9999), 1, 0.0)];
    for solution in by_multipliers(&body, &fixed, &nothing, &missing) {
        assert!(matches!(solution, Err(LagrangeError::Solve(_))), "{solution:?}");
    }
    // Eq. 2 without any support: all nodes of the end held as constraints.
    let hung: Vec<LinearConstraint> =
        body.fixed.iter().flat_map(|&n| LinearConstraint::node(n, DVec3::ZERO)).chain([x]).collect();
    let [dense, sparse] = by_multipliers(&body, &BoundaryConditions::new(), &nothing, &hung);
    assert!(matches!(sparse, Err(LagrangeError::Solve(_))), "{sparse:?}");
    let held = by_multipliers(&body, &fixed, &nothing, &hung[hung.len() - 1..]);
    let [_, sparse] = held.map(Result::unwrap);
    assert!(relative_difference(&dense.unwrap().displacement_m, &sparse.displacement_m) < 1e-10);
}

#[test]
fn conjugate_gradients_come_to_the_factors_solution() {
    let body = Body::new();
    let edges = MeshEdges::of_mesh(&body.mesh).unwrap();
    let tensors = StiffnessTensors::assemble(&body.mesh, &edges, &body.material).unwrap();
    let system = FreeSystem::new(&edges, &tensors, &BoundaryConditions::fixed(&body.fixed)).unwrap();
    let mut random = SeededRandom::new(2);
    let right: Vec<f64> = (0..system.n_free()).map(|_| random.normal()).collect();
    let factor = system.factorize().unwrap();
    let mut expected = right.clone();
    factor.solve_in_place(&mut expected, 1, &mut factor.scratch(1));

    let preconditioner = IncompleteCholesky::new(&system).unwrap();
    let mut scratch = preconditioner.scratch();
    let mut found = vec![0.0; system.n_free()];
    let report = preconditioner.solve_into(&right, &mut found, 1e-12, 1000, &mut scratch, |_| false);
    let size = expected.iter().fold(0.0, |s: f64, x| s.max(x.abs()));
    let off = found.iter().zip(&expected).fold(0.0, |s: f64, (a, b)| s.max((a - b).abs())) / size;
    assert!(report.converged && off < 1e-9, "{report:?} {off:e}");
    // The preconditioner is worth its name: without it a conjugate gradient takes some three times as many.
    assert!(report.n_iterations < system.n_free() / 2, "{report:?} of {}", system.n_free());
    let mut n_told = 0;
    let enough = |_: &[f64]| {
        n_told += 1;
        n_told == 5
    };
    let report = preconditioner.solve_into(&right, &mut found, 0.0, 1000, &mut scratch, enough);
    assert_eq!((report.n_iterations, report.converged), (5, true));
    let report = preconditioner.solve_into(&right, &mut found, 1e-12, 3, &mut scratch, |_| false);
    assert!(!report.converged && report.relative_residual > 1e-12);
    found.fill(1.0);
    let none =
        preconditioner.solve_into(&vec![0.0; found.len()], &mut found, 1e-12, 3, &mut scratch, |_| false);
    assert!(none.converged && found.iter().all(|x| *x == 0.0));
}

#[test]
fn a_large_body_is_dissected_and_solved_all_the_same() {
    let mesh = glisson_mesh::mesh::box_mesh::cube_of_five(15, 0.1);
    assert!(mesh.positions_m.len() > 3000);
    let edges = MeshEdges::of_mesh(&mesh).unwrap();
    let tensors = StiffnessTensors::assemble(&mesh, &edges, &material()).unwrap();
    let conditions = BoundaryConditions::fixed(&nodes_below(&mesh, 2, 1e-6));
    let by_degree = FreeSystem::new(&edges, &tensors, &conditions).unwrap().factorize().unwrap();
    let dissected = FreeSystem::for_many_solutions(&mesh.positions_m, &edges, &tensors, &conditions).unwrap();
    let dissected = dissected.factorize().unwrap();
    let (few, many) = (dissected.n_entries(), by_degree.n_entries());
    assert!(10 * few < 9 * many, "{few} {many}");
    let solved = [by_degree, dissected].map(|factor| {
        let mut random = SeededRandom::new(6);
        let mut x: Vec<f64> = (0..factor.n_rows()).map(|_| random.normal()).collect();
        factor.solve_in_place(&mut x, 1, &mut factor.scratch(1));
        x.chunks_exact(3).map(DVec3::from_slice).collect::<Vec<_>>()
    });
    assert!(relative_difference(&solved[1], &solved[0]) < 1e-10);
}

/// A slender column that is held below, and of a layer of which one tetrahedron is left: what is above hangs at an edge.
fn hanging_at_an_edge() -> (TetMesh, Precomputed) {
    let edge_m = 5e-3;
    let mesh = box_of_five([1, 1, 8], DVec3::new(edge_m, edge_m, 8.0 * edge_m));
    let low_m = mesh.positions_m.iter().map(|p| p.z).fold(f64::INFINITY, f64::min);
    let layer_of = |n: NodeId| ((mesh.positions_m[n.index()].z - low_m) / edge_m).round() as usize;
    let nodes = (0..mesh.positions_m.len()).map(NodeId::from_index);
    let fixed: Vec<NodeId> = nodes.filter(|&n| layer_of(n) == 0).collect();
    let count = |t: &[NodeId; 4], layer: usize| t.iter().filter(|&&n| layer_of(n) == layer).count();
    let is_hinge = |t: &[NodeId; 4]| count(t, 6) == 2 && count(t, 7) == 2;
    let hinge = mesh.tetrahedra.iter().position(is_hinge).expect("one in the middle of the cell");
    let is_in_layer = |t: usize| count(&mesh.tetrahedra[t], 6) > 0 && count(&mesh.tetrahedra[t], 7) > 0;
    let tets = (0..mesh.tetrahedra.len()).filter(|&t| t != hinge && is_in_layer(t));
    let tets = tets.map(TetId::from_index).collect();
    let mut model = Precomputed::build(&PrecomputedParams {
        mesh: &mesh,
        material: &material(),
        fixed_nodes: &fixed,
        stored: StoredNodes::Surface,
        precision: Precision::F64,
        progress: None,
    })
    .unwrap();
    let mut body = EditableMesh::new(mesh.clone()).unwrap();
    let change = body.apply(&MeshEdit::Remove { tets }).unwrap();
    model.topology_changed(body.mesh(), &change).unwrap();
    (mesh, model)
}

/// The soak of edits found it: tissue at a hinge that is stretched to many times its length is stiffer than the share of its
/// pull was made for, and column and piece threw each other further in every step, to places that are no numbers.
#[test]
fn a_piece_that_is_pulled_far_from_its_hinge_does_not_swing_up() {
    let (mesh, model) = hanging_at_an_edge();
    let high_m = mesh.positions_m.iter().map(|p| p.z).fold(f64::NEG_INFINITY, f64::max);
    for way_m in [DVec3::new(0.1, 0.0, 0.0), DVec3::new(-0.05, 0.03, -0.08)] {
        let mut model = model.duplicate();
        let pulled_m: Vec<DVec3> =
            mesh.positions_m.iter().map(|p| if p.z > high_m - 7e-3 { *p + way_m } else { *p }).collect();
        model.take_over(&pulled_m);
        model.apply(&Constraints::default());
        let mut furthest_m = 0.0_f64;
        for _ in 0..200 {
            model.step(1e-2);
            let now_m = model.state().positions_m;
            let away_m = now_m.iter().zip(&mesh.positions_m).map(|(a, b)| a.distance(*b));
            furthest_m = away_m.fold(furthest_m, f64::max);
        }
        let kinetic_j = model.report().kinetic_energy_j;
        assert!(furthest_m < 2.0, "{way_m}: {furthest_m} m");
        assert!(kinetic_j < 1e-2, "{way_m}: {kinetic_j} J");
    }
}
