//! What mesh of several organs is wanted.

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
}
