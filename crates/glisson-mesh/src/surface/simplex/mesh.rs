//! The mesh: three neighbours and three cells a vertex.
//!
//! Seen from outside the neighbours of a vertex stand counter-clockwise, and cell `k` of a vertex is the one
//! that does not touch its edge to neighbour `k`. The three cells of a vertex are therefore the corners of its
//! triangle in the dual triangulation, in the same orientation.

use std::ops::{Add, Div};

use super::error::SimplexError;
use crate::math::DVec3;
use crate::surface::TriMesh;
use crate::surface::check::{check_edge, check_numbers, sorted_sides};
use crate::surface::error::{Place, SurfaceError};

/// A closed, oriented surface whose vertices all have three neighbours.
#[derive(Clone, Debug, PartialEq)]
pub struct SimplexMesh {
    pub(super) positions_m: Vec<DVec3>,
    pub(super) neighbours: Vec<[u32; 3]>,
    pub(super) cells: Vec<[u32; 3]>,
    /// A vertex of each cell.
    pub(super) first_of_cell: Vec<u32>,
}

/// Counts of a simplex mesh.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SimplexTopology {
    /// Vertices.
    pub n_vertices: usize,
    /// Edges: three for every two vertices.
    pub n_edges: usize,
    /// Cells.
    pub n_cells: usize,
    /// Vertices - edges + cells: 2 for a ball.
    pub euler_characteristic: i64,
}

impl SimplexMesh {
    /// The dual of a closed, oriented manifold: vertex `t` at the centre of triangle `t`, cell `v` around
    /// vertex `v`.
    ///
    /// # Errors
    /// [`SimplexError::Surface`] for a surface that is not closed or not a manifold,
    /// [`SimplexError::UnusedVertex`].
    pub fn from_triangles(mesh: &TriMesh) -> Result<Self, SimplexError> {
        check_numbers(mesh)?;
        let n = mesh.triangles.len();
        let mut neighbours = vec![[u32::MAX; 3]; n];
        let sides = sorted_sides(mesh);
        let edges = || sides.chunk_by(|a, b| (a.low, a.high) == (b.low, b.high));
        for edge in edges() {
            let n_open = || edges().filter(|e| e.len() == 1).count();
            let [a, b] = check_edge(mesh, edge, n_open)?;
            for (s, t) in [(a, b), (b, a)] {
                let own = mesh.triangles[s.triangle as usize];
                for k in 0..3 {
                    let (from, to) = (own[(k + 1) % 3], own[(k + 2) % 3]);
                    if (from.min(to), from.max(to)) == (s.low, s.high) {
                        neighbours[s.triangle as usize][k] = t.triangle;
                    }
                }
            }
        }
        let mut first_of_cell = vec![u32::MAX; mesh.positions_m.len()];
        for (t, corners) in mesh.triangles.iter().enumerate() {
            for &c in corners {
                if first_of_cell[c as usize] == u32::MAX {
                    first_of_cell[c as usize] = t as u32;
                }
            }
        }
        if let Some(vertex) = first_of_cell.iter().position(|&f| f == u32::MAX) {
            return Err(SimplexError::UnusedVertex { vertex, place: Place(mesh.positions_m[vertex]) });
        }
        let positions_m = (0..n).map(|t| mesh.corners_m(t).into_iter().sum::<DVec3>() / 3.0).collect();
        let simplex = Self { positions_m, neighbours, cells: mesh.triangles.clone(), first_of_cell };
        match simplex.check() {
            Err(SimplexError::BrokenContour { cell, .. }) => {
                let fan = simplex.contour(cell as u32);
                let other = (0..n)
                    .find(|&t| mesh.triangles[t].contains(&(cell as u32)) && !fan.contains(&(t as u32)));
                Err(SurfaceError::PinchedVertex {
                    vertex: cell,
                    n_fans: 2,
                    triangles: [fan[0] as usize, other.unwrap_or(fan[0] as usize)],
                    place: Place(mesh.positions_m[cell]),
                }
                .into())
            }
            Err(other) => Err(other),
            Ok(_) => Ok(simplex),
        }
    }

    /// Number of vertices.
    pub fn n_vertices(&self) -> usize {
        self.positions_m.len()
    }

    /// Number of cells.
    pub fn n_cells(&self) -> usize {
        self.first_of_cell.len()
    }

    /// Vertices [m], LPS.
    pub fn positions_m(&self) -> &[DVec3] {
        &self.positions_m
    }

    /// Vertices [m], to be moved.
    pub fn positions_m_mut(&mut self) -> &mut [DVec3] {
        &mut self.positions_m
    }

    /// Neighbours of each vertex, counter-clockwise seen from outside.
    pub fn neighbours(&self) -> &[[u32; 3]] {
        &self.neighbours
    }

    /// Cells of each vertex: cell `k` does not touch the edge to neighbour `k`.
    pub fn cells(&self) -> &[[u32; 3]] {
        &self.cells
    }

    /// Positions of the neighbours of `vertex` [m].
    pub fn neighbours_m(&self, vertex: usize) -> [DVec3; 3] {
        self.neighbours[vertex].map(|n| self.positions_m[n as usize])
    }

    /// Vertices around `cell`, counter-clockwise seen from outside.
    pub fn contour(&self, cell: u32) -> Vec<u32> {
        let first = self.first_of_cell[cell as usize];
        let mut contour = vec![first];
        let mut at = self.next_around(cell, first);
        while at != first && contour.len() <= self.positions_m.len() {
            contour.push(at);
            at = self.next_around(cell, at);
        }
        contour
    }

    /// The vertex after `vertex` on the contour of `cell`.
    pub(super) fn next_around(&self, cell: u32, vertex: u32) -> u32 {
        let cells = self.cells[vertex as usize];
        let k = cells.iter().position(|&c| c == cell).unwrap_or(0);
        self.neighbours[vertex as usize][(k + 1) % 3]
    }

    /// Mean of the vertices of each cell [m].
    pub fn cell_centres_m(&self) -> Vec<DVec3> {
        self.cell_means(&self.positions_m)
    }

    /// Mean over the vertices of each cell of what each vertex has.
    pub fn cell_means<T>(&self, of_vertices: &[T]) -> Vec<T>
    where
        T: Copy + Default + Add<Output = T> + Div<f64, Output = T>,
    {
        let mut sums = vec![(T::default(), 0.0); self.n_cells()];
        for (cells, &x) in self.cells.iter().zip(of_vertices) {
            for &c in cells {
                let sum = &mut sums[c as usize];
                *sum = (sum.0 + x, sum.1 + 1.0);
            }
        }
        sums.into_iter().map(|(sum, n)| sum / n).collect()
    }

    /// Area of each cell [m2], cut into triangles from its centre.
    pub fn cell_areas_m2(&self) -> Vec<f64> {
        let centres_m = self.cell_centres_m();
        let mut areas_m2 = vec![0.0; self.n_cells()];
        for v in 0..self.n_vertices() {
            let at = self.positions_m[v];
            for k in 0..3 {
                let (cell, next) = (self.cells[v][k], self.neighbours[v][(k + 1) % 3]);
                let centre = centres_m[cell as usize];
                let next = self.positions_m[next as usize];
                areas_m2[cell as usize] += 0.5 * (at - centre).cross(next - centre).length();
            }
        }
        areas_m2
    }

    /// The dual triangulation over the centres of the cells: triangle `v` for vertex `v`, vertex `c` for cell `c`.
    pub fn dual(&self) -> TriMesh {
        TriMesh { positions_m: self.cell_centres_m(), triangles: self.cells.clone() }
    }

    /// Checks that neighbours are mutual, contours closed, cells of at least three vertices and that any two
    /// meet along one edge at most, and that coordinates are finite.
    ///
    /// # Errors
    /// [`SimplexError`]: the first violation.
    pub fn check(&self) -> Result<SimplexTopology, SimplexError> {
        if let Some(vertex) = self.positions_m.iter().position(|p| !p.is_finite()) {
            return Err(SimplexError::NotFinite { vertex, found_m: self.positions_m[vertex] });
        }
        let n = self.n_vertices();
        let mut n_named = vec![0usize; self.n_cells()];
        let mut borders = Vec::with_capacity(3 * n / 2);
        for v in 0..n {
            for k in 0..3 {
                let neighbour = self.neighbours[v][k];
                let ends = [self.cells[v][(k + 1) % 3], self.cells[v][(k + 2) % 3]];
                let agrees = |w: usize| {
                    (0..3).any(|j| {
                        self.neighbours[w][j] as usize == v
                            && [self.cells[w][(j + 2) % 3], self.cells[w][(j + 1) % 3]] == ends
                    })
                };
                if neighbour as usize >= n || neighbour as usize == v || !agrees(neighbour as usize) {
                    return Err(SimplexError::NotMutual { vertex: v, side: k, neighbour });
                }
                if (neighbour as usize) > v {
                    borders.push([ends[0].min(ends[1]), ends[0].max(ends[1])]);
                }
                n_named[self.cells[v][k] as usize] += 1;
            }
        }
        for cell in 0..self.n_cells() {
            let found = self.contour(cell as u32).len();
            if found < 3 {
                return Err(SimplexError::SmallCell { cell, found });
            }
            if found != n_named[cell] {
                return Err(SimplexError::BrokenContour { cell, found, expected: n_named[cell] });
            }
        }
        borders.sort_unstable();
        if let Some(double) = borders.chunk_by(|a, b| a == b).find(|b| b.len() > 1) {
            return Err(SimplexError::DoubleBorder { cells: double[0], found: double.len() });
        }
        let n_edges = 3 * n / 2;
        let n_cells = self.n_cells();
        let euler_characteristic = n as i64 - n_edges as i64 + n_cells as i64;
        Ok(SimplexTopology { n_vertices: n, n_edges, n_cells, euler_characteristic })
    }
}
