//! How good a tetrahedral mesh is.
//!
//! - Dihedral angle at an edge: the inner angle between the two faces that meet there; 70.53 degrees in the
//!   regular tetrahedron.
//! - Radius ratio: 3 r_in / r_out, 1 for the regular tetrahedron, 0 for a flat one (Liu and Joe 1994,
//!   doi 10.1007/BF01955874), with r_in = 3 V / (sum of face areas) and
//!   r_out = |a^2 (b x c) + b^2 (c x a) + c^2 (a x b)| / (12 V) for the edges a, b, c from one corner.

mod criteria;

pub use criteria::{
    Criterion, Degeneracy, DegeneracyLimits, REGULAR_DIHEDRAL_RAD, REGULAR_SOLID_ANGLE_SR, TetMeasures,
    degeneracy,
};

use super::{TetId, TetMesh};
use crate::disjoint_sets::DisjointSets;
use crate::math::{Aabb, DVec3, tetrahedron_volume_m3};
use std::collections::BTreeSet;

/// Width of a bin of the dihedral angles' histogram [degrees].
pub const DIHEDRAL_BIN_DEG: f64 = 5.0;

/// Number of bins of the radius ratios' histogram over 0 to 1.
pub const RADIUS_RATIO_BINS: usize = 20;

/// The faces of a tetrahedron with positive volume, each counter-clockwise seen from outside; face i is
/// opposite to corner i.
pub const FACES: [[usize; 3]; 4] = [[1, 2, 3], [0, 3, 2], [0, 1, 3], [0, 2, 1]];

/// Shape of a triangle surface as a complex.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct SurfaceShape {
    /// Vertices that a triangle uses.
    pub n_vertices: usize,
    /// Edges.
    pub n_edges: usize,
    /// Triangles.
    pub n_triangles: usize,
    /// Vertices - edges + triangles: 2 for each piece like a sphere.
    pub euler_characteristic: i64,
    /// Number of pieces connected by vertices.
    pub pieces: usize,
    /// Edges that do not have one triangle on each side in opposite directions, apart from pinched ones.
    pub open_edges: Vec<[u32; 2]>,
    /// Edges with more than two triangles, as many in one direction as in the other.
    pub pinched_edges: Vec<[u32; 2]>,
    /// Vertices at which more than one fan of triangles meets.
    pub pinched_vertices: Vec<u32>,
}

impl SurfaceShape {
    /// Shape of `triangles` over `n_vertices` vertices.
    ///
    /// # Panics
    /// When a triangle names a vertex at or above `n_vertices`.
    pub fn of(n_vertices: usize, triangles: &[[u32; 3]]) -> Self {
        // Each side of a triangle: edge with its lower vertex first, whether it runs upwards, the corner where
        // it starts and the corner where it ends.
        let mut sides: Vec<([u32; 2], bool, usize, usize)> = Vec::with_capacity(3 * triangles.len());
        for (t, corners) in triangles.iter().enumerate() {
            for side in 0..3 {
                let (a, b) = (corners[side], corners[(side + 1) % 3]);
                let (from, to) = (3 * t + side, 3 * t + (side + 1) % 3);
                sides.push(([a.min(b), a.max(b)], a < b, from, to));
            }
        }
        sides.sort_unstable();
        let mut shape = Self { n_triangles: triangles.len(), ..Self::default() };
        let mut fans = DisjointSets::new(3 * triangles.len());
        for edge in sides.chunk_by(|a, b| a.0 == b.0) {
            shape.n_edges += 1;
            let n_upward = edge.iter().filter(|s| s.1).count();
            if 2 * n_upward != edge.len() {
                shape.open_edges.push(edge[0].0);
            } else if edge.len() > 2 {
                shape.pinched_edges.push(edge[0].0);
            } else {
                fans.join(edge[0].2, edge[1].3);
                fans.join(edge[0].3, edge[1].2);
            }
        }
        let mut fan_of_vertex = vec![usize::MAX; n_vertices];
        let mut pieces = DisjointSets::new(n_vertices);
        let mut pinched = BTreeSet::new();
        for (corner, &vertex) in triangles.iter().flatten().enumerate() {
            let fan = fans.root(corner);
            let known = &mut fan_of_vertex[vertex as usize];
            if *known == usize::MAX {
                *known = fan;
                shape.n_vertices += 1;
            } else if *known != fan {
                pinched.insert(vertex);
            }
            pieces.join(vertex as usize, triangles[corner / 3][0] as usize);
        }
        // The ends of open and pinched edges have more fans, too, but they are told by their edges.
        for end in shape.open_edges.iter().chain(&shape.pinched_edges).flatten() {
            pinched.remove(end);
        }
        shape.pinched_vertices = pinched.into_iter().collect();
        let used = (0..n_vertices).filter(|&v| fan_of_vertex[v] != usize::MAX);
        shape.pieces = used.map(|v| pieces.root(v)).collect::<BTreeSet<_>>().len();
        shape.euler_characteristic =
            shape.n_vertices as i64 - shape.n_edges as i64 + shape.n_triangles as i64;
        shape
    }

    /// Whether every edge has one triangle on each side and every vertex one fan.
    pub fn is_closed_manifold(&self) -> bool {
        self.open_edges.is_empty() && self.pinched_edges.is_empty() && self.pinched_vertices.is_empty()
    }

    /// Piece of each vertex, numbered by first vertex among those used; `u32::MAX` for unused ones.
    pub fn piece_of_vertices(n_vertices: usize, triangles: &[[u32; 3]]) -> Vec<u32> {
        let mut sets = DisjointSets::new(n_vertices);
        let mut used = vec![false; n_vertices];
        for triangle in triangles {
            for &v in triangle {
                used[v as usize] = true;
                sets.join(v as usize, triangle[0] as usize);
            }
        }
        let mut number = vec![u32::MAX; n_vertices];
        let mut n_pieces = 0;
        let mut piece = vec![u32::MAX; n_vertices];
        for v in (0..n_vertices).filter(|&v| used[v]) {
            let root = sets.root(v);
            if number[root] == u32::MAX {
                number[root] = n_pieces;
                n_pieces += 1;
            }
            piece[v] = number[root];
        }
        piece
    }
}

/// Faces that belong to one tetrahedron only, counter-clockwise seen from outside, in the order of their
/// sorted nodes; and faces that belong to more than two.
pub fn surface_triangles(mesh: &TetMesh) -> (Vec<[u32; 3]>, Vec<[u32; 3]>) {
    let mut faces: Vec<([u32; 3], [u32; 3])> = Vec::with_capacity(4 * mesh.tetrahedra.len());
    for nodes in &mesh.tetrahedra {
        for face in FACES {
            let corners = face.map(|c| nodes[c].0);
            let mut sorted = corners;
            sorted.sort_unstable();
            faces.push((sorted, corners));
        }
    }
    faces.sort_unstable();
    let (mut surface, mut overshared) = (Vec::new(), Vec::new());
    for same in faces.chunk_by(|a, b| a.0 == b.0) {
        match same.len() {
            1 => surface.push(same[0].1),
            2 => {}
            _ => overshared.push(same[0].0),
        }
    }
    (surface, overshared)
}

/// Smallest and largest cosine of the six dihedral angles; the smallest belongs to the largest angle. A flat
/// tetrahedron gives [-1, 1].
pub fn dihedral_cosine_range(corners_m: [DVec3; 4]) -> [f64; 2] {
    let cosines = dihedral_cosines(corners_m);
    cosines.iter().fold([1.0, -1.0], |[low, high], &c| [c.min(low), c.max(high)])
}

/// Cosines of the dihedral angles at the six edges, in the order of the pairs of faces 01, 02, 03, 12, 13, 23;
/// 1 and -1 by turns where a face has no area.
fn dihedral_cosines(corners_m: [DVec3; 4]) -> [f64; 6] {
    const PAIRS: [[usize; 2]; 6] = [[0, 1], [0, 2], [0, 3], [1, 2], [1, 3], [2, 3]];
    // A loop: the closures of `map` were calls.
    let mut normals = [None; 4];
    for (normal, [a, b, c]) in normals.iter_mut().zip(FACES) {
        *normal = (corners_m[b] - corners_m[a]).cross(corners_m[c] - corners_m[a]).try_normalize();
    }
    let mut cosines = [0.0; 6];
    for (at, [i, j]) in PAIRS.into_iter().enumerate() {
        cosines[at] = match (normals[i], normals[j]) {
            (Some(m), Some(n)) => (-m.dot(n)).clamp(-1.0, 1.0),
            _ => 1.0 - 2.0 * (at % 2) as f64,
        };
    }
    cosines
}

/// Radius ratio 3 r_in / r_out of a tetrahedron: 1 for the regular one, 0 for a flat or inverted one.
pub fn radius_ratio(corners_m: [DVec3; 4]) -> f64 {
    let volume_m3 = tetrahedron_volume_m3(corners_m);
    if volume_m3 <= 0.0 {
        return 0.0;
    }
    let area_m2: f64 = FACES
        .iter()
        .map(|f| 0.5 * (corners_m[f[1]] - corners_m[f[0]]).cross(corners_m[f[2]] - corners_m[f[0]]).length())
        .sum();
    let [a, b, c] = [1, 2, 3].map(|i| corners_m[i] - corners_m[0]);
    let across =
        a.length_squared() * b.cross(c) + b.length_squared() * c.cross(a) + c.length_squared() * a.cross(b);
    let inner_m = 3.0 * volume_m3 / area_m2;
    let outer_m = across.length() / (12.0 * volume_m3);
    3.0 * inner_m / outer_m
}

/// The six dihedral angles [degrees] of each tetrahedron in turn; a face without area gives 0 and 180.
pub fn dihedral_angles_deg(mesh: &TetMesh) -> Vec<f64> {
    (0..mesh.tetrahedra.len())
        .flat_map(|t| dihedral_cosines(mesh.corners_m(TetId::from_index(t))))
        .map(|cosine| libm::acos(cosine).to_degrees())
        .collect()
}

/// The radius ratio of each tetrahedron.
pub fn radius_ratios(mesh: &TetMesh) -> Vec<f64> {
    (0..mesh.tetrahedra.len()).map(|t| radius_ratio(mesh.corners_m(TetId::from_index(t)))).collect()
}

/// What the numbers of a mesh look like; lengths in metres, angles in degrees.
#[derive(Clone, Debug, PartialEq, serde::Serialize)]
pub struct MeshQuality {
    /// Number of nodes.
    pub nodes: usize,
    /// Number of tetrahedra.
    pub tetrahedra: usize,
    /// Sum of the signed volumes [m3].
    pub volume_m3: f64,
    /// Smallest dihedral angle [degrees].
    pub min_dihedral_deg: f64,
    /// Largest dihedral angle [degrees].
    pub max_dihedral_deg: f64,
    /// Smallest radius ratio.
    pub min_radius_ratio: f64,
    /// Mean radius ratio.
    pub mean_radius_ratio: f64,
    /// Shortest edge [m].
    pub min_edge_m: f64,
    /// Mean edge [m].
    pub mean_edge_m: f64,
    /// Longest edge [m].
    pub max_edge_m: f64,
    /// Smallest signed volume of a tetrahedron [m3].
    pub min_tetrahedron_volume_m3: f64,
    /// Largest volume of a tetrahedron [m3].
    pub max_tetrahedron_volume_m3: f64,
    /// Number of triangles of the surface.
    pub surface_triangles: usize,
    /// Area of the surface [m2].
    pub surface_area_m2: f64,
    /// Euler characteristic of the surface: 2 for each piece like a sphere.
    pub surface_euler_characteristic: i64,
    /// Number of connected surfaces: bodies and cavities.
    pub surface_pieces: usize,
    /// Smallest corner of the box around the nodes [m].
    pub bounds_min_m: [f64; 3],
    /// Largest corner of the box around the nodes [m].
    pub bounds_max_m: [f64; 3],
    /// Dihedral angles in bins of [`DIHEDRAL_BIN_DEG`] from 0 to 180; the sum is six a tetrahedron.
    pub dihedral_histogram: Vec<usize>,
    /// Radius ratios in [`RADIUS_RATIO_BINS`] bins from 0 to 1; the sum is one a tetrahedron.
    pub radius_ratio_histogram: Vec<usize>,
}

impl MeshQuality {
    /// Quality of `mesh`. Of a mesh without tetrahedra the extremes are 0.
    ///
    /// # Panics
    /// When a tetrahedron names a node that does not exist.
    pub fn of(mesh: &TetMesh) -> Self {
        let (surface, _) = surface_triangles(mesh);
        let shape = SurfaceShape::of(mesh.positions_m.len(), &surface);
        let mut dihedral = Range::new();
        let mut ratio = Range::new();
        let mut volume = Range::new();
        let n_bins = (180.0 / DIHEDRAL_BIN_DEG) as usize;
        let mut dihedral_histogram = vec![0; n_bins];
        let mut radius_ratio_histogram = vec![0; RADIUS_RATIO_BINS];
        for angle_deg in dihedral_angles_deg(mesh) {
            dihedral.add(angle_deg);
            dihedral_histogram[((angle_deg / DIHEDRAL_BIN_DEG) as usize).min(n_bins - 1)] += 1;
        }
        for this_ratio in radius_ratios(mesh) {
            ratio.add(this_ratio);
            let bin = (this_ratio * RADIUS_RATIO_BINS as f64) as usize;
            radius_ratio_histogram[bin.min(RADIUS_RATIO_BINS - 1)] += 1;
        }
        for t in 0..mesh.tetrahedra.len() {
            volume.add(mesh.tet_volume_m3(TetId::from_index(t)));
        }
        let edge = edge_lengths_m(mesh);
        let bounds_m = match mesh.positions_m[..] {
            [] => Aabb { min_m: DVec3::ZERO, max_m: DVec3::ZERO },
            _ => Aabb::of_points(&mesh.positions_m),
        };
        let area = |t: &[u32; 3]| {
            let [a, b, c] = t.map(|v| mesh.positions_m[v as usize]);
            0.5 * (b - a).cross(c - a).length()
        };
        Self {
            nodes: mesh.positions_m.len(),
            tetrahedra: mesh.tetrahedra.len(),
            volume_m3: volume.sum,
            min_dihedral_deg: dihedral.min(),
            max_dihedral_deg: dihedral.max(),
            min_radius_ratio: ratio.min(),
            mean_radius_ratio: ratio.mean(),
            min_edge_m: edge.min(),
            mean_edge_m: edge.mean(),
            max_edge_m: edge.max(),
            min_tetrahedron_volume_m3: volume.min(),
            max_tetrahedron_volume_m3: volume.max(),
            surface_triangles: surface.len(),
            surface_area_m2: surface.iter().map(area).sum(),
            surface_euler_characteristic: shape.euler_characteristic,
            surface_pieces: shape.pieces,
            bounds_min_m: bounds_m.min_m.to_array(),
            bounds_max_m: bounds_m.max_m.to_array(),
            dihedral_histogram,
            radius_ratio_histogram,
        }
    }
}

/// Lengths [m] of the edges, each counted once.
fn edge_lengths_m(mesh: &TetMesh) -> Range {
    let mut edges: Vec<[u32; 2]> = Vec::with_capacity(6 * mesh.tetrahedra.len());
    for nodes in &mesh.tetrahedra {
        for i in 0..4 {
            for j in i + 1..4 {
                edges.push([nodes[i].0.min(nodes[j].0), nodes[i].0.max(nodes[j].0)]);
            }
        }
    }
    edges.sort_unstable();
    edges.dedup();
    let mut lengths = Range::new();
    for [a, b] in edges {
        lengths.add(mesh.positions_m[a as usize].distance(mesh.positions_m[b as usize]));
    }
    lengths
}

struct Range {
    low: f64,
    high: f64,
    sum: f64,
    count: usize,
}

impl Range {
    fn new() -> Self {
        Self { low: f64::INFINITY, high: f64::NEG_INFINITY, sum: 0.0, count: 0 }
    }

    fn add(&mut self, value: f64) {
        self.low = self.low.min(value);
        self.high = self.high.max(value);
        self.sum += value;
        self.count += 1;
    }

    fn min(&self) -> f64 {
        if self.count == 0 { 0.0 } else { self.low }
    }

    fn max(&self) -> f64 {
        if self.count == 0 { 0.0 } else { self.high }
    }

    fn mean(&self) -> f64 {
        if self.count == 0 { 0.0 } else { self.sum / self.count as f64 }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::NodeId;

    fn regular() -> TetMesh {
        let positions_m = [(1., 1., 1.), (1., -1., -1.), (-1., 1., -1.), (-1., -1., 1.)];
        TetMesh {
            positions_m: positions_m.map(|(x, y, z)| DVec3::new(x, y, z)).to_vec(),
            tetrahedra: vec![[NodeId(0), NodeId(1), NodeId(3), NodeId(2)]],
            ..TetMesh::default()
        }
    }

    #[test]
    fn regular_tetrahedron_has_the_known_numbers() {
        let mesh = regular();
        let quality = MeshQuality::of(&mesh);
        let angle_deg = (1.0f64 / 3.0).acos().to_degrees();
        assert!((quality.min_dihedral_deg - angle_deg).abs() < 1e-12);
        assert!((quality.max_dihedral_deg - angle_deg).abs() < 1e-12);
        assert!((quality.min_radius_ratio - 1.0).abs() < 1e-14);
        assert!((quality.volume_m3 - 8.0 / 3.0).abs() < 1e-14);
        assert!((quality.mean_edge_m - 8f64.sqrt()).abs() < 1e-14);
        assert_eq!((quality.surface_euler_characteristic, quality.surface_pieces), (2, 1));
        assert_eq!(quality.dihedral_histogram[14], 6);
        assert_eq!(quality.radius_ratio_histogram.iter().sum::<usize>(), 1);
    }

    #[test]
    fn corner_tetrahedron_has_right_angles_and_its_radius_ratio() {
        let corners = [DVec3::ZERO, DVec3::X, DVec3::Y, DVec3::Z];
        let [min, max] = dihedral_cosine_range(corners);
        assert!(min.abs() < 1e-15 && (max - 1.0 / 3f64.sqrt()).abs() < 1e-15);
        // r_in = 1 / (3 + sqrt 3), r_out = sqrt(3) / 2.
        let expected = 6.0 / (3f64.sqrt() * (3.0 + 3f64.sqrt()));
        assert!((radius_ratio(corners) - expected).abs() < 1e-15);
    }

    #[test]
    fn two_tetrahedra_at_a_node_or_an_edge_are_pinched() {
        let mut mesh = regular();
        let far = |p: DVec3| 2.0 * mesh.positions_m[0] - p;
        let mirrored: Vec<DVec3> = mesh.positions_m[1..].iter().map(|&p| far(p)).collect();
        mesh.positions_m.extend(mirrored);
        mesh.tetrahedra.push([NodeId(0), NodeId(4), NodeId(5), NodeId(6)]);
        let shape = |mesh: &TetMesh| SurfaceShape::of(mesh.positions_m.len(), &surface_triangles(mesh).0);
        assert_eq!(shape(&mesh).pinched_vertices, [0]);
        mesh.tetrahedra[1] = [NodeId(0), NodeId(1), NodeId(4), NodeId(5)];
        assert_eq!(shape(&mesh).pinched_edges, [[0, 1]]);
        assert!(!shape(&mesh).is_closed_manifold());
    }
}
