//! The fast kernel against the plain formula, the tensors, the tensor-mass model and itself on every path and
//! number of threads.

use glisson_mesh::math::{DMat3, DVec3, SeededRandom};
use glisson_mesh::mesh::{NodeId, TetId, TetMesh};
use glisson_tissue::material::LinearElastic;
use glisson_tissue::model::kernel::{
    ExplicitStep, FastKernel, KernelError, KernelExtras, KernelLaw, KernelParams, KernelPath, Quarantine,
    QuarantineReport, StepSums,
};
use glisson_tissue::model::tensor_mass::{TensorMass, TensorMassParams};
use glisson_tissue::model::{DeformableModel, DynamicBody, Rayleigh};
use glisson_tissue::solve::{MeshEdges, SolveError, StiffnessTensors};
use glisson_tissue::workers::Sequential;

use crate::team::team;

use crate::kernel_laws::{AllExtras, kernel_with};
use crate::model_meshes::{block, held, nodes_below, relative_difference, shaken_block};

const LAWS: [KernelLaw; 2] = [KernelLaw::Linear, KernelLaw::StVenantKirchhoff];
const ALL_LAWS: [KernelLaw; 5] = [
    KernelLaw::Linear,
    KernelLaw::StVenantKirchhoff,
    KernelLaw::NeoHookeLog,
    KernelLaw::StableNeoHooke,
    KernelLaw::General,
];
const SIZE_M: DVec3 = DVec3::new(0.1, 0.06, 0.05);

fn material() -> LinearElastic {
    LinearElastic::from_young_poisson(5000.0, 0.45, 1060.0).unwrap()
}

fn kernel(mesh: &TetMesh, law: KernelLaw) -> FastKernel {
    let path = KernelPath::fastest();
    FastKernel::new(&KernelParams { mesh, law, materials: &[material()], path }).unwrap()
}

/// Displacements of up to `size_m` in each direction.
fn random_field(n: usize, size_m: f64, seed: u64) -> Vec<DVec3> {
    let mut random = SeededRandom::new(seed);
    (0..n).map(|_| DVec3::from_array(std::array::from_fn(|_| random.uniform_in(-size_m, size_m)))).collect()
}

/// Second Piola-Kirchhoff stress or Hooke's, straight from the definitions, element by element: F from the
/// deformed and the rest edges, no shape gradients.
fn plain_forces(mesh: &TetMesh, law: KernelLaw, material_of: &[LinearElastic], u: &[DVec3]) -> Vec<DVec3> {
    let mut force_n = vec![DVec3::ZERO; u.len()];
    for (t, nodes) in mesh.tetrahedra.iter().enumerate() {
        let material = material_of[t];
        let rest = nodes.map(|n| mesh.positions_m[n.index()]);
        let moved = nodes.map(|n| mesh.positions_m[n.index()] + u[n.index()]);
        let edges = |p: [DVec3; 4]| DMat3::from_cols(p[1] - p[0], p[2] - p[0], p[3] - p[0]);
        let inverse = edges(rest).inverse();
        let f = edges(moved) * inverse;
        let stress = |strain: DMat3| {
            let trace = strain.col(0).x + strain.col(1).y + strain.col(2).z;
            DMat3::from_diagonal(DVec3::splat(material.lambda_pa() * trace))
                + strain * (2.0 * material.mu_pa())
        };
        let p = match law {
            KernelLaw::Linear => stress((f + f.transpose()) * 0.5 - DMat3::IDENTITY),
            _ => f * stress((f.transpose() * f - DMat3::IDENTITY) * 0.5),
        };
        let forces = p * inverse.transpose() * mesh.tet_volume_m3(TetId::from_index(t));
        for k in 0..3 {
            force_n[nodes[k + 1].index()] += forces.col(k);
            force_n[nodes[0].index()] -= forces.col(k);
        }
    }
    force_n
}

#[test]
fn forces_equal_the_plain_formula_with_materials_that_differ() {
    let mesh = shaken_block([9, 7, 6], SIZE_M, 0.15, 3);
    let n_tets = mesh.tetrahedra.len();
    let mut random = SeededRandom::new(4);
    let materials: Vec<LinearElastic> = (0..n_tets)
        .map(|_| {
            let young_pa = random.uniform_in(1e3, 2e4);
            LinearElastic::from_young_poisson(young_pa, random.uniform_in(0.1, 0.49), 1000.0).unwrap()
        })
        .collect();
    let u = random_field(mesh.positions_m.len(), 4e-3, 5);
    for law in LAWS {
        let path = KernelPath::fastest();
        let mut kernel =
            FastKernel::new(&KernelParams { mesh: &mesh, law, materials: &materials, path }).unwrap();
        assert!(kernel.n_parts() >= 4, "parts exchange rows");
        let mut force_n = vec![DVec3::ZERO; u.len()];
        kernel.force_into(&Sequential, &u, &mut force_n);
        let off = relative_difference(&force_n, &plain_forces(&mesh, law, &materials, &u));
        assert!(off < 1e-12, "{law:?}: {off:e}");
    }
}

#[test]
fn the_linear_law_equals_the_stiffness_tensors_and_small_st_venant_kirchhoff() {
    let mesh = shaken_block([6, 5, 4], SIZE_M, 0.15, 6);
    let edges = MeshEdges::of_mesh(&mesh).unwrap();
    let tensors = StiffnessTensors::assemble(&mesh, &edges, &material()).unwrap();
    let u = random_field(mesh.positions_m.len(), 1e-3, 7);
    let (mut expected, mut found) = (vec![DVec3::ZERO; u.len()], vec![DVec3::ZERO; u.len()]);
    tensors.force_into(&edges, &u, &mut expected);
    kernel(&mesh, KernelLaw::Linear).force_into(&Sequential, &u, &mut found);
    assert!(relative_difference(&found, &expected) < 1e-12);
    // Twelve digits below the size of the body: what F^T F - Id would lose, the displacements keep.
    let tiny: Vec<DVec3> = u.iter().map(|u| *u * 1e-9).collect();
    tensors.force_into(&edges, &tiny, &mut expected);
    kernel(&mesh, KernelLaw::StVenantKirchhoff).force_into(&Sequential, &tiny, &mut found);
    assert!(relative_difference(&found, &expected) < 1e-9);
}

#[test]
fn all_orders_of_the_corners_give_the_same_forces_or_are_inside_out() {
    let u = random_field(4, 0.2, 8);
    let corners =
        [DVec3::ZERO, DVec3::new(1.0, 0.1, 0.0), DVec3::new(0.2, 1.1, 0.1), DVec3::new(0.1, 0.3, 0.9)];
    for law in LAWS {
        let mut reference: Option<Vec<DVec3>> = None;
        let mut n_refused = 0;
        let orders = (0..256_usize).map(|code| [code & 3, code >> 2 & 3, code >> 4 & 3, code >> 6]);
        let orders = orders.filter(|order| (0..4).all(|corner| order.contains(&corner)));
        for order in orders {
            let mesh = TetMesh {
                positions_m: corners.to_vec(),
                tetrahedra: vec![order.map(NodeId::from_index)],
                ..TetMesh::default()
            };
            let (materials, path) = (&[material()], KernelPath::fastest());
            let params = KernelParams { mesh: &mesh, law, materials, path };
            let Ok(mut kernel) = FastKernel::new(&params) else {
                n_refused += 1;
                continue;
            };
            let mut force_n = vec![DVec3::ZERO; 4];
            kernel.force_into(&Sequential, &u, &mut force_n);
            let reference = reference.get_or_insert_with(|| force_n.clone());
            assert!(relative_difference(&force_n, reference) < 1e-12, "{order:?}");
        }
        assert_eq!(n_refused, 12);
    }
}

#[test]
fn a_rotated_body_is_free_of_forces_under_st_venant_kirchhoff_only() {
    let mesh = shaken_block([4, 3, 3], SIZE_M, 0.15, 9);
    let turn = DMat3::from_axis_angle(DVec3::new(1.0, 2.0, -1.0).normalize(), 2.0);
    let shift = DVec3::new(0.3, -0.1, 0.2);
    let u: Vec<DVec3> = mesh.positions_m.iter().map(|&p| turn * p + shift - p).collect();
    let stretched: Vec<DVec3> = mesh.positions_m.iter().map(|&p| 0.1 * p).collect();
    let largest = |law, u: &[DVec3]| {
        let mut force_n = vec![DVec3::ZERO; u.len()];
        kernel(&mesh, law).force_into(&Sequential, u, &mut force_n);
        force_n.iter().map(|f| f.length()).fold(0.0, f64::max)
    };
    let scale = largest(KernelLaw::StVenantKirchhoff, &stretched);
    assert!(largest(KernelLaw::StVenantKirchhoff, &u) < 1e-11 * scale);
    assert!(largest(KernelLaw::Linear, &u) > scale);
    // And turning a deformed body turns its forces.
    let bent = random_field(u.len(), 3e-3, 10);
    let turned: Vec<DVec3> =
        mesh.positions_m.iter().zip(&bent).map(|(&p, &b)| turn * (p + b) + shift - p).collect();
    let mut kernel = kernel(&mesh, KernelLaw::StVenantKirchhoff);
    let (mut before, mut after) = (vec![DVec3::ZERO; u.len()], vec![DVec3::ZERO; u.len()]);
    kernel.force_into(&Sequential, &bent, &mut before);
    kernel.force_into(&Sequential, &turned, &mut after);
    let expected: Vec<DVec3> = before.iter().map(|&f| turn * f).collect();
    assert!(relative_difference(&after, &expected) < 1e-10);
}

fn bits(vectors: &[DVec3]) -> Vec<[u64; 3]> {
    vectors.iter().map(|v| v.to_array().map(f64::to_bits)).collect()
}

/// Displacements, increments, forces; viscous memory and energies; what the first step left out.
type Outcome = ([Vec<[u64; 3]>; 3], Vec<u64>, QuarantineReport);

/// The energies of a step.
fn energies_j(sums: StepSums) -> [f64; 3] {
    [sums.kinetic_before_j, sums.kinetic_after_j, sums.outer_work_j]
}

/// Of the comparison of all paths; the portable one is slow.
const N_STEPS: u32 = 12;

#[test]
fn every_path_and_number_of_threads_gives_the_same_bits() {
    let mesh = shaken_block([11, 9, 7], SIZE_M, 0.15, 12);
    let fixed = nodes_below(&mesh, 0, 0.01);
    let mut u = random_field(mesh.positions_m.len(), 8e-4, 13);
    // Some tetrahedra are inverted.
    for n in [111, 222] {
        u[n] += DVec3::splat(0.012);
    }
    let step = ExplicitStep { step_s: 1e-6, damping_per_s: 5.0 };
    let beside = AllExtras::of_mesh(&mesh);
    for law in ALL_LAWS {
        let plain = KernelExtras { laws: beside.laws_for(law), ..KernelExtras::default() };
        for extras in [plain, beside.for_law(law)] {
            let mut reference: Option<Outcome> = None;
            for path in KernelPath::available() {
                for n_threads in [1, 2, 4] {
                    let mut kernel = kernel_with(&mesh, law, &extras);
                    kernel.set_path(path);
                    kernel.set_displacements(&u);
                    for &node in &fixed {
                        kernel.hold(node, true);
                    }
                    let workers = team(n_threads);
                    kernel.set_outer_force(NodeId(50), DVec3::new(0.1, 0.2, -0.3));
                    let mut quarantined = QuarantineReport::default();
                    let mut energies = Vec::new();
                    for i in 0..N_STEPS {
                        kernel.step(workers.as_ref(), step);
                        energies.extend(energies_j(kernel.step_sums()));
                        if i == 0 {
                            quarantined = kernel.quarantined();
                        }
                        kernel.remove_tet(&mesh, TetId(37 * i));
                    }
                    let mut state = [(); 3].map(|()| vec![DVec3::ZERO; u.len()]);
                    kernel.displacements_into(&mut state[0]);
                    kernel.increments_into(&mut state[1]);
                    kernel.forces_into(&mut state[2]);
                    let mut history = vec![0.0; kernel.history_len()];
                    kernel.history_into(&mut history);
                    history.extend(energies);
                    assert!(state[0].iter().all(|u| u.is_finite()));
                    assert!(fixed.iter().all(|n| state[0][n.index()] == u[n.index()]), "held nodes stay");
                    assert!(quarantined.n_tets > 0, "some are inverted");
                    let history = history.into_iter().map(f64::to_bits).collect();
                    let found = (state.map(|vectors| bits(&vectors)), history, quarantined);
                    let reference = reference.get_or_insert_with(|| found.clone());
                    assert!(*reference == found, "{law:?} on {} with {n_threads} threads", path.name());
                }
            }
        }
    }
    assert_eq!(KernelPath::available().last().unwrap().name(), "portable");
}

#[test]
fn a_kernel_after_removals_equals_one_of_the_remaining_mesh() {
    let mesh = shaken_block([6, 5, 4], SIZE_M, 0.15, 14);
    let n_nodes = mesh.positions_m.len();
    // A node that loses everything, and every seventh tetrahedron.
    let bare = mesh.tetrahedra[0][0];
    let goes = |t: usize| t % 7 == 3 || mesh.tetrahedra[t].contains(&bare);
    let (removed, kept): (Vec<usize>, Vec<usize>) = (0..mesh.tetrahedra.len()).partition(|&t| goes(t));
    let rest = TetMesh {
        positions_m: mesh.positions_m.clone(),
        tetrahedra: kept.iter().map(|&t| mesh.tetrahedra[t]).collect(),
        ..TetMesh::default()
    };
    let u = random_field(n_nodes, 3e-3, 15);
    for law in LAWS {
        let mut cut = kernel(&mesh, law);
        for &t in &removed {
            cut.remove_tet(&mesh, TetId::from_index(t));
            cut.remove_tet(&mesh, TetId::from_index(t));
        }
        let mut fresh = kernel(&rest, law);
        let (mut found, mut expected) = (vec![DVec3::ONE; n_nodes], vec![DVec3::ONE; n_nodes]);
        cut.force_into(&Sequential, &u, &mut found);
        fresh.force_into(&Sequential, &u, &mut expected);
        assert!(relative_difference(&found, &expected) < 1e-12);
        assert_eq!((found[bare.index()], expected[bare.index()]), (DVec3::ZERO, DVec3::ZERO));
        for n in (0..n_nodes).map(NodeId::from_index) {
            let (cut, fresh) = (cut.mass_kg(n), fresh.mass_kg(n));
            assert!((cut - fresh).abs() <= 1e-14 * fresh + 0.0, "mass {cut} {fresh}");
        }
        assert!(!cut.is_live(TetId::from_index(removed[0])) && cut.is_live(TetId::from_index(kept[0])));
    }
}

#[test]
fn steps_follow_the_tensor_mass_model() {
    let mesh = shaken_block([5, 4, 3], SIZE_M, 0.1, 16);
    let material = material();
    let fixed_nodes = &nodes_below(&mesh, 0, 0.012)[..];
    let step_s = 0.8 * TensorMass::stable_step(&mesh, &material).unwrap().step_s;
    let damping_per_s = 3.0;
    let gravity_m_per_s2 = DVec3::new(0.0, 1.0, -9.81);
    let mut model = TensorMass::build(&TensorMassParams {
        body: DynamicBody {
            fixed: &held(fixed_nodes),
            damping: Rayleigh::of_mass(damping_per_s),
            gravity_m_per_s2,
            time_step_s: step_s,
            ..DynamicBody::new(&mesh, material.density_kg_per_m3())
        },
        material: &material,
    })
    .unwrap();
    let mut kernel = kernel(&mesh, KernelLaw::Linear);
    for n in (0..mesh.positions_m.len()).map(NodeId::from_index) {
        assert!((kernel.mass_kg(n) - model.mass_kg(n)).abs() < 1e-15);
        kernel.set_outer_force(n, gravity_m_per_s2 * kernel.mass_kg(n));
        kernel.hold(n, fixed_nodes.contains(&n));
    }
    for _ in 0..300 {
        model.step(step_s);
        kernel.step(&Sequential, ExplicitStep { step_s, damping_per_s });
    }
    let mut found = vec![DVec3::ZERO; mesh.positions_m.len()];
    kernel.displacements_into(&mut found);
    let expected: Vec<DVec3> =
        model.state().positions_m.iter().zip(&mesh.positions_m).map(|(p, rest)| *p - *rest).collect();
    assert!(relative_difference(&found, &expected) < 1e-9);
    kernel.stop();
    kernel.increments_into(&mut found);
    assert!(found.iter().all(|i| *i == DVec3::ZERO));
}

/// Seed `003`, eq. 3.3, node by node, with the energies that the sums are documented to have.
#[test]
fn a_step_moves_every_node_as_the_formula_says_and_sums_its_energies() {
    // An odd number of nodes; two parts.
    let mesh = shaken_block([4, 4, 2], SIZE_M, 0.1, 21);
    let n_nodes = mesh.positions_m.len();
    assert_eq!(n_nodes % 2, 1);
    let (u, v_m) = (random_field(n_nodes, 2e-4, 22), random_field(n_nodes, 1e-6, 23));
    let outer_n = random_field(n_nodes, 0.2, 24);
    let (last_s, h, d) = (2e-5, 1e-5, 50.0);
    // All nodes somewhere, then one nowhere.
    for nowhere in [None, Some(31)] {
        let mut kernel = kernel(&mesh, KernelLaw::StVenantKirchhoff);
        kernel.set_displacements(&u);
        let held = |n: usize| [n.is_multiple_of(5), n.is_multiple_of(7), n.is_multiple_of(5)];
        for n in 0..n_nodes {
            let node = NodeId::from_index(n);
            kernel.hold_axes(node, held(n));
            kernel.set_added_mass(node, 1e-4 * (n % 3) as f64);
            kernel.set_increment(node, v_m[n]);
            kernel.set_outer_force(node, if Some(n) == nowhere { DVec3::INFINITY } else { outer_n[n] });
        }
        kernel.set_last_step_s(Some(last_s));
        kernel.step(&Sequential, ExplicitStep { step_s: h, damping_per_s: d });
        let [mut before_j, mut after_j, mut work_j] = [0.0; 3];
        for n in 0..n_nodes {
            let node = NodeId::from_index(n);
            let free = DVec3::from_array(held(n).map(|held| f64::from(u8::from(!held))));
            let old_m = v_m[n] * free;
            let inertia_kg = kernel.inertia_kg(node);
            before_j += 0.5 * inertia_kg * (old_m / last_s).length_squared();
            // The last increment in proportion to the step.
            let past_m = old_m * (h / last_s);
            let push = (outer_n[n] - kernel.force_n(node)) / inertia_kg;
            let moved_m =
                free * (past_m * (1.0 / (h * h) - 0.5 * d / h) + push) / (1.0 / (h * h) + 0.5 * d / h);
            if Some(n) == nowhere {
                assert_eq!(kernel.displacement_m(node), u[n], "it stays");
                assert_eq!(kernel.increment_m(node), DVec3::ZERO);
                continue;
            }
            after_j += 0.5 * inertia_kg * (moved_m / h).length_squared();
            work_j += 0.5 * outer_n[n].dot(moved_m + past_m);
            let off_m = kernel.increment_m(node).distance(moved_m);
            assert!(off_m <= 1e-12 * moved_m.length(), "node {n}: {off_m}");
            assert!(kernel.displacement_m(node).distance(u[n] + moved_m) < 1e-18, "{n}");
        }
        let sums = kernel.step_sums();
        assert_eq!(sums.n_recovered, u32::from(nowhere.is_some()));
        let is_near = |found: f64, expected: f64| (found - expected).abs() < 1e-12 * expected.abs();
        assert!(is_near(sums.kinetic_before_j, before_j), "{sums:?} {before_j}");
        assert!(is_near(sums.kinetic_after_j, after_j), "{sums:?} {after_j}");
        // The work of an infinite force is no number.
        assert!(nowhere.is_some() || is_near(sums.outer_work_j, work_j), "{sums:?} {work_j}");
    }
}

/// Calm are det F from 0.5 to 1.8 and, where strain makes a law stiffer, |F^T F - Id| up to 1.3^2 - 1.
#[test]
fn tissue_is_strained_when_its_volume_or_strain_leaves_the_calm_ones() {
    let mesh = block([2, 2, 2], SIZE_M);
    let n_tets = mesh.tetrahedra.len();
    let by_volume =
        [(1.0, false, 0), (0.501, false, 0), (0.499, true, 0), (1.799, false, 0), (1.801, true, 0)];
    let by_strain = [(1.0, false, 0), (0.56, false, 0), (0.55, true, 0), (1.299, false, 0), (1.301, true, 0)];
    for law in [KernelLaw::Linear, KernelLaw::StVenantKirchhoff, KernelLaw::StableNeoHooke] {
        let mut kernel = kernel(&mesh, law);
        kernel.set_quarantine(Quarantine::NotFinite);
        let not_finite = if law == KernelLaw::StVenantKirchhoff { n_tets } else { 0 };
        let stretches = if law == KernelLaw::Linear { by_volume } else { by_strain };
        for (stretch, is_strained, n_left_out) in
            stretches.into_iter().chain([(-1.0, true, n_tets), (1e90, true, not_finite)])
        {
            // Turned by a quarter: large gradients alone are no strain.
            let moved = |p: &DVec3| DVec3::new(-p.y, stretch * p.x, p.z) - *p;
            let u: Vec<DVec3> = mesh.positions_m.iter().map(moved).collect();
            kernel.set_displacements(&u);
            kernel.stop();
            kernel.step(&Sequential, ExplicitStep { step_s: 1e-6, damping_per_s: 0.0 });
            let found = (kernel.is_strained(), kernel.quarantined().n_tets as usize);
            assert_eq!(found, (is_strained, n_left_out), "{law:?} {stretch}");
        }
    }
    let mut kernel = kernel(&mesh, KernelLaw::StVenantKirchhoff);
    kernel.set_calm_stretch(1.5);
    let u: Vec<DVec3> = mesh.positions_m.iter().map(|p| DVec3::X * (0.4 * p.x)).collect();
    kernel.set_displacements(&u);
    kernel.step(&Sequential, ExplicitStep { step_s: 1e-6, damping_per_s: 0.0 });
    assert!(!kernel.is_strained());
}

#[test]
fn a_changed_step_length_keeps_the_velocity() {
    // A free body in flight: nothing but its velocity counts.
    let mesh = block([1, 1, 1], DVec3::splat(0.1));
    let mut kernel = kernel(&mesh, KernelLaw::StVenantKirchhoff);
    let undamped = |step_s| ExplicitStep { step_s, damping_per_s: 0.0 };
    for n in (0..8).map(NodeId::from_index) {
        kernel.set_outer_force(n, DVec3::X * kernel.mass_kg(n));
    }
    kernel.step(&Sequential, undamped(1e-3));
    for n in (0..8).map(NodeId::from_index) {
        kernel.set_outer_force(n, DVec3::ZERO);
    }
    let mut increments = vec![DVec3::ZERO; 8];
    for step_s in [1e-3, 5e-4, 2e-3] {
        kernel.step(&Sequential, undamped(step_s));
        kernel.increments_into(&mut increments);
        assert!(increments.iter().all(|i| (i.x / step_s - 1e-3).abs() < 1e-12), "{increments:?}");
    }
}

#[test]
fn nodes_without_a_tetrahedron_have_no_part_in_it() {
    let mut mesh = block([2, 2, 2], SIZE_M);
    let loose = NodeId::from_index(mesh.positions_m.len());
    mesh.positions_m.push(DVec3::splat(5.0));
    let mut kernel = kernel(&mesh, KernelLaw::StVenantKirchhoff);
    let u = random_field(kernel.n_nodes(), 1e-3, 17);
    let mut force_n = vec![DVec3::ONE; u.len()];
    kernel.force_into(&Sequential, &u, &mut force_n);
    assert_eq!(force_n[loose.index()], DVec3::ZERO);
    kernel.hold(loose, true);
    kernel.set_displacement(loose, DVec3::ONE);
    kernel.set_outer_force(loose, DVec3::ONE);
    assert_eq!(kernel.mass_kg(loose), 0.0);
}

#[test]
fn unusable_input_is_named() {
    let mesh = block([2, 1, 1], SIZE_M);
    let build = |mesh: &TetMesh, materials: &[LinearElastic]| {
        let (law, path) = (KernelLaw::Linear, KernelPath::fastest());
        FastKernel::new(&KernelParams { mesh, law, materials, path }).err()
    };
    let two = [material(), material()];
    assert_eq!(build(&mesh, &two), Some(KernelError::Materials { found: 2, n_tets: 12 }));
    assert_eq!(build(&TetMesh::default(), &two[..1]), Some(SolveError::EmptyMesh.into()));
    let mut beyond = mesh.clone();
    beyond.tetrahedra[3][1] = NodeId(99);
    let out_of_range = SolveError::NodeOutOfRange { tet: TetId(3), node: NodeId(99), n_nodes: 12 };
    assert_eq!(build(&beyond, &two[..1]), Some(out_of_range.into()));
    let mut inverted = mesh.clone();
    inverted.tetrahedra[5].swap(0, 1);
    let found = build(&inverted, &two[..1]);
    assert!(matches!(found, Some(KernelError::Solve(SolveError::Volume { tet: TetId(5), .. }))), "{found:?}");
    let mut nowhere = mesh.clone();
    nowhere.positions_m[4].y = f64::NAN;
    assert!(matches!(
        build(&nowhere, &two[..1]),
        Some(KernelError::Solve(SolveError::NonFinitePosition { node: NodeId(4), .. }))
    ));
}
