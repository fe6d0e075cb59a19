//! Segmentation by contours: edges of known place, polygons and pixels, contours of known shape, the
//! synthetic patient.

use glisson_mesh::image::contours::canny::gaussian_gradient;
use glisson_mesh::image::contours::deriche::recursive_gradient;
use glisson_mesh::image::contours::edges::{Gradient, edges};
use glisson_mesh::image::contours::plane::Plane;
use glisson_mesh::image::contours::polygon::{any_crossing, perimeter_m, resampled, signed_area_m2};
use glisson_mesh::image::contours::raster::{outlines, rasterised};
use glisson_mesh::image::contours::{
    ContourError, ContourParams, ContourSegmentation, EdgeMethod, SliceContour, segment_by_contours,
};
use glisson_mesh::image::filter::{self, Connectivity};
use glisson_mesh::image::labels::{Parts, dice, hausdorff_95_m};
use glisson_mesh::image::phantom::{Phantom, PhantomParams, generate};
use glisson_mesh::image::segment::SegmentError;
use glisson_mesh::image::topology::solid_euler_characteristic;
use glisson_mesh::image::{Volume, VoxelGrid};
use glisson_mesh::math::{DVec2, DVec3, SeededRandom};
use proptest::prelude::*;

use crate::sample_images::plain_grid;

// ---- Edges -------------------------------------------------------------------------------------------

/// A step from 0 to 1 across the line `normal . x = at_m` of every slice (or the plane, with a part along k), blurred
/// by a Gaussian of deviation `blur_m`.
fn step(grid: &VoxelGrid, normal: DVec3, at_m: f64, blur_m: f64) -> Vec<f32> {
    (0..grid.n_voxels())
        .map(|v| {
            let place = DVec3::from_array(grid.voxel(v).map(|x| x as f64)) * grid.spacing_m;
            (0.5 * libm::erfc(-(normal.dot(place) - at_m) / (blur_m * 2f64.sqrt()))) as f32
        })
        .collect()
}

#[test]
fn a_step_is_found_within_a_tenth_of_a_voxel() {
    let grid = plain_grid([40, 36, 9], [1.5, 1.5, 1.5]);
    let plane = Plane::of(&grid);
    let canny = |values: &[f32]| gaussian_gradient(&grid, values, 1.5e-3);
    let deriche = |values: &[f32]| recursive_gradient(&grid, values, 1.2e-3);
    for (degrees, share_of_voxel) in
        [(0.0, 0.0), (0.0, 0.3), (90.0, 0.45), (30.0, 0.2), (45.0, 0.7), (200.0, 0.1)]
    {
        let radians: f64 = f64::to_radians(degrees);
        let normal = DVec3::new(radians.cos(), radians.sin(), 0.0);
        let middle = DVec3::new(19.0, 17.0, 4.0) * grid.spacing_m;
        let at_m = normal.dot(middle) + share_of_voxel * 1.5e-3;
        let values = step(&grid, normal, at_m, 1e-3);
        for (name, gradient) in [("Canny", canny(&values)), ("Deriche", deriche(&values))] {
            let slice = &edges(&grid, &gradient, [60.0, 100.0])[4];
            assert!(slice.edges.len() > 20, "{name} at {degrees} degrees: {} edges", slice.edges.len());
            for edge in &slice.edges {
                let error = (normal.truncate().dot(edge.place_m) - at_m) / 1.5e-3;
                let from_border = edge.place_m.min(DVec2::new(39.0, 35.0) * plane.spacing_m - edge.place_m);
                if from_border.min_element() > 6e-3 {
                    assert!(error.abs() < 0.1, "{name} at {degrees} degrees: {error} voxels off");
                    assert!(edge.to_brighter.dot(normal.truncate()) > 0.99);
                }
            }
            // Seen along the normal from 2 mm before it.
            let from_m = middle.truncate() + normal.truncate() * (at_m - normal.dot(middle) - 2e-3);
            let seen = slice.nearest_along(&plane, from_m, normal.truncate(), 3e-3, |_| true);
            assert!(seen.is_some_and(|d| (d - 2e-3).abs() < 0.25e-3), "{name} at {degrees}: {seen:?}");
            assert_eq!(slice.nearest_along(&plane, from_m, normal.truncate(), 1e-3, |_| true), None);
        }
    }
}

#[test]
fn an_oblique_plane_is_placed_where_it_cuts_the_slice() {
    let grid = plain_grid([40, 20, 24], [1.5, 1.5, 2.5]);
    let normal = DVec3::new(0.8, 0.0, 0.6);
    let at_m = normal.dot(DVec3::new(19.0, 10.0, 12.0) * grid.spacing_m) + 0.4e-3;
    let gradient = recursive_gradient(&grid, &step(&grid, normal, at_m, 1.2e-3), 1.5e-3);
    for k in [10, 12, 13] {
        let slice = &edges(&grid, &gradient, [50.0, 80.0])[k];
        let expected_m = (at_m - normal.z * k as f64 * 2.5e-3) / normal.x;
        let row = slice.edges.iter().filter(|e| (e.place_m.y - 15e-3).abs() < 3e-3);
        let places: Vec<f64> = row.map(|e| e.place_m.x).collect();
        assert!(places.len() >= 3, "slice {k}");
        for x in places {
            assert!((x - expected_m).abs() < 0.3e-3, "slice {k}: {x} m instead of {expected_m} m");
        }
    }
}

/// Gradient by the definition: sums over the kernels of Deriche's filters, the border value continued.
fn direct_gradient(grid: &VoxelGrid, values: &[f32], decay_length_m: f64, component: usize) -> Vec<f64> {
    let mut now: Vec<f64> = values.iter().map(|v| f64::from(*v)).collect();
    for axis in 0..3 {
        let decay = grid.spacing_m[axis] / decay_length_m;
        const REACH: isize = 60;
        let weight = |o: isize| {
            let fall = (-decay * o.abs() as f64).exp();
            if axis == component { o as f64 * fall } else { (1.0 + decay * o.abs() as f64) * fall }
        };
        // The derivative gives 1 for a ramp, the smoothing 1 for a constant.
        let sum: f64 = (-REACH..=REACH)
            .map(|o| weight(o) * if axis == component { o as f64 * grid.spacing_m[axis] } else { 1.0 })
            .sum();
        now = (0..values.len())
            .map(|v| {
                let voxel = grid.voxel(v);
                let at = |o: isize| {
                    let mut other = voxel;
                    other[axis] = (voxel[axis] as isize + o).clamp(0, grid.dims[axis] as isize - 1) as usize;
                    now[grid.index(other)]
                };
                (-REACH..=REACH).map(|o| weight(o) * at(o)).sum::<f64>() / sum
            })
            .collect();
    }
    now
}

#[test]
fn the_recursive_filter_agrees_with_direct_convolution() {
    let grid = plain_grid([11, 9, 8], [1.0, 1.5, 2.0]);
    let mut random = SeededRandom::new(3);
    let values: Vec<f32> = (0..grid.n_voxels()).map(|_| random.normal() as f32).collect();
    for decay_length_m in [0.8e-3, 1.5e-3] {
        let found = recursive_gradient(&grid, &values, decay_length_m);
        for component in 0..3 {
            let direct = direct_gradient(&grid, &values, decay_length_m, component);
            let largest = direct.iter().fold(0.0, |m: f64, v| m.max(v.abs()));
            for v in 0..values.len() {
                let error = (f64::from(found.along[component][v]) - direct[v]).abs();
                assert!(
                    error < 2e-6 * largest,
                    "component {component}, voxel {v}: off by {error} of {largest}"
                );
            }
        }
    }
}

#[test]
fn both_gradients_are_exact_for_a_ramp() {
    let grid = plain_grid([30, 28, 26], [1.0, 1.5, 2.0]);
    let slope = DVec3::new(3.0, -2.0, 5.0);
    let values: Vec<f32> = (0..grid.n_voxels())
        .map(|v| slope.dot(DVec3::from_array(grid.voxel(v).map(|x| x as f64)) * grid.spacing_m) as f32)
        .collect();
    let middle = grid.index([15, 14, 13]);
    let check = |gradient: &Gradient, n: usize| {
        for axis in 0..n {
            let found = f64::from(gradient.along[axis][middle]);
            assert!((found - slope[axis]).abs() < 2e-3, "axis {axis}: {found}");
        }
    };
    check(&gaussian_gradient(&grid, &values, 1.5e-3), 2);
    check(&gaussian_gradient(&grid, &values, 0.1e-3), 2);
    check(&recursive_gradient(&grid, &values, 0.8e-3), 3);
}

#[test]
fn the_noise_of_a_gradient_is_measured_beside_edges_and_thresholds_follow_it() {
    let grid = plain_grid([64, 64, 12], [1.0; 3]);
    let plane = Plane::of(&grid);
    let everywhere = vec![true; grid.n_voxels()];
    for noise in [1.0, 4.0] {
        let mut random = SeededRandom::new(11);
        let noisy = |contrast: f64, random: &mut SeededRandom| -> Vec<f32> {
            let edge = step(&grid, DVec3::X, 32e-3, 1e-3);
            edge.iter().map(|e| (contrast * f64::from(*e) + noise * random.normal()) as f32).collect()
        };
        let (plain, stepped) = (noisy(0.0, &mut random), noisy(12.0 * noise, &mut random));
        for take in [gaussian as fn(&VoxelGrid, &[f32]) -> Gradient, deriche] {
            let gradient = take(&grid, &plain);
            let sum2: f64 = gradient.along[0].iter().map(|v| f64::from(*v) * f64::from(*v)).sum();
            let deviation = (sum2 / grid.n_voxels() as f64).sqrt();
            let found = gradient.noise(&everywhere).unwrap();
            assert!((found / deviation - 1.0).abs() < 0.1, "{found} instead of {deviation}");
            // An edge in the image hardly changes it.
            let stepped = take(&grid, &stepped);
            let with_edge = stepped.noise(&everywhere).unwrap();
            assert!((with_edge / deviation - 1.0).abs() < 0.25, "{with_edge} instead of {deviation}");
            let slices = edges(&grid, &gradient, [3.0 * found, 5.0 * found]);
            let n_false: usize = slices.iter().map(|s| s.edges.len()).sum();
            assert!(n_false < grid.n_voxels() / 200, "{n_false} edges of noise");
            let slices = edges(&grid, &stepped, [3.0 * found, 5.0 * found]);
            for slice in &slices[2..10] {
                let rows = (8..56).filter(|j| {
                    let from_m = DVec2::new(31e-3, *j as f64 * 1e-3);
                    slice.nearest_along(&plane, from_m, DVec2::X, 3e-3, |_| true).is_some()
                });
                assert!(rows.count() > 44, "the step has gaps");
            }
        }
    }
    assert!(Gradient { n_dimensions: 2, along: [vec![], vec![], vec![]] }.noise(&[]).is_none());
}

fn gaussian(grid: &VoxelGrid, values: &[f32]) -> Gradient {
    gaussian_gradient(grid, values, 1.5e-3)
}

fn deriche(grid: &VoxelGrid, values: &[f32]) -> Gradient {
    recursive_gradient(grid, values, 1.2e-3)
}

#[test]
fn hysteresis_keeps_weak_edges_that_continue_strong_ones() {
    let grid = plain_grid([40, 40, 1], [1.0; 3]);
    // A step that fades from contrast 2 to 0.4 along j, and a separate one of contrast 0.5.
    let values: Vec<f32> = (0..grid.n_voxels())
        .map(|v| {
            let [i, j, _] = grid.voxel(v);
            let strong = if i >= 10 { 2.0 - 0.04 * j as f32 } else { 0.0 };
            let weak = if i >= 30 { 0.5 } else { 0.0 };
            strong + weak
        })
        .collect();
    let gradient = gaussian_gradient(&grid, &values, 1e-3);
    let near = |thresholds: [f64; 2], i: f64| {
        let slice = &edges(&grid, &gradient, thresholds)[0];
        slice.edges.iter().filter(|e| (e.place_m.x - i * 1e-3).abs() < 2e-3).count()
    };
    let per_m = |contrast: f64| contrast / (1e-3 * std::f64::consts::TAU.sqrt());
    assert_eq!(near([per_m(0.3), per_m(1.2)], 29.5), 0, "weak and alone");
    assert!(near([per_m(0.3), per_m(1.2)], 9.5) >= 38, "weak and connected");
    assert!(near([per_m(0.3), per_m(0.3)], 29.5) >= 38);
    assert!(near([per_m(1.2), per_m(1.2)], 9.5) < 30);
}

// ---- Polygons and pixels -----------------------------------------------------------------------------

fn mm(points: &[[f64; 2]]) -> Vec<DVec2> {
    points.iter().map(|p| DVec2::from_array(*p) * 1e-3).collect()
}

fn plane(dims: [usize; 2], spacing_mm: [f64; 2]) -> Plane {
    Plane { dims, spacing_m: DVec2::from_array(spacing_mm) * 1e-3 }
}

fn n_inside(mask: &[bool]) -> usize {
    mask.iter().filter(|&&m| m).count()
}

#[test]
fn rasterising_takes_centres_on_the_lower_sides_only() {
    let plane = plane([8, 8], [1.0, 1.0]);
    let square = mm(&[[1.0, 2.0], [4.0, 2.0], [4.0, 5.0], [1.0, 5.0]]);
    let expected: Vec<bool> =
        (0..64).map(|p| (1..4).contains(&(p % 8)) && (2..5).contains(&(p / 8))).collect();
    assert_eq!(rasterised(&plane, &[&square]), expected);
    let reversed: Vec<DVec2> = square.iter().rev().copied().collect();
    assert_eq!(rasterised(&plane, &[&reversed]), expected, "the direction does not matter");
    // Two triangles that share a side share no pixel and miss none.
    let halves = [mm(&[[1.0, 2.0], [4.0, 2.0], [4.0, 5.0]]), mm(&[[1.0, 2.0], [4.0, 5.0], [1.0, 5.0]])];
    assert_eq!(rasterised(&plane, &halves), expected);
    let parts = halves.each_ref().map(|h| rasterised(&plane, &[h]));
    assert_eq!(n_inside(&parts[0]) + n_inside(&parts[1]), 9);
    // Beyond the image it is cut off.
    let large = mm(&[[-9.0, -9.0], [20.0, -9.0], [20.0, 20.0], [-9.0, 20.0]]);
    assert_eq!(n_inside(&rasterised(&plane, &[&large])), 64);
    // The small loop of an eight, turned inside out, is left out; overlapping polygons are united.
    let eight = mm(&[[0.0, 0.0], [5.0, 0.0], [5.0, 4.0], [4.0, 5.5], [6.0, 5.5], [5.0, 4.0], [0.0, 4.0]]);
    assert!(rasterised(&plane, &[&eight])[..32].iter().filter(|&&m| m).count() == 20);
    assert_eq!(n_inside(&rasterised(&plane, &[&square, &large])), 64);
    assert_eq!(n_inside(&rasterised::<Vec<DVec2>>(&plane, &[])), 0);
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 300, ..ProptestConfig::default() })]

    #[test]
    fn outlines_lead_back_to_the_pixels_without_holes(seed in any::<u64>(), share in 0.2..0.9f64) {
        let plane = plane([9, 7], [0.8, 1.3]);
        let mut random = SeededRandom::new(seed);
        let mask: Vec<bool> = (0..63).map(|_| random.uniform() < share).collect();
        let found = outlines(&plane, &mask);
        let grid = VoxelGrid { dims: [9, 7, 1], ..plain_grid([9, 7, 1], [0.8, 1.3, 1.0]) };
        let pieces = filter::components(&grid, &mask, Connectivity::Faces);
        prop_assert_eq!(found.len(), pieces.sizes.len());
        let back = rasterised(&plane, &found);
        for p in 0..63 {
            prop_assert!(back[p] || !mask[p], "pixel {p} is lost");
        }
        for (number, outline) in found.iter().enumerate() {
            prop_assert!(signed_area_m2(outline) > 0.0);
            let own: Vec<bool> = pieces.piece.iter().map(|&p| p as usize == number + 1).collect();
            let alone = rasterised(&plane, &[outline]);
            // What is added is enclosed: no walk over pixels that share a corner leads out.
            for p in 0..63 {
                prop_assert!(alone[p] || !own[p]);
                let [i, j] = [p % 9, p / 9];
                if alone[p] && !own[p] {
                    prop_assert!(i > 0 && i < 8 && j > 0 && j < 6, "pixel {p} of the border added");
                    for n in [p - 1, p + 1, p - 9, p + 9] {
                        prop_assert!(alone[n], "pixel {p} added beside {n} outside");
                    }
                }
            }
        }
    }
}

#[test]
fn polygons_have_area_length_even_spacing_and_crossings() {
    let square = mm(&[[0.0, 0.0], [6.0, 0.0], [6.0, 6.0], [0.0, 6.0]]);
    assert!((signed_area_m2(&square) - 36e-6).abs() < 1e-15);
    assert!((perimeter_m(&square) - 24e-3).abs() < 1e-12);
    let even = resampled(&square, 1e-3);
    assert_eq!(even.len(), 24);
    for p in 0..24 {
        assert!((even[p].distance(even[(p + 1) % 24]) - 1e-3).abs() < 1e-9, "point {p}");
    }
    assert!((signed_area_m2(&even) - 36e-6).abs() < 1e-12);
    assert_eq!(resampled(&mm(&[[0.0, 0.0], [0.1, 0.0], [0.0, 0.1]]), 1e-3).len(), 6);
    assert!(!any_crossing(std::slice::from_ref(&square)));
    let apart: Vec<DVec2> = square.iter().map(|p| *p + DVec2::new(7e-3, 0.0)).collect();
    let over: Vec<DVec2> = square.iter().map(|p| *p + DVec2::new(5e-3, 1e-3)).collect();
    assert!(!any_crossing(&[square.clone(), apart]));
    assert!(any_crossing(&[square, over]));
    assert!(any_crossing(&[mm(&[[0.0, 0.0], [4.0, 4.0], [4.0, 0.0], [0.0, 4.0]])]));
}

// ---- Contours of known shape -------------------------------------------------------------------------

/// An organ of 110 HU in fat of -90 HU, blurred by the pixels' own size, with noise.
fn organ(grid: &VoxelGrid, noise_hu: f64, depth_m: impl Fn(DVec3) -> f64) -> Volume<f32> {
    let mut random = SeededRandom::new(5);
    let values = (0..grid.n_voxels())
        .map(|v| {
            let place = DVec3::from_array(grid.voxel(v).map(|x| x as f64)) * grid.spacing_m;
            let share = (depth_m(place) / grid.spacing_m.x + 0.5).clamp(0.0, 1.0);
            (-90.0 + 200.0 * share + noise_hu * random.normal()) as f32
        })
        .collect();
    Volume { grid: grid.clone(), values }
}

fn at_mm(grid: &VoxelGrid, [x, y, z]: [f64; 3]) -> DVec3 {
    grid.position_m(DVec3::new(x, y, z) * 1e-3 / grid.spacing_m)
}

fn area_m2(found: &ContourSegmentation, slice: usize) -> f64 {
    found.contours.iter().filter(|c| c.slice == slice).map(|c| signed_area_m2(&c.points_m)).sum()
}

#[test]
fn a_disc_is_found_with_its_area() {
    let grid = plain_grid([60, 60, 9], [1.5, 1.5, 1.5]);
    let center = DVec2::new(44.3e-3, 43.8e-3);
    for (radius_m, noise_hu) in [(30e-3, 0.0), (30e-3, 20.0), (18e-3, 10.0)] {
        let ct = organ(&grid, noise_hu, |p| radius_m - p.truncate().distance(center));
        // The gradient of a blurred disc is steepest a little inside its border: 0.2 of a voxel is allowed.
        let allowed = 2.0 * 0.2 * grid.spacing_m.x / radius_m;
        for method in [EdgeMethod::Canny { sigma_m: 1e-3 }, EdgeMethod::Deriche { decay_length_m: 1.2e-3 }] {
            let params = ContourParams {
                seeds_m: vec![at_mm(&grid, [50.0, 40.0, 6.0])],
                edges: method,
                ..ContourParams::default()
            };
            let found = segment_by_contours(&ct, &params).unwrap();
            let expected = std::f64::consts::PI * radius_m * radius_m;
            // The first and last slice have no neighbour to smooth with (and Deriche's filter no edges): not judged here.
            for slice in 1..8 {
                let error = area_m2(&found, slice) / expected - 1.0;
                assert!(
                    error.abs() < allowed,
                    "{method:?}, noise {noise_hu}, slice {slice}: area off by {error}"
                );
            }
            assert!(found.report.slices_not_at_rest.is_empty());
        }
    }
}

#[test]
fn a_gap_in_the_border_does_not_leak() {
    // Two discs of the same tissue behind a wall of fat 5 mm thick, with a gap 5 mm wide in it.
    let grid = plain_grid([80, 50, 5], [1.5, 1.5, 1.5]);
    let disc = |p: DVec3, x: f64| 24e-3 - p.truncate().distance(DVec2::new(x, 36e-3));
    let bridge = |p: DVec3| 2.5e-3 - (p.y - 36e-3).abs();
    let ct = organ(&grid, 10.0, |p| {
        let discs = disc(p, 32e-3).max(disc(p, 85e-3));
        if (32e-3..85e-3).contains(&p.x) { discs.max(bridge(p)) } else { discs }
    });
    let params = ContourParams { seeds_m: vec![at_mm(&grid, [32.0, 36.0, 3.0])], ..ContourParams::default() };
    let found = segment_by_contours(&ct, &params).unwrap();
    let truth: Vec<bool> = (0..grid.n_voxels())
        .map(|v| disc(DVec3::from_array(grid.voxel(v).map(|x| x as f64)) * grid.spacing_m, 32e-3) > 0.0)
        .collect();
    let overlap = dice(&found.mask, &truth);
    assert!(overlap > 0.97, "Dice {overlap}");
}

#[test]
fn lobes_that_part_and_hang_down_are_followed() {
    // An arch: two legs joined above; the seed is in one leg, so the other is found on the way back.
    let grid = plain_grid([60, 40, 24], [1.5, 1.5, 2.0]);
    let depth = |p: DVec3| {
        let leg = |x: f64| (12e-3 - p.truncate().distance(DVec2::new(x, 30e-3))).min(p.z - 5e-3);
        let beam = (12e-3 - (p.y - 30e-3).abs()).min(29e-3 - (p.x - 45e-3).abs()).min(p.z - 30e-3);
        leg(28e-3).max(leg(62e-3)).max(beam).min(42e-3 - p.z)
    };
    let ct = organ(&grid, 10.0, depth);
    let params =
        ContourParams { seeds_m: vec![at_mm(&grid, [28.0, 30.0, 12.0])], ..ContourParams::default() };
    let found = segment_by_contours(&ct, &params).unwrap();
    assert_eq!(found.contours.iter().filter(|c| c.slice == 8).count(), 2, "two legs");
    assert_eq!(found.contours.iter().filter(|c| c.slice == 18).count(), 1, "one beam");
    let truth: Vec<bool> = (0..grid.n_voxels())
        .map(|v| depth(DVec3::from_array(grid.voxel(v).map(|x| x as f64)) * grid.spacing_m) > 0.0)
        .collect();
    let overlap = dice(&found.mask, &truth);
    assert!(overlap > 0.92, "Dice {overlap}");
    // The ends: no slice below or above the organ.
    assert!(found.contours.iter().all(|c| (2..=21).contains(&c.slice)));
}

#[test]
fn a_correction_by_hand_replaces_and_seeds_its_neighbours() {
    // Two columns of the same tissue that touch along their whole side: without help they are one organ.
    let grid = plain_grid([70, 44, 9], [1.5, 1.5, 1.5]);
    let ct = organ(&grid, 5.0, |p| {
        let disc = |x: f64| 20e-3 - p.truncate().distance(DVec2::new(x, 32e-3));
        disc(30e-3).max(disc(66e-3))
    });
    let seeds_m = vec![at_mm(&grid, [30.0, 32.0, 6.0])];
    let plain = ContourParams { seeds_m, ..ContourParams::default() };
    let expected = std::f64::consts::PI * 20e-3 * 20e-3;
    // Square drawn by hand in slice 4, where the seed is too.
    let square = mm(&[[22.0, 24.0], [38.0, 24.0], [38.0, 40.0], [22.0, 40.0]]);
    let corrections = vec![SliceContour { slice: 4, points_m: square.clone() }];
    let found = segment_by_contours(&ct, &ContourParams { corrections, ..plain.clone() }).unwrap();
    let in_slice: Vec<&SliceContour> = found.contours.iter().filter(|c| c.slice == 4).collect();
    assert_eq!(in_slice.len(), 1);
    assert_eq!(in_slice[0].points_m, square);
    let n = 70 * 44;
    let drawn = rasterised(&Plane::of(&grid), &[&square]);
    assert_eq!(found.mask[4 * n..5 * n], drawn[..], "the mask has what was drawn");
    for slice in [3, 5] {
        assert!(area_m2(&found, slice) > 0.95 * expected, "slice {slice} starts from the correction");
    }
    // An empty contour ends the organ: nothing is found beyond it.
    let corrections = vec![SliceContour { slice: 6, points_m: Vec::new() }];
    let found = segment_by_contours(&ct, &ContourParams { corrections, ..plain.clone() }).unwrap();
    assert!(found.contours.iter().all(|c| c.slice < 6));
    assert!(found.contours.iter().any(|c| c.slice == 5));
    // A correction away from the seed leads to what the seed does not reach.
    let other = mm(&[[58.0, 24.0], [74.0, 24.0], [74.0, 40.0], [58.0, 40.0]]);
    let gap = Volume {
        values: (0..grid.n_voxels())
            .map(|v| if (30..35).contains(&grid.voxel(v)[0]) { -90.0 } else { ct.values[v] })
            .collect(),
        grid: grid.clone(),
    };
    let alone = segment_by_contours(&gap, &plain).unwrap();
    assert_eq!(alone.contours.iter().filter(|c| c.slice == 1).count(), 1);
    let corrections = vec![SliceContour { slice: 7, points_m: other }];
    let both = segment_by_contours(&gap, &ContourParams { corrections, ..plain.clone() }).unwrap();
    assert_eq!(both.contours.iter().filter(|c| c.slice == 1).count(), 2);
    // What is no contour is refused.
    let refused = |slice: usize, points_m: Vec<DVec2>| {
        let corrections = vec![SliceContour { slice, points_m }];
        segment_by_contours(&ct, &ContourParams { corrections, ..plain.clone() }).unwrap_err()
    };
    assert_eq!(refused(9, square), ContourError::CorrectionOutside { slice: 9, last: 8 });
    assert_eq!(
        refused(2, mm(&[[1.0, 1.0], [2.0, f64::NAN]])),
        ContourError::CorrectionNotAContour { slice: 2, n_points: 2, n_finite: 1 }
    );
}

// ---- The synthetic patient ---------------------------------------------------------------------------

fn coarse(seed: u64, noise_hu: f64) -> Phantom {
    generate(&PhantomParams { seed, voxel_m: 3e-3, noise_hu, ..PhantomParams::default() })
}

#[test]
fn the_liver_is_found_by_contours() {
    let canny = EdgeMethod::Canny { sigma_m: 1e-3 };
    let deriche = EdgeMethod::Deriche { decay_length_m: 1.2e-3 };
    for (seed, noise_hu, edges) in [(1, 20.0, canny), (2, 10.0, deriche), (3, 20.0, canny)] {
        let patient = coarse(seed, noise_hu);
        let grid = &patient.ct.grid;
        let truth = patient.labels.mask(&patient.labels.select("liver", Parts::Included).unwrap());
        let found =
            segment_by_contours(&patient.ct, &ContourParams { edges, ..ContourParams::default() }).unwrap();
        let overlap = dice(&found.mask, &truth);
        assert!(overlap >= 0.96, "seed {seed}, noise {noise_hu}: Dice {overlap}");
        let far_m = hausdorff_95_m(grid, &found.mask, &truth).unwrap();
        assert!(far_m <= 6.001e-3, "seed {seed}, noise {noise_hu}: 95 % within {far_m} m");
        assert_eq!(solid_euler_characteristic(grid, &found.mask), Ok(1));
        assert!((found.level.level_hu - 110.0).abs() < 8.0, "{:?}", found.level);
        assert!((found.level.noise_hu - noise_hu).abs() < 0.3 * noise_hu, "{:?}", found.level);
    }
}

#[test]
fn contours_have_the_same_bits_at_any_thread_count() {
    let patient = generate(&PhantomParams { voxel_m: 4.5e-3, ..PhantomParams::default() });
    for edges in [EdgeMethod::Canny { sigma_m: 1e-3 }, EdgeMethod::Deriche { decay_length_m: 1.2e-3 }] {
        let params = ContourParams { edges, ..ContourParams::default() };
        let with_threads = |n| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(n).build().unwrap();
            pool.install(|| segment_by_contours(&patient.ct, &params).unwrap())
        };
        assert_eq!(with_threads(1), with_threads(3));
    }
}

#[test]
fn contours_refuse_seeds_in_the_wrong_place() {
    let patient = generate(&PhantomParams { voxel_m: 6e-3, ..PhantomParams::default() });
    let at = |x: f64, y: f64, z: f64| {
        let seeds_m = vec![DVec3::new(x, y, z) * 1e-3];
        segment_by_contours(&patient.ct, &ContourParams { seeds_m, ..ContourParams::default() }).unwrap_err()
    };
    assert!(matches!(at(-900.0, 0.0, 0.0), ContourError::Seed(SegmentError::SeedOutside { .. })));
    assert!(matches!(at(f64::NAN, 0.0, 0.0), ContourError::Seed(SegmentError::SeedOutside { .. })));
    assert!(matches!(at(-188.0, -105.0, 0.0), ContourError::Seed(SegmentError::SeedNotSoftTissue { .. })));
    let air = Volume { values: vec![-1000.0; patient.ct.grid.n_voxels()], grid: patient.ct.grid.clone() };
    let error = segment_by_contours(&air, &ContourParams::default()).unwrap_err();
    assert!(matches!(error, ContourError::Seed(SegmentError::NoSeed { .. })), "{error}");
    // A speck of tissue holds no contour.
    let grid = plain_grid([30, 30, 5], [1.5; 3]);
    let speck = organ(&grid, 0.0, |p| 3e-3 - p.distance(DVec3::new(21e-3, 21e-3, 3e-3)));
    let seeds_m = vec![at_mm(&grid, [21.0, 21.0, 3.0])];
    let params = ContourParams { seeds_m, statistics_radius_m: 1e-3, ..ContourParams::default() };
    let error = segment_by_contours(&speck, &params).unwrap_err();
    assert!(matches!(error, ContourError::NothingFound { .. }), "{error}");
}
