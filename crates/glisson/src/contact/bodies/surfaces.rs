//! The surfaces of all bodies and of the obstacles that are meshes, under one numbering.

use crate::math::DVec3;
use crate::mesh::NodeId;
use crate::surface::TriMesh;

/// Marks an edge without a second triangle.
pub(super) const NO_TRIANGLE: u32 = u32::MAX;

/// Vertices, triangles and edges of everything that touches. Bodies come first, then obstacles.
#[derive(Clone, Debug, Default)]
pub(super) struct Surfaces {
    /// Where the vertices of each body or obstacle start, and the end.
    pub(super) starts: Vec<u32>,
    /// The node of each vertex in its body; of no meaning for obstacles.
    pub(super) nodes: Vec<NodeId>,
    /// Body or obstacle of each vertex.
    pub(super) owner: Vec<u32>,
    pub(super) triangles: Vec<[u32; 3]>,
    /// Body or obstacle of each triangle.
    pub(super) triangle_owner: Vec<u32>,
    /// Edges, the lower vertex first.
    pub(super) edges: Vec<[u32; 2]>,
    /// Their first two triangles.
    pub(super) edge_triangles: Vec<[u32; 2]>,
    /// The edges of each triangle.
    pub(super) triangle_edges: Vec<[u32; 3]>,
    /// The first triangle at each vertex.
    pub(super) first_triangle: Vec<u32>,
    /// Positions [m] at the start of the step.
    pub(super) start_m: Vec<DVec3>,
    /// How far they go in it [m].
    pub(super) moves_m: Vec<DVec3>,
}

impl Surfaces {
    /// Adds the surface of a body, or of an obstacle with its vertices as nodes.
    pub(super) fn add(&mut self, surface: &TriMesh, nodes: impl Iterator<Item = NodeId>) {
        let (first, owner) = (self.owner.len() as u32, self.starts.len() as u32);
        self.starts.push(first);
        self.nodes.extend(nodes);
        self.owner.resize(first as usize + surface.positions_m.len(), owner);
        self.start_m.extend_from_slice(&surface.positions_m);
        self.triangles.extend(surface.triangles.iter().map(|t| t.map(|v| v + first)));
        self.triangle_owner.resize(self.triangles.len(), owner);
    }

    /// Edges, and what hangs together, after the last surface was added.
    pub(super) fn finish(&mut self) {
        self.starts.push(self.owner.len() as u32);
        self.moves_m = vec![DVec3::ZERO; self.owner.len()];
        let mut sides: Vec<([u32; 2], u32, u8)> = Vec::with_capacity(3 * self.triangles.len());
        for (t, corners) in self.triangles.iter().enumerate() {
            for e in 0..3 {
                let (a, b) = (corners[e], corners[(e + 1) % 3]);
                sides.push(([a.min(b), a.max(b)], t as u32, e as u8));
            }
        }
        sides.sort_unstable();
        self.triangle_edges = vec![[0; 3]; self.triangles.len()];
        for of_edge in sides.chunk_by(|a, b| a.0 == b.0) {
            for (_, t, e) in of_edge {
                self.triangle_edges[*t as usize][*e as usize] = self.edges.len() as u32;
            }
            self.edges.push(of_edge[0].0);
            self.edge_triangles.push([of_edge[0].1, of_edge.get(1).map_or(NO_TRIANGLE, |side| side.1)]);
        }
        self.first_triangle = vec![NO_TRIANGLE; self.owner.len()];
        for (t, corners) in self.triangles.iter().enumerate() {
            for &v in corners {
                let first = &mut self.first_triangle[v as usize];
                *first = (*first).min(t as u32);
            }
        }
    }

    /// The vertices of a body or obstacle.
    pub(super) fn vertices_of(&self, owner: usize) -> std::ops::Range<usize> {
        self.starts[owner] as usize..self.starts[owner + 1] as usize
    }

    pub(super) fn corners_m(&self, t: u32) -> [DVec3; 3] {
        self.triangles[t as usize].map(|v| self.start_m[v as usize])
    }

    /// Twice the area vector of a triangle [m2].
    pub(super) fn area_m2(&self, t: u32) -> DVec3 {
        let [a, b, c] = self.corners_m(t);
        (b - a).cross(c - a)
    }

    /// Sum of the unit normals of the triangles of an edge.
    pub(super) fn edge_normal(&self, edge: u32) -> DVec3 {
        let [s, t] = self.edge_triangles[edge as usize];
        let first = self.area_m2(s).normalize_or_zero();
        if t == NO_TRIANGLE { first } else { first + self.area_m2(t).normalize_or_zero() }
    }

    /// Whether the surface bends outwards at an edge by more than `sine`, or ends there.
    pub(super) fn is_ridge(&self, edge: u32, sine: f64) -> bool {
        let [s, t] = self.edge_triangles[edge as usize];
        if t == NO_TRIANGLE {
            return true;
        }
        let [a, b] = self.edges[edge as usize];
        let opposite = self.triangles[t as usize].into_iter().find(|&v| v != a && v != b);
        let Some(opposite) = opposite else { return false };
        let [a_m, b_m] = [a, b].map(|v| self.start_m[v as usize]);
        let along = (b_m - a_m).normalize_or_zero();
        let arm = self.start_m[opposite as usize] - a_m;
        let across = arm - along * arm.dot(along);
        across.normalize_or_zero().dot(self.area_m2(s).normalize_or_zero()) < -sine
    }
}
