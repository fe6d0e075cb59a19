//! Ogden's law: a sum of powers of the principal stretches, and a bulk modulus.
//!
//! W = sum_p 2 mu_p/alpha_p^2 (t_1^alpha_p + t_2^alpha_p + t_3^alpha_p - 3) + K/2 (J - 1)^2 with the isochoric
//! stretches t_i = J^(-1/3) s_i (Ogden 1972, doi 10.1098/rspa.1972.0026, in the normalization of Miller and
//! Chinzei 2002, doi 10.1016/S0021-9290(01)00234-2; the volumetric term is K/2 (J - 1)^2). mu_p, K [Pa].
//! Small strain: mu = sum mu_p, bulk modulus K. Valid for J > 0 (an inverted element has infinite energy);
//! brain: mu = 842 Pa, alpha = -4.7 for stretches from 0.74 to 1.22 (natural strain -0.3 to 0.2, Miller and Chinzei).

use super::eigen::signed_singular_values;
use super::linear_elastic::check_bulk;
use super::principal::{self, PAIRS, PrincipalDerivatives};
use super::{
    LawEntry, LawKey, LawKeyKind, LinearElastic, Material, MaterialError, MaterialSpec, NamedLaw,
    NumberRange, Tangent, Typical,
};
use glisson_mesh::math::DMat3;

/// The exponent alpha.
const EXPONENT: NumberRange =
    NumberRange { allowed: "a finite number other than 0", holds: |x| x.is_finite() && x != 0.0 };

/// The law's line in the table of laws.
pub(super) const LAW: LawEntry = LawEntry {
    name: "ogden",
    about: "a power of the principal stretches",
    source: "Ogden 1972, doi 10.1098/rspa.1972.0026",
    keys: &[LawKey {
        name: "exponent",
        about: "the exponent alpha, not 0: it belongs to the tissue",
        kind: LawKeyKind::Number(None),
        range: EXPONENT,
        typical: Typical::Number(-4.7),
    }],
    example: "law = { name = \"ogden\", exponent = -4.7 }",
    make: |linear, own| Ok(MaterialSpec::from(Ogden::from_linear(linear, own.number("exponent"))?)),
};

impl NamedLaw for Ogden {
    const ENTRY: &'static LawEntry = &LAW;
}

/// One power of Ogden's law.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct OgdenTerm {
    /// Its part of the shear modulus [Pa].
    pub mu_pa: f64,
    /// Exponent alpha, not 0.
    pub exponent: f64,
}

/// Ogden's law.
///
/// ```
/// use glisson_tissue::material::{Material, Ogden, OgdenTerm};
/// use glisson_mesh::math::{DMat3, DVec3};
/// let brain = Ogden::new(&[OgdenTerm { mu_pa: 842.0, exponent: -4.7 }], 1e6)?;
/// // Uniaxial stretch s at constant volume: P_11 - P_22 s_2/s = 2 mu/alpha (s^(alpha-1) - s^(-alpha/2-1)).
/// let (s, t) = (0.8_f64, 1.0 / 0.8_f64.sqrt());
/// let stress = brain.first_piola_pa(&DMat3::from_diagonal(DVec3::new(s, t, t)));
/// let nominal_pa = stress.x_axis.x - stress.y_axis.y * t / s;
/// assert!((nominal_pa + 1013.2).abs() < 0.05);
/// # Ok::<(), glisson_tissue::material::MaterialError>(())
/// ```
#[derive(Clone, Debug, PartialEq)]
pub struct Ogden {
    terms: Vec<OgdenTerm>,
    bulk_pa: f64,
}

impl Ogden {
    /// The law of its terms.
    ///
    /// # Errors
    /// [`MaterialError`] unless every mu_p is positive, every alpha_p finite and not 0, there is a term, and K
    /// is positive.
    pub fn new(terms: &[OgdenTerm], bulk_pa: f64) -> Result<Self, MaterialError> {
        if terms.is_empty() {
            return Err(MaterialError::ShearModulus { found_pa: 0.0 });
        }
        for term in terms {
            if !(term.mu_pa.is_finite() && term.mu_pa > 0.0) {
                return Err(MaterialError::ShearModulus { found_pa: term.mu_pa });
            }
            EXPONENT.check(LAW.name, "alpha", term.exponent)?;
        }
        check_bulk("ogden", bulk_pa)?;
        Ok(Self { terms: terms.to_vec(), bulk_pa })
    }

    /// One term that agrees with `linear` at small strain.
    ///
    /// # Errors
    /// [`MaterialError`] as of [`Ogden::new`].
    pub fn from_linear(linear: &LinearElastic, exponent: f64) -> Result<Self, MaterialError> {
        Self::new(&[OgdenTerm { mu_pa: linear.mu_pa(), exponent }], linear.bulk_modulus_pa())
    }

    /// W_i = (sum_p 2 mu_p/alpha_p J^(-alpha_p/3) (s_i^alpha_p - S_p/3) + K (J - 1) J)/s_i, S_p = sum s^alpha_p.
    fn principal(&self, s: [f64; 3]) -> PrincipalDerivatives {
        let j = s[0] * s[1] * s[2];
        if j <= 0.0 {
            return PrincipalDerivatives::INVALID;
        }
        let pressure = self.bulk_pa * (j - 1.0) * j;
        let pressure_slope = self.bulk_pa * (2.0 * j - 1.0) * j;
        let mut result = PrincipalDerivatives {
            first: s.map(|x| pressure / x),
            second: std::array::from_fn(|i| std::array::from_fn(|k| pressure_slope / (s[i] * s[k]))),
            symmetric: PAIRS.map(|[i, k]| -pressure / (s[i] * s[k])),
            antisymmetric: PAIRS.map(|[i, k]| pressure / (s[i] * s[k])),
        };
        for i in 0..3 {
            result.second[i][i] -= pressure / (s[i] * s[i]);
        }
        for term in &self.terms {
            let alpha = term.exponent;
            let factor = 2.0 * term.mu_pa / alpha * libm::pow(j, -alpha / 3.0);
            let power = s.map(|x| libm::pow(x, alpha));
            let mean = (power[0] + power[1] + power[2]) / 3.0;
            for i in 0..3 {
                result.first[i] += factor * (power[i] - mean) / s[i];
                for k in 0..3 {
                    let change = -(power[i] - mean) - power[k];
                    result.second[i][k] += factor * alpha / 3.0 * change / (s[i] * s[k]);
                }
                result.second[i][i] += factor * ((alpha - 1.0) * power[i] + mean) / (s[i] * s[i]);
            }
            for (pair, [i, k]) in PAIRS.into_iter().enumerate() {
                let product = s[i] * s[k];
                let quotient = power_quotient(s[i], s[k], alpha - 1.0);
                result.symmetric[pair] += factor * (quotient + mean / product);
                let sum = (power[i] / s[i] + power[k] / s[k]) / (s[i] + s[k]);
                result.antisymmetric[pair] += factor * (sum - mean / product);
            }
        }
        result
    }
}

/// (x^n - y^n)/(x - y) without cancellation; n y^(n-1) for equal numbers.
fn power_quotient(x: f64, y: f64, n: f64) -> f64 {
    let ratio = libm::log1p((x - y) / y);
    let quotient = if ratio == 0.0 { n } else { libm::expm1(n * ratio) / libm::expm1(ratio) };
    libm::pow(y, n - 1.0) * quotient
}

impl Material for Ogden {
    fn energy_density_j_per_m3(&self, f: &DMat3) -> f64 {
        let s = signed_singular_values(f).stretches;
        let j = s[0] * s[1] * s[2];
        if j <= 0.0 {
            return f64::INFINITY;
        }
        let mut energy = 0.5 * self.bulk_pa * (j - 1.0) * (j - 1.0);
        for term in &self.terms {
            let shrink = libm::pow(j, -term.exponent / 3.0);
            let sum: f64 = s.iter().map(|&x| shrink * libm::pow(x, term.exponent)).sum();
            energy += 2.0 * term.mu_pa / (term.exponent * term.exponent) * (sum - 3.0);
        }
        energy
    }

    fn first_piola_pa(&self, f: &DMat3) -> DMat3 {
        principal::first_piola_pa(f, |s| self.principal(s))
    }

    fn first_piola_differential_pa(&self, f: &DMat3, df: &DMat3) -> DMat3 {
        principal::first_piola_differential_pa(f, df, |s| self.principal(s))
    }

    fn tangent_pa(&self, f: &DMat3) -> Tangent {
        principal::tangent_pa(f, |s| self.principal(s))
    }

    fn projected_tangent_pa(&self, f: &DMat3) -> Tangent {
        principal::projected_tangent_pa(f, |s| self.principal(s))
    }
}
