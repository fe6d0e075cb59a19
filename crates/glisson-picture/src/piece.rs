//! Solids as triangles with normals and texture coordinates, before they are put into a scene.
//!
//! Vertex normals are means of the triangles' normals weighted by the angle at the vertex (Thürmer and
//! Wüthrich 1998, doi 10.1080/10867651.1998.10487487). Coarse organ surfaces are refined with Phong
//! tessellation (Boubekeur and Alexa 2008, doi 10.1145/1409060.1409094), so that outlines look round; the
//! vertices of the given mesh stay where they are, and so do borders, where another surface may begin.

use glam::{DVec3, Vec3};
use glisson::tool::pose::ToolFrame;

/// Share of the tangent-plane projection in Phong tessellation: the authors' choice.
const TESSELLATION_SHAPE: f32 = 0.75;
/// Segments around round things, and around wires.
const SEGMENTS: usize = 40;
const WIRE_SEGMENTS: usize = 12;
/// Faces that meet at a smaller angle are one smooth surface: cosine of 35 degrees. A choice.
const SMOOTH_COSINE: f64 = 0.82;

/// A part before it is added to the scene.
#[derive(Clone, Debug, Default)]
pub(super) struct Piece {
    pub(super) positions: Vec<Vec3>,
    pub(super) normals: Vec<Vec3>,
    pub(super) rest: Vec<Vec3>,
    pub(super) triangles: Vec<[u32; 3]>,
}

/// Unit normals at the vertices; +z where there is none.
pub(super) fn vertex_normals(positions_m: &[DVec3], triangles: &[[u32; 3]]) -> Vec<Vec3> {
    let mut normals = vec![DVec3::ZERO; positions_m.len()];
    for triangle in triangles {
        let corners = triangle.map(|v| positions_m[v as usize]);
        let Some(normal) = (corners[1] - corners[0]).cross(corners[2] - corners[0]).try_normalize() else {
            continue;
        };
        for c in 0..3 {
            let to_next = corners[(c + 1) % 3] - corners[c];
            let to_last = corners[(c + 2) % 3] - corners[c];
            normals[triangle[c] as usize] += to_next.angle_between(to_last) * normal;
        }
    }
    normals.iter().map(|n| n.try_normalize().unwrap_or(DVec3::Z).as_vec3()).collect()
}

/// Half a meridian of a ball around `z = 0`: profile points from height `from` to its pole at `radius`.
pub(super) fn arc(from: f64, to: f64, radius: f64) -> Vec<[f64; 4]> {
    let steps = SEGMENTS / 2;
    let (start, end) = ((from / radius).asin(), (to / radius).asin());
    (0..=steps)
        .map(|i| {
            let (sin, cos) = (start + (end - start) * i as f64 / steps as f64).sin_cos();
            [radius * sin, radius * cos, cos, sin]
        })
        .collect()
}

/// The profile through (radius, height) pairs with a sharp edge at each.
pub(super) fn lathed(points: &[[f64; 2]]) -> Vec<[f64; 4]> {
    points
        .windows(2)
        .flat_map(|pair| {
            let [[r0, z0], [r1, z1]] = [pair[0], pair[1]];
            let length = (r1 - r0).hypot(z1 - z0).max(f64::MIN_POSITIVE);
            let normal = [(z1 - z0) / length, (r0 - r1) / length];
            [[z0, r0, normal[0], normal[1]], [z1, r1, normal[0], normal[1]]]
        })
        .collect()
}

fn index(i: usize) -> u32 {
    u32::try_from(i).expect("a picture has fewer than 2^32 vertices")
}

impl Piece {
    /// Surface of revolution around `axis` through `base`. Profile points are (height, radius, radial and
    /// axial part of the normal); where two follow each other at the same place the normal jumps.
    pub(super) fn turned(base: DVec3, axis: DVec3, profile: &[[f64; 4]]) -> Self {
        let side = axis.any_orthonormal_vector();
        let other = axis.cross(side);
        let mut piece = Self::default();
        for segment in 0..SEGMENTS {
            let (sin, cos) = (std::f64::consts::TAU * segment as f64 / SEGMENTS as f64).sin_cos();
            let radial = cos * side + sin * other;
            for &[height, radius, normal_r, normal_z] in profile {
                piece.positions.push((base + height * axis + radius * radial).as_vec3());
                piece.normals.push((normal_r * radial + normal_z * axis).as_vec3());
                piece.rest.push(DVec3::new(radius * cos, radius * sin, height).as_vec3());
            }
        }
        let n = profile.len();
        for segment in 0..SEGMENTS {
            let (here, next) = (segment * n, (segment + 1) % SEGMENTS * n);
            for row in 1..n {
                let corners = [here + row - 1, next + row - 1, next + row, here + row].map(index);
                piece.triangles.push([corners[0], corners[1], corners[2]]);
                piece.triangles.push([corners[0], corners[2], corners[3]]);
            }
        }
        piece
    }

    /// A solid through rings of equally many points, each counter-clockwise seen from the next one, with flat ends.
    pub(super) fn lofted(rings: &[Vec<DVec3>]) -> Self {
        let n = rings.first().map_or(0, Vec::len);
        let mut points_m: Vec<DVec3> = rings.concat();
        let mut triangles = Vec::new();
        for k in 1..rings.len() {
            for i in 0..n {
                let next = (i + 1) % n;
                let corners = [(k - 1) * n + i, (k - 1) * n + next, k * n + next, k * n + i].map(index);
                triangles.push([corners[0], corners[1], corners[2]]);
                triangles.push([corners[0], corners[2], corners[3]]);
            }
        }
        let ends = [(0, true), (rings.len().saturating_sub(1), false)];
        for (ring, is_first) in ends.into_iter().filter(|_| n > 0) {
            let middle = index(points_m.len());
            points_m.push(rings[ring].iter().sum::<DVec3>() / n as f64);
            for i in 0..n {
                let [a, b] = [ring * n + i, ring * n + (i + 1) % n].map(index);
                triangles.push(if is_first { [middle, b, a] } else { [middle, a, b] });
            }
        }
        Self::with_edges(&points_m, &triangles)
    }

    /// A round wire through `points_m`.
    pub(super) fn wire(points_m: &[DVec3], radius_m: f64) -> Self {
        let mut way_m: Vec<DVec3> = points_m.to_vec();
        way_m.dedup();
        if way_m.len() < 2 {
            return Self::default();
        }
        let mut side = DVec3::ZERO;
        let rings: Vec<Vec<DVec3>> = (0..way_m.len())
            .map(|k| {
                let along = way_m[(k + 1).min(way_m.len() - 1)] - way_m[k.saturating_sub(1)];
                let along = along.try_normalize().unwrap_or(DVec3::Z);
                // Turned no more than the wire bends.
                side = (side - side.dot(along) * along)
                    .try_normalize()
                    .unwrap_or_else(|| along.any_orthonormal_vector());
                let other = along.cross(side);
                let ring = |i: usize| {
                    let angle = std::f64::consts::TAU * i as f64 / WIRE_SEGMENTS as f64;
                    way_m[k] + radius_m * (angle.cos() * side + angle.sin() * other)
                };
                (0..WIRE_SEGMENTS).map(ring).collect()
            })
            .collect();
        Self::lofted(&rings)
    }

    /// A solid whose faces meet in edges where they are not one smooth surface.
    fn with_edges(points_m: &[DVec3], triangles: &[[u32; 3]]) -> Self {
        let across: Vec<DVec3> = triangles
            .iter()
            .map(|t| t.map(|v| points_m[v as usize]))
            .map(|[a, b, c]| (b - a).cross(c - a))
            .collect();
        let mut around: Vec<Vec<usize>> = vec![Vec::new(); points_m.len()];
        for (t, triangle) in triangles.iter().enumerate() {
            triangle.iter().for_each(|&v| around[v as usize].push(t));
        }
        let mut piece = Self::default();
        for (t, triangle) in triangles.iter().enumerate() {
            let Some(own) = across[t].try_normalize() else { continue };
            let first = index(piece.positions.len());
            for &v in triangle {
                let is_smooth =
                    |other: &&usize| across[**other].dot(own) > SMOOTH_COSINE * across[**other].length();
                let sum: DVec3 =
                    around[v as usize].iter().filter(is_smooth).map(|&other| across[other]).sum();
                let place = points_m[v as usize].as_vec3();
                piece.positions.push(place);
                piece.rest.push(place);
                piece.normals.push(sum.try_normalize().unwrap_or(own).as_vec3());
            }
            piece.triangles.push([first, first + 1, first + 2]);
        }
        piece
    }

    /// The same, from the frame of a tool to places relative to `origin_m`.
    pub(super) fn placed(mut self, frame: &ToolFrame, origin_m: DVec3) -> Self {
        for place in &mut self.positions {
            *place = (frame.to_world_m(place.as_dvec3()) - origin_m).as_vec3();
        }
        for normal in &mut self.normals {
            *normal = (frame.world_from_tool * normal.as_dvec3()).as_vec3();
        }
        self
    }

    /// Splits every triangle in four; new vertices are lifted towards the tangent planes of their edge's ends, but not
    /// on a border.
    pub(super) fn refine(&mut self) {
        let mut sides: Vec<[u32; 2]> = self
            .triangles
            .iter()
            .flat_map(|&[a, b, c]| [[a, b], [b, c], [c, a]])
            .map(|[a, b]| [a.min(b), a.max(b)])
            .collect();
        sides.sort_unstable();
        let edges: Vec<([u32; 2], bool)> =
            sides.chunk_by(|a, b| a == b).map(|same| (same[0], same.len() == 1)).collect();
        let first = index(self.positions.len());
        for &([a, b], is_border) in &edges {
            let (a, b) = (a as usize, b as usize);
            let (pa, pb, na, nb) = (self.positions[a], self.positions[b], self.normals[a], self.normals[b]);
            let middle = 0.5 * (pa + pb);
            let lifted = middle - 0.5 * ((middle - pa).dot(na) * na + (middle - pb).dot(nb) * nb);
            let shape = if is_border { 0.0 } else { TESSELLATION_SHAPE };
            self.positions.push(middle.lerp(lifted, shape));
            self.normals.push((na + nb).try_normalize().unwrap_or(na));
            self.rest.push(0.5 * (self.rest[a] + self.rest[b]));
        }
        let middle_of = |a: u32, b: u32| {
            let edge = [a.min(b), a.max(b)];
            let place = edges.binary_search_by(|(other, _)| other.cmp(&edge)).expect("every edge was listed");
            first + index(place)
        };
        self.triangles = self
            .triangles
            .iter()
            .flat_map(|&[a, b, c]| {
                let (ab, bc, ca) = (middle_of(a, b), middle_of(b, c), middle_of(c, a));
                [[a, ab, ca], [ab, b, bc], [ca, bc, c], [ab, bc, ca]]
            })
            .collect();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Volume inside [m3]; positive when the triangles are counter-clockwise from outside.
    fn volume_m3(piece: &Piece) -> f64 {
        let corner = |v: u32| piece.positions[v as usize].as_dvec3();
        piece.triangles.iter().map(|&[a, b, c]| corner(a).dot(corner(b).cross(corner(c))) / 6.0).sum()
    }

    #[test]
    fn a_loft_encloses_its_volume_and_has_sharp_edges() {
        let square = |z: f64| {
            vec![[0.0, 0.0], [2.0, 0.0], [2.0, 3.0], [0.0, 3.0]]
                .into_iter()
                .map(|[x, y]| DVec3::new(x, y, z))
                .collect::<Vec<_>>()
        };
        let block = Piece::lofted(&[square(0.0), square(1.0), square(4.0)]);
        assert!((volume_m3(&block) - 24.0).abs() < 1e-4);
        for normal in &block.normals {
            assert!(normal.abs().max_element() > 0.999, "a face of a block has the normal {normal}");
        }
    }

    #[test]
    fn a_wire_is_as_thick_as_it_is_told_also_around_a_bend() {
        let quarter = |i: usize| (std::f64::consts::FRAC_PI_2 * i as f64 / 40.0).sin_cos();
        let way: Vec<DVec3> = (0..=40).map(quarter).map(|(s, c)| DVec3::new(c, s, 0.0)).collect();
        let wire = Piece::wire(&way, 0.05);
        for place in &wire.positions {
            let place = place.as_dvec3();
            let off = way.iter().map(|p| p.distance(place)).fold(f64::INFINITY, f64::min);
            assert!(off < 0.0501, "{place} is {off} away from the wire's middle");
        }
        let sides = WIRE_SEGMENTS as f64;
        let area = 0.5 * sides * (std::f64::consts::TAU / sides).sin() * 0.05 * 0.05;
        let expected = area * std::f64::consts::FRAC_PI_2;
        assert!((volume_m3(&wire) / expected - 1.0).abs() < 0.01);
        assert!(Piece::wire(&way[..1], 0.05).triangles.is_empty());
    }

    #[test]
    fn borders_stay_where_they_are_when_a_surface_is_refined() {
        // A roof of two triangles whose normals lean apart.
        let mut roof = Piece {
            positions: vec![Vec3::ZERO, Vec3::X, Vec3::Y, Vec3::X + Vec3::Y],
            normals: vec![
                Vec3::new(-0.6, 0.0, 0.8),
                Vec3::new(0.6, 0.0, 0.8),
                Vec3::new(-0.6, 0.0, 0.8),
                Vec3::new(0.6, 0.0, 0.8),
            ],
            rest: vec![Vec3::ZERO; 4],
            triangles: vec![[0, 1, 2], [2, 1, 3]],
        };
        roof.refine();
        let new = &roof.positions[4..];
        let lifted = new.iter().filter(|p| p.z.abs() > 1e-6).count();
        assert_eq!((new.len(), lifted), (5, 1), "{new:?}");
    }
}
