//! Zones chosen by region or by graph, and zones merged.
//!
//! By graph: the tetrahedra are halved across the principal axis of their centroids, the cut is improved, and both
//! halves are divided further. The improvement moves single tetrahedra as in C. M. Fiduccia and R. M. Mattheyses,
//! "A linear-time heuristic for improving network partitions", 1982, doi 10.1109/DAC.1982.1585498: tetrahedra are
//! the cells and nodes the nets, so that the number of cut nets is the number of frontier nodes, on which cost and
//! storage of a hybrid model depend. Ties go to the lower number: the result depends on the mesh alone.

use std::collections::BTreeSet;

use super::{Zones, ZonesError};
use crate::math::DVec3;
use crate::mesh::{TetId, TetMesh};

/// Share of the tetrahedra by which a part may differ from its fair size in one bisection: a choice.
const IMBALANCE: f64 = 0.03;
/// Passes of the improvement at most; it ends before when a pass gains nothing.
const MOST_PASSES: usize = 8;
/// A pass ends after this share of the tetrahedra has moved without a new best cut, and at least so many.
const PATIENCE_SHARE: f64 = 0.05;
const LEAST_PATIENCE: usize = 64;

impl Zones {
    /// Zones by region: `zone_at` says the zone of each tetrahedron from its centroid [m].
    ///
    /// # Errors
    /// [`ZonesError::EmptyZone`] when a number up to the highest one is never given.
    pub fn by_place(mesh: &TetMesh, zone_at: impl FnMut(DVec3) -> u32) -> Result<Self, ZonesError> {
        Self::new(mesh, centroids_m(mesh).map(zone_at).collect())
    }

    /// `n_zones` zones of nearly equal numbers of tetrahedra with few frontier nodes.
    ///
    /// # Errors
    /// [`ZonesError::Count`] for no zone, or for more zones than tetrahedra.
    pub fn by_graph(mesh: &TetMesh, n_zones: usize) -> Result<Self, ZonesError> {
        let n_tets = mesh.tetrahedra.len();
        if n_zones == 0 || n_zones > n_tets {
            return Err(ZonesError::Count { n_zones, n_tets });
        }
        let centroids_m: Vec<DVec3> = centroids_m(mesh).collect();
        let mut of_tet = vec![0; n_tets];
        let mut waiting = vec![((0..n_tets as u32).collect::<Vec<u32>>(), 0, n_zones)];
        while let Some((tets, first_zone, n_parts)) = waiting.pop() {
            if n_parts == 1 {
                tets.iter().for_each(|&t| of_tet[t as usize] = first_zone as u32);
                continue;
            }
            let n_lower = n_parts / 2;
            let [lower, upper] = bisected(mesh, &centroids_m, tets, [n_lower, n_parts - n_lower]);
            waiting.push((lower, first_zone, n_lower));
            waiting.push((upper, first_zone + n_lower, n_parts - n_lower));
        }
        Self::new(mesh, of_tet)
    }

    /// The same tetrahedra with zone `z` renamed to `new_zone[z]`; zones of the same new number are one.
    ///
    /// # Errors
    /// [`ZonesError::Length`] when `new_zone` has another length than the zones, [`ZonesError::EmptyZone`] for a
    /// number that is skipped.
    pub fn merged(&self, mesh: &TetMesh, new_zone: &[u32]) -> Result<Self, ZonesError> {
        let (found, expected) = (new_zone.len(), self.n_zones());
        if found != expected {
            return Err(ZonesError::Length { found, expected });
        }
        Self::new(mesh, self.of_tet.iter().map(|&z| new_zone[z as usize]).collect())
    }

    /// Merges the zones that `is_merged` marks wherever they share a node; numbers close up, ascending by the
    /// lowest zone of each group. Returns the zones and the new number of each old one.
    ///
    /// # Errors
    /// As [`Zones::merged`].
    pub fn merged_where_touching(
        &self,
        mesh: &TetMesh,
        is_merged: &[bool],
    ) -> Result<(Self, Vec<u32>), ZonesError> {
        let (found, expected) = (is_merged.len(), self.n_zones());
        if found != expected {
            return Err(ZonesError::Length { found, expected });
        }
        let mut group: Vec<u32> = (0..expected as u32).collect();
        for &node in &self.frontier_nodes {
            let merged: Vec<u32> =
                self.zones_of_node(node).iter().copied().filter(|&z| is_merged[z as usize]).collect();
            let Some(lowest) = merged.iter().map(|&z| group[z as usize]).min() else { continue };
            let joined: Vec<u32> = merged.iter().map(|&z| group[z as usize]).collect();
            group.iter_mut().filter(|g| joined.contains(g)).for_each(|g| *g = lowest);
        }
        let mut numbers: Vec<u32> = group.clone();
        numbers.sort_unstable();
        numbers.dedup();
        let new_zone: Vec<u32> =
            group.iter().map(|g| numbers.partition_point(|number| number < g) as u32).collect();
        Ok((self.merged(mesh, &new_zone)?, new_zone))
    }

    /// Zones that share a node with `zone`, ascending.
    pub fn neighbours(&self, zone: usize) -> Vec<usize> {
        let shared = self.frontier(zone).iter().flat_map(|&node| self.zones_of_node(node));
        let mut neighbours: Vec<usize> = shared.map(|&z| z as usize).filter(|&z| z != zone).collect();
        neighbours.sort_unstable();
        neighbours.dedup();
        neighbours
    }
}

fn centroids_m(mesh: &TetMesh) -> impl Iterator<Item = DVec3> + '_ {
    (0..mesh.tetrahedra.len()).map(|t| mesh.corners_m(TetId::from_index(t)).into_iter().sum::<DVec3>() * 0.25)
}

/// Direction in which points spread most: power iteration on their covariance, which converges where the spread
/// has one largest direction and gives one of several equal ones elsewhere.
fn principal_axis(points_m: &[DVec3]) -> DVec3 {
    let mean_m = points_m.iter().sum::<DVec3>() / points_m.len().max(1) as f64;
    let covariance =
        |axis: DVec3| points_m.iter().map(|&p| (p - mean_m) * (p - mean_m).dot(axis)).sum::<DVec3>();
    // No direction of symmetry, so that it is not orthogonal to the wanted one.
    let mut axis = DVec3::new(1.0, 0.7, 0.4).normalize();
    for _ in 0..60 {
        axis = covariance(axis).try_normalize().unwrap_or(axis);
    }
    axis
}

/// Two parts of `tets` with sizes in the given ratio.
fn bisected(mesh: &TetMesh, centroids_m: &[DVec3], mut tets: Vec<u32>, ratio: [usize; 2]) -> [Vec<u32>; 2] {
    let points_m: Vec<DVec3> = tets.iter().map(|&t| centroids_m[t as usize]).collect();
    let axis = principal_axis(&points_m);
    let along = |t: u32| centroids_m[t as usize].dot(axis);
    tets.sort_unstable_by(|&a, &b| along(a).total_cmp(&along(b)).then(a.cmp(&b)));
    // Every part must still give each of its zones a tetrahedron.
    let n = tets.len();
    let n_lower = (n * ratio[0] / (ratio[0] + ratio[1])).clamp(ratio[0], n - ratio[1]);
    let mut is_upper: Vec<bool> = (0..n).map(|place| place >= n_lower).collect();
    let slack = (IMBALANCE * n as f64) as usize;
    let least =
        [n_lower.saturating_sub(slack).max(ratio[0]), (n - n_lower).saturating_sub(slack).max(ratio[1])];
    Cut::new(mesh, &tets).improve(&mut is_upper, least);
    let part = |upper: bool| {
        let mut part: Vec<u32> =
            tets.iter().zip(&is_upper).filter(|(_, is)| **is == upper).map(|(&t, _)| t).collect();
        part.sort_unstable();
        part
    };
    [part(false), part(true)]
}

/// Nodes (nets) and tetrahedra (cells) of a part that is to be halved.
struct Cut {
    /// Nets of each cell.
    nets: Vec<[u32; 4]>,
    cells_start: Vec<u32>,
    cells: Vec<u32>,
}

impl Cut {
    fn new(mesh: &TetMesh, tets: &[u32]) -> Self {
        let mut net_of = vec![u32::MAX; mesh.positions_m.len()];
        let mut n_nets = 0;
        let mut net = |node: usize| {
            if net_of[node] == u32::MAX {
                net_of[node] = n_nets;
                n_nets += 1;
            }
            net_of[node]
        };
        let nets: Vec<[u32; 4]> =
            tets.iter().map(|&t| mesh.tetrahedra[t as usize].map(|node| net(node.index()))).collect();
        let mut cells_start = vec![0; n_nets as usize + 1];
        nets.iter().flatten().for_each(|&net| cells_start[net as usize + 1] += 1);
        for net in 0..n_nets as usize {
            cells_start[net + 1] += cells_start[net];
        }
        let mut next = cells_start.clone();
        let mut cells = vec![0; 4 * nets.len()];
        for (cell, nets) in nets.iter().enumerate() {
            for &net in nets {
                cells[next[net as usize] as usize] = cell as u32;
                next[net as usize] += 1;
            }
        }
        Self { nets, cells_start, cells }
    }

    fn cells_of(&self, net: u32) -> &[u32] {
        &self.cells[self.cells_start[net as usize] as usize..self.cells_start[net as usize + 1] as usize]
    }

    /// Cut nets that fewer there are after a cell changes its side.
    fn gain(&self, cell: usize, is_upper: bool, on_side: &[[u32; 2]]) -> i32 {
        let (from, to) = (usize::from(is_upper), usize::from(!is_upper));
        let of_net = |net: &u32| {
            let counts = on_side[*net as usize];
            i32::from(counts[from] == 1 && counts[to] > 0) - i32::from(counts[to] == 0 && counts[from] > 1)
        };
        self.nets[cell].iter().map(of_net).sum()
    }

    /// Moves cells as long as passes find fewer cut nets; each side keeps at least `least` cells.
    fn improve(&self, is_upper: &mut [bool], least: [usize; 2]) {
        let n = is_upper.len();
        let patience = LEAST_PATIENCE.max((PATIENCE_SHARE * n as f64) as usize);
        for _ in 0..MOST_PASSES {
            if self.pass(is_upper, least, patience) <= 0 {
                break;
            }
        }
    }

    /// One pass: every cell moves at most once, the best gain first; what came after the best cut is undone.
    /// Returns the number of cut nets won.
    fn pass(&self, is_upper: &mut [bool], least: [usize; 2], patience: usize) -> i32 {
        let mut on_side = vec![[0_u32; 2]; self.cells_start.len() - 1];
        let mut size = [0_usize; 2];
        for (cell, &upper) in is_upper.iter().enumerate() {
            size[usize::from(upper)] += 1;
            self.nets[cell].iter().for_each(|&net| on_side[net as usize][usize::from(upper)] += 1);
        }
        let mut gains: Vec<i32> =
            (0..is_upper.len()).map(|cell| self.gain(cell, is_upper[cell], &on_side)).collect();
        // Cells of each side by falling gain, then by number. Those inside a side are not worth keeping.
        let is_at_cut = |gain: i32| gain > -4;
        let mut ready = [BTreeSet::new(), BTreeSet::new()];
        for (cell, &gain) in gains.iter().enumerate().filter(|(_, gain)| is_at_cut(**gain)) {
            ready[usize::from(is_upper[cell])].insert((-gain, cell));
        }
        let mut has_moved = vec![false; is_upper.len()];
        let mut moves = Vec::new();
        let (mut won, mut best, mut n_best) = (0, 0, 0);
        while moves.len() < n_best + patience {
            let candidate = |side: usize| ready[side].first().copied().filter(|_| size[side] > least[side]);
            let Some((cost, cell)) = [0, 1].into_iter().filter_map(candidate).min() else { break };
            let from = usize::from(is_upper[cell]);
            ready[from].remove(&(cost, cell));
            has_moved[cell] = true;
            is_upper[cell] = !is_upper[cell];
            size[from] -= 1;
            size[1 - from] += 1;
            for &net in &self.nets[cell] {
                on_side[net as usize][from] -= 1;
                on_side[net as usize][1 - from] += 1;
            }
            won -= cost;
            moves.push(cell);
            if won > best {
                (best, n_best) = (won, moves.len());
            }
            for &other in self.nets[cell].iter().flat_map(|&net| self.cells_of(net)) {
                let other = other as usize;
                if has_moved[other] {
                    continue;
                }
                let gain = self.gain(other, is_upper[other], &on_side);
                let side = &mut ready[usize::from(is_upper[other])];
                if gain != gains[other] {
                    side.remove(&(-gains[other], other));
                    gains[other] = gain;
                }
                if is_at_cut(gain) {
                    side.insert((-gain, other));
                }
            }
        }
        for &cell in &moves[n_best..] {
            is_upper[cell] = !is_upper[cell];
        }
        best
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::box_mesh::box_of_five;

    #[test]
    fn a_graph_partition_is_balanced_and_no_worse_than_planes_across() {
        let mesh = box_of_five([16, 4, 3], DVec3::new(0.16, 0.04, 0.03));
        for n_zones in [1, 2, 3, 4, 7] {
            let zones = Zones::by_graph(&mesh, n_zones).unwrap();
            let fair = mesh.tetrahedra.len() as f64 / n_zones as f64;
            for z in 0..n_zones {
                let share = zones.tets(z).count() as f64 / fair;
                assert!((0.85..1.15).contains(&share), "zone {z} of {n_zones}: {share}");
            }
            // A plane across holds 20 nodes.
            assert!(zones.frontier_nodes().len() <= 20 * (n_zones - 1), "{n_zones} zones");
            assert_eq!(zones, Zones::by_graph(&mesh, n_zones).unwrap());
        }
    }

    #[test]
    fn improvement_repairs_a_bad_cut() {
        let mesh = box_of_five([12, 3, 3], DVec3::new(0.12, 0.03, 0.03));
        let tets: Vec<u32> = (0..mesh.tetrahedra.len() as u32).collect();
        // A slanted cut has more nodes than the plane across, which has 16.
        let centroids: Vec<DVec3> = centroids_m(&mesh).collect();
        let mut is_upper: Vec<bool> = centroids.iter().map(|c| c.x + 1.5 * c.y > 0.0825).collect();
        let cut = Cut::new(&mesh, &tets);
        let zones =
            |is_upper: &[bool]| Zones::new(&mesh, is_upper.iter().map(|&u| u32::from(u)).collect()).unwrap();
        let before = zones(&is_upper).frontier_nodes().len();
        cut.improve(&mut is_upper, [tets.len() * 2 / 5; 2]);
        let after = zones(&is_upper).frontier_nodes().len();
        assert!(after <= 18 && after < before, "{before} to {after}");
    }

    #[test]
    fn zones_merge_where_they_touch() {
        let mesh = box_of_five([6, 1, 1], DVec3::new(6.0, 1.0, 1.0));
        let zones = Zones::by_place(&mesh, |c| c.x as u32).unwrap();
        assert_eq!(zones.neighbours(2), [1, 3]);
        let (merged, new_zone) =
            zones.merged_where_touching(&mesh, &[true, false, true, true, false, true]).unwrap();
        assert_eq!(new_zone, [0, 1, 2, 2, 3, 4]);
        assert_eq!(merged.tets(2).count(), 10);
        assert_eq!(zones.merged(&mesh, &[0; 5]).unwrap_err(), ZonesError::Length { found: 5, expected: 6 });
        assert_eq!(Zones::by_graph(&mesh, 31).unwrap_err(), ZonesError::Count { n_zones: 31, n_tets: 30 });
    }
}
