//! The models by their scene names.

use crate::material::law_names;
use serde::{Deserialize, Serialize};
use std::fmt;

/// Which model moves an organ.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum ModelKind {
    /// Linear elasticity through a pre-computed compliance: quasi-static, follows cuts.
    Precomputed,
    /// The pre-computed model with forces and displacements that follow measured curves; cannot be cut.
    QuasiNonlinear,
    /// St Venant-Kirchhoff in reduced coordinates: quasi-static, right under bending and turning, cannot be cut.
    Reduced,
    /// Linear tensor-mass: explicit dynamics, can be cut.
    TensorMass,
    /// St Venant-Kirchhoff tensor-mass as in the papers, the reference implementation: explicit dynamics, right
    /// under large rotations, can be cut.
    NonlinearTensorMass,
    /// The fast kernel with any law, total Lagrangian explicit dynamics: can be cut, on several threads.
    Explicit,
    /// Implicit Euler with any law: large steps, can be cut.
    Implicit,
    /// Masses and springs on the edges: explicit dynamics, can be cut, no law of elasticity behind it.
    MassSpring,
    /// Forces from squared edge lengths, with viscosity: explicit dynamics, can be cut.
    ExtendedMassSpring,
    /// Pre-computed zones and tensor-mass ones, linear or of St Venant-Kirchhoff tissue, coupled exactly: can be cut.
    Hybrid,
}

impl ModelKind {
    /// All kinds, in the order that messages list them.
    pub const ALL: [Self; 10] = [
        Self::Precomputed,
        Self::TensorMass,
        Self::NonlinearTensorMass,
        Self::Explicit,
        Self::Implicit,
        Self::MassSpring,
        Self::ExtendedMassSpring,
        Self::Hybrid,
        Self::Reduced,
        Self::QuasiNonlinear,
    ];

    /// The name in scene files.
    pub fn name(self) -> &'static str {
        match self {
            Self::Precomputed => "precomputed",
            Self::TensorMass => "tensor_mass",
            Self::NonlinearTensorMass => "nonlinear_tensor_mass",
            Self::Explicit => "explicit",
            Self::Implicit => "implicit",
            Self::MassSpring => "mass_spring",
            Self::ExtendedMassSpring => "extended_mass_spring",
            Self::Hybrid => "hybrid",
            Self::Reduced => "reduced",
            Self::QuasiNonlinear => "quasi_nonlinear",
        }
    }

    /// The kind with this scene name.
    pub fn by_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|kind| kind.name() == name)
    }

    /// Names of the laws that the model can follow; the first is its own. None for springs without a law.
    pub fn laws(self) -> Vec<&'static str> {
        match self {
            Self::Precomputed | Self::QuasiNonlinear | Self::TensorMass => vec!["linear"],
            Self::Hybrid => vec!["linear", "st_venant_kirchhoff"],
            Self::NonlinearTensorMass | Self::Reduced => vec!["st_venant_kirchhoff"],
            Self::Explicit => every_law_after(&["st_venant_kirchhoff"]),
            Self::Implicit => every_law_after(&["neo_hooke_log", "stable_neo_hooke", "st_venant_kirchhoff"]),
            Self::MassSpring => Vec::new(),
            Self::ExtendedMassSpring => vec!["st_venant_kirchhoff", "neo_hooke_log"],
        }
    }

    /// Whether the model can follow a law of this name. [`Self::Explicit`] and [`Self::Implicit`] follow any, also one that
    /// is not in the table of laws.
    pub fn follows(self, law: &str) -> bool {
        matches!(self, Self::Explicit | Self::Implicit) || self.laws().contains(&law)
    }
}

/// The names of all laws: those `first`, the others in the order of the table.
fn every_law_after(first: &[&'static str]) -> Vec<&'static str> {
    first.iter().copied().chain(law_names().filter(|name| !first.contains(name))).collect()
}

impl fmt::Display for ModelKind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}
