//! Several organs meshed together: shared interfaces, closed surfaces, volumes, angles, repeatability.

use glisson_mesh::image::phantom::{self, PhantomParams, Tissue};
use glisson_mesh::image::{LabelMap, VoxelGrid};
use glisson_mesh::math::{DMat3, DVec3, SeededRandom};
use glisson_mesh::mesh::TetId;
use glisson_mesh::mesh::faults::find_faults;
use glisson_mesh::mesh::organs::{
    FinerBall, GRADED_DIHEDRAL_DEG, Grading, MAX_ORGAN_DIHEDRAL_DEG, MIN_ORGAN_DIHEDRAL_DEG,
    ORGAN_VOLUME_TOLERANCE, OrganMesh, OrganMeshError, OrganMeshParams, OrganSize, mesh_organs,
};
use glisson_mesh::mesh::quality::{MeshQuality, SurfaceShape};
use glisson_mesh::mesh::topology::Topology;
use glisson_mesh::progress::watched;
use glisson_mesh::surface::intersect::self_intersections;
use proptest::prelude::*;
use std::collections::BTreeSet;
use std::ops::ControlFlow;
use std::sync::{Arc, Mutex};

/// A map of cubic voxels whose labels are those of `label_at` at their centres [m].
fn painted(dims: [usize; 3], voxel_m: f64, label_at: impl Fn(DVec3) -> u16) -> LabelMap {
    let grid = VoxelGrid {
        dims,
        spacing_m: DVec3::splat(voxel_m),
        origin_m: DVec3::new(-0.03, 0.02, 0.05),
        axes: DMat3::IDENTITY,
    };
    painted_on(grid, label_at)
}

fn painted_on(grid: VoxelGrid, label_at: impl Fn(DVec3) -> u16) -> LabelMap {
    let center = |v: usize| {
        let [i, j, k] = grid.voxel(v);
        grid.position_m(DVec3::new(i as f64, j as f64, k as f64))
    };
    let labels = (0..grid.n_voxels()).map(|v| label_at(center(v))).collect();
    LabelMap { grid, labels, names: Vec::new(), colours: Vec::new() }
}

/// Middle of a map's box [m].
fn middle_m(map: &LabelMap) -> DVec3 {
    map.grid.bounds_m().center_m()
}

fn meshed(map: &LabelMap, cell_m: f64) -> OrganMesh {
    let params =
        OrganMeshParams { labels: Vec::new(), size: OrganSize::CellM(cell_m), grading: Grading::default() };
    mesh_organs(map, &params).unwrap()
}

/// Triangles over the mesh's nodes, each turned so that its lowest node is first.
fn triangles_of(organs: &OrganMesh, label: u16, other: u16) -> BTreeSet<[u32; 3]> {
    let cut = organs.interface(label, other);
    let turned = |t: &[u32; 3]| {
        let [a, b, c] = t.map(|v| cut.nodes[v as usize].0);
        [[a, b, c], [b, c, a], [c, a, b]].into_iter().min().unwrap()
    };
    let found: BTreeSet<[u32; 3]> = cut.surface.triangles.iter().map(turned).collect();
    assert_eq!(found.len(), cut.surface.triangles.len(), "each face once");
    for (vertex, node) in cut.nodes.iter().enumerate() {
        assert_eq!(cut.surface.positions_m[vertex], organs.mesh.positions_m[node.index()]);
    }
    found
}

/// Everything that a mesh of organs promises whatever the labels are.
fn assert_is_sound(organs: &OrganMesh) {
    assert_is_sound_within(organs, [MIN_ORGAN_DIHEDRAL_DEG, MAX_ORGAN_DIHEDRAL_DEG]);
}

fn assert_is_sound_within(organs: &OrganMesh, [smallest_deg, largest_deg]: [f64; 2]) {
    let (mesh, report) = (&organs.mesh, &organs.report);
    assert_eq!(find_faults(mesh).lines(), Vec::<String>::new());
    let quality = MeshQuality::of(mesh);
    assert!(quality.min_tetrahedron_volume_m3 > 0.0);
    assert!(quality.min_dihedral_deg >= smallest_deg, "{}", quality.min_dihedral_deg);
    assert!(quality.max_dihedral_deg <= largest_deg, "{}", quality.max_dihedral_deg);
    let told = [report.min_dihedral_deg, report.max_dihedral_deg];
    assert_eq!(told, [quality.min_dihedral_deg, quality.max_dihedral_deg]);
    assert_eq!([report.n_nodes, report.n_tets], [quality.nodes, quality.tetrahedra]);

    // The topology takes each triangle once or between two tetrahedra on different sides; all together are a manifold.
    let topology = Topology::build(mesh).unwrap();
    assert!(topology.pinches().is_empty());
    let all = organs.surface_of(0);
    assert_eq!(all.surface.triangles.len(), topology.n_surface_triangles());
    assert_eq!(self_intersections(&all.surface, 5), Vec::<[u32; 2]>::new());

    let labels = organs.labels();
    let told: Vec<u16> = report.labels.iter().map(|l| l.label).collect();
    assert_eq!(labels, told);
    let mut n_triangles = 0;
    for of_label in &report.labels {
        let label = of_label.label;
        let cut = organs.surface_of(label);
        let shape = SurfaceShape::of(cut.nodes.len(), &cut.surface.triangles);
        assert!(shape.is_closed_manifold(), "label {label}");
        // Its surface encloses what its tetrahedra fill: oriented outwards, nothing missing.
        assert!((cut.surface.volume_m3() / of_label.volume_m3 - 1.0).abs() < 1e-9, "label {label}");
        n_triangles += cut.surface.triangles.len();
        // And it is put together from its interfaces, which the other side has the other way round.
        let mut n_of_interfaces = 0;
        for other in labels.iter().copied().chain([0]).filter(|&o| o != label) {
            let (here, there) = (triangles_of(organs, label, other), triangles_of(organs, other, label));
            let turned: BTreeSet<[u32; 3]> = there.iter().map(|&[a, b, c]| [a, c, b]).collect();
            assert_eq!(here, turned, "labels {label} and {other}");
            assert_eq!(!here.is_empty(), organs.neighbours().contains(&[label.min(other), label.max(other)]));
            n_of_interfaces += here.len();
        }
        assert_eq!(n_of_interfaces, cut.surface.triangles.len());
    }
    assert!(
        n_triangles > all.surface.triangles.len()
            || labels.len() == 1
            || organs.neighbours().len() == labels.len()
    );
}

fn assert_volumes_hold(organs: &OrganMesh, labels: &[u16]) {
    for label in organs.report.labels.iter().filter(|l| labels.contains(&l.label)) {
        let off = label.volume_error().abs();
        assert!(off <= ORGAN_VOLUME_TOLERANCE, "label {}: {off}", label.label);
    }
}

#[test]
fn small_organs_get_their_tetrahedra_in_a_coarse_mesh() {
    let patient = phantom::generate(&PhantomParams { voxel_m: 2.5e-3, ..PhantomParams::default() });
    let labels = [Tissue::Liver, Tissue::LiverTumour, Tissue::GallBladder].map(Tissue::label).to_vec();
    let meshed = |grading: Grading| {
        let size = OrganSize::Tetrahedra(6_300);
        let organs =
            mesh_organs(&patient.labels, &OrganMeshParams { labels: labels.clone(), size, grading }).unwrap();
        assert_is_sound_within(&organs, GRADED_DIHEDRAL_DEG);
        assert!((organs.report.n_tets as f64 / 6_300.0 - 1.0).abs() < 0.05, "{}", organs.report.n_tets);
        organs
    };
    let of_tumour = |organs: &OrganMesh| {
        let tumour = organs.report.labels.iter().find(|l| l.label == Tissue::LiverTumour.label()).unwrap();
        (tumour.n_tets, tumour.volume_error())
    };
    // With even cells nothing would be left of the tumour.
    let even = OrganMeshParams {
        labels: labels.clone(),
        size: OrganSize::Tetrahedra(6_300),
        grading: Grading::default(),
    };
    let error = mesh_organs(&patient.labels, &even).unwrap_err();
    assert!(matches!(error, OrganMeshError::Vanished { label: 2, .. }), "{error}");
    let graded = meshed(Grading { least_tetrahedra: 300, ..Grading::default() });
    let (n, _) = of_tumour(&graded);
    assert!((240..900).contains(&n), "{n}");
    assert_volumes_hold(&graded, &labels);

    // A ball of small cells in the right lobe, and small cells at the surface: the mean size tells.
    let mean_m3 = |organs: &OrganMesh, is_there: &dyn Fn(DVec3) -> bool| {
        let volumes: Vec<f64> = (0..organs.mesh.tetrahedra.len())
            .map(TetId::from_index)
            .filter(|&t| is_there(organs.mesh.corners_m(t).iter().sum::<DVec3>() / 4.0))
            .map(|t| organs.mesh.tet_volume_m3(t))
            .collect();
        volumes.iter().sum::<f64>() / volumes.len() as f64
    };
    let center_m = DVec3::new(-0.08, -0.02, 0.0);
    let ball = FinerBall { center_m, radius_m: 0.015, factor: 2.0 };
    let around_ball = meshed(Grading { balls: vec![ball], least_tetrahedra: 100, ..Grading::default() });
    let in_ball = |p: DVec3| p.distance(center_m) < 0.012;
    let beyond = |p: DVec3| p.distance(center_m) > 0.06;
    let ratio = mean_m3(&around_ball, &beyond) / mean_m3(&around_ball, &in_ball);
    // Eight times as large, but for those at the surface.
    assert!((3.0..10.0).contains(&ratio), "{ratio}");
}

#[test]
fn the_phantoms_organs_share_their_interfaces() {
    let patient = phantom::generate(&PhantomParams { voxel_m: 2.5e-3, ..PhantomParams::default() });
    let tissues = [
        Tissue::Liver,
        Tissue::LiverTumour,
        Tissue::PortalVein,
        Tissue::HepaticVein,
        Tissue::GallBladder,
        Tissue::KidneyRight,
        Tissue::VenaCava,
    ];
    let labels = tissues.map(Tissue::label).to_vec();
    let params = OrganMeshParams {
        labels: labels.clone(),
        size: OrganSize::Tetrahedra(40_000),
        grading: Grading::default(),
    };
    // The great vessels and the stomach reach the end of the image.
    let error = mesh_organs(&patient.labels, &params).unwrap_err();
    assert!(matches!(error, OrganMeshError::Border { label: 17, .. }), "{error}");
    let params = OrganMeshParams { labels: labels[..6].to_vec(), ..params };
    let told = Arc::new(Mutex::new(Vec::new()));
    let hears = Arc::clone(&told);
    let listener = move |share| {
        hears.lock().unwrap().push(share);
        ControlFlow::Continue(())
    };
    let organs = watched(listener, || mesh_organs(&patient.labels, &params)).unwrap().unwrap();
    assert_is_sound(&organs);
    assert!((organs.report.n_tets as f64 / 40_000.0 - 1.0).abs() < 0.05, "{}", organs.report.n_tets);
    // Cells of 10 mm: the veins are thinner than that, the tumour is one and a half across.
    assert_volumes_hold(&organs, &[1, 5, 7]);
    assert!(organs.report.interface_rms_m < 0.12 * organs.report.cell_m, "{:?}", organs.report);
    let neighbours = organs.neighbours();
    for pair in [[0, 1], [1, 2], [1, 3], [1, 4], [1, 5], [1, 7], [0, 7]] {
        assert!(neighbours.contains(&pair), "{neighbours:?}");
    }
    let told = told.lock().unwrap();
    assert!(told.windows(2).all(|w| w[0] < w[1]) && told.last() == Some(&1.0));
}

#[test]
fn a_ball_in_a_ball_lies_on_its_spheres() {
    let map = painted([50; 3], 1.5e-3, |_| 0);
    let middle = middle_m(&map);
    let label_at = |p: DVec3| match p.distance(middle) {
        r if r < 0.015 => 7,
        r if r < 0.030 => 3,
        _ => 0,
    };
    let map = painted([50; 3], 1.5e-3, label_at);
    let organs = meshed(&map, 4e-3);
    assert_is_sound(&organs);
    assert_eq!(organs.neighbours(), [[0, 3], [3, 7]]);
    assert_volumes_hold(&organs, &[3, 7]);
    for (interface, radius_m) in [(organs.interface(7, 3), 0.015), (organs.interface(3, 0), 0.030)] {
        let shape = SurfaceShape::of(interface.nodes.len(), &interface.surface.triangles);
        assert_eq!((shape.pieces, shape.euler_characteristic), (1, 2));
        let exact_m3 = 4.0 / 3.0 * std::f64::consts::PI * radius_m * radius_m * radius_m;
        // The voxels' own volume is off by up to half a percent.
        assert!((interface.surface.volume_m3() / exact_m3 - 1.0).abs() < 0.01);
        let off_m2: f64 =
            interface.surface.positions_m.iter().map(|p| (p.distance(middle) - radius_m).powi(2)).sum();
        let rms_m = (off_m2 / interface.nodes.len() as f64).sqrt();
        assert!(rms_m < 0.05 * 4e-3, "{rms_m}");
    }
}

#[test]
fn two_boxes_that_touch_share_a_flat_interface() {
    let map = painted([60, 36, 36], 1e-3, |p| {
        let q = 1e3 * (p - DVec3::new(-0.03, 0.02, 0.05));
        let in_middle = |v: f64| (6.5..28.5).contains(&v);
        match (in_middle(q.y) && in_middle(q.z), q.x) {
            (true, x) if (6.5..26.5).contains(&x) => 1,
            (true, x) if (26.5..50.5).contains(&x) => 2,
            _ => 0,
        }
    });
    let organs = meshed(&map, 3e-3);
    assert_is_sound(&organs);
    assert_volumes_hold(&organs, &[1, 2]);
    let interface = organs.interface(1, 2);
    let wall_x_m = -0.03 + 26.5e-3;
    let off_m2: f64 = interface.surface.positions_m.iter().map(|p| (p.x - wall_x_m).powi(2)).sum();
    assert!((off_m2 / interface.nodes.len() as f64).sqrt() < 0.1 * 3e-3);
    let area_vector_m2: DVec3 = (0..interface.surface.triangles.len())
        .map(|t| {
            let [a, b, c] = interface.surface.corners_m(t);
            0.5 * (b - a).cross(c - a)
        })
        .sum();
    // 22 mm by 22 mm with rounded corners, seen from the second box.
    assert!((area_vector_m2.x / 484e-6 - 1.0).abs() < 0.05, "{area_vector_m2}");
    assert!(area_vector_m2.y.abs() + area_vector_m2.z.abs() < 0.05 * area_vector_m2.x);
}

#[test]
fn organs_a_little_apart_do_not_run_into_each_other() {
    let map = painted([60, 36, 36], 1e-3, |p| {
        let q = 1e3 * (p - DVec3::new(-0.03, 0.02, 0.05));
        let (a, b) = (DVec3::new(18.0, 17.5, 17.5), DVec3::new(42.0, 17.5, 17.5));
        if q.distance(a) < 11.0 {
            return 1;
        }
        u16::from(q.distance(b) < 11.0) * 2
    });
    for cell_m in [2e-3, 4e-3, 6e-3] {
        let organs = meshed(&map, cell_m);
        assert_is_sound(&organs);
        assert_volumes_hold(&organs, &[1, 2]);
    }
}

#[test]
fn a_vein_and_a_sheet_two_cells_thick_keep_their_volumes() {
    let cell_m = 3e-3;
    let map = painted([64, 44, 44], 1e-3, |_| 0);
    let middle = middle_m(&map);
    let along = DVec3::new(0.9, 0.3, 0.3).normalize();
    let map = painted([64, 44, 44], 1e-3, |p| {
        let q = p - middle;
        if q.x.abs() > 0.028 || q.y.abs() > 0.018 || q.z.abs() > 0.018 {
            return 0;
        }
        // A slanted vein of two cells across in the first half, a sheet two cells thick at the end.
        match (q - q.dot(along) * along).length() < cell_m {
            true if q.x < 0.015 => 2,
            _ if (0.018..0.018 + 2.0 * cell_m).contains(&q.x) => 3,
            _ => 1,
        }
    });
    let organs = meshed(&map, cell_m);
    assert_is_sound(&organs);
    assert_volumes_hold(&organs, &[1, 2, 3]);
    let n_pieces: Vec<usize> = organs.report.labels.iter().map(|l| l.n_pieces).collect();
    assert_eq!(n_pieces, [2, 1, 1], "the sheet cuts off the end of the box");
}

#[test]
fn a_crumb_is_dropped() {
    let map = painted([40, 24, 24], 1e-3, |_| 0);
    let middle = middle_m(&map);
    let map = painted([40, 24, 24], 1e-3, |p| {
        let (body, crumb) = (middle - DVec3::X * 8e-3, middle + DVec3::X * 13e-3);
        u16::from(p.distance(body) < 8e-3 || p.distance(crumb) < 2.2e-3)
    });
    let organs = meshed(&map, 3e-3);
    assert_is_sound(&organs);
    assert_eq!(organs.report.labels[0].n_pieces, 1);
    assert!((1..4).contains(&organs.report.n_crumb_nodes), "{}", organs.report.n_crumb_nodes);
}

#[test]
fn slanted_thick_slices_are_meshed_in_the_patient_frame() {
    let axes = DMat3::from_rotation_x(0.4) * DMat3::from_rotation_z(0.7);
    let grid = VoxelGrid {
        dims: [60, 60, 20],
        spacing_m: DVec3::new(1e-3, 1e-3, 3e-3),
        origin_m: DVec3::new(0.1, -0.2, 0.3),
        axes: DMat3::from_cols(axes.x_axis, axes.y_axis, -axes.z_axis),
    };
    let center_m = grid.position_m(DVec3::new(29.5, 29.5, 9.5));
    let map = painted_on(grid, |p| match p - center_m {
        d if d.length() > 0.024 => 0,
        d => 1 + u16::from(d.x > 0.0) + 2 * u16::from(d.y > 0.0),
    });
    let organs = meshed(&map, 5e-3);
    assert_is_sound(&organs);
    assert_volumes_hold(&organs, &[1, 2, 3, 4]);
    let all = organs.surface_of(0);
    let far_m =
        all.surface.positions_m.iter().map(|p| (p.distance(center_m) - 0.024).abs()).fold(0.0, f64::max);
    assert!(far_m < 3e-3, "{far_m}");
}

#[test]
fn the_number_of_threads_changes_no_bit() {
    let map = random_map(5, 26, 4);
    let with_threads = |n| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(n).build().unwrap();
        pool.install(|| meshed(&map, 3e-3))
    };
    let (one, three) = (with_threads(1), with_threads(3));
    assert_eq!(one, three);
    let bits = |organs: &OrganMesh| -> Vec<[u64; 3]> {
        organs.mesh.positions_m.iter().map(|p| p.to_array().map(f64::to_bits)).collect()
    };
    assert_eq!(bits(&one), bits(&three));
}

#[test]
fn what_cannot_be_meshed_is_refused_with_the_figures() {
    let ball = |radius_m: f64, label: u16| {
        let map = painted([20; 3], 1e-3, |_| 0);
        let middle = middle_m(&map);
        painted([20; 3], 1e-3, |p| if p.distance(middle) < radius_m { label } else { 0 })
    };
    let refusal = |map: &LabelMap, labels: &[u16], size| {
        mesh_organs(map, &OrganMeshParams { labels: labels.to_vec(), size, grading: Grading::default() })
            .unwrap_err()
    };
    let cell = OrganSize::CellM(2e-3);
    assert_eq!(refusal(&ball(0.0, 1), &[], cell), OrganMeshError::NoLabels);
    let error = refusal(&ball(7e-3, 4), &[4, 9], cell);
    assert_eq!(error, OrganMeshError::UnknownLabel { label: 9, available: vec![4] });
    let error = refusal(&ball(7e-3, 4), &[0], cell);
    assert!(matches!(error, OrganMeshError::BadParameter { what: "a wanted label", .. }), "{error}");
    let error = refusal(&ball(11e-3, 4), &[4], cell);
    assert!(error.to_string().starts_with("label 4: the label touches the border"), "{error}");
    for size in [
        OrganSize::CellM(f64::NAN),
        OrganSize::CellM(0.0),
        OrganSize::CellM(-1.0),
        OrganSize::CellM(f64::INFINITY),
        OrganSize::Tetrahedra(3),
        OrganSize::Tetrahedra(usize::MAX),
    ] {
        let error = refusal(&ball(7e-3, 4), &[4], size);
        assert!(matches!(error, OrganMeshError::BadParameter { .. }), "{error}");
    }
    let error = refusal(&ball(7e-3, 4), &[4], OrganSize::CellM(1e-5));
    assert!(matches!(error, OrganMeshError::TooMany { allowed: 20_000_000, .. }), "{error}");
    let mut far = ball(2e-3, 4);
    far.grid.dims = [400; 3];
    far.labels = vec![0; 64_000_000];
    for voxel in [[1, 1, 1], [398, 398, 398]] {
        let at = far.grid.index(voxel);
        far.labels[at] = 4;
    }
    for grading in [
        Grading { finer_at_surface: Some(0.5), ..Grading::default() },
        Grading { finer_at_surface: Some(f64::NAN), ..Grading::default() },
        Grading {
            balls: vec![FinerBall { center_m: DVec3::ZERO, radius_m: -1.0, factor: 2.0 }],
            ..Grading::default()
        },
    ] {
        let params = OrganMeshParams { labels: Vec::new(), size: cell, grading };
        assert!(matches!(mesh_organs(&far, &params), Err(OrganMeshError::BadParameter { .. })), "{params:?}");
    }
    let error = refusal(&far, &[4], OrganSize::CellM(1e-3));
    assert!(matches!(error, OrganMeshError::LatticeTooLarge { .. }), "{error}");
    let mut speck = ball(7e-3, 4);
    let at = speck.grid.index([10, 10, 10]);
    speck.labels[at] = 5;
    match refusal(&speck, &[], OrganSize::CellM(6e-3)) {
        OrganMeshError::Vanished { label: 5, n_voxels: 1, .. } => {}
        other => panic!("{other}"),
    }
    let mut short = ball(7e-3, 4);
    short.labels.pop();
    assert_eq!(refusal(&short, &[], cell), OrganMeshError::BadMap { found: 7999, allowed: 8000 });
}

/// Balls of random labels that overlap, some so small that they are specks.
fn random_map(seed: u64, n: usize, n_labels: u64) -> LabelMap {
    let mut random = SeededRandom::new(seed);
    let mut at_random = |low: f64, high: f64| random.uniform_in(low, high);
    let side_m = n as f64 * 1e-3;
    let balls: Vec<(DVec3, f64, u16)> = (0..9)
        .map(|b| {
            let center = DVec3::new(at_random(0.2, 0.8), at_random(0.2, 0.8), at_random(0.2, 0.8));
            (side_m * center, side_m * at_random(0.02, 0.35), (b % n_labels) as u16 + 1)
        })
        .collect();
    let border_m = 1.6e-3;
    let origin_m = DVec3::new(-0.03, 0.02, 0.05);
    painted([n; 3], 1e-3, |p| {
        let q = p - origin_m;
        let is_near_border = q.min_element() < border_m || q.max_element() > side_m - 1e-3 - border_m;
        let found = balls.iter().rev().find(|(center, radius_m, _)| q.distance(*center) < *radius_m);
        found.map_or(0, |ball| if is_near_border { 0 } else { ball.2 })
    })
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 6, ..ProptestConfig::default() })]

    #[test]
    fn any_labels_give_a_sound_mesh_of_organs(
        seed in 0u64..1_000_000, n_labels in 1u64..7, cell_mm in 1.5..5.0f64, noise in 0.0..0.3f64,
        least in prop_oneof![Just(0usize), 100usize..2000], surface in prop_oneof![Just(1.0), 1.0..3.0f64],
    ) {
        let ball = FinerBall { center_m: DVec3::new(-0.02, 0.03, 0.06), radius_m: 2e-3, factor: surface };
        let grading = Grading {
            least_tetrahedra: least,
            finer_at_surface: (surface > 1.0).then_some(surface),
            balls: if surface > 2.0 { vec![ball] } else { Vec::new() },
        };
        let mut map = random_map(seed, 24, n_labels);
        let mut random = SeededRandom::new(seed + 1);
        for v in 0..map.labels.len() {
            let voxel = map.grid.voxel(v);
            if voxel.iter().all(|&at| at > 1 && at < 22) && random.uniform() < noise * noise {
                map.labels[v] = (random.next_u64() % (n_labels + 1)) as u16;
            }
        }
        let params = OrganMeshParams { labels: Vec::new(), size: OrganSize::CellM(1e-3 * cell_mm), grading };
        match mesh_organs(&map, &params) {
            Ok(organs) if params.grading == Grading::default() => assert_is_sound(&organs),
            Ok(organs) => assert_is_sound_within(&organs, GRADED_DIHEDRAL_DEG),
            Err(OrganMeshError::Vanished { label, .. }) => prop_assert!(label as u64 <= n_labels),
            Err(OrganMeshError::NoLabels) => prop_assert!(map.present().is_empty()),
            Err(other) => panic!("{other}"),
        }
    }
}
