//! Criteria of one tetrahedron's shape, and the ways in which it can be degenerate (seed `000` s. 4.4.2).
//!
//! All criteria are 1 for the regular tetrahedron and lie between 0 and 1. With edges l, faces s, volume v,
//! rho_in = 3 v / sum s, rho_out = sqrt((a + b + c)(-a + b + c)(a - b + c)(a + b - c)) / (24 v) for the products
//! a, b, c of opposite edges:
//! - min l / max l, which misses flat tetrahedra with long edges;
//! - (12 / sqrt 6) rho_in / max l (the seed prints the factor the wrong way up);
//! - 3 rho_in / rho_out, which sees every degeneracy;
//! - smallest solid angle over 6 asin(1 / sqrt 3) - pi;
//! - smallest dihedral angle over pi - acos(-1/3), which misses needles (the seed multiplies).
//!
//! A tetrahedron of volume 0 or less has 0 in all but the edge ratio.

use super::{FACES, dihedral_cosines};
use crate::math::{DVec3, tetrahedron_volume_m3};

/// Solid angle at a corner of the regular tetrahedron [sr]: 6 asin(1 / sqrt 3) - pi.
pub const REGULAR_SOLID_ANGLE_SR: f64 = 0.551_285_598_432_530_8;

/// Dihedral angle of the regular tetrahedron [rad]: pi - acos(-1/3) = acos(1/3).
pub const REGULAR_DIHEDRAL_RAD: f64 = 1.230_959_417_340_774_6;

/// Pairs of corners of the six edges; pair `5 - k` is opposite to pair `k`.
const EDGES: [[usize; 2]; 6] = [[0, 1], [0, 2], [0, 3], [1, 2], [1, 3], [2, 3]];

/// Lengths, areas, volume, radii and angles of one tetrahedron.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TetMeasures {
    /// Edges 01, 02, 03, 12, 13, 23 [m].
    pub edges_m: [f64; 6],
    /// Faces opposite to corners 0 to 3 [m2].
    pub areas_m2: [f64; 4],
    /// Signed volume [m3].
    pub volume_m3: f64,
    /// Radius of the inscribed sphere [m]; 0 without volume.
    pub inner_radius_m: f64,
    /// Radius of the sphere through the corners [m]; infinite without volume.
    pub outer_radius_m: f64,
    /// Solid angle at each corner [sr] (Van Oosterom and Strackee 1983, The solid angle of a plane triangle).
    pub solid_angles_sr: [f64; 4],
    /// Dihedral angles [rad] between the faces opposite to corners 01, 02, 03, 12, 13, 23.
    pub dihedrals_rad: [f64; 6],
}

impl TetMeasures {
    /// Measures of the tetrahedron with these corners [m].
    pub fn of(corners_m: [DVec3; 4]) -> Self {
        let edges_m = EDGES.map(|[i, j]| corners_m[i].distance(corners_m[j]));
        let areas_m2 = FACES.map(|f| area_vector_m2(corners_m, f).length());
        let volume_m3 = tetrahedron_volume_m3(corners_m);
        let [a, b, c] = [0, 1, 2].map(|k| edges_m[k] * edges_m[5 - k]);
        let (inner_radius_m, outer_radius_m) = if volume_m3 > 0.0 {
            let squared = (a + b + c) * (-a + b + c) * (a - b + c) * (a + b - c);
            (3.0 * volume_m3 / areas_m2.iter().sum::<f64>(), squared.max(0.0).sqrt() / (24.0 * volume_m3))
        } else {
            (0.0, f64::INFINITY)
        };
        Self {
            edges_m,
            areas_m2,
            volume_m3,
            inner_radius_m,
            outer_radius_m,
            solid_angles_sr: [0, 1, 2, 3].map(|corner| solid_angle_sr(corners_m, corner)),
            dihedrals_rad: dihedral_cosines(corners_m).map(libm::acos),
        }
    }

    /// Longest edge [m].
    pub fn longest_edge_m(&self) -> f64 {
        self.edges_m.iter().fold(0.0, |most, &l| l.max(most))
    }

    /// Shortest edge [m].
    pub fn shortest_edge_m(&self) -> f64 {
        self.edges_m.iter().fold(f64::INFINITY, |least, &l| l.min(least))
    }
}

/// Solid angle [sr] at one corner: tan(angle / 2) = 6 v / (x y z + (x.y) z + (y.z) x + (z.x) y).
fn solid_angle_sr(corners_m: [DVec3; 4], corner: usize) -> f64 {
    let [x, y, z] = FACES[corner].map(|other| corners_m[other] - corners_m[corner]);
    let (lx, ly, lz) = (x.length(), y.length(), z.length());
    let below = lx * ly * lz + x.dot(y) * lz + y.dot(z) * lx + z.dot(x) * ly;
    2.0 * libm::atan2(x.cross(y).dot(z).abs(), below)
}

fn area_vector_m2(corners_m: [DVec3; 4], [a, b, c]: [usize; 3]) -> DVec3 {
    0.5 * (corners_m[b] - corners_m[a]).cross(corners_m[c] - corners_m[a])
}

/// A number between 0 and 1 for a tetrahedron's shape, 1 for the regular one.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Criterion {
    /// min l / max l.
    EdgeRatio,
    /// (12 / sqrt 6) rho_in / max l.
    InnerRadiusToLongestEdge,
    /// 3 rho_in / rho_out, called RRS in seed `000`; [`super::radius_ratio`] by another formula.
    RadiusRatio,
    /// Smallest solid angle over the regular one's.
    SolidAngle,
    /// Smallest dihedral angle over the regular one's.
    Dihedral,
}

impl Criterion {
    /// Every criterion.
    pub const ALL: [Self; 5] = [
        Self::EdgeRatio,
        Self::InnerRadiusToLongestEdge,
        Self::RadiusRatio,
        Self::SolidAngle,
        Self::Dihedral,
    ];

    /// The criterion's value for a tetrahedron.
    pub fn of(self, measures: &TetMeasures) -> f64 {
        let least = |values: &[f64]| values.iter().fold(f64::INFINITY, |least, &x| x.min(least));
        let longest_m = measures.longest_edge_m();
        let has_volume = measures.volume_m3 > 0.0;
        match self {
            Self::EdgeRatio if longest_m > 0.0 => measures.shortest_edge_m() / longest_m,
            _ if !has_volume => 0.0,
            Self::EdgeRatio => 0.0,
            Self::InnerRadiusToLongestEdge => 12.0 / 6f64.sqrt() * measures.inner_radius_m / longest_m,
            Self::RadiusRatio => 3.0 * measures.inner_radius_m / measures.outer_radius_m,
            Self::SolidAngle => least(&measures.solid_angles_sr) / REGULAR_SOLID_ANGLE_SR,
            Self::Dihedral => least(&measures.dihedrals_rad) / REGULAR_DIHEDRAL_RAD,
        }
    }
}

/// How a tetrahedron is degenerate: type I has very short edges, type II none but four corners nearly in a plane
/// (seed `000` s. 4.4.2, after Forest).
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Degeneracy {
    /// Type I: two corners nearly in one place.
    OneShortEdge,
    /// Type I: two pairs of corners, each nearly in one place.
    TwoShortEdges,
    /// Type I: three corners nearly in one place.
    ThreeShortEdges,
    /// Type II: nearly in a plane, seen from above a quadrilateral with both diagonals.
    Sliver,
    /// Type II: nearly in a plane, one corner over the triangle of the others.
    Cap,
}

impl Degeneracy {
    /// Whether it is of type I: short edges, which a collapse takes away.
    pub fn has_short_edges(self) -> bool {
        matches!(self, Self::OneShortEdge | Self::TwoShortEdges | Self::ThreeShortEdges)
    }
}

/// From where on a tetrahedron counts as degenerate. Both are choices; the seed has no numbers.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DegeneracyLimits {
    /// An edge below this share of the longest one is very short. Below 1/3, so that four corners are never
    /// all in one place.
    pub short_edge: f64,
    /// A tetrahedron below this radius ratio is degenerate.
    pub radius_ratio: f64,
}

impl Default for DegeneracyLimits {
    fn default() -> Self {
        Self { short_edge: 0.15, radius_ratio: 0.1 }
    }
}

/// How a tetrahedron is degenerate, if it is.
pub fn degeneracy(corners_m: [DVec3; 4], limits: &DegeneracyLimits) -> Option<Degeneracy> {
    let lengths_m = EDGES.map(|[i, j]| corners_m[i].distance(corners_m[j]));
    let short_m = limits.short_edge * lengths_m.iter().fold(0.0, |most: f64, &l| l.max(most));
    // Corners joined by short edges are one place.
    let mut place = [0, 1, 2, 3];
    for ([i, j], &length_m) in EDGES.iter().zip(&lengths_m) {
        if length_m <= short_m {
            let (from, to) = (place[*i].max(place[*j]), place[*i].min(place[*j]));
            for p in &mut place {
                if *p == from {
                    *p = to;
                }
            }
        }
    }
    let size = |of: usize| place.iter().filter(|&&p| p == of).count();
    let mut sizes = [0, 1, 2, 3].map(size);
    sizes.sort_unstable();
    match sizes {
        [.., 1] => {}
        [.., 2, 2] => return Some(Degeneracy::TwoShortEdges),
        [.., 2] => return Some(Degeneracy::OneShortEdge),
        _ => return Some(Degeneracy::ThreeShortEdges),
    }
    if super::radius_ratio(corners_m) >= limits.radius_ratio {
        return None;
    }
    // Seen along the normal of the largest face, two faces look up and two down in a sliver, one and three in a cap.
    let areas_m2 = FACES.map(|f| area_vector_m2(corners_m, f));
    let largest = areas_m2
        .iter()
        .fold(DVec3::ZERO, |most, &a| if a.length_squared() > most.length_squared() { a } else { most });
    let n_up = areas_m2.iter().filter(|a| a.dot(largest) > 0.0).count();
    Some(if n_up == 2 { Degeneracy::Sliver } else { Degeneracy::Cap })
}
