//! The neo-Hookean law with ln J: compressible, with infinite energy at zero volume.
//!
//! W = mu/2 (I1 - 3) - mu ln J + lambda/2 (ln J)^2, I1 = tr(F^T F), J = det F (Bonet and Wood, Nonlinear
//! Continuum Mechanics for Finite Element Analysis, 2nd edition 2008, s. 6.4.3). Its volumetric term is
//! lambda/2 (ln J)^2; -mu ln J makes rest free of stress. P = mu F + (lambda ln J - mu) F^-T. lambda, mu [Pa].
//! Valid for J > 0 only: an inverted element has infinite energy and no stress (use
//! [`super::StableNeoHooke`] where elements may invert). Not convex in J above J = e (tension softens there).

use super::law::{cofactor, contraction};
use super::linear_elastic::check_lame;
use super::principal::{self, PAIRS, PrincipalDerivatives};
use super::{LawEntry, LinearElastic, Material, MaterialError, MaterialSpec, NamedLaw, Tangent};
use glisson_mesh::math::DMat3;

/// The law's line in the table of laws.
pub(super) const LAW: LawEntry = LawEntry {
    name: "neo_hooke_log",
    about: "mu/2 (I1 - 3) - mu ln J + lambda/2 (ln J)^2",
    source: "Bonet and Wood 2008, Nonlinear Continuum Mechanics for Finite Element Analysis, s. 6.4.3",
    keys: &[],
    example: "",
    make: |linear, _| Ok(MaterialSpec::from(NeoHookeLog::from(linear))),
};

impl NamedLaw for NeoHookeLog {
    const ENTRY: &'static LawEntry = &LAW;
}

/// The ln J neo-Hookean law.
///
/// ```
/// use glisson_tissue::material::{Material, NeoHookeLog};
/// use glisson_mesh::math::DMat3;
/// let law = NeoHookeLog::new(15_000.0, 1_700.0)?;
/// // Swollen by s in all directions: P = mu s + (3 lambda ln s - mu)/s.
/// let s = 1.1_f64;
/// let expected_pa = 1_700.0 * s + (3.0 * 15_000.0 * s.ln() - 1_700.0) / s;
/// let stress = law.first_piola_pa(&(DMat3::IDENTITY * s));
/// assert!((stress.x_axis.x - expected_pa).abs() < 1e-9 * expected_pa);
/// # Ok::<(), glisson_tissue::material::MaterialError>(())
/// ```
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct NeoHookeLog {
    lambda_pa: f64,
    mu_pa: f64,
}

impl NeoHookeLog {
    /// The law of Lame's coefficients.
    ///
    /// # Errors
    /// [`MaterialError`] unless mu > 0 and lambda > -2/3 mu, both finite.
    pub fn new(lambda_pa: f64, mu_pa: f64) -> Result<Self, MaterialError> {
        check_lame(lambda_pa, mu_pa)?;
        Ok(Self { lambda_pa, mu_pa })
    }

    /// Lame's first coefficient [Pa].
    pub fn lambda_pa(&self) -> f64 {
        self.lambda_pa
    }

    /// Shear modulus [Pa].
    pub fn mu_pa(&self) -> f64 {
        self.mu_pa
    }

    /// lambda ln J - mu; NaN for J <= 0.
    fn pressure_pa(&self, j: f64) -> f64 {
        if j > 0.0 { self.lambda_pa * libm::log(j) - self.mu_pa } else { f64::NAN }
    }

    /// With p = lambda ln J - mu, W_i = mu s_i + p/s_i.
    fn principal(&self, s: [f64; 3]) -> PrincipalDerivatives {
        let (lambda, mu) = (self.lambda_pa, self.mu_pa);
        let p = self.pressure_pa(s[0] * s[1] * s[2]);
        let mut second = [[0.0; 3]; 3];
        for i in 0..3 {
            for j in 0..3 {
                second[i][j] = lambda / (s[i] * s[j]);
            }
            second[i][i] += mu - p / (s[i] * s[i]);
        }
        PrincipalDerivatives {
            first: s.map(|x| mu * x + p / x),
            second,
            symmetric: PAIRS.map(|[i, j]| mu - p / (s[i] * s[j])),
            antisymmetric: PAIRS.map(|[i, j]| mu + p / (s[i] * s[j])),
        }
    }
}

impl From<&LinearElastic> for NeoHookeLog {
    fn from(linear: &LinearElastic) -> Self {
        Self { lambda_pa: linear.lambda_pa(), mu_pa: linear.mu_pa() }
    }
}

impl Material for NeoHookeLog {
    fn energy_density_j_per_m3(&self, f: &DMat3) -> f64 {
        let j = f.determinant();
        if j > 0.0 {
            let log_j = libm::log(j);
            0.5 * self.mu_pa * (contraction(f, f) - 3.0) + log_j * (0.5 * self.lambda_pa * log_j - self.mu_pa)
        } else {
            f64::INFINITY
        }
    }

    fn first_piola_pa(&self, f: &DMat3) -> DMat3 {
        let cofactor = cofactor(f);
        let j = cofactor.x_axis.dot(f.x_axis);
        *f * self.mu_pa + cofactor * (self.pressure_pa(j) / j)
    }

    fn first_piola_differential_pa(&self, f: &DMat3, df: &DMat3) -> DMat3 {
        let cofactor = cofactor(f);
        let j = cofactor.x_axis.dot(f.x_axis);
        let inverse_transposed = cofactor * (1.0 / j);
        let log_j_change = contraction(&inverse_transposed, df);
        *df * self.mu_pa + inverse_transposed * (self.lambda_pa * log_j_change)
            - inverse_transposed * df.transpose() * inverse_transposed * self.pressure_pa(j)
    }

    /// With G = F^-T and p = lambda ln J - mu:
    /// d2W/dF_rc dF_sd = mu delta_rs delta_cd + lambda G_rc G_sd - p G_rd G_sc.
    fn tangent_pa(&self, f: &DMat3) -> Tangent {
        let cofactor = cofactor(f);
        let j = cofactor.x_axis.dot(f.x_axis);
        let g = (cofactor * (1.0 / j)).to_cols_array();
        let p = self.pressure_pa(j);
        let mut tangent = [[0.0; 9]; 9];
        for row in 0..9 {
            for column in 0..9 {
                let ((r, c), (s, d)) = ((row % 3, row / 3), (column % 3, column / 3));
                tangent[row][column] = self.lambda_pa * g[row] * g[column] - p * g[3 * d + r] * g[3 * c + s];
            }
            tangent[row][row] += self.mu_pa;
        }
        tangent
    }

    fn projected_tangent_pa(&self, f: &DMat3) -> Tangent {
        principal::projected_tangent_pa(f, |s| self.principal(s))
    }
}
