//! Everything in a scene as triangles with normals and rest positions.

use anyhow::ensure;
use glam::{DVec3, Vec3};
use glisson::math::Aabb;

use super::PictureScene;
use super::camera::Projection;
use super::instrument::Instrument;
use super::look::Look;
use super::piece::{Piece, arc, vertex_normals};

/// Organ surfaces are refined until they have this many triangles ...
const REFINE_BELOW_TRIANGLES: usize = 24_000;
/// ... or these are so small in the picture [pixels] ...
const REFINE_ABOVE_PIXELS: f32 = 6.0;
/// ... or were refined this often.
const MAX_REFINEMENTS: usize = 2;
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

impl ShadedSurface {
    /// A ball.
    pub fn ball(center_m: DVec3, radius_m: f64, look: Look) -> Self {
        Self::of_piece(Piece::turned(center_m, DVec3::Z, &arc(-radius_m, radius_m, radius_m)), look)
    }

    /// A round wire through `points_m`.
    pub fn wire(points_m: &[DVec3], radius_m: f64, look: Look) -> Self {
        Self::of_piece(Piece::wire(points_m, radius_m), look)
    }

    fn of_piece(piece: Piece, look: Look) -> Self {
        let places_m = |places: &[Vec3]| places.iter().map(|p| p.as_dvec3()).collect();
        Self {
            positions_m: places_m(&piece.positions),
            rest_positions_m: places_m(&piece.rest),
            triangles: piece.triangles,
            look,
        }
    }
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
        let projection = Projection::new(&scene.camera, scene.size);
        for (index, surface) in scene.surfaces.iter().enumerate() {
            check(index, surface)?;
            facets.add_surface(surface, origin_m, &projection);
        }
        facets.note_bounds();
        for instrument in &scene.instruments {
            let frame = &instrument.frame;
            ensure!(
                frame.tip_in_world_m.is_finite() && frame.world_from_tool.is_finite(),
                "an instrument is at {} and turned by {}: not finite",
                frame.tip_in_world_m,
                frame.world_from_tool
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

    fn add_surface(&mut self, surface: &ShadedSurface, origin_m: DVec3, projection: &Projection) {
        let mut piece = Piece {
            positions: surface.positions_m.iter().map(|&p| (p - origin_m).as_vec3()).collect(),
            normals: vertex_normals(&surface.positions_m, &surface.triangles),
            rest: surface.rest_positions_m.iter().map(|p| p.as_vec3()).collect(),
            triangles: surface.triangles.clone(),
        };
        let pixels = projection.pixels_of(&piece.positions);
        for _ in 0..MAX_REFINEMENTS {
            let n = piece.triangles.len();
            if n < REFINE_BELOW_TRIANGLES && pixels > REFINE_ABOVE_PIXELS * n as f32 {
                piece.refine();
            }
        }
        self.add_part(Part { look: surface.look, overlay: false, casts_shadow: true }, &piece);
    }

    fn add_instrument(&mut self, instrument: &Instrument, origin_m: DVec3) {
        for (look, piece) in instrument.parts() {
            let part = Part { look, overlay: false, casts_shadow: true };
            self.add_part(part, &piece.placed(&instrument.frame, origin_m));
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

/// Box around the organs' vertices [m]; empty for none.
pub fn bounds_of(surfaces: &[ShadedSurface]) -> Aabb {
    surfaces
        .iter()
        .flat_map(|surface| &surface.positions_m)
        .fold(Aabb::EMPTY, |bounds, &position_m| bounds.including(position_m))
}
