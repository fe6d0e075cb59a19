//! A closed surface filled with tetrahedra of a wanted size or number.
//!
//! The surface's signed distance is stuffed ([`super::stuffing`]). Around that three nested loops, each with
//! a fixed list of steps, so that the same surface gives the same bits:
//! - level: the iso-level is moved until the tetrahedra's volume is the wanted one, because flat faces cut
//!   off what is round (Newton's first step over the surface's area, then regula falsi on the bracket);
//! - size: the lattice cell is changed until the number of tetrahedra is the wanted one;
//! - attempt: where the surface's topology is not met, the lattice is moved, then made a little finer.

use super::quality::{MeshQuality, SurfaceShape};
use super::stuffing::{
    Filling, Lattice, MEAN_EDGE_OVER_CELL, Stuffing, StuffingError, TETRAHEDRON_OVER_CELL, WantedTopology,
};
use super::thin::{ThinFeature, thin_features};
use super::{NodeId, TetMesh};
use crate::math::{Aabb, DVec3};
use crate::progress::{part, tell};
use crate::surface::TriMesh;
use crate::surface::signed_distance::{SignedDistance, SignedDistanceError};

/// Largest relative difference between the mesh's volume and the wanted one.
pub const VOLUME_TOLERANCE: f64 = 1e-3;

/// Largest relative difference between the number of tetrahedra and the wanted one, for numbers from
/// [`MIN_TETRAHEDRA`] on.
pub const COUNT_TOLERANCE: f64 = 0.05;

/// Number of tetrahedra where neither a number nor a size is told.
pub const USUAL_TETRAHEDRA: usize = 6_300;

/// Smallest number of tetrahedra that can be asked for.
pub const MIN_TETRAHEDRA: usize = 200;

/// Largest number of tetrahedra that can be asked for.
pub const MAX_TETRAHEDRA: usize = 4_000_000;

/// Level iterations stop at this relative volume difference: a fifth of the tolerance.
const VOLUME_GOAL: f64 = 2e-4;

/// While the size is searched a coarser volume does: the number of tetrahedra hardly depends on the level.
const LOOSE_VOLUME_GOAL: f64 = 5e-3;

/// Size iterations stop at this relative difference.
const COUNT_GOAL: f64 = 0.01;

/// Moves of the lattice [cells] and factors on the cell that are tried in turn.
const ATTEMPTS: [([f64; 3], f64); 10] = [
    ([0.0, 0.0, 0.0], 1.0),
    ([0.25, 0.25, 0.25], 1.0),
    ([0.5, 0.25, 0.0], 1.0),
    ([0.0, 0.5, 0.25], 1.0),
    ([0.25, 0.0, 0.5], 1.0),
    ([0.0, 0.0, 0.0], 0.99),
    ([0.25, 0.25, 0.25], 0.98),
    ([0.5, 0.25, 0.0], 0.97),
    ([0.0, 0.5, 0.25], 0.96),
    ([0.25, 0.0, 0.5], 0.95),
];

/// How large the tetrahedra should be.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum WantedSize {
    /// This many tetrahedra, met within [`COUNT_TOLERANCE`].
    Tetrahedra(usize),
    /// This mean edge of the inner tetrahedra [m].
    EdgeM(f64),
}

/// What mesh is wanted.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MeshParams {
    /// Size or number of tetrahedra.
    pub size: WantedSize,
    /// Volume to meet [m3], within [`VOLUME_TOLERANCE`]; without it the surface's.
    pub volume_m3: Option<f64>,
}

/// What was made, and how.
#[derive(Clone, Debug, PartialEq, serde::Serialize)]
pub struct MeshReport {
    /// The mesh's numbers.
    pub quality: MeshQuality,
    /// Volume that was wanted [m3].
    pub wanted_volume_m3: f64,
    /// Lattice cell [m].
    pub cell_m: f64,
    /// Mean edge of the inner tetrahedra [m].
    pub inner_edge_m: f64,
    /// Distance from the surface at which the level lies, outwards [m].
    pub level_m: f64,
    /// Spacing of the distance field [m].
    pub field_spacing_m: f64,
    /// Number of fillings made.
    pub n_fillings: usize,
    /// Why earlier attempts with other lattices were given up.
    pub given_up: Vec<String>,
    /// Inside lattice nodes of loose crumbs that were dropped.
    pub crumb_nodes: usize,
    /// Outside lattice nodes of unwanted cavities that were filled.
    pub filled_nodes: usize,
    /// Lattice nodes whose side was changed to get the surface's topology.
    pub changed_nodes: usize,
    /// Lattice nodes that were not warped, to avoid pinches and bad angles.
    pub stiff_nodes: usize,
    /// Places where the body or a gap is thinner than two cells, the largest first.
    pub thin_features: Vec<ThinFeature>,
}

/// Why a surface cannot be meshed.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum MeshingError {
    /// The distance field failed.
    #[error(transparent)]
    Distance(#[from] SignedDistanceError),
    /// The surface has holes or edges with more than two triangles.
    #[error(
        "the surface is not closed: {n_edges} edges are not between two triangles of opposite direction, the first \
         between vertices {} and {} at {position_mm} mm; close it first", first[0], first[1]
    )]
    NotClosed {
        /// How many edges.
        n_edges: usize,
        /// Vertices of the first.
        first: [u32; 2],
        /// Where its first vertex is [mm].
        position_mm: DVec3,
    },
    /// The triangles are oriented inwards, or the surface encloses nothing.
    #[error(
        "the surface encloses {volume_ml} ml: a positive volume is needed (triangles counter-clockwise from outside)"
    )]
    NoVolume {
        /// Signed volume [ml].
        volume_ml: f64,
    },
    /// A size that is no size.
    #[error("{what} is {found}: {allowed} is allowed")]
    BadParameter {
        /// Which parameter.
        what: &'static str,
        /// Its value.
        found: String,
        /// What is allowed.
        allowed: String,
    },
    /// No attempt met the surface's topology, the volume and the number.
    #[error(
        "no mesh with the surface's topology ({bodies} bodies, {cavities} cavities, Euler number {euler}) at this \
         size; take smaller tetrahedra or a simpler surface. Tried: {}", reasons.join("; ")
    )]
    Refused {
        /// Outer surfaces of the input.
        bodies: usize,
        /// Inner surfaces of the input.
        cavities: usize,
        /// Euler characteristic of the input.
        euler: i64,
        /// Why each attempt failed.
        reasons: Vec<String>,
    },
}

/// Fills `surface` (closed, outward oriented) with tetrahedra.
///
/// # Errors
/// [`MeshingError`]: the surface is not closed, the parameters make no sense, or no attempt gave a mesh with the
/// surface's number of pieces and Euler number.
pub fn generate(surface: &TriMesh, params: &MeshParams) -> Result<(TetMesh, MeshReport), MeshingError> {
    tell(0.0);
    let plan = MeshPlan::new(surface, params)?;
    let field = plan.distance_field(surface)?;
    part(0.3, 1.0, || plan.fill(&field))
}

/// A checked surface and parameters, ready to be meshed in two steps.
#[derive(Clone, Debug)]
pub struct MeshPlan {
    params: MeshParams,
    bounds_m: Aabb,
    volume_m3: f64,
    first_cell_m: f64,
    topology: WantedTopology,
}

impl MeshPlan {
    /// Checks the surface and the parameters.
    ///
    /// # Errors
    /// [`MeshingError`] other than `Refused`.
    pub fn new(surface: &TriMesh, params: &MeshParams) -> Result<Self, MeshingError> {
        let surface_volume_m3 = check_surface(surface)?;
        let volume_m3 = params.volume_m3.unwrap_or(surface_volume_m3);
        let ratio = volume_m3 / surface_volume_m3;
        if !(ratio > 0.5 && ratio < 2.0) {
            return Err(MeshingError::BadParameter {
                what: "the wanted volume",
                found: format!("{} ml", 1e6 * volume_m3),
                allowed: format!("half to twice the surface's {:.3} ml", 1e6 * surface_volume_m3),
            });
        }
        let area_m2: f64 = (0..surface.triangles.len())
            .map(|t| {
                let [a, b, c] = surface.corners_m(t);
                0.5 * (b - a).cross(c - a).length()
            })
            .sum();
        let bounds_m = Aabb::of_points(&surface.positions_m);
        let first_cell_m = match params.size {
            WantedSize::Tetrahedra(n) => {
                if !(MIN_TETRAHEDRA..=MAX_TETRAHEDRA).contains(&n) {
                    return Err(MeshingError::BadParameter {
                        what: "the wanted number of tetrahedra",
                        found: n.to_string(),
                        allowed: format!("{MIN_TETRAHEDRA} to {MAX_TETRAHEDRA}"),
                    });
                }
                cell_for_count(n as f64, volume_m3, area_m2)
            }
            WantedSize::EdgeM(edge_m) => {
                let longest_m = bounds_m.size_m().max_element();
                let smallest_m = libm::cbrt(volume_m3 / TETRAHEDRON_OVER_CELL / MAX_TETRAHEDRA as f64);
                if !(edge_m >= smallest_m && edge_m <= longest_m) {
                    return Err(MeshingError::BadParameter {
                        what: "the element size",
                        found: format!("{} mm", 1e3 * edge_m),
                        allowed: format!(
                            "{:.3} to {:.0} mm for this surface",
                            1e3 * smallest_m,
                            1e3 * longest_m
                        ),
                    });
                }
                edge_m / MEAN_EDGE_OVER_CELL
            }
        };
        Ok(Self { params: *params, bounds_m, volume_m3, first_cell_m, topology: topology_of(surface) })
    }

    /// With another topology than the surface's, for one that is known to have tunnels, cavities or pieces that are not
    /// meant.
    #[must_use]
    pub fn with_topology(self, topology: WantedTopology) -> Self {
        Self { topology, ..self }
    }

    /// Signed distance of the surface, fine enough for the cells to come.
    ///
    /// # Errors
    /// [`MeshingError::Distance`].
    pub fn distance_field(&self, surface: &TriMesh) -> Result<SignedDistance, MeshingError> {
        // Four samples a cell, or down to two and a half where they would be too many; at least fifty over the
        // surface, so that its shape is met by coarse cells, too. Beyond the margin the samples go on as the
        // distance to the grid; within it the gaps between the surface's parts are measured.
        const MANY_NODES: f64 = 1.5e6;
        let margin_m = 1.3 * self.first_cell_m;
        let many_m = libm::cbrt(self.bounds_m.grown(margin_m).size_m().element_product() / MANY_NODES);
        let of_cell_m = many_m.clamp(self.first_cell_m / 4.0, self.first_cell_m / 2.5);
        let spacing_m = of_cell_m.min(self.bounds_m.size_m().max_element() / 50.0);
        Ok(SignedDistance::of_surface(surface, spacing_m, margin_m)?)
    }

    /// Fills the level set.
    ///
    /// # Errors
    /// [`MeshingError::Refused`].
    pub fn fill(&self, field: &SignedDistance) -> Result<(TetMesh, MeshReport), MeshingError> {
        let mut reasons = Vec::new();
        let mut n_fillings = 0;
        for (offset, factor) in ATTEMPTS {
            let attempt = Attempt { plan: self, field, offset: DVec3::from_array(offset) };
            match attempt.search(self.first_cell_m * factor, &mut n_fillings) {
                Ok(found) => {
                    let quality = MeshQuality::of(&found.filling.mesh);
                    let changes = found.filling.sign_changes;
                    let report = MeshReport {
                        quality,
                        wanted_volume_m3: self.volume_m3,
                        cell_m: found.cell_m,
                        inner_edge_m: MEAN_EDGE_OVER_CELL * found.cell_m,
                        level_m: found.level_m,
                        field_spacing_m: field.spacing_m(),
                        n_fillings,
                        given_up: reasons,
                        crumb_nodes: changes.crumb_nodes,
                        filled_nodes: changes.filled_nodes,
                        changed_nodes: found.changed_nodes,
                        stiff_nodes: found.stiff_nodes,
                        thin_features: thin_features(field, found.cell_m),
                    };
                    return Ok((found.filling.mesh, report));
                }
                Err(reason) => reasons.push(reason),
            }
        }
        let WantedTopology { bodies, cavities, surface_euler_characteristic: euler } = self.topology;
        Err(MeshingError::Refused { bodies, cavities, euler, reasons })
    }
}

/// Checks that the surface is closed and gives its volume [m3].
fn check_surface(surface: &TriMesh) -> Result<f64, MeshingError> {
    if surface.triangles.is_empty() {
        return Err(SignedDistanceError::Empty.into());
    }
    let n_vertices = surface.positions_m.len();
    for (triangle, corners) in surface.triangles.iter().enumerate() {
        if let Some(&vertex) = corners.iter().find(|&&v| v as usize >= n_vertices) {
            return Err(SignedDistanceError::UnknownVertex { triangle, vertex, n_vertices }.into());
        }
    }
    let shape = SurfaceShape::of(n_vertices, &surface.triangles);
    if let Some(&first) = shape.open_edges.first() {
        let position_mm = 1e3 * surface.positions_m[first[0] as usize];
        return Err(MeshingError::NotClosed { n_edges: shape.open_edges.len(), first, position_mm });
    }
    if let Some(vertex) = surface.positions_m.iter().position(|p| !p.is_finite()) {
        let position_m = surface.positions_m[vertex];
        return Err(SignedDistanceError::NotFinite { vertex, position_m }.into());
    }
    let volume_m3 = surface.volume_m3();
    if volume_m3 > 0.0 { Ok(volume_m3) } else { Err(MeshingError::NoVolume { volume_ml: 1e6 * volume_m3 }) }
}

/// Bodies, cavities and Euler characteristic of a closed surface.
fn topology_of(surface: &TriMesh) -> WantedTopology {
    let n_vertices = surface.positions_m.len();
    let shape = SurfaceShape::of(n_vertices, &surface.triangles);
    let piece = SurfaceShape::piece_of_vertices(n_vertices, &surface.triangles);
    let mut volumes_m3 = vec![0.0; shape.pieces];
    for (t, corners) in surface.triangles.iter().enumerate() {
        let [a, b, c] = surface.corners_m(t);
        volumes_m3[piece[corners[0] as usize] as usize] += a.dot(b.cross(c)) / 6.0;
    }
    let cavities = volumes_m3.iter().filter(|v| **v < 0.0).count();
    WantedTopology {
        bodies: shape.pieces - cavities,
        cavities,
        surface_euler_characteristic: shape.euler_characteristic,
    }
}

/// Cell [m] at which a body gives about `n` tetrahedra: n = 12 V/h^3 + c A/h^2, where c = 10 is what
/// stuffing adds at the surface of large bodies (measured on balls).
fn cell_for_count(n: f64, volume_m3: f64, area_m2: f64) -> f64 {
    const SURFACE_COEFFICIENT: f64 = 10.0;
    let count = |cell_m: f64| {
        volume_m3 / TETRAHEDRON_OVER_CELL / (cell_m * cell_m * cell_m)
            + SURFACE_COEFFICIENT * area_m2 / (cell_m * cell_m)
    };
    let mut cell_m = libm::cbrt(volume_m3 / TETRAHEDRON_OVER_CELL / n);
    for _ in 0..20 {
        cell_m *= libm::pow(count(cell_m) / n, 0.4);
    }
    cell_m
}

/// One position of the lattice.
struct Attempt<'a> {
    plan: &'a MeshPlan,
    field: &'a SignedDistance,
    offset: DVec3,
}

struct Found {
    filling: Filling,
    cell_m: f64,
    level_m: f64,
    changed_nodes: usize,
    stiff_nodes: usize,
}

impl Attempt<'_> {
    /// Lattice of `cell_m` around the surface, with two layers and a quarter of a cell to spare.
    fn lattice(&self, cell_m: f64) -> Lattice {
        const LAYERS: f64 = 3.5;
        let bounds_m = self.plan.bounds_m;
        let n = (bounds_m.size_m() / cell_m).ceil() + 2.0 * LAYERS;
        let dims = [n.x, n.y, n.z].map(|n| n as usize);
        let extent_m = cell_m * (DVec3::new(dims[0] as f64, dims[1] as f64, dims[2] as f64) - 0.5);
        let origin_m = bounds_m.center_m() - 0.5 * extent_m + cell_m * (self.offset - 0.25);
        Lattice { dims, cell_m, origin_m }
    }

    /// Searches the cell, from `cell_m` on, and the level.
    fn search(&self, first_cell_m: f64, n_fillings: &mut usize) -> Result<Found, String> {
        const MAX_SIZE_ITERATIONS: usize = 12;
        let WantedSize::Tetrahedra(wanted) = self.plan.params.size else {
            return self.filled(first_cell_m, 0.0, VOLUME_GOAL, n_fillings);
        };
        let wanted = wanted as f64;
        let mut cell_m = first_cell_m;
        let mut level_m = 0.0;
        let mut best: Option<(f64, f64)> = None;
        for _ in 0..MAX_SIZE_ITERATIONS {
            let found = self.filled(cell_m, level_m, LOOSE_VOLUME_GOAL, n_fillings)?;
            level_m = found.level_m;
            let ratio = found.filling.mesh.tetrahedra.len() as f64 / wanted;
            let off = (ratio - 1.0).abs();
            if best.is_none_or(|(least, _)| off < least) {
                best = Some((off, cell_m));
            }
            if off < COUNT_GOAL {
                break;
            }
            cell_m *= libm::pow(ratio, 1.0 / 2.8);
        }
        let (_, cell_m) = best.expect("at least one iteration");
        let found = self.filled(cell_m, level_m, VOLUME_GOAL, n_fillings)?;
        let n = found.filling.mesh.tetrahedra.len();
        if (n as f64 / wanted - 1.0).abs() > COUNT_TOLERANCE {
            return Err(format!("{n} tetrahedra instead of {wanted} at {:.3} mm cells", 1e3 * cell_m));
        }
        Ok(found)
    }

    /// Fills at `cell_m`, with the level moved until the volume is met.
    fn filled(&self, cell_m: f64, level_m: f64, goal: f64, n_fillings: &mut usize) -> Result<Found, String> {
        const MAX_LEVELS: usize = 24;
        let wanted_m3 = self.plan.volume_m3;
        let mut stuffing =
            Stuffing::new(self.lattice(cell_m), |p_m| self.field.sample_m(p_m), self.plan.topology);
        let mut best: Option<(f64, f64, Filling)> = None;
        // Levels with their volume errors: the highest known to be too low, the lowest known to be too high.
        let (mut low, mut high): (Option<[f64; 2]>, Option<[f64; 2]>) = (None, None);
        let mut level_m = level_m.clamp(-cell_m, cell_m);
        for _ in 0..MAX_LEVELS {
            // How many there will be is not known; mostly some ten.
            tell(*n_fillings as f64 / (*n_fillings as f64 + 5.0));
            *n_fillings += 1;
            let filling = stuffing.fill(level_m).map_err(|error: StuffingError| error.to_string())?;
            let error = filling.mesh.volume_m3() / wanted_m3 - 1.0;
            let area_m2 = area_m2(&filling);
            if best.as_ref().is_none_or(|(least, ..)| error.abs() < *least) {
                best = Some((error.abs(), level_m, filling));
            }
            if error.abs() < goal {
                break;
            }
            let side = if error < 0.0 { &mut low } else { &mut high };
            *side = Some([level_m, error]);
            level_m = match (low, high) {
                (Some([low_m, low]), Some([high_m, high])) => {
                    if high_m - low_m < 1e-6 * cell_m {
                        break;
                    }
                    // Kept away from the ends: a jump of the volume there would stall the secant.
                    let part = (low / (low - high)).clamp(0.1, 0.9);
                    low_m + part * (high_m - low_m)
                }
                // One-sided: a little more than Newton's step, to get the other side.
                _ => (level_m - 1.05 * error * wanted_m3 / area_m2).clamp(-cell_m, cell_m),
            };
        }
        let (error, level_m, filling) = best.expect("at least one level");
        if error > VOLUME_TOLERANCE.max(goal) {
            return Err(format!("volume off by {:.2} % at {:.3} mm cells", 100.0 * error, 1e3 * cell_m));
        }
        let (changed_nodes, stiff_nodes) = (stuffing.n_changed_signs(), stuffing.n_stiff());
        Ok(Found { filling, cell_m, level_m, changed_nodes, stiff_nodes })
    }
}

fn area_m2(filling: &Filling) -> f64 {
    let corner_m = |v: u32| filling.mesh.positions_m[NodeId(v).index()];
    filling
        .surface
        .iter()
        .map(|t| {
            let [a, b, c] = t.map(corner_m);
            0.5 * (b - a).cross(c - a).length()
        })
        .sum()
}
