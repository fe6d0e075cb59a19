//! The vertices within a number of edges of each vertex.

use super::mesh::SimplexMesh;
use rayon::prelude::*;

/// Rows of vertices, each row in order of distance and then of discovery, its own vertex first.
#[derive(Clone, Debug, PartialEq)]
pub struct Neighbourhoods {
    start: Vec<usize>,
    vertices: Vec<u32>,
}

impl Neighbourhoods {
    /// All vertices within `n_rings` edges of each vertex: at most 1 + 3 n (n + 1) / 2 on a flat honeycomb.
    pub fn within(mesh: &SimplexMesh, n_rings: usize) -> Self {
        let row = |v: usize| {
            let mut row = vec![v as u32];
            let mut ring = 0;
            for _ in 0..n_rings {
                let end = row.len();
                for at in ring..end {
                    for n in mesh.neighbours()[row[at] as usize] {
                        if !row.contains(&n) {
                            row.push(n);
                        }
                    }
                }
                ring = end;
            }
            row
        };
        let rows: Vec<Vec<u32>> = (0..mesh.n_vertices()).into_par_iter().map(row).collect();
        let mut start = Vec::with_capacity(rows.len() + 1);
        start.push(0);
        let mut vertices = Vec::with_capacity(rows.iter().map(Vec::len).sum());
        for row in &rows {
            vertices.extend_from_slice(row);
            start.push(vertices.len());
        }
        Self { start, vertices }
    }

    /// The neighbourhood of `vertex`, itself first.
    pub fn of(&self, vertex: usize) -> &[u32] {
        &self.vertices[self.start[vertex]..self.start[vertex + 1]]
    }

    /// Mean of `values`, one a vertex, over each neighbourhood.
    pub fn means(&self, values: &[f64]) -> Vec<f64> {
        let mean = |v: usize| {
            let row = self.of(v);
            row.iter().fold(0.0, |sum, &n| sum + values[n as usize]) / row.len() as f64
        };
        (0..self.start.len() - 1).into_par_iter().map(mean).collect()
    }
}
