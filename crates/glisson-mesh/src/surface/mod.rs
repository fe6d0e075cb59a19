//! Triangle surfaces of organs.

pub mod signed_distance;
pub mod error;
pub mod normals;
mod box_tree;
pub mod intersect;
pub mod winding;
pub mod check;
pub mod smooth;
pub mod decimate;
pub mod extract;
pub mod repair;
pub mod files;
pub mod simplex;

use crate::math::DVec3;

/// Triangles over shared vertices, counter-clockwise seen from outside.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct TriMesh {
    /// Vertices [m], LPS.
    pub positions_m: Vec<DVec3>,
    /// Vertex indices of each triangle.
    pub triangles: Vec<[u32; 3]>,
}

impl TriMesh {
    /// `triangles` over some of the `positions_m` [m], with the vertices they use in the old order; in time that depends on the
    /// triangles alone.
    ///
    /// # Panics
    /// When a triangle names a vertex that is not there.
    pub fn over(positions_m: &[DVec3], triangles: &[[u32; 3]]) -> Self {
        let mut used: Vec<u32> = triangles.iter().flatten().copied().collect();
        used.sort_unstable();
        used.dedup();
        let at = |v: u32| used.binary_search(&v).expect("a corner is used") as u32;
        Self {
            positions_m: used.iter().map(|&v| positions_m[v as usize]).collect(),
            triangles: triangles.iter().map(|t| t.map(at)).collect(),
        }
    }

    /// Corners of triangle `index` [m].
    pub fn corners_m(&self, index: usize) -> [DVec3; 3] {
        self.triangles[index].map(|v| self.positions_m[v as usize])
    }

    /// Enclosed volume [m3] by the divergence theorem; negative when inside out.
    pub fn volume_m3(&self) -> f64 {
        (0..self.triangles.len())
            .map(|t| {
                let [a, b, c] = self.corners_m(t);
                a.dot(b.cross(c)) / 6.0
            })
            .sum()
    }
}
