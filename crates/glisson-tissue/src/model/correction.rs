//! Contact corrects a step after it was made: how the result of a step answers to forces beyond those that acted in it.
//!
//! A contact force depends on where the step leads, which is known only afterwards. For a step h of a lumped explicit
//! scheme the answer is exact: a further force f moves its node alone, by h^2 f/m. An implicit step answers through its
//! tangent, (M/h^2 + D/h + K)^-1 f, here with the tangent of the factor at hand: what that misses is an error of the
//! correction only, which vanishes as the forces that act in the step itself come to be the right ones. A quasi-static
//! model is stepped again under the new forces.

/// How a model answers to further forces.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum StepAnswer {
    /// It does not tell: it follows the forces of its next step only.
    Unknown,
    /// Every node for itself, by `node_answer_m_per_n`.
    NodeByNode,
    /// All nodes together, by `answer_into`.
    Coupled {
        /// Another number whenever the answer may have become another.
        version: u64,
    },
    /// At once, by another step.
    Static,
}

/// Where an answer is asked for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Answered {
    /// At all nodes.
    Everywhere,
    /// At the nodes of the forces, of which some may be zero; what others get has no meaning. The same bits, for less.
    AtForces,
}

/// What a correction changes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Correction {
    /// Places and velocities: as if the forces had acted in the step.
    Motion,
    /// Places alone: what undoes a penetration must not become motion.
    Places,
}
