//! The stable neo-Hookean law: finite and restoring for flat and inverted elements.
//!
//! W = m/2 (I1 - 3) + l/2 (J - a)^2 - m/2 ln((I1 + 1)/4) - l/2 (1 - a)^2, I1 = tr(F^T F), J = det F
//! (Smith, de Goes and Kim 2018, doi 10.1145/3180491). Its volumetric term is l/2 (J - a)^2. Two
//! constants are added so that rest has no energy. P = m (1 - 1/(I1 + 1)) F + l (J - a) dJ/dF.
//! The law's own m and l [Pa] come from Lame's coefficients as m = 4/3 mu and l = lambda + 5/6 mu (as
//! they re-parametrise it), with a = 1 + 3/4 m/l: so it agrees with Hooke's law at small strain.
//! Valid for every F; for soft tissue near incompressibility (lambda well above mu).

use super::law::{cofactor, cofactor_differential, contraction};
use super::linear_elastic::check_lame;
use super::principal::{self, PAIRS, PrincipalDerivatives};
use super::{LawEntry, LinearElastic, Material, MaterialError, MaterialSpec, NamedLaw, Tangent};
use glisson_mesh::math::DMat3;

/// The law's line in the table of laws.
pub(super) const LAW: LawEntry = LawEntry {
    name: "stable_neo_hooke",
    about: "Smith, de Goes and Kim 2018: bears inverted elements",
    source: "Smith, de Goes and Kim 2018, doi 10.1145/3180491",
    keys: &[],
    example: "",
    make: |linear, _| Ok(MaterialSpec::from(StableNeoHooke::from(linear))),
};

impl NamedLaw for StableNeoHooke {
    const ENTRY: &'static LawEntry = &LAW;
}

/// The stable neo-Hookean law.
///
/// ```
/// use glisson_tissue::material::{Material, StableNeoHooke};
/// use glisson_mesh::math::{DMat3, DVec3};
/// let law = StableNeoHooke::new(15_000.0, 1_700.0)?;
/// // Turned inside out, it still has a finite energy and pushes back.
/// let inverted = DMat3::from_diagonal(DVec3::new(-0.1, 1.0, 1.0));
/// assert!(law.energy_density_j_per_m3(&inverted).is_finite());
/// assert!(law.first_piola_pa(&inverted).x_axis.x < 0.0);
/// # Ok::<(), glisson_tissue::material::MaterialError>(())
/// ```
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StableNeoHooke {
    own_mu_pa: f64,
    own_lambda_pa: f64,
    /// a: the volume ratio at which the volumetric term alone rests.
    rest_ratio: f64,
}

impl StableNeoHooke {
    /// The law that agrees with Lame's coefficients at small strain.
    ///
    /// # Errors
    /// [`MaterialError`] unless mu > 0 and lambda > -2/3 mu, both finite.
    pub fn new(lambda_pa: f64, mu_pa: f64) -> Result<Self, MaterialError> {
        check_lame(lambda_pa, mu_pa)?;
        Ok(Self::of_lame(lambda_pa, mu_pa))
    }

    fn of_lame(lambda_pa: f64, mu_pa: f64) -> Self {
        let own_mu_pa = 4.0 / 3.0 * mu_pa;
        let own_lambda_pa = lambda_pa + 5.0 / 6.0 * mu_pa;
        Self { own_mu_pa, own_lambda_pa, rest_ratio: 1.0 + 0.75 * own_mu_pa / own_lambda_pa }
    }

    /// Lame's first coefficient [Pa] at small strain.
    pub fn lambda_pa(&self) -> f64 {
        self.own_lambda_pa - 5.0 / 6.0 * self.mu_pa()
    }

    /// Shear modulus [Pa] at small strain.
    pub fn mu_pa(&self) -> f64 {
        0.75 * self.own_mu_pa
    }

    /// The law's own l and m [Pa].
    pub(crate) fn own_pa(&self) -> [f64; 2] {
        [self.own_lambda_pa, self.own_mu_pa]
    }

    /// With k = 1 - 1/(I1 + 1), g = l (J - a) and c_i = dJ/ds_i, W_i = m k s_i + g c_i.
    pub(crate) fn principal(&self, s: [f64; 3]) -> PrincipalDerivatives {
        let (mu, lambda) = (self.own_mu_pa, self.own_lambda_pa);
        let share = 1.0 / (s[0] * s[0] + s[1] * s[1] + s[2] * s[2] + 1.0);
        let shear = mu * (1.0 - share);
        let pressure = lambda * (s[0] * s[1] * s[2] - self.rest_ratio);
        let area = PAIRS.map(|[i, j]| s[i] * s[j]);
        let mut second = [[0.0; 3]; 3];
        for i in 0..3 {
            for j in 0..3 {
                second[i][j] = 2.0 * mu * share * share * s[i] * s[j] + lambda * area[i] * area[j];
                if i != j {
                    second[i][j] += pressure * s[3 - i - j];
                }
            }
            second[i][i] += shear;
        }
        PrincipalDerivatives {
            first: std::array::from_fn(|i| shear * s[i] + pressure * area[i]),
            second,
            symmetric: s.map(|x| shear - pressure * x),
            antisymmetric: s.map(|x| shear + pressure * x),
        }
    }
}

impl From<&LinearElastic> for StableNeoHooke {
    fn from(linear: &LinearElastic) -> Self {
        Self::of_lame(linear.lambda_pa(), linear.mu_pa())
    }
}

impl Material for StableNeoHooke {
    fn returns_from_inversion(&self) -> bool {
        true
    }

    fn energy_density_j_per_m3(&self, f: &DMat3) -> f64 {
        let squares = contraction(f, f);
        let away = f.determinant() - self.rest_ratio;
        let at_rest = 1.0 - self.rest_ratio;
        0.5 * self.own_mu_pa * (squares - 3.0 - libm::log(0.25 * (squares + 1.0)))
            + 0.5 * self.own_lambda_pa * (away * away - at_rest * at_rest)
    }

    fn first_piola_pa(&self, f: &DMat3) -> DMat3 {
        let cofactor = cofactor(f);
        let j = cofactor.x_axis.dot(f.x_axis);
        let shear_pa = self.own_mu_pa * (1.0 - 1.0 / (contraction(f, f) + 1.0));
        *f * shear_pa + cofactor * (self.own_lambda_pa * (j - self.rest_ratio))
    }

    fn first_piola_differential_pa(&self, f: &DMat3, df: &DMat3) -> DMat3 {
        let cofactor = cofactor(f);
        let j = cofactor.x_axis.dot(f.x_axis);
        let share = 1.0 / (contraction(f, f) + 1.0);
        *df * (self.own_mu_pa * (1.0 - share))
            + *f * (2.0 * self.own_mu_pa * share * share * contraction(f, df))
            + cofactor * (self.own_lambda_pa * contraction(&cofactor, df))
            + cofactor_differential(f, df) * (self.own_lambda_pa * (j - self.rest_ratio))
    }

    fn projected_tangent_pa(&self, f: &DMat3) -> Tangent {
        principal::projected_tangent_pa(f, |s| self.principal(s))
    }
}
