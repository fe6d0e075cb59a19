//! The law of St Venant and Kirchhoff: linear in the Green-Lagrange strain, right for large rotations.
//!
//! W = lambda/2 (tr E)^2 + mu tr(E^2), E = (F^T F - Id)/2 (seed `002`, eq. 5). Its volumetric term is
//! lambda/2 (tr E)^2: tr E is the volume change for small strains only, and W stays finite at J = 0.
//! P = F (lambda tr E Id + 2 mu E). lambda, mu [Pa].
//! Valid for any rotation and stretches from about 0.8 to 1.2; pressed below a stretch of 1/sqrt(3) = 0.58 (in
//! uniaxial strain) it softens and then turns inside out, where explicit models guard it ([`squeeze_guard_pa`]).

use super::law::{cofactor, cofactor_differential, contraction};
use super::linear_elastic::check_lame;
use super::principal::{self, PAIRS, PrincipalDerivatives};
use super::{LawEntry, LinearElastic, Material, MaterialError, MaterialSpec, NamedLaw, Tangent};
use glisson_mesh::math::{DMat3, DVec3};

/// The law's line in the table of laws.
pub(super) const LAW: LawEntry = LawEntry {
    name: "st_venant_kirchhoff",
    about: "linear in the Green-Lagrange strain",
    source: "seed 002, eq. 5",
    keys: &[],
    example: "",
    make: |linear, _| Ok(MaterialSpec::from(StVenantKirchhoff::from(linear))),
};

impl NamedLaw for StVenantKirchhoff {
    const ENTRY: &'static LawEntry = &LAW;
}

/// St Venant and Kirchhoff's law.
///
/// ```
/// use glisson_tissue::material::{Material, StVenantKirchhoff};
/// use glisson_mesh::math::{DMat3, DVec3};
/// let law = StVenantKirchhoff::new(15_000.0, 1_700.0)?;
/// // Uniaxial strain F: P = (lambda/2 + mu) F (F^2 - 1).
/// let stretched = DMat3::from_diagonal(DVec3::new(1.2, 1.0, 1.0));
/// let expected_pa = (15_000.0 / 2.0 + 1_700.0) * 1.2 * (1.2 * 1.2 - 1.0);
/// assert!((law.first_piola_pa(&stretched).x_axis.x - expected_pa).abs() < 1e-9 * expected_pa);
/// # Ok::<(), glisson_tissue::material::MaterialError>(())
/// ```
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StVenantKirchhoff {
    lambda_pa: f64,
    mu_pa: f64,
}

impl StVenantKirchhoff {
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

    /// S = lambda tr E Id + 2 mu E.
    fn second_piola_pa(&self, strain: &DMat3) -> DMat3 {
        let trace = strain.x_axis.x + strain.y_axis.y + strain.z_axis.z;
        DMat3::from_diagonal(DVec3::splat(self.lambda_pa * trace)) + *strain * (2.0 * self.mu_pa)
    }

    /// With c = lambda tr E - mu, W_i = c s_i + mu s_i^3.
    fn principal(&self, s: [f64; 3]) -> PrincipalDerivatives {
        let (lambda, mu) = (self.lambda_pa, self.mu_pa);
        let c = lambda * 0.5 * (s[0] * s[0] + s[1] * s[1] + s[2] * s[2] - 3.0) - mu;
        let mut second = [[0.0; 3]; 3];
        for i in 0..3 {
            for j in 0..3 {
                second[i][j] = lambda * s[i] * s[j];
            }
            second[i][i] += c + 3.0 * mu * s[i] * s[i];
        }
        PrincipalDerivatives {
            first: s.map(|x| x * (c + mu * x * x)),
            second,
            symmetric: PAIRS.map(|[i, j]| c + mu * (s[i] * s[i] + s[i] * s[j] + s[j] * s[j])),
            antisymmetric: PAIRS.map(|[i, j]| c + mu * (s[i] * s[i] - s[i] * s[j] + s[j] * s[j])),
        }
    }
}

/// Volume ratio below which [`squeeze_guard_pa`] adds a stress, and its stiffness over lambda + 2 mu: choices. The uniaxial curves of
/// seed `004` go down to a stretch of 0.1; flat tissue is pushed apart by as much as the law bears at most.
pub(crate) const SQUEEZED_J: f64 = 0.1;
const GUARD_STIFFNESS: f64 = 2.0;

/// First Piola-Kirchhoff stress [Pa] that explicit models add to the law where tissue is squeezed below [`SQUEEZED_J`].
///
/// Squeezed along an axis to 1/sqrt(3) the law bears no more, and it rests in its mirror image: tissue under a tip falls through itself,
/// and a law that takes over where it is inside out throws it back, from step to step. The guard's energy, (lambda + 2 mu) (J - J0)^2, is
/// steady where it begins and steeper than the law's own hollow in the mirror image.
pub(crate) fn squeeze_guard_pa(f: &DMat3, lambda_pa: f64, mu_pa: f64) -> Option<DMat3> {
    let cofactor = cofactor(f);
    let below = cofactor.x_axis.dot(f.x_axis) - SQUEEZED_J;
    (below < 0.0).then(|| cofactor * (GUARD_STIFFNESS * (lambda_pa + 2.0 * mu_pa) * below))
}

/// The law with [`squeeze_guard_pa`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct GuardedStVenantKirchhoff(StVenantKirchhoff);

impl GuardedStVenantKirchhoff {
    pub(crate) fn of_lame(lambda_pa: f64, mu_pa: f64) -> Self {
        Self(StVenantKirchhoff { lambda_pa, mu_pa })
    }

    /// The guard's stiffness, and J - J0 where it counts.
    fn guard(&self, f: &DMat3) -> (f64, f64) {
        let modulus_pa = self.0.lambda_pa + 2.0 * self.0.mu_pa;
        (GUARD_STIFFNESS * modulus_pa, (f.determinant() - SQUEEZED_J).min(0.0))
    }
}

impl Material for GuardedStVenantKirchhoff {
    fn returns_from_inversion(&self) -> bool {
        true
    }

    fn energy_density_j_per_m3(&self, f: &DMat3) -> f64 {
        let (modulus_pa, below) = self.guard(f);
        self.0.energy_density_j_per_m3(f) + 0.5 * modulus_pa * below * below
    }

    fn first_piola_pa(&self, f: &DMat3) -> DMat3 {
        let guard_pa = squeeze_guard_pa(f, self.0.lambda_pa, self.0.mu_pa);
        self.0.first_piola_pa(f) + guard_pa.unwrap_or(DMat3::ZERO)
    }

    fn first_piola_differential_pa(&self, f: &DMat3, df: &DMat3) -> DMat3 {
        let (modulus_pa, below) = self.guard(f);
        let own_pa = self.0.first_piola_differential_pa(f, df);
        if below == 0.0 {
            return own_pa;
        }
        let cofactor = cofactor(f);
        let of_volume = cofactor * contraction(&cofactor, df) + cofactor_differential(f, df) * below;
        own_pa + of_volume * modulus_pa
    }
}

impl From<&LinearElastic> for StVenantKirchhoff {
    fn from(linear: &LinearElastic) -> Self {
        Self { lambda_pa: linear.lambda_pa(), mu_pa: linear.mu_pa() }
    }
}

fn green_strain(f: &DMat3) -> DMat3 {
    (f.transpose() * *f - DMat3::IDENTITY) * 0.5
}

impl Material for StVenantKirchhoff {
    fn energy_density_j_per_m3(&self, f: &DMat3) -> f64 {
        let strain = green_strain(f);
        0.5 * contraction(&self.second_piola_pa(&strain), &strain)
    }

    fn first_piola_pa(&self, f: &DMat3) -> DMat3 {
        *f * self.second_piola_pa(&green_strain(f))
    }

    fn first_piola_differential_pa(&self, f: &DMat3, df: &DMat3) -> DMat3 {
        let product = f.transpose() * *df;
        let strain_change = (product + product.transpose()) * 0.5;
        *df * self.second_piola_pa(&green_strain(f)) + *f * self.second_piola_pa(&strain_change)
    }

    /// d2W/dF_rc dF_sd = delta_rs S_cd + lambda F_rc F_sd + mu ((F F^T)_rs delta_cd + F_rd F_sc).
    fn tangent_pa(&self, f: &DMat3) -> Tangent {
        let stress = self.second_piola_pa(&green_strain(f)).to_cols_array();
        let left = (*f * f.transpose()).to_cols_array();
        let g = f.to_cols_array();
        let mut tangent = [[0.0; 9]; 9];
        for row in 0..9 {
            for column in 0..9 {
                let ((r, c), (s, d)) = ((row % 3, row / 3), (column % 3, column / 3));
                let mut entry =
                    self.lambda_pa * g[row] * g[column] + self.mu_pa * g[3 * d + r] * g[3 * c + s];
                if r == s {
                    entry += stress[3 * c + d];
                }
                if c == d {
                    entry += self.mu_pa * left[3 * r + s];
                }
                tangent[row][column] = entry;
            }
        }
        tangent
    }

    fn projected_tangent_pa(&self, f: &DMat3) -> Tangent {
        principal::projected_tangent_pa(f, |s| self.principal(s))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn guarded_tissue_comes_back_from_its_mirror_image_and_its_stress_is_the_energys() {
        let law = GuardedStVenantKirchhoff::of_lame(15_500.0, 1_700.0);
        let squeezed = |s: f64| DMat3::from_diagonal(DVec3::new(s, 1.1, 0.95));
        // Unguarded above J0, and pushed apart at every stretch below that of the law's collapse.
        assert_eq!(law.first_piola_pa(&squeezed(0.2)), law.0.first_piola_pa(&squeezed(0.2)));
        for i in 0..30 {
            let s = 0.5 - 0.06 * f64::from(i);
            assert!(law.first_piola_pa(&squeezed(s)).x_axis.x < 0.0, "{s}");
        }
        let (f, df) =
            (squeezed(-0.3), DMat3::from_cols_array(&[0.3, -0.1, 0.2, 0.4, -0.5, 0.1, -0.2, 0.3, 0.6]));
        let h = 1e-5;
        let energy = |h: f64| law.energy_density_j_per_m3(&(f + df * h));
        let work = contraction(&law.first_piola_pa(&f), &df);
        assert!(((energy(h) - energy(-h)) * (0.5 / h) - work).abs() < 1e-6 * work.abs());
        let stress = |h: f64| law.first_piola_pa(&(f + df * h));
        let change = (stress(h) - stress(-h)) * (0.5 / h);
        assert!((change - law.first_piola_differential_pa(&f, &df)).abs_diff_eq(DMat3::ZERO, 1e-2));
    }
}
