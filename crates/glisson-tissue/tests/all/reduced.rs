//! The reduced non-linear model: exact when its basis spans the body, linear under small loads, near the full solution
//! between.

use crate::model_meshes::block;
use glisson_mesh::math::{DVec3, SeededRandom};
use glisson_mesh::mesh::box_mesh::box_of_five;
use glisson_mesh::mesh::{NodeId, TetMesh};
use glisson_tissue::material::{LinearElastic, StVenantKirchhoff};
use glisson_tissue::model::precomputed::{Precision, Precomputed, PrecomputedParams, StoredNodes};
use glisson_tissue::model::reduced::{Reduced, ReducedError, ReducedParams};
use glisson_tissue::model::{Constraints, DeformableModel, FixedNode, ImposedDisplacement, NodalForce};
use glisson_tissue::solve::{
    BoundaryConditions, NonlinearProblem, NonlinearSettings, NonlinearSolution, add_gravity_forces,
    solve_nonlinear,
};

fn material() -> LinearElastic {
    LinearElastic::from_young_poisson(5e3, 0.4, 1000.0).unwrap()
}

fn nodes_at(mesh: &TetMesh, z: f64) -> Vec<NodeId> {
    let places = mesh.positions_m.iter().enumerate();
    places.filter(|(_, p)| (p.z - z).abs() < 1e-9).map(|(n, _)| NodeId::from_index(n)).collect()
}

fn held(nodes: &[NodeId]) -> Vec<FixedNode> {
    nodes.iter().copied().map(FixedNode::all_axes).collect()
}

fn displacements(model: &dyn DeformableModel, mesh: &TetMesh) -> Vec<DVec3> {
    model.state().positions_m.iter().zip(&mesh.positions_m).map(|(p, rest)| *p - *rest).collect()
}

fn relative_difference(found: &[DVec3], expected: &[DVec3]) -> f64 {
    let largest = expected.iter().map(|u| u.length()).fold(0.0, f64::max);
    found.iter().zip(expected).map(|(a, b)| a.distance(*b)).fold(0.0, f64::max) / largest
}

/// The full non-linear solution of St Venant and Kirchhoff's law.
fn full(mesh: &TetMesh, fixed: &[NodeId], load: &Constraints, gravity_m_per_s2: DVec3) -> NonlinearSolution {
    let material = material();
    let mut conditions = BoundaryConditions::fixed(fixed);
    load.displacements.iter().for_each(|i| conditions.impose_node(i.node, i.displacement_m));
    let mut force_n = vec![DVec3::ZERO; mesh.positions_m.len()];
    add_gravity_forces(mesh, &material, gravity_m_per_s2, &mut force_n);
    load.forces.iter().for_each(|f| force_n[f.node.index()] += f.force_n);
    let laws = [StVenantKirchhoff::from(&material)];
    let settings = NonlinearSettings::default();
    let problem =
        NonlinearProblem { mesh, laws: &laws, conditions: &conditions, nodal_force_n: &force_n, settings };
    solve_nonlinear(&problem).unwrap()
}

fn imposed(node: NodeId, displacement_m: DVec3) -> ImposedDisplacement {
    ImposedDisplacement { node, displacement_m }
}

/// Twelve modes of a cell with twelve free components: the reduced equilibrium is the full one.
#[test]
fn a_basis_of_all_components_gives_the_full_solution() {
    let mesh = box_of_five([1, 1, 1], DVec3::new(0.04, 0.05, 0.06));
    let (fixed, top, material) = (nodes_at(&mesh, 0.0), nodes_at(&mesh, 0.06), material());
    let supports = held(&fixed);
    let params =
        ReducedParams { n_modes: 12, n_reduced: 12, ..ReducedParams::new(&mesh, &material, &supports) };
    let mut model = Reduced::build(&params).unwrap();
    assert_eq!(model.n_reduced(), 12);
    assert_eq!(model.loadable_nodes(), top);
    let push = |x: f64| Constraints {
        displacements: Vec::new(),
        forces: vec![NodalForce { node: top[0], force_n: DVec3::new(x, 0.3 * x, -0.2 * x) }],
    };
    let pull = Constraints {
        displacements: vec![imposed(top[1], DVec3::new(0.012, 0.0, 0.005))],
        forces: vec![NodalForce { node: top[2], force_n: DVec3::new(0.0, 0.2, 0.1) }],
    };
    let two = Constraints {
        displacements: vec![
            imposed(top[0], DVec3::new(0.006, 0.006, 0.0)),
            imposed(top[3], DVec3::new(0.0, -0.006, 0.012)),
        ],
        forces: Vec::new(),
    };
    for (load, gravity) in [(push(0.3), 0.0), (push(0.5), 0.0), (pull, 0.0), (two, 0.0), (push(0.1), 40.0)] {
        let gravity = DVec3::new(gravity, 0.0, 0.5 * gravity);
        model.set_gravity(gravity);
        model.apply(&load);
        model.step(1e-3);
        assert!(model.solution().converged, "{:?}", model.solution());
        let expected = full(&mesh, &fixed, &load, gravity);
        let off = relative_difference(&displacements(&model, &mesh), &expected.displacement_m);
        assert!(off < 1e-9, "{load:?}: {off:e}");
        let largest_m = expected.displacement_m.iter().map(|u| u.length()).fold(0.0, f64::max);
        assert!(largest_m > 3e-3, "the load is large: {largest_m}");
        for (found, imposed) in model.constraint_forces_n().iter().zip(&load.displacements) {
            let expected_n = expected.reaction_n[imposed.node.index()];
            assert!((*found - expected_n).length() < 1e-8 * expected_n.length(), "{found} {expected_n}");
        }
    }
    // The rest shape carries its own gravity; without load it comes back to it.
    model.carry_at_rest(DVec3::Z);
    model.set_gravity(DVec3::Z);
    model.apply(&Constraints::default());
    model.step(1e-3);
    model.step(1e-3);
    assert!(model.solution().converged);
    assert!(displacements(&model, &mesh).iter().all(|u| u.length() < 1e-12));
}

struct Organ {
    mesh: TetMesh,
    fixed: Vec<NodeId>,
    top: Vec<NodeId>,
}

/// A soft column on its base.
fn organ() -> Organ {
    let mesh = block([4, 3, 8], DVec3::new(0.03, 0.025, 0.1));
    let (fixed, top) = (nodes_at(&mesh, 0.0), nodes_at(&mesh, 0.1));
    Organ { mesh, fixed, top }
}

fn reduced(organ: &Organ, n_modes: usize, n_reduced: usize, stored: StoredNodes) -> Reduced {
    let (material, supports) = (material(), held(&organ.fixed));
    let params = ReducedParams::new(&organ.mesh, &material, &supports);
    Reduced::build(&ReducedParams { n_modes, n_reduced, stored, ..params }).unwrap()
}

fn precomputed(organ: &Organ) -> Precomputed {
    let stored = StoredNodes::All;
    let (mesh, material, fixed_nodes, progress) = (&organ.mesh, &material(), &organ.fixed[..], None);
    Precomputed::build(&PrecomputedParams {
        mesh,
        material,
        fixed_nodes,
        stored,
        precision: Precision::F64,
        progress,
    })
    .unwrap()
}

/// Random loads on random nodes, ascending.
fn random_load(
    nodes: &[NodeId],
    n_forces: usize,
    n_displacements: usize,
    size: f64,
    seed: u64,
) -> Constraints {
    let mut random = SeededRandom::new(seed);
    let mut some = |n: usize| -> Vec<(NodeId, DVec3)> {
        let mut chosen: Vec<NodeId> =
            (0..n).map(|_| nodes[(random.uniform() * nodes.len() as f64) as usize]).collect();
        chosen.sort_unstable();
        chosen.dedup();
        let mut draw = || DVec3::new(random.normal(), random.normal(), random.normal()) * size;
        chosen.into_iter().map(|node| (node, draw())).collect()
    };
    Constraints {
        displacements: some(n_displacements).into_iter().map(|(n, u)| imposed(n, u * 0.01)).collect(),
        forces: some(n_forces).into_iter().map(|(node, force_n)| NodalForce { node, force_n }).collect(),
    }
}

#[test]
fn under_small_loads_it_is_the_precomputed_model_whatever_the_basis() {
    let organ = organ();
    let mut linear = precomputed(&organ);
    for (n_modes, n_reduced) in [(1, 1), (3, 8), (6, 20)] {
        let mut model = reduced(&organ, n_modes, n_reduced, StoredNodes::All);
        for (n_forces, n_displacements) in [(5, 0), (0, 6), (3, 25)] {
            let load = random_load(linear.loadable_nodes(), n_forces, n_displacements, 1e-8, 5);
            for model in [&mut model as &mut dyn DeformableModel, &mut linear] {
                model.set_gravity(DVec3::X * 1e-8);
                model.apply(&load);
                model.step(1e-3);
            }
            assert!(model.solution().converged);
            let found = displacements(&model, &organ.mesh);
            let off = relative_difference(&found, &displacements(&linear, &organ.mesh));
            assert!(off < 2e-6, "{n_reduced} {n_forces} {n_displacements}: {off:e}");
            if n_displacements > 0 {
                let off = relative_difference(model.constraint_forces_n(), linear.constraint_forces_n());
                assert!(off < 2e-6, "forces, {n_reduced} {n_forces} {n_displacements}: {off:e}");
            }
        }
    }
}

/// The column's top pushed aside by a third of its height.
#[test]
fn a_bent_column_is_much_nearer_to_the_full_solution_than_the_linear_one() {
    let organ = organ();
    let (mut model, mut linear) = (reduced(&organ, 8, 30, StoredNodes::All), precomputed(&organ));
    let share = 1.0 / organ.top.len() as f64;
    let force = |node: &NodeId| NodalForce { node: *node, force_n: DVec3::X * (0.03 * share) };
    let load = Constraints { displacements: Vec::new(), forces: organ.top.iter().map(force).collect() };
    let expected = full(&organ.mesh, &organ.fixed, &load, DVec3::ZERO).displacement_m;
    let off = |model: &mut dyn DeformableModel| {
        model.apply(&load);
        model.step(1e-3);
        relative_difference(&displacements(model, &organ.mesh), &expected)
    };
    let (reduced_off, linear_off) = (off(&mut model), off(&mut linear));
    let largest_m = expected.iter().map(|u| u.length()).fold(0.0, f64::max);
    assert!(model.solution().converged, "{:?}", model.solution());
    assert!(largest_m > 0.02 && linear_off > 0.05, "{largest_m} {linear_off}");
    assert!(reduced_off < 0.1 * linear_off, "{reduced_off} {linear_off}");
}

#[test]
fn imposed_displacements_are_met_and_their_forces_do_the_work() {
    let organ = organ();
    let mut model = reduced(&organ, 6, 20, StoredNodes::Surface);
    for n in [1, 7, 30] {
        let load = random_load(&organ.top, 0, n, 0.3, 11);
        model.apply(&load);
        for _ in 0..4 {
            model.step(1e-3);
        }
        assert!(model.solution().converged, "{n}: {:?}", model.solution());
        for imposed in &load.displacements {
            let rest_m = organ.mesh.positions_m[imposed.node.index()];
            let found = model.state().positions_m[imposed.node.index()] - rest_m;
            assert!((found - imposed.displacement_m).length() < 1e-12, "{found} {}", imposed.displacement_m);
        }
        let work: f64 = load
            .displacements
            .iter()
            .zip(model.constraint_forces_n())
            .map(|(i, f)| i.displacement_m.dot(*f))
            .sum();
        assert!(work > 0.0);
    }
}

#[test]
fn copies_go_on_with_the_same_bits_and_without_allocation() {
    let organ = organ();
    let run = |model: &mut dyn DeformableModel, from: u32| -> Vec<DVec3> {
        let loads: Vec<Constraints> = (from..from + 5)
            .map(|i| {
                let mut load = random_load(&organ.top, 0, 1 + i as usize, 0.05 * f64::from(i), 3);
                load.forces = random_load(&organ.top, 4, 0, 0.01, 8).forces;
                load
            })
            .collect();
        let count = allocation_counter::measure(|| {
            for load in &loads {
                model.apply(load);
                model.step(1e-3);
            }
        });
        assert_eq!(count.count_total, 0);
        model.state().positions_m.to_vec()
    };
    let pool = |n| rayon::ThreadPoolBuilder::new().num_threads(n).build().unwrap();
    let mut model = pool(1).install(|| reduced(&organ, 4, 12, StoredNodes::Surface));
    let mut other = pool(3).install(|| reduced(&organ, 4, 12, StoredNodes::Surface));
    assert_eq!(run(&mut model, 0), run(&mut other, 0));
    let mut copy = model.duplicate();
    assert_eq!(run(&mut model, 5), run(&mut *copy, 5));
    assert_eq!(model.history(), copy.history());
    // Taken over from the other model, it starts where that one is.
    let places_m = model.state().positions_m.to_vec();
    let coordinates = model.coordinates().to_vec();
    model.take_over(&organ.mesh.positions_m);
    assert!(model.coordinates().iter().all(|q| *q == 0.0));
    model.take_over(&places_m);
    let (size, off) =
        (coordinates.iter().map(|q| q.abs()).fold(0.0, f64::max), coordinates[0] - model.coordinates()[0]);
    assert!(off.abs() < 0.2 * size, "{off} of {size}");
    assert!(model.topology_refusal().is_some());
}

/// A node without a finite place starts at rest, the others where they are.
#[test]
fn places_that_are_not_finite_are_not_taken_over() {
    let organ = organ();
    let mut model = reduced(&organ, 4, 12, StoredNodes::Surface);
    let rest_m = &organ.mesh.positions_m;
    let mut places_m: Vec<DVec3> = rest_m.iter().map(|p| *p + DVec3::X * (0.1 * p.z * p.z)).collect();
    model.take_over(&places_m);
    let size = model.coordinates().iter().map(|q| q.abs()).fold(0.0, f64::max);
    for (n, bad) in [(3, DVec3::NAN), (20, DVec3::new(0.0, f64::INFINITY, 0.0))] {
        places_m[n] = rest_m[n];
        model.take_over(&places_m);
        let (expected_m, coordinates) = (places_m.clone(), model.coordinates().to_vec());
        places_m[n] = bad;
        model.take_over(&places_m);
        assert_eq!(model.state().positions_m, expected_m);
        assert_eq!(model.coordinates(), coordinates);
        assert!(size > 0.0 && coordinates.iter().any(|q| q.abs() > 0.5 * size));
        places_m[n] = rest_m[n];
    }
    model.take_over(&vec![DVec3::NAN; rest_m.len()]);
    assert_eq!(model.state().positions_m, rest_m);
    assert!(model.coordinates().iter().all(|q| *q == 0.0));
}

#[test]
fn bad_sizes_constraints_and_supports_are_told() {
    let organ = organ();
    let (material, supports) = (material(), held(&organ.fixed));
    let params = ReducedParams::new(&organ.mesh, &material, &supports);
    let refused = |params: ReducedParams<'_>| Reduced::build(&params).err().unwrap();
    for (n_modes, n_reduced) in [(0, 5), (6, 5), (5, 101), (1, 10_000)] {
        let error = refused(ReducedParams { n_modes, n_reduced, ..params });
        assert!(matches!(error, ReducedError::Sizes { .. }), "{error}");
    }
    assert!(matches!(refused(ReducedParams { fixed: &[], ..params }), ReducedError::Solve(_)));
    assert!(matches!(refused(ReducedParams { loads: &[Vec::new()], ..params }), ReducedError::Sizes { .. }));
    let all: Vec<NodeId> = (0..organ.mesh.positions_m.len()).map(NodeId::from_index).collect();
    let mut nearly_all = held(&all);
    let inner = all.iter().position(|n| {
        let p = organ.mesh.positions_m[n.index()];
        p.x > 1e-3 && p.x < 0.029 && p.y > 1e-3 && p.y < 0.024 && p.z > 1e-3 && p.z < 0.099
    });
    nearly_all.remove(inner.unwrap());
    let error = refused(ReducedParams { fixed: &nearly_all, n_modes: 1, n_reduced: 1, ..params });
    assert!(error.to_string().contains("nothing is left to push"), "{error}");

    let mut model = reduced(&organ, 3, 8, StoredNodes::Surface);
    model.apply(&Constraints {
        displacements: vec![imposed(organ.fixed[0], DVec3::X), imposed(organ.top[0], DVec3::NAN)],
        forces: vec![NodalForce { node: NodeId(99_999), force_n: DVec3::X }],
    });
    model.step(1e-3);
    assert_eq!(model.report().n_ignored_constraints, 3);
    assert_eq!(model.constraint_forces_n(), [DVec3::ZERO; 2]);
    assert_eq!(model.state().positions_m, organ.mesh.positions_m);
    // A step that may not iterate says so and stays finite.
    model.set_most_iterations(1);
    model.apply(&random_load(&organ.top, 0, 3, 3.0, 1));
    model.step(1e-3);
    assert!(model.report().missed_tolerance);
    assert!(model.state().positions_m.iter().all(|p| p.is_finite()));
}
