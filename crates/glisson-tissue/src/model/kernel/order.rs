//! Order in space: tetrahedra along a Hilbert curve, cut into parts that each touch few nodes.
//!
//! The curve: J. Skilling, Programming the Hilbert curve, AIP Conf. Proc. 707 (2004), doi:10.1063/1.1751381.

use super::rows::MOST_ROWS;
use glisson_mesh::math::DVec3;
use glisson_mesh::mesh::{NodeId, TetId, TetMesh};

/// Cells of the curve along each axis, as a power of two: finer than any mesh that fits in memory.
const CURVE_BITS: u32 = 16;
/// Tetrahedra in a part at most: displacements and forces of its nodes together stay in a first-level cache.
const MOST_TETS: usize = 2048;
/// Smaller meshes are also divided into this many parts, so that several threads have work ...
const LEAST_PARTS: usize = 4;
/// ... unless parts would become smaller than this.
const LEAST_TETS: usize = 128;

/// Place along the Hilbert curve of a cell; each coordinate below 2^[`CURVE_BITS`].
fn hilbert_key(mut x: [u32; 3]) -> u64 {
    let top = 1 << (CURVE_BITS - 1);
    let mut q = top;
    while q > 1 {
        let below = q - 1;
        for i in 0..3 {
            if x[i] & q != 0 {
                x[0] ^= below;
            } else {
                let swap = (x[0] ^ x[i]) & below;
                x[0] ^= swap;
                x[i] ^= swap;
            }
        }
        q >>= 1;
    }
    x[1] ^= x[0];
    x[2] ^= x[1];
    let mut flip = 0;
    q = top;
    while q > 1 {
        if x[2] & q != 0 {
            flip ^= q - 1;
        }
        q >>= 1;
    }
    let mut key = 0;
    for bit in (0..CURVE_BITS).rev() {
        for axis in x {
            key = key << 1 | u64::from((axis ^ flip) >> bit & 1);
        }
    }
    key
}

/// The live tetrahedra in the order of their centroids along the curve; equal places in the order of their ids.
fn sorted_tets(mesh: &TetMesh, is_live: &[bool]) -> Vec<TetId> {
    let centroid = |t: TetId| mesh.corners_m(t).into_iter().sum::<DVec3>() / 4.0;
    let all = || (0..mesh.tetrahedra.len()).filter(|&t| is_live[t]).map(TetId::from_index);
    let low = all().map(centroid).fold(DVec3::INFINITY, DVec3::min);
    let high = all().map(centroid).fold(DVec3::NEG_INFINITY, DVec3::max);
    let scale = f64::from((1_u32 << CURVE_BITS) - 1) / (high - low).max_element().max(f64::MIN_POSITIVE);
    let mut keyed: Vec<(u64, TetId)> = all()
        .map(|t| {
            let cell = (centroid(t) - low) * scale;
            (hilbert_key(cell.to_array().map(|c| c as u32)), t)
        })
        .collect();
    keyed.sort_unstable();
    keyed.into_iter().map(|(_, t)| t).collect()
}

/// Place of a node's row or a tetrahedron: a part and an index in it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Place {
    pub(super) part: u32,
    pub(super) index: u32,
}

/// A part of the mesh: consecutive tetrahedra of the curve and the nodes that no earlier part touches.
#[derive(Clone, Debug, Default)]
pub(super) struct PartPlan {
    pub(super) tets: Vec<TetId>,
    /// Nodes that this part is the first to touch, in the order in which it does.
    pub(super) own: Vec<NodeId>,
    /// Nodes of earlier parts that its tetrahedra touch, ascending by part and place.
    pub(super) borrowed: Vec<NodeId>,
}

/// The parts of the live tetrahedra of a mesh, and the place of each node's own row; `None` for nodes without a tetrahedron.
///
/// The number of parts depends on the mesh only. Every node of every tetrahedron must exist.
pub(super) fn partition(mesh: &TetMesh, is_live: &[bool]) -> (Vec<PartPlan>, Vec<Option<Place>>) {
    let n_nodes = mesh.positions_m.len();
    let n_tets = is_live.iter().filter(|live| **live).count();
    let target = n_tets.div_ceil(LEAST_PARTS).next_multiple_of(8).clamp(LEAST_TETS, MOST_TETS);
    let mut places: Vec<Option<Place>> = vec![None; n_nodes];
    // The last part that touched a node, counted from 1.
    let mut touched_by = vec![0_usize; n_nodes];
    let mut parts = vec![PartPlan::default()];
    for tet in sorted_tets(mesh, is_live) {
        let nodes = mesh.tetrahedra[tet.index()];
        let part = parts.last().expect("there is always one");
        let n_new = nodes.iter().filter(|n| touched_by[n.index()] != parts.len()).count();
        if part.tets.len() == target || part.own.len() + part.borrowed.len() + n_new > MOST_ROWS {
            parts.push(PartPlan::default());
        }
        let number = parts.len();
        let part = parts.last_mut().expect("there is always one");
        part.tets.push(tet);
        for node in nodes {
            let n = node.index();
            if touched_by[n] == number {
                continue;
            }
            touched_by[n] = number;
            if places[n].is_some() {
                part.borrowed.push(node);
            } else {
                let place = |i: usize| u32::try_from(i).expect("parts are small");
                places[n] = Some(Place { part: place(number - 1), index: place(part.own.len()) });
                part.own.push(node);
            }
        }
    }
    for part in &mut parts {
        part.borrowed.sort_unstable_by_key(|n| places[n.index()].map(|p| (p.part, p.index)));
    }
    (parts, places)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Every cell of the 4x4x4 corner once, each step to a neighbour: a Hilbert curve.
    #[test]
    fn the_curve_visits_every_cell_and_never_jumps() {
        let mut cells: Vec<(u64, [u32; 3])> = (0..64)
            .map(|i| [i & 3, i >> 2 & 3, i >> 4])
            .map(|cell: [u32; 3]| (hilbert_key(cell), cell))
            .collect();
        cells.sort_unstable();
        for (i, pair) in cells.windows(2).enumerate() {
            let jump: u32 = (0..3).map(|a| pair[0].1[a].abs_diff(pair[1].1[a])).sum();
            assert_eq!(jump, 1, "step {i}");
            assert_eq!(pair[1].0, pair[0].0 + 1);
        }
    }

    #[test]
    fn parts_of_disjoint_tetrahedra_hold_at_most_their_rows() {
        let mut mesh = TetMesh::default();
        for t in 0..900_u32 {
            let corner = DVec3::new(f64::from(t % 30), f64::from(t / 30), 0.0);
            let first = 4 * t;
            mesh.positions_m.extend([DVec3::ZERO, DVec3::X, DVec3::Y, DVec3::Z].map(|e| corner + 0.5 * e));
            mesh.tetrahedra.push([0, 1, 2, 3].map(|i| NodeId(first + i)));
        }
        let (parts, places) = partition(&mesh, &[true; 900]);
        assert!(parts.iter().all(|p| p.own.len() + p.borrowed.len() <= MOST_ROWS));
        assert_eq!(parts.iter().map(|p| p.tets.len()).sum::<usize>(), 900);
        assert_eq!(parts.iter().map(|p| p.own.len()).sum::<usize>(), 3600);
        assert!(places.iter().all(Option::is_some));
    }
}
