//! The laws that scenes and the command line know, by name.

use super::{LinearElastic, Material, NeoHookeLog, StVenantKirchhoff};

/// A law with its parameters: the closed set of laws.
#[derive(Clone, Debug, PartialEq)]
pub enum MaterialSpec {
    /// `linear`
    Linear(LinearElastic),
    /// `st_venant_kirchhoff`
    StVenantKirchhoff(StVenantKirchhoff),
    /// `neo_hooke_log`
    NeoHookeLog(NeoHookeLog),
}

impl MaterialSpec {
    /// The names, as scenes write them.
    pub const NAMES: [&'static str; 3] = ["linear", "st_venant_kirchhoff", "neo_hooke_log"];

    /// Its name.
    pub fn name(&self) -> &'static str {
        match self {
            Self::Linear(_) => "linear",
            Self::StVenantKirchhoff(_) => "st_venant_kirchhoff",
            Self::NeoHookeLog(_) => "neo_hooke_log",
        }
    }

    /// The law itself, for code that is not generic.
    pub fn material(&self) -> &dyn Material {
        match self {
            Self::Linear(law) => law,
            Self::StVenantKirchhoff(law) => law,
            Self::NeoHookeLog(law) => law,
        }
    }
}
