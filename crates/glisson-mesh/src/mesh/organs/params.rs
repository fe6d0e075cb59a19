//! What mesh of several organs is wanted.

use crate::math::DVec3;

/// Largest number of tetrahedra that can be asked for.
pub const MAX_ORGAN_TETRAHEDRA: usize = 20_000_000;

/// Smallest number of tetrahedra that can be asked for.
pub const MIN_ORGAN_TETRAHEDRA: usize = 500;

/// How large the tetrahedra should be.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum OrganSize {
    /// About this many tetrahedra of all organs together, met within 5 % where smooth borders allow it.
    Tetrahedra(usize),
    /// This lattice cell [m]: inner edges are 0.92 of it on the mean, those at borders about half as long.
    CellM(f64),
}

/// What mesh of several organs is wanted.
#[derive(Clone, Debug, PartialEq)]
pub struct OrganMeshParams {
    /// Labels that become regions; empty: all that the map has. Other labels count as outside.
    pub labels: Vec<u16>,
    /// Size or number of tetrahedra.
    pub size: OrganSize,
    /// Where they are smaller than elsewhere.
    pub grading: Grading,
}

/// Where tetrahedra are smaller than elsewhere. Around these places they grow with the distance. By default nowhere.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Grading {
    /// So many tetrahedra each organ gets at least, about; 0: as many as come with the cells of all. Small organs keep their
    /// volume and shape so.
    pub least_tetrahedra: usize,
    /// By how much cells at the surface of all organs together are smaller than within: 1 to [`MAX_FINER`].
    pub finer_at_surface: Option<f64>,
    /// Balls in which cells are smaller.
    pub balls: Vec<FinerBall>,
}

/// A place where cells are smaller.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FinerBall {
    /// Its centre [m], LPS.
    pub center_m: DVec3,
    /// Its radius [m].
    pub radius_m: f64,
    /// By how much cells in it are smaller: 1 to [`MAX_FINER`].
    pub factor: f64,
}

/// Largest ratio of cells that can be asked for.
pub const MAX_FINER: f64 = 16.0;
