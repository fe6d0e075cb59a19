//! Why an edit of the organ was refused.

use crate::mesh::edit::EditError;
use crate::mesh::topology::TopologyError;
use crate::model::TopologyRefusal;
use crate::tool::cut::scalpel::ScalpelRefusal;
use crate::tool::cut::subdivision::CutRefusal;
use glisson_mesh::fault::OrderedFault;

/// Why an edit of the organ was refused. Nothing changed.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum EditRefusal {
    /// The model cannot follow.
    #[error(transparent)]
    Model(#[from] TopologyRefusal),
    /// The mesh cannot be edited so.
    #[error(transparent)]
    Mesh(#[from] EditError),
    /// The mesh is no mesh.
    #[error(transparent)]
    Topology(#[from] TopologyError),
    /// A blade's step makes no cut that the mesh can bear.
    #[error(transparent)]
    Cut(#[from] CutRefusal),
    /// Scissors that do not close hard enough for the tissue.
    #[error(
        "the jaws close with {found_n} N; to part this tissue they need {needed_n:.2} N (closing_force, jaw_length)"
    )]
    TooWeak {
        /// Force of the jaws [N].
        found_n: f64,
        /// Force that the crack takes [N].
        needed_n: f64,
    },
    /// A scalpel cannot be followed.
    #[error(transparent)]
    Scalpel(#[from] ScalpelRefusal),
    /// Only in tests.
    #[error(transparent)]
    Ordered(#[from] OrderedFault),
}
