//! The laws that scenes and the command line know, by name.

use super::{
    HolzapfelGasserOgden, HolzapfelGasserOgdenParameters, LinearElastic, Material, MaterialError,
    MooneyRivlin, NeoHookeLog, Ogden, StVenantKirchhoff, StableNeoHooke,
};
use glisson_mesh::math::DVec3;
use std::sync::Arc;

/// A law with its parameters: the closed set of laws.
///
/// ```
/// use glisson_tissue::material::{LinearElastic, MaterialSpec, StableNeoHooke};
/// use glisson_mesh::math::DMat3;
/// let liver = LinearElastic::from_young_poisson(5000.0, 0.45, 1060.0)?;
/// let spec = MaterialSpec::StableNeoHooke(StableNeoHooke::from(&liver));
/// assert_eq!(spec.name(), "stable_neo_hooke");
/// assert!(spec.material().energy_density_j_per_m3(&(DMat3::IDENTITY * 1.1)) > 0.0);
/// # Ok::<(), glisson_tissue::material::MaterialError>(())
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

    /// The law, to be shared between threads.
    pub fn into_shared(self) -> Arc<dyn Material + Send + Sync> {
        match self {
            Self::Linear(law) => Arc::new(law),
            Self::StVenantKirchhoff(law) => Arc::new(law),
            Self::NeoHookeLog(law) => Arc::new(law),
            Self::StableNeoHooke(law) => Arc::new(law),
            Self::MooneyRivlin(law) => Arc::new(law),
            Self::Ogden(law) => Arc::new(law),
            Self::HolzapfelGasserOgden(law) => Arc::new(law),
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

/// A law by name, with what it needs beside the moduli of small strain: what scenes and the command line give.
#[derive(Clone, Debug, PartialEq)]
pub enum LawChoice {
    /// `linear`
    Linear,
    /// `st_venant_kirchhoff`
    StVenantKirchhoff,
    /// `neo_hooke_log`
    NeoHookeLog,
    /// `stable_neo_hooke`
    StableNeoHooke,
    /// `mooney_rivlin`
    MooneyRivlin {
        /// C01 as a share of C10 + C01, 0 to 1.
        second_share: f64,
    },
    /// `ogden`, of one term
    Ogden {
        /// The exponent alpha, not 0.
        exponent: f64,
    },
    /// `holzapfel_gasser_ogden`; the matrix has the shear and bulk modulus of small strain
    HolzapfelGasserOgden {
        /// k1: stiffness of the fibres [Pa].
        fibre_stiffness_pa: f64,
        /// k2: how fast they stiffen.
        fibre_exponent: f64,
        /// kappa: dispersion about the family's direction, 0 to 1/3.
        dispersion: f64,
        /// Direction of each family at rest; any length but zero.
        fibre_directions: Vec<DVec3>,
    },
}

impl LawChoice {
    /// Its name, one of [`MaterialSpec::NAMES`].
    pub fn name(&self) -> &'static str {
        match self {
            Self::Linear => "linear",
            Self::StVenantKirchhoff => "st_venant_kirchhoff",
            Self::NeoHookeLog => "neo_hooke_log",
            Self::StableNeoHooke => "stable_neo_hooke",
            Self::MooneyRivlin { .. } => "mooney_rivlin",
            Self::Ogden { .. } => "ogden",
            Self::HolzapfelGasserOgden { .. } => "holzapfel_gasser_ogden",
        }
    }

    /// The law that has the moduli of `linear` at small strain (the fibre law: without its fibres).
    ///
    /// # Errors
    /// [`MaterialError`] for parameters outside the law's range.
    pub fn with_moduli_of(&self, linear: &LinearElastic) -> Result<MaterialSpec, MaterialError> {
        Ok(match self {
            Self::Linear => MaterialSpec::Linear(*linear),
            Self::StVenantKirchhoff => MaterialSpec::StVenantKirchhoff(StVenantKirchhoff::from(linear)),
            Self::NeoHookeLog => MaterialSpec::NeoHookeLog(NeoHookeLog::from(linear)),
            Self::StableNeoHooke => MaterialSpec::StableNeoHooke(StableNeoHooke::from(linear)),
            &Self::MooneyRivlin { second_share } => {
                MaterialSpec::MooneyRivlin(MooneyRivlin::from_linear(linear, second_share)?)
            }
            &Self::Ogden { exponent } => MaterialSpec::Ogden(Ogden::from_linear(linear, exponent)?),
            Self::HolzapfelGasserOgden {
                fibre_stiffness_pa,
                fibre_exponent,
                dispersion,
                fibre_directions,
            } => MaterialSpec::HolzapfelGasserOgden(HolzapfelGasserOgden::new(
                &HolzapfelGasserOgdenParameters {
                    matrix_shear_pa: linear.mu_pa(),
                    fibre_stiffness_pa: *fibre_stiffness_pa,
                    fibre_exponent: *fibre_exponent,
                    dispersion: *dispersion,
                    fibre_directions: fibre_directions.clone(),
                    bulk_pa: linear.bulk_modulus_pa(),
                },
            )?),
        })
    }
}
