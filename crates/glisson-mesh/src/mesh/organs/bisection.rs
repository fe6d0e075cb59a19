//! A body-centred cubic lattice refined where smaller cells are wanted, by halving longest edges.
//!
//! A tetrahedron that is too large is halved at its longest edge, with all others around that edge; where one of these has a
//! longer edge, that one is halved first (Rivara, New longest-edge algorithms for the refinement and/or improvement of unstructured
//! triangulations, International Journal for Numerical Methods in Engineering 40(18), 3313-3324, 1997). From the tetrahedra of the
//! lattice only three more shapes come, again and again in smaller sizes, and none of their dihedral angles is below 45 degrees.

use super::cell_size::CellSize;
use crate::math::{DVec3, tetrahedron_volume_m3};
use crate::mesh::stuffing::{Lattice, TETRAHEDRON_OVER_CELL};
use std::collections::HashMap;

/// Steps of the integer coordinates in half a cell: halves of halves stay whole numbers.
const STEPS: i64 = 1 << 10;

/// A tetrahedron may be larger than that of the wanted cell by this factor: halving leaves it as much smaller.
const TOLERATED: f64 = std::f64::consts::SQRT_2;

/// Size of a node's cell over the longest edge of the smallest tetrahedron there. The width of the flattest of the shapes is 0.35 of its
/// longest edge, that of the lattice's a half.
const CELL_OVER_LONGEST_EDGE: f64 = 0.7;

/// Tetrahedra that are made at most, halved ones included: these take 2.6 GB on the way.
pub(super) const MOST_BISECTED: usize = 30_000_000;

/// The corners of a tetrahedron's edges.
const EDGES: [[usize; 2]; 6] = [[0, 1], [0, 2], [0, 3], [1, 2], [1, 3], [2, 3]];

/// Nodes and tetrahedra of the refined lattice.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct Graded {
    pub(super) positions_m: Vec<DVec3>,
    pub(super) tets: Vec<[u32; 4]>,
    /// Whether a node is away from the lattice's border.
    pub(super) is_interior: Vec<bool>,
    /// Size of the cells around each node [m].
    pub(super) cell_m: Vec<f64>,
    /// Volume of each node: a quarter of its tetrahedra's [m3].
    pub(super) volume_m3: Vec<f64>,
}

type Edge = (u32, u32);

fn edge(a: u32, b: u32) -> Edge {
    (a.min(b), a.max(b))
}

struct Bisector<'a> {
    lattice: &'a Lattice,
    /// In steps.
    coordinates: Vec<[i64; 3]>,
    is_interior: Vec<bool>,
    tets: Vec<[u32; 4]>,
    is_alive: Vec<bool>,
    /// Tetrahedra around each edge. Looked up, never walked through.
    around: HashMap<Edge, Vec<u32>>,
}

/// The lattice, refined to `size`; none where that would take more than [`MOST_BISECTED`] tetrahedra.
pub(super) fn graded(lattice: &Lattice, size: &CellSize<'_>) -> Option<Graded> {
    let mut bisector = Bisector {
        lattice,
        coordinates: (0..lattice.n_nodes())
            .map(|node| lattice.half_cells(node).map(|c| i64::from(c) * STEPS))
            .collect(),
        is_interior: (0..lattice.n_nodes()).map(|node| lattice.is_interior(node, 1)).collect(),
        tets: Vec::new(),
        is_alive: Vec::new(),
        around: HashMap::new(),
    };
    lattice.for_each_tet(|nodes| {
        bisector.add(nodes.map(|n| u32::try_from(n).expect("the number of lattice nodes is bounded")));
    });
    // Those that come are looked at in their turn.
    let mut tet = 0;
    while tet < bisector.tets.len() {
        if bisector.tets.len() > MOST_BISECTED {
            return None;
        }
        while bisector.is_alive[tet] && bisector.is_too_large(tet, size) {
            bisector.halve(tet);
        }
        tet += 1;
    }
    Some(bisector.finish())
}

impl Bisector<'_> {
    fn add(&mut self, nodes: [u32; 4]) {
        let tet = u32::try_from(self.tets.len()).expect("the number of tetrahedra is bounded");
        for [a, b] in EDGES {
            self.around.entry(edge(nodes[a], nodes[b])).or_default().push(tet);
        }
        self.tets.push(nodes);
        self.is_alive.push(true);
    }

    fn remove(&mut self, tet: u32) {
        self.is_alive[tet as usize] = false;
        let nodes = self.tets[tet as usize];
        for [a, b] in EDGES {
            let edge = edge(nodes[a], nodes[b]);
            let around = self.around.get_mut(&edge).map(|around| {
                around.retain(|&other| other != tet);
                around.len()
            });
            if around == Some(0) {
                self.around.remove(&edge);
            }
        }
    }

    fn position_m(&self, node: u32) -> DVec3 {
        let [x, y, z] = self.coordinates[node as usize].map(|c| c as f64 / STEPS as f64);
        self.lattice.origin_m + 0.5 * self.lattice.cell_m * DVec3::new(x, y, z)
    }

    fn is_too_large(&self, tet: usize, size: &CellSize<'_>) -> bool {
        let corners_m = self.tets[tet].map(|node| self.position_m(node));
        let cell_m = size.at_m(corners_m.iter().sum::<DVec3>() / 4.0);
        tetrahedron_volume_m3(corners_m).abs() > TOLERATED * TETRAHEDRON_OVER_CELL * cell_m * cell_m * cell_m
    }

    /// Squared length in steps: exact, so that equal ones are equal.
    fn length2(&self, (a, b): Edge) -> i64 {
        let (p, q) = (self.coordinates[a as usize], self.coordinates[b as usize]);
        (0..3).map(|axis| (p[axis] - q[axis]) * (p[axis] - q[axis])).sum()
    }

    /// The longest edge of a tetrahedron, of equal ones the first.
    fn longest(&self, tet: u32) -> (i64, Edge) {
        let nodes = self.tets[tet as usize];
        let edges = EDGES.map(|[a, b]| edge(nodes[a], nodes[b]));
        let (mut length2, mut longest) = (0, edges[0]);
        for edge in edges {
            let this2 = self.length2(edge);
            if this2 > length2 || (this2 == length2 && edge < longest) {
                (length2, longest) = (this2, edge);
            }
        }
        (length2, longest)
    }

    /// Halves a tetrahedron, after those around its longest edge that have longer ones.
    fn halve(&mut self, tet: usize) {
        let wanted = u32::try_from(tet).expect("the number of tetrahedra is bounded");
        let mut path = vec![wanted];
        while let Some(&last) = path.last() {
            if !self.is_alive[last as usize] {
                path.pop();
                continue;
            }
            let (length2, longest) = self.longest(last);
            let around = &self.around[&longest];
            match around.iter().copied().find(|&other| self.longest(other).0 > length2) {
                Some(longer) => path.push(longer),
                None => self.halve_edge(longest),
            }
        }
    }

    /// Halves an edge and all tetrahedra around it.
    fn halve_edge(&mut self, (a, b): Edge) {
        let (p, q) = (self.coordinates[a as usize], self.coordinates[b as usize]);
        let middle = u32::try_from(self.coordinates.len()).expect("the number of nodes is bounded");
        self.coordinates.push([0, 1, 2].map(|axis| (p[axis] + q[axis]) / 2));
        self.is_interior.push(self.is_interior[a as usize] || self.is_interior[b as usize]);
        for tet in self.around.get(&(a, b)).cloned().unwrap_or_default() {
            let nodes = self.tets[tet as usize];
            self.remove(tet);
            self.add(nodes.map(|node| if node == a { middle } else { node }));
            self.add(nodes.map(|node| if node == b { middle } else { node }));
        }
    }

    fn finish(self) -> Graded {
        let alive: Vec<usize> = (0..self.tets.len()).filter(|&tet| self.is_alive[tet]).collect();
        let n_nodes = self.coordinates.len();
        let step_m = 0.5 * self.lattice.cell_m / STEPS as f64;
        let mut graded = Graded {
            positions_m: (0..n_nodes as u32).map(|node| self.position_m(node)).collect(),
            tets: alive.iter().map(|&tet| self.tets[tet]).collect(),
            cell_m: vec![f64::INFINITY; n_nodes],
            volume_m3: vec![0.0; n_nodes],
            ..Graded::default()
        };
        for &tet in &alive {
            let nodes = self.tets[tet];
            let (length2, _) = self.longest(tet as u32);
            let cell_m = CELL_OVER_LONGEST_EDGE * step_m * (length2 as f64).sqrt();
            let volume_m3 = tetrahedron_volume_m3(nodes.map(|n| graded.positions_m[n as usize])).abs();
            for node in nodes.map(|n| n as usize) {
                graded.cell_m[node] = graded.cell_m[node].min(cell_m);
                graded.volume_m3[node] += 0.25 * volume_m3;
            }
        }
        graded.is_interior = self.is_interior;
        graded
    }
}

impl Graded {
    /// Nodes that share an edge with each of some nodes, ascending.
    pub(super) fn neighbours_of(&self, nodes: &[usize]) -> Vec<Vec<usize>> {
        let place_of: HashMap<usize, usize> = nodes.iter().copied().zip(0..).collect();
        let mut neighbours = vec![Vec::new(); nodes.len()];
        for corners in self.tets.iter().map(|tet| tet.map(|n| n as usize)) {
            for node in corners {
                if let Some(&place) = place_of.get(&node) {
                    neighbours[place].extend(corners.into_iter().filter(|&other| other != node));
                }
            }
        }
        for list in &mut neighbours {
            list.sort_unstable();
            list.dedup();
        }
        neighbours
    }
}

#[cfg(test)]
mod tests {
    use super::super::cell_size::FinePlaces;
    use super::super::params::FinerBall;
    use super::*;
    use crate::mesh::quality::{FACES, dihedral_cosine_range};
    use std::collections::{BTreeMap, BTreeSet};

    fn refined(factor: f64) -> (Lattice, Graded) {
        let lattice = Lattice { dims: [9; 3], cell_m: 0.01, origin_m: DVec3::ZERO };
        let ball = FinerBall { center_m: DVec3::splat(0.042), radius_m: 0.006, factor };
        let places = FinePlaces::of_balls(vec![ball]);
        let graded = graded(&lattice, &CellSize::new(0.01, &places)).unwrap();
        (lattice, graded)
    }

    #[test]
    fn a_refined_lattice_is_conforming_fills_the_same_space_and_is_as_fine_as_wanted() {
        let (lattice, graded) = refined(6.0);
        let (mut n_coarse, mut volume_m3) = (0, 0.0);
        let corners = |tet: &[u32; 4]| tet.map(|n| graded.positions_m[n as usize]);
        lattice.for_each_tet(|nodes| {
            n_coarse += 1;
            volume_m3 += tetrahedron_volume_m3(nodes.map(|n| lattice.position_m(n))).abs();
        });
        let fine_m3: f64 = graded.tets.iter().map(|t| tetrahedron_volume_m3(corners(t)).abs()).sum();
        assert!((fine_m3 / volume_m3 - 1.0).abs() < 1e-12);
        assert!((graded.volume_m3.iter().sum::<f64>() / volume_m3 - 1.0).abs() < 1e-12);
        assert!(graded.tets.len() > 2 * n_coarse, "{}", graded.tets.len());
        let mut n_of_face = BTreeMap::new();
        for tet in &graded.tets {
            for face in FACES {
                let mut face = face.map(|c| tet[c]);
                face.sort_unstable();
                *n_of_face.entry(face).or_insert(0) += 1;
            }
        }
        // A face with one tetrahedron is on the border, in the planes through the outermost nodes or between them.
        for (face, n) in &n_of_face {
            assert!(*n <= 2, "{face:?}");
            let is_border = face.iter().all(|&node| !graded.is_interior[node as usize]);
            assert!(*n == 2 || is_border, "{face:?} has {n} tetrahedra");
        }
        for tet in &graded.tets {
            let corners_m = corners(tet);
            let [_, high] = dihedral_cosine_range(corners_m);
            assert!(high.acos().to_degrees() > 44.999, "{}", high.acos().to_degrees());
            let middle = corners_m.iter().sum::<DVec3>() / 4.0;
            if middle.distance(DVec3::splat(0.042)) < 0.006 {
                let cell_m = libm::cbrt(12.0 * tetrahedron_volume_m3(corners_m).abs());
                assert!(cell_m < 1.13 * 0.01 / 6.0, "{cell_m}");
            }
        }
    }

    #[test]
    fn neighbours_are_the_other_ends_of_edges() {
        let (_, graded) = refined(2.0);
        let all: Vec<usize> = (0..graded.positions_m.len()).collect();
        let neighbours = graded.neighbours_of(&all);
        let mut edges = BTreeSet::new();
        for tet in graded.tets.iter().map(|tet| tet.map(|n| n as usize)) {
            for [a, b] in EDGES {
                assert!(neighbours[tet[a]].contains(&tet[b]) && neighbours[tet[b]].contains(&tet[a]));
                edges.extend([(tet[a], tet[b]), (tet[b], tet[a])]);
            }
        }
        assert_eq!(neighbours.iter().map(Vec::len).sum::<usize>(), edges.len());
        assert_eq!(graded.neighbours_of(&[7, 3]), [neighbours[7].clone(), neighbours[3].clone()]);
    }
}
