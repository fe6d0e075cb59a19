//! The hybrid model of zones that exchange forces: against the direct solution, its counted costs, its frontiers
//! with tensor-mass zones, and cuts.

use crate::model_meshes::shaken_block;
use glisson_mesh::math::{DVec3, SeededRandom};
use glisson_mesh::mesh::box_mesh::box_of_five;
use glisson_mesh::mesh::edit::{EditableMesh, MeshEdit};
use glisson_mesh::mesh::zones::Zones;
use glisson_mesh::mesh::{NodeId, TetId, TetMesh};
use glisson_tissue::material::LinearElastic;
use glisson_tissue::model::hybrid::exchange::{
    EditReport, ExchangeAmount, ExchangeError, ExchangeParams, HybridExchange, Method, Overlap, SweepOrder,
    ZoneLaw, ZoneSize,
};
use glisson_tissue::model::{Constraints, DeformableModel, ImposedDisplacement, NodalForce};
use glisson_tissue::solve::{
    BoundaryConditions, SolveError, StaticProblem, add_gravity_forces, boundary_nodes, solve_static,
};

const STEP_S: f64 = 1e-3;

struct Case {
    mesh: TetMesh,
    material: LinearElastic,
    fixed: Vec<NodeId>,
}

impl Case {
    fn new(mesh: TetMesh) -> Self {
        let low_m = mesh.positions_m.iter().map(|p| p.x).fold(f64::INFINITY, f64::min);
        let fixed = (0..mesh.positions_m.len())
            .map(NodeId::from_index)
            .filter(|n| mesh.positions_m[n.index()].x < low_m + 0.004)
            .collect();
        let material = LinearElastic::from_young_poisson(5e3, 0.4, 1000.0).unwrap();
        Self { mesh, material, fixed }
    }

    /// An irregular block, its longest axis x.
    fn block() -> Self {
        Self::new(shaken_block([9, 3, 4], DVec3::new(0.09, 0.03, 0.04), 0.15, 7))
    }

    fn bar() -> Self {
        Self::new(box_of_five([12, 2, 3], DVec3::new(0.12, 0.02, 0.03)))
    }

    fn slabs(&self, cuts_m: &[f64]) -> Zones {
        Zones::by_place(&self.mesh, |c| cuts_m.iter().filter(|cut| c.x > **cut).count() as u32).unwrap()
    }

    fn node_near(&self, p: DVec3) -> NodeId {
        let nearest = |n: &NodeId| self.mesh.positions_m[n.index()].distance_squared(p);
        let surface = boundary_nodes(&self.mesh);
        *surface.iter().min_by(|a, b| nearest(a).total_cmp(&nearest(b))).unwrap()
    }

    /// The direct solution: displacements, and the forces on the imposed nodes, in the constraints' order.
    fn direct(&self, constraints: &Constraints, gravity_m_per_s2: DVec3) -> (Vec<DVec3>, Vec<DVec3>) {
        direct_on(&self.mesh, self, constraints, gravity_m_per_s2)
    }

    fn model(&self, zones: &Zones, change: impl Fn(&mut ExchangeParams<'_>)) -> HybridExchange {
        self.model_of(zones, &vec![ZoneLaw::Precomputed; zones.n_zones()], change)
    }

    fn model_of(
        &self,
        zones: &Zones,
        laws: &[ZoneLaw],
        change: impl Fn(&mut ExchangeParams<'_>),
    ) -> HybridExchange {
        let mut params = ExchangeParams::new(&self.mesh, &self.material, &self.fixed, zones, laws);
        change(&mut params);
        HybridExchange::build(&params).unwrap()
    }
}

fn direct_on(
    mesh: &TetMesh,
    case: &Case,
    constraints: &Constraints,
    gravity_m_per_s2: DVec3,
) -> (Vec<DVec3>, Vec<DVec3>) {
    let mut conditions = BoundaryConditions::fixed(&case.fixed);
    constraints.displacements.iter().for_each(|i| conditions.impose_node(i.node, i.displacement_m));
    let mut nodal_force_n = vec![DVec3::ZERO; mesh.positions_m.len()];
    constraints.forces.iter().for_each(|f| nodal_force_n[f.node.index()] += f.force_n);
    add_gravity_forces(mesh, &case.material, gravity_m_per_s2, &mut nodal_force_n);
    let (conditions, nodal_force_n) = (&conditions, &nodal_force_n[..]);
    let material = &case.material;
    let solution = solve_static(&StaticProblem { mesh, material, conditions, nodal_force_n }).unwrap();
    let forces_n = constraints.displacements.iter().map(|i| solution.reaction_n[i.node.index()]).collect();
    (solution.displacement_m, forces_n)
}

/// Largest difference over the largest expected length.
fn off(found: &[DVec3], expected: &[DVec3]) -> f64 {
    assert_eq!(found.len(), expected.len());
    let size = expected.iter().map(|u| u.length()).fold(0.0, f64::max);
    found.iter().zip(expected).map(|(a, b)| a.distance(*b)).fold(0.0, f64::max) / size
}

fn off_on_surface(case: &Case, found: &[DVec3], expected: &[DVec3]) -> f64 {
    let of =
        |u: &[DVec3]| -> Vec<DVec3> { boundary_nodes(&case.mesh).iter().map(|n| u[n.index()]).collect() };
    off(&of(found), &of(expected))
}

fn sorted(mut constraints: Constraints) -> Constraints {
    constraints.displacements.sort_by_key(|i| i.node);
    constraints.forces.sort_by_key(|f| f.node);
    constraints
}

/// Forces and imposed displacements in several zones, some on frontier nodes.
fn mixed_constraints(case: &Case, zones: &Zones) -> Constraints {
    let free_surface: Vec<NodeId> =
        boundary_nodes(&case.mesh).into_iter().filter(|n| !case.fixed.contains(n)).collect();
    let on_frontier: Vec<NodeId> =
        free_surface.iter().copied().filter(|n| zones.zones_of_node(*n).len() > 1).collect();
    let end = [case.node_near(DVec3::new(0.2, 0.0, 0.0)), case.node_near(DVec3::new(0.2, 0.1, 0.1))];
    let displacement =
        |node, z: f64| ImposedDisplacement { node, displacement_m: DVec3::new(1e-3, -5e-4, z) };
    let force = |node, y: f64| NodalForce { node, force_n: DVec3::new(0.01, y, -0.02) };
    let mut constraints = Constraints {
        displacements: vec![displacement(end[0], 2e-3), displacement(end[1], 1e-3)],
        forces: vec![force(free_surface[free_surface.len() / 2], 0.03)],
    };
    if let [first, .., last] = on_frontier[..] {
        constraints.displacements.push(displacement(first, -1e-3));
        constraints.forces.push(force(last, -0.02));
    }
    let is_imposed = |n: NodeId| constraints.displacements.iter().any(|i| i.node == n);
    let forces = constraints.forces.iter().copied().filter(|f| !is_imposed(f.node)).collect();
    sorted(Constraints { forces, ..constraints })
}

fn sweep(model: &mut HybridExchange, n_sweeps: u32) {
    model.set_sweeps_per_step(n_sweeps).unwrap();
    model.step(STEP_S);
}

const GRAVITY: DVec3 = DVec3::new(0.3, -0.2, -1.0);

#[test]
fn sweeps_in_turn_reach_the_direct_solution_on_any_partition() {
    let case = Case::block();
    for n_zones in [1, 2, 4, 6] {
        let zones = Zones::by_graph(&case.mesh, n_zones).unwrap();
        let n_meeting =
            zones.frontier_nodes().iter().map(|n| zones.zones_of_node(*n).len()).max().unwrap_or(1);
        assert!(n_zones < 6 || n_meeting > 2, "no node of more than two zones");
        let constraints = mixed_constraints(&case, &zones);
        let (expected_m, expected_n) = case.direct(&constraints, GRAVITY);
        for method in [Method::AllNodes, Method::Surface] {
            let mut model = case.model(&zones, |p| p.method = method);
            model.set_gravity(GRAVITY);
            model.apply(&constraints);
            sweep(&mut model, if n_zones == 1 { 1 } else { 600 });
            let found_m = model.displacements_m();
            let error = match method {
                Method::AllNodes => off(found_m, &expected_m),
                Method::Surface => off_on_surface(&case, found_m, &expected_m),
            };
            assert!(error < 1e-9, "{n_zones} zones, {method:?}: {error:e}");
            let error = off(model.constraint_forces_n(), &expected_n);
            assert!(error < 1e-8, "{n_zones} zones, {method:?}: forces {error:e}");
            assert_eq!(model.report().n_ignored_constraints, 0);
        }
    }
}

#[test]
fn zones_at_once_reach_it_too_and_two_sweeps_of_two_zones_are_worth_one_in_turn() {
    let case = Case::bar();
    let zones = case.slabs(&[0.06]);
    let constraints = mixed_constraints(&case, &zones);
    let (expected_m, _) = case.direct(&constraints, DVec3::ZERO);
    let run = |order, n_sweeps| {
        let mut model = case.model(&zones, |p| p.order = order);
        model.apply(&constraints);
        sweep(&mut model, n_sweeps);
        off(model.displacements_m(), &expected_m)
    };
    for n in [5, 20, 40] {
        let ratio = run(SweepOrder::Jacobi, 2 * n) / run(SweepOrder::GaussSeidel, n);
        assert!((0.2..5.0).contains(&ratio), "{n} sweeps: {ratio}");
    }
    let case = Case::block();
    let zones = Zones::by_graph(&case.mesh, 6).unwrap();
    let constraints = mixed_constraints(&case, &zones);
    let (expected_m, expected_n) = case.direct(&constraints, DVec3::ZERO);
    for method in [Method::AllNodes, Method::Surface] {
        let jacobi = |p: &mut ExchangeParams<'_>| (p.method, p.order) = (method, SweepOrder::Jacobi);
        let mut model = case.model(&zones, jacobi);
        model.apply(&constraints);
        sweep(&mut model, 1200);
        assert!(off_on_surface(&case, model.displacements_m(), &expected_m) < 1e-9, "{method:?}");
        assert!(off(model.constraint_forces_n(), &expected_n) < 1e-8, "{method:?}");
    }
}

#[test]
fn threads_change_no_bit() {
    let case = Case::block();
    let zones = Zones::by_graph(&case.mesh, 5).unwrap();
    let constraints = mixed_constraints(&case, &zones);
    let run = |n_threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(n_threads).build().unwrap();
        pool.install(|| {
            let mut model = case.model(&zones, |p| p.order = SweepOrder::Jacobi);
            model.apply(&constraints);
            model.set_sweeps_per_step(7).unwrap();
            (0..3).for_each(|_| model.step_in_pool(STEP_S));
            model.displacements_m().to_vec()
        })
    };
    let alone = run(1);
    assert_eq!(alone, run(2));
    assert_eq!(alone, run(4));
}

#[test]
fn passing_on_less_in_a_sweep_leaves_the_equilibrium_where_it_is() {
    let case = Case::bar();
    let zones = case.slabs(&[0.03, 0.07]);
    let constraints = mixed_constraints(&case, &zones);
    let (expected_m, _) = case.direct(&constraints, GRAVITY);
    let amounts =
        [ExchangeAmount::All, ExchangeAmount::InTurn { n_sets: 3 }, ExchangeAmount::Largest { share: 0.5 }];
    let mut products = Vec::new();
    for amount in amounts {
        for method in [Method::AllNodes, Method::Surface] {
            let mut model = case.model(&zones, |p| (p.amount, p.method) = (amount, method));
            model.set_gravity(GRAVITY);
            model.apply(&constraints);
            sweep(&mut model, 10);
            products.push(model.count().products() as f64);
            sweep(&mut model, 2500);
            let error = off_on_surface(&case, model.displacements_m(), &expected_m);
            assert!(error < 1e-9, "{amount:?} {method:?}: {error:e}");
        }
    }
    assert!(products[2] < 0.6 * products[0] && products[3] < 0.6 * products[1], "{products:?}");
}

#[test]
fn counted_storage_and_products_are_those_of_the_formulas() {
    let case = Case::bar();
    let zones = case.slabs(&[0.04, 0.08]);
    let constraints = Constraints::default();
    for method in [Method::Surface, Method::AllNodes] {
        let mut model = case.model(&zones, |p| p.method = method);
        // Something to relax from: without outer force, as in the formulas.
        let lifted_m: Vec<DVec3> =
            case.mesh.positions_m.iter().map(|p| *p + DVec3::Z * (0.1 * p.x)).collect();
        model.take_over(&lifted_m);
        model.apply(&constraints);
        sweep(&mut model, 1);
        let sizes: Vec<ZoneSize> = model.zone_sizes().map(|(_, size)| size).collect();
        assert_eq!(sizes.len(), 3);
        let sum = |of: fn(ZoneSize) -> u64| sizes.iter().map(|s| of(*s)).sum::<u64>();
        let count = model.count();
        match method {
            Method::Surface => {
                assert_eq!(model.n_tensors() as u64, sum(ZoneSize::surface_tensors));
                assert_eq!(count.response_products, sum(ZoneSize::surface_products));
                // No node is in more than two zones.
                assert_eq!(count.edge_products, 0);
            }
            Method::AllNodes => {
                assert_eq!(model.n_tensors() as u64, sum(ZoneSize::all_nodes_tensors));
                assert_eq!(count.response_products, sum(ZoneSize::all_nodes_products));
                assert_eq!(count.edge_products, model.n_leaving_edges() as u64);
            }
        }
    }
}

/// Table 5.1 of seed `003` (N, F, S of each zone, with the row that is missing and F_0 = 122 for 128), and C of
/// methods A and B in table 5.2 (with 3,860 for 3,810; the last A is printed 974,752).
#[test]
fn formulas_give_the_reports_table_from_its_zone_sizes() {
    let bar = |rest: &[[u64; 3]]| [&[[99, 10, 85]], rest].concat();
    let rows: [(Vec<[u64; 3]>, u64, u64); 8] = [
        (bar(&[[102, 10, 81]]), 2_060, 2_066),
        (bar(&[[50, 20, 30], [62, 10, 41]]), 3_060, 2_720),
        (bar(&[[40, 20, 20], [40, 20, 20], [42, 10, 21]]), 3_860, 3_174),
        (bar(&[[30, 20, 10], [30, 20, 10], [30, 20, 10], [42, 10, 21]]), 4_460, 3_428),
        (vec![[278, 63, 113], [253, 63, 105]], 29_610, 33_820),
        (vec![[183, 122, 38], [308, 69, 119], [119, 71, 30]], 64_349, 52_768),
        (vec![[183, 122, 38], [173, 127, 20], [119, 71, 30], [198, 61, 74]], 93_370, 65_886),
        (vec![[2863, 332, 855], [2387, 332, 749]], 974_752, 1_744_851),
    ];
    for (i, (zones, surface, all_nodes)) in rows.iter().enumerate() {
        let size = |&[n_nodes, n_frontier, n_surface]: &[u64; 3]| ZoneSize { n_nodes, n_frontier, n_surface };
        let sizes: Vec<ZoneSize> = zones.iter().map(size).collect();
        let sum = |of: fn(ZoneSize) -> u64| sizes.iter().map(|s| of(*s)).sum::<u64>();
        let by_formula = sum(ZoneSize::surface_products);
        // 974,752 is 4 * 332 too many.
        assert_eq!(by_formula + if i == 7 { 4 * 332 } else { 0 }, *surface, "row {i}, method A");
        let n_frontier: u64 = sizes.iter().map(|s| s.n_frontier).sum();
        let edges = (*all_nodes - sum(ZoneSize::all_nodes_products)) as f64 / n_frontier as f64;
        assert!((2.6..3.0).contains(&edges), "row {i}: {edges} edges a frontier node");
    }
    // Tensor-mass: nodes times mean neighbours.
    for (nodes, neighbours, products) in
        [(192.0, 8.6, 1651.0), (469.0, 11.5, 5393.0), (4919.0, 12.66, 62274.0)]
    {
        assert!((nodes * neighbours - products) / products < 1e-3_f64);
    }
}

/// Brings a model with moving zones to rest.
fn rest(model: &mut HybridExchange, n_steps: usize) {
    (0..n_steps).for_each(|_| model.step(2e-3));
}

#[test]
fn tensor_mass_beside_precomputed_comes_to_rest_in_the_direct_solution() {
    let case = Case::bar();
    // The third and fourth zones are neighbours and merge.
    let zones = case.slabs(&[0.03, 0.06, 0.08, 0.1]);
    let laws = [0, 0, 1, 1, 0].map(|l| [ZoneLaw::Precomputed, ZoneLaw::TensorMass][l]);
    let constraints = mixed_constraints(&case, &zones);
    let (expected_m, expected_n) = case.direct(&constraints, GRAVITY);
    let wide = [2, 3, 4].map(|n| (Overlap::Nodes(n), Method::AllNodes));
    for (overlap, method) in wide.into_iter().chain([(Overlap::Nodes(2), Method::Surface)]) {
        let mut model = case.model_of(&zones, &laws, |p| {
            (p.overlap, p.method, p.damping_per_s, p.sweeps_per_step) = (overlap, method, 60.0, 2);
        });
        assert!(model.n_moving_nodes() > 20);
        model.set_gravity(GRAVITY);
        model.apply(&constraints);
        rest(&mut model, 1200);
        let error = off_on_surface(&case, model.displacements_m(), &expected_m);
        assert!(error < 1e-6, "{overlap:?} {method:?}: {error:e}");
        let error = off(model.constraint_forces_n(), &expected_n);
        assert!(error < 1e-6, "{overlap:?} {method:?}: forces {error:e}");
    }
}

#[test]
fn a_frontier_of_one_node_converges_with_relaxation() {
    let case = Case::bar();
    let zones = case.slabs(&[0.07]);
    let end = case.node_near(DVec3::new(0.12, 0.0, 0.0));
    let forces = vec![NodalForce { node: end, force_n: DVec3::new(0.0, 0.002, 0.01) }];
    let constraints = Constraints { forces, displacements: Vec::new() };
    let (expected_m, _) = case.direct(&constraints, DVec3::ZERO);
    let laws = [ZoneLaw::Precomputed, ZoneLaw::TensorMass];
    let run = |relaxation: f64, dt_s: f64, n_steps: usize| {
        let mut model = case.model_of(&zones, &laws, |p| {
            p.overlap = Overlap::OneNode { relaxation };
            p.damping_per_s = 40.0;
        });
        model.apply(&constraints);
        (0..n_steps).for_each(|_| model.step(dt_s));
        off(model.displacements_m(), &expected_m)
    };
    // When tensor-mass comes to rest between two exchanges, the iteration's factors are 1 - relaxation (1 + rho), where
    // rho, tensor-mass' condensed stiffness over the neighbour's, is 0 to 4.13 here (by another program).
    let at_rest = run(0.3, 0.5, 40);
    assert!(at_rest < 1e-6, "{at_rest:e}");
    let beyond = run(0.45, 0.5, 40);
    assert!(beyond > 1.0, "{beyond:e}");
    // Tensor-mass that has no time to follow answers with its held stiffness: rho up to 109.
    let hurried = run(0.3, 2e-3, 400);
    assert!(hurried.is_nan() || hurried > 1.0, "{hurried:e}");
}

#[test]
fn tensor_mass_zones_alone_are_the_tensor_mass_model() {
    let case = Case::bar();
    let zones = case.slabs(&[0.06]);
    let constraints = mixed_constraints(&case, &zones);
    let mut model = case.model_of(&zones, &[ZoneLaw::TensorMass; 2], |p| p.damping_per_s = 30.0);
    let step_s = 0.9 * model.stable_step_s();
    let fixed: Vec<_> = case.fixed.iter().map(|&n| glisson_tissue::model::FixedNode::all_axes(n)).collect();
    let mut reference = glisson_tissue::model::tensor_mass::TensorMass::build(
        &glisson_tissue::model::tensor_mass::TensorMassParams {
            body: glisson_tissue::model::DynamicBody {
                fixed: &fixed,
                damping: glisson_tissue::model::Rayleigh::of_mass(30.0),
                time_step_s: step_s,
                ..glisson_tissue::model::DynamicBody::new(&case.mesh, case.material.density_kg_per_m3())
            },
            material: &case.material,
        },
    )
    .unwrap();
    model.apply(&constraints);
    reference.apply(&constraints);
    for _ in 0..50 {
        model.step(step_s);
        reference.step(step_s);
    }
    let displacements: Vec<DVec3> = reference
        .state()
        .positions_m
        .iter()
        .zip(&case.mesh.positions_m)
        .map(|(x, rest)| *x - *rest)
        .collect();
    let error = off(model.displacements_m(), &displacements);
    assert!(error < 1e-9, "{error:e}");
}

#[test]
fn a_zone_turns_dynamic_where_it_is_and_as_fast_as_it_moves() {
    let case = Case::bar();
    let zones = case.slabs(&[0.04, 0.08]);
    let end = case.node_near(DVec3::new(0.12, 0.0, 0.0));
    let load = |z: f64| Constraints {
        displacements: vec![ImposedDisplacement { node: end, displacement_m: DVec3::new(0.0, 0.0, z) }],
        forces: Vec::new(),
    };
    for method in [Method::AllNodes, Method::Surface] {
        let mut model =
            case.model(&zones, |p| (p.method, p.sweeps_per_step, p.damping_per_s) = (method, 500, 40.0));
        model.apply(&load(0.010));
        model.step(STEP_S);
        model.apply(&load(0.012));
        model.step(STEP_S);
        let [before_m, now_m] = [0.010, 0.012].map(|z| case.direct(&load(z), DVec3::ZERO).0);
        let tables_before = model.n_tensors();
        let report = model.turn_dynamic(1).unwrap();
        assert_eq!(report, EditReport { turned: vec![1], ..EditReport::default() });
        assert_eq!(model.laws(), [ZoneLaw::Precomputed, ZoneLaw::TensorMass, ZoneLaw::Precomputed]);
        assert!(model.n_tensors() < tables_before && model.n_moving_nodes() > 10);
        let inner: Vec<usize> =
            (0..now_m.len()).filter(|&n| zones.zones_of_node(NodeId::from_index(n)) == [1]).collect();
        let of = |u: &[DVec3]| -> Vec<DVec3> { inner.iter().map(|&n| u[n]).collect() };
        assert!(off(&of(model.displacements_m()), &of(&now_m)) < 1e-6);
        let velocity: Vec<DVec3> = before_m.iter().zip(&now_m).map(|(a, b)| (*b - *a) / STEP_S).collect();
        assert!(off(&of(model.state().velocities_m_per_s), &of(&velocity)) < 1e-4, "{method:?}");
        model.set_sweeps_per_step(4).unwrap();
        rest(&mut model, 600);
        let error = off_on_surface(&case, model.displacements_m(), &now_m);
        assert!(error < 1e-7, "{method:?}: {error:e}");
        assert!(matches!(model.turn_dynamic(3), Err(ExchangeError::NoSuchZone { zone: 3, n_zones: 3 })));
    }
}

/// Tetrahedra of a zone with so many nodes that it shares with another, lowest first.
fn tets_touching(case: &Case, zones: &Zones, zone: usize, neighbour: usize, least: usize) -> Vec<TetId> {
    let shared = |tet: &TetId| {
        let nodes = &case.mesh.tetrahedra[tet.index()];
        nodes.iter().filter(|n| zones.zones_of_node(**n).contains(&(neighbour as u32))).count() >= least
    };
    zones.tets(zone).filter(shared).collect()
}

#[test]
fn a_cut_at_a_frontier_corrects_the_neighbour_and_equals_the_remaining_mesh() {
    let case = Case::new(box_of_five([12, 4, 4], DVec3::new(0.12, 0.04, 0.04)));
    let zones = case.slabs(&[0.04, 0.08]);
    let constraints = mixed_constraints(&case, &zones);
    for method in [Method::AllNodes, Method::Surface] {
        let mut model =
            case.model(&zones, |p| (p.method, p.damping_per_s, p.sweeps_per_step) = (method, 60.0, 2));
        model.apply(&constraints);
        let mut removed = Vec::new();
        let tets = tets_touching(&case, &zones, 1, 2, 2);
        for (turn, pair) in [&tets[..1], &tets[2..5], &tets[..14]].into_iter().enumerate() {
            let report = model.remove_tets(pair).unwrap();
            removed.extend_from_slice(pair);
            assert_eq!(report.turned, if turn == 0 { vec![1] } else { vec![] });
            let expected = if turn < 2 { (vec![2], vec![]) } else { (vec![], vec![2]) };
            assert_eq!((report.corrected, report.recomputed), expected, "{turn}");
            rest(&mut model, 700);
            let mut mesh = case.mesh.clone();
            let mut t = 0;
            mesh.tetrahedra.retain(|_| {
                t += 1;
                !removed.contains(&TetId(t - 1))
            });
            let (expected_m, expected_n) = direct_on(&mesh, &case, &constraints, DVec3::ZERO);
            let error = off_on_surface(&case, model.displacements_m(), &expected_m);
            assert!(error < 1e-8, "{method:?} {turn}: {error:e}");
            let error = off(model.constraint_forces_n(), &expected_n);
            assert!(error < 1e-6, "{method:?} {turn}: forces {error:e}");
        }
    }
}

#[test]
fn edits_of_the_mesh_are_followed_as_removals() {
    let case = Case::bar();
    let zones = case.slabs(&[0.06]);
    let mut model = case.model(&zones, |_| ());
    let mut mesh = EditableMesh::new(case.mesh.clone()).unwrap();
    let tet = zones.tets(1).nth(20).unwrap();
    let change = mesh.apply(&MeshEdit::Remove { tets: vec![tet] }).unwrap();
    model.topology_changed(mesh.mesh(), &change).unwrap();
    assert_eq!(model.laws(), [ZoneLaw::Precomputed, ZoneLaw::TensorMass]);
    assert_eq!(model.remove_tets(&[tet]).unwrap(), EditReport::default());
}

#[test]
fn a_zone_that_a_cut_leaves_unheld_turns_dynamic_too() {
    let case = Case::bar();
    let zones = case.slabs(&[0.04, 0.08]);
    let mut model = case.model(&zones, |p| p.damping_per_s = 30.0);
    // Everything between the two ends goes: the far end is free.
    let all: Vec<TetId> = zones.tets(1).collect();
    let report = model.remove_tets(&all).unwrap();
    assert_eq!(report.turned, [1, 2]);
    model.set_gravity(-DVec3::Z);
    (0..100).for_each(|_| model.step(1e-3));
    let end = case.node_near(DVec3::new(0.12, 0.02, 0.03));
    let fallen_m = -model.displacements_m()[end.index()].z;
    // Damped fall: g (t/d - (1 - exp(-d t))/d^2).
    let expected_m = 0.1 / 30.0 - (1.0 - (-3.0_f64).exp()) / 900.0;
    assert!((fallen_m / expected_m - 1.0).abs() < 0.02, "{fallen_m} {expected_m}");
}

#[test]
fn steps_allocate_nothing_and_copies_go_on_with_the_same_bits() {
    let case = Case::bar();
    let zones = case.slabs(&[0.04, 0.08]);
    let laws = [ZoneLaw::Precomputed, ZoneLaw::TensorMass, ZoneLaw::Precomputed];
    let constraints = mixed_constraints(&case, &zones);
    for amount in [ExchangeAmount::All, ExchangeAmount::InTurn { n_sets: 4 }] {
        let mut model = case.model_of(&zones, &laws, |p| (p.amount, p.sweeps_per_step) = (amount, 3));
        model.apply(&constraints);
        model.step(STEP_S);
        let mut copy = model.duplicate();
        let count = allocation_counter::measure(|| {
            model.apply(&constraints);
            copy.apply(&constraints);
            for _ in 0..20 {
                model.step(STEP_S);
                copy.step(STEP_S);
            }
        });
        assert_eq!(count.count_total, 0, "{amount:?}");
        assert_eq!(model.state().positions_m, copy.state().positions_m);
        assert_eq!(model.state().velocities_m_per_s, copy.state().velocities_m_per_s);
        assert_eq!(model.constraint_forces_n(), copy.constraint_forces_n());
    }
}

#[test]
fn what_cannot_be_built_is_named() {
    let case = Case::bar();
    let zones = case.slabs(&[0.06]);
    let laws = [ZoneLaw::TensorMass, ZoneLaw::Precomputed];
    let build = |fixed: &[NodeId], laws: &[ZoneLaw], change: fn(&mut ExchangeParams<'_>)| {
        let mut params = ExchangeParams::new(&case.mesh, &case.material, fixed, &zones, laws);
        change(&mut params);
        HybridExchange::build(&params).unwrap_err().to_string()
    };
    let floating =
        HybridExchange::build(&ExchangeParams::new(&case.mesh, &case.material, &[], &zones, &laws));
    assert!(matches!(
        floating.unwrap_err(),
        ExchangeError::Solve(SolveError::Floating { rigid_modes: 6, .. })
    ));
    assert!(build(&case.fixed, &laws[..1], |_| ()).contains("1 laws are given for 2 zones"));
    let unheld = build(&case.fixed, &laws, |p| p.overlap = Overlap::OneNode { relaxation: 0.5 });
    assert!(unheld.contains("zone 1 is held by tensor-mass zones alone"), "{unheld}");
    for change in [
        (|p| p.sweeps_per_step = 0) as fn(&mut ExchangeParams<'_>),
        |p| p.overlap = Overlap::Nodes(1),
        |p| (p.overlap, p.method) = (Overlap::Nodes(3), Method::Surface),
        |p| p.overlap = Overlap::OneNode { relaxation: 1.5 },
        |p| p.amount = ExchangeAmount::InTurn { n_sets: 0 },
        |p| p.amount = ExchangeAmount::Largest { share: f64::NAN },
        |p| p.damping_per_s = -1.0,
    ] {
        assert!(build(&case.fixed, &laws, change).contains("allowed: "));
    }
}

#[test]
fn constraints_that_no_zone_takes_are_counted() {
    let case = Case::block();
    let zones = case.slabs(&[0.05]);
    let surface = boundary_nodes(&case.mesh);
    let is_inner = |n: &NodeId| surface.binary_search(n).is_err() && zones.zones_of_node(*n).len() == 1;
    let mut random = SeededRandom::new(3);
    let inner: Vec<NodeId> =
        (0..case.mesh.positions_m.len()).map(NodeId::from_index).filter(is_inner).collect();
    let node = inner[(random.next_u64() % inner.len() as u64) as usize];
    let mut model = case.model(&zones, |_| ());
    let bad = DVec3::new(f64::NAN, 0.0, 0.0);
    model.apply(&sorted(Constraints {
        forces: vec![
            NodalForce { node, force_n: DVec3::X },
            NodalForce { node: surface[5], force_n: bad },
            NodalForce { node: NodeId(1_000_000), force_n: DVec3::X },
        ],
        displacements: vec![ImposedDisplacement { node: case.fixed[0], displacement_m: DVec3::X }],
    }));
    model.step(STEP_S);
    assert_eq!(model.report().n_ignored_constraints, 4);
    assert_eq!(model.constraint_forces_n(), [DVec3::ZERO]);
    assert!(model.displacements_m().iter().all(|u| *u == DVec3::ZERO));
}

#[test]
fn bad_places_gravity_and_tetrahedra_change_nothing() {
    let case = Case::bar();
    let zones = case.slabs(&[0.05]);
    let mut model = case.model(&zones, |p| p.amount = ExchangeAmount::InTurn { n_sets: 3 });
    let n = case.mesh.positions_m.len();
    let node = case.node_near(DVec3::new(0.12, 0.0, 0.03));
    let force = NodalForce { node, force_n: DVec3::Z };
    // Beyond one a node there is no room.
    model.apply(&Constraints { displacements: Vec::new(), forces: vec![force; n + 7] });
    model.step(STEP_S);
    assert_eq!(model.report().n_ignored_constraints, 7);
    model.reset();
    assert_eq!(model.report().n_ignored_constraints, 0);

    let run = |model: &mut HybridExchange| {
        model.apply(&Constraints { displacements: Vec::new(), forces: vec![force] });
        (0..4).for_each(|_| model.step(STEP_S));
        model.displacements_m().to_vec()
    };
    let first = run(&mut model);
    model.reset();
    assert_eq!(run(&mut model), first, "a reset begins with the first set");
    let before_m = model.state().positions_m.to_vec();
    model.take_over(&vec![DVec3::NAN; n]);
    model.set_gravity(DVec3::new(0.0, f64::INFINITY, 0.0));
    assert_eq!(model.state().positions_m, before_m);
    model.step(STEP_S);
    assert!(model.state().positions_m.iter().all(|p| p.is_finite()));

    let n_tets = case.mesh.tetrahedra.len();
    let tet = TetId::from_index(n_tets);
    let laws = model.laws().to_vec();
    let error = model.remove_tets(&[TetId(0), tet]).unwrap_err();
    assert_eq!(error, ExchangeError::NoSuchTet { tet, n_tets });
    assert_eq!(model.laws(), laws);
}
