//! A cube of about as many tetrahedra and surface triangles as that of seed 000 (s. 4.2.2: 353 and 288). Its fine surface and
//! coarse inside come from commercial software; here they are built by hand.

use glisson::math::{DVec3, tetrahedron_volume_m3};
use glisson::mesh::{NodeId, TetMesh};
use std::collections::BTreeMap;

/// Cells along the axes: 288 triangles and 360 tetrahedra.
pub(crate) const CELLS_288: [usize; 3] = [4, 4, 7];
/// The same with 296 triangles, so that two have 592 (seed 000, fig. 4.6: 596), and 368 tetrahedra.
pub(crate) const CELLS_296: [usize; 3] = [4, 5, 6];

/// Depth of the inner nodes below the middles of the sides, as a share of the edge: a choice. Less deep, the flat tetrahedra
/// under the sides would bear shorter steps only.
const DEPTH: f64 = 0.36;

/// A cube with one corner in the origin. Below the middle of each side is a node, to which all triangles of that side lead;
/// between two sides there is a tetrahedron at each piece of their edge, at a corner one between three, and inside four.
pub(crate) fn thesis_cube(cells: [usize; 3], side_m: f64) -> TetMesh {
    let mut cube = Cube::new(cells, side_m);
    for axis in 0..3 {
        cube.fill_under_sides(axis);
        cube.fill_along_edges(axis);
    }
    cube.fill_corners();
    cube.fill_inside();
    cube.into_mesh()
}

/// A cube that is being built.
struct Cube {
    cells: [usize; 3],
    side_m: f64,
    positions_m: Vec<DVec3>,
    /// Of the nodes on the surface, by their places in cells.
    nodes: BTreeMap<[usize; 3], NodeId>,
    /// The node below each side, by axis and by which of the two.
    inner: [[NodeId; 2]; 3],
    /// Of either orientation.
    tets: Vec<[NodeId; 4]>,
}

impl Cube {
    fn new(cells: [usize; 3], side_m: f64) -> Self {
        let mut positions_m = Vec::new();
        let inner = [0, 1, 2].map(|axis| {
            [DEPTH, 1.0 - DEPTH].map(|depth| {
                let mut share = [0.5; 3];
                share[axis] = depth;
                positions_m.push(DVec3::from_array(share) * side_m);
                NodeId::from_index(positions_m.len() - 1)
            })
        });
        Self { cells, side_m, positions_m, nodes: BTreeMap::new(), inner, tets: Vec::new() }
    }

    /// The node of the surface at a place in cells.
    fn node(&mut self, place: [usize; 3]) -> NodeId {
        *self.nodes.entry(place).or_insert_with(|| {
            let share = [0, 1, 2].map(|axis| place[axis] as f64 / self.cells[axis] as f64);
            self.positions_m.push(DVec3::from_array(share) * self.side_m);
            NodeId::from_index(self.positions_m.len() - 1)
        })
    }

    /// Under the triangles of the two sides across this axis.
    fn fill_under_sides(&mut self, axis: usize) {
        let [u, v] = [(axis + 1) % 3, (axis + 2) % 3];
        for end in 0..2 {
            for i in 0..self.cells[u] {
                for j in 0..self.cells[v] {
                    let corners = [(0, 0), (1, 0), (1, 1), (0, 1)];
                    let [a, b, c, d] = corners.map(|(k, l)| {
                        let mut place = [0; 3];
                        (place[axis], place[u], place[v]) = (end * self.cells[axis], i + k, j + l);
                        self.node(place)
                    });
                    let apex = self.inner[axis][end];
                    self.tets.extend([[a, b, c, apex], [a, c, d, apex]]);
                }
            }
        }
    }

    /// Along the four edges that run this way.
    fn fill_along_edges(&mut self, axis: usize) {
        let [u, v] = [(axis + 1) % 3, (axis + 2) % 3];
        for (end_u, end_v) in [(0, 0), (0, 1), (1, 0), (1, 1)] {
            for k in 0..self.cells[axis] {
                let [a, b] = [k, k + 1].map(|along| {
                    let mut place = [0; 3];
                    (place[axis], place[u], place[v]) = (along, end_u * self.cells[u], end_v * self.cells[v]);
                    self.node(place)
                });
                self.tets.push([a, b, self.inner[u][end_u], self.inner[v][end_v]]);
            }
        }
    }

    fn fill_corners(&mut self) {
        for corner in 0..8 {
            let ends = [corner & 1, (corner >> 1) & 1, (corner >> 2) & 1];
            let place = [0, 1, 2].map(|axis| ends[axis] * self.cells[axis]);
            let [a, b, c] = [0, 1, 2].map(|axis| self.inner[axis][ends[axis]]);
            let node = self.node(place);
            self.tets.push([node, a, b, c]);
        }
    }

    /// The octahedron around one of its diagonals.
    fn fill_inside(&mut self) {
        let [x, y, z] = self.inner;
        for [a, b] in [[y[0], z[0]], [z[0], y[1]], [y[1], z[1]], [z[1], y[0]]] {
            self.tets.push([x[0], x[1], a, b]);
        }
    }

    fn into_mesh(self) -> TetMesh {
        let mut mesh = TetMesh { positions_m: self.positions_m, ..TetMesh::default() };
        for tet in self.tets {
            let volume_m3 = tetrahedron_volume_m3(tet.map(|n| mesh.positions_m[n.index()]));
            let [p, q, r, s] = tet;
            mesh.tetrahedra.push(if volume_m3 > 0.0 { tet } else { [p, r, q, s] });
        }
        mesh
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glisson::mesh::faults::find_faults;
    use glisson::mesh::topology::Topology;

    #[test]
    fn the_cubes_are_whole_and_of_the_thesis_size() {
        for (cells, n_triangles, n_tets) in [(CELLS_288, 288, 360), (CELLS_296, 296, 368)] {
            let mesh = thesis_cube(cells, 0.05);
            assert!(find_faults(&mesh).is_empty(), "{:?}", find_faults(&mesh));
            assert!((mesh.volume_m3() / 0.05_f64.powi(3) - 1.0).abs() < 1e-12, "{}", mesh.volume_m3());
            assert_eq!(Topology::build(&mesh).unwrap().surface_triangles().count(), n_triangles);
            assert_eq!(mesh.tetrahedra.len(), n_tets);
            assert!((n_tets as f64 / 353.0 - 1.0).abs() < 0.05);
        }
    }
}
