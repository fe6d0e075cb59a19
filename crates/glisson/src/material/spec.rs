//! The laws that scenes and the command line know, by name.

use super::{
    HolzapfelGasserOgden, LinearElastic, Material, MooneyRivlin, NeoHookeLog, Ogden, StVenantKirchhoff,
    StableNeoHooke,
};

/// A law with its parameters: the closed set of laws.
///
/// ```
/// use glisson::material::{LinearElastic, MaterialSpec, StableNeoHooke};
/// use glisson::math::DMat3;
/// let liver = LinearElastic::from_young_poisson(5000.0, 0.45, 1060.0)?;
/// let spec = MaterialSpec::StableNeoHooke(StableNeoHooke::from(&liver));
/// assert_eq!(spec.name(), "stable_neo_hooke");
/// assert!(spec.material().energy_density_j_per_m3(&(DMat3::IDENTITY * 1.1)) > 0.0);
/// # Ok::<(), glisson::material::MaterialError>(())
/// ```
#[derive(Clone, Debug, PartialEq)]
pub enum MaterialSpec {
    /// `linear`
    Linear(LinearElastic),
    /// `st_venant_kirchhoff`
    StVenantKirchhoff(StVenantKirchhoff),
    /// `neo_hooke_log`
    NeoHookeLog(NeoHookeLog),
    /// `stable_neo_hooke`
    StableNeoHooke(StableNeoHooke),
    /// `mooney_rivlin`
    MooneyRivlin(MooneyRivlin),
    /// `ogden`
    Ogden(Ogden),
    /// `holzapfel_gasser_ogden`
    HolzapfelGasserOgden(HolzapfelGasserOgden),
}

impl MaterialSpec {
    /// The names, as scenes write them.
    pub const NAMES: [&'static str; 7] = [
        "linear",
        "st_venant_kirchhoff",
        "neo_hooke_log",
        "stable_neo_hooke",
        "mooney_rivlin",
        "ogden",
        "holzapfel_gasser_ogden",
    ];

    /// Its name.
    pub fn name(&self) -> &'static str {
        match self {
            Self::Linear(_) => "linear",
            Self::StVenantKirchhoff(_) => "st_venant_kirchhoff",
            Self::NeoHookeLog(_) => "neo_hooke_log",
            Self::StableNeoHooke(_) => "stable_neo_hooke",
            Self::MooneyRivlin(_) => "mooney_rivlin",
            Self::Ogden(_) => "ogden",
            Self::HolzapfelGasserOgden(_) => "holzapfel_gasser_ogden",
        }
    }

    /// The law itself, for code that is not generic.
    pub fn material(&self) -> &dyn Material {
        match self {
            Self::Linear(law) => law,
            Self::StVenantKirchhoff(law) => law,
            Self::NeoHookeLog(law) => law,
            Self::StableNeoHooke(law) => law,
            Self::MooneyRivlin(law) => law,
            Self::Ogden(law) => law,
            Self::HolzapfelGasserOgden(law) => law,
        }
    }
}
