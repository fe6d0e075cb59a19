//! Voxel topology, extraction, checks and files of surfaces.

use glisson::image::VoxelGrid;
use glisson::image::topology::{
    TopologyError, TopologyRepair, is_well_composed, repair_to_ball, solid_euler_characteristic,
};
use glisson::math::{DMat3, DVec3, SeededRandom};
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
