//! What cutting did to a pre-computed body.

/// How far a compliance has come from the pre-computed one.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct CutReport {
    /// Edits followed.
    pub n_edits: usize,
    /// Tetrahedra that left the compliance, loose ones at hinges included.
    pub n_taken_out: usize,
    /// Tetrahedra of pieces that came loose and were handed to a dynamic body.
    pub n_loose: usize,
    /// Tetrahedra of pieces that came loose and of which no dynamic body could be made: they stay where they are.
    pub n_stuck: usize,
    /// Columns of low rank in the history.
    pub n_columns: usize,
    /// Nodes laid bare that got rows and columns from the factor.
    pub n_laid_bare: usize,
    /// Least pivot of all capacitance matrices so far; 1 before the first.
    pub least_pivot: f64,
    /// Estimated error relative to the largest entry of the compliance: the largest of all probes so far. Each probe
    /// sums some columns with random signs, so that it is seldom below the worst entry's error and mostly some times above.
    pub error: f64,
    /// Whether a fresh pre-computation should take over.
    pub wants_recomputation: bool,
}
