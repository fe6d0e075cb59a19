//! Smoothed tetrahedra: patch test, derivatives, oracles of one strain, and the bodies in which plain tetrahedra lock.

use glisson_mesh::math::{DMat3, DVec3, SeededRandom};
use glisson_mesh::mesh::{NodeId, TetId, TetMesh};
use glisson_tissue::material::{
    HolzapfelGasserOgden, HolzapfelGasserOgdenParameters, LinearElastic, Material, MaterialSpec,
    MooneyRivlin, NeoHookeLog, StVenantKirchhoff, every_law,
};
use glisson_tissue::solve::{
    BoundaryConditions, ElasticBody, MeshEdges, NonlinearError, NonlinearProblem, NonlinearSettings,
    SmoothedBody, Smoothing, SolveError, StaticProblem, StiffnessTensors, TangentKind, add_gravity_forces,
    boundary_nodes, node_deformation_gradients, solve_nonlinear, solve_nonlinear_smoothed, solve_static,
    solve_static_smoothed,
};

use crate::model_meshes::{block, relative_difference, shaken_block};

const MIXED: Smoothing = Smoothing { element: 0.2, edge: 0.5, node: 0.3 };

fn linear(poisson_ratio: f64) -> LinearElastic {
    LinearElastic::from_young_poisson(5000.0, poisson_ratio, 1000.0).unwrap()
}

/// Every law.
fn laws() -> Vec<MaterialSpec> {
    let soft = linear(0.49);
    let fibres = HolzapfelGasserOgdenParameters {
        matrix_shear_pa: soft.mu_pa(),
        fibre_stiffness_pa: 900.0,
        fibre_exponent: 2.0,
        dispersion: 0.1,
        fibre_directions: vec![DVec3::X],
        bulk_pa: soft.bulk_modulus_pa(),
    };
    let own = |spec: MaterialSpec| match spec.name() {
        "st_venant_kirchhoff" => MaterialSpec::from(StVenantKirchhoff::from(&linear(0.3))),
        "holzapfel_gasser_ogden" => MaterialSpec::from(HolzapfelGasserOgden::new(&fibres).unwrap()),
        _ => spec,
    };
    every_law(&soft).unwrap().into_iter().map(own).collect()
}

/// Stretched along x, so that fibres are taut.
const GRADIENT: DMat3 =
    DMat3::from_cols(DVec3::new(0.15, 0.02, 0.03), DVec3::new(0.1, -0.08, 0.0), DVec3::new(0.0, 0.06, -0.04));

fn affine(mesh: &TetMesh) -> Vec<DVec3> {
    mesh.positions_m.iter().map(|&p| GRADIENT * p).collect()
}

fn irregular() -> TetMesh {
    shaken_block([3, 3, 2], DVec3::new(0.06, 0.05, 0.04), 0.2, 7)
}

fn random_vectors(n: usize, size: f64, seed: u64) -> Vec<DVec3> {
    let mut random = SeededRandom::new(seed);
    (0..n).map(|_| DVec3::new(random.normal(), random.normal(), random.normal()) * size).collect()
}

fn tensors_of<M: Material>(body: &SmoothedBody<'_, M>, u_m: &[DVec3], kind: TangentKind) -> StiffnessTensors {
    let n_pairs = body.pairs().nodes.len();
    let mut tensors =
        StiffnessTensors { vertex: vec![DMat3::ZERO; u_m.len()], edge: vec![DMat3::ZERO; n_pairs] };
    body.stiffness_into(u_m, kind, &mut tensors);
    tensors
}

fn dot(a: &[DVec3], b: &[DVec3]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a.dot(*b)).sum()
}

#[test]
fn an_affine_displacement_passes_the_patch_test_for_every_law() {
    let mesh = shaken_block([4, 3, 3], DVec3::new(0.08, 0.05, 0.05), 0.2, 7);
    let exact_m = affine(&mesh);
    let mut conditions = BoundaryConditions::new();
    for node in boundary_nodes(&mesh) {
        conditions.impose_node(node, exact_m[node.index()]);
    }
    let nodal_force_n = vec![DVec3::ZERO; mesh.positions_m.len()];
    let settings = NonlinearSettings { residual_tolerance: 1e-13, ..NonlinearSettings::default() };
    for spec in laws() {
        for smoothing in [Smoothing::BENDING, Smoothing::VOLUME, MIXED] {
            let problem = NonlinearProblem {
                mesh: &mesh,
                laws: &[spec.material()],
                conditions: &conditions,
                nodal_force_n: &nodal_force_n,
                settings,
            };
            let solution = solve_nonlinear_smoothed(&problem, smoothing)
                .unwrap_or_else(|e| panic!("{} {smoothing:?}: {e}", spec.name()));
            let error = relative_difference(&solution.displacement_m, &exact_m);
            assert!(error <= 1e-10, "{} {smoothing:?}: {error:e}", spec.name());
            for f in node_deformation_gradients(&mesh, &solution.displacement_m).unwrap() {
                assert!(f.abs_diff_eq(DMat3::IDENTITY + GRADIENT, 1e-9));
            }
        }
    }
}

#[test]
fn under_one_strain_energy_and_resultant_are_the_laws() {
    let mesh = irregular();
    let u_m = affine(&mesh);
    let edges = MeshEdges::of_mesh(&mesh).unwrap();
    for spec in laws() {
        let law = [spec.material()];
        let plain = ElasticBody::new(&mesh, &edges, &law).unwrap().energy_j(&u_m);
        let body = SmoothedBody::new(&mesh, &law, MIXED).unwrap();
        let (mut force_n, mut plain_n) = (vec![DVec3::ZERO; u_m.len()], vec![DVec3::ZERO; u_m.len()]);
        assert!((body.energy_j(&u_m) / plain - 1.0).abs() < 1e-10, "{}", spec.name());
        // The virial: sum of f (x) X is V P, whatever the division.
        body.force_into(&u_m, &mut force_n);
        ElasticBody::new(&mesh, &edges, &law).unwrap().force_into(&u_m, &mut plain_n);
        let virial = |f: &[DVec3]| {
            f.iter()
                .zip(&mesh.positions_m)
                .fold(DMat3::ZERO, |m, (f, x)| m + glisson_mesh::math::outer(*f, *x))
        };
        let (found, expected) = (virial(&force_n), virial(&plain_n));
        let scale = expected.to_cols_array().iter().fold(0.0_f64, |m, x| m.max(x.abs()));
        assert!(found.abs_diff_eq(expected, 1e-10 * scale), "{}: {found} {expected}", spec.name());
    }
}

#[test]
fn a_single_tetrahedron_is_a_plain_one() {
    let mesh = TetMesh {
        positions_m: vec![DVec3::ZERO, DVec3::X * 0.02, DVec3::Y * 0.01, DVec3::new(0.004, 0.003, 0.015)],
        tetrahedra: vec![[0, 1, 2, 3].map(NodeId)],
        ..TetMesh::default()
    };
    let u_m = random_vectors(4, 5e-4, 2);
    let edges = MeshEdges::of_mesh(&mesh).unwrap();
    for spec in laws() {
        let law = [spec.material()];
        let plain = ElasticBody::new(&mesh, &edges, &law).unwrap();
        let body = SmoothedBody::new(&mesh, &law, MIXED).unwrap();
        assert!((body.energy_j(&u_m) / plain.energy_j(&u_m) - 1.0).abs() < 1e-9, "{}", spec.name());
        let mut expected =
            StiffnessTensors { vertex: vec![DMat3::ZERO; 4], edge: vec![DMat3::ZERO; edges.nodes.len()] };
        plain.stiffness_into(&u_m, TangentKind::Exact, &mut expected);
        assert_eq!(body.pairs().nodes, edges.nodes);
        let found = tensors_of(&body, &u_m, TangentKind::Exact);
        let scale = expected.vertex[0].x_axis.length();
        for (a, b) in found.vertex.iter().chain(&found.edge).zip(expected.vertex.iter().chain(&expected.edge))
        {
            assert!(a.abs_diff_eq(*b, 1e-9 * scale), "{}: {a} {b}", spec.name());
        }
    }
}

/// Forces are the gradient of the energy, the stiffness that of the forces; a law a tetrahedron among them.
#[test]
fn derivatives_agree_with_finite_differences() {
    let mesh = irregular();
    let n = mesh.positions_m.len();
    let specs = laws();
    let mut cases: Vec<(String, Vec<&dyn Material>)> =
        specs.iter().map(|s| (s.name().to_owned(), vec![s.material()])).collect();
    let mixture = (0..mesh.tetrahedra.len()).map(|t| specs[t % specs.len()].material()).collect();
    cases.push(("a mixture".to_owned(), mixture));
    let noise = random_vectors(n, 2e-4, 3);
    // Swollen too: fibres that are just slack in a node's mean volume would have no second derivative.
    let u_m: Vec<DVec3> =
        (0..n).map(|i| GRADIENT * mesh.positions_m[i] + 0.05 * mesh.positions_m[i] + noise[i]).collect();
    let direction = random_vectors(n, 1.0, 4);
    let step_m = 1e-7;
    let moved = |sign: f64| -> Vec<DVec3> {
        u_m.iter().zip(&direction).map(|(u, d)| *u + *d * (sign * step_m)).collect()
    };
    for (name, laws) in &cases {
        for smoothing in [Smoothing::BENDING, MIXED] {
            let body = SmoothedBody::new(&mesh, laws, smoothing).unwrap();
            let force_at = |u: &[DVec3]| {
                let mut force_n = vec![DVec3::ZERO; n];
                body.force_into(u, &mut force_n);
                force_n
            };
            let (plus, minus) = (moved(1.0), moved(-1.0));
            let slope = (body.energy_j(&plus) - body.energy_j(&minus)) / (2.0 * step_m);
            let found = dot(&force_at(&u_m), &direction);
            assert!((found / slope - 1.0).abs() < 1e-6, "{name}: {found} {slope}");
            let difference: Vec<DVec3> = force_at(&plus)
                .iter()
                .zip(&force_at(&minus))
                .map(|(a, b)| (*a - *b) / (2.0 * step_m))
                .collect();
            let mut product = vec![DVec3::ZERO; n];
            tensors_of(&body, &u_m, TangentKind::Exact).force_into(body.pairs(), &direction, &mut product);
            let error = relative_difference(&product, &difference);
            assert!(error < 1e-6, "{name}: {error:e}");
        }
    }
}

#[test]
fn a_projected_stiffness_has_no_negative_direction() {
    let mesh = irregular();
    let law = [StVenantKirchhoff::from(&linear(0.3))];
    let body = SmoothedBody::new(&mesh, &law, Smoothing::BENDING).unwrap();
    // Below 1/sqrt(3) of its length St Venant-Kirchhoff tissue gives way.
    let u_m: Vec<DVec3> = mesh.positions_m.iter().map(|p| DVec3::new(-0.55 * p.x, 0.0, 0.0)).collect();
    let exact = tensors_of(&body, &u_m, TangentKind::Exact);
    let projected = tensors_of(&body, &u_m, TangentKind::Projected);
    let mut product = vec![DVec3::ZERO; u_m.len()];
    let mut least = [f64::INFINITY; 2];
    let further: Vec<DVec3> = mesh.positions_m.iter().map(|p| DVec3::new(p.x, 0.0, 0.0)).collect();
    for direction in (0..20).map(|seed| random_vectors(u_m.len(), 1.0, seed)).chain([further]) {
        for (k, tensors) in [&exact, &projected].into_iter().enumerate() {
            tensors.force_into(body.pairs(), &direction, &mut product);
            least[k] = least[k].min(dot(&product, &direction) / dot(&direction, &direction));
        }
    }
    assert!(least[0] < 0.0, "the case gives way: {least:?}");
    assert!(least[1] >= 0.0, "{least:?}");
}

#[test]
fn rigid_motions_cost_nothing() {
    let mesh = irregular();
    let turn = DMat3::from_axis_angle(DVec3::new(1.0, 2.0, -1.0).normalize(), 2.5);
    let shift_m = DVec3::new(0.3, -0.1, 0.2);
    let moved_m: Vec<DVec3> = mesh.positions_m.iter().map(|&p| turn * p + shift_m - p).collect();
    for spec in laws().iter().skip(1) {
        let law = [spec.material()];
        let body = SmoothedBody::new(&mesh, &law, MIXED).unwrap();
        let mut force_n = vec![DVec3::ZERO; moved_m.len()];
        body.force_into(&moved_m, &mut force_n);
        let largest_n = force_n.iter().map(|f| f.length()).fold(0.0, f64::max);
        // Bulk modulus times a face of 1 cm2.
        assert!(largest_n < 1e-10 * 83e3 * 1e-4, "{}: {largest_n:e}", spec.name());
    }
}

/// A clamped beam along z under its weight along -y.
struct Beam {
    mesh: TetMesh,
    material: LinearElastic,
    conditions: BoundaryConditions,
    weight_n: Vec<DVec3>,
}

impl Beam {
    /// B1: 20 x 20 x 200 mm, E 2 MPa, nu 0.45, 1100 kg/m3.
    fn new(cells: [usize; 3], gravity_m_per_s2: f64) -> Self {
        let mesh = block(cells, DVec3::new(0.02, 0.02, 0.2));
        let material = LinearElastic::from_young_poisson(2e6, 0.45, 1100.0).unwrap();
        let clamped: Vec<NodeId> = (0..mesh.positions_m.len())
            .filter(|&n| mesh.positions_m[n].z == 0.0)
            .map(NodeId::from_index)
            .collect();
        let mut weight_n = vec![DVec3::ZERO; mesh.positions_m.len()];
        add_gravity_forces(&mesh, &material, DVec3::new(0.0, -gravity_m_per_s2, 0.0), &mut weight_n);
        Self { mesh, material, conditions: BoundaryConditions::fixed(&clamped), weight_n }
    }

    fn linear(&self) -> StaticProblem<'_> {
        StaticProblem {
            mesh: &self.mesh,
            material: &self.material,
            conditions: &self.conditions,
            nodal_force_n: &self.weight_n,
        }
    }

    fn finite<'a, M>(&'a self, laws: &'a [M]) -> NonlinearProblem<'a, M> {
        NonlinearProblem {
            mesh: &self.mesh,
            laws,
            conditions: &self.conditions,
            nodal_force_n: &self.weight_n,
            settings: NonlinearSettings::default(),
        }
    }

    /// Mean displacement of the free end.
    fn tip_m(&self, displacement_m: &[DVec3]) -> DVec3 {
        let tip: Vec<usize> =
            (0..displacement_m.len()).filter(|&n| self.mesh.positions_m[n].z > 0.1999).collect();
        tip.iter().map(|&n| displacement_m[n]).sum::<DVec3>() / tip.len() as f64
    }
}

#[test]
fn small_loads_give_the_linear_solution() {
    let beam = Beam::new([2, 2, 10], 1e-3);
    let expected = solve_static_smoothed(&beam.linear(), Smoothing::BENDING).unwrap();
    for spec in [
        MaterialSpec::from(NeoHookeLog::from(&beam.material)),
        MaterialSpec::from(MooneyRivlin::from_linear(&beam.material, 0.3).unwrap()),
    ] {
        let laws = [spec.material()];
        // Forces of this beam are rounded at 1e-8 of so small a weight.
        let settings = NonlinearSettings { residual_tolerance: 1e-6, ..NonlinearSettings::default() };
        let problem = NonlinearProblem { settings, ..beam.finite(&laws) };
        let found = solve_nonlinear_smoothed(&problem, Smoothing::BENDING).unwrap();
        let error = relative_difference(&found.displacement_m, &expected.displacement_m);
        assert!(error < 1e-4, "{}: {error:e}", spec.name());
        let weight: DVec3 = beam.weight_n.iter().sum();
        let support: DVec3 = found.reaction_n.iter().sum();
        assert!((weight + support).length() < 1e-5 * weight.length());
    }
}

/// B1 on a mesh whose cells are all cut along the same diagonal: Timoshenko 32.74 mm linear, elastica 31.72 mm.
#[test]
fn the_cantilever_bends_like_a_beam() {
    let beam = Beam::new([4, 4, 29], 9.81);
    let sinks_mm = |u_m: &[DVec3]| -1e3 * beam.tip_m(u_m).y;
    let plain = sinks_mm(&solve_static(&beam.linear()).unwrap().displacement_m);
    let smoothed =
        sinks_mm(&solve_static_smoothed(&beam.linear(), Smoothing::BENDING).unwrap().displacement_m);
    assert!((smoothed / 32.74 - 1.0).abs() < 0.03, "{smoothed}");
    assert!(plain < 0.95 * smoothed, "{plain}");
    let beam = Beam::new([2, 2, 15], 9.81);
    let sinks_mm = |u_m: &[DVec3]| -1e3 * beam.tip_m(u_m).y;
    let laws = [NeoHookeLog::from(&beam.material)];
    let plain = sinks_mm(&solve_nonlinear(&beam.finite(&laws)).unwrap().displacement_m);
    let smoothed =
        sinks_mm(&solve_nonlinear_smoothed(&beam.finite(&laws), Smoothing::BENDING).unwrap().displacement_m);
    assert!((smoothed / 31.72 - 1.0).abs() < 0.05, "{smoothed}");
    assert!(plain < 0.8 * smoothed, "{plain}");
}

/// A nearly incompressible block squeezed between rough plates, to 70 %; plain tetrahedra resist much more
/// already at 95 %, and below 93 % the solver finds no equilibrium of them.
#[test]
fn a_squeezed_incompressible_block_does_not_lock() {
    let squeeze = |cells: usize, share: f64, smoothing: Option<Smoothing>| {
        let mesh = block([cells; 3], DVec3::splat(0.02));
        let mut conditions = BoundaryConditions::new();
        for (n, p) in mesh.positions_m.iter().enumerate() {
            if p.z == 0.0 || p.z > 0.02 - 1e-9 {
                let moved_m = if p.z == 0.0 { 0.0 } else { -share * 0.02 };
                conditions.impose_node(NodeId::from_index(n), DVec3::new(0.0, 0.0, moved_m));
            }
        }
        let laws = [NeoHookeLog::from(&linear(0.499))];
        let nodal_force_n = vec![DVec3::ZERO; mesh.positions_m.len()];
        let problem = NonlinearProblem {
            mesh: &mesh,
            laws: &laws,
            conditions: &conditions,
            nodal_force_n: &nodal_force_n,
            settings: NonlinearSettings { residual_tolerance: 1e-8, ..NonlinearSettings::default() },
        };
        let solution = match smoothing {
            Some(smoothing) => solve_nonlinear_smoothed(&problem, smoothing),
            None => solve_nonlinear(&problem),
        }
        .unwrap();
        let below = (0..mesh.positions_m.len()).filter(|&n| mesh.positions_m[n].z == 0.0);
        let volume_m3 = |u: &[DVec3]| -> f64 {
            let mut moved = mesh.clone();
            moved.positions_m.iter_mut().zip(u).for_each(|(p, u)| *p += *u);
            moved.volume_m3()
        };
        let swelling = volume_m3(&solution.displacement_m) / mesh.volume_m3() - 1.0;
        (below.map(|n| solution.reaction_n[n].z).sum::<f64>(), swelling)
    };
    let (coarse_n, swelling) = squeeze(4, 0.3, Some(Smoothing::BENDING));
    let (finer_n, _) = squeeze(6, 0.3, Some(Smoothing::BENDING));
    let (little_n, _) = squeeze(3, 0.05, Some(Smoothing::BENDING));
    let (plain_n, _) = squeeze(3, 0.05, None);
    assert!(swelling.abs() < 0.005, "{swelling}");
    assert!((coarse_n / finer_n - 1.0).abs() < 0.15, "{coarse_n} {finer_n}");
    assert!(plain_n > 1.4 * little_n, "{plain_n} {little_n}");
}

#[test]
fn faulty_cases_are_refused_as_by_the_plain_solver() {
    let beam = Beam::new([1, 1, 2], 9.81);
    let none: [NeoHookeLog; 0] = [];
    let n_tets = beam.mesh.tetrahedra.len();
    let refused = solve_nonlinear_smoothed(&beam.finite(&none), Smoothing::BENDING).unwrap_err();
    assert_eq!(refused, NonlinearError::LawCount { found: 0, n_tets });
    let floating = StaticProblem { conditions: &BoundaryConditions::new(), ..beam.linear() };
    let refused = solve_static_smoothed(&floating, Smoothing::BENDING).unwrap_err();
    assert!(matches!(refused, SolveError::Floating { rigid_modes: 6, .. }), "{refused}");
    let mut flat = Beam::new([1, 1, 2], 9.81);
    flat.mesh.tetrahedra[3].swap(0, 1);
    let refused = solve_static_smoothed(&flat.linear(), Smoothing::BENDING).unwrap_err();
    assert!(matches!(refused, SolveError::Volume { tet: TetId(3), .. }), "{refused}");
}
