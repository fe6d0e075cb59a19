//! The law of Mooney and Rivlin, with two constants and a bulk modulus.
//!
//! W = C10 (J^(-2/3) I1 - 3) + C01 (J^(-4/3) I2 - 3) + K/2 (J - 1)^2, I1 = tr C, I2 = ((tr C)^2 - tr C^2)/2,
//! C = F^T F, J = det F (Rivlin 1948, doi 10.1098/rsta.1948.0024, made compressible by the volumetric term
//! K/2 (J - 1)^2 and by isochoric invariants). C10, C01, K [Pa].
//! Small strain: mu = 2 (C10 + C01), bulk modulus K. Valid for J > 0 (an inverted element has infinite
//! energy); nearly incompressible bodies in stretches from about 0.5 to 2.

use super::linear_elastic::check_bulk;
use super::principal::{self, PAIRS, PrincipalDerivatives};
use super::{
    LawEntry, LawKey, LawKeyKind, LinearElastic, Material, MaterialError, MaterialSpec, NamedLaw,
    NumberRange, Tangent, Typical,
};
use glisson_mesh::math::DMat3;

/// C01 as a share of C10 + C01.
const SECOND_SHARE: NumberRange = NumberRange { allowed: "0 to 1", holds: |x| (0.0..=1.0).contains(&x) };

/// The law's line in the table of laws.
pub(super) const LAW: LawEntry = LawEntry {
    name: "mooney_rivlin",
    about: "two isochoric invariants",
    source: "Rivlin 1948, doi 10.1098/rsta.1948.0024",
    keys: &[LawKey {
        name: "c01_share",
        about: "C01 as a share of C10 + C01, 0 to 1",
        kind: LawKeyKind::Number(None),
        range: SECOND_SHARE,
        typical: Typical::Number(0.4),
    }],
    example: "law = { name = \"mooney_rivlin\", c01_share = 0.4 }",
    make: |linear, own| Ok(MaterialSpec::from(MooneyRivlin::from_linear(linear, own.number("c01_share"))?)),
};

impl NamedLaw for MooneyRivlin {
    const ENTRY: &'static LawEntry = &LAW;
}

/// Mooney and Rivlin's law.
///
/// ```
/// use glisson_tissue::material::{Material, MooneyRivlin};
/// use glisson_mesh::math::{DMat3, DVec3};
/// let brain = MooneyRivlin::new(263.0, 263.0, 1e6)?;
/// // Uniaxial stretch s at constant volume: P_11 - P_22 s_2/s = 2 (C10 + C01/s)(s - 1/s^2).
/// let (s, t) = (1.25_f64, 1.0 / 1.25_f64.sqrt());
/// let stress = brain.first_piola_pa(&DMat3::from_diagonal(DVec3::new(s, t, t)));
/// let nominal_pa = stress.x_axis.x - stress.y_axis.y * t / s;
/// assert!((nominal_pa - 2.0 * (263.0 + 263.0 / s) * (s - 1.0 / (s * s))).abs() < 1e-6);
/// # Ok::<(), glisson_tissue::material::MaterialError>(())
/// ```
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MooneyRivlin {
    c10_pa: f64,
    c01_pa: f64,
    bulk_pa: f64,
}

impl MooneyRivlin {
    /// The law of its constants.
    ///
    /// # Errors
    /// [`MaterialError`] unless C10 and C01 are finite and not negative, their sum positive and K positive.
    pub fn new(c10_pa: f64, c01_pa: f64, bulk_pa: f64) -> Result<Self, MaterialError> {
        for (name, found) in [("C10", c10_pa), ("C01", c01_pa)] {
            if !(found.is_finite() && found >= 0.0) {
                let allowed = "a finite number of Pa, not negative";
                return Err(MaterialError::Parameter { law: "mooney_rivlin", name, found, allowed });
            }
        }
        if c10_pa + c01_pa <= 0.0 {
            return Err(MaterialError::ShearModulus { found_pa: 2.0 * (c10_pa + c01_pa) });
        }
        check_bulk("mooney_rivlin", bulk_pa)?;
        Ok(Self { c10_pa, c01_pa, bulk_pa })
    }

    /// The law that agrees with `linear` at small strain; `second_share` of mu/2 is C01, the rest C10.
    ///
    /// # Errors
    /// [`MaterialError::Parameter`] unless the share is in [0, 1], or when lambda + 2/3 mu is not positive.
    pub fn from_linear(linear: &LinearElastic, second_share: f64) -> Result<Self, MaterialError> {
        SECOND_SHARE.check(LAW.name, "share of C01", second_share)?;
        let half_pa = 0.5 * linear.mu_pa();
        Self::new(half_pa * (1.0 - second_share), half_pa * second_share, linear.bulk_modulus_pa())
    }

    /// W_i = a s_i + b s_i^3 + d/s_i.
    fn principal(&self, s: [f64; 3]) -> PrincipalDerivatives {
        let j = s[0] * s[1] * s[2];
        if j <= 0.0 {
            return PrincipalDerivatives::INVALID;
        }
        let q = s.map(|x| x * x);
        let (i1, i2) = (q[0] + q[1] + q[2], q[0] * q[1] + q[1] * q[2] + q[2] * q[0]);
        let shrink = 1.0 / libm::cbrt(j * j);
        let (c1, c2) = (self.c10_pa * shrink, self.c01_pa * shrink * shrink);
        let a = 2.0 * (c1 + c2 * i1);
        let b = -2.0 * c2;
        let d = -2.0 / 3.0 * c1 * i1 - 4.0 / 3.0 * c2 * i2 + self.bulk_pa * (j - 1.0) * j;
        // Changes of a, b and d with s_j.
        let da: [f64; 3] =
            std::array::from_fn(|k| -4.0 / 3.0 * (c1 + 2.0 * c2 * i1) / s[k] + 4.0 * c2 * s[k]);
        let db: [f64; 3] = std::array::from_fn(|k| 8.0 / 3.0 * c2 / s[k]);
        let dd: [f64; 3] = std::array::from_fn(|k| {
            let first = -2.0 / 3.0 * c1 * (2.0 * s[k] - 2.0 / 3.0 * i1 / s[k]);
            let second = -4.0 / 3.0 * c2 * (2.0 * s[k] * (i1 - q[k]) - 4.0 / 3.0 * i2 / s[k]);
            first + second + self.bulk_pa * (2.0 * j - 1.0) * j / s[k]
        });
        let mut second = [[0.0; 3]; 3];
        for i in 0..3 {
            for k in 0..3 {
                second[i][k] = s[i] * da[k] + s[i] * q[i] * db[k] + dd[k] / s[i];
            }
            second[i][i] += a + 3.0 * b * q[i] - d / q[i];
        }
        PrincipalDerivatives {
            first: std::array::from_fn(|i| a * s[i] + b * s[i] * q[i] + d / s[i]),
            second,
            symmetric: PAIRS.map(|[i, k]| a + b * (q[i] + s[i] * s[k] + q[k]) - d / (s[i] * s[k])),
            antisymmetric: PAIRS.map(|[i, k]| a + b * (q[i] - s[i] * s[k] + q[k]) + d / (s[i] * s[k])),
        }
    }
}

impl Material for MooneyRivlin {
    fn energy_density_j_per_m3(&self, f: &DMat3) -> f64 {
        let j = f.determinant();
        if j <= 0.0 {
            return f64::INFINITY;
        }
        let c = f.transpose() * *f;
        let i1 = c.x_axis.x + c.y_axis.y + c.z_axis.z;
        let i2 = 0.5 * (i1 * i1 - super::law::contraction(&c, &c));
        let shrink = 1.0 / libm::cbrt(j * j);
        self.c10_pa * (shrink * i1 - 3.0)
            + self.c01_pa * (shrink * shrink * i2 - 3.0)
            + 0.5 * self.bulk_pa * (j - 1.0) * (j - 1.0)
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
