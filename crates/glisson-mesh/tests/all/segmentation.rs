//! Finding organs by seeds inside and outside, with a geodesic active contour.

use glisson_mesh::image::labels::{Parts, dice, hausdorff_95_m};
use glisson_mesh::image::phantom::{Phantom, PhantomParams, generate};
use glisson_mesh::image::resample::{VoxelBox, block_means, steps_for};
use glisson_mesh::image::segment::{SeededParams, Seeds, SegmentError, segment_with_seeds};
use glisson_mesh::image::topology::solid_euler_characteristic;
use glisson_mesh::image::{Volume, VoxelGrid};
use glisson_mesh::math::{DVec3, SeededRandom};

use crate::sample_images::plain_grid;

fn patient(seed: u64, noise_hu: f64) -> Phantom {
    generate(&PhantomParams { seed, noise_hu, voxel_m: 3e-3, ..PhantomParams::default() })
}

fn liver_of(patient: &Phantom) -> Vec<bool> {
    patient.labels.mask(&patient.labels.select("liver", Parts::Included).unwrap())
}

#[test]
fn the_liver_is_found_at_any_noise() {
    for (seed, noise_hu) in [(1, 10.0), (3, 10.0), (2, 20.0), (4, 40.0)] {
        let patient = patient(seed, noise_hu);
        let grid = &patient.ct.grid;
        let found = segment_with_seeds(&patient.ct, &Seeds::default(), &SeededParams::default()).unwrap();
        let truth = liver_of(&patient);
        let overlap = dice(&found.mask, &truth);
        let far_m = hausdorff_95_m(grid, &found.mask, &truth).unwrap();
        assert!(overlap >= 0.96, "seed {seed}, noise {noise_hu}: Dice {overlap}");
        assert!(
            far_m <= 6e-3 * (1.0 + 1e-6),
            "seed {seed}, noise {noise_hu}: {far_m} m is more than 2 voxels"
        );
        assert_eq!(solid_euler_characteristic(grid, &found.mask), Ok(1));
    }
}

/// Two blocks of soft tissue in fat, of the levels given [HU], joined by a bridge; and a lobe that stands alone.
fn blocks(bridge: usize, other_hu: f32, lobe_hu: f32) -> Volume<f32> {
    let grid = plain_grid([70, 30, 30], [2.0, 2.0, 2.0]);
    let mut random = SeededRandom::new(4);
    let middle = 15 - bridge / 2..15 - bridge / 2 + bridge;
    let values = (0..grid.n_voxels())
        .map(|index| {
            let [i, j, k] = grid.voxel(index);
            let within = |low: usize, high: usize| {
                (5..25).contains(&j) && (5..25).contains(&k) && (low..high).contains(&i)
            };
            let level = if within(4, 24) {
                100.0
            } else if within(30, 50) {
                other_hu
            } else if (24..30).contains(&i) && middle.contains(&j) && middle.contains(&k) {
                100.0
            } else if within(56, 66) {
                lobe_hu
            } else {
                -100.0
            };
            level + 8.0 * random.normal() as f32
        })
        .collect();
    Volume { grid, values }
}

fn at(grid: &VoxelGrid, voxel: [f64; 3]) -> DVec3 {
    grid.position_m(DVec3::from_array(voxel))
}

fn share(mask: &[bool], grid: &VoxelGrid, i: std::ops::Range<usize>) -> f64 {
    let inside = |index: &usize| {
        let [x, y, z] = grid.voxel(*index);
        i.contains(&x) && (5..25).contains(&y) && (5..25).contains(&z)
    };
    let all: Vec<usize> = (0..mask.len()).filter(inside).collect();
    all.iter().filter(|&&index| mask[index]).count() as f64 / all.len() as f64
}

#[test]
fn a_seed_outside_parts_what_a_bridge_joins() {
    let image = blocks(10, 100.0, 100.0);
    let grid = &image.grid;
    let [first, second] = [at(grid, [14.0, 15.0, 15.0]), at(grid, [40.0, 15.0, 15.0])];
    let params = SeededParams::default();
    let both =
        segment_with_seeds(&image, &Seeds { inside_m: vec![first], outside_m: vec![] }, &params).unwrap();
    assert!(
        share(&both.mask, grid, 4..24) > 0.9 && share(&both.mask, grid, 30..50) > 0.9,
        "a wide bridge joins"
    );
    let parted =
        segment_with_seeds(&image, &Seeds { inside_m: vec![first], outside_m: vec![second] }, &params)
            .unwrap();
    let (own, other) = (share(&parted.mask, grid, 4..24), share(&parted.mask, grid, 30..50));
    assert!(own > 0.9, "{own} of the organ");
    assert!(other < 0.02, "{other} of what was barred");
    // The other way round too.
    let turned =
        segment_with_seeds(&image, &Seeds { inside_m: vec![second], outside_m: vec![first] }, &params)
            .unwrap();
    assert!(share(&turned.mask, grid, 30..50) > 0.9 && share(&turned.mask, grid, 4..24) < 0.02);
}

#[test]
fn a_second_seed_inside_adds_a_part_of_another_level() {
    // Joined by a thick bridge, but too dark for the band of the first seed.
    let image = blocks(14, 60.0, 100.0);
    let grid = &image.grid;
    let [first, second] = [at(grid, [14.0, 15.0, 15.0]), at(grid, [40.0, 15.0, 15.0])];
    let params = SeededParams::default();
    let alone =
        segment_with_seeds(&image, &Seeds { inside_m: vec![first], outside_m: vec![] }, &params).unwrap();
    assert!(share(&alone.mask, grid, 33..50) < 0.02);
    let both =
        segment_with_seeds(&image, &Seeds { inside_m: vec![first, second], outside_m: vec![] }, &params)
            .unwrap();
    let [own, added] = [share(&both.mask, grid, 4..24), share(&both.mask, grid, 30..50)];
    assert!(own > 0.9 && added > 0.85, "{own} and {added}");
}

#[test]
fn seeds_of_both_kinds_in_one_place_are_refused() {
    let image = blocks(10, 100.0, 100.0);
    let [a, b] = [at(&image.grid, [14.0, 15.0, 15.0]), at(&image.grid, [16.0, 15.0, 15.0])];
    let seeds = Seeds { inside_m: vec![a], outside_m: vec![b] };
    let Err(error) = segment_with_seeds(&image, &seeds, &SeededParams::default()) else { panic!("found") };
    assert!(matches!(error, SegmentError::SeedsTooClose { .. }), "{error}");
    let far = Seeds { inside_m: vec![DVec3::splat(9.0)], outside_m: vec![] };
    let Err(error) = segment_with_seeds(&image, &far, &SeededParams::default()) else { panic!("found") };
    assert!(matches!(error, SegmentError::SeedOutside { .. }), "{error}");
    // A seed in fat bars nothing.
    let fat = Seeds { inside_m: vec![a], outside_m: vec![at(&image.grid, [27.0, 2.0, 2.0])] };
    assert!(segment_with_seeds(&image, &fat, &SeededParams::default()).is_ok());
}

#[test]
fn the_contour_is_the_same_at_any_thread_count() {
    let image = blocks(10, 100.0, 100.0);
    let seeds = Seeds {
        inside_m: vec![at(&image.grid, [14.0, 15.0, 15.0])],
        outside_m: vec![at(&image.grid, [40.0, 15.0, 15.0])],
    };
    let with_threads = |n| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(n).build().unwrap();
        pool.install(|| segment_with_seeds(&image, &seeds, &SeededParams::default()).unwrap())
    };
    assert_eq!(with_threads(1), with_threads(3));
}

#[test]
fn the_hausdorff_distance_is_that_of_shifted_boxes() {
    let grid = plain_grid([30, 20, 10], [1.0, 2.0, 3.0]);
    let block = |i: usize| -> Vec<bool> {
        (0..grid.n_voxels())
            .map(|index| {
                let [x, y, z] = grid.voxel(index);
                (i..i + 10).contains(&x) && (3..17).contains(&y) && (2..8).contains(&z)
            })
            .collect()
    };
    assert_eq!(hausdorff_95_m(&grid, &block(4), &block(4)), Some(0.0));
    let far_m = hausdorff_95_m(&grid, &block(4), &block(9)).unwrap();
    assert!((far_m - 5e-3).abs() < 1e-9, "{far_m}");
    assert_eq!(hausdorff_95_m(&grid, &block(4), &vec![false; grid.n_voxels()]), None);
}

#[test]
fn parts_and_coarser_copies_lie_where_they_belong() {
    let grid = plain_grid([13, 9, 7], [1.0, 1.5, 2.0]);
    let slope = DVec3::new(3e3, -2e3, 5e3);
    let values: Vec<f32> = (0..grid.n_voxels()).map(|i| slope.dot(grid.center_m(i)) as f32).collect();
    let image = Volume { grid, values };
    let coarse = block_means(&image, steps_for(&image.grid, 3e-3));
    assert_eq!(coarse.grid.dims, [5, 5, 4]);
    // Whole blocks of a linear image have the value at their middle.
    for index in 0..coarse.grid.n_voxels() {
        if coarse.grid.voxel(index).into_iter().zip([4, 4, 3]).all(|(v, whole)| v < whole) {
            let expected = slope.dot(coarse.grid.center_m(index)) as f32;
            assert!((coarse.values[index] - expected).abs() < 1e-3, "{index}");
        }
    }
    let between = DVec3::new(3.3, 4.6, 2.2);
    let expected = slope.dot(image.grid.position_m(between));
    assert!((image.value_at(image.grid.position_m(between)) - expected).abs() < 1e-3);
    let mut mask = vec![false; image.grid.n_voxels()];
    mask[image.grid.index([4, 3, 2])] = true;
    mask[image.grid.index([6, 5, 3])] = true;
    let part = VoxelBox::around(&image.grid, &mask, 1.5e-3).unwrap();
    assert_eq!(part, VoxelBox { first: [2, 2, 1], dims: [7, 5, 4] });
    let inside = part.cut(&image.grid, &image.values);
    assert_eq!(part.grid(&image.grid).center_m(1), image.grid.center_m(image.grid.index([3, 2, 1])));
    let mut pasted = image.values.clone();
    part.paste(&image.grid, &inside, &mut pasted);
    assert_eq!(pasted, image.values);
    assert!(VoxelBox::around(&image.grid, &vec![false; mask.len()], 1e-3).is_none());
}
