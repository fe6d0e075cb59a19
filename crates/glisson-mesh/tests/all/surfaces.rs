//! Voxel topology, extraction, smoothing, decimation and checks of surfaces.

use glisson_mesh::image::VoxelGrid;
use glisson_mesh::image::topology::{
    TopologyError, TopologyRepair, is_well_composed, repair_to_ball, solid_euler_characteristic,
};
use glisson_mesh::math::{DMat3, DVec3, SeededRandom};
use glisson_mesh::surface::TriMesh;
use glisson_mesh::surface::check::{check_closed, orient_outward};
use glisson_mesh::surface::decimate::decimate;
use glisson_mesh::surface::error::SurfaceError;
use glisson_mesh::surface::extract::{SurfaceParams, SurfaceReport, surface_of_mask};
use glisson_mesh::surface::intersect::{self_intersections, triangles_intersect};
use glisson_mesh::surface::normals::{NormalWeight, vertex_normals};
use glisson_mesh::surface::smooth::{offset_to_volume, smooth_surface};
use proptest::prelude::*;

fn grid(dims: [usize; 3]) -> VoxelGrid {
    VoxelGrid { dims, spacing_m: DVec3::splat(1e-3), origin_m: DVec3::ZERO, axes: DMat3::IDENTITY }
}

fn mask_of(grid: &VoxelGrid, inside: impl Fn(DVec3) -> bool) -> Vec<bool> {
    (0..grid.n_voxels())
        .map(|index| {
            let [i, j, k] = grid.voxel(index);
            inside(DVec3::new(i as f64, j as f64, k as f64))
        })
        .collect()
}

/// Pieces of the voxels equal to `of`, by faces; an own flood fill as oracle.
fn n_pieces(grid: &VoxelGrid, mask: &[bool], of: bool) -> usize {
    let mut seen = vec![false; mask.len()];
    let mut n = 0;
    for start in 0..mask.len() {
        if mask[start] != of || seen[start] {
            continue;
        }
        n += 1;
        let mut stack = vec![start];
        seen[start] = true;
        while let Some(at) = stack.pop() {
            let voxel = grid.voxel(at);
            for axis in 0..3 {
                for up in [false, true] {
                    let mut next = voxel;
                    if up && voxel[axis] + 1 < grid.dims[axis] {
                        next[axis] += 1;
                    } else if !up && voxel[axis] > 0 {
                        next[axis] -= 1;
                    }
                    let next = grid.index(next);
                    if mask[next] == of && !seen[next] {
                        seen[next] = true;
                        stack.push(next);
                    }
                }
            }
        }
    }
    n
}

/// Repairs and checks by other means that the result is a well-composed ball; the mask must leave a free
/// layer at the grid's border.
fn repaired_ball(grid: &VoxelGrid, mask: &[bool]) -> (Vec<bool>, TopologyRepair) {
    let mut repaired = mask.to_vec();
    let report = repair_to_ball(grid, &mut repaired).unwrap();
    assert_eq!(n_pieces(grid, &repaired, true), 1);
    assert_eq!(n_pieces(grid, &repaired, false), 1);
    assert_eq!(solid_euler_characteristic(grid, &repaired).unwrap(), 1);
    assert!(is_well_composed(grid, &repaired).unwrap());
    assert_eq!(report.euler_characteristic, 2);
    let changed = |from: bool| mask.iter().zip(&repaired).filter(|&(&a, &b)| a == from && b != from).count();
    assert_eq!((report.voxels_added, report.voxels_removed), (changed(false), changed(true)));
    assert_eq!(report.voxels_before, mask.iter().filter(|&&m| m).count());
    (repaired, report)
}

#[test]
fn a_ball_is_left_alone() {
    let grid = grid([21, 21, 21]);
    let mask = mask_of(&grid, |p| (p - DVec3::splat(10.0)).abs().max_element() < 7.5);
    let (repaired, report) = repaired_ball(&grid, &mask);
    assert_eq!(repaired, mask);
    assert_eq!((report.cavities_filled, report.tunnels_filled, report.tunnels_cut), (0, 0, 0));
    assert_eq!(report.euler_characteristic_before, 2);
}

#[test]
fn cavities_and_narrow_tunnels_are_filled() {
    let grid = grid([31, 31, 31]);
    let centre = DVec3::splat(15.0);
    let mask = mask_of(&grid, |p| {
        let d = p - centre;
        let in_tunnel = |x: f64, y: f64| x.hypot(y) < 1.2;
        d.abs().max_element() < 11.5
            && !in_tunnel(d.x - 5.0, d.y + 4.0)
            && !in_tunnel(d.y - 5.0, d.z - 5.0)
            && (d - DVec3::new(-6.0, -5.0, -5.0)).length() > 2.5
    });
    let (repaired, report) = repaired_ball(&grid, &mask);
    assert_eq!((report.cavities_filled, report.tunnels_filled, report.tunnels_cut), (1, 2, 0));
    assert_eq!(report.euler_characteristic_before, 0, "2 (pieces - tunnels + cavities)");
    assert_eq!(report.voxels_removed, 0);
    // Not a membrane only: a plug of 4 mm to each side, as far as the tunnel lets it be well-composed.
    let plug = (0..31).filter(|&k| repaired[grid.index([20, 11, k])]).count();
    assert!((7..=11).contains(&plug), "{plug} voxels along the first tunnel's axis");
    let full = mask_of(&grid, |p| (p - centre).abs().max_element() < 11.5);
    assert!(repaired.iter().zip(&full).all(|(&a, &b)| !a || b), "nothing is added outside the hull");
}

#[test]
fn a_wide_ring_is_cut_where_it_is_thin() {
    let grid = grid([61, 61, 15]);
    let mask = mask_of(&grid, |p| {
        let d = p - DVec3::new(30.0, 30.0, 7.0);
        let ring = d.x.hypot(d.y) - 20.0;
        ring.hypot(d.z) < 4.5 - 1.5 * (d.x / 20.0)
    });
    let (repaired, report) = repaired_ball(&grid, &mask);
    assert_eq!((report.tunnels_filled, report.tunnels_cut), (0, 1));
    assert!(report.voxels_added < 60, "the ring's opening is not filled: {report:?}");
    assert!(report.voxels_removed < 60, "{report:?}");
    let cut_x: Vec<usize> =
        (0..mask.len()).filter(|&v| mask[v] && !repaired[v]).map(|v| grid.voxel(v)[0]).collect();
    assert!(cut_x.iter().all(|&x| x > 40), "cut on the thin side: {cut_x:?}");
}

#[test]
fn contacts_by_edge_and_corner_are_resolved() {
    let grid = grid([12, 12, 12]);
    // A common edge is four voxels long; a corner needs two voxels to join by faces.
    for (offset, most) in [(DVec3::new(4.0, 4.0, 0.0), 4), (DVec3::new(4.0, 4.0, 4.0), 2)] {
        let cube = |p: DVec3, low: DVec3| p.cmpge(low).all() && p.cmplt(low + 4.0).all();
        let low = DVec3::splat(1.0);
        let mask = mask_of(&grid, |p| cube(p, low) || cube(p, low + offset));
        let (_, report) = repaired_ball(&grid, &mask);
        assert!(report.voxels_added <= most && report.voxels_removed == 0, "{report:?}");
    }
}

#[test]
fn smaller_pieces_are_taken_away() {
    let grid = grid([20, 10, 10]);
    let mask = mask_of(&grid, |p| {
        let d = p - DVec3::splat(5.0);
        d.abs().max_element() < 3.5 || (p - DVec3::new(15.0, 5.0, 5.0)).abs().max_element() < 1.5
    });
    let (_, report) = repaired_ball(&grid, &mask);
    assert_eq!((report.pieces_removed, report.voxels_removed, report.voxels_added), (1, 27, 0));
}

#[test]
fn masks_that_cannot_be_repaired_are_refused() {
    let mut grid = grid([4, 4, 4]);
    assert_eq!(repair_to_ball(&grid, &mut [false; 64]), Err(TopologyError::Empty));
    let wrong = repair_to_ball(&grid, &mut [true; 63]);
    assert_eq!(wrong, Err(TopologyError::WrongLength { found: 63, needed: 64, dims: [4, 4, 4] }));
    grid.spacing_m.y = f64::NAN;
    let spacing = repair_to_ball(&grid, &mut [true; 64]);
    assert!(matches!(spacing, Err(TopologyError::WrongSpacing { axis: 1, .. })));
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    /// Noise of any density: many tunnels, cavities, edge and corner contacts at once.
    #[test]
    fn noise_becomes_a_ball(seed in any::<u64>(), density in 0.05..0.98f64) {
        let grid = grid([11, 10, 12]);
        let mut random = SeededRandom::new(seed);
        let mut mask = mask_of(&grid, |_| false);
        for v in 0..mask.len() {
            let [i, j, k] = grid.voxel(v);
            let inner = [i, j, k].iter().zip(grid.dims).all(|(&x, d)| x > 0 && x + 1 < d);
            mask[v] = random.uniform() < density && inner;
        }
        mask[grid.index([5, 5, 5])] = true;
        repaired_ball(&grid, &mask);
    }

    /// Blobs with tunnels punched through them and cavities in them, on flat voxels.
    #[test]
    fn punched_blobs_become_balls(seed in any::<u64>()) {
        let mut grid = grid([34, 30, 16]);
        grid.spacing_m.z = 2.5e-3;
        let mut random = SeededRandom::new(seed);
        let centre = DVec3::new(17.0, 15.0, 8.0);
        let mut direction = || {
            DVec3::new(random.normal(), random.normal(), random.normal()).normalize_or(DVec3::X)
        };
        let lines: Vec<(DVec3, DVec3)> =
            (0..3).map(|_| (centre + 3.0 * direction(), direction())).collect();
        let mask = mask_of(&grid, |p| {
            let d = (p - centre) / DVec3::new(14.0, 12.0, 6.5);
            let off_lines = lines.iter().all(|(at, along)| (p - *at).cross(*along).length() > 1.3);
            d.length() < 1.0 && off_lines
        });
        let (_, report) = repaired_ball(&grid, &mask);
        let changed = report.voxels_added + report.voxels_removed;
        prop_assert!(changed * 5 < report.voxels_before, "{:?}", report);
    }
}

// --- surfaces ---------------------------------------------------------------------------------------------

/// A cube of 2 mm about the origin, outward.
pub(crate) fn cube() -> TriMesh {
    let positions_m = (0..8)
        .map(|c| 1e-3 * (2.0 * DVec3::new(f64::from(c & 1), f64::from(c >> 1 & 1), f64::from(c >> 2)) - 1.0))
        .collect();
    let quads = [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]];
    let triangles = quads.iter().flat_map(|&[a, b, c, d]| [[a, b, c], [a, c, d]]).collect();
    TriMesh { positions_m, triangles }
}

/// A torus about z: radii [m] of the ring and the tube, `n` times `m` quadrilaterals.
pub(crate) fn torus(ring_m: f64, tube_m: f64, n: u32, m: u32) -> TriMesh {
    let mut mesh = TriMesh::default();
    for i in 0..n {
        for j in 0..m {
            let (u, v) =
                [(i, n), (j, m)].map(|(k, n)| std::f64::consts::TAU * f64::from(k) / f64::from(n)).into();
            let distance = ring_m + tube_m * f64::cos(v);
            mesh.positions_m.push(DVec3::new(
                distance * f64::cos(u),
                distance * f64::sin(u),
                tube_m * f64::sin(v),
            ));
            let at = |i: u32, j: u32| (i % n) * m + j % m;
            let [a, b, c, d] = [at(i, j), at(i + 1, j), at(i + 1, j + 1), at(i, j + 1)];
            mesh.triangles.extend([[a, b, c], [a, c, d]]);
        }
    }
    mesh
}

/// `mesh` and `other` as one mesh of separate vertices.
pub(crate) fn joined(mesh: &TriMesh, other: &TriMesh) -> TriMesh {
    let mut both = mesh.clone();
    let n = mesh.positions_m.len() as u32;
    both.positions_m.extend(&other.positions_m);
    both.triangles.extend(other.triangles.iter().map(|t| t.map(|v| v + n)));
    both
}

fn moved(mesh: &TriMesh, by_m: DVec3, factor: f64) -> TriMesh {
    let positions_m = mesh.positions_m.iter().map(|&p| factor * p + by_m).collect();
    TriMesh { positions_m, triangles: mesh.triangles.clone() }
}

fn inside_out(mesh: &TriMesh) -> TriMesh {
    let triangles = mesh.triangles.iter().map(|&[a, b, c]| [a, c, b]).collect();
    TriMesh { positions_m: mesh.positions_m.clone(), triangles }
}

#[test]
fn closed_surfaces_are_counted_and_measured() {
    let cube_counts = check_closed(&cube()).unwrap();
    assert_eq!((cube_counts.n_vertices, cube_counts.n_edges, cube_counts.n_triangles), (8, 18, 12));
    assert_eq!((cube_counts.euler_characteristic, cube_counts.n_pieces), (2, 1));
    assert!((cube_counts.volume_m3 - 8e-9).abs() < 1e-20);
    assert!((cube_counts.area_m2 - 24e-6).abs() < 1e-17);
    let ring = check_closed(&torus(0.03, 0.01, 24, 12)).unwrap();
    assert_eq!((ring.euler_characteristic, ring.n_pieces), (0, 1));
    let mut two = joined(&cube(), &moved(&cube(), DVec3::X * 0.01, 1.0));
    two.positions_m.push(DVec3::ZERO);
    let two = check_closed(&two).unwrap();
    assert_eq!((two.euler_characteristic, two.n_pieces, two.n_unused_vertices), (4, 2, 1));
}

#[test]
fn nested_pieces_bound_cavities() {
    let inner = moved(&cube(), DVec3::ZERO, 0.5);
    let hollow = joined(&cube(), &inside_out(&inner));
    assert!((check_closed(&hollow).unwrap().volume_m3 - 7e-9).abs() < 1e-20);
    let doubled = joined(&cube(), &inner);
    let inside = check_closed(&doubled);
    assert!(matches!(inside, Err(SurfaceError::InsideOut { triangle: 12, .. })), "{inside:?}");
}

#[test]
fn inside_out_surfaces_are_refused_and_can_be_turned() {
    let mut mesh = inside_out(&cube());
    assert!(matches!(check_closed(&mesh), Err(SurfaceError::InsideOut { triangle: 0, .. })));
    assert_eq!(orient_outward(&mut mesh), Ok(1));
    assert_eq!(mesh, cube());
    assert_eq!(orient_outward(&mut mesh), Ok(0));
}

#[test]
fn each_fault_is_named_with_its_place() {
    let broken = |change: &dyn Fn(&mut TriMesh)| {
        let mut mesh = cube();
        change(&mut mesh);
        check_closed(&mesh).unwrap_err()
    };
    assert_eq!(broken(&|m| m.triangles.clear()), SurfaceError::Empty);
    let no_such = SurfaceError::NoSuchVertex { triangle: 3, vertex: 8, n_vertices: 8 };
    assert_eq!(broken(&|m| m.triangles[3][1] = 8), no_such);
    assert!(matches!(broken(&|m| m.positions_m[5].y = f64::NAN), SurfaceError::NotFinite { vertex: 5, .. }));
    let flat = broken(&|m| m.positions_m[3] = 0.5 * (m.positions_m[0] + m.positions_m[1]));
    assert!(matches!(flat, SurfaceError::Degenerate { .. }), "{flat}");
    let twice = broken(&|m| m.triangles[4] = [0, 0, 1]);
    assert!(matches!(twice, SurfaceError::Degenerate { triangle: 4, .. }), "{twice}");
    let open = broken(&|m| m.triangles.truncate(11));
    assert!(matches!(open, SurfaceError::OpenEdge { n_open: 3, .. }), "{open}");
    assert!(open.to_string().contains(" mm"), "{open}");
    let fin = broken(&|m| {
        m.positions_m.push(DVec3::new(0.0, 0.0, -5e-3));
        m.triangles.push([0, 3, 8]);
    });
    assert!(matches!(fin, SurfaceError::NonManifoldEdge { vertices: [0, 3], n_triangles: 3, .. }), "{fin}");
    let turned = broken(&|m| m.triangles[0].swap(0, 1));
    let expected = matches!(turned, SurfaceError::InconsistentOrientation { triangles: [0, _], .. });
    assert!(expected, "{turned}");
}

#[test]
fn a_pinched_vertex_is_found() {
    let mut mesh = joined(&cube(), &moved(&cube(), DVec3::splat(2e-3), 1.0));
    for v in mesh.triangles.iter_mut().flatten().filter(|v| **v == 8) {
        *v = 7;
    }
    let pinched = check_closed(&mesh);
    assert!(matches!(pinched, Err(SurfaceError::PinchedVertex { vertex: 7, n_fans: 2, .. })), "{pinched:?}");
}

#[test]
fn crossing_and_touching_pieces_are_found() {
    for (shift_mm, meets) in [(1.5, true), (2.0, true), (2.0 + 1e-12, false), (2.5, false)] {
        let mesh = joined(&cube(), &moved(&cube(), 1e-3 * DVec3::new(shift_mm, 0.3, 0.2), 1.0));
        let found = check_closed(&mesh);
        assert_eq!(
            matches!(found, Err(SurfaceError::SelfIntersection { .. })),
            meets,
            "{shift_mm}: {found:?}"
        );
    }
    // A corner pushed through the opposite face: the triangles around it share no vertex with that face's.
    let mut mesh = torus(0.03, 0.01, 24, 12);
    assert!(self_intersections(&mesh, usize::MAX).is_empty());
    mesh.positions_m[0].x -= 0.03;
    assert!(!self_intersections(&mesh, usize::MAX).is_empty());
}

#[test]
fn triangles_that_share_vertices_are_judged_beyond_them() {
    let p = |x: f64, y: f64, z: f64| DVec3::new(x, y, z);
    // Triangles 0 1 2 (in the plane z = 0) and another one.
    let base = [p(0.0, 0.0, 0.0), p(4.0, 0.0, 0.0), p(0.0, 4.0, 0.0)];
    let meets = |others: &[DVec3], second: [u32; 3]| {
        let mesh = TriMesh {
            positions_m: base.iter().chain(others).copied().collect(),
            triangles: vec![[0, 1, 2], second],
        };
        let both = [triangles_intersect(&mesh, 0, 1), triangles_intersect(&mesh, 1, 0)];
        assert_eq!(both[0], both[1]);
        both[0]
    };
    // One common vertex.
    assert!(!meets(&[p(-1.0, -1.0, 1.0), p(-1.0, -1.0, -1.0)], [0, 3, 4]));
    assert!(meets(&[p(1.0, 1.0, 1.0), p(1.0, 1.0, -1.0)], [0, 3, 4]));
    assert!(meets(&[p(3.0, 3.0, 1.0), p(3.0, 3.0, -1.0)], [0, 3, 4]), "beyond the far edge");
    assert!(meets(&[p(1.0, 1.0, 0.0), p(1.0, 1.0, 5.0)], [0, 3, 4]), "along a line in the plane");
    assert!(!meets(&[p(-1.0, 1.0, 0.0), p(-1.0, -1.0, 0.0)], [0, 3, 4]), "coplanar beside");
    assert!(meets(&[p(1.0, 1.0, 0.0), p(-1.0, 3.0, 0.0)], [0, 3, 4]), "coplanar over");
    assert!(meets(&[p(2.0, 0.0, 0.0), p(0.0, -1.0, 1.0)], [0, 3, 4]), "along the common edge's line");
    // A common edge.
    assert!(!meets(&[p(1.0, -1.0, 0.0)], [0, 1, 3]), "coplanar, unfolded");
    assert!(meets(&[p(1.0, 1.0, 0.0)], [0, 1, 3]), "coplanar, folded");
    assert!(!meets(&[p(1.0, 1.0, 1e-300)], [0, 1, 3]), "almost folded");
    // None.
    assert!(meets(&[p(1.0, 1.0, 0.0), p(2.0, 1.0, 0.0), p(1.0, 2.0, 0.0)], [3, 4, 5]), "coplanar, within");
    assert!(!meets(&[p(3.0, 3.0, 0.0), p(5.0, 3.0, 0.0), p(3.0, 5.0, 0.0)], [3, 4, 5]), "coplanar, apart");
    assert!(meets(&[p(2.0, 2.0, 0.0), p(5.0, 5.0, 3.0), p(5.0, 5.0, 1.0)], [3, 4, 5]), "a corner on an edge");
}

#[test]
fn vertex_normals_of_a_cube_point_to_its_corners() {
    let mesh = cube();
    for (normal, position) in vertex_normals(&mesh, NormalWeight::Angle).iter().zip(&mesh.positions_m) {
        assert!((*normal - position.normalize()).length() < 1e-12);
    }
    let by_area = vertex_normals(&mesh, NormalWeight::Area);
    assert!(by_area.iter().all(|n| (n.length() - 1.0).abs() < 1e-12));
}

#[test]
fn decimation_meets_its_target_and_keeps_the_topology() {
    let mesh = torus(0.03, 0.01, 96, 40);
    for target in [5000, 1001, 300] {
        let fewer = decimate(&mesh, target).unwrap();
        assert!(fewer.triangles.len() <= target && fewer.triangles.len() + 2 > target);
        let topology = check_closed(&fewer).unwrap();
        assert_eq!((topology.euler_characteristic, topology.n_unused_vertices), (0, 0));
        // Chords of a tube of 10 mm: off by the sagitta.
        let worst = fewer.positions_m.iter().map(|p| {
            let ring = (p.x.hypot(p.y) - 0.03).hypot(p.z);
            (ring - 0.01).abs()
        });
        let worst = worst.fold(0.0, f64::max);
        assert!(worst < 0.6e-3, "{target}: {worst} m off the torus");
    }
    assert_eq!(decimate(&mesh, 7680).unwrap(), mesh);
    let stuck = decimate(&cube(), 5).map(|m| m.triangles.len());
    assert!(matches!(stuck, Ok(4) | Err(SurfaceError::TargetNotReached { target: 5, .. })), "{stuck:?}");
}

#[test]
fn smoothing_takes_noise_and_leaves_the_shape_and_the_volume() {
    let clean = torus(0.03, 0.01, 120, 48);
    let mut random = SeededRandom::new(7);
    let mut noisy = clean.clone();
    for p in &mut noisy.positions_m {
        *p += 2e-4 * DVec3::new(random.normal(), random.normal(), random.normal());
    }
    let smooth = smooth_surface(&noisy, 8e-3).unwrap();
    let off = |mesh: &TriMesh| {
        let squares = mesh.positions_m.iter().map(|p| ((p.x.hypot(p.y) - 0.03).hypot(p.z) - 0.01).powi(2));
        (squares.sum::<f64>() / mesh.positions_m.len() as f64).sqrt()
    };
    assert!(off(&smooth) < 0.35 * off(&noisy), "{} of {}", off(&smooth), off(&noisy));
    assert!((smooth.volume_m3() / noisy.volume_m3() - 1.0).abs() < 1e-8);
    // Without noise the tube keeps its 63 mm circumference: a wave of 8 mm is far shorter.
    assert!(off(&smooth_surface(&clean, 8e-3).unwrap()) < 2e-5);
    let refused = smooth_surface(&clean, f64::NAN);
    assert!(matches!(refused, Err(SurfaceError::Parameter { .. })));
}

/// Solves (1 + (tau L)^2) x = x0 by elimination; L from its definition.
fn low_passed_directly(mesh: &TriMesh, wavelength_m: f64) -> Vec<DVec3> {
    let n = mesh.positions_m.len();
    let edges: std::collections::BTreeSet<[usize; 2]> = mesh
        .triangles
        .iter()
        .flat_map(|&[a, b, c]| [[a, b], [b, c], [c, a]])
        .map(|[a, b]| [a.min(b) as usize, a.max(b) as usize])
        .collect();
    let length = |&[a, b]: &[usize; 2]| (mesh.positions_m[b] - mesh.positions_m[a]).length();
    let mut lengths: Vec<f64> = edges.iter().map(length).collect();
    lengths.sort_by(f64::total_cmp);
    let shortest = 0.1 * lengths[lengths.len() / 2];
    let tau = (wavelength_m / std::f64::consts::TAU).powi(2);
    let mut laplacian = vec![vec![0.0; n]; n];
    for edge in &edges {
        let weight = tau * length(edge).max(shortest).powi(-2);
        let [a, b] = *edge;
        for (at, to, value) in [(a, a, weight), (b, b, weight), (a, b, -weight), (b, a, -weight)] {
            laplacian[at][to] += value;
        }
    }
    let squared = |i: usize, j: usize| (0..n).map(|k| laplacian[i][k] * laplacian[k][j]).sum::<f64>();
    let mut matrix: Vec<Vec<f64>> =
        (0..n).map(|i| (0..n).map(|j| squared(i, j) + f64::from(u8::from(i == j))).collect()).collect();
    let mut x = mesh.positions_m.clone();
    // Symmetric and positive definite: no pivoting.
    for i in 0..n {
        let pivot = matrix[i].clone();
        for j in i + 1..n {
            let factor = matrix[j][i] / pivot[i];
            for (value, p) in matrix[j][i..].iter_mut().zip(&pivot[i..]) {
                *value -= factor * p;
            }
            x[j] = x[j] - factor * x[i];
        }
    }
    for i in (0..n).rev() {
        let known: DVec3 = (i + 1..n).map(|j| matrix[i][j] * x[j]).sum();
        x[i] = (x[i] - known) / matrix[i][i];
    }
    x
}

#[test]
fn the_low_pass_filter_solves_its_equation() {
    let mut mesh = torus(0.03, 0.01, 20, 10);
    let mut random = SeededRandom::new(3);
    for p in &mut mesh.positions_m {
        *p += DVec3::new(0.1, -0.2, 0.3);
        *p += 1e-3 * DVec3::new(random.normal(), random.normal(), random.normal());
    }
    // One short edge stiffens the system.
    mesh.positions_m[0] = mesh.positions_m[1].lerp(mesh.positions_m[0], 0.02);
    for wavelength_m in [1e-3, 8e-3, 25e-3] {
        let smooth = smooth_surface(&mesh, wavelength_m).unwrap();
        let mut expected = TriMesh {
            positions_m: low_passed_directly(&mesh, wavelength_m),
            triangles: mesh.triangles.clone(),
        };
        offset_to_volume(&mut expected, mesh.volume_m3()).unwrap();
        let off = smooth.positions_m.iter().zip(&expected.positions_m).map(|(a, b)| (*a - *b).length());
        let off = off.fold(0.0, f64::max);
        assert!(off < 1e-6 * 0.04, "{off} m at {wavelength_m} m");
    }
    mesh.positions_m.push(DVec3::splat(0.5));
    let unused = smooth_surface(&mesh, 8e-3).unwrap().positions_m[200];
    assert_eq!(unused, DVec3::splat(0.5), "a vertex that no triangle uses stays");
}

#[test]
fn surfaces_have_the_same_bits_at_any_thread_count() {
    let grid = oblique_grid(false);
    let (mut mask, _) = ball_on(&grid, 22e-3);
    // A tunnel and a thin sheet: repair and untangling have something to do.
    for index in 0..mask.len() {
        let [i, j, k] = grid.voxel(index);
        mask[index] &= !((35..37).contains(&i) && (30..32).contains(&j));
        mask[index] |= k == 12 && j == 36 && (2..70).contains(&i);
    }
    let with_threads = |n| rayon::ThreadPoolBuilder::new().num_threads(n).build().unwrap();
    let made =
        |n| with_threads(n).install(|| surface_of_mask(&grid, &mask, &SurfaceParams::default()).unwrap());
    let one = made(1);
    assert_eq!(one.1.repair.tunnels_filled, 1, "{:?}", one.1.repair);
    assert_eq!(one, made(3));
}

#[test]
fn an_offset_meets_the_volume() {
    let mut mesh = torus(0.03, 0.01, 48, 24);
    let wanted_m3 = 1.1 * mesh.volume_m3();
    let offset_m = offset_to_volume(&mut mesh, wanted_m3).unwrap();
    assert!((mesh.volume_m3() / wanted_m3 - 1.0).abs() < 1e-8);
    // A tube's section grows with the square of its radius.
    assert!((offset_m / 0.01 - (1.1f64.sqrt() - 1.0)).abs() < 5e-3, "{offset_m}");
}

// --- from masks to surfaces -------------------------------------------------------------------------------

/// Thick slices, turned axes; `mirrored` makes them left-handed.
fn oblique_grid(mirrored: bool) -> VoxelGrid {
    let mut axes = DMat3::from_axis_angle(DVec3::new(1.0, 2.0, 3.0).normalize(), 0.7);
    if mirrored {
        axes.z_axis = -axes.z_axis;
    }
    VoxelGrid {
        dims: [72, 72, 24],
        spacing_m: DVec3::new(0.7e-3, 0.7e-3, 2.5e-3),
        origin_m: DVec3::new(0.1, -0.2, 0.3),
        axes,
    }
}

fn ball_on(grid: &VoxelGrid, radius_m: f64) -> (Vec<bool>, DVec3) {
    let middle = 0.5 * DVec3::from_array(grid.dims.map(|d| d as f64 - 1.0)) + 0.17;
    let centre = grid.position_m(middle);
    (mask_of(grid, |v| (grid.position_m(v) - centre).length() < radius_m), centre)
}

fn surface(grid: &VoxelGrid, mask: &[bool], params: &SurfaceParams) -> (TriMesh, SurfaceReport) {
    let (mesh, report) = surface_of_mask(grid, mask, params).unwrap();
    let topology = check_closed(&mesh).unwrap();
    assert_eq!((topology.euler_characteristic, topology.n_pieces, topology.n_unused_vertices), (2, 1, 0));
    assert!((topology.volume_m3 / report.voxel_volume_m3 - 1.0).abs() < 1e-6);
    assert_eq!(report.euler_characteristic, 2);
    assert_eq!((report.n_triangles, report.n_vertices), (mesh.triangles.len(), mesh.positions_m.len()));
    (mesh, report)
}

#[test]
fn a_ball_on_thick_oblique_slices_becomes_smooth() {
    let radius_m = 22e-3;
    for mirrored in [false, true] {
        let grid = oblique_grid(mirrored);
        let (mask, centre) = ball_on(&grid, radius_m);
        let deviation = |mesh: &TriMesh| {
            let normals = vertex_normals(mesh, NormalWeight::Angle);
            let angles = normals.iter().zip(&mesh.positions_m).map(|(n, p)| n.angle_between(*p - centre));
            let mean_deg = angles.sum::<f64>().to_degrees() / mesh.positions_m.len() as f64;
            let off = mesh.positions_m.iter().map(|p| ((*p - centre).length() - radius_m).abs());
            (mean_deg, 1e3 * off.fold(0.0, f64::max))
        };
        let raw = SurfaceParams { smoothing_wavelength_m: Some(0.0), ..Default::default() };
        let (stepped, _) = surface(&grid, &mask, &raw);
        let (smooth, report) = surface(&grid, &mask, &SurfaceParams::default());
        let ((raw_deg, raw_mm), (smooth_deg, smooth_mm)) = (deviation(&stepped), deviation(&smooth));
        assert!(raw_deg > 12.0 && smooth_deg < 1.5, "normals off by {raw_deg} and {smooth_deg} degrees");
        assert!(smooth_mm < 0.5, "radius off by {smooth_mm} mm, steps by {raw_mm} mm");
        assert!(report.max_smoothing_m < 1.5e-3 && report.mean_smoothing_m < 0.5e-3);
    }
}

#[test]
fn decimated_surfaces_keep_the_volume_and_the_count() {
    let grid = oblique_grid(false);
    let (mask, _) = ball_on(&grid, 22e-3);
    let params = SurfaceParams { target_triangles: Some(1500), ..Default::default() };
    let (mesh, report) = surface(&grid, &mask, &params);
    assert_eq!(mesh.triangles.len(), 1500);
    assert!(report.n_triangles_extracted > 5000);
    assert_eq!(surface_of_mask(&grid, &mask, &params).unwrap().0, mesh, "the same bits twice");
}

#[test]
fn a_hollow_ring_and_thin_sheets_give_one_ball() {
    let grid = grid([48, 48, 20]);
    let centre = DVec3::new(24.0, 24.0, 10.0);
    let ring = mask_of(&grid, |v| {
        let d = v - centre;
        (d.x.hypot(d.y) - 14.0).hypot(d.z) < 5.0 && (d - DVec3::X * 14.0).length() > 2.0
    });
    let (_, report) = surface(&grid, &ring, &SurfaceParams::default());
    assert_eq!((report.repair.cavities_filled, report.repair.tunnels_cut), (1, 1));
    // One voxel thick, with a spike: smoothing must not push one side through the other.
    let sheet = mask_of(&grid, |v| {
        let d = (v - centre).abs();
        (d.z < 0.5 && d.x < 15.0 && d.y < 12.0) || (d.x < 0.5 && d.y < 0.5 && d.z < 8.0)
    });
    surface(&grid, &sheet, &SurfaceParams::default());
}

#[test]
fn labels_at_the_border_are_refused_or_capped() {
    let grid = grid([12, 12, 12]);
    let mask = mask_of(&grid, |v| v.z < 6.0 && v.x > 2.0 && v.x < 9.0 && v.y > 2.0 && v.y < 9.0);
    let refused = surface_of_mask(&grid, &mask, &SurfaceParams::default()).unwrap_err();
    assert_eq!(refused, SurfaceError::TouchesBorder { axis: 'k', side: "lower", n_voxels: 36 });
    surface(&grid, &mask, &SurfaceParams { cap_at_border: true, ..Default::default() });
}

#[test]
fn masks_and_parameters_out_of_range_are_refused() {
    let mut grid = grid([12, 12, 12]);
    let mask = mask_of(&grid, |v| (v - 6.0).abs().max_element() < 3.5);
    let refused = |params: SurfaceParams| surface_of_mask(&grid, &mask, &params).unwrap_err();
    let parameter = |e: SurfaceError| matches!(e, SurfaceError::Parameter { .. });
    assert!(parameter(refused(SurfaceParams { target_triangles: Some(3), ..Default::default() })));
    assert!(parameter(refused(SurfaceParams { smoothing_wavelength_m: Some(-1.0), ..Default::default() })));
    let empty = surface_of_mask(&grid, &vec![false; 1728], &SurfaceParams::default()).unwrap_err();
    assert_eq!(empty, SurfaceError::Topology(TopologyError::Empty));
    let holes = mask_of(&grid, |v| {
        let d = (v - 6.0).abs();
        d.max_element() < 4.5 && !(d.x < 1.5 && d.y < 1.5)
    });
    let repair =
        surface_of_mask(&grid, &holes, &SurfaceParams { largest_repair: 0.001, ..Default::default() });
    assert!(matches!(repair, Err(SurfaceError::RepairTooLarge { .. })), "{repair:?}");
    grid.axes.x_axis *= 1.1;
    assert!(parameter(surface_of_mask(&grid, &mask, &SurfaceParams::default()).unwrap_err()));
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(12))]

    /// Rough blobs with thin parts: closed, one ball, without crossings, of the right volume and count.
    #[test]
    fn rough_blobs_become_closed_surfaces(seed in any::<u64>()) {
        let mut grid = oblique_grid(seed % 2 == 0);
        grid.dims = [20, 20, 12];
        let mut random = SeededRandom::new(seed);
        let balls: Vec<(DVec3, f64)> = (0..7)
            .map(|_| {
                let centre = DVec3::new(random.uniform_in(5.0, 14.0), random.uniform_in(5.0, 14.0), random.uniform_in(4.0, 7.0));
                (centre, random.uniform_in(1.0, 4.0))
            })
            .collect();
        let mut mask = mask_of(&grid, |v| {
            let d = DVec3::new(1.0, 1.0, 2.0);
            balls.iter().any(|(c, r)| ((v - *c) * d).length() < *r)
        });
        for v in 0..mask.len() {
            let inner = grid.voxel(v).iter().zip(grid.dims).all(|(&x, d)| x > 0 && x + 1 < d);
            mask[v] = (mask[v] != (random.uniform() < 0.03)) && inner;
        }
        mask[grid.index([10, 10, 6])] = true;
        let params = SurfaceParams { largest_repair: 2.0, ..Default::default() };
        let (mesh, _) = surface(&grid, &mask, &params);
        let target = mesh.triangles.len() / 3;
        let fewer = surface_of_mask(&grid, &mask, &SurfaceParams { target_triangles: Some(target), ..params });
        match fewer {
            Ok((fewer, _)) => prop_assert!(fewer.triangles.len() <= target),
            Err(e) => prop_assert!(matches!(e, SurfaceError::TargetNotReached { .. }), "{}", e),
        }
    }

    /// The tree of boxes finds what testing all pairs finds.
    #[test]
    fn all_crossings_of_a_soup_are_found(seed in any::<u64>(), n in 2u32..60) {
        let mut random = SeededRandom::new(seed);
        // Few distinct coordinates: many exact contacts.
        let mut point = || DVec3::from_array([0; 3].map(|_| (random.uniform() * 9.0).floor()));
        let positions_m: Vec<DVec3> = (0..3 * n).map(|_| point()).collect();
        let triangles = (0..n).map(|t| [3 * t, 3 * t + 1, 3 * t + 2]).collect();
        let mut mesh = TriMesh { positions_m, triangles };
        mesh.triangles.retain(|t| {
            let [a, b, c] = t.map(|v| mesh.positions_m[v as usize]);
            (b - a).cross(c - a).length() > 0.0
        });
        let count = mesh.triangles.len() as u32;
        let all: Vec<[u32; 2]> = (0..count)
            .flat_map(|s| (s + 1..count).map(move |t| [s, t]))
            .filter(|&[s, t]| triangles_intersect(&mesh, s, t))
            .collect();
        prop_assert_eq!(self_intersections(&mesh, usize::MAX), all);
    }
}
