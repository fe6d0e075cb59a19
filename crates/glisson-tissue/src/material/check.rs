//! The check that every law passes: its stress and its differential against central differences, and a projected
//! tangent without negative eigenvalue.

use super::{Material, Tangent};
use glisson_mesh::math::{DMat3, SeededRandom};

/// Random strains that are looked at, and their seed.
const N_STRAINS: usize = 50;
const SEED: u64 = 8;
/// Largest entry of a strain.
const LARGEST_STRAIN: f64 = 0.3;
/// Step of the central differences: an error about its square of truncation and 1e-16 over it of rounding.
const STEP: f64 = 1e-5;
/// What is added to the diagonal before a tangent counts as indefinite, as a share of its largest entry: rounding.
const SHIFT: f64 = 1e-9;

/// How far a law's functions are from each other; 0 for one without a mistake, but for the rounding of differences.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct DerivativeErrors {
    /// Largest difference of P : dF and the change of W, as a share of the tangent's largest entry.
    pub stress: f64,
    /// Largest difference of dP and the change of P, as a share of the tangent's largest entry.
    pub differential: f64,
    /// Projected tangents with a negative eigenvalue.
    pub n_negative: u32,
}

/// What a law's functions are off at 50 random strains of up to 30 %, for a law that has an energy there.
///
/// ```
/// use glisson_tissue::material::{LinearElastic, NeoHookeLog, check::derivative_errors};
/// let liver = LinearElastic::from_young_poisson(5000.0, 0.45, 1060.0)?;
/// let errors = derivative_errors(&NeoHookeLog::from(&liver));
/// assert!(errors.stress < 1e-6 && errors.differential < 1e-6 && errors.n_negative == 0);
/// # Ok::<(), glisson_tissue::material::MaterialError>(())
/// ```
pub fn derivative_errors(law: &dyn Material) -> DerivativeErrors {
    let mut random = SeededRandom::new(SEED);
    let mut errors = DerivativeErrors::default();
    for _ in 0..N_STRAINS {
        let mut entry =
            |size: f64| DMat3::from_cols_array(&std::array::from_fn(|_| random.uniform_in(-size, size)));
        let (f, df) = (DMat3::IDENTITY + entry(LARGEST_STRAIN), entry(1.0));
        let tangent = law.tangent_pa(&f);
        let scale_pa = tangent.iter().flatten().fold(0.0_f64, |m, x| m.max(x.abs()));
        let stress = law.first_piola_pa(&f);
        let ahead = f + df * STEP;
        let behind = f - df * STEP;
        let slope =
            (law.energy_density_j_per_m3(&ahead) - law.energy_density_j_per_m3(&behind)) / (2.0 * STEP);
        errors.stress = worse(errors.stress, (slope - dot(&stress, &df)).abs() / scale_pa);
        let change = (law.first_piola_pa(&ahead) - law.first_piola_pa(&behind)) * (0.5 / STEP);
        let differential = law.first_piola_differential_pa(&f, &df);
        errors.differential = worse(errors.differential, norm(&(change - differential)) / scale_pa);
        let is_definite = is_positive(&law.projected_tangent_pa(&f), SHIFT * scale_pa);
        errors.n_negative += u32::from(!is_definite);
    }
    errors
}

/// The larger one; a difference that is no number is infinitely large.
fn worse(least: f64, found: f64) -> f64 {
    if found.is_nan() { f64::INFINITY } else { least.max(found) }
}

fn norm(a: &DMat3) -> f64 {
    dot(a, a).sqrt()
}

fn dot(a: &DMat3, b: &DMat3) -> f64 {
    a.to_cols_array().iter().zip(b.to_cols_array()).map(|(x, y)| x * y).sum()
}

/// Whether a matrix, with so much added to its diagonal, has a Cholesky factor.
fn is_positive(tangent: &Tangent, shift: f64) -> bool {
    let mut l = *tangent;
    for k in 0..9 {
        l[k][k] += shift;
    }
    for j in 0..9 {
        for k in 0..j {
            for i in j..9 {
                l[i][j] -= l[i][k] * l[j][k];
            }
        }
        if l[j][j].is_nan() || l[j][j] <= 0.0 {
            return false;
        }
        let root = l[j][j].sqrt();
        for row in &mut l[j..] {
            row[j] /= root;
        }
    }
    true
}

#[cfg(test)]
mod tests {
    use super::super::{LinearElastic, NeoHookeLog, every_law};
    use super::*;

    fn liver() -> LinearElastic {
        LinearElastic::from_young_poisson(5000.0, 0.45, 1060.0).expect("the numbers are in range")
    }

    #[test]
    fn every_law_of_the_table_passes() {
        for law in every_law(&liver()).unwrap() {
            let (name, errors) = (law.name(), derivative_errors(law.material()));
            assert!(errors.stress < 1e-6 && errors.differential < 1e-6, "{name}: {errors:?}");
            assert_eq!(errors.n_negative, 0, "{name}");
        }
    }

    /// A law with one mistake: a share of its stress, of its differential, or no number.
    struct Wrong {
        stress: f64,
        differential: f64,
    }

    impl Material for Wrong {
        fn energy_density_j_per_m3(&self, f: &DMat3) -> f64 {
            NeoHookeLog::from(&liver()).energy_density_j_per_m3(f)
        }

        fn first_piola_pa(&self, f: &DMat3) -> DMat3 {
            NeoHookeLog::from(&liver()).first_piola_pa(f) * self.stress
        }

        fn first_piola_differential_pa(&self, f: &DMat3, df: &DMat3) -> DMat3 {
            NeoHookeLog::from(&liver()).first_piola_differential_pa(f, df) * self.differential
        }
    }

    #[test]
    fn a_mistake_of_a_thousandth_is_found() {
        let errors = |stress, differential| derivative_errors(&Wrong { stress, differential });
        let right = errors(1.0, 1.0);
        assert!(right.stress < 1e-6 && right.differential < 1e-6 && right.n_negative == 0, "{right:?}");
        assert!(errors(1.001, 1.001).stress > 1e-6);
        let wrong = errors(1.0, 1.001);
        assert!(wrong.stress < 1e-6 && wrong.differential > 1e-6, "{wrong:?}");
        assert!(errors(f64::NAN, 1.0).stress.is_infinite());
    }
}
