//! Explicit dynamics of lumped masses: supports, loads, ligaments, damping, steps and edits, shared by all models
//! that bring their elastic forces.
//!
//! `frame` is what they have in common. Two movers stand on it: `central`, central differences of displacements in the
//! padded layout of the tensor-mass forces, and `by_scheme`, any scheme of [`crate::solve::integrators`] for forces of
//! positions and velocities.

mod dynamics;
mod by_scheme;
mod central;
mod cuttable;
mod frame;
mod mass_shares;
mod rest_tensions;
mod stable;
mod stand_in;

pub(in crate::model) use by_scheme::{ExplicitBody, InternalForces, check_number};
pub use by_scheme::{Inertia, Integration};
pub(in crate::model) use central::ExplicitMotion;
pub use central::ExplicitSnapshot;
pub(in crate::model) use cuttable::{
    Cuttable, Insertions, LiveEdges, LiveTets, follow, place_of, renumbered,
};
pub(in crate::model) use dynamics::{ExplicitDynamics, Mover};
pub(in crate::model) use frame::{Quarantine, check_body};
pub(in crate::model) use mass_shares::{MassShares, StiffTet};
pub(in crate::model) use rest_tensions::RestTensions;
#[cfg(test)]
pub(in crate::model) use stable::estimate_from_below;
pub use stable::{MOST_NODES_PROVEN, StableStep};
pub(in crate::model) use stable::{Stability, masses_kg};
pub(in crate::model) use stand_in::{StandIn, StandIns};

use crate::solve::SolveError;
use glisson_mesh::math::DVec3;
use glisson_mesh::mesh::TetId;

/// Why there is no model with explicit dynamics.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum ExplicitError {
    /// The mesh is unusable, or a support or ligament is at a node that does not exist.
    #[error(transparent)]
    Solve(#[from] SolveError),
    /// A step above the stable one.
    #[error(
        "time step {} ms is above the stable one: central differences allow at most {:.4} ms here, because of \
         tetrahedron {tet} (smallest ratio of size to wave speed). Take a smaller step, a coarser mesh or a softer \
         material",
        1e3 * found_s,
        1e3 * allowed_s
    )]
    UnstableStep {
        /// What was asked for [s].
        found_s: f64,
        /// The largest allowed step [s].
        allowed_s: f64,
        /// The tetrahedron that limits it.
        tet: TetId,
    },
    /// A step above the one that is stable with a scheme.
    #[error(
        "time step {found_s:e} s is above the stable one: {scheme} allows at most {allowed_s:e} s here. Take a \
         smaller step, a coarser mesh, a softer material or (Runge-Kutta 2) more damping"
    )]
    UnstableScheme {
        /// Name of the scheme.
        scheme: &'static str,
        /// What was asked for [s].
        found_s: f64,
        /// The largest allowed step [s].
        allowed_s: f64,
    },
    /// A parameter that is negative or no number.
    #[error("{what} is {found}; allowed: {allowed}")]
    Parameter {
        /// Which one, with its unit.
        what: &'static str,
        /// What was given.
        found: f64,
        /// What may be given.
        allowed: &'static str,
    },
    /// Stresses at rest are given for another number of tetrahedra.
    #[error("there are {found} stresses at rest for {n_tets} tetrahedra; allowed: none, or one for each")]
    RestStressCount {
        /// How many were given.
        found: usize,
        /// How many tetrahedra there are.
        n_tets: usize,
    },
}

/// Three numbers padded to four, so that one load fetches them.
pub(in crate::model) type Padded = [f64; 4];

pub(in crate::model) fn padded(v: DVec3) -> Padded {
    [v.x, v.y, v.z, 0.0]
}

pub(in crate::model) fn unpadded(v: &Padded) -> DVec3 {
    DVec3::new(v[0], v[1], v[2])
}

/// Keeps the values whose flag is set, in their order.
pub(in crate::model) fn keep<T>(values: &mut Vec<T>, stays: &[bool]) {
    let mut flags = stays.iter();
    values.retain(|_| *flags.next().expect("one flag a value"));
}
