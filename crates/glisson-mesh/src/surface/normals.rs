//! Unit normals of triangles and vertices, area and average edge length.

use super::TriMesh;
use crate::math::DVec3;

/// How the normals of a vertex's triangles are averaged.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum NormalWeight {
    /// By area: the direction in which moving the vertex changes the volume most.
    Area,
    /// By corner angle: independent of how the surface is cut into triangles (G. Thürmer and C. Wüthrich,
    /// "Computing vertex normals from polygonal facets", 1998, doi 10.1080/10867651.1998.10487487).
    Angle,
}

/// Twice the area [m2] times the unit normal of each triangle.
pub fn doubled_area_normals_m2(mesh: &TriMesh) -> Vec<DVec3> {
    (0..mesh.triangles.len())
        .map(|t| {
            let [a, b, c] = mesh.corners_m(t);
            (b - a).cross(c - a)
        })
        .collect()
}

/// One outward unit normal a vertex; zero for a vertex without triangles.
pub fn vertex_normals(mesh: &TriMesh, weight: NormalWeight) -> Vec<DVec3> {
    let mut normals = vec![DVec3::ZERO; mesh.positions_m.len()];
    for (t, doubled) in doubled_area_normals_m2(mesh).into_iter().enumerate() {
        let corners = mesh.corners_m(t);
        for c in 0..3 {
            let contribution = match weight {
                NormalWeight::Area => doubled,
                NormalWeight::Angle => {
                    let u = corners[(c + 1) % 3] - corners[c];
                    let v = corners[(c + 2) % 3] - corners[c];
                    libm::atan2(u.cross(v).length(), u.dot(v)) * doubled.normalize_or_zero()
                }
            };
            normals[mesh.triangles[t][c] as usize] += contribution;
        }
    }
    for normal in &mut normals {
        *normal = normal.normalize_or_zero();
    }
    normals
}

/// Surface area [m2].
pub fn area_m2(mesh: &TriMesh) -> f64 {
    doubled_area_normals_m2(mesh).iter().map(|n| 0.5 * n.length()).sum()
}
