//! What a repair may do, what it found and did, and why it gives up.

use crate::math::DVec3;
use crate::surface::error::{Place, SurfaceError};
use crate::surface::signed_distance::SignedDistanceError;

/// Places that are kept of each fault.
pub const MOST_PLACES: usize = 8;

/// How a surface is repaired.
#[derive(Clone, Debug, PartialEq)]
pub struct RepairParams {
    /// Spacing of the grid on which a surface is rebuilt [m]. None: a 160th of the longest side, or a third of
    /// `smallest_feature_m` where that is less.
    pub spacing_m: Option<f64>,
    /// Thickness of the thinnest part, or width of the narrowest gap, that has to survive rebuilding [m].
    pub smallest_feature_m: Option<f64>,
    /// Pieces and cavities below this share of the largest piece's volume are taken away.
    pub smallest_piece_share: f64,
    /// Largest share of the rebuilt surface that may close holes: beyond it the volume is a guess.
    pub largest_closing_share: f64,
}

impl Default for RepairParams {
    fn default() -> Self {
        Self {
            spacing_m: None,
            smallest_feature_m: None,
            smallest_piece_share: 1e-3,
            largest_closing_share: 0.2,
        }
    }
}

/// How often something was seen, and where first.
#[derive(Clone, Debug, Default, PartialEq, serde::Serialize)]
pub struct Sightings {
    /// How often.
    pub count: usize,
    /// The first [`MOST_PLACES`] places [m], LPS.
    pub places_m: Vec<DVec3>,
}

impl Sightings {
    /// Counts one more.
    pub(super) fn add(&mut self, place_m: DVec3) {
        self.count += 1;
        if self.places_m.len() < MOST_PLACES {
            self.places_m.push(place_m);
        }
    }
}

/// Faults of a surface as given.
#[derive(Clone, Debug, Default, PartialEq, serde::Serialize)]
pub struct FaultsFound {
    /// Vertices at exactly the place of another one.
    pub coincident_vertices: Sightings,
    /// Vertices that no triangle uses.
    pub unused_vertices: Sightings,
    /// Triangles without area or with a repeated corner.
    pub degenerate_triangles: Sightings,
    /// Triangles with the same corners as another one.
    pub duplicate_triangles: Sightings,
    /// Edges of one triangle, once those above are gone.
    pub open_edges: Sightings,
    /// Edges of more than two triangles, once those above are gone.
    pub crowded_edges: Sightings,
    /// Triangles turned against most of their neighbours.
    pub turned_triangles: Sightings,
    /// Connected pieces inside out.
    pub turned_pieces: Sightings,
    /// Pairs of triangles that cross or touch where they should not, once the above are mended; counting
    /// stops soon after `intersections_limit`.
    pub self_intersections: Sightings,
    /// Where counting intersections stopped looking.
    pub intersections_limit: usize,
    /// Connected pieces.
    pub pieces: usize,
}

/// What was done to a surface.
#[derive(Clone, Debug, Default, PartialEq, serde::Serialize)]
pub struct RepairsDone {
    /// Vertices made one with another at the same place.
    pub vertices_merged: usize,
    /// Vertices dropped because nothing uses them.
    pub vertices_dropped: usize,
    /// Triangles dropped as degenerate or duplicate.
    pub triangles_dropped: usize,
    /// Triangles turned over, those of turned pieces included.
    pub triangles_turned: usize,
    /// Pieces, or cavities, dropped as too small; a place and no more when rebuilt.
    pub small_pieces_dropped: Sightings,
    /// Pieces inside others that bound no cavity, so that they are part of the solid.
    pub inner_pieces_filled: Sightings,
    /// Nodes of the grid added where the solid touched itself by an edge or a corner only.
    pub contacts_filled: usize,
    /// Vertices held back from the old surface because triangles would have crossed.
    pub vertices_held_back: usize,
}

/// What [`super::repair`] found and did.
#[derive(Clone, Debug, Default, PartialEq, serde::Serialize)]
pub struct RepairReport {
    /// The faults as given.
    pub found: FaultsFound,
    /// What was done about them.
    pub done: RepairsDone,
    /// Whether all triangles are new.
    pub rebuilt: bool,
    /// Spacing of the grid it was rebuilt on [m].
    pub spacing_m: Option<f64>,
    /// Greatest distance from a new vertex, not over a hole, to the old surface [m].
    pub greatest_move_m: f64,
    /// Greatest distance from an old vertex to the new surface [m]: large where parts lay inside others or
    /// were dropped.
    pub greatest_distance_from_old_m: f64,
    /// Share of the new surface that closes holes.
    pub closing_share: f64,
    /// Volume as given [m3]: where the winding number is above one half, counted on the grid; the exact one
    /// of a surface that needed no rebuilding.
    pub volume_before_m3: f64,
    /// Volume of the answer [m3].
    pub volume_after_m3: f64,
    /// Triangles of the answer.
    pub n_triangles: usize,
    /// Connected pieces of the answer.
    pub n_pieces: usize,
    /// Vertices - edges + triangles of the answer.
    pub euler_characteristic: i64,
}

/// Why a surface cannot be repaired.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum RepairError {
    /// Numbers that mean nothing, or no triangle at all.
    #[error(transparent)]
    Surface(#[from] SurfaceError),
    /// Only triangles without area.
    #[error(
        "none of the {n_triangles} triangles is left once those without area ({n_degenerate}) and opposite pairs are gone"
    )]
    NothingLeft {
        /// Triangles as given.
        n_triangles: usize,
        /// Those without area.
        n_degenerate: usize,
    },
    /// A parameter out of its range.
    #[error("{name} is {found}; allowed: {allowed}")]
    Parameter {
        /// Which one.
        name: &'static str,
        /// Its value.
        found: f64,
        /// What is allowed.
        allowed: &'static str,
    },
    /// The grid is too fine, or cannot be laid.
    #[error("the surface cannot be rebuilt on a grid: {0}")]
    Grid(#[from] SignedDistanceError),
    /// A sheet.
    #[error(
        "the surface has no inside: its winding number reaches {largest:.3}, near {place}; above 0.5 is needed. It is an open sheet, or thinner than the grid's spacing of {spacing_mm:.3} mm"
    )]
    NoInside {
        /// Largest winding number found.
        largest: f64,
        /// Where.
        place: Place,
        /// Spacing of the grid [mm].
        spacing_mm: f64,
    },
    /// Too much is missing.
    #[error(
        "{:.1} % of the closed surface would be guessed, the largest part around {place}; {:.1} % are allowed: the volume is undetermined", 100.0 * .share, 100.0 * .allowed
    )]
    HoleTooLarge {
        /// Share of the new surface over holes.
        share: f64,
        /// Largest share allowed.
        allowed: f64,
        /// Middle of what closes them.
        place: Place,
    },
}
