//! Simplex meshes: topology, geometry, forces, operators, adaptation.

use glisson_mesh::image::{Volume, VoxelGrid};
use glisson_mesh::math::{DMat3, DVec3, SeededRandom};
use glisson_mesh::surface::TriMesh;
use glisson_mesh::surface::check::check_closed;
use glisson_mesh::surface::error::SurfaceError;
use glisson_mesh::surface::simplex::adapt::{AdaptParams, adapt};
use glisson_mesh::surface::simplex::dual::following_dual;
use glisson_mesh::surface::simplex::edit::SimplexEdit;
use glisson_mesh::surface::simplex::error::SimplexError;
use glisson_mesh::surface::simplex::evolve::{Deformation, DeformationLaw};
use glisson_mesh::surface::simplex::external::{
    Attraction, EdgePolarity, GradientBorder, MaskBorder, SurfaceBorder,
};
use glisson_mesh::surface::simplex::geometry::{
    NeighbourCircle, mean_curvatures_per_m, vertex_normals, vertex_shape,
};
use glisson_mesh::surface::simplex::internal::{
    Smoothness, Spacing, internal_forces_m, metric_towards_curvature,
};
use glisson_mesh::surface::simplex::measure::{
    density_correlation, middle_range, rank_correlation, surface_distances,
    triangulation_mean_curvatures_per_m,
};
use glisson_mesh::surface::simplex::mesh::SimplexMesh;
use glisson_mesh::surface::simplex::neighbourhood::Neighbourhoods;
use glisson_mesh::surface::simplex::untangle::{
    crossing_vertices, return_from_crossings, smooth_crossings_away, surroundings,
};
use proptest::prelude::*;

/// An octahedron whose triangles are cut in four `n_cuts` times, its vertices on the unit sphere.
fn unit_sphere(n_cuts: usize) -> TriMesh {
    let mut mesh = TriMesh {
        positions_m: [DVec3::X, DVec3::Y, DVec3::Z, -DVec3::X, -DVec3::Y, -DVec3::Z].to_vec(),
        triangles: vec![
            [0, 1, 2],
            [1, 3, 2],
            [3, 4, 2],
            [4, 0, 2],
            [1, 0, 5],
            [3, 1, 5],
            [4, 3, 5],
            [0, 4, 5],
        ],
    };
    for _ in 0..n_cuts {
        let mut middles = std::collections::BTreeMap::new();
        let mut triangles = Vec::new();
        for &[a, b, c] in &mesh.triangles {
            let mut middle = |p: u32, q: u32| {
                *middles.entry((p.min(q), p.max(q))).or_insert_with(|| {
                    let at = mesh.positions_m[p as usize] + mesh.positions_m[q as usize];
                    mesh.positions_m.push(at.normalize());
                    mesh.positions_m.len() as u32 - 1
                })
            };
            let [ab, bc, ca] = [middle(a, b), middle(b, c), middle(c, a)];
            triangles.extend([[a, ab, ca], [b, bc, ab], [c, ca, bc], [ab, bc, ca]]);
        }
        mesh.triangles = triangles;
    }
    mesh
}

/// A simplex mesh with its vertices on an ellipsoid of these half axes [m].
fn ellipsoid(half_axes_m: DVec3, n_cuts: usize) -> SimplexMesh {
    let mut mesh = SimplexMesh::from_triangles(&unit_sphere(n_cuts)).unwrap();
    for p in mesh.positions_m_mut() {
        *p = p.normalize() * half_axes_m;
    }
    mesh
}

fn torus(n_around: u32, n_tube: u32) -> TriMesh {
    let mut mesh = TriMesh::default();
    for i in 0..n_around {
        for j in 0..n_tube {
            let angle = |k: u32, n: u32| std::f64::consts::TAU * f64::from(k) / f64::from(n);
            let (u, v) = (angle(i, n_around), angle(j, n_tube));
            let ring = 0.03 + 0.01 * v.cos();
            mesh.positions_m.push(DVec3::new(ring * u.cos(), ring * u.sin(), 0.01 * v.sin()));
            let at = |i: u32, j: u32| (i % n_around) * n_tube + j % n_tube;
            let [a, b, c, d] = [at(i, j), at(i + 1, j), at(i + 1, j + 1), at(i, j + 1)];
            mesh.triangles.extend([[a, b, c], [a, c, d]]);
        }
    }
    mesh
}

fn random_unit(random: &mut SeededRandom) -> DVec3 {
    DVec3::new(random.normal(), random.normal(), random.normal()).normalize()
}

fn smallest_first([a, b, c]: [u32; 3]) -> [u32; 3] {
    if a < b && a < c {
        [a, b, c]
    } else if b < c {
        [b, c, a]
    } else {
        [c, a, b]
    }
}

/// Carries out operators chosen at random; answers how many were not refused.
fn edit_at_random(edit: &mut SimplexEdit, random: &mut SeededRandom, n: usize) -> usize {
    let mut done = 0;
    for _ in 0..n {
        let below = |random: &mut SeededRandom, n: usize| (random.uniform() * n as f64) as usize;
        let vertex = below(random, edit.mesh().n_vertices()) as u32;
        let side = below(random, 3);
        done += usize::from(match below(random, 3) {
            0 => edit.remove_edge(vertex, side).is_some(),
            1 => edit.swap_edge(vertex, side),
            _ => {
                let cell = below(random, edit.mesh().n_cells()) as u32;
                let sides = if edit.has_cell(cell) { edit.mesh().contour(cell).len() } else { 3 };
                let (from, to) = (below(random, sides), below(random, sides));
                edit.split_cell(cell, from, to).is_some()
            }
        });
    }
    done
}

// --- topology ---------------------------------------------------------------------------------------------

#[test]
fn simplex_vertices_have_the_neighbours_of_their_triangles() {
    let triangles = torus(24, 12);
    let mesh = SimplexMesh::from_triangles(&triangles).unwrap();
    let topology = mesh.check().unwrap();
    assert_eq!((topology.n_vertices, topology.n_cells, topology.n_edges), (576, 288, 864));
    assert_eq!(topology.euler_characteristic, 0);
    for v in 0..mesh.n_vertices() {
        for (k, &n) in mesh.neighbours()[v].iter().enumerate() {
            let (own, other) = (triangles.triangles[v], triangles.triangles[n as usize]);
            assert!(!other.contains(&own[k]), "across the edge opposite to corner {k}");
            assert_eq!(own.iter().filter(|c| other.contains(c)).count(), 2);
        }
    }
    // Contours: the triangles around each vertex, each a neighbour of the next, counter-clockwise.
    for cell in 0..mesh.n_cells() as u32 {
        let contour = mesh.contour(cell);
        assert_eq!(contour.len(), triangles.triangles.iter().filter(|t| t.contains(&cell)).count());
        let centre = triangles.positions_m[cell as usize];
        let at = |i: usize| mesh.positions_m()[contour[i % contour.len()] as usize] - centre;
        let turn: DVec3 = (0..contour.len()).map(|i| at(i).cross(at(i + 1))).sum();
        let on_ring = DVec3::new(centre.x, centre.y, 0.0).normalize() * 0.03;
        assert!(turn.dot(centre - on_ring) > 0.0, "cell {cell} runs clockwise");
    }
}

#[test]
fn simplex_mesh_refuses_what_is_no_closed_manifold() {
    let sphere = unit_sphere(1);
    let refused = |mesh: &TriMesh| SimplexMesh::from_triangles(mesh).unwrap_err();
    let mut open = sphere.clone();
    open.triangles.pop();
    assert!(matches!(refused(&open), SimplexError::Surface(SurfaceError::OpenEdge { n_open: 3, .. })));
    let mut turned = sphere.clone();
    turned.triangles[0].swap(0, 1);
    assert!(matches!(refused(&turned), SimplexError::Surface(SurfaceError::InconsistentOrientation { .. })));
    let mut loose = sphere.clone();
    loose.positions_m.push(DVec3::ZERO);
    assert!(matches!(refused(&loose), SimplexError::UnusedVertex { vertex: 18, .. }));
    let mut double = sphere.clone();
    double.triangles.extend(sphere.triangles.clone());
    assert!(matches!(refused(&double), SimplexError::Surface(SurfaceError::NonManifoldEdge { .. })));
    // Two spheres that share one vertex.
    let mut pinched = sphere.clone();
    let n = sphere.positions_m.len() as u32;
    pinched.positions_m.extend(sphere.positions_m.iter().skip(1).map(|p| *p + 2.0 * DVec3::X));
    let second = |v: u32| if v == 0 { 0 } else { v + n - 1 };
    pinched.triangles.extend(sphere.triangles.iter().map(|t| t.map(second)));
    assert!(matches!(
        refused(&pinched),
        SimplexError::Surface(SurfaceError::PinchedVertex { vertex: 0, n_fans: 2, .. })
    ));
    assert_eq!(refused(&TriMesh::default()), SimplexError::Surface(SurfaceError::Empty));
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(48))]

    /// Dual of the dual: the same triangles over the same numbers, whatever the triangulation.
    #[test]
    fn simplex_dual_of_the_dual_is_the_mesh(seed in any::<u64>(), n in 3u32..9, m in 3u32..9, genus in 0..2) {
        let start = if genus == 0 { unit_sphere(2) } else { torus(n, m) };
        let mut random = SeededRandom::new(seed);
        let mut edit = SimplexEdit::new(SimplexMesh::from_triangles(&start).unwrap());
        edit_at_random(&mut edit, &mut random, 200);
        let triangles = edit.finish().dual();
        let mesh = SimplexMesh::from_triangles(&triangles).unwrap();
        mesh.check().unwrap();
        let again = SimplexMesh::from_triangles(&mesh.dual()).unwrap();
        prop_assert_eq!(again.neighbours(), mesh.neighbours());
        let normal = |mesh: &TriMesh| mesh.triangles.iter().map(|&t| smallest_first(t)).collect::<Vec<_>>();
        prop_assert_eq!(normal(&mesh.dual()), normal(&triangles));
        prop_assert_eq!(mesh.n_cells(), triangles.positions_m.len());
        // A cell's contour read back from the dual: the triangles that have it as their corner.
        for (cell, contour) in (0..mesh.n_cells() as u32).map(|c| (c, mesh.contour(c))) {
            prop_assert!(contour.iter().all(|&v| triangles.triangles[v as usize].contains(&cell)));
        }
    }

    /// Any sequence of operators keeps three neighbours a vertex and the Euler characteristic.
    #[test]
    fn simplex_operators_keep_the_surface_whole(seed in any::<u64>(), genus in 0..2) {
        let start = if genus == 0 { unit_sphere(1) } else { torus(7, 5) };
        let euler = 2 - 2 * i64::from(genus);
        let mut edit = SimplexEdit::new(SimplexMesh::from_triangles(&start).unwrap());
        let mut random = SeededRandom::new(seed);
        let mut done = 0;
        for _ in 0..6 {
            done += edit_at_random(&mut edit, &mut random, 80);
            let n_cells = edit.n_cells();
            let mesh = edit.finish();
            let topology = mesh.check().unwrap();
            prop_assert_eq!(topology.euler_characteristic, euler);
            prop_assert_eq!(topology.n_cells, n_cells);
            edit = SimplexEdit::new(mesh);
        }
        prop_assert!(done > 100, "{} operators were carried out", done);
    }
}

#[test]
fn simplex_operators_do_what_they_say() {
    let start = SimplexMesh::from_triangles(&unit_sphere(2)).unwrap();
    let sides = |mesh: &SimplexMesh, cell: u32| mesh.contour(cell).len();
    // T1: the two cells become one, those at the ends lose a side.
    let (vertex, side) = (40, 1);
    let own = start.cells()[vertex as usize];
    let [ahead, left, right] = [0, 1, 2].map(|step| own[(side + step) % 3]);
    let mut edit = SimplexEdit::new(start.clone());
    let merged = edit.remove_edge(vertex, side).unwrap();
    assert_eq!((merged.kept, merged.removed, merged.removed_vertices[0]), (left, right, vertex));
    assert_eq!(sides(edit.mesh(), left), sides(&start, left) + sides(&start, right) - 4);
    assert_eq!(sides(edit.mesh(), ahead), sides(&start, ahead) - 1);
    assert!(!edit.has_vertex(vertex) && !edit.has_cell(right) && edit.has_cell(left));
    assert!(edit.remove_edge(vertex, side).is_none() && !edit.swap_edge(vertex, side));
    let merged = edit.finish();
    assert_eq!(merged.n_vertices() + 2, start.n_vertices());
    assert_eq!(merged.check().unwrap().euler_characteristic, 2);
    // T2: two vertices in the middle of two edges, the cell's sides shared out.
    let mut edit = SimplexEdit::new(start.clone());
    let contour = start.contour(20);
    let around = edit.cells_around(20);
    assert_eq!(contour.len(), 6);
    let split = edit.split_cell(20, 1, 4).unwrap();
    assert_eq!([sides(edit.mesh(), 20), sides(edit.mesh(), split.cell)], [5, 5]);
    assert_eq!(sides(edit.mesh(), around[1]), sides(&start, around[1]) + 1);
    assert!(
        edit.mesh().contour(20).contains(&contour[2])
            && edit.mesh().contour(split.cell).contains(&contour[5])
    );
    let at = |v: u32| start.positions_m()[v as usize];
    let middle = 0.5 * (at(contour[1]) + at(contour[2]));
    assert!(edit.mesh().positions_m()[split.vertices[0] as usize].distance(middle) < 1e-15);
    assert!(edit.split_cell(20, 2, 2).is_none() && edit.split_cell(20, 0, 5).is_none());
    assert_eq!(edit.finish().check().unwrap().euler_characteristic, 2);
    // A swap and the swap back: the same connectivity.
    let mut edit = SimplexEdit::new(start.clone());
    let (losing, gaining) = edit.swap_cells(vertex, side).unwrap();
    assert_eq!((losing, gaining[0]), ([left, right], ahead));
    assert!(edit.swap_edge(vertex, side));
    assert_eq!(sides(edit.mesh(), left), sides(&start, left) - 1);
    assert_eq!(sides(edit.mesh(), ahead), sides(&start, ahead) + 1);
    edit.mesh().check().unwrap();
    let across = edit.mesh().cells()[vertex as usize].iter().position(|&c| c == left).unwrap();
    assert!(edit.swap_edge(vertex, across));
    let back = edit.finish();
    back.check().unwrap();
    let all = |mesh: &SimplexMesh| {
        let mut all: Vec<_> = mesh.cells().iter().map(|&t| smallest_first(t)).collect();
        all.sort_unstable();
        all
    };
    assert_eq!(all(&back), all(&start));
    // The smallest mesh gives up nothing: the tetrahedron is its own dual.
    let tetrahedron = TriMesh {
        positions_m: vec![DVec3::ZERO, DVec3::X, DVec3::Y, DVec3::Z],
        triangles: vec![[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]],
    };
    let mut edit = SimplexEdit::new(SimplexMesh::from_triangles(&tetrahedron).unwrap());
    for (v, side) in (0..4).flat_map(|v| (0..3).map(move |side| (v, side))) {
        assert!(!edit.can_remove_edge(v, side) && !edit.swap_edge(v, side));
    }
}

// --- geometry ---------------------------------------------------------------------------------------------

#[test]
fn simplex_vertex_comes_back_from_its_metric_and_angle() {
    let mut random = SeededRandom::new(3);
    let mut n_steep = 0;
    for _ in 0..2000 {
        let mut point = || DVec3::new(random.normal(), random.normal(), random.normal());
        let corners = [point(), point(), point()];
        let circle = NeighbourCircle::through(corners).unwrap();
        for corner in corners {
            assert!((circle.centre_m.distance(corner) / circle.radius_m - 1.0).abs() < 1e-6);
        }
        // The foot anywhere within the circle, any height.
        let along = (corners[0] - circle.centre_m).normalize();
        let (turn, reach) = (random.uniform_in(0.0, std::f64::consts::TAU), random.uniform_in(0.0, 0.98));
        let spoke = turn.cos() * along + turn.sin() * circle.normal.cross(along);
        let height = circle.radius_m * 1.5 * random.normal();
        let vertex = circle.centre_m + reach * circle.radius_m * spoke + height * circle.normal;
        let shape = circle.shape_of(vertex);
        assert!((shape.metric.iter().sum::<f64>() - 1.0).abs() < 1e-9);
        assert!((shape.height_m - height).abs() < 1e-9 * circle.radius_m);
        assert_eq!(shape.simplex_angle_rad > 0.0, height > 0.0);
        n_steep += usize::from(shape.simplex_angle_rad.abs() > std::f64::consts::FRAC_PI_2);
        let again = circle.vertex_m(shape.metric, shape.simplex_angle_rad);
        assert!(again.distance(vertex) < 1e-6 * circle.radius_m, "{shape:?}: {again} is not {vertex}");
    }
    assert!(n_steep > 200, "both branches of the equation");
    assert!(NeighbourCircle::through([DVec3::ZERO, DVec3::X, 2.0 * DVec3::X]).is_none());
}

#[test]
fn simplex_mean_curvature_of_a_sphere_is_one_over_its_radius() {
    let radius_m = 0.07;
    let mut sphere = ellipsoid(DVec3::splat(radius_m), 3);
    let check = |mesh: &SimplexMesh, expected: f64| {
        for h in mean_curvatures_per_m(mesh) {
            assert!((h / expected - 1.0).abs() < 1e-6, "{h} 1/m");
        }
    };
    check(&sphere, 1.0 / radius_m);
    for (normal, p) in vertex_normals(&sphere).iter().zip(sphere.positions_m()) {
        assert!(normal.dot(p.normalize()) > 0.9);
    }
    // Inside out it is concave.
    let mut inward = unit_sphere(3);
    inward.triangles.iter_mut().for_each(|t| t.swap(1, 2));
    sphere = SimplexMesh::from_triangles(&inward).unwrap();
    sphere.positions_m_mut().iter_mut().for_each(|p| *p = radius_m * p.normalize());
    check(&sphere, -1.0 / radius_m);
}

#[test]
fn simplex_neighbourhoods_hold_the_vertices_within_their_rings() {
    let mesh = SimplexMesh::from_triangles(&torus(40, 30)).unwrap();
    for rings in 0..4 {
        let within = Neighbourhoods::within(&mesh, rings);
        // On a honeycomb of six-sided cells.
        assert!((0..mesh.n_vertices()).all(|v| within.of(v).len() == 1 + 3 * rings * (rings + 1) / 2));
        assert!((0..mesh.n_vertices()).all(|v| within.of(v)[0] as usize == v));
        assert_eq!(surroundings(&mesh, &[7], rings).len(), within.of(7).len());
    }
    let values: Vec<f64> = (0..mesh.n_vertices()).map(|v| v as f64).collect();
    let means = Neighbourhoods::within(&mesh, 1).means(&values);
    let ring = mesh.neighbours()[5];
    assert!((means[5] - 0.25 * (5.0 + ring.iter().map(|&n| f64::from(n)).sum::<f64>())).abs() < 1e-12);
}

// --- forces -----------------------------------------------------------------------------------------------

#[test]
fn simplex_internal_forces_keep_what_they_should() {
    let radius_m = 0.05;
    let sphere = ellipsoid(DVec3::splat(radius_m), 3);
    let within = Neighbourhoods::within(&sphere, 3);
    let forces = |mesh: &SimplexMesh, smoothness: &Smoothness, spacing| {
        internal_forces_m(mesh, &within, smoothness, spacing)
    };
    let largest = |forces: &[DVec3]| forces.iter().map(|f| f.length()).fold(0.0, f64::max);
    let normals = vertex_normals(&sphere);
    let across =
        |forces: &[DVec3]| -> Vec<f64> { forces.iter().zip(&normals).map(|(f, n)| f.dot(*n)).collect() };
    let size_m = (sphere.neighbours_m(0)[0] - sphere.positions_m()[0]).length();
    // C0 never acts across the surface, and with free spacing not at all.
    assert!(across(&forces(&sphere, &Smoothness::Position, Spacing::Even)).iter().all(|f| f.abs() < 1e-12));
    assert!(largest(&forces(&sphere, &Smoothness::Position, Spacing::Free)) < 1e-12);
    // C1 pulls a sphere together; with even spacing it is the Laplacian.
    let c1 = forces(&sphere, &Smoothness::Orientation, Spacing::Even);
    assert!(across(&c1).iter().all(|&f| f < -1e-3 * size_m));
    let laplacian = sphere.neighbours_m(9).into_iter().sum::<DVec3>() / 3.0 - sphere.positions_m()[9];
    assert!((c1[9] - laplacian).length() < 1e-12);
    // C2 leaves a sphere alone, however uneven; C1 does not.
    let c2 = Smoothness::Curvature { rigidity: 3 };
    assert!(largest(&forces(&sphere, &c2, Spacing::Free)) < 1e-9 * radius_m);
    // A bump of one vertex is taken back.
    let mut bumped = sphere.clone();
    let outward = bumped.positions_m()[100].normalize();
    bumped.positions_m_mut()[100] += 0.3 * size_m * outward;
    assert!(forces(&bumped, &c2, Spacing::Free)[100].dot(outward) < -0.2 * size_m);
    // Shape memory: nothing on any similar shape, a way back on others.
    let shaped = ellipsoid(DVec3::new(0.07, 0.05, 0.04), 3);
    let angles_rad =
        (0..shaped.n_vertices()).map(|v| vertex_shape(&shaped, v).unwrap().1.simplex_angle_rad).collect();
    let memory = Smoothness::Shape { angles_rad };
    let mut similar = shaped.clone();
    let rotation = DMat3::from_axis_angle(DVec3::new(1.0, 2.0, -1.0).normalize(), 1.0);
    similar.positions_m_mut().iter_mut().for_each(|p| *p = 3.0 * (rotation * *p) + DVec3::ONE);
    assert!(largest(&forces(&similar, &memory, Spacing::Free)) < 1e-9);
    assert!(largest(&forces(&sphere, &memory, Spacing::Free)) > 1e-2 * size_m);
}

fn law(smoothness: Smoothness, spacing: Spacing, external: f64) -> DeformationLaw {
    DeformationLaw {
        damping: 0.65,
        internal: 0.4,
        external,
        data_uncertainty_m: f64::INFINITY,
        smoothness,
        spacing,
        largest_move_m: 2e-3,
    }
}

#[test]
fn simplex_metric_parameters_become_even_or_follow_curvature() {
    let metric_error = |mesh: &SimplexMesh| {
        let shapes = (0..mesh.n_vertices()).map(|v| vertex_shape(mesh, v).unwrap().1);
        shapes.flat_map(|s| s.metric).map(|e| (e - 1.0 / 3.0).abs()).sum::<f64>() / mesh.n_vertices() as f64
    };
    let mut random = SeededRandom::new(5);
    let mut mesh = ellipsoid(DVec3::new(0.08, 0.04, 0.04), 3);
    for p in mesh.positions_m_mut() {
        *p += 8e-4 * random_unit(&mut random);
    }
    let target = ellipsoid(DVec3::new(0.08, 0.04, 0.04), 5);
    let border = SurfaceBorder::new(following_dual(&target), 0.02);
    let run = |mut mesh: SimplexMesh, spacing, n| {
        let law = law(Smoothness::Curvature { rigidity: 3 }, spacing, 0.3);
        let mut deformation = Deformation::at_rest(&mesh, &law);
        for _ in 0..n {
            deformation.step(&mut mesh, &law, Some(&Attraction::Surface(&border)));
        }
        mesh
    };
    let before = metric_error(&mesh);
    let even = run(mesh, Spacing::Even, 150);
    assert!(metric_error(&even) < 0.2 * before, "{} of {before}", metric_error(&even));
    // Towards curvature: denser at the ellipsoid's ends than evenly spaced.
    let gathered = run(even.clone(), Spacing::TowardsCurvature { gain: 0.2 }, 150);
    let correlation = |mesh: &SimplexMesh| density_correlation(mesh, &mean_curvatures_per_m(mesh));
    assert!(
        correlation(&gathered) > correlation(&even) + 0.1,
        "{} from {}",
        correlation(&gathered),
        correlation(&even)
    );
    assert_eq!(metric_towards_curvature([0.0; 3], 0.2), [1.0 / 3.0; 3]);
    let metric = metric_towards_curvature([1.0, 2.0, 9.0], 0.2);
    assert!(metric[2] > metric[1] && metric[1] > metric[0] && metric[0] >= 0.08);
    assert!((metric.iter().sum::<f64>() - 1.0).abs() < 1e-12);
}

#[test]
fn simplex_curvature_force_takes_noise_and_keeps_the_sphere() {
    let radius_m = 0.05;
    let mut random = SeededRandom::new(8);
    let mut mesh = ellipsoid(DVec3::splat(radius_m), 3);
    for p in mesh.positions_m_mut() {
        *p *= 1.0 + 0.01 * random.normal();
    }
    let spread = |mesh: &SimplexMesh| {
        let [low, high] = middle_range(&mean_curvatures_per_m(mesh));
        high - low
    };
    let before = spread(&mesh);
    let c2 = law(Smoothness::Curvature { rigidity: 3 }, Spacing::Even, 0.0);
    let mut deformation = Deformation::at_rest(&mesh, &c2);
    let mut last = deformation.step(&mut mesh, &c2, None);
    assert_eq!(last.n_without_data, mesh.n_vertices());
    let first = last;
    for _ in 0..80 {
        last = deformation.step(&mut mesh, &c2, None);
    }
    assert!(last.mean_move_m < 0.05 * first.mean_move_m);
    assert!(spread(&mesh) < 0.1 * before, "{} of {before} 1/m", spread(&mesh));
    let mean_m = mesh.positions_m().iter().map(|p| p.length()).sum::<f64>() / mesh.n_vertices() as f64;
    assert!((mean_m / radius_m - 1.0).abs() < 0.01, "radius {mean_m} m without data");
}

fn cube_grid(n: usize) -> VoxelGrid {
    let origin_m = -0.5e-3 * (n as f64 - 1.0) * DVec3::ONE;
    VoxelGrid { dims: [n; 3], spacing_m: DVec3::splat(1e-3), origin_m, axes: DMat3::IDENTITY }
}

fn radii_m(grid: &VoxelGrid) -> Vec<f64> {
    let at = |v: [usize; 3]| grid.position_m(DVec3::from_array(v.map(|x| x as f64)));
    (0..grid.n_voxels()).map(|v| at(grid.voxel(v)).length()).collect()
}

#[test]
fn simplex_external_forces_find_the_border() {
    let grid = cube_grid(40);
    let radii_m = radii_m(&grid);
    let mask: Vec<bool> = radii_m.iter().map(|&r| r < 12e-3).collect();
    let border = MaskBorder::new(&grid, &mask, 1e-3, 5e-3).unwrap();
    let blurred: Vec<f32> =
        radii_m.iter().map(|r| 100.0 / (1.0 + ((r - 12e-3) / 1e-3).exp()) as f32).collect();
    let image = Volume { grid, values: blurred };
    let gradient =
        |polarity| GradientBorder { image: &image, reach_m: 5e-3, polarity, least_slope_per_m: 1e4 };
    let mut surface = unit_sphere(5);
    surface.positions_m.iter_mut().for_each(|p| *p *= 12e-3);
    let follow = SurfaceBorder::new(surface, 5e-3);
    let mut random = SeededRandom::new(11);
    for _ in 0..300 {
        let direction = random_unit(&mut random);
        let start_m = random.uniform_in(9e-3, 15e-3);
        let from = start_m * direction;
        let off = |offset_m: Option<f64>| (start_m + offset_m.unwrap() - 12e-3).abs();
        // The voxels' own steps remain; the image and the surface have none.
        assert!(off(border.offset_m(from, direction)) < 0.5e-3);
        assert!(off(Attraction::Mask(&border).offset_m(from, direction)) < 0.5e-3);
        assert!(off(gradient(EdgePolarity::BrightInside).offset_m(from, direction)) < 0.25e-3);
        assert!(off(gradient(EdgePolarity::Either).offset_m(from, direction)) < 0.25e-3);
        assert!(off(follow.offset_m(from, direction)) < 0.05e-3);
        assert!(gradient(EdgePolarity::DarkInside).offset_m(from, direction).is_none());
        // A border that falls against the normal is another sheet's.
        assert!(border.offset_m(from, -direction).is_none());
    }
    assert!(border.offset_m(DVec3::ZERO, DVec3::X).is_none(), "12 mm away, reach 5 mm");
    assert!(follow.distance_m(DVec3::ZERO).is_none());
}

#[test]
fn simplex_mask_border_keeps_sheets_thinner_than_its_smoothing() {
    let grid = cube_grid(24);
    // One voxel thick around k = 12, and a slot of one voxel in a block.
    let sheet: Vec<bool> = (0..grid.n_voxels()).map(|v| grid.voxel(v)[2] == 12).collect();
    let slotted: Vec<bool> = sheet.iter().map(|&s| !s).collect();
    for (mask, outward) in [(&sheet, 1.0), (&slotted, -1.0)] {
        let border = MaskBorder::new(&grid, mask, 1.5e-3, 4e-3).unwrap();
        let at_k = |k: f64| grid.position_m(DVec3::new(12.0, 12.0, k));
        let offset_m = border.offset_m(at_k(12.8), outward * DVec3::Z).unwrap();
        assert!((outward * offset_m + 0.3e-3).abs() < 0.3e-3, "{offset_m} m to the near side");
        let offset_m = border.offset_m(at_k(11.2), -outward * DVec3::Z).unwrap();
        assert!((outward * offset_m + 0.3e-3).abs() < 0.3e-3, "{offset_m} m to the far side");
    }
    let refused = MaskBorder::new(&grid, &[], 1e-3, 1e-3).err();
    assert!(matches!(refused, Some(SimplexError::Parameter { found: 0.0, .. })));
    let refused = MaskBorder::new(&grid, &sheet, -1e-3, 1e-3).err();
    assert!(matches!(refused, Some(SimplexError::Parameter { .. })));
}

// --- dual, measures, adaptation ---------------------------------------------------------------------------

#[test]
fn simplex_dual_follows_the_surface_without_shrinking() {
    let radius_m = 0.05;
    let sphere = ellipsoid(DVec3::splat(radius_m), 3);
    let volume = |mesh: &TriMesh| mesh.volume_m3() / (4.0 / 3.0 * std::f64::consts::PI * radius_m.powi(3));
    let (plain, following) = (sphere.dual(), following_dual(&sphere));
    assert!(volume(&plain) < 0.96, "{}", volume(&plain));
    assert!((volume(&following) - 1.0).abs() < 0.01, "{}", volume(&following));
    for t in 0..following.triangles.len() {
        let centre = following.corners_m(t).into_iter().sum::<DVec3>() / 3.0;
        assert!((centre.length() / radius_m - 1.0).abs() < 2e-3);
    }
    check_closed(&following).unwrap();
}

#[test]
fn simplex_measures_match_known_values() {
    assert_eq!(rank_correlation(&[1.0, 5.0, 9.0, 9.5], &[-1.0, 0.0, 100.0, 101.0]), 1.0);
    assert_eq!(rank_correlation(&[1.0, 5.0, 9.0], &[3.0, 2.0, 1.0]), -1.0);
    assert_eq!(rank_correlation(&[1.0, 2.0, 3.0], &[4.0, 4.0, 4.0]), 0.0);
    // With ties: Pearson's correlation of the ranks 0.5 0.5 2 3 and 0 1 2 3.
    let tied = rank_correlation(&[1.0, 1.0, 2.0, 3.0], &[1.0, 2.0, 3.0, 4.0]);
    assert!((tied - 4.5 / (4.5f64 * 5.0).sqrt()).abs() < 1e-12, "{tied}");
    let values: Vec<f64> = (0..=100).map(f64::from).collect();
    assert_eq!(middle_range(&values), [5.0, 95.0]);
    assert_eq!(middle_range(&[]), [0.0, 0.0]);
    let scaled = |radius: f64| {
        let mut mesh = unit_sphere(4);
        mesh.positions_m.iter_mut().for_each(|p| *p *= radius);
        mesh
    };
    let apart = surface_distances(&scaled(1.1), &scaled(1.0));
    assert!(
        (apart.mean_m - 0.1).abs() < 2e-3 && (apart.max_m - 0.1).abs() < 4e-3 && apart.p95_m <= apart.max_m
    );
    for h in triangulation_mean_curvatures_per_m(&scaled(2.0)) {
        assert!((h - 0.5).abs() < 0.03, "{h}");
    }
}

#[test]
fn simplex_adaptation_meets_its_number_and_gathers_cells_at_curvature() {
    let even = law(Smoothness::Curvature { rigidity: 2 }, Spacing::Even, 0.0);
    let relaxed = |mut mesh: SimplexMesh| {
        let mut deformation = Deformation::at_rest(&mesh, &even);
        for _ in 0..10 {
            deformation.step(&mut mesh, &even, None);
        }
        mesh
    };
    // Evenly spaced first: cut and joined by area alone.
    let start = ellipsoid(DVec3::new(0.08, 0.03, 0.03), 4);
    let zeros = vec![0.0; start.n_vertices()];
    let params = AdaptParams { target_cells: start.n_cells(), contrast: 6.0, tolerance_m: 1e-3 };
    let mesh = relaxed(adapt(start, &zeros, &zeros, &[], &params).0);
    let zeros = vec![0.0; mesh.n_vertices()];
    let curvatures_of =
        |mesh: &SimplexMesh| Neighbourhoods::within(mesh, 4).means(&mean_curvatures_per_m(mesh));
    let curvatures = curvatures_of(&mesh);
    for target_cells in [700, mesh.n_cells(), 1500] {
        let params = AdaptParams { target_cells, ..params };
        let (adapted, report) = adapt(mesh.clone(), &curvatures, &zeros, &[], &params);
        assert_eq!(adapted.n_cells(), target_cells);
        assert_eq!(mesh.n_cells() + report.n_split, target_cells + report.n_merged);
        assert_eq!(adapted.check().unwrap().euler_characteristic, 2);
        check_closed(&adapted.dual()).unwrap();
        let sides = (0..target_cells as u32).map(|c| adapted.contour(c).len());
        assert!(sides.filter(|&n| (5..=7).contains(&n)).count() > target_cells * 9 / 10);
    }
    let before = density_correlation(&mesh, &curvatures);
    let adapted = relaxed(adapt(mesh.clone(), &curvatures, &zeros, &[], &params).0);
    let after = density_correlation(&adapted, &curvatures_of(&adapted));
    assert!(after > 0.5 && after > before + 0.2, "{after} from {before}");
    // Far from the data: as dense as twice the area asks for. Kept cells stay.
    let far: Vec<f64> = mesh.positions_m().iter().map(|p| if p.x > 0.0 { 2e-3 } else { 0.0 }).collect();
    let (dense, _) = adapt(mesh.clone(), &zeros, &far, &[], &params);
    let in_front = dense.positions_m().iter().filter(|p| p.x > 0.0).count();
    assert!(in_front > dense.n_vertices() * 7 / 10, "{in_front} of {}", dense.n_vertices());
    let all: Vec<u32> = (0..mesh.n_vertices() as u32).collect();
    let (kept, report) = adapt(mesh.clone(), &curvatures, &far, &all, &params);
    assert_eq!((&kept, report.n_swapped), (&mesh, 0));
}

#[test]
fn simplex_crossings_are_taken_back() {
    let safe = ellipsoid(DVec3::new(0.05, 0.05, 0.01), 3);
    assert!(crossing_vertices(&safe).is_empty());
    // The upper side's middle pushed through the lower side.
    let mut pushed = safe.clone();
    for p in pushed.positions_m_mut() {
        if p.z > 0.0 && p.x.hypot(p.y) < 0.02 {
            p.z -= 0.03;
        }
    }
    assert!(!crossing_vertices(&pushed).is_empty());
    let mut dual = following_dual(&pushed);
    let (n, is_clear) = return_from_crossings(&mut pushed, safe.positions_m());
    assert!(is_clear && n > 0 && n < safe.n_vertices());
    check_closed(&following_dual(&pushed)).unwrap();
    assert!(smooth_crossings_away(&mut dual).is_ok_and(|n| n > 0));
    check_closed(&dual).unwrap();
}
