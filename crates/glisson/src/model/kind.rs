//! The models by their scene names.

use serde::{Deserialize, Serialize};
use std::fmt;

/// Which model moves an organ.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum ModelKind {
    /// Linear elasticity through a pre-computed compliance: quasi-static, cannot be cut.
    Precomputed,
    /// Linear tensor-mass: explicit dynamics, can be cut.
    TensorMass,
    /// St Venant-Kirchhoff tensor-mass: explicit dynamics, right under large rotations, can be cut.
    StVenantKirchhoff,
}

impl ModelKind {
    /// All kinds, in the order that messages list them.
    pub const ALL: [Self; 3] = [Self::Precomputed, Self::TensorMass, Self::StVenantKirchhoff];

    /// The name in scene files.
    pub fn name(self) -> &'static str {
        match self {
            Self::Precomputed => "precomputed",
            Self::TensorMass => "tensor_mass",
            Self::StVenantKirchhoff => "st_venant_kirchhoff",
        }
    }

    /// The kind with this scene name.
    pub fn by_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|kind| kind.name() == name)
    }
}

impl fmt::Display for ModelKind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}
