//! Parting what hangs together but has seeds of the organ and of other tissue.

use std::cmp::Reverse;
use std::collections::{BTreeSet, BinaryHeap};

use crate::image::VoxelGrid;
use crate::image::filter::{self, Connectivity};

/// Radii of erosion that are tried, one after the other, to part the seeds [m].
const RADII_M: [f64; 10] = [2e-3, 3e-3, 4e-3, 5e-3, 6e-3, 7e-3, 8e-3, 10e-3, 12e-3, 15e-3];

/// Voxels of seeds.
pub(super) struct SeedVoxels {
    pub(super) inside: Vec<usize>,
    pub(super) outside: Vec<usize>,
}

/// Which voxels of `mask` belong to the seeds outside the organ.
///
/// The mask is eroded just so far that no piece has seeds of both kinds; the pieces grow back, each voxel going to
/// the one from which the way is shortest. A difference of `edge_hu` between neighbours makes a way e times as
/// long. Pieces outside grow back by what was eroded and half as much again, so that a seed outside takes
/// what is around it and not a lobe that has no seed of its own.
pub(super) fn belongs_outside(
    grid: &VoxelGrid,
    mask: &[bool],
    smooth: &[f32],
    seeds: &SeedVoxels,
    edge_hu: f32,
) -> Vec<bool> {
    let (sources, radius_m) = part(grid, mask, seeds);
    let reach_um = (1e6 * (1.5 * radius_m + 2e-3)) as u64;
    let mut nearest = vec![(u64::MAX, false); mask.len()];
    let mut front = BinaryHeap::new();
    for (voxels, outside) in [(&sources.inside, false), (&sources.outside, true)] {
        for &index in voxels {
            nearest[index] = (0, outside);
            front.push(Reverse((0, index)));
        }
    }
    let (dims, step) = (grid.dims, [1, grid.dims[0], grid.dims[0] * grid.dims[1]]);
    let length_um = grid.spacing_m.to_array().map(|s| (s * 1e6) as f32);
    while let Some(Reverse((way_um, index))) = front.pop() {
        let (best_um, outside) = nearest[index];
        if way_um > best_um {
            continue;
        }
        let voxel = grid.voxel(index);
        for axis in 0..3 {
            let before = (voxel[axis] > 0).then(|| index - step[axis]);
            let after = (voxel[axis] + 1 < dims[axis]).then(|| index + step[axis]);
            for next in before.into_iter().chain(after).filter(|&next| mask[next]) {
                let edge = ((smooth[next] - smooth[index]).abs() / edge_hu).min(5.0);
                let way_um = way_um + (length_um[axis] * libm::expf(edge)) as u64;
                if way_um < nearest[next].0 && (!outside || way_um < reach_um) {
                    nearest[next] = (way_um, outside);
                    front.push(Reverse((way_um, next)));
                }
            }
        }
    }
    nearest.into_iter().map(|(way_um, outside)| outside && way_um < u64::MAX).collect()
}

/// The seeds with the pieces of the eroded mask they lie in, and the radius of erosion [m] that parted them.
fn part(grid: &VoxelGrid, mask: &[bool], seeds: &SeedVoxels) -> (SeedVoxels, f64) {
    let around: Vec<bool> = mask.iter().map(|m| !m).collect();
    let depth2 = filter::distance_squared_m2(grid, &around);
    for radius_m in RADII_M {
        let eroded: Vec<bool> = depth2.iter().map(|&d| f64::from(d) > radius_m * radius_m).collect();
        let found = filter::components(grid, &eroded, Connectivity::Faces);
        let pieces_of = |voxels: &[usize]| -> BTreeSet<u32> {
            voxels.iter().map(|&index| found.piece[index]).filter(|&piece| piece > 0).collect()
        };
        let (inside, outside) = (pieces_of(&seeds.inside), pieces_of(&seeds.outside));
        if inside.is_disjoint(&outside) {
            let with_pieces = |pieces: &BTreeSet<u32>, voxels: &[usize]| {
                let in_pieces = (0..eroded.len()).filter(|&i| pieces.contains(&found.piece[i]));
                in_pieces.chain(voxels.iter().copied()).collect()
            };
            let parted = SeedVoxels {
                inside: with_pieces(&inside, &seeds.inside),
                outside: with_pieces(&outside, &seeds.outside),
            };
            return (parted, radius_m);
        }
    }
    let alone = SeedVoxels { inside: seeds.inside.clone(), outside: seeds.outside.clone() };
    (alone, RADII_M[RADII_M.len() - 1])
}
