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

/// Rounds of moving the dual's vertices.
const ROUNDS: usize = 3;

/// Dual triangulation of `mesh` whose triangles pass through the simplex vertices, but for waves of a cell's
/// size. Vertex `c` for cell `c`, triangle `v` for vertex `v`.
pub fn following_dual(mesh: &SimplexMesh) -> TriMesh {
    let normals = vertex_normals(mesh);
    let mut dual = mesh.dual();
    for _ in 0..ROUNDS {
        let gap_m = |v: usize| {
            let centre_m = dual.corners_m(v).into_iter().sum::<DVec3>() / 3.0;
            normals[v].dot(mesh.positions_m()[v] - centre_m) * normals[v]
        };
        let gaps_m: Vec<DVec3> = (0..mesh.n_vertices()).map(gap_m).collect();
        for (position, move_m) in dual.positions_m.iter_mut().zip(mesh.cell_means(&gaps_m)) {
            *position += move_m;
        }
    }
    dual
}
