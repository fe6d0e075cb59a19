//! Isotropic linear elasticity.
//!
//! Energy density W = lambda/2 (tr e)^2 + mu tr(e^2) with the small strain e = (grad u + grad u^T)/2
//! (seed `003`, eq. 1.1 and 1.2), with
//! lambda = E nu / ((1 + nu)(1 - 2 nu)) and mu = E / (2 (1 + nu)).
//! Valid for displacements below about a tenth of the body's size (seed `003`, introduction): a rotated body
//! swells.

use super::law::contraction;
use super::{LawEntry, Material, MaterialSpec, NamedLaw, Tangent};
use glisson_mesh::math::{DMat3, DVec3};

/// The law's line in the table of laws.
pub(super) const LAW: LawEntry = LawEntry {
    name: "linear",
    about: "isotropic linear elasticity at small strain",
    source: "seed 003, eq. 1.1 and 1.2",
    keys: &[],
    example: "",
    make: |linear, _| Ok(MaterialSpec::from(*linear)),
};

impl NamedLaw for LinearElastic {
    const ENTRY: &'static LawEntry = &LAW;
}

/// Why a material is refused.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum MaterialError {
    /// Young's modulus is not a positive finite number.
    #[error("Young's modulus is {found_pa} Pa; allowed: a finite number above 0 Pa")]
    YoungModulus {
        /// What was given [Pa].
        found_pa: f64,
    },
    /// Poisson's ratio is outside the range in which the energy is positive.
    #[error("Poisson's ratio is {found}; allowed: above -1 and below 0.5")]
    PoissonRatio {
        /// What was given.
        found: f64,
    },
    /// The incompressible limit, where lambda is infinite.
    #[error(
        "Poisson's ratio is 0.5 (incompressible), where lambda is infinite and a displacement model has no \
         solution; allowed: above -1 and below 0.5. For nearly incompressible tissue take 0.45 to 0.49"
    )]
    Incompressible,
    /// Shear modulus is not a positive finite number.
    #[error("the shear modulus mu is {found_pa} Pa; allowed: a finite number above 0 Pa")]
    ShearModulus {
        /// What was given [Pa].
        found_pa: f64,
    },
    /// Lambda makes the bulk modulus lambda + 2/3 mu zero, negative or infinite.
    #[error(
        "lambda is {found_pa} Pa; allowed: a finite number above -2/3 mu = {least_pa} Pa (positive bulk modulus)"
    )]
    Lambda {
        /// What was given [Pa].
        found_pa: f64,
        /// Bound, excluded [Pa].
        least_pa: f64,
    },
    /// A law's own parameter is out of its range.
    #[error("{law}: {name} is {found}; allowed: {allowed}")]
    Parameter {
        /// The law's name in scenes.
        law: &'static str,
        /// The parameter's name.
        name: &'static str,
        /// What was given [SI].
        found: f64,
        /// Its range.
        allowed: &'static str,
    },
    /// Density is not a positive finite number.
    #[error("density is {found_kg_per_m3} kg/m3; allowed: a finite number above 0 kg/m3")]
    Density {
        /// What was given [kg/m3].
        found_kg_per_m3: f64,
    },
}

/// An isotropic linear elastic material with a density.
///
/// ```
/// use glisson_tissue::material::LinearElastic;
/// let liver = LinearElastic::from_young_poisson(5000.0, 0.45, 1060.0)?;
/// assert!((liver.mu_pa() - 5000.0 / 2.9).abs() < 1e-9);
/// assert!(LinearElastic::from_young_poisson(5000.0, 0.5, 1060.0).is_err());
/// # Ok::<(), glisson_tissue::material::MaterialError>(())
/// ```
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LinearElastic {
    young_modulus_pa: f64,
    poisson_ratio: f64,
    lambda_pa: f64,
    mu_pa: f64,
    density_kg_per_m3: f64,
}

impl LinearElastic {
    /// The material of Young's modulus E and Poisson's ratio nu.
    ///
    /// # Errors
    /// [`MaterialError`] unless E > 0, -1 < nu < 0.5 and the density is positive.
    pub fn from_young_poisson(
        young_modulus_pa: f64,
        poisson_ratio: f64,
        density_kg_per_m3: f64,
    ) -> Result<Self, MaterialError> {
        if !(young_modulus_pa.is_finite() && young_modulus_pa > 0.0) {
            return Err(MaterialError::YoungModulus { found_pa: young_modulus_pa });
        }
        if poisson_ratio == 0.5 {
            return Err(MaterialError::Incompressible);
        }
        if !(poisson_ratio > -1.0 && poisson_ratio < 0.5) {
            return Err(MaterialError::PoissonRatio { found: poisson_ratio });
        }
        check_density(density_kg_per_m3)?;
        Ok(Self {
            young_modulus_pa,
            poisson_ratio,
            lambda_pa: young_modulus_pa * poisson_ratio
                / ((1.0 + poisson_ratio) * (1.0 - 2.0 * poisson_ratio)),
            mu_pa: young_modulus_pa / (2.0 * (1.0 + poisson_ratio)),
            density_kg_per_m3,
        })
    }

    /// The material of Lame's coefficients lambda and mu.
    ///
    /// # Errors
    /// [`MaterialError`] unless mu > 0, lambda > -2/3 mu (both finite) and the density is positive.
    pub fn from_lame(lambda_pa: f64, mu_pa: f64, density_kg_per_m3: f64) -> Result<Self, MaterialError> {
        check_lame(lambda_pa, mu_pa)?;
        check_density(density_kg_per_m3)?;
        let sum_pa = lambda_pa + mu_pa;
        Ok(Self {
            young_modulus_pa: mu_pa * (3.0 * lambda_pa + 2.0 * mu_pa) / sum_pa,
            poisson_ratio: lambda_pa / (2.0 * sum_pa),
            lambda_pa,
            mu_pa,
            density_kg_per_m3,
        })
    }

    /// Young's modulus E [Pa].
    pub fn young_modulus_pa(&self) -> f64 {
        self.young_modulus_pa
    }

    /// Poisson's ratio nu.
    pub fn poisson_ratio(&self) -> f64 {
        self.poisson_ratio
    }

    /// Lame's first coefficient lambda [Pa].
    pub fn lambda_pa(&self) -> f64 {
        self.lambda_pa
    }

    /// Shear modulus mu [Pa].
    pub fn mu_pa(&self) -> f64 {
        self.mu_pa
    }

    /// Bulk modulus lambda + 2/3 mu [Pa].
    pub fn bulk_modulus_pa(&self) -> f64 {
        self.lambda_pa + 2.0 / 3.0 * self.mu_pa
    }

    /// Density [kg/m3].
    pub fn density_kg_per_m3(&self) -> f64 {
        self.density_kg_per_m3
    }
}

/// W as a function of F, with e = (F + F^T)/2 - Id: not rotation invariant.
impl Material for LinearElastic {
    fn returns_from_inversion(&self) -> bool {
        true
    }

    fn energy_density_j_per_m3(&self, f: &DMat3) -> f64 {
        let change = *f - DMat3::IDENTITY;
        0.5 * contraction(&self.first_piola_differential_pa(f, &change), &change)
    }

    fn first_piola_pa(&self, f: &DMat3) -> DMat3 {
        self.first_piola_differential_pa(f, &(*f - DMat3::IDENTITY))
    }

    fn first_piola_differential_pa(&self, _f: &DMat3, df: &DMat3) -> DMat3 {
        let trace = df.x_axis.x + df.y_axis.y + df.z_axis.z;
        DMat3::from_diagonal(DVec3::splat(self.lambda_pa * trace)) + (*df + df.transpose()) * self.mu_pa
    }

    /// The tangent itself: its eigenvalues are 2 mu, 3 lambda + 2 mu and 0.
    fn projected_tangent_pa(&self, f: &DMat3) -> Tangent {
        self.tangent_pa(f)
    }
}

/// Refuses Lame's coefficients for which the energy of small strains is not positive.
pub(super) fn check_lame(lambda_pa: f64, mu_pa: f64) -> Result<(), MaterialError> {
    if !(mu_pa.is_finite() && mu_pa > 0.0) {
        return Err(MaterialError::ShearModulus { found_pa: mu_pa });
    }
    let least_pa = -2.0 / 3.0 * mu_pa;
    if !(lambda_pa.is_finite() && lambda_pa > least_pa) {
        return Err(MaterialError::Lambda { found_pa: lambda_pa, least_pa });
    }
    Ok(())
}

/// Refuses a bulk modulus that is not positive.
pub(super) fn check_bulk(law: &'static str, bulk_pa: f64) -> Result<(), MaterialError> {
    if bulk_pa.is_finite() && bulk_pa > 0.0 {
        Ok(())
    } else {
        let allowed = "a finite number above 0 Pa";
        Err(MaterialError::Parameter { law, name: "the bulk modulus K", found: bulk_pa, allowed })
    }
}

fn check_density(density_kg_per_m3: f64) -> Result<(), MaterialError> {
    if density_kg_per_m3.is_finite() && density_kg_per_m3 > 0.0 {
        Ok(())
    } else {
        Err(MaterialError::Density { found_kg_per_m3: density_kg_per_m3 })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_two_pairs_of_constants_agree() {
        for nu in [-0.9, -0.2, 0.0, 0.3, 0.45, 0.4999] {
            let a = LinearElastic::from_young_poisson(5000.0, nu, 1000.0).unwrap();
            let b = LinearElastic::from_lame(a.lambda_pa(), a.mu_pa(), 1000.0).unwrap();
            assert!((b.young_modulus_pa() - 5000.0).abs() < 1e-8 * 5000.0, "nu {nu}");
            assert!((b.poisson_ratio() - nu).abs() < 1e-12, "nu {nu}");
        }
        // Seed 003, s. 2.4: E = 10000, nu = 0.45 has lambda = 31034, mu = 3448.
        let seed = LinearElastic::from_young_poisson(10000.0, 0.45, 1.0).unwrap();
        assert_eq!((seed.lambda_pa().round(), seed.mu_pa().round()), (31034.0, 3448.0));
    }

    #[test]
    fn impossible_materials_are_refused_with_the_reason() {
        use MaterialError as E;
        let young = |e, nu, rho| LinearElastic::from_young_poisson(e, nu, rho).unwrap_err();
        assert_eq!(young(0.0, 0.3, 1.0), E::YoungModulus { found_pa: 0.0 });
        assert!(matches!(young(f64::NAN, 0.3, 1.0), E::YoungModulus { .. }));
        assert_eq!(young(1.0, 0.5, 1.0), E::Incompressible);
        assert_eq!(young(1.0, 0.6, 1.0), E::PoissonRatio { found: 0.6 });
        assert_eq!(young(1.0, -1.0, 1.0), E::PoissonRatio { found: -1.0 });
        assert!(matches!(young(1.0, f64::NAN, 1.0), E::PoissonRatio { .. }));
        assert_eq!(young(1.0, 0.3, -1.0), E::Density { found_kg_per_m3: -1.0 });
        let lame = |l, m| LinearElastic::from_lame(l, m, 1.0).unwrap_err();
        assert_eq!(lame(1.0, 0.0), E::ShearModulus { found_pa: 0.0 });
        assert!(matches!(lame(-3.0, 3.0), E::Lambda { .. }));
        assert!(matches!(lame(f64::INFINITY, 3.0), E::Lambda { .. }));
    }
}
