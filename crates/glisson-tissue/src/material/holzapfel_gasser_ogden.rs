//! The fibre law of Gasser, Ogden and Holzapfel: a soft matrix with two families of dispersed fibres.
//!
//! W = c/2 (J^(-2/3) I1 - 3) + K/2 (J - 1)^2 + sum over families of k1/(2 k2) (exp(k2 E^2) - 1) where E > 0, with
//! E = kappa (I1 - 3) + (1 - 3 kappa)(I4 - 1), I1 = tr(F^T F), I4 = |F a|^2 and a the unit fibre direction at
//! rest (Gasser, Ogden and Holzapfel 2006, doi 10.1098/rsif.2005.0073). Its volumetric term is K/2 (J - 1)^2.
//! c (the shear modulus of the matrix), k1, K [Pa]; k2 without unit; kappa 0 (parallel) to 1/3 (isotropic).
//! We take I1 and I4 of the whole F in E, not of its isochoric part: with the split, fibres do not feel a swelling
//! of a compressible body (Vergori, Destrade, McGarry and Ogden 2013, arXiv 2009.00044). For incompressible
//! bodies the two are the same.
//! Fibres pull only (E > 0), so the tangent jumps where E = 0. Valid for J > 0 (an inverted element has
//! infinite energy) and until exp(k2 E^2) overflows.

use super::law::{add_square, contraction};
use super::linear_elastic::check_bulk;
use super::{
    LawEntry, LawKey, LawKeyKind, Material, MaterialError, MaterialSpec, MooneyRivlin, NamedLaw, NumberRange,
    Tangent, Typical,
};
use glisson_mesh::math::{DMat3, DVec3, outer};
use glisson_mesh::units::Dimension;

/// kappa.
const DISPERSION: NumberRange = NumberRange {
    allowed: "0 (parallel fibres) to 1/3 (isotropic)",
    // The decimal 0.333... that people write for 1/3 may be above it by rounding.
    holds: |x| (0.0..=1.0 / 3.0 + 1e-9).contains(&x),
};

/// The law's line in the table of laws.
pub(super) const LAW: LawEntry = LawEntry {
    name: "holzapfel_gasser_ogden",
    about: "fibres in a soft matrix, which has the moduli of small strain",
    source: "Gasser, Ogden and Holzapfel 2006, doi 10.1098/rsif.2005.0073",
    keys: &[
        LawKey {
            name: "k1",
            about: "stiffness of the fibres",
            kind: LawKeyKind::Positive(Dimension::Pressure),
            range: NumberRange::ABOVE_ZERO,
            typical: Typical::Number(3000.0),
        },
        LawKey {
            name: "k2",
            about: "how fast they stiffen",
            kind: LawKeyKind::Number(None),
            range: NumberRange::ABOVE_ZERO,
            typical: Typical::Number(1.5),
        },
        LawKey {
            name: "kappa",
            about: "dispersion about the direction, 0 (parallel) to 1/3 (isotropic)",
            kind: LawKeyKind::Number(Some(0.0)),
            range: DISPERSION,
            typical: Typical::Number(0.1),
        },
        LawKey {
            name: "fibre",
            about: "direction of a family at rest",
            kind: LawKeyKind::Directions,
            range: NumberRange::ANY,
            typical: Typical::Directions(&[DVec3::new(1.0, 2.0, -0.5), DVec3::new(1.0, -1.0, 0.3)]),
        },
    ],
    example: "law = { name = \"holzapfel_gasser_ogden\", k1 = \"20 kPa\", k2 = 5, fibre = [1, 0, 0] }",
    make: |linear, own| {
        Ok(MaterialSpec::from(HolzapfelGasserOgden::new(&HolzapfelGasserOgdenParameters {
            matrix_shear_pa: linear.mu_pa(),
            fibre_stiffness_pa: own.number("k1"),
            fibre_exponent: own.number("k2"),
            dispersion: own.number("kappa"),
            fibre_directions: own.directions().to_vec(),
            bulk_pa: linear.bulk_modulus_pa(),
        })?))
    },
};

impl NamedLaw for HolzapfelGasserOgden {
    const ENTRY: &'static LawEntry = &LAW;
}

/// Parameters of [`HolzapfelGasserOgden`].
#[derive(Clone, Debug, PartialEq)]
pub struct HolzapfelGasserOgdenParameters {
    /// c: shear modulus of the matrix [Pa].
    pub matrix_shear_pa: f64,
    /// k1: stiffness of the fibres [Pa].
    pub fibre_stiffness_pa: f64,
    /// k2: exponent of their stiffening.
    pub fibre_exponent: f64,
    /// kappa: dispersion about the family's direction, 0 to 1/3.
    pub dispersion: f64,
    /// Direction of each family at rest; any length but zero.
    pub fibre_directions: Vec<DVec3>,
    /// K: bulk modulus [Pa].
    pub bulk_pa: f64,
}

/// The law of Gasser, Ogden and Holzapfel.
///
/// ```
/// use glisson_tissue::material::{HolzapfelGasserOgden, HolzapfelGasserOgdenParameters, Material};
/// use glisson_mesh::math::{DMat3, DVec3};
/// let law = HolzapfelGasserOgden::new(&HolzapfelGasserOgdenParameters {
///     matrix_shear_pa: 7_640.0,
///     fibre_stiffness_pa: 996_600.0,
///     fibre_exponent: 524.6,
///     dispersion: 0.226,
///     fibre_directions: vec![DVec3::X],
///     bulk_pa: 1e6,
/// })?;
/// // Fibres pull but do not push.
/// let pulled = law.energy_density_j_per_m3(&DMat3::from_diagonal(DVec3::new(1.05, 1.0, 1.0)));
/// let pressed = law.energy_density_j_per_m3(&DMat3::from_diagonal(DVec3::new(0.95, 1.0, 1.0)));
/// assert!(pulled > 1.5 * pressed);
/// # Ok::<(), glisson_tissue::material::MaterialError>(())
/// ```
#[derive(Clone, Debug, PartialEq)]
pub struct HolzapfelGasserOgden {
    /// C01 = 0: the matrix is the isochoric neo-Hookean law.
    matrix: MooneyRivlin,
    fibre_stiffness_pa: f64,
    fibre_exponent: f64,
    dispersion: f64,
    fibres: Vec<DVec3>,
}

/// Derivatives of a family's energy: dW/dE and d2W/dE2 [Pa], and dE/dF.
struct FamilyState {
    first_pa: f64,
    second_pa: f64,
    gradient: DMat3,
}

impl HolzapfelGasserOgden {
    /// The law of its parameters.
    ///
    /// # Errors
    /// [`MaterialError`] unless c, k1, k2 and K are positive, kappa is in [0, 1/3] and every direction has a
    /// length.
    pub fn new(parameters: &HolzapfelGasserOgdenParameters) -> Result<Self, MaterialError> {
        let p = parameters;
        let law = LAW.name;
        for (name, found) in
            [("c", p.matrix_shear_pa), ("k1", p.fibre_stiffness_pa), ("k2", p.fibre_exponent)]
        {
            NumberRange::ABOVE_ZERO.check(law, name, found)?;
        }
        DISPERSION.check(law, "kappa", p.dispersion)?;
        check_bulk(law, p.bulk_pa)?;
        let mut fibres = Vec::with_capacity(p.fibre_directions.len());
        for direction in &p.fibre_directions {
            match direction.try_normalize() {
                Some(unit) => fibres.push(unit),
                None => {
                    let (name, allowed) = ("length of a fibre direction", "above 0 and finite");
                    return Err(MaterialError::Parameter { law, name, found: direction.length(), allowed });
                }
            }
        }
        Ok(Self {
            matrix: MooneyRivlin::new(0.5 * p.matrix_shear_pa, 0.0, p.bulk_pa)?,
            fibre_stiffness_pa: p.fibre_stiffness_pa,
            fibre_exponent: p.fibre_exponent,
            dispersion: p.dispersion.min(1.0 / 3.0),
            fibres,
        })
    }

    /// 1 - 3 kappa.
    fn alignment(&self) -> f64 {
        1.0 - 3.0 * self.dispersion
    }

    fn family_strain(&self, f: &DMat3, fibre: DVec3) -> f64 {
        self.dispersion * (contraction(f, f) - 3.0) + self.alignment() * ((*f * fibre).length_squared() - 1.0)
    }

    /// The state of a family that is under tension.
    fn family(&self, f: &DMat3, fibre: DVec3) -> Option<FamilyState> {
        let strain = self.family_strain(f, fibre);
        (strain > 0.0).then(|| {
            let stiffness_pa = self.fibre_stiffness_pa * libm::exp(self.fibre_exponent * strain * strain);
            FamilyState {
                first_pa: stiffness_pa * strain,
                second_pa: stiffness_pa * (1.0 + 2.0 * self.fibre_exponent * strain * strain),
                gradient: *f * (2.0 * self.dispersion) + outer(*f * fibre, fibre) * (2.0 * self.alignment()),
            }
        })
    }
}

impl HolzapfelGasserOgden {
    /// Adds the fibres' part to the matrix's tangent.
    fn with_fibres(&self, f: &DMat3, mut tangent: Tangent) -> Tangent {
        for &fibre in &self.fibres {
            let Some(family) = self.family(f, fibre) else { continue };
            add_square(&mut tangent, family.second_pa, &family.gradient.to_cols_array());
            for axis in 0..9 {
                tangent[axis][axis] += 2.0 * self.dispersion * family.first_pa;
            }
            for row in DVec3::AXES {
                let along = outer(row, fibre).to_cols_array();
                add_square(&mut tangent, 2.0 * self.alignment() * family.first_pa, &along);
            }
        }
        tangent
    }
}

impl Material for HolzapfelGasserOgden {
    fn energy_density_j_per_m3(&self, f: &DMat3) -> f64 {
        let mut energy = self.matrix.energy_density_j_per_m3(f);
        for &fibre in &self.fibres {
            let strain = self.family_strain(f, fibre).max(0.0);
            energy += 0.5 * self.fibre_stiffness_pa / self.fibre_exponent
                * libm::expm1(self.fibre_exponent * strain * strain);
        }
        energy
    }

    fn first_piola_pa(&self, f: &DMat3) -> DMat3 {
        let mut stress = self.matrix.first_piola_pa(f);
        for family in self.fibres.iter().filter_map(|&a| self.family(f, a)) {
            stress += family.gradient * family.first_pa;
        }
        stress
    }

    fn first_piola_differential_pa(&self, f: &DMat3, df: &DMat3) -> DMat3 {
        let mut change = self.matrix.first_piola_differential_pa(f, df);
        for &fibre in &self.fibres {
            if let Some(family) = self.family(f, fibre) {
                change += family.gradient * (family.second_pa * contraction(&family.gradient, df));
                let turned =
                    *df * (2.0 * self.dispersion) + outer(*df * fibre, fibre) * (2.0 * self.alignment());
                change += turned * family.first_pa;
            }
        }
        change
    }

    fn tangent_pa(&self, f: &DMat3) -> Tangent {
        self.with_fibres(f, self.matrix.tangent_pa(f))
    }

    /// The matrix's projected tangent plus the fibres', which have no negative eigenvalue: a pulled fibre's
    /// second derivative is a square plus a positive stress times a positive form. Not the nearest such matrix
    /// to the sum, but a convex one that is exact where the matrix's tangent is convex.
    fn projected_tangent_pa(&self, f: &DMat3) -> Tangent {
        self.with_fibres(f, self.matrix.projected_tangent_pa(f))
    }
}
