//! The pre-computed and the tensor-mass model against the static solver, against each other, and against exact
//! solutions; files of the pre-computed model.

use std::path::Path;

use glisson_mesh::math::{DMat3, DVec3, SeededRandom};
use glisson_mesh::mesh::edit::{EditableMesh, MeshEdit};
use glisson_mesh::mesh::{NodeId, TetId, TetMesh};
use glisson_tissue::material::LinearElastic;
use glisson_tissue::model::precomputed::{
    Precision, Precomputed, PrecomputedError, PrecomputedExpectation, PrecomputedParams, StoredNodes,
};
use glisson_tissue::model::tensor_mass::{TensorMass, TensorMassError, TensorMassParams};
use glisson_tissue::model::{
    Constraints, DeformableModel, DynamicBody, ImposedDisplacement, NodalForce, Rayleigh, TopologyRefusal,
};
use glisson_tissue::solve::{BoundaryConditions, SolveError, StaticProblem, solve_static};
use proptest::prelude::*;

use crate::model_meshes::{block, held, nodes_below, random_live_tets, relative_difference, shaken_block};

fn material() -> LinearElastic {
    LinearElastic::from_young_poisson(5000.0, 0.45, 1060.0).unwrap()
}

/// A shaken block, held at one end.
fn organ() -> (TetMesh, Vec<NodeId>) {
    let mesh = shaken_block([5, 3, 3], DVec3::new(0.1, 0.06, 0.05), 0.15, 11);
    let fixed = nodes_below(&mesh, 0, 0.012);
    assert!(fixed.len() >= 4);
    (mesh, fixed)
}

fn precomputed(mesh: &TetMesh, fixed_nodes: &[NodeId], stored: StoredNodes) -> Precomputed {
    let material = material();
    let params = PrecomputedParams {
        mesh,
        material: &material,
        fixed_nodes,
        stored,
        precision: Precision::F64,
        progress: None,
    };
    Precomputed::build(&params).unwrap()
}

/// Forces and displacements on some loadable nodes, at random, ascending.
fn load(model: &Precomputed, n_forces: usize, n_displacements: usize, seed: u64) -> Constraints {
    let mut random = SeededRandom::new(seed);
    let mut vector = |size: f64| DVec3::new(random.normal(), random.normal(), random.normal()) * size;
    let nodes = model.loadable_nodes();
    let stride = nodes.len() / (n_forces + n_displacements + 1);
    let mut constraints = Constraints::default();
    for (i, &node) in nodes.iter().step_by(stride).take(n_forces + n_displacements).enumerate() {
        // Mixed, so that both lists span the body.
        if i % 2 == 0 && constraints.forces.len() < n_forces
            || constraints.displacements.len() == n_displacements
        {
            constraints.forces.push(NodalForce { node, force_n: vector(0.02) });
        } else {
            constraints.displacements.push(ImposedDisplacement { node, displacement_m: vector(0.003) });
        }
    }
    constraints
}

/// Displacements and constraint forces of the same load by the static solver.
fn solved(mesh: &TetMesh, fixed: &[NodeId], constraints: &Constraints) -> (Vec<DVec3>, Vec<DVec3>) {
    let mut conditions = BoundaryConditions::fixed(fixed);
    for held in &constraints.displacements {
        conditions.impose_node(held.node, held.displacement_m);
    }
    let mut nodal_force_n = vec![DVec3::ZERO; mesh.positions_m.len()];
    for force in &constraints.forces {
        nodal_force_n[force.node.index()] = force.force_n;
    }
    let material = material();
    let solution = solve_static(&StaticProblem {
        mesh,
        material: &material,
        conditions: &conditions,
        nodal_force_n: &nodal_force_n,
    })
    .unwrap();
    let forces_n = constraints.displacements.iter().map(|d| solution.reaction_n[d.node.index()]).collect();
    (solution.displacement_m, forces_n)
}

fn displacements(model: &impl DeformableModel, mesh: &TetMesh) -> Vec<DVec3> {
    model.state().positions_m.iter().zip(&mesh.positions_m).map(|(x, rest)| *x - *rest).collect()
}

#[test]
fn precomputed_response_equals_the_static_solution() {
    let (mesh, fixed) = organ();
    let mut model = precomputed(&mesh, &fixed, StoredNodes::All);
    for (n_forces, n_displacements) in [(1, 0), (0, 1), (7, 0), (0, 12), (9, 8), (0, 40)] {
        let constraints = load(&model, n_forces, n_displacements, 3);
        assert_eq!(constraints.forces.len(), n_forces);
        assert_eq!(constraints.displacements.len(), n_displacements);
        model.apply(&constraints);
        model.step(0.01);
        assert_eq!(model.response_report(), Default::default());
        let (u_m, forces_n) = solved(&mesh, &fixed, &constraints);
        let off = relative_difference(&displacements(&model, &mesh), &u_m);
        assert!(off < 1e-10, "{n_forces} forces, {n_displacements} displacements: {off:e}");
        if n_displacements > 0 {
            let off = relative_difference(model.constraint_forces_n(), &forces_n);
            assert!(off < 1e-10, "{n_forces} forces, {n_displacements} displacements: {off:e}");
            for held in &constraints.displacements {
                let x = model.state().positions_m[held.node.index()];
                let error_m = (x - mesh.positions_m[held.node.index()] - held.displacement_m).length();
                assert!(error_m <= 1e-12 * 0.003, "{error_m:e}");
            }
        }
    }
    model.reset();
    assert_eq!(model.state().positions_m, &mesh.positions_m[..]);
}

#[test]
fn compliance_is_symmetric_and_the_surface_alone_gives_the_same_numbers() {
    let (mesh, fixed) = organ();
    let all = precomputed(&mesh, &fixed, StoredNodes::All);
    let surface = precomputed(&mesh, &fixed, StoredNodes::Surface);
    assert!(surface.stored_nodes().len() < all.stored_nodes().len());
    assert_eq!(surface.loadable_nodes(), all.loadable_nodes());
    let nodes = surface.loadable_nodes();
    let size = |m: DMat3| m.to_cols_array().into_iter().fold(0.0, |s: f64, x| s.max(x.abs()));
    let largest = nodes.iter().map(|&n| size(surface.compliance_m_per_n(n, n).unwrap())).fold(0.0, f64::max);
    for &l in nodes {
        for &m in nodes {
            let lm = surface.compliance_m_per_n(l, m).unwrap();
            let ml = surface.compliance_m_per_n(m, l).unwrap();
            assert!(size(lm - ml.transpose()) <= 1e-12 * largest);
            assert_eq!(lm, all.compliance_m_per_n(l, m).unwrap());
        }
    }
    assert!(all.compliance_m_per_n(fixed[0], nodes[0]).is_none());
    assert!(surface.compliance_m_per_n(nodes[0], fixed[0]).is_none());
    // Inner nodes of the surface-only model rest.
    let mut surface = surface;
    let constraints = load(&surface, 3, 2, 1);
    surface.apply(&constraints);
    surface.step(0.01);
    for n in 0..mesh.positions_m.len() {
        let moved = surface.state().positions_m[n] != mesh.positions_m[n];
        assert_eq!(moved, surface.is_loadable(NodeId::from_index(n)));
    }
}

#[test]
fn compliance_has_the_same_bits_at_any_thread_count() {
    let (mesh, fixed) = organ();
    let with = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        let model = pool.install(|| precomputed(&mesh, &fixed, StoredNodes::Surface));
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("c");
        model.save(&path).unwrap();
        std::fs::read(path).unwrap()
    };
    let one = with(1);
    assert_eq!(one, with(2));
    assert_eq!(one, with(3));
}

#[test]
fn constraints_that_cannot_act_are_counted_and_harm_nothing() {
    let (mesh, fixed) = organ();
    let mut model = precomputed(&mesh, &fixed, StoredNodes::Surface);
    let good = load(&model, 0, 2, 1);
    model.apply(&good);
    model.step(0.01);
    let expected = model.state().positions_m.to_vec();
    let mut bad = good.clone();
    let u = DVec3::X * 0.001;
    bad.displacements.push(ImposedDisplacement { node: fixed[0], displacement_m: u });
    bad.displacements.push(ImposedDisplacement { node: NodeId(100_000), displacement_m: u });
    bad.displacements
        .push(ImposedDisplacement { node: model.loadable_nodes()[9], displacement_m: u * f64::NAN });
    bad.forces.push(NodalForce { node: fixed[0], force_n: DVec3::X });
    model.apply(&bad);
    model.step(0.01);
    assert_eq!(
        (model.response_report().ignored_displacements, model.response_report().ignored_forces),
        (3, 1)
    );
    assert_eq!(model.state().positions_m, expected);
    assert_eq!(model.constraint_forces_n().len(), 5);
    assert_eq!(model.constraint_forces_n()[2..], [DVec3::ZERO; 3]);
    // The same node twice: the second is without effect.
    let mut twice = good.clone();
    twice.displacements.insert(0, good.displacements[0]);
    model.apply(&twice);
    model.step(0.01);
    assert!(relative_difference(model.state().positions_m, &expected) < 1e-9);

    let mut edited = EditableMesh::new(mesh.clone()).unwrap();
    let (node, position_m) = (NodeId(0), mesh.positions_m[0] + DVec3::splat(1e-6));
    let change = edited.apply(&MeshEdit::MoveVertex { node, position_m }).unwrap();
    let refusal = model.topology_changed(edited.mesh(), &change).unwrap_err();
    assert!(matches!(refusal, TopologyRefusal::Frozen { model: "precomputed", .. }));
}

#[test]
fn what_cannot_be_precomputed_is_refused() {
    let (mesh, _) = organ();
    let material = material();
    let build = |fixed_nodes: &[NodeId]| {
        let stored = StoredNodes::Surface;
        Precomputed::build(&PrecomputedParams {
            mesh: &mesh,
            material: &material,
            fixed_nodes,
            stored,
            precision: Precision::F64,
            progress: None,
        })
        .unwrap_err()
    };
    assert!(matches!(build(&[]), PrecomputedError::Solve(SolveError::Floating { rigid_modes: 6, .. })));
    let everything: Vec<NodeId> = (0..mesh.positions_m.len()).map(NodeId::from_index).collect();
    assert!(matches!(build(&everything), PrecomputedError::NothingLoadable { .. }));
}

/// A small saved model: its file and what it was made for.
fn saved() -> (Vec<u8>, TetMesh, Vec<NodeId>) {
    let mesh = block([1, 1, 1], DVec3::splat(0.02));
    let fixed = nodes_below(&mesh, 2, 0.001);
    let directory = tempfile::tempdir().unwrap();
    let path = directory.path().join("liver.compliance");
    let bytes_written = precomputed(&mesh, &fixed, StoredNodes::Surface).save(&path).unwrap();
    let bytes = std::fs::read(&path).unwrap();
    assert_eq!(bytes.len() as u64, bytes_written);
    assert_eq!(std::fs::read_dir(directory.path()).unwrap().count(), 1, "no temporary file is left");
    (bytes, mesh, fixed)
}

#[test]
fn a_saved_compliance_comes_back_to_the_same_bits() {
    let (mesh, fixed) = organ();
    let mut model = precomputed(&mesh, &fixed, StoredNodes::All);
    let directory = tempfile::tempdir().unwrap();
    let path = directory.path().join("c");
    model.save(&path).unwrap();
    let material = material();
    let expected = PrecomputedExpectation { mesh: &mesh, material: &material, fixed_nodes: &fixed };
    let mut loaded = Precomputed::load(&path, &expected).unwrap();
    let constraints = load(&model, 4, 5, 2);
    for m in [&mut model, &mut loaded] {
        m.apply(&constraints);
        m.step(0.01);
    }
    assert_eq!(model.state().positions_m, loaded.state().positions_m);
    assert_eq!(model.constraint_forces_n(), loaded.constraint_forces_n());
}

#[test]
fn files_of_other_things_are_refused_with_what_was_found_and_expected() {
    let (bytes, mesh, fixed) = saved();
    let material = material();
    let path = Path::new("liver.compliance");
    let load = |bytes: &[u8], mesh: &TetMesh, material: &LinearElastic, fixed_nodes: &[NodeId]| {
        Precomputed::from_bytes(path, bytes, &PrecomputedExpectation { mesh, material, fixed_nodes })
    };
    assert!(load(&bytes, &mesh, &material, &fixed).is_ok());
    let message = |result: Result<Precomputed, PrecomputedError>| {
        let text = result.unwrap_err().to_string();
        assert!(text.starts_with("liver.compliance: "), "{text}");
        text
    };
    let changed = |place: usize, value: u8| {
        let mut bytes = bytes.clone();
        bytes[place] = value;
        message(load(&bytes, &mesh, &material, &fixed))
    };
    assert!(changed(0, b'X').contains("not a pre-computed compliance"));
    assert!(changed(8, 7).contains("format version 7, this program reads version 4"));
    assert!(changed(bytes.len() - 40, 0x55).contains("checksum"));
    assert!(changed(bytes.len() - 1, bytes[bytes.len() - 1] ^ 1).contains("checksum"));
    assert!(changed(90, 0xff).contains("its header asks for"));
    let text = message(load(&bytes[..bytes.len() - 1], &mesh, &material, &fixed));
    assert!(
        text.contains(&format!("{} bytes, but its header asks for {}", bytes.len() - 1, bytes.len())),
        "{text}"
    );

    let mut other = mesh.clone();
    other.positions_m[3].x += 1e-15;
    assert!(message(load(&bytes, &other, &material, &fixed)).contains("the mesh with BLAKE3"));
    let stiffer = LinearElastic::from_young_poisson(6000.0, 0.45, 1060.0).unwrap();
    let text = message(load(&bytes, &mesh, &stiffer, &fixed));
    assert!(text.contains("E = 5000 Pa, nu = 0.45, but the scene has E = 6000 Pa, nu = 0.45"), "{text}");
    let text = message(load(&bytes, &mesh, &material, &fixed[1..]));
    assert!(text.contains("the fixed nodes 4 nodes") && text.contains("3 nodes"), "{text}");
    assert!(message(load(b"", &mesh, &material, &fixed)).contains("not a pre-computed"));
}

proptest! {
    /// Every mutation is noticed; none panics or allocates by a lie.
    #[test]
    fn mutated_compliance_files_never_panic(
        cut in prop::option::of(0usize..4000),
        changes in prop::collection::vec((0usize..4000, any::<u8>()), 0..5),
        header in prop::collection::vec((0usize..104, any::<u8>()), 0..3),
    ) {
        static SAVED: std::sync::OnceLock<(Vec<u8>, TetMesh, Vec<NodeId>)> = std::sync::OnceLock::new();
        let (original, mesh, fixed) = SAVED.get_or_init(saved);
        let mut bytes = original.clone();
        for (place, value) in changes.into_iter().chain(header) {
            let n = bytes.len();
            bytes[place % n] = value;
        }
        if let Some(cut) = cut {
            bytes.truncate(cut);
        }
        let material = material();
        let expected = PrecomputedExpectation { mesh, material: &material, fixed_nodes: fixed };
        let result = Precomputed::from_bytes(Path::new("f"), &bytes, &expected);
        prop_assert_eq!(result.is_ok(), &bytes == original);
    }
}

fn tensor_mass(mesh: &TetMesh, fixed_nodes: &[NodeId], damping_per_s: f64) -> TensorMass {
    let material = material();
    let stable = TensorMass::stable_step(mesh, &material).unwrap();
    TensorMass::build(&TensorMassParams {
        body: DynamicBody {
            fixed: &held(fixed_nodes),
            damping: Rayleigh::of_mass(damping_per_s),
            time_step_s: stable.step_s,
            ..DynamicBody::new(mesh, material.density_kg_per_m3())
        },
        material: &material,
    })
    .unwrap()
}

/// Runs until the fastest node moves less than 1e-10 m/s.
fn run_to_rest(model: &mut TensorMass, dt_s: f64) {
    for _ in 0..20_000 {
        model.step(dt_s);
        let fastest = model.state().velocities_m_per_s.iter().map(|v| v.length()).fold(0.0, f64::max);
        if fastest < 1e-10 {
            return;
        }
    }
    panic!("no rest");
}

#[test]
fn tensor_mass_at_rest_is_the_precomputed_solution() {
    let (mesh, fixed) = organ();
    let mut precomputed = precomputed(&mesh, &fixed, StoredNodes::All);
    let mut dynamic = tensor_mass(&mesh, &fixed, 40.0);
    for (n_forces, n_displacements) in [(5, 0), (0, 6), (4, 5)] {
        let constraints = load(&precomputed, n_forces, n_displacements, 9);
        precomputed.apply(&constraints);
        precomputed.step(0.01);
        dynamic.reset();
        dynamic.apply(&constraints);
        run_to_rest(&mut dynamic, 0.004);
        let off = relative_difference(&displacements(&dynamic, &mesh), &displacements(&precomputed, &mesh));
        assert!(off < 1e-6, "{n_forces} forces, {n_displacements} displacements: {off:e}");
        if n_displacements > 0 {
            let off = relative_difference(dynamic.constraint_forces_n(), precomputed.constraint_forces_n());
            assert!(off < 1e-6, "{n_forces} forces, {n_displacements} displacements: {off:e}");
        }
    }
}

#[test]
fn weight_hangs_in_the_supports_as_the_static_solver_says() {
    let (mesh, fixed) = organ();
    let material = material();
    let gravity_m_per_s2 = DVec3::new(0.0, 0.0, -0.4);
    let mut model = TensorMass::build(&TensorMassParams {
        body: DynamicBody {
            fixed: &held(&fixed),
            damping: Rayleigh::of_mass(40.0),
            gravity_m_per_s2,
            time_step_s: 1e-3,
            ..DynamicBody::new(&mesh, material.density_kg_per_m3())
        },
        material: &material,
    })
    .unwrap();
    run_to_rest(&mut model, 1e-3);
    let mut nodal_force_n = vec![DVec3::ZERO; mesh.positions_m.len()];
    glisson_tissue::solve::add_gravity_forces(&mesh, &material, gravity_m_per_s2, &mut nodal_force_n);
    let conditions = BoundaryConditions::fixed(&fixed);
    let problem = StaticProblem {
        mesh: &mesh,
        material: &material,
        conditions: &conditions,
        nodal_force_n: &nodal_force_n,
    };
    let expected = solve_static(&problem).unwrap().displacement_m;
    let off = relative_difference(&displacements(&model, &mesh), &expected);
    assert!(off < 1e-6, "{off:e}");
}

/// Nothing holds it: every node falls by the scheme's own parabola, g h^2 k (k + 1)/2 after k steps.
#[test]
fn a_free_body_falls_and_does_not_deform() {
    let (mesh, _) = organ();
    let material = material();
    let (g, h_s) = (9.81, 1e-3);
    let mut model = TensorMass::build(&TensorMassParams {
        body: DynamicBody {
            damping: Rayleigh::of_mass(0.0),
            gravity_m_per_s2: DVec3::new(0.0, -g, 0.0),
            time_step_s: h_s,
            ..DynamicBody::new(&mesh, material.density_kg_per_m3())
        },
        material: &material,
    })
    .unwrap();
    for k in 1..=100 {
        model.step(h_s);
        let fallen_m = 0.5 * g * h_s * h_s * f64::from(k * (k + 1));
        for u in displacements(&model, &mesh) {
            assert!((u - DVec3::new(0.0, -fallen_m, 0.0)).length() <= 1e-12 * fallen_m.max(0.1), "{k}: {u}");
        }
    }
}

#[test]
fn energy_stays_at_the_stable_step_and_a_longer_one_is_refused() {
    let (mesh, fixed) = organ();
    let mut model = tensor_mass(&mesh, &fixed, 0.0);
    // Random positions excite every mode, the fastest ones too.
    let mut random = SeededRandom::new(8);
    let start: Vec<DVec3> = mesh
        .positions_m
        .iter()
        .map(|p| *p + DVec3::new(random.normal(), random.normal(), random.normal()) * 1e-4)
        .collect();
    model.take_over(&start);
    let h_s = model.time_step_s();
    model.step(h_s);
    let energy_j = model.energy_j();
    assert!(energy_j > 0.0);
    for _ in 0..3000 {
        model.step(h_s);
    }
    assert!((model.energy_j() - energy_j).abs() <= 1e-9 * energy_j, "{} {energy_j}", model.energy_j());

    let material = material();
    let params = TensorMassParams {
        body: DynamicBody {
            fixed: &held(&fixed),
            damping: Rayleigh::of_mass(0.0),
            time_step_s: 1.0001 * h_s,
            ..DynamicBody::new(&mesh, material.density_kg_per_m3())
        },
        material: &material,
    };
    let refusal = TensorMass::build(&params).unwrap_err();
    assert!(
        matches!(refusal, TensorMassError::UnstableStep { allowed_s, .. } if allowed_s == h_s),
        "{refusal}"
    );
    assert!(matches!(
        TensorMass::build(&TensorMassParams {
            body: DynamicBody { damping: Rayleigh::of_mass(-1.0), time_step_s: h_s, ..params.body },
            ..params
        }),
        Err(TensorMassError::Parameter { .. })
    ));
}

/// The true highest frequency, by power iteration on M^-1 K: the estimate must be on the safe side, and not
/// wastefully so.
#[test]
fn the_stable_step_is_below_the_true_limit_and_near_it() {
    let (mesh, fixed) = organ();
    let stable = tensor_mass(&mesh, &fixed, 0.0);
    let h_s = stable.time_step_s();
    // Power iteration on M^-1 K through the model's own tensors: the true highest frequency.
    let n = mesh.positions_m.len();
    let mut random = SeededRandom::new(3);
    let mut x: Vec<DVec3> =
        (0..n).map(|_| DVec3::new(random.normal(), random.normal(), random.normal())).collect();
    let edges: Vec<_> = stable.edge_tensors_n_per_m().collect();
    let mut omega_squared = 0.0;
    for _ in 0..2000 {
        for node in &fixed {
            x[node.index()] = DVec3::ZERO;
        }
        let size = x.iter().map(|v| v.length_squared()).sum::<f64>().sqrt();
        x.iter_mut().for_each(|v| *v /= size);
        let mut y: Vec<DVec3> =
            (0..n).map(|p| stable.vertex_tensor_n_per_m(NodeId::from_index(p)) * x[p]).collect();
        for &([p, j], b) in &edges {
            y[p.index()] += b * x[j.index()];
            y[j.index()] += b.transpose() * x[p.index()];
        }
        for (p, y) in y.iter_mut().enumerate() {
            *y /= stable.mass_kg(NodeId::from_index(p));
        }
        omega_squared = y.iter().map(|v| v.length_squared()).sum::<f64>().sqrt();
        x = y;
    }
    let true_limit_s = 2.0 / omega_squared.sqrt();
    assert!(h_s <= true_limit_s, "{h_s} {true_limit_s}");
    assert!(h_s >= 0.9 * true_limit_s, "{h_s} {true_limit_s}");
}

#[test]
fn steps_are_divided_snapshots_come_back_and_runs_repeat() {
    let (mesh, fixed) = organ();
    let surface = precomputed(&mesh, &fixed, StoredNodes::Surface);
    let constraints = load(&surface, 2, 3, 4);
    let run = |model: &mut TensorMass, dt_s: f64, n: usize| {
        for _ in 0..n {
            model.step(dt_s);
        }
        model.history().iter().map(|x| x.to_bits()).collect::<Vec<_>>()
    };
    let mut a = tensor_mass(&mesh, &fixed, 10.0);
    let h_s = a.time_step_s();
    a.apply(&Constraints { displacements: Vec::new(), ..constraints.clone() });
    let mut b = a.clone();
    // Forces alone: 5 steps of 4 h are 20 steps of h.
    let long = run(&mut a, 4.0 * h_s, 5);
    let short = run(&mut b, h_s, 20);
    assert_eq!(long.len(), short.len());
    let value = |bits: &[u64]| bits.iter().map(|&b| f64::from_bits(b)).collect::<Vec<_>>();
    let largest = value(&long).iter().fold(0.0, |m: f64, x| m.max(x.abs()));
    for (x, y) in value(&long).iter().zip(value(&short)) {
        assert!((x - y).abs() <= 1e-12 * largest);
    }

    let mut c = tensor_mass(&mesh, &fixed, 10.0);
    c.apply(&constraints);
    run(&mut c, 0.01, 5);
    let snapshot = c.snapshot();
    let first = run(&mut c, 0.01, 7);
    c.restore(&snapshot);
    assert_eq!(run(&mut c, 0.01, 7), first);
    let mut d = tensor_mass(&mesh, &fixed, 10.0);
    d.apply(&constraints);
    assert_eq!(run(&mut d, 0.01, 12), first);
}

/// Largest difference of masses and tensors between two models on the same numbering, over the largest entry.
fn model_difference(a: &TensorMass, b: &TensorMass, n_nodes: usize) -> f64 {
    let mut largest: f64 = 0.0;
    let mut off: f64 = 0.0;
    let mut compare = |x: DMat3, y: DMat3| {
        for (x, y) in x.to_cols_array().into_iter().zip(y.to_cols_array()) {
            largest = largest.max(y.abs());
            off = off.max((x - y).abs());
        }
    };
    for n in (0..n_nodes).map(NodeId::from_index) {
        compare(a.vertex_tensor_n_per_m(n), b.vertex_tensor_n_per_m(n));
    }
    let of_b: std::collections::BTreeMap<_, _> = b.edge_tensors_n_per_m().collect();
    let mut met = 0;
    for (edge, tensor) in a.edge_tensors_n_per_m() {
        match of_b.get(&edge) {
            Some(expected) => {
                met += 1;
                compare(tensor, *expected);
            }
            None => assert_eq!(tensor, DMat3::ZERO, "an edge without tetrahedron is exactly zero"),
        }
    }
    assert_eq!(met, of_b.len());
    off / largest
}

#[test]
fn removal_equals_a_model_of_the_remaining_mesh() {
    let (mesh, fixed) = organ();
    let mut model = tensor_mass(&mesh, &fixed, 10.0);
    let mut editable = EditableMesh::new(mesh.clone()).unwrap();
    // A third of the tetrahedra, in batches, at random: leaves nodes and edges alone.
    let mut random = SeededRandom::new(6);
    for _ in 0..10 {
        let tets = random_live_tets(&editable, &mut random, 9);
        let change = editable.apply(&MeshEdit::Remove { tets }).unwrap();
        model.topology_changed(editable.mesh(), &change).unwrap();
        model.step(0.002);
    }
    // Everything at one node goes, so that it is left alone.
    let lonely = NodeId(7);
    let tets = editable.topology().node_tets(lonely).to_vec();
    let change = editable.apply(&MeshEdit::Remove { tets }).unwrap();
    model.topology_changed(editable.mesh(), &change).unwrap();
    assert_eq!(model.vertex_tensor_n_per_m(lonely), DMat3::ZERO);
    assert_eq!(model.mass_kg(lonely), 0.0);

    let remaining = TetMesh {
        positions_m: mesh.positions_m.clone(),
        tetrahedra: editable.topology().live_tets().map(|t| editable.topology().tet_nodes(t)).collect(),
        ..TetMesh::default()
    };
    let fresh = tensor_mass(&remaining, &fixed, 10.0);
    let off = model_difference(&model, &fresh, mesh.positions_m.len());
    assert!(off <= 1e-12, "{off:e}");
    for n in (0..mesh.positions_m.len()).map(NodeId::from_index) {
        assert!((model.mass_kg(n) - fresh.mass_kg(n)).abs() <= 1e-12 * model.mass_kg(NodeId(0)).max(1e-3));
    }
    assert!(fresh.stable_step_s() >= model.stable_step_s(), "the bound after cuts holds");

    // Compacted, the numbering is that of a compact mesh, and the motion went along.
    let before = model.state().positions_m.to_vec();
    let change = editable.compact();
    model.topology_changed(editable.mesh(), &change).unwrap();
    let n_nodes = editable.mesh().positions_m.len();
    assert!(n_nodes < mesh.positions_m.len());
    assert_eq!(model.state().positions_m.len(), n_nodes);
    for (old, new) in change.nodes.new_ids.iter().enumerate() {
        if let Some(new) = new {
            assert_eq!(model.state().positions_m[new.index()], before[old]);
        }
    }
    let fixed: Vec<NodeId> = fixed.iter().filter_map(|n| change.nodes.new_ids[n.index()]).collect();
    let fresh = tensor_mass(editable.mesh(), &fixed, 10.0);
    let off = model_difference(&model, &fresh, n_nodes);
    assert!(off <= 1e-12, "{off:e}");

    // And it goes on: removal after compaction, and steps.
    let change = editable.apply(&MeshEdit::Remove { tets: vec![TetId(3)] }).unwrap();
    model.topology_changed(editable.mesh(), &change).unwrap();
    for _ in 0..50 {
        model.step(0.002);
    }
    assert!(model.state().positions_m.iter().all(|p| p.is_finite()));
}
