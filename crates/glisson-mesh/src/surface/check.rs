//! Whether a triangle mesh is the closed, outward oriented surface of a solid.

use rayon::prelude::*;

use super::TriMesh;
use super::error::{Place, SurfaceError};
use super::intersect::self_intersections;
use super::normals::area_m2;
use super::winding::solid_angle_sr;
use crate::disjoint_sets::DisjointSets;
use crate::math::{Aabb, DVec3};

/// A triangle whose smallest height is below this share of its longest edge has no area: its normal is
/// rounding noise.
const SMALLEST_RELATIVE_HEIGHT: f64 = 1e-9;

/// Counts and measures of a closed surface.
#[derive(Clone, Debug, PartialEq)]
pub struct SurfaceTopology {
    /// Vertices that triangles use.
    pub n_vertices: usize,
    /// Vertices that no triangle uses.
    pub n_unused_vertices: usize,
    /// Edges.
    pub n_edges: usize,
    /// Triangles.
    pub n_triangles: usize,
    /// Connected pieces.
    pub n_pieces: usize,
    /// Vertices - edges + triangles: 2 for each ball, 2 less for each tunnel.
    pub euler_characteristic: i64,
    /// Enclosed volume [m3].
    pub volume_m3: f64,
    /// Area [m2].
    pub area_m2: f64,
}

/// Checks that `mesh` is closed, a manifold at its edges and vertices, oriented outward (a piece inside an
/// odd number of others bounds a cavity and faces inward), without degenerate triangles and without
/// self-intersection.
///
/// # Errors
/// [`SurfaceError`]: the first violation by index, with its place.
pub fn check_closed(mesh: &TriMesh) -> Result<SurfaceTopology, SurfaceError> {
    let pieces = check_manifold(mesh)?;
    // First, because what is inside what has no meaning for pieces that cross.
    if let Some(&triangles) = self_intersections(mesh, 1).first() {
        let place = Place(mesh.corners_m(triangles[0] as usize)[0]);
        return Err(SurfaceError::SelfIntersection { triangles, place });
    }
    for piece in &pieces.list {
        let inward = pieces.depth(mesh, piece) % 2 == 1;
        if (piece.volume_m3 < 0.0) != inward {
            return Err(SurfaceError::InsideOut {
                triangle: piece.first_triangle,
                volume_ml: 1e6 * piece.volume_m3,
                place: Place(mesh.corners_m(piece.first_triangle)[0]),
            });
        }
    }
    Ok(pieces.topology)
}

/// Turns over the closed pieces of `mesh` that are inside out; answers how many. Neighbouring triangles must
/// agree already.
///
/// # Errors
/// As [`check_closed`], but for self-intersection.
pub fn orient_outward(mesh: &mut TriMesh) -> Result<usize, SurfaceError> {
    let pieces = check_manifold(mesh)?;
    let mut turned = 0;
    for (label, piece) in pieces.list.iter().enumerate() {
        let inward = pieces.depth(mesh, piece) % 2 == 1;
        if (piece.volume_m3 < 0.0) != inward {
            turned += 1;
            for (triangle, &l) in mesh.triangles.iter_mut().zip(&pieces.labels) {
                if l as usize == label {
                    triangle.swap(1, 2);
                }
            }
        }
    }
    Ok(turned)
}

/// One connected piece.
struct Piece {
    first_triangle: usize,
    volume_m3: f64,
    bounds: Aabb,
}

struct Pieces {
    /// Piece of each triangle.
    labels: Vec<u32>,
    list: Vec<Piece>,
    topology: SurfaceTopology,
}

impl Pieces {
    /// Number of other pieces around `piece`.
    fn depth(&self, mesh: &TriMesh, piece: &Piece) -> usize {
        let point = mesh.corners_m(piece.first_triangle)[0];
        let around = |&(label, other): &(usize, &Piece)| {
            other.first_triangle != piece.first_triangle
                && other.bounds.contains(point)
                && self.winding_number(mesh, label, point).abs() > 0.5
        };
        self.list.iter().enumerate().filter(around).count()
    }

    /// How often piece `label` goes around `point`.
    fn winding_number(&self, mesh: &TriMesh, label: usize, point: DVec3) -> f64 {
        let own = self.labels.iter().enumerate().filter(|&(_, &l)| l as usize == label);
        let angles = own.map(|(t, _)| solid_angle_sr(point, mesh.corners_m(t)));
        angles.sum::<f64>() / (4.0 * std::f64::consts::PI)
    }
}

/// One side of a triangle, its vertices ascending.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(super) struct Side {
    pub(super) low: u32,
    pub(super) high: u32,
    pub(super) triangle: u32,
    /// The triangle runs from `low` to `high`.
    pub(super) ascending: bool,
}

/// Every side of every triangle, in ascending order, so that those of one edge stand together.
pub(super) fn sorted_sides(mesh: &TriMesh) -> Vec<Side> {
    let mut sides = Vec::with_capacity(3 * mesh.triangles.len());
    for (t, triangle) in mesh.triangles.iter().enumerate() {
        for c in 0..3 {
            let (from, to) = (triangle[c], triangle[(c + 1) % 3]);
            let triangle = u32::try_from(t).expect("meshes have fewer than 2^32 triangles");
            sides.push(Side { low: from.min(to), high: from.max(to), triangle, ascending: from < to });
        }
    }
    sides.par_sort_unstable();
    sides
}

/// The two sides of an edge when exactly two triangles meet there with the same orientation. `n_open` counts the open
/// edges of the mesh.
pub(super) fn check_edge(
    mesh: &TriMesh,
    edge: &[Side],
    n_open: impl Fn() -> usize,
) -> Result<[Side; 2], SurfaceError> {
    let first = edge[0];
    let vertices = [first.low, first.high];
    let place = Place(0.5 * vertices.map(|v| mesh.positions_m[v as usize]).into_iter().sum::<DVec3>());
    match *edge {
        [a] => {
            Err(SurfaceError::OpenEdge { vertices, triangle: a.triangle as usize, place, n_open: n_open() })
        }
        [a, b] if a.ascending != b.ascending => Ok([a, b]),
        [a, b] => {
            let triangles = [a.triangle as usize, b.triangle as usize];
            Err(SurfaceError::InconsistentOrientation { vertices, triangles, place })
        }
        [a, b, ..] => {
            let triangles = [a.triangle as usize, b.triangle as usize];
            let n_triangles = edge.len();
            Err(SurfaceError::NonManifoldEdge { vertices, triangles, n_triangles, place })
        }
        [] => unreachable!("chunk_by gives no empty chunk"),
    }
}

/// The pieces whose triangles `triangle_sets` joins, and the label of each triangle.
fn label_pieces(mesh: &TriMesh, triangle_sets: &mut DisjointSets) -> (Vec<u32>, Vec<Piece>) {
    let n_triangles = mesh.triangles.len();
    let mut labels = vec![u32::MAX; n_triangles];
    let mut list: Vec<Piece> = Vec::new();
    for t in 0..n_triangles {
        let root = triangle_sets.root(t);
        // Roots are the smallest member, so a root is labelled before its members.
        if root == t {
            labels[t] = u32::try_from(list.len()).expect("fewer pieces than triangles");
            list.push(Piece { first_triangle: t, volume_m3: 0.0, bounds: Aabb::EMPTY });
        }
        labels[t] = labels[root];
        let piece = &mut list[labels[t] as usize];
        let origin = mesh.corners_m(piece.first_triangle)[0];
        let corners = mesh.corners_m(t);
        let [a, b, c] = corners.map(|p| p - origin);
        piece.volume_m3 += a.dot(b.cross(c)) / 6.0;
        piece.bounds = corners.iter().fold(piece.bounds, |bounds, &p| bounds.including(p));
    }
    (labels, list)
}

fn check_manifold(mesh: &TriMesh) -> Result<Pieces, SurfaceError> {
    check_triangles(mesh)?;
    let n_triangles = mesh.triangles.len();
    let sides = sorted_sides(mesh);
    let edges = || sides.chunk_by(|a, b| (a.low, a.high) == (b.low, b.high));
    let mut corner_sets = DisjointSets::new(3 * n_triangles);
    let mut triangle_sets = DisjointSets::new(n_triangles);
    let corner = |triangle: u32, vertex: u32| {
        let place = mesh.triangles[triangle as usize].iter().position(|&v| v == vertex);
        3 * triangle as usize + place.expect("a side's vertices are its triangle's")
    };
    for edge in edges() {
        let [a, b] = check_edge(mesh, edge, || edges().filter(|e| e.len() == 1).count())?;
        triangle_sets.join(a.triangle as usize, b.triangle as usize);
        for vertex in [a.low, a.high] {
            corner_sets.join(corner(a.triangle, vertex), corner(b.triangle, vertex));
        }
    }
    let n_used = check_fans(mesh, &mut corner_sets)?;
    let n_edges = edges().count();
    let (labels, list) = label_pieces(mesh, &mut triangle_sets);
    let topology = SurfaceTopology {
        n_vertices: n_used,
        n_unused_vertices: mesh.positions_m.len() - n_used,
        n_edges,
        n_triangles,
        n_pieces: list.len(),
        euler_characteristic: n_used as i64 - n_edges as i64 + n_triangles as i64,
        volume_m3: list.iter().map(|p| p.volume_m3).sum(),
        area_m2: area_m2(mesh),
    };
    Ok(Pieces { labels, list, topology })
}

fn check_triangles(mesh: &TriMesh) -> Result<(), SurfaceError> {
    check_numbers(mesh)?;
    for (t, triangle) in mesh.triangles.iter().enumerate() {
        let corners_m = mesh.corners_m(t);
        if has_no_area(corners_m) {
            let place = Place(corners_m[0]);
            return Err(SurfaceError::Degenerate { triangle: t, vertices: *triangle, place });
        }
    }
    Ok(())
}

/// Checks that there are triangles, that their vertices exist and that all coordinates are finite.
pub(super) fn check_numbers(mesh: &TriMesh) -> Result<(), SurfaceError> {
    if mesh.triangles.is_empty() {
        return Err(SurfaceError::Empty);
    }
    let n_vertices = mesh.positions_m.len();
    if let Some(vertex) = mesh.positions_m.iter().position(|p| !p.is_finite()) {
        return Err(SurfaceError::NotFinite { vertex, found_m: mesh.positions_m[vertex] });
    }
    for (t, triangle) in mesh.triangles.iter().enumerate() {
        if let Some(&vertex) = triangle.iter().find(|&&v| v as usize >= n_vertices) {
            return Err(SurfaceError::NoSuchVertex { triangle: t, vertex, n_vertices });
        }
    }
    Ok(())
}

/// Whether a triangle's smallest height is too small against its longest edge for a normal.
pub(super) fn has_no_area([a, b, c]: [DVec3; 3]) -> bool {
    let longest = (b - a).length().max((c - b).length()).max((a - c).length());
    let doubled_area = (b - a).cross(c - a).length();
    let relative_height = doubled_area / (longest * longest);
    // Overflow and 0 / 0 give NaN.
    relative_height.is_nan() || relative_height <= SMALLEST_RELATIVE_HEIGHT
}

/// Checks that the corners at each vertex are one set; answers the number of used vertices.
fn check_fans(mesh: &TriMesh, corner_sets: &mut DisjointSets) -> Result<usize, SurfaceError> {
    let mut first_corner = vec![usize::MAX; mesh.positions_m.len()];
    let mut pinched: Option<(usize, usize)> = None;
    for corner in 0..3 * mesh.triangles.len() {
        let vertex = mesh.triangles[corner / 3][corner % 3] as usize;
        let root = corner_sets.root(corner);
        if first_corner[vertex] == usize::MAX {
            first_corner[vertex] = root;
        } else if first_corner[vertex] != root && pinched.is_none_or(|(v, _)| vertex < v) {
            pinched = Some((vertex, corner));
        }
    }
    let Some((vertex, other)) = pinched else {
        return Ok(first_corner.iter().filter(|&&c| c != usize::MAX).count());
    };
    let is_here = |&corner: &usize| mesh.triangles[corner / 3][corner % 3] as usize == vertex;
    let mut roots: Vec<usize> =
        (0..3 * mesh.triangles.len()).filter(is_here).map(|c| corner_sets.root(c)).collect();
    roots.sort_unstable();
    roots.dedup();
    Err(SurfaceError::PinchedVertex {
        vertex,
        n_fans: roots.len(),
        triangles: [first_corner[vertex] / 3, other / 3],
        place: Place(mesh.positions_m[vertex]),
    })
}
