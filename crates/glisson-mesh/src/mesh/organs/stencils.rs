//! A lattice whose nodes carry regions, cut into tetrahedra of one region each.
//!
//! Every lattice tetrahedron is cut as the barycentric subdivision would, as far as its corners differ: an edge between two
//! regions gets a node, a face between three regions gets one, and so does a tetrahedron between four. The part of a region
//! is then a tetrahedron, a prism or a cube (as complexes), and all are cut into tetrahedra in one way: from the part's
//! first point to the facets without it, these from their first point likewise ("pulling"; Lee and Santos, Subdivisions and
//! triangulations of polytopes, Handbook of Discrete and Computational Geometry, 2017, chapter 16). "First" is by one
//! order of all points of the mesh, so that two tetrahedra cut their common face alike.
//!
//! The part of a region in the whole lattice is the derived neighbourhood of the nodes that carry it, and so is that of
//! the outside: the border of each of them is a closed manifold, whatever the regions are (Rourke and Sanderson,
//! Introduction to Piecewise-Linear Topology, 1972, chapter 3).

use super::background::Background;
use super::complex::{Complex, NO_REGION};
use crate::math::tetrahedron_volume_m3;
use std::collections::HashMap;

/// A point by the lattice nodes in whose middle it lies, ascending, filled up with [`NO_NODE`].
type Key = [u32; 4];

const NO_NODE: u32 = u32::MAX;

/// Number of tetrahedra into which a lattice tetrahedron with these regions at its corners is cut, the outside's not
/// counted.
pub(super) fn n_pieces(regions: [u16; 4]) -> usize {
    let mut n = 0;
    for (at, &region) in regions.iter().enumerate() {
        if region == 0 || regions[..at].contains(&region) {
            continue;
        }
        let n_same = regions.iter().filter(|&&r| r == region).count();
        let n_other = distinct(regions) - 1;
        n += match (n_same, n_other) {
            (4, _) | (1, 1) => 1,
            (3, 1) | (2, 1) | (1, 2) => 3,
            _ => 6,
        };
    }
    n
}

fn distinct(regions: [u16; 4]) -> usize {
    (0..4).filter(|&at| !regions[..at].contains(&regions[at])).count()
}

/// Cuts the lattice, whose nodes carry `regions`: all regions, and the outside as far as it shares a lattice tetrahedron with
/// one. The cuts lie in the middle.
pub(super) fn cut(lattice: &Background, regions: &[u16]) -> Complex {
    let mut cutter = Cutter { lattice, regions, complex: Complex::default(), id_of: HashMap::new() };
    lattice.for_each_tet(|nodes| {
        let of_corners = nodes.map(|n| regions[n]);
        if of_corners != [0; 4] {
            cutter.cut_tet(nodes, of_corners);
        }
    });
    cutter.complex
}

struct Cutter<'a> {
    lattice: &'a Background,
    regions: &'a [u16],
    complex: Complex,
    /// Looked up, never walked through.
    id_of: HashMap<Key, u32>,
}

impl Cutter<'_> {
    fn cut_tet(&mut self, nodes: [usize; 4], regions: [u16; 4]) {
        let mut corners = [0, 1, 2, 3].map(|c| (regions[c], nodes[c]));
        corners.sort_unstable();
        // Equal regions stand together: their first place and number, the most first.
        let mut groups: Vec<(usize, usize)> = Vec::with_capacity(4);
        for at in 0..4 {
            match groups.last_mut() {
                Some((first, n)) if corners[*first].0 == corners[at].0 => *n += 1,
                _ => groups.push((at, 1)),
            }
        }
        groups.sort_by_key(|&(first, n)| (4 - n, first));
        let order: Vec<usize> = groups.iter().flat_map(|&(first, n)| first..first + n).collect();
        let [a, b, c, d] = [0, 1, 2, 3].map(|at| corners[order[at]]);
        let node = |corner: (u16, usize)| key(&[corner.1]);
        let cut2 = |p: (u16, usize), q: (u16, usize)| key(&[p.1, q.1]);
        let cut3 = |p: (u16, usize), q: (u16, usize), r: (u16, usize)| key(&[p.1, q.1, r.1]);
        let sizes: Vec<usize> = groups.iter().map(|g| g.1).collect();
        match sizes[..] {
            [4] => self.add_tet(a.0, [a, b, c, d].map(node)),
            [3, 1] => {
                let cuts = [a, b, c].map(|p| cut2(p, d));
                self.add_prism(a.0, [[a, b, c].map(node), cuts]);
                self.add_tet(d.0, [node(d), cuts[0], cuts[1], cuts[2]]);
            }
            [2, 2] => {
                let [ac, ad, bc, bd] = [cut2(a, c), cut2(a, d), cut2(b, c), cut2(b, d)];
                self.add_prism(a.0, [[node(a), ac, ad], [node(b), bc, bd]]);
                self.add_prism(c.0, [[node(c), ac, bc], [node(d), ad, bd]]);
            }
            [2, 1, 1] => {
                let [ac, ad, bc, bd, cd] = [cut2(a, c), cut2(a, d), cut2(b, c), cut2(b, d), cut2(c, d)];
                let [acd, bcd] = [cut3(a, c, d), cut3(b, c, d)];
                self.add_cube(a.0, [[node(a), ac, acd, ad], [node(b), bc, bcd, bd]]);
                self.add_prism(c.0, [[node(c), ac, bc], [cd, acd, bcd]]);
                self.add_prism(d.0, [[node(d), ad, bd], [cd, acd, bcd]]);
            }
            _ => {
                let middle = key(&[a.1, b.1, c.1, d.1]);
                for [p, q, r, s] in [[a, b, c, d], [b, c, d, a], [c, d, a, b], [d, a, b, c]] {
                    let bottom = [node(p), cut2(p, q), cut3(p, q, r), cut2(p, r)];
                    let top = [cut2(p, s), cut3(p, q, s), middle, cut3(p, r, s)];
                    self.add_cube(p.0, [bottom, top]);
                }
            }
        }
    }

    /// A prism between two triangles whose points belong together in turn.
    fn add_prism(&mut self, region: u16, [low, high]: [[Key; 3]; 2]) {
        let facets = [[0, 1], [1, 2], [2, 0]].map(|[p, q]| vec![low[p], low[q], high[q], high[p]]);
        let ends = [low.to_vec(), high.to_vec()];
        self.pull(region, facets.into_iter().chain(ends));
    }

    /// A cube between two squares whose points belong together in turn.
    fn add_cube(&mut self, region: u16, [low, high]: [[Key; 4]; 2]) {
        let facets = [[0, 1], [1, 2], [2, 3], [3, 0]].map(|[p, q]| vec![low[p], low[q], high[q], high[p]]);
        let ends = [low.to_vec(), high.to_vec()];
        self.pull(region, facets.into_iter().chain(ends));
    }

    /// Tetrahedra from the first point of all facets to those without it.
    fn pull(&mut self, region: u16, facets: impl Iterator<Item = Vec<Key>>) {
        let facets: Vec<Vec<Key>> = facets.collect();
        let Some(&apex) = facets.iter().flatten().min_by_key(|&&k| order_of(k)) else { return };
        for facet in facets.iter().filter(|f| !f.contains(&apex)) {
            let first = (0..facet.len()).min_by_key(|&at| order_of(facet[at])).unwrap_or(0);
            for step in 1..facet.len() - 1 {
                let [p, q] = [step, step + 1].map(|s| facet[(first + s) % facet.len()]);
                self.add_tet(region, [apex, facet[first], p, q]);
            }
        }
    }

    fn add_tet(&mut self, region: u16, keys: [Key; 4]) {
        let mut nodes = keys.map(|k| self.id(k));
        let corners_m = nodes.map(|n| self.complex.positions_m[n as usize]);
        if tetrahedron_volume_m3(corners_m) < 0.0 {
            nodes.swap(2, 3);
        }
        self.complex.tets.push(nodes);
        self.complex.tet_regions.push(region);
    }

    /// Number of the point, which is made when it is first met.
    fn id(&mut self, key: Key) -> u32 {
        let complex = &mut self.complex;
        *self.id_of.entry(key).or_insert_with(|| {
            let nodes = key.iter().filter(|&&n| n != NO_NODE).map(|&n| n as usize);
            let mut regions = [NO_REGION; 4];
            let mut sum = crate::math::DVec3::ZERO;
            let mut n = 0;
            let mut cell_m = f64::INFINITY;
            for node in nodes {
                sum += self.lattice.position_m(node);
                regions[n] = self.regions[node];
                cell_m = cell_m.min(self.lattice.cell_at_m(node));
                n += 1;
            }
            regions.sort_unstable();
            complex.positions_m.push(sum / n as f64);
            complex.cell_m.push(cell_m);
            complex.node_regions.push(regions);
            u32::try_from(complex.positions_m.len() - 1).expect("the number of tetrahedra is bounded")
        })
    }
}

/// The point in the middle of lattice nodes.
fn key(nodes: &[usize]) -> Key {
    let mut key = [NO_NODE; 4];
    for (slot, &node) in key.iter_mut().zip(nodes) {
        *slot = u32::try_from(node).expect("the number of lattice nodes is bounded");
    }
    key.sort_unstable();
    key
}

/// The one order of all points: lattice nodes first, then cuts of edges, of faces, of tetrahedra. So a quadrilateral on a face
/// between three regions is cut from its lattice node to the face's point.
fn order_of(key: Key) -> (usize, Key) {
    (key.iter().filter(|&&n| n != NO_NODE).count(), key)
}

#[cfg(test)]
mod tests {
    use super::super::GRADED_DIHEDRAL_DEG;
    use super::super::cell_size::{CellSize, FinePlaces};
    use super::super::params::FinerBall;
    use super::*;
    use crate::math::{DVec3, SeededRandom};
    use crate::mesh::quality::dihedral_cosine_range;
    use crate::mesh::stuffing::Lattice;

    /// Cuts a lattice with random regions; checks that nothing overlaps or is left out, and answers the smallest and largest
    /// angle [degrees].
    fn angles_of_random_cuts(lattice: &Background) -> [f64; 2] {
        let mut random = SeededRandom::new(3);
        let mut all = [180.0f64, 0.0f64];
        for n_regions in 2..5u64 {
            let regions: Vec<u16> =
                (0..lattice.n_nodes()).map(|_| 1 + (random.next_u64() % n_regions) as u16).collect();
            let complex = cut(lattice, &regions);
            let (mut n_expected, mut lattice_m3) = (0, 0.0);
            lattice.for_each_tet(|nodes| {
                lattice_m3 += tetrahedron_volume_m3(nodes.map(|n| lattice.position_m(n))).abs();
                n_expected += n_pieces(nodes.map(|n| regions[n]));
            });
            assert_eq!(complex.tets.len(), n_expected);
            let volume_m3: f64 = complex.volumes_m3(5).iter().sum();
            assert!((volume_m3 / lattice_m3 - 1.0).abs() < 1e-9);
            for tet in 0..complex.tets.len() {
                let [low, high] =
                    dihedral_cosine_range(complex.corners_m(tet)).map(|c| c.acos().to_degrees());
                all = [all[0].min(high), all[1].max(low)];
            }
        }
        all
    }

    #[test]
    fn random_regions_are_cut_into_good_tetrahedra_that_fill_the_lattice() {
        let lattice = Lattice { dims: [6; 3], cell_m: 1.0, origin_m: DVec3::ZERO };
        let [smallest_deg, largest_deg] = angles_of_random_cuts(&Background::Even(lattice));
        assert!(smallest_deg > 18.0, "{smallest_deg}");
        assert!(largest_deg < 150.0, "{largest_deg}");
    }

    #[test]
    fn a_refined_lattice_is_cut_into_good_tetrahedra_too() {
        let lattice = Lattice { dims: [9; 3], cell_m: 1.0, origin_m: DVec3::ZERO };
        let ball = FinerBall { center_m: DVec3::splat(4.2), radius_m: 0.8, factor: 6.0 };
        let places = FinePlaces::of_balls(vec![ball]);
        let refined = Background::new(lattice, &CellSize::new(1.0, &places)).unwrap();
        let [smallest_deg, largest_deg] = angles_of_random_cuts(&refined);
        assert!(smallest_deg > GRADED_DIHEDRAL_DEG[0], "{smallest_deg}");
        assert!(largest_deg < GRADED_DIHEDRAL_DEG[1], "{largest_deg}");
    }
}
