//! Surfaces filled with tetrahedra: shape, volume, angles, topology, repeatability.

use glisson_mesh::image::labels::Parts;
use glisson_mesh::image::phantom::{self, PhantomParams};
use glisson_mesh::math::{DVec3, SeededRandom};
use glisson_mesh::mesh::TetMesh;
use glisson_mesh::mesh::faults::find_faults;
use glisson_mesh::mesh::generate::{
    COUNT_TOLERANCE, MeshParams, MeshingError, VOLUME_TOLERANCE, WantedSize, generate,
};
use glisson_mesh::mesh::quality::{MeshQuality, SurfaceShape, surface_triangles};
use glisson_mesh::mesh::stuffing::{Lattice, MIN_DIHEDRAL_DEG, Stuffing, WantedTopology};
use glisson_mesh::mesh::thin::{ThinKind, thin_features};
use glisson_mesh::surface::TriMesh;
use glisson_mesh::surface::extract::{SurfaceParams, surface_of_mask};
use glisson_mesh::surface::signed_distance::{SignedDistance, SignedDistanceError};
use proptest::prelude::*;
use std::collections::BTreeMap;

/// Unit sphere: an octahedron with its triangles split in four `n` times.
pub(crate) fn sphere(n: usize) -> TriMesh {
    let mut positions_m = vec![DVec3::X, -DVec3::X, DVec3::Y, -DVec3::Y, DVec3::Z, -DVec3::Z];
    let mut triangles: Vec<[u32; 3]> =
        vec![[0, 2, 4], [2, 1, 4], [1, 3, 4], [3, 0, 4], [2, 0, 5], [1, 2, 5], [3, 1, 5], [0, 3, 5]];
    for _ in 0..n {
        let mut middle_of = BTreeMap::new();
        let mut middle = |a: u32, b: u32| {
            *middle_of.entry([a.min(b), a.max(b)]).or_insert_with(|| {
                positions_m.push((positions_m[a as usize] + positions_m[b as usize]).normalize());
                positions_m.len() as u32 - 1
            })
        };
        triangles = triangles
            .iter()
            .flat_map(|&[a, b, c]| {
                let (ab, bc, ca) = (middle(a, b), middle(b, c), middle(c, a));
                [[a, ab, ca], [ab, b, bc], [ca, bc, c], [ab, bc, ca]]
            })
            .collect();
    }
    TriMesh { positions_m, triangles }
}

fn moved(mut surface: TriMesh, to: impl Fn(DVec3) -> DVec3) -> TriMesh {
    for p in &mut surface.positions_m {
        *p = to(*p);
    }
    surface
}

/// Torus around z of the radii `big` and `small`.
fn torus(big: f64, small: f64) -> TriMesh {
    let (n, m) = (60u32, 30u32);
    let turn = |i: u32, n: u32| f64::from(i) / f64::from(n) * std::f64::consts::TAU;
    let positions_m = (0..n * m)
        .map(|v| {
            let (u, w) = (turn(v / m, n), turn(v % m, m));
            let ring = big + small * w.cos();
            DVec3::new(ring * u.cos(), ring * u.sin(), small * w.sin())
        })
        .collect();
    let at = |i: u32, j: u32| (i % n) * m + j % m;
    let triangles = (0..n * m)
        .flat_map(|v| {
            let (i, j) = (v / m, v % m);
            [[at(i, j), at(i + 1, j), at(i + 1, j + 1)], [at(i, j), at(i + 1, j + 1), at(i, j + 1)]]
        })
        .collect();
    TriMesh { positions_m, triangles }
}

/// Smooth random star-shaped body of about 10 cm.
fn blob(seed: u64, roughness: f64) -> TriMesh {
    let mut random = SeededRandom::new(seed);
    let waves: Vec<(DVec3, f64, f64)> = (0..8)
        .map(|_| {
            let direction = DVec3::new(random.normal(), random.normal(), random.normal()).normalize();
            (direction, random.uniform_in(1.0, 4.0), random.uniform_in(0.0, 6.3))
        })
        .collect();
    let scale = DVec3::new(random.uniform_in(0.5, 1.0), random.uniform_in(0.5, 1.0), 1.0);
    let turn = glisson_mesh::math::DMat3::from_rotation_z(random.uniform_in(0.0, 6.3))
        * glisson_mesh::math::DMat3::from_rotation_x(random.uniform_in(0.0, 6.3));
    moved(sphere(3), |p| {
        let swell: f64 = waves.iter().map(|(d, k, phase)| (k * d.dot(p) + phase).sin()).sum();
        0.05 * (turn * (scale * p * (1.0 + roughness * swell / 8.0).max(0.2)))
    })
}

/// Two-lobed wedge of a liver's size with a sharp rim and a fissure.
fn liver_like() -> TriMesh {
    moved(sphere(5), |p| {
        let fissure = 0.35 * (-((p.x - 0.25) / 0.06).powi(2)).exp() * (0.5 - 0.5 * p.y).powi(2);
        let thick = 0.05 * (1.0 - 0.75 * p.x.max(0.0)) * (1.0 + 0.3 * p.x);
        DVec3::new(
            0.14 * p.x,
            0.08 * p.y + 0.08 * fissure * (1.0 - p.y),
            thick * p.z * (1.0 - 0.85 * (p.x * p.x + 0.2 * p.y * p.y)).max(0.12),
        )
    })
}

fn with_count(n: usize) -> MeshParams {
    MeshParams { size: WantedSize::Tetrahedra(n), volume_m3: None }
}

/// Everything that a generated mesh promises.
fn assert_is_sound(mesh: &TetMesh, volume_m3: f64, euler: i64, pieces: usize) {
    let quality = MeshQuality::of(mesh);
    let (surface, overshared) = surface_triangles(mesh);
    assert!(overshared.is_empty());
    assert!(SurfaceShape::of(mesh.positions_m.len(), &surface).is_closed_manifold());
    assert_eq!(find_faults(mesh).lines(), Vec::<String>::new());
    assert!(quality.min_dihedral_deg >= MIN_DIHEDRAL_DEG - 1e-9, "{}", quality.min_dihedral_deg);
    assert!(quality.max_dihedral_deg <= 164.8, "{}", quality.max_dihedral_deg);
    assert!(quality.min_tetrahedron_volume_m3 > 0.0);
    assert!(
        (quality.volume_m3 / volume_m3 - 1.0).abs() <= VOLUME_TOLERANCE,
        "{}",
        quality.volume_m3 / volume_m3
    );
    assert_eq!((quality.surface_euler_characteristic, quality.surface_pieces), (euler, pieces));
}

#[test]
fn distance_to_a_sphere_is_the_known_one() {
    let surface = moved(sphere(5), |p| 0.05 * p + DVec3::new(0.3, -0.2, 0.1));
    let field = SignedDistance::of_surface(&surface, 0.0025, 0.02).unwrap();
    let mut random = SeededRandom::new(1);
    for _ in 0..2000 {
        let p = field.bounds_m().min_m
            + field.bounds_m().size_m() * DVec3::new(random.uniform(), random.uniform(), random.uniform());
        let expected = p.distance(DVec3::new(0.3, -0.2, 0.1)) - 0.05;
        // Near the surface: facets and trilinear interpolation, both about h^2/(8 r); far away one cell.
        let allowed = if expected.abs() < 0.0025 { 1e-4 } else { 2.5e-3 };
        assert!((field.sample_m(p) - expected).abs() < allowed, "{p}: {} {expected}", field.sample_m(p));
    }
}

#[test]
fn signs_hold_where_the_grid_runs_through_vertices_and_edges() {
    // Grid lines meet vertices, edges and whole faces of an octahedron whose corners are grid nodes.
    let surface = moved(sphere(0), |p| 4.0 * p);
    let field = SignedDistance::of_surface(&surface, 0.5, 1.0).unwrap();
    let [nx, ny, nz] = field.dims();
    for node in 0..nx * ny * nz {
        let p = field.node_position_m([node % nx, node / nx % ny, node / nx / ny]);
        let beyond = p.abs().element_sum() - 4.0;
        if beyond.abs() > 1e-9 {
            assert_eq!(field.values_m()[node] < 0.0, beyond < 0.0, "{p}");
        }
    }
}

#[test]
fn overlapping_pieces_are_united_by_their_winding() {
    let mut surface = sphere(3);
    let n = surface.positions_m.len() as u32;
    let second = moved(sphere(3), |p| p + DVec3::new(0.8, 0.1, 0.0));
    surface.positions_m.extend(second.positions_m);
    surface.triangles.extend(second.triangles.iter().map(|t| t.map(|v| v + n)));
    let field = SignedDistance::of_surface(&surface, 0.1, 0.3).unwrap();
    assert!(field.sample_m(DVec3::new(0.4, 0.0, 0.0)) < 0.0, "inside both");
    assert!(field.sample_m(DVec3::new(1.5, 0.1, 0.0)) < 0.0, "inside one");
    assert!(field.sample_m(DVec3::new(0.4, 1.2, 0.0)) > 0.0);
}

#[test]
fn a_ball_is_filled_at_every_size() {
    let surface = moved(sphere(4), |p| 0.05 * p);
    for n in [500, 2_000, 12_000] {
        let (mesh, report) = generate(&surface, &with_count(n)).unwrap();
        assert_is_sound(&mesh, surface.volume_m3(), 2, 1);
        let off = (mesh.tetrahedra.len() as f64 / n as f64 - 1.0).abs();
        assert!(off <= COUNT_TOLERANCE, "{} for {n}", mesh.tetrahedra.len());
        assert!(report.thin_features.is_empty(), "{:?}", report.thin_features);
        assert_eq!(report.quality, MeshQuality::of(&mesh));
    }
}

#[test]
fn the_wanted_edge_is_the_mean_inner_edge() {
    let surface = moved(sphere(5), |p| 0.05 * p);
    let params = MeshParams { size: WantedSize::EdgeM(0.006), volume_m3: None };
    let (mesh, report) = generate(&surface, &params).unwrap();
    assert_is_sound(&mesh, surface.volume_m3(), 2, 1);
    assert!((report.inner_edge_m - 0.006).abs() < 1e-12);
    assert!((report.quality.mean_edge_m / 0.006 - 1.0).abs() < 0.1, "{}", report.quality.mean_edge_m);
}

#[test]
fn a_torus_stays_a_torus() {
    let surface = torus(0.05, 0.02);
    let (mesh, _) = generate(&surface, &with_count(6_300)).unwrap();
    assert_is_sound(&mesh, surface.volume_m3(), 0, 1);
}

#[test]
fn a_ring_too_thin_for_the_cells_is_repaired_or_refused_but_never_torn() {
    for n in [200, 1_000] {
        let surface = torus(0.05, 0.006);
        match generate(&surface, &with_count(n)) {
            Ok((mesh, report)) => {
                assert_is_sound(&mesh, surface.volume_m3(), 0, 1);
                assert!(report.thin_features.iter().any(|f| f.kind == ThinKind::Body));
            }
            Err(MeshingError::Refused { euler, reasons, .. }) => {
                assert_eq!((euler, reasons.len()), (0, 10));
            }
            Err(other) => panic!("{other}"),
        }
    }
}

#[test]
fn two_bodies_and_a_hollow_one_keep_their_pieces() {
    let mut surface = moved(sphere(4), |p| 0.04 * p);
    let n = surface.positions_m.len() as u32;
    let hole = moved(sphere(4), |p| 0.02 * p);
    surface.positions_m.extend(hole.positions_m);
    surface.triangles.extend(hole.triangles.iter().map(|&[a, b, c]| [a + n, c + n, b + n]));
    let second = moved(sphere(4), |p| 0.03 * p + DVec3::new(0.1, 0.0, 0.0));
    surface.positions_m.extend(second.positions_m);
    surface.triangles.extend(second.triangles.iter().map(|t| t.map(|v| v + 2 * n)));
    let (mesh, _) = generate(&surface, &with_count(8_000)).unwrap();
    assert_is_sound(&mesh, surface.volume_m3(), 6, 3);
}

#[test]
fn a_liver_with_thin_rims_is_one_ball_at_every_size() {
    let surface = liver_like();
    for n in [2_000, 12_000] {
        let (mesh, report) = generate(&surface, &with_count(n)).unwrap();
        assert_is_sound(&mesh, surface.volume_m3(), 2, 1);
        let off = (mesh.tetrahedra.len() as f64 / n as f64 - 1.0).abs();
        assert!(off <= COUNT_TOLERANCE, "{} for {n}", mesh.tetrahedra.len());
        let thin = report.thin_features.iter().find(|f| f.kind == ThinKind::Body).expect("the rim");
        assert!(thin.thickness_m < 2.5 * report.cell_m && thin.volume_m3 > 0.0);
    }
}

#[test]
fn the_phantoms_liver_keeps_its_labels_volume() {
    let phantom = phantom::generate(&PhantomParams { seed: 4, voxel_m: 4e-3, ..PhantomParams::default() });
    let labels = &phantom.labels;
    let selection = labels.select("liver", Parts::Included).unwrap();
    let volume_m3 = labels.volume_m3(&selection);
    let (surface, _) =
        surface_of_mask(&labels.grid, &labels.mask(&selection), &SurfaceParams::default()).unwrap();
    let size = WantedSize::Tetrahedra(6_300);
    let (mesh, _) = generate(&surface, &MeshParams { size, volume_m3: Some(volume_m3) }).unwrap();
    assert_is_sound(&mesh, volume_m3, 2, 1);
}

#[test]
fn another_volume_than_the_surfaces_is_met() {
    let surface = liver_like();
    let wanted_m3 = 1.01 * surface.volume_m3();
    let params = MeshParams { size: WantedSize::Tetrahedra(6_300), volume_m3: Some(wanted_m3) };
    let (mesh, report) = generate(&surface, &params).unwrap();
    assert_is_sound(&mesh, wanted_m3, 2, 1);
    assert!(report.level_m > 0.0);
}

#[test]
fn the_same_surface_gives_the_same_bits() {
    let surface = blob(11, 1.0);
    let first = generate(&surface, &with_count(3_000)).unwrap();
    let second = generate(&surface, &with_count(3_000)).unwrap();
    assert_eq!(first, second);
    assert!(first.0.tetrahedra.windows(2).all(|w| w[0] != w[1]));
}

#[test]
fn sheets_and_fissures_are_found_where_they_are() {
    // A slab of 4 mm and a ball of 40 mm: the slab is thin for 5 mm cells, the ball is not.
    let mut surface = moved(sphere(4), |p| DVec3::new(0.05, 0.05, 0.002) * p.signum() * p.abs().powf(0.3));
    let n = surface.positions_m.len() as u32;
    let ball = moved(sphere(4), |p| 0.02 * p + DVec3::new(0.0, 0.0, 0.1));
    surface.positions_m.extend(ball.positions_m);
    surface.triangles.extend(ball.triangles.iter().map(|t| t.map(|v| v + n)));
    let field = SignedDistance::of_surface(&surface, 0.00125, 0.01).unwrap();
    let found = thin_features(&field, 0.005);
    assert_eq!(found.len(), 1, "{found:?}");
    assert_eq!(found[0].kind, ThinKind::Body);
    assert!(found[0].position_m[2].abs() < 0.002);
    assert!((found[0].thickness_m - 0.004).abs() < 0.0015, "{}", found[0].thickness_m);
    assert!(thin_features(&field, 0.0009).is_empty());
}

#[test]
fn an_analytic_field_is_stuffed_with_its_surface_nodes_on_it() {
    let lattice = Lattice { dims: [24; 3], cell_m: 0.1, origin_m: DVec3::splat(-1.15) };
    let mut stuffing = Stuffing::new(lattice, |p: DVec3| p.length() - 0.8, WantedTopology::BALL);
    let filling = stuffing.fill(0.0).unwrap();
    assert_eq!((stuffing.n_changed_signs(), filling.shape.euler_characteristic), (0, 2));
    let clamped = filling
        .surface
        .iter()
        .flatten()
        .filter(|&&v| (filling.mesh.positions_m[v as usize].length() - 0.8).abs() > 1e-8)
        .count();
    // Only cut points that a stiff node keeps away are off the sphere.
    assert!(clamped <= 14 * 3 * stuffing.n_stiff(), "{clamped} of {}", filling.surface.len());
    let exact = 4.0 / 3.0 * std::f64::consts::PI * 0.8f64.powi(3);
    let volume = filling.mesh.volume_m3();
    assert!(volume < exact && volume > 0.98 * exact, "chords cut off: {}", volume / exact);
}

#[test]
fn bad_surfaces_and_sizes_are_refused_with_the_reason() {
    let ball = moved(sphere(2), |p| 0.05 * p);
    let refusal = |surface: &TriMesh, params: MeshParams| generate(surface, &params).unwrap_err();
    let mut open = ball.clone();
    open.triangles.pop();
    match refusal(&open, with_count(2_000)) {
        MeshingError::NotClosed { n_edges: 3, .. } => {}
        other => panic!("{other}"),
    }
    let mut inverted = ball.clone();
    inverted.triangles.iter_mut().for_each(|t| t.swap(0, 1));
    assert!(
        matches!(refusal(&inverted, with_count(2_000)), MeshingError::NoVolume { volume_ml } if volume_ml < 0.0)
    );
    let mut broken = ball.clone();
    broken.triangles[7][1] = 999;
    assert!(refusal(&broken, with_count(2_000)).to_string().contains("triangle 7 names vertex 999"));
    let mut nan = ball.clone();
    nan.positions_m[5].y = f64::NAN;
    assert_eq!(refusal(&nan, with_count(2_000)).to_string().split(" is at").next(), Some("vertex 5"),);
    assert_eq!(refusal(&TriMesh::default(), with_count(2_000)), SignedDistanceError::Empty.into());
    for size in [
        WantedSize::Tetrahedra(3),
        WantedSize::EdgeM(f64::NAN),
        WantedSize::EdgeM(-1.0),
        WantedSize::EdgeM(1.0),
    ] {
        let error = refusal(&ball, MeshParams { size, volume_m3: None });
        assert!(matches!(error, MeshingError::BadParameter { .. }), "{error}");
    }
    let error = refusal(&ball, MeshParams { volume_m3: Some(1.0), ..with_count(2_000) });
    assert!(error.to_string().contains("wanted volume"), "{error}");
    let error = SignedDistance::of_surface(&ball, 1e-9, 0.0).unwrap_err();
    assert!(matches!(error, SignedDistanceError::TooFine { .. }));
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 12, ..ProptestConfig::default() })]

    #[test]
    fn any_smooth_blob_is_filled_soundly(seed in 0u64..1_000_000, roughness in 0.0..2.5f64, n in 600usize..3_000) {
        let surface = blob(seed, roughness);
        prop_assume!(surface.volume_m3() > 0.0);
        let (mesh, report) = generate(&surface, &with_count(n)).unwrap();
        assert_is_sound(&mesh, surface.volume_m3(), 2, 1);
        let off = (mesh.tetrahedra.len() as f64 / n as f64 - 1.0).abs();
        prop_assert!(off <= COUNT_TOLERANCE, "{} for {n}: {:?}", mesh.tetrahedra.len(), report.given_up);
    }
}
