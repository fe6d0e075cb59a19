//! Report on the cuts of a pre-computed body.

/// How far the compliance is from the pre-computed one.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct CutReport {
    /// Edits followed.
    pub n_edits: usize,
    /// Tetrahedra that left the compliance, loose ones at hinges included.
    pub n_taken_out: usize,
    /// Tetrahedra of fragments that became dynamic bodies.
    pub n_loose: usize,
    /// Tetrahedra of fragments from which no dynamic body could be made: they stay where they are.
    pub n_stuck: usize,
    /// Columns of the low-rank updates in the history.
    pub n_columns: usize,
    /// Nodes exposed by cuts that got rows and columns from the factor.
    pub n_laid_bare: usize,
    /// Least pivot of all capacitance matrices so far; 1 before the first.
    pub least_pivot: f64,
    /// Estimated error relative to the largest entry of the compliance: the largest of all probes so far. Each probe sums
    /// some columns with random signs. It is seldom below the error of the worst entry, and mostly a few times above.
    pub error: f64,
    /// Whether a new pre-computation should replace it.
    pub wants_recomputation: bool,
}
