//! The dual triangulation that follows the simplex surface.
//!
//! Over the centres of the cells the dual lies inside a convex surface, by about half of area times curvature.
//! Instead each dual vertex q moves along the surface's normal until the triangles pass through the simplex
//! vertices: q += mean over the vertices v of the cell of (n_v . (p_v - g_v)) n_v, g_v being the centre of dual
//! triangle v. Waves longer than a few cells are met after one or two rounds; the shortest, to which centres
//! are blind, are left as they are.

use super::geometry::vertex_normals;
use super::mesh::SimplexMesh;
use crate::math::DVec3;
use crate::surface::TriMesh;
use crate::surface::error::{Place, SurfaceError};
use crate::surface::intersect::self_intersections;
use crate::surface::smooth::EdgeGraph;

/// Rounds of moving the dual's vertices.
const ROUNDS: usize = 3;
/// Rounds of smoothing around crossings; by the last, eight rings around them are smooth.
const MOST_UNTANGLING_ROUNDS: usize = 8;
/// Smoothing sweeps of a round.
const UNTANGLING_SWEEPS: usize = 4;

/// Dual triangulation of `mesh` whose triangles pass through the simplex vertices, but for waves of a cell's
/// size. Vertex `c` for cell `c`, triangle `v` for vertex `v`.
pub fn following_dual(mesh: &SimplexMesh) -> TriMesh {
    let normals = vertex_normals(mesh);
    let mut dual = mesh.dual();
    for _ in 0..ROUNDS {
        let mut moves = vec![(DVec3::ZERO, 0.0); mesh.n_cells()];
        for v in 0..mesh.n_vertices() {
            let centre_m = dual.corners_m(v).into_iter().sum::<DVec3>() / 3.0;
            let gap_m = normals[v].dot(mesh.positions_m()[v] - centre_m);
            for cell in mesh.cells()[v] {
                let sum = &mut moves[cell as usize];
                *sum = (sum.0 + gap_m * normals[v], sum.1 + 1.0);
            }
        }
        for (position, (sum, n)) in dual.positions_m.iter_mut().zip(moves) {
            *position += sum / n;
        }
    }
    dual
}

/// Smooths `mesh` around crossing triangles, over wider and wider surroundings, until none cross. Answers how
/// many vertices were moved.
///
/// # Errors
/// [`SurfaceError::Tangled`] when that does not end.
pub fn take_crossings_away(mesh: &mut TriMesh) -> Result<usize, SurfaceError> {
    let mut moved = vec![false; mesh.positions_m.len()];
    let mut graph = None;
    for round in 0..=MOST_UNTANGLING_ROUNDS {
        let pairs = self_intersections(mesh, usize::MAX);
        let Some(first) = pairs.first() else { break };
        if round == MOST_UNTANGLING_ROUNDS {
            let place = Place(mesh.corners_m(first[0] as usize)[0]);
            return Err(SurfaceError::Tangled { stage: "fitting", n: pairs.len(), place });
        }
        let graph = graph.get_or_insert_with(|| EdgeGraph::of_mesh(mesh));
        let mut around: Vec<u32> = pairs.iter().flatten().flat_map(|&t| mesh.triangles[t as usize]).collect();
        for _ in 0..round {
            let beside: Vec<u32> =
                around.iter().flat_map(|&v| graph.neighbours(v as usize)).copied().collect();
            around.extend(beside);
            around.sort_unstable();
            around.dedup();
        }
        around.sort_unstable();
        around.dedup();
        around.iter().for_each(|&v| moved[v as usize] = true);
        for _ in 0..UNTANGLING_SWEEPS {
            let middles: Vec<DVec3> = around
                .iter()
                .map(|&v| {
                    let ring = graph.neighbours(v as usize);
                    ring.iter().map(|&n| mesh.positions_m[n as usize]).sum::<DVec3>() / ring.len() as f64
                })
                .collect();
            for (&v, middle) in around.iter().zip(middles) {
                mesh.positions_m[v as usize] = middle;
            }
        }
    }
    Ok(moved.into_iter().filter(|&m| m).count())
}
