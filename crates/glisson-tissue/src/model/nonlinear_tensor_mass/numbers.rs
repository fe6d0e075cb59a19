//! The stiffness numbers of the non-linear part and where they are kept (seed `002`, table 1).
//!
//! | on | vectors C | scalars D |
//! |---|---|---|
//! | vertex p | ppp | pppp |
//! | edge p < j | ppj, pjj, jpp, jjp | jppp, jjjp, jjpp, jpjp, pjjp |
//! | triangle p < j < k | pjk, jkp, kjp | for each of its nodes q, the others r < s: rsqq, rqsq, qrsq |
//! | tetrahedron p, j, k, l | | jklp, kjlp, jlkp, ljkp, kljp, lkjp |
//!
//! All other index orders are equal to one of these: C_jkl = C_jlk, D_jklm = D_lmjk = D_kjml. The report's table
//! prints jppp and jjjp of the edge twice and garbles others; these follow from its eq. 9. Three further sums would
//! do (the two last of an edge and of each q, and each pair of the tetrahedron, always enter added up); all are
//! kept, as the report has them, so that a removal takes out 4 (9 + 3 + 1) + 6 (9 + 12 + 5) + 4 (9 + 9) = 280
//! numbers, the tensors B included.

use crate::model::explicit::{Insertions, LiveTets, place_of};
use crate::model::tet_law::TetShape;
use glisson_mesh::math::DVec3;
use glisson_mesh::mesh::{NodeId, TetId, TetMesh};

/// Local nodes of the triangle opposite to each corner.
pub(super) const LOCAL_TRIANGLES: [[usize; 3]; 4] = [[1, 2, 3], [0, 2, 3], [0, 1, 3], [0, 1, 2]];

/// Non-linear stiffness of a vertex p.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct VertexStiffness {
    /// C_ppp [N/m2].
    pub c: DVec3,
    /// D_pppp [N/m3].
    pub d: f64,
}

/// Non-linear stiffness of an edge (p, j), p < j.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct EdgeStiffness {
    /// C_ppj, C_pjj, C_jpp, C_jjp [N/m2].
    pub c: [DVec3; 4],
    /// D_jppp, D_jjjp, D_jjpp, D_jpjp, D_pjjp [N/m3].
    pub d: [f64; 5],
}

/// Non-linear stiffness of a triangle (p, j, k), p < j < k.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct TriangleStiffness {
    /// C_pjk, C_jkp, C_kjp [N/m2].
    pub c: [DVec3; 3],
    /// For q = p, j, k with the others r < s: D_rsqq, D_rqsq, D_qrsq [N/m3].
    pub d: [[f64; 3]; 3],
}

/// Non-linear stiffness of a tetrahedron (p, j, k, l), in the order of its corners, whatever their numbers.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct TetScalars {
    /// D_jklp, D_kjlp; D_jlkp, D_ljkp; D_kljp, D_lkjp [N/m3].
    pub d: [[f64; 2]; 3],
}

/// Numbers that are summed over tetrahedra.
pub(super) trait Summed: Copy + Default {
    /// Adds `sign` times `other`; exact but for the rounding of the sum when the sign is 1 or -1.
    fn add(&mut self, other: &Self, sign: f64);
}

impl Summed for VertexStiffness {
    fn add(&mut self, other: &Self, sign: f64) {
        self.c += other.c * sign;
        self.d += other.d * sign;
    }
}

impl Summed for EdgeStiffness {
    fn add(&mut self, other: &Self, sign: f64) {
        self.c.iter_mut().zip(&other.c).for_each(|(c, other)| *c += *other * sign);
        self.d.iter_mut().zip(&other.d).for_each(|(d, other)| *d += *other * sign);
    }
}

impl Summed for TriangleStiffness {
    fn add(&mut self, other: &Self, sign: f64) {
        self.c.iter_mut().zip(&other.c).for_each(|(c, other)| *c += *other * sign);
        let others = other.d.as_flattened();
        self.d.as_flattened_mut().iter_mut().zip(others).for_each(|(d, other)| *d += *other * sign);
    }
}

/// What one tetrahedron adds to its vertices, edges and triangles, and keeps itself.
impl TetShape {
    pub(super) fn of_vertex(&self, p: usize) -> VertexStiffness {
        VertexStiffness { c: self.c(p, p, p), d: self.d(p, p, p, p) }
    }

    pub(super) fn of_edge(&self, [p, j]: [usize; 2]) -> EdgeStiffness {
        EdgeStiffness {
            c: [self.c(p, p, j), self.c(p, j, j), self.c(j, p, p), self.c(j, j, p)],
            d: [
                self.d(j, p, p, p),
                self.d(j, j, j, p),
                self.d(j, j, p, p),
                self.d(j, p, j, p),
                self.d(p, j, j, p),
            ],
        }
    }

    pub(super) fn of_triangle(&self, [p, j, k]: [usize; 3]) -> TriangleStiffness {
        let doubled = |q, r, s| [self.d(r, s, q, q), self.d(r, q, s, q), self.d(q, r, s, q)];
        TriangleStiffness {
            c: [self.c(p, j, k), self.c(j, k, p), self.c(k, j, p)],
            d: [doubled(p, j, k), doubled(j, p, k), doubled(k, p, j)],
        }
    }

    pub(super) fn of_tet(&self) -> TetScalars {
        let (p, j, k, l) = (0, 1, 2, 3);
        let pair = |a, b, c| [self.d(a, b, c, p), self.d(b, a, c, p)];
        TetScalars { d: [pair(j, k, l), pair(j, l, k), pair(k, l, j)] }
    }
}

/// Local nodes of an edge or triangle, lowest mesh node first.
pub(super) fn ascending<const N: usize>(mut local: [usize; N], nodes: &[NodeId; 4]) -> [usize; N] {
    local.sort_unstable_by_key(|&i| nodes[i]);
    local
}

/// The triangles of a mesh: each once, ascending, and the four of each tetrahedron.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct MeshTriangles {
    /// Nodes of each triangle, ascending.
    pub nodes: Vec<[NodeId; 3]>,
    /// Triangle opposite to each corner of each tetrahedron.
    pub of_tet: Vec<[u32; 4]>,
    /// Live tetrahedra at each triangle.
    pub tets: Vec<u32>,
}

impl MeshTriangles {
    /// The triangles of a mesh whose tetrahedra name nodes that exist.
    pub(super) fn of_mesh(mesh: &TetMesh) -> Self {
        let mut keyed = Vec::with_capacity(4 * mesh.tetrahedra.len());
        for (t, nodes) in mesh.tetrahedra.iter().enumerate() {
            for (corner, local) in LOCAL_TRIANGLES.into_iter().enumerate() {
                keyed.push((ascending(local, nodes).map(|i| nodes[i]), t, corner));
            }
        }
        keyed.sort_unstable();
        let mut triangles = Self { of_tet: vec![[0; 4]; mesh.tetrahedra.len()], ..Self::default() };
        for (key, t, corner) in keyed {
            if triangles.nodes.last() != Some(&key) {
                triangles.nodes.push(key);
                triangles.tets.push(0);
            }
            let at = triangles.nodes.len() - 1;
            triangles.tets[at] += 1;
            triangles.of_tet[t][corner] = u32::try_from(at).expect("fewer than 2^32 triangles");
        }
        triangles
    }

    /// Adds the triangles of tetrahedra that are not counted yet, and room for all of `tets`. Where new triangles come
    /// into the lists by triangle.
    pub(super) fn grow(&mut self, tets: &LiveTets, added: &[TetId]) -> Insertions {
        let corners = |tet: &TetId| {
            let nodes = tets.nodes[tet.index()];
            LOCAL_TRIANGLES.map(|local| ascending(local, &nodes).map(|i| nodes[i]))
        };
        let insertions = Insertions::into(&mut self.nodes, added.iter().flat_map(corners).collect());
        insertions.spread(&mut self.tets, 0);
        insertions.renumber(self.of_tet.as_flattened_mut());
        self.of_tet.resize(tets.nodes.len(), [0; 4]);
        for tet in added {
            self.of_tet[tet.index()] = corners(tet).map(|key| place_of(&self.nodes, &key));
        }
        insertions
    }
}
