//! What a model tells about its last step.

use glisson_mesh::mesh::TetId;

/// How a model's last step went. A step never fails: what it could not do as asked is here.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ModelReport {
    /// Internal steps made; 1 for a quasi-static or implicit model.
    pub n_parts: u32,
    /// Tetrahedra that were inverted or whose numbers were not finite. Where the law gives no number they were left
    /// out of the forces or followed a substitute that does. Those of a piece cut loose from a pre-computed organ of which
    /// no dynamic body could be made, which stay where they are, count too.
    pub n_quarantined_tets: u32,
    /// The first of them.
    pub first_quarantined: Option<TetId>,
    /// Nodes that were brought back to their last finite place.
    pub n_recovered_nodes: u32,
    /// Nodes that are heavier than their tissue, so that the step stays stable after an edit, or that a loose piece makes
    /// no shorter steps.
    pub n_mass_scaled_nodes: u32,
    /// Constraints that were left out: on nodes that do not exist, are fixed or have no tetrahedron, and values
    /// that are not finite.
    pub n_ignored_constraints: u32,
    /// Kinetic energy [J]; after an edit of the mesh it may still be that of the last step.
    pub kinetic_energy_j: f64,
    /// The kinetic energy grew beyond what the outside can have put in, and the velocities were cut down.
    pub energy_was_limited: bool,
    /// A step that solves equations ended before their residual was small enough.
    pub missed_tolerance: bool,
    /// Allocations are allowed where the topology changes by more than a removal: how often it happened since
    /// the model was made. The pre-computed model allocates at every cut.
    pub n_reanalyses: u32,
    /// Estimated error of a pre-computed compliance after cuts, relative to its largest entry.
    pub compliance_error: f64,
    /// A fresh pre-computation of the cut organ should take over: errors or the history of cuts grew too large.
    pub wants_recomputation: bool,
}
