//! Winding numbers, and broken surfaces made closed again.

use glisson_mesh::image::labels::Parts;
use glisson_mesh::image::phantom::{self, PhantomParams};
use glisson_mesh::math::{Aabb, DQuat, DVec3, SeededRandom};
use glisson_mesh::surface::TriMesh;
use glisson_mesh::surface::check::check_closed;
use glisson_mesh::surface::extract::{SurfaceParams, surface_of_mask};
use glisson_mesh::surface::repair::{RepairError, RepairParams, RepairReport, repair};
use glisson_mesh::surface::signed_distance::SignedDistance;
use glisson_mesh::surface::winding::{WindingTree, winding_number};
use rayon::prelude::*;

use super::meshing::sphere;
use super::surfaces::{cube, joined, torus};

/// A box of the edge 0.1 m, `n` times `n` squares a side, two triangles each.
fn fine_box(n: u32) -> TriMesh {
    let mut mesh = TriMesh::default();
    for side in 0..6usize {
        let axis = side / 2;
        let first = mesh.positions_m.len() as u32;
        for u in 0..=n {
            for v in 0..=n {
                let mut p = DVec3::ZERO;
                p[axis] = (side % 2) as f64;
                p[(axis + 1) % 3] = f64::from(u) / f64::from(n);
                p[(axis + 2) % 3] = f64::from(v) / f64::from(n);
                mesh.positions_m.push(0.1 * p);
            }
        }
        for u in 0..n {
            for v in 0..n {
                let at = |u: u32, v: u32| first + u * (n + 1) + v;
                let quad = [at(u, v), at(u + 1, v), at(u + 1, v + 1), at(u, v + 1)];
                let [a, b, c, d] = if side % 2 == 1 { quad } else { [quad[3], quad[2], quad[1], quad[0]] };
                mesh.triangles.extend([[a, b, c], [a, c, d]]);
            }
        }
    }
    mesh
}

fn liver() -> TriMesh {
    let phantom = phantom::generate(&PhantomParams { seed: 4, voxel_m: 6e-3, ..PhantomParams::default() });
    let labels = &phantom.labels;
    let mask = labels.mask(&labels.select("liver", Parts::Included).unwrap());
    surface_of_mask(&labels.grid, &mask, &SurfaceParams::default()).unwrap().0
}

fn moved(mesh: &TriMesh, to: impl Fn(DVec3) -> DVec3) -> TriMesh {
    TriMesh {
        positions_m: mesh.positions_m.iter().map(|&p| to(p)).collect(),
        triangles: mesh.triangles.clone(),
    }
}

fn inside_out(mesh: &TriMesh) -> TriMesh {
    let triangles = mesh.triangles.iter().map(|&[a, b, c]| [a, c, b]).collect();
    TriMesh { positions_m: mesh.positions_m.clone(), triangles }
}

/// Every triangle with vertices of its own.
fn unwelded(mesh: &TriMesh) -> TriMesh {
    let positions_m = (0..mesh.triangles.len()).flat_map(|t| mesh.corners_m(t)).collect();
    let triangles = (0..mesh.triangles.len() as u32).map(|t| [3 * t, 3 * t + 1, 3 * t + 2]).collect();
    TriMesh { positions_m, triangles }
}

fn coarse(surface: &TriMesh, cells: f64) -> RepairParams {
    let longest_m = Aabb::of_points(&surface.positions_m).size_m().max_element();
    RepairParams { spacing_m: Some(longest_m / cells), ..RepairParams::default() }
}

// --- winding numbers --------------------------------------------------------------------------------------

fn random_point(random: &mut SeededRandom) -> DVec3 {
    DVec3::new(random.normal(), random.normal(), random.normal())
}

#[test]
fn winding_numbers_of_closed_surfaces_are_whole() {
    let ball = sphere(4);
    let shells = joined(&ball, &moved(&ball, |p| 0.5 * p));
    let (tree, shells_tree) = (WindingTree::of_triangles(&ball), WindingTree::of_triangles(&shells));
    let mut random = SeededRandom::new(3);
    for _ in 0..300 {
        let p = random_point(&mut random);
        if (p.length() - 1.0).abs() < 0.01 || (p.length() - 0.5).abs() < 0.01 {
            continue;
        }
        let (outer, inner) = (f64::from(u8::from(p.length() < 1.0)), f64::from(u8::from(p.length() < 0.5)));
        assert!((winding_number(&ball, p) - outer).abs() < 1e-12);
        assert!((winding_number(&shells, p) - outer - inner).abs() < 1e-12);
        assert!((tree.winding_number(p) - outer).abs() < 0.03, "{p}: {}", tree.winding_number(p));
        assert!((shells_tree.winding_number(p) - outer - inner).abs() < 0.03);
    }
}

/// The error of the second order at the opening criterion of two radii, against the exact sum.
#[test]
fn fast_winding_numbers_are_near_the_exact_sum_on_soups() {
    let (mut largest, mut squares, mut n) = (0.0f64, 0.0, 0);
    for seed in 0..20 {
        let mut random = SeededRandom::new(seed);
        let n_triangles = 10 + 100 * seed as u32;
        let size = random.uniform_in(0.02, 0.5);
        let mut positions_m = Vec::new();
        for _ in 0..n_triangles {
            let middle = random_point(&mut random);
            positions_m.extend([0; 3].map(|_| middle + size * random_point(&mut random)));
        }
        let triangles = (0..n_triangles).map(|t| [3 * t, 3 * t + 1, 3 * t + 2]).collect();
        let soup = TriMesh { positions_m, triangles };
        let tree = WindingTree::of_triangles(&soup);
        // Relative to what the triangles would give if all faced the point.
        for _ in 0..100 {
            let p = 2.0 * random_point(&mut random);
            let apart = unwelded(&soup);
            let all: f64 = (0..apart.triangles.len())
                .map(|t| {
                    let one =
                        TriMesh { positions_m: apart.corners_m(t).to_vec(), triangles: vec![[0, 1, 2]] };
                    winding_number(&one, p).abs()
                })
                .sum();
            let error = (tree.winding_number(p) - winding_number(&soup, p)).abs() / all.max(1.0);
            largest = largest.max(error);
            squares += error * error;
            n += 1;
        }
    }
    // Far from a piece the terms that are left out are of the third order in its size over the distance.
    let soup = sphere(2);
    let half = TriMesh { triangles: soup.triangles[..60].to_vec(), ..soup };
    let tree = WindingTree::of_triangles(&half);
    let mut random = SeededRandom::new(77);
    for _ in 0..100 {
        let p = 20.0 * random_point(&mut random).normalize();
        let error = (tree.winding_number(p) - winding_number(&half, p)).abs() * 400.0;
        assert!(error < 1e-3, "{error}");
    }
    let rms = (squares / f64::from(n)).sqrt();
    assert!(largest < 0.02 && rms < 0.003, "largest {largest}, rms {rms}");
}

#[test]
fn the_closest_point_is_that_of_all_triangles() {
    let ball = sphere(3);
    let tree = WindingTree::of_triangles(&ball);
    let mut random = SeededRandom::new(5);
    for _ in 0..200 {
        let p = random_point(&mut random);
        let far = (0..ball.triangles.len()).map(|t| {
            let corners = ball.corners_m(t);
            let w = glisson_mesh::math::closest_point_barycentric(p, corners);
            (w[0] * corners[0] + w[1] * corners[1] + w[2] * corners[2]).distance(p)
        });
        let nearest = far.fold(f64::INFINITY, f64::min);
        let (_, at, distance) = tree.closest(p, f64::INFINITY).unwrap();
        assert!((distance - nearest).abs() < 1e-12 && (at.distance(p) - nearest).abs() < 1e-12);
        assert!(tree.closest(p, 0.99 * nearest).is_none());
    }
}

// --- single faults ----------------------------------------------------------------------------------------

fn repaired(surface: &TriMesh, params: &RepairParams) -> (TriMesh, RepairReport) {
    let (mesh, report) = repair(surface, params).unwrap();
    let topology = check_closed(&mesh).unwrap();
    assert_eq!(topology.n_unused_vertices, 0);
    assert_eq!(report.volume_after_m3, topology.volume_m3);
    assert_eq!((report.n_triangles, report.n_pieces), (mesh.triangles.len(), topology.n_pieces));
    assert_eq!(report.rebuilt, report.spacing_m.is_some());
    (mesh, report)
}

#[test]
fn a_good_surface_comes_back_bit_for_bit() {
    let hollow = joined(&cube(), &inside_out(&moved(&cube(), |p| 0.5 * p)));
    for mesh in [sphere(3), torus(0.03, 0.01, 24, 12), liver(), hollow] {
        let (same, report) = repaired(&mesh, &RepairParams::default());
        assert_eq!(same, mesh);
        assert!(!report.rebuilt && report.greatest_move_m == 0.0 && report.closing_share == 0.0);
        let bits = |m: &TriMesh| -> Vec<u64> {
            m.positions_m.iter().flat_map(|p| p.to_array().map(f64::to_bits)).collect()
        };
        assert_eq!(bits(&same), bits(&mesh));
    }
}

#[test]
fn what_moves_nothing_is_mended_without_a_grid() {
    let good = fine_box(6);
    let (welded, report) = repaired(&good, &RepairParams::default());
    assert!(!report.rebuilt && report.found.coincident_vertices.count > 0);
    assert_eq!(welded.positions_m.len() as u32, 6 * 6 * 6 + 2);
    let mut broken = unwelded(&welded);
    broken.positions_m.push(DVec3::ONE);
    broken.triangles.extend([[0, 0, 1], broken.triangles[7], broken.triangles[9], broken.triangles[9]]);
    for t in [3, 40, 41] {
        broken.triangles[t].swap(1, 2);
    }
    let (mesh, report) = repaired(&inside_out(&broken), &RepairParams::default());
    let (found, done) = (&report.found, &report.done);
    assert!(!report.rebuilt && report.greatest_move_m == 0.0);
    assert_eq!(mesh.triangles.len(), welded.triangles.len());
    assert!((mesh.volume_m3() / welded.volume_m3() - 1.0).abs() < 1e-12);
    assert_eq!((found.degenerate_triangles.count, found.duplicate_triangles.count), (1, 3));
    assert_eq!((found.unused_vertices.count, done.vertices_dropped, done.triangles_dropped), (1, 1, 4));
    assert_eq!((found.turned_triangles.count, found.turned_pieces.count, found.open_edges.count), (3, 1, 0));
    assert_eq!(done.triangles_turned, 3 + mesh.triangles.len());
    let json = serde_json::to_value(&report).unwrap();
    assert_eq!(json["found"]["turned_triangles"]["places_m"].as_array().unwrap().len(), 3);
}

#[test]
fn pieces_inside_others_are_filled_unless_they_bound_a_cavity() {
    let ball = sphere(3);
    let inner = moved(&ball, |p| 0.5 * p);
    let speck = moved(&ball, |p| 0.05 * p + DVec3::splat(2.0));
    let (plain, cavity) = (ball.volume_m3(), inner.volume_m3());
    let cases = [
        (joined(&ball, &inner), plain),
        (joined(&ball, &inside_out(&inner)), plain - cavity),
        (inside_out(&joined(&ball, &inside_out(&inner))), plain - cavity),
        (inside_out(&joined(&ball, &inner)), plain),
        (joined(&ball, &speck), plain),
        (joined(&ball, &inside_out(&moved(&ball, |p| p + DVec3::X * 3.0))), 2.0 * plain),
    ];
    for (case, (mesh, expected)) in cases.iter().enumerate() {
        let (_, report) = repaired(mesh, &RepairParams::default());
        assert!(!report.rebuilt, "{case}");
        assert!((report.volume_after_m3 / expected - 1.0).abs() < 1e-12, "{case}: {report:?}");
        // The same after a hole that needs a grid.
        let mut open = mesh.clone();
        open.triangles.remove(5);
        let (_, report) = repaired(&open, &coarse(mesh, 36.0));
        assert!(report.rebuilt);
        let off = report.volume_after_m3 / expected - 1.0;
        assert!(off.abs() < 0.01, "{case}: volume off by {off}");
    }
    let kept = RepairParams { smallest_piece_share: 1e-5, ..RepairParams::default() };
    assert_eq!(repaired(&cases[4].0, &kept).1.n_pieces, 2);
    let (_, report) = repaired(&cases[4].0, &RepairParams::default());
    assert_eq!((report.n_pieces, report.done.small_pieces_dropped.count), (1, 1));
    assert!(report.done.small_pieces_dropped.places_m[0].distance(DVec3::splat(2.0)) < 0.06);
}

#[test]
fn the_rebuilt_surface_lies_on_the_old_one() {
    let mut ball = sphere(4);
    ball.triangles.drain(100..103);
    let params = coarse(&ball, 50.0);
    let (mesh, report) = repaired(&ball, &params);
    let spacing_m = params.spacing_m.unwrap();
    assert_eq!(report.spacing_m, params.spacing_m);
    assert_eq!((report.n_pieces, report.euler_characteristic), (1, 2));
    assert!(report.greatest_move_m < 0.2 * spacing_m, "{report:?}");
    assert!(report.greatest_distance_from_old_m < 0.5 * spacing_m, "{report:?}");
    assert!(report.closing_share < 0.01);
    assert!((report.volume_before_m3 / report.volume_after_m3 - 1.0).abs() < 0.01);
    let farthest = mesh.positions_m.iter().map(|p| (p.length() - 1.0).abs()).fold(0.0, f64::max);
    assert!(farthest < 0.2 * spacing_m, "{farthest}");
}

#[test]
fn hopeless_surfaces_are_refused_with_a_reason() {
    let refused = |mesh: &TriMesh| repair(mesh, &coarse(mesh, 40.0)).unwrap_err();
    let ball = sphere(3);
    let mut open = ball.clone();
    open.triangles.retain(|t| t.iter().all(|&v| ball.positions_m[v as usize].z < 0.1));
    let bowl = refused(&open);
    assert!(matches!(bowl, RepairError::HoleTooLarge { allowed: 0.2, .. }), "{bowl}");
    let RepairError::HoleTooLarge { share, place, .. } = bowl else { unreachable!() };
    // A disc of 3.1 over a bowl of 6.9, without its seam.
    assert!((share - 0.31).abs() < 0.06 && (place.0 - 0.1 * DVec3::Z).length() < 0.2, "{share} {place}");
    let mut sheet = fine_box(8);
    sheet.triangles.truncate(128);
    let sheet = refused(&sheet);
    assert!(matches!(sheet, RepairError::NoInside { .. }), "{sheet}");
    let empty = repair(&TriMesh::default(), &RepairParams::default()).unwrap_err();
    assert!(matches!(empty, RepairError::Surface(_)), "{empty}");
    let flat = TriMesh { positions_m: vec![DVec3::ZERO, DVec3::X], triangles: vec![[0, 1, 1], [0, 1, 0]] };
    let flat = repair(&flat, &RepairParams::default()).unwrap_err();
    assert_eq!(flat, RepairError::NothingLeft { n_triangles: 2, n_degenerate: 2 });
    let mut wild = ball.clone();
    wild.positions_m[4].y = f64::NAN;
    assert!(matches!(refused_plainly(&wild), RepairError::Surface(_)));
    wild = ball.clone();
    wild.triangles[4][1] = 9999;
    assert!(matches!(refused_plainly(&wild), RepairError::Surface(_)));
    let params = RepairParams { spacing_m: Some(-1.0), ..RepairParams::default() };
    assert!(matches!(repair(&ball, &params), Err(RepairError::Parameter { .. })));
    let params = RepairParams { spacing_m: Some(1e-4), ..RepairParams::default() };
    let mut holed = ball;
    holed.triangles.pop();
    assert!(matches!(repair(&holed, &params), Err(RepairError::Grid(_))));
}

fn refused_plainly(mesh: &TriMesh) -> RepairError {
    repair(mesh, &RepairParams::default()).unwrap_err()
}

// --- faults at random -------------------------------------------------------------------------------------

/// Up to `n` triangles around `start`, neighbours over vertices first.
fn patch(mesh: &TriMesh, start: usize, n: usize) -> Vec<usize> {
    let mut around = vec![Vec::new(); mesh.positions_m.len()];
    for (t, triangle) in mesh.triangles.iter().enumerate() {
        for &v in triangle {
            around[v as usize].push(t);
        }
    }
    let mut found = vec![start];
    let mut next = 0;
    while next < found.len() && found.len() < n {
        for &v in &mesh.triangles[found[next]] {
            for &t in &around[v as usize] {
                if found.len() < n && !found.contains(&t) {
                    found.push(t);
                }
            }
        }
        next += 1;
    }
    found
}

fn any(random: &mut SeededRandom, n: usize) -> usize {
    (random.next_u64() % n as u64) as usize
}

fn with_hole(mut mesh: TriMesh, random: &mut SeededRandom, most: usize) -> TriMesh {
    let n = 1 + any(random, most);
    let start = any(random, mesh.triangles.len());
    let gone = patch(&mesh, start, n);
    let mut t = 0;
    mesh.triangles.retain(|_| {
        t += 1;
        !gone.contains(&(t - 1))
    });
    mesh
}

fn with_turned(mut mesh: TriMesh, random: &mut SeededRandom) -> TriMesh {
    for _ in 0..1 + any(random, 5) {
        let (start, n) = (any(random, mesh.triangles.len()), 1 + any(random, 30));
        for t in patch(&mesh, start, n) {
            mesh.triangles[t].swap(1, 2);
        }
    }
    mesh
}

fn with_doubled(mut mesh: TriMesh, random: &mut SeededRandom) -> TriMesh {
    for _ in 0..1 + any(random, 10) {
        let mut triangle = mesh.triangles[any(random, mesh.triangles.len())];
        if random.uniform() < 0.4 {
            triangle.swap(1, 2);
        }
        triangle.rotate_left(any(random, 3));
        mesh.triangles.push(triangle);
    }
    mesh
}

/// Triangles of two corners, of three on a line, and edges divided for one of their triangles only.
fn with_degenerate(mut mesh: TriMesh, random: &mut SeededRandom) -> TriMesh {
    for _ in 0..1 + any(random, 10) {
        let t = any(random, mesh.triangles.len());
        let [a, b, c] = mesh.triangles[t];
        let kind = any(random, 3);
        if kind == 0 {
            mesh.triangles.push([a, b, b]);
            continue;
        }
        let middle = mesh.positions_m.len() as u32;
        let [a_m, b_m, _] = mesh.corners_m(t);
        mesh.positions_m.push(0.5 * (a_m + b_m));
        mesh.triangles.push([a, b, middle]);
        if kind == 2 {
            mesh.triangles[t] = [a, middle, c];
            mesh.triangles.push([middle, b, c]);
        }
    }
    mesh
}

/// A vertex pulled along the inward direction until it is outside at the other end.
fn with_pulled(mut mesh: TriMesh, random: &mut SeededRandom) -> TriMesh {
    let bounds = Aabb::of_points(&mesh.positions_m);
    let v = any(random, mesh.positions_m.len());
    let to_m = bounds.center_m() - mesh.positions_m[v];
    mesh.positions_m[v] += random.uniform_in(1.5, 2.2) * to_m;
    mesh
}

/// Volume of what lies in either body, counted at many points by the sign of their distances, which comes
/// from crossings of rays.
fn volume_of_union_m3(a: &TriMesh, b: &TriMesh) -> f64 {
    let both = joined(a, b);
    let bounds = Aabb::of_points(&both.positions_m);
    let spacing_m = bounds.size_m().max_element() / 90.0;
    let bounds = bounds.grown(1.5 * spacing_m);
    let fields = [a, b].map(|m| SignedDistance::of_surface(m, spacing_m, 0.0).unwrap());
    let n = bounds.size_m() / spacing_m;
    let mut sum = 0.0;
    for k in 0..=n.z as usize {
        for j in 0..=n.y as usize {
            for i in 0..=n.x as usize {
                let p = bounds.min_m + spacing_m * DVec3::new(i as f64, j as f64, k as f64);
                let d = fields.iter().map(|f| f.sample_m(p)).fold(f64::INFINITY, f64::min);
                // Half of a point whose cell the surface cuts in half.
                sum += (0.5 - d / spacing_m).clamp(0.0, 1.0);
            }
        }
    }
    sum * spacing_m.powi(3)
}

const KINDS: [&str; 10] = [
    "hole",
    "turned",
    "turned piece",
    "doubled",
    "degenerate",
    "pulled",
    "pierced",
    "soup",
    "cracked soup",
    "all",
];

/// A broken surface and the volume it should have.
fn broken(good: &TriMesh, kind: &str, random: &mut SeededRandom) -> (TriMesh, f64) {
    let volume_m3 = good.volume_m3();
    let size_m = Aabb::of_points(&good.positions_m).size_m();
    let mesh = match kind {
        "hole" => with_hole(good.clone(), random, 30),
        "turned" => with_turned(good.clone(), random),
        "turned piece" => {
            let factor = random.uniform_in(0.3, 1.0);
            let other = moved(good, |p| factor * p + DVec3::X * (1.5 * size_m.x + 0.5 * size_m.y));
            let other_m3 = other.volume_m3();
            let both = joined(good, &inside_out(&other));
            let mesh = if random.uniform() < 0.5 { with_hole(both, random, 5) } else { both };
            return (mesh, volume_m3 + other_m3);
        }
        "doubled" => with_doubled(good.clone(), random),
        "degenerate" => with_degenerate(good.clone(), random),
        "pulled" => with_pulled(good.clone(), random),
        "pierced" => {
            let factor = random.uniform_in(0.5, 1.0);
            let by_m = size_m * DVec3::new(random.uniform_in(0.3, 0.7), random.uniform_in(0.1, 0.4), 0.123);
            let other = moved(good, |p| factor * p + by_m);
            let expected_m3 = volume_of_union_m3(good, &other);
            let other = if random.uniform() < 0.3 { inside_out(&other) } else { other };
            return (joined(good, &other), expected_m3);
        }
        "soup" => unwelded(good),
        "cracked soup" => {
            let mut soup = unwelded(good);
            for p in &mut soup.positions_m {
                *p += 1e-5 * size_m.x * random_point(random);
            }
            soup
        }
        _ => {
            let mesh = with_turned(with_hole(good.clone(), random, 12), random);
            with_hole(unwelded(&with_degenerate(with_doubled(mesh, random), random)), random, 3)
        }
    };
    (mesh, volume_m3)
}

/// 200 surfaces broken by seed. All are within one percent of the good one's volume or refused.
#[test]
fn surfaces_broken_at_random_are_repaired_or_refused() {
    let bodies = [fine_box(14), sphere(4), liver()];
    let cases: Vec<(usize, &str, Result<f64, String>, bool)> = (0..200usize)
        .into_par_iter()
        .map(|seed| {
            let mut random = SeededRandom::new(seed as u64);
            let kind = KINDS[seed % KINDS.len()];
            let body = &bodies[seed / KINDS.len() % bodies.len()];
            let cells = [24.0, 24.0, 36.0][seed / KINDS.len() % bodies.len()];
            let turn = if seed % 2 == 0 {
                DQuat::IDENTITY
            } else {
                DQuat::from_axis_angle(random_point(&mut random).normalize(), random.uniform_in(0.0, 6.0))
            };
            let (mesh, expected_m3) = broken(&moved(body, |p| turn * p), kind, &mut random);
            match repair(&mesh, &coarse(body, cells)) {
                Ok((closed, report)) => {
                    let topology = check_closed(&closed).unwrap_or_else(|e| panic!("{seed} {kind}: {e}"));
                    (seed, kind, Ok(topology.volume_m3 / expected_m3 - 1.0), report.rebuilt)
                }
                Err(refusal) => (seed, kind, Err(refusal.to_string()), false),
            }
        })
        .collect();
    let wrong: Vec<_> = cases.iter().filter(|c| !matches!(c.2, Ok(off) if off.abs() < 0.01)).collect();
    let n_repaired = cases.iter().filter(|c| c.2.is_ok()).count();
    assert!(wrong.iter().all(|c| c.2.is_err()), "{wrong:?}");
    let n_rebuilt = cases.iter().filter(|c| c.3).count();
    assert_eq!((n_repaired, n_rebuilt), (200, 133), "{wrong:?}");
}

#[test]
fn the_same_bits_at_any_number_of_threads() {
    let good = liver();
    for kind in ["hole", "pierced", "all"] {
        let (mesh, _) = broken(&good, kind, &mut SeededRandom::new(11));
        let with = |n| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(n).build().unwrap();
            pool.install(|| repair(&mesh, &coarse(&mesh, 36.0)).unwrap())
        };
        let (one, two) = (with(1), with(2));
        assert!(one.1.rebuilt);
        assert_eq!(one, two);
        let bits = |m: &TriMesh| -> Vec<[u64; 3]> {
            m.positions_m.iter().map(|p| p.to_array().map(f64::to_bits)).collect()
        };
        assert_eq!(bits(&one.0), bits(&two.0));
    }
}
