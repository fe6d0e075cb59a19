//! Everything in a scene as triangles with normals and rest positions.
//!
//! Vertex normals are means of the triangles' normals weighted by the angle at the vertex (Thürmer and
//! Wüthrich 1998, doi 10.1080/10867651.1998.10487487). Coarse organ surfaces are refined with Phong
//! tessellation (Boubekeur and Alexa 2008, doi 10.1145/1409060.1409094), so that outlines look round; the
//! vertices of the given mesh stay where they are.

use anyhow::ensure;
use glam::{DVec3, Vec3};
use glisson::math::Aabb;

use super::PictureScene;
use super::look::Look;

/// Organ surfaces are refined until they have this many triangles ...
const REFINE_BELOW_TRIANGLES: usize = 24_000;
/// ... or were refined this often.
const MAX_REFINEMENTS: usize = 2;
/// Share of the tangent-plane projection in Phong tessellation: the authors' choice.
const TESSELLATION_SHAPE: f32 = 0.75;
/// Segments around round things.
const SEGMENTS: usize = 40;
/// Part of an arrow's length that is its head, at most; and how much thicker the head is.
const ARROW_HEAD_LENGTH: f64 = 0.42;
const ARROW_HEAD_RADII: f64 = 2.6;

/// An organ's surface, deformed, with the rest shape that its texture sticks to.
#[derive(Clone, Debug)]
pub struct ShadedSurface {
    /// Vertices as they are now [m].
    pub positions_m: Vec<DVec3>,
    /// Vertex indices, counter-clockwise seen from outside.
    pub triangles: Vec<[u32; 3]>,
    /// Vertices at rest [m], as many as now.
    pub rest_positions_m: Vec<DVec3>,
    /// Colours and gloss.
    pub look: Look,
}

/// A rigid instrument: a straight shaft with a round end and a ball at the tip.
#[derive(Clone, Copy, Debug)]
pub struct Instrument {
    /// Centre of the ball [m].
    pub tip_m: DVec3,
    /// Other end of the shaft [m].
    pub handle_m: DVec3,
    /// Radius of the ball [m].
    pub tip_radius_m: f64,
    /// Radius of the shaft [m].
    pub shaft_radius_m: f64,
}

/// A force, drawn in front of everything.
#[derive(Clone, Copy, Debug)]
pub struct Arrow {
    /// Where it starts [m].
    pub from_m: DVec3,
    /// Where its point is [m].
    pub to_m: DVec3,
    /// Radius of its shaft [m].
    pub radius_m: f64,
    /// sRGB colour.
    pub colour: [u8; 3],
}

/// A part of the scene with one look.
#[derive(Clone, Copy, Debug)]
pub(super) struct Part {
    pub(super) look: Look,
    /// Drawn in front of everything.
    pub(super) overlay: bool,
    /// Throws a shadow.
    pub(super) casts_shadow: bool,
}

/// Triangles of a whole scene. Positions are relative to the camera's target [m].
#[derive(Clone, Debug, Default)]
pub(super) struct Facets {
    pub(super) positions: Vec<Vec3>,
    pub(super) normals: Vec<Vec3>,
    /// Texture coordinates: rest positions [m] in the patient frame.
    pub(super) rest: Vec<Vec3>,
    pub(super) triangles: Vec<[u32; 3]>,
    /// Part of each triangle.
    pub(super) part_of: Vec<u32>,
    pub(super) parts: Vec<Part>,
    /// Box around the organs, relative to the target [m]; around everything when there is no organ.
    pub(super) organ_bounds: Option<(Vec3, Vec3)>,
}

impl Facets {
    /// Triangles of `scene`.
    ///
    /// # Errors
    /// See [`super::Picture::render`].
    pub(super) fn of_scene(scene: &PictureScene) -> anyhow::Result<Self> {
        let mut facets = Self::default();
        let origin_m = scene.camera.target_m;
        ensure!(
            scene.camera.eye_m.is_finite() && origin_m.is_finite(),
            "the camera's eye {} or target {origin_m} is not finite",
            scene.camera.eye_m
        );
        for (index, surface) in scene.surfaces.iter().enumerate() {
            check(index, surface)?;
            facets.add_surface(surface, origin_m);
        }
        facets.note_bounds();
        for instrument in &scene.instruments {
            ensure!(
                instrument.tip_m.is_finite() && instrument.handle_m.is_finite(),
                "an instrument is at {} to {}: not finite",
                instrument.tip_m,
                instrument.handle_m
            );
            facets.add_instrument(instrument, origin_m);
        }
        for arrow in &scene.arrows {
            ensure!(
                arrow.from_m.is_finite() && arrow.to_m.is_finite(),
                "an arrow goes from {} to {}: not finite",
                arrow.from_m,
                arrow.to_m
            );
            facets.add_arrow(arrow, origin_m);
        }
        if facets.organ_bounds.is_none() {
            facets.note_bounds();
        }
        Ok(facets)
    }

    fn note_bounds(&mut self) {
        let mut points = self.positions.iter().copied();
        if let Some(first) = points.next() {
            self.organ_bounds = Some(points.fold((first, first), |(low, high), p| (low.min(p), high.max(p))));
        }
    }

    fn add_part(&mut self, part: Part, piece: &Piece) {
        let first = u32::try_from(self.positions.len()).expect("a picture has fewer than 2^32 vertices");
        let part_index = u32::try_from(self.parts.len()).expect("a picture has fewer than 2^32 parts");
        self.positions.extend(&piece.positions);
        self.normals.extend(&piece.normals);
        self.rest.extend(&piece.rest);
        self.triangles.extend(piece.triangles.iter().map(|t| t.map(|v| v + first)));
        self.part_of.extend(std::iter::repeat_n(part_index, piece.triangles.len()));
        self.parts.push(part);
    }

    fn add_surface(&mut self, surface: &ShadedSurface, origin_m: DVec3) {
        let mut piece = Piece {
            positions: surface.positions_m.iter().map(|&p| (p - origin_m).as_vec3()).collect(),
            normals: vertex_normals(&surface.positions_m, &surface.triangles),
            rest: surface.rest_positions_m.iter().map(|p| p.as_vec3()).collect(),
            triangles: surface.triangles.clone(),
        };
        for _ in 0..MAX_REFINEMENTS {
            if piece.triangles.len() < REFINE_BELOW_TRIANGLES {
                piece.refine();
            }
        }
        self.add_part(Part { look: surface.look, overlay: false, casts_shadow: true }, &piece);
    }

    fn add_instrument(&mut self, instrument: &Instrument, origin_m: DVec3) {
        let metal = Part { look: Look::Metal, overlay: false, casts_shadow: true };
        let tip = instrument.tip_m - origin_m;
        let handle = instrument.handle_m - origin_m;
        let axis = (handle - tip).try_normalize().unwrap_or(DVec3::Z);
        let (ball, shaft) = (instrument.tip_radius_m, instrument.shaft_radius_m);
        let ball_profile = arc(-ball, ball, ball);
        self.add_part(metal, &Piece::turned(tip, axis, &ball_profile));
        let length = (handle - tip).length();
        if length > 0.0 {
            let mut profile = vec![[0.0, shaft, 1.0, 0.0], [length, shaft, 1.0, 0.0]];
            profile.extend(arc(0.0, shaft, shaft).into_iter().map(|[z, r, nr, nz]| [z + length, r, nr, nz]));
            self.add_part(Part { look: Look::Shaft, ..metal }, &Piece::turned(tip, axis, &profile));
        }
    }

    fn add_arrow(&mut self, arrow: &Arrow, origin_m: DVec3) {
        let along = arrow.to_m - arrow.from_m;
        let length = along.length();
        let Some(axis) = along.try_normalize() else { return };
        let head_radius = ARROW_HEAD_RADII * arrow.radius_m;
        let head = (2.4 * head_radius).min(ARROW_HEAD_LENGTH * length);
        let neck = length - head;
        // Slope of the cone's outward normal.
        let slope = head.hypot(head_radius);
        let (normal_r, normal_z) = (head / slope, head_radius / slope);
        let radius = arrow.radius_m;
        let profile = [
            [0.0, 0.0, 0.0, -1.0],
            [0.0, radius, 0.0, -1.0],
            [0.0, radius, 1.0, 0.0],
            [neck, radius, 1.0, 0.0],
            [neck, radius, 0.0, -1.0],
            [neck, head_radius, 0.0, -1.0],
            [neck, head_radius, normal_r, normal_z],
            [length, 0.0, normal_r, normal_z],
        ];
        let part = Part { look: Look::Sign { colour: arrow.colour }, overlay: true, casts_shadow: false };
        self.add_part(part, &Piece::turned(arrow.from_m - origin_m, axis, &profile));
    }
}

fn check(index: usize, surface: &ShadedSurface) -> anyhow::Result<()> {
    let n = surface.positions_m.len();
    ensure!(
        surface.rest_positions_m.len() == n,
        "surface {index} has {n} positions but {} rest positions",
        surface.rest_positions_m.len()
    );
    for (t, triangle) in surface.triangles.iter().enumerate() {
        for &v in triangle {
            ensure!(
                (v as usize) < n,
                "surface {index}, triangle {t}: vertex {v}, but there are {n} vertices"
            );
        }
    }
    for positions in [&surface.positions_m, &surface.rest_positions_m] {
        if let Some(v) = positions.iter().position(|p| !p.is_finite()) {
            anyhow::bail!("surface {index}, vertex {v}: position {} is not finite", positions[v]);
        }
    }
    Ok(())
}

/// Unit normals at the vertices; +z where there is none.
fn vertex_normals(positions_m: &[DVec3], triangles: &[[u32; 3]]) -> Vec<Vec3> {
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
fn arc(from: f64, to: f64, radius: f64) -> Vec<[f64; 4]> {
    let steps = SEGMENTS / 2;
    let (start, end) = ((from / radius).asin(), (to / radius).asin());
    (0..=steps)
        .map(|i| {
            let (sin, cos) = (start + (end - start) * i as f64 / steps as f64).sin_cos();
            [radius * sin, radius * cos, cos, sin]
        })
        .collect()
}

/// A part before it is added to the scene.
#[derive(Clone, Debug, Default)]
struct Piece {
    positions: Vec<Vec3>,
    normals: Vec<Vec3>,
    rest: Vec<Vec3>,
    triangles: Vec<[u32; 3]>,
}

impl Piece {
    /// Surface of revolution around `axis` through `base`. Profile points are (height, radius, radial and
    /// axial part of the normal); where two follow each other at the same place the normal jumps.
    fn turned(base: DVec3, axis: DVec3, profile: &[[f64; 4]]) -> Self {
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
                let corners = [here + row - 1, next + row - 1, next + row, here + row]
                    .map(|v| u32::try_from(v).expect("a turned piece is small"));
                piece.triangles.push([corners[0], corners[1], corners[2]]);
                piece.triangles.push([corners[0], corners[2], corners[3]]);
            }
        }
        piece
    }

    /// Splits every triangle in four; new vertices are lifted towards the tangent planes of their edge's ends.
    fn refine(&mut self) {
        let mut edges: Vec<[u32; 2]> = self
            .triangles
            .iter()
            .flat_map(|&[a, b, c]| [[a, b], [b, c], [c, a]])
            .map(|[a, b]| [a.min(b), a.max(b)])
            .collect();
        edges.sort_unstable();
        edges.dedup();
        let first = u32::try_from(self.positions.len()).expect("a picture has fewer than 2^32 vertices");
        for &[a, b] in &edges {
            let (a, b) = (a as usize, b as usize);
            let (pa, pb, na, nb) = (self.positions[a], self.positions[b], self.normals[a], self.normals[b]);
            let middle = 0.5 * (pa + pb);
            let lifted = middle - 0.5 * ((middle - pa).dot(na) * na + (middle - pb).dot(nb) * nb);
            self.positions.push(middle.lerp(lifted, TESSELLATION_SHAPE));
            self.normals.push((na + nb).try_normalize().unwrap_or(na));
            self.rest.push(0.5 * (self.rest[a] + self.rest[b]));
        }
        let middle_of = |a: u32, b: u32| {
            let place = edges.binary_search(&[a.min(b), a.max(b)]).expect("every edge was listed");
            first + u32::try_from(place).expect("a picture has fewer than 2^32 edges")
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

/// Box around the organs' vertices [m]; empty for none.
pub fn bounds_of(surfaces: &[ShadedSurface]) -> Aabb {
    surfaces
        .iter()
        .flat_map(|surface| &surface.positions_m)
        .fold(Aabb::EMPTY, |bounds, &position_m| bounds.including(position_m))
}
