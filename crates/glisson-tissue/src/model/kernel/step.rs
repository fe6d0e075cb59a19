//! The input of a step and the sums that it returns, for each part.

use super::ExplicitStep;
use super::rows::{N_LANES, Row};

/// Numbers in a row.
pub(super) const ROW_LANES: usize = size_of::<Row>() / size_of::<f64>();

/// Rows that are advanced together; a part's rows are padded to whole groups.
pub(super) const GROUP_ROWS: usize = N_LANES / ROW_LANES;

/// Report on the moving nodes of a step.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct StepSums {
    /// Kinetic energy of the half step before [J].
    pub kinetic_before_j: f64,
    /// Kinetic energy of the half step after [J].
    pub kinetic_after_j: f64,
    /// Work of the outer forces along half of both increments [J].
    pub outer_work_j: f64,
    /// Number of nodes that stayed where they were, at rest, because their new position was not finite.
    pub n_recovered: u32,
}

/// Factors of a step of central differences: the new increment is `keep` times the last one plus `push_s2` times
/// force over mass.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct StepFactors {
    pub(super) keep: f64,
    pub(super) push_s2: f64,
    /// Length of the step over that of the last one.
    pub(super) stretch: f64,
    /// 1/h^2 of the last step and of this one [1/s2].
    pub(super) per_square_s2: [f64; 2],
    /// Elastic forces are taken at u plus this multiple of the last increment; zero without stiffness damping.
    pub(super) lead: Option<f64>,
}

impl StepFactors {
    /// With stiffness damping, forces are taken at u + beta v, with v the velocity of the last half step.
    pub(super) fn new(step: ExplicitStep, last_s: f64, stiffness_damping_s: f64) -> Self {
        let ExplicitStep { step_s: h, damping_per_s: d } = step;
        let inverse = 1.0 / (1.0 / (h * h) + 0.5 * d / h);
        let stretch = h / last_s;
        Self {
            keep: (1.0 / (h * h) - 0.5 * d / h) * inverse * stretch,
            push_s2: inverse,
            stretch,
            per_square_s2: [1.0 / (last_s * last_s), 1.0 / (h * h)],
            lead: (stiffness_damping_s > 0.0).then(|| stiffness_damping_s / last_s),
        }
    }

    pub(super) fn leads(&self) -> bool {
        self.lead.is_some()
    }
}
